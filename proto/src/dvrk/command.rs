//! What a client may ask of an arm: values of one enum, whichever way they came.
//!
//! Commands hold what was sent, and may hold anything: the server's controller of the arm checks them. Vectors are
//! in the order of the joints: rad, rad/s; m and m/s for the insertion (index 2).

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::Pose;

/// Jaw angle to which `jaw.close()` of dVRK's Python client goes, rad: −20°.
pub const JAW_CLOSE: f64 = -20.0 * DEGREE;

/// Jaw angle to which `jaw.open()` of dVRK's Python client goes, rad: 60°.
pub const JAW_OPEN: f64 = 60.0 * DEGREE;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Largest number that is a position, m: 1000 km. What is larger would only overflow.
const LARGEST: f64 = 1e6;

/// How far from 1 the length of a quaternion may be.
const UNIT: f64 = 1e-2;

/// A pose as a message holds it (`geometry_msgs/PoseStamped`).
#[derive(Debug, Clone, PartialEq)]
pub struct PoseMessage {
    /// The frame that the pose is in (`header.frame_id`): empty or the arm's reference frame, or `NAME_base` for its
    /// remote centre.
    pub frame: String,
    /// x, y, z, m.
    pub position: [f64; 3],
    /// x, y, z, w of a unit quaternion.
    pub orientation: [f64; 4],
}

impl PoseMessage {
    /// A pose in the arm's reference frame.
    pub fn new(pose: &Pose) -> Self {
        Self {
            frame: String::new(),
            position: pose.translation.vector.into(),
            orientation: pose.rotation.coords.into(),
        }
    }

    /// The same numbers in another frame.
    #[must_use]
    pub fn with_frame(self, frame: impl Into<String>) -> Self {
        Self { frame: frame.into(), ..self }
    }

    /// The pose that the numbers are, or what is wrong with them.
    pub fn pose(&self) -> Result<Pose, Malformed> {
        if let Some(index) = self.position.iter().position(|value| !is_position(*value)) {
            return Err(Malformed::Position(index));
        }
        let quaternion = Quaternion::from(self.orientation);
        let norm = quaternion.norm();
        // A NaN is in no range.
        if !(1.0 - UNIT..=1.0 + UNIT).contains(&norm) {
            return Err(Malformed::Orientation);
        }
        let rotation = UnitQuaternion::new_unchecked(quaternion / norm);
        Ok(Pose::from_parts(Vector3::from(self.position).into(), rotation))
    }
}

/// What is wrong with a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Malformed {
    /// A coordinate, from 0, is a NaN, infinite or absurdly large.
    Position(usize),
    /// The quaternion is not of length 1.
    Orientation,
}

/// Whether a number can be a position.
pub fn is_position(value: f64) -> bool {
    value.abs() <= LARGEST
}

/// A `state_command`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StateCommand {
    /// Power on.
    Enable,
    /// Power off.
    Disable,
    /// Find the zero of every joint.
    Home,
    /// Forget that they were found.
    Unhome,
    /// Stop and take no commands.
    Pause,
    /// Go on after a pause.
    Resume,
    /// A word that is none of these.
    Unknown(String),
}

impl StateCommand {
    /// The command of a word, as `state_command` has it.
    pub fn of(word: &str) -> Self {
        match word {
            "enable" => Self::Enable,
            "disable" => Self::Disable,
            "home" => Self::Home,
            "unhome" => Self::Unhome,
            "pause" => Self::Pause,
            "resume" => Self::Resume,
            _ => Self::Unknown(word.into()),
        }
    }

    /// Its word.
    pub fn word(&self) -> &str {
        match self {
            Self::Enable => "enable",
            Self::Disable => "disable",
            Self::Home => "home",
            Self::Unhome => "unhome",
            Self::Pause => "pause",
            Self::Resume => "resume",
            Self::Unknown(word) => word,
        }
    }
}

/// What needs dynamics of joints, which this controller has not: it says so and does nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effort {
    /// Torques of joints.
    ServoJf,
    /// Torque of the jaw.
    JawServoJf,
    /// A wrench at the end of the arm.
    SpatialServoCf,
    /// The same in its axes.
    BodyServoCf,
    /// How the wrench turns with it.
    BodySetCfOrientationAbsolute,
    /// Torques that hold the arm's weight.
    UseGravityCompensation,
    /// Pose, twist and wrench together.
    ServoCs,
    /// Stiffness.
    ServoCi,
}

