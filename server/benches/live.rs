//! How much faster than life a live world runs on one core whose arm is servoed at 100 Hz, in lock-step and in-process.
//!
//! `cargo bench -p trocar-server --bench live` reports ticks per second of an arm over a needle that lies, and of one that
//! holds it; 240 ticks are a second of life.

use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use trocar_proto::Options;
use trocar_server::Registry;
use trocar_server::dvrk::{
    ArmController, Command, Homing, Pose, PoseMessage, StateCommand, TICK, TICKS_PER_SECOND,
};
use trocar_server::env::LiveWorld;

const ARM: &str = "PSM1";

/// Ticks in one measured batch: a circle that takes 5 s.
const TICKS: u64 = 5 * TICKS_PER_SECOND;

/// Radius of the circle, m.
const RADIUS: f64 = 0.01;

fn command(world: &mut LiveWorld, command: &Command) {
    world.arm_mut(ARM).expect("the task has it").command(command);
}

/// Servoes the wrist round a circle, level and 100 times a second.
fn run(world: &mut LiveWorld, start: &Pose) {
    for tick in 0..TICKS {
        if tick * 100 / TICKS_PER_SECOND > tick.saturating_sub(1) * 100 / TICKS_PER_SECOND {
            let angle = std::f64::consts::TAU * tick as f64 / TICKS as f64;
            let (sin, cos) = angle.sin_cos();
            let goal = Pose::translation(RADIUS * (1.0 - cos), RADIUS * sin, 0.0) * start;
            command(world, &Command::ServoCp(PoseMessage::new(&goal)));
        }
        world.tick().expect("nothing explodes");
        world.arm_mut(ARM).expect("the task has it").take_events();
    }
}

fn servo(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("live");
    group.throughput(Throughput::Elements(TICKS)).sample_size(20);
    let mut lines = vec![];
    for (name, start) in [("lies", "reset"), ("held", "lift")] {
        let options = Options::new().with_text("start", start);
        let mut env = Registry::builtin().make("NeedlePick-v0", &options).expect("a task");
        env.reset(Some(0));
        let mut world = LiveWorld::new(env, Homing::InPlace).expect("it was reset");
        for word in [StateCommand::Enable, StateCommand::Home] {
            command(&mut world, &Command::State(word));
            for _ in 0..TICKS_PER_SECOND {
                world.tick().expect("nothing explodes");
            }
        }
        let start = world.arm(ARM).and_then(ArmController::setpoint_cp).expect("it has a tool");
        let (mut ticks, mut taken) = (0, Duration::ZERO);
        group.bench_function(BenchmarkId::new("servo", name), |bencher| {
            bencher.iter_custom(|batches| {
                let began = Instant::now();
                (0..batches).for_each(|_| run(&mut world, &start));
                ticks += batches * TICKS;
                taken += began.elapsed();
                began.elapsed()
            });
        });
        let times = ticks as f64 * TICK / taken.as_secs_f64();
        lines.push(format!("needle {name}: {times:.0} times as fast as life"));
    }
    group.finish();
    for line in lines {
        eprintln!("{line}");
    }
}

criterion_group!(benches, servo);
criterion_main!(benches);
