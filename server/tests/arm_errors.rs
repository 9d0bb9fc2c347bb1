//! Errors of real arms: lag, play and coupling as their rows say, in live worlds and in episodes.
//!
//! `make picture-arm-errors` draws the motion of the first test.

use std::fmt::Write;
use std::path::Path;

use nalgebra::{DMatrix, DVector};
use trocar_proto::{OptionValue, Options};
use trocar_server::Registry;
use trocar_server::dvrk::{Command, Homing, State, StateCommand, TICK, What};
use trocar_server::env::LiveWorld;
use trocar_server::robots::Psm;
use trocar_server::sim::random::Rng;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// The joints of a PSM.
const JOINTS: [&str; 6] = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"];

/// What each joint moves within, rad; index 2 in m: what is picked up is in the middle of it.
const WITHIN: [[f64; 2]; 6] = [
    [-0.35, 0.35],
    [-0.35, 0.35],
    [0.06, 0.12],
    [-60.0 * DEGREE, 60.0 * DEGREE],
    [-45.0 * DEGREE, 45.0 * DEGREE],
    [-45.0 * DEGREE, 45.0 * DEGREE],
];

/// Time from one place to the next, s: then the wrist goes at 80 mm/s.
const SECONDS: f64 = 1.0;

/// Places of a motion.
const PLACES: usize = 24;

fn dvrk(rows: &[(&str, f64)]) -> Options {
    let rows = rows.iter().map(|(row, number)| (row.to_string(), vec![*number; 2]));
    Options::new().with("domain", OptionValue::Preset("dvrk".into(), rows.collect()))
}

fn live(options: &Options, seed: u64) -> LiveWorld {
    let mut env = Registry::builtin().make("NeedlePick-v0", options).unwrap();
    env.reset(Some(seed));
    let mut world = LiveWorld::new(env, Homing::ToZero).unwrap();
    for command in [StateCommand::Enable, StateCommand::Home] {
        world.arm_mut("PSM1").unwrap().command(&Command::State(command));
        while world.arm("PSM1").unwrap().operating_state().is_busy {
            world.tick().unwrap();
        }
    }
    world
}

/// What a joint of PSM1 was told, what its encoder said, and where its link was, tick by tick.
#[derive(Default)]
struct Track {
    commanded: Vec<f64>,
    encoder: Vec<f64>,
    link: Vec<f64>,
}

/// A pick-like motion: from place to place, smoothly, the jaws mostly turned.
fn motion(options: &Options, seed: u64) -> [Track; 6] {
    let mut world = live(options, seed);
    let mut rng = Rng::new(seed, 7);
    let mut tracks: [Track; 6] = Default::default();
    let mut from: Vec<f64> = world.arm("PSM1").unwrap().setpoint_js().position.to_vec();
    let ticks = (SECONDS / TICK).round() as u32;
    for _ in 0..PLACES {
        let to: Vec<f64> = WITHIN.iter().map(|[low, high]| rng.uniform(*low, *high)).collect();
        for now in 1..=ticks {
            let part = f64::from(now) / f64::from(ticks);
            let part = part * part * (3.0 - 2.0 * part);
            let joints: Vec<_> =
                from.iter().zip(&to).map(|(from, to)| from + (to - from) * part).collect();
            world.arm_mut("PSM1").unwrap().command(&Command::servo_jp(&joints));
            world.tick().unwrap();
            let arm = world.arm("PSM1").unwrap();
            let encoders = arm.encoders();
            let links = arm.drivetrain().settled::<7>(encoders.first_chunk().unwrap());
            for (joint, track) in tracks.iter_mut().enumerate() {
                track.commanded.push(arm.setpoint_js().position[joint]);
                track.encoder.push(encoders[joint]);
                track.link.push(links[joint]);
            }
        }
        from = to;
    }
    assert_eq!(world.arm("PSM1").unwrap().operating_state().state, State::Enabled);
    tracks
}

