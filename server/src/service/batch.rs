//! The environments of a session: reset, step, autoreset, copies. No transport in here.

use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_proto::control::{Autoreset, SessionRequest};
use trocar_proto::{Code, Placement, Rejection, TaskSpec, seed};

use super::drawing;
use super::observer::StepObserver;
use super::rows::Rows;
use super::scheduler::{Quantum, Splittable};
use crate::env::{Env, Imaging, Rebuild, Step};
use crate::error::StepError;
use crate::registry::Registry;
use crate::render::Scene;

/// N environments of one task.
pub(crate) struct Batch {
    envs: Vec<Env>,
    spec: Arc<TaskSpec>,
    autoreset: Autoreset,
    /// Expected time of one environment's step.
    cost: Duration,
    /// How many the latest message stepped, reset or restored.
    rows: usize,
    /// It stepped or reset them, and the time that this took was not reported yet.
    untimed: bool,
    /// What the latest step of each environment took that was timed.
    took: Vec<Duration>,
}

/// What a request does with each of its environments.
#[derive(Clone, Copy)]
pub(crate) enum BatchCommand<'a> {
    /// Reset; to these seeds and their episodes (rows) where given, else to the next episode.
    Reset(Option<(&'a [u64], &'a [u64])>),
    /// Step with the actions (rows, action dim).
    Step(&'a [f32]),
    /// Go on from these states (rows).
    Restore(&'a [Arc<Env>]),
}

impl Batch {
    /// The environments that a request asks for; its task and options are checked again.
    pub(crate) fn new(registry: &Registry, request: &SessionRequest) -> Result<Self, Rejection> {
        let first = registry.make(&request.task, &request.options)?;
        let spec = Arc::new(first.spec().clone());
        let envs: Vec<_> = (0..u64::from(request.envs))
            .map(|index| {
                let mut env = first.clone();
                env.set_seed(seed::of(u128::from(request.seed) + u128::from(index)));
                env
            })
            .collect();
        let took = vec![Duration::ZERO; envs.len()];
        Ok(Self {
            envs,
            spec,
            autoreset: request.autoreset,
            cost: Duration::from_micros(100),
            rows: took.len(),
            untimed: false,
            took,
        })
    }

    /// The task under the session's options.
    pub(crate) fn spec(&self) -> &Arc<TaskSpec> {
        &self.spec
    }

    /// Takes note of the time that the latest message took, which says something about the next step if it was one.
    pub(crate) fn learn(&mut self, took: Duration) {
        if std::mem::take(&mut self.untimed) {
            self.cost = (self.cost + took / self.rows as u32) / 2;
        }
    }

    /// Copies of the environments `env_ids`, as they are now.
    pub(crate) fn copies(
        &self,
        env_ids: &[u32],
        quantum: &mut Quantum<'_>,
    ) -> Result<Vec<Arc<Env>>, Rejection> {
        self.check_env_ids(env_ids)?;
        for id in env_ids {
            self.check_begun(*id)?;
        }
        let mut copies = vec![None; env_ids.len()];
        quantum.run(Copying { envs: &self.envs, env_ids, copies: &mut copies }, COPY);
        Ok(copies.into_iter().flatten().collect())
    }

    /// For every row the state of its environment, whose episode has only begun, arranged by the placement of
    /// that row.
    pub(crate) fn arranged(
        &self,
        env_ids: &[u32],
        placements: Vec<Arc<Placement>>,
        quantum: &mut Quantum<'_>,
    ) -> Result<Vec<Arc<Env>>, Rejection> {
        let mut rows: Vec<_> = self.copies(env_ids, quantum)?.into_iter().zip(placements).collect();
        let mut refusals = vec![None; rows.len()];
        quantum.run(Arranging { rows: &mut rows, refusals: &mut refusals }, ARRANGED);
        let refused =
            refusals.into_iter().zip(env_ids).find_map(|(refusal, id)| Some((refusal?, id)));
        match refused {
            None => Ok(rows.into_iter().map(|(env, _)| env).collect()),
            Some((refusal, _)) if self.envs.len() == 1 => Err(refusal),
            Some((refusal, id)) => {
                Err(Rejection { field: format!("{}[env {id}]", refusal.field), ..refusal })
            }
        }
    }

    /// For every row the state that the environment of that number is in now.
    pub(crate) fn sources(
        &self,
        numbers: &[u64],
        quantum: &mut Quantum<'_>,
    ) -> Result<Vec<Arc<Env>>, Rejection> {
        if let Some(number) = numbers.iter().find(|number| **number >= self.envs.len() as u64) {
            let allowed = format!("allowed are numbers below {}", self.envs.len());
            return Err(Rejection::new(Code::InvalidEnvIds, "source", number, allowed));
        }
        let mut ids: Vec<u32> = numbers.iter().map(|number| *number as u32).collect();
        ids.sort_unstable();
        ids.dedup();
        let copies = self.copies(&ids, quantum)?;
        let source = |number: &u64| {
            let at = ids.binary_search(&(*number as u32)).expect("its number was copied");
            Arc::clone(&copies[at])
        };
        Ok(numbers.iter().map(source).collect())
    }

    /// Draws one environment as `view` shows it: its colours, or its depth where there is room for that.
    pub(crate) fn draw(
        &self,
        env_ids: &[u32],
        view: &Imaging,
        rgb: &mut [u8],
        depth: &mut [f32],
        quantum: &mut Quantum<'_>,
    ) -> Result<(), Rejection> {
        self.check_env_ids(env_ids)?;
        let [id] = env_ids else {
            let allowed = "one environment is drawn at a time";
            return Err(Rejection::new(Code::InvalidEnvIds, "env_ids", env_ids.len(), allowed));
        };
        self.check_begun(*id)?;
        let env = &self.envs[*id as usize];
        quantum.run(drawing::One { env: Some(env), view, rgb, depth }, PICTURE);
        Ok(())
    }

    /// An error before the first reset of an environment.
    fn check_begun(&self, id: u32) -> Result<(), Rejection> {
        self.envs[id as usize]
            .check_begun()
            .map_err(|refusal| Rejection { value: id.to_string(), ..refusal })
    }

    /// An environment like those of the session.
    pub(crate) fn like(&self) -> &Env {
        &self.envs[0]
    }

    /// One of the session's.
    ///
    /// # Panics
    /// Where there is none of that number.
    pub(crate) fn env(&self, number: u32) -> &Env {
        &self.envs[number as usize]
    }

    /// Carries out `command` for the environments `env_ids` and writes their rows. Either all of it
    /// is carried out, or none and the refusal says why.
    pub(crate) fn apply(
        &mut self,
        command: BatchCommand<'_>,
        env_ids: &[u32],
        want_expert: bool,
        observer: StepObserver<'_>,
        mut rows: Rows<'_>,
        quantum: &mut Quantum<'_>,
    ) -> Result<(), Rejection> {
        self.check_env_ids(env_ids)?;
        if let BatchCommand::Step(actions) = command {
            self.check_actions(actions, env_ids)?;
            self.check_reset(env_ids)?;
        }
        let cost = self.cost;
        self.rows = env_ids.len();
        // States may have to be rebuilt before they are restored.
        self.untimed = !matches!(command, BatchCommand::Restore(_));
        // Pictures are drawn once all environments were stepped: a renderer may draw many at once.
        let [pictures, final_pictures] = rows.take_pictures();
        let has_pictures = self.envs[0].imaging().is_some();
        let mut finals: Vec<Option<Scene>> =
            vec![None; if has_pictures { env_ids.len() } else { 0 }];
        let work = Work {
            finals: &mut finals,
            first: 0,
            envs: &mut self.envs,
            took: &mut self.took,
            long: (cost > WORTH_TIMING && quantum.is_parallel()).then_some(cost * LONG),
            env_ids,
            command,
            action_dim: self.spec.action_dim(),
            autoreset: self.autoreset,
            want_expert,
            observer,
            rows,
        };
        quantum.run(work, cost);
        if let Some(imaging) = self.envs[0].imaging() {
            let (envs, finals) = (&self.envs, finals.as_mut_slice());
            let drawing = drawing::All { envs, env_ids, imaging, finals, pictures, final_pictures };
            quantum.run(drawing, cost);
        }
        Ok(())
    }

    fn check_env_ids(&self, env_ids: &[u32]) -> Result<(), Rejection> {
        let increasing = env_ids.windows(2).all(|pair| pair[0] < pair[1]);
        let in_range = env_ids.last().is_some_and(|last| (*last as usize) < self.envs.len());
        if increasing && in_range {
            return Ok(());
        }
        Err(Rejection::new(
            Code::InvalidEnvIds,
            "env_ids",
            format!("{env_ids:?}"),
            format!("allowed are one or more increasing numbers below {}", self.envs.len()),
        ))
    }

    fn check_actions(&self, actions: &[f32], env_ids: &[u32]) -> Result<(), Rejection> {
        let Some(at) = actions.iter().position(|value| !value.is_finite()) else { return Ok(()) };
        let dim = self.spec.action_dim();
        Err(Rejection::new(
            Code::InvalidAction,
            format!("actions[env {}][{}]", env_ids[at / dim], at % dim),
            actions[at],
            format!("allowed is a finite number ({})", self.spec.action[at % dim].name),
        ))
    }

    fn check_reset(&self, env_ids: &[u32]) -> Result<(), Rejection> {
        let unready = |id: &&u32| {
            let env = &self.envs[**id as usize];
            env.needs_reset() && (self.autoreset != Autoreset::NextStep || !env.was_reset())
        };
        let Some(id) = env_ids.iter().find(unready) else { return Ok(()) };
        let why = if self.envs[*id as usize].was_reset() {
            "its episode has ended; reset it before the next step"
        } else {
            "it was never reset; reset it before the first step"
        };
        Err(Rejection::new(Code::ResetNeeded, "env", id, why))
    }
}

/// Some rows of a request: the environments it is about and where their results go.
struct Work<'a> {
    /// The number of `envs[0]` in the session.
    first: u32,
    envs: &'a mut [Env],
    /// What the latest step of each took.
    took: &'a mut [Duration],
    /// More than that is long, where that is of interest.
    long: Option<Duration>,
    env_ids: &'a [u32],
    command: BatchCommand<'a>,
    action_dim: usize,
    autoreset: Autoreset,
    want_expert: bool,
    observer: StepObserver<'a>,
    rows: Rows<'a>,
    /// What there is to see at the ends of episodes that the same step replaced, where there are pictures.
    finals: &'a mut [Option<Scene>],
}

