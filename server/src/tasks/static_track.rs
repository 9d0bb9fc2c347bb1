//! Static tracking: the endoscope centres a red cube among others and keeps its picture level.
//!
//! # Description
//!
//! A red cube stands among 18 others of the same size. The endoscope must turn until the cube is in
//! the middle of its picture, while the misorientation θ* (see [`mis_orient`](super::mis_orient))
//! stays below 0.01 rad. Cubes, observation and image point are described in [`track`](super::track).
//!
//! # Action Space
//!
//! `action = "paper"`; what a velocity does, and the law by which the camera rolls meanwhile, is in
//! [`ecm_scene`](super::ecm_scene), and so are the other modes.
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | camera velocity to the right of the picture | −1 | 1 | 5 mm/s |
//! | 1 | camera velocity down | −1 | 1 | 5 mm/s |
//! | 2 | camera velocity forward | −1 | 1 | 5 mm/s |
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
//! | 6 | 1 where the target is in view, else 0 | 0 | 1 | 1 |
//! | 7 | image point x of the target, to the right | −2 | 2 | half a picture |
//! | 8 | image point y, down | −2 | 2 | half a picture |
//! | 9 | misorientation θ*, as sensed | −π | π | rad |
//!
//! The angles are extrinsic XYZ Euler angles of the camera with its z axis against the view, 0 for a
//! straight arm. Number 6 hardly ever leaves 1: some of every target is in the picture at the start,
//! and seldom wholly hidden. Achieved goal: image point x, y and the true θ* (3 numbers); desired goal: zeros.
//! Both ignore `domain`'s noise and encoder errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where the image point is less than 0.01 from the middle and
//! |θ*| < 0.01 rad, −1 otherwise. `dense`: minus the norm of the achieved goal. Both are functions
//! of the goals alone.
//!
//! # Starting State
//!
//! Joints 0, 0, 40 mm, 0. Cubes of 100 mm, their centres uniform in x ±0.5 m, y ±0.4 m, z 0.05 m, no
//! two nearer than 0.15 m; the target turned by up to ±90°, the others by up to ±180°. At
//! least a part of the target is in the picture.
//!
//! # Episode End
//!
//! Truncated after 50 steps of 0.1 s; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, and:
//!
//! - `"perceived"` in `observation`: numbers 6 to 8 come from the endoscope's picture, see
//!   [`track`](super::track); beside pictures it stands for `"state"`.
//! - `preset = "surrol"`: angles of dVRK's own camera frame, about ±π for a straight arm; actions
//!   with the opposite sign, as the original's control law takes them (inferred from its expert);
//!   number 9 is the roll rate of the original's law, 25 · θ*, rad/s. Not reproduced: pixels, dVRK's
//!   limits instead of the original's, and the original's law itself, see below.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see
//!   [`ecm_scene`](super::ecm_scene); not with `preset = "surrol"`.
//! - `domain`: `camera_pose_position` (m, up to 0.005 either way along each axis of the camera)
//!   and `camera_pose_angle` (rad, up to 0.004 either way about each): where the camera really is,
//!   seen from where the joint sensors have it (the law that levels the picture cannot know of it,
//!   and 0.01 must remain), `observation_noise` (m, on observed positions), `joint_offset` (rad,
//!   on every rotary joint), `latency` (steps; the arm holds until the first action arrives).
//! - `setup`: `base` (x, y, z in m and pitch in rad of the arm's base). The start is the same joints,
//!   and must have the middle of the targets' region in the picture; the natural line of sight stays
//!   that of the nominal arm.
//!
//! # Differences from the original
//!
//! - Success needs |θ*| < 0.01 rad, as in the paper; the original's test of it always holds, and its
//!   achieved goal has the roll rate in place of θ*.
//! - θ* is that of MisOrient, and the roll follows ω = θ* / 0.1 s. The original's is
//!   ω = 25 · δ · exp(−0.1 · ‖e‖), with another measure δ of the same turn and an image error e that
//!   only its expert sets, so that the camera rolls differently under any other policy.
//! - The image point comes from the target's outline instead of the pixels of a picture of
//!   256 × 256; cubes that stand before the target do not move it.
//! - Every cube finds a place. In the original one that does not stays at the origin.
//! - The expert turns by the target's angles instead of following an image Jacobian with gain 0.4.
//! - dVRK's joint limits; seeds determine the episode.
//!
//! # Version History
//!
//! - v0: first version.

use trocar_proto::builtin::{self, TaskInfo};
use trocar_proto::goal::SuccessRule;
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection};

use super::camera::Cube;
use super::ecm_scene::{EcmArm, RATE, misorientation_element};
use super::expert::{ExpertInput, Sees};
use super::options;
use super::relative;
use super::track::{Layout, Tracker, image_elements};
use super::{Registered, State, Task};
use crate::render::Scene;
use crate::sim::random::Rng;
use crate::sim::world::{Solver, World};

