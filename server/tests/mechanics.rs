//! The world against closed form: falling, sliding, gripping, resting, and what bodies weigh.
//!
//! Friction coefficients of two bodies are averaged; bodies here have the same, so that it is theirs.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, Point3, Vector3};
use trocar_server::assets::Model;
use trocar_server::sim::frames::{self, Pose};
use trocar_server::sim::instrument::{
    FINGER_HALF, Instrument, JAW_CLOSED, JAW_OPEN, Posture, TIP_OFFSET,
};
use trocar_server::sim::motion::{self, Effort, Profile, carry_out};
use trocar_server::sim::world::{
    BodyId, GRAVITY, Motion, Part, SUBSTEPS_PER_SECOND, Shape, Solver, World,
};
use trocar_server::tasks::objects::Object;
use trocar_server::tasks::options::{Domain, Preset, Variation};
use trocar_server::tasks::tray::{self, Needle};

/// A flat slab of acetal: half extents, m, and mass, kg.
const SLAB: Vector3<f64> = Vector3::new(8e-3, 6e-3, 1e-3);
const SLAB_MASS: f64 = 1410.0 * 8.0 * 8e-3 * 6e-3 * 1e-3;

const SOLVERS: [Solver; 2] = [Solver::LIGHT, Solver::HEAVY];

fn cuboid(half: Vector3<f64>) -> Part {
    Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(half) }
}

/// A slab at rest on a plate that falls by `slope` (rad) along x.
fn slab_on_plate(solver: Solver, slope: f64, friction: f64) -> (World, BodyId) {
    let tilt = frames::pose([0.0; 3], [0.0, slope, 0.0]);
    let mut world = World::new(solver);
    let plate = Vector3::new(0.3, 0.3, 0.01);
    let below = tilt * Pose::translation(0.0, 0.0, -plate.z);
    world.insert(Motion::Fixed, &below, friction, &[cuboid(plate)]);
    let above = tilt * Pose::translation(0.0, 0.0, SLAB.z);
    let free = Motion::Free { mass: SLAB_MASS };
    let slab = world.insert(free, &above, friction, &[cuboid(SLAB)]);
    (world, slab)
}

fn run(world: &mut World, seconds: f64) {
    for _ in 0..(seconds * SUBSTEPS_PER_SECOND) as u32 {
        world.advance();
    }
}

#[test]
fn what_is_dropped_falls_by_half_g_t_squared_at_every_substep() {
    for solver in SOLVERS {
        let mut world = World::new(solver);
        let free = Motion::Free { mass: SLAB_MASS };
        let start = frames::pose([0.1, -0.2, 0.5], [0.3, 0.2, 0.1]);
        let slab = world.insert(free, &start, 1.0, &[cuboid(SLAB)]);
        world.wake(slab);
        for substep in 1..=72 {
            world.advance();
            let time = f64::from(substep) / SUBSTEPS_PER_SECOND;
            let fallen = start.translation.z - world.pose(slab).translation.z;
            let expected = 0.5 * GRAVITY * time * time;
            assert!((fallen - expected).abs() < 0.002 * expected + 1e-7, "{solver:?}: {fallen}");
        }
    }
}

#[test]
fn a_slab_on_an_incline_begins_to_slide_where_the_slope_is_the_friction_coefficient() {
    for solver in SOLVERS {
        for friction in [0.1, 0.3, 0.5] {
            let slides = |slope: f64| {
                let (mut world, slab) = slab_on_plate(solver, libm::atan(slope), friction);
                let start = world.pose(slab);
                world.wake(slab);
                run(&mut world, 0.5);
                // Where it slides, it covers ½·g·(sin θ − μ·cos θ)·t², at 5 % more than μ 6 mm.
                (world.pose(slab).translation.vector - start.translation.vector).norm() > 0.5e-3
            };
            assert!(!slides(0.95 * friction), "{solver:?}, {friction}: slides too early");
            assert!(slides(1.05 * friction), "{solver:?}, {friction}: slides too late");
        }
    }
}

