//! Options that several tasks share: what they accept, and their values as types.

use std::collections::BTreeMap;

use trocar_proto::goal::{Reward, SuccessRule};
use trocar_proto::spec::{Allowed, Element, ImageKind, OptionSpec, OptionValue, RowSpec};
use trocar_proto::{Code, Options, Rejection};

use super::proprioception::Proprioception;
use super::relative;
use crate::robots::ArmModel;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::grasp::GraspMode;
use crate::sim::random::Rng;
use crate::sim::world::Spring;

/// Unit of positions under `preset = "surrol"`, which multiplies metres by 5.
pub const SCALED_LENGTH: &str = "0.2 m";

/// How many of [`SCALED_LENGTH`] make a metre.
pub const SCALED_LENGTHS_PER_METRE: f64 = 5.0;

/// `reward`: sparse or dense.
pub fn reward() -> OptionSpec {
    OptionSpec::choice(
        "reward",
        "sparse: 0 on success, -1 otherwise; dense: minus the distance of the goals.",
        &["sparse", "dense"],
    )
}

/// The reward that resolved options ask for.
pub fn reward_of(options: &Options) -> Reward {
    if options.text("reward") == Some("dense") { Reward::Dense } else { Reward::Sparse }
}

/// `grasp` and `grasp_distance`: what holds an object in the jaws.
pub fn grasp() -> [OptionSpec; 2] {
    [
        OptionSpec::choice(
            "grasp",
            "interact: friction, and nothing else; approx: an attachment, when jaws close near the object; \
             weld: friction until it is lifted, then an attachment, as in the original.",
            &["interact", "approx", "weld"],
        ),
        OptionSpec {
            name: "grasp_distance".into(),
            summary: "approx: from the tip to the object's surface, m.".into(),
            default: OptionValue::Number(0.002),
            allowed: Allowed::Range { min: 0.0, max: 0.02 },
        },
    ]
}

/// The grasp mode that resolved options ask for.
pub fn grasp_of(options: &Options) -> GraspMode {
    match options.text("grasp") {
        Some("approx") => {
            let distance = options.number("grasp_distance").expect("resolved options have it");
            GraspMode::Approx { distance }
        }
        Some("weld") => GraspMode::Weld,
        _ => GraspMode::Interact,
    }
}

/// What the numbers of an action mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ActionMode {
    /// The paper's few degrees of freedom.
    Paper,
    /// Increments of the whole pose.
    Cartesian,
    /// A pose to go to.
    CartesianAbs,
    /// Increments of the joints.
    Joint,
}

impl ActionMode {
    /// Numbers of an action of a PSM.
    pub fn psm_numbers(self) -> usize {
        if self == Self::Paper { 5 } else { 7 }
    }
}

/// `action`: what the numbers of an action mean.
pub fn action() -> OptionSpec {
    OptionSpec::choice(
        "action",
        "paper: the original's increments; cartesian: increments of the whole pose; \
         cartesian_abs: a pose to go to; joint: increments of the joints.",
        &["paper", "cartesian", "cartesian_abs", "joint"],
    )
}

/// The action mode that resolved options ask for.
pub fn action_of(options: &Options) -> ActionMode {
    match options.text("action") {
        Some("cartesian") => ActionMode::Cartesian,
        Some("cartesian_abs") => ActionMode::CartesianAbs,
        Some("joint") => ActionMode::Joint,
        _ => ActionMode::Paper,
    }
}

/// `observation`: which observations a step returns.
pub fn observation() -> OptionSpec {
    OptionSpec {
        name: "observation".into(),
        summary: "What a step returns; state is the vector described by the task.".into(),
        default: OptionValue::Texts(vec!["state".into()]),
        allowed: Allowed::SomeOf(vec!["state".into()]),
    }
}

/// The word of `observation` for a state whose target is sought in the endoscope's picture.
const PERCEIVED: &str = "perceived";

/// `observation` of tasks whose target can be sought in the endoscope's picture.
pub fn observation_or_perceived() -> OptionSpec {
    let words = ["state", PERCEIVED].map(String::from);
    OptionSpec { allowed: Allowed::SomeOf(words.to_vec()), ..observation() }
}

