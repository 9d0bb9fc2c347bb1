//! From meshes to faces: triangles as they lie in a picture, clipped at the near plane, with what a
//! rasteriser asks of them.

use super::mesh::Mesh;
use crate::sim::world::RestSurface;

/// A linear map and a shift, rows of (x, y, z, 1).
pub(super) type Affine = [[f32; 4]; 3];

/// How points in the axes of a camera or a lamp come to lie in its picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Projection {
    /// Pixels: columns and rows.
    pub(super) size: [usize; 2],
    /// Focal lengths of a camera; pixels per metre of a lamp.
    pub(super) scale: [f32; 2],
    /// Pixel of the axis.
    pub(super) centre: [f32; 2],
    /// Least depth, m, of a camera; none for parallel rays.
    pub(super) near: Option<f32>,
}

/// How far a triangle's normal may turn away from the eye and the triangle still be looked at more closely, rad:
/// far more than rounding.
const TURNED_AWAY: f32 = 1e-4;

/// No point is taken to be nearer to the plane of the lens, m.
const LEAST_DEPTH: f32 = 1e-9;

/// A triangle in a picture.
///
/// A pixel (x, y) lies in it where all three of `edges` are above `least` there; the value of each edge over
/// the area is the weight of the vertex across from it. `key` is what decides which face is seen: linear in
/// the picture, and greater is nearer. For a camera it is 1 / depth, for a lamp minus the depth.
#[derive(Debug, Clone, Copy)]
pub(super) struct Face {
    /// a, b, c of the edges' a·x + b·y + c.
    pub(super) edges: [[f32; 3]; 3],
    pub(super) least: [f32; 3],
    /// One over the sum of the edges.
    pub(super) over_area: f32,
    /// Change of the key along x and y, and the key at the first vertex.
    pub(super) key: [f32; 3],
    /// The first vertex.
    pub(super) origin: [f32; 2],
    /// Numbers of the vertices.
    pub(super) vertices: [u32; 3],
    /// Number of the instance.
    pub(super) instance: u32,
    /// First and last column and row that it can cover.
    pub(super) columns: [u16; 2],
    pub(super) rows: [u16; 2],
}

/// Vertices in a picture and the faces between them. Kept from picture to picture for its memory.
#[derive(Debug, Default)]
#[expect(clippy::struct_field_names, reason = "the faces of all that is drawn")]
pub(super) struct Faces {
    /// Column, row, key and depth of each vertex.
    places: Vec<[f32; 4]>,
    /// Unit normal in the world and key of each vertex, for shading.
    pub(super) normals: Vec<[f32; 4]>,
    pub(super) faces: Vec<Face>,
    /// Where the vertices of painted instances are in the body at rest, m.
    rest: Vec<[f32; 3]>,
    /// Painted instances, and by how much the numbers of their vertices are greater than those of their places at rest.
    painted: Vec<(u32, u32)>,
    /// How much the triangles of a mesh face the eye.
    facing: Vec<f32>,
}

impl Faces {
    pub(super) fn clear(&mut self) {
        self.places.clear();
        self.normals.clear();
        self.faces.clear();
        self.rest.clear();
        self.painted.clear();
    }

    /// Where the corners of a face of a painted instance are in the body at rest, m.
    pub(super) fn rest_of(&self, face: &Face) -> Option<[[f32; 3]; 3]> {
        let (_, less) = self.painted.iter().find(|(instance, _)| *instance == face.instance)?;
        Some(face.vertices.map(|vertex| self.rest[(vertex - less) as usize]))
    }

    /// Adds the faces of a mesh that the projection sees from outside. `turn` takes its normals to the
    /// world; without it there are none. `rest` is where the vertices are in a painted body at rest.
    pub(super) fn add(
        &mut self,
        mesh: &Mesh,
        instance: u32,
        view_from_mesh: &Affine,
        turn: Option<&[[f32; 3]; 3]>,
        rest: Option<&RestSurface>,
        projection: &Projection,
    ) {
        let first = self.places.len();
        if let Some(rest) = rest {
            self.painted.push((instance, (first - self.rest.len()) as u32));
            self.rest.extend(rest.vertices.iter().map(|at| <[f32; 3]>::from(at.coords)));
        }
        let nearest = self.add_vertices(mesh, view_from_mesh, projection);
        if let Some(turn) = turn {
            let [nx, ny, nz] = &mesh.normals;
            let keys = self.places[first..].iter().map(|place| place[2]);
            let normals = nx.iter().zip(ny).zip(nz).zip(keys);
            self.normals.extend(normals.map(|(((x, y), z), key)| {
                let [nx, ny, nz] = turn.map(|row| row[0] * x + row[1] * y + row[2] * z);
                [nx, ny, nz, key]
            }));
        }
        let mut facing = std::mem::take(&mut self.facing);
        let least = how_they_face(mesh, view_from_mesh, projection, &mut facing);
        let turned = mesh.triangles.iter().zip(&facing).filter(|(_, facing)| **facing > least);
        let turned = turned.map(|(corners, _)| corners.map(|corner| corner + first as u32));
        match projection.near.filter(|near| nearest <= *near) {
            None => turned.for_each(|corners| self.add_face(corners, instance, projection)),
            Some(near) => turned.for_each(|corners| {
                let ahead =
                    corners.iter().filter(|corner| self.places[**corner as usize][3] > near);
                match ahead.count() {
                    0 => {}
                    3 => self.add_face(corners, instance, projection),
                    _ => {
                        let has = [turn.is_some(), rest.is_some()];
                        self.add_clipped(corners, instance, projection, near, has);
                    }
                }
            }),
        }
        self.facing = facing;
    }

