//! `trocar learn`: trains a policy, in a Python that has `trocar[rl]`.

use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

use anyhow::Context;
use clap::Args;

use crate::process;

/// Train a policy of a task, by the best way known, in minutes.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar learn NeedlePick                        from 100 demonstrations of the expert
  trocar learn PegTransfer --view                and its viewer shows it as it learns
  trocar learn NeedlePick --algo bc --seed 1     any argument of `python -m trocar.rl train`
  python -m trocar learn NeedlePick              in this Python

Needs the extra `rl` of the Python package (docs/python.md). A run writes its curve and its policies
into a folder of `runs`, and says how long it will take. Ctrl-C interrupts it, --resume goes on; for
algorithms of Stable-Baselines3 with --trust, since their files can run code.")]
pub(crate) struct Learn {
    /// A task of `trocar tasks`
    task: String,
    /// The Python that has the package `trocar[rl]` [default: $TROCAR_PYTHON, else python3]
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
    /// Arguments of `python -m trocar.rl train`
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

impl Learn {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let python = self.python.unwrap_or_else(process::python);
        // This process becomes the trainer, whose server is this program.
        let error = Command::new(&python)
            .args(["-m", "trocar.rl", "train", "--task", &self.task])
            .args(&self.arguments)
            .env("TROCAR_BINARY", std::env::current_exe()?)
            .exec();
        Err(error).with_context(|| format!("--python {}", python.display()))
    }
}
