//! What the ECM tasks share: where the endoscope's arm stands, how actions move it, what is
//! observed of it. The arm touches nothing, so it is pure kinematics.
//!
//! The *RCM frame* has its origin at the remote centre of motion, as dVRK's `local/measured_cp`; its
//! z axis points out along a straight endoscope. It is the nominal one, fixed in the world: where
//! `setup` moves the base, actions and poses stay in the nominal frame, so a policy keeps working.
//!
//! # Arms
//!
//! `arm = "si"` puts the arm of the S and Si where the one of the first generation stands by default, with the
//! same remote centre. Equal joints give the same view, and it looks the same. What differs are the limits of yaw
//! (±169.8° instead of ±90°), pitch (−63.0° to 59.6° instead of −44.0° to 65.0°), insertion (1 to 259 mm instead of
//! 0 to 255 mm) and roll (±88.2° instead of ±88.9°).
//!
//! # Actions
//!
//! Every action moves from the pose that the joint sensors report. A position that the arm cannot
//! take within its joint limits is not taken: the arm stays where it is for that step. Where joints
//! are commanded, each stops at its limit.
//!
//! | `action` | numbers (1.0 stands for) |
//! |---|---|
//! | `paper`, [`Control::Position`] | dx, dy, dz in the RCM frame (10 mm); the roll joint stays |
//! | `paper`, [`Control::Roll`] | the roll joint's increment (3°) |
//! | `paper`, [`Control::Velocity`] | vx, vy, vz of the camera in its image axes (5 mm/s), see below |
//! | `cartesian` | dx, dy, dz in the RCM frame (10 mm) and the roll joint's increment (3°) |
//! | `cartesian_abs` | x, y, z within the box of positions, roll joint (90°); a step goes at most 10 mm along each axis and 3° towards it |
//! | `joint` | yaw, pitch (0.06 rad), insertion (10 mm), roll (3°) |
//!
//! # Camera velocity
//!
//! The velocity v = (right, down, forward) is that of a point d = 20 mm ahead of the lens, relative
//! to it across the optical axis. It asks for the turns ω_down = v_right / d and
//! ω_right = −v_down / d about the image axes; v_forward is the speed of the lens itself. So 1.0
//! across turns the camera by 25 mrad a step, and 1.0 forward brings it on by 0.5 mm.
//!
//! The turn about the optical axis is not commanded but follows a law that drives the
//! [misorientation](super::camera::misorientation) θ* to zero: ω_forward = θ* / 0.1 s, so that one
//! step takes it away, but at most 3° in a step. θ* is that of the pose that the joint sensors
//! report.
//!
//! The joints' rates are those whose twist of the camera, (v, ω) in m/s and rad/s, comes nearest to
//! (0, 0, v_forward, ω_right, ω_down, ω_forward) in least squares: the pseudo-inverse of the 6 × 4
//! Jacobian. Source: the original.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_proto::builtin;
use trocar_proto::spec::{Element, RowSpec};
use trocar_proto::{Options, Rejection};

use super::camera;
use super::expert::Sees;
use super::options::{self, ActionMode, ArmErrors, Domain, Preset};
use super::rate::Rate;
use super::state::State;
use super::theatre;
use crate::render::{Scene, Viewpoint};
use crate::robots::{Drivetrain, Ecm, Endoscope, JointLimit};
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::random::Rng;
use crate::sim::world::SUBSTEPS_PER_SECOND;

mod action;
#[cfg(test)]
#[expect(clippy::float_cmp, reason = "these results are exact")]
mod tests;

/// How often the tasks are commanded for which numbers below are those of a step.
pub const RATE: Rate = Rate::nominal(builtin::ECM_HERTZ);

/// Movement that 1.0 in an action stands for, m. Source: the original.
pub const STEP_LENGTH: f64 = 0.01;

/// Roll that 1.0 in an action stands for, rad. Source: the original.
pub const STEP_ROLL: f64 = 3.0 * PI / 180.0;

/// Camera velocity that 1.0 in an action stands for, m/s. Source: the original's 0.01, with which
/// it moves the joints for 0.05 s a step.
const CAMERA_SPEED: f64 = 0.005;

