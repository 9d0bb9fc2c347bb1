//! A soft body in the world: bits, sleep, pictures, memory, and instruments that mean it ill.

use nalgebra::Vector3;
use trocar_server::render::{Lens, Renderer, Scene, Software};
use trocar_server::sim::frames::Pose;
use trocar_server::sim::instrument::{Instrument, JAW_CLOSED, JAW_OPEN, Jaws, Posture};
use trocar_server::sim::motion::carry_out;
use trocar_server::sim::random::Rng;
use trocar_server::sim::soft::Friction;
use trocar_server::sim::world::{Motion, Part, Shape, SoftId, World};

use crate::soft_grasp::{Sheet, posture, sheet_on_table};

/// Height of the sheet's upper face, m.
const TOP: f64 = 8e-3;

/// Where jaws grasp the sheet, and how they are turned then, rad.
const PLACE: [f64; 2] = [9.8e-3, 1.6e-3];
const YAW: f64 = 0.19;

fn at(z: f64, jaw: f64) -> Posture {
    let [x, y] = PLACE;
    posture(&Vector3::new(x, y, z), YAW, jaw)
}

fn settle(world: &mut World) {
    for _ in 0..4800 {
        if world.at_rest() {
            return;
        }
        world.advance();
    }
    panic!("it does not come to rest");
}

/// The sheet at rest, and a forceps above it.
fn prepared() -> (World, SoftId, Instrument) {
    let (mut world, id) = sheet_on_table(&Sheet::FAT, 5e3);
    world.soft_mut(id).set_friction(Friction { smooth: 0.3, profiled: 0.8 });
    settle(&mut world);
    let above = at(TOP + 0.02, JAW_OPEN);
    let jaws = Instrument::with_jaws(&mut world, above, 1.0, Jaws::TISSUE_FORCEPS);
    (world, id, jaws)
}

/// Closes the jaws on the sheet and lifts it.
fn grasp(world: &mut World, jaws: &mut Instrument) {
    for end in [at(3.5e-3, JAW_OPEN), at(3.5e-3, JAW_CLOSED), at(0.015, JAW_CLOSED)] {
        carry_out([jaws], world, [end], 96);
    }
}

fn bits(world: &World) -> Vec<u32> {
    world.bits().collect()
}

#[test]
fn a_copy_goes_on_with_the_same_bits_on_another_thread() {
    let (mut world, id, mut jaws) = prepared();
    carry_out([&mut jaws], &mut world, [at(3.5e-3, JAW_OPEN)], 96);
    carry_out([&mut jaws], &mut world, [at(3.5e-3, JAW_CLOSED)], 96);
    assert_eq!(jaws.fingers_on(&world, id), 2);
    let go_on = move |mut world: World, mut jaws: Instrument| {
        carry_out([&mut jaws], &mut world, [at(0.015, JAW_CLOSED)], 96);
        bits(&world)
    };
    let (copy, its_jaws) = (world.clone(), jaws.clone());
    assert_eq!(bits(&copy), bits(&world));
    let its = std::thread::spawn(move || go_on(copy, its_jaws)).join().unwrap();
    assert_eq!(go_on(world, jaws), its);
}

#[test]
fn a_sheet_sleeps_until_jaws_come_near_and_again_after_they_have_left() {
    let (mut world, id, mut jaws) = prepared();
    let before = bits(&world);
    assert_eq!(carry_out([&mut jaws], &mut world, [at(TOP + 0.01, JAW_OPEN)], 48), [1.0]);
    assert_eq!(bits(&world), before, "no time passed for it");
    grasp(&mut world, &mut jaws);
    assert!(!world.at_rest() && jaws.fingers_on(&world, id) == 2);
    carry_out([&mut jaws], &mut world, [at(0.015, JAW_OPEN)], 96);
    carry_out([&mut jaws], &mut world, [at(0.06, JAW_OPEN)], 96);
    settle(&mut world);
    assert_eq!(jaws.fingers_on(&world, id), 0);
    let bounds = world.others().next().unwrap().bounds();
    assert!((bounds.max.z - TOP).abs() < 0.5e-3, "it lies as before: {bounds:?}");
}

#[test]
fn what_lies_on_a_sheet_sinks_into_it_and_falls_when_it_is_gone() {
    let (mut world, id) = sheet_on_table(&Sheet::FAT, 5e3);
    let half = Vector3::repeat(5e-3);
    let cube = Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(half) };
    let mass = 5e-3;
    let at = Pose::translation(0.0, 0.0, TOP + half.z + 1e-3);
    let cube = world.insert(Motion::Free { mass }, &at, 1.0, &[cube]);
    world.wake(cube);
    for _ in 0..1200 {
        world.advance();
    }
    // It trembles a little: too much to fall asleep.
    assert!(world.velocity(cube).norm() < 0.01, "{}", world.velocity(cube));
    // 0.05 N on a square of 10 mm, on 8 mm of 5 kPa: about half a millimetre, and less since the rest helps.
    let sunk = TOP + half.z - world.pose(cube).translation.z;
    assert!((0.1e-3..1e-3).contains(&sunk), "{sunk}");
    // It falls when the sheet is pulled away.
    world.soft_mut(id).place(&Pose::translation(0.3, 0.0, 4e-3));
    for _ in 0..480 {
        world.advance();
    }
    assert!(world.pose(cube).translation.z < TOP, "{}", world.pose(cube).translation.z);
}

