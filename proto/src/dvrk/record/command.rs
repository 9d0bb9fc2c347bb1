//! Commands to arms, by their topics.

use bytemuck::{Pod, Zeroable};

use super::values::{Numbers, Text};
use crate::dvrk::command::{Command, Effort, Fault, PoseMessage, StateCommand};
use crate::error::{Code, Rejection};

/// A command to an arm.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct CommandRecord {
    /// The arm, by its place in [`LiveInfo::arms`](crate::dvrk::LiveInfo::arms).
    pub arm: u32,
    /// The place of its topic in [`TOPICS`].
    pub(super) topic: u32,
    pub(super) numbers: Numbers,
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
    pub(in crate::dvrk) fn content(&self) -> Result<(u32, [&[f64]; 2], String), Rejection> {
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
