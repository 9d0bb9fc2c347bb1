//! How the endoscope stands, moves and turns.

use super::*;

/// An arm in the middle of its workspace.
fn arm(options: &Options, control: Control) -> EcmArm {
    let mut arm = EcmArm::new(options, control).unwrap();
    assert!(arm.start_at(&Vector3::new(0.5, 0.0, 0.7)));
    arm.reset(&mut Rng::new(0, 0));
    arm
}

/// Lets a step pass under `action`.
fn pass(arm: &mut EcmArm, action: &[f32]) {
    arm.command(Some(action));
    arm.glide(1.0);
}

#[test]
fn the_arm_stands_where_the_originals_does() {
    let arm = arm(&Options::new(), Control::Position);
    let rcm = arm.world_from_rcm.translation.vector;
    assert!((rcm - Vector3::new(0.53133, 0.0, 0.78409)).norm() < 1e-5);
    // The original's lens under joints (0, 0, 0.04, 0), looking down at 30° towards −x.
    let camera = arm.world_from_rcm * arm.kinematics.base_from_camera(&[0.0, 0.0, 0.04, 0.0]);
    assert!((camera.translation.vector - Vector3::new(0.511, 0.0, 0.749)).norm() < 1e-3);
    let axis = camera.rotation * Vector3::z();
    assert!((axis - Vector3::new(-0.5, 0.0, -0.75f64.sqrt())).norm() < 1e-9);
}

#[test]
fn every_action_mode_moves_the_camera_as_its_encoding_says() {
    for mode in ["paper", "cartesian", "cartesian_abs", "joint"] {
        let options = Options::new().with_text("action", mode);
        let mut arm = arm(&options, Control::Position);
        let before = arm.rcm_from_camera.translation.vector;
        let step = Vector3::new(0.003, -0.004, -0.002);
        let mut action = vec![0.0; arm.action_elements().len()];
        arm.encode(&step, 0.0, &mut action);
        assert!(action.iter().all(|number| number.abs() <= 1.0), "{mode}: {action:?}");
        pass(&mut arm, &action);
        let off = arm.rcm_from_camera.translation.vector - before - step;
        assert!(off.norm() < 1e-7, "{mode}: {off}");
    }
}

#[test]
fn an_unreachable_position_leaves_the_arm_where_it_is() {
    let mut arm = arm(&Options::new(), Control::Position);
    for _ in 0..100 {
        pass(&mut arm, &[0.0, 0.0, 1.0]);
    }
    let stopped = arm.joints;
    pass(&mut arm, &[0.0, 0.0, 1.0]);
    assert_eq!(arm.joints, stopped);
    let limits = arm.kinematics.limits();
    assert!(arm.joints.iter().zip(limits).all(|(q, l)| l.min <= *q && *q <= l.max));
    pass(&mut arm, &[0.0, 0.0, -1.0]);
    assert!(arm.joints != stopped);
}

#[test]
fn a_velocity_across_turns_the_picture_towards_it_and_keeps_it_level() {
    for (velocity, axis) in [([1.0, 0.0, 0.0], 0), ([0.0, -1.0, 0.0], 1)] {
        let mut arm = arm(&Options::new(), Control::Velocity);
        let target = arm.world_from_camera() * Point3::new(0.0, 0.0, 0.9);
        for step in 1..=10 {
            pass(&mut arm, &velocity);
            let seen = arm.world_from_camera().inverse_transform_point(&target);
            // What was in the middle moves to the other side, by 25 mrad a step less what the
            // arm makes of a turn about the lens by turning about its remote centre.
            let image = [-seen.x / seen.z, -seen.y / seen.z];
            let moved = -image[axis] * f64::from(velocity[axis]) / f64::from(step);
            assert!((0.8 * STEP_TURN..1.5 * STEP_TURN).contains(&moved), "{image:?}");
            assert!(image[1 - axis].abs() < 0.1 * image[axis].abs(), "{image:?}");
            assert!(arm.misorientation().abs() < 5e-3, "{}", arm.misorientation());
        }
    }
}

#[test]
fn a_velocity_forward_brings_the_camera_on_and_takes_the_misorientation_away() {
    let mut arm = arm(&Options::new(), Control::Velocity);
    let [yaw, pitch, insertion, _] = arm.joints;
    arm.sense([yaw, pitch, insertion, 0.2]);
    let start = arm.joints;
    let mut before = arm.misorientation().abs();
    for step in 1..=10 {
        pass(&mut arm, &[0.0, 0.0, 1.0]);
        let on = arm.joints[2] - start[2];
        assert!((on - 0.5e-3 * f64::from(step)).abs() < 1e-9, "{on}");
        let now = arm.misorientation().abs();
        assert!(now < (before - 0.9 * STEP_ROLL).max(1e-3), "{step}: {now}");
        before = now;
    }
}

#[test]
fn joints_stop_at_their_limits_under_a_velocity() {
    for (model, kinematics) in [("classic", Ecm::CLASSIC), ("si", Ecm::SI)] {
        let mut rng = Rng::new(4, 0);
        let mut arm = arm(&Options::new().with_text("arm", model), Control::Velocity);
        let mut stopped = [false; 4];
        for _ in 0..40 {
            let action: [f32; 3] = std::array::from_fn(|_| rng.uniform(-1.0, 1.0).signum() as f32);
            for _ in 0..100 {
                pass(&mut arm, &action);
                for (joint, limit) in kinematics.limits().iter().enumerate() {
                    let q = arm.joints[joint];
                    assert!(limit.contains(q), "{model}: {q}");
                    stopped[joint] |= q == limit.min || q == limit.max;
                }
            }
        }
        assert!(stopped[1] && stopped[2], "{model}: {stopped:?}");
    }
}

#[test]
fn equal_joints_of_either_generation_give_the_same_view_and_starts_are_within_its_limits() {
    let [mut classic, mut si] = ["classic", "si"]
        .map(|model| arm(&Options::new().with_text("arm", model), Control::Position));
    assert_eq!(si.joints, classic.joints);
    assert_eq!(si.world_from_camera(), classic.world_from_camera());
    for arm in [&mut classic, &mut si] {
        arm.start_with(&[0.5, -0.3, 0.0, -0.2]);
        arm.reset(&mut Rng::new(0, 0));
    }
    assert_eq!(classic.joints, [0.5, -0.3, 0.0, -0.2]);
    assert_eq!(si.joints, [0.5, -0.3, 0.001, -0.2]);
}

#[test]
fn the_originals_sign_is_the_opposite() {
    let surrol = Options::new().with_text("preset", "surrol");
    let [mut here, mut there] =
        [Options::new(), surrol].map(|options| arm(&options, Control::Velocity));
    pass(&mut here, &[0.5, -1.0, 0.25]);
    pass(&mut there, &[-0.5, 1.0, -0.25]);
    assert_eq!(here.joints, there.joints);
}
