//! Commands, events and states as fixed-size records, so that a message is a copy.
//!
//! What a client wrote may be anything: [`CommandRecord::command`] and [`QuestionRecord`]'s methods check what they read.

use bytemuck::{Pod, Zeroable};

use super::command::{Command, Effort, Fault, PoseMessage, StateCommand};
use super::report::{Event, Report};
use super::state::{OperatingState, State};
use crate::error::{Code, Rejection};

/// Most axes of an arm: six joints and the jaw.
pub const MAX_AXES: usize = 7;

/// Most numbers of a command: positions and velocities of a few more axes than there are, so that a wrong count is
/// told by the arm.
pub const MAX_NUMBERS: usize = 24;

/// Most numbers of an answer: a Jacobian has 36.
pub const MAX_ANSWER: usize = 48;

/// Most bytes of a text.
const MAX_TEXT: usize = 256;

/// A short text.
#[derive(Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Text {
    bytes: [u8; MAX_TEXT],
    length: u32,
    reserved: u32,
}

const _: () = assert!(size_of::<Text>() == 264);

impl Text {
    /// Most bytes of one.
    pub const MOST: usize = MAX_TEXT;

    /// As much of a text as there is room for.
    pub fn new(text: &str) -> Self {
        let end = (0..=text.len().min(Self::MOST)).rev().find(|end| text.is_char_boundary(*end));
        let kept = &text.as_bytes()[..end.unwrap_or(0)];
        let mut bytes = [0; Self::MOST];
        bytes[..kept.len()].copy_from_slice(kept);
        Self { bytes, length: kept.len() as u32, reserved: 0 }
    }

    /// The text; what is no UTF-8 reads `�`.
    pub fn read(&self) -> String {
        String::from_utf8_lossy(&self.bytes[..(self.length as usize).min(Self::MOST)]).into_owned()
    }
}

impl std::fmt::Debug for Text {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.read())
    }
}

/// Up to [`MAX_NUMBERS`] numbers in two groups, one behind the other.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Numbers {
    values: [f64; MAX_NUMBERS],
    counts: [u32; 2],
}

impl Numbers {
    /// The numbers of a `field`, unless they are too many.
    pub fn new(field: &str, groups: [&[f64]; 2]) -> Result<Self, Rejection> {
        let [first, second] = groups;
        let count = first.len() + second.len();
        if count > MAX_NUMBERS {
            return Err(too_many(field, count));
        }
        let mut values = [0.0; MAX_NUMBERS];
        values[..first.len()].copy_from_slice(first);
        values[first.len()..count].copy_from_slice(second);
        Ok(Self { values, counts: groups.map(|group| group.len() as u32) })
    }

    /// Both groups, unless they are too many.
    pub fn read(&self, field: &str) -> Result<[&[f64]; 2], Rejection> {
        let [first, second] = self.counts.map(|count| count as usize);
        if first.saturating_add(second) > MAX_NUMBERS {
            return Err(too_many(field, first.saturating_add(second)));
        }
        let (first, rest) = self.values.split_at(first);
        Ok([first, &rest[..second]])
    }
}

fn too_many(field: &str, count: usize) -> Rejection {
    let allowed = format!("at most {MAX_NUMBERS}");
    Rejection::new(Code::InvalidCommand, field, format!("{count} numbers"), allowed)
}

/// A command to an arm.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct CommandRecord {
    /// The arm, by its place in [`LiveInfo::arms`](super::LiveInfo::arms).
    pub arm: u32,
    /// The place of its topic in [`TOPICS`].
    topic: u32,
    numbers: Numbers,
    text: Text,
}

const _: () = assert!(size_of::<CommandRecord>() == 472);