/// By how much `late` is behind `early`, s: where their cross-correlation is largest, between ticks by a parabola.
fn lag(early: &[f64], late: &[f64]) -> f64 {
    const MOST: usize = 30;
    let count = early.len() - MOST;
    let correlation = |shift: usize| {
        let pairs = early[MOST - shift..][..count].iter().zip(&late[MOST..]);
        let [a, b] = [&early[MOST - shift..][..count], &late[MOST..]]
            .map(|values| values.iter().sum::<f64>() / count as f64);
        let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
        for (x, y) in pairs {
            (ab, aa, bb) = (ab + (x - a) * (y - b), aa + (x - a) * (x - a), bb + (y - b) * (y - b));
        }
        ab / (aa * bb).sqrt()
    };
    let found: Vec<f64> = (0..MOST).map(correlation).collect();
    let best = (1..MOST - 1).max_by(|a, b| found[*a].total_cmp(&found[*b])).unwrap();
    let [before, here, after] = [found[best - 1], found[best], found[best + 1]];
    (best as f64 + 0.5 * (before - after) / (before - 2.0 * here + after)) * TICK
}

/// What follows `motor` with a play of this half-width.
fn play(motor: &[f64], half_width: f64) -> Vec<f64> {
    let mut at = motor[0];
    let follow = |to: &f64| {
        at = at.max(to - half_width).min(to + half_width);
        at
    };
    motor.iter().map(follow).collect()
}

/// The factors with which these columns and a constant come nearest to `link`, and what then is left, root mean square.
fn fit(link: &[f64], columns: &[&[f64]]) -> (Vec<f64>, f64) {
    let column = |index: usize, row: usize| columns.get(index).map_or(1.0, |of| of[row]);
    let matrix = DMatrix::from_fn(link.len(), columns.len() + 1, |row, index| column(index, row));
    let link = DVector::from_column_slice(link);
    let squares = matrix.transpose() * &matrix;
    let factors = squares.cholesky().unwrap().solve(&(matrix.transpose() * &link));
    let left = (&matrix * &factors - link).norm() / (matrix.nrows() as f64).sqrt();
    (factors.as_slice().to_vec(), left)
}

/// The best of half-widths about one, and the factors that go with it, of a fit with other columns.
fn best_play(track: &Track, about: f64, others: impl Fn(f64) -> Vec<Vec<f64>>) -> (f64, Vec<f64>) {
    // Until the play has been taken up on both sides, where it began still shows.
    let from = 2 * (SECONDS / TICK).round() as usize;
    let tried = (0..41).map(|step| about * (0.6 + 0.02 * f64::from(step)));
    let found = tried.map(|half_width| {
        let columns = others(half_width);
        let columns: Vec<_> = columns.iter().map(|column| &column[from..]).collect();
        let (factors, left) = fit(&track.link[from..], &columns);
        (half_width, factors, left)
    });
    let best = found.min_by(|a, b| a.2.total_cmp(&b.2)).unwrap();
    (best.0, best.1)
}

fn assert_within_a_tenth(what: &str, is: f64, row: f64) {
    assert!((is - row).abs() < 0.1 * row.abs(), "{what}: {is}, its row says {row}");
}

