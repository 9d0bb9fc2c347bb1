//! How a session with a live world is opened.

use serde::{Deserialize, Serialize};

use crate::error::{Code, Rejection};

/// Fastest pace that may be asked for: beyond that, a world in lock-step is what is wanted.
pub const FASTEST: f64 = 1000.0;

/// Slowest pace.
pub const SLOWEST: f64 = 0.01;

/// What an arm does when it is homed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Homing {
    /// It moves all joints and the jaw to 0, and the insertion to 0.12 m, as dVRK's kinematic simulation does.
    #[default]
    ToZero,
    /// It stays, as a real PSM with a tool does.
    InPlace,
}

/// A live world instead of environments that are stepped: one environment, which begins with the first episode of the
/// session's seed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct LiveRequest {
    /// What its arms do when they are homed.
    pub homing: Homing,
    /// How many times as fast as life the server lets time pass; `None` where time passes by the ticks that clients
    /// ask for (lock-step).
    pub speed: Option<f64>,
    /// The session whose world this one shares; `None` for a world of its own. Task, options and speed must be those of
    /// that session. A shared world ends with the session that made it.
    pub world: Option<u64>,
    /// Whether a page of the viewer that may drive takes the arms over that this session drives, and gives them back.
    pub intervention: bool,
}

impl LiveRequest {
    /// Whether it may be asked for.
    pub fn check(&self) -> Result<(), Rejection> {
        match self.speed {
            // A NaN is in no range.
            Some(speed) if !(SLOWEST..=FASTEST).contains(&speed) => Err(Rejection::new(
                Code::InvalidOption,
                "live.speed",
                speed,
                format!("allowed is {SLOWEST} to {FASTEST} times real time, or none for lock-step"),
            )),
            _ => Ok(()),
        }
    }
}

/// A live world, as its clients see it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LiveInfo {
    /// Its arms; commands name them by their place here.
    pub arms: Vec<ArmInfo>,
    /// Names of the objects.
    pub objects: Vec<String>,
    /// How many times as fast as life its time passes; `None` in lock-step.
    pub speed: Option<f64>,
}

/// An arm of a live world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArmInfo {
    /// Its name: `PSM1`, `ECM`.
    pub name: String,
    /// Names of its joints.
    pub joints: Vec<String>,
    /// Names of what it has without a tool: joints, and the discs that would drive the tool.
    pub raw_joints: Vec<String>,
    /// Whether it has a jaw.
    pub has_jaw: bool,
    /// Where its remote centre is in the world: x, y, z, m; x, y, z, w of a unit quaternion.
    pub world_from_base: [f64; 7],
}

impl LiveInfo {
    /// The place of an arm among [`Self::arms`].
    pub fn arm(&self, name: &str) -> Result<u32, Rejection> {
        let place = self.arms.iter().position(|arm| arm.name == name);
        place.map(|place| place as u32).ok_or_else(|| {
            let known: Vec<&str> = self.arms.iter().map(|arm| arm.name.as_str()).collect();
            let allowed = format!("this world has {}", known.join(", "));
            Rejection::new(Code::UnknownArm, "arm", format!("{name:?}"), allowed)
        })
    }
}
