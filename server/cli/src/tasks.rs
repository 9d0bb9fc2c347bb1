//! `trocar tasks`: the tasks and their options.

use std::io::{self, Write};

use clap::Args;
use serde::Serialize;
use serde_json::{Map, Value, json};
use trocar_proto::TaskSpec;
use trocar_proto::spec::OptionSpec;

use crate::catalog::Catalog;
use crate::{options, output};

/// Options by groups; the remaining options are in a group of their own.
const GROUPS: [(&str, &[&str]); 4] = [
    (
        "Task and episode",
        &["preset", "reward", "terminate", "tolerance", "spawn", "start", "arm", "setup"],
    ),
    ("Control and grasp", &["action", "rate", "grasp", "grasp_distance", "instrument", "squeeze"]),
    (
        "Observations and pictures",
        &[
            "observation",
            "image_size",
            "camera",
            "camera_eye",
            "camera_target",
            "camera_view",
            "look",
            "expert_sees",
        ],
    ),
    ("Errors and randomisation", &["domain"]),
];

/// List the tasks and their options.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar tasks           a table of all tasks
  trocar tasks NeedlePick   the options of a task
  trocar tasks --server own   the tasks of a server, which may have its own
  trocar tasks --json    {id, action_dim, observation_dim, goal_dim, max_steps, seconds_per_step, options}

In Python a task is gym.make(\"trocar/<task>\", option=value, …).")]
pub(crate) struct Tasks {
    /// A task, to list its options
    #[arg(value_name = "NAME", value_parser = options::task_id)]
    task: Option<String>,
    /// List the tasks of the server of that name
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
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
        let catalog = Catalog::open(self.server.as_deref())?;
        let ids = match &self.task {
            Some(task) => vec![task.clone()],
            None => catalog.tasks()?,
        };
        let specs = catalog.specs(&ids)?;
        if self.json {
            return specs.iter().try_for_each(|spec| output::json_line(&row(spec)));
        }
        match (&self.task, specs.as_slice()) {
            (Some(_), [spec]) => option_tables(spec),
            _ => task_table(&specs),
        }
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

/// The table of all tasks.
fn task_table(specs: &[TaskSpec]) -> anyhow::Result<()> {
    let header = ["task", "what is learnt", "action", "state", "goal", "steps × s"];
    let mut table = output::stdout_table(&header, 2);
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
    writeln!(io::stdout(), "{table}\ntrocar tasks NAME lists the options of a task.")?;
    Ok(())
}

/// The options of a task, by groups.
fn option_tables(spec: &TaskSpec) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{}: {}", spec.id, spec.summary)?;
    let others = |name: &str| !GROUPS.iter().any(|(_, names)| names.contains(&name));
    let groups = GROUPS.iter().map(|(title, names)| (*title, *names)).chain([("Others", &[][..])]);
    for (title, names) in groups {
        let is_member = |option: &&OptionSpec| {
            let name = option.name.as_str();
            names.contains(&name) || names.is_empty() && others(name)
        };
        let options: Vec<_> = spec.options.iter().filter(is_member).collect();
        if options.is_empty() {
            continue;
        }
        let mut table = output::stdout_table(&["option", "default", "accepts"], 3);
        for option in options {
            let accepts = format!("{}\n{}", option.allowed, option.summary);
            table.add_row([option.name.clone(), option.default.to_string(), accepts]);
        }
        writeln!(stdout, "\n{title}\n{table}")?;
    }
    Ok(())
}
