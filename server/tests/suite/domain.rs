//! The rows of `domain`: what each of them does, and what it leaves as it was.

use trocar_proto::spec::{Allowed, OptionValue, RowSpec};
use trocar_proto::{Code, Options, builtin};
use trocar_server::Registry;
use trocar_server::env::Env;
use trocar_server::sim::world::{GRAVITY, Inertia, SUBSTEPS_PER_SECOND};

use super::{Seen, is_slow, table};

/// Rows about an object.
const OBJECT: [&str; 2] = ["mass", "size"];

/// Whether a row is one of what is wrong with arms.
pub(crate) fn is_arm_error(row: &str) -> bool {
    ["lag_", "play_", "gain_", "coupling_", "base_"].iter().any(|kind| row.starts_with(kind))
}

/// The rows of a task's `domain`.
fn domain_rows(id: &str) -> Vec<RowSpec> {
    let options = Registry::builtin().spec(id, &Options::new()).unwrap().options;
    let domain = options.into_iter().find(|option| option.name == "domain").unwrap();
    let Allowed::Table(rows) = domain.allowed else { panic!("{id}: domain is a table") };
    rows
}

/// A task under the whole range of every row.
pub(crate) fn everything(id: &str) -> (String, Options) {
    let rows = domain_rows(id).into_iter().map(|row| (row.name, vec![row.min, row.max]));
    (id.to_string(), Options::new().with("domain", OptionValue::Table(rows.collect())))
}

/// A task with the lightest and largest object that there may be.
pub(crate) fn ends_of_objects(id: &str) -> (String, Options) {
    let rows = domain_rows(id).into_iter().filter(|row| OBJECT.contains(&row.name.as_str()));
    let rows = rows.map(|row| {
        let end = if row.name == "mass" { row.min } else { row.max };
        (row.name, vec![end; 2])
    });
    (id.to_string(), Options::new().with("domain", OptionValue::Table(rows.collect())))
}

/// A task where every episode draws `number` for the row `row`.
fn fixed(id: &str, row: &str, number: f64) -> Env {
    let domain = table(&[(row, &[number, number])]);
    Registry::builtin().make(id, &Options::new().with("domain", domain)).unwrap()
}

fn plain(id: &str) -> Env {
    Registry::builtin().make(id, &Options::new()).unwrap()
}

/// What the expert's episode of seed 3 shows, as far as `steps`.
fn shown(mut env: Env, steps: u32) -> Vec<Vec<u32>> {
    env.reset(Some(3));
    let mut seen = vec![Seen::of(&env).bits()];
    while !env.needs_reset() && env.steps() < steps {
        env.step(&Seen::of(&env).expert).unwrap();
        seen.push(Seen::of(&env).bits());
    }
    seen
}

/// How the mass of the objects of an episode is spread.
fn inertias(mut env: Env) -> Vec<Inertia> {
    env.reset(Some(3));
    env.world().objects().map(|object| env.world().inertia(object)).collect()
}

/// After how many steps two environments that are told opposite things show different ones.
fn steps_until_commands_show(mut env: Env) -> u32 {
    env.reset(Some(3));
    let mut other = env.clone();
    let dim = env.spec().action_dim();
    // The expert knows of commands before they show.
    let shown = |env: &Env| Seen { expert: vec![], ..Seen::of(env) }.bits();
    while shown(&env) == shown(&other) {
        env.step(&vec![1.0; dim]).unwrap();
        other.step(&vec![-1.0; dim]).unwrap();
    }
    env.steps()
}

/// How low closed jaws come that are pressed down in the middle of the workspace, m, wrist.
fn lowest_wrist(mut env: Env) -> f64 {
    env.reset(Some(3));
    for step in 0..13 {
        let action =
            if step < 5 { [1.0, -1.0, 0.0, 0.0, -1.0] } else { [0.0, 0.0, -1.0, 0.0, -1.0] };
        env.step(&action).unwrap();
    }
    f64::from(Seen::of(&env).observation[2])
}

