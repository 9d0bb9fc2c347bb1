//! Recordings: episodes of one environment as a file, from which they come again, bit by bit.
//!
//! A recording is exported snapshots one after another ([`trocar_proto::snapshot`]): of every episode one now and
//! then, and one where it ended. Each has the task, its options, the seed, the placement and the actions since the
//! episode began, which is all that the episode depends on, and a fingerprint of the state that came of it. So a
//! program that plays a recording again sees at every snapshot whether it is still the same, bit by bit. A trainer can
//! import any of them and go on from there.
//!
//! A recording of a live world has what its arms were told instead of actions, see [`trocar_proto::dvrk::recording`].

use std::collections::BTreeMap;

use trocar_proto::dvrk::recording::LivePart;
use trocar_proto::part::{self, Kind};
use trocar_proto::snapshot::Recipe;
use trocar_proto::{Code, Options, Rejection};

use crate::env::{Env, Step};
use crate::error::StepError;
use crate::registry::Registry;
use crate::render::Scene;

pub(crate) mod live;

use live::{LiveEpisode, LiveReplay};

/// Steps from one snapshot of an episode to the next, unless said otherwise.
pub const EVERY: u32 = 10;

/// Decides which states of an environment go into a recording.
#[derive(Debug, Clone)]
pub struct Recorder {
    every: u32,
    /// Seed, episode and step of the last state that went there.
    last: Option<(u64, u64, u32)>,
}

impl Default for Recorder {
    fn default() -> Self {
        Self::new(EVERY)
    }
}

impl Recorder {
    /// A recorder that takes a state each `every` steps (at least 1) and at the end of every episode.
    pub fn new(every: u32) -> Self {
        Self { every: every.max(1), last: None }
    }

    /// What goes into the recording after a step: the state as bytes, if its time has come.
    pub fn after_step(&mut self, env: &Env) -> Option<Vec<u8>> {
        (env.needs_reset() || env.steps().is_multiple_of(self.every)).then(|| self.take(env))?
    }

    /// What goes into the recording before the environment is reset or brought elsewhere: where its
    /// episode was left, unless that was taken already.
    pub fn before_leaving(&mut self, env: &Env) -> Option<Vec<u8>> {
        let part = (env.was_reset() && env.steps() > 0).then(|| self.take(env))?;
        // The same seed may come again and begin otherwise.
        self.last = None;
        part
    }

    fn take(&mut self, env: &Env) -> Option<Vec<u8>> {
        let now = (env.seed(), env.episode(), env.steps());
        if self.last == Some(now) {
            return None;
        }
        // Only what is too long to be exported is missing.
        let part = env.export().ok()?;
        self.last = Some(now);
        Some(part)
    }
}

/// One episode of a recording, or all of a live world.
#[derive(Debug, Clone)]
pub struct Course(Told);

/// What a recording tells.
#[derive(Debug, Clone)]
enum Told {
    Episode(Box<Episode>),
    Live(LiveEpisode),
}

/// An episode that actions led through.
#[derive(Debug, Clone)]
struct Episode {
    /// What is known of its last state; the actions are those of the whole episode.
    recipe: Recipe,
    /// The fingerprints that states must have, by the numbers of actions taken until then.
    marks: BTreeMap<usize, u64>,
}

impl Course {
    /// Task id.
    pub fn task(&self) -> &str {
        match &self.0 {
            Told::Episode(episode) => &episode.recipe.task,
            Told::Live(course) => &course.beginning.task,
        }
    }

    /// Seed of the episode.
    pub fn seed(&self) -> u64 {
        match &self.0 {
            Told::Episode(episode) => episode.recipe.seed,
            Told::Live(course) => course.beginning.seed,
        }
    }

    /// Number of the episode under that seed.
    pub fn episode(&self) -> u64 {
        match &self.0 {
            Told::Episode(episode) => episode.recipe.episode,
            Told::Live(_) => 0,
        }
    }

    /// Its options.
    pub fn options(&self) -> &Options {
        match &self.0 {
            Told::Episode(episode) => &episode.recipe.options,
            Told::Live(course) => &course.beginning.options,
        }
    }

    /// Whether it is of a live world, whose arms were told what to do.
    pub fn is_live(&self) -> bool {
        matches!(self.0, Told::Live(_))
    }

    /// How many of its states are compared.
    pub fn marks(&self) -> usize {
        match &self.0 {
            Told::Episode(episode) => episode.marks.len(),
            Told::Live(course) => course.marks(),
        }
    }
}

/// The episodes of a recording, in the order in which they were played; `bytes` may be anything.
pub fn read(bytes: &[u8]) -> Result<Vec<Course>, Rejection> {
    courses(part::split(bytes)?)
}

