//! Episodes that a reset arranges: what is put somewhere rests there, what cannot be is refused by name, and an
//! arranged episode comes again bit by bit.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use trocar_proto::{Code, Options, Placement, Rejection};
use trocar_server::recording::{self, Recorder, Replay};
use trocar_server::sim::frames::{self, Pose};
use trocar_server::{Env, Registry};

use crate::look as seen;

/// Tasks whose objects may be placed, and the names of these.
const GRASPING: [(&str, usize); 5] = [
    ("NeedleReach-v0", 1),
    ("NeedlePick-v0", 1),
    ("GauzeRetrieve-v0", 1),
    ("PegTransfer-v0", 4),
    ("BiPegTransfer-v0", 6),
];

/// Places of other episodes at which objects are put.
const PLACES: u64 = 20;

/// How far what is put where something rested may move, m and rad: it lay there already.
const MOVED: f64 = 0.1e-3;
const TURNED: f64 = 0.01;

fn make(task: &str, options: &Options) -> Env {
    Registry::builtin().make(task, options).expect("a registered task")
}

fn begun(task: &str, seed: u64) -> Env {
    let mut env = make(task, &Options::new());
    env.reset(Some(seed));
    env
}

fn numbers(pose: &Pose) -> Vec<f64> {
    let position: [f64; 3] = pose.translation.vector.into();
    [position, frames::euler_xyz(&pose.rotation)].concat()
}

/// All objects where those of another episode are.
fn as_in(other: &Env) -> Placement {
    let objects = other.objects().map(|(name, pose)| (name.to_string(), numbers(&pose))).collect();
    Placement { objects, ..Placement::default() }
}

fn object(name: &str, pose: &[f64]) -> Placement {
    Placement { objects: [(name.into(), pose.to_vec())].into(), ..Placement::default() }
}

fn goal(goal: &[f64]) -> Placement {
    Placement { goal: Some(goal.to_vec()), ..Placement::default() }
}

fn tip(tip: &[f64]) -> Placement {
    Placement { tip: Some(tip.to_vec()), ..Placement::default() }
}

/// Everything that could be otherwise: what is seen, where objects are, what the expert would do.
fn bits(env: &Env) -> Vec<u32> {
    let mut action = vec![0.0; env.spec().action_dim()];
    env.expert(&mut action);
    let seen = seen(env).concat().into_iter().chain(action).map(f32::to_bits);
    seen.chain(env.world().bits()).chain([env.steps()]).collect()
}

/// What refuses a placement; it must leave everything as it was.
fn refusal(env: &mut Env, placement: &Placement) -> Rejection {
    let before = bits(env);
    let refusal = env.arrange(placement).expect_err("it must be refused");
    assert_eq!(bits(env), before, "{refusal}");
    refusal
}

/// Lets the expert work; whether it succeeds.
fn succeeds(env: &mut Env) -> bool {
    let mut action = vec![0.0; env.spec().action_dim()];
    loop {
        env.expert(&mut action);
        let step = env.step(&action).expect("the expert's action is good");
        if step.truncated || step.terminated {
            return step.is_success;
        }
    }
}

#[test]
fn objects_rest_where_objects_of_other_episodes_rested() {
    for (task, count) in GRASPING {
        let mut failed = vec![];
        for seed in 0..PLACES {
            let (mut env, other) = (begun(task, seed), begun(task, 1000 + seed));
            let wanted: BTreeMap<_, _> = other.objects().collect();
            assert_eq!(wanted.len(), count, "{task}");
            env.arrange(&as_in(&other))
                .unwrap_or_else(|refusal| panic!("{task} {seed}: {refusal}"));
            assert!(env.world().at_rest());
            for (name, pose) in env.objects() {
                let off = wanted[name].inv_mul(&pose);
                let (moved, turned) = (off.translation.vector.norm(), off.rotation.angle());
                assert!(moved < MOVED && turned < TURNED, "{task} {seed} {name}: {moved} {turned}");
            }
            if task == "NeedlePick-v0" || task == "GauzeRetrieve-v0" {
                let [_, achieved, desired] = seen(&env);
                let [_, other_achieved, other_desired] = seen(&other);
                let off =
                    Vector3::from_fn(|axis, _| f64::from(achieved[axis] - other_achieved[axis]));
                assert!(off.norm() < MOVED, "{task} {seed}: {off}");
                assert_ne!(desired, other_desired);
                if !succeeds(&mut env) {
                    failed.push(seed);
                }
            }
        }
        assert!(failed.is_empty(), "{task}: the expert fails on {failed:?}");
    }
}

