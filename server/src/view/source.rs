//! What can be watched, and the channel through which it is.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};

use serde::{Deserialize, Serialize};
use tokio::sync::Notify;
use trocar_proto::Stage;

use crate::env::Env;
use crate::render::Scene;
use crate::sim::world::Contact;

/// What has environments to watch: a server, or a recording.
pub trait Source: Send + Sync + 'static {
    /// What this is: a server, or recordings.
    fn about(&self) -> About;

    /// What can be watched now.
    fn sessions(&self) -> Vec<SessionCard>;

    /// Has moments of an environment put into `channel` until that is closed from either side. An error
    /// says why there is nothing to see.
    fn watch(&self, session: u64, env: u32, channel: &Arc<FrameChannel>) -> Result<(), String>;

    /// Has an arm of a live world do what a page wants; an error says why not.
    fn drive(&self, page: u64, wish: &Wish) -> Result<(), String> {
        let _ = (page, wish);
        Err("nothing here can be driven".into())
    }

    /// Has the arms hold that a page has driven.
    fn let_go(&self, page: u64) {
        let _ = page;
    }
}

/// What a page wants an arm of a live world to do.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wish {
    /// The session whose world it is.
    pub session: u64,
    /// The page's right to drive: part of its address.
    pub token: String,
    /// The arm's name.
    pub arm: String,
    /// What it is to do.
    pub motion: Motion,
}

/// What an arm can be made to do by hand.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// To be given power, and to be homed.
    Enable,
    /// To move its end like this for a tenth of a second: m/s and rad/s in the axes of the world.
    Twist([f64; 6]),
    /// To open its jaw this far, rad; below 0 it squeezes.
    Jaw(f64),
    /// To stay.
    Hold,
}

/// A source, as the page names it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct About {
    /// Its name.
    pub name: String,
    /// Its process.
    pub pid: u32,
    /// Its version.
    pub version: &'static str,
    /// It shows recordings: each is a session, each of its episodes an environment, shown from its beginning
    /// to its end at once.
    pub recording: bool,
}

/// A session, as the list shows it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SessionCard {
    /// Its number.
    pub id: u64,
    /// Its client's process; 0 for a recording.
    pub pid: u32,
    /// The language of its client, or the name of the recording.
    pub language: String,
    /// Its task.
    pub task: String,
    /// Its environments.
    pub envs: u32,
    /// Names of the arms that can be driven, of a live world.
    pub arms: Vec<String>,
    /// How many times as fast as life its live world is; none in lock-step, and where there is no live world.
    pub speed: Option<f64>,
    /// Steps of an episode at most.
    pub max_steps: u32,
    /// Simulated time of a step, s.
    pub seconds_per_step: f64,
    /// Steps of all its environments together in a second.
    pub steps_per_second: f64,
    /// Time of a message at the server, half of them, µs.
    pub p50_us: f64,
    /// The same, 99 of 100.
    pub p99_us: f64,
    /// Episodes that have ended.
    pub episodes: u64,
    /// Part of the latest of them, at most [`Tally::RECENT`], that ended in success; none for tasks without
    /// goals and before the first end.
    pub success_rate: Option<f64>,
}

/// Counts how episodes end.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    episodes: u64,
    recent: VecDeque<bool>,
}

impl Tally {
    /// How many of the latest episodes make the rate.
    pub const RECENT: usize = 100;

    /// An episode ended.
    pub fn ended(&mut self, is_success: bool) {
        self.episodes += 1;
        if self.recent.len() == Self::RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(is_success);
    }

    /// How many ended.
    pub fn episodes(&self) -> u64 {
        self.episodes
    }

    /// Part of the latest that ended in success; none before the first end.
    pub fn success_rate(&self) -> Option<f64> {
        let successes = self.recent.iter().filter(|success| **success).count();
        (!self.recent.is_empty()).then(|| successes as f64 / self.recent.len() as f64)
    }
}

/// An environment at one moment.
#[derive(Debug, Clone)]
pub struct Moment {
    /// What there is to see.
    pub scene: Scene,
    /// What touches what.
    pub contacts: Vec<Contact>,
    /// Seed of the episode.
    pub seed: u64,
    /// Number of the episode under its seed.
    pub episode: u64,
    /// Steps since it began.
    pub steps: u32,
    /// What the scripted expert would be about.
    pub stage: Stage,
    /// The steps since the moment before, in order; the latest of them where there were many.
    pub marks: Vec<Mark>,
}

