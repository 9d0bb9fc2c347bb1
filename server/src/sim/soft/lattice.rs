//! A lattice of hexahedra: which elements there are, how heavy and stiff they are, and where its nodes are.
//!
//! Nodes are stored layer by layer, row by row, as arrays of x, y and z. Elements have the number of their first
//! corner, so that a layer of elements is one run of memory, and what an element needs lies at fixed distances from
//! its number. At the end of each row there is an element that has no material. So the kernel reads and writes
//! [`LANES`](super::lanes::LANES) neighbours at once without lists of indices.
//!
//! Positions are f32, relative to an [origin](Lattice::origin) in the middle of the body: 4 nm at 50 mm.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};

use super::damping::Rigid;
use super::lanes::{LANES, Lanes, with_widest_instructions, with_widest_registers};
use super::material::{MOST_NODES, Material, MaterialError};
use super::{damping, elasticity};
use crate::sim::frames::{Aabb, Pose};
use crate::sim::world::{GRAVITY, SUBSTEPS_PER_SECOND};

/// Corners of an element; bit 0, 1 and 2 of a corner's number are its place along x, y and z.
pub(super) const CORNERS: usize = 8;

/// The tangent up to which elements bear the time step of the material: [`elasticity`] says what it is. Below it all
/// steps are alike, since steps that follow a vibration would feed it.
const TANGENT: f32 = 1.1;

/// The greatest speed of a node, m/s. Instruments move with 0.1 m/s, and what falls in the scene reaches 1.5. Only tissue
/// that was stretched to twice its length and comes free would be faster, for a moment; that energy is lost.
const FASTEST: f32 = 6.0;

/// How many times shorter time steps become, at most.
const SHORTEST: f64 = 16.0;

/// Elements side by side along three axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Elements along each axis.
    pub cells: [usize; 3],
    /// Edge of an element, m.
    pub spacing: f64,
    /// The first corner of the first element, in the body's frame, m.
    pub min: Vector3<f64>,
}

impl Grid {
    /// The fewest elements of this edge that fill a box, m; they stick out alike on both sides.
    pub fn around(bounds: &Aabb, spacing: f64) -> Self {
        // A box of 12 mm has three elements of 4 mm, however it was rounded.
        let count = |length: f64| ((length / spacing - 1e-6).ceil() as usize).max(1);
        let extents = bounds.extents();
        let cells = [0, 1, 2].map(|axis| count(extents[axis]));
        let size = Vector3::from(cells.map(|count| count as f64 * spacing));
        Self { cells, spacing, min: bounds.centre() - 0.5 * size }
    }

    /// From a node to the next along each axis.
    pub fn strides(&self) -> [usize; 3] {
        let row = self.cells[0] + 1;
        [1, row, row * (self.cells[1] + 1)]
    }

    /// Nodes.
    pub fn nodes(&self) -> usize {
        self.cells.iter().map(|count| count + 1).product()
    }

    /// The number of a node, and of the element whose first corner it is.
    pub fn index(&self, place: [usize; 3]) -> usize {
        let strides = self.strides();
        (0..3).map(|axis| place[axis] * strides[axis]).sum()
    }

    /// Where a node is at rest, in the body's frame, m.
    pub fn node(&self, place: [usize; 3]) -> Point3<f64> {
        Point3::from(self.min + self.spacing * Vector3::from(place.map(|count| count as f64)))
    }

    /// The places of all nodes, in the order of their numbers.
    pub fn node_places(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        places(self.cells.map(|count| count + 1))
    }

    /// The places of all elements.
    pub fn cell_places(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        places(self.cells)
    }

    /// From the number of an element to those of its corners.
    pub fn corner_offsets(&self) -> [usize; CORNERS] {
        std::array::from_fn(|corner| self.index([corner & 1, corner >> 1 & 1, corner >> 2]))
    }
}

fn places(counts: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    let [nx, ny, nz] = counts;
    (0..nz).flat_map(move |k| (0..ny).flat_map(move |j| (0..nx).map(move |i| [i, j, k])))
}

