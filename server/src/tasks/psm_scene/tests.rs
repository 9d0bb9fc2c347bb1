//! How the arm stands, moves and turns.

use super::action::moved;
use super::orientation::PITCHED;
use super::*;
use crate::sim::instrument::JAW_OPEN;
use crate::sim::motion::Motion;
use crate::sim::world::Solver;
use crate::tasks::tray::pad;

fn arm(options: &Options) -> (World, PsmArm) {
    let mut world = World::new(Solver::LIGHT);
    let paper = PaperAction { turn: Turn::Vertical, jaw: true };
    let start = [WORKSPACE.min.x, WORKSPACE.max.y, WORKSPACE.max.z + TIP_OFFSET];
    let mut arm =
        PsmArm::insert(&mut world, options, paper, Station::psm1(start, pad().max.z)).unwrap();
    arm.reset(&mut world, &mut Rng::new(0, 0));
    (world, arm)
}

/// Lets a step pass under `action`.
fn step(arm: &mut PsmArm, world: &mut World, action: &[f32]) {
    arm.command(Some(action));
    let substeps = arm.rate.substeps();
    let mut motion = Motion::new([arm.profile.clone()], substeps);
    motion.pass(substeps, &mut [&mut arm.instrument], world);
    arm.arrive(motion.arrivals().next().unwrap());
}

#[test]
fn the_start_is_the_originals() {
    for model in ["classic", "si"] {
        let (world, arm) = arm(&Options::new().with_text("arm", model));
        // Joints that the original reports after its reset, to the digits it was read with.
        let original = [0.2505, -0.0078, 0.1068, -0.3389, -0.0776, -0.2386];
        for (found, expected) in arm.joints.iter().zip(original) {
            assert!((found - expected).abs() < 2e-3, "{model}: {:?}", arm.joints);
        }
        let mut seen = [0.0; PsmArm::OBSERVED];
        arm.state(&world, &mut State::read(&mut seen));
        let quarter = std::f32::consts::FRAC_PI_2;
        let start = [0.5, 0.05, 0.7552, -quarter, 0.0, quarter, 0.0];
        for (found, expected) in seen.iter().zip(start) {
            assert!((found - expected).abs() < 1e-6, "{model}: {seen:?}");
        }
    }
}

#[test]
fn the_si_goes_wherever_the_classic_goes_and_further() {
    let far = [2.5, -1.2, 0.28, 0.0, 0.0, 0.0];
    let [(_, classic), (_, si)] =
        ["classic", "si"].map(|model| arm(&Options::new().with_text("arm", model)));
    for (ours, theirs) in si.kinematics.limits().iter().zip(classic.kinematics.limits()) {
        assert!(ours.min <= theirs.min && theirs.max <= ours.max, "{ours:?}");
    }
    // Jaws straight down, at every corner of the reach, turned about the vertical as far as the Classic's.
    for corner in si.reach.corners() {
        for turn in -3..=3 {
            let turn = Vector3::z() * (f64::from(turn) * STEP_ANGLE);
            let place = Pose::from_parts(corner.coords.into(), down());
            let place = moved(&place, Vector3::zeros(), turn);
            let [ours, theirs] = [&si, &classic].map(|arm| arm.solve(&arm.confined(place)));
            if let Some(theirs) = theirs {
                let ours = ours.expect("what the Classic reaches");
                assert!(ours.iter().zip(theirs).all(|(a, b)| (a - b).abs() < 1e-9), "{ours:?}");
            }
        }
    }
    let beyond = si.pose_at(&far);
    let [ours, theirs] = [si, classic].map(|mut arm| arm.put(&beyond, JAW_CLOSED));
    assert!(ours && !theirs, "only the Si reaches {far:?}");
}

#[test]
fn every_action_mode_takes_the_wrist_where_its_encoding_says() {
    for mode in ["paper", "cartesian", "cartesian_abs", "joint"] {
        let (mut world, mut arm) = arm(&Options::new().with_text("action", mode));
        let target = moved(
            arm.scene_from_wrist(),
            Vector3::new(0.003, -0.004, -0.005),
            Vector3::new(0.0, 0.0, 0.2),
        );
        let mut action = vec![0.0; arm.action_elements().len()];
        arm.encode(&target, JAW_OPEN, &mut action);
        assert!(action.iter().all(|number| number.abs() <= 1.0), "{mode}: {action:?}");
        step(&mut arm, &mut world, &action);
        let off = target.inv_mul(arm.scene_from_wrist());
        assert!(off.translation.vector.norm() < 1e-6, "{mode}: {off}");
        assert!(off.rotation.angle() < 1e-6, "{mode}");
        assert!((arm.instrument.posture().jaw - JAW_OPEN).abs() < 1e-6, "{mode}");
    }
}