/// The same of a file that may be cut off: its episodes up to the last whole part, and the number of bytes after that part.
pub fn read_whole(bytes: &[u8]) -> Result<(Vec<Course>, usize), Rejection> {
    let (parts, lost) = part::split_whole(bytes)?;
    Ok((courses(parts)?, lost))
}

fn courses(parts: Vec<&[u8]>) -> Result<Vec<Course>, Rejection> {
    let mut courses: Vec<Course> = vec![];
    for part in parts {
        if Kind::of(part) == Some(Kind::Live) {
            match (LivePart::from_bytes(part)?, courses.last_mut()) {
                (LivePart::Beginning(beginning), _) => {
                    courses.push(Course(Told::Live(LiveEpisode::new(beginning))));
                }
                (LivePart::Stretch(next), Some(Course(Told::Live(course)))) => course.push(next)?,
                (LivePart::Stretch(next), _) => {
                    let (number, why) = (next.number, "it has no beginning");
                    let field = "recording.number";
                    return Err(Rejection::new(Code::InvalidSnapshot, field, number, why));
                }
            }
            continue;
        }
        let recipe = Recipe::from_bytes(part)?;
        let mark = (recipe.actions.len(), recipe.fingerprint);
        match courses.last_mut() {
            Some(Course(Told::Episode(episode))) if goes_on(&episode.recipe, &recipe) => {
                episode.marks.extend([mark]);
                episode.recipe = recipe;
            }
            _ => {
                let episode = Episode { recipe, marks: [mark].into() };
                courses.push(Course(Told::Episode(episode.into())));
            }
        }
    }
    Ok(courses)
}

/// Whether `later` is of the same episode as `earlier`, further on.
fn goes_on(earlier: &Recipe, later: &Recipe) -> bool {
    (earlier.seed, earlier.episode, &earlier.task) == (later.seed, later.episode, &later.task)
        && (&earlier.options, &earlier.placement) == (&later.options, &later.placement)
        && later.actions.starts_with(&earlier.actions)
}

/// An episode or a live world that is played again, step by step.
#[derive(Clone)]
pub struct Replay {
    play: Play,
    failed: bool,
}

/// What is played.
#[derive(Clone)]
#[expect(clippy::large_enum_variant, reason = "there is one at a time")]
enum Play {
    Episode {
        env: Env,
        episode: Box<Episode>,
        /// Numbers of actions that were carried out.
        done: usize,
    },
    Live(LiveReplay),
}

impl Replay {
    /// The episode or the world at its beginning.
    pub fn new(registry: &Registry, course: Course) -> Result<Self, Rejection> {
        let play = match course.0 {
            Told::Live(course) => Play::Live(LiveReplay::new(registry, course)?),
            Told::Episode(episode) => {
                let recipe = &episode.recipe;
                let mut env = registry.make(&recipe.task, &recipe.options)?;
                env.identity().check(recipe)?;
                env.reset_to(recipe.seed, recipe.episode);
                env.arrange(&recipe.placement)?;
                compare(&env, &episode, 0)?;
                Play::Episode { env, episode, done: 0 }
            }
        };
        Ok(Self { play, failed: false })
    }

    /// The environment as it is now.
    pub fn env(&self) -> &Env {
        match &self.play {
            Play::Episode { env, .. } => env,
            Play::Live(replay) => replay.world.env(),
        }
    }

    /// Plays the next step; `None` after the last. A failure of the simulation that was recorded fails
    /// again, and its step is one without reward. An error where the bits are not those that were recorded.
    #[expect(
        clippy::should_implement_trait,
        reason = "one looks at the environment between the steps"
    )]
    pub fn next(&mut self) -> Option<Result<Step, Rejection>> {
        self.next_in_parts(1, &mut |_| {})
    }

    /// As [`Self::next`], and shows what there is to see at the ends of `parts` even parts of the step but the
    /// last; nothing of a step that fails.
    pub fn next_in_parts(
        &mut self,
        parts: u32,
        see: &mut dyn FnMut(Scene),
    ) -> Option<Result<Step, Rejection>> {
        let Self { play, failed } = self;
        match play {
            Play::Live(replay) => {
                (!replay.is_done()).then(|| live_step(replay, failed, parts, see))
            }
            Play::Episode { env, episode, done } => {
                let actions = &episode.recipe.actions;
                if *done >= actions.len() {
                    return None;
                }
                let end = *done + env.spec().action_dim();
                let step = match env.step_in_parts(&actions[*done..end], parts, see) {
                    Ok(step) => step,
                    Err(StepError::Simulation { .. }) => {
                        *failed = true;
                        Step { truncated: true, ..Step::default() }
                    }
                    Err(StepError::InvalidAction(refusal)) => return Some(Err(refusal)),
                    Err(StepError::ResetNeeded) => return Some(Err(differs(env, "it has ended"))),
                };
                *done = end;
                Some(compare(env, episode, end).map(|()| step))
            }
        }
    }

    /// Whether the simulation failed in its last step.
    pub fn has_failed(&self) -> bool {
        self.failed
    }
}

