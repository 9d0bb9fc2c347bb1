//! Contacts with rigid bodies: friction, forces both ways, jaws.

use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::super::lanes::NARROW;
use super::super::{Form, Friction, Material, MaterialPoint, Skin, SoftBody, box_distance};
use super::material;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::instrument::{Instrument, JAW_CLOSED, JAW_OPEN, Jaws, Posture, TIP_OFFSET};
use crate::sim::motion::carry_out;
use crate::sim::world::{
    GRAVITY, Motion, NonRigid, Part, Push, SUBSTEPS_PER_SECOND, Shape, SoftId, Solver, World,
};

/// A box of these elements, at rest with its middle at a pose; nodes are held where `is_held` says.
fn block(
    cells: [usize; 3],
    spacing: f64,
    material: Material,
    at: &Pose,
    is_held: impl Fn(&Point3<f64>) -> bool,
) -> SoftBody {
    let half = Vector3::from(cells.map(|count| 0.5 * count as f64 * spacing));
    let mut form = Form::slab(cells, spacing, material).unwrap();
    form.hold(is_held);
    let bounds = Aabb { min: -half, max: half };
    let skin = Skin::new(&form, &bounds, spacing, box_distance(&half));
    SoftBody::new("block", [0.9, 0.8, 0.4], Arc::new(form), Arc::new(skin), at)
}

fn cuboid(half: [f64; 3]) -> Part {
    Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(half.into()) }
}

fn with_friction(material: Material, both: f64) -> Material {
    Material { friction: Friction { smooth: both, profiled: both }, ..material }
}

fn advance(world: &mut World, seconds: f64) {
    for _ in 0..(seconds * SUBSTEPS_PER_SECOND).round() as u32 {
        world.advance();
    }
}

/// Mean place and velocity of a body.
fn mean(world: &World, id: SoftId) -> [Vector3<f64>; 2] {
    let lattice = world.soft(id).lattice();
    let form = lattice.form();
    let mut sum = [Vector3::zeros(); 2];
    for node in 0..form.grid.nodes() {
        let mass = f64::from(form.mass[node]);
        sum[0] += lattice.node(node).coords * mass;
        sum[1] += lattice.velocity(node) * mass;
    }
    sum.map(|sum| sum / form.mass())
}

/// A cube of 12 mm on an incline whose slope is `steepness` times its friction; its downhill direction.
fn incline(steepness: f64) -> (World, SoftId, Vector3<f64>, f64) {
    let mu = 0.5;
    let slope = libm::atan(steepness * mu);
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), slope);
    let mut world = World::new(Solver::LIGHT);
    let plane = Pose::from_parts((tilt * Vector3::new(0.0, 0.0, -0.05)).into(), tilt);
    world.insert(Motion::Fixed, &plane, 1.0, &[cuboid([2.0, 0.1, 0.05])]);
    let at = Pose::from_parts((tilt * Vector3::new(0.0, 0.0, 6e-3)).into(), tilt);
    let material = with_friction(material(20e3, 0.3, 1000.0), mu);
    let body = block([3, 3, 3], 4e-3, material, &at, |_| false);
    let id = world.insert_soft(body);
    (world, id, tilt * Vector3::x(), slope)
}

#[test]
fn a_cube_sticks_to_an_incline_below_its_friction() {
    let (mut world, id, downhill, _) = incline(0.95);
    // It must not fall asleep: what sleeps would not creep.
    let mut awake = |seconds: f64| {
        for _ in 0..(seconds * SUBSTEPS_PER_SECOND) as u32 {
            world.soft_mut(id).wake();
            world.advance();
        }
        mean(&world, id)[0].dot(&downhill)
    };
    let before = awake(2.0);
    let creep = awake(10.0) - before;
    println!("creeps {:.3} µm in 10 s", 1e6 * creep);
    assert!(creep.abs() < 10e-6, "{creep} m in 10 s");
}

#[test]
fn a_cube_slides_down_a_steeper_incline_as_coulomb_has_it() {
    let (mut world, id, downhill, slope) = incline(1.2);
    let speed = |world: &World| mean(world, id)[1].dot(&downhill);
    advance(&mut world, 0.5);
    let before = speed(&world);
    advance(&mut world, 0.5);
    let found = (speed(&world) - before) / 0.5;
    let expected = GRAVITY * (libm::sin(slope) - 0.5 * libm::cos(slope));
    println!("slides with {:+.2} %", 100.0 * (found / expected - 1.0));
    assert!((found / expected - 1.0).abs() < 0.05, "{found} instead of {expected}");
}

