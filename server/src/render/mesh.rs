//! Closed triangle meshes with smooth normals: those of `assets/`, read once in the program's life, and
//! simple forms.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use nalgebra::{Point3, Vector3};

use crate::sim::world::Shape;

/// Corners of what is round.
const MERIDIANS: u32 = 24;

/// A closed surface; triangles are counter-clockwise from outside. Coordinates lie in arrays of their own,
/// so that loops over vertices use wide registers.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// x, y and z of the vertices, m.
    pub(super) positions: [Vec<f32>; 3],
    /// x, y and z of their unit normals.
    pub(super) normals: [Vec<f32>; 3],
    pub(super) triangles: Vec<[u32; 3]>,
    /// x, y and z of the triangles' unit normals, and how far out along them they lie, m.
    pub(super) planes: [Vec<f32>; 4],
    /// The sphere around it: centre and radius, m.
    pub(super) centre: Point3<f64>,
    pub(super) radius: f64,
}

impl Mesh {
    /// A mesh from vertices (m), their unit normals, and triangles, which index both.
    ///
    /// # Panics
    /// Where a triangle has a vertex that is not there.
    pub fn new(
        positions: &[Point3<f64>],
        normals: &[Vector3<f64>],
        triangles: Vec<[u32; 3]>,
    ) -> Self {
        assert!(positions.len() == normals.len(), "a normal for each vertex");
        let last = triangles.iter().flatten().max().map_or(0, |last| *last as usize + 1);
        assert!(last <= positions.len(), "triangles have vertices that are there");
        let along = |axis: usize| positions.iter().map(|point| point[axis] as f32).collect();
        let across = |axis: usize| normals.iter().map(|normal| normal[axis] as f32).collect();
        let (low, high) = positions.iter().fold(
            (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)),
            |(low, high), point| (low.inf(&point.coords), high.sup(&point.coords)),
        );
        let centre = Point3::from((low + high) * 0.5);
        let mut planes = [(); 4].map(|()| Vec::with_capacity(triangles.len()));
        for corners in &triangles {
            let [a, b, c] = corners.map(|corner| positions[corner as usize]);
            // A triangle without an area has a plane that faces no viewer, and every viewer.
            let out = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
            let plane = [out.x, out.y, out.z, out.dot(&a.coords)];
            planes.iter_mut().zip(plane).for_each(|(all, number)| all.push(number as f32));
        }
        let far = |point: &Point3<f64>| (point - centre).norm();
        Self {
            positions: [along(0), along(1), along(2)],
            normals: [across(0), across(1), across(2)],
            triangles,
            planes,
            centre,
            radius: positions.iter().map(far).fold(0.0, f64::max),
        }
    }

    /// Reads a Wavefront OBJ of triangles with a normal for each corner.
    pub fn from_obj(text: &str) -> Result<Self, ObjError> {
        let (mut points, mut directions) = (vec![], vec![]);
        let (mut positions, mut normals, mut triangles) = (vec![], vec![], vec![]);
        let mut known: HashMap<[usize; 2], u32> = HashMap::new();
        for (index, line) in text.lines().enumerate() {
            let wrong = |what| ObjError { line: index + 1, what };
            let mut words = line.split_ascii_whitespace();
            let kind = words.next().unwrap_or_default();
            match kind {
                "v" | "vn" => {
                    let mut vector = Vector3::zeros();
                    for number in &mut vector {
                        let word = words.next().and_then(|word| word.parse::<f64>().ok());
                        *number =
                            word.filter(|number| number.is_finite()).ok_or(wrong("numbers"))?;
                    }
                    if kind == "v" {
                        points.push(Point3::from(vector));
                    } else {
                        directions.push(vector);
                    }
                }
                "f" => {
                    let mut corners = [0; 3];
                    for corner in &mut corners {
                        let word = words.next().ok_or(wrong("three corners"))?;
                        let (point, normal) = word.split_once("//").ok_or(wrong("normals"))?;
                        let parse = |word: &str| word.parse::<usize>().ok()?.checked_sub(1);
                        let key = parse(point).zip(parse(normal)).ok_or(wrong("indices"))?;
                        let point = points.get(key.0).ok_or(wrong("known vertices"))?;
                        let normal = directions.get(key.1).ok_or(wrong("known normals"))?;
                        *corner = *known.entry([key.0, key.1]).or_insert_with(|| {
                            positions.push(*point);
                            normals.push(*normal);
                            positions.len() as u32 - 1
                        });
                    }
                    triangles.push(corners);
                    if words.next().is_some() {
                        return Err(wrong("three corners"));
                    }
                }
                _ => {}
            }
        }
        Ok(Self::new(&positions, &normals, triangles))
    }

    /// The form of a collision shape.
    pub fn of_shape(shape: &Shape) -> Self {
        match shape {
            Shape::Cuboid(half) => Self::cuboid(half),
            Shape::Capsule { a, b, radius } => Self::capsule(a, b, *radius),
            Shape::Cylinder { half_height, radius } => Self::cylinder(*half_height, *radius),
        }
    }

    /// A box with sharp edges by its half extents, m.
    pub fn cuboid(half: &Vector3<f64>) -> Self {
        let (mut positions, mut normals, mut triangles) = (vec![], vec![], vec![]);
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let first = positions.len() as u32;
                for (u, v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                    let mut corner = Vector3::zeros();
                    corner[axis] = side;
                    corner[(axis + 1) % 3] = u * side;
                    corner[(axis + 2) % 3] = v;
                    positions.push(Point3::from(corner.component_mul(half)));
                    let mut normal = Vector3::zeros();
                    normal[axis] = side;
                    normals.push(normal);
                }
                triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
        Self::new(&positions, &normals, triangles)
    }

    /// The points within `radius` of the segment from `a` to `b`, m; a sphere where both are one.
    pub fn capsule(a: &Point3<f64>, b: &Point3<f64>, radius: f64) -> Self {
        /// From the pole to the equator.
        const CIRCLES: u32 = 6;
        let z = (b - a).try_normalize(1e-12).unwrap_or_else(Vector3::z);
        let x = z.cross(&if z.x.abs() < 0.5 { Vector3::x() } else { Vector3::y() }).normalize();
        let y = z.cross(&x);
        let (mut positions, mut normals, mut triangles) = (vec![], vec![], vec![]);
        for end in 0..2_u32 {
            for circle in 0..=CIRCLES {
                let step = f64::from(if end == 0 { circle } else { CIRCLES - circle });
                let angle = std::f64::consts::FRAC_PI_2 * step / f64::from(CIRCLES);
                let (across, along) = (libm::sin(angle), libm::cos(angle));
                let (centre, along) = if end == 0 { (a, -along) } else { (b, along) };
                for meridian in 0..MERIDIANS {
                    let turn = std::f64::consts::TAU * f64::from(meridian) / f64::from(MERIDIANS);
                    let around = x * libm::cos(turn) + y * libm::sin(turn);
                    let normal = around * across + z * along;
                    positions.push(centre + normal * radius);
                    normals.push(normal);
                }
            }
        }
        for circle in 0..=2 * CIRCLES {
            for meridian in 0..MERIDIANS {
                let next = (meridian + 1) % MERIDIANS;
                let [low, high] = [circle * MERIDIANS, (circle + 1) * MERIDIANS];
                let [a, b, c, d] = [low + meridian, low + next, high + next, high + meridian];
                // At the poles a circle is a point.
                if circle != 0 {
                    triangles.push([a, b, c]);
                }
                if circle != 2 * CIRCLES {
                    triangles.push([a, c, d]);
                }
            }
        }
        Self::new(&positions, &normals, triangles)
    }

    /// The points within `radius` of the y axis and within `half_height` of the origin along it, m.
    pub fn cylinder(half_height: f64, radius: f64) -> Self {
        let (mut positions, mut normals, mut triangles) = (vec![], vec![], vec![]);
        let mut ring = |y: f64, normal: &dyn Fn(Vector3<f64>) -> Vector3<f64>| {
            for meridian in 0..MERIDIANS {
                let turn = std::f64::consts::TAU * f64::from(meridian) / f64::from(MERIDIANS);
                let outward = Vector3::new(libm::sin(turn), 0.0, libm::cos(turn));
                positions.push(Point3::from(outward * radius + Vector3::y() * y));
                normals.push(normal(outward));
            }
        };
        // The mantle, then the ends, which have edges with it.
        for y in [-half_height, half_height] {
            ring(y, &|outward| outward);
        }
        for end in [-1.0, 1.0] {
            ring(end * half_height, &|_| Vector3::y() * end);
        }
        let [low, high, bottom, top] = [0, 1, 2, 3].map(|ring| ring * MERIDIANS);
        for meridian in 0..MERIDIANS {
            let next = (meridian + 1) % MERIDIANS;
            let [a, b, c, d] = [low + meridian, low + next, high + next, high + meridian];
            triangles.extend([[a, b, c], [a, c, d]]);
            if (1..MERIDIANS - 1).contains(&meridian) {
                triangles.push([bottom, bottom + next, bottom + meridian]);
                triangles.push([top, top + meridian, top + next]);
            }
        }
        Self::new(&positions, &normals, triangles)
    }

    /// Number of its triangles.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Whether it has no triangle.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Its vertices, m.
    pub fn vertices(&self) -> impl Iterator<Item = Point3<f32>> {
        let [x, y, z] = &self.positions;
        x.iter().zip(y).zip(z).map(|((x, y), z)| Point3::new(*x, *y, *z))
    }

    /// The unit normals of its vertices.
    pub fn normals(&self) -> impl Iterator<Item = Vector3<f32>> {
        let [x, y, z] = &self.normals;
        x.iter().zip(y).zip(z).map(|((x, y), z)| Vector3::new(*x, *y, *z))
    }

    /// Its triangles: numbers of vertices, counter-clockwise from outside.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }
}

