//! What the PSM tasks share: where the arm stands, how actions move it, what is observed of it.
//!
//! Everything is in the *scene* frame, the original's world: z up, table top nominally at 0.675 m.
//! Where `setup` moves the base or the table, the arm's base moves in the scene, while workspace,
//! pad, actions and state stay: a policy keeps working.
//!
//! # Arms
//!
//! `arm = "si"` puts an arm of the S and Si where the one of the first generation stands by default, with
//! the same remote centre. Equal joints bring the wrist to the same pose, and the jaws and all that they touch are
//! the same. Two things differ:
//!
//! - Limits of yaw (±169.8° instead of ±91.0°), pitch (−72.5° to 74.5° instead of ±53.0°) and insertion (0.29 m instead
//!   of 0.24 m). They hold all of the first generation's.
//! - What is drawn: a shaft and rail 50.8 mm longer.
//!
//! # Errors
//!
//! Rows of `domain` say what is wrong with an arm: see the table of [`arm_errors`](super::options::arm_errors). Joint
//! sensors then report other joints than its links have, and its base is elsewhere than it is believed to be. Where the base
//! errs, the wrist may go further by as much.
//!
//! # Actions
//!
//! Every action moves from the pose that the joint sensors report. The resulting pose is confined:
//! the wrist to the workspace and a margin around it ([`REACH`]), the tip to the same box in x and
//! y. The closed jaws, as they truly are, stay 0.05 mm above the pad, or as far in it as it
//! gives: encoders that err keep no arm from what lies on it. A pose outside the arm's
//! joint limits, or one that would take a whole turn of the roll, is not taken: the arm stays
//! where it is for that step.
//!
//! | `action` | numbers (1.0 stands for) |
//! |---|---|
//! | `paper` | dx, dy, dz (10 mm), the task's turn, jaw (below 0 closed, else open 40°) |
//! | `cartesian` | dx, dy, dz (10 mm), rotation vector x, y, z in the scene frame (30°), jaw (−1 closed … 1 open 40°) |
//! | `cartesian_abs` | x, y, z within [`REACH`], rotation vector from jaws straight down (180°), jaw as before; a step goes at most 10 mm along each axis and 30° towards it |
//! | `joint` | yaw, pitch (0.06 rad), insertion (10 mm), roll, wrist pitch, wrist yaw (30°), jaw as before |

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use nalgebra::Vector3;
use trocar_proto::builtin;
use trocar_proto::spec::{Element, RowSpec};
use trocar_proto::{Options, Rejection};

use super::options::{self, ActionMode, ArmErrors, Preset, Range};
use super::rate::Rate;
use super::state::State;
use crate::render::skeleton::Skeleton;
use crate::render::{Jaws, Scene};
use crate::robots::{ArmModel, Axes, Drivetrain, Psm};
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::instrument::{
    self, Instrument, JAW_CLOSED, JAW_OPEN, Jaws as Fingers, Posture, TIP_OFFSET,
};
use crate::sim::motion::Profile;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, SoftId, World};

mod action;
mod command;
mod driven;
mod erring;
mod measured;
mod orientation;
mod place;
mod placing;
#[cfg(test)]
mod tests;
mod varying;

use command::Commanded;
pub use command::{command, settle};
use orientation::wrist_from_link;
pub(super) use orientation::{down, straight_down};
pub use orientation::{pitch_across, pitch_of, pitched};

/// How often the tasks are commanded for which numbers below are those of a step.
pub const RATE: Rate = Rate::nominal(builtin::PSM_HERTZ);

/// Height of the table's top, m. Source: the original's table.
pub const TABLE_HEIGHT: f64 = 0.675;

/// Bases of PSM1 and PSM2 of either generation: position, m, and turn about the vertical, rad. Source: the original.
pub const BASES: [[f64; 4]; 2] =
    [[0.05, 0.24, 0.8524, -110.0 * DEGREE], [0.05, -0.24, 0.8524, -70.0 * DEGREE]];

/// Rows of `setup` that move the bases.
pub const BASE_ROWS: [&str; 2] = ["base", "base_2"];

/// The remote centre of motion in the base, m. Source: the original's arm model.
const BASE_FROM_RCM: [f64; 3] = [0.0, 0.4864, 0.0];

/// The 10 cm workspace, for the tip of jaws that point down, m. Source: the original.
pub const WORKSPACE: Aabb = Aabb::new([0.50, -0.05, 0.675], [0.60, 0.05, 0.745]);