/// Joints at the start, rad; index 2 in m. Source: the original.
const START: [f64; 4] = [0.0, 0.0, 0.04, 0.0];

/// The cubes. Source: the original.
const LAYOUT: Layout = Layout { edge: 0.1, region: [[-0.5, -0.4], [0.5, 0.4]], apart: 0.15 };

/// Largest turn of the target, rad. Source: the original.
const TARGET_YAW: f64 = std::f64::consts::FRAC_PI_2;

/// Distance from the middle below which the target counts as centred, in halves of the picture.
/// Source: the paper.
const IMAGE_TOLERANCE: f32 = 0.01;

/// Misorientation below which the picture counts as level, rad. Source: the paper.
const ANGLE_TOLERANCE: f32 = 0.01;

/// Largest error of the camera's direction that episodes may draw, rad: the law that levels the picture
/// goes by the joint sensors, and what it cannot know must stay below [`ANGLE_TOLERANCE`].
const CAMERA_ANGLE: f64 = 0.004;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct StaticTrack {
    tracker: Tracker,
}

impl StaticTrack {
    /// All cubes, the target first.
    pub fn cubes(&self) -> impl Iterator<Item = &Cube> {
        self.tracker.cubes()
    }
}

impl Registered for StaticTrack {
    const INFO: TaskInfo = builtin::STATIC_TRACK;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] = &["target in view"];

    fn options() -> Vec<OptionSpec> {
        vec![
            options::reward(),
            options::action(),
            options::observation_or_perceived(),
            options::preset(),
            options::arm(),
            RATE.option(10.0),
            Sees::option(),
            options::domain_with(
                options::camera_rows(CAMERA_ANGLE).into_iter().chain(options::ecm_rows()),
            ),
            options::setup(&Tracker::setup_rows()),
        ]
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let target = LAYOUT.target(&nalgebra::Vector2::zeros(), 0.0);
        let tracker = Tracker::new(options, &START, target)?;
        let task = Self { tracker };
        Ok((task, World::new(Solver::HEAVY)))
    }
}

impl Task for StaticTrack {
    fn action(&self) -> Vec<Element> {
        self.tracker.action_elements()
    }

    fn goal(&self) -> Option<GoalSpec> {
        let [x, y] = image_elements();
        Some(GoalSpec {
            elements: vec![x, y, misorientation_element()],
            success: SuccessRule::Centred { image: IMAGE_TOLERANCE, angle: ANGLE_TOLERANCE },
        })
    }

    fn relative(&self, state: &[Element]) -> Relative {
        relative::looking(state, &[], 3, &[1.0, 0.1, 0.01])
    }

    fn reset(&mut self, _: &mut World, rng: &mut Rng) {
        let place = LAYOUT.place(rng);
        let target = LAYOUT.target(&place, rng.uniform(-TARGET_YAW, TARGET_YAW));
        let distractors = LAYOUT.distractors(&[place], rng);
        self.tracker.reset_arm(rng);
        self.tracker.furnish(target, distractors);
    }

    fn command(&mut self, _: &mut World, action: Option<&[f32]>) {
        self.tracker.arm().command(action);
    }

    fn endoscope(&mut self) -> Option<&mut EcmArm> {
        Some(self.tracker.arm())
    }

    fn after_step(&mut self, _: &mut World) {
        self.tracker.look();
    }

    fn state(&self, _: &World, state: &mut State<'_>) {
        self.tracker.state(state);
    }

    fn goals(&self, _: &World, achieved: &mut [f32], desired: &mut [f32]) {
        let point = self.tracker.sighting().point;
        achieved[0] = point.x as f32;
        achieved[1] = point.y as f32;
        achieved[2] = self.tracker.misorientation() as f32;
        desired.fill(0.0);
    }

    fn scene(&self, _: &World, scene: &mut Scene) {
        self.tracker.draw(scene);
    }

    fn expert(&self, _: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        self.tracker.expert(input, action);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_episode_has_nineteen_cubes_and_one_of_them_is_the_target() {
        let options = Options::new().resolve(&StaticTrack::options()).unwrap();
        let (mut task, mut world) = StaticTrack::new(&options).unwrap();
        for seed in 0..200 {
            task.reset(&mut world, &mut Rng::new(seed, 0));
            let cubes: Vec<_> = task.cubes().collect();
            assert_eq!(cubes.len(), 19);
            assert_eq!(cubes.iter().filter(|cube| cube.colour == cubes[0].colour).count(), 1);
            let place = cubes[0].centre;
            assert!(place.x.abs() <= 0.5 && place.y.abs() <= 0.4, "{place}");
            assert!(task.tracker.sighting().in_picture, "{seed}: {place}");
        }
    }
}
