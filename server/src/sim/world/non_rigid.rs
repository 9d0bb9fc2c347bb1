//! Bodies of another kind than rigid: what the world, the renderer and snapshots must know of them.

use std::any::Any;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};

use super::{SUBSTEPS_PER_SECOND, World};
use crate::sim::frames::Aabb;

/// A body that the engine of rigid bodies does not simulate: tissue, thread. A clone of the world clones it, and
/// goes on bit by bit like it.
pub trait NonRigid: Any + Send + Sync {
    /// Lets `seconds` pass for it, before they pass for the rigid bodies of `world`, which it may push.
    fn advance(&mut self, world: &mut World, seconds: f64);

    /// All that decides how it goes on, as bits.
    fn bits(&self) -> Box<dyn Iterator<Item = u32> + '_>;

    /// Whether all of its state is finite.
    fn is_finite(&self) -> bool;

    /// Whether it stays as it is until something touches it.
    fn at_rest(&self) -> bool;

    /// A box around it, m.
    fn bounds(&self) -> Aabb;

    /// What there is to see of it now.
    fn surface(&self) -> Surface;

    /// Memory that it takes, bytes; a session's is counted with it.
    fn memory_bytes(&self) -> u64;

    /// A copy.
    fn boxed_clone(&self) -> Box<dyn NonRigid>;
}

impl Clone for Box<dyn NonRigid> {
    fn clone(&self) -> Self {
        self.as_ref().boxed_clone()
    }
}

/// The skin of a body, in the world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// Name of the body, as masks have it.
    pub name: &'static str,
    /// Vertices, m.
    pub vertices: Vec<Point3<f64>>,
    /// Their unit normals.
    pub normals: Vec<Vector3<f64>>,
    /// The same before anything deformed it.
    pub rest: Arc<RestSurface>,
    /// Colour: red, green, blue, as pictures store it, 0 to 1.
    pub colour: [f32; 3],
    /// Its row of `assets/materials.csv`, which has its gloss. One that is not there shines like foam.
    pub material: String,
}

/// The skin of a body at rest, in the body's frame. It does not change while the body moves.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RestSurface {
    /// Vertices, m; as many as the skin has now.
    pub vertices: Vec<Point3<f32>>,
    /// Triangles, which index vertices and normals; counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl World {
    /// Puts a body of another kind into the world.
    pub fn add(&mut self, body: Box<dyn NonRigid>) {
        self.others.push(body);
    }

    /// The bodies of other kinds, in the order in which they were put into the world.
    pub fn others(&self) -> impl Iterator<Item = &dyn NonRigid> {
        self.others.iter().map(AsRef::as_ref)
    }

    /// Memory of the bodies of other kinds, bytes.
    pub fn memory_bytes(&self) -> u64 {
        self.others.iter().map(|other| other.memory_bytes()).sum()
    }

    pub(super) fn advance_others(&mut self) {
        if self.others.is_empty() {
            return;
        }
        self.clear_soft_touches();
        let mut others = std::mem::take(&mut self.others);
        for (number, other) in others.iter_mut().enumerate() {
            self.advancing = number;
            other.advance(self, 1.0 / SUBSTEPS_PER_SECOND);
        }
        self.others = others;
    }
}
