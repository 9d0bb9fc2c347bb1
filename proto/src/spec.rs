//! What a task looks like from outside: actions, observations, goals, options.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::error::{Code, Rejection};
use crate::goal::{Reward, SuccessRule};
use crate::relative::Relative;
use crate::similar;

/// Stands for the preset of an option's rows where people write one among the rows.
pub const PRESET: &str = "preset";

/// A task as its clients see it, under one choice of options. Sent once, when a session opens.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskSpec {
    /// Registered name with version, e.g. `NeedleReach-v0`.
    pub id: String,
    /// One sentence for people.
    pub summary: String,
    /// Steps after which an episode is truncated.
    pub max_steps: u32,
    /// Simulated time of one step, s.
    pub seconds_per_step: f64,
    /// The action vector, element by element.
    pub action: Vec<Element>,
    /// The state observation, element by element.
    pub observation: Vec<Element>,
    /// Achieved and desired goal; `None` for tasks without goals.
    pub goal: Option<GoalSpec>,
    /// Which reward these options give.
    pub reward: Reward,
    /// What state and goals say of each other. Tasks give the features; the registry adds the dimensions.
    pub relative: Relative,
    /// The options this task knows.
    pub options: Vec<OptionSpec>,
    /// Pictures that an observation has; none unless they are asked for. Tasks leave this to the registry.
    pub images: Option<ImageSpec>,
    /// Whether there are soft bodies: then steps tell what is done to them.
    pub has_tissue: bool,
}

impl TaskSpec {
    /// Number of elements of an action.
    pub fn action_dim(&self) -> usize {
        self.action.len()
    }

    /// Number of elements of the state observation.
    pub fn observation_dim(&self) -> usize {
        self.observation.len()
    }

    /// Number of elements of a goal; 0 for tasks without goals.
    pub fn goal_dim(&self) -> usize {
        self.goal.as_ref().map_or(0, |goal| goal.elements.len())
    }

    /// Pixels of one kind of picture in an observation; 0 where it has none of this kind.
    pub fn pixels(&self, kind: ImageKind) -> usize {
        let images = self.images.as_ref().filter(|images| images.kinds.contains(&kind));
        images.map_or(0, |images| images.views.len() * images.height * images.width)
    }

    /// Whether `achieved` reaches `desired`; never for tasks without goals.
    pub fn is_success(&self, achieved: &[f32], desired: &[f32]) -> bool {
        self.goal.as_ref().is_some_and(|goal| goal.success.holds(achieved, desired))
    }
}

/// One element of a vector: what it means, where, in which unit and range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Element {
    /// Meaning, e.g. `tip position x`.
    pub name: String,
    /// Coordinate frame, e.g. `world`; empty where none applies.
    pub frame: String,
    /// SI unit, `1` where dimensionless.
    pub unit: String,
    /// Smallest value.
    pub min: f32,
    /// Largest value.
    pub max: f32,
    /// Whether an object that is lost leaves `[min, max]`; the element then stays at the edge.
    pub saturates: bool,
}

impl Element {
    /// An element that stays in `[min, max]` whatever happens.
    pub fn new(name: &str, frame: &str, unit: &str, min: f32, max: f32) -> Self {
        let [name, frame, unit] = [name, frame, unit].map(String::from);
        Self { name, frame, unit, min, max, saturates: false }
    }

    /// The same element, which an object that is lost takes to its edge.
    #[must_use]
    pub fn saturating(self) -> Self {
        Self { saturates: true, ..self }
    }
}

/// The pictures of an observation. Their cameras are OpenCV's: x to the right, y down, z forward; pixel
/// (u, v), from 0, shows what lies along ((u − cx)/fx, (v − cy)/fy, 1). With the depth d it shows the point
/// d · ((u − cx)/fx, (v − cy)/fy, 1) in the axes of its camera, m.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ImageSpec {
    /// What there is of each view.
    pub kinds: Vec<ImageKind>,
    /// What is appended to the names of the pictures of each view: nothing, or `_left` and `_right`.
    pub views: Vec<String>,
    /// Rows of a picture.
    pub height: usize,
    /// Columns of a picture.
    pub width: usize,
    /// Focal lengths and optical axis, pixels: fx, fy, cx, cy.
    pub intrinsics: [f64; 4],
    /// Where the camera of each view stands: rows of OpenCV's [R | t], which takes points of the world (m) to
    /// the axes of the camera. Empty where the camera moves.
    pub camera_from_world: Vec<[[f64; 4]; 3]>,
    /// Greatest depth, m: that of pixels that show nothing.
    pub far: f32,
    /// Names of the bodies: number n of a mask is the name at n − 1, and 0 is nothing.
    pub bodies: Vec<String>,
    /// Whether the state is wanted besides.
    pub with_state: bool,
}