#[test]
fn a_pushed_slab_stops_after_the_square_of_its_speed_over_twice_friction_times_g() {
    for solver in SOLVERS {
        for (friction, speed) in [(0.1, 0.1), (0.3, 0.3), (0.5, 0.3), (0.5, 0.5)] {
            let (mut world, slab) = slab_on_plate(solver, 0.0, friction);
            world.set_velocity(slab, &Vector3::new(speed, 0.0, 0.0));
            run(&mut world, 1.0);
            let slid = world.pose(slab).translation.x;
            let ratio = slid / (speed * speed / (2.0 * friction * GRAVITY));
            eprintln!("μ {friction}, {speed} m/s: {ratio:.3} of the distance");
            assert!((ratio - 1.0).abs() < 0.1, "{solver:?}, {friction}, {speed}: {ratio}");
        }
    }
}

/// Jaws that point down and hold a slab of `mass` (kg) with `squeeze` (N) each at its upper end, and
/// the force between slab and finger, N.
fn gripped_slab(mass: f64, squeeze: f64, friction: f64) -> (World, Instrument, BodyId, f64) {
    let mut world = World::new(Solver::LIGHT);
    let floor = Vector3::new(0.1, 0.1, 0.01);
    world.insert(Motion::Fixed, &Pose::translation(0.0, 0.0, -0.01), 1.0, &[cuboid(floor)]);
    let half = Vector3::new(6e-3, 0.5e-3, 8e-3);
    let standing = Pose::translation(0.0, 0.0, half.z);
    let free = Motion::Free { mass };
    let slab = world.insert(free, &standing, friction, &[cuboid(half)]);
    let at = |above: f64, jaw: f64| {
        let wrist = [0.0, 0.0, 2.0 * half.z - 1e-3 + above + TIP_OFFSET];
        Posture { world_from_wrist: frames::pose(wrist, [PI, 0.0, 0.0]), jaw }
    };
    let mut arm = Instrument::insert(&mut world, at(0.0, JAW_OPEN), squeeze);
    arm.set_friction(&mut world, friction);
    carry_out([&mut arm], &mut world, [at(0.0, JAW_CLOSED)], 96);
    assert!(arm.holds(&world, slab));
    carry_out([&mut arm], &mut world, [at(0.01, JAW_CLOSED)], 96);
    let normal = 0.5 * world.pressure(slab);
    (world, arm, slab, normal)
}

/// Jaws that point down and hold a staple of wire (0.4 g, 1 mm thick) by its back, its legs level, and
/// how far its centre of mass is from there, m.
fn gripped_staple(friction: f64) -> (World, Instrument, BodyId, f64) {
    const RADIUS: f64 = 0.5e-3;
    let mut world = World::new(Solver::LIGHT);
    let floor = Vector3::new(0.1, 0.1, 0.01);
    world.insert(Motion::Fixed, &Pose::translation(0.0, 0.0, -0.01), 1.0, &[cuboid(floor)]);
    let [left, right] = [-8e-3, 8e-3].map(|x| Point3::new(x, 0.0, 0.0));
    let leg = Vector3::new(0.0, -15e-3, 0.0);
    let wires = [(left, right), (left, left + leg), (right, right + leg)].map(|(a, b)| Part {
        body_from_part: Pose::identity(),
        shape: Shape::Capsule { a, b, radius: RADIUS },
    });
    let lying = Pose::translation(0.0, 0.0, RADIUS);
    let staple = world.insert(Motion::Free { mass: 0.4e-3 }, &lying, friction, &wires);
    let at = |height: f64, jaw: f64| {
        let wrist = [0.0, 0.0, height + TIP_OFFSET];
        Posture { world_from_wrist: frames::pose(wrist, [PI, 0.0, 0.0]), jaw }
    };
    let mut arm = Instrument::insert(&mut world, at(0.05e-3, JAW_OPEN), 1.0);
    arm.set_friction(&mut world, friction);
    carry_out([&mut arm], &mut world, [at(0.05e-3, JAW_CLOSED)], 96);
    carry_out([&mut arm], &mut world, [at(0.03, JAW_CLOSED)], 96);
    assert!(arm.holds(&world, staple));
    // Wires weigh by their length and about a radius more.
    (world, arm, staple, 2.0 * 15.5e-3 * 7.5e-3 / (2.0 * 15.5e-3 + 16.5e-3))
}

