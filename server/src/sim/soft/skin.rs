//! The skin of a soft body: triangles that are embedded in the lattice, and samples at which it touches others.
//!
//! The skin is found by dual contouring (Ju, Losasso, Schaefer, Warren: Dual Contouring of Hermite Data, SIGGRAPH 2002):
//! each cell of a sampling grid that the form's surface crosses has one vertex. The vertex is where the
//! tangent planes at the cell's crossed edges meet best, so flat faces, edges and corners are exact. Each
//! crossed edge gives one quadrilateral of four vertices.
//!
//! Every vertex and every sample is a [`MaterialPoint`]: an element and trilinear coordinates in it. So the skin follows
//! the lattice however that is deformed.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};

use super::corners::Corners;
use super::lattice::{CORNERS, Form, Lattice};
use crate::sim::frames::Aabb;
use crate::sim::world::RestSurface;

/// Distance of neighbouring samples where instruments touch, m, at most: jaws are 1.8 mm wide and more. More samples
/// than nodes only say the same again.
const SAMPLE_SPACING: f64 = 1.7e-3;

/// A point of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MaterialPoint {
    /// The element.
    pub element: u32,
    /// Along each edge of the element, 0 to 1; beyond, for points just outside of the lattice.
    pub at: [f32; 3],
}

impl MaterialPoint {
    /// How much each corner of the element counts.
    #[inline]
    pub fn weights(&self) -> [f32; CORNERS] {
        let [x, y, z] = self.at.map(|at| [1.0 - at, at]);
        std::array::from_fn(|corner| x[corner & 1] * y[corner >> 1 & 1] * z[corner >> 2])
    }

    /// The place of a point of the body at rest, in the body's frame, m.
    ///
    /// # Panics
    /// Where no element is within two of the point.
    pub fn of(form: &Form, point: &Point3<f64>) -> Self {
        let grid = &form.grid;
        let at = (point.coords - grid.min) / grid.spacing;
        let place = [0, 1, 2].map(|axis: usize| at[axis].floor() as isize);
        let mut best: Option<(f64, Self)> = None;
        for offset in (0..125).map(|index| [index % 5 - 2, index / 5 % 5 - 2, index / 25 - 2]) {
            let there = [0, 1, 2].map(|axis: usize| place[axis] + offset[axis]);
            let is_there =
                |axis: usize| there[axis] >= 0 && (there[axis] as usize) < grid.cells[axis];
            if !(0..3).all(is_there) {
                continue;
            }
            let element = grid.index(there.map(|count| count as usize));
            if form.mu[element] == 0.0 {
                continue;
            }
            let local = [0, 1, 2].map(|axis: usize| at[axis] - there[axis] as f64);
            let outside = local.map(|at| (at - 1.0).max(-at).max(0.0));
            let away = Vector3::from(outside).norm();
            if best.is_none_or(|(least, _)| away < least) {
                let at = local.map(|at| at as f32);
                best = Some((away, Self { element: element as u32, at }));
            }
        }
        best.expect("the skin is near the lattice").1
    }
}

/// Places, sorted by element.
#[derive(Debug, Clone, Default)]
pub(super) struct Samples {
    pub(super) places: Vec<MaterialPoint>,
    /// What each has of its nodes.
    pub(super) corners: Vec<Corners>,
    /// For how much of the skin each stands, m².
    pub(super) areas: Vec<f32>,
    /// Elements, and which places are in each.
    pub(super) elements: Vec<(u32, Range<u32>)>,
}

impl Samples {
    fn new(form: &Form, mut samples: Vec<(MaterialPoint, f32)>) -> Self {
        samples.sort_by_key(|(place, _)| place.element);
        let (places, areas): (Vec<_>, _) = samples.into_iter().unzip();
        let mut elements: Vec<(u32, Range<u32>)> = vec![];
        for (index, place) in (0_u32..).zip(&places) {
            match elements.last_mut() {
                Some((element, range)) if *element == place.element => range.end = index + 1,
                _ => elements.push((place.element, index..index + 1)),
            }
        }
        let corners = places.iter().map(|place| Corners::new(form, place)).collect();
        Self { places, corners, areas, elements }
    }
}

/// What is seen and touched of a body; it does not change while the body moves.
#[derive(Debug, Clone)]
pub struct Skin {
    pub(super) vertices: Vec<MaterialPoint>,
    /// The vertices before the body was deformed, and the triangles between them.
    pub(super) rest: Arc<RestSurface>,
    /// Where instruments and what moves freely touch it.
    pub(super) fine: Samples,
    /// Where what stands still touches it, but near its edges: the vertices.
    pub(super) coarse: Samples,
    /// Distance of neighbouring vertices, m.
    pub(super) spacing: f32,
}

