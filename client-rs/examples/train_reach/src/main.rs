//! Learns a task of goals from sparse rewards, in Rust: DDPG with hindsight replay ([`agent`], [`replay`])
//! on a server's environments.
//!
//! ```sh
//! cargo run --release -p train-reach                    # with a server of its own
//! trocar serve --name lab & cargo run --release -p train-reach -- --server lab --seed 2
//! ```
//!
//! It ends when 95 % of 100 held-out episodes succeed, or fails after `--epochs`. The same seed gives the
//! same numbers.

mod agent;
mod replay;

use std::time::Instant;

use agent::Agent;
use anyhow::{bail, ensure};
use clap::Parser;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use replay::{Episodes, Replay};
use trocar_client::{Client, Reply, Session, SessionRequest};

/// Share of episodes that must end in success.
const ENOUGH: f64 = 0.95;

/// Episodes in which a policy is scored, of these seeds and the following.
const HELD_OUT: u32 = 100;
const HELD_OUT_SEED: u64 = 1_000_000;

/// Episodes in an epoch, as in the paper.
const EPOCH: u32 = 40;

/// Updates for each episode, and after how many target networks move (`OpenAI` baselines' HER: 40 for two, then
/// a move).
const UPDATES: u32 = 20;
const FOLLOW: u32 = 40;

/// Transitions in each.
const BATCH: usize = 256;

#[derive(Debug, Parser)]
struct Arguments {
    /// A running server; one of its own by default
    #[arg(long)]
    server: Option<String>,
    #[arg(long, default_value = "NeedleReach-v0")]
    task: String,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Of 40 episodes, at most
    #[arg(long, default_value_t = 30)]
    epochs: u32,
    /// How many environments collect episodes
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=40))]
    envs: u32,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let client = match &arguments.server {
        Some(name) => Client::connect(name)?,
        None => Client::connect_private()?,
    };
    let request = SessionRequest::new(&arguments.task);
    let mut session = client.open(&request.clone().envs(arguments.envs).seed(arguments.seed))?;
    let mut held_out = client.open(&request.envs(HELD_OUT))?;
    let spec = session.spec().clone();
    ensure!(spec.goal.is_some(), "--task {}: it has no goals to learn from", arguments.task);

    let mut rng = ChaCha8Rng::seed_from_u64(arguments.seed);
    let mut agent = Agent::new(&spec, &mut rng)?;
    let mut replay = Replay::new(spec);
    let start = Instant::now();
    let mut reply = session.reset()?;
    let (mut episodes, mut updates) = (0, 0);
    for epoch in 1..=arguments.epochs {
        while episodes < epoch * EPOCH {
            reply = collect(&mut session, reply, &agent, &mut replay, &mut rng)?;
            episodes += arguments.envs;
            agent.see(&replay);
            for _ in 0..UPDATES * arguments.envs {
                agent.update(&replay.sample(BATCH, &mut rng))?;
                updates += 1;
                if updates % FOLLOW == 0 {
                    agent.follow()?;
                }
            }
        }
        let success = score(&mut held_out, &agent)?;
        eprintln!(
            "epoch {epoch:3}  {episodes:5} episodes  {updates:6} updates  {:5.0} s  success {:5.1} %",
            start.elapsed().as_secs_f64(),
            100.0 * success,
        );
        if success >= ENOUGH {
            return Ok(());
        }
    }
    bail!("--epochs {}: after these, success is still below {ENOUGH}", arguments.epochs)
}

/// Plays an episode in every environment, exploring, and returns the reply with which the next ones begin.
fn collect(
    session: &mut Session,
    mut reply: Reply,
    agent: &Agent,
    replay: &mut Replay,
    rng: &mut ChaCha8Rng,
) -> anyhow::Result<Reply> {
    let mut episodes = Episodes::begin(&reply);
    loop {
        let actions = agent.explore(reply.observation(), reply.desired_goal(), rng)?;
        reply = session.step(&actions)?;
        // Episodes are equally long, so all end at the same time.
        if reply.truncated()[0] == 1 {
            episodes.add(&actions, reply.final_observation(), reply.final_achieved_goal());
            replay.keep(episodes);
            return Ok(reply);
        }
        episodes.add(&actions, reply.observation(), reply.achieved_goal());
    }
}

/// The share of held-out episodes that end in success.
fn score(session: &mut Session, agent: &Agent) -> anyhow::Result<f64> {
    let ids: Vec<u32> = (0..HELD_OUT).collect();
    let seeds: Vec<u64> = (0..u64::from(HELD_OUT)).map(|index| HELD_OUT_SEED + index).collect();
    let mut reply = session.reset_envs(&ids, Some(&seeds))?;
    loop {
        let actions = agent.act(reply.observation(), reply.desired_goal())?;
        reply = session.step(&actions)?;
        if reply.truncated()[0] == 1 {
            let successes = reply.is_success().iter().map(|flag| u32::from(*flag)).sum::<u32>();
            return Ok(f64::from(successes) / f64::from(HELD_OUT));
        }
    }
}
