//! How exactly the jaws must be placed for each grasp mode to lift a needle.
//!
//! In every trial the needle lies somewhere else, the jaws close a given distance off the ideal place
//! and then rise by 40 mm. `TROCAR_SOAK=1 cargo test --release --test server grasp_modes:: -- --nocapture` prints
//! the table of `server/GRASPING.md` as Markdown.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{UnitQuaternion, Vector3};
use trocar_server::assets::Model;
use trocar_server::sim::frames;
use trocar_server::sim::grasp::{Grasp, GraspMode};
use trocar_server::sim::instrument::{Instrument, JAW_CLOSED, JAW_OPEN, Posture, TIP_OFFSET};
use trocar_server::sim::motion::carry_out;
use trocar_server::sim::random::Rng;
use trocar_server::tasks::options::{Domain, Preset};
use trocar_server::tasks::tray::{self, Needle};

/// Substeps of 0.2 s.
const STEP: u32 = 48;

/// Force of each finger, N.
const SQUEEZE: f64 = 1.0;

/// Height of the tip over the pad where the jaws close ideally, m.
const IDEAL_HEIGHT: f64 = 0.05e-3;

/// Diameter of the wire, m: its surface is this far above the pad.
const WIRE: f64 = 1e-3;

/// The needle's middle must rise by this much to count as lifted, m, of 40 mm.
const LIFTED: f64 = 0.03;

/// Height of the needle's middle from which `weld` attaches it, m above where it lay. Source: the original.
const WELD_LIFT: f64 = 0.005;

/// Errors that no mode is told of: turn and place along the arc, rad.
const ERRORS: [f64; 2] = [5.0 * PI / 180.0, 20.0 * PI / 180.0];

const MODES: [(&str, GraspMode); 5] = [
    ("interact", GraspMode::Interact),
    ("approx 1 mm", GraspMode::Approx { distance: 1e-3 }),
    ("approx 2 mm", GraspMode::Approx { distance: 2e-3 }),
    ("approx 3 mm", GraspMode::Approx { distance: 3e-3 }),
    ("weld", GraspMode::Weld),
];

/// Axes of the jaws along which they are off.
const AXES: [&str; 3] = ["approach (up)", "closing", "wire"];

/// Whether jaws that close `off` (m; along the axes of [`AXES`]) the ideal place lift the needle.
fn lifts(mode: GraspMode, off: [f64; 3], seed: u64) -> bool {
    let mut rng = Rng::new(seed, 0);
    let mut world = tray::furnished_world(Preset::Paper);
    let needle = Needle::insert(&mut world, Preset::Paper, Domain::default());
    let centre = tray::pad().centre();
    needle.lay(&mut world, centre.x, centre.y, rng.uniform(-FRAC_PI_2, FRAC_PI_2));
    let mut grasp = Grasp::new(&mut world, mode, needle.body());

    let [turn, arc] = ERRORS.map(|most| rng.uniform(-most, most));
    let about = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), arc);
    let place = world.pose(needle.body()) * about * Model::needle().body_from("mid_arc");
    let (across, wire) = (place.rotation * Vector3::x(), place.rotation * Vector3::y());
    let height = tray::pad().max.z + IDEAL_HEIGHT;
    let at = place.translation.vector;
    let tip =
        Vector3::new(at.x, at.y, height) + Vector3::z() * off[0] + across * off[1] + wire * off[2];
    let yaw = libm::atan2(wire.y, wire.x) + turn;
    let rest = needle.scene_from_middle(&world).translation.z;

    let posture = |rise: f64, jaw: f64| {
        let wrist = tip + Vector3::z() * (TIP_OFFSET + rise);
        Posture { world_from_wrist: frames::pose(wrist.into(), [PI, 0.0, yaw]), jaw }
    };
    let mut arm = Instrument::insert(&mut world, posture(0.014, JAW_OPEN), SQUEEZE);
    let way = [(0.0, JAW_OPEN), (0.0, JAW_CLOSED), (0.0, JAW_CLOSED)];
    let lift = (1..=4).map(|step| (0.01 * f64::from(step), JAW_CLOSED));
    for (rise, jaw) in way.into_iter().chain(lift).chain([(0.04, JAW_CLOSED); 2]) {
        grasp.command(&mut world, [&mut arm], [jaw < 0.5 * JAW_OPEN]);
        carry_out([&mut arm], &mut world, [posture(rise, jaw)], STEP);
        let risen = needle.scene_from_middle(&world).translation.z - rest;
        grasp.settle(&mut world, [&mut arm], risen > WELD_LIFT);
        if mode == GraspMode::Interact {
            assert_eq!(world.joints().count(), 2, "the fingers' hinges and nothing else");
        }
    }
    needle.scene_from_middle(&world).translation.z - rest > LIFTED
}

/// The share of `count` trials in which the needle is lifted.
fn share(mode: GraspMode, off: [f64; 3], count: u64) -> f64 {
    let lifted = (7001..=7000 + count).filter(|seed| lifts(mode, off, *seed)).count();
    lifted as f64 / count as f64
}

fn is_soak() -> bool {
    std::env::var_os("TROCAR_SOAK").is_some()
}

#[test]
fn a_needle_out_of_the_fingers_reach_is_lifted_by_a_tie_only() {
    let count = if is_soak() { 200 } else { 10 };
    let above = [WIRE + 2.8e-3 - IDEAL_HEIGHT, 0.0, 0.0]; // the tip is 2.8 mm above the wire
    let interact = share(GraspMode::Interact, above, count);
    let approx = share(GraspMode::Approx { distance: 3e-3 }, above, count);
    eprintln!("tip 2.8 mm above the wire: interact {interact:.3}, approx at 3 mm {approx:.3}");
    assert!(interact <= 0.05 && approx >= 0.9);
    assert!(share(GraspMode::Approx { distance: 2e-3 }, above, count) <= 0.05);
}

#[test]
fn jaws_in_the_right_place_lift_the_needle_in_every_mode() {
    for (name, mode) in MODES {
        let lifted = share(mode, [0.0; 3], if is_soak() { 200 } else { 6 });
        assert!(lifted >= 0.95, "{name}: {lifted}");
    }
}

#[test]
fn the_table_of_offsets() {
    let (count, offsets): (u64, &[f64]) =
        if is_soak() { (40, &[0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]) } else { (2, &[3.0]) };
    let row = |cells: Vec<String>| format!("| {} |", cells.join(" | "));
    let columns = offsets.iter().map(|off| format!("{off} mm"));
    println!("{}", row(["mode".into(), "off along".into()].into_iter().chain(columns).collect()));
    println!("{}", row(vec!["---".into(); 2 + offsets.len()]));
    for (name, mode) in MODES {
        for (axis, label) in AXES.iter().enumerate() {
            let cells = offsets.iter().map(|off| {
                let mut vector = [0.0; 3];
                vector[axis] = off * 1e-3;
                share(mode, vector, count)
            });
            let cells: Vec<_> = cells.collect();
            let shown = cells.iter().map(|share| format!("{:.0} %", 100.0 * share));
            println!(
                "{}",
                row([format!("`{name}`"), (*label).into()].into_iter().chain(shown).collect())
            );
            if mode == GraspMode::Interact && axis == 0 {
                assert!(cells[cells.len() - 1] < 0.5, "3 mm above: nothing to grip");
            }
        }
    }
}