impl Skin {
    /// The skin of the form within `bounds` whose `distance` (m, body's frame) is below 0, with a vertex every
    /// `spacing` m.
    ///
    /// It knows how easily its samples are pushed, so nodes that are held must be held before.
    pub fn new(
        form: &Form,
        bounds: &Aabb,
        spacing: f64,
        distance: impl Fn(&Point3<f64>) -> f64,
    ) -> Self {
        let contour = Contour::new(bounds, spacing, &distance);
        let place = |point: &Point3<f64>| MaterialPoint::of(form, point);
        let vertices: Vec<_> = contour.vertices.iter().map(place).collect();
        let quads = contour.quads();
        let across = (spacing / SAMPLE_SPACING).ceil().max(1.0) as usize;
        let mut samples = Vec::with_capacity(quads.len() * across * across);
        for quad in &quads {
            let corners = quad.map(|vertex| contour.vertices[vertex as usize].coords);
            let diagonals = (corners[2] - corners[0]).cross(&(corners[3] - corners[1]));
            let area = 0.5 * diagonals.norm() / (across * across) as f64;
            for index in 0..across * across {
                let [u, v] = [index % across, index / across]
                    .map(|count| (count as f64 + 0.5) / across as f64);
                let near = corners[0].lerp(&corners[1], u);
                let far = corners[3].lerp(&corners[2], u);
                samples.push((place(&near.lerp(&far, v).into()), area as f32));
            }
        }
        let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]);
        let rest = RestSurface {
            vertices: contour.vertices.iter().map(|vertex| vertex.cast()).collect(),
            triangles: triangles.collect(),
        };
        let unweighted = vertices.iter().map(|vertex| (*vertex, 0.0)).collect();
        let (fine, coarse) = (Samples::new(form, samples), Samples::new(form, unweighted));
        Self { vertices, rest: Arc::new(rest), fine, coarse, spacing: spacing as f32 }
    }

    /// Its triangles, which index vertices; counter-clockwise from outside.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.rest.triangles
    }

    /// Where its vertices are, m.
    pub fn points(&self, lattice: &Lattice) -> Vec<Point3<f64>> {
        self.vertices.iter().map(|place| lattice.point(place)).collect()
    }

    /// Where its vertices are, m, with their normals.
    pub fn surface(&self, lattice: &Lattice) -> (Vec<Point3<f64>>, Vec<Vector3<f64>>) {
        let points = self.points(lattice);
        let mut normals = vec![Vector3::zeros(); points.len()];
        for [a, b, c] in self.rest.triangles.iter().map(|each| each.map(|vertex| vertex as usize)) {
            // Twice the area as its length: large triangles count more.
            let normal = (points[b] - points[a]).cross(&(points[c] - points[a]));
            for vertex in [a, b, c] {
                normals[vertex] += normal;
            }
        }
        for normal in &mut normals {
            *normal = normal.try_normalize(0.0).unwrap_or_else(Vector3::z);
        }
        (points, normals)
    }
}

impl Lattice {
    /// Where a point of the body is, m.
    pub fn point(&self, place: &MaterialPoint) -> Point3<f64> {
        let local = self.local(place).map(f64::from);
        Point3::from(self.origin + Vector3::from(local))
    }

    /// The same from the lattice's origin on.
    #[inline]
    pub(super) fn local(&self, place: &MaterialPoint) -> [f32; 3] {
        let (weights, [_, row, layer]) = (place.weights(), self.form.grid.strides());
        let first = place.element as usize;
        let rows = [first, first + row, first + layer, first + layer + row];
        let mut at = [0.0; 3];
        for (at, x) in at.iter_mut().zip(&self.x) {
            for (ends, row) in weights.chunks_exact(2).zip(rows) {
                *at += ends[0] * x[row] + ends[1] * x[row + 1];
            }
        }
        at
    }
}

/// The surface of a form as quadrilaterals of vertices in the cells of a sampling grid.
struct Contour<'a, Distance> {
    distance: &'a Distance,
    spacing: f64,
    min: Vector3<f64>,
    /// Points of the grid along each axis.
    counts: [usize; 3],
    /// Distances at the points.
    values: Vec<f64>,
    vertices: Vec<Point3<f64>>,
    /// The vertex of the cell whose first corner a point is.
    vertex_of: Vec<Option<u32>>,
}

impl<'a, Distance: Fn(&Point3<f64>) -> f64> Contour<'a, Distance> {
    fn new(bounds: &Aabb, spacing: f64, distance: &'a Distance) -> Self {
        // Faces of the box lie in the middle of cells, where they cross edges one by one.
        let counts = [0, 1, 2]
            .map(|axis| (bounds.extents()[axis] / spacing - 1e-6).ceil().max(1.0) as usize + 2);
        let size = Vector3::from(counts.map(|count| (count - 1) as f64 * spacing));
        let min = bounds.centre() - 0.5 * size;
        let mut contour = Self {
            distance,
            spacing,
            min,
            counts,
            values: vec![],
            vertices: vec![],
            vertex_of: vec![],
        };
        contour.values = contour.places(0).map(|place| distance(&contour.point(place))).collect();
        contour.vertex_of = vec![None; contour.values.len()];
        for place in contour.places(1).collect::<Vec<_>>() {
            if let Some(vertex) = contour.vertex(place) {
                let cell = contour.index(place);
                contour.vertex_of[cell] = Some(contour.vertices.len() as u32);
                contour.vertices.push(vertex);
            }
        }
        contour
    }

