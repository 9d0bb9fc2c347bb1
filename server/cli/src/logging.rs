//! Logs of the server: to stderr, as text or JSON.

use std::io::IsTerminal;

use clap::{Args, ValueEnum};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::ParseError;

use crate::exit::Exit;

/// The environment variable that says what is logged.
const VARIABLE: &str = "TROCAR_LOG";

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Format {
    /// A line for people
    #[default]
    Text,
    /// A JSON object a line: timestamp, level, target, fields
    Json,
}

/// How a server logs.
#[derive(Debug, Default, Args)]
pub(crate) struct Logging {
    /// What is logged to stderr: error, warn, info, debug, trace, or these by module, as in
    /// info,trocar_server=debug [default: $TROCAR_LOG, else info]
    #[arg(long, value_name = "LEVELS", value_parser = parse)]
    log: Option<String>,
    /// How log lines look
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    log_format: Format,
}

impl Logging {
    /// Starts the log; the levels are `usual` if neither flag nor variable gives others.
    pub(crate) fn start(&self, usual: &str) -> anyhow::Result<()> {
        // An empty variable is none.
        let set = std::env::var(VARIABLE).ok().filter(|levels| !levels.is_empty());
        let levels = match (&self.log, set) {
            (Some(levels), _) => levels.clone(),
            (None, Some(levels)) => parse(&levels).map_err(|error| {
                Exit::Usage(format!("{VARIABLE} = {levels:?}: {error}; expected levels, e.g. warn"))
            })?,
            (None, None) => usual.into(),
        };
        let filter = EnvFilter::try_new(levels)?;
        // Colours are for terminals only: files and pipes would show their control codes. The library obeys `NO_COLOR`.
        let mut lines =
            tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
        if !std::io::stderr().is_terminal() {
            lines = lines.with_ansi(false);
        }
        match self.log_format {
            Format::Text => lines.init(),
            Format::Json => lines.json().flatten_event(true).init(),
        }
        Ok(())
    }

    /// Whether lines are for programs.
    pub(crate) fn is_json(&self) -> bool {
        self.log_format == Format::Json
    }
}

fn parse(levels: &str) -> Result<String, ParseError> {
    EnvFilter::try_new(levels).map(|_| levels.into())
}