/// How far ahead of the lens the point is whose velocity an action sets, m. Source: the original.
const TIP_OFFSET: f64 = 0.02;

/// Turn across the optical axis that 1.0 in a camera velocity makes in a step at [`RATE`], rad.
pub const STEP_TURN: f64 = CAMERA_SPEED / TIP_OFFSET * STEP;

/// A step's time at [`RATE`], s.
const STEP: f64 = 0.1;

/// Joint movements that 1.0 stands for, rad; index 2 in m.
const JOINT_STEPS: [f64; 4] = [0.06, 0.06, 0.01, STEP_ROLL];

/// Base of the arm of either generation: x, y, z, m, and pitch, rad. Source: the original.
const BASE: [f64; 4] = [-0.05, 0.0, 1.0024, PI / 6.0];

/// The remote centre of motion in the base, m; its axes are turned by −90° about z.
/// Source: the original's arm model.
const BASE_FROM_RCM: [f64; 3] = [0.6126, 0.0, 0.1016];

/// Positions of the camera, m, RCM frame: a box around all that the arm can take.
const POSITIONS: Aabb = Aabb::new([-0.26, -0.26, -0.26], [0.26, 0.26, 0.26]);

/// Largest error of the camera's direction that episodes may draw, rad.
pub const CAMERA_ANGLE: f64 = 0.05;

/// Height of the overview's view, rad.
const OVERVIEW: f64 = 0.72;

/// What `action = "paper"` commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// Increments of the camera's position.
    Position,
    /// Increments of the roll joint.
    Roll,
    /// The camera's velocity.
    Velocity,
}