impl Splittable for Work<'_> {
    fn len(&self) -> usize {
        self.env_ids.len()
    }

    fn split_at(self, at: usize) -> (Self, Self) {
        let (ids, later_ids) = self.env_ids.split_at(at);
        // Increasing ids: everything from the first later one on belongs to the second part.
        let border = later_ids.first().map_or(self.envs.len(), |id| (id - self.first) as usize);
        let (envs, later_envs) = self.envs.split_at_mut(border);
        let (took, later_took) = self.took.split_at_mut(border);
        let (command, later_command) = match self.command {
            BatchCommand::Reset(None) => (BatchCommand::Reset(None), BatchCommand::Reset(None)),
            BatchCommand::Reset(Some((seeds, episodes))) => {
                let (seeds, later_seeds) = seeds.split_at(at);
                let (episodes, later_episodes) = episodes.split_at(at);
                let later = (later_seeds, later_episodes);
                (BatchCommand::Reset(Some((seeds, episodes))), BatchCommand::Reset(Some(later)))
            }
            BatchCommand::Step(actions) => {
                let (actions, later) = actions.split_at(at * self.action_dim);
                (BatchCommand::Step(actions), BatchCommand::Step(later))
            }
            BatchCommand::Restore(states) => {
                let (states, later) = states.split_at(at);
                (BatchCommand::Restore(states), BatchCommand::Restore(later))
            }
        };
        let (rows, later_rows) = self.rows.split_at(at);
        let at = at.min(self.finals.len());
        let (finals, later_finals) = self.finals.split_at_mut(at);
        let part = |first, envs, took, env_ids, command, rows, finals| Self {
            finals,
            first,
            envs,
            took,
            long: self.long,
            env_ids,
            command,
            action_dim: self.action_dim,
            autoreset: self.autoreset,
            want_expert: self.want_expert,
            observer: self.observer,
            rows,
        };
        let now = part(self.first, envs, took, ids, command, rows, finals);
        let border = self.first + border as u32;
        let later = part(
            border,
            later_envs,
            later_took,
            later_ids,
            later_command,
            later_rows,
            later_finals,
        );
        (now, later)
    }

    /// An object that is held now, or falls, will most often be so in the next step.
    fn first_long(&self) -> Option<usize> {
        let long = self.long?;
        self.env_ids.iter().position(|id| self.took[(id - self.first) as usize] > long)
    }

    fn run(mut self) {
        for (row, id) in self.env_ids.iter().enumerate() {
            let start = self.long.map(|_| Instant::now());
            let env = &mut self.envs[(id - self.first) as usize];
            match self.command {
                BatchCommand::Reset(to) => {
                    self.observer.before_leaving(*id, env);
                    match to {
                        Some((seeds, episodes)) => env.reset_to(seeds[row], episodes[row]),
                        None => env.reset(None),
                    }
                    self.rows.write_step(row, &Step::default(), 0);
                    show(env, &mut self.rows, row);
                }
                BatchCommand::Step(actions) => {
                    let action = &actions[row * self.action_dim..(row + 1) * self.action_dim];
                    let last = self.finals.get_mut(row);
                    let observer = (*id, self.observer);
                    step(env, action, self.autoreset, observer, &mut self.rows, row, last);
                }
                BatchCommand::Restore(states) => {
                    self.observer.before_leaving(*id, env);
                    env.clone_from(&states[row]);
                    self.rows.write_step(row, &Step::default(), 0);
                    show(env, &mut self.rows, row);
                }
            }
            write_state(env, self.want_expert, &mut self.rows, row);
            if let Some(start) = start {
                self.took[(id - self.first) as usize] = start.elapsed();
            }
        }
    }
}