impl Moment {
    /// An environment as it is, after the steps of `marks`.
    pub fn of(env: &Env, marks: Vec<Mark>) -> Self {
        Self {
            scene: env.scene(),
            contacts: env.world().contacts().collect(),
            seed: env.seed(),
            episode: env.episode(),
            steps: env.steps(),
            stage: env.stage(),
            marks,
        }
    }
}

/// What a step gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// It was a step; else an episode began, or a state was restored.
    pub is_step: bool,
    /// Its reward.
    pub reward: f32,
    /// The episode ended with it.
    pub ended: bool,
    /// The goal was reached.
    pub is_success: bool,
}

/// How moments follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pace {
    /// The present, a few dozen times a second at most.
    #[default]
    Live,
    /// Every step of an episode, then of another: to be played at the speed of life, however fast the
    /// simulation is.
    Episodes,
}

/// A place for moments between a session and a page. Neither waits for the other: where there is no room,
/// or the other is at it just then, a moment is not put there.
#[derive(Debug, Default)]
pub struct FrameChannel {
    pace: Pace,
    /// A moment (live), or an episode of them, is wanted.
    wanted: AtomicBool,
    closed: AtomicBool,
    moments: Mutex<VecDeque<Moment>>,
    changed: Notify,
}

impl FrameChannel {
    /// Most moments that wait to be taken.
    pub const ROOM: usize = 512;

    /// A channel in which nothing is wanted yet.
    pub fn new(pace: Pace) -> Arc<Self> {
        Arc::new(Self { pace, ..Self::default() })
    }

    /// How moments are to follow each other.
    pub fn pace(&self) -> Pace {
        self.pace
    }

    /// Says that one more moment is wanted, or one more episode.
    pub fn ask(&self) {
        self.wanted.store(true, Ordering::Release);
    }

    /// Whether that was said and not fulfilled yet.
    pub fn is_wanted(&self) -> bool {
        self.wanted.load(Ordering::Acquire)
    }

    /// What was wanted has been put there.
    pub fn fulfil(&self) {
        self.wanted.store(false, Ordering::Release);
    }

    /// Puts a moment there; false where it could not be.
    pub fn put(&self, moment: Moment) -> bool {
        let mut moments = match self.moments.try_lock() {
            Ok(moments) => moments,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return false,
        };
        if moments.len() == Self::ROOM {
            return false;
        }
        moments.push_back(moment);
        drop(moments);
        self.changed.notify_one();
        true
    }

    /// Waits for the next moment; `None` once the channel is closed.
    pub async fn next(&self) -> Option<Moment> {
        loop {
            let first = self.moments.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
            if first.is_some() {
                return first;
            }
            if self.is_closed() {
                return None;
            }
            self.changed.notified().await;
        }
    }

    /// Says that nothing more is put there, or looked at.
    pub fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.changed.notify_one();
    }

    /// Whether that was said.
    pub fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moment(steps: u32) -> Moment {
        Moment {
            scene: Scene::default(),
            contacts: vec![],
            seed: 0,
            episode: 0,
            steps,
            stage: Stage::Reach,
            marks: vec![],
        }
    }

    #[test]
    fn the_rate_is_that_of_the_latest_episodes() {
        let mut tally = Tally::default();
        assert_eq!((tally.episodes(), tally.success_rate()), (0, None));
        tally.ended(false);
        assert_eq!(tally.success_rate(), Some(0.0));
        (0..Tally::RECENT - 1).for_each(|_| tally.ended(true));
        assert_eq!(tally.success_rate(), Some(0.99));
        tally.ended(true);
        assert_eq!((tally.episodes(), tally.success_rate()), (101, Some(1.0)));
    }

    #[test]
    fn a_window_that_nobody_looks_through_takes_no_more_than_it_has_room_for() {
        let channel = FrameChannel::new(Pace::Episodes);
        let taken =
            (0..2 * FrameChannel::ROOM as u32).filter(|steps| channel.put(moment(*steps))).count();
        assert_eq!(taken, FrameChannel::ROOM);
        // A page that looks at it does not hold the session up.
        let looking = channel.moments.lock().unwrap();
        assert!(!channel.put(moment(0)));
        drop(looking);
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            for steps in 0..FrameChannel::ROOM as u32 {
                assert_eq!(channel.next().await.unwrap().steps, steps);
            }
            channel.close();
            assert!(channel.next().await.is_none());
        });
    }
}
