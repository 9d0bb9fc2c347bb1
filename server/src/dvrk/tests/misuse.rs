//! Scripts that do something wrong, or at the wrong time: what a real arm answers, and what this one refuses.

use super::*;
use crate::dvrk::{Error, Warning};

const ZERO: [f64; 6] = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0];

#[test]
fn a_disabled_or_unhomed_arm_ignores_motions_and_says_so_every_two_seconds() {
    let mut script = Script::new(&Mechanism::Psm(Psm::CLASSIC));
    let handle = script.heard.len();
    for _ in 0..500 {
        script.send(Command::MoveJp(ZERO.to_vec()));
        script.run(0.01);
    }
    let complaints = script.complaints(handle);
    assert_eq!(complaints.len(), 3, "{complaints:?}");
    assert!(complaints[0].contains("DISABLED") && complaints[0].contains("enable"));
    // A command every two ticks.
    assert!(complaints[1].contains("241 commands"), "{}", complaints[1]);
    assert_eq!(script.joints(), [0.0; 6]);
    assert!(script.reached(handle).is_empty() && script.states(handle) == 0);

    script.run(2.1);
    script.send(Command::State(StateCommand::Enable));
    let handle = script.heard.len();
    script.send(Command::servo_jp(&ZERO));
    script.tick();
    assert!(script.complaints(handle)[0].contains("not homed"));
    assert_eq!(script.joints(), [0.0; 6]);
}

#[test]
fn homing_a_disabled_arm_is_answered_and_does_nothing() {
    let mut script = Script::new(&Mechanism::Psm(Psm::CLASSIC));
    assert_eq!(script.wait(Command::State(StateCommand::Home)), None);
    assert_eq!(script.states(0), 1);
    assert!(script.complaints(0)[0].contains("DISABLED"));
    assert_eq!(script.arm.operating_state().state, State::Disabled);
    assert!(!script.arm.operating_state().is_homed);
}

#[test]
fn every_state_command_is_answered_in_every_state() {
    use StateCommand::{Enable, Pause};
    let ways: [(State, &[StateCommand]); 4] = [
        (State::Disabled, &[]),
        (State::Enabled, &[Enable]),
        (State::Paused, &[Enable, Pause]),
        (State::Fault, &[]),
    ];
    for (state, way) in ways {
        for command in ["enable", "disable", "home", "unhome", "pause", "resume", "dance", ""] {
            let mut script = Script::new(&Mechanism::Psm(Psm::CLASSIC));
            if state == State::Fault {
                script = faulted();
            }
            for command in way {
                script.send(Command::State(command.clone()));
            }
            assert_eq!(script.arm.operating_state().state, state);
            let before = script.heard.len();
            script.send(Command::State(StateCommand::of(command)));
            assert!(script.states(before) >= 1, "{state}: {command}");
            let (then, complaints) =
                (script.arm.operating_state().state, script.complaints(before));
            let expected = matches!(
                (state, command),
                (State::Disabled | State::Fault, "enable" | "disable" | "unhome")
                    | (State::Enabled, "enable" | "disable" | "pause" | "unhome" | "home")
                    | (State::Paused, "disable" | "pause" | "resume" | "unhome")
            );
            assert_eq!(complaints.is_empty(), expected, "{state}: {command}: {complaints:?}");
            let leads_to = match command {
                _ if !expected => state,
                "enable" | "resume" => State::Enabled,
                "disable" => State::Disabled,
                "pause" => State::Paused,
                _ => state,
            };
            assert_eq!(then, leads_to, "{state}: {command}");
        }
    }
}

