//! From meshes to faces: triangles as they lie in a picture, clipped at the near plane, with what a
//! rasteriser asks of them.

use super::mesh::Mesh;

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
    x: Vec<f32>,
    y: Vec<f32>,
    pub(super) key: Vec<f32>,
    depth: Vec<f32>,
    /// Unit normals in the world.
    pub(super) normals: [Vec<f32>; 3],
    pub(super) faces: Vec<Face>,
}

impl Faces {
    pub(super) fn clear(&mut self) {
        let Self { x, y, key, depth, normals: [nx, ny, nz], faces } = self;
        for numbers in [x, y, key, depth, nx, ny, nz] {
            numbers.clear();
        }
        faces.clear();
    }

    /// Adds the faces of a mesh that the projection sees from outside. `turn` takes its normals to the
    /// world; without it there are none.
    pub(super) fn add(
        &mut self,
        mesh: &Mesh,
        instance: u32,
        view_from_mesh: &Affine,
        turn: Option<&[[f32; 3]; 3]>,
        projection: &Projection,
    ) {
        let first = self.x.len();
        self.add_vertices(mesh, view_from_mesh, projection);
        if let Some(turn) = turn {
            let [mx, my, mz] = &mesh.normals;
            for (row, out) in turn.iter().zip(&mut self.normals) {
                let turned = mx.iter().zip(my).zip(mz);
                out.extend(turned.map(|((x, y), z)| row[0] * x + row[1] * y + row[2] * z));
            }
        }
        let Some(near) = projection.near else {
            for corners in &mesh.triangles {
                self.add_face(corners.map(|corner| corner + first as u32), instance, projection);
            }
            return;
        };
        let is_ahead = self.depth[first..].iter().all(|depth| *depth > near);
        for corners in &mesh.triangles {
            let corners = corners.map(|corner| corner + first as u32);
            if is_ahead || corners.iter().all(|corner| self.depth[*corner as usize] > near) {
                self.add_face(corners, instance, projection);
            } else if corners.iter().any(|corner| self.depth[*corner as usize] > near) {
                self.add_clipped(corners, instance, projection, near, turn.is_some());
            }
        }
    }

    fn add_vertices(&mut self, mesh: &Mesh, view_from_mesh: &Affine, projection: &Projection) {
        let [mx, my, mz] = &mesh.positions;
        let [sx, sy] = projection.scale;
        let [cx, cy] = projection.centre;
        let first = self.x.len();
        let count = mx.len();
        for numbers in [&mut self.x, &mut self.y, &mut self.key, &mut self.depth] {
            numbers.resize(first + count, 0.0);
        }
        let [to_x, to_y, to_z] = view_from_mesh;
        let at =
            |row: &[f32; 4], x: f32, y: f32, z: f32| row[0] * x + row[1] * y + row[2] * z + row[3];
        let (xs, ys) = (&mut self.x[first..][..count], &mut self.y[first..][..count]);
        let (keys, depths) = (&mut self.key[first..][..count], &mut self.depth[first..][..count]);
        let (mx, my, mz) = (&mx[..count], &my[..count], &mz[..count]);
        if projection.near.is_some() {
            for i in 0..count {
                let (x, y, z) = (mx[i], my[i], mz[i]);
                let depth = at(to_z, x, y, z);
                // Behind the near plane, but so that the place can be had from the quotient again.
                let depth = if depth.abs() < LEAST_DEPTH { LEAST_DEPTH } else { depth };
                let key = 1.0 / depth;
                xs[i] = at(to_x, x, y, z) * key * sx + cx;
                ys[i] = at(to_y, x, y, z) * key * sy + cy;
                (keys[i], depths[i]) = (key, depth);
            }
        } else {
            for i in 0..count {
                let (x, y, z) = (mx[i], my[i], mz[i]);
                xs[i] = at(to_x, x, y, z) * sx + cx;
                ys[i] = at(to_y, x, y, z) * sy + cy;
                keys[i] = -at(to_z, x, y, z);
            }
        }
    }

    /// Adds what lies beyond the near plane of a triangle that passes through it.
    fn add_clipped(
        &mut self,
        corners: [u32; 3],
        instance: u32,
        projection: &Projection,
        near: f32,
        has_normals: bool,
    ) {
        let mut kept = [0; 4];
        let mut count = 0;
        for index in 0..3 {
            let (from, to) = (corners[index], corners[(index + 1) % 3]);
            let (start, end) = (self.depth[from as usize], self.depth[to as usize]);
            if start > near {
                kept[count] = from;
                count += 1;
            }
            if (start > near) != (end > near) {
                // Cut from the same side for both triangles at an edge, so that no gap opens.
                let (from, to) = if start > end { (from, to) } else { (to, from) };
                kept[count] = self.add_cut(from, to, projection, near, has_normals);
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
        has_normals: bool,
    ) -> u32 {
        let (from, to) = (from as usize, to as usize);
        let part = (self.depth[from] - near) / (self.depth[from] - self.depth[to]);
        let between = |a: f32, b: f32| a + (b - a) * part;
        let along = |numbers: &[f32], scale: f32, centre: f32| {
            let side = |index: usize| (numbers[index] - centre) * self.depth[index] / scale;
            between(side(from), side(to)) / near * scale + centre
        };
        let x = along(&self.x, projection.scale[0], projection.centre[0]);
        let y = along(&self.y, projection.scale[1], projection.centre[1]);
        self.x.push(x);
        self.y.push(y);
        self.key.push(1.0 / near);
        self.depth.push(near);
        if has_normals {
            for normals in &mut self.normals {
                normals.push(between(normals[from], normals[to]));
            }
        }
        self.x.len() as u32 - 1
    }

    /// Adds a triangle, unless it is seen from behind or covers no pixel's centre.
    fn add_face(&mut self, vertices: [u32; 3], instance: u32, projection: &Projection) {
        let [i, j, k] = vertices.map(|vertex| vertex as usize);
        let (x, y) = ([self.x[i], self.x[j], self.x[k]], [self.y[i], self.y[j], self.y[k]]);
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
        let key = [self.key[i], self.key[j], self.key[k]];
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
    let (low, high) = (low.max(0.0), high.min(most));
    // Both are in range here, or else low > high; `as` rounds towards 0.
    let start = low as u16;
    let start = start + u16::from(f32::from(start) < low);
    let end = high as u16;
    (high >= 0.0 && low <= most && start <= end).then_some([start, end])
}
