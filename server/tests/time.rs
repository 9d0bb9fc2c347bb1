//! Time belongs to the environment: rates, late and disturbed commands, arms that are driven from outside, pictures
//! between steps.

use std::collections::BTreeMap;

use nalgebra::UnitQuaternion;
use trocar_proto::{OptionValue, Options, Stage, builtin};
use trocar_server::Registry;
use trocar_server::env::Env;
use trocar_server::error::StepError;
use trocar_server::render::Scene;
use trocar_server::sim::frames::Pose;
use trocar_server::sim::instrument::Posture;
use trocar_server::sim::motion::Profile;
use trocar_server::sim::random::Rng;

fn make(id: &str, options: &Options) -> Env {
    Registry::builtin().make(id, options).unwrap()
}

fn at_rate(hertz: f64) -> Options {
    Options::new().with("rate", OptionValue::Number(hertz))
}

fn with_domain(options: &Options, rows: &[(&str, f64)]) -> Options {
    let row = |(name, value): &(&str, f64)| ((*name).to_string(), vec![*value; 2]);
    let rows: BTreeMap<_, _> = rows.iter().map(row).collect();
    options.clone().with("domain", OptionValue::Table(rows))
}

/// What an environment shows, and its world, as bits.
fn bits(env: &Env) -> Vec<u32> {
    let spec = env.spec();
    let mut observation = vec![0.0; spec.observation_dim()];
    let mut goals = [vec![0.0; spec.goal_dim()], vec![0.0; spec.goal_dim()]];
    let [achieved, desired] = &mut goals;
    env.observe(&mut observation, achieved, desired);
    let shown = observation.iter().chain(goals.iter().flatten()).map(|number| number.to_bits());
    shown.chain(env.world().bits()).collect()
}

fn expert(env: &Env) -> Vec<f32> {
    let mut action = vec![0.0; env.spec().action_dim()];
    env.expert(&mut action);
    action
}

fn random(env: &Env, rng: &mut Rng) -> Vec<f32> {
    (0..env.spec().action_dim()).map(|_| rng.uniform(-1.0, 1.0) as f32).collect()
}

/// The expert's action, but at random now and then.
fn mixed(env: &Env, rng: &mut Rng) -> Vec<f32> {
    let expert = expert(env);
    if rng.unit() < 0.2 { random(env, rng) } else { expert }
}

/// The true wrist of the first arm, by its link in the picture.
fn wrist(scene: &Scene) -> Pose {
    let body = scene.body("psm1 wrist_yaw_link").or_else(|| scene.body("psm1 jaw_1_link")).unwrap();
    scene.instances().iter().find(|part| part.body == body).unwrap().world_from_mesh
}

#[test]
fn a_world_driven_with_the_set_points_of_a_step_has_the_bits_of_that_step() {
    for id in Registry::builtin().tagged("psm") {
        let mut touched = 0;
        let is_slow = Registry::builtin().tagged("tissue").any(|tissue| tissue == id);
        for seed in 0..if is_slow { 1 } else { 4 } {
            let (mut stepped, mut rng) = (make(id, &Options::new()), Rng::new(seed, 9));
            stepped.reset(Some(seed));
            let mut driven = stepped.clone();
            while stepped.steps() + 1 < stepped.spec().max_steps {
                let action = mixed(&stepped, &mut rng);
                let step = stepped.step(&action).unwrap();
                let came_to = stepped.clone().drive().unwrap().postures();
                let mut drive = driven.drive().unwrap();
                let profiles = drive.command(&action).unwrap();
                let (mut before, mut path) = (drive.postures(), 0.0);
                for now in 1..=48 {
                    // An arm with nothing in its way is put to the end: interpolation there may round.
                    let set_point = |(profile, end): (&Profile, &Posture)| {
                        let is_put = now == 48 && profile.end() == *end;
                        if is_put { *end } else { profile.at(now, now, 48) }
                    };
                    let set_points: Vec<_> = profiles.iter().zip(&came_to).map(set_point).collect();
                    drive.advance(&set_points);
                    let after = drive.postures();
                    let tip = |posture: &Posture| posture.world_from_tip().translation.vector;
                    let ways = before.iter().zip(&after);
                    path += ways.map(|(one, next)| (tip(next) - tip(one)).norm()).sum::<f64>();
                    before = after;
                }
                drive.sense();
                // Where nothing is in its way any more, an arm may do the rest of its turn in one substep.
                let told = f64::from(step.tip_path);
                assert!((told - path).abs() < 1e-3 * path + 1e-9, "{id} {seed}: {told}, {path}");
                assert_eq!(bits(&driven), bits(&stepped), "{id} {seed}, step {}", stepped.steps());
                touched += usize::from(!stepped.world().at_rest());
            }
        }
        assert!(
            touched > 20 || !Registry::builtin().tagged("grasp").any(|each| each == id),
            "{id}: nothing was touched"
        );
    }
}