/// Whether resolved options ask for a target that is sought in the endoscope's picture.
pub fn perceives(options: &Options) -> bool {
    observes(options, PERCEIVED)
}

/// Whether resolved options ask for an observation of this name.
pub(crate) fn observes(options: &Options, name: &str) -> bool {
    let wanted = options.0.get("observation");
    matches!(wanted, Some(OptionValue::Texts(words)) if words.iter().any(|word| word == name))
}

/// Whether resolved options ask for the task's state.
pub(crate) fn observes_state(options: &Options) -> bool {
    observes(options, "state") || perceives(options)
}

/// `terminate`: whether success ends an episode.
fn terminate() -> OptionSpec {
    OptionSpec::choice(
        "terminate",
        "never: episodes go on to their time limit; success: the first success ends them.",
        &["never", "success"],
    )
}

/// `tolerance`: how near its goal success is.
fn tolerance() -> OptionSpec {
    OptionSpec {
        name: "tolerance".into(),
        summary: "Factor on the distances from the goal, and the angle, below which it counts as reached.".into(),
        default: OptionValue::Number(1.0),
        allowed: Allowed::Range { min: 0.1, max: 10.0 },
    }
}

/// The rule of success that resolved options make of a task's own.
pub(crate) fn tolerated(rule: SuccessRule, options: &Options) -> SuccessRule {
    let factor = options.number("tolerance").unwrap_or(1.0) as f32;
    match rule {
        SuccessRule::Distance { tolerance } => {
            SuccessRule::Distance { tolerance: tolerance * factor }
        }
        SuccessRule::Seated { horizontal, vertical } => {
            SuccessRule::Seated { horizontal: horizontal * factor, vertical: vertical * factor }
        }
        SuccessRule::Centred { image, angle } => {
            SuccessRule::Centred { image: image * factor, angle: angle * factor }
        }
    }
}

/// Whether resolved options let success end an episode.
pub(crate) fn terminates_on_success(options: &Options) -> bool {
    options.text("terminate") == Some("success")
}

/// Whether resolved options ask for the vector `observation`, in place of pictures alone.
pub(crate) fn observes_numbers(options: &Options) -> bool {
    observes_state(options)
        || Proprioception::of(options).is_wanted()
        || relative::is_wanted(options)
}

/// What a task knows, with the options that all tasks of its kind have: `terminate` where there is a goal, and
/// what observations may have besides the state where there is `observation`: `image_size`, `camera` and where a
/// placed camera is.
pub(crate) fn with_common(mut known: Vec<OptionSpec>) -> Vec<OptionSpec> {
    let has = |name: &str| known.iter().any(|option| option.name == name);
    let (has_goal, grasps) = (has("reward"), has("grasp"));
    if has_goal {
        known.extend([terminate(), tolerance()]);
    }
    let Some(observation) = known.iter_mut().find(|option| option.name == "observation") else {
        return known;
    };
    observation.summary = "What a step returns: state is the vector described by the task; joints and \
                           proprioception (joints, tip, jaw) are what the arms measure of themselves, after \
                           it or without it; rgb, depth (m), mask (bodies) and points (m) are pictures."
        .into();
    if has_goal {
        observation.summary +=
            " relative: where things are from each other, made of state and goals.";
    }
    if grasps {
        observation.summary += " contact: what presses on each finger.";
    }
    if let Allowed::SomeOf(words) = &mut observation.allowed {
        if words.iter().any(|word| word == PERCEIVED) {
            observation.summary +=
                " perceived: a state whose target is found in the endoscope's picture.";
        }
        words.extend(Proprioception::WORDS.map(String::from));
        let more = [(Proprioception::CONTACT, grasps), (relative::WORD, has_goal)];
        words.extend(more.iter().filter(|(_, has)| *has).map(|(word, _)| word.to_string()));
        words.extend(ImageKind::ALL.map(|kind| kind.name().to_string()));
    }
    known.push(OptionSpec {
        name: "image_size".into(),
        summary: "Rows and columns of pictures, pixels.".into(),
        default: OptionValue::Numbers(vec![128.0, 128.0]),
        allowed: Allowed::Vector { count: 2, min: 8.0, max: 1024.0 },
    });
    known.push(OptionSpec::choice(
        "camera",
        "From where: endoscope (60° high), overview, stereo, both lenses of the endoscope, or placed: where \
         camera_eye says.",
        &["endoscope", "overview", "stereo", "placed"],
    ));
    let place = |name: &str, summary: &str, default: [f64; 3]| OptionSpec {
        name: name.into(),
        summary: summary.into(),
        default: OptionValue::Numbers(default.to_vec()),
        allowed: Allowed::Vector { count: 3, min: -10.0, max: 10.0 },
    };
    let eye = "Where a placed camera is: x, y, z in the world, m.";
    let target = "What a placed camera has in the middle of its picture: x, y, z in the world, m.";
    known.extend([
        place("camera_eye", eye, [1.1, 0.6, 1.1]),
        place("camera_target", target, [0.5, 0.0, 0.7]),
        OptionSpec {
            name: "camera_view".into(),
            summary: "Height of a placed camera's view, degrees.".into(),
            default: OptionValue::Number(45.0),
            allowed: Allowed::Range { min: 1.0, max: 150.0 },
        },
    ]);
    known
}