#[test]
fn a_joint_goal_beyond_a_limit_is_clipped_without_an_error() {
    let mut script = Script::psm();
    let handle = script.heard.len();
    let mut goal = ZERO.to_vec();
    goal[0] = 120.0 * DEGREE;
    let seconds = rest_to_rest(1.588, 90.0 * DEGREE, 90.0 * DEGREE);
    assert_took(script.wait(Command::MoveJp(goal.clone())), seconds);
    assert_eq!(script.joints()[0], 1.588);
    assert_eq!(script.reached(handle), [true]);
    script.send(Command::servo_jp(&goal.iter().map(|value| -value).collect::<Vec<_>>()));
    script.tick();
    assert_eq!(script.joints()[..3], [-1.588, 0.0, 0.0]);
    assert!(script.complaints(handle).is_empty());
}

#[test]
fn a_jaw_goal_beyond_a_limit_ends_there_after_its_whole_time() {
    let mut script = Script::psm();
    let seconds = rest_to_rest(90.0 * DEGREE, 1080.0 * DEGREE, 720.0 * DEGREE);
    let handle = script.heard.len();
    // The jaw meets its limit at speed, so the checks of a tick do not hold.
    script.send(Command::JawMoveJp(vec![-90.0 * DEGREE]));
    let mut passed = 0;
    while script.arm.operating_state().is_busy {
        script.arm.tick();
        passed += 1;
    }
    script.listen();
    assert_took(Some(passed as f64 * TICK), seconds);
    assert_eq!(script.jaw(), -0.698_132);
    assert_eq!(script.reached(handle), [true]);
}

#[test]
fn a_pose_out_of_reach_moves_a_psm_to_clipped_joints_and_an_ecm_not_at_all() {
    let mut script = Script::psm();
    let start = script.arm.setpoint_cp().unwrap();
    for step in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [0.5, 0.5, 1.0]] {
        let handle = script.heard.len();
        assert!(script.wait(Script::step_from(&start, step)).is_some());
        assert_eq!(script.reached(handle), [true]);
        assert!(script.complaints(handle).is_empty());
        let goal = start.translation.vector + nalgebra::Vector3::from(step);
        let here = script.arm.setpoint_cp().unwrap().translation.vector;
        assert!((here - goal).norm() > 0.5, "{here}");
    }

    let mut script = Script::ecm();
    let (start, joints) = (script.arm.setpoint_cp().unwrap(), script.joints());
    for step in [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]] {
        let handle = script.heard.len();
        assert_eq!(script.wait(Script::step_from(&start, step)), None);
        assert_eq!(script.reached(handle), [false]);
        let complaints = script.complaints(handle);
        assert!(complaints.len() == 1 && complaints[0].contains("inverse kinematics"));
        assert_eq!(script.joints(), joints);
        // A servoed pose out of reach leaves the set-point before.
        let Command::MoveCp(goal) = Script::step_from(&start, step) else { unreachable!() };
        script.send(Command::ServoCp(goal));
        script.tick();
        assert_eq!(script.joints(), joints);
    }
}

#[test]
fn a_pose_at_the_remote_centre_is_refused_and_one_near_it_keeps_its_distance() {
    let mut script = Script::psm();
    let start = script.arm.setpoint_cp().unwrap();
    let handle = script.heard.len();
    let at_centre =
        Pose::from_parts(nalgebra::Vector3::new(0.0, 0.0, -0.5e-3).into(), start.rotation);
    assert_eq!(script.wait(Command::MoveCp(PoseMessage::new(&at_centre))), None);
    assert_eq!(script.reached(handle), [false]);
    assert!(script.complaints(handle)[0].contains("remote centre"));
    let near = Pose::from_parts(nalgebra::Vector3::new(0.0, 0.0, -0.03).into(), start.rotation);
    script.wait(Command::MoveCp(PoseMessage::new(&near))).unwrap();
    assert_near(&script.joints(), &[0.0, 0.0, 0.0606, 0.0, 0.0, 0.0], 1e-9);
}

/// An arm that did not follow its set-points.
fn faulted() -> Script {
    let mut script = Script::psm();
    script.send(Command::servo_jp(&[60.0 * DEGREE, 0.0, 0.12, 0.0, 0.0, 0.0]));
    script.arm.tick();
    script.arm.measure(&[0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.0]);
    script.listen();
    script
}

