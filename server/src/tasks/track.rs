//! What the tracking tasks share: an endoscope, a target cube among other cubes on the ground, what
//! is observed of them, and the visual servo.
//!
//! Cubes stand on the ground, z = 0, at random places and turns; the distance between two centres
//! is never below that of two cubes corner to corner, so they never touch. Nothing else is in the
//! world, and nothing needs its engine.
//!
//! # Observation
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0–2 | camera x, y, z, RCM frame, as sensed | −0.26 | 0.26 | m |
//! | 3–5 | roll, pitch, yaw of the camera, RCM frame, as sensed | −π, −π/2, −π | π, π/2, π | rad |
//! | 6 | 1 where some of the target is in view, else 0 | 0 | 1 | 1 |
//! | 7 | image point x of the target, to the right | −2 | 2 | half a picture |
//! | 8 | image point y, down | −2 | 2 | half a picture |
//! | 9 | misorientation θ*, as sensed | −π | π | rad |
//!
//! The picture is −1 to 1 in x and y, 60° wide and high. The target is *in view* where one of 54
//! samples of its surface (3 × 3 a face) is in the picture, at least 10 mm ahead of the lens, and
//! no other cube is between it and the lens. Its *image point* is then the area centroid of its
//! outline, the convex hull of its projection, as far as that is in the picture; other cubes cut
//! nothing off. Where it is not in view, the image point is the projection of its centre, taken at
//! least 10 mm ahead of the lens, within ±2.
//!
//! With `"perceived"` in the option `observation`, numbers 6 to 8 come from the endoscope's picture instead:
//! whether the target's colour is seen there, and the middle of the pixels that have it; 0, 0 where it is not
//! seen. How it is found is told in [`perception`](super::perception). The expert then knows no more than
//! this. Goals, rewards and the end of episodes stay those of the geometry. A step draws a picture then, which takes
//! milliseconds instead of microseconds.
//!
//! Under `preset = "surrol"` number 9 is the roll rate of the original's law, 25 · θ*, rad/s.

use std::borrow::Cow;

use nalgebra::{Vector2, Vector3};
use trocar_proto::spec::{Element, RowSpec};
use trocar_proto::{Options, Rejection};

use super::camera::{Cube, IMAGE_BOUND, Sighting, TAN_HALF_VIEW, View};
use super::ecm_scene::{Control, EcmArm, STEP_TURN, misorientation_element};
use super::expert::ExpertInput;
use super::options::{self, Preset};
use super::perception;
use super::rate::Rate;
use super::state::State;
use crate::assets::Model;
use crate::render::Scene;
use crate::sim::random::Rng;

/// Cubes besides the target. Source: the original.
pub const DISTRACTORS: usize = 18;

/// Colour of the target, red, green, blue.
pub const TARGET_COLOUR: [f32; 3] = [0.84, 0.12, 0.13];

/// Colours of the other cubes, two of each.
pub const COLOURS: [[f32; 3]; DISTRACTORS / 2] = [
    [0.12, 0.36, 0.74],
    [0.16, 0.56, 0.27],
    [0.95, 0.79, 0.18],
    [0.45, 0.24, 0.62],
    [0.10, 0.63, 0.66],
    [0.93, 0.56, 0.72],
    [0.46, 0.33, 0.22],
    [0.88, 0.88, 0.86],
    [0.27, 0.28, 0.31],
];

/// Roll rate of the original's law for each radian of misorientation, 1/s.
const SURROL_ROLL_GAIN: f64 = 25.0;

/// How much the region grows on every side where a place drawn in it is not free, m.
const GROWTH: f64 = 0.001;

/// Distance from the middle of the targets' region, along x and y, at which a target must be in the
/// picture at the start, m.
const MIDDLE: f64 = 0.1;

/// Where cubes may stand.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// Length of their edges, m.
    pub edge: f64,
    /// Where their centres are, m, world frame: smallest and largest x and y.
    pub region: [[f64; 2]; 2],
    /// Least distance of two centres, m.
    pub apart: f64,
}

impl Layout {
    /// A red cube at `place` (m, world frame), turned by `yaw`.
    pub fn target(&self, place: &Vector2<f64>, yaw: f64) -> Cube {
        self.cube(place, yaw, TARGET_COLOUR)
    }

    /// A place in the region.
    pub fn place(&self, rng: &mut Rng) -> Vector2<f64> {
        let [low, high] = self.region;
        Vector2::new(rng.uniform(low[0], high[0]), rng.uniform(low[1], high[1]))
    }

