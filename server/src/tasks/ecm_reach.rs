//! ECM reach: the endoscope goes to a position.
//!
//! # Description
//!
//! The end of the endoscope, which pivots about its remote centre of motion (RCM), must come within
//! 5 mm of a point. The roll joint, which does not move it, stays.
//!
//! # Action Space
//!
//! `action = "paper"`, each number in [−1, 1]; the other modes are in [`ecm_scene`](super::ecm_scene).
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | dx, RCM frame | −1 | 1 | 10 mm |
//! | 1 | dy, RCM frame | −1 | 1 | 10 mm |
//! | 2 | dz, RCM frame | −1 | 1 | 10 mm |
//!
//! # Observation Space
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | camera x, RCM frame, as sensed | −0.26 | 0.26 | m |
//! | 1 | camera y | −0.26 | 0.26 | m |
//! | 2 | camera z | −0.26 | 0.26 | m |
//! | 3 | roll of the camera, RCM frame | −π | π | rad |
//! | 4 | pitch | −π/2 | π/2 | rad |
//! | 5 | yaw; 0 while the roll joint is, as under `paper` | −π | π | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll), of the camera with its
//! z axis against the view, 0 for a straight arm. Achieved goal: the true position of the camera
//! (x, y, z, m, world frame); desired goal: the point. Both ignore `domain`'s noise and encoder
//! errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where the goals are less than 5 mm apart, −1 otherwise. `dense`: minus
//! their distance, m. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The camera at (0.50, 0, 0.70) m in the world, roll 0. The goal is uniform in x 0.45 to 0.55 m,
//! y −0.05 to 0.05 m, z 0.60 to 0.70 m, all of which the arm reaches; with another `setup`, among
//! the positions of this box that it reaches.
//!
//! # Episode End
//!
//! Truncated after 50 steps of 0.1 s; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, and:
//!
//! - `preset = "surrol"`: angles of dVRK's own camera frame, about ±π for a straight arm, as in the
//!   original.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see
//!   [`ecm_scene`](super::ecm_scene); not with `preset = "surrol"`.
//! - `domain`: `camera_pose_position` (m, up to 0.005 either way along each axis of the camera: where it
//!   really is, seen from where the joint sensors have it), `observation_noise` (m, on observed
//!   positions), `joint_offset` (rad, on every rotary joint), `latency` (steps; the arm holds until the
//!   first action arrives).
//! - `setup`: `base` (x, y, z in m and pitch in rad of the arm's base). The arm must reach the
//!   start and the corners of the goals' box.
//!
//! # Differences from the original
//!
//! - Angles that do not jump near the start.
//! - dVRK's joint limits; positions outside are not taken, silently.
//! - The expert goes at 0.3 of a full action instead of 0.2, since 0.2 covers at most 100 mm in 50
//!   steps and the farthest goals are 112 mm away along one axis.
//! - Seeds determine the episode.
//!
//! # Version History
//!
//! - v0: first version.

use nalgebra::Vector3;
use trocar_proto::builtin::{self, TaskInfo};
use trocar_proto::goal::SuccessRule;
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection};

use super::ecm_scene::{Control, EcmArm, RATE, STEP_LENGTH};
use super::expert::{ExpertInput, Sees};
use super::goal;
use super::options::{self, Preset};
use super::relative;
use super::{Registered, State, Task};
use crate::render::Scene;
use crate::sim::frames::Aabb;
use crate::sim::random::Rng;
use crate::sim::world::{Solver, World};

/// Where the camera starts, m, world frame. Source: the original.
const START: [f64; 3] = [0.50, 0.0, 0.70];

/// Where goals are, m, world frame. Source: the original.
const GOALS: Aabb = Aabb::new([0.45, -0.05, 0.60], [0.55, 0.05, 0.70]);

/// Distance below which the goal is reached, m. Source: the paper.
const TOLERANCE: f32 = 0.005;

/// Radius of the ball that marks the goal, m: it is seen from 2 m away.
const GOAL_RADIUS: f64 = 0.01;

/// The part of a full action with which the expert moves.
const EXPERT_SPEED: f64 = 0.3;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct EcmReach {
    arm: EcmArm,
    goal: Vector3<f64>,
}