#[test]
fn it_is_drawn_where_it_is_and_takes_little_memory() {
    let (mut world, id, mut jaws) = prepared();
    grasp(&mut world, &mut jaws);
    let mut scene = Scene::default();
    scene.add_world(&world);
    scene.add_others(&world, &mut Rng::new(0, 0));
    let camera = scene.camera(Lens::Overview, 160, 120).unwrap();
    let sheet = scene.body("sheet").unwrap();
    let picture = Software::default().picture(&scene, &camera);
    let seen = picture.mask.iter().filter(|body| **body == sheet).count();
    assert!(seen > 50, "{seen} pixels");
    let surface = world.others().next().unwrap().surface();
    let highest = surface.vertices.iter().map(|vertex| vertex.z).fold(0.0, f64::max);
    assert!(highest > TOP + 4e-3, "its skin is lifted: {highest}");
    assert!(surface.normals.iter().all(|normal| (normal.norm() - 1.0).abs() < 1e-9));
    assert!(world.memory_bytes() < 150 * 1024, "{}", world.memory_bytes());
    check_damage(&mut world, id, &jaws);
}

/// What jaws of 1 N do to fat shows: they crush what they hold, and lifting it overstretches little beside them.
fn check_damage(world: &mut World, id: SoftId, jaws: &Instrument) {
    let sheet = world.soft(id);
    let between = jaws.between_fingers(world);
    let damage = sheet.damage(|point, reach| between.has(point, reach));
    assert!(damage.gripped > 1 && damage.gripped < 40, "{damage:?}");
    assert!(damage.crushed > 0 && damage.overstretched < 10, "{damage:?}");
    assert_eq!(damage.gripped + damage.free, sheet.lattice().form().elements().count() as u32);
    // Faces of 5 mm, some 4 mm deep in the sheet.
    let force = jaws.pressures(world).into_iter().fold(0.0, f64::max);
    let touched = force / jaws.tissue_pressure(world);
    assert!((8e-6..50e-6).contains(&touched), "{touched} m², {force} N");
    let sheet = world.soft_mut(id);
    sheet.set_ultimate_strain(Some(0.0));
    assert!(sheet.damage(|_, _| false).overstretched_share() > 0.9);
}

#[test]
fn an_instrument_is_stopped_by_the_edge_that_is_held() {
    let (world, id, jaws) = prepared();
    for jaw in [JAW_OPEN, JAW_CLOSED] {
        let (mut world, mut jaws) = (world.clone(), jaws.clone());
        let over_edge = |z| posture(&Vector3::new(-0.03, 0.0, z), 0.0, jaw);
        carry_out([&mut jaws], &mut world, [over_edge(TOP + 0.02)], 96);
        for _ in 0..4 {
            let [covered] = carry_out([&mut jaws], &mut world, [over_edge(1e-3)], 48);
            let overlap = world.soft_overlap(world.soft(id));
            println!("covered {covered:.2}, {:.3} mm deep", 1e3 * overlap);
            assert!(covered < 1.0);
            assert!(overlap < 0.5e-3, "{overlap}");
        }
    }
}

#[test]
fn nothing_explodes_whatever_an_instrument_does() {
    let moves = if std::env::var_os("TROCAR_SOAK").is_some() { 2000 } else { 20 };
    let (mut world, id, mut jaws) = prepared();
    let mut rng = Rng::new(7, 0);
    let (mut fastest, mut deepest, mut before) = (0.0_f64, 0.0_f64, 0.0);
    for _ in 0..moves {
        let tip = Vector3::new(
            rng.uniform(-0.035, 0.035),
            rng.uniform(-0.035, 0.035),
            rng.uniform(1e-3, 0.03),
        );
        let jaw = if rng.unit() < 0.5 { JAW_OPEN } else { JAW_CLOSED };
        let end = posture(&tip, rng.uniform(-3.0, 3.0), jaw);
        carry_out([&mut jaws], &mut world, [end], 48);
        assert!(world.is_finite());
        fastest = fastest.max(world.soft(id).lattice().fastest());
        let overlap = world.soft_overlap(world.soft(id));
        deepest = deepest.max(overlap.min(before));
        before = overlap;
    }
    println!("fastest {fastest:.2} m/s, twice deeper than {:.3} mm", 1e3 * deepest);
    assert!(fastest < 8.0, "{fastest}");
    assert!(deepest < 0.5e-3, "{deepest}");
}
