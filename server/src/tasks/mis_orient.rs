//! Misorientation: the endoscope is rolled until its picture is aligned with the natural line of
//! sight.
//!
//! # Description
//!
//! The endoscope looks at the ground from somewhere, and its picture is turned against what a
//! surgeon would expect. The roll joint alone must take the misorientation θ* to zero: the angle of
//! [`camera::misorientation`](super::camera::misorientation), the rotation in the polar
//! decomposition of the affine map that takes the current picture to that of the nominal arm with
//! all joints at 0. A turn of the roll joint by q changes θ* by −q.
//!
//! # Action Space
//!
//! `action = "paper"`; the other modes are in [`ecm_scene`](super::ecm_scene).
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | increment of the roll joint | −1 | 1 | 3° |
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
//! | 5 | yaw | −π | π | rad |
//! | 6 | roll of the camera, world frame | −π | π | rad |
//! | 7 | pitch | −π/2 | π/2 | rad |
//! | 8 | yaw | −π | π | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll), of the camera with its
//! z axis against the view: those in the RCM frame are 0 for a straight arm. The position stays the
//! same in an episode under `paper`. Achieved goal: the true θ* (1 number, rad, in [−π, π]); desired
//! goal: 0. Both ignore `domain`'s noise and encoder errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where |θ*| < 0.01 rad, −1 otherwise. `dense`: −|θ*|, rad. Both are
//! functions of the goals alone.
//!
//! # Starting State
//!
//! Joints uniform: yaw ±45°, pitch −22.5° to 33.2°, insertion 0 to 0.24 m, roll ±45°, among those
//! with which the camera looks at the ground in front of that of the natural line of sight, and whose
//! θ* the roll joint can take away. That is less than 45 full actions away.
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
//!   [`ecm_scene`](super::ecm_scene); starts have an insertion of at least 1 mm. Not with
//!   `preset = "surrol"`.
//! - `domain`: `camera_pose_position` (m, up to 0.005 either way along each axis of the camera)
//!   and `camera_pose_angle` (rad, up to 0.05 either way about each): where the camera really is,
//!   seen from where the joint sensors have it, `observation_noise` (m, on observed positions),
//!   `joint_offset` (rad, on every rotary joint), `latency` (steps; the arm holds until the first
//!   action arrives).
//! - `setup`: `base` (x, y, z in m and pitch in rad of the arm's base). The starts are the same joints;
//!   the natural line of sight stays that of the nominal arm, in front of whose camera a straight arm
//!   must look at the ground.
//!
//! # Differences from the original
//!
//! - θ* is the rotation of the polar decomposition; the original multiplies by a transposed factor
//!   too many, which is another angle, under `preset = "surrol"` too.
//! - The affine map is taken around one point, not over axes of 0.1 m, so θ* is a smooth function
//!   with values in [−π, π] for every pose of the camera.
//! - dVRK's joint limits, ±88.9° for the roll; the original's turns without end.
//! - The expert makes full steps instead of 0.3 of them, which did not get there in 50 steps from
//!   every start.
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

use super::ecm_scene::{CAMERA_ANGLE, Control, EcmArm, RATE, STEP_ROLL, misorientation_element};
use super::expert::{ExpertInput, Sees};
use super::options;
use super::relative;
use super::{Registered, State, Task};
use crate::render::Scene;
use crate::sim::random::Rng;
use crate::sim::world::{Solver, World};

/// Joints at the start, rad; index 2 in m: smallest and largest. Source: the original.
const START: [[f64; 2]; 4] = [
    [-45.0 * DEGREE, 45.0 * DEGREE],
    [-22.5 * DEGREE, 33.2 * DEGREE],
    [0.0, 0.24],
    [-45.0 * DEGREE, 45.0 * DEGREE],
];

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Misorientation below which the picture counts as aligned, rad. Source: the paper.
const TOLERANCE: f32 = 0.01;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct MisOrient {
    arm: EcmArm,
}

