//! What dVRK's own test scripts do (`dvrk_arm_test.py`, `dvrk_psm_test.py`, `dvrk_move_wait_test.py`), with the times
//! of the closed form.

use super::*;

const SLOW: [f64; 2] = [90.0 * DEGREE, 90.0 * DEGREE];
const INSERTION: [f64; 2] = [0.2, 0.2];
const FAST: [f64; 2] = [1080.0 * DEGREE, 720.0 * DEGREE];

fn time_of(distance: f64, [velocity, acceleration]: [f64; 2]) -> f64 {
    rest_to_rest(distance, velocity, acceleration)
}

fn joints_plus(script: &Script, steps: [f64; 2]) -> Command {
    let mut joints = script.joints();
    joints[0] += steps[0] * DEGREE;
    joints[1] += steps[1] * DEGREE;
    Command::MoveJp(joints)
}

/// When the command of a stream before that of `time` was.
fn before(time: f64) -> f64 {
    ((time * 100.0).round() - 1.0) / 100.0
}

#[test]
fn enabling_and_homing_bring_the_arm_to_its_zeros_and_again_at_once() {
    for mechanism in [Mechanism::Psm(Psm::CLASSIC), Mechanism::Ecm(Ecm::CLASSIC)] {
        let mut script = Script::new(&mechanism);
        assert_eq!(script.arm.operating_state().state, State::Disabled);
        script.send(Command::State(StateCommand::Enable));
        assert_eq!(script.arm.operating_state().state, State::Enabled);
        assert_eq!(script.states(0), 1);

        let limit = mechanism.limit(2);
        let seconds = rest_to_rest(0.12, limit.max_velocity, limit.max_acceleration);
        let took = script.wait(Command::State(StateCommand::Home));
        assert_took(took, seconds);
        let mut home = vec![0.0; mechanism.joints()];
        home[2] = 0.12;
        assert_eq!(script.joints(), home);
        assert!(script.arm.operating_state().is_homed);

        for command in [StateCommand::Enable, StateCommand::Home] {
            let before = script.heard.len();
            assert!(!script.is_busy_after(Command::State(command)));
            assert_eq!(script.states(before), 1);
            assert!(script.arm.operating_state().is_homed);
        }
    }
    assert!((time_of(0.12, INSERTION) - 1.549).abs() < 1e-3);
}

#[test]
fn homing_where_the_arm_is_at_its_zeros_is_busy_long_enough_to_be_seen() {
    let mut script = Script::psm();
    script.send(Command::State(StateCommand::Unhome));
    assert!(!script.arm.operating_state().is_homed);
    assert_took(script.wait(Command::State(StateCommand::Home)), 0.1);
}

#[test]
fn a_move_to_where_the_arm_is_is_busy_and_then_is_not() {
    for mut script in [Script::psm(), Script::ecm()] {
        let here = Command::MoveJp(script.joints());
        let handle = script.handle(here);
        assert!(script.arm.operating_state().is_busy);
        assert_took(script.wait_for(handle), 0.0);
        assert_eq!(script.reached(handle), [true]);
        let here = Command::MoveCp(PoseMessage::new(&script.arm.setpoint_cp().unwrap()));
        assert_took(script.wait(here), 0.0);
    }
}

#[test]
fn servoed_joints_are_followed_at_once_and_hold_when_the_stream_stops() {
    let mut script = Script::psm();
    let start = script.joints();
    let wave = |time: f64| 5.0 * DEGREE * (1.0 - (std::f64::consts::TAU * time / 5.0).cos());
    let goal = |time: f64| {
        let mut joints = start.clone();
        joints[0] += wave(time);
        joints[1] += wave(time);
        joints
    };
    let mut fastest: f64 = 0.0;
    let velocity = |time: f64| {
        let rate = std::f64::consts::TAU / 5.0;
        let speed = 5.0 * DEGREE * rate * (rate * time).sin();
        vec![speed, speed, 0.0, 0.0, 0.0, 0.0]
    };
    script.stream(
        5.0,
        |time| Command::ServoJp { position: goal(time), velocity: velocity(time) },
        |arm, time| {
            if time > 0.1 {
                let last = goal(before(time));
                assert_eq!(arm.setpoint_js().position[..], last[..]);
                assert_eq!(arm.setpoint_js().velocity[..], velocity(before(time))[..]);
                fastest = fastest.max(arm.measured_js().velocity[0]);
            }
        },
    );
    let peak = 5.0 * std::f64::consts::TAU / 5.0; // °/s
    // The velocity that is measured is the stream's, but for the beat of 100 Hz in 240 Hz.
    assert!((fastest / DEGREE - peak).abs() < 0.3 * peak, "{}", fastest / DEGREE);
    let last = script.joints();
    script.run(1.0);
    assert_eq!(script.joints(), last);
    assert_eq!(script.arm.measured_js().velocity[0], 0.0);
    assert!(script.complaints(0).is_empty(), "{:?}", script.complaints(0));
}