    /// The other cubes, none nearer than [`Self::apart`] to another or to one of `kept_free`.
    ///
    /// With every place that is not free, the region grows, so that there is room in the end.
    pub fn distractors(&self, kept_free: &[Vector2<f64>], rng: &mut Rng) -> Vec<Cube> {
        let mut region = *self;
        let mut cubes: Vec<Cube> = Vec::with_capacity(DISTRACTORS);
        let near =
            |a: &Vector2<f64>, b: &Vector2<f64>| (a - b).norm_squared() < self.apart * self.apart;
        while cubes.len() < DISTRACTORS {
            let place = region.place(rng);
            let taken = cubes.iter().any(|cube| near(&cube.centre.coords.xy(), &place));
            if taken || kept_free.iter().any(|free| near(free, &place)) {
                let [low, high] = region.region;
                region.region = [low.map(|edge| edge - GROWTH), high.map(|edge| edge + GROWTH)];
                continue;
            }
            let yaw = rng.uniform(-std::f64::consts::PI, std::f64::consts::PI);
            cubes.push(self.cube(&place, yaw, COLOURS[cubes.len() / 2]));
        }
        cubes
    }

    fn cube(&self, place: &Vector2<f64>, yaw: f64, colour: [f32; 3]) -> Cube {
        let centre = [place.x, place.y, 0.5 * self.edge].into();
        Cube { centre, yaw, edge: self.edge, colour }
    }
}

/// An endoscope and the cubes that it sees.
#[derive(Debug, Clone)]
pub struct Tracker {
    arm: EcmArm,
    preset: Preset,
    target: Cube,
    distractors: Vec<Cube>,
    sighting: Sighting,
    /// What is observed of the target instead, where that comes from the endoscope's picture.
    perceived: Option<Perceived>,
    /// The true one, rad.
    misorientation: f64,
}

/// The image point of the target in the endoscope's picture; none where it is not seen there.
type Perceived = Option<Vector2<f64>>;

impl Tracker {
    /// The rows of `setup` that move the arm.
    pub fn setup_rows() -> Vec<RowSpec> {
        EcmArm::setup_rows()
    }

    /// An endoscope that starts with `joints` (rad; index 2 in m), and one cube, the target, in the
    /// middle of the region of targets, around which the endoscope must have it in its picture.
    pub fn new(options: &Options, joints: &[f64; 4], target: Cube) -> Result<Self, Rejection> {
        let mut arm = EcmArm::new(options, Control::Velocity)?;
        arm.start_with(joints);
        let tracker = Self {
            arm,
            preset: options::preset_of(options),
            target,
            distractors: Vec::new(),
            sighting: Sighting { in_view: false, in_picture: false, point: Vector2::zeros() },
            perceived: options::perceives(options).then_some(None),
            misorientation: 0.0,
        };
        let view = View::new(tracker.arm.nominal_start());
        let around = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
        let in_picture = around.map(|[x, y]| {
            let mut moved = tracker.target.clone();
            moved.centre += Vector3::new(x, y, 0.0) * MIDDLE;
            view.holds(&moved)
        });
        if in_picture == [true; 4] {
            return Ok(tracker);
        }
        let why = "the middle of the targets' region must be in the picture at the start";
        Err(options::refuse_setup(options, why))
    }

    /// Brings the arm to its start; what is there to see is still that of before.
    pub fn reset_arm(&mut self, rng: &mut Rng) {
        self.arm.reset(rng);
    }

    /// The true camera's view.
    pub fn view(&self) -> View {
        View::new(self.arm.world_from_camera())
    }

    /// Puts the cubes of an episode on the ground.
    pub fn furnish(&mut self, target: Cube, distractors: Vec<Cube>) {
        (self.target, self.distractors) = (target, distractors);
        self.look();
    }

    /// All cubes, the target first.
    pub fn cubes(&self) -> impl Iterator<Item = &Cube> {
        std::iter::once(&self.target).chain(&self.distractors)
    }

    /// The endoscope's arm.
    pub fn arm(&mut self) -> &mut EcmArm {
        &mut self.arm
    }

    /// How often the endoscope is commanded.
    pub fn rate(&self) -> Rate {
        self.arm.rate()
    }

    /// Moves the target to `place` (m, world frame).
    pub fn move_target(&mut self, place: &Vector2<f64>) {
        (self.target.centre.x, self.target.centre.y) = (place.x, place.y);
    }

    /// Draws the arm and all cubes, the target as `target`.
    pub fn draw(&self, scene: &mut Scene) {
        self.arm.draw(scene);
        for (number, cube) in self.cubes().enumerate() {
            if number == 0 {
                scene.begin("target");
            } else {
                scene.begin(format!("cube {number}"));
            }
            for visual in &Model::cube(cube.edge).visuals {
                let at = cube.world_from_cube() * visual.body_from_visual;
                scene.draw(visual.form.mesh(), at, visual.material.coloured(cube.colour));
            }
        }
    }

