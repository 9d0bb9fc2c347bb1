//! The `trocar` command. JSON goes to stdout, everything for people to stderr.

mod serve;

use clap::{Parser, Subcommand};
use tracing_subscriber::EnvFilter;

/// A surgical-robot simulation service: one server, any number of trainers.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Start a server that trainers can connect to
    Serve(serve::Serve),
}

fn main() -> anyhow::Result<()> {
    let cli = Cli::parse();
    let filter = EnvFilter::try_from_env("TROCAR_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    match cli.command {
        Command::Serve(serve) => serve.run(),
    }
}