#[test]
fn an_arm_that_does_not_follow_faults_and_recovers() {
    let mut script = faulted();
    let complaints = script.complaints(0);
    assert!(complaints[0].contains("tracking error") && complaints[0].contains("yaw"));
    assert_eq!(script.joints(), ZERO, "it stays where it is, not where it was to be");
    let state = script.arm.operating_state();
    assert!(state.state == State::Fault && !state.is_homed && !state.is_busy);
    let before = script.heard.len();
    script.send(Command::MoveJp(ZERO.to_vec()));
    assert!(script.complaints(before)[0].contains("FAULT"));
    let mut script = script.homed();
    assert!(script.wait(script.insert(0.10)).is_some());

    // Within the tolerance nothing happens, nor at a limit.
    let mut script = Script::psm();
    for (goal, is) in [(0.4, 0.0), (1.588, 0.5)] {
        script.send(Command::servo_jp(&[goal, 0.0, 0.12, 0.0, 0.0, 0.0]));
        script.arm.tick();
        script.arm.measure(&[is, 0.0, 0.12, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(script.arm.operating_state().state, State::Enabled);
        assert_eq!(script.arm.measured_js().position[0], is);
        assert_eq!(script.arm.setpoint_js().position[0], goal);
    }
}

#[test]
fn disabling_during_a_move_stops_it_and_refuses_others() {
    let mut script = Script::psm();
    let handle = script.handle(Command::MoveJp(vec![0.5, 0.0, 0.12, 0.0, 0.0, 0.0]));
    script.run(0.3);
    let there = script.joints();
    script.send(Command::State(StateCommand::Disable));
    script.run(0.5);
    assert_eq!(script.arm.operating_state().state, State::Disabled);
    assert!(!script.arm.operating_state().is_busy);
    assert_eq!(script.joints(), there);
    assert_eq!(script.reached(handle), [false]);
    script.send(Command::MoveJp(ZERO.to_vec()));
    script.run(0.5);
    assert_eq!(script.joints(), there);
}

#[test]
fn holding_servoing_or_freeing_during_a_move_stops_it_at_once() {
    let stops: [fn(&Script) -> Command; 4] = [
        |_| Command::Hold,
        |_| Command::Free,
        |script| Command::servo_jp(&script.joints()),
        |_| Command::JawServoJp(vec![0.0]),
    ];
    for stop in stops {
        let mut script = Script::psm();
        let handle = script.handle(Command::MoveJp(vec![0.5, 0.0, 0.12, 0.0, 0.0, 0.0]));
        script.run(0.3);
        let there = script.joints();
        let command = stop(&script);
        script.send(command);
        assert_eq!(script.wait_for(handle), Some(0.0));
        assert_eq!(script.reached(handle), [false]);
        script.run(0.2);
        assert_eq!(script.joints(), there);
        assert_eq!(script.arm.setpoint_js().velocity[..], [0.0; 6]);
    }
}

#[test]
fn a_pause_stops_a_move_and_homing_goes_on_after_it() {
    let mut script = Script::psm();
    let handle = script.handle(Command::MoveJp(vec![0.5, 0.0, 0.12, 0.0, 0.0, 0.0]));
    script.run(0.3);
    script.send(Command::State(StateCommand::Pause));
    assert_eq!(script.reached(handle), [false]);
    let there = script.joints();
    script.send(Command::servo_jp(&ZERO));
    script.tick();
    assert_eq!(script.joints(), there);
    script.send(Command::State(StateCommand::Resume));
    assert!(script.arm.operating_state().is_homed);
    assert!(script.wait(Command::MoveJp(ZERO.to_vec())).is_some());

    let mut script = Script::new(&Mechanism::Psm(Psm::CLASSIC));
    script.send(Command::State(StateCommand::Enable));
    script.send(Command::State(StateCommand::Home));
    script.run(0.5);
    script.send(Command::State(StateCommand::Pause));
    assert!(!script.arm.operating_state().is_busy);
    assert!(script.wait(Command::State(StateCommand::Resume)).is_some());
    assert!(script.arm.operating_state().is_homed);
}

#[test]
fn what_is_malformed_is_refused_and_named() {
    let mut script = Script::psm();
    let pose = PoseMessage::new(&script.arm.setpoint_cp().unwrap());
    let bad_position = |value: f64| PoseMessage { position: [0.0, value, 0.0], ..pose.clone() };
    let bad_turn = |orientation: [f64; 4]| PoseMessage { orientation, ..pose.clone() };
    let mut commands = vec![];
    for count in [0, 1, 5, 7, 8, 1000] {
        let joints = vec![0.1; count];
        commands.extend([
            (Command::servo_jp(&joints), "expected 6"),
            (Command::ServoJr(joints.clone()), "expected 6"),
            (Command::ServoJv(joints.clone()), "expected 6"),
            (Command::MoveJp(joints.clone()), "expected 6"),
            (Command::MoveJr(joints.clone()), "expected 6"),
        ]);
        if count != 1 {
            commands.push((Command::JawMoveJp(joints.clone()), "expected 1"));
            commands.push((Command::JawServoJp(joints.clone()), "expected 1"));
        }
        if count != 0 {
            let position = ZERO.to_vec();
            commands.push((Command::ServoJp { position, velocity: joints }, "expected 6"));
        }
    }
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
        let mut joints = ZERO.to_vec();
        joints[4] = value;
        commands.extend([
            (Command::servo_jp(&joints), "number 4"),
            (Command::MoveJp(joints.clone()), "number 4"),
            (Command::MoveJr(joints.clone()), "number 4"),
            (Command::ServoCv([0.0, 0.0, 0.0, 0.0, value, 0.0]), "number 4"),
            (Command::JawMoveJp(vec![value]), "number 0"),
            (Command::JawServoJp(vec![value]), "number 0"),
            (Command::ServoCp(bad_position(value)), "number 1"),
            (Command::MoveCp(bad_position(value)), "number 1"),
            (Command::MoveCr(bad_position(value)), "number 1"),
            (Command::SetBaseFrame(bad_position(value)), "number 1"),
            (Command::MoveCp(bad_turn([value, 0.0, 0.0, 1.0])), "unit quaternion"),
        ]);
    }
    for orientation in [[0.0; 4], [1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5]] {
        commands.push((Command::ServoCp(bad_turn(orientation)), "unit quaternion"));
        commands.push((Command::SetBaseFrame(bad_turn(orientation)), "unit quaternion"));
    }
    let elsewhere = pose.clone().with_frame("Atlantis");
    commands.push((Command::ServoCp(elsewhere.clone()), "\"Atlantis\""));
    commands.push((Command::MoveCp(elsewhere.clone()), "\"PSM1_base\""));
    commands.push((Command::MoveCr(elsewhere), "unknown frame"));
    commands.push((Command::SetToolType("PROGRASP_FORCEPS:400049".into()), "PROGRASP"));
    commands.push((Command::SetEndoscopeType("Classic_HD_UP".into()), "none"));

    let joints = script.joints();
    for (command, named) in commands {
        let before = script.heard.len();
        script.send(command.clone());
        let complaints = script.complaints(before);
        assert_eq!(complaints.len(), 1, "{command:?}: {complaints:?}");
        assert!(complaints[0].starts_with("error"), "{complaints:?}");
        assert!(complaints[0].contains(named), "{command:?}: {complaints:?}");
        assert!(complaints[0].contains(command.topic()), "{command:?}: {complaints:?}");
        script.tick();
        assert_eq!(script.joints(), joints);
        assert!(script.arm.operating_state().is_homed && script.states(before) == 0);
    }

    let mut ecm = Script::ecm();
    for command in [
        Command::jaw_close(),
        Command::JawServoJp(vec![0.0]),
        Command::EmulateToolPresent(false),
        Command::EmulateAdapterPresent(true),
        Command::SetToolType("LARGE_NEEDLE_DRIVER:400006".into()),
    ] {
        let before = ecm.heard.len();
        ecm.send(command.clone());
        let is_none = |event: &Event| matches!(event.what, What::Error(Error::NotOnThisArm { .. }));
        assert!(ecm.heard[before..].iter().any(is_none), "{command:?}");
    }
}

#[test]
fn a_malformed_command_leaves_a_move_alone() {
    let mut script = Script::psm();
    let handle = script.handle(Command::MoveJp(vec![0.1, 0.0, 0.12, 0.0, 0.0, 0.0]));
    script.run(0.1);
    script.send(Command::servo_jp(&[f64::NAN; 6]));
    script.send(Command::MoveJp(vec![]));
    assert!(script.wait_for(handle).is_some());
    assert_eq!(script.reached(handle), [true]);
}

#[test]
fn cartesian_commands_need_the_tool_past_the_cannula() {
    let mut script = Script::psm();
    script.wait(script.insert(0.05)).unwrap();
    let start = script.arm.setpoint_cp().unwrap();
    let handle = script.heard.len();
    assert_eq!(script.wait(Script::step_from(&start, [0.0, 0.0, -0.01])), None);
    assert!(script.complaints(handle)[0].contains("cannula"));
    assert_near(&script.joints(), &[0.0, 0.0, 0.05, 0.0, 0.0, 0.0], 0.0);
    // 43 mm beyond the remote centre suffice.
    script.wait(script.insert(0.0587)).unwrap();
    assert!(script.wait(Script::step_from(&start, [0.0, 0.0, -0.03])).is_some());
}

#[test]
fn what_needs_dynamics_of_joints_is_ignored_with_a_warning() {
    use crate::dvrk::Effort;
    for effort in [
        Effort::ServoJf,
        Effort::JawServoJf,
        Effort::SpatialServoCf,
        Effort::BodyServoCf,
        Effort::BodySetCfOrientationAbsolute,
        Effort::UseGravityCompensation,
        Effort::ServoCs,
        Effort::ServoCi,
    ] {
        let mut script = Script::psm();
        let (joints, before) = (script.joints(), script.heard.len());
        for _ in 0..100 {
            script.send(Command::Effort(effort));
            script.tick();
        }
        assert_eq!(script.joints(), joints);
        let complaints = script.complaints(before);
        assert!(complaints.len() == 1 && complaints[0].contains("dynamics"), "{complaints:?}");
        assert!(complaints[0].contains(Command::Effort(effort).topic()));
    }
}

#[test]
fn a_script_that_starts_late_learns_the_state_by_homing() {
    let mut script = Script::psm();
    script.run(1.0);
    // A late client has heard nothing.
    let before = script.heard.len();
    script.send(Command::State(StateCommand::Home));
    let answers: Vec<_> = script.heard[before..].iter().map(|event| event.what.clone()).collect();
    let [What::OperatingState(state)] = answers.as_slice() else { panic!("{answers:?}") };
    assert!(state.is_homed && !state.is_busy);
}

#[test]
fn a_move_after_a_servoed_jaw_says_that_a_real_arm_may_open_it() {
    let mut script = Script::psm();
    script.wait(Command::jaw_open(60.0 * DEGREE)).unwrap();
    script.send(Command::JawServoJp(vec![-10.0 * DEGREE]));
    script.tick();
    let before = script.heard.len();
    script.wait(script.insert(0.13)).unwrap();
    script.wait(script.insert(0.12)).unwrap();
    assert_near(&[script.jaw()], &[-10.0 * DEGREE], 1e-12);
    let stale = script.heard[before..].iter().filter_map(|event| match event.what {
        What::Warning(Warning::JawStays { stale, .. }) => Some(stale),
        _ => None,
    });
    assert_near(&stale.collect::<Vec<_>>(), &[60.0 * DEGREE], 1e-12);
}
