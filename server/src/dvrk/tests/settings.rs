//! Base frame, tools, endoscopes, encoders, velocities and ratios.

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::*;
use crate::dvrk::{Homing, VELOCITY_SECONDS};
use crate::robots::Drivetrain;

/// JHU's PSM2: turned by −150° about x, 0.2 m aside.
fn base() -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -150.0 * DEGREE);
    Pose::from_parts(Translation3::new(0.2, 0.0, 0.0), turn)
}

#[test]
fn poses_are_in_the_reference_frame_and_local_ones_are_not() {
    let mut script = Script::psm();
    script.arm = script.arm.with_base_frame("ECM", base());
    assert_eq!(script.arm.reference_frame(), "ECM");
    let local = script.arm.local_measured_cp().unwrap();
    assert!(far(&script.arm.measured_cp().unwrap(), &(base() * local)) < 1e-12);

    // The same step, once in the reference frame and once in the base frame.
    let step = Pose::translation(0.01, 0.02, -0.01) * local;
    for (frame, goal) in [("", base() * step), ("ECM", base() * step), ("PSM1_base", step)] {
        script.wait(Command::MoveJp(vec![0.0, 0.0, 0.12, 0.0, 0.0, 0.0])).unwrap();
        script.wait(Command::MoveCp(PoseMessage::new(&goal).with_frame(frame))).unwrap();
        assert!(far(&script.arm.local_measured_cp().unwrap(), &step) < 1e-9, "{frame}");
        assert!(far(&script.arm.goal_cp().unwrap(), &(base() * step)) < 1e-9);
    }

    // It may change at run time; the service of the inverse never knows it.
    script.send(Command::SetBaseFrame(PoseMessage::new(&Pose::translation(1.0, 0.0, 0.0))));
    assert_eq!(script.arm.reference_frame(), "ECM");
    let moved = script.arm.measured_cp().unwrap().translation.vector;
    assert!((moved - step.translation.vector - Vector3::x()).norm() < 1e-9);
    let seed = script.joints();
    let found = script.arm.inverse_kinematics(&PoseMessage::new(&step), &seed).unwrap();
    assert_near(&found, &seed, 1e-9);
    script.send(Command::SetBaseFrame(PoseMessage::new(&base()).with_frame("table")));
    assert_eq!(script.arm.reference_frame(), "table");
}

#[test]
fn twists_are_velocities_of_the_pose_in_the_reference_frame() {
    let mut script = Script::psm();
    script.arm = script.arm.with_base_frame("ECM", base());
    script.send(Command::MoveJp(vec![0.3, -0.2, 0.15, 0.5, 0.4, -0.6]));
    script.run(0.3);
    let [mut fastest, mut turning]: [f64; 2] = [0.0; 2];
    for _ in 0..40 {
        let before = script.arm.setpoint_cp().unwrap();
        let twist = script.arm.measured_cv().unwrap();
        script.tick();
        let [after, then] =
            [script.arm.setpoint_cp(), script.arm.setpoint_cp()].map(Option::unwrap);
        let mean = 0.5 * (twist + script.arm.measured_cv().unwrap());
        let moved = (after.translation.vector - before.translation.vector) / TICK;
        let turned = (then.rotation * before.rotation.inverse()).scaled_axis() / TICK;
        assert!((moved - mean.fixed_rows::<3>(0)).norm() < 5e-4, "{moved} {mean}");
        assert!((turned - mean.fixed_rows::<3>(3)).norm() < 2e-2, "{turned} {mean}");
        fastest = fastest.max(moved.norm());
        turning = turning.max(turned.norm());
        let local = script.arm.local_measured_cv().unwrap();
        let own = before.rotation.inverse() * Vector3::from(twist.fixed_rows::<3>(0));
        assert!((local.fixed_rows::<3>(0) - own).norm() < 0.1 * fastest);
    }
    assert!(fastest > 0.02 && turning > 0.2, "{fastest} {turning}");
}

