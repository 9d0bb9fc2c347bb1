//! Live worlds: arms that answer dVRK's commands in a task's world, in lock-step.

use nalgebra::{UnitQuaternion, Vector3};
use trocar_proto::{OptionValue, Options};
use trocar_server::Registry;
use trocar_server::dvrk::{
    ArmController, Command, Homing, OperatingState, Pose, PoseMessage, State, StateCommand, TICK,
    What,
};
use trocar_server::env::{Env, LiveWorld};
use trocar_server::sim::random::Rng;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Angle of jaws that are open, rad.
const OPEN: f64 = 40.0 * DEGREE;

/// Angle of jaws that squeeze, rad.
const CLOSE: f64 = -20.0 * DEGREE;

/// How far above a grasp an arm comes first, m.
const HOVER: f64 = 0.02;

/// From the wrist-yaw axis to the tip, m: `measured_cp` is the former.
const TIP: f64 = 0.0102;

fn make(id: &str, seed: u64, homing: Homing) -> LiveWorld {
    let mut env = Registry::builtin().make(id, &Options::new()).unwrap();
    env.reset(Some(seed));
    LiveWorld::new(env, homing).unwrap()
}

/// What an environment shows, and its world, as bits.
fn bits(env: &Env) -> Vec<u32> {
    let (observation, goals) = seen(env);
    let shown = observation.iter().chain(goals.iter().flatten()).map(|number| number.to_bits());
    shown.chain(env.world().bits()).collect()
}

/// Observation, achieved and desired goal.
fn seen(env: &Env) -> (Vec<f32>, [Vec<f32>; 2]) {
    let spec = env.spec();
    let mut observation = vec![0.0; spec.observation_dim()];
    let mut goals = [vec![0.0; spec.goal_dim()], vec![0.0; spec.goal_dim()]];
    let [achieved, desired] = &mut goals;
    env.observe(&mut observation, achieved, desired);
    (observation, goals)
}

fn vector(numbers: &[f32]) -> Vector3<f64> {
    Vector3::from_iterator(numbers.iter().take(3).map(|number| f64::from(*number)))
}

/// A script in a world: it sends commands and waits for their ends.
struct Script {
    world: LiveWorld,
    /// What the arms did not do as they were told, in words.
    complaints: Vec<String>,
    reached: Vec<bool>,
}

impl Script {
    fn new(world: LiveWorld) -> Self {
        Self { world, complaints: vec![], reached: vec![] }
    }

    fn state(&self, arm: &str) -> OperatingState {
        self.world.arm(arm).unwrap().operating_state()
    }

    fn send(&mut self, arm: &str, command: &Command) {
        self.world.arm_mut(arm).unwrap().command(command);
    }

    fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / TICK).round() as u32 {
            self.tick();
        }
    }

    fn tick(&mut self) {
        self.world.tick().unwrap();
        let names: Vec<String> = self.world.arms().map(|arm| arm.name().to_string()).collect();
        for name in names {
            for event in self.world.arm_mut(&name).unwrap().take_events() {
                match event.what {
                    What::Warning(warning) => self.complaints.push(warning.to_string()),
                    What::Error(error) => self.complaints.push(error.to_string()),
                    What::GoalReached(reached) => self.reached.push(reached),
                    _ => {}
                }
            }
        }
    }

    /// Sends a command and waits until the arm is not busy; the time that it took, s.
    fn wait(&mut self, arm: &str, command: &Command) -> f64 {
        self.send(arm, command);
        let mut ticks = 0;
        while self.state(arm).is_busy {
            self.tick();
            ticks += 1;
            assert!(ticks < 7200, "{arm} is busy for 30 s with {command:?}");
        }
        f64::from(ticks) * TICK
    }

    fn enable_and_home(&mut self, arm: &str) {
        self.wait(arm, &Command::State(StateCommand::Enable));
        self.wait(arm, &Command::State(StateCommand::Home));
        assert!(self.state(arm).is_homed);
    }

    /// `move_cp` to a pose in the world.
    fn move_to(&mut self, arm: &str, world_from_wrist: &Pose) -> f64 {
        let base_from_wrist = self.world.world_from_base(arm).unwrap().inv_mul(world_from_wrist);
        self.wait(arm, &Command::MoveCp(PoseMessage::new(&base_from_wrist)))
    }

    fn jaw(&mut self, arm: &str, angle: f64) {
        self.wait(arm, &Command::JawMoveJp(vec![angle]));
    }

    /// The wrist in the world, as the encoders have it.
    fn wrist(&self, arm: &str) -> Pose {
        let base_from_wrist = self.world.arm(arm).unwrap().measured_cp().unwrap();
        self.world.world_from_base(arm).unwrap() * base_from_wrist
    }
}

