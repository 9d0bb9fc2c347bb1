//! What the ECM tasks share: where the endoscope's arm stands, how actions move it, what is
//! observed of it. The arm touches nothing, so it is pure kinematics.
//!
//! The *RCM frame* has its origin at the remote centre of motion, as dVRK's `local/measured_cp`; its
//! z axis points out along a straight endoscope. It is the nominal one, fixed in the world: where
//! `setup` moves the base, actions and poses stay in the nominal frame, so a policy keeps working.
//!
//! # Actions
//!
//! Every action moves from the pose that the joint sensors report. A position that the arm cannot
//! take within its joint limits is not taken: the arm stays where it is for that step.
//!
//! | `action` | numbers (1.0 stands for) |
//! |---|---|
//! | `paper` | dx, dy, dz in the RCM frame (10 mm); the roll joint stays |
//! | `cartesian` | the same and the roll joint's increment (3°) |
//! | `cartesian_abs` | x, y, z within the box of positions, roll joint (90°); a step goes at most 10 mm along each axis and 3° towards it |
//! | `joint` | yaw, pitch (0.06 rad), insertion (10 mm), roll (3°) |

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_proto::spec::{Element, RowSpec};
use trocar_proto::{Options, Rejection};

use super::options::{self, ActionMode, Preset, Range};
use crate::robots::Ecm;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::random::Rng;

/// Simulated time of one step, s.
pub const SECONDS_PER_STEP: f64 = 0.1;

/// Movement that 1.0 in an action stands for, m. Source: the original.
pub const STEP_LENGTH: f64 = 0.01;

/// Roll that 1.0 in an action stands for, rad. Source: the original.
pub const STEP_ROLL: f64 = 3.0 * PI / 180.0;

/// Joint movements that 1.0 stands for, rad; index 2 in m.
const JOINT_STEPS: [f64; 4] = [0.06, 0.06, 0.01, STEP_ROLL];

/// Base of the arm: x, y, z, m, and pitch, rad. Source: the original.
const BASE: [f64; 4] = [-0.05, 0.0, 1.0024, PI / 6.0];

/// The remote centre of motion in the base, m; its axes are turned by −90° about z.
/// Source: the original's arm model.
const BASE_FROM_RCM: [f64; 3] = [0.6126, 0.0, 0.1016];

/// Positions of the camera, m, RCM frame: a box around all that the arm can take.
const POSITIONS: Aabb = Aabb::new([-0.26, -0.26, -0.26], [0.26, 0.26, 0.26]);

/// An ECM.
#[derive(Debug, Clone)]
pub struct EcmArm {
    kinematics: Ecm,
    world_from_rcm: Pose,
    world_from_nominal: Pose,
    start: [f64; 4],
    mode: ActionMode,
    preset: Preset,
    joint_offset: Range,
    /// What the joint sensors report.
    joints: [f64; 4],
    /// What the joints really are, less what the sensors report.
    offsets: [f64; 4],
    /// The camera as the joint sensors report it, in the nominal RCM frame.
    rcm_from_camera: Pose,
}

impl EcmArm {
    /// The rows of `setup` that move an ECM.
    pub fn setup_rows() -> Vec<RowSpec> {
        vec![RowSpec {
            name: "base".into(),
            summary: "Base of the arm: x, y, z (m), pitch (rad).".into(),
            count: 4,
            min: -PI,
            max: PI,
        }]
    }

    /// An arm whose camera starts at `start` (m, world frame), roll 0.
    pub fn new(options: &Options, start: [f64; 3]) -> Result<Self, Rejection> {
        let base = match options.row("setup", "base") {
            Some(&[x, y, z, pitch]) => [x, y, z, pitch],
            _ => BASE,
        };
        let mut arm = Self {
            kinematics: Ecm::CLASSIC,
            world_from_rcm: world_from_rcm(base),
            world_from_nominal: world_from_rcm(BASE),
            start: [0.0; 4],
            mode: options::action_of(options),
            preset: options::preset_of(options),
            joint_offset: options::Domain::of(options)?.joint_offset,
            joints: [0.0; 4],
            offsets: [0.0; 4],
            rcm_from_camera: Pose::identity(),
        };
        arm.start = arm
            .joints_at(&start.into())
            .ok_or_else(|| options::refuse_setup(options, "the arm must reach its start"))?;
        arm.joints = arm.start;
        Ok(arm)
    }

    /// Whether the camera can be at `position` (m, world frame).
    pub fn reaches(&self, position: &Vector3<f64>) -> bool {
        self.joints_at(position).is_some()
    }