/// How many times the average makes a step long.
const LONG: u32 = 3;

/// Average of a step from which on it is worth measuring each, which reads the clock twice: about 50 ns.
const WORTH_TIMING: Duration = Duration::from_micros(10);

/// About the time that a copy takes.
const COPY: Duration = Duration::from_micros(50);

/// About the time that an object takes to come to rest.
const ARRANGED: Duration = Duration::from_millis(2);

/// About the time that a step of an environment that is rebuilt takes.
const REBUILT: Duration = Duration::from_micros(300);

/// About the time that a picture takes.
pub(crate) const PICTURE: Duration = Duration::from_millis(50);

/// Environments that are copied.
struct Copying<'a> {
    envs: &'a [Env],
    env_ids: &'a [u32],
    copies: &'a mut [Option<Arc<Env>>],
}

impl Splittable for Copying<'_> {
    fn len(&self) -> usize {
        self.env_ids.len()
    }

    fn split_at(self, at: usize) -> (Self, Self) {
        let (ids, later_ids) = self.env_ids.split_at(at);
        let (copies, later) = self.copies.split_at_mut(at);
        let part = |env_ids, copies| Self { envs: self.envs, env_ids, copies };
        (part(ids, copies), part(later_ids, later))
    }

    fn run(self) {
        for (copy, id) in self.copies.iter_mut().zip(self.env_ids) {
            *copy = Some(Arc::new(self.envs[*id as usize].clone()));
        }
    }
}