/// What does not change while a body moves.
#[derive(Debug, Clone)]
pub struct Form {
    pub(super) grid: Grid,
    pub(super) material: Material,
    /// Substeps of the world's substep.
    pub(super) substeps: u32,
    /// Shear modulus of each element, Pa, scaled by its fill; 0 where there is none.
    pub(super) mu: Vec<f32>,
    /// λ + μ of each element, Pa, scaled by its fill.
    pub(super) lambda: Vec<f32>,
    /// Mass of each node, kg.
    pub(super) mass: Vec<f32>,
    /// 1/mass of each node, 1/kg; 0 where it is held, or where there is nothing.
    pub(super) inverse_mass: Vec<f32>,
    pub(super) has_held_nodes: bool,
    /// How many times as thick elements are at rest along z as along x and y.
    pub(super) thickness: f64,
}

impl Form {
    /// A body of which `fill` tells for each element how much of it there is, 0 to 1.
    pub fn new(
        grid: Grid,
        material: Material,
        fill: impl Fn([usize; 3]) -> f64,
    ) -> Result<Self, MaterialError> {
        let substeps = material.substeps(grid.spacing)?;
        let nodes = grid.nodes();
        if nodes > MOST_NODES {
            let (name, spacing) = (material.name, grid.spacing);
            return Err(MaterialError::TooFine { name, spacing, nodes });
        }
        // Lanes of the last block reach past the last element.
        let size = nodes + LANES;
        let mut mass = vec![0.0_f64; size];
        let (mut mu, mut lambda) = (vec![0.0; size], vec![0.0; size]);
        let corner_mass = material.density * grid.spacing.powi(3) / CORNERS as f64;
        let offsets = grid.corner_offsets();
        for place in grid.cell_places() {
            let (element, fill) = (grid.index(place), fill(place));
            mu[element] = (material.shear_modulus() * fill) as f32;
            lambda[element] = ((material.lame() + material.shear_modulus()) * fill) as f32;
            for offset in offsets {
                mass[element + offset] += corner_mass * fill;
            }
        }
        let inverse = |mass: &f64| if *mass > 0.0 { (1.0 / mass) as f32 } else { 0.0 };
        let inverse_mass = mass.iter().map(inverse).collect();
        let mass = mass.into_iter().map(|mass| mass as f32).collect();
        Ok(Self {
            grid,
            material,
            substeps,
            mu,
            lambda,
            mass,
            inverse_mass,
            has_held_nodes: false,
            thickness: 1.0,
        })
    }

    /// The same body, `thickness` times as thick at rest along its z axis.
    pub fn thickened(&self, thickness: f64) -> Result<Self, MaterialError> {
        let substeps = self.material.substeps(self.grid.spacing * thickness.min(1.0))?;
        let factor = (thickness / self.thickness) as f32;
        let scaled = |numbers: &[f32], by: f32| numbers.iter().map(|number| number * by).collect();
        Ok(Self {
            substeps,
            // Forces are those of an element's volume.
            mu: scaled(&self.mu, factor),
            lambda: scaled(&self.lambda, factor),
            mass: scaled(&self.mass, factor),
            inverse_mass: scaled(&self.inverse_mass, 1.0 / factor),
            thickness,
            ..self.clone()
        })
    }

    /// A box that is filled.
    pub fn slab(
        cells: [usize; 3],
        spacing: f64,
        material: Material,
    ) -> Result<Self, MaterialError> {
        let size = Vector3::from(cells.map(|count| count as f64 * spacing));
        Self::new(Grid { cells, spacing, min: -0.5 * size }, material, |_| 1.0)
    }

    /// Holds the nodes at these places where they are, whatever pulls.
    pub fn hold(&mut self, is_held: impl Fn(&Point3<f64>) -> bool) {
        for (node, place) in self.grid.node_places().enumerate() {
            if self.mass[node] > 0.0 && is_held(&self.grid.node(place)) {
                self.inverse_mass[node] = 0.0;
                self.has_held_nodes = true;
            }
        }
    }

