//! A task's options as text: `reward=dense`, `domain.latency=0,2`, `domain.preset=dvrk`.

use std::collections::BTreeMap;

use trocar_proto::spec::{self, Allowed, OptionSpec, PRESET};
use trocar_proto::{OptionValue, Options, Rejection};

/// `NAME=VALUE` or, for a row of a table, `NAME.ROW=VALUE`.
#[derive(Debug, Clone, PartialEq)]
pub struct Assignment {
    /// The option.
    pub name: String,
    /// The row, where the option is a table.
    row: Option<String>,
    text: String,
}

impl Assignment {
    /// The option `name` with the value `text`.
    pub fn new(name: &str, text: &str) -> Self {
        Self { name: name.into(), row: None, text: text.into() }
    }

    /// Reads `NAME=VALUE` or `NAME.ROW=VALUE`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (path, value) = text.split_once('=').ok_or("expected NAME=VALUE")?;
        let (name, row) = match path.split_once('.') {
            Some((name, row)) => (name, Some(row.to_string())),
            None => (path, None),
        };
        Ok(Self { name: name.into(), row, text: value.into() })
    }

    /// The options that `assignments` give to a task that knows `known`. Unknown ones are refused; values are
    /// checked when the task is made.
    pub fn options(assignments: &[Self], known: &[OptionSpec]) -> Result<Options, Rejection> {
        let mut options = Options::new();
        for assignment in assignments {
            let name = &assignment.name;
            let Some(option) = known.iter().find(|option| option.name == *name) else {
                return Err(spec::unknown(name, format!("{:?}", assignment.text), known));
            };
            let value = assignment.value(option);
            match (options.0.get_mut(name), value) {
                // Rows of one table add up.
                (
                    Some(OptionValue::Table(table) | OptionValue::Preset(_, table)),
                    OptionValue::Table(rows),
                ) => table.extend(rows),
                (Some(OptionValue::Table(table)), OptionValue::Preset(preset, _)) => {
                    let preset = OptionValue::Preset(preset, std::mem::take(table));
                    options = options.with(name, preset);
                }
                (_, value) => options = options.with(name, value),
            }
        }
        Ok(options)
    }

    /// The value, as the option wants it. What cannot be read as that is left a word, so that the
    /// task's own check refuses it and says what is allowed.
    fn value(&self, option: &OptionSpec) -> OptionValue {
        let word = || OptionValue::Text(self.text.clone());
        let numbers = || -> Option<Vec<f64>> {
            self.text.split(',').map(|part| part.trim().parse().ok()).collect()
        };
        match (&option.allowed, &self.row) {
            (Allowed::Flag, None) => self.text.parse().map_or_else(|_| word(), OptionValue::Flag),
            (Allowed::Range { .. } | Allowed::NumberOf(_), None) => {
                self.text.parse().map_or_else(|_| word(), OptionValue::Number)
            }
            (Allowed::SomeOf(_), None) => {
                OptionValue::Texts(self.text.split(',').map(|part| part.trim().into()).collect())
            }
            (Allowed::Vector { .. }, None) => numbers().map_or_else(word, OptionValue::Numbers),
            (Allowed::Table(_), Some(row)) if row == PRESET => {
                OptionValue::Preset(self.text.clone(), BTreeMap::new())
            }
            (Allowed::Table(_), Some(row)) => match numbers() {
                Some(numbers) => OptionValue::Table(BTreeMap::from([(row.clone(), numbers)])),
                None => word(),
            },
            _ => word(),
        }
    }
}