#[test]
fn moves_of_two_joints_take_the_time_of_the_closed_form() {
    let mut script = Script::psm();
    let [short, long] = [10.0, 20.0].map(|angle| time_of(angle * DEGREE, SLOW));
    let mut sum = 0.0;
    for (steps, seconds) in [([10.0, -10.0], short), ([-20.0, 20.0], long), ([10.0, -10.0], short)]
    {
        let goal = joints_plus(&script, steps);
        let took = script.wait(goal);
        assert_took(took, seconds);
        sum += took.unwrap();
    }
    assert!((2.0 * short + long - 2.276).abs() < 1e-3);
    assert!(sum <= 2.276 + 6.0 * TICK, "{sum}");
    assert_eq!(script.joints(), [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]);

    // A loop over `is_busy` leaves when the arm has stopped, not before.
    let goal = joints_plus(&script, [10.0, -10.0]);
    script.send(goal);
    while script.arm.operating_state().is_busy {
        script.tick();
    }
    let there = script.joints();
    script.run(0.1);
    assert_eq!(script.joints(), there);
    assert_near(&there[..2], &[10.0 * DEGREE, -10.0 * DEGREE], 1e-12);
}

#[test]
fn the_ecm_moves_at_its_own_limits() {
    let mut script = Script::ecm();
    let mut joints = script.joints();
    joints[0] += 60.0 * DEGREE;
    joints[2] -= 0.05;
    let [turn, slide] = [(60.0 * DEGREE, [30.0 * DEGREE, 90.0 * DEGREE]), (0.05, [0.06, 0.06])]
        .map(|(d, l)| time_of(d, l));
    assert_took(script.wait(Command::MoveJp(joints.clone())), turn.max(slide));
    assert_eq!(script.joints(), joints);
    assert_took(script.wait(script.insert(0.15)), time_of(0.08, [0.06, 0.06]));
}

#[test]
fn servoed_poses_are_followed_on_a_diagonal() {
    for mut script in [Script::psm(), Script::ecm()] {
        let start = script.arm.setpoint_cp().unwrap();
        let goal = |time: f64| {
            let way = 0.02 * (1.0 - (std::f64::consts::TAU * time / 5.0).cos());
            let mut goal = start;
            goal.translation.vector += nalgebra::Vector3::new(way, way, 0.0);
            goal
        };
        let mut worst: f64 = 0.0;
        script.stream(
            5.0,
            |time| Command::ServoCp(PoseMessage::new(&goal(time))),
            |arm, time| {
                let off =
                    goal(time).translation.vector - arm.setpoint_cp().unwrap().translation.vector;
                worst = worst.max(off.norm());
            },
        );
        assert!(worst <= 2e-3, "{worst} m");
        assert!(worst > 1e-5, "the set-point cannot be there before");
        assert!(script.complaints(0).is_empty(), "{:?}", script.complaints(0));
    }
}

#[test]
fn moves_of_poses_take_the_time_of_the_slowest_joint() {
    let mut script = Script::psm();
    let start = script.arm.setpoint_cp().unwrap();
    let expected = [1.028, 1.454, 1.028, 1.067, 1.508, 1.067];
    let steps = [[-0.05, 0.0], [0.05, 0.0], [0.0; 2], [0.0, -0.05], [0.0, 0.05], [0.0; 2]];
    let mut sum = 0.0;
    for (index, ([x, y], seconds)) in steps.into_iter().zip(expected).enumerate() {
        let took = script.wait(Script::step_from(&start, [x, y, 0.0])).unwrap();
        // The times in the list are rounded to a millisecond.
        assert!(took > seconds - 1e-3 && took < seconds + 1e-3 + 2.0 * TICK, "{index}: {took}");
        sum += took;
        let mut goal = start;
        goal.translation.vector += nalgebra::Vector3::new(x, y, 0.0);
        assert!(far(&script.arm.measured_cp().unwrap(), &goal) < 1e-9);
        let joints = script.joints();
        let [a, b] = [23.775 * DEGREE, 25.591 * DEGREE];
        match index {
            0 => assert_near(&joints, &[-a, 0.0, 0.130_53, 0.0, 0.0, a], 1e-5),
            3 => assert_near(&joints, &[0.0, b, 0.131_36, 0.0, -b, 0.0], 1e-5),
            2 | 5 => assert_near(&joints, &[0.0, 0.0, 0.12, 0.0, 0.0, 0.0], 1e-9),
            _ => {}
        }
    }
    assert!((sum - 7.151).abs() < 6e-3 + 12.0 * TICK, "{sum}");
}

