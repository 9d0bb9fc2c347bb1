//! What is seen between the ends of steps: nothing jumps, and looking changes nothing.

use std::collections::BTreeSet;

use nalgebra::Vector3;
use trocar_proto::Options;
use trocar_proto::spec::OptionValue;
use trocar_server::Env;
use trocar_server::Registry;
use trocar_server::render::Scene;
use trocar_server::render::scene::Instance;

/// Parts of a step.
const PARTS: u32 = 5;

/// How far something must get in a step for its way to be looked at, m.
const FAR: f64 = 1e-3;

fn make(task: &str, options: &Options) -> Env {
    let mut env = Registry::builtin().make(task, options).unwrap();
    env.reset(Some(3));
    env
}

/// Where the parts of all bodies are, m.
fn places(scene: &Scene) -> Vec<Vector3<f64>> {
    let place = |instance: &Instance| instance.world_from_mesh.translation.vector;
    scene.instances().iter().map(place).collect()
}

#[test]
fn looking_between_steps_does_not_change_their_bits() {
    let rows = [("latency_seconds".to_string(), vec![0.03; 2])];
    let late = Options::new().with("domain", OptionValue::Table(rows.into()));
    for task in crate::suite::tasks() {
        for options in [&Options::new(), &late] {
            let (mut one, mut other) = (make(task, options), make(task, options));
            let mut action = vec![0.0; one.spec().action_dim()];
            let mut seen = 0;
            for _ in 0..25 {
                one.expert(&mut action);
                let expected = one.step(&action).unwrap();
                let step = other.step_in_parts(&action, PARTS, &mut |_| seen += 1).unwrap();
                assert_eq!(step.reward.to_bits(), expected.reward.to_bits(), "{task}");
            }
            assert_eq!(one.export().unwrap(), other.export().unwrap(), "{task}");
            assert_eq!(seen, 25 * (PARTS - 1));
        }
    }
}

#[test]
fn what_moves_in_a_step_moves_bit_by_bit() {
    for (task, movers) in [
        ("NeedlePick-v0", ["psm1 insertion_link", "psm1 jaw_1_link", "needle"]),
        ("BiPegTransfer-v0", ["psm1 jaw_1_link", "psm2 jaw_2_link", "block"]),
        ("ActiveTrack-v0", ["ecm bottom_link", "ecm insertion_link", "target"]),
    ] {
        let mut env = make(task, &Options::new());
        let mut action = vec![0.0; env.spec().action_dim()];
        let mut moving = BTreeSet::new();
        for step in 0..env.spec().max_steps.min(40) {
            env.expert(&mut action);
            let mut ways = vec![places(&env.scene())];
            env.step_in_parts(&action, PARTS, &mut |scene| ways.push(places(&scene))).unwrap();
            ways.push(places(&env.scene()));
            assert_eq!(ways.len(), PARTS as usize + 1);
            let scene = env.scene();
            for (index, instance) in scene.instances().iter().enumerate() {
                let whole = ways[PARTS as usize][index] - ways[0][index];
                if whole.norm() < FAR {
                    continue;
                }
                let body = &scene.bodies()[instance.body as usize - 1];
                moving.insert(body.to_string());
                for pair in ways.windows(2) {
                    let part = pair[1][index] - pair[0][index];
                    let forward = part.dot(&whole) / whole.norm_squared();
                    assert!(
                        (-0.1..0.6).contains(&forward),
                        "{task}, step {step}: {body} goes {forward} of its way in one of {PARTS} parts"
                    );
                }
            }
        }
        for body in movers {
            assert!(moving.contains(body), "{task}: {body} did not move");
        }
    }
}
