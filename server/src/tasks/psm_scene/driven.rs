//! An arm that is driven from outside, by joints.

use super::erring::axes;
use super::{Commanded, PsmArm};
use crate::robots::{Drivetrain, Psm};
use crate::sim::frames::Pose;
use crate::sim::instrument::{JAW_CLOSED, Posture};
use crate::sim::world::World;

/// Opening up to which jaws count as closed, rad. Closed jaws turn no further, but their motors do: the cables give.
const SHUT: f64 = 0.01;

impl PsmArm {
    /// Its kinematics.
    pub fn kinematics(&self) -> &Psm {
        &self.kinematics
    }

    /// Its remote centre of motion as it is believed to be, scene frame.
    pub fn scene_from_base(&self) -> &Pose {
        &self.scene_from_base
    }

    /// What the joint sensors report, rad; index 2 in m.
    pub fn encoders(&self) -> &[f64; 6] {
        &self.joints
    }

    /// What lies between what its motors are told, its joint sensors and its links; the jaw is behind the joints.
    pub fn drivetrain(&self) -> &Drivetrain {
        &self.drivetrain
    }

    /// Where the instrument is when the true joints are these, and its jaws are asked to be open by `jaw`, rad. A jaw
    /// angle below 0 squeezes; jaws that are locked cannot.
    pub fn posture_of(&self, links: &[f64; 6], jaw: f64) -> Posture {
        let world_from_wrist = self.pose_of(links);
        let jaw = if self.instrument.grips() { jaw } else { jaw.max(JAW_CLOSED) };
        Posture { world_from_wrist, jaw }
    }

    /// The true joints, where they are near to `links`, which are theirs at `posture`; those where the instrument is
    /// at no place that joints lead to.
    pub fn links_near(&self, links: &[f64; 6], posture: &Posture) -> [f64; 6] {
        let is = &self.instrument.posture().world_from_wrist;
        if *is == posture.world_from_wrist {
            return *links;
        }
        let found =
            self.kinematics.inverse_unlimited(&self.scene_from_true_base.inv_mul(is), links);
        found.unwrap_or(*links)
    }

    /// The jaw angle that the motor has, rad, where `asked` was asked for: the opening, and what the cables give where
    /// the jaws are closed.
    pub fn jaw_near(&self, world: &World, asked: f64) -> f64 {
        let opening = self.opening(world);
        if opening < SHUT { asked.min(opening) } else { opening }
    }

    /// Where an action asks the sensed wrist to be, as far as the arm may go there, and how far the jaws to be open, rad.
    pub fn aim(&self, action: &[f32]) -> (Pose, f64) {
        let (target, asked) = self.decode(action);
        let (joints, _) = self.reachable(target);
        (self.pose_at(&joints), self.turned(asked))
    }

    /// The action that brings the arm from a sensed wrist and opening of the jaws to others, as near as one can.
    pub fn action_between(&self, from: &(Pose, f64), to: &(Pose, f64)) -> Vec<f32> {
        let mut arm = self.clone();
        let joints = self.solve(&from.0).unwrap_or(self.commanded.joints);
        arm.commanded = Commanded { joints, scene_from_wrist: from.0, jaw: from.1 };
        let mut action = vec![0.0; self.action_len()];
        arm.encode(&to.0, to.1, &mut action);
        action
    }

    /// Takes note of what the joint sensors report, of the true joints, rad; index 2 in m, of the drivetrain between
    /// them, and whether the arm is elsewhere than it was to be.
    pub fn follow(
        &mut self,
        encoders: &[f64; 6],
        links: &[f64; 6],
        drivetrain: &Drivetrain,
        is_held_up: bool,
    ) {
        self.joints = *encoders;
        if drivetrain.gives() {
            self.drivetrain.clone_from(drivetrain);
            self.drivetrain.displace(&axes(links, self.instrument.posture().jaw));
        }
        self.scene_from_wrist = self.pose_at(encoders);
        self.stay();
        self.is_held_up = is_held_up;
    }
}