impl ImageSpec {
    /// Largest x and y of points, m.
    pub fn reach(&self) -> [f32; 2] {
        let [fx, fy, cx, cy] = self.intrinsics;
        let reach = |pixels: usize, focal: f64, axis: f64| {
            let widest = axis.max(pixels as f64 - 1.0 - axis) / focal;
            (widest * f64::from(self.far) * 1.000_001) as f32 // more than rounding adds
        };
        [reach(self.width, fx, cx), reach(self.height, fy, cy)]
    }
}

/// Distance between both lenses of the endoscope, m; their axes are parallel.
pub const STEREO_BASELINE: f64 = 4.2e-3;

/// A kind of picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ImageKind {
    /// Red, green, blue: u8 (height, width, 3).
    Rgb,
    /// Distance along the optical axis, m: f32 (height, width, 1).
    Depth,
    /// Numbers of bodies: i32 (height, width).
    Mask,
    /// Where each pixel's surface is, in the axes of the camera, m: f32 (height · width, 3).
    Points,
}

impl ImageKind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Rgb, Self::Depth, Self::Mask, Self::Points];

    /// Its name in the option `observation` and in observations.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Depth => "depth",
            Self::Mask => "mask",
            Self::Points => "points",
        }
    }

    /// Numbers of each pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Rgb | Self::Points => 3,
            Self::Depth | Self::Mask => 1,
        }
    }
}

/// The goal of a task: what its elements are and when it is reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GoalSpec {
    /// Achieved and desired goal, element by element.
    pub elements: Vec<Element>,
    /// When the achieved goal counts as the desired one.
    pub success: SuccessRule,
}

/// One option of a task: its name, its default and what is allowed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OptionSpec {
    /// Keyword, e.g. `reward`.
    pub name: String,
    /// One sentence for people.
    pub summary: String,
    /// The value where none is given.
    pub default: OptionValue,
    /// What is accepted.
    pub allowed: Allowed,
}

impl OptionSpec {
    /// A choice of one of `values`, of which the first is the default.
    pub fn choice(name: &str, summary: &str, values: &[&str]) -> Self {
        Self {
            name: name.into(),
            summary: summary.into(),
            default: OptionValue::Text(values[0].into()),
            allowed: Allowed::OneOf(values.iter().map(ToString::to_string).collect()),
        }
    }
}

impl OptionSpec {
    /// Why a value is not accepted; where it is for one row of a table, that row is named.
    fn refuse(&self, value: &OptionValue) -> Rejection {
        let field = format!("options.{}", self.name);
        let (Allowed::Table(rows), OptionValue::Table(table) | OptionValue::Preset(_, table)) =
            (&self.allowed, value)
        else {
            let allowed = format!("allowed is {}{}", self.allowed, self.allowed.hint(value));
            return Rejection::new(Code::InvalidOption, field, value, allowed);
        };
        let known = |name: &str| rows.iter().find(|row| row.name == name);
        let is_bad = |(name, numbers): &(&String, &Vec<f64>)| {
            known(name).is_none_or(|row| !row.accepts(numbers))
        };
        let (name, numbers) = table.iter().find(is_bad).expect("a row is not accepted");
        let allowed = if let Some(row) = known(name) {
            format!("allowed is {row}")
        } else {
            let names: Vec<_> = rows.iter().map(|row| row.name.as_str()).collect();
            let hint = similar::hint(name, names.iter().copied());
            format!("unknown row{hint}; this task knows {names:?}")
        };
        let given = OptionValue::Numbers(numbers.clone());
        Rejection::new(Code::InvalidOption, format!("{field}.{name}"), given, allowed)
    }
}

/// The value of an option. Not recursive, so that no message can nest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum OptionValue {
    /// True or false.
    Flag(bool),
    /// A number; the unit is the option's.
    Number(f64),
    /// A word.
    Text(String),
    /// Several numbers.
    Numbers(Vec<f64>),
    /// Several words.
    Texts(Vec<String>),
    /// Named rows of numbers, e.g. ranges by parameter.
    Table(BTreeMap<String, Vec<f64>>),
    /// The rows that a preset gives, and those that are given in their place. Resolved options have a table of all.
    Preset(String, BTreeMap<String, Vec<f64>>),
}