/// Where the wrist may go in [`WORKSPACE`], m.
pub const REACH: Aabb = reach(&WORKSPACE);

/// Where the wrist may go for the tip to work in `workspace`, m: as much higher as the jaws are long,
/// 4 mm more to each side and 16 mm more above. Source: the original.
pub const fn reach(workspace: &Aabb) -> Aabb {
    let [[x0, y0, z0], [x1, y1, z1]] = [workspace.min.data.0[0], workspace.max.data.0[0]];
    Aabb::new(
        [x0 - 0.004, y0 - 0.004, z0 + TIP_OFFSET],
        [x1 + 0.004, y1 + 0.004, z1 + TIP_OFFSET + 0.016],
    )
}

/// Movement that 1.0 in an action stands for, m. Source: the original.
pub const STEP_LENGTH: f64 = 0.01;

/// Turn that 1.0 in an action stands for, rad. Source: the original.
pub const STEP_ANGLE: f64 = 30.0 * DEGREE;

/// Pitch that 1.0 in an action stands for, rad. Source: the original.
pub const STEP_PITCH: f64 = 15.0 * DEGREE;

/// Largest pitch in both directions, rad. Source: the original.
pub const PITCH_LIMIT: f64 = FRAC_PI_2;

/// Joint movements that 1.0 stands for, rad; index 2 in m: 10 mm at the usual depth of 0.16 m.
const JOINT_STEPS: [f64; 6] = [0.06, 0.06, 0.01, STEP_ANGLE, STEP_ANGLE, STEP_ANGLE];

const DEGREE: f64 = PI / 180.0;

/// Squeeze of jaws that no action opens, N: nothing pries them apart.
const LOCKED: f64 = f64::INFINITY;

/// Force with which each finger squeezes, N. What an engine's contact can bear grows with the mass of
/// the object: 1 N holds real objects, 3 N the original's of 10 g.
pub const SQUEEZE: f64 = 1.0;
const SQUEEZE_HEAVY: f64 = 3.0;

/// What the `paper` action of a task moves besides the position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PaperAction {
    /// What the fourth number turns.
    pub turn: Turn,
    /// Whether the last number opens and closes the jaws; otherwise they stay closed, in every
    /// action mode.
    pub jaw: bool,
}

/// What the fourth number of the `paper` action turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// Nothing: the number is ignored.
    Nothing,
    /// The jaws about the vertical, by [`STEP_ANGLE`].
    Vertical,
    /// The pitch of the wrist link, by [`STEP_PITCH`] within ±[`PITCH_LIMIT`], while its roll and yaw
    /// stay: see [`pitched`].
    Pitch,
}

/// Where an arm stands and works.
#[derive(Debug, Clone, Copy)]
pub struct Station {
    /// Which arm: 0 is PSM1, 1 is PSM2.
    pub arm: usize,
    /// Where the tip of jaws that point down works, m.
    pub workspace: Aabb,
    /// The wrist at the beginning of an episode.
    pub start: Pose,
    /// Height of what lies under the jaws, m.
    pub support: f64,
    /// Force with which each finger squeezes under `preset = "paper"`, N; [`SQUEEZE`] where none is given.
    pub squeeze: Option<f64>,
    /// What it has at the end of its wrist.
    pub jaws: Fingers,
}

impl Station {
    /// PSM1 in [`WORKSPACE`], the wrist at `start` (m), jaws straight down.
    pub fn psm1(start: [f64; 3], support: f64) -> Self {
        let jaws = Fingers::NEEDLE_DRIVER;
        let start = straight_down(start);
        Self { arm: 0, workspace: WORKSPACE, start, support, squeeze: None, jaws }
    }
}