/// The topics of commands; a command is sent as its topic's place here, so new ones come last.
pub const TOPICS: [&str; 32] = [
    "state_command",
    "hold",
    "free",
    "servo_jp",
    "servo_jr",
    "servo_jv",
    "servo_cp",
    "servo_cr",
    "servo_cv",
    "move_jp",
    "move_jr",
    "move_cp",
    "move_cr",
    "jaw/servo_jp",
    "jaw/move_jp",
    "servo_jf",
    "jaw/servo_jf",
    "spatial/servo_cf",
    "body/servo_cf",
    "body/set_cf_orientation_absolute",
    "use_gravity_compensation",
    "servo_cs",
    "servo_ci",
    "trajectory_j/set_ratio",
    "trajectory_j/set_ratio_v",
    "trajectory_j/set_ratio_a",
    "set_base_frame",
    "emulate_adapter_present",
    "emulate_tool_present",
    "set_tool_type",
    "set_endoscope_type",
    "emulate_fault",
];

impl CommandRecord {
    /// A command to the arm of this place.
    pub fn new(arm: u32, command: &Command) -> Result<Self, Rejection> {
        let topic = command.topic();
        let place = TOPICS.iter().position(|known| *known == topic);
        let place = place.expect("every command has a topic that is listed");
        let flag = |is: &bool| [f64::from(*is)];
        let (mut text, flags, pose);
        text = "";
        let numbers: [&[f64]; 2] = match command {
            Command::State(state) => {
                text = state.word();
                [&[], &[]]
            }
            Command::Hold | Command::Free | Command::Effort(_) => [&[], &[]],
            Command::ServoJp { position, velocity } => [position, velocity],
            Command::ServoJr(numbers)
            | Command::ServoJv(numbers)
            | Command::MoveJp(numbers)
            | Command::MoveJr(numbers)
            | Command::JawServoJp(numbers)
            | Command::JawMoveJp(numbers) => [numbers, &[]],
            Command::ServoCp(message)
            | Command::ServoCr(message)
            | Command::MoveCp(message)
            | Command::MoveCr(message)
            | Command::SetBaseFrame(message) => {
                text = &message.frame;
                pose = message;
                [&pose.position, &pose.orientation]
            }
            Command::ServoCv(twist) => [twist, &[]],
            Command::SetRatio(ratio) | Command::SetRatioV(ratio) | Command::SetRatioA(ratio) => {
                [std::slice::from_ref(ratio), &[]]
            }
            Command::EmulateAdapterPresent(is) | Command::EmulateToolPresent(is) => {
                flags = flag(is);
                [&flags, &[]]
            }
            Command::SetToolType(name) | Command::SetEndoscopeType(name) => {
                text = name;
                [&[], &[]]
            }
            Command::EmulateFault(fault) => {
                text = fault.word();
                [&[], &[]]
            }
        };
        if text.len() > Text::MOST {
            let (found, allowed) = (text.len(), format!("at most {} bytes", Text::MOST));
            let found = format!("a text of {found} bytes");
            return Err(Rejection::new(Code::InvalidCommand, topic, found, allowed));
        }
        let numbers = Numbers::new(topic, numbers)?;
        Ok(Self { arm, topic: place as u32, numbers, text: Text::new(text) })
    }

    /// The command.
    pub fn command(&self) -> Result<Command, Rejection> {
        let (topic, [first, second], text) = self.content()?;
        Command::of(TOPICS[topic as usize], first, second, &text)
    }

    /// The place of its topic in [`TOPICS`], its numbers and its text.
    pub(super) fn content(&self) -> Result<(u32, [&[f64]; 2], String), Rejection> {
        let Some(topic) = TOPICS.get(self.topic as usize) else {
            let allowed = format!("allowed are numbers below {}", TOPICS.len());
            return Err(Rejection::new(Code::InvalidCommand, "topic", self.topic, allowed));
        };
        Ok((self.topic, self.numbers.read(topic)?, self.text.read()))
    }
}