    /// The elements that are there.
    pub fn elements(&self) -> impl Iterator<Item = usize> {
        self.mu.iter().enumerate().filter(|(_, mu)| **mu > 0.0).map(|(element, _)| element)
    }

    /// What it is made of.
    pub fn material(&self) -> &Material {
        &self.material
    }

    /// Its mass, kg.
    pub fn mass(&self) -> f64 {
        self.mass.iter().map(|mass| f64::from(*mass)).sum()
    }
}

/// Where the nodes of a body are and how they move.
#[derive(Debug, Clone)]
pub struct Lattice {
    pub(super) form: Arc<Form>,
    /// Where the coordinates below begin, m; axes are those of the world.
    pub(super) origin: Vector3<f64>,
    /// Positions relative to the origin, m: all x, all y, all z.
    pub(super) x: [Vec<f32>; 3],
    /// Velocities, m/s.
    pub(super) v: [Vec<f32>; 3],
    /// All moduli are this many times those of the form.
    pub(super) stiffness: f32,
    /// Greatest tangent of an element, in the world's substep before this one and in this one.
    pub(super) tangents: [f32; 2],
    workspace: Workspace,
}

/// What is computed anew in each step; copies hold nothing.
#[derive(Debug, Default)]
struct Workspace {
    /// Forces on nodes, N.
    forces: [Vec<f32>; 3],
    /// Positions for which elastic forces are computed, m.
    ahead: [Vec<f32>; 3],
    /// How a body that nothing holds moves as a whole.
    rigid: Option<Rigid>,
}

impl Clone for Workspace {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Lattice {
    /// The body at rest, with its frame at `world_from_body`.
    pub fn new(form: Arc<Form>, world_from_body: &Pose) -> Self {
        let zeros = || [0, 1, 2].map(|_| vec![0.0; form.mu.len()]);
        let (x, v) = (zeros(), zeros());
        let origin = Vector3::zeros();
        let (stiffness, tangents, workspace) = (1.0, [0.0; 2], Workspace::default());
        let mut lattice = Self { form, origin, x, v, stiffness, tangents, workspace };
        lattice.place(world_from_body);
        lattice
    }

    /// Puts it somewhere, undeformed and at rest.
    pub fn place(&mut self, world_from_body: &Pose) {
        let grid = self.form.grid;
        self.origin = world_from_body.translation.vector;
        self.tangents = [0.0; 2];
        for (node, place) in grid.node_places().enumerate() {
            let mut at = grid.node(place);
            at.z *= self.form.thickness;
            let at = world_from_body.rotation * at;
            for axis in 0..3 {
                self.x[axis][node] = at[axis] as f32;
                self.v[axis][node] = 0.0;
            }
        }
    }

    /// Moves it as it is, by a motion of the world.
    pub fn carry(&mut self, motion: &Pose) {
        self.origin = (motion * Point3::from(self.origin)).coords;
        let turn = motion.rotation.to_rotation_matrix().into_inner().cast::<f32>();
        for vectors in [&mut self.x, &mut self.v] {
            let [x, y, z] = vectors;
            for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
                let turned = turn * Vector3::new(*x, *y, *z);
                (*x, *y, *z) = (turned.x, turned.y, turned.z);
            }
        }
    }

    /// Makes all moduli `stiffness` times as large as those of the material, at most as large.
    ///
    /// # Panics
    /// Where that is not above 0 and at most 1: substeps are those of the material.
    pub fn soften(&mut self, stiffness: f64) {
        assert!(stiffness > 0.0 && stiffness <= 1.0, "{stiffness}");
        self.stiffness = stiffness as f32;
    }

    /// Makes it of another form on the same grid; it is to be placed.
    pub(super) fn reform(&mut self, form: Arc<Form>) {
        self.form = form;
    }

    /// What does not change of it.
    pub fn form(&self) -> &Form {
        &self.form
    }

    /// Where a node is, m.
    pub fn node(&self, node: usize) -> Point3<f64> {
        Point3::from(
            self.origin + Vector3::from([0, 1, 2].map(|axis| f64::from(self.x[axis][node]))),
        )
    }

