//! Overshoot of moves that begin a few ticks after a set-point.

use super::*;

/// Greatest number of ticks between the latest set-point and the move.
const LATEST: usize = 8;

/// Joint positions of a PSM at rest with this yaw, rad; insertion in m.
fn yaw(angle: f64) -> Vec<f64> {
    vec![angle, 0.0, 0.12, 0.0, 0.0, 0.0]
}

fn servo(angle: f64) -> Command {
    Command::ServoJp { position: yaw(angle), velocity: vec![] }
}

/// Overshoot of yaw and jaw, rad, in the directions `ways`, during a move to the present position.
fn past(script: &mut Script, ways: [f64; 2]) -> [f64; 2] {
    let there = [script.joints()[0], script.jaw()];
    script.send(Command::MoveJp(yaw(there[0])));
    let mut past: [f64; 2] = [0.0; 2];
    while script.arm.operating_state().is_busy {
        // The set-points before tell no velocity, so that the first tick's acceleration is not known.
        script.arm.tick();
        script.listen();
        let moved = [script.joints()[0] - there[0], script.jaw() - there[1]];
        past = [0, 1].map(|axis| past[axis].max(moved[axis] * ways[axis]));
    }
    past
}

#[test]
fn a_step_is_no_velocity_of_a_move() {
    for step in [-0.05, 0.05, 0.2] {
        for ticks in 1..=LATEST {
            let mut script = Script::psm();
            script.wait(Command::JawMoveJp(vec![0.6])).unwrap();
            script.run(0.1);
            script.send(servo(step));
            script.send(Command::JawServoJp(vec![0.6 + step]));
            script.run(ticks as f64 * TICK);
            let past = past(&mut script, [step.signum(); 2]);
            assert!(past[0] < 1e-3 && past[1] < 5e-3, "{step} rad, {ticks} ticks: {past:?}");
        }
    }
}

#[test]
fn slow_loops_are_steps_and_fast_ones_have_a_velocity() {
    let speed = 0.5;
    let braking = speed * speed / (2.0 * 90.0 * DEGREE);
    for (hertz, expected) in [
        (10.0, [0.0, 1e-3]),
        (20.0, [0.0, 1e-3]),
        (50.0, [0.9 * braking, 1.1 * braking]),
        (100.0, [0.8 * braking, 1.2 * braking]),
        (200.0, [0.8 * braking, 1.2 * braking]),
    ] {
        let mut script = Script::psm();
        let mut next = 0.0;
        for tick in 0..ticks(1.0) {
            if tick as f64 * TICK * hertz >= next {
                script.send(servo(speed * next / hertz));
                next += 1.0;
            }
            script.tick();
        }
        let [past, _] = past(&mut script, [1.0; 2]);
        assert!(past >= expected[0] && past <= expected[1], "{hertz} Hz: {past} rad");
    }
}

#[test]
fn a_velocity_that_was_asked_for_counts_at_once() {
    let mut script = Script::psm();
    script.send(Command::ServoJv(vec![0.5, 0.0, 0.0, 0.0, 0.0, 0.0]));
    script.tick();
    let [past, _] = past(&mut script, [1.0; 2]);
    assert!((past - 0.25 / (2.0 * 90.0 * DEGREE)).abs() < 2e-3, "{past} rad");
}