impl Command {
    /// The command of a topic, with what its message holds: numbers (of poses: position, and the quaternion x, y, z, w
    /// behind it; truth values: 0 or not), further numbers (velocities of `servo_jp`), a text (a word, a name, the
    /// frame of a pose). Numbers of joints may be of any count, which the arm checks.
    pub fn of(topic: &str, first: &[f64], second: &[f64], text: &str) -> Result<Self, Rejection> {
        let refuse = |expected: &str| {
            let found = format!("{} numbers", first.len() + second.len());
            Rejection::new(Code::InvalidCommand, topic, found, format!("expected {expected}"))
        };
        let pose = || {
            let all: Vec<f64> = first.iter().chain(second).copied().collect();
            let [x, y, z, orientation @ ..] = all.as_slice() else { return Err(refuse(POSE)) };
            let orientation = <[f64; 4]>::try_from(orientation).map_err(|_| refuse(POSE))?;
            Ok(PoseMessage { frame: text.into(), position: [*x, *y, *z], orientation })
        };
        let one = || match first {
            [one] if second.is_empty() => Ok(*one),
            _ => Err(refuse("1")),
        };
        let numbers = || first.to_vec();
        Ok(match topic {
            "state_command" => Self::State(StateCommand::of(text)),
            "hold" => Self::Hold,
            "free" => Self::Free,
            "servo_jp" => Self::ServoJp { position: numbers(), velocity: second.to_vec() },
            "servo_jr" => Self::ServoJr(numbers()),
            "servo_jv" => Self::ServoJv(numbers()),
            "servo_cp" => Self::ServoCp(pose()?),
            "servo_cr" => Self::ServoCr(pose()?),
            "servo_cv" => Self::ServoCv(first.try_into().map_err(|_| refuse("6"))?),
            "move_jp" => Self::MoveJp(numbers()),
            "move_jr" => Self::MoveJr(numbers()),
            "move_cp" => Self::MoveCp(pose()?),
            "move_cr" => Self::MoveCr(pose()?),
            "jaw/servo_jp" => Self::JawServoJp(numbers()),
            "jaw/move_jp" => Self::JawMoveJp(numbers()),
            "servo_jf" => Self::Effort(Effort::ServoJf),
            "jaw/servo_jf" => Self::Effort(Effort::JawServoJf),
            "spatial/servo_cf" => Self::Effort(Effort::SpatialServoCf),
            "body/servo_cf" => Self::Effort(Effort::BodyServoCf),
            "body/set_cf_orientation_absolute" => {
                Self::Effort(Effort::BodySetCfOrientationAbsolute)
            }
            "use_gravity_compensation" => Self::Effort(Effort::UseGravityCompensation),
            "servo_cs" => Self::Effort(Effort::ServoCs),
            "servo_ci" => Self::Effort(Effort::ServoCi),
            "trajectory_j/set_ratio" => Self::SetRatio(one()?),
            "trajectory_j/set_ratio_v" => Self::SetRatioV(one()?),
            "trajectory_j/set_ratio_a" => Self::SetRatioA(one()?),
            "set_base_frame" => Self::SetBaseFrame(pose()?),
            "emulate_adapter_present" => Self::EmulateAdapterPresent(one()? != 0.0),
            "emulate_tool_present" => Self::EmulateToolPresent(one()? != 0.0),
            "set_tool_type" => Self::SetToolType(text.into()),
            "set_endoscope_type" => Self::SetEndoscopeType(text.into()),
            "emulate_fault" => Self::EmulateFault(Fault::of(text)),
            _ => {
                let allowed = format!("allowed are {}", TOPICS.join(", "));
                return Err(Rejection::new(Code::InvalidCommand, "topic", topic, allowed));
            }
        })
    }
}

const POSE: &str = "7: x, y, z, and x, y, z, w of a unit quaternion";