/// The options of pictures on demand: those of observed ones with defaults for people, of which both colour
/// and depth can be had.
pub(crate) fn of_views() -> Vec<OptionSpec> {
    let kinds = [ImageKind::Rgb, ImageKind::Depth].map(|kind| kind.name().to_string());
    let mut known = with_common(vec![observation()]);
    for option in &mut known {
        match option.name.as_str() {
            "observation" => {
                option.default = OptionValue::Texts(kinds.to_vec());
                option.allowed = Allowed::SomeOf(kinds.to_vec());
            }
            "image_size" => option.default = OptionValue::Numbers(vec![480.0, 640.0]),
            "camera" => option.default = OptionValue::Text("overview".into()),
            _ => {}
        }
    }
    known
}

/// Whose numbers a task uses where paper and original code differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Preset {
    /// The paper's.
    Paper,
    /// The original code's, for policies that were trained there.
    Surrol,
}

/// `preset`: whose numbers a task uses.
pub fn preset() -> OptionSpec {
    OptionSpec::choice(
        "preset",
        "paper: the paper's numbers in metres; surrol: the original code's, for its policies.",
        &["paper", "surrol"],
    )
}

/// The preset that resolved options ask for.
pub fn preset_of(options: &Options) -> Preset {
    if options.text("preset") == Some("surrol") { Preset::Surrol } else { Preset::Paper }
}

/// `arm`: the generation of every arm of a task.
pub fn arm() -> OptionSpec {
    OptionSpec::choice(
        "arm",
        "Generation of the arms. classic: the first; si: the S and Si, with their joint limits and looks; the \
         default setup is the same, since they reach all of it. Not with preset surrol.",
        &["classic", "si"],
    )
}

/// The generation that resolved options ask for.
pub fn arm_of(options: &Options) -> Result<ArmModel, Rejection> {
    if options.text("arm") != Some("si") {
        return Ok(ArmModel::Classic);
    }
    if preset_of(options) == Preset::Surrol {
        let allowed = "allowed is \"classic\", the original's arms, with preset = \"surrol\"";
        return Err(Rejection::new(Code::InvalidOption, "options.arm", "\"si\"", allowed));
    }
    Ok(ArmModel::Si)
}

/// `spawn`: where objects and goals appear.
pub fn spawn() -> OptionSpec {
    OptionSpec::choice(
        "spawn",
        "workspace: anywhere in the 10 cm workspace; narrow: the original's 20 mm area.",
        &["workspace", "narrow"],
    )
}

/// What a preset changes of other options' defaults: what the client gives itself counts.
const PRESETS: [(&str, &str, &str); 2] =
    [("surrol", "spawn", "narrow"), ("surrol", "grasp", "weld")];

/// What a task knows, with the defaults that the preset in `options` brings.
pub(crate) fn under_preset(mut known: Vec<OptionSpec>, options: &Options) -> Vec<OptionSpec> {
    for (preset, name, value) in PRESETS {
        if options.text("preset") == Some(preset) {
            for option in known.iter_mut().filter(|option| option.name == name) {
                option.default = OptionValue::Text(value.into());
            }
        }
    }
    known
}