/// Mean square of what sensors add to observed positions, m².
fn noise(id: &str, mut env: Env) -> f64 {
    let mut plain = plain(id);
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in 0..100 {
        env.reset(Some(seed));
        plain.reset(Some(seed));
        let (noisy, exact) = (Seen::of(&env).observation, Seen::of(&plain).observation);
        for (index, element) in env.spec().observation.iter().enumerate() {
            if element.unit == "m" {
                sum += f64::from(noisy[index] - exact[index]).powi(2);
                count += 1.0;
            } else {
                assert_eq!(noisy[index].to_bits(), exact[index].to_bits(), "{}", element.name);
            }
        }
    }
    sum / count
}

#[test]
fn randomised_domains_are_drawn_by_episode() {
    let domain = table(&[
        ("observation_noise", &[0.001, 0.002]),
        ("joint_offset", &[-0.01, 0.01]),
        ("latency", &[1.0, 3.0]),
    ]);
    for id in Registry::builtin().ids() {
        let options = Options::new().with("domain", domain.clone());
        let mut env = Registry::builtin().make(id, &options).unwrap();
        let mut plain = Registry::builtin().make(id, &Options::new()).unwrap();
        let mut offsets = vec![];
        for seed in 0..5 {
            env.reset(Some(seed));
            plain.reset(Some(seed));
            let (noisy, exact) = (Seen::of(&env), Seen::of(&plain));
            assert_eq!(noisy.desired, exact.desired, "the episode itself is the same");
            assert_ne!(noisy.observation, exact.observation);
            assert!((noisy.observation[0] - exact.observation[0]).abs() < 0.01);
            offsets.push(noisy.observation[0].to_bits());
            if !id.contains("Reach") {
                continue; // what is achieved is not the arm's
            }
            assert_ne!(noisy.achieved, exact.achieved, "encoder errors move the arm");
            let held = noisy.achieved.clone();
            env.step(&vec![-1.0; env.spec().action_dim()]).unwrap();
            assert_eq!(Seen::of(&env).achieved, held, "no command has arrived yet");
            for _ in 0..3 {
                env.step(&vec![-1.0; env.spec().action_dim()]).unwrap();
            }
            assert_ne!(Seen::of(&env).achieved, held);
        }
        offsets.dedup();
        assert_eq!(offsets.len(), 5);
    }
}

/// Whether a task has what shows an error of arms: none moves all joints of an ECM, and the jaws of two are locked.
fn is_felt(id: &str, row: &str) -> bool {
    let is_psm = builtin::ALL.iter().any(|task| task.id == id && task.has("psm"));
    row.starts_with("base_") || is_psm && (row != "lag_jaw" || !id.contains("Reach"))
}

/// Whether the least and the largest of an error of arms are seen apart.
fn arm_error_shows(id: &str, row: &str, ends: [f64; 2]) -> bool {
    // A weight is that of a play.
    let play = match row {
        "coupling_weight" => Some("wrist_yaw"),
        row => row.strip_prefix("play_weight_"),
    };
    let play = play.map(|joint| format!("play_{joint}"));
    let [low, high] = ends.map(|number| {
        let mut rows = vec![(row, [number; 2])];
        rows.extend(play.as_ref().map(|play| (play.as_str(), [1e-3; 2])));
        let rows: Vec<_> = rows.iter().map(|(row, it)| (*row, &it[..])).collect();
        let options = Options::new().with("domain", table(&rows));
        shown(Registry::builtin().make(id, &options).unwrap(), 6)
    });
    low != high
}

/// The rows that say what tissue is like.
const TISSUE: [&str; 4] = ["friction", "modulus", "thickness", "strength"];

/// A row of tissue shows once jaws have closed on it, and episodes begin at rest.
fn check_tissue(id: &str, row: &str, ends: [f64; 2]) {
    if row == "strength" {
        return check_strength(id, ends);
    }
    let [low, high] = ends.map(|number| shown(fixed(id, row, number), 18));
    assert!(low != high, "{id}, {row}: is not to be seen");
    let mut env = fixed(id, row, ends[0]);
    env.reset(Some(3));
    assert!(env.world().at_rest(), "{id}, {row}: the sheet is not at rest");
}