/// Plays a step's time of a live world, less at its end.
fn live_step(
    replay: &mut LiveReplay,
    failed: &mut bool,
    parts: u32,
    see: &mut dyn FnMut(Scene),
) -> Result<Step, Rejection> {
    let ticks = replay.world.ticks_per_step();
    let parts = parts.clamp(1, ticks);
    for tick in 1..=ticks {
        match replay.tick()? {
            Some(true) => {}
            Some(false) => return Err(differs(replay.world.env(), ANOTHER)),
            None => {
                *failed = true;
                return Ok(Step { truncated: true, ..Step::default() });
            }
        }
        if replay.is_done() {
            break;
        }
        let part = |tick: u32| tick * parts / ticks;
        if tick < ticks && part(tick) > part(tick - 1) {
            see(replay.world.env().scene());
        }
    }
    Ok(replay.world.evaluate())
}

/// Why bits may differ.
const ANOTHER: &str = "another build or machine wrote it, or it was changed";

/// An error where this state was recorded and is another now.
fn compare(env: &Env, episode: &Episode, done: usize) -> Result<(), Rejection> {
    match episode.marks.get(&done) {
        Some(mark) if *mark != env.fingerprint() => Err(differs(env, ANOTHER)),
        _ => Ok(()),
    }
}

fn differs(env: &Env, why: &str) -> Rejection {
    Rejection::new(
        Code::InvalidSnapshot,
        "recording.fingerprint",
        format!("episode {} of seed {}, step {}", env.episode(), env.seed(), env.steps()),
        format!("its bits are not those that were recorded: {why}"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn env() -> Env {
        Registry::builtin().make("NeedleReach-v0", &Options::new()).unwrap()
    }

    fn episode(course: &mut Course) -> &mut Episode {
        match &mut course.0 {
            Told::Episode(episode) => episode,
            Told::Live(_) => panic!("it is an episode"),
        }
    }

    /// A recording of two episodes: one of 50 steps, one that is left after 13.
    fn recording(every: u32) -> Vec<u8> {
        let (mut env, mut recorder) = (env(), Recorder::new(every));
        let mut bytes = vec![];
        for (seed, steps) in [(3, 50), (4, 13)] {
            bytes.extend(recorder.before_leaving(&env).into_iter().flatten());
            env.reset(Some(seed));
            let mut action = [0.0; 5];
            for _ in 0..steps {
                env.expert(&mut action);
                env.step(&action).unwrap();
                bytes.extend(recorder.after_step(&env).into_iter().flatten());
            }
        }
        bytes.extend(recorder.before_leaving(&env).into_iter().flatten());
        bytes
    }

    #[test]
    fn episodes_come_again_bit_by_bit() {
        let courses = read(&recording(10)).unwrap();
        assert_eq!(courses.iter().map(Course::marks).collect::<Vec<_>>(), [5, 2]);
        for (course, (seed, steps)) in courses.into_iter().zip([(3, 50), (4, 13)]) {
            let mut replay = Replay::new(&Registry::builtin(), course).unwrap();
            let mut last = None;
            while let Some(step) = replay.next() {
                last = Some(step.unwrap());
            }
            assert_eq!((replay.env().seed(), replay.env().steps()), (seed, steps));
            assert_eq!(last.unwrap().truncated, steps == 50);
            assert!(!replay.has_failed());
        }
    }

    #[test]
    fn another_action_is_noticed_at_the_next_snapshot() {
        let mut courses = read(&recording(10)).unwrap();
        // The last step before the next snapshot, at which the arm is at rest otherwise.
        episode(&mut courses[0]).recipe.actions[5 * 29] += 1e-3;
        let mut replay = Replay::new(&Registry::builtin(), courses.remove(0)).unwrap();
        let refusal = std::iter::from_fn(|| replay.next()).find_map(Result::err).unwrap();
        assert_eq!(refusal.field, "recording.fingerprint");
        assert!(refusal.value.contains("step 30"), "{refusal}");
    }

    #[test]
    fn what_is_no_recording_is_refused() {
        let bytes = recording(10);
        assert!(read(b"").is_err());
        assert!(read(&bytes[..bytes.len() - 1]).is_err());
        let mut courses = read(&bytes).unwrap();
        episode(&mut courses[0]).recipe.task = "Unknown-v0".into();
        assert!(Replay::new(&Registry::builtin(), courses.remove(0)).is_err());
    }
}