#[test]
fn the_goal_and_the_tip_are_where_they_are_asked_for() {
    let wanted = Placement { tip: Some(vec![0.56, 0.01, 0.72]), ..goal(&[0.55, -0.02, 0.73]) };
    for task in ["NeedleReach-v0", "NeedlePick-v0", "GauzeRetrieve-v0"] {
        let mut env = begun(task, 3);
        env.arrange(&wanted).unwrap();
        let [observation, achieved, desired] = seen(&env);
        assert_eq!(desired, [0.55, -0.02, 0.73], "{task}");
        // The wrist is 10.2 mm above the tip of jaws that point down.
        for (seen, wanted) in observation.iter().zip([0.56, 0.01, 0.7302]) {
            assert!((seen - wanted).abs() < 1e-6, "{task}: {observation:?}");
        }
        if task == "NeedleReach-v0" {
            assert!(achieved.iter().zip([0.56, 0.01, 0.72]).all(|(a, b)| (a - b).abs() < 1e-6));
        }
        assert!(succeeds(&mut env), "{task}");
    }
}

#[test]
fn the_tip_turns_as_observations_show_it() {
    let mut env = make("NeedlePick-v0", &Options::new().with_text("action", "cartesian"));
    env.reset(Some(1));
    let turned = [0.55, 0.0, 0.72, -1.3, 0.2, 1.2];
    env.arrange(&tip(&turned)).unwrap();
    let [observation, ..] = seen(&env);
    assert!((3..6).all(|index| (f64::from(observation[index]) - turned[index]).abs() < 1e-6));
}

#[test]
fn goals_are_where_each_task_allows_them() {
    let mut env = begun("PegTransfer-v0", 2);
    let refused = refusal(&mut env, &goal(&[0.55, 0.0, 0.7081]));
    assert_eq!(refused.field, "options.goal");
    assert!(refused.allowed.contains("[0.5200, 0.0430, 0.7081]"), "{refused}");
    env.arrange(&goal(&[0.52, 0.043, 0.7081])).unwrap();
    assert_eq!(seen(&env)[2], [0.52, 0.043, 0.7081]);
    assert!(succeeds(&mut env));

    let mut env = begun("EcmReach-v0", 2);
    assert!(refusal(&mut env, &goal(&[3.0, 0.0, 0.0])).allowed.contains("does not reach"));
    env.arrange(&goal(&[0.5, 0.02, 0.65])).unwrap();
    assert!(succeeds(&mut env));

    let mut env = begun("NeedleRegrasp-v0", 2);
    let desired = seen(&begun("NeedleRegrasp-v0", 3))[2].clone();
    assert!(refusal(&mut env, &goal(&[0.58, 0.03, 0.73])).allowed.contains("PSM2"));
    env.arrange(&goal(&desired.iter().map(|number| f64::from(*number)).collect::<Vec<_>>()))
        .unwrap();
    assert_eq!(seen(&env)[2], desired);

    for task in ["MisOrient-v0", "StaticTrack-v0", "ActiveTrack-v0"] {
        assert_eq!(refusal(&mut begun(task, 0), &goal(&[0.5; 3])).field, "options.goal", "{task}");
    }
}

#[test]
fn a_goal_that_is_not_given_is_above_the_needle_where_that_is_the_task() {
    let (mut env, other) = (begun("NeedleReach-v0", 1), begun("NeedleReach-v0", 2));
    env.arrange(&as_in(&other)).unwrap();
    let ([_, _, desired], [_, _, expected]) = (seen(&env), seen(&other));
    assert!(desired.iter().zip(&expected).all(|(one, other)| (one - other).abs() < 0.1e-3));
}