/// Environments whose episodes are arranged.
struct Arranging<'a> {
    rows: &'a mut [(Arc<Env>, Arc<Placement>)],
    refusals: &'a mut [Option<Rejection>],
}

impl Splittable for Arranging<'_> {
    fn len(&self) -> usize {
        self.rows.len()
    }

    fn split_at(self, at: usize) -> (Self, Self) {
        let (rows, later_rows) = self.rows.split_at_mut(at);
        let (refusals, later) = self.refusals.split_at_mut(at);
        (Self { rows, refusals }, Self { rows: later_rows, refusals: later })
    }

    fn run(self) {
        for ((env, placement), refusal) in self.rows.iter_mut().zip(self.refusals) {
            *refusal = Arc::make_mut(env).arrange(placement).err();
        }
    }
}

/// Rebuilds environments from what led to their states. `go_on` is asked now and then whether it is
/// still worth it; `None` where it was not.
pub(crate) fn rebuild(
    mut rebuilds: Vec<Rebuild>,
    quantum: &mut Quantum<'_>,
    go_on: impl Fn() -> bool,
) -> Option<Vec<Result<Env, Rejection>>> {
    // All of them by one step at a time, so that they share the threads, also with other sessions.
    while rebuilds.iter().any(|rebuild| !rebuild.is_done()) {
        if !go_on() {
            return None;
        }
        quantum.run(Rebuilding(&mut rebuilds), REBUILT);
    }
    Some(rebuilds.into_iter().map(Rebuild::finish).collect())
}

/// A step of each environment that is being rebuilt.
struct Rebuilding<'a>(&'a mut [Rebuild]);

impl Splittable for Rebuilding<'_> {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn split_at(self, at: usize) -> (Self, Self) {
        let (now, later) = self.0.split_at_mut(at);
        (Self(now), Self(later))
    }

    fn run(self) {
        self.0.iter_mut().for_each(Rebuild::step);
    }
}