/// What can be asked of an arm's kinematics; the number is the wire format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Question {
    /// The frame along the chain that these joints lead to, in the reference frame: a pose.
    ForwardKinematics = 0,
    /// The same in the base frame.
    LocalForwardKinematics = 1,
    /// Joints for a pose in the base frame (first group) near to others (second group).
    InverseKinematics = 2,
    /// Joints that turns of motors lead to.
    ActuatorToJointPosition = 3,
    /// The Jacobian in the axes of the end: 6 rows, row by row.
    BodyJacobian = 4,
    /// The Jacobian of the point at the remote centre.
    SpatialJacobian = 5,
    /// Where this arm's numbers of a task's action ask it to be, from where it is: of a PSM a pose in the reference frame
    /// and the jaw angle, of the ECM joints.
    TaskSetPoint = 6,
    /// This arm's numbers of the action that brings a PSM from one pose and jaw angle (first group) to others, or as near
    /// as one action can.
    TaskAction = 7,
}

impl Question {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::ForwardKinematics,
        Self::LocalForwardKinematics,
        Self::InverseKinematics,
        Self::ActuatorToJointPosition,
        Self::BodyJacobian,
        Self::SpatialJacobian,
        Self::TaskSetPoint,
        Self::TaskAction,
    ];
}

/// A question about an arm.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct QuestionRecord {
    /// The arm, by its place.
    pub arm: u32,
    which: u32,
    /// Joints, or a pose and joints.
    pub numbers: Numbers,
}

impl QuestionRecord {
    /// A question about the arm of this place.
    pub fn new(arm: u32, which: Question, groups: [&[f64]; 2]) -> Result<Self, Rejection> {
        Ok(Self { arm, which: which as u32, numbers: Numbers::new("joints", groups)? })
    }

    /// Which question it is.
    pub fn which(&self) -> Result<Question, Rejection> {
        let found = Question::ALL.into_iter().find(|known| *known as u32 == self.which);
        found.ok_or_else(|| {
            let allowed = format!("allowed are numbers below {}", Question::ALL.len());
            Rejection::new(Code::InvalidCommand, "question", self.which, allowed)
        })
    }
}

/// The answer: numbers, or why there are none.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct AnswerRecord {
    values: [f64; MAX_ANSWER],
    count: u32,
    is_answer: u32,
    text: Text,
}

impl AnswerRecord {
    /// An answer of at most [`MAX_ANSWER`] numbers, or why there is none.
    pub fn new(answer: Result<&[f64], &str>) -> Self {
        let mut record = Self::zeroed();
        match answer {
            Ok(numbers) => {
                record.values[..numbers.len()].copy_from_slice(numbers);
                (record.count, record.is_answer) = (numbers.len() as u32, 1);
            }
            Err(why) => record.text = Text::new(why),
        }
        record
    }

    /// The numbers, or why there are none.
    pub fn read(&self) -> Result<&[f64], String> {
        let count = (self.count as usize).min(MAX_ANSWER);
        if self.is_answer == 0 { Err(self.text.read()) } else { Ok(&self.values[..count]) }
    }
}

/// What can be read of an arm. All of one tick has the same stamp.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ArmRecord {
    /// When it was, ns since the world began.
    pub stamp: u64,
    /// The operating state, as a number.
    pub(crate) state: StateWord,
    /// Whether it has a tool: without one, there is nothing Cartesian, and the joints are raw ones.
    pub has_tool: u32,
    /// The process that drives it, 0 if none does.
    pub driver: u32,
    /// Reserved.
    pub reserved: u32,
    /// `measured_js`: rad; index 2 in m. The jaw is behind the joints.
    pub measured_position: [f64; MAX_AXES],
    /// Velocities of the same.
    pub measured_velocity: [f64; MAX_AXES],
    /// `setpoint_js`.
    pub setpoint_position: [f64; MAX_AXES],
    /// Velocities of the same.
    pub setpoint_velocity: [f64; MAX_AXES],
    /// `local/measured_cp`: x, y, z, m; x, y, z, w of a unit quaternion.
    pub local_measured_cp: [f64; 7],
    /// `local/setpoint_cp`.
    pub local_setpoint_cp: [f64; 7],
    /// `measured_cp`.
    pub measured_cp: [f64; 7],
    /// `setpoint_cp`.
    pub setpoint_cp: [f64; 7],
    /// `measured_cv`: m/s, rad/s.
    pub measured_cv: [f64; 6],
    /// The ratio of velocities and accelerations of moves; 0 where they differ.
    pub ratio: f64,
    /// Where the remote centre is in the reference frame.
    pub base_frame: [f64; 7],
    /// Name of the reference frame.
    pub reference_frame: Text,
}

