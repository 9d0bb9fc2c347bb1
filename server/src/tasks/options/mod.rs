//! Options that several tasks share: what they accept, and their values as types.

use std::collections::BTreeMap;

use trocar_proto::goal::{Reward, SuccessRule};
use trocar_proto::spec::{Allowed, Element, ImageKind, OptionSpec, OptionValue, RowSpec};
use trocar_proto::{Code, Options, Rejection, TaskSpec};

use super::proprioception::Proprioception;
use super::relative;
use crate::render::Look;
use crate::robots::ArmModel;
use crate::sim::frames::Aabb;
use crate::sim::grasp::GraspMode;

pub mod arm_errors;
mod domain;

pub use arm_errors::{ArmErrors, DVRK, ecm_rows, psm_rows};
pub use domain::{
    Domain, MOST_JOINT_OFFSET, MOST_PAD_DEPTH, Range, Variation, camera_rows, domain, domain_with,
    friction_row, object_rows, pad_rows, tissue_row,
};

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
    observes(options, "state") || perceives(options) || is_scaled(options)
}

/// The word of `observation` for a state and goals that are scaled by their ranges.
pub(crate) const SCALED: &str = "scaled";

/// True if resolved options ask for scaled numbers.
pub(crate) fn is_scaled(options: &Options) -> bool {
    observes(options, SCALED)
}

/// The specification that clients get of an unscaled one.
pub(crate) fn shown(plain: TaskSpec, options: &Options) -> TaskSpec {
    if is_scaled(options) { plain.scaled() } else { plain }
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
        SuccessRule::Parts(mut parts) => {
            for part in &mut parts {
                part.tolerance *= factor;
            }
            SuccessRule::Parts(parts)
        }
        SuccessRule::Scaled { ranges, rule } => {
            SuccessRule::Scaled { ranges, rule: Box::new(tolerated(*rule, options)) }
        }
    }
}

/// `episode_seconds`: simulated time until an episode is truncated, s; `own` is the task's own time.
pub(crate) fn episode_seconds(own: f64) -> OptionSpec {
    OptionSpec {
        name: "episode_seconds".into(),
        summary: "Simulated time until an episode is truncated, s.".into(),
        default: OptionValue::Number(own),
        allowed: Allowed::Range { min: 0.01, max: 3600.0 },
    }
}

/// Simulated time until truncation, s, of resolved options.
pub(crate) fn episode_seconds_of(options: &Options) -> f64 {
    options.number("episode_seconds").expect("every task has this option")
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
/// placed camera is; and `look`.
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
    observation.summary +=
        " scaled: the state and the goals, each element as (x - centre) / half-width of its range.";
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
        words.push(SCALED.into());
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
        look(),
    ]);
    known
}

/// `look`: in what light there are pictures.
fn look() -> OptionSpec {
    OptionSpec::choice(
        "look",
        "In what light pictures are drawn. bench: under a theatre's lamps; cavity: as in a body, from a lamp at \
         the endoscope, and dark elsewhere.",
        &Look::NAMES,
    )
}

/// The look that resolved options ask for.
pub(crate) fn look_of(options: &Options) -> Look {
    if options.text("look") == Some("cavity") { Look::Cavity } else { Look::Bench }
}

/// The options of pictures on demand: those of observed ones with defaults for people, of which both colour
/// and depth can be had. Their look is the environment's.
pub(crate) fn of_views() -> Vec<OptionSpec> {
    let kinds = [ImageKind::Rgb, ImageKind::Depth].map(|kind| kind.name().to_string());
    let mut known = with_common(vec![observation()]);
    known.retain(|option| option.name != "look");
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
