//! Soft bodies: tissue, silicone, gauze, by explicit dynamics of a lattice of hexahedra.
//!
//! | module | holds |
//! |---|---|
//! | [`material`] | moduli, density, friction, strength; how many substeps a material needs |
//! | [`lattice`] | elements and nodes, their masses, positions and velocities |
//! | [`lanes`] | eight numbers at once, with the widest registers of the processor |
//! | [`elasticity`] | forces: stable neo-Hookean, one point of integration, hourglass stiffness |
//! | [`damping`] | deformation dies out, momenta stay |
//! | [`carve`] | a lattice cut from a distance function |
//! | [`skin`] | triangles that are seen, samples that touch |
//! | [`corners`] | what samples have of nodes |
//! | [`proxy`], [`shape`] | rigid bodies in the substeps of soft ones |
//! | [`candidates`] | samples that may touch rigid bodies in a step |
//! | [`contact`] | contacts with them: Coulomb friction, impulses both ways |
//! | [`resting`] | those on flat faces of what stands still: the same, faster |
//! | [`attachment`] | samples that are held to a rigid body without friction, for comparison |
//! | [`body`] | a soft body in the world: what it has of all these, and sleep |
//!
//! A time step is v += Δt (f/m + g), then contacts change v, then x += Δt v. Tissue is so soft (2 to 30 kPa) that
//! pressure waves go at 3 to 9 m/s, and steps of 0.2 to 0.8 ms are stable. Nothing has to converge: rest,
//! waves and friction are those of the mesh.
//!
//! Numbers are f32. The order of all sums is fixed and no multiplication is fused with an addition, so the bits
//! are the same on every processor.

// What is not inlined is compiled for narrow registers only: see `lanes`.
#![allow(clippy::inline_always)]

mod attachment;
mod body;
mod candidates;
mod carve;
mod contact;
mod corners;
mod damping;
mod elasticity;
mod lanes;
mod lattice;
mod material;
pub(in crate::sim) mod proxy;
mod resting;
mod shape;
mod skin;
#[cfg(test)]
mod tests;

pub use body::{Damage, SoftBody};
pub use carve::box_distance;
pub use lattice::{Form, Grid, Lattice};
pub use material::{Friction, MOST_NODES, MOST_SUBSTEPS, Material, MaterialError};
pub use skin::{MaterialPoint, Skin};