impl fmt::Display for OptionValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flag(flag) => write!(f, "{flag}"),
            Self::Number(number) => write!(f, "{number}"),
            Self::Text(text) => write!(f, "{text:?}"),
            Self::Numbers(numbers) => write!(f, "{numbers:?}"),
            Self::Texts(texts) => write!(f, "{texts:?}"),
            Self::Table(table) => write!(f, "{table:?}"),
            Self::Preset(preset, table) => write!(f, "preset {preset:?} with {table:?}"),
        }
    }
}

/// What values an option accepts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Allowed {
    /// True or false.
    Flag,
    /// A finite number in `[min, max]`.
    Range {
        /// Smallest value.
        min: f64,
        /// Largest value.
        max: f64,
    },
    /// One of these numbers.
    NumberOf(Vec<f64>),
    /// One of these words.
    OneOf(Vec<String>),
    /// One or more of these words, none twice.
    SomeOf(Vec<String>),
    /// `count` finite numbers, each in `[min, max]`.
    Vector {
        /// How many.
        count: usize,
        /// Smallest value.
        min: f64,
        /// Largest value.
        max: f64,
    },
    /// Rows by name; every row has `count` finite numbers in `[min, max]`. Presets give what rows say of them.
    Table(Vec<RowSpec>),
}

/// One row that a [`Allowed::Table`] accepts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RowSpec {
    /// Name of the row.
    pub name: String,
    /// What it means, with unit.
    pub summary: String,
    /// How many numbers it has.
    pub count: usize,
    /// Smallest value of each.
    pub min: f64,
    /// Largest value of each.
    pub max: f64,
    /// Its numbers in the presets that give it.
    pub presets: BTreeMap<String, Vec<f64>>,
}

impl RowSpec {
    fn accepts(&self, numbers: &[f64]) -> bool {
        are_within(numbers, self.count, self.min, self.max)
    }
}

impl fmt::Display for RowSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} numbers in [{}, {}]", self.count, self.min, self.max)
    }
}

/// Whether there are `count` numbers, each in `[min, max]`.
fn are_within(numbers: &[f64], count: usize, min: f64, max: f64) -> bool {
    numbers.len() == count && numbers.iter().all(|number| (min..=max).contains(number))
}

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flag => write!(f, "true or false"),
            Self::Range { min, max } => write!(f, "a number in [{min}, {max}]"),
            Self::NumberOf(numbers) => write!(f, "one of {numbers:?}"),
            Self::OneOf(words) => write!(f, "one of {words:?}"),
            Self::SomeOf(words) => write!(f, "one or more of {words:?}, none twice"),
            Self::Vector { count, min, max } => {
                write!(f, "{count} numbers in [{min}, {max}]")
            }
            Self::Table(rows) => {
                write!(f, "a table with any of")?;
                for (index, row) in rows.iter().enumerate() {
                    let comma = if index == 0 { "" } else { "," };
                    write!(f, "{comma} {}", row.name)?;
                }
                let presets = presets_of(rows);
                if !presets.is_empty() {
                    write!(f, ", and a preset of {presets:?}")?;
                }
                Ok(())
            }
        }
    }
}

impl Allowed {
    fn accepts(&self, value: &OptionValue) -> bool {
        match (self, value) {
            (Self::Flag, OptionValue::Flag(_)) => true,
            (Self::Range { min, max }, OptionValue::Number(number)) => {
                (min..=max).contains(&number)
            }
            (Self::NumberOf(numbers), OptionValue::Number(number)) => numbers.contains(number),
            (Self::OneOf(words), OptionValue::Text(word)) => words.contains(word),
            (Self::SomeOf(words), OptionValue::Texts(chosen)) => {
                !chosen.is_empty()
                    && chosen.iter().enumerate().all(|(index, word)| {
                        words.contains(word) && !chosen[..index].contains(word)
                    })
            }
            (Self::Vector { count, min, max }, OptionValue::Numbers(numbers)) => {
                are_within(numbers, *count, *min, *max)
            }
            (Self::Table(rows), OptionValue::Table(table) | OptionValue::Preset(_, table)) => {
                let is_known = |(name, numbers): (&String, &Vec<f64>)| {
                    rows.iter().any(|row| row.name == *name && row.accepts(numbers))
                };
                table.iter().all(is_known)
            }
            _ => false,
        }
    }

