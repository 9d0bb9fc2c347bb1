//! A task's options as flags, and as JSON.

use std::collections::BTreeSet;

use anyhow::Context;
use clap::Args;
use serde_json::{Map, Value, json};
use trocar_proto::spec::{Allowed, OptionSpec, PRESET};
use trocar_proto::{OptionValue, Options, TaskSpec, similar};
use trocar_server::Registry;
pub(crate) use trocar_server::tasks::Assignment;

use crate::exit::Exit;

/// The options of tasks, as flags.
#[derive(Debug, Args)]
pub(crate) struct Given {
    /// sparse or dense
    #[arg(long, value_name = "WORD")]
    reward: Option<String>,
    /// What the numbers of an action mean: paper, cartesian, cartesian_abs or joint
    #[arg(long, value_name = "WORD")]
    action: Option<String>,
    /// What holds an object in the jaws: interact, approx or weld
    #[arg(long, value_name = "WORD")]
    grasp: Option<String>,
    /// With --grasp approx: from the jaws' tip to the object's surface, m
    #[arg(long, value_name = "METRES")]
    grasp_distance: Option<String>,
    /// Where objects and goals appear: workspace or narrow
    #[arg(long, value_name = "WORD")]
    spawn: Option<String>,
    /// How much is done when an episode begins: reset, approach, pick or lift
    #[arg(long, value_name = "WORD")]
    start: Option<String>,
    /// Whose numbers: paper or surrol
    #[arg(long, value_name = "WORD")]
    preset: Option<String>,
    #[command(flatten)]
    others: OptionFlags,
}

/// The flag `--option` of all commands.
#[derive(Debug, Args)]
pub(crate) struct OptionFlags {
    /// Any option of the task: NAME=VALUE, lists as NAME=A,B, rows of a table as NAME.ROW=LOW,HIGH; JSON values
    /// are accepted too. May be repeated
    #[arg(long = "option", value_name = "NAME=VALUE", value_parser = OptionFlag::parse)]
    flags: Vec<OptionFlag>,
}

impl OptionFlags {
    /// All assignments, in the order of the flags.
    pub(crate) fn assignments(&self) -> Vec<Assignment> {
        self.flags.iter().flat_map(|flag| &flag.0).cloned().collect()
    }
}

/// The assignments of one flag: several if its value is a JSON object, whose members are rows of a table.
#[derive(Debug, Clone, PartialEq)]
struct OptionFlag(Vec<Assignment>);

impl OptionFlag {
    fn parse(text: &str) -> Result<Self, String> {
        if let Some((name, value)) = text.split_once('=')
            && value.trim_start().starts_with(['[', '{', '"'])
        {
            let value: Value = serde_json::from_str(value)
                .map_err(|error| format!("neither NAME=VALUE nor NAME=JSON: {error}"))?;
            let assignments = from_json_members([(name, &value)]);
            return Ok(Self(assignments.map_err(|error| format!("{error:#}"))?));
        }
        Ok(Self(vec![Assignment::parse(text)?]))
    }
}

impl Given {
    /// All that were given, by name.
    pub(crate) fn assignments(&self) -> Vec<Assignment> {
        let named = [
            ("reward", &self.reward),
            ("action", &self.action),
            ("grasp", &self.grasp),
            ("grasp_distance", &self.grasp_distance),
            ("spawn", &self.spawn),
            ("start", &self.start),
            ("preset", &self.preset),
        ];
        let named = named
            .into_iter()
            .filter_map(|(name, text)| text.as_ref().map(|text| Assignment::new(name, text)));
        named.chain(self.others.assignments()).collect()
    }
}

/// The id of a task by its name, with or without `-v0`. Other names remain: a server may have tasks of its own.
#[expect(clippy::unnecessary_wraps, reason = "a parser of clap")]
pub(crate) fn task_id(name: &str) -> Result<String, std::convert::Infallible> {
    let is_named = |id: &&str| *id == name || id.strip_suffix("-v0") == Some(name);
    Ok(Registry::builtin().ids().find(is_named).unwrap_or(name).to_string())
}

