//! `domain`: ranges from which every episode draws what differs between arms, sensors and objects.

use std::collections::BTreeMap;

use trocar_proto::spec::{Allowed, OptionSpec, OptionValue, RowSpec};
use trocar_proto::{Code, Options, Rejection};

use super::arm_errors::DVRK;
use crate::sim::frames::{self, Pose};
use crate::sim::random::Rng;
use crate::sim::world::Spring;

/// `domain`: ranges from which every episode draws.
pub fn domain() -> OptionSpec {
    domain_with([])
}

/// `domain`: ranges from which every episode of a task with these rows of its own draws.
pub fn domain_with(own: impl IntoIterator<Item = RowSpec>) -> OptionSpec {
    let noise = "Standard deviation of observed positions, m.";
    let offset = "Error of each rotary joint's encoder, rad.";
    let latency = "Steps by which actions take effect late (integers).";
    let late =
        "Time by which actions take effect late, s, to the nearest 1/240 s; besides latency.";
    let shaken = "Standard deviation of what actuators add to each command along each axis, m.";
    let twisted = "Standard deviation of what actuators add to each command about each axis, rad.";
    let joint_offset = range_row("joint_offset", offset, -MOST_JOINT_OFFSET, MOST_JOINT_OFFSET);
    let mut rows = Vec::from_iter(own);
    rows.extend([
        range_row("observation_noise", noise, 0.0, 0.01),
        RowSpec { presets: [(DVRK.to_string(), JOINT_OFFSET.to_vec())].into(), ..joint_offset },
        range_row("latency", latency, 0.0, 10.0),
        range_row("latency_seconds", late, 0.0, 1.0),
        range_row("action_noise", shaken, 0.0, 0.01),
        range_row("action_noise_angle", twisted, 0.0, 0.1),
    ]);
    OptionSpec {
        name: "domain".into(),
        summary: "Ranges [low, high] from which every episode draws. preset dvrk: those that were measured of \
                  real arms, and what is given beside it in their place."
            .into(),
        default: OptionValue::Table(BTreeMap::new()),
        allowed: Allowed::Table(rows),
    }
}

/// Largest error of a rotary joint's encoder that episodes may draw, rad.
pub const MOST_JOINT_OFFSET: f64 = 0.02;

/// Errors of encoders that the preset [`DVRK`] gives, rad: those of yaw and pitch were measured, 0.06° to 0.09° each.
const JOINT_OFFSET: [f64; 2] = [-0.002, 0.002];

/// The row `friction` of `domain`.
pub fn friction_row() -> RowSpec {
    range_row("friction", "Friction coefficient of the jaws; 1 where none is given.", 0.1, 2.0)
}

/// A row of `domain` of tasks with something soft: what it says, the number where none is given, and the range.
pub fn tissue_row(name: &str, what: &str, nominal: f64, [min, max]: [f64; 2]) -> RowSpec {
    range_row(name, &format!("{what}; {nominal} where none is given."), min, max)
}

/// The rows `mass` and `size` of `domain`; `size`: the smallest and the largest.
pub fn object_rows(size: [f64; 2]) -> [RowSpec; 2] {
    let mass = "Factor on the object's mass, besides what its size makes of it.";
    let lengths = "Factor on every length of the object; its mass grows with the third power.";
    [range_row("mass", mass, MASS[0], MASS[1]), range_row("size", lengths, size[0], size[1])]
}

/// The rows of `domain` of tasks whose object lies on a pad that may give.
pub fn pad_rows() -> [RowSpec; 2] {
    let stiffness = "Stiffness of the pad where it gives, N/m; 200 where only pad_depth is given.";
    let depth = "How far the pad gives, m; 0.001 where only pad_stiffness is given.";
    [
        range_row("pad_stiffness", stiffness, PAD_STIFFNESS[0], PAD_STIFFNESS[1]),
        range_row("pad_depth", depth, 0.0, MOST_PAD_DEPTH),
    ]
}

