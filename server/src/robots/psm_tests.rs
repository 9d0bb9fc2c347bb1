use super::*;
use nalgebra::UnitQuaternion;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The target of the project for IK∘FK, m and rad.
const ROUND_TRIP: f64 = 1e-9;
/// Configurations per model in the round trip.
const CONFIGURATIONS: usize = 100_000;
const MODELS: [Psm; 2] = [Psm::CLASSIC, Psm::SI];

fn random_joints(psm: &Psm, rng: &mut ChaCha8Rng) -> [f64; 6] {
    psm.limits().map(|limit| rng.random_range(limit.min..=limit.max))
}

/// `q` moved by up to 0.1 rad and 5 mm.
fn perturbed(q: &[f64; 6], rng: &mut ChaCha8Rng) -> [f64; 6] {
    std::array::from_fn(|i| {
        let reach = if i == 2 { 0.005 } else { 0.1 };
        q[i] + rng.random_range(-reach..=reach)
    })
}

fn largest_difference(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Largest of position (m) and angle (rad) between two poses. The chord between both rotation
/// matrices stands for the angle; unlike an arccosine it is exact near zero.
fn pose_difference(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let chord = (a.rotation.to_rotation_matrix().matrix()
        - b.rotation.to_rotation_matrix().matrix())
    .norm()
        / 2.0_f64.sqrt();
    (a.translation.vector - b.translation.vector).norm().max(chord)
}

#[test]
fn forward_kinematics_equals_the_golden_vectors() {
    #[rustfmt::skip]
    let golden = [
        (Psm::CLASSIC, [0.0, 0.0, 0.12, 0.0, 0.0, 0.0],
         [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0], [0.0, 0.0, -0.1135]),
        (Psm::CLASSIC, [0.0, 0.0, 0.10, 0.0, 0.0, 0.0],
         [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0], [0.0, 0.0, -0.0935]),
        (Psm::CLASSIC, [0.3, -0.2, 0.15, 0.5, 0.4, -0.6],
         [0.487_188_318, 0.776_429_404, -0.399_756_080,
          0.869_560_222, -0.473_595_867, 0.139_899_874,
          -0.080_700_451, -0.415_769_570, -0.905_882_499],
         [0.039_913_298, 0.025_318_431, -0.134_777_834]),
        (Psm::CLASSIC, [-0.7, 0.5, 0.20, -1.2, -0.8, 0.3],
         [-0.169_068_502, 0.281_009_578, -0.944_695_432,
          0.565_470_760, 0.812_704_882, 0.140_547_479,
          0.807_253_777, -0.510_435_492, -0.296_305_497],
         [-0.113_219_785, -0.089_369_765, -0.124_974_793]),
        (Psm::SI, [0.0, 0.0, 0.12, 0.0, 0.0, 0.0],
         [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0], [0.0, 0.0, -0.1135]),
    ];
    for (psm, q, rotation, position) in golden {
        let pose = psm.base_from_wrist(&q);
        let rotation = Matrix3::from_row_slice(&rotation);
        let error = (pose.rotation.to_rotation_matrix().matrix() - rotation).amax();
        assert!(error < 1e-8, "rotation at {q:?}: {error:e}");
        let error = (pose.translation.vector - Vector3::from(position)).amax();
        assert!(error < 1e-8, "position at {q:?}: {error:e} m");
    }
}

#[test]
fn both_generations_have_the_same_pose_at_equal_joint_values() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..1000 {
        let q = random_joints(&Psm::CLASSIC, &mut rng);
        let (classic, si) = (Psm::CLASSIC.base_from_wrist(&q), Psm::SI.base_from_wrist(&q));
        assert!(pose_difference(&classic, &si) < 1e-14);
    }
}

#[test]
fn the_tip_is_one_jaw_length_past_the_wrist_along_the_approach_axis() {
    let q = [0.3, -0.2, 0.15, 0.5, 0.4, -0.6];
    let (wrist, tip) = (Psm::CLASSIC.base_from_wrist(&q), Psm::CLASSIC.base_from_tip(&q));
    let approach = wrist.rotation * Vector3::z();
    let offset = tip.translation.vector - wrist.translation.vector;
    assert!((offset - 0.0102 * approach).norm() < 1e-15);
    assert_eq!(tip.rotation, wrist.rotation);
}