/// A PSM with its instrument in the world.
#[derive(Debug, Clone)]
pub struct PsmArm {
    /// 0 is PSM1, 1 is PSM2.
    index: usize,
    kinematics: Psm,
    /// The base as it is believed to be.
    scene_from_base: Pose,
    /// The base as it truly is.
    scene_from_true_base: Pose,
    start: Pose,
    start_joints: [f64; 6],
    mode: ActionMode,
    paper: PaperAction,
    preset: Preset,
    joint_offset: Range,
    friction: Range,
    errors: Arc<ArmErrors>,
    /// The middle of the workspace, m, about which the true base may be turned.
    middle: [f64; 3],
    /// Where the wrist may go, m.
    reach: Aabb,
    /// Height of what lies under the jaws, m.
    support: f64,
    /// How far the jaws may be pressed into it, m.
    give: f64,
    rate: Rate,
    instrument: Instrument,
    /// What the joint sensors report.
    joints: [f64; 6],
    /// What lies between what motors are told, joint sensors and links.
    drivetrain: Drivetrain,
    /// The same once motors have come to rest where the latest command asked the arm to be.
    asked_drivetrain: Drivetrain,
    /// What the motors of an arm with a transmission were told in each substep of the latest command, and where it then
    /// was; the first are from before.
    told: Vec<(Axes, Drivetrain)>,
    /// The wrist as the joint sensors report it.
    scene_from_wrist: Pose,
    /// From where increments count: where the latest command asked the arm to be, or where it is if it was
    /// held up.
    commanded: Commanded,
    /// How the arm goes where the latest command asked it to be.
    profile: Profile,
    /// Whether it was held up or pushed aside in the last step.
    is_held_up: bool,
    /// What the actuators add to the next command: a step (m) and a rotation vector (rad), scene frame.
    disturbance: Option<[Vector3<f64>; 2]>,
}

impl PsmArm {
    /// The rows of `setup` that move `count` PSMs.
    pub fn setup_rows(count: usize) -> Vec<RowSpec> {
        let row = |name: &str, summary: &str, count, min, max| RowSpec {
            name: name.into(),
            summary: summary.into(),
            count,
            min,
            max,
            presets: BTreeMap::new(),
        };
        let base = "Base of the arm: x, y, z (m), turn about the vertical (rad).";
        let bases = BASE_ROWS[..count].iter().map(|name| row(name, base, 4, -PI, PI));
        bases.chain([row("table_height", "Height of the table's top, m.", 1, 0.0, 2.0)]).collect()
    }

    /// Puts an arm into the world, jaws closed.
    pub fn insert(
        world: &mut World,
        options: &Options,
        paper: PaperAction,
        station: Station,
    ) -> Result<Self, Rejection> {
        let [x, y, z, yaw] = match options.row("setup", BASE_ROWS[station.arm]) {
            Some(&[x, y, z, yaw]) => [x, y, z, yaw],
            _ => BASES[station.arm],
        };
        let table = options.row("setup", "table_height").map_or(TABLE_HEIGHT, |row| row[0]);
        let scene_from_base = frames::pose([x, y, z - (table - TABLE_HEIGHT)], [0.0, 0.0, yaw])
            * Pose::from(Vector3::from(BASE_FROM_RCM));
        let start = station.start;
        let domain = options::Domain::of(options)?;
        let errors = ArmErrors::of(options)?;
        let mut arm = Self {
            index: station.arm,
            kinematics: Psm::new(options::arm_of(options)?),
            scene_from_base,
            scene_from_true_base: scene_from_base,
            start,
            start_joints: [0.0; 6],
            mode: options::action_of(options),
            paper,
            preset: options::preset_of(options),
            joint_offset: domain.joint_offset,
            friction: domain.friction,
            reach: reach(&station.workspace).grown(errors.reach_margin()),
            errors: errors.into(),
            middle: station.workspace.centre().into(),
            support: station.support,
            give: 0.0,
            instrument: Instrument::with_jaws(
                world,
                Posture { world_from_wrist: start, jaw: JAW_CLOSED },
                match options::preset_of(options) {
                    _ if !paper.jaw => LOCKED,
                    Preset::Paper => station.squeeze.unwrap_or(SQUEEZE),
                    Preset::Surrol => SQUEEZE_HEAVY,
                },
                station.jaws,
            ),
            joints: [0.0, 0.0, 0.1, 0.0, 0.0, 0.0],
            drivetrain: Drivetrain::new([0.0; 7]),
            asked_drivetrain: Drivetrain::new([0.0; 7]),
            told: vec![],
            scene_from_wrist: start,
            rate: RATE.of(options),
            commanded: Commanded {
                joints: [0.0, 0.0, 0.1, 0.0, 0.0, 0.0],
                scene_from_wrist: start,
                jaw: JAW_CLOSED,
            },
            profile: Profile::rest(Posture { world_from_wrist: start, jaw: JAW_CLOSED }),
            is_held_up: false,
            disturbance: None,
        };
        for corner in station.workspace.corners() {
            let wrist = corner.coords + Vector3::z() * TIP_OFFSET;
            let wrist = Pose::from_parts(wrist.into(), start.rotation);
            if arm.solve(&arm.confined(wrist)).is_none() {
                let why = "the arm must reach all of the workspace within its joint limits";
                return Err(options::refuse_setup(options, why));
            }
        }
        arm.start_joints = arm
            .solve(&start)
            .ok_or_else(|| options::refuse_setup(options, "the arm must reach its start"))?;
        Ok(arm)
    }