    /// A suggestion for the first word of `value` that is not allowed; empty without one.
    fn hint(&self, value: &OptionValue) -> String {
        let (Self::OneOf(words) | Self::SomeOf(words)) = self else { return String::new() };
        let chosen = match value {
            OptionValue::Text(word) => std::slice::from_ref(word),
            OptionValue::Texts(chosen) => chosen,
            _ => return String::new(),
        };
        let wrong = chosen.iter().find(|word| !words.contains(word));
        wrong.map_or(String::new(), |word| similar::hint(word, words.iter().map(String::as_str)))
    }

    /// The value with the rows of its preset, if it has one.
    fn expanded(&self, option: &str, value: &OptionValue) -> Result<OptionValue, Rejection> {
        let (Self::Table(rows), OptionValue::Preset(preset, own)) = (self, value) else {
            return Ok(value.clone());
        };
        let presets = presets_of(rows);
        if !presets.contains(preset.as_str()) {
            return Err(Rejection::new(
                Code::InvalidOption,
                format!("options.{option}.preset"),
                format!("{preset:?}"),
                format!(
                    "allowed is one of {presets:?}{}",
                    similar::hint(preset, presets.iter().copied())
                ),
            ));
        }
        let given = |row: &RowSpec| Some((row.name.clone(), row.presets.get(preset)?.clone()));
        let mut table: BTreeMap<_, _> = rows.iter().filter_map(given).collect();
        table.extend(own.clone());
        Ok(OptionValue::Table(table))
    }
}

/// Refusal of the option `name`, which is none of the `known` options.
pub fn unknown(name: &str, value: impl fmt::Display, known: &[OptionSpec]) -> Rejection {
    let names: Vec<_> = known.iter().map(|option| option.name.as_str()).collect();
    let hint = similar::hint(name, names.iter().copied());
    let allowed = format!("unknown option{hint}; this task knows {names:?}");
    Rejection::new(Code::UnknownOption, format!("options.{name}"), value, allowed)
}

/// The presets that give any of `rows`.
fn presets_of(rows: &[RowSpec]) -> BTreeSet<&str> {
    rows.iter().flat_map(|row| row.presets.keys()).map(String::as_str).collect()
}

/// The options of a session by name; what is missing has its default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Options(pub BTreeMap<String, OptionValue>);

impl Options {
    /// No option given.
    pub fn new() -> Self {
        Self::default()
    }

    /// The same options with `name` set to `value`.
    #[must_use]
    pub fn with(mut self, name: &str, value: OptionValue) -> Self {
        self.0.insert(name.into(), value);
        self
    }

    /// The same options with `name` set to a word.
    #[must_use]
    pub fn with_text(self, name: &str, word: &str) -> Self {
        self.with(name, OptionValue::Text(word.into()))
    }

    /// Checks every option against what a task allows, fills in the defaults and puts rows in place of presets.
    pub fn resolve(&self, allowed: &[OptionSpec]) -> Result<Options, Rejection> {
        for (name, value) in &self.0 {
            let Some(option) = allowed.iter().find(|option| option.name == *name) else {
                return Err(unknown(name, value, allowed));
            };
            if !option.allowed.accepts(value) {
                return Err(option.refuse(value));
            }
        }
        let value_of = |option: &OptionSpec| {
            let value = self.0.get(&option.name).unwrap_or(&option.default);
            Ok((option.name.clone(), option.allowed.expanded(&option.name, value)?))
        };
        allowed.iter().map(value_of).collect::<Result<_, _>>().map(Options)
    }

    /// The word given for `name`.
    pub fn text(&self, name: &str) -> Option<&str> {
        match self.0.get(name)? {
            OptionValue::Text(word) => Some(word),
            _ => None,
        }
    }

    /// The number given for `name`.
    pub fn number(&self, name: &str) -> Option<f64> {
        match self.0.get(name)? {
            OptionValue::Number(number) => Some(*number),
            _ => None,
        }
    }

