//! What led to the present state of a live world: kept while it is driven, and played again.

use std::sync::Arc;

use trocar_proto::dvrk::record::CommandRecord;
use trocar_proto::dvrk::recording::{Beginning, Given, LivePart, MOST_TICKS, Stretch};
use trocar_proto::{Code, Rejection};

use crate::env::LiveWorld;
use crate::registry::Registry;

/// Longest that commands wait for their stretch to end, ticks: a second.
const LONGEST: u64 = 240;

/// Commands that end a stretch, bytes: several stretches fit into a message.
const MOST_OPEN: usize = 16 << 10;

/// Most bytes that a world keeps: some 17 minutes of two arms that are servoed at 500 Hz.
const MOST_KEPT: usize = 64 << 20;

/// What led to the present state of a live world. A clone belongs to a clone of the world.
#[derive(Debug, Clone)]
pub(crate) struct LiveLog {
    /// The beginning, then the stretches.
    parts: Vec<Arc<[u8]>>,
    bytes: usize,
    /// Commands of the stretch that is not over.
    open: Vec<Given>,
    open_bytes: usize,
    /// Ticks of that stretch.
    ticks: u64,
    /// Ticks of all stretches.
    age: u64,
    is_given_up: bool,
}

impl LiveLog {
    /// That of a world which begins so.
    pub(crate) fn new(beginning: Beginning) -> Result<Self, Rejection> {
        let part = LivePart::Beginning(beginning).to_bytes()?;
        let (bytes, parts) = (part.len(), vec![part.into()]);
        Ok(Self { parts, bytes, open: vec![], open_bytes: 0, ticks: 0, age: 0, is_given_up: false })
    }

    /// Takes note of a command that was given to an arm.
    pub(crate) fn give(&mut self, record: &CommandRecord, world: &LiveWorld) {
        if self.is_given_up {
            return;
        }
        if self.open_bytes > MOST_OPEN {
            self.close(world);
        }
        // What cannot be read was refused.
        if let Ok(given) = Given::new(self.ticks, record) {
            self.open_bytes += given.bytes();
            self.open.push(given);
        }
    }

    /// Takes note of a tick that has passed in the world.
    pub(crate) fn tick(&mut self, world: &LiveWorld) {
        self.ticks += 1;
        self.age += 1;
        if self.age > MOST_TICKS {
            self.give_up();
        }
        let first = self.open.first().map_or(self.ticks, |given| given.tick);
        if self.ticks - first >= LONGEST {
            self.close(world);
        }
    }

    /// Ends the stretch, if there is anything in it.
    pub(crate) fn close(&mut self, world: &LiveWorld) {
        if self.is_given_up || (self.open.is_empty() && self.ticks == 0) {
            return;
        }
        let stretch = Stretch {
            number: self.parts.len() as u64 - 1,
            commands: std::mem::take(&mut self.open),
            ticks: std::mem::take(&mut self.ticks),
            fingerprint: world.fingerprint(),
        };
        self.open_bytes = 0;
        match LivePart::Stretch(stretch).to_bytes() {
            Ok(part) if self.bytes + part.len() <= MOST_KEPT => {
                self.bytes += part.len();
                self.parts.push(part.into());
            }
            _ => self.give_up(),
        }
    }

    /// Forgets it all, and keeps nothing from now on.
    pub(crate) fn give_up(&mut self) {
        *self = Self { parts: vec![], bytes: 0, open: vec![], is_given_up: true, ..*self };
    }

    /// Whether there are commands in the stretch that is not over.
    pub(crate) fn has_commands(&self) -> bool {
        !self.open.is_empty()
    }

    /// Bytes that it takes.
    pub(crate) fn bytes(&self) -> usize {
        self.bytes
    }

    /// The parts of a recording, without the stretch that is not over.
    pub(crate) fn parts(&self) -> Result<&[Arc<[u8]>], Rejection> {
        if self.is_given_up {
            let allowed = "its recording was given up: it took more memory than a world or its client may, or more than a day";
            return Err(Rejection::new(Code::MemoryBudget, "recording", "given up", allowed));
        }
        Ok(&self.parts)
    }
}

/// What was done in a live world, from its beginning to the end of a recording.
#[derive(Debug, Clone)]
pub(super) struct LiveEpisode {
    pub(super) beginning: Beginning,
    stretches: Vec<Stretch>,
}

