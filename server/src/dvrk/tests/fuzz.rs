//! 100,000 commands of all kinds, most of them nonsense: nothing panics, and what always holds holds.

use super::*;
use crate::dvrk::command::Fault;
use crate::dvrk::{Effort, State};

const COMMANDS: usize = 100_000;

/// A number that a client may send.
fn number(rng: &mut Rng) -> f64 {
    const ODD: [f64; 9] = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::MAX,
        f64::MIN_POSITIVE,
        -0.0,
        1e6,
        -1e6,
        1e-300,
    ];
    match rng.index(60) {
        0 => ODD[rng.index(ODD.len())],
        1 => rng.uniform(-100.0, 100.0),
        _ => rng.uniform(-1.5, 1.5),
    }
}

/// A vector that a client may send: mostly of the right length.
fn numbers(rng: &mut Rng, count: usize) -> Vec<f64> {
    let count = if rng.index(20) == 0 { rng.index(10) } else { count };
    (0..count).map(|_| number(rng)).collect()
}

fn pose(rng: &mut Rng) -> PoseMessage {
    let frames = ["", "", "", "", "", "PSM1_base", "ECM_base", "elsewhere"];
    let position = [(); 3].map(|()| 0.15 * number(rng));
    let mut orientation = [(); 4].map(|()| number(rng));
    if rng.index(20) > 0 {
        let norm = orientation.iter().map(|value| value * value).sum::<f64>().sqrt();
        orientation = orientation.map(|value| value / norm);
    }
    PoseMessage { frame: frames[rng.index(frames.len())].into(), position, orientation }
}

/// A command that a client may send.
pub(super) fn command(rng: &mut Rng, mechanism: &Mechanism) -> Command {
    let joints = mechanism.joints();
    match rng.index(34) {
        0 | 1 => {
            let words = ["enable", "disable", "home", "unhome", "pause", "resume", "nonsense"];
            Command::State(StateCommand::of(words[rng.index(words.len())]))
        }
        2..5 => Command::State([StateCommand::Enable, StateCommand::Home][rng.index(2)].clone()),
        5 => Command::Hold,
        6 => Command::Free,
        7 | 8 => {
            let velocity = if rng.index(2) == 0 { vec![] } else { numbers(rng, joints) };
            Command::ServoJp { position: numbers(rng, joints), velocity }
        }
        9 => Command::ServoJr(numbers(rng, joints)),
        10 => Command::ServoJv(numbers(rng, joints)),
        11 | 12 => Command::ServoCp(pose(rng)),
        13 => Command::ServoCr(pose(rng)),
        14 => Command::ServoCv([(); 6].map(|()| number(rng))),
        15..18 => Command::MoveJp(numbers(rng, joints)),
        18 | 19 => Command::MoveJr(numbers(rng, joints)),
        20..23 => Command::MoveCp(pose(rng)),
        23 => Command::MoveCr(pose(rng)),
        24 => Command::JawServoJp(numbers(rng, 1)),
        25 | 26 => Command::JawMoveJp(numbers(rng, 1)),
        27 => Command::Effort([Effort::ServoJf, Effort::JawServoJf, Effort::ServoCi][rng.index(3)]),
        28 => Command::SetRatio(rng.uniform(-0.1, 1.2)),
        29 => Command::SetRatioV(number(rng)),
        30 => Command::SetRatioA(number(rng)),
        31 => Command::SetBaseFrame(pose(rng)),
        32 => match rng.index(4) {
            0 => Command::EmulateToolPresent(false),
            1 => Command::EmulateAdapterPresent(rng.index(2) == 0),
            _ => Command::EmulateToolPresent(true),
        },
        _ => match rng.index(6) {
            4 => Command::EmulateFault(Fault::ALL[rng.index(4)].clone()),
            5 => Command::EmulateFault(Fault::of("é")),
            0 => Command::SetToolType("LARGE_NEEDLE_DRIVER:400006".into()),
            1 => Command::SetToolType("x".repeat(100_000)),
            2 => Command::SetEndoscopeType("Classic_HD_DOWN".into()),
            _ => Command::SetEndoscopeType("Classic_é".into()),
        },
    }
}

#[test]
fn no_command_makes_an_arm_panic_or_leave_its_limits() {
    for mechanism in [Mechanism::Psm(Psm::CLASSIC), Mechanism::Ecm(Ecm::CLASSIC)] {
        let mut script = Script::new(&mechanism);
        let mut rng = Rng::new(7, mechanism.joints() as u64);
        let [mut moves, mut reached, mut homed, mut refused] = [0_usize; 4];
        for _ in 0..COMMANDS / 2 {
            let command = command(&mut rng, &mechanism);
            script.arm.command(&command);
            // Now and then until homing or a move is at its end.
            let is_patient = script.arm.operating_state().is_busy && rng.index(8) == 0;
            for _ in 0..if is_patient { 2000 } else { rng.index(12) } {
                let before = script.arm.operating_state();
                script.arm.tick();
                check(&script.arm, before.is_busy);
                if is_patient && !script.arm.operating_state().is_busy {
                    break;
                }
            }
            // Now and then an arm that is elsewhere.
            if rng.index(200) == 0 {
                let off: Vec<f64> = (0..mechanism.axes()).map(|_| rng.uniform(-0.2, 0.2)).collect();
                script.arm.measure(&off);
            }
            script.heard.clear();
            script.listen();
            for event in &script.heard {
                match &event.what {
                    What::OperatingState(state) => moves += usize::from(state.is_busy),
                    What::GoalReached(true) => reached += 1,
                    What::Error(error) => {
                        refused += 1;
                        assert!(error.to_string().len() < 400, "{error}");
                    }
                    _ => {}
                }
            }
            homed += usize::from(script.arm.operating_state().is_homed);
        }
        // It is no test of an arm that refuses everything.
        let counts = [moves, reached, homed, refused];
        assert!(moves > 2000 && reached > 100 && homed > 5000 && refused > 1000, "{counts:?}");
    }
}

fn check(arm: &ArmController, was_busy: bool) {
    let state = arm.operating_state();
    assert!(!state.is_busy || state.state == State::Enabled);
    assert!(!state.is_homed || state.state != State::Disabled && state.state != State::Fault);
    let (set, measured) = (arm.setpoint_js(), arm.measured_js());
    let all = set.position.iter().chain(&set.velocity).chain(&measured.position);
    assert!(all.chain(&measured.velocity).all(|value| value.is_finite()));
    if arm.tool().is_none() {
        return;
    }
    for axis in 0..arm.mechanism().joints() {
        let limit = arm.mechanism().limit(axis);
        assert!(limit.contains(set.position[axis]));
        if was_busy && state.is_busy {
            assert!(set.velocity[axis].abs() <= limit.max_velocity + ROUNDING);
        }
    }
    let fk = arm.forward_kinematics(&measured.position).unwrap();
    // A base frame may be 1000 km away.
    let scale = 1.0 + fk.translation.vector.norm();
    assert!(far(&fk, &arm.measured_cp().unwrap()) < 1e-9 * scale);
}