/// An ECM.
#[derive(Debug, Clone)]
pub struct EcmArm {
    kinematics: Ecm,
    control: Control,
    world_from_rcm: Pose,
    /// The remote centre as it truly is.
    world_from_true_rcm: Pose,
    world_from_nominal: Pose,
    /// The camera of the nominal arm with all joints at 0: its view is the natural line of sight.
    world_from_reference: Pose,
    start: [f64; 4],
    mode: ActionMode,
    preset: Preset,
    domain: Domain,
    errors: Arc<ArmErrors>,
    /// What the joint sensors report.
    joints: [f64; 4],
    /// What lies between what motors are told, joint sensors and links.
    drivetrain: Drivetrain,
    /// Where an arm with a transmission is after each substep of the latest command; the first is from before.
    passed: Vec<Drivetrain>,
    /// Where the camera really is, seen from where it should be; none where it is there.
    camera_error: Option<Pose>,
    /// The camera as the joint sensors report it, in the base and in the nominal RCM frame.
    base_from_camera: Pose,
    rcm_from_camera: Pose,
    rate: Rate,
    /// Where the latest command moves the joints, as the sensors report them: from, to.
    way: [[f64; 4]; 2],
    /// What the actuators add to the next command: along the insertion, m, and about each rotary joint, rad.
    disturbance: Option<[f64; 4]>,
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
            presets: BTreeMap::new(),
        }]
    }

    /// An arm; where it starts is still to be said.
    pub fn new(options: &Options, control: Control) -> Result<Self, Rejection> {
        let base = match options.row("setup", "base") {
            Some(&[x, y, z, pitch]) => [x, y, z, pitch],
            _ => BASE,
        };
        let kinematics = Ecm::new(options::arm_of(options)?, Endoscope::Straight);
        let world_from_nominal = world_from_rcm(BASE);
        let base_from_camera = kinematics.base_from_camera(&[0.0; 4]);
        Ok(Self {
            kinematics,
            control,
            world_from_rcm: world_from_rcm(base),
            world_from_true_rcm: world_from_rcm(base),
            world_from_nominal,
            world_from_reference: world_from_nominal * base_from_camera,
            start: [0.0; 4],
            mode: options::action_of(options),
            preset: options::preset_of(options),
            domain: Domain::of(options)?,
            errors: ArmErrors::of(options)?.into(),
            joints: [0.0; 4],
            drivetrain: Drivetrain::new([0.0; 4]),
            passed: vec![],
            camera_error: None,
            base_from_camera,
            rcm_from_camera: Pose::identity(),
            rate: RATE.of(options),
            way: [[0.0; 4]; 2],
            disturbance: None,
        })
    }

    /// Lets episodes start with the camera at `position` (m, world frame), roll 0; false where the
    /// arm cannot be there.
    pub fn start_at(&mut self, position: &Vector3<f64>) -> bool {
        let Some([yaw, pitch, insertion, _]) = self.joints_at(position) else { return false };
        self.start = [yaw, pitch, insertion, 0.0];
        true
    }

    /// Whether the camera can be at `position` (m, world frame).
    pub fn reaches(&self, position: &Vector3<f64>) -> bool {
        self.joints_at(position).is_some()
    }

    /// Brings the arm to its start and draws this episode's errors of encoders and camera.
    pub fn reset(&mut self, rng: &mut Rng) {
        let mut offsets = [0.0; 4];
        for joint in [0, 1, 3] {
            offsets[joint] = self.domain.joint_offset.draw(rng);
        }
        self.drivetrain = Drivetrain::new(offsets);
        if let Some(transmission) = self.errors.draw_transmission(rng) {
            self.drivetrain = self.drivetrain.clone().with_transmission(transmission, &self.start);
        }
        let middle = self.nominal_start().translation.vector.into();
        let error = self.errors.draw_base_error(rng, middle);
        self.world_from_true_rcm =
            error.map_or(self.world_from_rcm, |error| error * self.world_from_rcm);
        self.camera_error = self.domain.draw_camera_error(rng);
        self.passed.clear();
        self.way = [self.start; 2];
        self.sense(self.start);
    }

    /// Lets episodes start with these joints, rad; index 2 in m, or with those nearest to them that it can take.
    pub fn start_with(&mut self, joints: &[f64; 4]) {
        let limits = self.kinematics.limits();
        self.start = std::array::from_fn(|joint| limits[joint].clamp(joints[joint]));
    }

    /// Whether the camera looks at the ground in front of the natural line of sight's camera at the
    /// start, so that its misorientation means something there.
    pub fn starts_comparable(&self) -> bool {
        camera::comparable(&self.world_from_reference, &self.camera_with(&self.start))
    }

    /// The camera at the start of an episode without errors, world frame.
    pub fn nominal_start(&self) -> Pose {
        self.world_from_rcm * self.kinematics.base_from_camera(&self.start)
    }

    /// Where joints, as they really are, bring the true camera, world frame.
    fn camera_with(&self, joints: &[f64; 4]) -> Pose {
        // What the sensors report is mostly true, to the bit.
        let are_sensed = joints.map(f64::to_bits) == self.joints.map(f64::to_bits);
        let base_from_camera = if are_sensed {
            self.base_from_camera
        } else {
            self.kinematics.base_from_camera(joints)
        };
        let world_from_camera = self.world_from_true_rcm * base_from_camera;
        self.camera_error.map_or(world_from_camera, |error| world_from_camera * error)
    }

    /// The true misorientation, rad.
    pub fn misorientation(&self) -> f64 {
        camera::misorientation(&self.world_from_reference, &self.world_from_camera())
    }

    /// The misorientation that the joint sensors report, rad.
    pub fn sensed_misorientation(&self) -> f64 {
        let world_from_camera = self.world_from_nominal * self.rcm_from_camera;
        camera::misorientation(&self.world_from_reference, &world_from_camera)
    }

    /// What the roll joint may turn on by, rad: least and most.
    pub fn roll_left(&self) -> [f64; 2] {
        let limit = &self.kinematics.limits()[3];
        [limit.min - self.joints[3], limit.max - self.joints[3]]
    }

    /// The joints as they really are, rad; index 2 in m.
    pub fn true_joints(&self) -> [f64; 4] {
        self.drivetrain.settled(&self.joints)
    }

    /// Length of the path of the endoscope's tip, m, since the true joints were `joints` and moved evenly. Where the
    /// camera is misplaced on its arm, the tip is not.
    pub fn tip_path(&self, joints: &[f64; 4]) -> f64 {
        self.kinematics.tip_path(joints, &self.true_joints())
    }

    /// The true camera, world frame.
    pub fn world_from_camera(&self) -> Pose {
        self.camera_with(&self.true_joints())
    }

    /// The camera as an expert sees it, world frame.
    pub fn seen_camera(&self, sees: Sees) -> Pose {
        match sees {
            Sees::Truth => self.world_from_camera(),
            Sees::Measured => self.world_from_nominal * self.rcm_from_camera,
        }
    }

    /// The misorientation as an expert sees it, rad.
    pub fn seen_misorientation(&self, sees: Sees) -> f64 {
        camera::misorientation(&self.world_from_reference, &self.seen_camera(sees))
    }

    /// Draws the arm as it truly is, as `ecm`, over a floor with a pattern of tiles; its camera is the
    /// endoscope.
    pub fn draw(&self, scene: &mut Scene) {
        theatre::draw_tiles(scene);
        let joints = self.true_joints();
        theatre::draw_ecm(scene, &self.kinematics, &self.world_from_true_rcm, &joints);
        scene.look_through(&self.camera_with(&joints), false);
        scene.stage = Aabb::new([-0.8, -0.7, 0.0], [0.9, 0.7, 0.9]);
        scene.overview = Viewpoint::towards([1.75, -0.95, 1.45], [0.18, -0.02, 0.55], OVERVIEW);
    }

    /// A vector of the world (m) in the axes of the RCM frame.
    pub fn in_rcm(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.world_from_nominal.inverse_transform_vector(vector)
    }

    /// How often the arm is commanded.
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// Lets the actuators add this to the next command's joints, rad; index 2 in m.
    pub fn disturb(&mut self, joints: [f64; 4]) {
        self.disturbance = Some(joints);
    }

    /// Takes a command: an action of the arm's mode, or none, for the arm to hold.
    pub fn command(&mut self, action: Option<&[f32]>) {
        let mut end = action.and_then(|action| self.decode(action)).unwrap_or(self.joints);
        if let Some(added) = self.disturbance.take() {
            let limits = self.kinematics.limits();
            end = std::array::from_fn(|joint| limits[joint].clamp(end[joint] + added[joint]));
        }
        self.way = [self.joints, end];
        if self.drivetrain.gives() {
            self.follow_way();
        }
    }

    /// Sees ahead how encoders and links follow their motors on the way of the latest command.
    fn follow_way(&mut self) {
        let substeps = self.rate.substeps();
        let mut drivetrain = self.drivetrain.clone();
        self.passed.clear();
        self.passed.push(drivetrain.clone());
        for now in 1..=substeps {
            let told = self.along(f64::from(now) / f64::from(substeps));
            drivetrain.advance(&told, 1.0 / SUBSTEPS_PER_SECOND);
            self.passed.push(drivetrain.clone());
        }
    }

    /// Where the latest command has the joints after a `part`, 0 to 1, of its time.
    fn along(&self, part: f64) -> [f64; 4] {
        let [start, end] = self.way;
        if part < 1.0 {
            std::array::from_fn(|joint| start[joint] + (end[joint] - start[joint]) * part)
        } else {
            end
        }
    }

    /// Brings the arm to where it is after a `part`, 0 to 1, of the time that it has for its latest command: each
    /// joint moves evenly.
    pub fn glide(&mut self, part: f64) {
        let joints = match self.passed.len() {
            0 => self.along(part),
            count => {
                let now = (part * (count - 1) as f64).round() as usize;
                self.drivetrain.clone_from(&self.passed[now]);
                first(self.drivetrain.present())
            }
        };
        if joints != self.joints {
            self.sense(joints);
        }
    }

    /// Its kinematics.
    pub fn kinematics(&self) -> &Ecm {
        &self.kinematics
    }

    /// Its remote centre of motion as it is believed to be, world frame.
    pub fn world_from_rcm(&self) -> &Pose {
        &self.world_from_rcm
    }

    /// What the joint sensors report, rad; index 2 in m.
    pub fn encoders(&self) -> &[f64; 4] {
        &self.joints
    }

    /// What lies between what its motors are told, its joint sensors and its links.
    pub fn drivetrain(&self) -> &Drivetrain {
        &self.drivetrain
    }

    /// The joints that an action asks for, as far as the arm may go there, rad; index 2 in m.
    pub fn aim(&self, action: &[f32]) -> [f64; 4] {
        self.decode(action).unwrap_or(self.joints)
    }

    /// Takes note of what the joint sensors report of an arm that is driven from outside, rad; index 2 in m, and of
    /// its drivetrain.
    pub fn follow(&mut self, encoders: &[f64; 4], drivetrain: &Drivetrain) {
        self.way = [*encoders; 2];
        self.drivetrain.clone_from(drivetrain);
        self.passed.clear();
        self.sense(*encoders);
    }

    /// The arm once actions that are on their way have been carried out, as its expert foresees it.
    #[must_use]
    pub fn ahead(&self, in_flight: &[f32]) -> Cow<'_, Self> {
        if in_flight.is_empty() && self.joints == self.way[1] {
            return Cow::Borrowed(self);
        }
        let mut ahead = Self { disturbance: None, ..self.clone() };
        ahead.glide(1.0);
        for action in in_flight.chunks(self.action_elements().len()) {
            ahead.command(Some(action));
            ahead.glide(1.0);
        }
        Cow::Owned(ahead)
    }

    /// Its part of a state: camera position (3) and extrinsic XYZ Euler angles (3) in the RCM frame, as sensed.
    pub fn state(&self, state: &mut State<'_>) {
        // ECM scenes are not scaled under any preset.
        let camera = &self.rcm_from_camera;
        state.position("camera", "rcm", &POSITIONS, Preset::Paper, &camera.translation.vector);
        state.angles("camera", "rcm", self.angles(&camera.rotation));
    }

    /// The elements of [`Self::measured_joints`].
    pub fn joint_elements(&self) -> Vec<Element> {
        let names = [("yaw", "rad"), ("pitch", "rad"), ("insertion", "m"), ("roll", "rad")];
        let limits = self.kinematics.limits();
        let element = |((name, unit), limit): ((&str, &str), &JointLimit)| {
            let (min, max) = (limit.min as f32, limit.max as f32);
            Element::new(&format!("{name} joint"), "joint", unit, min, max)
        };
        names.into_iter().zip(limits).map(element).collect()
    }

    /// What the joint sensors report: yaw, pitch (rad), insertion (m), roll (rad).
    pub fn measured_joints(&self) -> [f32; 4] {
        self.joints.map(|joint| joint as f32)
    }

    /// The sensed camera's extrinsic XYZ Euler angles in the world, rad.
    pub fn angles_in_world(&self) -> [f64; 3] {
        self.angles(&(self.world_from_nominal.rotation * self.rcm_from_camera.rotation))
    }

    fn angles(&self, rotation: &UnitQuaternion<f64>) -> [f64; 3] {
        match self.preset {
            Preset::Paper => frames::euler_xyz(&(rotation * half_turn())),
            Preset::Surrol => frames::euler_xyz(rotation),
        }
    }

    /// The joints that bring the sensed camera to `position` (m, world frame).
    fn joints_at(&self, position: &Vector3<f64>) -> Option<[f64; 4]> {
        let position = self.world_from_rcm.inverse_transform_point(&Point3::from(*position));
        self.kinematics.inverse_position(&position.coords, &self.joints).ok()
    }

    /// Takes note of what the joint sensors report, rad; index 2 in m.
    fn sense(&mut self, joints: [f64; 4]) {
        self.joints = joints;
        self.base_from_camera = self.kinematics.base_from_camera(&joints);
        self.rcm_from_camera = self.in_nominal_rcm(&self.base_from_camera);
    }

    /// Where the nominal RCM frame has a camera that is here in the base.
    fn in_nominal_rcm(&self, base_from_camera: &Pose) -> Pose {
        self.world_from_nominal.inv_mul(&(self.world_from_rcm * base_from_camera))
    }
}

/// The joints among axes.
fn first(axes: &[f64]) -> [f64; 4] {
    std::array::from_fn(|joint| axes[joint])
}

/// The misorientation as an element of a goal or an observation.
pub fn misorientation_element() -> Element {
    use std::f32::consts::PI;
    Element::new("misorientation", "camera image", "rad", -PI, PI)
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