/// A refusal of what a recording says.
fn refuse(part: &str, value: u64, allowed: String) -> Rejection {
    Rejection::new(Code::InvalidSnapshot, format!("recording.{part}"), value, allowed)
}

impl LiveEpisode {
    pub(super) fn new(beginning: Beginning) -> Self {
        Self { beginning, stretches: vec![] }
    }

    /// Takes the next stretch. Later stretches of a number take the place of earlier ones, and of what followed these.
    pub(super) fn push(&mut self, stretch: Stretch) -> Result<(), Rejection> {
        let known = self.stretches.len();
        if stretch.number > known as u64 {
            return Err(refuse("number", stretch.number, format!("expected {known} at most")));
        }
        if let Some(given) = stretch.commands.iter().find(|given| given.tick > stretch.ticks) {
            return Err(refuse(
                "tick",
                given.tick,
                format!("the stretch has {} ticks", stretch.ticks),
            ));
        }
        self.stretches.truncate(stretch.number as usize);
        let before: u64 = self.stretches.iter().map(|stretch| stretch.ticks).sum();
        if before.saturating_add(stretch.ticks) > MOST_TICKS {
            return Err(refuse("ticks", stretch.ticks, format!("at most {MOST_TICKS} in all")));
        }
        self.stretches.push(stretch);
        Ok(())
    }

    /// How many states are compared.
    pub(super) fn marks(&self) -> usize {
        self.stretches.len()
    }
}

/// A live world that goes through what was done again.
#[derive(Clone)]
pub(super) struct LiveReplay {
    pub(super) world: LiveWorld,
    /// What is still to be done, the next stretch last.
    left: Vec<Stretch>,
    /// Ticks of the present stretch that have passed, and commands of it that were given.
    passed: u64,
    given: usize,
}

impl LiveReplay {
    /// The world at its beginning.
    pub(super) fn new(registry: &Registry, episode: LiveEpisode) -> Result<Self, Rejection> {
        let Beginning { version, task, options, seed, homing } = episode.beginning;
        if version != env!("CARGO_PKG_VERSION") {
            let allowed = format!("this is release {}", env!("CARGO_PKG_VERSION"));
            return Err(Rejection::new(
                Code::InvalidSnapshot,
                "recording.version",
                format!("{version:?}"),
                allowed,
            ));
        }
        let mut env = registry.make(&task, &options)?;
        env.reset(Some(seed));
        let mut left = episode.stretches;
        left.reverse();
        Ok(Self { world: LiveWorld::new(env, homing)?, left, passed: 0, given: 0 })
    }

    /// Whether all was done.
    pub(super) fn is_done(&self) -> bool {
        self.left.is_empty()
    }

    /// Gives the commands that are due, and lets a tick pass. Whether all states that were to be compared are the same;
    /// `None` where the simulation fails, which is then the end.
    pub(super) fn tick(&mut self) -> Result<Option<bool>, Rejection> {
        let mut is_same = self.catch_up()?;
        if let Some(stretch) = self.left.last() {
            debug_assert!(self.passed < stretch.ticks);
            if self.world.tick().is_err() {
                self.left.clear();
                return Ok(None);
            }
            self.passed += 1;
            is_same &= self.catch_up()?;
        }
        Ok(Some(is_same))
    }

    /// Gives the commands of the present tick, and leaves stretches behind that are over; whether these led where they
    /// should.
    fn catch_up(&mut self) -> Result<bool, Rejection> {
        let mut is_same = true;
        while let Some(stretch) = self.left.last() {
            while let Some(given) =
                stretch.commands.get(self.given).filter(|given| given.tick <= self.passed)
            {
                let arm = self.world.arms_mut().nth(given.arm as usize);
                let no_arm = || refuse("arm", given.arm.into(), "an arm of the task".into());
                let arm = arm.ok_or_else(no_arm)?;
                arm.command(&given.command()?);
                arm.take_events();
                self.given += 1;
            }
            if self.passed < stretch.ticks {
                break;
            }
            is_same &= self.world.fingerprint() == stretch.fingerprint;
            self.left.pop();
            (self.passed, self.given) = (0, 0);
        }
        Ok(is_same)
    }
}
