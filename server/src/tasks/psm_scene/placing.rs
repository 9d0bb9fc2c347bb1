//! Where a reset may put an arm, and may set its goal.

use nalgebra::{UnitQuaternion, Vector3};
use trocar_proto::Rejection;

use super::{PsmArm, straight_down, wrist_from_link};
use crate::sim::frames::{Aabb, Pose};
use crate::sim::instrument::TIP_OFFSET;
use crate::sim::world::World;
use crate::tasks::goal;

/// How far rounding may take a pose out of where it may be, m.
const ROUNDING: f64 = 1e-6;

/// How deep jaws may be in what they were put next to, m: less than the clearance that they keep.
const TOUCHING: f64 = 0.02e-3;

impl PsmArm {
    /// Puts the arm, at once, where the tip of its closed jaws is at `tip`: a position (m), and where there are six
    /// numbers Euler angles of the wrist link (rad); otherwise says why it cannot be there.
    pub(crate) fn put_tip(&mut self, tip: &[f64]) -> Result<(), String> {
        let posture = *self.instrument.posture();
        let rotation = match *tip {
            [_, _, _, roll, pitch, yaw] => {
                UnitQuaternion::from_euler_angles(roll, pitch, yaw) * wrist_from_link().inverse()
            }
            _ => posture.world_from_wrist.rotation,
        };
        let tip = Vector3::new(tip[0], tip[1], tip[2]);
        let wrist = tip - rotation * Vector3::z() * TIP_OFFSET;
        let reach = self.reach;
        let off = (reach.clamp(&wrist) - wrist).abs();
        let tip_off = (reach.clamp(&tip) - tip).abs();
        if off.x.max(off.y).max(tip_off.x).max(tip_off.y) > ROUNDING
            || wrist.z > reach.max.z + ROUNDING
        {
            let Aabb { min, max } = reach;
            return Err(format!(
                "out of reach: allowed is a wrist with x in [{:.4}, {:.4}], y in [{:.4}, {:.4}] and z up to {:.4} \
                 m, and a tip with the same x and y; the wrist would be at [{:.4}, {:.4}, {:.4}]",
                min.x, max.x, min.y, max.y, max.z, wrist.x, wrist.y, wrist.z
            ));
        }
        let wrist = Pose::from_parts(wrist.into(), rotation);
        let missing = self.confined(wrist).translation.z - wrist.translation.z;
        if missing > ROUNDING {
            let missing = 1e3 * missing;
            return Err(format!("in what lies under the jaws: it must be {missing:.2} mm higher"));
        }
        if !self.put(&wrist, posture.jaw) {
            return Err("out of reach: the arm's joints do not allow it".into());
        }
        Ok(())
    }

    /// Whether the arm, where it was put, would be in an object or in what is fixed.
    pub(crate) fn is_in_something(&self, world: &World) -> bool {
        self.instrument.deepest_overlap(world) > TOUCHING
    }

    /// Whether jaws that point straight down can bring something to `goal` (m).
    pub(crate) fn check_goal(&self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        let mut bounds = self.reach;
        bounds.max.z -= TIP_OFFSET;
        bounds.min.z = self.support;
        goal::check(goal, &bounds, "where the tip of the arm's jaws reaches")?;
        let wrist = goal + Vector3::z() * TIP_OFFSET;
        match self.solve(&straight_down(wrist.into())) {
            Some(_) => Ok(()),
            None => Err(goal::refuse(goal, "the arm's joints do not allow its tip there")),
        }
    }
}