#[test]
fn a_gripped_wire_does_not_swing() {
    let (mut world, mut arm, staple, _) = gripped_staple(1.0);
    let (here, before) = (*arm.posture(), world.pose(staple));
    let mut fastest: f64 = 0.0;
    for now in 0..240 {
        carry_out([&mut arm], &mut world, [here], 1);
        if now >= 24 {
            fastest = fastest.max(world.velocity(staple).norm());
        }
    }
    let turned = world.pose(staple).rotation.angle_to(&before.rotation).to_degrees();
    eprintln!("at most {:.2} mm/s after 0.1 s, turned by {turned:.2}° in 1 s", fastest * 1e3);
    assert!(fastest < 1e-3 && turned < 1.0);
}

#[test]
fn jaws_press_on_a_wire_as_hard_as_they_are_asked_to() {
    let (mut world, mut arm, _, _) = gripped_staple(1.0);
    let here = *arm.posture();
    for _ in 0..24 {
        carry_out([&mut arm], &mut world, [here], 1);
        let pressures = arm.pressures(&world);
        assert!(pressures.iter().all(|force| (force - 1.0).abs() < 0.15), "{pressures:?}");
    }
}

/// What an arm does on its way to `end`, in a fifth of a second.
fn effort(world: &mut World, arm: &mut Instrument, end: Posture) -> Effort {
    let profile = Profile::Smoothstep { start: *arm.posture(), end };
    motion::Motion::new([profile], 48).pass(48, &mut [arm], world)
}

#[test]
fn the_peak_force_on_what_is_held_still_is_the_squeeze_and_none_once_it_is_let_go() {
    for squeeze in [0.5, 1.0] {
        let (mut world, mut arm, _, _) = gripped_slab(1e-3, squeeze, 0.5);
        let here = *arm.posture();
        let held = effort(&mut world, &mut arm, here);
        assert!((held.peak_force / squeeze - 1.0).abs() < 0.15, "{squeeze} N: {held:?}");
        assert!(held.tip_path < 1e-9, "{held:?}");
        let open = Posture { jaw: JAW_OPEN, ..here };
        assert!(effort(&mut world, &mut arm, open).peak_force > 0.5 * squeeze);
        let free = effort(&mut world, &mut arm, open);
        assert!(free.tip_path < 1e-9 && free.peak_force <= 0.0, "{free:?}");
    }
    // A wire that both fingers touch at several of its points.
    let (mut world, mut arm, _, _) = gripped_staple(1.0);
    let here = *arm.posture();
    let held = effort(&mut world, &mut arm, here);
    assert!((held.peak_force - 1.0).abs() < 0.15, "{held:?}");
}

