//! Episodes in a server: a session whose environments take the next episode as theirs end.

use std::collections::BTreeMap;
use std::thread;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use trocar_client::{Autoreset, Client, Reply, SessionRequest};
use trocar_network::Seen;

use super::{Episode, Job};
use crate::policy::Player;

/// An episode under way in one environment.
struct Running {
    k: u32,
    player: Player,
    episode: Episode,
    action: Vec<f32>,
}

impl Running {
    /// Chooses the action for the state in row `row`.
    fn act(&mut self, reply: &Reply, row: usize) -> anyhow::Result<()> {
        fn part(rows: &[f32], row: usize, dim: usize) -> &[f32] {
            &rows[row * dim..(row + 1) * dim]
        }
        let spec = reply.spec();
        let expert = part(reply.expert_action(), row, self.action.len());
        let seen = Seen {
            observation: part(reply.observation(), row, spec.observation_dim()),
            achieved: part(reply.achieved_goal(), row, spec.goal_dim()),
            desired: part(reply.desired_goal(), row, spec.goal_dim()),
        };
        self.player.act(&seen, &mut self.action, |action| action.copy_from_slice(expert))
    }

    /// Takes down the step in row `row`; whether the episode ended with it.
    fn take_down(&mut self, reply: &Reply, row: usize) -> bool {
        if reply.fault()[row] == 0 {
            self.episode.step(reply.reward()[row], reply.is_success()[row] == 1);
        } else {
            self.episode.fail();
        }
        reply.terminated()[row] == 1 || reply.truncated()[row] == 1
    }
}

/// Runs all episodes of a job, in order.
pub(super) fn run(
    client: &Client,
    job: &Job<'_>,
    progress: &ProgressBar,
) -> anyhow::Result<Vec<Episode>> {
    let envs = job.envs.min(job.episodes);
    let request = SessionRequest::new(job.task)
        .envs(envs)
        .autoreset(Autoreset::Disabled)
        .options(job.options.clone());
    let mut session = client.open(&request)?;
    session.want_expert(job.policy.asks_expert());
    let dim = session.spec().action_dim();
    let step = Duration::from_secs_f64(session.spec().seconds_per_step);

    let mut done = vec![Episode::default(); job.episodes as usize];
    let mut next = 0;
    let mut due = Instant::now();
    // By environment, and so in the order in which a request names them.
    let mut running: BTreeMap<u32, Running> = BTreeMap::new();
    loop {
        let idle = (0..envs).filter(|env| !running.contains_key(env));
        let begun: Vec<(u32, u32)> = idle.zip(next..job.episodes).collect();
        if !begun.is_empty() {
            next += begun.len() as u32;
            let (env_ids, seeds): (Vec<_>, Vec<_>) =
                begun.iter().map(|(env, k)| (*env, job.seed_of(*k))).unzip();
            let reply = session.reset_envs(&env_ids, Some(&seeds))?;
            for (row, (env, k)) in begun.into_iter().enumerate() {
                let player = job.policy.player(seeds[row]);
                let action = vec![0.0; dim];
                let mut begun = Running { k, player, episode: Episode::default(), action };
                begun.act(&reply, row)?;
                running.insert(env, begun);
            }
        }
        if running.is_empty() {
            return Ok(done);
        }
        let env_ids: Vec<u32> = running.keys().copied().collect();
        let actions: Vec<f32> =
            running.values().flat_map(|running| &running.action).copied().collect();
        if job.lifelike {
            due += step;
            thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        session.send(&env_ids, &actions)?;
        let reply = session.recv()?;
        for (row, env) in env_ids.iter().enumerate() {
            let current = running.get_mut(env).expect("it was stepped");
            if current.take_down(&reply, row) {
                done[current.k as usize] = current.episode;
                running.remove(env);
                progress.inc(1);
            } else {
                current.act(&reply, row)?;
            }
        }
    }
}
