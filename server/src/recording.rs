//! Recordings: episodes of one environment as a file, from which they come again, bit by bit.
//!
//! A recording is exported snapshots one after another ([`trocar_proto::snapshot`]): of every episode one now and
//! then, and one where it ended. Each has the task, its options, the seed, the placement and the actions since the
//! episode began, which is all that the episode depends on, and a fingerprint of the state that came of it. So a
//! program that plays a recording again sees at every snapshot whether it is still the same, bit by bit. A trainer can
//! import any of them and go on from there.

use std::collections::BTreeMap;

use trocar_proto::snapshot::{self, Recipe};
use trocar_proto::{Code, Options, Rejection};

use crate::env::{Env, Step};
use crate::error::StepError;
use crate::registry::Registry;
use crate::render::Scene;

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

/// One episode of a recording.
#[derive(Debug, Clone)]
pub struct Course {
    /// What is known of its last state; the actions are those of the whole episode.
    recipe: Recipe,
    /// The fingerprints that states must have, by the numbers of actions taken until then.
    marks: BTreeMap<usize, u64>,
}

impl Course {
    /// Task id.
    pub fn task(&self) -> &str {
        &self.recipe.task
    }

    /// Seed of the episode.
    pub fn seed(&self) -> u64 {
        self.recipe.seed
    }

    /// Number of the episode under that seed.
    pub fn episode(&self) -> u64 {
        self.recipe.episode
    }

    /// Its options.
    pub fn options(&self) -> &Options {
        &self.recipe.options
    }

    /// How many of its states are compared.
    pub fn marks(&self) -> usize {
        self.marks.len()
    }
}

/// The episodes of a recording, in the order in which they were played; `bytes` may be anything.
pub fn read(bytes: &[u8]) -> Result<Vec<Course>, Rejection> {
    let mut courses: Vec<Course> = vec![];
    for part in snapshot::split(bytes)? {
        let recipe = Recipe::from_bytes(part)?;
        let mark = (recipe.actions.len(), recipe.fingerprint);
        match courses.last_mut() {
            Some(course) if goes_on(&course.recipe, &recipe) => {
                course.marks.extend([mark]);
                course.recipe = recipe;
            }
            _ => courses.push(Course { recipe, marks: [mark].into() }),
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

/// An episode that is played again, step by step.
#[derive(Clone)]
pub struct Replay {
    env: Env,
    course: Course,
    /// Numbers of actions that were carried out.
    done: usize,
    failed: bool,
}

impl Replay {
    /// The episode at its beginning.
    pub fn new(registry: &Registry, course: Course) -> Result<Self, Rejection> {
        let recipe = &course.recipe;
        let mut env = registry.make(&recipe.task, &recipe.options)?;
        env.identity().check(recipe)?;
        env.reset_to(recipe.seed, recipe.episode);
        env.arrange(&recipe.placement)?;
        let mut replay = Self { env, course, done: 0, failed: false };
        replay.compare()?;
        Ok(replay)
    }

    /// The environment as it is now.
    pub fn env(&self) -> &Env {
        &self.env
    }

    /// What is played.
    pub fn course(&self) -> &Course {
        &self.course
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
        let actions = &self.course.recipe.actions;
        if self.done >= actions.len() {
            return None;
        }
        let end = self.done + self.env.spec().action_dim();
        let step = match self.env.step_in_parts(&actions[self.done..end], parts, see) {
            Ok(step) => step,
            Err(StepError::Simulation { .. }) => {
                self.failed = true;
                Step { truncated: true, ..Step::default() }
            }
            Err(StepError::InvalidAction(refusal)) => return Some(Err(refusal)),
            Err(StepError::ResetNeeded) => return Some(Err(self.differs("it has ended"))),
        };
        self.done = end;
        Some(self.compare().map(|()| step))
    }

    /// Whether the simulation failed in its last step.
    pub fn has_failed(&self) -> bool {
        self.failed
    }

    /// An error where this state was recorded and is another now.
    fn compare(&mut self) -> Result<(), Rejection> {
        match self.course.marks.get(&self.done) {
            Some(mark) if *mark != self.env.fingerprint() => {
                Err(self.differs("another build or machine wrote it, or it was changed"))
            }
            _ => Ok(()),
        }
    }

    fn differs(&self, why: &str) -> Rejection {
        let Self { env, course, .. } = self;
        Rejection::new(
            Code::InvalidSnapshot,
            "recording.fingerprint",
            format!("episode {} of seed {}, step {}", course.episode(), course.seed(), env.steps()),
            format!("its bits are not those that were recorded: {why}"),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn env() -> Env {
        Registry::builtin().make("NeedleReach-v0", &Options::new()).unwrap()
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
        courses[0].recipe.actions[5 * 29] += 1e-3;
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
        courses[0].recipe.task = "Unknown-v0".into();
        assert!(Replay::new(&Registry::builtin(), courses.remove(0)).is_err());
    }
}