/// The options that `assignments` give to a task that knows `known`. Unknown ones are refused.
pub(crate) fn options(assignments: &[Assignment], known: &[OptionSpec]) -> anyhow::Result<Options> {
    Ok(Assignment::options(assignments, known)?)
}

/// Every task with those of `assignments` that it knows. A single task must know all of them; of
/// several, some must.
pub(crate) fn for_tasks(
    assignments: &[Assignment],
    tasks: &[TaskSpec],
) -> anyhow::Result<Vec<(String, Options)>> {
    if let [task] = tasks {
        return Ok(vec![(task.id.clone(), options(assignments, &task.options)?)]);
    }
    let knows = |task: &TaskSpec, given: &Assignment| {
        task.options.iter().any(|option| option.name == given.name)
    };
    if let Some(unknown) =
        assignments.iter().find(|given| !tasks.iter().any(|task| knows(task, given)))
    {
        let known = tasks.iter().flat_map(|task| &task.options).map(|option| option.name.as_str());
        let hint = similar::hint(&unknown.name, known);
        let text = format!("options.{}: no task knows this option{hint}", unknown.name);
        return Err(Exit::Usage(text).into());
    }
    let with_options = |task: &TaskSpec| {
        let (known, others): (Vec<_>, Vec<_>) =
            assignments.iter().cloned().partition(|given| knows(task, given));
        for ignored in others {
            eprintln!("{}: has no option {}, ignored", task.id, ignored.name);
        }
        Ok((task.id.clone(), options(&known, &task.options)?))
    };
    tasks.iter().map(with_options).collect()
}

/// The assignments of a JSON object: values by the name of their option.
pub(crate) fn from_json(object: &str) -> anyhow::Result<Vec<Assignment>> {
    let object: Map<String, Value> = serde_json::from_str(object)?;
    from_json_members(object.iter().map(|(name, value)| (name.as_str(), value)))
}

/// The same for members of an object. A name may be that of a row, NAME.ROW.
fn from_json_members<'a>(
    members: impl IntoIterator<Item = (&'a str, &'a Value)>,
) -> anyhow::Result<Vec<Assignment>> {
    fn text(value: &Value) -> Option<String> {
        match value {
            Value::Bool(_) | Value::Number(_) => Some(value.to_string()),
            Value::String(word) => Some(word.clone()),
            Value::Array(parts) => {
                parts.iter().map(text).collect::<Option<Vec<_>>>().map(|parts| parts.join(","))
            }
            Value::Null | Value::Object(_) => None,
        }
    }
    let mut assignments = vec![];
    for (name, value) in members {
        let rows = match value {
            Value::Object(rows) => {
                rows.iter().map(|(row, value)| (format!("{name}.{row}"), value)).collect()
            }
            value => vec![(name.to_string(), value)],
        };
        for (path, value) in rows {
            let text = text(value)
                .with_context(|| format!("options.{path} = {value}: no option has such a value"))?;
            assignments.push(Assignment::parse(&format!("{path}={text}")).map_err(Exit::Usage)?);
        }
    }
    Ok(assignments)
}

/// A value as JSON.
pub(crate) fn json(value: &OptionValue) -> Value {
    match value {
        OptionValue::Flag(flag) => json!(flag),
        OptionValue::Number(number) => json!(number),
        OptionValue::Text(text) => json!(text),
        OptionValue::Numbers(numbers) => json!(numbers),
        OptionValue::Texts(texts) => json!(texts),
        OptionValue::Table(table) => json!(table),
        OptionValue::Preset(preset, table) => {
            let mut table = json!(table);
            table[PRESET] = json!(preset);
            table
        }
    }
}