#[test]
fn what_is_not_allowed_is_refused_by_name_and_changes_nothing() {
    let mut env = begun("NeedlePick-v0", 5);
    let (_, rests) = env.objects().next().unwrap();
    let at = |x: f64, y: f64, z: f64| {
        let mut pose = rests;
        pose.translation.vector += Vector3::new(x, y, z);
        numbers(&pose)
    };
    let middle = [0.55, 0.0, rests.translation.z];
    // In the tray's rim: the nearest wall along x.
    let in_wall = (0..400).map(|index| {
        let pose = [0.55 + 0.5e-3 * f64::from(index), 0.0, middle[2] + 3e-3, 0.0, 0.0, 0.0];
        refusal(&mut env, &object("needle", &pose))
    });
    let in_wall: Vec<_> =
        in_wall.filter(|refused| refused.allowed.contains("in another body")).collect();
    assert!(in_wall.iter().all(|refused| refused.field == "options.objects.needle"));
    assert!(in_wall.len() > 10, "{} places are in the wall", in_wall.len());

    let cases = [
        (object("needle", &at(0.0, 0.0, -2e-3)), "options.objects.needle", "in another body"),
        (object("needle", &at(0.0, 0.0, 0.02)), "options.objects.needle", "does not rest there"),
        (
            object("needle", &[0.55, 0.0, 0.702, 1.5, 0.0, 0.0]),
            "options.objects.needle",
            "does not rest there",
        ),
        (object("needle", &[0.45, 0.0, 0.68]), "options.objects.needle", "out of reach"),
        (object("needle", &[0.55, 0.0]), "options.objects.needle", "expected 3 numbers"),
        (object("needle", &[f64::NAN, 0.0, 0.68]), "options.objects.needle", "finite"),
        (object("gauze", &middle), "options.objects", r#"it has ["needle"]"#),
        (goal(&[0.7, 0.0, 0.72]), "options.goal", "allowed is x in"),
        (goal(&[0.55, 0.0, 0.66]), "options.goal", "allowed is x in"),
        (goal(&[0.55, 0.0]), "options.goal", "expected 3 numbers"),
        (tip(&[0.65, 0.0, 0.72]), "options.tip", "out of reach"),
        (tip(&[0.55, 0.0, 0.675]), "options.tip", "what lies under the jaws"),
        (tip(&[0.55, 0.0, 0.72, 1.6, 0.0, 0.0]), "options.tip", "out of reach"),
        (tip(&[0.55; 4]), "options.tip", "expected 3 numbers"),
        // All or nothing: a good object beside a bad goal.
        (
            Placement { goal: Some(vec![9.0; 3]), ..object("needle", &middle) },
            "options.goal",
            "allowed",
        ),
    ];
    for (placement, field, why) in cases {
        let refused = refusal(&mut env, &placement);
        assert_eq!(
            (refused.code, refused.field.as_str()),
            (Code::InvalidOption, field),
            "{refused}"
        );
        assert!(refused.allowed.contains(why), "{refused}");
    }

    // Jaws in the wire.
    let wire =
        Vector3::from_row_slice(&seen(&env)[1].iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
    let refused = refusal(&mut env, &tip(wire.as_slice()));
    assert!(refused.allowed.contains("in an object"), "{refused}");
}

#[test]
fn objects_do_not_push_others_nor_lie_in_them() {
    let mut env = begun("PegTransfer-v0", 5);
    let objects: Vec<_> = env.objects().collect();
    let refused = refusal(&mut env, &object("block", &numbers(&objects[1].1)));
    assert!(refused.allowed.contains("in another body"), "{refused}");
    // Both at once change places.
    let swapped = [("block", objects[1].1), ("other block 1", objects[0].1)];
    let swapped = swapped.map(|(name, pose)| (name.to_string(), numbers(&pose))).into();
    env.arrange(&Placement { objects: swapped, ..Placement::default() }).unwrap();
    assert!(succeeds(&mut env));
}

#[test]
fn where_the_jaws_are_at_the_object_only_a_goal_may_be_given() {
    let mut env = make("NeedlePick-v0", &Options::new().with_text("start", "lift"));
    env.reset(Some(0));
    let refused = refusal(&mut env, &object("needle", &[0.55, 0.0, 0.68]));
    assert_eq!(refused.field, "options.objects");
    assert!(refused.allowed.contains("start"), "{refused}");
    assert_eq!(refusal(&mut env, &tip(&[0.55, 0.0, 0.72])).field, "options.tip");
    env.arrange(&goal(&[0.55, 0.0, 0.73])).unwrap();
    assert!(succeeds(&mut env));

    let mut env = begun("NeedleRegrasp-v0", 0);
    let refused = refusal(&mut env, &object("needle", &[0.55, 0.0, 0.68]));
    assert_eq!(refused.field, "options.objects");
    let mut env = begun("EcmReach-v0", 0);
    assert_eq!(refusal(&mut env, &tip(&[0.5, 0.0, 0.7])).field, "options.tip");
    assert!(refusal(&mut env, &object("cube", &[0.5, 0.0, 0.7])).allowed.contains("it has []"));
}

#[test]
fn an_episode_is_arranged_once_before_its_first_step() {
    let mut env = make("EcmReach-v0", &Options::new());
    let placement = goal(&[0.5, 0.02, 0.65]);
    assert_eq!(env.arrange(&placement).unwrap_err().code, Code::ResetNeeded);
    env.reset(Some(1));
    env.arrange(&Placement::default()).unwrap();
    env.arrange(&placement).unwrap();
    assert_eq!(refusal(&mut env, &placement).code, Code::ResetNeeded);
    env.reset(None);
    env.step(&[0.0; 3]).unwrap();
    assert_eq!(refusal(&mut env, &placement).code, Code::ResetNeeded);
}

/// An arranged episode of each grasping task after `steps` of the expert's.
fn arranged(task: &str, steps: usize, recorder: Option<&mut (Recorder, Vec<u8>)>) -> Env {
    let (mut env, other) = (begun(task, 7), begun(task, 8));
    let place = as_in(&other);
    let tip = other.spec().id.starts_with("NeedlePick").then(|| vec![0.55, 0.02, 0.73]);
    env.arrange(&Placement { tip, ..place }).expect("objects rested there");
    let mut action = vec![0.0; env.spec().action_dim()];
    let mut bytes = vec![];
    let mut none = Recorder::default();
    let (recorder, bytes) = recorder.map_or((&mut none, &mut bytes), |(one, bytes)| (one, bytes));
    for _ in 0..steps {
        env.expert(&mut action);
        env.step(&action).expect("the expert's action is good");
        bytes.extend(recorder.after_step(&env).into_iter().flatten());
    }
    bytes.extend(recorder.before_leaving(&env).into_iter().flatten());
    env
}

#[test]
fn snapshots_exports_and_recordings_of_arranged_episodes_come_again_bit_by_bit() {
    for (task, _) in GRASPING {
        let env = arranged(task, 9, None);
        let imported = make(task, &Options::new()).import(&env.export().unwrap()).unwrap();
        let (mut one, mut other) = (env.clone(), imported);
        assert_eq!(bits(&one), bits(&other), "{task}");
        for env in [&mut one, &mut other] {
            succeeds(env);
        }
        assert_eq!(bits(&one), bits(&other), "{task}");

        let mut recorder = (Recorder::new(10), vec![]);
        let last = arranged(task, 27, Some(&mut recorder));
        // The same seed again, for as long, as it is without being arranged.
        let mut plain = begun(task, 7);
        for _ in 0..27 {
            plain.step(&vec![0.0; plain.spec().action_dim()]).unwrap();
        }
        recorder.1.extend(recorder.0.before_leaving(&plain).unwrap());
        let courses = recording::read(&recorder.1).unwrap();
        assert_eq!(courses.iter().map(recording::Course::marks).collect::<Vec<_>>(), [3, 1]);
        for (course, end) in courses.into_iter().zip(vec![last, plain]) {
            let mut replay = Replay::new(&Registry::builtin(), course).unwrap();
            while let Some(step) = replay.next() {
                step.unwrap();
            }
            assert_eq!(bits(replay.env()), bits(&end), "{task}");
        }
    }
}

#[test]
fn a_snapshot_whose_placement_cannot_be_is_refused_by_name() {
    use trocar_proto::snapshot::Recipe;
    let env = arranged("NeedlePick-v0", 3, None);
    let mut recipe = Recipe::from_bytes(&env.export().unwrap()).unwrap();
    recipe.placement.tip = Some(vec![0.65, 0.0, 0.72]);
    let refused = env.import(&recipe.to_bytes().unwrap()).err().unwrap();
    assert_eq!((refused.code, refused.field.as_str()), (Code::InvalidSnapshot, "options.tip"));
    recipe.placement = Placement::default();
    let refused = env.import(&recipe.to_bytes().unwrap()).err().unwrap();
    assert_eq!(refused.field, "snapshot.fingerprint");
}

#[test]
fn positions_are_metres_under_the_preset_of_the_original_too() {
    let mut env = make("NeedlePick-v0", &Options::new().with_text("preset", "surrol"));
    env.reset(Some(1));
    env.arrange(&goal(&[0.55, -0.02, 0.73])).unwrap();
    assert_eq!(seen(&env)[2], [2.75, -0.1, 3.65]);
}

#[test]
fn goals_with_several_parts_can_be_given_back_and_their_fixed_numbers_are_checked() {
    for task in ["TissueRetract-v0", "TissuePoint-v0", "GauzePlace-v0", "MisOrient-v0"] {
        let own: Vec<f64> = seen(&begun(task, 1))[2].iter().map(|part| f64::from(*part)).collect();
        for seed in [1, 2] {
            let mut env = begun(task, seed);
            env.arrange(&goal(&own)).unwrap();
            assert_eq!(seen(&env)[2], own.iter().map(|part| *part as f32).collect::<Vec<_>>());
        }
        let mut other = own.clone();
        *other.last_mut().unwrap() += 0.5;
        let refused = refusal(&mut begun(task, 1), &goal(&other));
        assert!(refused.to_string().contains("fixed by the task: allowed is"), "{task}: {refused}");
    }
}
