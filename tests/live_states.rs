//! States of live worlds: they come back to what was kept, and recordings of them play again, bit by bit.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trocar_client::proto::dvrk::recording::LivePart;
use trocar_client::proto::dvrk::{Command, LiveRequest, Report, StateCommand};
use trocar_client::proto::part;
use trocar_client::{Code, SessionRequest};
use trocar_server::Registry;
use trocar_server::recording::{self, Course, Replay};

use crate::harness::Server;
use crate::live::{Script, random, refused};

/// Does at random what scripts do, in a world in lock-step.
fn act(script: &mut Script, seed: u64, rounds: usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let names: Vec<_> = script.world.live().arms.iter().map(|arm| arm.name.clone()).collect();
    for _ in 0..rounds {
        let name = &names[rng.random_range(0..names.len())];
        script.send(name, &random(&mut rng));
        script.advance(rng.random_range(0..60));
    }
}

/// Every bit that a client sees of a world, but for time.
#[derive(Debug, PartialEq)]
struct Seen {
    observation: Vec<f32>,
    arms: Vec<[f64; 7]>,
    objects: Vec<[f64; 7]>,
    steps: u32,
}

fn seen(script: &Script) -> Seen {
    let world = &script.world;
    let arms = world.live().arms.iter().map(|arm| script.arm(&arm.name).measured_position);
    let objects = world.live().objects.iter().map(|name| *world.object(name).unwrap());
    Seen {
        observation: world.observation().to_vec(),
        arms: arms.collect(),
        objects: objects.collect(),
        steps: world.world().steps,
    }
}

fn begun(server: &Server, task: &str) -> Script {
    let mut script = Script::open(server, &SessionRequest::new(task).seed(3));
    for arm in script.world.live().arms.clone() {
        script.enable_and_home(&arm.name);
    }
    script
}

fn play(course: Course) -> Replay {
    let mut replay = Replay::new(&Registry::builtin(), course).unwrap();
    while let Some(step) = replay.next() {
        step.unwrap();
    }
    replay
}

fn observation(replay: &Replay) -> Vec<f32> {
    let spec = replay.env().spec();
    let mut observation = vec![0.0; spec.observation_dim()];
    let mut goals = [vec![0.0; spec.goal_dim()], vec![0.0; spec.goal_dim()]];
    let [achieved, desired] = &mut goals;
    replay.env().observe(&mut observation, achieved, desired);
    observation
}

#[test]
fn a_world_comes_back_to_a_state_that_was_kept() {
    let server = Server::start();
    for task in ["NeedlePick-v0", "BiPegTransfer-v0", "EcmReach-v0"] {
        let mut script = begun(&server, task);
        act(&mut script, 5, 20);
        // In the middle of a move.
        let first = script.world.live().arms[0].name.clone();
        script.enable_and_home(&first);
        let joints = script.arm(&first).setpoint_position;
        let count = script.world.live().arms[0].joints.len();
        let mut goal = joints[..count].to_vec();
        goal[0] += 0.3;
        script.send(&first, &Command::MoveJp(goal));
        script.advance(30);
        assert!(script.state(&first).is_busy);
        let kept = script.world.snapshot().unwrap();
        let before = seen(&script);
        act(&mut script, 6, 30);
        let after = seen(&script);
        assert_ne!(before, after);
        for _ in 0..2 {
            let (ticks, stamp) = (script.world.world().ticks, script.arm(&first).stamp);
            script.heard.clear();
            script.world.restore(&kept).unwrap();
            assert_eq!(seen(&script), before, "{task}");
            // Time goes on, and a script learns what the arm is about.
            assert_eq!(script.world.world().ticks, ticks);
            assert!(script.arm(&first).stamp >= stamp);
            script.listen();
            let tells = |event: &_| matches!(event, Report::OperatingState(is) if is.is_busy);
            assert!(script.heard.iter().any(|event| tells(&event.report)), "{:?}", script.heard);
            assert!(script.heard.iter().all(|event| event.stamp > stamp));
            act(&mut script, 6, 30);
            assert_eq!(seen(&script), after, "{task}");
        }
    }
}