#[test]
fn lags_plays_weights_and_slopes_are_those_of_their_rows() {
    let lags = [0.049, 0.045, 0.052, 0.015, 0.034, 0.028];
    let plays = [0.0, 0.0, 0.2e-3, 1.5 * DEGREE, 8.5 * DEGREE, 13.75 * DEGREE];
    let weights = [1.0, 1.0, 1.15, 0.55, 0.55, 0.62];
    let gains = [1.0, 1.0, 1.0, 1.0, 0.97, 0.90];
    let [coupling_weight, pitch_gain, yaw_gain] = [-0.65, 0.12, 0.2];
    let mut rows = vec![];
    for (joint, name) in JOINTS.into_iter().enumerate() {
        rows.push((format!("lag_{name}"), lags[joint]));
        if joint >= 2 {
            rows.push((format!("play_{name}"), plays[joint]));
            rows.push((format!("play_weight_{name}"), weights[joint]));
            rows.push((format!("gain_{name}"), gains[joint]));
        }
    }
    rows.push(("coupling_weight".into(), coupling_weight));
    rows.push(("coupling_gain_wrist_pitch".into(), pitch_gain));
    rows.push(("coupling_gain_wrist_yaw".into(), yaw_gain));
    let rows: Vec<_> = rows.iter().map(|(row, number)| (row.as_str(), *number)).collect();
    let tracks = motion(&dvrk(&rows), 3);
    if std::env::var_os("TROCAR_WRITE_PICTURE").is_some() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/pictures/arm_errors.svg");
        std::fs::write(path, picture(&tracks)).unwrap();
    }

    for (joint, track) in tracks.iter().enumerate() {
        let found = lag(&track.commanded, &track.encoder);
        assert!((found - lags[joint]).abs() < 5e-3, "{}: {found} s", JOINTS[joint]);
    }
    for joint in [2, 3] {
        let (track, name) = (&tracks[joint], JOINTS[joint]);
        let columns = |half_width| vec![track.encoder.clone(), play(&track.encoder, half_width)];
        let (half_width, factors) = best_play(track, plays[joint], columns);
        assert_within_a_tenth(name, half_width, plays[joint]);
        assert_within_a_tenth(name, factors[1], weights[joint]);
        assert_within_a_tenth(name, factors[0] + factors[1], gains[joint]);
    }
    let [.., pitch, yaw] = &tracks;
    let columns = |half_width| {
        vec![yaw.encoder.clone(), play(&yaw.encoder, half_width), pitch.encoder.clone()]
    };
    let (yaw_width, factors) = best_play(yaw, plays[5], columns);
    assert_within_a_tenth("wrist yaw", yaw_width, plays[5]);
    assert_within_a_tenth("wrist yaw", factors[0], gains[5] - weights[5]);
    assert_within_a_tenth("wrist yaw", factors[1], weights[5]);
    assert_within_a_tenth("wrist yaw", factors[2], yaw_gain);
    let columns = |half_width| {
        let own = [pitch.encoder.clone(), play(&pitch.encoder, half_width)];
        own.into_iter().chain([yaw.encoder.clone(), play(&yaw.encoder, yaw_width)]).collect()
    };
    let (half_width, factors) = best_play(pitch, plays[4], columns);
    assert_within_a_tenth("wrist pitch", half_width, plays[4]);
    assert_within_a_tenth("wrist pitch", factors[0], gains[4] - weights[4]);
    assert_within_a_tenth("wrist pitch", factors[1], weights[4]);
    assert_within_a_tenth("wrist pitch of yaw", factors[2], pitch_gain - coupling_weight);
    assert_within_a_tenth("wrist pitch of yaw's play", factors[3], coupling_weight);
}

#[test]
fn under_the_preset_links_are_off_as_those_of_real_arms() {
    for seed in 0..3 {
        let tracks = motion(&dvrk(&[]), seed);
        let error = |joint: usize| -> Vec<f64> {
            let Track { encoder, link, .. } = &tracks[joint];
            let off: Vec<_> = link.iter().zip(encoder).map(|(link, is)| link - is).collect();
            let mean = off.iter().sum::<f64>() / off.len() as f64;
            off.iter().map(|off| off - mean).collect()
        };
        let product = |a: &[f64], b: &[f64]| {
            a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len() as f64
        };
        let deviation = |of: &[f64]| product(of, of).sqrt();
        let [insertion, roll, pitch, yaw] = [2, 3, 4, 5].map(error);
        let [pitch_off, yaw_off] = [&pitch, &yaw].map(|of| deviation(of));
        let correlation = product(&pitch, &yaw) / (pitch_off * yaw_off);
        let found = [
            (pitch_off / DEGREE, [7.0, 12.0]),
            (yaw_off / DEGREE, [7.0, 12.0]),
            (correlation, [-0.98, -0.8]),
            (deviation(&insertion) * 1e3, [0.15, 0.45]),
            (deviation(&roll) / DEGREE, [0.6, 2.2]),
        ];
        eprintln!("seed {seed}: {found:.2?}");
        for (is, [least, most]) in found {
            assert!((least..=most).contains(&is), "seed {seed}: {is} in {found:?}");
        }
    }
}