const _: () = assert!(size_of::<ArmRecord>() == 24 + 8 * (4 * 7 + 4 * 7 + 6 + 1 + 7) + 264);

impl ArmRecord {
    /// The record of an arm in this operating state, everything else zero.
    pub fn in_state(state: OperatingState) -> Self {
        Self { state: StateWord::new(state), ..Self::zeroed() }
    }

    /// The operating state.
    pub fn operating_state(&self) -> OperatingState {
        self.state.read()
    }
}

/// An operating state as a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(transparent)]
pub(crate) struct StateWord(u32);

const STATES: [State; 4] = [State::Disabled, State::Enabled, State::Paused, State::Fault];
const IS_HOMED: u32 = 4;
const IS_BUSY: u32 = 8;

impl StateWord {
    fn new(state: OperatingState) -> Self {
        let place = STATES.iter().position(|known| *known == state.state).unwrap_or_default();
        let bit = |is: bool, bit: u32| if is { bit } else { 0 };
        Self(place as u32 | bit(state.is_homed, IS_HOMED) | bit(state.is_busy, IS_BUSY))
    }

    fn read(self) -> OperatingState {
        OperatingState {
            state: STATES[(self.0 % 4) as usize],
            is_homed: self.0 & IS_HOMED != 0,
            is_busy: self.0 & IS_BUSY != 0,
        }
    }
}

/// An event of an arm.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct EventRecord {
    stamp: u64,
    value: f64,
    arm: u32,
    kind: u32,
    state: StateWord,
    reserved: u32,
    text: Text,
}

const _: () = assert!(size_of::<EventRecord>() == 296);

impl EventRecord {
    /// An event as a record; long texts are cut.
    pub fn new(event: &Event) -> Self {
        let mut record = Self { stamp: event.stamp, arm: event.arm, ..Self::zeroed() };
        let (kind, text) = match &event.report {
            Report::OperatingState(state) => {
                record.state = StateWord::new(*state);
                (1, "")
            }
            Report::GoalReached(is) => {
                record.value = f64::from(*is);
                (2, "")
            }
            Report::Ratio(ratio) => {
                record.value = *ratio;
                (3, "")
            }
            Report::RatioV(ratio) => {
                record.value = *ratio;
                (4, "")
            }
            Report::RatioA(ratio) => {
                record.value = *ratio;
                (5, "")
            }
            Report::ToolType(name) => (6, name.as_str()),
            Report::EndoscopeType(name) => (7, name.as_str()),
            Report::Warning(why) => (8, why.as_str()),
            Report::Error(why) => (9, why.as_str()),
        };
        record.kind = kind;
        record.text = Text::new(text);
        record
    }

    /// The event, if it is one.
    pub fn event(&self) -> Option<Event> {
        let (value, text) = (self.value, || self.text.read());
        let report = match self.kind {
            1 => Report::OperatingState(self.state.read()),
            2 => Report::GoalReached(value != 0.0),
            3 => Report::Ratio(value),
            4 => Report::RatioV(value),
            5 => Report::RatioA(value),
            6 => Report::ToolType(text()),
            7 => Report::EndoscopeType(text()),
            8 => Report::Warning(text()),
            9 => Report::Error(text()),
            _ => return None,
        };
        Some(Event { arm: self.arm, stamp: self.stamp, report })
    }
}

