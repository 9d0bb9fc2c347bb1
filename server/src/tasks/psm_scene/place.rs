//! Where an arm may go, and the joints that bring it there.

use std::f64::consts::PI;

use nalgebra::Vector3;

use super::PsmArm;
use super::erring::first;
use crate::sim::frames::Pose;
use crate::sim::instrument::TIP_OFFSET;

impl PsmArm {
    /// The pose nearest to `target` in which wrist and tip are where they may be. Where encoders err, the height is
    /// that of the true jaws, see [`Self::solve_clear_of_pad`].
    pub(super) fn confined(&self, mut target: Pose) -> Pose {
        let jaws = target.rotation * Vector3::z() * TIP_OFFSET;
        let wrist = self.reach.clamp(&target.translation.vector);
        let tip = wrist + jaws;
        let inside = self.reach.clamp(&tip) - tip;
        target.translation.vector = Vector3::new(wrist.x + inside.x, wrist.y + inside.y, wrist.z);
        if !self.errs() {
            let lowest = self.lowest() + self.instrument.depth_below_wrist(&target.rotation);
            target.translation.z = wrist.z.max(lowest);
        }
        target
    }

    /// The joints that bring the sensed wrist to `target` without turning the roll right round.
    pub(super) fn solve(&self, target: &Pose) -> Option<[f64; 6]> {
        let base_from_wrist = self.scene_from_base.inv_mul(target);
        let joints = self.kinematics.inverse(&base_from_wrist, &self.commanded.joints).ok()?;
        let roll = (joints[3] - self.commanded.joints[3]).abs();
        (roll < PI).then_some(joints)
    }

    /// As [`Self::solve`], but so that encoder errors do not press the true jaws onto the pad; and where the true
    /// wrist then is.
    pub(super) fn solve_clear_of_pad(&self, target: &Pose) -> Option<([f64; 6], Pose)> {
        /// What rounding may take from the clearance, m.
        const ROUNDING: f64 = 1e-8;
        /// A play may take up all of a way upwards.
        const MOST_TRIES: usize = 100;
        let mut target = *target;
        let mut joints = self.solve(&target)?;
        for _ in 0..MOST_TRIES {
            let pose = self.true_pose(&joints);
            let low = pose.translation.z - self.instrument.depth_below_wrist(&pose.rotation);
            let missing = self.lowest() - low;
            if missing <= ROUNDING {
                return Some((joints, pose));
            }
            target.translation.z += missing;
            joints = self.solve(&target)?;
        }
        None
    }

    /// The joints as sensed after the arm yielded on its way to `end`.
    pub(super) fn joints_where_it_is(&self, end: &[f64; 6]) -> [f64; 6] {
        let base_from_wrist =
            self.scene_from_true_base.inv_mul(&self.instrument.posture().world_from_wrist);
        let seed = self.drivetrain.settled(end);
        match self.kinematics.inverse(&base_from_wrist, &seed) {
            Ok(links) => first(&self.drivetrain.encoders(&links)),
            Err(_) => self.joints, // between two poses at a limit: at most a step away
        }
    }

    /// The wrist as sensors have it that report these joints.
    pub(super) fn pose_at(&self, joints: &[f64; 6]) -> Pose {
        self.scene_from_base * self.kinematics.base_from_wrist(joints)
    }

    /// Whether the arm is elsewhere than its encoders have it.
    pub(super) fn errs(&self) -> bool {
        self.drivetrain.errs() || self.scene_from_true_base != self.scene_from_base
    }

    /// The true wrist where the true joints are these.
    pub(super) fn pose_of(&self, links: &[f64; 6]) -> Pose {
        self.scene_from_true_base * self.kinematics.base_from_wrist(links)
    }

    /// The true wrist once the arm has come to rest where the encoders say this.
    pub(super) fn true_pose(&self, joints: &[f64; 6]) -> Pose {
        self.pose_of(&self.asked_drivetrain.settled(joints))
    }
}
