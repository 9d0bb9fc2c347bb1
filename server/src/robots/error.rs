//! Why an inverse does not exist.

use crate::robots::JointLimit;
use nalgebra::Vector3;

/// How far past a limit a computed joint value may lie and still count as the limit itself,
/// rad or m. It absorbs rounding for poses that were made from joints at their limits.
pub(super) const LIMIT_ROUNDING: f64 = 1e-9;

/// An inverse-kinematics target that the arm cannot take.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum IkError {
    /// The target point is too far from the remote centre of motion, however the arm turns.
    #[error("the target lies {distance:.4} m from the remote centre; the arm reaches {reach:.4} m")]
    OutOfReach {
        /// Distance of the target point from the remote centre of motion, m.
        distance: f64,
        /// Largest distance that the arm reaches, m.
        reach: f64,
    },
    /// The only joint vectors that reach the target break a limit.
    #[error("joint {joint} would be {value:.6}, outside [{min:.6}, {max:.6}] (rad or m)")]
    JointLimit {
        /// The first joint, from the base, that is outside its limits.
        joint: &'static str,
        /// The value that the target needs, rad or m.
        value: f64,
        /// Lower limit, rad or m.
        min: f64,
        /// Upper limit, rad or m.
        max: f64,
    },
    /// The target or the seed holds a NaN or an infinity.
    #[error("the target pose and the seed must be finite")]
    NotFinite,
}

/// Checks that the wrist or camera can come as far as `point`.
pub(super) fn check_reach(point: &Vector3<f64>, reach: f64) -> Result<(), IkError> {
    let distance = point.norm();
    if distance > reach + LIMIT_ROUNDING {
        return Err(IkError::OutOfReach { distance, reach });
    }
    Ok(())
}

/// `q` with rounding past the limits removed, or the first joint that is outside.
pub(super) fn check_limits<const N: usize>(
    limits: &[JointLimit; N],
    q: [f64; N],
) -> Result<[f64; N], IkError> {
    for (limit, value) in limits.iter().zip(q) {
        if value < limit.min - LIMIT_ROUNDING || value > limit.max + LIMIT_ROUNDING {
            let JointLimit { name, min, max, .. } = *limit;
            return Err(IkError::JointLimit { joint: name, value, min, max });
        }
    }
    Ok(std::array::from_fn(|i| limits[i].clamp(q[i])))
}