    /// The places of points, but for the last `less` along each axis.
    fn places(&self, less: usize) -> impl Iterator<Item = [usize; 3]> + use<Distance> {
        let [nx, ny, nz] = self.counts.map(|count| count - less);
        (0..nz).flat_map(move |k| (0..ny).flat_map(move |j| (0..nx).map(move |i| [i, j, k])))
    }

    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.counts[0] * (j + self.counts[1] * k)
    }

    fn point(&self, place: [usize; 3]) -> Point3<f64> {
        Point3::from(self.min + self.spacing * Vector3::from(place.map(|count| count as f64)))
    }

    /// Where the surface crosses the edge from a point along an axis.
    fn crossing(&self, place: [usize; 3], axis: usize) -> Option<Point3<f64>> {
        let mut next = place;
        next[axis] += 1;
        let [from, to] = [place, next].map(|place| self.values[self.index(place)]);
        if (from < 0.0) == (to < 0.0) {
            return None;
        }
        let (start, end) = (self.point(place), self.point(next));
        let [mut inside, mut outside] = if from < 0.0 { [start, end] } else { [end, start] };
        // Halved until it is known to a nanometre.
        for _ in 0..24 {
            let middle = nalgebra::center(&inside, &outside);
            if (self.distance)(&middle) < 0.0 { inside = middle } else { outside = middle }
        }
        Some(nalgebra::center(&inside, &outside))
    }

    fn normal(&self, point: &Point3<f64>) -> Vector3<f64> {
        let step = 1e-3 * self.spacing;
        let slope = |axis: usize| {
            let mut by = Vector3::zeros();
            by[axis] = step;
            (self.distance)(&(point + by)) - (self.distance)(&(point - by))
        };
        Vector3::new(slope(0), slope(1), slope(2)).try_normalize(0.0).unwrap_or_else(Vector3::z)
    }

    /// The vertex of a cell that the surface crosses: where the planes at its crossed edges meet best.
    fn vertex(&self, place: [usize; 3]) -> Option<Point3<f64>> {
        /// Weight of the middle of the crossings: it decides where planes leave the vertex free.
        const MIDDLE: f64 = 1e-3;
        let edges = (0..3).flat_map(|axis| {
            (0..4).map(move |corner: usize| {
                let mut start = place;
                start[(axis + 1) % 3] += corner & 1;
                start[(axis + 2) % 3] += corner >> 1;
                (start, axis)
            })
        });
        let crossings: Vec<_> =
            edges.filter_map(|(start, axis)| self.crossing(start, axis)).collect();
        if crossings.is_empty() {
            return None;
        }
        let count = crossings.len() as f64;
        let middle = crossings.iter().map(|point| point.coords).sum::<Vector3<f64>>() / count;
        let (mut planes, mut along) = (Matrix3::identity() * (MIDDLE * count), Vector3::zeros());
        for crossing in &crossings {
            let normal = self.normal(crossing);
            planes += normal * normal.transpose();
            along += normal * normal.dot(&crossing.coords);
        }
        let (inverse, mut solved) = (planes.try_inverse()?, middle);
        // Each time the middle counts a thousandth as much.
        for _ in 0..3 {
            solved = inverse * (along + MIDDLE * count * solved);
        }
        // Planes of a curved face may meet outside of the cell.
        let (min, edge) = (self.point(place).coords, Vector3::repeat(self.spacing));
        Some(Point3::from(solved.sup(&min).inf(&(min + edge))))
    }

    /// One for each crossed edge, counter-clockwise from outside.
    fn quads(&self) -> Vec<[u32; 4]> {
        let mut quads = vec![];
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for place in self.places(0) {
                if place[axis] + 1 >= self.counts[axis] || place[u] == 0 || place[v] == 0 {
                    continue;
                }
                let mut next = place;
                next[axis] += 1;
                let [from, to] = [place, next].map(|place| self.values[self.index(place)] < 0.0);
                if from == to {
                    continue;
                }
                let vertex = |back_u: usize, back_v: usize| {
                    let mut cell = place;
                    cell[u] -= back_u;
                    cell[v] -= back_v;
                    self.vertex_of[self.index(cell)].expect("its cell is crossed")
                };
                let mut quad = [vertex(1, 1), vertex(0, 1), vertex(0, 0), vertex(1, 0)];
                if to {
                    quad.reverse();
                }
                quads.push(quad);
            }
        }
        quads
    }
}