#[test]
fn set_points_may_change_at_any_substep() {
    let mut env = make("NeedlePick-v0", &Options::new());
    env.reset(Some(1));
    let mut drive = env.drive().unwrap();
    let profiles = drive.command(&[1.0, 0.0, 0.0, 0.0, 1.0]).unwrap();
    // Forward for a quarter of the step, then back to where it began.
    for now in (1..=12).chain((0..12).rev()) {
        drive.advance(&[profiles[0].at(now, now, 48)]);
    }
    let begun = profiles[0].at(0, 0, 48);
    drive.sense();
    let there = wrist(&drive.env().scene());
    env.reset(Some(1));
    let here = wrist(&env.scene());
    assert!((there.translation.vector - here.translation.vector).norm() < 1e-9, "{begun:?}");
    // A stream has no end: it is forgotten behind the arm.
    let mut drive = env.drive().unwrap();
    for turn in 0..1000 {
        drive.advance(&[profiles[0].at(turn % 2, turn % 2, 48)]);
    }
    assert!(env.export().is_err(), "no actions lead to where a driven arm is");
    env.reset(None);
    assert!(env.export().is_ok());
    assert!(make("NeedlePick-v0", &Options::new()).drive().is_err(), "it was never reset");
}

#[test]
fn the_same_movement_at_twice_the_rate_ends_at_the_same_place() {
    for id in ["NeedleReach-v0", "NeedlePick-v0", "GauzeRetrieve-v0", "PegTransfer-v0"] {
        for seed in 0..10 {
            for mode in ["paper", "cartesian", "joint"] {
                let (slow, fast) = (Options::new().with_text("action", mode), 10.0);
                let mut slow = make(id, &slow);
                let mut fast = make(id, &at_rate(fast).with_text("action", mode));
                assert_eq!(fast.spec().max_steps, 2 * slow.spec().max_steps);
                slow.reset(Some(seed));
                fast.reset(Some(seed));
                let action = expert(&slow); // over the object, where nothing is in the way
                slow.step(&action).unwrap();
                fast.step(&action).unwrap();
                fast.step(&action).unwrap();
                let mut still = vec![0.0; action.len()];
                *still.last_mut().unwrap() = *action.last().unwrap();
                for _ in 0..8 {
                    fast.step(&still).unwrap();
                }
                let off = wrist(&slow.scene()).inv_mul(&wrist(&fast.scene()));
                assert!(off.translation.vector.norm() < 0.1e-3, "{id} {seed} {mode}: {off}");
                let turned = UnitQuaternion::angle(&off.rotation).to_degrees();
                assert!(turned < 0.1, "{id} {seed} {mode}: {turned}");
            }
        }
    }
}

#[test]
fn the_path_of_a_tip_is_as_long_as_is_commanded_at_every_rate_and_however_late() {
    let joint = |options: Options| options.with_text("action", "joint");
    for (id, options, action) in [
        ("NeedleReach-v0", Options::new(), vec![0.6, -0.8, 0.0, 0.0, 0.0]),
        ("NeedlePick-v0", Options::new(), vec![0.6, -0.8, 0.0, 1.0, 1.0]),
        ("EcmReach-v0", joint(Options::new()), vec![0.0, 0.0, 1.0, 1.0]),
    ] {
        let nominal = make(id, &options).spec().seconds_per_step;
        for hertz in [None, Some(20.0), Some(60.0)] {
            for late in [0.0, 0.05, nominal, 0.217] {
                let options = with_domain(&options, &[("latency_seconds", late)]);
                let options = match hertz {
                    Some(hertz) => options.with("rate", OptionValue::Number(hertz)),
                    None => options,
                };
                let mut env = make(id, &options);
                env.reset(Some(3));
                // As many of them as move by 10 mm, and then none until all have arrived.
                let seconds = env.spec().seconds_per_step;
                let moves = (nominal / seconds).round() as usize;
                let rest = (late / seconds).ceil() as usize + 3;
                let still = vec![0.0; action.len()];
                let mut path = 0.0;
                for action in [&action; 1].repeat(moves).into_iter().chain([&still; 1].repeat(rest))
                {
                    let step = env.step(action).unwrap();
                    path += f64::from(step.tip_path);
                    assert_eq!(step.peak_force.to_bits(), 0, "nothing is touched");
                }
                assert!((path - 0.01).abs() < 1e-6, "{id}, {hertz:?}, {late} s late: {path}");
            }
        }
    }
}

