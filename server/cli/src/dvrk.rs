//! `trocar dvrk`: runs the program of its own that is a node of ROS 2, since it brings forty packages that nothing else
//! needs.

use std::convert::Infallible;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::Command;

use anyhow::Context;
use clap::Args;

/// The program, which lies beside this one.
const PROGRAM: &str = "trocar-dvrk";

#[derive(Debug, Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Dvrk {
    /// What the program takes; --help lists it
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

impl Dvrk {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let here = std::env::current_exe().context("the path of this program")?;
        let program = here.with_file_name(PROGRAM);
        // Where it succeeds, this process has become the other.
        let error = Command::new(&program).args(self.arguments).exec();
        let hint = "it is a program of its own, beside this one; in Trocar's source tree, \
                    `cargo build --release -p trocar-ros2` makes it";
        Err::<Infallible, _>(error)
            .with_context(|| format!("{}: {hint}", program.display()))
            .map(|never| match never {})
    }
}
