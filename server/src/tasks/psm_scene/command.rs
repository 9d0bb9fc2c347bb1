//! From a command to how the arm goes, and how far it came.

use nalgebra::Vector3;

use super::{PsmArm, action, erring};
use crate::sim::frames::Pose;
use crate::sim::grasp::Grasp;
use crate::sim::instrument::{JAW_CLOSED, JAW_OPEN, Posture};
use crate::sim::motion::{Arrival, Profile};
use crate::sim::world::World;

/// Where an arm was asked to be.
#[derive(Debug, Clone, Copy)]
pub(super) struct Commanded {
    /// What the joint sensors then report.
    pub(super) joints: [f64; 6],
    /// The wrist as they then report it.
    pub(super) scene_from_wrist: Pose,
    /// Opening of the jaws, rad.
    pub(super) jaw: f64,
}

impl PsmArm {
    /// Lets the actuators add `step` (m) and the rotation vector `turn` (rad), scene frame, to the next command.
    pub fn disturb(&mut self, step: Vector3<f64>, turn: Vector3<f64>) {
        self.disturbance = Some([step, turn]);
    }

    /// Takes a command: an action of the arm's mode, or none, for the arm to hold.
    pub fn command(&mut self, action: Option<&[f32]>) {
        self.plan(action);
    }

    /// Takes a command, and says whether the jaws are told to close: to less than half of what they open.
    fn plan(&mut self, action: Option<&[f32]>) -> bool {
        let start = *self.instrument.posture();
        let (mut target, asked) = match action {
            Some(action) => self.decode(action),
            None => (self.commanded.scene_from_wrist, self.commanded.jaw),
        };
        if let Some([step, turn]) = self.disturbance.take() {
            target = action::moved(&target, step, turn);
        }
        let before = self.commanded;
        let (joints, world_from_wrist) = self.reachable(target);
        let scene_from_wrist = if self.errs() { self.pose_at(&joints) } else { world_from_wrist };
        let jaw = self.turned(asked);
        let end = Posture { world_from_wrist, jaw };
        self.profile = if self.drivetrain.gives() {
            self.stream(&before, &erring::axes(&joints, jaw))
        } else if self.rate.is_nominal() {
            Profile::Smoothstep { start, end }
        } else {
            let world_from_wrist = self.true_pose(&before.joints);
            let via = Posture { world_from_wrist, jaw: before.jaw };
            Profile::Bend { start, via, end: via.towards(&end, 0.5, 0.5) }
        };
        self.asked_drivetrain.settle(&joints);
        self.commanded = Commanded { joints, scene_from_wrist, jaw };
        asked < 0.5 * (JAW_CLOSED + JAW_OPEN)
    }

    /// The joints, as sensors report them, and the true wrist of a target: where the arm was commanded to be before if it
    /// may not go there.
    pub(super) fn reachable(&self, target: Pose) -> ([f64; 6], Pose) {
        let before = &self.commanded.joints;
        self.solve_clear_of_pad(&self.confined(target))
            .unwrap_or_else(|| (*before, self.true_pose(before)))
    }

    /// How far the jaws will be open that are asked to be open so far, rad: from closed to open takes them a step at the
    /// nominal rate.
    pub(super) fn turned(&self, asked: f64) -> f64 {
        let (before, most) = (self.commanded.jaw, (JAW_OPEN - JAW_CLOSED) * self.rate.scale());
        let turn = asked - before;
        if turn.abs() <= most { asked } else { before + most.copysign(turn) }
    }

    /// Takes note of how far the arm came.
    pub fn arrive(&mut self, arrival: Arrival) {
        let is_there = arrival.covered >= 1.0 && self.rate.is_nominal();
        if self.drivetrain.gives() {
            self.arrive_along(arrival);
        } else if is_there {
            let Commanded { joints, scene_from_wrist, .. } = self.commanded;
            (self.joints, self.scene_from_wrist) = (joints, scene_from_wrist);
        } else {
            self.joints = self.joints_where_it_is(&self.commanded.joints);
            self.scene_from_wrist = self.pose_at(&self.joints);
        }
        self.is_held_up = arrival.is_blocked;
        if arrival.is_blocked {
            let (joints, scene_from_wrist) = (self.joints, self.scene_from_wrist);
            self.commanded = Commanded { joints, scene_from_wrist, ..self.commanded };
            self.asked_drivetrain.clone_from(&self.drivetrain);
        }
    }

    /// Makes where the arm is the place from where increments count.
    pub(super) fn stay(&mut self) {
        let (joints, scene_from_wrist) = (self.joints, self.scene_from_wrist);
        self.commanded = Commanded { joints, scene_from_wrist, jaw: self.instrument.posture().jaw };
        self.is_held_up = false;
        self.profile = Profile::rest(*self.instrument.posture());
        self.told.clear();
        if self.drivetrain.gives() {
            self.asked_drivetrain.clone_from(&self.drivetrain);
            let told = erring::axes(&self.joints, self.commanded.jaw);
            self.told.push((told, self.drivetrain.clone()));
        }
    }
}

/// Gives an action to `arms`, which has as many numbers for each, one arm after the other; they hold where
/// there is none.
pub fn command<const N: usize>(
    mut arms: [&mut PsmArm; N],
    world: &mut World,
    grasp: &mut Grasp,
    action: Option<&[f32]>,
) {
    let closing = std::array::from_fn(|index| {
        let own = action.map(|action| {
            let count = action.len() / N;
            &action[index * count..][..count]
        });
        arms[index].plan(own)
    });
    grasp.command(world, arms.map(PsmArm::instrument), closing);
}

/// Lets an attachment take over what `arms` hold or let it go; `is_lifted` tells whether the object of `grasp` has risen
/// enough for an attachment to replace friction where the grasp mode is `weld`.
pub fn settle<const N: usize>(
    arms: [&mut PsmArm; N],
    world: &mut World,
    grasp: &mut Grasp,
    is_lifted: bool,
) {
    grasp.settle(world, arms.map(PsmArm::instrument), is_lifted);
}
