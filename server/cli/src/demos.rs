//! `trocar demos`: records a scripted expert, or a person, as a data set.
//!
//! Minari and LeRobot are Python packages, and so is what writes their formats: this command checks
//! what it is asked for and becomes `python -m trocar.demos`, which uses this program as its server.

use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

use anyhow::Context;
use clap::{Args, ValueEnum};
use serde_json::Value;
use trocar_proto::Options;

use crate::catalog::Catalog;
use crate::options::{self, Given};
use crate::process::{PYTHON, python};

/// What Python runs: as `-m trocar.demos`, but says what to do where the package is missing.
const PROGRAM: &str = "\
import sys
try:
    from trocar.demos.__main__ import main
except ImportError as error:
    sys.exit(f'error: {sys.executable}: {error}; $TROCAR_PYTHON may name a Python that has trocar[demos]')
sys.exit(main(sys.argv[1:]))
";

/// Record a scripted expert, or what you do by hand, as a data set.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar demos --task NeedlePick-v0                     100 episodes into demos/
  trocar demos --task PegTransfer-v0 --episodes 500 --out data --resume
  trocar demos --task NeedleReach-v0 --format lerobot --json
  trocar demos --task NeedlePick-v0 --by-hand --episodes 10   at a page in your browser: key G takes an arm
  MINARI_DATASETS_PATH=demos python -c 'import minari; minari.load_dataset(\"trocar/NeedlePick-v0/expert-v0\")'

Episode k has the seed SEED + k. Those are kept whose last step ends in success. The data set holds the
task, options, seeds and version that it was made with, and the stage that the expert is in at every
step. What is done survives an interruption: --resume goes on. Needs a Python with trocar[demos]:
$TROCAR_PYTHON, else python3. With --json: {task, episodes, kept, path}.")]
pub(crate) struct Demos {
    /// A task id of `trocar tasks`
    #[arg(long, value_parser = crate::options::task_id)]
    task: String,
    /// How many episodes are run
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// Folder of data sets; this one is trocar/TASK/NAME in it
    #[arg(long, value_name = "DIR", default_value = "demos")]
    out: PathBuf,
    /// The data set's name, with a version [default: expert-v0, by hand hand-v0]
    #[arg(long)]
    name: Option<String>,
    /// What it is written as
    #[arg(long, value_enum, default_value_t = Format::Minari)]
    format: Format,
    /// Episode k has the seed SEED + k
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Most environments at a time
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    envs: u32,
    /// Keep episodes that do not succeed, too
    #[arg(long)]
    keep_failures: bool,
    #[command(flatten)]
    hands: Hands,
    /// Go on with an interrupted recording
    #[arg(long)]
    resume: bool,
    /// Run in the server of that name instead of in one of its own
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
    #[command(flatten)]
    options: Given,
    /// One JSON object on stdout
    #[arg(long)]
    json: bool,
}

/// What is about episodes by hand.
#[derive(Debug, Args)]
struct Hands {
    /// Drive the arms yourself, at the page whose address is printed; an episode ends with success, when you let go
    /// of the arms, or at the time limit
    #[arg(long)]
    by_hand: bool,
    /// Times real time, by hand
    #[arg(long, default_value_t = 1.0, requires = "by_hand")]
    speed: f64,
    /// Steps of an episode by hand [default: ten times the task's]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..), requires = "by_hand")]
    max_steps: Option<u32>,
}

/// Formats of data sets.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// HDF5, for `minari.load_dataset`
    Minari,
    /// LeRobot's, version 3.0
    Lerobot,
}

impl Demos {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let options = self.checked_options()?;
        let python = python();
        let mut command = Command::new(&python);
        let name = if self.hands.by_hand { "hand-v0" } else { "expert-v0" };
        let name = self.name.as_deref().unwrap_or(name);
        command.args(["-c", PROGRAM, "--task", &self.task, "--name", name]);
        command.args(["--format", self.format.to_possible_value().expect("all are").get_name()]);
        command.arg("--out").arg(&self.out);
        let numbers = [
            ("--episodes", self.episodes.into()),
            ("--seed", self.seed),
            ("--envs", self.envs.into()),
        ];
        for (flag, number) in numbers {
            command.args([flag, &number.to_string()]);
        }
        if self.hands.by_hand {
            command.args(["--by-hand", "--speed", &self.hands.speed.to_string()]);
        }
        if let Some(steps) = self.hands.max_steps {
            command.args(["--max-steps", &steps.to_string()]);
        }
        let switches = [
            ("--keep-failures", self.keep_failures),
            ("--resume", self.resume),
            ("--json", self.json),
        ];
        command.args(switches.iter().filter(|(_, given)| *given).map(|(flag, _)| flag));
        if let Some(server) = &self.server {
            command.args(["--server", server]);
        }
        let given = options.0.iter().map(|(name, value)| (name.clone(), options::json(value)));
        let given: Value = given.collect::<serde_json::Map<_, _>>().into();
        command.args(["--options", &given.to_string()]);
        command.env("TROCAR_BINARY", std::env::current_exe()?);
        // It takes this process's place, and so its terminal, signals and exit code.
        let error = command.exec();
        Err(error).with_context(|| format!("{} (${PYTHON} may name another)", python.display()))
    }

    /// The options, if the task and all of them are known and allowed.
    fn checked_options(&self) -> anyhow::Result<Options> {
        let catalog = Catalog::open(self.server.as_deref())?;
        let known = catalog.spec(&self.task, &Options::new())?;
        let options = options::options(&self.options.assignments(), &known.options)?;
        catalog.spec(&self.task, &options)?;
        Ok(options)
    }
}