fn raised(pose: &Pose, height: f64) -> Pose {
    Pose::translation(0.0, 0.0, height) * pose
}

/// Jaws straight down that close across a horizontal direction, turned as little as possible from straight on.
fn jaws_across(along: &Vector3<f64>) -> UnitQuaternion<f64> {
    let half = std::f64::consts::PI;
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), half);
    let turn = along.y.atan2(along.x);
    let turn = turn - half * (turn / half).round();
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * down
}

/// Picks the needle of NeedlePick and brings it to the goal.
fn pick_needle(script: &mut Script) {
    script.enable_and_home("PSM1");
    let (observation, [achieved, desired]) = seen(script.world.env());
    // The middle of the needle's arc, and its axes: y lies along the wire.
    let middle = vector(&achieved);
    let [roll, pitch, yaw] = [16, 17, 18].map(|index| f64::from(observation[index]));
    let wire = UnitQuaternion::from_euler_angles(roll, pitch, yaw) * Vector3::y();
    let at = middle + Vector3::z() * (TIP - 0.45e-3);
    let grasp = Pose::from_parts(at.into(), jaws_across(&wire));
    script.jaw("PSM1", OPEN);
    script.move_to("PSM1", &raised(&grasp, HOVER));
    script.move_to("PSM1", &grasp);
    script.jaw("PSM1", CLOSE);
    script.move_to("PSM1", &raised(&grasp, HOVER));
    let (_, [achieved, _]) = seen(script.world.env());
    let here = script.wrist("PSM1");
    let way = vector(&desired) - vector(&achieved);
    script.move_to("PSM1", &(Pose::from(way) * here));
}

#[test]
fn a_needle_is_picked_and_placed_by_commands_of_a_robot_alone() {
    for seed in 0..10 {
        let mut script = Script::new(make("NeedlePick-v0", seed, Homing::ToZero));
        let began = script.world.evaluate();
        assert!(!began.is_success && began.reward == -1.0);
        let lies = script.world.objects().next().unwrap().1.translation.z;
        pick_needle(&mut script);
        let is = script.world.evaluate();
        assert!(is.is_success && is.reward == 0.0, "seed {seed}: {:?}", script.complaints);
        let (name, pose) = script.world.objects().next().unwrap();
        assert!(name == "needle" && pose.translation.z > lies + 5e-3);
        assert!(script.complaints.is_empty(), "seed {seed}: {:?}", script.complaints);
        assert!(script.reached.iter().all(|reached| *reached));
        // The jaws are kept open by the needle.
        let jaw = script.world.arm("PSM1").unwrap().jaw_measured_js().unwrap().position[0];
        assert!(jaw > 0.02 && jaw < 0.3, "{jaw}");
    }
}

/// Lets the expert of a task act, by servoed poses and jaw angles at 100 Hz, until it succeeds or for `steps` steps.
fn act(script: &mut Script, steps: u32) -> bool {
    let names: Vec<String> = script.world.arms().map(|arm| arm.name().to_string()).collect();
    for name in &names {
        script.enable_and_home(name);
    }
    for _ in 0..steps {
        let mut action = vec![0.0; script.world.env().spec().action_dim()];
        script.world.env().expert(&mut action);
        // Where a step would bring the arms.
        let mut copy = script.world.env().clone();
        let profiles = copy.drive().unwrap().command(&action).unwrap();
        for now in 1..=48 {
            if now * 100 / 240 > (now - 1) * 100 / 240 {
                for (name, profile) in names.iter().zip(&profiles) {
                    let goal = profile.at(now, now, 48);
                    let base_from_world = script.world.world_from_base(name).unwrap().inverse();
                    let pose = PoseMessage::new(&(base_from_world * goal.world_from_wrist));
                    script.send(name, &Command::ServoCp(pose));
                    script.send(name, &Command::JawServoJp(vec![goal.jaw]));
                }
            }
            script.tick();
        }
        if script.world.evaluate().is_success {
            return true;
        }
    }
    false
}

#[test]
fn experts_pick_hand_over_and_place_by_commands_of_a_robot_alone() {
    for id in [
        "NeedleReach-v0",
        "NeedlePick-v0",
        "GauzeRetrieve-v0",
        "PegTransfer-v0",
        "NeedleRegrasp-v0",
        "BiPegTransfer-v0",
    ] {
        for seed in 0..4 {
            // Homed in place, the arms keep what they hold.
            let mut script = Script::new(make(id, seed, Homing::InPlace));
            assert!(act(&mut script, 100), "{id} {seed}: {:?}", script.complaints);
            assert!(script.complaints.is_empty(), "{id} {seed}: {:?}", script.complaints);
        }
    }
}