impl Registered for MisOrient {
    const INFO: TaskInfo = builtin::MIS_ORIENT;

    fn options() -> Vec<OptionSpec> {
        vec![
            options::reward(),
            options::action(),
            options::observation(),
            options::preset(),
            options::arm(),
            RATE.option(5.0),
            Sees::option(),
            options::domain_with(
                options::camera_rows(CAMERA_ANGLE).into_iter().chain(options::ecm_rows()),
            ),
            options::setup(&EcmArm::setup_rows()),
        ]
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let mut arm = EcmArm::new(options, Control::Roll)?;
        arm.start_with(&[0.0; 4]);
        if !arm.starts_comparable() {
            let why = "a straight arm must look at the ground in front of the nominal camera";
            return Err(options::refuse_setup(options, why));
        }
        let task = Self { arm };
        Ok((task, World::new(Solver::HEAVY)))
    }
}

impl Task for MisOrient {
    fn action(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    fn goal(&self) -> Option<GoalSpec> {
        Some(GoalSpec {
            elements: vec![misorientation_element()],
            success: SuccessRule::Distance { tolerance: TOLERANCE },
        })
    }

    fn relative(&self, state: &[Element]) -> Relative {
        relative::looking(state, &[6], 1, &[0.5, 0.05, 0.01])
    }

    fn reset(&mut self, _: &mut World, rng: &mut Rng) {
        loop {
            let joints = START.map(|[low, high]| rng.uniform(low, high));
            self.arm.start_with(&joints);
            self.arm.reset(rng);
            let [least, most] = self.arm.roll_left();
            let levelled = (least..=most).contains(&self.arm.sensed_misorientation());
            if levelled && self.arm.starts_comparable() {
                break; // soon: near a straight arm, all starts are
            }
        }
    }

    fn command(&mut self, _: &mut World, action: Option<&[f32]>) {
        self.arm.command(action);
    }

    fn endoscope(&mut self) -> Option<&mut EcmArm> {
        Some(&mut self.arm)
    }

    fn state(&self, _: &World, state: &mut State<'_>) {
        self.arm.state(state);
        state.angles("camera", "world", self.arm.angles_in_world());
    }

    fn goals(&self, _: &World, achieved: &mut [f32], desired: &mut [f32]) {
        achieved[0] = self.arm.misorientation() as f32;
        desired[0] = 0.0;
    }

    fn scene(&self, _: &World, scene: &mut Scene) {
        self.arm.draw(scene);
    }

    fn expert(&self, _: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let arm = self.arm.ahead(input.in_flight);
        let most = STEP_ROLL * arm.rate().scale();
        let turn = arm.seen_misorientation(input.sees).clamp(-most, most);
        arm.encode(&Vector3::zeros(), turn, action);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks::time;

    #[test]
    fn every_start_is_misoriented_by_what_the_roll_joint_can_take_away() {
        for model in ["classic", "si"] {
            let options = Options::new().with_text("arm", model);
            let options = options.resolve(&MisOrient::options()).unwrap();
            let (mut task, mut world) = MisOrient::new(&options).unwrap();
            let (mut farthest, mut action) = (0.0_f64, [0.0]);
            for seed in 0..500 {
                task.reset(&mut world, &mut Rng::new(seed, 0));
                let start = task.arm.misorientation();
                let steps = (start.abs() / STEP_ROLL).ceil();
                farthest = farthest.max(steps);
                for _ in 0..steps as u32 {
                    task.expert(&world, &ExpertInput::default(), &mut action);
                    time::step(&mut task, &mut world, Some(&action), RATE.substeps());
                }
                let left = task.arm.misorientation();
                assert!(left.abs() < 1e-6, "{model} {seed}: {left} of {start}");
            }
            assert!((10.0..45.0).contains(&farthest), "{model}: {farthest}");
        }
    }
}
