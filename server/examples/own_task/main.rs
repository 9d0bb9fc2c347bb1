//! A task of one's own, served to Rust and Python: a PSM pushes a cube along a board to a goal.
//!
//! ```sh
//! cargo run --release --example own_task -- own     # serves as "own" until Ctrl-C
//! ```
//!
//! Python then has it after `trocar.register_all(server="own")`, as `gym.make("trocar/PushCube-v0")`.

use anyhow::Context;
use nalgebra::Vector3;
use trocar_proto::builtin::TaskInfo;
use trocar_proto::goal::SuccessRule;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection};
use trocar_server::assets::Scene;
use trocar_server::sim::frames::{self, Aabb, Pose};
use trocar_server::sim::instrument::{CLEARANCE, JAW_CLOSED, TIP_OFFSET};
use trocar_server::sim::random::Rng;
use trocar_server::sim::world::{BodyId, Solver, World};
use trocar_server::tasks::expert::{ArmView, ExpertInput};
use trocar_server::tasks::options::{self, Preset};
use trocar_server::tasks::psm_scene::{PaperAction, PsmArm, Station, Turn};
use trocar_server::tasks::{Arms, Registered, State};
use trocar_server::{Registry, ServerConfig, StopSignal, Task, serve};

/// Where cubes start, m: those of the whole range along x lie in front of the arm's start.
const STARTS: Aabb = Aabb::new([0.53, -0.03, 0.0], [0.55, 0.03, 0.0]);

/// How far they are to go along x, m.
const DISTANCES: [f64; 2] = [0.02, 0.035];

/// Where the cube is observed, m.
const THEATRE: Aabb = Aabb::new([0.4, -0.2, 0.5], [0.7, 0.2, 0.9]);

/// Distance below which the goal is reached, m.
const TOLERANCE: f32 = 0.003;

/// Coefficient of friction between cube and board.
const FRICTION: f64 = 0.4;

/// Where the expert's tip waits behind the cube, m from its middle.
const BEHIND: f64 = 0.012;

/// The task.
#[derive(Clone)]
struct PushCube {
    arm: PsmArm,
    cube: BodyId,
    /// Height of a cube that lies on the board, m.
    height: f64,
    goal: Vector3<f64>,
}

impl Registered for PushCube {
    const INFO: TaskInfo = TaskInfo {
        id: "PushCube-v0",
        summary: "Push a cube along a board to a goal.",
        steps: 50,
        hertz: 5.0,
        tags: &[],
    };

    fn options() -> Vec<OptionSpec> {
        vec![options::reward(), options::action(), options::observation(), options::domain()]
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let scene = Scene::from_urdf(include_str!("scene.urdf"))?;
        let mut world = World::new(Solver::LIGHT);
        let cube = scene.insert(&mut world, FRICTION)["cube"];
        let (board, at) = scene.body("board");
        let paper = PaperAction { turn: Turn::Nothing, jaw: false };
        let start = [0.50, 0.0, 0.70 + TIP_OFFSET];
        let station = Station::psm1(start, board.aabb(&at).max.z);
        let task = Self {
            arm: PsmArm::insert(&mut world, options, paper, station)?,
            cube,
            height: scene.body("cube").1.translation.z,
            goal: Vector3::zeros(),
        };
        Ok((task, world))
    }
}

impl Task for PushCube {
    fn action(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    fn goal(&self) -> Option<GoalSpec> {
        Some(GoalSpec {
            elements: options::position_elements("cube", "scene", &THEATRE, Preset::Paper),
            success: SuccessRule::Distance { tolerance: TOLERANCE },
        })
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        let mut along = |axis: usize| rng.uniform(STARTS.min[axis], STARTS.max[axis]);
        let start = Vector3::new(along(0), along(1), self.height);
        world.place(self.cube, &frames::pose(start.into(), [0.0; 3]));
        self.goal = start + Vector3::x() * rng.uniform(DISTANCES[0], DISTANCES[1]);
        self.arm.reset(world, rng);
    }

    fn command(&mut self, _: &mut World, action: Option<&[f32]>) {
        self.arm.command(action);
    }

    fn arms(&mut self) -> Arms<'_> {
        [&mut self.arm].into_iter().collect()
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        self.arm.state(world, state);
        let cube = world.pose(self.cube).translation.vector;
        state.position("cube", "scene", &THEATRE, Preset::Paper, &cube);
    }

    fn goals(&self, world: &World, achieved: &mut [f32], desired: &mut [f32]) {
        let cube = world.pose(self.cube).translation.vector;
        for axis in 0..3 {
            achieved[axis] = cube[axis] as f32;
            desired[axis] = self.goal[axis] as f32;
        }
    }

    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let [arm] = ArmView::of([&self.arm], world, input);
        let tip = (arm.aim * Pose::translation(0.0, 0.0, TIP_OFFSET)).translation.vector;
        let cube = input.pose(world, self.cube).translation.vector;
        let low = self.height - 0.006 + CLEARANCE;
        let behind = Vector3::new(cube.x - BEHIND, cube.y, low);
        let to_behind = behind - tip;
        let lined_up = to_behind.y.abs() < 1e-3 && to_behind.z.abs() < 1e-3;
        let way = if lined_up {
            Vector3::new(self.goal.x - cube.x, to_behind.y, to_behind.z)
        } else {
            to_behind
        };
        arm.act(&(Pose::from(way) * arm.aim), JAW_CLOSED, action);
    }
}

fn main() -> anyhow::Result<()> {
    let name = std::env::args().nth(1).context("usage: own_task SERVER_NAME")?;
    let mut registry = Registry::builtin();
    registry.register::<PushCube>();
    let stop = StopSignal::default();
    let on_signal = stop.clone();
    ctrlc::set_handler(move || on_signal.set())?;
    serve(registry, &ServerConfig::new(name.parse()?), &stop, || {
        eprintln!("PushCube-v0 is served as {name:?}; Ctrl-C ends it");
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_expert_pushes_every_cube_to_its_goal_and_snapshots_go_on() {
        let mut registry = Registry::empty();
        registry.register::<PushCube>();
        let fresh = registry.make(PushCube::INFO.id, &Options::new()).unwrap();
        let mut env = fresh.clone();
        let mut action = vec![0.0; env.spec().action_dim()];
        for seed in 0..20 {
            env.reset(Some(seed));
            let mut copy: Option<trocar_server::Env> = None;
            let last = loop {
                env.expert(&mut action);
                let step = env.step(&action).unwrap();
                if let Some(copy) = &mut copy {
                    assert_eq!(copy.step(&action).unwrap(), step);
                } else if env.steps() == 12 {
                    copy = Some(fresh.import(&env.export().unwrap()).unwrap());
                }
                if step.truncated {
                    break step;
                }
            };
            assert!(last.is_success, "seed {seed}");
        }
    }
}
