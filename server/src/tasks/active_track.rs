//! Active tracking: the endoscope follows a red cube that moves among others.
//!
//! # Description
//!
//! A red cube moves at constant speed along a closed path on the ground, past 18 others. The
//! endoscope must keep it in the middle of its picture, and the picture level. Path, cubes,
//! observation and image point are described in [`path`](super::path) and [`track`](super::track).
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
//! straight arm. There are no goals: an observation is one vector.
//!
//! # Rewards
//!
//! 1 − (‖p‖ + 0.1 · |θ*|) for the image point p and the true θ* after the step: at most 1.
//!
//! # Starting State
//!
//! Joints 0, 0, 20 mm, 0. The target, 80 mm, starts at a random one of those points of its path
//! where all of it is in the picture, turned by up to ±90°, and goes round once in 200 steps (20 s):
//! at 0.16 m/s in the median, 0.10 to 0.25 m/s depending on the path's length. The other cubes, 80 mm too, have their
//! centres in x −0.5 to 0.6 m, y ±0.4 m, z 0.04 m, no two nearer than 0.12 m and none nearer than
//! that to the path; where that leaves too little room, the region grows by 1 mm on every side with
//! every place that is not free.
//!
//! # Episode End
//!
//! Terminated where the target is lost: no part of its outline, hidden or not, is in the picture.
//! Truncated after 500 steps of 0.1 s.
//!
//! # Options
//!
//! `action`, `observation`, and:
//!
//! - `"perceived"` in `observation`: numbers 6 to 8 come from the endoscope's picture, see
//!   [`track`](super::track); beside pictures it stands for `"state"`.
//! - `preset = "surrol"`: the reward is 1 − (‖p‖ / 2 + 0.1 · |w|) with the roll rate w of the
//!   original's law, 25 · θ*, rad/s, which also is number 9 of the observation; angles of dVRK's own
//!   camera frame, about ±π for a straight arm; actions with the opposite sign, as the original's
//!   control law takes them (inferred from its expert). Not reproduced: pixels, the original's joint
//!   limits and roll law (see [`static_track`](super::static_track)), its path, which does not go at
//!   constant speed and shoves other cubes aside, and its end of an episode.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see
//!   [`ecm_scene`](super::ecm_scene); not with `preset = "surrol"`.
//! - `domain`: `camera_pose_position` (m, up to 0.005 either way along each axis of the camera)
//!   and `camera_pose_angle` (rad, up to 0.05 either way about each): where the camera really is,
//!   seen from where the joint sensors have it, `observation_noise` (m, on observed positions),
//!   `joint_offset` (rad, on every rotary joint), `latency` (steps; the arm holds until the first
//!   action arrives).
//! - `setup`: `base` (x, y, z in m and pitch in rad of the arm's base). The start is the same joints,
//!   and must have the middle of the targets' region in the picture; the natural line of sight stays
//!   that of the nominal arm.
//!
//! # Differences from the original
//!
//! - The reward is the paper's; the original's halves the image error.
//! - The target moves at constant speed, as in the paper, and past the other cubes, which keep clear
//!   of its path; in the original it pushes them.
//! - Paths that swing out of their region by more than 100 mm are drawn again.
//! - The original ends an episode where the image point leaves x −1.2 to 1.1 or y ±1.1.
//! - What is said of image point, roll and cubes in [`static_track`](super::static_track).
//! - Seeds determine the episode, the path included.
//!
//! # Version History
//!
//! - v0: first version.

use trocar_proto::builtin::{self, TaskInfo};
use trocar_proto::spec::{Element, OptionSpec};
use trocar_proto::{Options, Rejection};

use super::camera::Cube;
use super::ecm_scene::{CAMERA_ANGLE, EcmArm, RATE};
use super::expert::{ExpertInput, Sees};
use super::options::{self, Preset};
use super::path::{self, LAP, Path};
use super::track::{Layout, Tracker};
use super::{Registered, State, Task};
use crate::render::Scene;
use crate::sim::random::Rng;
use crate::sim::world::{Solver, World};

/// Joints at the start, rad; index 2 in m. Source: the original.
const START: [f64; 4] = [0.0, 0.0, 0.02, 0.0];

/// The cubes. Source: the original.
const LAYOUT: Layout = Layout { edge: 0.08, region: [[-0.5, -0.4], [0.6, 0.4]], apart: 0.12 };

