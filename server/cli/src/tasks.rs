//! `trocar tasks`: the tasks and their options.

use clap::Args;
use serde::Serialize;
use serde_json::{Map, Value, json};
use trocar_proto::{Options, TaskSpec};
use trocar_server::Registry;

use crate::{options, output};

/// List the tasks and their options.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar tasks           a table, and what every option accepts
  trocar tasks --json    {id, action_dim, observation_dim, goal_dim, max_steps, seconds_per_step, options}

In Python a task is gym.make(\"trocar/<task>\", option=value, …).")]
pub(crate) struct Tasks {
    /// One JSON object per task and line, on stdout
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Row<'a> {
    id: &'a str,
    action_dim: usize,
    observation_dim: usize,
    goal_dim: usize,
    max_steps: u32,
    seconds_per_step: f64,
    options: Map<String, Value>,
}

impl Tasks {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let registry = Registry::builtin();
        let specs = registry
            .ids()
            .map(|id| registry.spec(id, &Options::new()))
            .collect::<Result<Vec<_>, _>>()?;
        if self.json {
            return specs.iter().try_for_each(|spec| output::json_line(&row(spec)));
        }
        show_for_people(&specs);
        Ok(())
    }
}

fn row(spec: &TaskSpec) -> Row<'_> {
    let options = spec.options.iter().map(|option| {
        let entry = json!({
            "default": options::json(&option.default),
            "allowed": options::allowed_json(&option.allowed),
            "summary": option.summary,
        });
        (option.name.clone(), entry)
    });
    Row {
        id: &spec.id,
        action_dim: spec.action_dim(),
        observation_dim: spec.observation_dim(),
        goal_dim: spec.goal_dim(),
        max_steps: spec.max_steps,
        seconds_per_step: spec.seconds_per_step,
        options: options.collect(),
    }
}

fn show_for_people(specs: &[TaskSpec]) {
    let mut table =
        output::table(&["task", "what is learnt", "action", "state", "goal", "steps × s"], 2);
    for spec in specs {
        table.add_row([
            spec.id.clone(),
            spec.summary.clone(),
            spec.action_dim().to_string(),
            spec.observation_dim().to_string(),
            spec.goal_dim().to_string(),
            format!("{} × {}", spec.max_steps, spec.seconds_per_step),
        ]);
    }
    eprintln!("{table}");
    let mut table = output::table(&["option", "default", "accepts", "tasks"], 4);
    let mut shown: Vec<(&str, String)> = Vec::new();
    for option in specs.iter().flat_map(|spec| &spec.options) {
        let key = (option.name.as_str(), option.allowed.to_string());
        if shown.contains(&key) {
            continue;
        }
        let knows = |spec: &&TaskSpec| spec.options.contains(option);
        let tasks: Vec<_> =
            specs.iter().filter(knows).map(|spec| spec.id.trim_end_matches("-v0")).collect();
        let tasks = if tasks.len() == specs.len() { "all".into() } else { tasks.join(", ") };
        let accepts = format!("{}\n{}", option.allowed, option.summary);
        table.add_row([option.name.clone(), option.default.to_string(), accepts, tasks]);
        shown.push(key);
    }
    eprintln!("{table}");
}
