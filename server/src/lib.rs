//! Trocar's simulation, tasks and hosting.
//!
//! | module | holds |
//! |---|---|
//! | [`robots`] | the arms: kinematics, joint limits |
//! | [`assets`] | models of objects, embedded |
//! | [`sim`] | the world: physics in SI units, instruments as bodies |
//! | [`tasks`] | what is learnt: one file per task |
//! | [`render`] | pictures of it: colour, depth, bodies |
//! | [`dvrk`] | arms that answer as a dVRK's: controllers of joints, tick by tick |
//! | [`mod@env`] | one environment: a task in its world, episode by episode |
//! | [`registry`] | the tasks that can be made, and environments of them |
//! | [`recording`] | episodes as a file, from which they come again |
//! | `clock` | processor time of a thread |
//! | [`error`] | why an environment could not be stepped |
//! | [`view`] | the live viewer: a page over HTTP |
//! | [`service`] | hosting: sessions of many clients over shared memory |
//!
//! Nothing here but hosting knows of clients: an [`Env`] runs wherever it is made.

pub mod assets;
mod clock;
pub mod dvrk;
pub mod env;
pub mod error;
pub mod recording;
pub mod registry;
pub mod render;
pub mod robots;
pub mod service;
pub mod sim;
pub mod tasks;
pub mod view;

pub use env::{Env, Step};
pub use error::StepError;
pub use registry::Registry;
pub use service::{ServerConfig, StopSignal, serve};
pub use tasks::Task;
