//! Environments in a server, stepped by a client in this process.

use trocar_client::{Autoreset, CallError, Reply, Session, SessionRequest};

use super::{Job, Measured, Stopwatch};
use crate::policy::Actor;
use crate::process::OwnServer;

/// Measures a job.
pub(super) fn run(server: &OwnServer, job: &Job) -> anyhow::Result<Measured> {
    let request = SessionRequest::new(&job.task)
        .envs(job.envs)
        .autoreset(Autoreset::SameStep)
        .options(job.options.clone());
    let mut session = server.client().open(&request)?;
    session.want_expert(job.policy.asks_expert());
    let mut actors: Vec<_> = (0..u64::from(job.envs)).map(|seed| job.policy.actor(seed)).collect();
    let mut actions = vec![0.0; job.envs as usize * session.spec().action_dim()];

    let reply = session.reset()?;
    act(&mut actors, &reply, &mut actions);
    drop(reply);
    job.warm_up(|| step(&mut session, &mut actors, &mut actions))?;
    let reply = session.reset()?;
    act(&mut actors, &reply, &mut actions);
    drop(reply);
    let watch = Stopwatch::start(&[std::process::id(), server.pid()])?;
    let rounds = job.rounds(|| step(&mut session, &mut actors, &mut actions))?;
    watch.stop(rounds * u64::from(job.envs))
}

fn step(session: &mut Session, actors: &mut [Actor], actions: &mut [f32]) -> Result<(), CallError> {
    let reply = session.step(actions)?;
    act(actors, &reply, actions);
    Ok(())
}

/// Chooses the actions for the states of `reply`.
fn act(actors: &mut [Actor], reply: &Reply, actions: &mut [f32]) {
    let dim = actions.len() / actors.len();
    let rows = actions.chunks_mut(dim).zip(reply.expert_action().chunks(dim));
    for (actor, (action, expert)) in actors.iter_mut().zip(rows) {
        actor.act(action, |action| action.copy_from_slice(expert));
    }
}