    /// Brings the arm to its start and draws this episode's encoder errors.
    pub fn reset(&mut self, rng: &mut Rng) {
        for joint in [0, 1, 3] {
            self.offsets[joint] = self.joint_offset.draw(rng);
        }
        self.joints = self.start;
        self.rcm_from_camera = self.sensed(&self.joints);
    }

    /// The true camera, world frame.
    pub fn world_from_camera(&self) -> Pose {
        let joints = std::array::from_fn(|joint| self.joints[joint] + self.offsets[joint]);
        self.world_from_rcm * self.kinematics.base_from_camera(&joints)
    }

    /// A vector of the world (m) in the axes of the RCM frame.
    pub fn in_rcm(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.world_from_nominal.inverse_transform_vector(vector)
    }

    /// Moves the arm for one step under an action of its mode; it holds where there is none.
    pub fn apply(&mut self, action: Option<&[f32]>) {
        let Some(action) = action else { return };
        if let Some(joints) = self.decode(action) {
            self.joints = joints;
            self.rcm_from_camera = self.sensed(&self.joints);
        }
    }

    /// The action that moves the sensed camera by `step` (m, RCM frame) and keeps its roll.
    pub fn encode(&self, step: &Vector3<f64>, action: &mut [f32]) {
        let d = step / STEP_LENGTH;
        let numbers = match self.mode {
            ActionMode::Paper | ActionMode::Cartesian => [d.x, d.y, d.z, 0.0],
            ActionMode::CartesianAbs => {
                let half = (POSITIONS.max - POSITIONS.min) * 0.5;
                let target = self.rcm_from_camera.translation.vector + step;
                let p = (target - POSITIONS.centre()).component_div(&half);
                [p.x, p.y, p.z, self.joints[3] / FRAC_PI_2]
            }
            ActionMode::Joint => {
                let joints = self.moved(step, self.joints[3]).unwrap_or(self.joints);
                std::array::from_fn(|joint| {
                    (joints[joint] - self.joints[joint]) / JOINT_STEPS[joint]
                })
            }
        };
        for (number, value) in action.iter_mut().zip(numbers) {
            *number = value as f32;
        }
    }

    /// The elements of an action.
    pub fn action_elements(&self) -> Vec<Element> {
        let names: &[&str] = match self.mode {
            ActionMode::Paper => &["dx", "dy", "dz"],
            ActionMode::Cartesian => &["dx", "dy", "dz", "roll joint increment"],
            ActionMode::CartesianAbs => &["x", "y", "z", "roll joint"],
            ActionMode::Joint => &["yaw", "pitch", "insertion", "roll"],
        };
        let frame = if self.mode == ActionMode::Joint { "joint" } else { "rcm" };
        names.iter().map(|name| options::action_element(name, frame)).collect()
    }

    /// The elements of [`Self::observe`].
    pub fn observation_elements(&self) -> Vec<Element> {
        // ECM scenes are not scaled under any preset.
        let mut elements = options::position_elements("camera", "rcm", &POSITIONS, Preset::Paper);
        elements.extend(options::euler_elements("camera", "rcm"));
        elements
    }

    /// Writes what is observed of the arm: camera position (3) and extrinsic XYZ Euler angles (3)
    /// in the RCM frame.
    pub fn observe(&self, observation: &mut [f32]) {
        let axes = match self.preset {
            Preset::Paper => self.rcm_from_camera.rotation * half_turn(),
            Preset::Surrol => self.rcm_from_camera.rotation,
        };
        let angles = frames::euler_xyz(&axes);
        let numbers = self.rcm_from_camera.translation.vector.iter().chain(&angles);
        for (slot, number) in observation.iter_mut().zip(numbers) {
            *slot = *number as f32;
        }
    }

    fn decode(&self, action: &[f32]) -> Option<[f64; 4]> {
        let number = |index: usize| f64::from(action[index]);
        let vector = Vector3::new(number(0), number(1), number(2));
        let limits = self.kinematics.limits();
        let roll_to = |roll: f64| roll.clamp(limits[3].min, limits[3].max);
        let roll = self.joints[3];
        match self.mode {
            ActionMode::Paper => self.moved(&(vector * STEP_LENGTH), roll),
            ActionMode::Cartesian => {
                self.moved(&(vector * STEP_LENGTH), roll_to(roll + number(3) * STEP_ROLL))
            }
            ActionMode::CartesianAbs => {
                let half = (POSITIONS.max - POSITIONS.min) * 0.5;
                let target = POSITIONS.centre() + vector.component_mul(&half);
                let step = target - self.rcm_from_camera.translation.vector;
                let step = step / (step.amax() / STEP_LENGTH).max(1.0);
                let turn = (number(3) * FRAC_PI_2 - roll).clamp(-STEP_ROLL, STEP_ROLL);
                self.moved(&step, roll_to(roll + turn))
            }
            ActionMode::Joint => Some(std::array::from_fn(|joint| {
                let wanted = self.joints[joint] + number(joint) * JOINT_STEPS[joint];
                wanted.clamp(limits[joint].min, limits[joint].max)
            })),
        }
    }