#[test]
fn what_a_body_gets_from_a_plate_is_what_the_plate_gets() {
    let mut world = World::new(Solver::LIGHT);
    let at = Pose::translation(0.0, 0.0, 0.1);
    let material = with_friction(material(5e3, 0.45, 1000.0), 0.4);
    let id = world.insert_soft(block([4, 3, 2], 4e-3, material, &at, |_| false));
    let plate = world.insert(Motion::Driven, &Pose::identity(), 1.0, &[cuboid([0.05, 0.05, 5e-3])]);
    world.place(plate, &Pose::translation(0.0, 0.0, 0.1 - 4e-3 - 5e-3 - 1e-3));
    let mass = world.soft(id).lattice().form().mass();
    let mut given = Vector3::zeros();
    let step = 1.0 / SUBSTEPS_PER_SECOND;
    let before = world.soft(id).lattice().momentum()[0];
    let mut largest: f64 = 0.0;
    for index in 0..60 {
        // Up and aside, and back.
        let along = 2e-3 * f64::from(index) * if index < 30 { 1.0 } else { 0.0 };
        let up = 0.09 + if index < 30 { along } else { 0.06 };
        world.drive(plate, &Pose::translation(0.5 * along, 0.0, up));
        world.advance();
        given -= world.soft_force(id, plate) * step;
        largest = largest.max(given.norm());
    }
    let weight = Vector3::new(0.0, 0.0, -GRAVITY * mass * 60.0 * step);
    let gained = world.soft(id).lattice().momentum()[0] - before - weight;
    let error = (gained - given).norm() / largest;
    println!("impulse and momentum differ by {error:.1e}");
    assert!(largest > 0.1 * mass && given.x.abs() > 1e-3 * mass, "{given}");
    assert!(error < 1e-4, "{error}");
}

#[test]
fn contacts_in_narrow_and_wide_registers_give_the_same_bits() {
    let bits = |is_narrow: bool| {
        NARROW.set(is_narrow);
        let (mut sliding, cube, ..) = incline(1.2);
        advance(&mut sliding, 0.2);
        let (mut gripping, sheet, _) = gripped(true, 1.0, 0.8);
        advance(&mut gripping, 0.2);
        NARROW.set(false);
        let both = sliding.soft(cube).bits().chain(gripping.soft(sheet).bits());
        both.collect::<Vec<_>>()
    };
    assert_eq!(bits(true), bits(false));
}

#[test]
fn a_rigid_cube_that_lands_on_a_block_and_the_block_share_their_momentum() {
    let mut world = World::new(Solver::LIGHT);
    // Both are in free fall: weight acts on both alike.
    let material = with_friction(material(5e3, 0.45, 1000.0), 0.4);
    let body = block([5, 5, 2], 4e-3, material, &Pose::identity(), |_| false);
    let id = world.insert_soft(body);
    let mass = 2e-3;
    let cube = world.insert(
        Motion::Free { mass },
        &Pose::translation(2e-3, 0.0, 9e-3 + 3e-3),
        1.0,
        &[cuboid([3e-3; 3])],
    );
    world.wake(cube);
    world.set_velocity(cube, &Vector3::new(0.1, 0.0, -0.5));
    let momentum =
        |world: &World| world.velocity(cube) * mass + world.soft(id).lattice().momentum()[0];
    let before = momentum(&world);
    let seconds = 0.1;
    advance(&mut world, seconds);
    let all = mass + world.soft(id).lattice().form().mass();
    let fell = Vector3::new(0.0, 0.0, -GRAVITY * seconds * all);
    let error = (momentum(&world) - before - fell).norm() / (0.5 * mass);
    println!("momentum of both changes by {error:.1e}");
    assert!(world.velocity(cube).z + GRAVITY * seconds > -0.3, "it was stopped");
    assert!(error < 1e-4, "{error}");
}

/// Jaws from above, tip at `tip`, which close along y.
fn down(tip: [f64; 3], jaw: f64) -> Posture {
    let [x, y, z] = tip;
    let pose = frames::pose([x, y, z + TIP_OFFSET], [std::f64::consts::PI, 0.0, 0.0]);
    Posture { world_from_wrist: pose, jaw }
}

