//! The grasp test bench of the peg transfer: a block gripped by one of its walls, by friction alone,
//! again and again, a little off each time, and handled.
//!
//! `TROCAR_SOAK=1` runs ten times as many trials. `--nocapture` shows slip and rotation.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use trocar_server::assets::Model;
use trocar_server::sim::frames::{self, Pose};
use trocar_server::sim::instrument::{Instrument, JAW_CLOSED, JAW_OPEN, Posture, TIP_OFFSET};
use trocar_server::sim::random::Rng;
use trocar_server::sim::travel::travel;
use trocar_server::sim::world::Motion;
use trocar_server::tasks::options::Preset;
use trocar_server::tasks::psm_scene::WORKSPACE;
use trocar_server::tasks::tray;

const DEGREE: f64 = PI / 180.0;

/// Substeps of 0.2 s.
const STEP: u32 = 48;

/// Slip and rotation up to which an object counts as held, m and rad.
const SLIP: f64 = 2e-3;
const ROTATION: f64 = 20.0 * DEGREE;

/// How far the tips of closed jaws reach below the block's top, m: as the expert grasps.
const DEPTH: f64 = 3.5e-3;

/// How a trial goes.
#[derive(Debug, Clone, Copy)]
struct Trial {
    preset: Preset,
    /// Friction coefficient of the jaws.
    friction: f64,
    /// Half the range of the errors: across and along the wall (m), turn (rad).
    errors: [f64; 3],
}

impl Trial {
    const PERTURBED: Self =
        Self { preset: Preset::Paper, friction: 1.0, errors: [1e-3, 2e-3, 5.0 * DEGREE] };
}

/// What became of the block.
#[derive(Debug, Clone, Copy)]
struct Outcome {
    slip: f64,
    rotation: f64,
    touched: bool,
}

impl Outcome {
    fn held(&self) -> bool {
        self.touched && self.slip < SLIP && self.rotation < ROTATION
    }
}

/// A grasp, a lift and 50 random moves of up to 10 mm along each axis and 30°.
fn run(trial: Trial, seed: u64) -> Outcome {
    let mut rng = Rng::new(seed, 0);
    let (mass, squeeze) = match trial.preset {
        Preset::Paper => (Model::block().mass, 1.0),
        Preset::Surrol => (0.01, 3.0),
    };
    let mut world = tray::furnished_world(trial.preset);
    let model = Model::block();
    let pad = tray::pad();
    let height = model.aabb(&Pose::identity()).max.z;
    let turned = rng.uniform(-PI, PI);
    let pose =
        frames::pose([pad.centre().x, pad.centre().y, pad.max.z + height], [0.0, 0.0, turned]);
    let block = world.insert(Motion::Free { mass }, &pose, model.friction, &model.parts);

    let [across, along, turn] = trial.errors;
    let off = Vector3::new(rng.uniform(-across, across), rng.uniform(-along, along), 0.0);
    let wall = pose * model.body_from("wall_0") * Pose::from(off);
    let mut tip = wall.translation.vector;
    tip.z = pad.max.z + 2.0 * height - DEPTH;
    // The jaws close along their y axis, which is to be the wall's x axis.
    let mut yaw = turned + 90.0 * DEGREE + rng.uniform(-turn, turn);
    let down = |tip: Vector3<f64>, yaw: f64, jaw: f64| {
        let wrist = tip + Vector3::z() * TIP_OFFSET;
        Posture { world_from_wrist: frames::pose(wrist.into(), [PI, 0.0, yaw]), jaw }
    };
    let mut arm =
        Instrument::insert(&mut world, down(tip + Vector3::z() * 0.014, yaw, JAW_OPEN), squeeze);
    arm.set_friction(&mut world, trial.friction);
    travel([&mut arm], &mut world, [down(tip, yaw, JAW_OPEN)], STEP);
    travel([&mut arm], &mut world, [down(tip, yaw, JAW_CLOSED)], 2 * STEP);

    let wrist_from_block =
        |arm: &Instrument, pose: Pose| arm.posture().world_from_wrist.inv_mul(&pose);
    let gripped = wrist_from_block(&arm, world.pose(block));
    let point = gripped.inverse() * Point3::new(0.0, 0.0, TIP_OFFSET - DEPTH);
    let mut outcome = Outcome { slip: 0.0, rotation: 0.0, touched: false };
    tip.z += 0.04;
    travel([&mut arm], &mut world, [down(tip, yaw, JAW_CLOSED)], 4 * STEP);
    for _ in 0..50 {
        for axis in 0..3 {
            tip[axis] += rng.uniform(-0.01, 0.01);
            tip[axis] = tip[axis].clamp(WORKSPACE.min[axis], WORKSPACE.max[axis]);
        }
        tip.z = tip.z.max(pad.max.z + 0.03);
        yaw += rng.uniform(-30.0, 30.0) * DEGREE;
        travel([&mut arm], &mut world, [down(tip, yaw, JAW_CLOSED)], STEP);
        let now = wrist_from_block(&arm, world.pose(block));
        outcome.slip = outcome.slip.max((now * point - gripped * point).norm());
        outcome.rotation = outcome.rotation.max(now.rotation.angle_to(&gripped.rotation));
        outcome.touched = arm.holds(&world, block);
    }
    assert_eq!(world.joints().count(), 2, "no constraint ever ties an object to a jaw");
    outcome
}

/// Runs `count` trials (ten times as many in a soak) and returns the share of those that held.
fn share_held(name: &str, trial: Trial, count: u64) -> f64 {
    let count = if std::env::var_os("TROCAR_SOAK").is_some() { 10 * count } else { count };
    let outcomes: Vec<_> = (5001..=5000 + count).map(|seed| run(trial, seed)).collect();
    let held = outcomes.iter().filter(|outcome| outcome.held()).count();
    let quantiles = |value: fn(&Outcome) -> f64| {
        let mut values: Vec<_> = outcomes.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        [values[values.len() / 2], values[values.len() * 95 / 100]]
    };
    let [slip, slip_95] = quantiles(|outcome| outcome.slip * 1e3);
    let [turn, turn_95] = quantiles(|outcome| outcome.rotation / DEGREE);
    eprintln!(
        "{name}: held {held}/{count}, slip median {slip:.2} / 95 % {slip_95:.2} mm, \
         rotation {turn:.1} / {turn_95:.1}°",
    );
    held as f64 / count as f64
}

#[test]
fn a_block_gripped_a_little_off_is_held_through_random_moves() {
    assert!(share_held("block", Trial::PERTURBED, 20) >= 0.95);
}

#[test]
fn a_block_is_held_by_slippery_jaws() {
    let slippery = Trial { friction: 0.5, ..Trial::PERTURBED };
    assert!(share_held("block, friction 0.5", slippery, 10) >= 0.9);
}

#[test]
fn the_originals_heavy_block_is_held_by_the_cheaper_solver() {
    let heavy = Trial { preset: Preset::Surrol, ..Trial::PERTURBED };
    assert!(share_held("block of 10 g", heavy, 10) >= 0.95);
}
