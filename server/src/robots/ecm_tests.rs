use super::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const MODELS: [Ecm; 2] = [Ecm::CLASSIC, Ecm::SI];

fn random_joints(ecm: &Ecm, rng: &mut ChaCha8Rng) -> [f64; 4] {
    ecm.limits().map(|limit| rng.random_range(limit.min..=limit.max))
}

#[test]
fn forward_kinematics_equals_the_golden_vectors() {
    #[rustfmt::skip]
    let golden = [
        ([0.0, 0.0, 0.12, 0.0],
         [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0], [0.0, 0.0, -0.1207]),
        ([0.0, 0.0, 0.05, 0.0],
         [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0], [0.0, 0.0, -0.0507]),
        ([0.3, -0.2, 0.10, 0.5],
         [0.866_534_101, -0.406_489_135, 0.289_629_478,
          -0.469_868_947, -0.860_089_338, 0.198_669_331,
          0.168_350_301, -0.308_241_648, -0.936_293_364],
         [0.029_165_688, 0.020_006_002, -0.094_284_742]),
    ];
    for ecm in MODELS {
        for (q, rotation, position) in golden {
            let pose = ecm.base_from_camera(&q);
            let rotation = Matrix3::from_row_slice(&rotation);
            let error = (pose.rotation.to_rotation_matrix().matrix() - rotation).amax();
            assert!(error < 1e-8, "rotation at {q:?}: {error:e}");
            let error = (pose.translation.vector - Vector3::from(position)).amax();
            assert!(error < 1e-8, "position at {q:?}: {error:e} m");
        }
    }
}

#[test]
fn angled_endoscopes_look_thirty_degrees_up_and_down() {
    let q = [0.3, -0.2, 0.10, 0.5];
    let straight = Ecm::CLASSIC.base_from_camera(&q);
    for (endoscope, tilt) in [(Endoscope::Up30, 0.5), (Endoscope::Down30, -0.5)] {
        let camera = Ecm::CLASSIC.with_endoscope(endoscope).base_from_camera(&q);
        assert_eq!(camera.translation, straight.translation);
        let view = straight.rotation.inverse() * (camera.rotation * Vector3::z());
        assert!((view - Vector3::new(0.0, tilt, 0.75_f64.sqrt())).norm() < 1e-15, "{view}");
    }
}

#[test]
fn the_inverse_undoes_the_forward_kinematics() {
    for ecm in MODELS {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut worst = 0.0_f64;
        for _ in 0..100_000 {
            let q = random_joints(&ecm, &mut rng);
            let mut seed = q.map(|value| value + rng.random_range(-0.005..=0.005));
            seed[3] = q[3];
            let position = ecm.base_from_camera(&q).translation.vector;
            let found = ecm.inverse_position(&position, &seed).unwrap();
            worst = q.iter().zip(found).map(|(a, b)| (a - b).abs()).fold(worst, f64::max);
        }
        println!("worst joint {worst:.1e} (rad, m)");
        assert!(worst < 1e-9, "{worst:e}");
    }
}

#[test]
fn an_unreachable_position_says_what_is_in_the_way() {
    let ecm = Ecm::CLASSIC;
    let seed = [0.0, 0.0, 0.1, 0.2];
    let far = ecm.inverse_position(&Vector3::new(0.0, 0.0, -0.3), &seed);
    assert!(matches!(far, Err(IkError::OutOfReach { .. })), "{far:?}");
    let refused =
        |position: Vector3<f64>, seed: [f64; 4]| match ecm.inverse_position(&position, &seed) {
            Err(IkError::JointLimit { joint, .. }) => joint,
            other => panic!("{position} gives {other:?}"),
        };
    assert_eq!(refused(Vector3::new(0.0, 0.0, 0.1), seed), "yaw");
    assert_eq!(refused(Vector3::new(0.0, -0.1, 0.0), seed), "pitch");
    assert_eq!(refused(Vector3::zeros(), seed), "insertion");
    assert_eq!(refused(Vector3::new(0.0, 0.0, -0.1), [0.0, 0.0, 0.1, 1.6]), "roll");
    let nan = ecm.inverse_position(&Vector3::new(0.0, f64::NAN, 0.0), &seed);
    assert_eq!(nan, Err(IkError::NotFinite));
}

#[test]
fn the_jacobian_is_the_derivative_of_the_forward_kinematics() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let h = 1e-6;
    for ecm in MODELS {
        for _ in 0..200 {
            let q = random_joints(&ecm, &mut rng);
            let jacobian = ecm.jacobian(&q);
            for joint in 0..4 {
                let (mut above, mut below) = (q, q);
                above[joint] += h;
                below[joint] -= h;
                let (above, below) = (ecm.base_from_camera(&above), ecm.base_from_camera(&below));
                let linear = (above.translation.vector - below.translation.vector) / (2.0 * h);
                let angular = (above.rotation / below.rotation).scaled_axis() / (2.0 * h);
                let column = jacobian.column(joint);
                assert!((column.fixed_rows::<3>(0) - linear).amax() < 1e-8);
                assert!((column.fixed_rows::<3>(3) - angular).amax() < 1e-8);
            }
        }
    }
}

#[test]
fn the_path_of_the_tip_is_as_long_as_a_fine_polygon() {
    for ecm in MODELS {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..1000 {
            let start = random_joints(&ecm, &mut rng);
            // As far as commands go in a step.
            let step = [0.06, 0.06, 0.01, 0.06].map(|most: f64| rng.random_range(-most..=most));
            let at = |part: f64| std::array::from_fn(|joint| start[joint] + part * step[joint]);
            let places: Vec<_> = (0..=1000)
                .map(|part| ecm.base_from_camera(&at(f64::from(part) / 1000.0)).translation.vector)
                .collect();
            let polygon: f64 = places.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            let path = ecm.tip_path(&start, &at(1.0));
            assert!((path / polygon - 1.0).abs() < 1e-6, "{start:?}, {step:?}: {path}, {polygon}");
        }
        // Straight on, and about its own axis.
        let path = ecm.tip_path(&[0.3, 0.2, 0.1, 0.0], &[0.3, 0.2, 0.11, 0.5]);
        assert!((path - 0.01).abs() < 1e-15, "{path}");
        assert!(ecm.tip_path(&[0.3, 0.2, 0.1, 0.0], &[0.3, 0.2, 0.1, 0.5]) == 0.0);
    }
}