#[test]
fn the_jaw_opens_and_closes_in_the_time_of_its_limits() {
    let mut script = Script::psm();
    let open = Command::jaw_open(crate::dvrk::command::JAW_OPEN);
    assert_took(script.wait(Command::jaw_close()), time_of(20.0 * DEGREE, FAST));
    for _ in 0..2 {
        assert_took(script.wait(open.clone()), time_of(80.0 * DEGREE, FAST));
        assert_near(&[script.jaw()], &[60.0 * DEGREE], 1e-12);
        assert_took(script.wait(Command::jaw_close()), time_of(80.0 * DEGREE, FAST));
        assert_near(&[script.jaw()], &[-20.0 * DEGREE], 1e-12);
    }
    assert!((time_of(20.0 * DEGREE, FAST) - 0.333).abs() < 1e-3);
    assert!((time_of(80.0 * DEGREE, FAST) - 0.667).abs() < 1e-3);
    assert_eq!(script.joints(), [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]);
}

#[test]
fn jaw_and_insertion_share_a_trajectory() {
    let mut script = Script::psm();
    for (jaw, angle, depth, alone) in [
        (Command::jaw_close(), -20.0, 0.10, time_of(0.02, INSERTION)),
        (Command::jaw_open(60.0 * DEGREE), 60.0, 0.15, time_of(0.05, INSERTION)),
    ] {
        // `wait(is_busy=True)` returns as soon as the arm is busy.
        assert!(script.is_busy_after(jaw));
        let before = script.heard.len();
        let insert = script.insert(depth);
        assert_took(script.wait(insert), alone);
        assert_eq!(script.reached(before), [true]);
        assert_near(&[script.joints()[2], script.jaw()], &[depth, angle * DEGREE], 1e-12);
    }
    assert!((time_of(0.02, INSERTION) - 0.632).abs() < 1e-3);
    assert!((time_of(0.05, INSERTION) - 1.0).abs() < 1e-3);
}

#[test]
fn a_jaw_that_moves_during_a_move_of_the_arm_leaves_its_goal() {
    let mut script = Script::psm();
    let start = script.arm.setpoint_cp().unwrap();
    assert!(script.is_busy_after(Script::step_from(&start, [-0.05, 0.0, 0.0])));
    script.run(0.1);
    let before = script.heard.len();
    let took = script.wait(Command::jaw_close()).unwrap();
    assert_eq!(script.reached(before), [true]);
    let here = script.arm.measured_cp().unwrap().translation.vector;
    assert!(
        (here - start.translation.vector - nalgebra::Vector3::new(-0.05, 0.0, 0.0)).norm() < 1e-9
    );
    assert_near(&[script.jaw()], &[-20.0 * DEGREE], 1e-12);
    // The arm needs 1.028 s in all, 0.1 s of which had passed.
    assert!((took - 0.928).abs() < 1e-3 + 2.0 * TICK, "{took}");
}

#[test]
fn a_servoed_jaw_is_followed_and_moves_on_without_a_jump() {
    let mut script = Script::psm();
    script.wait(Command::jaw_open(60.0 * DEGREE)).unwrap();
    let angle = |time: f64| (50.0 + 30.0 * (std::f64::consts::TAU * time / 5.0).sin()) * DEGREE;
    script.stream(
        20.0,
        |time| Command::JawServoJp(vec![angle(time)]),
        |arm, time| {
            if time > 0.1 {
                let jaw = arm.jaw_setpoint_js().unwrap();
                assert_eq!(jaw.position[0], angle(before(time)).min(1.396_26));
                assert!(jaw.velocity.is_empty());
            }
        },
    );
    let before = script.jaw();
    script.send(Command::jaw_close());
    script.tick();
    let step = (script.jaw() - before).abs();
    // It goes on with no more than the velocity of the stream, 37.7 °/s, and half a tick's acceleration.
    let most = (1.3 * 37.7 * DEGREE + 0.5 * FAST[1] * TICK) * TICK;
    assert!(step <= most, "{} °", step / DEGREE);
    script.run(1.0);
    assert!(!script.arm.operating_state().is_busy);
    assert_took(script.wait(Command::jaw_open(60.0 * DEGREE)), time_of(80.0 * DEGREE, FAST));
}

