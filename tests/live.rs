//! Live worlds over shared memory: the bits of a world in-process, kinematics, pace; several clients of one world; bad
//! input.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trocar_client::proto::dvrk::record::Question;
use trocar_client::proto::dvrk::{
    ArmRecord, Command, Event, Homing, LiveRequest, OperatingState, PoseMessage, Report, State,
    StateCommand, TICKS_PER_SECOND,
};
use trocar_client::proto::wire::{Header, kind};
use trocar_client::{CallError, Code, LiveWorld, OptionValue, Options, Rejection, SessionRequest};
use trocar_server::Registry;
use trocar_server::env;

use crate::harness::{Server, client, eventually};

pub(crate) const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Longest wait of a script, as dVRK's handles have it.
const LONGEST: u32 = 30 * TICKS_PER_SECOND as u32;

pub(crate) const HOME: [f64; 6] = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0];

/// A script in a world in lock-step.
pub(crate) struct Script {
    pub(crate) world: LiveWorld,
    pub(crate) heard: Vec<Event>,
}

impl Script {
    pub(crate) fn open(server: &Server, request: &SessionRequest) -> Self {
        Self { world: server.connect().open_live(request).unwrap(), heard: vec![] }
    }

    pub(crate) fn new(server: &Server, task: &str) -> Self {
        Self::open(server, &SessionRequest::new(task))
    }

    pub(crate) fn send(&mut self, arm: &str, command: &Command) {
        self.world.command(arm, command).unwrap();
    }

    pub(crate) fn listen(&mut self) {
        self.heard.extend(std::iter::from_fn(|| self.world.next_event()));
    }

    pub(crate) fn advance(&mut self, ticks: u32) {
        assert_eq!(self.world.advance(ticks).unwrap(), ticks);
        self.listen();
    }

    pub(crate) fn arm(&self, arm: &str) -> &ArmRecord {
        self.world.arm(arm).unwrap()
    }

    pub(crate) fn state(&self, arm: &str) -> OperatingState {
        self.arm(arm).operating_state()
    }

    /// Waits until an arm is not busy; how many ticks that took.
    pub(crate) fn wait(&mut self, arm: &str) -> u32 {
        self.world.look().unwrap();
        let mut ticks = 0;
        while self.state(arm).is_busy && ticks < LONGEST {
            ticks += self.world.advance_until_event(LONGEST - ticks).unwrap();
        }
        self.listen();
        ticks
    }

    /// Gives a command and waits for its end; how long that took, s.
    pub(crate) fn carry_out(&mut self, arm: &str, command: &Command) -> f64 {
        self.send(arm, command);
        f64::from(self.wait(arm)) / TICKS_PER_SECOND as f64
    }

    pub(crate) fn enable_and_home(&mut self, arm: &str) {
        self.carry_out(arm, &Command::State(StateCommand::Enable));
        self.carry_out(arm, &Command::State(StateCommand::Home));
        assert!(self.state(arm).is_homed);
    }

    /// What arms complained of, and whether moves reached their goals.
    pub(crate) fn complaints(&mut self) -> Vec<String> {
        let mut complaints = vec![];
        for event in self.heard.drain(..) {
            match event.report {
                Report::Warning(why) | Report::Error(why) => complaints.push(why),
                _ => {}
            }
        }
        complaints
    }

    pub(crate) fn reached(&self) -> Vec<bool> {
        let reached = |event: &Event| match event.report {
            Report::GoalReached(is_reached) => Some(is_reached),
            _ => None,
        };
        self.heard.iter().filter_map(reached).collect()
    }
}