#[test]
fn the_peak_force_tells_when_jaws_touch_something_and_how_hard_they_hold_it() {
    for (id, grasp) in [
        ("NeedlePick-v0", "interact"),
        ("NeedlePick-v0", "weld"),
        ("NeedlePick-v0", "approx"),
        ("GauzeRetrieve-v0", "interact"),
    ] {
        let mut env = make(id, &Options::new().with_text("grasp", grasp));
        env.reset(Some(2));
        let mut forces = vec![];
        while !env.needs_reset() {
            let stage = env.stage();
            let action = expert(&env);
            forces.push((stage, env.step(&action).unwrap().peak_force));
        }
        let of = |stage: Stage| forces.iter().filter(move |(each, _)| *each == stage);
        assert!(of(Stage::Approach).take(3).all(|(_, force)| *force == 0.0), "{id}: {forces:?}");
        // Fingers pass through what a tie holds as soon as they are near.
        let (_, last) = forces.last().unwrap();
        let held = if grasp == "approx" { 0.0..=0.0 } else { 0.85..=1.3 };
        assert!(held.contains(last), "{id}, {grasp}: {forces:?}");
        assert!(of(Stage::Carry).count() > 3 && of(Stage::Carry).all(|(_, force)| *force < 3.0));
    }
}

#[test]
fn an_arm_does_not_stop_between_steps_at_a_high_rate() {
    // At the paper's rate an arm rests after each step; at another one it goes on evenly.
    for (hertz, rests) in [(5.0, true), (20.0, false)] {
        let mut env = make("NeedleReach-v0", &at_rate(hertz));
        env.reset(Some(0));
        let mut places = vec![wrist(&env.scene()).translation.vector];
        let parts = (240.0 / hertz) as u32;
        for _ in 0..(hertz * 0.8) as usize {
            env.step_in_parts(&[0.3, -0.3, 0.0, 0.0, 0.0], parts, &mut |scene| {
                places.push(wrist(&scene).translation.vector);
            })
            .unwrap();
            places.push(wrist(&env.scene()).translation.vector);
        }
        let speeds: Vec<_> = places.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
        let middle = &speeds[60..speeds.len() - 4];
        let slowest = middle.iter().copied().fold(f64::INFINITY, f64::min);
        let fastest = middle.iter().copied().fold(0.0, f64::max);
        assert_eq!(
            slowest < 0.1 * fastest,
            rests,
            "{hertz} Hz: {slowest} to {fastest} m a substep"
        );
    }
}

#[test]
fn steps_of_every_rate_take_as_long_as_they_say() {
    for id in crate::suite::tasks() {
        let spec = Registry::builtin().spec(id, &Options::new()).unwrap();
        let whole = f64::from(spec.max_steps) * spec.seconds_per_step;
        for hertz in [5.0, 10.0, 20.0, 30.0, 40.0, 60.0] {
            let made = Registry::builtin().make(id, &at_rate(hertz));
            if id.contains("Track") && hertz < 10.0 {
                assert_eq!(made.err().unwrap().field, "options.rate");
                continue;
            }
            let mut env = made.unwrap();
            assert_eq!(env.spec().seconds_per_step, 1.0 / hertz);
            assert!((f64::from(env.spec().max_steps) / hertz - whole).abs() < 1e-9);
            env.reset(Some(1));
            let mut rng = Rng::new(1, 0);
            for _ in 0..20 {
                let action = mixed(&env, &mut rng);
                env.step(&action).unwrap();
                if env.needs_reset() {
                    env.reset(None);
                }
            }
        }
        let refused = Registry::builtin().make(id, &at_rate(25.0)).err().unwrap();
        assert_eq!(refused.field, "options.rate");
        assert!(refused.to_string().contains("60"), "{refused}");
    }
}