#[test]
fn no_action_takes_the_jaws_below_their_clearance_or_out_of_reach() {
    let offset = trocar_proto::OptionValue::Table(std::collections::BTreeMap::from([(
        "joint_offset".to_string(),
        vec![0.01, 0.02],
    )]));
    let modes = ["paper", "cartesian", "cartesian_abs", "joint"];
    for (mode, model) in modes.into_iter().flat_map(|mode| [(mode, "classic"), (mode, "si")]) {
        let options = Options::new().with_text("action", mode).with_text("arm", model);
        let (mut world, mut arm) = arm(&options.with("domain", offset.clone()));
        let mut rng = Rng::new(1, 0);
        let count = arm.action_elements().len();
        let mut lowest = f64::INFINITY;
        for _ in 0..2000 {
            let mut action: Vec<f32> = (0..count).map(|_| rng.uniform(-1.0, 1.0) as f32).collect();
            action[2] = if mode == "joint" { 1.0 } else { -1.0 };
            let before = arm.tip();
            step(&mut arm, &mut world, &action);
            let pose = arm.instrument.posture().world_from_wrist;
            let low = pose.translation.z - arm.instrument.depth_below_wrist(&pose.rotation);
            lowest = lowest.min(low);
            assert!(low > pad().max.z + instrument::CLEARANCE - 1e-7, "{mode}: {low}");
            assert!((arm.tip() - before).norm() < 0.05, "{mode}: a jump");
            let limits = arm.kinematics.limits();
            assert!(arm.joints.iter().zip(limits).all(|(q, l)| l.min <= *q && *q <= l.max));
        }
        assert!(lowest < pad().max.z + 1e-3, "{mode}: never came down, {lowest}");
    }
}

/// PSM1 or PSM2 where both hand over a needle, its jaws at this pitch.
fn pitching_arm(model: &str, arm: usize, pitch: f64) -> (World, PsmArm) {
    let mut world = World::new(Solver::LIGHT);
    let paper = PaperAction { turn: Turn::Pitch, jaw: true };
    let side = [1.0, -1.0][arm];
    let y = 0.045 * side;
    let workspace = Aabb::new([0.55, y - 0.035, 0.695], [0.60, y + 0.035, 0.745]);
    let at = workspace.centre() + Vector3::z() * TIP_OFFSET;
    let start = Pose::from_parts(at.into(), pitched(arm, pitch));
    let (support, jaws) = (pad().max.z, crate::sim::instrument::Jaws::NEEDLE_DRIVER);
    let station = Station { arm, workspace, start, support, squeeze: None, jaws };
    let options = Options::new().with_text("arm", model);
    let mut arm = PsmArm::insert(&mut world, &options, paper, station).unwrap();
    arm.reset(&mut world, &mut Rng::new(0, 0));
    (world, arm)
}

#[test]
fn the_pitch_turns_jaws_about_themselves_within_a_quarter_turn() {
    for (index, [roll, yaw]) in PITCHED.into_iter().enumerate() {
        let (mut world, mut arm) = pitching_arm("classic", index, -FRAC_PI_2);
        let along = arm.scene_from_wrist().rotation * Vector3::z();
        assert!((along - Vector3::x()).norm() < 1e-12, "{along}");
        let mut seen = [0.0; PsmArm::OBSERVED];
        for (turn, pitch) in [(1.0, -75.0), (0.4, -69.0), (-1.0, -84.0)] {
            step(&mut arm, &mut world, &[0.0, 0.0, 0.0, turn, -1.0]);
            arm.state(&world, &mut State::read(&mut seen));
            let expected = [roll, pitch * DEGREE, yaw];
            for (found, expected) in seen[3..6].iter().zip(expected) {
                assert!((f64::from(*found) - expected).abs() < 1e-6, "{seen:?}");
            }
        }
        for _ in 0..2 {
            step(&mut arm, &mut world, &[0.0, 0.0, 0.0, -1.0, -1.0]);
        }
        arm.state(&world, &mut State::read(&mut seen));
        // The original's numbers where roll and yaw are not determined.
        for (found, expected) in seen[3..6].iter().zip([0.0, -FRAC_PI_2, -FRAC_PI_2]) {
            assert!((f64::from(*found) - expected).abs() < 1e-6, "{seen:?}");
        }
    }
}

#[test]
fn the_pitch_goes_far_enough_all_over_the_workspace() {
    for (index, model) in [(0, "classic"), (1, "classic"), (0, "si"), (1, "si")] {
        let (_, start) = pitching_arm(model, index, -FRAC_PI_2);
        for corner in start.reach.corners() {
            let mut arm = start.clone();
            let reached = (-6..=6).map(|step| f64::from(step) * STEP_PITCH).take_while(|pitch| {
                let pose = Pose::from_parts(corner.coords.into(), pitched(index, *pitch));
                let joints = arm.solve(&arm.confined(pose));
                arm.commanded.joints = joints.unwrap_or(arm.commanded.joints);
                joints.is_some()
            });
            // Further, the roll may end at its limit.
            let last = reached.last().expect("the start's pitch is reached");
            assert!(last >= 60.0 * DEGREE - 1e-9, "{model} PSM{} at {corner}: {last}", index + 1);
        }
    }
}

#[test]
fn jaws_close_across_what_their_pitch_is_chosen_for() {
    for index in 0..2 {
        for angle in [-1.4, -0.5, 0.0, 0.3, 1.5] {
            let along = Vector3::new(0.3, libm::cos(angle), libm::sin(angle));
            let wrist = pitched(index, pitch_across(index, &along));
            assert!((wrist * Vector3::y()).dot(&along).abs() < 1e-12, "{index} {angle}");
            assert!((pitch_of(index, &wrist) - pitch_across(index, &along)).abs() < 1e-12);
        }
    }
}
