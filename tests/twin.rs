//! The same environments in-process: what a session is compared with. The autoreset modes are
//! written out here a second time, from their description and not from the server's code.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use trocar_client::{Autoreset, Code, Options, Placement, SessionRequest};
use trocar_proto::TaskSpec;
use trocar_server::{Env, Registry, Step, StepError};

use crate::harness::Server;
use crate::rows::{Digest, Row, act, bits, policies};

/// N environments of one task, without a server.
#[derive(Clone)]
pub(crate) struct Twin {
    envs: Vec<Env>,
    autoreset: Autoreset,
}

impl Twin {
    pub(crate) fn new(task: &str, options: &Options, envs: usize, seed: u64) -> Self {
        let first = Registry::builtin().make(task, options).expect("the task is registered");
        let seeded = |index| {
            let mut env = first.clone();
            env.set_seed(seed + index);
            env
        };
        let envs = (0..envs as u64).map(seeded).collect();
        Self { envs, autoreset: Autoreset::default() }
    }

    pub(crate) fn autoreset(self, autoreset: Autoreset) -> Self {
        Self { autoreset, ..self }
    }

    pub(crate) fn spec(&self) -> &TaskSpec {
        self.envs[0].spec()
    }

    pub(crate) fn all(&self) -> Vec<u32> {
        (0..self.envs.len() as u32).collect()
    }

    pub(crate) fn reset(&mut self, env_ids: &[u32], seeds: Option<&[u64]>) -> Vec<Row> {
        let reset = |(row, id): (usize, &u32)| {
            let env = &mut self.envs[*id as usize];
            env.reset(seeds.map(|seeds| seeds[row]));
            show(env, None, None)
        };
        env_ids.iter().enumerate().map(reset).collect()
    }

    /// Lets the episodes of `env_ids`, which have only begun, begin as placements ask for.
    pub(crate) fn arrange(&mut self, env_ids: &[u32], placements: &[Placement]) -> Vec<Row> {
        let arrange = |(id, placement): (&u32, &Placement)| {
            let env = &mut self.envs[*id as usize];
            env.arrange(placement).expect("it is allowed");
            show(env, None, None)
        };
        env_ids.iter().zip(placements).map(arrange).collect()
    }

    /// Lets `env_ids` go on from the environments `sources` of `other`.
    pub(crate) fn go_on_from(
        &mut self,
        other: &Self,
        sources: &[u32],
        env_ids: &[u32],
    ) -> Vec<Row> {
        let go_on = |(id, source): (&u32, &u32)| {
            self.envs[*id as usize] = other.envs[*source as usize].clone();
            show(&self.envs[*id as usize], None, None)
        };
        env_ids.iter().zip(sources).map(go_on).collect()
    }

    /// Steps the environments; nothing happens where one of them is not ready.
    pub(crate) fn step(&mut self, env_ids: &[u32], actions: &[f32]) -> Result<Vec<Row>, Code> {
        let dim = self.spec().action_dim();
        let mut stepped = self.envs.clone();
        let mut rows = vec![];
        for (id, action) in env_ids.iter().zip(actions.chunks(dim)) {
            let env = &mut stepped[*id as usize];
            if env.was_reset() && env.needs_reset() && self.autoreset == Autoreset::NextStep {
                env.reset(None);
                rows.push(show(env, None, None));
                continue;
            }
            let step = env.step(action).map_err(|error| match error {
                StepError::ResetNeeded => Code::ResetNeeded,
                StepError::InvalidAction(refusal) => refusal.code,
                StepError::Simulation { .. } => Code::Simulation,
            })?;
            let ended = step.terminated || step.truncated;
            let last = (ended && self.autoreset == Autoreset::SameStep).then(|| {
                let last = see(env);
                env.reset(None);
                last
            });
            rows.push(show(env, Some(step), last));
        }
        self.envs = stepped;
        Ok(rows)
    }
}

fn see(env: &Env) -> [Vec<u32>; 3] {
    let spec = env.spec();
    let (mut observation, goal) = (vec![f32::NAN; spec.observation_dim()], spec.goal_dim());
    let (mut achieved, mut desired) = (vec![f32::NAN; goal], vec![f32::NAN; goal]);
    env.observe(&mut observation, &mut achieved, &mut desired);
    [bits(&observation), bits(&achieved), bits(&desired)]
}

fn show(env: &Env, step: Option<Step>, last: Option<[Vec<u32>; 3]>) -> Row {
    let [observation, achieved, desired] = see(env);
    let mut expert = vec![f32::NAN; env.spec().action_dim()];
    env.expert(&mut expert);
    Row {
        observation,
        achieved,
        desired,
        reward: step.map_or(0.0, |step| step.reward).to_bits(),
        terminated: step.is_some_and(|step| step.terminated),
        truncated: step.is_some_and(|step| step.truncated),
        is_success: step.is_some_and(|step| step.is_success),
        tip_path: step.map_or(0.0, |step| step.tip_path).to_bits(),
        peak_force: step.map_or(0.0, |step| step.peak_force).to_bits(),
        steps: env.steps(),
        seed: env.seed(),
        episode: env.episode(),
        expert: bits(&expert),
        stage: env.stage() as u8,
        last,
    }
}

/// What the role `digest` of `trocar-test-client` prints.
pub(crate) fn digest() -> String {
    let mut twin = Twin::new("EcmReach-v0", &Options::new(), 4, 0);
    let (all, mut policies, mut digest) = (twin.all(), policies(0, 4), Digest::default());
    let mut rows = twin.reset(&all, Some(&[0, 1, 2, 3]));
    digest.add(&rows);
    for _ in 0..Digest::STEPS {
        let actions = act(&mut policies, &rows);
        rows = twin.step(&all, &actions).expect("every environment was reset");
        digest.add(&rows);
    }
    digest.text()
}

/// A client that steps without a pause, and finds every bit as its twin does.
pub(crate) struct Bystander {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Bystander {
    /// Steps that it takes at least, however soon it is to finish.
    const LEAST: usize = 20;

    /// A client of `server` on a thread of its own.
    pub(crate) fn start(server: &Server) -> Self {
        let request = SessionRequest::new("NeedleReach-v0").envs(3).seed(77);
        let mut session = server.open(&request);
        let mut twin = Twin::new(&request.task, &request.options, 3, request.seed);
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let (all, mut policies) = (twin.all(), policies(77, 3));
            let mut rows = Row::all(&session.reset().unwrap(), Autoreset::NextStep);
            assert_eq!(rows, twin.reset(&all, None));
            let mut steps = 0;
            while steps < Self::LEAST || !stopped.load(Ordering::Acquire) {
                let actions = act(&mut policies, &rows);
                rows = Row::all(&session.step(&actions).unwrap(), Autoreset::NextStep);
                assert_eq!(rows, twin.step(&all, &actions).unwrap(), "after {steps} steps");
                steps += 1;
            }
        });
        Self { stop, thread }
    }

    /// Ends it; fails where it found anything amiss.
    pub(crate) fn finish(self) {
        self.stop.store(true, Ordering::Release);
        self.thread.join().expect("the bystander saw its twin's bits");
    }
}
