//! The `trocar` command. JSON goes to stdout, everything for people to stderr.
//!
//! | file | holds |
//! |---|---|
//! | `serve.rs`, `status.rs`, `stop.rs`, `clean.rs` | a server's life |
//! | `tasks.rs`, `rollout.rs`, `bench.rs` | what there is to learn, how well a policy does, how fast |
//! | `learn.rs` | trains a policy, in Python |
//! | `render.rs` | pictures of rollouts: contact sheets, moving pictures |
//! | `record.rs`, `replay.rs` | episodes as files, from which they are played again |
//! | `dvrk.rs` | the program of its own that is a node of ROS 2 |
//! | `demos.rs` | scripted experts as data sets |
//! | `demo.rs` | a moving picture; one server and three clients in two languages at once |
//! | `load.rs` | many clients at once that are killed and stopped, each compared with a twin |
//! | `policy.rs`, `policies.rs` | agents: experts, chance, trained policies; the policies that come with Trocar |
//! | `catalog.rs` | tasks of this program, or of a server |
//! | `process.rs`, `options.rs` | processes that are started; options as text |
//! | `usage.rs`, `inherited.rs` | what other processes use, and what they leave open |
//! | `logging.rs` | what is logged, and how |
//! | `output.rs`, `exit.rs` | JSON lines, tables; exit codes |

mod bench;
mod catalog;
mod clean;
mod demo;
mod demos;
mod drive;
mod dvrk;
mod exit;
mod inherited;
mod learn;
mod load;
mod logging;
mod options;
mod output;
mod policies;
mod policy;
mod process;
mod record;
mod render;
mod replay;
mod rollout;
mod serve;
mod status;
mod stop;
mod tasks;
mod usage;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::logging::Logging;

/// A surgical-robot simulation service: one server, any number of trainers.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true, after_help = AFTER_HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const AFTER_HELP: &str = "\
A first session:
  trocar demo                                    a moving picture, a server and three clients
  trocar tasks                                   what there is to learn
  trocar rollout --task NeedleReach-v0           how well its scripted expert does, in this process
  trocar policies                                policies that were trained already
  trocar learn NeedlePick                        trains one, in minutes
  trocar render --out all.png                    what every task looks like
  trocar serve --name lab                        a server that trainers share (Ctrl-C ends it)
  trocar rollout --task all --server lab         the same episodes, in that server
  trocar record --task NeedlePick-v0 --out pick.trocar   an episode, for `trocar replay pick.trocar`
  trocar demos --task NeedlePick-v0 --out data   its scripted expert as a Minari data set
  trocar dvrk --task NeedlePick-v0               a da Vinci Research Kit on ROS 2, for its owners' scripts
  trocar bench --quick                           how fast this machine is
  trocar load --kill-every 2 --stop-every 5      what many clients, some of them killed, do to it
  trocar status --name lab --watch               its clients, and how fast it runs
  trocar stop --name lab                         ends it

Output: with --json, one JSON object a line on stdout; everything for people goes to stderr,
except the tables of `trocar tasks`, which go to stdout.

Exit codes:
  0  done
  1  failure
  2  wrong usage: unknown flag, task or option, or a value that is not allowed
  3  no server of that name runs (or it ended meanwhile)
  4  the name is in use by another server, or its files are

Environment:
  TROCAR_LOG  what is logged to stderr, e.g. warn (default: info) or trocar_server=debug";

#[derive(Debug, Subcommand)]
enum Command {
    /// Start a server that trainers can connect to
    Serve(serve::Serve),
    /// Show running servers: their clients, and how fast they run
    Status(status::Status),
    /// End a server and wait until it has ended
    Stop(stop::Stop),
    /// Remove what crashed servers and clients left in shared memory
    Clean(clean::Clean),
    /// List the tasks and their options
    Tasks(tasks::Tasks),
    /// List the policies that come with Trocar, and how well they do
    Policies(policies::Policies),
    /// Train a policy of a task, by the best way known, in minutes
    Learn(learn::Learn),
    /// Run a policy for some episodes and report how often it succeeds
    Rollout(rollout::Rollout),
    /// Draw rollouts: a contact sheet, a moving picture, or one picture of each task
    Render(render::Render),
    /// Drive the arms of a task by keyboard or gamepad, in the browser
    Drive(drive::Drive),
    /// Record episodes, of a policy or of a session of a server, to play them again
    Record(record::Record),
    /// Play a recording again, compare its bits, draw it
    Replay(replay::Replay),
    /// Record a scripted expert as a data set (Minari, LeRobot)
    Demos(demos::Demos),
    /// Be a da Vinci Research Kit on ROS 2, whose arms move in the world of a task
    Dvrk(dvrk::Dvrk),
    /// Measure environment steps per second, in this process and through a server
    Bench(bench::Bench),
    /// Load a server with many clients, kill and stop some, and compare every bit
    Load(load::Load),
    /// One client of the load
    #[command(hide = true)]
    LoadClient(load::worker::LoadClient),
    /// Show a robot at work, and one server with a Rust and two Python clients
    Demo(demo::Demo),
    /// One client of the demonstration
    #[command(hide = true)]
    DemoClient(demo::client::DemoClient),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    exit::report(run(cli.command))
}

fn run(command: Command) -> anyhow::Result<()> {
    match &command {
        Command::Serve(serve) => serve.start_logging()?,
        _ => Logging::default().start("info")?,
    }
    match command {
        Command::Serve(serve) => serve.run(),
        Command::Status(status) => status.run(),
        Command::Stop(stop) => stop.run(),
        Command::Clean(clean) => clean.run(),
        Command::Tasks(tasks) => tasks.run(),
        Command::Policies(policies) => policies.run(),
        Command::Learn(learn) => learn.run(),
        Command::Rollout(rollout) => rollout.run(),
        Command::Render(render) => render.run(),
        Command::Drive(drive) => drive.run(),
        Command::Record(record) => record.run(),
        Command::Replay(replay) => replay.run(),
        Command::Demos(demos) => demos.run(),
        Command::Dvrk(dvrk) => dvrk.run(),
        Command::Bench(bench) => bench.run(),
        Command::Load(load) => load.run(),
        Command::LoadClient(client) => client.run(),
        Command::Demo(demo) => demo.run(),
        Command::DemoClient(client) => client.run(),
    }
}