#[test]
fn a_second_move_takes_over_from_the_first_without_a_jump() {
    let mut script = Script::psm();
    let handle = script.handle(joints_plus(&script, [30.0, 0.0]));
    script.run(0.2);
    let (start, velocity) = (script.joints()[0], script.arm.setpoint_js().velocity[0]);
    assert!((velocity - 18.0 * DEGREE).abs() < 1e-9, "{velocity}");
    // The checks of each tick find no jump of velocity.
    let goal = -5.0 * DEGREE;
    let took = script.wait(Command::MoveJp(vec![goal, 0.0, 0.12, 0.0, 0.0, 0.0]));
    // Single axis, back beyond where it brakes: t = (2 √(a·e + w²/2) − w) / a.
    let [limit, acceleration] = SLOW;
    let (e, w) = (start - goal, -velocity);
    let peak = (acceleration * e + 0.5 * w * w).sqrt();
    assert!(peak < limit);
    assert_took(took, (2.0 * peak - w) / acceleration);
    assert_eq!(script.reached(handle), [true]);
    assert_near(&script.joints()[..1], &[goal], 1e-12);
}

#[test]
fn a_ratio_slows_moves_down() {
    let mut script = Script::psm();
    let before = script.heard.len();
    script.send(Command::SetRatio(0.5));
    assert!(script.heard[before..].iter().any(|event| event.what == What::Ratio(0.5)));
    let goal = joints_plus(&script, [10.0, 0.0]);
    assert_took(script.wait(goal), 2.0 * f64::sqrt(10.0 / 45.0));
    for ratio in [0.0, 1.5, -1.0, f64::NAN, f64::INFINITY] {
        let before = script.heard.len();
        script.send(Command::SetRatio(ratio));
        let complaints = script.complaints(before);
        assert!(complaints.len() == 1 && complaints[0].contains("]0, 1]"), "{complaints:?}");
        assert_eq!(script.arm.ratio(), 0.5);
    }
}

#[test]
fn joints_of_a_move_from_rest_keep_a_straight_line_and_arrive_together() {
    let mut script = Script::psm();
    let (start, goal) = (script.joints(), vec![0.5, -0.3, 0.15, 2.0, -0.6, 0.4]);
    script.send(Command::MoveJp(goal.clone()));
    while script.arm.operating_state().is_busy {
        script.tick();
        let parts: Vec<f64> =
            (0..6).map(|i| (script.joints()[i] - start[i]) / (goal[i] - start[i])).collect();
        assert_near(&parts, &[parts[0]; 6], 1e-9);
    }
    assert_eq!(script.joints(), goal);
}

#[test]
fn relative_moves_count_from_the_goal_of_a_move_else_from_the_set_point() {
    let mut script = Script::psm();
    let step = vec![0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
    script.send(Command::MoveJr(step.clone()));
    script.run(0.1);
    script.wait(Command::MoveJr(step.clone())).unwrap();
    assert_near(&script.joints()[..1], &[0.2], 1e-12);
    script.wait(Command::MoveJr(step.clone())).unwrap();
    assert_near(&script.joints()[..1], &[0.3], 1e-12);
    for _ in 0..2 {
        script.send(Command::ServoJr(step.clone()));
    }
    script.tick();
    assert_near(&script.joints()[..1], &[0.5], 1e-12);
}

#[test]
fn the_same_commands_give_the_same_bits() {
    let play = || {
        let mut script = Script::psm();
        let mut rng = Rng::new(3, 0);
        let mut bits = vec![];
        for _ in 0..2000 {
            let command = super::fuzz::command(&mut rng, script.arm.mechanism());
            script.send(command);
            for _ in 0..rng.index(5) {
                script.arm.tick();
                script.listen();
                bits.extend(script.joints().iter().map(|value| value.to_bits()));
            }
        }
        (bits, script.heard)
    };
    let [one, other] = [play(), play()];
    assert!(one.0 == other.0, "the set-points differ");
    // A NaN that is quoted is not equal to itself.
    assert_eq!(format!("{:?}", one.1), format!("{:?}", other.1));
}