/// Upright sheets of 4 mm whose upper 6 mm a forceps has closed on, so many elements wide and with their middle at x (m).
/// Their lower edges are held, or they hang in the jaws.
fn gripped_sheets<const N: usize>(
    sheets: [(usize, f64); N],
    is_held: bool,
    squeeze: f64,
    mu: f64,
) -> (World, [SoftId; N], Instrument) {
    let mut world = World::new(Solver::LIGHT);
    let material = with_friction(material(20e3, 0.4, 1000.0), mu);
    let shelf = Pose::translation(0.0, 0.0, -0.03);
    let shelf = world.insert(Motion::Fixed, &shelf, 1.0, &[cuboid([0.02, 0.02, 0.01])]);
    let ids = sheets.map(|(wide, x)| {
        let at = Pose::translation(x, 0.0, -0.01);
        let held = |point: &Point3<f64>| is_held && point.z < -9.9e-3;
        world.insert_soft(block([wide, 1, 5], 4e-3, material.clone(), &at, held))
    });
    let open = down([0.0, 0.0, -6e-3], JAW_OPEN);
    let mut jaws = Instrument::with_jaws(&mut world, open, squeeze, Jaws::TISSUE_FORCEPS);
    let closed = down([0.0, 0.0, -6e-3], JAW_CLOSED);
    carry_out([&mut jaws], &mut world, [open], 1);
    carry_out([&mut jaws], &mut world, [closed], 120);
    carry_out([&mut jaws], &mut world, [closed], 120);
    world.withdraw(shelf);
    (world, ids, jaws)
}

/// One sheet of 20 × 4 × 20 mm.
fn gripped(is_held: bool, squeeze: f64, mu: f64) -> (World, SoftId, Instrument) {
    let (world, [id], jaws) = gripped_sheets([(5, 0.0)], is_held, squeeze, mu);
    (world, id, jaws)
}

/// The force of each finger 1 mm from its tip, where the squeeze is defined, N: what presses nearer to the hinge presses
/// harder.
fn squeezes(world: &World, jaws: &Instrument) -> [f64; 2] {
    jaws.finger_bodies().map(|finger| {
        let hinge = world.pose(finger).translation.vector;
        let torque = |push: Push| (push.point.coords - hinge).cross(&push.force).x;
        torque(world.push_on(&[finger])).abs() / (TIP_OFFSET - 1e-3)
    })
}

#[test]
fn jaws_full_of_tissue_press_with_their_squeeze() {
    for squeeze in [0.25, 0.5, 1.0] {
        let (world, id, jaws) = gripped(true, squeeze, 0.8);
        let found = squeezes(&world, &jaws);
        println!("squeeze {squeeze} N: {found:.3?}, pressures {:.3?}", jaws.pressures(&world));
        assert_eq!(jaws.fingers_on(&world, id), 2);
        for force in found {
            assert!((force / squeeze - 1.0).abs() < 0.05, "{force} for {squeeze}");
        }
    }
}

#[test]
fn attachments_hold_without_friction_with_the_weight_of_what_hangs_and_copies_go_on_alike() {
    let (mut world, id, mut jaws) = gripped(true, 0.5, 0.0);
    jaws.attach_skin(&mut world, id, 1e-3);
    assert!(world.soft(id).is_attached());
    // Friction would not hold it; it is pulled up by the lower edge that is held, and let go of.
    let lifted = |z: f64| down([0.0, 0.0, z - 6e-3], JAW_CLOSED);
    let (mut copy, mut its_jaws) = (world.clone(), jaws.clone());
    carry_out([&mut jaws], &mut world, [lifted(4e-3)], 48);
    carry_out([&mut its_jaws], &mut copy, [lifted(4e-3)], 48);
    assert!(world.bits().eq(copy.bits()));
    carry_out([&mut jaws], &mut world, [lifted(4e-3)], 240);
    let pull = -jaws.force_of(&world, id).z;
    // 4 mm of the 14 mm between the jaws and the lower edge: about E A ε = 20 kPa · 80 mm² · 0.29.
    assert!((0.2..1.5).contains(&pull), "{pull} N");
    // What the sheet does to the jaws and the jaws to the sheet is the same: it is at rest but for its weight.
    let body = world.soft(id);
    let top = body.lattice().bounds().max.z;
    assert!(body.lattice().fastest() < 0.02, "{}", body.lattice().fastest());
    world.soft_mut(id).detach();
    carry_out([&mut jaws], &mut world, [lifted(4e-3)], 24);
    let sunk = top - world.soft(id).lattice().bounds().max.z;
    assert!(sunk > 2e-3, "it sinks by {sunk} m");
}

