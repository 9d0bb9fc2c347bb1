//! What dVRK's own test scripts do (A1 to A14, B1 to B12 in comments), in live worlds over shared memory: times of the
//! closed form, limits at every tick, refusals.

use std::collections::BTreeMap;

use trocar_client::proto::dvrk::command::Fault;
use trocar_client::proto::dvrk::{Command, Event, Report, State, StateCommand, TICKS_PER_SECOND};
use trocar_client::{OptionValue, Options, SessionRequest};
use trocar_server::robots::Psm;

use crate::harness::Server;
use crate::live::{DEGREE, HOME, Script, moved, pose};

/// Fails unless moves took what the closed form says: up to two ticks more, each.
fn assert_took(took: f64, expected: f64, moves: f64) {
    let tick = 1.0 / TICKS_PER_SECOND as f64;
    // The closed form was written down to the millisecond.
    let allowed = expected - 1e-3..=expected + 2.0 * moves * tick + 1e-3;
    assert!(allowed.contains(&took), "it took {took} s, not {expected} s");
}

#[test]
fn moves_of_dvrks_test_scripts_take_the_times_of_the_closed_form() {
    let server = Server::start();
    let mut script = Script::new(&server, "NeedleReach-v0");
    let names: Vec<_> = script.world.live().arms.iter().map(|arm| arm.name.as_str()).collect();
    assert_eq!(names, ["PSM1", "ECM"]);
    script.enable_and_home("PSM1");
    // Homed again, every command is answered, and nothing moves.
    script.heard.clear();
    assert_eq!(script.carry_out("PSM1", &Command::State(StateCommand::Home)), 0.0);
    assert!(matches!(script.heard[..], [Event { report: Report::OperatingState(_), .. }]));

    // A3: a move to where the arm is.
    let took = script.carry_out("PSM1", &Command::MoveJp(HOME.to_vec()));
    assert!(took > 0.0 && took < 0.1, "{took}");
    // A5.
    let mut took = 0.0;
    for step in [10.0, -20.0, 10.0] {
        let to = [(0, step * DEGREE), (1, -step * DEGREE)];
        let goal = moved(&script.arm("PSM1").setpoint_position, &to);
        took += script.carry_out("PSM1", &Command::MoveJp(goal));
    }
    assert_took(took, 2.276, 3.0);
    // A8.
    for (axis, times) in [(0, [1.028, 1.454, 1.028]), (1, [1.067, 1.508, 1.067])] {
        let start = script.arm("PSM1").setpoint_cp;
        for (at, expected) in [-0.05, 0.05, 0.0].into_iter().zip(times) {
            let mut goal = start;
            goal[axis] += at;
            let took = script.carry_out("PSM1", &Command::MoveCp(pose(&goal)));
            assert_took(took, expected, 1.0);
            let is = script.arm("PSM1").measured_cp;
            assert!((0..3).all(|axis| (is[axis] - goal[axis]).abs() < 1e-5), "{is:?}");
        }
    }
    // A9.
    for (angle, expected) in [(-20.0, 0.333), (60.0, 0.667), (-20.0, 0.667), (60.0, 0.667)] {
        let jaw = Command::JawMoveJp(vec![angle * DEGREE]);
        assert_took(script.carry_out("PSM1", &jaw), expected, 1.0);
    }
    // A10: the insertion while the jaw moves.
    script.send("PSM1", &Command::jaw_close());
    script.world.look().unwrap();
    assert!(script.state("PSM1").is_busy);
    let goal = moved(&HOME, &[(2, -0.02)]);
    script.carry_out("PSM1", &Command::MoveJp(goal.clone()));
    let to = script.arm("PSM1").setpoint_position;
    assert_eq!((to[2], to[6]), (goal[2], -20.0 * DEGREE));
    // A14.
    script.carry_out("PSM1", &Command::MoveJp(HOME.to_vec()));
    script.send("PSM1", &Command::SetRatio(0.5));
    let goal = moved(&HOME, &[(0, 10.0 * DEGREE)]);
    assert_took(script.carry_out("PSM1", &Command::MoveJp(goal)), 0.943, 1.0);
    assert_eq!(script.arm("PSM1").ratio, 0.5);
    assert!(script.reached().iter().all(|reached| *reached));
    assert_eq!(script.complaints(), [] as [String; 0]);
    script.send("PSM1", &Command::SetRatio(1.5));
    script.advance(1);
    let complaints = script.complaints();
    assert!(complaints[0].contains("within ]0, 1]"), "{complaints:?}");
}