/// Weak tissue is crushed by jaws that strong tissue bears.
fn check_strength(id: &str, ends: [f64; 2]) {
    let [weak, strong] = ends.map(|number| {
        let mut env = fixed(id, "strength", number);
        env.reset(Some(3));
        let steps = (0..18).map(|_| env.step(&Seen::of(&env).expert).unwrap().crushed);
        steps.fold(0.0, f32::max)
    });
    assert!(weak > 0.0 && strong == 0.0, "{id}: {weak} {strong}");
}

#[test]
fn every_range_of_a_domain_does_what_it_says() {
    for id in Registry::builtin().ids() {
        // Until the jaws have closed, where steps take long.
        let steps = if is_slow(id) { 15 } else { 50 };
        for RowSpec { name, min, max, .. } in domain_rows(id) {
            let what = format!("{id}, {name}");
            match name.as_str() {
                "mass" | "size" => {
                    let nominal = inertias(plain(id));
                    for number in [min, max] {
                        let found = inertias(fixed(id, &name, number));
                        assert!(!found.is_empty() && found.len() == nominal.len(), "{what}");
                        let size = if name == "size" { number } else { 1.0 };
                        let mass = if name == "mass" { number } else { size.powi(3) };
                        for (found, nominal) in found.iter().zip(&nominal) {
                            let ratio = found.mass / nominal.mass;
                            assert!((ratio / mass - 1.0).abs() < 1e-5, "{what}: {ratio}");
                            let ratio = found.moments.trace() / nominal.moments.trace();
                            let moments = mass * size * size;
                            assert!((ratio / moments - 1.0).abs() < 1e-4, "{what}: {ratio}");
                            let off = found.centre - nominal.centre * size;
                            assert!(off.norm() < 1e-7, "{what}: {off}");
                        }
                    }
                }
                "observation_noise" => {
                    assert_eq!(noise(id, fixed(id, &name, min)), min, "{what}");
                    let ratio = noise(id, fixed(id, &name, max)) / (max * max);
                    // Of 300 numbers and more.
                    assert!((ratio - 1.0).abs() < 0.35, "{what}: {ratio}");
                }
                "latency" => {
                    for number in [min, max] {
                        let steps = steps_until_commands_show(fixed(id, &name, number));
                        assert_eq!(f64::from(steps), number + 1.0, "{what}");
                    }
                }
                "latency_seconds" => {
                    let seconds = plain(id).spec().seconds_per_step;
                    for number in [min, max] {
                        let steps = steps_until_commands_show(fixed(id, &name, number));
                        assert_eq!(f64::from(steps), (number / seconds).floor() + 1.0, "{what}");
                    }
                }
                "action_noise" | "action_noise_angle" => {
                    let quiet = shown(plain(id), steps);
                    assert!(shown(fixed(id, &name, min), steps) == quiet, "{what}");
                    let noisy = shown(fixed(id, &name, max), steps);
                    assert!(noisy != quiet, "{what}: is not to be seen");
                    assert!(noisy == shown(fixed(id, &name, max), steps), "{what}");
                }
                "pad_stiffness" => {
                    let sags = [min, max].map(|stiffness| {
                        let mut env = fixed(id, &name, stiffness);
                        env.reset(Some(3));
                        let object = env.world().objects().next().unwrap();
                        let weight = env.world().inertia(object).mass * GRAVITY;
                        (Seen::of(&env).achieved[2], weight / stiffness)
                    });
                    let [(soft, deep), (stiff, flat)] = sags;
                    let off = f64::from(stiff - soft) - (deep - flat);
                    // Heights of 0.7 m are observed to 0.06 µm.
                    assert!(off.abs() < 0.2e-6 && deep > 1e-5, "{what}: {off}");
                }
                "pad_depth" => {
                    assert!(
                        shown(fixed(id, &name, min), steps) == shown(plain(id), steps),
                        "{what}"
                    );
                    let shallow = 1e-4;
                    let [deep, flat] =
                        [max, shallow].map(|depth| lowest_wrist(fixed(id, &name, depth)));
                    assert!(
                        (flat - deep - (max - shallow)).abs() < 0.1e-3,
                        "{what}: {flat} {deep}"
                    );
                }
                row if is_slow(id) && TISSUE.contains(&row) => check_tissue(id, row, [min, max]),
                "friction" => {
                    // It shows where something slips: what is heavy.
                    let heavy = |friction: f64| {
                        let domain =
                            table(&[("mass", &[5.0, 5.0]), (&name, &[friction, friction])]);
                        let options = Options::new().with("domain", domain);
                        let options = options.with_text("preset", "surrol");
                        let options = options.with_text("grasp", "interact");
                        shown(Registry::builtin().make(id, &options).unwrap(), steps)
                    };
                    assert!(heavy(min) != heavy(max), "{what}: is not to be seen");
                }
                "joint_offset" | "camera_pose_position" | "camera_pose_angle" => {
                    let [low, high] =
                        [min, max].map(|number| shown(fixed(id, &name, number), steps));
                    assert!(low != high, "{what}: is not to be seen");
                    assert_eq!(low, shown(fixed(id, &name, min), steps), "{what}");
                }
                row if is_arm_error(row) => {
                    let shows = arm_error_shows(id, row, [min, max]);
                    assert!(shows || !is_felt(id, row), "{what}: is not to be seen");
                }
                _ => panic!("{what}: what does it do?"),
            }
        }
    }
}

