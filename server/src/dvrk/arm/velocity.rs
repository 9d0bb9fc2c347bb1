//! Velocity commands (CRTK's `servo_jv` and `servo_cv`), and the estimate of an arm's own velocity.

use nalgebra::{Matrix6, Vector3, Vector6};

use super::{ArmController, Mode, Velocity, zeros};
use crate::dvrk::TICK;
use crate::dvrk::command;
use crate::dvrk::event::Error;
use crate::robots::Axes;

/// How much an ill-conditioned direction of a twist is left out: the square of a length (m) and an angle (rad).
const DAMPING: f64 = 1e-8;

impl ArmController {
    /// A twist in base axes, or why there is none.
    pub(super) fn local_twist(
        &self,
        command: &'static str,
        twist: &[f64; 6],
    ) -> Result<Vector6<f64>, Error> {
        if let Some(index) = twist.iter().position(|value| !command::is_position(*value)) {
            return Err(Error::NotFinite { command, index, value: twist[index] });
        }
        let base_from_reference = self.base.reference_from_base.rotation.inverse();
        let turned = |of: usize| base_from_reference * Vector3::from_row_slice(&twist[of..of + 3]);
        let [linear, angular] = [turned(0), turned(3)];
        Ok(Vector6::from_iterator(linear.iter().chain(&angular).copied()))
    }

    /// Positions and velocities after a tick with a velocity. All joints are slowed down alike where one would be
    /// too fast; one at a limit stays there.
    pub(super) fn follow_velocity(&self, of: &Velocity) -> [Axes; 2] {
        let joints = &self.setpoint.position[..self.mechanism.joints()];
        let wanted: Axes = match of {
            Velocity::Joints(velocity) => velocity.clone(),
            Velocity::Twist(twist) => {
                let jacobian = self.mechanism.jacobian(joints);
                let square = &jacobian * jacobian.transpose() + Matrix6::identity() * DAMPING;
                let solved = square.cholesky().map(|square| square.solve(twist));
                let velocity = jacobian.transpose() * solved.unwrap_or_default();
                velocity.iter().copied().collect()
            }
        };
        let slowed = |slowest: f64, (axis, velocity): (usize, &f64)| {
            let most = self.mechanism.limit(axis).max_velocity;
            if velocity.abs() * slowest > most { most / velocity.abs() } else { slowest }
        };
        let part = wanted.iter().enumerate().fold(1.0, slowed);
        let velocity: Axes = wanted.iter().map(|velocity| part * velocity).collect();
        let velocity = self.with_jaw(&velocity, &zeros(self.mechanism.axes()));
        let moved = self.setpoint.position.iter().zip(&velocity);
        [moved.map(|(position, velocity)| position + velocity * TICK).collect(), velocity]
    }

    /// Start velocity of a trajectory, rad/s and m/s, within the velocity limits of the joints.
    ///
    /// An arm follows set-points at once, so a step of the set-point measures as a high velocity for some ticks.
    /// After set-points, the estimate therefore grows at most by the joints' acceleration limit. A decrease counts
    /// at once.
    pub(super) fn own_velocity(&self) -> Axes {
        let is_servoed = matches!(self.mode, Mode::Servo { .. });
        let own = self.own.iter().zip(&self.measured.velocity).enumerate();
        own.map(|(axis, (own, measured))| {
            let limit = self.mechanism.limit(axis);
            let measured = measured.clamp(-limit.max_velocity, limit.max_velocity);
            let gain = limit.max_acceleration * TICK;
            if is_servoed {
                measured.clamp(own.min(0.0) - gain, own.max(0.0) + gain)
            } else {
                measured
            }
        })
        .collect()
    }
}