    /// The joints that move the sensed camera by `step` (m, RCM frame), with the roll at `roll`.
    fn moved(&self, step: &Vector3<f64>, roll: f64) -> Option<[f64; 4]> {
        let position = Point3::from(self.rcm_from_camera.translation.vector + step);
        let mut joints = self.joints_at(&(self.world_from_nominal * position).coords)?;
        joints[3] = roll;
        Some(joints)
    }

    /// The joints that bring the sensed camera to `position` (m, world frame).
    fn joints_at(&self, position: &Vector3<f64>) -> Option<[f64; 4]> {
        let position = self.world_from_rcm.inverse_transform_point(&Point3::from(*position));
        self.kinematics.inverse_position(&position.coords, &self.joints).ok()
    }

    fn sensed(&self, joints: &[f64; 4]) -> Pose {
        let world_from_camera = self.world_from_rcm * self.kinematics.base_from_camera(joints);
        self.world_from_nominal.inv_mul(&world_from_camera)
    }
}

fn world_from_rcm(base: [f64; 4]) -> Pose {
    let [x, y, z, pitch] = base;
    frames::pose([x, y, z], [0.0, pitch, 0.0]) * frames::pose(BASE_FROM_RCM, [0.0, 0.0, -FRAC_PI_2])
}

/// Turns dVRK's camera axes (z out of the lens) so that a straight endoscope has angles 0, far
/// from a wrap.
fn half_turn() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "these results are exact")]
mod tests {
    use super::*;

    #[test]
    fn the_arm_stands_where_the_originals_does() {
        let arm = EcmArm::new(&Options::new(), [0.5, 0.0, 0.7]).unwrap();
        let rcm = arm.world_from_rcm.translation.vector;
        assert!((rcm - Vector3::new(0.53133, 0.0, 0.78409)).norm() < 1e-5);
        // The original's lens under joints (0, 0, 0.04, 0), looking down at 30° towards −x.
        let camera = arm.world_from_rcm * arm.kinematics.base_from_camera(&[0.0, 0.0, 0.04, 0.0]);
        assert!((camera.translation.vector - Vector3::new(0.511, 0.0, 0.749)).norm() < 1e-3);
        let axis = camera.rotation * Vector3::z();
        assert!((axis - Vector3::new(-0.5, 0.0, -0.75f64.sqrt())).norm() < 1e-9);
    }

    #[test]
    fn every_action_mode_moves_the_camera_as_its_encoding_says() {
        for mode in ["paper", "cartesian", "cartesian_abs", "joint"] {
            let options = Options::new().with_text("action", mode);
            let mut arm = EcmArm::new(&options, [0.5, 0.0, 0.7]).unwrap();
            arm.reset(&mut Rng::new(0, 0));
            let before = arm.rcm_from_camera.translation.vector;
            let step = Vector3::new(0.003, -0.004, -0.002);
            let mut action = vec![0.0; arm.action_elements().len()];
            arm.encode(&step, &mut action);
            assert!(action.iter().all(|number| number.abs() <= 1.0), "{mode}: {action:?}");
            arm.apply(Some(&action));
            let off = arm.rcm_from_camera.translation.vector - before - step;
            assert!(off.norm() < 1e-7, "{mode}: {off}");
        }
    }

    #[test]
    fn an_unreachable_position_leaves_the_arm_where_it_is() {
        let mut arm = EcmArm::new(&Options::new(), [0.5, 0.0, 0.7]).unwrap();
        arm.reset(&mut Rng::new(0, 0));
        for _ in 0..100 {
            arm.apply(Some(&[0.0, 0.0, 1.0]));
        }
        let stopped = arm.joints;
        arm.apply(Some(&[0.0, 0.0, 1.0]));
        assert_eq!(arm.joints, stopped);
        let limits = arm.kinematics.limits();
        assert!(arm.joints.iter().zip(limits).all(|(q, l)| l.min <= *q && *q <= l.max));
        arm.apply(Some(&[0.0, 0.0, -1.0]));
        assert!(arm.joints != stopped);
    }
}