    /// Adds the vertices of a mesh; the least of their depths.
    fn add_vertices(
        &mut self,
        mesh: &Mesh,
        view_from_mesh: &Affine,
        projection: &Projection,
    ) -> f32 {
        let [mx, my, mz] = &mesh.positions;
        let [sx, sy] = projection.scale;
        let [cx, cy] = projection.centre;
        let [to_x, to_y, to_z] = view_from_mesh;
        let at =
            |row: &[f32; 4], x: f32, y: f32, z: f32| row[0] * x + row[1] * y + row[2] * z + row[3];
        let points = mx.iter().zip(my).zip(mz);
        let mut nearest = f32::INFINITY;
        if projection.near.is_some() {
            self.places.extend(points.map(|((x, y), z)| {
                let depth = at(to_z, *x, *y, *z);
                nearest = nearest.min(depth);
                // Behind the near plane, but so that the place can be had from the quotient again.
                let depth = if depth.abs() < LEAST_DEPTH { LEAST_DEPTH } else { depth };
                let key = 1.0 / depth;
                let column = at(to_x, *x, *y, *z) * key * sx + cx;
                let row = at(to_y, *x, *y, *z) * key * sy + cy;
                [column, row, key, depth]
            }));
        } else {
            self.places.extend(points.map(|((x, y), z)| {
                let depth = at(to_z, *x, *y, *z);
                let column = at(to_x, *x, *y, *z) * sx + cx;
                let row = at(to_y, *x, *y, *z) * sy + cy;
                [column, row, -depth, depth]
            }));
        }
        nearest
    }

    /// Adds what lies beyond the near plane of a triangle that passes through it. `has` says whether vertices have
    /// normals, and places at rest.
    fn add_clipped(
        &mut self,
        corners: [u32; 3],
        instance: u32,
        projection: &Projection,
        near: f32,
        has: [bool; 2],
    ) {
        let mut kept = [0; 4];
        let mut count = 0;
        for index in 0..3 {
            let (from, to) = (corners[index], corners[(index + 1) % 3]);
            let (start, end) = (self.places[from as usize][3], self.places[to as usize][3]);
            if start > near {
                kept[count] = from;
                count += 1;
            }
            if (start > near) != (end > near) {
                // Cut from the same side for both triangles at an edge, so that no gap opens.
                let (from, to) = if start > end { (from, to) } else { (to, from) };
                kept[count] = self.add_cut(from, to, projection, near, has);
                count += 1;
            }
        }
        self.add_face([kept[0], kept[1], kept[2]], instance, projection);
        if count == 4 {
            self.add_face([kept[0], kept[2], kept[3]], instance, projection);
        }
    }

    /// The vertex where the edge from `from`, ahead of the near plane, to `to`, behind it, meets the plane.
    fn add_cut(
        &mut self,
        from: u32,
        to: u32,
        projection: &Projection,
        near: f32,
        [has_normals, has_rest]: [bool; 2],
    ) -> u32 {
        let (from, to) = (from as usize, to as usize);
        let (start, end) = (self.places[from], self.places[to]);
        let part = (start[3] - near) / (start[3] - end[3]);
        let between = |a: f32, b: f32| a + (b - a) * part;
        let [x, y] = [0, 1].map(|axis| {
            let (scale, centre) = (projection.scale[axis], projection.centre[axis]);
            let side = |place: &[f32; 4]| (place[axis] - centre) * place[3] / scale;
            between(side(&start), side(&end)) / near * scale + centre
        });
        let key = 1.0 / near;
        self.places.push([x, y, key, near]);
        if has_normals {
            let (start, end) = (self.normals[from], self.normals[to]);
            let [nx, ny, nz] = [0, 1, 2].map(|axis| between(start[axis], end[axis]));
            self.normals.push([nx, ny, nz, key]);
        }
        if has_rest {
            let (_, less) = self.painted[self.painted.len() - 1];
            let (start, end) = (self.rest[from - less as usize], self.rest[to - less as usize]);
            self.rest.push(std::array::from_fn(|axis| between(start[axis], end[axis])));
        }
        self.places.len() as u32 - 1
    }

