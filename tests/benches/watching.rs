//! What it costs a trainer that its session is watched. Sessions of the same task, seed and actions take the
//! same steps in turns. There are four: of a server without a viewer, of a server with a viewer that no page
//! uses, watched live, and watched by episodes. Prints the median of the time for each over the first's in the
//! same round, by the clock and by the server's CPU time, painting included.
//!
//! The watching page is a plain WebSocket client: a browser, which needs much more, is usually on another
//! machine.
//!
//! `cargo bench -p trocar-tests --bench watching -- [TASK [ENVS [ROUNDS]]]`

#![expect(clippy::print_stdout, reason = "a table is what it is for")]

#[allow(dead_code, clippy::unwrap_used)] // Made for the tests, which need more of it.
#[path = "../harness.rs"]
mod harness;

use std::fs;
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use trocar_client::{Autoreset, Session, SessionRequest};
use tungstenite::{Message, WebSocket};

/// About how long each session steps in a round.
const ROUND_PART: Duration = Duration::from_millis(400);

const NAMES: [&str; 4] = ["without a viewer", "nobody looks", "watched live", "episodes watched"];

fn main() {
    let arguments: Vec<_> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let task = arguments.first().map_or("NeedlePick-v0", String::as_str);
    let number = |index: usize, default: u32| -> u32 {
        arguments.get(index).map_or(default, |word| word.parse().expect("a number"))
    };
    let (envs, rounds) = (number(1, 16), number(2, 30));
    let port =
        TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a port").port();
    let mut plain = harness::Server::start();
    let mut viewed = harness::Server::start_with(&["--threads", "2", "--view", &port.to_string()]);
    let request = SessionRequest::new(task).envs(envs).seed(1).autoreset(Autoreset::NextStep);
    let open = |server: &harness::Server| {
        let mut session = server.connect().open(&request).expect("the request is good");
        session.reset().expect("the server runs");
        session
    };
    let mut sessions = vec![open(&plain)];
    sessions.extend((1..NAMES.len()).map(|_| open(&viewed)));
    for (session, pace) in [(2, "live"), (3, "episodes")] {
        watch(port, session, pace);
    }

    let mut actions: Vec<_> = NAMES.iter().map(|_| ChaCha8Rng::seed_from_u64(9)).collect();
    let mut steps = 8;
    let start = Instant::now();
    run(&mut sessions[0], &mut actions[0], steps);
    let longer = ROUND_PART.as_secs_f64() / start.elapsed().as_secs_f64();
    for index in 1..NAMES.len() {
        run(&mut sessions[index], &mut actions[index], steps);
    }
    steps = ((f64::from(steps) * longer) as u32).max(1);
    let pids = [plain.process().pid(), viewed.process().pid()];
    let mut ratios = vec![vec![]; NAMES.len()];
    let mut rates = vec![];
    for round in 0..rounds as usize {
        let mut times = [[0.0; 2]; NAMES.len()];
        for turn in 0..NAMES.len() {
            let which = (round + turn) % NAMES.len();
            let pid = pids[usize::from(which > 0)];
            let (start, computed) = (Instant::now(), cpu_seconds(pid));
            run(&mut sessions[which], &mut actions[which], steps);
            let elapsed = start.elapsed().as_secs_f64();
            // What is still to be drawn belongs to this turn.
            std::thread::sleep(Duration::from_millis(60));
            times[which] = [elapsed, cpu_seconds(pid) - computed];
        }
        rates.push(f64::from(steps * envs) / times[0][0]);
        for (ratios, time) in ratios.iter_mut().zip(times) {
            ratios.push([0, 1].map(|kind| time[kind] / times[0][kind]));
        }
    }
    println!(
        "{task}, {envs} environments, {rounds} rounds of {steps} steps, {:.0} steps/s",
        median(rates)
    );
    for (name, ratios) in NAMES.iter().zip(&ratios).skip(1) {
        let by = |kind: usize| median(ratios.iter().map(|ratio| ratio[kind]).collect());
        println!("{name:>18}: time {:.3}, CPU time {:.3} of that without a viewer", by(0), by(1));
    }
    drop(sessions);
}

/// Steps all environments of a session with random actions.
fn run(session: &mut Session, rng: &mut ChaCha8Rng, steps: u32) {
    let mut actions = vec![0.0; session.envs() * session.spec().action_dim()];
    for _ in 0..steps {
        actions.fill_with(|| rng.random_range(-1.0..=1.0));
        session.step(&actions).expect("the server runs");
    }
}

/// A page that watches an environment of a session, and takes whatever comes.
fn watch(port: u16, session: u64, pace: &'static str) {
    let stream = TcpStream::connect(("127.0.0.1", port)).expect("the viewer listens");
    let address = format!("ws://127.0.0.1:{port}/live");
    let (mut page, _) = tungstenite::client::client(address, stream).expect("it is a viewer");
    let say = |page: &mut WebSocket<TcpStream>, command: &Value| {
        page.send(Message::text(command.to_string())).is_ok()
    };
    // Numbers of sessions begin with 1, in the order in which they were opened.
    say(&mut page, &json!({"watch": {"session": session, "env": 0, "pace": pace}}));
    std::thread::spawn(move || {
        let mut asked = Instant::now();
        while page.read().is_ok() {
            // A page that plays episodes at the speed of life asks for one every ten seconds; this one every
            // second.
            if pace == "episodes" && asked.elapsed().as_secs() >= 1 {
                asked = Instant::now();
                say(&mut page, &json!("more"));
            }
        }
    });
}

/// CPU time that a process has used, s.
fn cpu_seconds(pid: u32) -> f64 {
    let threads = fs::read_dir(format!("/proc/{pid}/task")).expect("it runs");
    let spent = |entry: std::io::Result<fs::DirEntry>| {
        let text = fs::read_to_string(entry.ok()?.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse::<f64>().ok()
    };
    threads.filter_map(spent).sum::<f64>() / 1e9
}

fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers[numbers.len() / 2]
}