    /// Brings the arm to its start and draws this episode's errors of the arm and friction of the jaws.
    pub fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        self.draw_friction(world, rng);
        self.draw_encoders(rng);
        self.joints = self.start_joints;
        self.scene_from_wrist = self.start;
        let world_from_wrist = self.pose_of(&self.true_joints());
        self.instrument.detach(world);
        self.instrument.place(Posture { world_from_wrist, jaw: JAW_CLOSED });
        self.stay();
    }

    /// Draws this episode's friction of the jaws.
    fn draw_friction(&mut self, world: &mut World, rng: &mut Rng) {
        if let Some(friction) = self.friction.draw_if_given(rng) {
            self.instrument.set_friction(world, friction);
        }
    }

    /// Draws this episode's errors of the arm.
    fn draw_encoders(&mut self, rng: &mut Rng) {
        let mut offsets = [0.0; 7];
        for joint in [0, 1, 3, 4, 5] {
            offsets[joint] = self.joint_offset.draw(rng);
        }
        self.draw_errors(offsets, rng);
    }

    /// Sets the largest depth of the jaws in a soft pad, m.
    pub fn give(&mut self, depth: f64) {
        self.give = depth;
    }

    /// The lowest height that commands bring the jaws to, m.
    fn lowest(&self) -> f64 {
        self.support - self.give + instrument::CLEARANCE
    }

    /// Puts the arm, at once, where its true wrist is at `target`, jaws open by `jaw` (rad); false
    /// where it cannot be there.
    pub fn put(&mut self, target: &Pose, jaw: f64) -> bool {
        let base_from_wrist = self.scene_from_true_base.inv_mul(target);
        let Ok(links) = self.kinematics.inverse(&base_from_wrist, &self.start_joints) else {
            return false;
        };
        let links = erring::axes(&links, jaw);
        self.joints = erring::first(&self.drivetrain.encoders(&links));
        self.drivetrain.displace(&links);
        self.scene_from_wrist = self.pose_at(&self.joints);
        let world_from_wrist = self.pose_of(&self.true_joints());
        self.instrument.place(Posture { world_from_wrist, jaw });
        self.stay();
        true
    }

    /// Attaches `object` to the wrist where it is, to prepare a start; [`Self::let_go`] ends it.
    pub fn hold_fast(&mut self, world: &mut World, object: BodyId) {
        self.instrument.attach(world, object);
    }

    /// Lets go what is attached to the wrist.
    pub fn let_go(&mut self, world: &mut World) {
        self.instrument.detach(world);
    }

    /// Which generation it is.
    pub fn model(&self) -> ArmModel {
        self.kinematics.model()
    }

    /// Where the wrist may go, m.
    pub fn reach(&self) -> &Aabb {
        &self.reach
    }

    /// The true tip of the closed jaws, m, scene frame.
    pub fn tip(&self) -> Vector3<f64> {
        self.instrument.posture().world_from_tip().translation.vector
    }

    /// The wrist where the latest command asked it to be, as the joint sensors will report it, scene frame; where
    /// it is if it was held up.
    pub fn commanded(&self) -> &Pose {
        &self.commanded.scene_from_wrist
    }

    /// The wrist as the joint sensors report it, scene frame.
    pub fn scene_from_wrist(&self) -> &Pose {
        &self.scene_from_wrist
    }

    /// Whether its actions turn the jaws about the vertical.
    pub fn turns(&self) -> bool {
        self.mode != ActionMode::Paper || self.paper.turn == Turn::Vertical
    }

    /// The wrist as it truly is, scene frame.
    pub fn true_wrist(&self) -> &Pose {
        &self.instrument.posture().world_from_wrist
    }

    /// The wrist where it truly will be when the arm is where the latest command asked it to be, scene frame.
    pub fn true_commanded(&self) -> Pose {
        if self.errs() {
            self.true_pose(&self.commanded.joints)
        } else {
            self.commanded.scene_from_wrist
        }
    }

    /// Present set point of the opening of the jaws, rad. It moves towards the latest command.
    pub fn told_opening(&self) -> f64 {
        self.instrument.posture().jaw
    }

    /// How far the latest command asked the jaws to be open, rad.
    pub fn asked_opening(&self) -> f64 {
        self.commanded.jaw
    }

    /// Whether it was held up or pushed aside in the last step.
    pub fn is_held_up(&self) -> bool {
        self.is_held_up
    }

    /// Whether the latest command asked it to be as low as it may go.
    pub fn is_lowest(&self) -> bool {
        /// What counts as no higher, m.
        const ROUNDING: f64 = 1e-6;
        let wrist = self.true_commanded();
        let low = wrist.translation.z - self.instrument.depth_below_wrist(&wrist.rotation);
        low < self.lowest() + ROUNDING
    }

    /// How far a place is outside of where the sensed wrist may go, m.
    pub fn shortfall(&self, place: &Vector3<f64>) -> f64 {
        (self.reach.clamp(place) - place).norm()
    }

    /// Numbers of an action.
    pub fn action_len(&self) -> usize {
        self.mode.psm_numbers()
    }

    /// Draws the arm as it truly is, as `psm1` or `psm2`.
    pub fn draw(&self, world: &World, scene: &mut Scene) {
        const NAMES: [&str; 6] = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"];
        let joints = self.true_joints();
        let joint = |name: &str| {
            let index = NAMES.iter().position(|other| *other == name);
            index.map_or(0.0, |index| joints[index])
        };
        let fingers = self.instrument.world_from_fingers(world);
        let link = wrist_from_link();
        // The first jaw of the model is on the −x side of its link.
        let first = usize::from((link * -Vector3::x()).y > 0.0);
        let elsewhere = |name: &str| match name {
            "jaw_1_link" => Some(fingers[first] * link),
            "jaw_2_link" => Some(fingers[1 - first] * link),
            _ => None,
        };
        let name = ["psm1", "psm2"][self.index];
        scene.jaws.push(Jaws {
            arm: name,
            opening: self.opening(world),
            asked: self.instrument.posture().jaw,
            pressures: self.instrument.pressures(world),
        });
        Skeleton::psm(self.model()).draw(scene, name, &self.scene_from_true_base, joint, elsewhere);
    }

    /// How far the shaft's end is from that of `other`, m; below 0 they overlap.
    pub fn gap(&self, other: &Self) -> f64 {
        self.instrument.posture().gap(other.instrument.posture())
    }

    /// How far the jaws are open, rad.
    pub fn opening(&self, world: &World) -> f64 {
        self.instrument.opening(world)
    }

    /// True if the jaws are open, or held by an object for which they closed already.
    pub(super) fn is_open(&self, world: &World) -> bool {
        self.opening(world) > 0.9 * JAW_OPEN || self.commanded.jaw <= JAW_CLOSED
    }

    /// Whether both fingers press on `object`.
    pub fn holds(&self, world: &World, object: BodyId) -> bool {
        self.instrument.holds(world, object)
    }

    /// How many of its fingers press on a soft body.
    pub fn fingers_on(&self, world: &World, soft: SoftId) -> usize {
        self.instrument.fingers_on(world, soft)
    }

    /// The force of a soft body on both fingers together, N, friction included.
    pub fn pull_of(&self, world: &World, soft: SoftId) -> Vector3<f64> {
        self.instrument.force_of(world, soft)
    }

    /// How hard everything together presses on each finger, N.
    pub fn pressures(&self, world: &World) -> [f64; 2] {
        self.instrument.pressures(world)
    }

    /// How often the arm is commanded.
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// How the arm goes where the latest command asked it to be.
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// Its instrument in the world.
    pub fn instrument(&mut self) -> &mut Instrument {
        &mut self.instrument
    }

    /// Number of fields of [`Self::state`].
    pub const OBSERVED: usize = 7;

    /// Its part of a state: wrist position (3) within its reach, extrinsic XYZ Euler angles of the wrist link (3), jaw
    /// angle.
    pub fn state(&self, world: &World, state: &mut State<'_>) {
        self.state_within(&self.reach.grown(1e-3), world, state);
    }

    /// The same for an arm whose wrist stays in `bounds`, m.
    pub fn state_within(&self, bounds: &Aabb, world: &World, state: &mut State<'_>) {
        let wrist = &self.scene_from_wrist;
        state.position("wrist", "scene", bounds, self.preset, &wrist.translation.vector);
        let angles = frames::euler_xyz(&(wrist.rotation * wrist_from_link()));
        state.angles("wrist link", "scene", angles);
        let jaw = || Element::new("jaw", "", "rad", -0.1, instrument::FORCED_OPEN as f32);
        state.field(jaw, self.instrument.opening(world));
    }
}