#[test]
fn the_inverse_undoes_the_forward_kinematics() {
    for psm in MODELS {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut worst_joint, mut worst_pose) = (0.0_f64, 0.0_f64);
        for _ in 0..CONFIGURATIONS {
            let q = random_joints(&psm, &mut rng);
            let pose = psm.base_from_wrist(&q);
            let found = psm.inverse(&pose, &perturbed(&q, &mut rng)).unwrap();
            worst_joint = worst_joint.max(largest_difference(&q, &found));
            worst_pose = worst_pose.max(pose_difference(&pose, &psm.base_from_wrist(&found)));
        }
        println!("worst joint {worst_joint:.1e} (rad, m), worst pose {worst_pose:.1e} (rad, m)");
        assert!(worst_joint < ROUND_TRIP, "joints: {worst_joint:e}");
        assert!(worst_pose < ROUND_TRIP, "poses: {worst_pose:e}");
    }
}

/// With the wrist inside the cannula two configurations leave a joint open: the pose must come
/// back exactly, the joints may differ but must stay where the seed is.
#[test]
fn a_singular_pose_keeps_the_seed() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let psm = Psm::CLASSIC;
    for _ in 0..10_000 {
        let mut q = random_joints(&psm, &mut rng);
        // The wrist-pitch axis at the remote centre.
        q[2] = 0.0156;
        let pose = psm.base_from_wrist(&q);
        let found = psm.inverse(&pose, &q).unwrap();
        assert!(pose_difference(&pose, &psm.base_from_wrist(&found)) < ROUND_TRIP);
        assert!(largest_difference(&q, &found) < 1e-2, "{q:?} became {found:?}");

        // The remote centre on the wrist-yaw axis.
        q[4] = rng.random_range(-0.9..0.9);
        q[2] = 0.0156 - PITCH_TO_YAW / sin_cos(q[4]).1;
        if psm.limits()[2].contains(q[2]) {
            let pose = psm.base_from_wrist(&q);
            let found = psm.inverse(&pose, &q).unwrap();
            assert!(pose_difference(&pose, &psm.base_from_wrist(&found)) < ROUND_TRIP);
        }
    }
}

#[test]
fn the_inverse_keeps_joints_that_are_at_their_limits() {
    let psm = Psm::CLASSIC;
    let limits = psm.limits();
    for corner in 0..64_u32 {
        let q =
            std::array::from_fn(
                |i| {
                    if corner >> i & 1 == 0 { limits[i].min } else { limits[i].max }
                },
            );
        let found = psm.inverse(&psm.base_from_wrist(&q), &q).unwrap();
        assert!(largest_difference(&q, &found) < ROUND_TRIP, "{q:?} became {found:?}");
        assert!(limits.iter().zip(found).all(|(limit, value)| limit.contains(value)));
    }
}

#[test]
fn the_roll_stays_in_the_turn_of_the_seed_while_the_limits_allow() {
    let psm = Psm::CLASSIC;
    let q = [0.1, 0.2, 0.1, 3.0, 0.3, -0.2];
    let pose = psm.base_from_wrist(&q);
    for (seed_roll, expected) in [(3.5, 3.0), (-3.5, 3.0 - TAU), (0.1, 3.0), (40.0, 3.0)] {
        let seed = [0.1, 0.2, 0.1, seed_roll, 0.3, -0.2];
        let found = psm.inverse(&pose, &seed).unwrap();
        assert!((found[3] - expected).abs() < ROUND_TRIP, "seed {seed_roll}: {}", found[3]);
    }
    // 1 rad + 2π is past the limit: the only roll left is 1 rad, whatever the seed.
    let pose = psm.base_from_wrist(&[0.1, 0.2, 0.1, 1.0, 0.3, -0.2]);
    let found = psm.inverse(&pose, &[0.1, 0.2, 0.1, 4.5, 0.3, -0.2]).unwrap();
    assert!((found[3] - 1.0).abs() < ROUND_TRIP);
}

