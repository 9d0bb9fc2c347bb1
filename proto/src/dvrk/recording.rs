//! What led to the state of a live world, from which it comes again, bit by bit: a recording is these parts one after
//! another, the beginning first.
//!
//! The same seed, and the same commands at the same ticks, give the same bits.

use serde::{Deserialize, Serialize};

use super::command::Command;
use super::live::Homing;
use super::record::{CommandRecord, TOPICS};
use crate::error::{Code, Rejection};
use crate::part::{self, Kind};
use crate::spec::Options;

/// Most ticks of a recording: a day.
pub const MOST_TICKS: u64 = 24 * 3600 * super::TICKS_PER_SECOND;

/// A part of a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum LivePart {
    /// How the world began.
    Beginning(Beginning),
    /// What was done next.
    Stretch(Stretch),
}

/// How a live world began.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Beginning {
    /// Release that wrote it.
    pub version: String,
    /// Task id.
    pub task: String,
    /// Options of the task.
    pub options: Options,
    /// Seed of the episode, the first one of that seed.
    pub seed: u64,
    /// What its arms do when they are homed.
    pub homing: Homing,
}

/// What was done in a live world for a while.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stretch {
    /// Which stretch it is, from 0. Where there was one of that number already, the world was brought back to an earlier
    /// state: that one and those after it did not lead here.
    pub number: u64,
    /// Commands in the order in which they were given.
    pub commands: Vec<Given>,
    /// Ticks that passed.
    pub ticks: u64,
    /// Stands for every bit of the state that must come of it.
    pub fingerprint: u64,
}

/// A command, and when it was given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Given {
    /// Ticks since the beginning of the stretch.
    pub tick: u64,
    /// The arm, by its place in [`LiveInfo::arms`](super::LiveInfo::arms).
    pub arm: u32,
    topic: u32,
    numbers: [Vec<f64>; 2],
    text: String,
}

impl Given {
    /// A command that was given to an arm at a tick.
    pub fn new(tick: u64, record: &CommandRecord) -> Result<Self, Rejection> {
        let (topic, numbers, text) = record.content()?;
        Ok(Self { tick, arm: record.arm, topic, numbers: numbers.map(<[f64]>::to_vec), text })
    }

    /// The command.
    pub fn command(&self) -> Result<Command, Rejection> {
        let Some(topic) = TOPICS.get(self.topic as usize) else {
            let allowed = format!("allowed are numbers below {}", TOPICS.len());
            return Err(Rejection::new(Code::InvalidSnapshot, "topic", self.topic, allowed));
        };
        let [first, second] = &self.numbers;
        Command::of(topic, first, second, &self.text)
    }

    /// About how many bytes it takes.
    pub fn bytes(&self) -> usize {
        let [first, second] = &self.numbers;
        8 * (first.len() + second.len()) + self.text.len() + 16
    }
}

impl LivePart {
    /// The part as bytes.
    pub fn to_bytes(&self) -> Result<Vec<u8>, Rejection> {
        part::seal(Kind::Live, self, || match self {
            Self::Beginning(_) => "the options".into(),
            Self::Stretch(stretch) => format!("{} commands", stretch.commands.len()),
        })
    }

    /// Reads what [`Self::to_bytes`] wrote; `bytes` may be anything.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        part::open(Kind::Live, bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dvrk::{PoseMessage, StateCommand};

    #[test]
    fn commands_survive_as_bytes() {
        let pose = PoseMessage {
            frame: "world".into(),
            position: [0.5; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let commands = [
            Command::State(StateCommand::Home),
            Command::ServoJp { position: vec![0.1; 6], velocity: vec![f64::NAN; 6] },
            Command::MoveCp(pose),
            Command::JawMoveJp(vec![]),
        ];
        let given: Vec<_> = commands
            .iter()
            .zip(3..)
            .map(|(command, tick)| {
                Given::new(tick, &CommandRecord::new(1, command).unwrap()).unwrap()
            })
            .collect();
        let stretch = Stretch { number: 7, commands: given, ticks: 240, fingerprint: 9 };
        let bytes = LivePart::Stretch(stretch).to_bytes().unwrap();
        let LivePart::Stretch(read) = LivePart::from_bytes(&bytes).unwrap() else { panic!() };
        assert_eq!((read.number, read.ticks, read.fingerprint), (7, 240, 9));
        for ((given, command), tick) in read.commands.iter().zip(&commands).zip(3..) {
            assert_eq!((given.tick, given.arm), (tick, 1));
            assert_eq!(format!("{:?}", given.command().unwrap()), format!("{command:?}"));
        }
    }

    #[test]
    fn snapshots_are_no_recordings_of_live_worlds() {
        let beginning = Beginning {
            version: "1".into(),
            task: "Test-v0".into(),
            options: Options::new(),
            seed: 3,
            homing: Homing::InPlace,
        };
        let bytes = LivePart::Beginning(beginning).to_bytes().unwrap();
        assert_eq!(crate::part::Kind::of(&bytes), Some(Kind::Live));
        let refusal = crate::snapshot::Recipe::from_bytes(&bytes).unwrap_err();
        assert_eq!(refusal.field, "snapshot.magic");
        assert!(LivePart::from_bytes(&bytes[..bytes.len() - 1]).is_err());
    }
}