/// Steps one environment, or resets it where the autoreset mode says so, and shows where it is.
/// What it sees is written into the reply at once.
fn step(
    env: &mut Env,
    action: &[f32],
    autoreset: Autoreset,
    (id, observer): (u32, StepObserver<'_>),
    rows: &mut Rows<'_>,
    row: usize,
    last: Option<&mut Option<Scene>>,
) {
    if env.needs_reset() {
        env.reset(None);
        rows.write_step(row, &Step::default(), 0);
        return show(env, rows, row);
    }
    let (achieved, desired) = (rows.achieved_goal.row(row), rows.desired_goal.row(row));
    let result = env.step_into(action, rows.observation.row(row), achieved, desired);
    observer.after_step(id, env, result.is_err());
    match result {
        Ok(step) => rows.write_step(row, &step, 0),
        // The actions were checked and the episode runs, so only the simulation can have failed:
        // the episode ends for a reason outside of the task.
        Err(error) => {
            debug_assert!(matches!(error, StepError::Simulation { .. }));
            tracing::warn!(%error, seed = env.seed(), episode = env.episode(), "simulation failed");
            let step = Step { truncated: true, ..Step::default() };
            rows.write_step(row, &step, Code::Simulation as u8);
        }
    }
    if env.needs_reset() && autoreset == Autoreset::SameStep {
        env.observe(
            rows.final_observation.row(row),
            rows.final_achieved_goal.row(row),
            rows.final_desired_goal.row(row),
        );
        if let Some(last) = last {
            *last = Some(env.scene());
        }
        env.reset(None);
        show(env, rows, row);
    }
}

/// Writes the present observation and goals.
fn show(env: &Env, rows: &mut Rows<'_>, row: usize) {
    env.observe(rows.observation.row(row), rows.achieved_goal.row(row), rows.desired_goal.row(row));
}

fn write_state(env: &Env, want_expert: bool, rows: &mut Rows<'_>, row: usize) {
    rows.steps.row(row)[0] = env.steps();
    rows.seed.row(row)[0] = env.seed();
    rows.episode.row(row)[0] = env.episode();
    let expert_action = rows.expert_action.row(row);
    let stage = &mut rows.expert_stage.row(row)[0];
    if want_expert {
        env.expert(expert_action);
        *stage = env.stage() as u8;
    } else {
        expert_action.fill(0.0);
        *stage = 0;
    }
}

#[cfg(test)]
mod tests {
    use trocar_proto::wire::ReplyLayout;

    use super::super::observer::LiveRecording;
    use super::super::scheduler::tests::TestScheduler;
    use super::super::scheduler::{Entity, ThreadQuota};
    use super::*;

    #[test]
    fn what_a_step_takes_is_learnt_from_steps_and_from_nothing_that_is_refused() {
        let request = SessionRequest::new("EcmReach-v0").envs(2);
        let mut batch = Batch::new(&Registry::builtin(), &request).unwrap();
        let layout = ReplyLayout::new(2, batch.spec());
        let mut reply = vec![0_u64; layout.bytes / 8];
        let test = TestScheduler::new("learns", 1);
        let mut apply = |batch: &mut Batch, command: BatchCommand<'_>, env_ids: &[u32], took| {
            let rows = Rows::of(&layout, bytemuck::cast_slice_mut(&mut reply), env_ids.len());
            let observer = StepObserver { failures: None, recording: &LiveRecording::default() };
            let entity = Entity::new(&ThreadQuota::new(1));
            let done = test.compute(&entity, |quantum| {
                batch.apply(command, env_ids, false, observer, rows, quantum)
            });
            batch.learn(took);
            done.map(|()| batch.cost)
        };
        let [none, some] = [Duration::ZERO, Duration::from_micros(80)];
        // 100 µs each at first, which every message halves, and half of what it took.
        let cost = apply(&mut batch, BatchCommand::Reset(None), &[0, 1], none).unwrap();
        assert_eq!(cost, Duration::from_micros(50));
        let cost = apply(&mut batch, BatchCommand::Step(&[0.0; 3]), &[1], some).unwrap();
        assert_eq!(cost, Duration::from_micros(65));
        assert!(apply(&mut batch, BatchCommand::Step(&[f32::NAN; 3]), &[1], none).is_err());
        assert_eq!(batch.cost, cost);
        let state = Arc::new(batch.env(0).clone());
        assert_eq!(apply(&mut batch, BatchCommand::Restore(&[state]), &[1], some), Ok(cost));
    }
}