#[test]
fn servoed_set_points_are_followed() {
    let server = Server::start();
    let mut script = Script::new(&server, "NeedleReach-v0");
    script.enable_and_home("PSM1");
    // A4: five seconds at 100 Hz.
    let mut stamp = 0;
    for step in 0..500_u32 {
        let angle = std::f64::consts::TAU * f64::from(step) / 500.0;
        let by = 5.0 * DEGREE * (1.0 - angle.cos());
        let goal = moved(&HOME, &[(0, by), (1, by)]);
        script.send("PSM1", &Command::servo_jp(&goal));
        script.advance(if step % 5 < 3 { 2 } else { 3 });
        let arm = script.arm("PSM1");
        assert_eq!(arm.setpoint_position[..6], goal);
        assert_eq!(arm.measured_position, arm.setpoint_position);
        assert!(arm.stamp > stamp);
        stamp = arm.stamp;
    }
    // B8: a move that is held stops, and has not reached its goal.
    script.heard.clear();
    script.send("PSM1", &Command::MoveJp(moved(&HOME, &[(0, 1.0)])));
    script.advance(60);
    script.send("PSM1", &Command::Hold);
    script.advance(1);
    assert_eq!(script.reached(), [false]);
    let held = script.arm("PSM1").measured_position;
    script.advance(240);
    assert_eq!(script.arm("PSM1").measured_position, held);
    // B7, B1: an arm without power does not move, and says why.
    script.send("PSM1", &Command::State(StateCommand::Disable));
    script.send("PSM1", &Command::MoveJp(HOME.to_vec()));
    assert_eq!(script.wait("PSM1"), 0);
    let complaints = script.complaints();
    assert!(complaints[0].contains("arm not ready: it is DISABLED"), "{complaints:?}");
    assert_eq!(script.arm("PSM1").measured_position, held);
    // B6: a jump that the arm does not follow is a fault, from which it recovers.
    script.enable_and_home("PSM1");
    script.heard.clear();
    let start = script.arm("PSM1").measured_position;
    script.send("PSM1", &Command::servo_jp(&moved(&start[..6], &[(0, -60.0 * DEGREE)])));
    script.advance(2);
    assert_eq!(script.state("PSM1").state, State::Fault);
    let complaints = script.complaints();
    assert!(complaints[0].contains("tracking error: yaw"), "{complaints:?}");
    script.enable_and_home("PSM1");
    assert_eq!(script.state("PSM1").state, State::Enabled);
}

