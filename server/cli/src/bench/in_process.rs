//! Environments in this process, those of all clients: every thread steps its part of them, one after
//! another.

use std::sync::Barrier;
use std::thread;

use trocar_server::Registry;
use trocar_server::env::Pictures;
use trocar_server::{Env, StepError};

use super::{BEGINNINGS, Job, Measured, Stopwatch};

/// An environment, and the expert's actions in it.
struct Player {
    env: Env,
    seed: u64,
    /// Number of its client, and its own in that one's session.
    client: u32,
    index: usize,
    action: Vec<f32>,
    pictures: Pictures,
}

impl Player {
    /// Steps by one of the actions of a round, or by the expert's.
    fn step(&mut self, round: Option<&[f32]>) -> Result<(), StepError> {
        let Self { env, index, action, pictures, .. } = self;
        let dim = action.len();
        let chosen = if let Some(round) = round {
            &round[*index * dim..][..dim]
        } else {
            env.expert(action);
            action
        };
        match env.step(chosen) {
            Ok(_) | Err(StepError::Simulation { .. }) => {}
            Err(error) => return Err(error),
        }
        if env.needs_reset() {
            env.reset(None);
        }
        pictures.take(env);
        Ok(())
    }
}

/// Measures a job.
pub(super) fn run(registry: &Registry, job: &Job) -> anyhow::Result<Measured> {
    let mut env = registry.make(&job.task, &job.options)?;
    (0..u64::from(BEGINNINGS)).for_each(|seed| env.reset(Some(seed)));
    let action = vec![0.0; env.spec().action_dim()];
    let pictures = Pictures::of(&env);
    let player = |seed| {
        let mut env = env.clone();
        env.reset(Some(seed));
        let (client, index) = (seed / u64::from(job.envs), seed % u64::from(job.envs));
        let (client, index) = (client as u32, index as usize);
        Player { env, seed, client, index, action: action.clone(), pictures: pictures.clone() }
    };
    let count = job.envs * job.clients;
    let mut players: Vec<_> = (0..u64::from(count)).map(player).collect();
    let threads = job.threads.min(count) as usize;
    let share = players.len().div_ceil(threads);
    let shares = players.len().div_ceil(share);
    let (ready, go) = (Barrier::new(shares + 1), Barrier::new(shares + 1));
    let work = |players: &mut [Player]| -> Result<u64, StepError> {
        let step = |players: &mut [Player], round| {
            players.iter_mut().try_for_each(|player| player.step(job.actions(player.client, round)))
        };
        let warmed = job.warm_up(|round| step(players, round));
        for player in players.iter_mut() {
            player.env.reset(Some(player.seed));
        }
        ready.wait();
        go.wait();
        warmed?;
        let rounds = job.rounds(|round| step(players, round))?;
        Ok(rounds * players.len() as u64)
    };
    thread::scope(|scope| {
        let work = &work;
        let workers: Vec<_> =
            players.chunks_mut(share).map(|share| scope.spawn(move || work(share))).collect();
        ready.wait();
        let watch = Stopwatch::start(&[std::process::id()]);
        go.wait();
        let join = |worker: thread::ScopedJoinHandle<'_, _>| {
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        let steps = workers.into_iter().map(join).sum::<Result<u64, StepError>>()?;
        watch?.stop(steps)
    })
}