    /// What is seen of the target.
    pub fn sighting(&self) -> &Sighting {
        &self.sighting
    }

    /// The true misorientation, rad.
    pub fn misorientation(&self) -> f64 {
        self.misorientation
    }

    /// The elements of an action.
    pub fn action_elements(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    /// The state; see the module's description.
    pub fn state(&self, state: &mut State<'_>) {
        self.arm.state(state);
        let (in_view, point) = self.observed();
        let seen = || Element::new("target in view", "", "1", 0.0, 1.0);
        state.field(seen, f64::from(u8::from(in_view)));
        state.fields(|| image_elements().into(), [point.x, point.y]);
        let roll = || match self.preset {
            Preset::Paper => misorientation_element(),
            Preset::Surrol => {
                let bound = SURROL_ROLL_GAIN as f32 * std::f32::consts::PI;
                Element::new("roll rate", "camera image", "rad/s", -bound, bound)
            }
        };
        state.field(roll, self.roll_number(self.arm.sensed_misorientation()));
    }

    /// A misorientation (rad) as the last number of an observation under this preset.
    pub fn roll_number(&self, misorientation: f64) -> f64 {
        match self.preset {
            Preset::Paper => misorientation,
            Preset::Surrol => SURROL_ROLL_GAIN * misorientation,
        }
    }

    /// Writes the action of the visual servo: a turn of the camera by the angles under which the
    /// target will be seen beside the middle once the actions in flight have turned the camera, as fast as it can be.
    pub fn expert(&self, input: &ExpertInput<'_>, action: &mut [f32]) {
        let ahead = self.arm.ahead(input.in_flight);
        let (_, point) = self.observed();
        // The camera frame's x and y axes are the image axes left and up.
        let seen = Vector3::new(-point.x * TAN_HALF_VIEW, -point.y * TAN_HALF_VIEW, 1.0);
        let will = match &ahead {
            Cow::Borrowed(_) => seen,
            Cow::Owned(ahead) => {
                let [then, now] =
                    [ahead, &self.arm].map(|arm| arm.seen_camera(input.sees).rotation);
                then.inverse() * now * seen
            }
        };
        let angles = Vector2::new(-will.x, -will.y).map(|across| libm::atan2(across, will.z));
        let across =
            (angles / (STEP_TURN * self.rate().scale())).map(|number| number.clamp(-1.0, 1.0));
        ahead.encode_velocity(&Vector3::new(across.x, across.y, 0.0), action);
    }

    /// Whether the target is in view, and its image point, as observed.
    fn observed(&self) -> (bool, Vector2<f64>) {
        match self.perceived {
            Some(seen) => (seen.is_some(), seen.unwrap_or_default()),
            None => (self.sighting.in_view, self.sighting.point),
        }
    }

    /// Looks at where the target is in the picture.
    pub fn look(&mut self) {
        self.sighting = self.view().sight(&self.target, &self.distractors);
        self.misorientation = self.arm.misorientation();
        if self.perceived.is_some() {
            let mut scene = Scene::default();
            self.draw(&mut scene);
            self.perceived = Some(perception::target(&scene));
        }
    }
}

/// The image point of the target as elements of a goal or an observation.
pub fn image_elements() -> [Element; 2] {
    let bound = IMAGE_BOUND as f32;
    ["target image x", "target image y"]
        .map(|name| Element::new(name, "camera image", "1", -bound, bound))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CROWDED: Layout = Layout { edge: 0.1, region: [[-0.1, -0.1], [0.1, 0.1]], apart: 0.15 };

    #[test]
    fn cubes_find_room_and_never_touch() {
        for seed in 0..50 {
            let free = [Vector2::zeros(), Vector2::new(0.3, 0.0)];
            let cubes = CROWDED.distractors(&free, &mut Rng::new(seed, 0));
            assert_eq!(cubes.len(), DISTRACTORS);
            for (index, cube) in cubes.iter().enumerate() {
                assert_eq!(cube.centre.z.to_bits(), 0.05_f64.to_bits());
                let place = cube.centre.coords.xy();
                let others = cubes[..index].iter().map(|other| other.centre.coords.xy());
                for other in others.chain(free) {
                    // Corner to corner, two squares of 100 mm are 141.4 mm apart.
                    assert!((place - other).norm() > 0.1 * 2f64.sqrt());
                }
            }
            for colour in COLOURS {
                assert_eq!(cubes.iter().filter(|cube| cube.colour == colour).count(), 2);
            }
        }
    }
}
