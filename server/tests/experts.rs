//! The scripted experts succeed: over seeds 0 to 499 with `TROCAR_SOAK=1`, over a few of them without.
//!
//! Success is that of the last step. Where friction alone is to hold objects, no constraint but the
//! fingers' hinges may ever be in the world. `--nocapture` prints the table.

#![expect(clippy::unwrap_used, reason = "a panic is a test's report, in its helpers too")]

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

use trocar_proto::spec::{Allowed, RowSpec};
use trocar_proto::{OptionValue, Options};
use trocar_server::tasks::Registry;

/// A task under options, and how often its expert must succeed.
struct Bar {
    id: String,
    options: Options,
    seeds: u64,
    /// How many of these episodes may fail.
    may_fail: usize,
}

/// Every task as the paper has it and under everything that changes what the expert does.
fn bars() -> Vec<Bar> {
    let soak = std::env::var_os("TROCAR_SOAK").is_some();
    let registry = Registry::builtin();
    let mut bars = vec![];
    for id in registry.ids() {
        let spec = registry.spec(id, &Options::new()).unwrap();
        if spec.goal.is_none() {
            continue; // what its expert achieves is tested with the task
        }
        let knows = |name: &str| spec.options.iter().any(|option| option.name == name);
        let grasps = knows("grasp");
        let mut add = |options: Options, (many, few): (u64, u64), may_fail: f64| {
            let seeds = if soak { many } else { few };
            // One of a few is not yet a rate.
            let may_fail = (may_fail * seeds as f64).ceil() as usize;
            bars.push(Bar { id: id.into(), options, seeds, may_fail });
        };
        // What is only reached for is reached always; what is grasped may be lost.
        let (seeds, may_fail) = if grasps { ((500, 16), 0.05) } else { ((500, 100), 0.0) };
        add(Options::new(), seeds, may_fail);
        if knows("spawn") {
            add(Options::new().with_text("spawn", "narrow"), seeds, may_fail);
        }
        let surrol = Options::new().with_text("preset", "surrol");
        if grasps {
            add(surrol.with_text("grasp", "interact"), seeds, may_fail);
        }
        if ["NeedlePick-v0", "PegTransfer-v0"].contains(&id) {
            let rows = BTreeMap::from([("friction".to_string(), vec![0.5, 0.5])]);
            let slippery = Options::new().with("domain", OptionValue::Table(rows));
            add(slippery, seeds, 0.1);
        }
        for option in spec.options.iter().filter(|option| option.name == "domain") {
            let Allowed::Table(rows) = &option.allowed else { continue };
            let varied = ["mass", "size", "camera_pose_position", "camera_pose_angle"];
            let rows = rows.iter().filter(|row| varied.contains(&row.name.as_str()));
            let draws = |ranges: Vec<(&RowSpec, Vec<f64>)>| {
                let rows = ranges.into_iter().map(|(row, range)| (row.name.clone(), range));
                Options::new().with("domain", OptionValue::Table(rows.collect()))
            };
            let whole = rows.clone().map(|row| (row, vec![row.min, row.max]));
            add(draws(whole.collect()), if grasps { (100, 4) } else { (100, 20) }, 0.1);
            for (row, end) in rows.flat_map(|row| [(row, row.min), (row, row.max)]) {
                add(draws(vec![(row, vec![end; 2])]), if grasps { (20, 2) } else { (20, 5) }, 0.1);
            }
        }
        for option in &spec.options {
            let Allowed::OneOf(words) = &option.allowed else { continue };
            // Rewards change nothing, and where things appear was looked at.
            if ["reward", "spawn"].contains(&option.name.as_str()) {
                continue;
            }
            for word in &words[1..] {
                let options = Options::new().with_text(&option.name, word);
                add(options, if grasps { (40, 3) } else { seeds }, may_fail);
            }
        }
    }
    bars
}

/// The seeds with which the expert fails.
fn failures(bar: &Bar) -> Vec<u64> {
    let mut env = Registry::builtin().make(&bar.id, &bar.options).unwrap();
    let mut action = vec![0.0; env.spec().action_dim()];
    let grasp = env.spec().options.iter().find(|option| option.name == "grasp");
    let grasp = grasp.map(|option| bar.options.0.get("grasp").unwrap_or(&option.default));
    let by_friction = grasp == Some(&OptionValue::Text("interact".into()));
    let mut fails = |seed: &u64| {
        env.reset(Some(*seed));
        let hinges = 2 * (env.spec().action_dim() / 5).max(1);
        let mut last = None;
        while !env.needs_reset() {
            env.expert(&mut action);
            last = Some(env.step(&action).unwrap());
            assert!(!by_friction || env.world().joints().count() == hinges, "{}", bar.id);
        }
        !last.unwrap().is_success
    };
    (0..bar.seeds).filter(&mut fails).collect()
}

#[test]
fn the_expert_succeeds() {
    let bars = bars();
    let next = AtomicUsize::new(0);
    let work = || {
        let mut bad = vec![];
        while let Some(bar) = bars.get(next.fetch_add(1, Ordering::Relaxed)) {
            let failed = failures(bar);
            let Bar { id, options, seeds, may_fail } = bar;
            eprintln!("{id} {:?}: {}/{seeds} failed {failed:?}", options.0, failed.len());
            if failed.len() > *may_fail {
                bad.push(format!("{id} {:?}: {} of {seeds}: {failed:?}", options.0, failed.len()));
            }
        }
        bad
    };
    let threads = std::thread::available_parallelism().unwrap().get();
    let bad: Vec<_> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap()).collect()
    });
    assert!(bad.is_empty(), "{bad:#?}");
}
