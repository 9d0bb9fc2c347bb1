//! Environments in a server, stepped by clients in this process: a thread and a connection of its own
//! for each.

use std::sync::Barrier;
use std::thread;

use trocar_client::{Autoreset, CallError, Client, Reply, Session, SessionRequest};

use super::{Job, Measured, Stopwatch};
use crate::policy::Actor;
use crate::process::OwnServer;

/// A session and who acts in it.
struct Player {
    session: Session,
    actors: Vec<Actor>,
    actions: Vec<f32>,
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
        let seeds = request.seed..request.seed + u64::from(job.envs);
        let actors = seeds.map(|seed| job.policy.actor(seed)).collect();
        let actions = vec![0.0; session.envs() * session.spec().action_dim()];
        let mut player = Self { session, actors, actions };
        player.reset()?;
        Ok(player)
    }

    fn reset(&mut self) -> Result<(), CallError> {
        let reply = self.session.reset()?;
        act(&mut self.actors, &reply, &mut self.actions);
        Ok(())
    }

    fn step(&mut self) -> Result<(), CallError> {
        let reply = self.session.step(&self.actions)?;
        act(&mut self.actors, &reply, &mut self.actions);
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
        let warmed = job.warm_up(|| player.step()).and_then(|()| player.reset());
        ready.wait();
        go.wait();
        warmed?;
        Ok(job.rounds(|| player.step())? * u64::from(job.envs))
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

/// Chooses the actions for the states of `reply`.
fn act(actors: &mut [Actor], reply: &Reply, actions: &mut [f32]) {
    let dim = actions.len() / actors.len();
    let rows = actions.chunks_mut(dim).zip(reply.expert_action().chunks(dim));
    for (actor, (action, expert)) in actors.iter_mut().zip(rows) {
        actor.act(action, |action| action.copy_from_slice(expert));
    }
}