/// `setup`: where things stand; `rows` are those that apply to the task.
pub fn setup(rows: &[RowSpec]) -> OptionSpec {
    OptionSpec {
        name: "setup".into(),
        summary: "Where things stand. Actions and state stay in the nominal frame, so a policy \
                  keeps working."
            .into(),
        default: OptionValue::Table(BTreeMap::new()),
        allowed: Allowed::Table(rows.to_vec()),
    }
}

/// A refusal of the row `row` of `setup`.
pub fn refuse_setup(options: &Options, why: impl Into<String>) -> Rejection {
    let given = options.0.get("setup").map_or(String::new(), ToString::to_string);
    Rejection::new(Code::InvalidOption, "options.setup", given, why)
}

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
    let mut rows = Vec::from_iter(own);
    rows.extend([
        range_row("observation_noise", noise, 0.0, 0.01),
        range_row("joint_offset", offset, -MOST_JOINT_OFFSET, MOST_JOINT_OFFSET),
        range_row("latency", latency, 0.0, 10.0),
        range_row("latency_seconds", late, 0.0, 1.0),
        range_row("action_noise", shaken, 0.0, 0.01),
        range_row("action_noise_angle", twisted, 0.0, 0.1),
    ]);
    OptionSpec {
        name: "domain".into(),
        summary: "Ranges [low, high] from which every episode draws.".into(),
        default: OptionValue::Table(BTreeMap::new()),
        allowed: Allowed::Table(rows),
    }
}

/// Largest error of a rotary joint's encoder that episodes may draw, rad.
pub const MOST_JOINT_OFFSET: f64 = 0.02;

/// The row `friction` of `domain`.
pub fn friction_row() -> RowSpec {
    range_row("friction", "Friction coefficient of the jaws; 1 where none is given.", 0.1, 2.0)
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

fn range_row(name: &str, summary: &str, min: f64, max: f64) -> RowSpec {
    RowSpec { name: name.into(), summary: summary.into(), count: 2, min, max }
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

    /// A number of the range; none where the range was not given.
    pub fn draw_if_given(&self, rng: &mut Rng) -> Option<f64> {
        self.is_given().then(|| self.draw(rng))
    }

    fn is_given(&self) -> bool {
        *self != Self::default()
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
        let range = |row: &str| match options.row("domain", row) {
            Some(&[low, high]) if low <= high => Ok(Range { low, high }),
            Some(numbers) => Err(Rejection::new(
                Code::InvalidOption,
                format!("options.domain.{row}"),
                OptionValue::Numbers(numbers.to_vec()),
                "[low, high] with low not above high",
            )),
            None => Ok(Range::default()),
        };
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

/// Elements "`name` x", "`name` y" and "`name` z" of a position in `bounds` (m), in the unit of
/// `preset`.
pub fn position_elements(name: &str, frame: &str, bounds: &Aabb, preset: Preset) -> Vec<Element> {
    let unit = if preset == Preset::Surrol { SCALED_LENGTH } else { "m" };
    ["x", "y", "z"]
        .iter()
        .enumerate()
        .map(|(axis, letter)| {
            let bound = |value: f64| (value * position_scale(preset)) as f32;
            let (min, max) = (bound(bounds.min[axis]), bound(bounds.max[axis]));
            Element::new(&format!("{name} {letter}"), frame, unit, min, max)
        })
        .collect()
}

/// What positions in metres are multiplied by.
pub fn position_scale(preset: Preset) -> f64 {
    if preset == Preset::Surrol { SCALED_LENGTHS_PER_METRE } else { 1.0 }
}

/// Elements of extrinsic XYZ Euler angles, rad.
pub fn euler_elements(name: &str, frame: &str) -> Vec<Element> {
    use std::f32::consts::{FRAC_PI_2, PI};
    [("roll", PI), ("pitch", FRAC_PI_2), ("yaw", PI)]
        .map(|(angle, bound)| Element::new(&format!("{name} {angle}"), frame, "rad", -bound, bound))
        .to_vec()
}

/// An element of an action, in [−1, 1].
pub fn action_element(name: &str, frame: &str) -> Element {
    Element::new(name, frame, "1", -1.0, 1.0)
}
