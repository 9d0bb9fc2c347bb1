//! A client process for the tests: `trocar-test-client ROLE SERVER`. It prints `ready` once it does
//! what its role says, and what it has found out; the roles are listed in `main`.

mod rows;

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::time::Duration;

use anyhow::{Result, bail};
use rows::{Digest, Row, act, policies};
use trocar_client::proto::dvrk::{Command, LiveRequest, StateCommand};
use trocar_client::{Autoreset, CallError, Client, ConnectError, Session, SessionRequest};

/// Environments of each session.
const ENVS: u32 = 4;

/// What happens at the end of an episode.
const MODE: Autoreset = Autoreset::NextStep;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [role, server] = arguments.as_slice() else { bail!("usage: ROLE SERVER") };
    match role.as_str() {
        "connect" => connect(server),
        "open" => open_for_ever(server),
        "churn" => churn(server),
        "fill" => fill(server),
        "open-anyway" => open_anyway(server),
        "greedy" => open_without_end(server),
        "fifty" => open_fifty(server),
        "step" => step_for_ever(server),
        "hold" => hold_replies(server),
        "in-flight" => leave_in_flight(server),
        "until-lost" => step_until_lost(server),
        "until-told" => step_until_told(server),
        "digest" => digest(server),
        "faulted" => live_through_a_fault(server),
        "drive" => drive(server),
        "private" => use_private_server(),
        _ => bail!("unknown role {role}"),
    }
}

/// Connects, and no more.
fn connect(server: &str) -> Result<()> {
    let _client = Client::connect(server)?;
    say("ready")?;
    await_end_of_input()
}

/// Shares the live world of the server's first session, and drives its first arm on a long way.
fn drive(server: &str) -> Result<()> {
    let client = Client::connect(server)?;
    let status = client.status()?;
    let Some(first) = status.sessions.first() else { bail!("there is no session") };
    let live = LiveRequest { world: Some(first.id), ..LiveRequest::default() };
    let mut world = client.open_live(&SessionRequest::new(&first.task).live(live))?;
    let arm = world.live().arms[0].name.clone();
    for word in [StateCommand::Enable, StateCommand::Home] {
        world.command(&arm, &Command::State(word))?;
    }
    world.advance(720)?;
    world.command(&arm, &Command::MoveJp(vec![1.0, 0.0, 0.12, 0.0, 0.0, 0.0]))?;
    world.advance(60)?;
    say("ready")?;
    await_end_of_input()
}

/// Opens one session after the other.
fn open_for_ever(server: &str) -> Result<()> {
    let client = Client::connect(server)?;
    say("ready")?;
    loop {
        drop(client.open(&request())?);
    }
}

/// Opens and closes 200 sessions, prints the number of this process's open files, and does so
/// again for each line of input.
fn churn(server: &str) -> Result<()> {
    let client = Client::connect(server)?;
    loop {
        for _ in 0..200 {
            client.open(&request())?.reset()?;
        }
        while !client.status()?.sessions.is_empty() {
            std::thread::sleep(Duration::from_millis(1));
        }
        // Threads of sessions that were closed just now still end.
        std::thread::sleep(Duration::from_millis(500));
        say(&std::fs::read_dir("/proc/self/fd")?.count().to_string())?;
        if std::io::stdin().read_line(&mut String::new())? == 0 {
            return Ok(());
        }
    }
}

/// Opens sessions until one is refused, prints why, and lets all of them use what they were given.
fn fill(server: &str) -> Result<()> {
    let client = connect_when_there(server)?;
    let mut sessions = vec![];
    let refusal = loop {
        match client.open(&SessionRequest::new("NeedleReach-v0").envs(256)) {
            Ok(session) => sessions.push(session),
            Err(CallError::Refused(refusal)) => break refusal,
            Err(error) => bail!(error),
        }
    };
    say(&refusal.to_string())?;
    for session in &mut sessions {
        let mut held = vec![session.reset()?];
        let actions = vec![0.5; session.envs() * session.spec().action_dim()];
        // As many replies as may be held, so that every buffer is written to.
        while let Ok(reply) = session.step(&actions) {
            held.push(reply);
        }
    }
    say("all stepped")
}

/// Connects, opens, steps and closes until its input ends, whatever is refused; prints how often that went well and how
/// often it did not, and the errors that do not name shared memory.
fn open_anyway(server: &str) -> Result<()> {
    say("ready")?;
    let over = std::thread::spawn(await_end_of_input);
    let (mut stepped, mut refused) = (0, 0);
    while !over.is_finished() {
        match open(server).and_then(|mut session| {
            let actions = vec![0.5; session.envs() * session.spec().action_dim()];
            Ok(session.step(&actions)?.steps().len())
        }) {
            Ok(_) => stepped += 1,
            Err(error) => {
                refused += 1;
                let said = format!("{error:#}");
                if !["/dev/shm", "space"].iter().any(|name| said.contains(name)) {
                    say(&said)?;
                }
            }
        }
    }
    say(&format!("{stepped} {refused}"))
}

