//! A cylinder against closed form: it rolls, and it falls over where it must.

use std::f64::consts::{FRAC_PI_2, TAU};

use trocar_server::assets::Model;
use trocar_server::sim::frames::{self, Pose};
use trocar_server::sim::world::{
    BodyId, GRAVITY, Motion, Part, SUBSTEPS_PER_SECOND, Shape, Solver, World,
};

/// The pin on a plate that falls by `slope` (rad) along x; `plate_from_pin` is where it touches the plate.
fn on_plate(slope: f64, plate_from_pin: &Pose) -> (World, BodyId) {
    let tilt = frames::pose([0.0; 3], [0.0, slope, 0.0]);
    let mut world = World::new(Solver::LIGHT);
    let half = [0.3, 0.3, 0.01].into();
    let plate = Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(half) };
    world.insert(Motion::Fixed, &(tilt * Pose::translation(0.0, 0.0, -half.z)), 1.0, &[plate]);
    let model = Model::cylinder();
    let pin = model.insert(&mut world, model.mass, &(tilt * plate_from_pin));
    world.wake(pin);
    (world, pin)
}

/// Radius and half the length, m.
fn size() -> [f64; 2] {
    let half = Model::cylinder().aabb(&Pose::identity()).max;
    assert!((half.x - half.y).abs() < 1e-9);
    [half.x, half.z]
}

#[test]
fn a_cylinder_rolls_down_a_slope_with_two_thirds_of_the_acceleration_of_one_that_slides() {
    const SLOPE: f64 = 0.1;
    let [radius, _] = size();
    let mut lying = frames::pose([0.0; 3], [FRAC_PI_2, 0.0, 0.0]);
    lying.translation.z = radius;
    let (mut world, pin) = on_plate(SLOPE, &lying);
    let start = world.pose(pin).translation.vector;
    let seconds = 0.5;
    for _ in 0..(seconds * SUBSTEPS_PER_SECOND) as u32 {
        world.advance();
    }
    // ½ a t² with a = g sin(slope) / (1 + I / (m r²)); its broken edges change the inertia by less than 2 %.
    let expected = 0.5 * seconds * seconds * GRAVITY * SLOPE.sin() / 1.5;
    let rolled = (world.pose(pin).translation.vector - start).norm();
    eprintln!("rolled {rolled:.5} m of {expected:.5}");
    assert!((rolled / expected - 1.0).abs() < 0.03, "{rolled} {expected}");
}

#[test]
fn a_cylinder_stands_on_a_slope_until_its_weight_is_beyond_its_rim() {
    let [radius, half_length] = size();
    let limit = libm::atan(radius / half_length);
    for turn in 0..8 {
        let turn = TAU * f64::from(turn) / 8.0 / 4.0;
        let falls = |slope: f64| {
            let standing = frames::pose([0.0, 0.0, half_length], [0.0, 0.0, turn]);
            let (mut world, pin) = on_plate(slope, &standing);
            let start = world.pose(pin);
            for _ in 0..SUBSTEPS_PER_SECOND as u32 {
                world.advance();
            }
            world.pose(pin).rotation.angle_to(&start.rotation) > 0.5
        };
        let mut found = [0.0, FRAC_PI_2];
        for _ in 0..10 {
            let middle = 0.5 * (found[0] + found[1]);
            found[usize::from(falls(middle))] = middle;
        }
        eprintln!(
            "turned by {turn:.2}: falls from {:.1}° on, of {:.1}°",
            found[1].to_degrees(),
            limit.to_degrees()
        );
        // The engine's contacts of a round end are the corners of a square in it: less than the rim bears.
        let part = found[1] / limit;
        assert!((0.85..1.01).contains(&part), "{turn}: {part}");
    }
}
