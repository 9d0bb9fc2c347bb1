//! Environments in this process: every thread steps its part of them, one after another.

use std::sync::Barrier;
use std::thread;

use trocar_server::tasks::Registry;
use trocar_server::{Env, StepError};

use super::{Job, Measured, Stopwatch};
use crate::policy::Actor;

/// An environment and who acts in it.
struct Player {
    env: Env,
    actor: Actor,
    action: Vec<f32>,
}

impl Player {
    fn step(&mut self) -> Result<(), StepError> {
        let Self { env, actor, action } = self;
        actor.act(action, |action| env.expert(action));
        match env.step(action) {
            Ok(_) | Err(StepError::Simulation { .. }) => {}
            Err(error) => return Err(error),
        }
        if env.needs_reset() {
            env.reset(None);
        }
        Ok(())
    }
}

/// Measures a job.
pub(super) fn run(registry: &Registry, job: &Job) -> anyhow::Result<Measured> {
    let env = registry.make(&job.task, &job.options)?;
    let action = vec![0.0; env.spec().action_dim()];
    let player = |seed| {
        let mut env = env.clone();
        env.reset(Some(seed));
        Player { env, actor: job.policy.actor(seed), action: action.clone() }
    };
    let mut players: Vec<_> = (0..u64::from(job.envs)).map(player).collect();
    let threads = job.threads.min(job.envs) as usize;
    let share = players.len().div_ceil(threads);
    let shares = players.len().div_ceil(share);
    let (ready, go) = (Barrier::new(shares + 1), Barrier::new(shares + 1));
    let work = |players: &mut [Player]| -> Result<u64, StepError> {
        let warmed = job.warm_up(|| players.iter_mut().try_for_each(Player::step));
        for player in players.iter_mut() {
            player.env.reset(None);
        }
        ready.wait();
        go.wait();
        warmed?;
        let rounds = job.rounds(|| players.iter_mut().try_for_each(Player::step))?;
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