impl Registered for EcmReach {
    const INFO: TaskInfo = builtin::ECM_REACH;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] = &["camera yaw"];

    fn options() -> Vec<OptionSpec> {
        // Where the camera is does not depend on its direction.
        let [camera_position, _] = options::camera_rows(0.0);
        vec![
            options::reward(),
            options::action(),
            options::observation(),
            options::preset(),
            options::arm(),
            RATE.option(5.0),
            Sees::option(),
            options::domain_with([camera_position].into_iter().chain(options::ecm_rows())),
            options::setup(&EcmArm::setup_rows()),
        ]
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let mut arm = EcmArm::new(options, Control::Position)?;
        if !arm.start_at(&START.into()) {
            return Err(options::refuse_setup(options, "the arm must reach its start"));
        }
        if !GOALS.corners().all(|corner| arm.reaches(&corner.coords)) {
            let why = "the arm must reach the corners of the goals' box within its joint limits";
            return Err(options::refuse_setup(options, why));
        }
        let task = Self { arm, goal: Vector3::zeros() };
        Ok((task, World::new(Solver::HEAVY)))
    }
}

impl Task for EcmReach {
    fn action(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    fn goal(&self) -> Option<GoalSpec> {
        // All that the arm reaches, 0.26 m around the remote centre, wherever its base stands.
        let positions = Aabb::new([-4.0, -4.0, -4.0], [4.0, 4.0, 4.0]);
        Some(GoalSpec {
            elements: options::position_elements("camera", "world", &positions, Preset::Paper),
            success: SuccessRule::Distance { tolerance: TOLERANCE },
        })
    }

    fn relative(&self, state: &[Element]) -> Relative {
        relative::looking(state, &[], 3, &[0.05, 0.01, 0.003])
    }

    fn reset(&mut self, _: &mut World, rng: &mut Rng) {
        let mut along = |axis: usize| rng.uniform(GOALS.min[axis], GOALS.max[axis]);
        self.goal = loop {
            let goal = Vector3::new(along(0), along(1), along(2));
            if self.arm.reaches(&goal) {
                break goal; // soon: the neighbourhoods of the corners are reached
            }
        };
        self.arm.reset(rng);
    }

    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        if !self.arm.reaches(goal) {
            return Err(goal::refuse(goal, "the arm does not reach it"));
        }
        self.goal = *goal;
        Ok(())
    }

    fn command(&mut self, _: &mut World, action: Option<&[f32]>) {
        self.arm.command(action);
    }

    fn endoscope(&mut self) -> Option<&mut EcmArm> {
        Some(&mut self.arm)
    }

    fn state(&self, _: &World, state: &mut State<'_>) {
        self.arm.state(state);
    }

    fn goals(&self, _: &World, achieved: &mut [f32], desired: &mut [f32]) {
        let camera = self.arm.world_from_camera().translation.vector;
        for axis in 0..3 {
            achieved[axis] = camera[axis] as f32;
            desired[axis] = self.goal[axis] as f32;
        }
    }

    fn scene(&self, _: &World, scene: &mut Scene) {
        self.arm.draw(scene);
        scene.add_goal(&self.goal, GOAL_RADIUS);
    }

    fn expert(&self, _: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let arm = self.arm.ahead(input.in_flight);
        let camera = arm.seen_camera(input.sees).translation.vector;
        let length = STEP_LENGTH * arm.rate().scale();
        let error = arm.in_rcm(&(self.goal - camera)) / length;
        let step = error * (EXPERT_SPEED * length / error.amax().max(1.0));
        arm.encode(&step, 0.0, action);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_goal_is_reachable_at_once() {
        for model in ["classic", "si"] {
            let options = Options::new().with_text("arm", model);
            let (task, _) = EcmReach::new(&options.resolve(&EcmReach::options()).unwrap()).unwrap();
            for index in 0..11 * 11 * 11 {
                let part = |divisor: usize| f64::from((index / divisor % 11) as u32) / 10.0;
                let parts = Vector3::new(part(1), part(11), part(121));
                let goal = GOALS.min + parts.component_mul(&(GOALS.max - GOALS.min));
                assert!(task.arm.reaches(&goal), "{model}: {goal}");
            }
        }
    }
}
