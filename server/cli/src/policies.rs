//! `trocar policies`: the policies that this program has, under the names of their tasks.
//!
//! They are the files of `assets/policies`, which `python -m trocar.rl export` wrote. Each holds its card.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use trocar_network::Network;

use crate::exit::Exit;
use crate::output;

macro_rules! files {
    ($($task:literal)*) => {
        [$(($task, include_bytes!(concat!("../../../assets/policies/", $task, ".onnx")))),*]
    };
}

/// The best policy known of each task: the task's id, and the file.
const FILES: [(&str, &[u8]); 15] = files! {
    "NeedleReach-v0" "GauzeRetrieve-v0" "NeedlePick-v0" "PegTransfer-v0" "NeedleRegrasp-v0" "BiPegTransfer-v0"
    "EcmReach-v0" "MisOrient-v0" "StaticTrack-v0" "ActiveTrack-v0"
    "CylinderReach-v0" "CylinderPick-v0" "TissueRetract-v0" "TissuePoint-v0" "GauzePlace-v0"
};

/// The policy of that name: the id of its task, with or without version.
pub(crate) fn find(name: &str) -> Option<Network> {
    let named = |(task, _): &&(&str, _)| *task == name || *task == format!("{name}-v0");
    FILES.iter().find(named).map(|(task, bytes)| read(task, bytes))
}

/// The names of all.
pub(crate) fn names() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|(task, _)| task.trim_end_matches("-v0"))
}

fn read(task: &str, bytes: &[u8]) -> Network {
    Network::read(Path::new(task), bytes.to_vec()).expect("a test reads them all")
}

/// List the policies that come with Trocar: how each was trained, and how well it does.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar policies                                     a table
  trocar policies --json                              {task, options, version, bytes} and the card
  trocar policies --save policies                     the files: policies/NeedlePick-v0.onnx, ...
  trocar rollout --policy NeedlePick --episodes 200   repeats the card's figure with other seeds
  trocar rollout --policy NeedlePick --view           shows it at work

Success is that of an episode's last step. The last three columns are rollouts in conditions that
the policy was not trained with: twice as many steps a second, arms that are 60 ms late, and noise
of 0.5 mm that they add to each command.")]
pub(crate) struct Policies {
    /// Write the ONNX files into this folder
    #[arg(long, value_name = "FOLDER")]
    save: Option<PathBuf>,
    /// One JSON object per policy and line, on stdout
    #[arg(long)]
    json: bool,
}

/// What the card of a policy says.
#[derive(Debug, Deserialize)]
struct Card {
    algorithm: String,
    #[serde(flatten)]
    result: Score,
    confidence_95: Option<[f64; 2]>,
    trainer_cpu_s: f64,
    server_cpu_s: f64,
    conditions: Vec<Condition>,
}

/// How well a policy does.
#[derive(Debug, Deserialize)]
struct Score {
    success_rate: Option<f64>,
    mean_return: f64,
    mean_length: f64,
}

/// How well it does in a condition that it was not trained with.
#[derive(Debug, Deserialize)]
struct Condition {
    name: String,
    #[serde(flatten)]
    result: Score,
}

impl Score {
    /// The part of episodes that succeed; of a task without success, the mean reward.
    fn text(&self) -> String {
        match self.success_rate {
            Some(_) => output::percent(self.success_rate),
            None => format!("return {:.3} a step", self.mean_return / self.mean_length),
        }
    }
}

impl Policies {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        if let Some(folder) = &self.save {
            save(folder)?;
        }
        if self.json {
            return FILES
                .iter()
                .try_for_each(|(task, bytes)| output::json_line(&object(task, bytes)?));
        }
        let mut table = output::table(&HEADER, 2);
        for (task, bytes) in FILES {
            table.add_row(row(&card(&read(task, bytes))?, task));
        }
        eprintln!("{table}");
        Ok(())
    }
}

fn save(folder: &Path) -> anyhow::Result<()> {
    let fail = |error| Exit::Usage(format!("--save {}: {error}", folder.display()));
    std::fs::create_dir_all(folder).map_err(fail)?;
    for (task, bytes) in FILES {
        let path = folder.join(format!("{task}.onnx"));
        std::fs::write(&path, bytes).with_context(|| format!("writing {}", path.display()))?;
    }
    eprintln!("wrote {} files into {}", FILES.len(), folder.display());
    Ok(())
}

/// All that is known of a policy.
fn object(task: &str, bytes: &[u8]) -> anyhow::Result<Map<String, Value>> {
    let policy = read(task, bytes);
    let mut object: Map<String, Value> = serde_json::from_str(policy.card().unwrap_or("{}"))?;
    object.insert("task".into(), json!(task));
    object.insert("options".into(), serde_json::from_str(policy.options().unwrap_or("{}"))?);
    object.insert("version".into(), json!(policy.version()));
    object.insert("bytes".into(), json!(bytes.len()));
    Ok(object)
}

fn card(policy: &Network) -> anyhow::Result<Card> {
    let text = policy.card().with_context(|| format!("{} has no card", policy.path().display()))?;
    Ok(serde_json::from_str(text)?)
}

const HEADER: [&str; 8] = [
    "task",
    "algorithm",
    "trained in",
    "success",
    "95 % interval, %",
    "twice the rate",
    "60 ms late",
    "noise 0.5 mm",
];

/// A line of the table.
fn row(card: &Card, task: &str) -> Vec<String> {
    let seconds = card.trainer_cpu_s + card.server_cpu_s;
    let within = |[low, high]: [f64; 2]| format!("{:.1} to {:.1}", 100.0 * low, 100.0 * high);
    let mut row = vec![
        task.trim_end_matches("-v0").to_string(),
        card.algorithm.clone(),
        format!("{seconds:.0} CPU s"),
        card.result.text(),
        card.confidence_95.map_or_else(|| "-".into(), within),
    ];
    row.extend(HEADER[5..].iter().map(|name| {
        let found = card.conditions.iter().find(|condition| condition.name == *name);
        found.map_or_else(|| "-".into(), |condition| condition.result.text())
    }));
    row
}

#[cfg(test)]
mod tests {
    use trocar_proto::Options;
    use trocar_server::Registry;

    use super::*;
    use crate::policy::Chooser;

    #[test]
    fn every_task_has_one_that_acts_in_it() {
        let registry = Registry::builtin();
        for id in registry.ids() {
            let policy = find(id).unwrap_or_else(|| panic!("{id} has no policy"));
            assert_eq!(policy.task(), Some(id));
            let chooser = Chooser::Network(policy);
            let spec = registry.spec(id, &Options::new()).unwrap();
            let options = chooser.with_options(vec![]).unwrap();
            let options = crate::options::options(&options, &spec.options).unwrap();
            chooser.check(&registry.spec(id, &options).unwrap()).unwrap();
        }
        assert_eq!(FILES.len(), registry.ids().count());
    }

    #[test]
    fn they_are_small_and_their_page_says_what_their_cards_do() {
        let page = include_str!("../../../assets/policies/README.md");
        for (task, bytes) in FILES {
            assert!(bytes.len() <= 700_000, "{task}: {} bytes", bytes.len());
            let row = row(&card(&read(task, bytes)).unwrap(), task);
            let line = page.lines().find(|line| line.starts_with(&format!("| {} |", row[0])));
            let line = line.unwrap_or_else(|| panic!("assets/policies/README.md lacks {task}"));
            assert!(row.iter().all(|cell| line.contains(cell)), "{line}\n{row:?}");
        }
    }
}