#[test]
fn the_same_commands_give_the_same_bits_also_from_a_snapshot() {
    let random = |rng: &mut Rng| {
        let joints = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0].map(|q: f64| q + 0.1 * rng.uniform(-1.0, 1.0));
        match rng.index(4) {
            0 => Command::MoveJp(joints.to_vec()),
            1 => Command::servo_jp(&joints),
            2 => Command::JawMoveJp(vec![rng.uniform(-0.3, 1.0)]),
            _ => Command::Hold,
        }
    };
    let play = |script: &mut Script, rng: &mut Rng| -> Vec<Vec<u32>> {
        let mut all = vec![];
        for _ in 0..60 {
            script.send("PSM1", &random(rng));
            script.run(0.1);
            all.push(bits(script.world.env()));
        }
        all
    };
    let mut script = Script::new(make("NeedlePick-v0", 2, Homing::ToZero));
    pick_needle(&mut script);
    let mut again = Script::new(make("NeedlePick-v0", 2, Homing::ToZero));
    pick_needle(&mut again);
    assert_eq!(bits(script.world.env()), bits(again.world.env()));
    let mut restored = Script::new(script.world.clone());
    let one = play(&mut script, &mut Rng::new(5, 0));
    let other = play(&mut again, &mut Rng::new(5, 0));
    let third = play(&mut restored, &mut Rng::new(5, 0));
    assert!(one == other && one == third, "worlds differ");
}

#[test]
fn an_arm_in_free_space_is_where_its_set_points_are() {
    let mut script = Script::new(make("NeedlePick-v0", 0, Homing::ToZero));
    script.enable_and_home("PSM1");
    let mut took = 0.0;
    for step in [10.0, -20.0, 10.0] {
        let mut joints = script.world.arm("PSM1").unwrap().setpoint_js().position.to_vec();
        joints[0] += step * DEGREE;
        joints[1] -= step * DEGREE;
        script.send("PSM1", &Command::MoveJp(joints));
        while script.state("PSM1").is_busy {
            script.tick();
            let arm = script.world.arm("PSM1").unwrap();
            assert_eq!(arm.measured_js().position, arm.setpoint_js().position);
            took += TICK;
        }
    }
    assert!((2.276..2.276 + 6.0 * TICK).contains(&(took + 1e-3)), "{took}");
    // What the task sees is what the encoders say, as far as its specification has it.
    let start = script.wrist("PSM1");
    let middle = Vector3::new(0.55, 0.0, 0.72);
    script.move_to("PSM1", &Pose::from_parts(middle.into(), start.rotation));
    let wrist = script.wrist("PSM1");
    assert!((wrist.translation.vector - middle).norm() < 1e-9);
    let (observation, _) = seen(script.world.env());
    assert!((vector(&observation) - wrist.translation.vector).norm() < 1e-6);
}

#[test]
fn an_arm_that_is_held_up_stops_and_comes_away_at_once() {
    let mut script = Script::new(make("NeedlePick-v0", 0, Homing::ToZero));
    script.enable_and_home("PSM1");
    let start = script.wrist("PSM1");
    // Far from the needle, down through the table.
    let side = Pose::translation(0.0, -0.03, 0.0) * start;
    script.move_to("PSM1", &side);
    script.move_to("PSM1", &raised(&side, -0.075));
    let held = script.wrist("PSM1");
    let sunk = script.world.arm("PSM1").unwrap().setpoint_js().position[2];
    let is = script.world.arm("PSM1").unwrap().measured_js().position[2];
    assert!(held.translation.z - TIP > 0.67, "it went on to {}", held.translation.z);
    assert!(sunk - is > 5e-3, "the set-point is at {sunk} m, the arm at {is} m");
    assert!(script.state("PSM1").state == State::Enabled, "{:?}", script.complaints);
    // A second later it is still there, and does not queue up what it was told meanwhile.
    script.run(1.0);
    script.move_to("PSM1", &side);
    let back = script.wrist("PSM1");
    assert!((back.translation.vector - side.translation.vector).norm() < 1e-6);
}