#[test]
fn servo_and_moves_follow_each_other_without_a_jump() {
    let server = Server::start();
    let mut script = Script::new(&server, "NeedleReach-v0");
    script.enable_and_home("PSM1");
    script.heard.clear();
    // A7: a diagonal of 40 mm.
    let start = script.arm("PSM1").setpoint_cp;
    for step in 0..500_u32 {
        let angle = std::f64::consts::TAU * f64::from(step) / 500.0;
        let mut goal = start;
        goal[0] += 0.02 * (1.0 - angle.cos());
        goal[1] += 0.02 * (1.0 - angle.cos());
        script.send("PSM1", &Command::ServoCp(pose(&goal)));
        script.advance(if step % 5 < 3 { 2 } else { 3 });
        let is = script.arm("PSM1").setpoint_cp;
        assert!((0..3).all(|axis| (is[axis] - goal[axis]).abs() < 1e-9), "{step}");
    }
    // A11: the jaw closes while the arm moves; both come to their ends.
    let mut goal = start;
    goal[0] -= 0.05;
    script.send("PSM1", &Command::MoveCp(pose(&goal)));
    script.advance(60);
    script.carry_out("PSM1", &Command::jaw_close());
    let arm = script.arm("PSM1");
    assert!((0..3).all(|axis| (arm.setpoint_cp[axis] - goal[axis]).abs() < 1e-5));
    assert_eq!(arm.setpoint_position[6], -20.0 * DEGREE);
    // A12: a jaw that is servoed, and then moved.
    script.carry_out("PSM1", &Command::jaw_open(50.0 * DEGREE));
    for step in 0..500_u32 {
        let angle = std::f64::consts::TAU * f64::from(step) / 500.0;
        let opening = (50.0 + 29.0 * angle.sin()) * DEGREE;
        script.send("PSM1", &Command::JawServoJp(vec![opening]));
        script.advance(if step % 5 < 3 { 2 } else { 3 });
        assert!((script.arm("PSM1").setpoint_position[6] - opening).abs() < 1e-12);
    }
    let before = script.arm("PSM1").setpoint_position[6];
    script.send("PSM1", &Command::jaw_close());
    script.advance(1);
    let step = (script.arm("PSM1").setpoint_position[6] - before).abs();
    assert!(step < 1080.0 * DEGREE / TICKS_PER_SECOND as f64, "{step}");
    script.wait("PSM1");
    // A13: another goal on the way: the velocity does not jump, and one move ends.
    script.carry_out("PSM1", &Command::MoveJp(HOME.to_vec()));
    script.heard.clear();
    script.send("PSM1", &Command::MoveJp(moved(&HOME, &[(0, 0.4)])));
    script.advance(48);
    script.send("PSM1", &Command::MoveJp(moved(&HOME, &[(0, -0.1)])));
    let mut velocity = script.arm("PSM1").setpoint_velocity[0];
    loop {
        script.advance(1);
        let now = script.arm("PSM1").setpoint_velocity[0];
        let most = 90.0 * DEGREE / TICKS_PER_SECOND as f64 + 1e-9;
        assert!((now - velocity).abs() <= most, "{velocity} to {now}");
        velocity = now;
        if !script.state("PSM1").is_busy {
            break;
        }
    }
    assert_eq!(script.reached(), [true]);
    // B3, B4, B5: what is out of reach is clipped, and counts as reached.
    let far = moved(&HOME, &[(0, 120.0 * DEGREE)]);
    script.carry_out("PSM1", &Command::MoveJp(far));
    assert!((script.arm("PSM1").setpoint_position[0] - 91.0 * DEGREE).abs() < 1e-3);
    script.carry_out("PSM1", &Command::MoveJp(HOME.to_vec()));
    script.carry_out("PSM1", &Command::JawMoveJp(vec![-90.0 * DEGREE]));
    assert!((script.arm("PSM1").setpoint_position[6] + 40.0 * DEGREE).abs() < 1e-3);
    let mut goal = script.arm("PSM1").setpoint_cp;
    goal[0] += 1.0;
    script.carry_out("PSM1", &Command::MoveCp(pose(&goal)));
    assert!(script.arm("PSM1").setpoint_cp[0] < goal[0] - 0.5);
    assert!(script.reached().iter().all(|reached| *reached), "{:?}", script.reached());
}

/// B6: the arm lags, so it is not where it was asked to be at once.
#[test]
fn a_servoed_jump_faults_an_arm_with_the_errors_of_a_real_one_and_enabling_recovers() {
    let server = Server::start();
    let errors = OptionValue::Preset("dvrk".into(), BTreeMap::new());
    let request =
        SessionRequest::new("NeedleReach-v0").options(Options::new().with("domain", errors));
    let mut script = Script::open(&server, &request);
    script.enable_and_home("PSM1");
    script.heard.clear();
    script.send("PSM1", &Command::servo_jp(&moved(&HOME, &[(0, 60.0 * DEGREE)])));
    script.advance(2);
    assert_eq!(script.state("PSM1").state, State::Fault);
    let error = |event: &Event| match &event.report {
        Report::Error(text) => Some(text.clone()),
        _ => None,
    };
    let errors: Vec<_> = script.heard.iter().filter_map(error).collect();
    assert!(errors.len() == 1 && errors[0].contains("tracking error"), "{errors:?}");
    script.enable_and_home("PSM1");
    script.carry_out("PSM1", &Command::MoveJp(HOME.to_vec()));
    script.advance(TICKS_PER_SECOND as u32);
    assert!(script.arm("PSM1").measured_position[0].abs() < 1e-6);
}

