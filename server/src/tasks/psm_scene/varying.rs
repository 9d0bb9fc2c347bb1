//! Variation of an arm in a prepared start: the errors of the episode, and another place of the true wrist.

use std::f64::consts::PI;

use super::PsmArm;
use super::erring::{axes, first};
use crate::sim::frames::Pose;
use crate::sim::instrument::Posture;
use crate::sim::random::Rng;
use crate::sim::world::World;

/// Largest distance of a sensed wrist from the nearest allowed place, m: the first command corrects the rest.
const MAX_EXCESS: f64 = 0.2e-3;

impl PsmArm {
    /// Draws the errors of the episode and the friction of the jaws, and places the true wrist at `target`. The asked
    /// opening stays; the angles of the fingers are multiplied by `widening`. Without `contacts` the friction stays. The
    /// caller places a held object.
    /// Returns false if the joints do not allow the place.
    pub(in crate::tasks) fn vary(
        &mut self,
        world: &mut World,
        rng: &mut Rng,
        target: &Pose,
        (widening, contacts): (f64, bool),
    ) -> bool {
        let (before, jaw) = (self.true_joints(), self.commanded.jaw);
        if contacts {
            self.draw_friction(world, rng);
        }
        self.draw_encoders(rng);
        let mut target = *target;
        let low = target.translation.z - self.instrument.depth_below_wrist(&target.rotation);
        target.translation.z += (self.lowest() - low).max(0.0);
        let base_from_wrist = self.scene_from_true_base.inv_mul(&target);
        let Ok(links) = self.kinematics.inverse(&base_from_wrist, &before) else {
            return false;
        };
        if (links[3] - before[3]).abs() >= PI {
            return false;
        }
        let links = axes(&links, jaw);
        self.joints = first(&self.drivetrain.encoders(&links));
        if self.drivetrain.gives() {
            // Plays are where the sensed wrist is turned as before, as far as they allow.
            let mut sensed = self.pose_at(&self.joints);
            sensed.rotation = self.scene_from_wrist.rotation;
            let base_from_wrist = self.scene_from_base.inv_mul(&sensed);
            if let Ok(encoders) = self.kinematics.inverse(&base_from_wrist, &self.joints) {
                self.drivetrain.load(&axes(&encoders, jaw), &links);
            }
            self.joints = first(&self.drivetrain.encoders(&links));
            self.drivetrain.displace(&links);
        }
        self.scene_from_wrist = self.pose_at(&self.joints);
        let world_from_wrist = self.pose_of(&self.true_joints());
        self.instrument.carry(world, Posture { world_from_wrist, jaw }, widening);
        self.stay();
        true
    }

    /// Draws the errors of the episode, and places an arm that touches nothing where its sensed wrist is at `target`.
    /// Returns false if the joints do not allow the place.
    pub(in crate::tasks) fn vary_free(
        &mut self,
        world: &mut World,
        rng: &mut Rng,
        target: &Pose,
    ) -> bool {
        let jaw = self.commanded.jaw;
        let Some(joints) = self.solve(target) else { return false };
        self.draw_friction(world, rng);
        self.draw_encoders(rng);
        self.drivetrain.displace_to(&axes(&joints, jaw));
        self.joints = joints;
        self.scene_from_wrist = self.pose_at(&joints);
        let world_from_wrist = self.pose_of(&self.true_joints());
        self.instrument.carry(world, Posture { world_from_wrist, jaw }, 1.0);
        self.stay();
        true
    }

    /// True if commands may bring the sensed wrist to its present place.
    pub(in crate::tasks) fn is_in_reach(&self) -> bool {
        let allowed = self.confined(self.scene_from_wrist).translation.vector;
        (allowed - self.scene_from_wrist.translation.vector).xy().norm() < MAX_EXCESS
            && self.scene_from_wrist.translation.z < self.reach.max.z + MAX_EXCESS
    }
}