#[test]
fn a_command_that_is_late_acts_as_much_later_to_the_substep() {
    // When the wrist first moves, in substeps, under an action of every step.
    let first_move = |hertz: f64, late: f64| {
        let mut env =
            make("NeedleReach-v0", &with_domain(&at_rate(hertz), &[("latency_seconds", late)]));
        env.reset(Some(0));
        let start = wrist(&env.scene()).translation.vector;
        let (parts, mut substep, mut moved) = ((240.0 / hertz) as u32, 0, None);
        while moved.is_none() {
            let mut look = |scene: &Scene| {
                substep += 1;
                if (wrist(scene).translation.vector - start).norm() > 1e-9 {
                    moved.get_or_insert(substep);
                }
            };
            let mut see = |scene: Scene| look(&scene);
            env.step_in_parts(&[1.0, 0.0, 0.0, 0.0, 0.0], parts, &mut see).unwrap();
            look(&env.scene());
        }
        moved.unwrap()
    };
    for hertz in [5.0, 20.0] {
        let at_once = first_move(hertz, 0.0);
        assert!(at_once <= 2, "{at_once}");
        for late in [1, 14, 48, 60] {
            assert_eq!(first_move(hertz, f64::from(late) / 240.0), at_once + late, "{hertz} Hz");
        }
    }
}

#[test]
fn a_whole_step_of_latency_in_seconds_is_one_in_steps() {
    let options = |row: &str, late: f64| with_domain(&Options::new(), &[(row, late)]);
    for id in ["NeedlePick-v0", "BiPegTransfer-v0", "EcmReach-v0", "ActiveTrack-v0"] {
        let seconds = Registry::builtin().spec(id, &Options::new()).unwrap().seconds_per_step;
        let mut by_steps = make(id, &options("latency", 2.0));
        let mut by_seconds = make(id, &options("latency_seconds", 2.0 * seconds));
        by_steps.reset(Some(4));
        by_seconds.reset(Some(4));
        let mut rng = Rng::new(4, 0);
        for _ in 0..30 {
            let action = mixed(&by_steps, &mut rng);
            by_steps.step(&action).unwrap();
            by_seconds.step(&action).unwrap();
            assert_eq!(bits(&by_steps), bits(&by_seconds), "{id}");
        }
    }
}

#[test]
fn actuators_add_noise_of_the_size_that_is_asked_for_and_the_same_again() {
    for id in ["NeedleReach-v0", "EcmReach-v0"] {
        let rows = [("action_noise", 0.5e-3), ("action_noise_angle", 0.01)];
        let (still, count) = (vec![0.0; make(id, &Options::new()).spec().action_dim()], 40);
        let walk = |rows: &[(&str, f64)]| {
            let mut env = make(id, &with_domain(&Options::new(), rows));
            env.reset(Some(2));
            let mut squares = 0.0;
            let seen = |env: &Env| {
                let mut observation = vec![0.0; env.spec().observation_dim()];
                let [mut a, mut b] = [[0.0; 3]; 2];
                env.observe(&mut observation, &mut a, &mut b);
                observation
            };
            let mut before = seen(&env);
            for _ in 0..count {
                env.step(&still).unwrap();
                let now = seen(&env);
                squares += f64::from((now[1] - before[1]).powi(2));
                before = now;
            }
            (f64::sqrt(squares / f64::from(count)), bits(&env))
        };
        let (sigma, noisy) = walk(&rows);
        assert!(sigma > 0.3e-3, "{id}: {sigma} m a step");
        assert!(id != "NeedleReach-v0" || sigma < 0.7e-3, "{id}: {sigma} m a step");
        assert_eq!(walk(&rows).1, noisy);
        let (sigma, quiet) = walk(&[]);
        assert!(sigma < 1e-6 && quiet != noisy, "{id}: {sigma}");
    }
}

#[test]
fn looking_between_steps_changes_no_bits_and_shows_what_moves() {
    for id in crate::suite::tasks() {
        let mut looked = make(id, &Options::new());
        looked.reset(Some(3));
        let mut stepped = looked.clone();
        for _ in 0..20 {
            let action = expert(&stepped);
            let mut scenes = vec![];
            let seen = looked.step_in_parts(&action, 5, &mut |scene| scenes.push(scene)).unwrap();
            assert_eq!(seen, stepped.step(&action).unwrap());
            assert_eq!(bits(&looked), bits(&stepped), "{id}");
            assert_eq!(scenes.len(), 4);
            if seen.terminated || seen.truncated {
                break;
            }
        }
    }
    // The target of ActiveTrack goes on between steps.
    let mut env = make("ActiveTrack-v0", &Options::new());
    env.reset(Some(3));
    let target = |scene: &Scene| {
        let body = scene.body("target").unwrap();
        let part = scene.instances().iter().find(|part| part.body == body).unwrap();
        part.world_from_mesh.translation.vector
    };
    let mut places = vec![target(&env.scene())];
    env.step_in_parts(&[0.0; 3], 4, &mut |scene| places.push(target(&scene))).unwrap();
    places.push(target(&env.scene()));
    for pair in places.windows(2) {
        let part = (pair[1] - pair[0]).norm() / (places[4] - places[0]).norm();
        assert!((part - 0.25).abs() < 0.02, "{places:?}");
    }
}