#[test]
fn experts_that_see_the_truth_work_with_arms_that_err() {
    let (rigid, pad) = (dvrk(&[]), dvrk(&[("pad_depth", 2e-3)]));
    let of_tasks = [
        ("GauzeRetrieve-v0", &pad, [3, 8, 26]), // jaws that are turned, and that play first moves down
        ("PegTransfer-v0", &rigid, [4, 11, 24]), // blocks that hang askew, and that are caught on their pegs
        ("BiPegTransfer-v0", &rigid, [3, 4, 6]),
    ];
    for (task, options, seeds) in of_tasks {
        let mut env = Registry::builtin().make(task, options).unwrap();
        let mut action = vec![0.0; env.spec().action_dim()];
        for seed in seeds {
            env.reset(Some(seed));
            let mut is_success = false;
            while !env.needs_reset() {
                env.expert(&mut action);
                is_success = env.step(&action).unwrap().is_success;
            }
            assert!(is_success, "{task} {seed}");
        }
    }
}

#[test]
fn the_arm_that_is_drawn_and_touches_is_the_true_one() {
    let mut world = live(&dvrk(&[("base_angle", 0.0)]), 1);
    for _ in 0..240 {
        let joints = [0.1, 0.1, 0.1, 0.3, 0.6, -0.5];
        world.arm_mut("PSM1").unwrap().command(&Command::MoveJp(joints.to_vec()));
        world.tick().unwrap();
    }
    let arm = world.arm("PSM1").unwrap();
    let links = arm.drivetrain().settled::<6>(arm.encoders().first_chunk().unwrap());
    let believed = world.world_from_base("PSM1").unwrap();
    let scene = world.env().scene();
    let body = scene.body("psm1 jaw_1_link").unwrap();
    let drawn = scene.instances().iter().find(|part| part.body == body).unwrap().world_from_mesh;
    let is = drawn.translation.vector;
    let [by_links, by_encoders] = [links, std::array::from_fn(|joint| arm.encoders()[joint])]
        .map(|joints| (believed * Psm::CLASSIC.base_from_wrist(&joints)).translation.vector);
    // Without a turn of the base, all is shifted by as much.
    let shift = is - by_links;
    assert!(shift.amax() <= 0.0035 + 1e-9 && shift.norm() > 0.1e-3, "{shift}");
    assert!((by_links - by_encoders).norm() > 0.5e-3);
}

#[test]
fn an_endoscope_that_lags_is_behind_its_command() {
    let moved = |rows: &[(&str, f64)]| {
        let rows = rows.iter().map(|(row, number)| (row.to_string(), vec![*number; 2])).collect();
        let options = Options::new().with("domain", OptionValue::Table(rows));
        let mut env = Registry::builtin().make("EcmReach-v0", &options).unwrap();
        env.reset(Some(0));
        let [mut before, mut after] = [(); 2].map(|()| vec![0.0; env.spec().observation_dim()]);
        let [mut achieved, mut desired] = [[0.0; 3]; 2];
        env.observe(&mut before, &mut achieved, &mut desired);
        env.step(&[0.0, 0.0, 1.0]).unwrap();
        env.observe(&mut after, &mut achieved, &mut desired);
        (0..3).map(|axis| (after[axis] - before[axis]).powi(2)).sum::<f32>().sqrt()
    };
    let lag = 0.05;
    let [full, late] = [vec![], vec![("lag_yaw", lag), ("lag_pitch", lag), ("lag_insertion", lag)]]
        .map(|rows| f64::from(moved(&rows)));
    // A ramp of 0.1 s that begins at rest: 1 − (T/t)(1 − exp(−t/T)) of it.
    let part = 1.0 - lag / 0.1 * (1.0 - (-0.1 / lag).exp());
    assert!(
        (full - 0.01).abs() < 1e-4 && (late / full - part).abs() < 0.02,
        "{full} {late} {part}"
    );
}

