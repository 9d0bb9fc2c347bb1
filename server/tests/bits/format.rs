//! The file of recorded episodes. Its format is its own, so that neither a new version of the protocol nor
//! one of the release can change what it says.
//!
//! Little-endian. The file: [`MAGIC`], [`VERSION`] (u32), number of episodes (u32), the episodes.
//! An episode: task id and options as texts (length as u16, UTF-8), seed (u64), number under the seed (u32),
//! steps that the expert chose (u16), numbers in an action (u8), steps (u16), actions (i16 each, in
//! [`ACTION_UNIT`]), hashes per mark (u8), marks (u16), the marks: step (u16), hashes (u64 each).
//! Options are those that were given, as a JSON object; options that are added later take their defaults.

use serde_json::{Map, Value, json};
use trocar_proto::{OptionValue, Options};

const MAGIC: &[u8; 8] = b"trocbits";

/// Version of the format, and of nothing else.
const VERSION: u32 = 1;

/// Unit of the numbers in stored actions: a power of two, so that no number is rounded.
const ACTION_UNIT: f32 = 1.0 / 16384.0;

/// What the hashes of a mark are of, in their order; the pictures' are missing where none are asked for.
pub(crate) const HASHED: [&str; 8] =
    ["world", "observation", "goals", "rewards and flags", "rgb", "depth", "mask", "points"];

/// How many of [`HASHED`] are of no picture.
pub(crate) const OF_STATE: usize = 4;

/// An episode as it was recorded.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Episode {
    pub(crate) task: String,
    /// The options that were given.
    pub(crate) options: Options,
    pub(crate) seed: u64,
    /// Number under the seed.
    pub(crate) number: u32,
    /// How many of the actions were the expert's.
    pub(crate) expert_steps: u16,
    /// Numbers in an action.
    pub(crate) dim: u8,
    /// All actions one after another, in [`ACTION_UNIT`].
    pub(crate) actions: Vec<i16>,
    pub(crate) marks: Vec<Mark>,
}

/// What an episode looked like after a step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Mark {
    /// Actions taken until then.
    pub(crate) step: u16,
    /// Hashes of [`HASHED`].
    pub(crate) hashes: Vec<u64>,
}

/// A number of an action as it is stored.
pub(crate) fn quantised(number: f32) -> i16 {
    (number / ACTION_UNIT).round() as i16
}

/// A stored number of an action.
pub(crate) fn number(stored: i16) -> f32 {
    f32::from(stored) * ACTION_UNIT
}

impl Episode {
    pub(crate) fn steps(&self) -> usize {
        self.actions.len() / usize::from(self.dim)
    }

    pub(crate) fn actions(&self) -> impl Iterator<Item = Vec<f32>> {
        let numbers = |action: &[i16]| action.iter().copied().map(number).collect();
        self.actions.chunks_exact(usize::from(self.dim)).map(numbers)
    }

    /// True if it begins in a prepared state.
    pub(crate) fn has_start_of_expert(&self) -> bool {
        self.options.text("start").is_some_and(|start| start != "reset")
            || self.task == "NeedleRegrasp-v0"
    }

    pub(crate) fn has_pictures(&self) -> bool {
        self.marks.iter().all(|mark| mark.hashes.len() > OF_STATE)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        for text in [self.task.clone(), json_of(&self.options)] {
            bytes.extend((text.len() as u16).to_le_bytes());
            bytes.extend(text.as_bytes());
        }
        bytes.extend(self.seed.to_le_bytes());
        bytes.extend(self.number.to_le_bytes());
        bytes.extend(self.expert_steps.to_le_bytes());
        bytes.push(self.dim);
        bytes.extend((self.steps() as u16).to_le_bytes());
        bytes.extend(self.actions.iter().flat_map(|number| number.to_le_bytes()));
        bytes.push(self.marks[0].hashes.len() as u8);
        bytes.extend((self.marks.len() as u16).to_le_bytes());
        for mark in &self.marks {
            bytes.extend(mark.step.to_le_bytes());
            bytes.extend(mark.hashes.iter().flat_map(|hash| hash.to_le_bytes()));
        }
    }