#[test]
fn floor_and_walls_stop_an_instrument_in_the_world_of_every_task() {
    /// The tray's floor and the tops of all tables are higher, m.
    const FLOOR: f64 = 0.673;
    let registry = Registry::builtin();
    for id in registry.ids() {
        let mut script = Script::new(make(id, 0, Homing::ToZero));
        if script.world.arm("PSM1").is_none() {
            let names: Vec<_> = script.world.arms().map(ArmController::name).collect();
            assert_eq!(names, ["ECM"], "{id}: the endoscope's arm touches nothing");
            continue;
        }
        script.enable_and_home("PSM1");
        // Down, and then to both sides, into the tray's walls.
        for yaw in [0.0, 0.6, -0.6] {
            script.wait("PSM1", &Command::MoveJp(vec![yaw, 0.0, 0.235, 0.0, 0.0, 0.0]));
            script.run(0.5);
            let wrist = script.wrist("PSM1").translation.vector;
            assert!(wrist.z > FLOOR, "{id}: the wrist is at {wrist}");
            if script.state("PSM1").state == State::Fault {
                script.enable_and_home("PSM1");
            }
        }
    }
}

#[test]
fn a_jump_that_an_arm_does_not_follow_faults_it() {
    let mut script = Script::new(make("NeedlePick-v0", 0, Homing::ToZero));
    script.enable_and_home("PSM1");
    script.send("PSM1", &Command::servo_jp(&[60.0 * DEGREE, 0.0, 0.12, 0.0, 0.0, 0.0]));
    script.tick();
    assert_eq!(script.state("PSM1").state, State::Fault);
    assert!(script.complaints[0].contains("tracking error"), "{:?}", script.complaints);
    // It stays where it came to in a tick, and comes back from there.
    let there = script.wrist("PSM1");
    script.run(0.5);
    assert_eq!(script.wrist("PSM1"), there);
    script.enable_and_home("PSM1");
}

#[test]
fn the_endoscope_beside_instruments_holds_the_camera_and_touches_nothing() {
    let camera = |script: &Script| script.world.env().scene().endoscope.unwrap();
    let env = make("NeedlePick-v0", 0, Homing::ToZero).into_env();
    let mut script = Script::new(make("NeedlePick-v0", 0, Homing::ToZero));
    let mut twin = Script::new(make("NeedlePick-v0", 0, Homing::ToZero));
    let began = camera(&script);
    assert!(!began.is_fixed, "it may move");
    script.enable_and_home("ECM");
    twin.run(script.wait("ECM", &Command::MoveJp(vec![0.1, 0.2, 0.1, 0.3])) + 10.0);
    let goal = script.world.arm("ECM").unwrap().measured_js().position;
    assert_eq!(goal[..], [0.1, 0.2, 0.1, 0.3]);
    let off = began.world_from_camera.inv_mul(&camera(&script).world_from_camera);
    assert!(off.translation.vector.norm() > 0.03 && off.rotation.angle() > 0.3, "{off}");
    // The same world but for the time.
    let objects = |script: &Script| script.world.objects().map(|(_, at)| at).collect::<Vec<_>>();
    assert_eq!(objects(&script), objects(&twin));
    // Out of the controllers' hands, it is back at the next reset.
    let mut again = script.world.into_env();
    again.reset(Some(0));
    let camera_of = |env: &Env| env.scene().endoscope.unwrap().world_from_camera;
    assert_eq!(camera_of(&again), began.world_from_camera);
    assert!(again.scene().endoscope.unwrap().is_fixed && camera_of(&env) == camera_of(&again));
}

#[test]
fn both_arms_of_a_task_move_at_the_same_time() {
    let mut script = Script::new(make("BiPegTransfer-v0", 0, Homing::ToZero));
    let names: Vec<_> = script.world.arms().map(ArmController::name).collect();
    assert_eq!(names, ["PSM1", "PSM2", "ECM"]);
    for arm in ["PSM1", "PSM2"] {
        script.send(arm, &Command::State(StateCommand::Enable));
        script.send(arm, &Command::State(StateCommand::Home));
    }
    script.run(3.0);
    let before = ["PSM1", "PSM2"].map(|arm| script.wrist(arm));
    for arm in ["PSM1", "PSM2"] {
        script.send(arm, &Command::MoveJr(vec![0.05, 0.0, 0.0, 0.0, 0.0, 0.0]));
    }
    script.run(1.0);
    for (arm, before) in ["PSM1", "PSM2"].into_iter().zip(before) {
        let moved = (script.wrist(arm).translation.vector - before.translation.vector).norm();
        assert!((moved - 0.05 * 0.1135).abs() < 1e-4, "{arm}: {moved}");
    }
    assert!(script.world.arm_mut("PSM3").is_none());
}

