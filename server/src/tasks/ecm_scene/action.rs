//! What the numbers of an action mean, see the tables in [`ecm_scene`](super): from numbers to joints, and from a motion to
//! numbers.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Point3, Vector3, Vector6};
use trocar_proto::spec::Element;

use super::{
    CAMERA_SPEED, Control, EcmArm, JOINT_STEPS, POSITIONS, STEP, STEP_LENGTH, STEP_ROLL, STEP_TURN,
};
use crate::tasks::options::{self, ActionMode, Preset};

impl EcmArm {
    /// The action that moves the sensed camera by `step` (m, RCM frame) and the roll joint by
    /// `turn` (rad), as far as its mode can.
    pub fn encode(&self, step: &Vector3<f64>, turn: f64, action: &mut [f32]) {
        let scale = self.rate.scale();
        let d = step / (STEP_LENGTH * scale);
        let roll = (turn / (STEP_ROLL * scale)).clamp(-1.0, 1.0);
        let numbers = match (self.mode, self.control) {
            (ActionMode::Paper, Control::Roll) => [roll, 0.0, 0.0, 0.0],
            (ActionMode::Paper | ActionMode::Cartesian, _) => [d.x, d.y, d.z, roll],
            (ActionMode::CartesianAbs, _) => {
                let half = (POSITIONS.max - POSITIONS.min) * 0.5;
                let target = self.rcm_from_camera.translation.vector + step;
                let p = (target - POSITIONS.centre()).component_div(&half);
                [p.x, p.y, p.z, (self.joints[3] + turn) / FRAC_PI_2]
            }
            (ActionMode::Joint, _) => {
                let joints = self.moved(step, self.joints[3] + turn).unwrap_or(self.joints);
                std::array::from_fn(|joint| {
                    let steps = joints[joint] - self.joints[joint];
                    (steps / (JOINT_STEPS[joint] * scale)).clamp(-1.0, 1.0)
                })
            }
        };
        for (number, value) in action.iter_mut().zip(numbers) {
            *number = value as f32;
        }
    }

    /// The action that gives the camera a velocity: parts of [`CAMERA_SPEED`] along its image axes.
    /// Other modes than `paper` get what moves the joints as much.
    pub fn encode_velocity(&self, velocity: &Vector3<f64>, action: &mut [f32]) {
        if self.mode == ActionMode::Paper {
            for (number, value) in action.iter_mut().zip(velocity.iter()) {
                *number = (value * self.velocity_sign()) as f32;
            }
            return;
        }
        let joints = self.steered(velocity);
        let to = self.in_nominal_rcm(&self.kinematics.base_from_camera(&joints));
        let step = to.translation.vector - self.rcm_from_camera.translation.vector;
        self.encode(&step, joints[3] - self.joints[3], action);
    }

    /// The elements of an action.
    pub fn action_elements(&self) -> Vec<Element> {
        let (frame, names): (_, &[&str]) = match (self.mode, self.control) {
            (ActionMode::Paper, Control::Position) => ("rcm", &["dx", "dy", "dz"]),
            (ActionMode::Paper, Control::Roll) => ("joint", &["roll joint increment"]),
            (ActionMode::Paper, Control::Velocity) => ("camera image", &["vx", "vy", "vz"]),
            (ActionMode::Cartesian, _) => ("rcm", &["dx", "dy", "dz", "roll joint increment"]),
            (ActionMode::CartesianAbs, _) => ("rcm", &["x", "y", "z", "roll joint"]),
            (ActionMode::Joint, _) => ("joint", &["yaw", "pitch", "insertion", "roll"]),
        };
        names.iter().map(|name| options::action_element(name, frame)).collect()
    }

    /// The joints that an action asks for, rad; index 2 in m; `None` where the arm cannot be there.
    pub(super) fn decode(&self, action: &[f32]) -> Option<[f64; 4]> {
        let number = |index: usize| f64::from(action.get(index).copied().unwrap_or_default());
        let vector = Vector3::new(number(0), number(1), number(2));
        let limits = self.kinematics.limits();
        let scale = self.rate.scale();
        let (length, most_roll) = (STEP_LENGTH * scale, STEP_ROLL * scale);
        let roll_to = |roll: f64| roll.clamp(limits[3].min, limits[3].max);
        let roll = self.joints[3];
        let mode = match (self.mode, self.control) {
            (ActionMode::Paper, Control::Roll) => {
                let [yaw, pitch, insertion, roll] = self.joints;
                return Some([yaw, pitch, insertion, roll_to(roll + number(0) * most_roll)]);
            }
            (ActionMode::Paper, Control::Velocity) => {
                return Some(self.steered(&(vector * self.velocity_sign())));
            }
            (mode, _) => mode,
        };
        match mode {
            ActionMode::Paper => self.moved(&(vector * length), roll),
            ActionMode::Cartesian => {
                self.moved(&(vector * length), roll_to(roll + number(3) * most_roll))
            }
            ActionMode::CartesianAbs => {
                let half = (POSITIONS.max - POSITIONS.min) * 0.5;
                let target = POSITIONS.centre() + vector.component_mul(&half);
                let step = target - self.rcm_from_camera.translation.vector;
                let step = step / (step.amax() / length).max(1.0);
                let turn = (number(3) * FRAC_PI_2 - roll).clamp(-most_roll, most_roll);
                self.moved(&step, roll_to(roll + turn))
            }
            ActionMode::Joint => Some(std::array::from_fn(|joint| {
                let wanted = self.joints[joint] + number(joint) * (JOINT_STEPS[joint] * scale);
                wanted.clamp(limits[joint].min, limits[joint].max)
            })),
        }
    }

    /// What the camera's velocity is multiplied by in an action. The original's control law has the
    /// opposite sign, for which its expert and policies that learnt from it make up.
    fn velocity_sign(&self) -> f64 {
        if self.preset == Preset::Surrol { -1.0 } else { 1.0 }
    }

    /// The joints after a step with the camera's `velocity`, parts of [`CAMERA_SPEED`] along its
    /// image axes, and the turn about the optical axis that takes the misorientation away.
    fn steered(&self, velocity: &Vector3<f64>) -> [f64; 4] {
        let scale = self.rate.scale();
        let across = velocity * (STEP_TURN * scale);
        let forward = velocity.z * CAMERA_SPEED * (STEP * scale);
        let most_roll = STEP_ROLL * scale;
        let roll = (self.sensed_misorientation() * scale).clamp(-most_roll, most_roll);
        // The camera frame's x and y axes are the image axes left and up.
        let base_from_camera = self.base_from_camera.rotation;
        let linear = base_from_camera * Vector3::new(0.0, 0.0, forward);
        let angular = base_from_camera * Vector3::new(across.y, -across.x, roll);
        let twist = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
        let jacobian = self.kinematics.jacobian(&self.joints);
        let squares = (jacobian.transpose() * jacobian)
            .cholesky()
            .expect("within their limits, no joint makes up for another");
        let step = squares.solve(&(jacobian.transpose() * twist));
        let limits = self.kinematics.limits();
        std::array::from_fn(|joint| limits[joint].clamp(self.joints[joint] + step[joint]))
    }

    /// The joints that move the sensed camera by `step` (m, RCM frame), with the roll at `roll`.
    fn moved(&self, step: &Vector3<f64>, roll: f64) -> Option<[f64; 4]> {
        let position = Point3::from(self.rcm_from_camera.translation.vector + step);
        let mut joints = self.joints_at(&(self.world_from_nominal * position).coords)?;
        joints[3] = roll;
        Some(joints)
    }
}