/// The rows of `domain` that misplace the camera; `angle`: the largest turn, rad.
pub fn camera_rows(angle: f64) -> [RowSpec; 2] {
    let position = "Error of the camera's place on its arm along each of its axes, m.";
    let turn = "Error of the camera's direction about each of its axes, rad.";
    [
        range_row("camera_pose_position", position, -0.005, 0.005),
        range_row("camera_pose_angle", turn, -angle, angle),
    ]
}

/// The factors on an object's mass with which every expert succeeds: stiffness of contacts is per mass, so
/// at a quarter blocks and gauze are lost, and at ten times a block is too heavy to be handed over.
const MASS: [f64; 2] = [0.5, 5.0];

/// The stiffness of pads with which experts do their work, N/m.
const PAD_STIFFNESS: [f64; 2] = [50.0, 1000.0];

/// The deepest that a pad gives, m.
pub const MOST_PAD_DEPTH: f64 = 0.002;

/// The pad of an episode of whose two ranges only one is given.
const PAD: Spring = Spring { stiffness: 200.0, travel: 0.001 };

pub(super) fn range_row(name: &str, summary: &str, min: f64, max: f64) -> RowSpec {
    let (name, summary) = (name.into(), summary.into());
    RowSpec { name, summary, count: 2, min, max, presets: BTreeMap::new() }
}

/// The range that resolved options give for the row `row`.
pub(super) fn range_given(options: &Options, row: &str) -> Result<Option<Range>, Rejection> {
    match options.row("domain", row) {
        Some(&[low, high]) if low <= high => Ok(Some(Range { low, high })),
        Some(numbers) => Err(Rejection::new(
            Code::InvalidOption,
            format!("options.domain.{row}"),
            OptionValue::Numbers(numbers.to_vec()),
            "[low, high] with low not above high",
        )),
        None => Ok(None),
    }
}

/// A range from which every episode draws; [0, 0] where none is given.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Range {
    low: f64,
    high: f64,
}

impl Range {
    /// A number of the range.
    pub fn draw(&self, rng: &mut Rng) -> f64 {
        rng.uniform(self.low, self.high)
    }

    /// The number at a `part` of the range, 0 to 1.
    pub(super) fn at(&self, part: f64) -> f64 {
        self.low + (self.high - self.low) * part
    }

    /// The largest magnitude of its numbers.
    pub(super) fn largest(&self) -> f64 {
        self.low.abs().max(self.high.abs())
    }

    /// A number of the range; none where the range was not given.
    pub fn draw_if_given(&self, rng: &mut Rng) -> Option<f64> {
        self.is_given().then(|| self.draw(rng))
    }

    fn is_given(&self) -> bool {
        *self != Self::default()
    }

    /// Its smallest number; none where the range was not given.
    pub fn least(&self) -> Option<f64> {
        self.is_given().then_some(self.low)
    }

    /// Its largest number; none where the range was not given.
    pub fn greatest(&self) -> Option<f64> {
        self.is_given().then_some(self.high)
    }

    /// An integer of the range, both ends included.
    pub fn draw_integer(&self, rng: &mut Rng) -> usize {
        let (low, high) = (self.low.ceil() as usize, self.high.floor() as usize);
        low + rng.index(high.saturating_sub(low) + 1)
    }
}

/// What an episode makes of its objects: factors on mass and size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variation {
    /// Factor on the mass, besides what the size makes of it.
    pub mass: f64,
    /// Factor on every length.
    pub size: f64,
}