#[test]
fn the_endoscope_of_a_task_is_an_arm_too() {
    let mut script = Script::new(make("EcmReach-v0", 0, Homing::ToZero));
    script.enable_and_home("ECM");
    let (_, [achieved, desired]) = seen(script.world.env());
    let camera = script.wrist("ECM");
    assert!((vector(&achieved) - camera.translation.vector).norm() < 1e-6);
    assert!(!script.world.evaluate().is_success);
    let way = vector(&desired) - vector(&achieved);
    script.move_to("ECM", &(Pose::from(way) * camera));
    assert!(script.world.evaluate().is_success, "{:?}", script.complaints);
}

#[test]
fn encoders_that_err_reach_their_set_points_and_the_arm_is_elsewhere() {
    let rows = [("joint_offset".to_string(), vec![0.01, 0.02])].into();
    let options = Options::new().with("domain", OptionValue::Table(rows));
    let mut env = Registry::builtin().make("NeedlePick-v0", &options).unwrap();
    env.reset(Some(0));
    let mut script = Script::new(LiveWorld::new(env, Homing::ToZero).unwrap());
    script.enable_and_home("PSM1");
    let arm = script.world.arm("PSM1").unwrap();
    let off = |(is, asked): (&f64, &f64)| (is - asked).abs() < 1e-12;
    let [measured, set] = [arm.measured_js().position, arm.setpoint_js().position];
    assert!(measured.iter().zip(&set).all(off), "{measured:?} {set:?}");
    // The picture shows where it truly is.
    let scene = script.world.env().scene();
    let body = scene.body("psm1 wrist_yaw_link").or_else(|| scene.body("psm1 jaw_1_link")).unwrap();
    let drawn = scene.instances().iter().find(|part| part.body == body).unwrap().world_from_mesh;
    let wrist = script.wrist("PSM1").translation.vector;
    let apart = (drawn.translation.vector - wrist).norm();
    assert!((1e-3..10e-3).contains(&apart), "{apart}");
}

#[test]
fn an_episode_that_was_live_is_no_recording_and_may_be_reset() {
    let mut script = Script::new(make("NeedlePick-v0", 3, Homing::ToZero));
    script.enable_and_home("PSM1");
    let mut env = script.world.into_env();
    assert!(env.export().is_err() && env.clamped().is_empty());
    env.reset(Some(3));
    assert!(env.export().is_ok());
}

#[test]
fn nothing_explodes_whatever_is_commanded() {
    for (id, seed) in [("NeedlePick-v0", 1), ("BiPegTransfer-v0", 2), ("GauzeRetrieve-v0", 3)] {
        let mut script = Script::new(make(id, seed, Homing::ToZero));
        let names: Vec<String> = script.world.arms().map(|arm| arm.name().to_string()).collect();
        let mut rng = Rng::new(seed, 0);
        for round in 0..600 {
            let name = &names[rng.index(names.len())];
            if !script.state(name).is_homed {
                // The other arm may be in the way.
                script.send(name, &Command::State(StateCommand::Enable));
                script.wait(name, &Command::State(StateCommand::Home));
            }
            // Into the table, into each other, at any speed and with jaws that snap.
            let size = if round % 50 == 0 { 1.0 } else { 0.2 };
            let mut joints = [0.0, 0.0, 0.14, 0.0, 0.0, 0.0];
            for joint in &mut joints {
                *joint += size * rng.uniform(-1.0, 1.0);
            }
            joints[2] = rng.uniform(0.07, 0.22);
            let command = match rng.index(5) {
                0 => Command::servo_jp(&joints),
                1 | 2 => Command::MoveJp(joints.to_vec()),
                3 => Command::JawServoJp(vec![rng.uniform(-0.7, 1.4)]),
                _ => Command::JawMoveJp(vec![rng.uniform(-0.7, 1.4)]),
            };
            script.send(name, &command);
            script.run(0.1 * rng.unit());
        }
        for (name, pose) in script.world.objects() {
            assert!(pose.translation.vector.norm() < 10.0, "{id}: {name} is at {pose}");
        }
        assert!(script.world.evaluate().reward.is_finite());
    }
}

#[test]
fn what_cannot_be_live_is_refused() {
    let registry = Registry::builtin();
    let never_reset = registry.make("NeedlePick-v0", &Options::new()).unwrap();
    assert_eq!(LiveWorld::new(never_reset, Homing::ToZero).err().unwrap().field, "env");
    let tied = Options::new().with_text("grasp", "weld");
    let mut env = registry.make("NeedlePick-v0", &tied).unwrap();
    env.reset(Some(0));
    assert_eq!(LiveWorld::new(env, Homing::ToZero).err().unwrap().field, "options.grasp");
}