#[test]
fn jaws_that_open_between_walls_press_on_them_with_the_torque_of_their_squeeze() {
    let (squeeze, aside) = (1.0, 3e-3);
    let mut world = World::new(Solver::LIGHT);
    let half = Vector3::new(0.02, 0.01, 0.02);
    for side in [-1.0, 1.0] {
        let at = Pose::translation(0.0, side * (aside + half.y), half.z);
        world.insert(Motion::Fixed, &at, 0.0, &[cuboid(half)]);
    }
    let wrist = frames::pose([0.0, 0.0, 0.02 + TIP_OFFSET], [PI, 0.0, 0.0]);
    let closed = Posture { world_from_wrist: wrist, jaw: JAW_CLOSED };
    let mut arm = Instrument::insert(&mut world, closed, squeeze);
    arm.set_friction(&mut world, 0.0);
    let open = Posture { jaw: JAW_OPEN, ..closed };
    effort(&mut world, &mut arm, open);
    let pressed = effort(&mut world, &mut arm, open);
    // The outer corner of a finger's end meets the wall, where the finger is turned by half the opening.
    let turn = 0.5 * arm.opening(&world);
    let (y, z) = (2.0 * FINGER_HALF.y, 2.0 * FINGER_HALF.z);
    let lever = z * turn.cos() - y * turn.sin();
    assert!((y * turn.cos() + z * turn.sin() - aside).abs() < 0.05e-3, "{turn}");
    let expected = squeeze * (TIP_OFFSET - 1e-3) / lever;
    let ratio = pressed.peak_force / expected;
    eprintln!("{:.3} N, {ratio:.3} of the torque's", pressed.peak_force);
    assert!((ratio - 1.0).abs() < 0.03, "{pressed:?} for {expected}");
}

/// By how much the forces of contacts differ from those that 200 sweeps of the solver find, as a share of these: the mean
/// over the substeps in which jaws carry what they hold along a curve.
fn solver_error(world: &mut World, arm: &mut Instrument) -> f64 {
    let here = arm.posture().world_from_wrist;
    let (mut off, mut all) = (0.0, 0.0);
    for now in 1..=96 {
        let way = 0.01 * (f64::from(now) / 96.0 * PI).sin();
        let to = Pose::translation(way, 0.5 * way, way)
            * here
            * frames::pose([0.0; 3], [0.0, 0.0, 20.0 * way]);
        let to = Posture { world_from_wrist: to, jaw: JAW_CLOSED };
        let (mut reference, mut same) = (world.clone(), arm.clone());
        reference.set_solver(Solver { sweeps: 200, ..Solver::LIGHT });
        carry_out([&mut same], &mut reference, [to], 1);
        carry_out([&mut *arm], world, [to], 1);
        assert_eq!(world.contacts().count(), reference.contacts().count());
        for (found, expected) in world.contacts().zip(reference.contacts()) {
            assert_eq!((found.on, found.by), (expected.on, expected.by));
            off += (found.force - expected.force).norm();
            all += expected.force.norm();
        }
    }
    off / all
}

#[test]
fn contacts_of_what_is_held_bear_what_a_converged_solver_finds() {
    let (mut world, mut arm, _, _) = gripped_staple(1.0);
    let staple = solver_error(&mut world, &mut arm);
    let (mut world, mut arm, _, _) = gripped_slab(1e-3, 1.0, 0.5);
    let slab = solver_error(&mut world, &mut arm);
    eprintln!("off by {:.2} % (staple of wire), {:.2} % (slab)", staple * 100.0, slab * 100.0);
    assert!(staple < 0.02 && slab < 0.02, "{staple} {slab}");
}

/// A world with a fixed vertical post of 30 mm; the radius in m.
fn world_with_post(radius: f64) -> World {
    let mut world = World::new(Solver::LIGHT);
    let (a, b) = (Point3::origin(), Point3::new(0.0, 0.0, 0.03));
    let shape = Shape::Capsule { a, b, radius };
    let post = Part { body_from_part: Pose::identity(), shape };
    world.insert(Motion::Fixed, &Pose::identity(), 1.0, &[post]);
    world
}