#[test]
fn faults_that_are_emulated_are_met_as_real_ones_are() {
    let server = Server::start();
    let mut script = Script::new(&server, "NeedlePick-v0");
    script.enable_and_home("PSM1");
    let emulate = |script: &mut Script, word: &str| {
        script.heard.clear();
        script.send("PSM1", &Command::EmulateFault(Fault::of(word)));
        script.advance(1);
    };
    emulate(&mut script, "stuck_jaw");
    script.carry_out("PSM1", &Command::jaw_open(0.5));
    let jaw = script.arm("PSM1").measured_position[6];
    assert!(jaw.abs() < 0.1 && (script.arm("PSM1").setpoint_position[6] - 0.5).abs() < 1e-9);
    emulate(&mut script, "none");
    script.advance(TICKS_PER_SECOND as u32);
    assert!(script.arm("PSM1").measured_position[6] > jaw + 0.1);
    emulate(&mut script, "lost_homing");
    let state = script.state("PSM1");
    assert!(state.state == State::Enabled && !state.is_homed);
    script.enable_and_home("PSM1");
    emulate(&mut script, "fault");
    assert_eq!(script.state("PSM1").state, State::Fault);
    script.enable_and_home("PSM1");
    emulate(&mut script, "smoke");
    let told: Vec<_> = script.heard.iter().map(|event| format!("{:?}", event.report)).collect();
    assert!(
        told.iter().any(|words| words.contains("smoke") && words.contains("stuck_jaw")),
        "{told:?}"
    );
}

/// A move from rest keeps to the arm's limits at every tick, on a straight line of joints that all arrive together; what
/// is read of a tick has one stamp, and poses are those of the joints.
#[test]
fn readings_of_a_move_fit_each_other_at_every_tick() {
    let server = Server::start();
    let mut script = Script::new(&server, "NeedleReach-v0");
    script.enable_and_home("PSM1");
    let psm = Psm::CLASSIC;
    let limits: Vec<_> = psm.limits().iter().chain([&psm.jaw_limit()]).copied().collect();
    let goal = [0.3, -0.2, 0.15, 0.5, 0.2, -0.4];
    let start = script.arm("PSM1").setpoint_position;
    let way: Vec<f64> = goal.iter().zip(&start).map(|(goal, start)| goal - start).collect();
    script.send("PSM1", &Command::MoveJp(goal.to_vec()));
    let mut before = *script.arm("PSM1");
    for tick in 0.. {
        script.advance(1);
        let arm = *script.arm("PSM1");
        assert!(arm.stamp > before.stamp);
        assert_eq!(arm.measured_position, arm.setpoint_position);
        assert_eq!(arm.measured_cp, arm.setpoint_cp);
        let part = (arm.setpoint_position[0] - start[0]) / way[0];
        for (axis, limit) in limits.iter().enumerate() {
            let [now, then] = [&arm, &before].map(|arm| arm.setpoint_velocity[axis]);
            assert!(now.abs() <= limit.max_velocity + 1e-9, "axis {axis} at tick {tick}: {now}");
            let most = limit.max_acceleration / TICKS_PER_SECOND as f64 + 1e-9;
            assert!((now - then).abs() <= most, "axis {axis} at tick {tick}: {then} to {now}");
            if let Some(way) = way.get(axis) {
                let off = arm.setpoint_position[axis] - start[axis] - part * way;
                assert!(off.abs() < 1e-9, "axis {axis} at tick {tick}: {off}");
            }
        }
        let joints = std::array::from_fn(|axis| arm.measured_position[axis]);
        let wrist = trocar_server::dvrk::numbers_of(&psm.base_from_wrist(&joints));
        let off = wrist.iter().zip(&arm.measured_cp).map(|(one, other)| (one - other).abs());
        assert!(off.fold(0.0, f64::max) < 1e-9);
        before = arm;
        if !script.state("PSM1").is_busy {
            break;
        }
    }
    assert_eq!(before.setpoint_position[..6], goal);
    assert_eq!(before.setpoint_velocity, [0.0; 7]);
}
