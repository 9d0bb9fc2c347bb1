//! Forward and inverse kinematics as services, against golden vectors and each other.

use nalgebra::Matrix3;

use super::*;
use crate::dvrk::NoSolution;
use crate::robots::{ArmModel, Endoscope};

/// The digits of the golden vectors.
const GOLDEN: f64 = 1e-9;

/// What the inverse may err by, rad and m.
const ROUND_TRIP: f64 = 1e-9;

/// An arm, its joints, and the rotation (row by row) and position (m) of its end.
type Golden = (Mechanism, &'static [f64], [f64; 9], [f64; 3]);

const DOWN: [f64; 9] = [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0];
const LOOKS_DOWN: [f64; 9] = [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0];

#[test]
fn the_services_give_the_golden_vectors() {
    let psm = Mechanism::Psm(Psm::CLASSIC);
    let ecm = Mechanism::Ecm(Ecm::CLASSIC);
    #[rustfmt::skip]
    let golden: [Golden; 8] = [
        (psm, &[0.0, 0.0, 0.12, 0.0, 0.0, 0.0], DOWN, [0.0, 0.0, -0.1135]),
        (psm, &[0.0, 0.0, 0.10, 0.0, 0.0, 0.0], DOWN, [0.0, 0.0, -0.0935]),
        (psm, &[0.3, -0.2, 0.15, 0.5, 0.4, -0.6],
         [0.487_188_318, 0.776_429_404, -0.399_756_080,
          0.869_560_222, -0.473_595_867, 0.139_899_874,
          -0.080_700_451, -0.415_769_570, -0.905_882_499],
         [0.039_913_298, 0.025_318_431, -0.134_777_834]),
        (psm, &[-0.7, 0.5, 0.20, -1.2, -0.8, 0.3],
         [-0.169_068_502, 0.281_009_578, -0.944_695_432,
          0.565_470_760, 0.812_704_882, 0.140_547_479,
          0.807_253_777, -0.510_435_492, -0.296_305_497],
         [-0.113_219_785, -0.089_369_765, -0.124_974_793]),
        (Mechanism::Psm(Psm::SI), &[0.0, 0.0, 0.12, 0.0, 0.0, 0.0], DOWN, [0.0, 0.0, -0.1135]),
        (ecm, &[0.0, 0.0, 0.12, 0.0], LOOKS_DOWN, [0.0, 0.0, -0.1207]),
        (ecm, &[0.0, 0.0, 0.05, 0.0], LOOKS_DOWN, [0.0, 0.0, -0.0507]),
        (ecm, &[0.3, -0.2, 0.10, 0.5],
         [0.866_534_101, -0.406_489_135, 0.289_629_478,
          -0.469_868_947, -0.860_089_338, 0.198_669_331,
          0.168_350_301, -0.308_241_648, -0.936_293_364],
         [0.029_165_688, 0.020_006_002, -0.094_284_742]),
    ];
    for (mechanism, joints, rotation, position) in golden {
        let arm = Script::new(&mechanism).arm;
        let pose = arm.forward_kinematics(joints).unwrap();
        let off = pose.translation.vector - nalgebra::Vector3::from(position);
        assert!(off.amax() < GOLDEN, "{joints:?}: {off}");
        let turned = pose.rotation.to_rotation_matrix().into_inner();
        assert!((turned - Matrix3::from_row_slice(&rotation)).amax() < GOLDEN, "{joints:?}");
    }
}

#[test]
fn shorter_vectors_give_the_frame_along_the_chain() {
    for mechanism in [Mechanism::Psm(Psm::CLASSIC), Mechanism::Ecm(Ecm::CLASSIC)] {
        let base = Pose::translation(0.1, 0.2, 0.3);
        let arm = Script::new(&mechanism).arm.with_base_frame("table", base);
        assert!(far(&arm.forward_kinematics(&[]).unwrap(), &base) < 1e-15);
        assert_eq!(arm.local_forward_kinematics(&[]).unwrap(), Pose::identity());
        let q = [0.3, -0.2, 0.15];
        // The insertion's frame lies on the shaft, as deep below the remote centre as its offset and value say.
        let offset = if mechanism.joints() == 6 { -0.4318 } else { -0.3822 };
        let depth = arm.local_forward_kinematics(&q).unwrap().translation.vector.norm();
        assert!((depth - f64::abs(0.15 + offset)).abs() < 1e-12, "{depth}");
        let all = vec![0.1; mechanism.joints()];
        assert_eq!(arm.local_forward_kinematics(&all).unwrap(), mechanism.forward(&all));
        let many = vec![0.1; mechanism.joints() + 1];
        let refused = arm.forward_kinematics(&many).unwrap_err();
        assert!(refused.to_string().contains("too many joints"), "{refused}");
        assert!(arm.forward_kinematics(&[f64::NAN]).is_err());
    }
}

/// Joints within the limits, instrument or endoscope as deep as the inverse leaves them.
fn random_joints(mechanism: &Mechanism, rng: &mut Rng) -> Vec<f64> {
    let least = if mechanism.joints() == 6 { 0.0606 } else { 0.04 };
    (0..mechanism.joints())
        .map(|axis| {
            let limit = mechanism.limit(axis);
            let min = if axis == 2 { least } else { limit.min };
            rng.uniform(min, limit.max)
        })
        .collect()
}

#[test]
fn the_inverse_undoes_the_forward_kinematics_without_the_base_frame() {
    for mechanism in [
        Mechanism::Psm(Psm::CLASSIC),
        Mechanism::Psm(Psm::SI),
        Mechanism::Ecm(Ecm::CLASSIC),
        Mechanism::Ecm(Ecm::SI),
        Mechanism::Ecm(Ecm::new(ArmModel::Classic, Endoscope::Up30)),
    ] {
        let arm = Script::new(&mechanism).arm;
        let arm = arm.with_base_frame("table", Pose::translation(0.3, 0.2, 0.1));
        let mut rng = Rng::new(8, 0);
        for _ in 0..20_000 {
            let joints = random_joints(&mechanism, &mut rng);
            let seed: Vec<f64> = joints.iter().map(|q| q + rng.uniform(-0.1, 0.1)).collect();
            let pose = arm.local_forward_kinematics(&joints).unwrap();
            if joints.len() == 4 && pose.translation.z > 0.0 {
                continue; // the yaw of an Si goes past the horizontal
            }
            let pose = PoseMessage::new(&pose);
            let found = arm.inverse_kinematics(&pose, &seed).unwrap();
            assert_near(&found, &joints, ROUND_TRIP);
        }
    }
}

#[test]
fn from_any_seed_the_inverse_of_a_psm_reaches_the_pose() {
    let mechanism = Mechanism::Psm(Psm::CLASSIC);
    let mut rng = Rng::new(9, 0);
    let mut bent = 0;
    for _ in 0..20_000 {
        let [joints, seed] = [(); 2].map(|()| random_joints(&mechanism, &mut rng));
        let pose = mechanism.forward(&joints);
        let found = mechanism.inverse(&pose, &seed).unwrap();
        // A wrist that is bent over is longer by up to two links; the shaft may be kept longer than that.
        if found[2] > 0.0606 + 1e-9 {
            assert!(far(&mechanism.forward(&found), &pose) < ROUND_TRIP, "{joints:?} {seed:?}");
        }
        bent += usize::from(found[4].abs() > 90.0 * DEGREE);
        assert!((found[3] - seed[3]).abs() <= std::f64::consts::PI + ROUND_TRIP);
    }
    // Some seeds are as near to a wrist that is bent over.
    assert!(bent < 200, "{bent} of 20,000 are bent over");
}

#[test]
fn a_wrist_that_is_servoed_past_its_limit_stays_there() {
    let mut script = Script::psm();
    let start = script.arm.setpoint_cp().unwrap();
    let axis = nalgebra::Vector3::y_axis();
    let mut last = script.joints();
    let mut furthest: f64 = 0.0;
    for degree in 0..130 {
        let turn = nalgebra::UnitQuaternion::from_axis_angle(&axis, f64::from(degree) * DEGREE);
        let goal = Pose::from_parts(start.translation, turn * start.rotation);
        script.send(Command::ServoCp(PoseMessage::new(&goal)));
        script.tick();
        let joints = script.joints();
        let step = joints.iter().zip(&last).map(|(q, last)| (q - last).abs()).fold(0.0, f64::max);
        assert!(step < 5.0 * DEGREE, "a jump of {} ° at {degree} °", step / DEGREE);
        furthest = furthest.max(joints[5].abs());
        last = joints;
    }
    assert_near(&[furthest], &[1.396_26], 0.0);
}

#[test]
fn an_ecm_drops_the_part_of_an_orientation_that_it_cannot_have() {
    let ecm = Mechanism::Ecm(Ecm::CLASSIC);
    let joints = [0.2, 0.1, 0.1, 0.3];
    let pose = ecm.forward(&joints);
    let tilt = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), 0.2);
    let tilted = Pose::from_parts(pose.translation, pose.rotation * tilt);
    let found = ecm.inverse(&tilted, &joints).unwrap();
    assert_near(&found, &joints, 0.01);
    let here = ecm.forward(&found);
    assert!((here.translation.vector - pose.translation.vector).norm() < ROUND_TRIP);

    let above = Pose::from_parts(nalgebra::Vector3::new(0.0, 0.01, 0.05).into(), pose.rotation);
    assert_eq!(ecm.inverse(&above, &joints), Err(NoSolution::AboveRemoteCentre));
    let shallow = ecm.forward(&[0.2, 0.1, 0.02, 0.3]);
    assert_near(&ecm.inverse(&shallow, &joints).unwrap(), &[0.2, 0.1, 0.04, 0.3], ROUND_TRIP);
    for beyond in
        [[1.7, 0.1, 0.1, 0.3], [0.2, 1.2, 0.1, 0.3], [0.2, 0.1, 0.3, 0.3], [0.2, 0.1, 0.1, 2.0]]
    {
        assert!(ecm.inverse(&ecm.forward(&beyond), &joints).is_err(), "{beyond:?}");
    }
}

#[test]
fn a_service_refuses_what_is_malformed() {
    let arm = Script::psm().arm;
    let pose = PoseMessage::new(&arm.local_measured_cp().unwrap());
    for count in [0, 5, 7] {
        let refused = arm.inverse_kinematics(&pose, &vec![0.1; count]).unwrap_err();
        assert!(refused.to_string().contains("incorrect number of joints"), "{refused}");
    }
    assert!(arm.inverse_kinematics(&pose, &[f64::NAN; 6]).is_err());
    let broken = PoseMessage { orientation: [0.0; 4], ..pose };
    assert!(arm.inverse_kinematics(&broken, &[0.1; 6]).is_err());
}
