//! What the simulation and its tasks do, in one program; `fuzz.rs` is another, since it looks at the memory of its process.
//! `cargo test -p trocar-server --test server grasp::` runs one file.

#![allow(clippy::unwrap_used)] // a panic is a test's report

mod arm_errors;
mod assets;
mod between;
mod bits;
mod cameras;
mod cylinder;
mod experts;
mod grasp;
mod grasp_modes;
mod late;
mod live;
mod looks;
mod mechanics;
mod non_rigid;
mod pad;
mod perceived;
mod placement;
mod relative;
mod render;
mod robustness;
mod scaled;
mod soft;
mod soft_grasp;
mod stages;
mod starts;
mod suite;
mod time;

use trocar_server::env::Env;

/// Observation, achieved and desired goal.
fn look(env: &Env) -> [Vec<f32>; 3] {
    let spec = env.spec();
    let mut seen =
        [spec.observation_dim(), spec.goal_dim(), spec.goal_dim()].map(|dim| vec![0.0; dim]);
    let [observation, achieved, desired] = &mut seen;
    env.observe(observation, achieved, desired);
    seen
}
