//! The simulated world: the only place that knows the physics engine and its scale.
//!
//! | module | holds |
//! |---|---|
//! | [`frames`] | poses, Euler angles, boxes; conversion to the engine's numbers |
//! | [`world`] | bodies, gravity, contacts, time |
//! | [`instrument`] | wrist and jaws of an arm as bodies: smooth motion, yield, quiescence |
//! | [`random`] | the named, portable generator of every episode |
//!
//! Everything outside is in SI units and in f64.

pub mod frames;
pub mod instrument;
pub mod random;
pub mod world;