/// A live world after a message.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct WorldRecord {
    /// Ticks that have passed since the world began.
    pub ticks: u64,
    /// Events that this client came too late for.
    pub lost_events: u64,
    /// Ticks that passed with this message.
    pub passed: u32,
    /// Events in this reply.
    pub events: u32,
    /// 1 where there are more events than there was room for: the next reply has them.
    pub has_more: u32,
    /// Steps of the task that have passed.
    pub steps: u32,
    /// What the present state is worth.
    pub reward: f32,
    /// 1 where the goal is reached now.
    pub is_success: u32,
    /// 1 where the state is terminal.
    pub terminated: u32,
    /// Ticks that a paced world is behind its pace: the server had no time for them.
    pub late: u32,
}

const _: () = assert!(size_of::<WorldRecord>() == 48);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_survive_the_wire() {
        let pose = PoseMessage {
            frame: "PSM1_base".into(),
            position: [0.1, f64::INFINITY, 0.3],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let mut commands = vec![
            Command::ServoJp { position: vec![1.0; 8], velocity: vec![2.0; 6] },
            Command::ServoCv([1.0; 6]),
            Command::JawMoveJp(vec![]),
            Command::State(StateCommand::Unknown("dance".into())),
            Command::SetToolType("LARGE_NEEDLE_DRIVER:400006".into()),
            Command::EmulateFault(Fault::StuckJaw),
            Command::EmulateToolPresent(false),
            Command::SetRatio(0.5),
            Command::MoveCp(pose),
        ];
        // Every topic has a command, which goes by its place.
        for topic in TOPICS {
            let few = [1.0; 7];
            let found = [0, 1, 6, 7].into_iter().find_map(|count| {
                Command::of(topic, &few[..count], &[], "a").ok().filter(|c| c.topic() == topic)
            });
            commands.push(found.expect(topic));
        }
        for command in &commands {
            let record = CommandRecord::new(2, command).unwrap();
            assert_eq!(record.command().as_ref(), Ok(command));
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_by_name() {
        let refusal = CommandRecord::new(0, &Command::MoveJp(vec![0.0; 100])).unwrap_err();
        assert_eq!(refusal.to_string(), "move_jp = 100 numbers: at most 24");
        let refusal = CommandRecord::new(0, &Command::SetToolType("x".repeat(257))).unwrap_err();
        assert_eq!(refusal.field, "set_tool_type");
        let refusal = Command::of("move_cp", &[0.0; 5], &[], "").unwrap_err();
        assert_eq!(refusal.field, "move_cp");
        let refusal = Command::of("dance", &[], &[], "").unwrap_err();
        assert!(refusal.allowed.contains("servo_jp"), "{refusal}");
        // Nor does what a client writes by itself harm.
        let mut record = CommandRecord::new(0, &Command::Hold).unwrap();
        record.topic = 32;
        assert_eq!(record.command().unwrap_err().code, Code::InvalidCommand);
        record.topic = 3;
        record.numbers.counts = [u32::MAX; 2];
        assert_eq!(record.command().unwrap_err().code, Code::InvalidCommand);
    }

    #[test]
    fn texts_are_cut_between_characters() {
        assert_eq!(Text::new("é").read(), "é");
        assert_eq!(Text::new(&"é".repeat(200)).read(), "é".repeat(128));
    }

    #[test]
    fn events_survive_the_wire() {
        let state = OperatingState { state: State::Fault, is_homed: true, is_busy: false };
        for report in [
            Report::OperatingState(state),
            Report::GoalReached(true),
            Report::Ratio(0.5),
            Report::RatioV(0.25),
            Report::RatioA(1.0),
            Report::ToolType("a".into()),
            Report::EndoscopeType("b".into()),
            Report::Warning("c".into()),
            Report::Error("d".into()),
        ] {
            let event = Event { arm: 1, stamp: 7, report };
            assert_eq!(EventRecord::new(&event).event(), Some(event));
        }
        assert_eq!(EventRecord::zeroed().event(), None);
        assert_eq!(ArmRecord::in_state(state).operating_state(), state);
    }
}