    /// How a node moves, m/s.
    pub fn velocity(&self, node: usize) -> Vector3<f64> {
        Vector3::from([0, 1, 2].map(|axis| f64::from(self.v[axis][node])))
    }

    /// Begins a substep of the world.
    pub fn begin(&mut self) {
        self.tangents = [self.tangents[1], 0.0];
    }

    /// Finds what pulls at nodes where they are: elastic forces, and `gravity` times that of the Earth. Returns the time
    /// step to take of the `left` (s): as long as the material bears, or shorter where an element is stiffer than at rest,
    /// or was since the world's last substep began. Steps that followed a vibration would feed it.
    pub fn find_forces(&mut self, gravity: f32, left: f64) -> f32 {
        let lag = (damping::VISCOSITY * self.longest_step()) as f32;
        self.begin_forces(gravity, lag);
        let form = &*self.form;
        let Workspace { forces, ahead, .. } = &mut self.workspace;
        let tangent = elasticity::add_forces(form, self.stiffness, ahead, forces);
        self.tangents[1] = self.tangents[1].max(tangent);
        // What is left is shared evenly, however it was rounded.
        (left / (left / self.longest_step() - 1e-6).ceil().max(1.0)) as f32
    }

    /// Writes where nodes will be after `lag` (s), and their weight with this `gravity`.
    fn begin_forces(&mut self, gravity: f32, lag: f32) {
        let lattice = self;
        with_widest_instructions!(begin_forces(lattice: &mut Lattice, gravity: f32, lag: f32));
    }

    /// The longest time step that its elements bear, s.
    fn longest_step(&self) -> f64 {
        let tangent = self.tangents[0].max(self.tangents[1]);
        let at_rest = 1.0 / (SUBSTEPS_PER_SECOND * f64::from(self.form.substeps));
        at_rest / f64::from((tangent / TANGENT).sqrt()).clamp(1.0, SHORTEST)
    }

    /// Changes velocities by what these forces and damping do in `seconds`.
    pub fn kick(&mut self, seconds: f32) {
        let lattice = self;
        with_widest_instructions!(kick(lattice: &mut Lattice, seconds: f32));
    }

    /// Moves nodes by their velocities, after it has made those slower that are above [`FASTEST`].
    pub fn drift(&mut self, seconds: f32) {
        let lattice = self;
        with_widest_instructions!(drift(lattice: &mut Lattice, seconds: f32));
    }

    /// Lets no node be faster than [`FASTEST`].
    fn slow_down(&mut self) {
        let [x, y, z] = &mut self.v;
        for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
            let square = *x * *x + *y * *y + *z * *z;
            if square > FASTEST * FASTEST {
                let part = FASTEST / square.sqrt();
                (*x, *y, *z) = (part * *x, part * *y, part * *z);
            }
        }
    }

    /// Makes all velocities 0.
    pub(super) fn stop(&mut self) {
        self.v.iter_mut().for_each(|velocities| velocities.fill(0.0));
    }

    /// Memory that its state and its workspace take, bytes; what does not change is shared.
    pub(super) fn memory_bytes(&self) -> u64 {
        (12 * self.form.mass.len() * size_of::<f32>()) as u64
    }

    /// The fastest node's speed, m/s.
    #[inline(always)]
    pub fn fastest(&self) -> f64 {
        let [x, y, z] = self.v.each_ref().map(|v| blocks(v));
        let mut most = [0.0_f32; LANES];
        for ((x, y), z) in x.iter().zip(y).zip(z) {
            for lane in 0..LANES {
                let square = x[lane] * x[lane] + y[lane] * y[lane] + z[lane] * z[lane];
                most[lane] = if square > most[lane] { square } else { most[lane] };
            }
        }
        f64::from(most.into_iter().fold(0.0, f32::max)).sqrt()
    }

    /// Whether positions and velocities are finite.
    pub fn is_finite(&self) -> bool {
        self.x.iter().chain(&self.v).all(|each| each.iter().all(|number| number.is_finite()))
    }

    /// A box around its nodes, m.
    pub fn bounds(&self) -> Aabb {
        let corners = self.x.each_ref().map(|x| extent(x, &self.form.mass));
        let [min, max] = [0, 1].map(|end: usize| {
            self.origin + Vector3::from(corners.map(|ends| f64::from(ends[end])))
        });
        Aabb { min, max }
    }

    /// The deformation gradient F = ∂x/∂X of an element, in its middle.
    pub fn deformation_gradient(&self, element: usize) -> nalgebra::Matrix3<f64> {
        let offsets = self.form.grid.corner_offsets();
        let scale = 1.0 / (4.0 * self.form.grid.spacing);
        let scales = [scale, scale, scale / self.form.thickness];
        nalgebra::Matrix3::from_fn(|component, axis| {
            let scale = scales[axis];
            let corners = offsets.iter().enumerate();
            let signed = corners.map(|(corner, offset)| {
                let sign = if corner >> axis & 1 == 1 { scale } else { -scale };
                sign * f64::from(self.x[component][element + offset])
            });
            signed.sum()
        })
    }
}