pub(crate) fn refused<T: std::fmt::Debug>(result: Result<T, CallError>) -> Rejection {
    match result {
        Err(CallError::Refused(refusal)) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}

pub(crate) fn moved(from: &[f64], steps: &[(usize, f64)]) -> Vec<f64> {
    let mut joints = from[..6].to_vec();
    for (joint, by) in steps {
        joints[*joint] += by;
    }
    joints
}

pub(crate) fn pose(numbers: &[f64; 7]) -> PoseMessage {
    let [x, y, z, i, j, k, w] = *numbers;
    PoseMessage { frame: String::new(), position: [x, y, z], orientation: [i, j, k, w] }
}

#[test]
fn kinematics_are_answered() {
    let server = Server::start();
    let mut script = Script::new(&server, "NeedleReach-v0");
    script.enable_and_home("PSM1");
    let joints = [0.1, -0.2, 0.13, 0.3, 0.2, -0.1];
    let mut ask = |which, groups| script.world.ask("PSM1", which, groups).unwrap();
    let goal = ask(Question::ForwardKinematics, [&joints, &[]]).unwrap();
    let found = ask(Question::InverseKinematics, [&goal, &joints]).unwrap();
    assert!(joints.iter().zip(&found).all(|(joint, found)| (joint - found).abs() < 1e-9));
    let why = ask(Question::ForwardKinematics, [&[0.0; 7], &[]]).unwrap_err();
    assert!(why.contains("too many joints: 7"), "{why}");
    assert_eq!(ask(Question::BodyJacobian, [&[], &[]]).unwrap().len(), 36);
    let refusal = refused(script.world.ask("PSM9", Question::BodyJacobian, [&[], &[]]));
    assert_eq!((refusal.code, refusal.field.as_str()), (Code::UnknownArm, "arm"));
}

/// What a random script commands.
pub(crate) fn random(rng: &mut ChaCha8Rng) -> Command {
    let joints: Vec<f64> = HOME.iter().map(|q| q + rng.random_range(-0.1..0.1)).collect();
    match rng.random_range(0..6) {
        0 => Command::MoveJp(joints),
        1 => Command::servo_jp(&joints),
        2 => Command::JawMoveJp(vec![rng.random_range(-0.3..1.0)]),
        3 => Command::ServoCv([0.01, -0.02, 0.0, 0.1, 0.0, rng.random_range(-0.5..0.5)]),
        4 => Command::Hold,
        _ => Command::MoveJp(joints[..5].to_vec()),
    }
}

#[test]
fn the_same_commands_give_the_bits_of_a_world_in_process() {
    let server = Server::start();
    for (task, seed) in [("NeedlePick-v0", 3), ("BiPegTransfer-v0", 4)] {
        let mut script = Script::open(&server, &SessionRequest::new(task).seed(seed));
        let mut env = Registry::builtin().make(task, &Options::new()).unwrap();
        env.reset(Some(seed));
        let mut twin = env::LiveWorld::new(env, Homing::ToZero).unwrap();
        let names: Vec<_> = script.world.live().arms.iter().map(|arm| arm.name.clone()).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut told = vec![];
        for round in 0..150 {
            let name = &names[rng.random_range(0..names.len())];
            let command = match round {
                0..10 => Command::State(StateCommand::Enable),
                10..20 => Command::State(StateCommand::Home),
                _ => random(&mut rng),
            };
            let ticks = rng.random_range(0..60);
            script.send(name, &command);
            script.advance(ticks);
            twin.arm_mut(name).unwrap().command(&command);
            for tick in 0..=ticks {
                for (place, arm) in twin.arms_mut().enumerate() {
                    told.extend(arm.take_events().into_iter().map(|event| Event {
                        arm: place as u32,
                        stamp: event.stamp.nanoseconds(),
                        report: event.what.report(),
                    }));
                }
                if tick < ticks {
                    twin.tick().unwrap();
                }
            }
            for name in &names {
                let driver = script.arm(name).driver;
                let mut own = twin.arm(name).unwrap().record();
                own.driver = driver;
                assert_eq!(*script.arm(name), own, "round {round}");
            }
            let spec = script.world.spec();
            let mut observation = vec![0.0; spec.observation_dim()];
            let mut goals = [vec![0.0; spec.goal_dim()], vec![0.0; spec.goal_dim()]];
            let [achieved, desired] = &mut goals;
            let step = twin.observe(&mut observation, achieved, desired);
            let world = script.world.world();
            assert_eq!(script.world.observation(), observation);
            assert_eq!([script.world.achieved_goal(), script.world.desired_goal()], goals);
            assert_eq!((world.reward, world.is_success != 0), (step.reward, step.is_success));
            for (name, place) in twin.objects() {
                let is = script.world.object(name).unwrap();
                assert_eq!(*is, trocar_server::dvrk::numbers_of(&place));
            }
        }
        assert_eq!(script.heard, told);
        assert!(told.len() > 50, "{}", told.len());
    }
}

#[test]
fn a_world_at_its_own_pace_goes_on_by_itself() {
    let server = Server::start();
    let live = LiveRequest { speed: Some(20.0), ..LiveRequest::default() };
    let mut script = Script::open(&server, &SessionRequest::new("NeedleReach-v0").live(live));
    let before = script.world.world().ticks;
    eventually("time passes", || {
        script.world.look().unwrap();
        script.world.world().ticks > before + 240
    });
    // A script needs nothing else: it waits for as many ticks, or for events.
    script.enable_and_home("PSM1");
    let before = script.world.world().ticks;
    let goal = moved(&HOME, &[(0, 0.5)]);
    script.send("PSM1", &Command::MoveJp(goal.clone()));
    script.wait("PSM1");
    assert_eq!(script.arm("PSM1").measured_position[..6], goal);
    let seconds = (script.world.world().ticks - before) as f64 / TICKS_PER_SECOND as f64;
    assert!(seconds >= 2.0 * (0.5 / (90.0 * DEGREE)).sqrt(), "{seconds}");
    let passed = script.world.advance(480).unwrap();
    assert!(passed >= 480, "{passed}");
    // One whose pace is beyond what the server can do answers all the same.
    let live = LiveRequest { speed: Some(1000.0), ..LiveRequest::default() };
    let request = SessionRequest::new("BiPegTransfer-v0").live(live);
    let mut hasty = server.connect().open_live(&request).unwrap();
    let before = hasty.world().ticks;
    for _ in 0..20 {
        hasty.advance(24).unwrap();
    }
    assert!(hasty.world().ticks >= before + 480);
    drop(hasty);
    for (speed, shown) in [(0.0, "0"), (f64::NAN, "NaN"), (1e9, "1000000000")] {
        let live = LiveRequest { speed: Some(speed), ..LiveRequest::default() };
        let request = SessionRequest::new("NeedleReach-v0").live(live);
        let refusal = refused(server.connect().open_live(&request));
        assert_eq!((refusal.field.as_str(), refusal.value.as_str()), ("live.speed", shown));
    }
}

#[test]
fn one_client_at_a_time_drives_an_arm() {
    let server = Server::start();
    let mut script = Script::new(&server, "BiPegTransfer-v0");
    let mut driver = client(server.name(), "drive");
    assert_eq!(driver.line(), "ready");
    // It has driven PSM1 for a while, in the same world; this client may read, and drive the other arm.
    script.world.look().unwrap();
    assert_eq!((script.arm("PSM1").driver, script.arm("PSM2").driver), (driver.pid(), 0));
    assert!(script.state("PSM1").is_busy && script.world.world().ticks == 780);
    script.enable_and_home("PSM2");
    script.send("PSM1", &Command::Hold);
    script.send("PSM2", &Command::MoveJp(moved(&HOME, &[(0, 0.1)])));
    let refusal = refused(script.world.look());
    assert_eq!((refusal.code, refusal.field.as_str()), (Code::ArmIsDriven, "arm"));
    assert_eq!(refusal.value, "PSM1");
    assert!(refusal.allowed.contains(&format!("process {}", driver.pid())), "{refusal}");
    // Of what is refused, nothing is done.
    script.world.look().unwrap();
    assert!(!script.state("PSM2").is_busy);
    let live = script.world.live().clone();
    script.heard.clear();
    driver.kill();
    eventually("the arm is free", || {
        script.world.look().unwrap();
        script.arm("PSM1").driver == 0
    });
    // It holds where it was.
    script.listen();
    assert!(!script.state("PSM1").is_busy && script.state("PSM1").is_homed);
    assert_eq!(script.reached(), [false]);
    let held = script.arm("PSM1").measured_position;
    assert!(held[0] > 0.0 && held[0] < 1.0);
    script.advance(240);
    assert_eq!(script.arm("PSM1").measured_position, held);
    script.carry_out("PSM1", &Command::MoveJp(HOME.to_vec()));
    assert_eq!(script.arm("PSM1").measured_position[..6], HOME);
    assert_eq!(script.arm("PSM1").driver, std::process::id());

    // Those that share a world must want the same one, and it ends with its maker.
    let world = Some(script.world.info().session);
    let shared = LiveRequest { world, ..LiveRequest::default() };
    let share =
        |task: &str, live| server.connect().open_live(&SessionRequest::new(task).live(live));
    assert_eq!(refused(share("NeedlePick-v0", shared)).field, "task");
    let paced = LiveRequest { speed: Some(1.0), ..shared };
    assert_eq!(refused(share("BiPegTransfer-v0", paced)).field, "live.speed");
    let unknown = LiveRequest { world: Some(99_999), ..shared };
    assert_eq!(refused(share("BiPegTransfer-v0", unknown)).field, "live.world");
    let mut other = share("BiPegTransfer-v0", shared).unwrap();
    assert_eq!(*other.live(), live);
    drop(script);
    eventually("its world ends", || match other.look() {
        Ok(()) => false,
        Err(CallError::Refused(refusal)) => refusal.field == "world",
        Err(other) => panic!("{other}"),
    });
}

#[test]
fn bad_input_is_refused_by_name_and_moves_nothing() {
    let server = Server::start();
    let mut script = Script::new(&server, "NeedleReach-v0");
    script.enable_and_home("PSM1");
    let still = script.arm("PSM1").measured_position;
    let twisted = PoseMessage { orientation: [0.0; 4], ..pose(&script.arm("PSM1").measured_cp) };
    let nowhere = pose(&script.arm("PSM1").measured_cp).with_frame("kitchen");
    let at = |value: f64| moved(&HOME, &[(3, value)]);
    let cases: [(Command, &[&str]); 8] = [
        (Command::MoveJp(HOME[..5].to_vec()), &["move_jp", "5 numbers", "expected 6"]),
        (Command::servo_jp(&[0.0; 8]), &["servo_jp", "8 numbers", "expected 6"]),
        (Command::MoveJp(at(f64::NAN)), &["move_jp", "number 3", "NaN", "expected"]),
        (Command::servo_jp(&at(f64::INFINITY)), &["servo_jp", "number 3", "inf"]),
        (Command::JawMoveJp(vec![f64::NAN]), &["jaw/move_jp", "NaN"]),
        (Command::JawServoJp(vec![]), &["jaw/servo_jp", "0 numbers", "expected 1"]),
        (Command::MoveCp(twisted), &["move_cp", "unit quaternion"]),
        (Command::ServoCp(nowhere), &["servo_cp", "kitchen", "PSM1_base"]),
    ];
    for (command, parts) in cases {
        script.heard.clear();
        script.send("PSM1", &command);
        script.advance(24);
        let complaints = script.complaints();
        assert!(parts.iter().all(|part| complaints[0].contains(part)), "{complaints:?}");
        assert_eq!(script.arm("PSM1").measured_position, still);
    }
    let refusal = refused(script.world.command("PSM7", &Command::Hold));
    assert_eq!(refusal.to_string(), "arm = \"PSM7\": this world has PSM1, ECM");
    let refusal = refused(script.world.command("PSM1", &Command::MoveJp(vec![0.0; 1000])));
    assert_eq!(refusal.to_string(), "move_jp = 1000 numbers: at most 24");
    for (request, field) in [
        (SessionRequest::new("NeedleReach-v0").envs(2), "envs"),
        (SessionRequest::new("NeedleReach-v9"), "task"),
        (
            SessionRequest::new("NeedlePick-v0").options(Options::new().with_text("grasp", "weld")),
            "options.grasp",
        ),
    ] {
        assert_eq!(refused(server.connect().open_live(&request)).field, field);
    }
}

#[test]
fn messages_that_no_client_of_ours_sends_harm_nothing() {
    let server = Server::start();
    let mut script = Script::new(&server, "NeedleReach-v0");
    script.enable_and_home("PSM1");
    let info = script.world.info();
    let good = Header { session: info.session, epoch: info.epoch, ..Header::new(kind::LIVE) };
    for (header, field) in [
        (Header { rows: 33, ..good }, "header.rows"),
        (Header { kind: kind::STEP, rows: 1, ..good }, "header.kind"),
        (Header { magic: 7, ..good }, "header.magic"),
        (Header { epoch: 5, ..good }, "session"),
    ] {
        assert_eq!(refused(script.world.call_raw(header, |_| ())).field, field);
    }
    let endless = |payload: &mut [u8]| payload[..4].fill(0xff);
    assert_eq!(refused(script.world.call_raw(good, endless)).field, "ticks");
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for round in 0..10_000 {
        let header = Header {
            kind: if round % 5 == 0 { kind::ASK } else { kind::LIVE },
            rows: rng.random_range(0..33),
            flags: rng.random(),
            ..good
        };
        let sent = script.world.call_raw(header, |payload| {
            payload.fill(0);
            for word in payload.as_chunks_mut::<4>().0 {
                let small: u32 = rng.random_range(0..40);
                *word = if rng.random_ratio(1, 9) { small } else { 0 }.to_le_bytes();
            }
        });
        assert!(matches!(sent, Ok(()) | Err(CallError::Refused(_))), "{sent:?}");
    }
    script.send("PSM1", &Command::State(StateCommand::Disable));
    script.advance(1);
    assert_eq!(script.state("PSM1").state, State::Disabled);
}

#[test]
fn pictures_are_those_of_an_environment() {
    let server = Server::start();
    let size = OptionValue::Numbers(vec![24.0, 32.0]);
    let request =
        SessionRequest::new("NeedlePick-v0").seed(3).view(Options::new().with("image_size", size));
    let mut session = server.connect().open(&request).unwrap();
    session.reset().unwrap();
    let mut world = server.connect().open_live(&request).unwrap();
    assert_eq!(world.info().view, session.info().view);
    let picture = session.render(0, false).unwrap().picture_rgb().to_vec();
    assert_eq!(picture.len(), 24 * 32 * 3);
    assert_eq!(world.render().unwrap(), picture);
    let depth = session.render(0, true).unwrap().picture_depth().to_vec();
    assert_eq!(world.render_depth().unwrap(), depth);
    for word in [StateCommand::Enable, StateCommand::Home] {
        world.command("PSM1", &Command::State(word)).unwrap();
    }
    world.advance(240).unwrap();
    assert_ne!(world.render().unwrap(), picture);
    let mut blind = server.connect().open_live(&SessionRequest::new("NeedlePick-v0")).unwrap();
    assert_eq!(refused(blind.render()).code, Code::Unsupported);
    blind.advance(1).unwrap();
}

#[test]
fn a_server_that_ends_in_the_middle_of_a_long_wait_says_so() {
    let server = Server::start();
    let live = LiveRequest { speed: Some(1.0), ..LiveRequest::default() };
    let mut script = Script::open(&server, &SessionRequest::new("NeedleReach-v0").live(live));
    server.connect().shut_down().unwrap();
    let error = script.world.advance(24_000_000).unwrap_err();
    assert!(matches!(error, CallError::ServerLost { .. }), "{error}");
}