    /// Row `row` of the table given for `name`.
    pub fn row(&self, name: &str, row: &str) -> Option<&[f64]> {
        match self.0.get(name)? {
            OptionValue::Table(table) => table.get(row).map(Vec::as_slice),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn allowed() -> Vec<OptionSpec> {
        vec![
            OptionSpec::choice("reward", "Reward.", &["sparse", "dense"]),
            OptionSpec {
                name: "grasp_distance".into(),
                summary: "Attachment distance, m.".into(),
                default: OptionValue::Number(0.002),
                allowed: Allowed::Range { min: 0.0, max: 0.01 },
            },
            OptionSpec {
                name: "domain".into(),
                summary: "Ranges.".into(),
                default: OptionValue::Table(BTreeMap::new()),
                allowed: Allowed::Table(vec![RowSpec {
                    name: "friction".into(),
                    summary: "Coefficient.".into(),
                    count: 2,
                    min: 0.0,
                    max: 2.0,
                    presets: [("slippery".to_string(), vec![0.2, 0.4])].into(),
                }]),
            },
        ]
    }

    #[test]
    fn defaults_are_filled_in() {
        let options = Options::new().with_text("reward", "dense").resolve(&allowed()).unwrap();
        assert_eq!(options.text("reward"), Some("dense"));
        assert_eq!(options.number("grasp_distance"), Some(0.002));
        assert_eq!(options.row("domain", "friction"), None);
    }

    #[test]
    fn mistyped_names_and_values_get_a_suggestion() {
        let refused = |options: Options| options.resolve(&allowed()).unwrap_err().to_string();
        let table = |row: &str| OptionValue::Table([(row.to_string(), vec![0.0, 1.0])].into());
        let preset = OptionValue::Preset("slipery".into(), BTreeMap::new());
        for (options, suggestion) in [
            (Options::new().with_text("rewards", "dense"), "reward"),
            (Options::new().with_text("reward", "dence"), "dense"),
            (Options::new().with("domain", table("fricton")), "friction"),
            (Options::new().with("domain", preset), "slippery"),
        ] {
            let text = refused(options);
            assert!(text.contains(&format!("did you mean {suggestion:?}?")), "{text}");
        }
        assert!(!refused(Options::new().with_text("reward", "shaped")).contains("did you mean"));
    }

    #[test]
    fn a_refusal_names_field_value_and_choices() {
        let refusal = Options::new().with_text("reward", "shaped").resolve(&allowed()).unwrap_err();
        assert_eq!(refusal.code, Code::InvalidOption);
        let text = refusal.to_string();
        for part in ["options.reward", "shaped", "sparse", "dense"] {
            assert!(text.contains(part), "{text}");
        }
        let refusal = Options::new().with_text("rewards", "dense").resolve(&allowed()).unwrap_err();
        assert_eq!(refusal.code, Code::UnknownOption);
        assert!(refusal.to_string().contains("grasp_distance"));
    }

    #[test]
    fn numbers_must_be_finite_and_in_range() {
        for number in [f64::NAN, f64::INFINITY, -0.1, 0.02] {
            let options = Options::new().with("grasp_distance", OptionValue::Number(number));
            assert_eq!(options.resolve(&allowed()).unwrap_err().code, Code::InvalidOption);
        }
        let row = |numbers: &[f64]| {
            let table = BTreeMap::from([("friction".to_string(), numbers.to_vec())]);
            Options::new().with("domain", OptionValue::Table(table)).resolve(&allowed())
        };
        assert!(row(&[0.5, 1.0]).is_ok());
        assert!(row(&[0.5]).is_err());
        assert!(row(&[0.5, f64::NAN]).is_err());
    }

    #[test]
    fn a_preset_gives_rows_and_those_beside_it_take_their_place() {
        let resolved = |preset: &str, rows: &[(&str, [f64; 2])]| {
            let rows = rows.iter().map(|(name, row)| (name.to_string(), row.to_vec()));
            let value = OptionValue::Preset(preset.into(), rows.collect());
            Options::new().with("domain", value).resolve(&allowed())
        };
        let rows = resolved("slippery", &[]).unwrap();
        assert_eq!(rows.row("domain", "friction"), Some([0.2, 0.4].as_slice()));
        let rows = resolved("slippery", &[("friction", [1.0, 1.0])]).unwrap();
        assert_eq!(rows.row("domain", "friction"), Some([1.0, 1.0].as_slice()));
        assert!(resolved("slippery", &[("friction", [1.0, 3.0])]).is_err());
        let refusal = resolved("sticky", &[]).unwrap_err();
        assert_eq!(refusal.field, "options.domain.preset");
        assert!(refusal.to_string().contains("slippery"), "{refusal}");
    }
}