#[test]
fn fingers_that_meet_a_post_sideways_do_not_turn_about_their_hinge() {
    let mut most: f64 = 0.0;
    for way in 0..24 {
        let mut world = world_with_post(1e-3);
        let free = Motion::Free { mass: SLAB_MASS };
        let slab = world.insert(free, &Pose::translation(0.0, 0.0, 0.2), 1.0, &[cuboid(SLAB)]);
        let side = 0.5e-3 * f64::from(way % 6) - 1.25e-3;
        let at = |x: f64, turn: f64| {
            let wrist = [x, side, 0.02 + TIP_OFFSET];
            Posture { world_from_wrist: frames::pose(wrist, [PI, 0.0, turn]), jaw: JAW_OPEN }
        };
        let mut arm = Instrument::insert(&mut world, at(-6e-3, 0.0), 1.0);
        // As long as it falls, time passes.
        world.wake(slab);
        for turn in [0.2, -0.3, 0.4] {
            let end = at(4e-3, turn * f64::from(way / 6 + 1) / 4.0);
            for _ in 0..12 {
                carry_out([&mut arm], &mut world, [end], 1);
                most = most.max((arm.opening(&world) - JAW_OPEN).abs());
            }
        }
    }
    eprintln!("opened by {most:.3} rad");
    // The post turns those that meet it on their flank by as much as it is off their middle.
    assert!(most < 0.4, "{most}");
}

#[test]
fn fingers_that_a_wrist_drives_askew_into_a_post_are_not_jammed_by_friction() {
    let mut strongest: f64 = 0.0;
    for way in 0..60 {
        let mut world = world_with_post(2e-3);
        // The fingers meet the post at several depths, and at angles between the axis of their hinges and a right angle.
        let (depth, angle) =
            (4e-3 + 2e-3 * f64::from(way % 5), FRAC_PI_2 * f64::from(way / 5) / 11.0);
        let at = |distance: f64| {
            let place = [distance * angle.cos(), distance * angle.sin(), 0.03 + depth];
            Posture { world_from_wrist: frames::pose(place, [PI, 0.0, 0.0]), jaw: JAW_OPEN }
        };
        let mut arm = Instrument::insert(&mut world, at(-12e-3), 1.0);
        strongest = strongest.max(effort(&mut world, &mut arm, at(12e-3)).peak_force);
    }
    eprintln!("{strongest:.2} N");
    // Jammed fingers bear 7.7 N here.
    assert!(strongest > 0.1 && strongest < 4.0, "{strongest} N");
}

#[test]
fn an_instrument_stops_at_another_one() {
    // The tips of the second instrument, which lies, go through the place of the first one's fingers and wrist.
    for height in [-0.6 * TIP_OFFSET, 0.0, 3e-3] {
        let mut world = World::new(Solver::LIGHT);
        let first =
            Posture { world_from_wrist: frames::pose([0.0; 3], [PI, 0.0, 0.0]), jaw: JAW_CLOSED };
        let lying = |x: f64| Posture {
            world_from_wrist: frames::pose([x, 0.0, height], [0.0, FRAC_PI_2, 0.0]),
            jaw: JAW_CLOSED,
        };
        let mut arms = [first, lying(-0.03)].map(|at| Instrument::insert(&mut world, at, 1.0));
        let [one, other] = &mut arms;
        let [_, covered] = carry_out([one, other], &mut world, [first, lying(0.0)], 96);
        // Without the first instrument, the second would come through to the other side.
        let tip = other.posture().world_from_wrist.translation.x + TIP_OFFSET;
        eprintln!("at {height}: {covered:.2} covered, tip at {:.2} mm", 1e3 * tip);
        assert!(covered < 1.0 && tip < 0.0, "{height}: {covered}, {tip}");
    }
}

