//! Trocar's simulation, tasks and hosting.

pub mod robots;