#[test]
fn the_jacobians_are_those_of_dvrk() {
    let mut script = Script::psm();
    script.wait(Command::MoveJp(vec![0.3, -0.2, 0.15, 0.5, 0.4, -0.6])).unwrap();
    let (arm, step) = (&script.arm, 1e-6);
    let [body, spatial] = [arm.body_jacobian(), arm.spatial_jacobian()].map(Option::unwrap);
    let here = arm.local_measured_cp().unwrap();
    for joint in 0..6 {
        let mut q = script.joints();
        q[joint] += step;
        let there = arm.local_forward_kinematics(&q).unwrap();
        let moved = (there.translation.vector - here.translation.vector) / step;
        let turn = (there.rotation * here.rotation.inverse()).scaled_axis() / step;
        let own = here.rotation.inverse();
        assert!((body.fixed_view::<3, 1>(0, joint) - own * moved).norm() < 1e-5);
        assert!((body.fixed_view::<3, 1>(3, joint) - own * turn).norm() < 1e-5);
        // The velocity of the point of the tool that is at the remote centre.
        let at_centre = moved - turn.cross(&here.translation.vector);
        assert!((spatial.fixed_view::<3, 1>(0, joint) - at_centre).norm() < 1e-5);
        assert!((spatial.fixed_view::<3, 1>(3, joint) - turn).norm() < 1e-5);
    }
}

#[test]
fn without_a_tool_an_arm_has_discs_and_no_pose() {
    let mut script = Script::psm();
    script.wait(Command::MoveJp(vec![0.1, 0.2, 0.15, 0.5, 0.4, -0.6])).unwrap();
    script.wait(Command::jaw_open(0.5)).unwrap();
    script.send(Command::EmulateToolPresent(false));
    assert!(!script.arm.operating_state().is_homed);
    assert!(script.arm.measured_cp().is_none() && script.arm.setpoint_cp().is_none());
    assert!(script.arm.measured_cv().is_none() && script.arm.body_jacobian().is_none());
    assert!(script.arm.jaw_measured_js().is_none());
    let discs = script.arm.measured_js();
    assert_eq!(discs.names[3..], ["disc_1", "disc_2", "disc_3", "disc_4"]);
    let joints = script.arm.actuator_to_joint_position(&discs.position).unwrap();
    assert_near(&joints, &[0.1, 0.2, 0.15, 0.5, 0.4, -0.6, 0.5], 1e-12);
    assert!(script.arm.actuator_to_joint_position(&[0.0; 6]).is_err());

    let before = script.heard.len();
    script.send(Command::jaw_close());
    script.tick();
    assert!(script.complaints(before)[0].contains("no tool"));
    script.send(Command::SetToolType("LARGE_NEEDLE_DRIVER:400006[7]".into()));
    assert_eq!(script.arm.tool(), Some("LARGE_NEEDLE_DRIVER:400006[7]"));
    assert!(script.arm.operating_state().is_homed);
    assert_took(
        script.wait(Command::jaw_open(0.0)),
        rest_to_rest(0.5, 1080.0 * DEGREE, 720.0 * DEGREE),
    );
}

#[test]
fn an_arm_that_is_homed_in_place_stays_there() {
    let mechanism = Mechanism::Psm(Psm::CLASSIC);
    let start = [0.3, -0.2, 0.15, 0.5, 0.4, -0.6, 0.2];
    let arm = ArmController::new("PSM1", mechanism, &start).with_homing(Homing::InPlace);
    let mut script = Script { arm, heard: vec![] };
    script.send(Command::State(StateCommand::Enable));
    assert_took(script.wait(Command::State(StateCommand::Home)), 0.1);
    assert!(script.arm.operating_state().is_homed);
    assert_eq!((script.joints(), script.jaw()), (start[..6].to_vec(), 0.2));
}

#[test]
fn an_endoscope_that_looks_up_turns_the_camera() {
    let mut script = Script::ecm();
    let straight = script.arm.measured_cp().unwrap();
    script.send(Command::SetEndoscopeType("Classic_SD_UP".into()));
    assert!(script.complaints(0).is_empty());
    assert_eq!(script.arm.tool(), Some("Classic_SD_UP"));
    let up = script.arm.measured_cp().unwrap();
    assert!((up.rotation.angle_to(&straight.rotation) / DEGREE - 30.0).abs() < 1e-9);
    assert_eq!(up.translation, straight.translation);
    script.send(Command::SetEndoscopeType("Si_HD_UP".into()));
    assert!(script.complaints(0)[0].contains("Si_HD_UP"));
}