#[test]
fn success_ends_an_episode_where_that_is_asked_for() {
    for id in ["NeedleReach-v0", "NeedlePick-v0", "EcmReach-v0"] {
        let mut env = make(id, &Options::new().with_text("terminate", "success"));
        env.reset(Some(1));
        let last = loop {
            let action = expert(&env);
            let step = env.step(&action).unwrap();
            assert_eq!(step.terminated, step.is_success, "{id}");
            if env.needs_reset() {
                break step;
            }
        };
        assert!(last.terminated && !last.truncated && env.steps() < env.spec().max_steps, "{id}");
        assert_eq!(env.step(&expert(&env)), Err(StepError::ResetNeeded));
    }
    let refused = Options::new().with_text("terminate", "success");
    let refused = Registry::builtin().make("ActiveTrack-v0", &refused).err().unwrap();
    assert_eq!(refused.field, "options.terminate");
}

#[test]
fn what_arms_measure_of_themselves_tells_nothing_of_objects() {
    let words = |words: &[&str]| {
        let words = words.iter().map(ToString::to_string).collect();
        Options::new().with("observation", OptionValue::Texts(words))
    };
    for task in builtin::ALL {
        let id = task.id;
        let [state, joints, all] = [&["state"][..], &["joints"], &["proprioception"]].map(words);
        let dim = |options: &Options| make(id, options).spec().observation_dim();
        let arms = if task.has("bimanual") { 2 } else { 1 };
        let joint = if task.has("psm") { 7 } else { 4 };
        assert_eq!((dim(&joints), dim(&all)), (arms * joint, arms * (joint + 6)), "{id}");
        let both = words(&["state", "proprioception"]);
        assert_eq!(dim(&both), dim(&state) + dim(&all), "{id}");

        // Another episode's objects lie elsewhere: the arms, which start where they always do, cannot tell.
        let seen = |options: &Options, seed: u64| {
            let mut env = make(id, options);
            env.reset(Some(seed));
            let mut numbers = vec![0.0; env.spec().observation_dim()];
            let goal = env.spec().goal_dim();
            env.observe(&mut numbers, &mut vec![0.0; goal], &mut vec![0.0; goal]);
            for (number, element) in numbers.iter().zip(&env.spec().observation) {
                assert!(
                    (element.min..=element.max).contains(number),
                    "{id}: {number} of {element:?}"
                );
            }
            numbers
        };
        let (one, two) = (seen(&all, 1), seen(&all, 2));
        // But for those whose arms start anywhere, or with a needle in their jaws.
        let starts_apart = ["MisOrient-v0", "NeedleRegrasp-v0"].contains(&id);
        assert_eq!(one == two, !starts_apart, "{id}");
        // Beside the state, they stand behind it.
        let (alone, beside) = (seen(&all, 1), seen(&both, 1));
        assert_eq!(beside[beside.len() - alone.len()..], alone, "{id}");
        assert_eq!(beside[..beside.len() - alone.len()], seen(&state, 1), "{id}");
    }
}

#[test]
fn the_option_episode_seconds_sets_the_step_of_truncation() {
    for (id, seconds, hertz, steps) in [
        ("NeedleReach-v0", 0.6, 5.0, 3),
        ("NeedleReach-v0", 20.0, 10.0, 200),
        ("EcmReach-v0", 0.4, 10.0, 4),
    ] {
        let options = at_rate(hertz).with("episode_seconds", OptionValue::Number(seconds));
        let mut env = make(id, &options);
        assert_eq!(env.spec().max_steps, steps);
        env.reset(Some(1));
        let action = vec![0.0; env.spec().action_dim()];
        for step in 1..=steps {
            assert_eq!(env.step(&action).unwrap().truncated, step == steps, "{id}, step {step}");
        }
    }
}