/// Scenario B6.
#[test]
fn a_jump_of_a_servoed_joint_faults_an_arm_that_lags_and_enabling_recovers() {
    for (arm, options, task) in
        [("PSM1", dvrk(&[]), "NeedlePick-v0"), ("ECM", dvrk(&[]), "EcmReach-v0")]
    {
        let mut env = Registry::builtin().make(task, &options).unwrap();
        env.reset(Some(0));
        let mut world = LiveWorld::new(env, Homing::InPlace).unwrap();
        let mut errors = vec![];
        let mut run = |world: &mut LiveWorld, command: &Command, ticks: u32| {
            world.arm_mut(arm).unwrap().command(command);
            for _ in 0..ticks {
                world.tick().unwrap();
                for event in world.arm_mut(arm).unwrap().take_events() {
                    if let What::Error(error) = event.what {
                        errors.push(error.to_string());
                    }
                }
            }
            world.arm(arm).unwrap().operating_state()
        };
        run(&mut world, &Command::State(StateCommand::Enable), 1);
        assert!(run(&mut world, &Command::State(StateCommand::Home), 60).is_homed);
        let start = world.arm(arm).unwrap().setpoint_js().position;
        let mut jump = start.clone();
        jump[0] += if jump[0] > 0.0 { -60.0 } else { 60.0 } * DEGREE;
        assert_eq!(run(&mut world, &Command::servo_jp(&jump), 2).state, State::Fault, "{arm}");
        let state = run(&mut world, &Command::State(StateCommand::Enable), 1);
        assert_eq!(state.state, State::Enabled);
        assert!(run(&mut world, &Command::State(StateCommand::Home), 60).is_homed);
        run(&mut world, &Command::MoveJp(start.to_vec()), 480);
        let is = world.arm(arm).unwrap().measured_js().position;
        assert!((is[0] - start[0]).abs() < 1e-6, "{arm}: {is:?}");
        assert!(errors.len() == 1 && errors[0].contains("tracking error"), "{errors:?}");
    }
}

/// What each joint was told (grey), what its encoder said (blue) and where its link was (red), over ten seconds.
fn picture(tracks: &[Track; 6]) -> String {
    const SIZE: [f64; 2] = [760.0, 110.0];
    let shown = 1..(11.0 / TICK) as usize;
    let height = SIZE[1] * tracks.len() as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {height}\" font-family=\"sans-serif\" \
         font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        SIZE[0]
    );
    for (joint, track) in tracks.iter().enumerate() {
        let [low, high] = WITHIN[joint];
        let (unit, scale) = if joint == 2 { ("mm", 1e3) } else { ("°", 1.0 / DEGREE) };
        let top = SIZE[1] * joint as f64;
        let label = JOINTS[joint].replace('_', " ");
        let (low_text, high_text) = (low * scale, high * scale);
        writeln!(svg, "<text x=\"8\" y=\"{}\">{label}</text>", top + 16.0).unwrap();
        let range = format!("{low_text:.0} to {high_text:.0} {unit}");
        writeln!(svg, "<text x=\"8\" y=\"{}\" fill=\"gray\">{range}</text>", top + 32.0).unwrap();
        for (values, colour) in
            [(&track.commanded, "silver"), (&track.encoder, "royalblue"), (&track.link, "crimson")]
        {
            let mut points = String::new();
            for tick in shown.clone().step_by(8) {
                let x = 120.0 + (SIZE[0] - 130.0) * tick as f64 / shown.end as f64;
                let part = (values[tick] - low) / (high - low);
                let y = top + SIZE[1] - 15.0 - (SIZE[1] - 30.0) * part;
                write!(points, "{x:.1},{y:.1} ").unwrap();
            }
            writeln!(svg, "<polyline points=\"{points}\" fill=\"none\" stroke=\"{colour}\"/>")
                .unwrap();
        }
    }
    svg + "</svg>\n"
}