#[test]
fn recordings_of_live_worlds_play_again_bit_by_bit() {
    let server = Server::start();
    for task in ["NeedlePick-v0", "BiPegTransfer-v0", "EcmReach-v0"] {
        let mut script = begun(&server, task);
        act(&mut script, 7, 40);
        let kept = script.world.snapshot().unwrap();
        // What did not lead to the present state is not in its recording, however it was fetched.
        let client = server.connect();
        let session = script.world.info().session;
        client.record(session, 0, 1).unwrap();
        let mut followed = vec![];
        for seed in [8, 9] {
            script.world.restore(&kept).unwrap();
            for _ in 0..3 {
                act(&mut script, seed, 10);
                followed.extend(client.recorded(session).unwrap().0);
            }
        }
        let whole = script.world.recording().unwrap();
        assert!(followed.len() > whole.len());
        for bytes in [followed, whole] {
            let courses = recording::read(&bytes).unwrap();
            let [course] = <[Course; 1]>::try_from(courses).unwrap();
            assert!(course.is_live() && course.marks() > 10);
            assert_eq!((course.task(), course.seed()), (task, 3));
            let replay = play(course);
            assert_eq!(observation(&replay), script.world.observation(), "{task}");
            assert_eq!(replay.env().steps(), script.world.world().steps);
            assert!(!replay.has_failed());
        }
    }
}

#[test]
fn another_command_is_noticed_and_nonsense_refused() {
    let server = Server::start();
    let mut script = begun(&server, "NeedleReach-v0");
    act(&mut script, 7, 40);
    let bytes = script.world.recording().unwrap();
    let mut parts: Vec<_> = part::split(&bytes)
        .unwrap()
        .into_iter()
        .map(|part| LivePart::from_bytes(part).unwrap())
        .collect();
    let join = |parts: &[LivePart]| -> Vec<u8> {
        parts.iter().flat_map(|part| part.to_bytes().unwrap()).collect()
    };
    assert_eq!(join(&parts), bytes);
    let good = parts.clone();
    // Commands that are left out are noticed: the arm is not homed.
    let LivePart::Stretch(stretch) = &mut parts[1] else { panic!("it is a stretch") };
    stretch.commands.clear();
    let course = recording::read(&join(&parts)).unwrap().remove(0);
    let mut replay = Replay::new(&Registry::builtin(), course).unwrap();
    let refusal = std::iter::from_fn(|| replay.next()).find_map(Result::err).unwrap();
    assert_eq!(refusal.field, "recording.fingerprint");

    let changed = |change: &dyn Fn(&mut Vec<LivePart>)| {
        let mut parts = good.clone();
        change(&mut parts);
        recording::read(&join(&parts)).err().unwrap().field
    };
    assert_eq!(changed(&|parts| drop(parts.remove(0))), "recording.number");
    assert_eq!(changed(&|parts| drop(parts.remove(2))), "recording.number");
    let late = |parts: &mut Vec<LivePart>| {
        let LivePart::Stretch(stretch) = &mut parts[2] else { panic!() };
        stretch.ticks = u64::MAX;
    };
    assert_eq!(changed(&late), "recording.ticks");
}

#[test]
fn states_belong_to_their_session_and_arms_to_their_drivers() {
    let server = Server::start();
    let mut script = begun(&server, "BiPegTransfer-v0");
    let kept = script.world.snapshot().unwrap();
    let world = Some(script.world.info().session);
    let shared = LiveRequest { world, ..LiveRequest::default() };
    let request = SessionRequest::new("BiPegTransfer-v0").live(shared);
    let mut other = server.connect().open_live(&request).unwrap();
    assert_eq!(refused(other.restore(&kept)).code, Code::UnknownSnapshot);
    let own = other.snapshot().unwrap();
    // This client drives both arms: no other one may move them.
    let before = seen(&script);
    let refusal = refused(other.restore(&own));
    assert_eq!((refusal.code, refusal.value.as_str()), (Code::ArmIsDriven, "PSM1"));
    script.world.look().unwrap();
    assert_eq!(seen(&script), before);
    script.world.restore(&kept).unwrap();

    // States of live worlds are no states of environments, and stay in the server.
    drop(own);
    assert_eq!(refused(other.restore(&kept)).code, Code::UnknownSnapshot);
    let session = server.connect().open(&SessionRequest::new("BiPegTransfer-v0"));
    assert!(session.is_ok());
    script.send("PSM1", &Command::State(StateCommand::Disable));
    script.world.look().unwrap();
}