/// What an option accepts as JSON: a list of words, or bounds.
pub(crate) fn allowed_json(allowed: &Allowed) -> Value {
    match allowed {
        Allowed::Flag => json!([true, false]),
        Allowed::Range { min, max } => json!({"min": min, "max": max}),
        Allowed::NumberOf(numbers) => json!(numbers),
        Allowed::OneOf(words) => json!(words),
        Allowed::SomeOf(words) => json!({"some_of": words}),
        Allowed::Vector { count, min, max } => json!({"count": count, "min": min, "max": max}),
        Allowed::Table(rows) => {
            let row = |row: &trocar_proto::spec::RowSpec| {
                (row.name.clone(), json!({"count": row.count, "min": row.min, "max": row.max}))
            };
            let presets: BTreeSet<_> = rows.iter().flat_map(|row| row.presets.keys()).collect();
            let preset = (!presets.is_empty()).then(|| (PRESET.to_string(), json!(presets)));
            Value::Object(rows.iter().map(row).chain(preset).collect())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_have_names_with_and_without_their_version() {
        for (name, id) in [
            ("NeedlePick", "NeedlePick-v0"),
            ("NeedlePick-v0", "NeedlePick-v0"),
            ("all", "all"),
            ("Own", "Own"),
        ] {
            assert_eq!(task_id(name), Ok(id.to_string()));
        }
    }

    fn read(texts: &[&str]) -> anyhow::Result<Options> {
        let assignments: Vec<_> =
            texts.iter().map(|text| Assignment::parse(text).unwrap()).collect();
        let registry = Registry::builtin();
        let spec = registry.spec("NeedleReach-v0", &Options::new()).unwrap();
        let options = options(&assignments, &spec.options)?;
        registry.spec("NeedleReach-v0", &options)?;
        Ok(options)
    }

    #[test]
    fn words_lists_and_rows_are_read() {
        let options =
            read(&["reward=dense", "domain.latency=0,2", "domain.observation_noise=0, 0.001"])
                .unwrap();
        assert_eq!(options.text("reward"), Some("dense"));
        assert_eq!(options.row("domain", "latency"), Some([0.0, 2.0].as_slice()));
        assert_eq!(options.row("domain", "observation_noise"), Some([0.0, 0.001].as_slice()));
        assert!(read(&["observation=state"]).is_ok());
    }

    #[test]
    fn a_policys_options_are_read_and_others_win() {
        let trained = r#"{"reward": "dense", "rate": 10, "domain": {"latency": [0, 2]}, "observation": ["state", "joints"]}"#;
        let mut assignments = from_json(trained).unwrap();
        assignments.push(Assignment::parse("reward=sparse").unwrap());
        let spec = Registry::builtin().spec("NeedleReach-v0", &Options::new()).unwrap();
        let options = options(&assignments, &spec.options).unwrap();
        assert_eq!(options.text("reward"), Some("sparse"));
        assert_eq!(options.row("domain", "latency"), Some([0.0, 2.0].as_slice()));
        assert_eq!(options.0["rate"], OptionValue::Number(10.0));
        let words = ["state", "joints"].map(String::from).to_vec();
        assert_eq!(options.0["observation"], OptionValue::Texts(words));
        for wrong in ["[1]", r#"{"rate": null}"#, r#"{"domain": {"latency": {}}}"#, "{"] {
            assert!(from_json(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn flags_may_have_json_values() {
        let read = |text| OptionFlag::parse(text).unwrap();
        let written = |texts: &[&str]| {
            OptionFlag(texts.iter().map(|text| Assignment::parse(text).unwrap()).collect())
        };
        assert_eq!(read("observation=state,rgb"), written(&["observation=state,rgb"]));
        assert_eq!(read(r#"observation=["state", "rgb"]"#), written(&["observation=state,rgb"]));
        assert_eq!(read(r#"reward="dense""#), written(&["reward=dense"]));
        assert_eq!(
            read(r#"domain={"latency": [0, 2], "preset": "dvrk"}"#),
            written(&["domain.latency=0,2", "domain.preset=dvrk"])
        );
        assert_eq!(read("domain.latency=[0, 2]"), written(&["domain.latency=0,2"]));
        for wrong in ["reward", "domain={", r#"domain={"latency": null}"#] {
            assert!(OptionFlag::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn what_is_not_allowed_is_refused_with_what_is() {
        let refused = |text| format!("{:#}", read(&[text]).unwrap_err());
        assert!(refused("reward=shaped").contains("sparse"));
        assert!(refused("rewards=dense").contains("reward"));
        assert!(refused("domain=1").contains("latency"));
        assert!(refused("domain.latency=soon").contains("latency"));
        assert!(refused("domain.weather=1,2").contains("latency"));
        assert!(Assignment::parse("reward").is_err());
    }
}