/// Opens sessions until one is refused, prints why, and keeps them.
fn open_without_end(server: &str) -> Result<()> {
    let client = Client::connect(server)?;
    let mut sessions = vec![];
    let refusal = loop {
        match client.open(&SessionRequest::new("EcmReach-v0")) {
            Ok(session) => sessions.push(session),
            Err(CallError::Refused(refusal)) => break refusal,
            Err(error) => bail!(error),
        }
    };
    say(&refusal.to_string())?;
    await_end_of_input()
}

/// Opens fifty sessions, resets each, and keeps them.
fn open_fifty(server: &str) -> Result<()> {
    let client = Client::connect(server)?;
    let mut sessions = vec![];
    for _ in 0..50 {
        let mut session = client.open(&request())?;
        session.reset()?;
        sessions.push(session);
    }
    say("ready")?;
    await_end_of_input()
}

/// Connects to a server that may be starting.
fn connect_when_there(server: &str) -> Result<Client> {
    loop {
        match Client::connect(server) {
            Err(ConnectError::NoServer { .. }) => std::thread::sleep(Duration::from_millis(5)),
            other => return Ok(other?),
        }
    }
}

/// Steps without a pause.
fn step_for_ever(server: &str) -> Result<()> {
    let mut session = open(server)?;
    let actions = vec![0.5; session.envs() * session.spec().action_dim()];
    say("ready")?;
    loop {
        session.step(&actions)?;
    }
}

/// Steps, and keeps the last three replies.
fn hold_replies(server: &str) -> Result<()> {
    let mut session = open(server)?;
    let actions = vec![0.5; session.envs() * session.spec().action_dim()];
    let mut held = VecDeque::new();
    for _ in 0..10 {
        held.push_back(session.step(&actions)?);
        if held.len() > 3 {
            held.pop_front();
        }
    }
    say("ready")?;
    await_end_of_input()
}

/// Sends two requests whose replies it never takes.
fn leave_in_flight(server: &str) -> Result<()> {
    let mut session = open(server)?;
    let action = vec![0.5; session.spec().action_dim()];
    session.send(&[0], &action)?;
    session.send(&[1], &action)?;
    say("ready")?;
    await_end_of_input()
}

/// Steps until the server is gone, and says how it went.
fn step_until_lost(server: &str) -> Result<()> {
    let mut session = open(server)?;
    let actions = vec![0.5; session.envs() * session.spec().action_dim()];
    say("ready")?;
    loop {
        match session.step(&actions) {
            Ok(_) => {}
            Err(CallError::ServerLost { closed, .. }) => {
                return say(if closed { "closed" } else { "died" });
            }
            Err(error) => bail!(error),
        }
    }
}

/// Takes one step for each line of input, and says what came of it.
fn step_until_told(server: &str) -> Result<()> {
    let mut session = open(server)?;
    let actions = vec![0.5; session.envs() * session.spec().action_dim()];
    say("ready")?;
    for line in std::io::stdin().lines() {
        line?;
        match session.step(&actions) {
            Ok(_) => say("stepped")?,
            Err(error) => say(&error.to_string())?,
        }
    }
    Ok(())
}

/// Prints a number that stands for every bit of a trajectory.
fn digest(server: &str) -> Result<()> {
    let mut session = open(server)?;
    let mut policies = policies(0, session.envs());
    let mut digest = Digest::default();
    // `open` began episode 0 of every seed; this begins it again.
    let mut rows = Row::all(&session.reset_envs(&[0, 1, 2, 3], Some(&[0, 1, 2, 3]))?, MODE);
    digest.add(&rows);
    for _ in 0..Digest::STEPS {
        let actions = act(&mut policies, &rows);
        rows = Row::all(&session.step(&actions)?, MODE);
        digest.add(&rows);
    }
    say(&digest.text())?;
    await_end_of_input()
}

/// Waits for a line, so that what happens from then on can be disturbed; then lives as `digest` does, and closes all.
fn live_through_a_fault(server: &str) -> Result<()> {
    say("ready")?;
    std::io::stdin().read_line(&mut String::new())?;
    digest(server)
}

/// Opens a session on the private server of the process tree, and says which process serves it.
fn use_private_server() -> Result<()> {
    let client = Client::connect_private()?;
    let mut session = client.open(&request())?;
    session.reset()?;
    say(&format!("{} {}", client.server().name, client.server().pid))?;
    await_end_of_input()
}

fn request() -> SessionRequest {
    SessionRequest::new("EcmReach-v0").envs(ENVS)
}

/// A session that was reset once and wants the expert.
fn open(server: &str) -> Result<Session> {
    let mut session = Client::connect(server)?.open(&request())?;
    session.want_expert(true);
    session.reset()?;
    Ok(session)
}

fn await_end_of_input() -> Result<()> {
    std::io::stdin().read_to_end(&mut Vec::new())?;
    Ok(())
}

fn say(line: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{line}")?;
    Ok(out.flush()?)
}