#[inline(always)]
fn begin_forces(lattice: &mut Lattice, gravity: f32, lag: f32) {
    // What is held is damped against the world in which it is held.
    let rigid = (!lattice.form.has_held_nodes).then(|| Rigid::of(lattice));
    let Lattice { form, x, v, workspace: Workspace { forces, ahead, rigid: kept }, .. } = lattice;
    damping::look_ahead(x, v, rigid.as_ref(), lag, ahead);
    *kept = rigid;
    for force in forces.iter_mut() {
        force.resize(form.mass.len(), 0.0);
        force.fill(0.0);
    }
    let weight = -gravity * GRAVITY as f32;
    for (force, mass) in forces[2].iter_mut().zip(&form.mass) {
        *force = weight * mass;
    }
}

#[inline(always)]
fn kick(lattice: &mut Lattice, seconds: f32) {
    let Lattice { form, x, v, workspace: Workspace { forces, rigid, .. }, .. } = lattice;
    let keep = damping::kept(form.material.damping, seconds);
    damping::damp(form, x, v, rigid.as_ref(), keep);
    for (velocities, forces) in v.iter_mut().zip(forces) {
        let nodes = velocities.iter_mut().zip(forces).zip(&form.inverse_mass);
        for ((velocity, force), inverse_mass) in nodes {
            *velocity += *force * inverse_mass * seconds;
        }
    }
}

#[inline(always)]
fn drift(lattice: &mut Lattice, seconds: f32) {
    if lattice.fastest() > f64::from(FASTEST) {
        lattice.slow_down();
    }
    for (positions, velocities) in lattice.x.iter_mut().zip(&lattice.v) {
        for (position, velocity) in positions.iter_mut().zip(velocities) {
            *position += velocity * seconds;
        }
    }
}

/// Numbers of nodes, eight at a time. What is left over is padding.
fn blocks(numbers: &[f32]) -> &[[f32; LANES]] {
    numbers.as_chunks().0
}

/// The least and the greatest number of those that have a mass.
fn extent(numbers: &[f32], masses: &[f32]) -> [f32; 2] {
    with_widest_registers!(extent_in_lanes(numbers: &[f32], masses: &[f32]) -> [f32; 2])
}

#[inline(always)]
fn extent_in_lanes<L: Lanes>(numbers: &[f32], masses: &[f32]) -> [f32; 2] {
    let far = L::splat(f32::MAX);
    let (mut least, mut most) = (far, -far);
    for (numbers, masses) in blocks(numbers).iter().zip(blocks(masses)) {
        let mass = L::new(*masses);
        let number = L::new(*numbers).where_positive(mass);
        let beyond = far - far.where_positive(mass);
        (least, most) = (least.min(number + beyond), most.max(number - beyond));
    }
    [
        least.numbers().into_iter().fold(f32::INFINITY, f32::min),
        most.numbers().into_iter().fold(f32::NEG_INFINITY, f32::max),
    ]
}