/// Largest turn of the target, rad. Source: the original.
const TARGET_YAW: f64 = std::f64::consts::FRAC_PI_2;

/// What a radian of misorientation costs, against an image error of 1. Source: the paper.
const ANGLE_WEIGHT: f64 = 0.1;

/// What the original multiplies the image error by.
const SURROL_IMAGE_WEIGHT: f64 = 0.5;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct ActiveTrack {
    tracker: Tracker,
    preset: Preset,
    path: Path,
    /// The stop at which it started.
    start: usize,
    /// Steps since then.
    steps: u32,
}

impl ActiveTrack {
    /// All cubes, the target first.
    pub fn cubes(&self) -> impl Iterator<Item = &Cube> {
        self.tracker.cubes()
    }

    /// Where the target goes.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Registered for ActiveTrack {
    const INFO: TaskInfo = builtin::ACTIVE_TRACK;

    fn options() -> Vec<OptionSpec> {
        vec![
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
        let tracker = Tracker::new(options, &START, LAYOUT.target(&path::middle(), 0.0))?;
        let path = Path::draw(&mut Rng::new(0, 0));
        let task = Self { tracker, preset: options::preset_of(options), path, start: 0, steps: 0 };
        Ok((task, World::new(Solver::HEAVY)))
    }
}

impl Task for ActiveTrack {
    fn action(&self) -> Vec<Element> {
        self.tracker.action_elements()
    }

    fn reset(&mut self, _: &mut World, rng: &mut Rng) {
        self.tracker.reset_arm(rng);
        let view = self.tracker.view();
        let yaw = rng.uniform(-TARGET_YAW, TARGET_YAW);
        let target = loop {
            self.path = Path::draw(rng);
            let in_picture =
                |step: &usize| view.holds(&LAYOUT.target(&self.path.at(*step as f64), yaw));
            let starts: Vec<_> = (0..LAP).filter(in_picture).collect();
            if let Some(last) = starts.len().checked_sub(1) {
                (self.start, self.steps) = (starts[rng.index(last + 1)], 0);
                break LAYOUT.target(&self.path.at(self.start as f64), yaw);
            }
        };
        let distractors = LAYOUT.distractors(self.path.stops(), rng);
        self.tracker.furnish(target, distractors);
    }

    fn command(&mut self, _: &mut World, action: Option<&[f32]>) {
        self.tracker.arm().command(action);
    }

    fn endoscope(&mut self) -> Option<&mut EcmArm> {
        Some(self.tracker.arm())
    }

    fn after_step(&mut self, _: &mut World) {
        self.steps += 1;
        self.between(0.0);
        self.tracker.look();
    }

    fn between(&mut self, part: f64) {
        let laps = (f64::from(self.steps) + part) * self.tracker.rate().scale();
        self.tracker.move_target(&self.path.at(self.start as f64 + laps));
    }

    fn state(&self, _: &World, state: &mut State<'_>) {
        self.tracker.state(state);
    }

    fn scene(&self, _: &World, scene: &mut Scene) {
        self.tracker.draw(scene);
    }

    fn expert(&self, _: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        self.tracker.expert(input, action);
    }

    fn reward(&self, _: &World) -> f32 {
        let image_weight = if self.preset == Preset::Surrol { SURROL_IMAGE_WEIGHT } else { 1.0 };
        let roll = self.tracker.roll_number(self.tracker.misorientation());
        let error = image_weight * self.tracker.sighting().point.norm();
        (1.0 - (error + ANGLE_WEIGHT * roll.abs())) as f32
    }

    fn terminated(&self, _: &World) -> bool {
        !self.tracker.sighting().in_picture
    }
}

#[cfg(test)]
mod tests {
    use trocar_proto::OptionValue;

    use super::*;
    use crate::tasks::time;

    fn episode(options: &Options, seed: u64) -> (ActiveTrack, World) {
        let options = options.resolve(&ActiveTrack::options()).unwrap();
        let (mut task, mut world) = ActiveTrack::new(&options).unwrap();
        task.reset(&mut world, &mut Rng::new(seed, 0));
        (task, world)
    }

