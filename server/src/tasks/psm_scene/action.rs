//! What the numbers of an action mean, see the table in [`psm_scene`](super): from numbers to a pose, and
//! from a pose to numbers.

use std::f64::consts::PI;

use nalgebra::{UnitQuaternion, Vector3};
use trocar_proto::spec::Element;

use super::{
    JOINT_STEPS, PITCH_LIMIT, PsmArm, STEP_ANGLE, STEP_LENGTH, STEP_PITCH, Turn, down, pitch_of,
    pitched,
};
use crate::sim::frames::Pose;
use crate::sim::instrument::{JAW_CLOSED, JAW_OPEN};
use crate::tasks::options::{self, ActionMode};

impl PsmArm {
    /// The action that brings the sensed wrist from where it was commanded to be to `target` or, where one step
    /// cannot, towards it.
    pub fn encode(&self, target: &Pose, jaw: f64, action: &mut [f32]) {
        let now = &self.commanded.scene_from_wrist;
        let moved = target.translation.vector - now.translation.vector;
        let turned = (target.rotation * now.rotation.inverse()).scaled_axis();
        let scale = self.rate.scale();
        let (length, angle) = (STEP_LENGTH * scale, STEP_ANGLE * scale);
        let opening = 2.0 * (jaw - JAW_CLOSED) / (JAW_OPEN - JAW_CLOSED) - 1.0;
        let numbers = match self.mode {
            ActionMode::Paper => {
                let d = moved / length;
                let turn = match self.paper.turn {
                    Turn::Nothing => 0.0,
                    Turn::Vertical => turned.z / angle,
                    Turn::Pitch => {
                        let pitch = |pose: &Pose| pitch_of(self.index, &pose.rotation);
                        (pitch(target) - pitch(now)) / (STEP_PITCH * scale)
                    }
                };
                [d.x, d.y, d.z, turn, opening, 0.0, 0.0]
            }
            ActionMode::Cartesian => {
                let (d, r) = (moved / length, turned / angle);
                [d.x, d.y, d.z, r.x, r.y, r.z, opening]
            }
            ActionMode::CartesianAbs => {
                let half = (self.reach.max - self.reach.min) * 0.5;
                let p = (target.translation.vector - self.reach.centre()).component_div(&half);
                let p = p.map(|number| number.clamp(-1.0, 1.0));
                let r = (target.rotation * down().inverse()).scaled_axis() / PI;
                [p.x, p.y, p.z, r.x, r.y, r.z, opening]
            }
            ActionMode::Joint => {
                let before = self.commanded.joints;
                let joints = self.solve(target).unwrap_or(before);
                let mut numbers = [opening; 7];
                for joint in 0..6 {
                    numbers[joint] = (joints[joint] - before[joint]) / (JOINT_STEPS[joint] * scale);
                }
                // Clipped one by one, they would lead elsewhere.
                let largest = numbers[..6].iter().fold(1.0, |most: f64, n| most.max(n.abs()));
                for number in &mut numbers[..6] {
                    *number /= largest;
                }
                numbers
            }
        };
        for (number, value) in action.iter_mut().zip(numbers) {
            *number = value.clamp(-1.0, 1.0) as f32;
        }
    }

    /// The elements of an action.
    pub fn action_elements(&self) -> Vec<Element> {
        let turn = match self.paper.turn {
            Turn::Nothing => "ignored (turn)",
            Turn::Vertical => "turn about the vertical",
            Turn::Pitch => "pitch",
        };
        let jaw = if self.paper.jaw { "jaw" } else { "ignored (jaw)" };
        let (frame, mut names) = match self.mode {
            ActionMode::Paper => ("scene", vec!["dx", "dy", "dz", turn]),
            ActionMode::Cartesian => {
                ("scene", vec!["dx", "dy", "dz", "rotation x", "rotation y", "rotation z"])
            }
            ActionMode::CartesianAbs => {
                ("scene", vec!["x", "y", "z", "rotation x", "rotation y", "rotation z"])
            }
            ActionMode::Joint => {
                ("joint", vec!["yaw", "pitch", "insertion", "roll", "wrist pitch", "wrist yaw"])
            }
        };
        names.push(jaw);
        names.iter().map(|name| options::action_element(name, frame)).collect()
    }

    /// Where an action asks the wrist to be, and the jaw angle that it asks for.
    pub(super) fn decode(&self, action: &[f32]) -> (Pose, f64) {
        let now = &self.commanded.scene_from_wrist;
        let scale = self.rate.scale();
        let (length, angle) = (STEP_LENGTH * scale, STEP_ANGLE * scale);
        let number = |index: usize| f64::from(action[index]);
        let vector =
            |first: usize| Vector3::new(number(first), number(first + 1), number(first + 2));
        let graded = JAW_CLOSED + (JAW_OPEN - JAW_CLOSED) * 0.5 * (number(action.len() - 1) + 1.0);
        let (target, jaw) = match self.mode {
            ActionMode::Paper => {
                let turn = match self.paper.turn {
                    Turn::Vertical => number(3) * angle,
                    Turn::Nothing | Turn::Pitch => 0.0,
                };
                let mut target = moved(now, vector(0) * length, Vector3::z() * turn);
                if self.paper.turn == Turn::Pitch {
                    let pitch =
                        pitch_of(self.index, &now.rotation) + number(3) * (STEP_PITCH * scale);
                    target.rotation = pitched(self.index, pitch.clamp(-PITCH_LIMIT, PITCH_LIMIT));
                }
                let jaw = if number(4) < 0.0 { JAW_CLOSED } else { JAW_OPEN };
                (target, jaw)
            }
            ActionMode::Cartesian => (moved(now, vector(0) * length, vector(3) * angle), graded),
            ActionMode::CartesianAbs => {
                let half = (self.reach.max - self.reach.min) * 0.5;
                let position = self.reach.centre() + vector(0).component_mul(&half);
                let rotation = UnitQuaternion::from_scaled_axis(vector(3) * PI) * down();
                let step = position - now.translation.vector;
                let step = step / (step.amax() / length).max(1.0);
                let turn = (rotation * now.rotation.inverse()).scaled_axis();
                let turn = turn / (turn.norm() / angle).max(1.0);
                (moved(now, step, turn), graded)
            }
            ActionMode::Joint => {
                let joints = std::array::from_fn(|joint| {
                    let limit = &self.kinematics.limits()[joint];
                    let wanted =
                        self.commanded.joints[joint] + number(joint) * (JOINT_STEPS[joint] * scale);
                    wanted.clamp(limit.min, limit.max)
                });
                (self.pose_at(&joints), graded)
            }
        };
        (target, if self.paper.jaw { jaw } else { JAW_CLOSED })
    }
}

/// `now` moved by `step` (m) and turned by the rotation vector `turn` (rad), both in the scene.
pub(super) fn moved(now: &Pose, step: Vector3<f64>, turn: Vector3<f64>) -> Pose {
    let rotation = UnitQuaternion::from_scaled_axis(turn) * now.rotation;
    Pose::from_parts((now.translation.vector + step).into(), rotation)
}