#[test]
fn encoders_and_links_are_two_things() {
    let offsets = [0.01, -0.02, 0.001, 0.03, 0.1, -0.1, 0.05];
    let mechanism = Mechanism::Psm(Psm::CLASSIC);
    let arm = ArmController::new("PSM1", mechanism, &[0.0; 7]);
    let arm = arm.with_drivetrain(Drivetrain::new(offsets));
    let mut script = Script { arm, heard: vec![] };
    script.send(Command::State(StateCommand::Enable));
    script.send(Command::State(StateCommand::Home));
    let mut last = script.arm.tick();
    while script.arm.operating_state().is_busy {
        last = script.arm.tick();
    }
    // The encoders say where the arm was asked to be, and the links are elsewhere.
    assert_near(&script.arm.measured_js().position, &[0.0, 0.0, 0.12, 0.0, 0.0, 0.0], 1e-15);
    assert_near(&last.joints, &[0.01, -0.02, 0.121, 0.03, 0.1, -0.1], 1e-15);
    assert_eq!(last.jaw, Some(0.05));
    // What a world reports are the links.
    let mut links = last.joints.to_vec();
    links.push(0.05);
    links[0] += 0.2;
    script.arm.measure(&links);
    assert_near(&script.arm.measured_js().position, &[0.2, 0.0, 0.12, 0.0, 0.0, 0.0], 1e-12);
    assert_near(&script.arm.setpoint_js().position, &[0.0, 0.0, 0.12, 0.0, 0.0, 0.0], 1e-15);
}

#[test]
fn a_velocity_acts_until_it_is_too_old() {
    let mut script = Script::psm();
    script.send(Command::ServoJv(vec![0.1, 0.0, 0.0, 0.0, 0.0, 0.0]));
    script.run(1.0);
    assert_near(&script.joints()[..1], &[0.1 * VELOCITY_SECONDS], 1e-12);
    // Too fast a velocity is slowed down, joints alike.
    script.send(Command::ServoJv(vec![-180.0 * DEGREE, 90.0 * DEGREE, 0.0, 0.0, 0.0, 0.0]));
    script.tick();
    assert_near(&script.arm.setpoint_js().velocity[..2], &[-90.0 * DEGREE, 45.0 * DEGREE], 1e-12);
    script.run(1.0);

    for mut script in [Script::psm(), Script::ecm()] {
        script.arm = script.arm.with_base_frame("ECM", base());
        let before = script.arm.measured_cp().unwrap();
        let twist = [0.02, 0.0, 0.0, 0.0, 0.0, 0.0];
        script.stream(0.5, |_| Command::ServoCv(twist), |_, _| {});
        let moved =
            script.arm.measured_cp().unwrap().translation.vector - before.translation.vector;
        if script.arm.mechanism().joints() == 6 {
            assert!((moved - Vector3::new(0.01, 0.0, 0.0)).norm() < 1e-4, "{moved}");
            let turned = before.rotation.angle_to(&script.arm.measured_cp().unwrap().rotation);
            assert!(turned < 1e-3, "{turned}");
        } else {
            // Four joints cannot keep the orientation: they do what is nearest.
            assert!(moved.x > 0.0);
        }
        script.run(0.2);
        let there = script.joints();
        script.run(0.2);
        assert_eq!(script.joints(), there);
    }
}

#[test]
fn relative_poses_are_in_the_axes_of_the_reference_frame() {
    let mut script = Script::psm();
    script.arm = script.arm.with_base_frame("ECM", base());
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.2);
    let step = PoseMessage::new(&Pose::from_parts(Translation3::new(0.0, 0.01, 0.0), turn));
    for command in [Command::MoveCr(step.clone()), Command::ServoCr(step)] {
        let before = script.arm.setpoint_cp().unwrap();
        script.send(command);
        script.run(1.0);
        let after = script.arm.setpoint_cp().unwrap();
        let moved = after.translation.vector - before.translation.vector;
        assert!((moved - Vector3::new(0.0, 0.01, 0.0)).norm() < 1e-9, "{moved}");
        assert!(after.rotation.angle_to(&(turn * before.rotation)) < 1e-9);
    }
}

#[test]
fn a_ratio_that_changes_during_a_move_changes_the_move() {
    let mut script = Script::psm();
    let handle = script.handle(Command::MoveJp(vec![0.5, 0.0, 0.12, 0.0, 0.0, 0.0]));
    script.run(0.2);
    script.send(Command::SetRatioV(0.1));
    assert_eq!(script.arm.ratio(), 0.0, "they differ");
    script.run(0.3);
    assert_near(&script.arm.setpoint_js().velocity[..1], &[9.0 * DEGREE], 1e-9);
    script.send(Command::SetRatio(1.0));
    assert!(script.wait_for(handle).is_some());
    assert_eq!(script.reached(handle), [true]);
    assert_near(&script.joints()[..1], &[0.5], 1e-12);
    assert_eq!(script.arm.ratio(), 1.0);
}