#[test]
fn every_pose_in_space_gives_a_solution_or_a_typed_refusal() {
    let psm = Psm::CLASSIC;
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (mut solved, mut limited, mut far) = (0, 0, 0);
    for _ in 0..100_000 {
        let position = Translation3::from(Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2)));
        let [x, y, z, w] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let pose = Isometry3::from_parts(
            position,
            UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z)),
        );
        match psm.inverse(&pose, &[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]) {
            Ok(q) => {
                solved += 1;
                assert!(pose_difference(&pose, &psm.base_from_wrist(&q)) < ROUND_TRIP);
                assert!(psm.limits().iter().zip(q).all(|(limit, value)| limit.contains(value)));
            }
            Err(IkError::JointLimit { value, min, max, .. }) => {
                limited += 1;
                assert!(value < min || value > max);
            }
            Err(IkError::OutOfReach { distance, reach }) => {
                far += 1;
                assert!(distance > reach);
            }
            Err(IkError::NotFinite) => panic!("{pose} is finite"),
        }
    }
    assert!(solved > 1000 && limited > 1000 && far > 1000, "{solved} {limited} {far}");
}

#[test]
fn an_unreachable_target_says_what_is_in_the_way() {
    let psm = Psm::CLASSIC;
    let seed = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0];
    let deep = psm.base_from_wrist(&[0.0, 0.0, 0.25, 0.0, 0.0, 0.0]);
    let Err(IkError::OutOfReach { distance, reach }) = psm.inverse(&deep, &seed) else {
        panic!("10 mm too deep must be out of reach");
    };
    assert!((distance - 0.2435).abs() < 1e-12 && (reach - 0.2335).abs() < 1e-12);

    for (joint, value) in [
        ("yaw", 1.7),
        ("pitch", 1.0),
        ("insertion", -0.01),
        ("wrist_pitch", 1.5),
        ("wrist_yaw", -1.5),
    ] {
        let mut q = [0.2, 0.1, 0.1, 0.4, 0.3, -0.2];
        let index = psm.limits().iter().position(|limit| limit.name == joint).unwrap();
        q[index] = value;
        let Err(IkError::JointLimit { joint: found, value: needed, .. }) =
            psm.inverse(&psm.base_from_wrist(&q), &seed)
        else {
            panic!("{joint} at {value} must be refused");
        };
        assert_eq!(found, joint);
        assert!((needed - value).abs() < ROUND_TRIP);
    }
}

#[test]
fn a_target_or_seed_that_is_not_finite_is_refused() {
    let psm = Psm::CLASSIC;
    let q = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0];
    let pose = psm.base_from_wrist(&q);
    let mut broken = pose;
    broken.translation.x = f64::NAN;
    assert_eq!(psm.inverse(&broken, &q), Err(IkError::NotFinite));
    let nan = nalgebra::Quaternion::new(f64::NAN, 0.0, 0.0, 0.0);
    let broken = Isometry3::from_parts(pose.translation, UnitQuaternion::new_unchecked(nan));
    assert_eq!(psm.inverse(&broken, &q), Err(IkError::NotFinite));
    assert_eq!(psm.inverse(&pose, &[f64::INFINITY; 6]), Err(IkError::NotFinite));
}

#[test]
fn the_jacobian_is_the_derivative_of_the_forward_kinematics() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let h = 1e-6;
    for psm in MODELS {
        for _ in 0..200 {
            let q = random_joints(&psm, &mut rng);
            let jacobian = psm.jacobian(&q);
            for joint in 0..6 {
                let (mut above, mut below) = (q, q);
                above[joint] += h;
                below[joint] -= h;
                let (above, below) = (psm.base_from_wrist(&above), psm.base_from_wrist(&below));
                let linear = (above.translation.vector - below.translation.vector) / (2.0 * h);
                let angular = (above.rotation / below.rotation).scaled_axis() / (2.0 * h);
                let column = jacobian.column(joint);
                assert!((column.fixed_rows::<3>(0) - linear).amax() < 1e-8);
                assert!((column.fixed_rows::<3>(3) - angular).amax() < 1e-8);
            }
        }
    }
}
