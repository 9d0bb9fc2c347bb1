//! Desired goals that a reset asks for: which are allowed.

use nalgebra::Vector3;
use trocar_proto::{Code, Rejection};

use crate::sim::frames::Aabb;

/// The refusal of a goal, m.
pub fn refuse(goal: &Vector3<f64>, why: &str) -> Rejection {
    let [x, y, z] = (*goal).into();
    Rejection::new(Code::InvalidOption, "options.goal", format!("[{x}, {y}, {z}]"), why)
}

/// Whether a goal is in `bounds` (m), which are `what`.
pub fn check(goal: &Vector3<f64>, bounds: &Aabb, what: &str) -> Result<(), Rejection> {
    /// What rounding to the numbers of an observation takes, m.
    const ROUNDING: f64 = 1e-6;
    if (bounds.clamp(goal) - goal).amax() <= ROUNDING {
        return Ok(());
    }
    let along = |axis: usize| {
        let name = ["x", "y", "z"][axis];
        format!("{name} in [{:.4}, {:.4}]", bounds.min[axis], bounds.max[axis])
    };
    let allowed = format!("allowed is {}, {}, {} m, {what}", along(0), along(1), along(2));
    Err(refuse(goal, &allowed))
}