/// Why a text is no mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("line {line} of the OBJ does not have {what}")]
pub struct ObjError {
    /// The line, from 1.
    pub line: usize,
    /// What it lacks.
    pub what: &'static str,
}

/// A mesh, perhaps still to be read.
#[derive(Debug, Clone)]
pub enum Form {
    /// One of `assets/`.
    Embedded(&'static Embedded),
    /// One that was made.
    Made(Arc<Mesh>),
}

impl Form {
    /// A mesh of `assets/`, by its path there, e.g. `needle/meshes/needle.obj`; none where the program has
    /// no such mesh.
    pub fn embedded(path: &str) -> Option<Self> {
        EMBEDDED.iter().find(|entry| entry.path == path).map(Self::Embedded)
    }

    /// The mesh, which is read when it is first asked for.
    pub fn mesh(&self) -> Arc<Mesh> {
        match self {
            Self::Made(mesh) => Arc::clone(mesh),
            Self::Embedded(entry) => {
                let read = || Mesh::from_obj(entry.text);
                let mesh = entry.mesh.get_or_init(|| match read() {
                    Ok(mesh) => Arc::new(mesh),
                    Err(why) => panic!("{}: {why}", entry.path), // tests read them all
                });
                Arc::clone(mesh)
            }
        }
    }
}

/// A mesh that is part of the program.
#[derive(Debug)]
pub struct Embedded {
    path: &'static str,
    text: &'static str,
    mesh: OnceLock<Arc<Mesh>>,
}

macro_rules! embedded {
    ($($path:literal)*) => {
        [$(Embedded {
            path: $path,
            text: include_str!(concat!("../../../assets/", $path)),
            mesh: OnceLock::new(),
        }),*]
    };
}

static EMBEDDED: [Embedded; 52] = embedded![
    "block/meshes/block.obj"
    "cube/meshes/cube_100.obj"
    "cube/meshes/cube_80.obj"
    "ecm/meshes/back.obj"
    "ecm/meshes/bar.obj"
    "ecm/meshes/base.obj"
    "ecm/meshes/base_flange.obj"
    "ecm/meshes/camera_head.obj"
    "ecm/meshes/camera_trim.obj"
    "ecm/meshes/cannula.obj"
    "ecm/meshes/cannula_mount.obj"
    "ecm/meshes/carriage.obj"
    "ecm/meshes/light_straight.obj"
    "ecm/meshes/rail.obj"
    "ecm/meshes/rail_track.obj"
    "ecm/meshes/scope_straight.obj"
    "ecm/meshes/window_straight.obj"
    "ecm/meshes/yaw_body.obj"
    "ecm/meshes/yaw_fork.obj"
    "cylinder/meshes/cylinder.obj"
    "gauze/meshes/gauze.obj"
    "needle/meshes/needle.obj"
    "pad/meshes/pad.obj"
    "pegboard/meshes/board.obj"
    "pegboard/meshes/pegs.obj"
    "psm/meshes/axle.obj"
    "psm/meshes/back.obj"
    "psm/meshes/bar.obj"
    "psm/meshes/base.obj"
    "psm/meshes/base_flange.obj"
    "psm/meshes/cannula.obj"
    "psm/meshes/cannula_mount.obj"
    "psm/meshes/carriage.obj"
    "psm/meshes/clevis.obj"
    "psm/meshes/housing.obj"
    "psm/meshes/housing_trim.obj"
    "psm/meshes/jaw.obj"
    "psm/meshes/rail.obj"
    "psm/meshes/rail_track.obj"
    "psm/meshes/shaft.obj"
    "psm/meshes/shaft_end.obj"
    "psm/meshes/yaw_body.obj"
    "psm/meshes/yaw_fork.obj"
    "psm_si/meshes/back.obj"
    "psm_si/meshes/cannula.obj"
    "psm_si/meshes/cannula_mount.obj"
    "psm_si/meshes/rail.obj"
    "psm_si/meshes/rail_track.obj"
    "psm_si/meshes/shaft.obj"
    "table/meshes/legs.obj"
    "table/meshes/top.obj"
    "tray/meshes/tray.obj"
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Volume by the theorem of Gauss, m³: positive where all triangles face outwards.
    fn volume(mesh: &Mesh) -> f64 {
        let at: Vec<_> = mesh.vertices().map(|point| point.coords.cast::<f64>()).collect();
        let of = |[a, b, c]: &[u32; 3]| {
            at[*a as usize].dot(&at[*b as usize].cross(&at[*c as usize])) / 6.0
        };
        mesh.triangles().iter().map(of).sum()
    }

    #[test]
    fn every_embedded_mesh_is_read_and_faces_outwards() {
        for entry in &EMBEDDED {
            let mesh = Form::embedded(entry.path).unwrap().mesh();
            assert!(mesh.len() > 10 && volume(&mesh) > 0.0, "{}", entry.path);
            assert!(mesh.radius < 5.0, "{}", entry.path);
            assert!(Arc::ptr_eq(&mesh, &Form::embedded(entry.path).unwrap().mesh()));
        }
        assert!(Form::embedded("needle/meshes/thread.obj").is_none());
    }

    #[test]
    fn simple_forms_have_their_volumes_and_outward_normals() {
        let half = Vector3::new(0.01, 0.02, 0.03);
        let cuboid = Mesh::cuboid(&half);
        assert!((volume(&cuboid) / 48e-6 - 1.0).abs() < 1e-6);
        let (a, b) = (Point3::new(0.0, 0.01, 0.0), Point3::new(0.02, 0.01, 0.01));
        let capsule = Mesh::capsule(&a, &b, 0.005);
        let exact = std::f64::consts::PI * 25e-6 * ((b - a).norm() + 4.0 / 3.0 * 0.005);
        assert!((volume(&capsule) / exact - 1.0).abs() < 0.03);
        let ball = Mesh::capsule(&a, &a, 0.005);
        assert!((volume(&ball) / (4.0 / 3.0 * std::f64::consts::PI * 125e-9) - 1.0).abs() < 0.03);
        for mesh in [cuboid, capsule, ball] {
            for corners in mesh.triangles() {
                let at = |array: &[Vec<f32>; 3], index: u32| {
                    Vector3::from([0, 1, 2].map(|axis| f64::from(array[axis][index as usize])))
                };
                let [a, b, c] = corners.map(|index| at(&mesh.positions, index));
                let face = (b - a).cross(&(c - a)).normalize();
                for index in corners {
                    assert!(face.dot(&at(&mesh.normals, *index)) > 0.8);
                }
            }
        }
    }

    #[test]
    fn what_is_no_mesh_is_refused_with_its_line() {
        let good = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n";
        assert_eq!(Mesh::from_obj(good).unwrap().len(), 1);
        for (from, to, line) in
            [("v 1 0", "v 1 x", 2), ("3//1", "4//1", 5), ("1//1", "1", 5), ("2//1", "0//1", 5)]
        {
            let error = Mesh::from_obj(&good.replacen(from, to, 1)).unwrap_err();
            assert_eq!(error.line, line, "{error}");
        }
    }
}