    #[test]
    fn the_target_goes_its_path_and_passes_through_no_other_cube() {
        for seed in 0..50 {
            let (mut task, mut world) = episode(&Options::new(), seed);
            let start = task.start;
            for step in 0..LAP {
                let cubes: Vec<_> = task.cubes().map(|cube| cube.centre.coords.xy()).collect();
                assert_eq!(cubes[0], task.path().at((start + step) as f64));
                for other in &cubes[1..] {
                    // Corner to corner, two squares of 80 mm are 113.1 mm apart.
                    assert!((other - cubes[0]).norm() > 0.08 * 2f64.sqrt(), "{seed} {step}");
                }
                time::step(&mut task, &mut world, None, RATE.substeps());
            }
        }
    }

    #[test]
    fn every_target_starts_wholly_in_the_picture() {
        for seed in 0..200 {
            let (task, world) = episode(&Options::new(), seed);
            let target = task.cubes().next().unwrap();
            assert!(task.tracker.view().holds(target) && !task.terminated(&world), "{seed}");
        }
    }

    #[test]
    fn rewards_are_those_of_the_paper_and_of_the_original() {
        let surrol = Options::new().with_text("preset", "surrol");
        for seed in 0..20 {
            let (mut task, mut world) = episode(&Options::new(), seed);
            let (mut original, mut its_world) = episode(&surrol, seed);
            for step in 0..20 {
                let action = [1.0, -1.0, 0.5].map(|number: f32| number * (step % 3) as f32 * 0.5);
                time::step(&mut task, &mut world, Some(&action), RATE.substeps());
                let action = action.map(|number| -number);
                time::step(&mut original, &mut its_world, Some(&action), RATE.substeps());
                let error = task.tracker.sighting().point.norm();
                let angle = task.tracker.misorientation().abs();
                let reward = 1.0 - (error + 0.1 * angle);
                assert!((f64::from(task.reward(&world)) - reward).abs() < 1e-6);
                let reward = 1.0 - (error / 2.0 + 0.1 * 25.0 * angle);
                assert!((f64::from(original.reward(&its_world)) - reward).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn an_endoscope_that_rests_loses_the_target_once_none_of_it_is_in_the_picture() {
        let mut lost = 0;
        for seed in 0..50 {
            let (mut task, mut world) = episode(&Options::new(), seed);
            for _ in 0..LAP {
                time::step(&mut task, &mut world, None, RATE.substeps());
                let centre = task.tracker.sighting().point;
                if task.terminated(&world) {
                    // Its centre is beside the picture by less than its half diagonal and a step.
                    assert!((1.0..1.25).contains(&centre.amax()), "{seed}: {centre}");
                    assert!(!task.tracker.sighting().in_view);
                    lost += 1;
                    break;
                }
                assert!(centre.amax() < 1.2, "{seed}: {centre}");
            }
        }
        assert!(lost > 10, "{lost}");
    }

    #[test]
    fn the_expert_never_loses_the_target() {
        let soak = std::env::var_os("TROCAR_SOAK").is_some();
        let preset = |word: &str| Options::new().with_text("preset", word);
        let misplaced = |sign: f64| {
            let rows = [("camera_pose_position", 0.005), ("camera_pose_angle", CAMERA_ANGLE)];
            let rows = rows.map(|(row, end)| (row.to_string(), vec![sign * end; 2]));
            Options::new().with("domain", OptionValue::Table(rows.into()))
        };
        let paper = if soak { 500 } else { 10 };
        let ends = if soak { 20 } else { 2 };
        let variants = [
            (preset("paper"), paper),
            (preset("surrol"), paper),
            (misplaced(1.0), ends),
            (misplaced(-1.0), ends),
        ];
        for (options, episodes) in variants {
            let (mut returned, mut action) = (0.0, [0.0; 3]);
            for seed in 0..episodes {
                let (mut task, mut world) = episode(&options, seed);
                for step in 0..ActiveTrack::INFO.steps {
                    task.expert(&world, &ExpertInput::default(), &mut action);
                    time::step(&mut task, &mut world, Some(&action), RATE.substeps());
                    assert!(
                        !task.terminated(&world),
                        "{options:?} {seed}: lost after {step} steps"
                    );
                    returned += f64::from(task.reward(&world));
                }
            }
            let mean = returned / episodes as f64;
            assert!(mean > 470.0, "{options:?}: {mean}");
        }
    }
}
