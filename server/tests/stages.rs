//! Experts say what they are about: the stages of each task, in the order in which they are gone through.

use trocar_proto::{Options, Stage};
use trocar_server::Registry;

/// Episodes of each task.
const SEEDS: u64 = 12;

/// The stages of an expert's episode, each once for as long as it lasts; only of successes.
fn stages(task: &str, options: &Options, seed: u64) -> Option<Vec<Stage>> {
    let mut env = Registry::builtin().make(task, options).unwrap();
    let mut action = vec![0.0; env.spec().action_dim()];
    env.reset(Some(seed));
    let mut stages = vec![env.stage()];
    let mut success = false;
    while !env.needs_reset() {
        env.expert(&mut action);
        success = env.step(&action).unwrap().is_success;
        stages.push(env.stage());
    }
    stages.dedup();
    success.then_some(stages)
}

#[track_caller]
fn assert_stages(task: &str, options: &Options, expected: &[Stage]) {
    let found: Vec<_> = (0..SEEDS).filter_map(|seed| stages(task, options, seed)).collect();
    assert_eq!(found.len() as u64, SEEDS, "{task}: episodes that succeed");
    assert!(found.iter().all(|stages| stages.as_slice() == expected), "{task}: {found:?}");
}

#[test]
fn an_arm_approaches_picks_lifts_and_carries() {
    use Stage::{Approach, Carry, Lift, Pick};
    assert_stages("NeedlePick-v0", &Options::new(), &[Approach, Pick, Lift, Carry]);
    assert_stages("GauzeRetrieve-v0", &Options::new(), &[Approach, Pick, Lift, Carry]);
    let picked = Options::new().with_text("start", "pick");
    assert_stages("NeedlePick-v0", &picked, &[Lift, Carry]);
}

#[test]
fn a_block_is_placed_in_the_end() {
    use Stage::{Approach, Carry, HandOver, Lift, Pick, Place};
    let alone = [Approach, Pick, Lift, Carry, Place];
    assert_stages("PegTransfer-v0", &Options::new(), &alone);
    let together = [Approach, Pick, Lift, Carry, HandOver, Carry, Place];
    assert_stages("BiPegTransfer-v0", &Options::new(), &together);
}

#[test]
fn a_needle_is_offered_handed_over_and_carried() {
    use Stage::{Carry, HandOver};
    assert_stages("NeedleRegrasp-v0", &Options::new(), &[Carry, HandOver, Carry]);
}

#[test]
fn where_nothing_is_picked_up_there_is_but_one_stage() {
    for task in ["NeedleReach-v0", "EcmReach-v0", "MisOrient-v0", "StaticTrack-v0"] {
        assert_stages(task, &Options::new(), &[Stage::Reach]);
    }
}
