//! How much faster than life a script runs that servoes an arm at 100 Hz in lock-step: through a server process on one
//! thread, one message for each command. `server/benches/live.rs` measures the same without messages.
//!
//! `cargo bench -p trocar-tests --bench live`

#[allow(dead_code, clippy::unwrap_used)] // Made for the tests, which need more of it.
#[path = "../harness.rs"]
mod harness;

use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput};
use trocar_client::proto::dvrk::{
    Command, Homing, LiveRequest, PoseMessage, StateCommand, TICKS_PER_SECOND,
};
use trocar_client::{LiveWorld, Options, SessionRequest};

const ARM: &str = "PSM1";

/// Commands in one measured batch: a circle that takes 5 s.
const COMMANDS: u64 = 500;

/// Radius of the circle, m.
const RADIUS: f64 = 0.01;

/// Servoes the wrist round a circle, level and 100 times a second.
fn run(world: &mut LiveWorld, start: &PoseMessage) {
    for command in 0..COMMANDS {
        let angle = std::f64::consts::TAU * command as f64 / COMMANDS as f64;
        let (sin, cos) = angle.sin_cos();
        let mut goal = start.clone();
        goal.position[0] += RADIUS * (1.0 - cos);
        goal.position[1] += RADIUS * sin;
        world.command(ARM, &Command::ServoCp(goal)).expect("the world has the arm");
        let until = |commands: u64| commands * TICKS_PER_SECOND / 100;
        let ticks = until(command + 1) - until(command);
        world.advance(ticks as u32).expect("the server runs");
        while world.next_event().is_some() {}
    }
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let server = harness::Server::start_with(&["--threads", "1"]);
    let mut group = criterion.benchmark_group("live");
    group.throughput(Throughput::Elements(COMMANDS)).sample_size(20);
    for (name, task, start) in [
        ("empty", "NeedleReach-v0", None),
        ("lies", "NeedlePick-v0", None),
        ("held", "NeedlePick-v0", Some("lift")),
    ] {
        let mut options = Options::new();
        if let Some(start) = start {
            options = options.with_text("start", start);
        }
        let live = LiveRequest { homing: Homing::InPlace, ..LiveRequest::default() };
        let request = SessionRequest::new(task).options(options).live(live);
        let mut world = server.connect().open_live(&request).expect("the request is good");
        for word in [StateCommand::Enable, StateCommand::Home] {
            world.command(ARM, &Command::State(word)).expect("the world has the arm");
        }
        world.advance(240).expect("the server runs");
        let [x, y, z, i, j, k, w] = world.arm(ARM).expect("the world has the arm").setpoint_cp;
        let (frame, position, orientation) = (String::new(), [x, y, z], [i, j, k, w]);
        let start = PoseMessage { frame, position, orientation };
        let (mut commands, mut taken) = (0, Duration::ZERO);
        group.bench_function(BenchmarkId::new("servo", name), |bencher| {
            bencher.iter_custom(|batches| {
                let began = Instant::now();
                (0..batches).for_each(|_| run(&mut world, &start));
                commands += batches * COMMANDS;
                taken += began.elapsed();
                began.elapsed()
            });
        });
        let times = commands as f64 / 100.0 / taken.as_secs_f64();
        eprintln!("{name}: {times:.0} times as fast as life");
    }
    group.finish();
    criterion.final_summary();
}
