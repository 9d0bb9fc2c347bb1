//! Bodies that fall, lie, are pushed and are cloned.

use nalgebra::UnitQuaternion;

use super::*;

fn cube(half: f64) -> Part {
    Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(Vector3::repeat(half)) }
}

fn at(z: f64) -> Pose {
    frames::pose([0.0, 0.0, z], [0.0; 3])
}

#[test]
fn an_object_falls_as_it_really_would() {
    let mut world = World::new(Solver::LIGHT);
    world.insert(Motion::Fixed, &at(-0.01), 1.0, &[cube(0.01)]);
    let (height, half) = (0.02, 0.005);
    let body = world.insert(Motion::Free { mass: 0.001 }, &at(height + half), 1.0, &[cube(half)]);
    world.wake(body);
    let mut landed = None;
    for substep in 1..=48 {
        world.advance();
        let time = f64::from(substep) / SUBSTEPS_PER_SECOND;
        let fallen = height + half - world.pose(body).translation.z;
        let expected = 0.5 * GRAVITY * time * time;
        if expected < height {
            assert!((fallen - expected).abs() < 0.02 * height, "{fallen} after {time} s");
        } else if landed.is_none() {
            landed = Some(time);
        }
    }
    // √(2h/g) = 63.9 ms, seen at the end of a substep of 4.2 ms.
    let landed = landed.unwrap();
    assert!((landed - 0.0639).abs() < 1.0 / SUBSTEPS_PER_SECOND, "{landed}");
    assert!(world.velocity(body).norm() < 1e-3);
    assert!((world.pose(body).translation.z - half).abs() < 1e-5);
}

#[test]
fn a_resting_object_weighs_what_it_weighs_and_falls_asleep() {
    let mut world = World::new(Solver::HEAVY);
    let plate = world.insert(Motion::Driven, &at(-0.01), 1.0, &[cube(0.01)]);
    let body = world.insert(Motion::Free { mass: 0.01 }, &at(0.001), 1.0, &[cube(0.001)]);
    world.wake(body);
    for _ in 0..100 {
        world.advance();
    }
    let push = world.push_on(&[plate]);
    assert!((push.force.z + 0.01 * GRAVITY).abs() < 0.002, "{push:?}");
    let contacts: Vec<_> = world.contacts().collect();
    let weight: Vector3<f64> = contacts.iter().map(|contact| contact.force).sum();
    assert!((weight + push.force).norm() < 1e-9, "{contacts:?}");
    for contact in contacts {
        assert_eq!((contact.on, contact.by), (body, plate));
        let Point3 { coords, .. } = contact.point;
        assert!(coords.xy().abs().max() < 1.1e-3 && coords.z.abs() < 1e-4, "{coords}");
    }
    for _ in 0..140 {
        world.advance();
    }
    assert!(world.at_rest());
}

#[test]
fn a_driven_body_wakes_and_moves_what_it_meets() {
    let mut world = World::new(Solver::HEAVY);
    world.insert(Motion::Fixed, &at(-0.1), 0.5, &[cube(0.1)]);
    let object = world.insert(Motion::Free { mass: 0.01 }, &at(0.002), 0.5, &[cube(0.002)]);
    let start = frames::pose([-0.02, 0.0, 0.0055], [0.0; 3]);
    let pusher = world.insert(Motion::Driven, &start, 0.5, &[cube(0.005)]);
    assert!(world.at_rest());
    for substep in 0..240 {
        let mut pose = start;
        pose.translation.x += 0.03 * f64::from(substep) / 240.0;
        world.drive(pusher, &pose);
        world.advance();
    }
    let moved = world.pose(object).translation.x;
    assert!((moved - (0.01 + 0.005 + 0.002)).abs() < 5e-4, "{moved}");
}

#[test]
fn a_clone_goes_on_bit_by_bit_like_the_original() {
    let mut world = World::new(Solver::LIGHT);
    world.insert(Motion::Fixed, &at(-0.01), 1.0, &[cube(0.01)]);
    let tilted = frames::pose([0.0, 0.0, 0.004], [0.3, 0.5, 0.1]);
    let body = world.insert(Motion::Free { mass: 0.001 }, &tilted, 0.3, &[cube(0.001)]);
    world.wake(body);
    let mut bits = vec![];
    for substep in 0..40 {
        let mut clone = world.clone();
        for world in [&mut world, &mut clone] {
            world.advance();
            bits.push((substep, world.pose(body).to_homogeneous().map(f64::to_bits)));
        }
    }
    for pair in bits.chunks(2) {
        assert_eq!(pair[0], pair[1]);
    }
}

#[test]
fn a_pose_of_opposite_sign_turns_a_driven_body_along_the_shorter_arc() {
    let mut world = World::new(Solver::LIGHT);
    let start = frames::pose([0.0, 0.0, 0.05], [0.1, 0.2, 0.3]);
    let body = world.insert(Motion::Driven, &start, 0.5, &[cube(0.005)]);
    let angle = 0.01; // rad, about the body's x axis
    let mut next = start;
    next.rotation *= UnitQuaternion::from_scaled_axis(Vector3::x() * angle);
    next.rotation = UnitQuaternion::new_unchecked(-next.rotation.into_inner());
    world.drive(body, &next);
    world.advance();
    let rate = f64::from(world.bodies[body.0].angvel().length());
    // Single precision: an angle of 0.01 rad has an error of 1e-5 rad or less.
    assert!((rate / SUBSTEPS_PER_SECOND - angle).abs() < 1e-5, "{rate} rad/s");
}