/// The ranges of `domain`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Domain {
    /// Standard deviation of observed positions, m.
    pub observation_noise: Range,
    /// Friction coefficient of the jaws.
    pub friction: Range,
    /// Factor on the object's mass.
    pub mass: Range,
    /// Factor on the object's lengths.
    pub size: Range,
    /// Stiffness of the pad, N/m.
    pub pad_stiffness: Range,
    /// How far the pad can be pressed in, m.
    pub pad_depth: Range,
    /// Young's modulus of tissue, Pa.
    pub modulus: Range,
    /// Thickness of tissue, m.
    pub thickness: Range,
    /// Ultimate strain of tissue.
    pub strength: Range,
    /// Error of the camera's place along each of its axes, m.
    pub camera_pose_position: Range,
    /// Error of the camera's direction about each of its axes, rad.
    pub camera_pose_angle: Range,
    /// Error of each rotary joint's encoder, rad.
    pub joint_offset: Range,
    /// Steps by which actions take effect late.
    pub latency: Range,
    /// Seconds by which actions take effect late, besides.
    pub latency_seconds: Range,
    /// Standard deviation of what actuators add to each command along each axis, m.
    pub action_noise: Range,
    /// Standard deviation of what actuators add to each command about each axis, rad.
    pub action_noise_angle: Range,
}

impl Domain {
    /// The ranges that resolved options give.
    pub fn of(options: &Options) -> Result<Self, Rejection> {
        let range = |row: &str| range_given(options, row).map(Option::unwrap_or_default);
        let has = |row: &str| options.row("domain", row).is_some();
        let pad_depth = if has("pad_stiffness") && !has("pad_depth") {
            Range { low: PAD.travel, high: PAD.travel }
        } else {
            range("pad_depth")?
        };
        Ok(Self {
            observation_noise: range("observation_noise")?,
            friction: range("friction")?,
            mass: range("mass")?,
            size: range("size")?,
            pad_stiffness: range("pad_stiffness")?,
            pad_depth,
            modulus: range("modulus")?,
            thickness: range("thickness")?,
            strength: range("strength")?,
            camera_pose_position: range("camera_pose_position")?,
            camera_pose_angle: range("camera_pose_angle")?,
            joint_offset: range("joint_offset")?,
            latency: range("latency")?,
            latency_seconds: range("latency_seconds")?,
            action_noise: range("action_noise")?,
            action_noise_angle: range("action_noise_angle")?,
        })
    }

    /// What the episode of `rng` makes of its objects; none where neither range was given.
    pub fn draw_variation(&self, rng: &Rng) -> Option<Variation> {
        let mut rng = rng.aside();
        let [mass, size] = [self.mass, self.size].map(|range| {
            let number = range.draw(&mut rng);
            range.is_given().then_some(number)
        });
        (mass.is_some() || size.is_some())
            .then(|| Variation { mass: mass.unwrap_or(1.0), size: size.unwrap_or(1.0) })
    }

    /// Whether the pad gives.
    pub fn has_soft_pad(&self) -> bool {
        self.pad_depth.is_given()
    }

    /// How the pad of the episode of `rng` gives; none where it does not. To be drawn where the variation is.
    pub fn draw_pad(&self, rng: &Rng) -> Option<Spring> {
        self.has_soft_pad().then(|| {
            let mut rng = rng.aside();
            // The first two numbers are those of the variation.
            let [_, _, stiffness, travel] =
                [self.mass, self.size, self.pad_stiffness, self.pad_depth]
                    .map(|range| range.draw(&mut rng));
            let is_given = self.pad_stiffness.is_given();
            Spring { stiffness: if is_given { stiffness } else { PAD.stiffness }, travel }
        })
    }

    /// Where the camera of the episode of `rng` is, seen from where it should be; none where neither range
    /// was given.
    pub fn draw_camera_error(&self, rng: &Rng) -> Option<Pose> {
        let ranges = [self.camera_pose_position, self.camera_pose_angle];
        ranges.iter().any(Range::is_given).then(|| {
            let mut rng = rng.aside();
            let [position, turn] = ranges.map(|range| [(); 3].map(|()| range.draw(&mut rng)));
            frames::pose(position, turn)
        })
    }
}