    /// Adds a triangle, unless it is seen from behind or covers no pixel's centre.
    fn add_face(&mut self, vertices: [u32; 3], instance: u32, projection: &Projection) {
        let places = vertices.map(|vertex| self.places[vertex as usize]);
        let [x, y, key] = [0, 1, 2].map(|number| places.map(|place| place[number]));
        let Some(columns) = whole_numbers(x, projection.size[0]) else { return };
        let Some(rows) = whole_numbers(y, projection.size[1]) else { return };
        // In long thin faces near the lens, products differ in their last digits only.
        let apart = |numbers: [f32; 3], to: usize| f64::from(numbers[to]) - f64::from(numbers[0]);
        let (x1, x2, y1, y2) = (apart(x, 1), apart(x, 2), apart(y, 1), apart(y, 2));
        // y points down, so what is counter-clockwise from outside is clockwise in numbers.
        let area = y1 * x2 - x1 * y2;
        if area <= 0.0 || area.is_nan() {
            return;
        }
        let (edges, least) = {
            let edge = |from: usize, to: usize| edge([x[from], y[from]], [x[to], y[to]]);
            let [one, two, three] = [edge(1, 2), edge(2, 0), edge(0, 1)];
            ([one.0, two.0, three.0], [one.1, two.1, three.1])
        };
        let over_area = 1.0 / area;
        let (d1, d2) = (apart(key, 1), apart(key, 2));
        let slopes = [(d2 * y1 - d1 * y2) * over_area, (d1 * x2 - d2 * x1) * over_area];
        self.faces.push(Face {
            edges,
            least,
            over_area: over_area as f32,
            key: [slopes[0] as f32, slopes[1] as f32, key[0]],
            origin: [x[0], y[0]],
            vertices,
            instance,
            columns,
            rows,
        });
    }
}

/// Writes how much each triangle of a mesh faces the eye, and returns how much it must at least to be looked at
/// more closely.
fn how_they_face(
    mesh: &Mesh,
    view_from_mesh: &Affine,
    projection: &Projection,
    facing: &mut Vec<f32>,
) -> f32 {
    let rows = view_from_mesh;
    let squared = rows[0][..3].iter().map(|number| number * number).sum::<f32>();
    // In the axes of the mesh: where the lens is, or where parallel rays come from.
    let (viewer, shift, reach) = if projection.near.is_some() {
        let lens: [f32; 3] = std::array::from_fn(|axis| {
            -rows.iter().map(|row| row[axis] * row[3]).sum::<f32>() / squared
        });
        let away = lens.iter().map(|number| number.abs()).sum::<f32>();
        (lens, 1.0, away + mesh.centre.coords.norm() as f32 + mesh.radius as f32)
    } else {
        (std::array::from_fn(|axis| -rows[2][axis] / squared.sqrt()), 0.0, 1.0)
    };
    let [nx, ny, nz, out] = &mesh.planes;
    let planes = nx.iter().zip(ny).zip(nz).zip(out);
    facing.clear();
    facing.extend(
        planes
            .map(|(((x, y), z), out)| viewer[0] * x + viewer[1] * y + viewer[2] * z - shift * out),
    );
    -TURNED_AWAY * reach
}

/// The line through two points: positive on the inner side, and with exactly the reversed sign for the face
/// on its other side. Pixels on the line belong to one of both: with what the value must be above.
fn edge(from: [f32; 2], to: [f32; 2]) -> ([f32; 3], f32) {
    let (a, b) = (to[1] - from[1], from[0] - to[0]);
    let on = if (from[0], from[1]) < (to[0], to[1]) { from } else { to };
    let owns = a > 0.0 || (a == 0.0 && b > 0.0);
    ([a, b, -(a * on[0] + b * on[1])], if owns { -f32::MIN_POSITIVE } else { 0.0 })
}

/// The least and the greatest whole number between three numbers, within 0 to `count` − 1.
fn whole_numbers(numbers: [f32; 3], count: usize) -> Option<[u16; 2]> {
    let [a, b, c] = numbers;
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    let most = (count - 1) as f32;
    if high < 0.0 || low > most {
        return None;
    }
    let (low, high) = (low.max(0.0), high.min(most));
    // Both are in range here; `as` rounds towards 0.
    let start = low as u16;
    let start = start + u16::from(f32::from(start) < low);
    let end = high as u16;
    (start <= end).then_some([start, end])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_far_outside_of_the_picture_cover_nothing() {
        assert_eq!(whole_numbers([0.5, 1.5, 2.5], 4), Some([1, 2]));
        assert_eq!(whole_numbers([-1e9, 1e9, 0.0], 4), Some([0, 3]));
        for outside in [[1e9, 2e9, 3e9], [-3e9, -2e9, -0.5], [3.5, 4.0, 5.0], [0.2, 0.4, 0.6]] {
            assert_eq!(whole_numbers(outside, 4), None, "{outside:?}");
        }
    }
}
