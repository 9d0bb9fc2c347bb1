//! Episodes in this process: every thread takes the next one that no other has taken.

use std::num::NonZero;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;

use indicatif::ProgressBar;
use trocar_server::Env;
use trocar_server::Registry;

use crate::policy::Chooser;

use super::{Episode, Job};

/// Runs all episodes of a job, in order.
pub(super) fn run(
    registry: &Registry,
    job: &Job<'_>,
    progress: &ProgressBar,
) -> anyhow::Result<Vec<Episode>> {
    let env = registry.make(job.task, &job.options)?;
    let cores = thread::available_parallelism().map_or(1, NonZero::get) as u32;
    let threads = cores.min(job.envs).min(job.episodes);
    let next = AtomicU32::new(0);
    let work = || -> anyhow::Result<Vec<(u32, Episode)>> {
        let (mut env, policy) = (env.clone(), job.policy.twin());
        let mut done = Vec::new();
        loop {
            let k = next.fetch_add(1, Ordering::Relaxed);
            if k >= job.episodes {
                return Ok(done);
            }
            done.push((k, episode(&mut env, &policy, job.seed_of(k))?));
            progress.inc(1);
        }
    };
    let results: Vec<_> = thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let join = |worker: thread::ScopedJoinHandle<'_, _>| {
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        workers.into_iter().map(join).collect()
    });
    let mut episodes = results.into_iter().collect::<Result<Vec<_>, _>>()?.concat();
    episodes.sort_by_key(|(k, _)| *k);
    Ok(episodes.into_iter().map(|(_, episode)| episode).collect())
}

fn episode(env: &mut Env, policy: &Chooser, seed: u64) -> anyhow::Result<Episode> {
    let mut episode = Episode::default();
    policy.play(env, seed, |_, step| {
        match step {
            Some(step) => episode.step(step.reward, step.is_success),
            None => episode.fail(),
        }
        Ok(())
    })?;
    Ok(episode)
}