#[test]
fn a_gripped_wire_rolls_where_friction_at_both_sides_cannot_stop_it() {
    const FRICTION: f64 = 0.5;
    let turned_by = |share: f64| {
        let (mut world, mut arm, staple, arm_of_force) = gripped_staple(FRICTION);
        let (here, before) = (*arm.posture(), world.pose(staple));
        // A newton on each side of a wire of 1 mm.
        let couple = FRICTION * 1.0 * 1e-3;
        let pull = share * couple / arm_of_force;
        world.pull(staple, &Vector3::new(0.0, 0.0, -pull));
        let mut most: f64 = 0.0;
        for _ in 0..24 {
            carry_out([&mut arm], &mut world, [here], 1);
            most = most.max(world.pose(staple).rotation.angle_to(&before.rotation));
        }
        most.to_degrees()
    };
    let turned = [0.25, 0.5, 0.9, 1.25].map(turned_by);
    eprintln!("pulled with 0.25, 0.5, 0.9 and 1.25 of that: turned by {turned:.1?} degrees");
    assert!(turned[1] < 2.0 && turned[2] < 20.0 && turned[3] > 60.0, "{turned:?}");
    assert!(turned.is_sorted(), "{turned:?}");
}

#[test]
fn a_gripped_slab_slips_where_its_weight_exceeds_twice_friction_times_the_grip() {
    for (squeeze, friction) in [(1.0, 0.3), (1.0, 0.5), (0.5, 0.5)] {
        // The grip is what a light slab feels; what hangs on it pulls with its weight.
        let slips = |pull: f64| {
            let (mut world, mut arm, slab, normal) = gripped_slab(1e-3, squeeze, friction);
            let before = world.pose(slab).translation.z;
            let here = *arm.posture();
            for _ in 0..5 {
                world.pull(slab, &Vector3::new(0.0, 0.0, -pull));
                carry_out([&mut arm], &mut world, [here], 24);
            }
            (before - world.pose(slab).translation.z > 1e-3, normal)
        };
        let (mut low, mut high) = (0.0, 8.0 * friction * squeeze);
        let mut normal = 0.0;
        for _ in 0..7 {
            let pull = 0.5 * (low + high);
            let (slipped, grip) = slips(pull);
            normal = grip;
            if slipped { high = pull } else { low = pull }
        }
        let limit = 0.5 * (low + high) + 1e-3 * GRAVITY;
        let ratio = limit / (2.0 * friction * normal);
        eprintln!(
            "squeeze {squeeze} N, μ {friction}: {normal:.3} N a finger; slips at {limit:.3} N, \
             {ratio:.3} of 2·μ·N",
        );
        assert!((ratio - 1.0).abs() < 0.15, "{squeeze}, {friction}: {ratio}");
        assert!((normal / squeeze - 1.0).abs() < 0.15, "{squeeze} N asked for, {normal} N there");
    }
}

#[test]
fn what_rests_overlaps_by_less_than_a_tenth_of_a_millimetre_and_sleeps() {
    for (preset, heavy) in [(Preset::Paper, false), (Preset::Surrol, true)] {
        let mut world = tray::furnished_world(preset);
        let needle = Needle::insert(&mut world, preset, Domain::default());
        let centre = tray::pad().centre();
        needle.lay(&mut world, centre.x, centre.y, 0.4);
        let on_pad = Pose::translation(centre.x, centre.y + 0.04, tray::pad().max.z + SLAB.z);
        let mass = if heavy { 0.05 } else { SLAB_MASS };
        let slab = world.insert(Motion::Free { mass }, &on_pad, 1.0, &[cuboid(SLAB)]);
        let laid = [needle.body(), slab].map(|body| world.pose(body));
        for body in [needle.body(), slab] {
            world.wake(body);
        }
        run(&mut world, 2.0);
        assert!(world.at_rest());
        run(&mut world, 2.0);
        assert!(world.at_rest());
        assert!(world.deepest_overlap() < 0.1e-3, "{}", world.deepest_overlap());
        for (body, laid) in [needle.body(), slab].into_iter().zip(laid) {
            let moved = world.pose(body).translation.vector - laid.translation.vector;
            assert!(moved.norm() < 0.05e-3, "{moved}");
        }
    }
}

