//! Environments in a server, stepped by clients in this process: a thread and a connection of its own
//! for each.

use std::sync::Barrier;
use std::thread;

use trocar_client::{Autoreset, CallError, Client, Session, SessionRequest};

use super::{BEGINNINGS, Job, Measured, Stopwatch};
use crate::process::OwnServer;

/// A session, and the expert's actions in it.
struct Player {
    /// Number of its client.
    number: u32,
    session: Session,
    seed: u64,
    expert: Vec<f32>,
}

impl Player {
    /// Opens the session of the client of this number.
    fn open(client: &Client, job: &Job, number: u32) -> Result<Self, CallError> {
        let request = SessionRequest::new(&job.task)
            .envs(job.envs)
            .seed(u64::from(number * job.envs))
            .autoreset(Autoreset::SameStep)
            .options(job.options.clone());
        let mut session = client.open(&request)?;
        session.want_expert(job.policy.asks_expert());
        let expert = vec![0.0; session.envs() * session.spec().action_dim()];
        let mut player = Self { number, session, seed: request.seed, expert };
        for round in 0..u64::from(BEGINNINGS.div_ceil(job.envs)) {
            player.reset_from(round * u64::from(job.envs))?;
        }
        player.reset()?;
        Ok(player)
    }

    /// Begins the episodes that are measured.
    fn reset(&mut self) -> Result<(), CallError> {
        self.reset_from(self.seed)
    }

    /// Begins an episode in every environment, from seeds that count up.
    fn reset_from(&mut self, seed: u64) -> Result<(), CallError> {
        let seeds: Vec<_> = (seed..).take(self.session.envs()).collect();
        self.session.start_reset(None, Some(&seeds))?;
        let reply = self.session.recv()?;
        self.expert.copy_from_slice(reply.expert_action());
        Ok(())
    }

    /// Steps by the actions of a round, or by the expert's.
    fn step(&mut self, round: Option<&[f32]>) -> Result<(), CallError> {
        let reply = self.session.step(round.unwrap_or(&self.expert))?;
        if round.is_none() {
            self.expert.copy_from_slice(reply.expert_action());
        }
        Ok(())
    }
}

/// Measures a job.
pub(super) fn run(server: &OwnServer, job: &Job) -> anyhow::Result<Measured> {
    let open = |number| {
        let client = Client::connect(server.name())?;
        anyhow::Ok(Player::open(&client, job, number)?)
    };
    let mut players = (0..job.clients).map(open).collect::<Result<Vec<_>, _>>()?;
    let (ready, go) = (Barrier::new(players.len() + 1), Barrier::new(players.len() + 1));
    let work = |player: &mut Player| -> Result<u64, CallError> {
        let number = player.number;
        let warmed = job.warm_up(|round| player.step(job.actions(number, round)));
        let warmed = warmed.and_then(|()| player.reset());
        ready.wait();
        go.wait();
        warmed?;
        Ok(job.rounds(|round| player.step(job.actions(number, round)))? * u64::from(job.envs))
    };
    thread::scope(|scope| {
        let work = &work;
        let clients: Vec<_> =
            players.iter_mut().map(|player| scope.spawn(move || work(player))).collect();
        ready.wait();
        let watch = Stopwatch::start(&[std::process::id(), server.pid()]);
        go.wait();
        let join = |client: thread::ScopedJoinHandle<'_, _>| {
            client.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        let steps = clients.into_iter().map(join).sum::<Result<u64, CallError>>()?;
        watch?.stop(steps)
    })
}