/// A command to one arm.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Changes the operating state.
    State(StateCommand),
    /// Stops where the set-point is.
    Hold,
    /// Stops, with no effort.
    Free,
    /// Joints to be at in the next tick; velocities are those of the set-point, or none.
    ServoJp {
        /// Position of each joint.
        position: Vec<f64>,
        /// Velocity of each joint, or nothing.
        velocity: Vec<f64>,
    },
    /// As [`Self::ServoJp`], from the set-point.
    ServoJr(Vec<f64>),
    /// Velocities of joints, for 0.1 s at most. CRTK has this, dVRK has not.
    ServoJv(Vec<f64>),
    /// A pose to be at in the next tick.
    ServoCp(PoseMessage),
    /// As [`Self::ServoCp`], from the set-point: a step and a turn in the axes of the reference frame. CRTK has this,
    /// dVRK has not.
    ServoCr(PoseMessage),
    /// A twist in the axes of the reference frame, m/s and rad/s, for as long as [`Self::ServoJv`]. CRTK has this,
    /// dVRK has not.
    ServoCv([f64; 6]),
    /// Joints to move to.
    MoveJp(Vec<f64>),
    /// As [`Self::MoveJp`], from the goal of the present move, else from the set-point.
    MoveJr(Vec<f64>),
    /// A pose to move to, not on a straight line.
    MoveCp(PoseMessage),
    /// As [`Self::MoveCp`], from the goal of the present move, else from the set-point: a step and a turn in the axes
    /// of the reference frame. CRTK has this, dVRK has not.
    MoveCr(PoseMessage),
    /// Jaw angle to be at in the next tick, rad: one number.
    JawServoJp(Vec<f64>),
    /// Jaw angle to move to, rad: one number.
    JawMoveJp(Vec<f64>),
    /// What needs dynamics of joints.
    Effort(Effort),
    /// Scales velocities and accelerations of moves, in ]0, 1].
    SetRatio(f64),
    /// Scales velocities of moves, in ]0, 1].
    SetRatioV(f64),
    /// Scales accelerations of moves, in ]0, 1].
    SetRatioA(f64),
    /// Where the remote centre is in the reference frame, whose name is that of the message.
    SetBaseFrame(PoseMessage),
    /// Whether there is a sterile adapter.
    EmulateAdapterPresent(bool),
    /// Whether there is a tool.
    EmulateToolPresent(bool),
    /// Which tool it is, `NAME:MODEL[VERSION]`.
    SetToolType(String),
    /// Which endoscope it is: the arm's kinematics follow what is said, whatever there is.
    SetEndoscopeType(String),
    /// Lets something go wrong with the arm, as a [`Fault`] has it. Trocar has this, no real arm has.
    EmulateFault(Fault),
}

/// What can go wrong with an arm, for scripts to be tried with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// Nothing any more: a jaw that was stuck moves again.
    None,
    /// The arm faults and loses its power.
    Fault,
    /// The zeros of all joints are lost.
    LostHoming,
    /// The jaw stays where it is, whatever it is told.
    StuckJaw,
    /// A word that is none of these.
    Unknown(String),
}

impl Fault {
    /// All that there are.
    pub const ALL: [Self; 4] = [Self::None, Self::Fault, Self::LostHoming, Self::StuckJaw];

    /// The fault of a word.
    pub fn of(word: &str) -> Self {
        let known = Self::ALL.into_iter().find(|fault| fault.word() == word);
        known.unwrap_or_else(|| Self::Unknown(word.into()))
    }

    /// Its word.
    pub fn word(&self) -> &str {
        match self {
            Self::None => "none",
            Self::Fault => "fault",
            Self::LostHoming => "lost_homing",
            Self::StuckJaw => "stuck_jaw",
            Self::Unknown(word) => word,
        }
    }
}

impl Command {
    /// `servo_jp` without velocities.
    pub fn servo_jp(position: &[f64]) -> Self {
        Self::ServoJp { position: position.to_vec(), velocity: vec![] }
    }

    /// What `jaw.close()` of dVRK's Python client sends.
    pub fn jaw_close() -> Self {
        Self::JawMoveJp(vec![JAW_CLOSE])
    }

    /// What `jaw.open(angle)` of dVRK's Python client sends.
    pub fn jaw_open(angle: f64) -> Self {
        Self::JawMoveJp(vec![angle])
    }

    /// The topic that it comes by, below the arm's name.
    pub fn topic(&self) -> &'static str {
        match self {
            Self::State(_) => "state_command",
            Self::Hold => "hold",
            Self::Free => "free",
            Self::ServoJp { .. } => "servo_jp",
            Self::ServoJr(_) => "servo_jr",
            Self::ServoJv(_) => "servo_jv",
            Self::ServoCp(_) => "servo_cp",
            Self::ServoCr(_) => "servo_cr",
            Self::ServoCv(_) => "servo_cv",
            Self::MoveJp(_) => "move_jp",
            Self::MoveJr(_) => "move_jr",
            Self::MoveCp(_) => "move_cp",
            Self::MoveCr(_) => "move_cr",
            Self::JawServoJp(_) => "jaw/servo_jp",
            Self::JawMoveJp(_) => "jaw/move_jp",
            Self::Effort(effort) => match effort {
                Effort::ServoJf => "servo_jf",
                Effort::JawServoJf => "jaw/servo_jf",
                Effort::SpatialServoCf => "spatial/servo_cf",
                Effort::BodyServoCf => "body/servo_cf",
                Effort::BodySetCfOrientationAbsolute => "body/set_cf_orientation_absolute",
                Effort::UseGravityCompensation => "use_gravity_compensation",
                Effort::ServoCs => "servo_cs",
                Effort::ServoCi => "servo_ci",
            },
            Self::SetRatio(_) => "trajectory_j/set_ratio",
            Self::SetRatioV(_) => "trajectory_j/set_ratio_v",
            Self::SetRatioA(_) => "trajectory_j/set_ratio_a",
            Self::SetBaseFrame(_) => "set_base_frame",
            Self::EmulateAdapterPresent(_) => "emulate_adapter_present",
            Self::EmulateToolPresent(_) => "emulate_tool_present",
            Self::SetToolType(_) => "set_tool_type",
            Self::EmulateFault(_) => "emulate_fault",
            Self::SetEndoscopeType(_) => "set_endoscope_type",
        }
    }
}