#[test]
fn an_object_of_another_size_and_mass_has_the_inertia_of_one_and_rests_like_one() {
    for preset in [Preset::Paper, Preset::Surrol] {
        let mut world = tray::furnished_world(preset);
        let mut needle = Object::insert(&mut world, Model::needle(), 0.001, &Pose::identity());
        let nominal = world.inertia(needle.body());
        for (mass, size) in [(2.0, 1.0), (1.0, 0.8), (0.5, 1.2), (1.0, 1.0)] {
            needle.vary(&mut world, Variation { mass, size });
            let found = world.inertia(needle.body());
            let factor = mass * f64::powi(size, 3);
            assert!((found.mass / nominal.mass / factor - 1.0).abs() < 1e-5, "{found:?}");
            assert!((found.centre - nominal.centre * size).norm() < 1e-7, "{found:?}");
            let moments = nominal.moments * (mass * f64::powi(size, 5));
            assert!((found.moments - moments).norm() < 1e-4 * moments.norm(), "{found:?}");

            let (centre, form) = (tray::pad().centre(), needle.form());
            let z = tray::pad().max.z - form.aabb(&Pose::identity()).min.z;
            let laid = frames::pose([centre.x, centre.y, z], [0.0, 0.0, 0.4]);
            world.place(needle.body(), &laid);
            world.wake(needle.body());
            run(&mut world, 2.0);
            assert!(world.at_rest() && world.deepest_overlap() < 0.1e-3);
            let moved = world.pose(needle.body()).translation.vector - laid.translation.vector;
            assert!(moved.norm() < 0.05e-3, "{preset:?} {mass} {size}: {moved}");
        }
    }
}

#[test]
fn bodies_have_the_mass_centre_and_inertia_of_their_models() {
    let mut world = World::new(Solver::LIGHT);
    for model in [Model::needle(), Model::gauze(), Model::block()] {
        let pose = frames::pose([0.5, 0.1, 0.7], [0.0, 0.0, FRAC_PI_2]);
        let body = model.insert(&mut world, model.mass, &pose);
        let (found, expected) = (world.inertia(body), model.inertia);
        assert!((found.mass / expected.mass - 1.0).abs() < 1e-5);
        assert!((found.centre - expected.centre).norm() < 1e-7, "{found:?} for {expected:?}");
        let off = (found.moments - expected.moments).norm() / expected.moments.norm();
        assert!(off < 1e-4, "{found:?} for {expected:?}");
    }
    // A box of known density, against the textbook.
    let free = Motion::Free { mass: SLAB_MASS };
    let slab = world.insert(free, &Pose::identity(), 1.0, &[cuboid(SLAB)]);
    let found = world.inertia(slab);
    let [x, y, z] = SLAB.map(|half| half * half).into();
    let moments = Vector3::new(y + z, x + z, x + y) * (SLAB_MASS / 3.0);
    assert!((found.mass / SLAB_MASS - 1.0).abs() < 1e-5 && found.centre.coords.norm() < 1e-9);
    let off = (found.moments - Matrix3::from_diagonal(&moments)).norm() / moments.norm();
    assert!(off < 1e-5, "{found:?}");
}

#[test]
fn a_needle_has_the_mass_and_centre_of_a_half_circle_of_steel_wire() {
    // The model tapers towards its tip, where 8 % of the wire's volume are missing.
    let (radius, wire, density) = (0.02, 0.5e-3, 7850.0);
    let inertia = Model::needle().inertia;
    let mass = density * PI * wire * wire * PI * radius;
    assert!((inertia.mass / mass - 1.0).abs() < 0.08, "{} for {mass}", inertia.mass);
    let centre = Point3::new(-2.0 * radius / PI, 0.0, 0.0);
    assert!((inertia.centre - centre).norm() < 1.5e-3, "{}", inertia.centre);
    // About the circle's axis every slice is at the same distance.
    let about_axis = inertia.moments[(2, 2)] + inertia.mass * inertia.centre.coords.norm_squared();
    assert!((about_axis / (inertia.mass * radius * radius) - 1.0).abs() < 0.02, "{about_axis}");
}