#[test]
fn a_misplaced_camera_is_where_its_error_says() {
    // What is achieved is the camera's position: 5 mm off along each of its axes.
    let (mut off, mut there) =
        (fixed("EcmReach-v0", "camera_pose_position", 0.005), plain("EcmReach-v0"));
    for seed in 0..10 {
        off.reset(Some(seed));
        there.reset(Some(seed));
        let (off, there) = (Seen::of(&off), Seen::of(&there));
        assert_eq!(off.desired, there.desired);
        let squares = off.achieved.iter().zip(&there.achieved).map(|(a, b)| (a - b) * (a - b));
        let distance = squares.sum::<f32>().sqrt();
        assert!((distance - 0.005 * 3f32.sqrt()).abs() < 1e-6, "{distance}");
    }
}

#[test]
fn a_factor_of_one_changes_no_bit() {
    for id in Registry::builtin().ids() {
        for row in domain_rows(id).iter().filter(|row| OBJECT.contains(&row.name.as_str())) {
            let same = shown(fixed(id, &row.name, 1.0), 50) == shown(plain(id), 50);
            assert!(same, "{id}, {}", row.name);
        }
    }
}

#[test]
fn a_varied_object_lies_at_rest_and_sleeps_until_it_is_touched() {
    for id in Registry::builtin().ids().filter(|id| *id != "NeedleRegrasp-v0") {
        for row in domain_rows(id).iter().filter(|row| OBJECT.contains(&row.name.as_str())) {
            for number in [row.min, 1.0, row.max] {
                let what = format!("{id}, {}: {number}", row.name);
                let mut env = fixed(id, &row.name, number);
                env.reset(Some(4));
                let poses = |env: &Env| -> Vec<_> {
                    env.world().objects().map(|object| env.world().pose(object)).collect()
                };
                let laid = poses(&env);
                assert!(env.world().at_rest() && !laid.is_empty(), "{what}");
                for _ in 0..5 {
                    env.step(&vec![0.0; env.spec().action_dim()]).unwrap();
                    assert!(env.world().at_rest() && poses(&env) == laid, "{what}: it wakes");
                }
                // Where it lies, it would lie.
                let mut world = env.world().clone();
                for object in env.world().objects() {
                    world.wake(object);
                }
                for _ in 0..SUBSTEPS_PER_SECOND as u32 {
                    world.advance();
                }
                assert!(world.at_rest() && world.deepest_overlap() < 0.02e-3, "{what}");
                for (object, laid) in env.world().objects().zip(&laid) {
                    let moved = world.pose(object).translation.vector - laid.translation.vector;
                    assert!(moved.norm() < 0.02e-3, "{what}: {moved}");
                }
            }
        }
    }
}