#[test]
fn jaws_on_two_bodies_press_with_their_squeeze_on_both_together() {
    let squeeze = 0.5;
    let (mut world, ids, mut jaws) =
        gripped_sheets([(2, -4.2e-3), (2, 4.2e-3)], true, squeeze, 0.8);
    let closed = *jaws.posture();
    let mut mean = [0.0; 2];
    for _ in 0..24 {
        carry_out([&mut jaws], &mut world, [closed], 1);
        for (mean, force) in mean.iter_mut().zip(squeezes(&world, &jaws)) {
            *mean += force / 24.0;
        }
    }
    println!(
        "squeeze {squeeze} N: {mean:.3?}, fastest {:.4}",
        world.soft(ids[0]).lattice().fastest()
    );
    for id in ids {
        assert_eq!(jaws.fingers_on(&world, id), 2);
    }
    for force in mean {
        assert!((force / squeeze - 1.0).abs() < 0.05, "{force} for {squeeze}");
    }
}

#[test]
fn a_body_that_nothing_is_near_overlaps_nothing_after_a_larger_one_was_looked_at() {
    let mut world = World::new(Solver::LIGHT);
    world.insert(Motion::Fixed, &Pose::identity(), 1.0, &[cuboid([0.05, 0.05, 5e-3])]);
    let near = Pose::translation(0.0, 0.0, 8e-3);
    let far = Pose::translation(0.0, 0.0, 1.0);
    let fat = || material(5e3, 0.45, 1000.0);
    let large = world.insert_soft(block([8, 8, 2], 4e-3, fat(), &near, |_| false));
    let small = world.insert_soft(block([1, 1, 1], 4e-3, fat(), &far, |_| false));
    assert!(world.soft_overlap(world.soft(large)) > 0.5e-3);
    assert_eq!(world.soft_overlap(world.soft(small)), 0.0);
}

#[test]
fn a_body_that_hangs_over_a_narrow_wall_is_not_in_it() {
    let mut world = World::new(Solver::LIGHT);
    // Between nodes, which are 4 mm apart.
    let (half, wall) = ([1e-3, 0.05, 0.02], Pose::translation(2e-3, 0.0, -0.02));
    world.insert(Motion::Fixed, &wall, 1.0, &[cuboid(half)]);
    let material = with_friction(material(5e3, 0.45, 1000.0), 0.8);
    let at = Pose::translation(0.0, 0.0, 3e-3);
    let id = world.insert_soft(block([8, 4, 1], 4e-3, material, &at, |_| false));
    let gap = box_distance(&half.into());
    let nearest = |world: &World| {
        let lattice = world.soft(id).lattice();
        let gaps = (-64..=64).map(|x| {
            let under = Point3::new(0.25e-3 * f64::from(x), 0.0, -2e-3);
            let place = MaterialPoint::of(lattice.form(), &under);
            gap(&(wall.inverse() * lattice.point(&place)))
        });
        gaps.fold(f64::INFINITY, f64::min)
    };
    let mut gaps = vec![];
    for _ in 0..36 {
        world.advance();
        gaps.push(nearest(&world));
    }
    let lowest = world.soft(id).lattice().bounds().min.z;
    let nearest = gaps.into_iter().fold(f64::INFINITY, f64::min);
    println!("lowest {:.2} mm, nearest to the wall {:.3} mm", 1e3 * lowest, 1e3 * nearest);
    assert!((-0.03..-3e-3).contains(&lowest), "it does not hang: {lowest}");
    assert!(nearest > -0.5e-3, "{nearest}");
}

#[test]
fn a_sheet_is_pulled_out_of_jaws_at_twice_friction_times_normal_force() {
    let mu = 0.4;
    let (mut world, id, mut jaws) = gripped(true, 0.5, mu);
    // Jaws go up while the lower edge is held.
    let (mut most, mut slipped) = (0.0_f64, false);
    for step in 0..500 {
        let end = down([0.0, 0.0, -6e-3 + 0.05e-3 * f64::from(step)], JAW_CLOSED);
        carry_out([&mut jaws], &mut world, [end], 12);
        let pull = -jaws.force_of(&world, id).z;
        let normal: f64 = jaws.pressures(&world).iter().sum();
        // Fingers that stand at an angle push the sheet out.
        let angle = 0.5 * jaws.opening(&world);
        most = most.max(pull / (normal * (mu * libm::cos(angle) - libm::sin(angle))));
        slipped |= jaws.fingers_on(&world, id) == 0;
        if slipped {
            break;
        }
    }
    println!("pulled out at {most:.3} of 2 μ N");
    assert!(slipped && (most - 1.0).abs() < 0.1, "{most}");
}

