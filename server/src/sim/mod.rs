//! The simulated world: the only place that knows the physics engine and its scale.
//!
//! | module | holds |
//! |---|---|
//! | [`frames`] | poses, Euler angles, boxes; conversion to the engine's numbers |
//! | [`world`] | bodies, gravity, contacts, time |
//! | [`instrument`] | wrist and jaws of an arm as bodies |
//! | [`motion`] | how instruments move: profiles, what stops them, quiescence |
//! | [`grasp`] | what holds an object in the jaws: friction, or an attachment |
//! | [`random`] | the named, portable generator of every episode |
//! | [`soft`] | bodies that deform: tissue, silicone, gauze |
//!
//! Everything outside is in SI units and in f64.

pub mod frames;
pub mod grasp;
pub mod instrument;
pub mod motion;
pub mod random;
pub mod soft;
pub mod world;