#[test]
fn episodes_differ_in_what_they_draw_and_in_nothing_else() {
    for id in Registry::builtin().ids() {
        let rows = ["mass", "camera_pose_position"];
        for row in domain_rows(id).iter().filter(|row| rows.contains(&row.name.as_str())) {
            let domain = table(&[(&row.name, &[row.min, row.max])]);
            let options = Options::new().with("domain", domain);
            let mut env = Registry::builtin().make(id, &options).unwrap();
            let mut plain = plain(id);
            let mut drawn = vec![];
            for seed in 0..5 {
                env.reset(Some(seed));
                plain.reset(Some(seed));
                assert_eq!(Seen::of(&env).desired, Seen::of(&plain).desired, "{id}");
                let masses = env.world().objects().map(|object| env.world().inertia(object).mass);
                let mut numbers: Vec<_> = masses.map(f64::to_bits).collect();
                // All objects of an episode are of one kind.
                numbers.dedup();
                assert!(numbers.len() <= 1, "{id}");
                // Where there is none, it is the camera that differs: by how much shows in what is seen.
                if numbers.is_empty() {
                    let [off, there] = [&env, &plain].map(Seen::of);
                    let seen = |seen: Seen| [seen.observation, seen.achieved].concat();
                    let pairs = seen(off).into_iter().zip(seen(there));
                    let off = pairs.map(|(off, there)| f64::from((off - there).abs())).sum::<f64>();
                    assert!(off > 0.0, "{id}: the camera is where it would be");
                    numbers.push(off.to_bits());
                }
                drawn.extend(numbers);
            }
            drawn.sort_unstable();
            drawn.dedup();
            assert_eq!(drawn.len(), 5, "{id}");
        }
    }
}

#[test]
fn ranges_that_may_not_be_are_refused_by_name_with_what_may() {
    let registry = Registry::builtin();
    for id in registry.ids() {
        let refuse = |row: &str, numbers: &[f64]| {
            let options = Options::new().with("domain", table(&[(row, numbers)]));
            let refusal = registry.make(id, &options).err().unwrap();
            assert_eq!(refusal.code, Code::InvalidOption, "{refusal}");
            refusal
        };
        for RowSpec { name, min, max, .. } in domain_rows(id) {
            let [low, high] = [min - 0.5, max + 0.5];
            let many = [min, max, max];
            let bad: [&[f64]; 5] = [&[low, max], &[min, high], &[min], &many, &[min, f64::NAN]];
            for numbers in bad {
                let refusal = refuse(&name, numbers);
                assert_eq!(refusal.field, format!("options.domain.{name}"));
                let allowed = format!("2 numbers in [{min}, {max}]");
                for part in [&format!("{numbers:?}"), &allowed] {
                    assert!(refusal.to_string().contains(part), "{part} in {refusal}");
                }
            }
            let refusal = refuse(&name, &[max, min]);
            assert_eq!(refusal.field, format!("options.domain.{name}"));
            let text = refusal.to_string();
            assert!(
                text.contains("low not above high") && text.contains(&format!("{max}")),
                "{text}"
            );
            for number in [min, max] {
                fixed(id, &name, number);
            }
        }
        // What only other tasks draw is no row of this one.
        let known = domain_rows(id);
        let others = [
            "friction",
            "mass",
            "size",
            "pad_depth",
            "camera_pose_position",
            "camera_pose_angle",
            "wind",
        ];
        for other in others.iter().filter(|other| known.iter().all(|row| row.name != **other)) {
            let refusal = refuse(other, &[1.0, 1.0]).to_string();
            assert!(refusal.contains(other) && refusal.contains("latency"), "{refusal}");
        }
    }
}