/// `TROCAR_SOAK=1` holds it for a minute.
#[test]
fn a_pinched_sheet_creeps_less_than_a_tenth_of_a_millimetre_in_a_minute() {
    let seconds = if std::env::var_os("TROCAR_SOAK").is_some() { 60 } else { 10 };
    let (mut world, id, mut jaws) = gripped(false, 0.1, 0.8);
    let place = |world: &World, jaws: &Instrument| {
        let lattice = world.soft(id).lattice();
        let upper = lattice.form().grid.index([2, 0, 5]);
        jaws.posture().world_from_wrist.inverse() * lattice.node(upper)
    };
    let closed = *jaws.posture();
    carry_out([&mut jaws], &mut world, [closed], 240);
    let before = place(&world, &jaws);
    let mut trembling: f64 = 0.0;
    for _ in 0..seconds {
        carry_out([&mut jaws], &mut world, [closed], 240);
        trembling = trembling.max(world.soft(id).lattice().fastest());
    }
    let creep = (place(&world, &jaws) - before).norm();
    println!(
        "creeps {:.1} µm in {seconds} s, fastest node {:.1} mm/s",
        1e6 * creep,
        1e3 * trembling
    );
    assert_eq!(jaws.fingers_on(&world, id), 2);
    assert!(creep < 0.1e-3 * f64::from(seconds) / 60.0, "{creep}");
}

#[test]
fn a_finger_that_is_pushed_into_the_edge_that_is_held_is_stopped_and_stirs_nothing_up() {
    let mut world = World::new(Solver::LIGHT);
    let material = with_friction(material(5e3, 0.45, 920.0), 0.8);
    let held = |point: &Point3<f64>| point.x < -9.9e-3;
    let sheet = block([4, 4, 2], 5e-3, material, &Pose::identity(), held);
    let id = world.insert_soft(sheet);
    let start = down([-0.0112, 1.7e-3, 1e-3], JAW_CLOSED);
    let mut jaws = Instrument::with_jaws(&mut world, start, 0.5, Jaws::TISSUE_FORCEPS);
    carry_out([&mut jaws], &mut world, [start], 4);
    let mut most = [0.0_f64; 2];
    for step in 0..96 {
        let side = if step < 24 { 1.7e-3 } else { 1.7e-3 + 1e-3 * f64::from(step / 8 % 2) };
        let target = down([-0.0112 + 1e-4 * f64::from(step.min(20)), side, 1e-3], JAW_CLOSED);
        carry_out([&mut jaws], &mut world, [target], 1);
        let pressing = jaws.jaw_force(&world);
        most = [most[0].max(world.soft(id).lattice().fastest()), most[1].max(pressing)];
    }
    println!("fastest {:.3} m/s, pressed with {:.1} N", most[0], most[1]);
    assert!(most[0] < 1.0 && most[1] < 100.0, "{most:?}");
}

#[test]
fn a_sheet_that_jaws_press_on_a_plate_is_in_neither() {
    let mut world = World::new(Solver::LIGHT);
    let plate = Pose::translation(0.0, 0.0, -0.01);
    world.insert(Motion::Fixed, &plate, 1.0, &[cuboid([0.1, 0.1, 0.01])]);
    let material = with_friction(material(10e3, 0.1, 1040.0), 1.0);
    let at = Pose::translation(0.0, 0.0, 1.25e-3);
    let id = world.insert_soft(block([8, 8, 1], 2.5e-3, material, &at, |_| false));
    let above = |z: f64| down([8e-3, 0.0, z], JAW_CLOSED);
    let mut jaws = Instrument::with_jaws(&mut world, above(5e-3), 0.5, Jaws::TISSUE_FORCEPS);
    carry_out([&mut jaws], &mut world, [above(5e-3)], 4);
    let mut deepest: f64 = 0.0;
    for step in 1..=8 {
        let target = above((5e-3 - 1e-3 * f64::from(step)).max(0.0));
        carry_out([&mut jaws], &mut world, [target], 24);
        deepest = deepest.max(world.soft_overlap(world.soft(id)));
    }
    println!("at most {:.3} mm deep", 1e3 * deepest);
    assert!(deepest < 0.3e-3, "{deepest}");
}