    fn read(bytes: &mut &[u8]) -> Self {
        let [task, options] = [(); 2].map(|()| {
            let length = u16::from_le_bytes(take(bytes));
            let (text, rest) = bytes.split_at(usize::from(length));
            *bytes = rest;
            String::from_utf8(text.to_vec()).unwrap()
        });
        let seed = u64::from_le_bytes(take(bytes));
        let number = u32::from_le_bytes(take(bytes));
        let expert_steps = u16::from_le_bytes(take(bytes));
        let [dim] = take(bytes);
        let steps = u16::from_le_bytes(take(bytes));
        let count = usize::from(dim) * usize::from(steps);
        let actions = (0..count).map(|_| i16::from_le_bytes(take(bytes))).collect();
        let [hashes] = take(bytes);
        let marks = u16::from_le_bytes(take(bytes));
        let mark = |_| Mark {
            step: u16::from_le_bytes(take(bytes)),
            hashes: (0..hashes).map(|_| u64::from_le_bytes(take(bytes))).collect(),
        };
        let marks = (0..marks).map(mark).collect();
        let options = options_of(&options);
        Self { task, options, seed, number, expert_steps, dim, actions, marks }
    }
}

/// Episodes as a file.
pub(crate) fn encode(episodes: &[Episode]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend((episodes.len() as u32).to_le_bytes());
    for episode in episodes {
        episode.write(&mut bytes);
    }
    bytes
}

/// The episodes of a file; panics where it is none.
pub(crate) fn decode(mut bytes: &[u8]) -> Vec<Episode> {
    let bytes = &mut bytes;
    assert_eq!(&take(bytes), MAGIC, "no file of recorded episodes");
    assert_eq!(u32::from_le_bytes(take(bytes)), VERSION, "version of the format");
    let count = u32::from_le_bytes(take(bytes));
    let episodes = (0..count).map(|_| Episode::read(bytes)).collect();
    assert!(bytes.is_empty(), "{} bytes too many", bytes.len());
    episodes
}

fn take<const N: usize>(bytes: &mut &[u8]) -> [u8; N] {
    let (taken, rest) = bytes.split_first_chunk().expect("the file is complete");
    *bytes = rest;
    *taken
}

/// Given options as a JSON object.
pub(crate) fn json_of(options: &Options) -> String {
    let json = |value: &OptionValue| match value {
        OptionValue::Flag(flag) => json!(flag),
        OptionValue::Number(number) => json!(number),
        OptionValue::Text(word) => json!(word),
        OptionValue::Numbers(numbers) => json!(numbers),
        OptionValue::Texts(words) => json!(words),
        OptionValue::Table(rows) => json!(rows),
        OptionValue::Preset(..) => panic!("episodes are kept with all their rows"),
    };
    let object: Map<_, _> =
        options.0.iter().map(|(name, value)| (name.clone(), json(value))).collect();
    Value::Object(object).to_string()
}

fn options_of(text: &str) -> Options {
    let numbers =
        |list: &Value| -> Option<Vec<f64>> { list.as_array()?.iter().map(Value::as_f64).collect() };
    let value = |value: Value| match value {
        Value::Bool(flag) => OptionValue::Flag(flag),
        Value::Number(number) => OptionValue::Number(number.as_f64().unwrap()),
        Value::String(word) => OptionValue::Text(word),
        Value::Object(rows) => {
            let rows = rows.into_iter().map(|(name, row)| (name, numbers(&row).unwrap()));
            OptionValue::Table(rows.collect())
        }
        list => numbers(&list).map_or_else(
            || OptionValue::Texts(serde_json::from_value(list.clone()).unwrap()),
            OptionValue::Numbers,
        ),
    };
    let object: Map<String, Value> = serde_json::from_str(text).unwrap();
    Options(object.into_iter().map(|(name, given)| (name, value(given))).collect())
}
