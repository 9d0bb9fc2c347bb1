//! `trocar serve`: start a server that trainers can connect to.

use std::time::Duration;

use clap::Args;
use trocar_proto::endpoint::ServerName;
use trocar_server::service::{PrivateRule, ServerConfig, StopSignal, serve};
use trocar_server::tasks::Registry;

/// How long a private server outlives its last client.
const LINGER: Duration = Duration::from_secs(3);

#[derive(Debug, Args)]
pub(crate) struct Serve {
    /// Name that clients connect to
    #[arg(long, default_value = "default")]
    name: ServerName,
    /// Threads that step environments [default: one per core]
    #[arg(long)]
    threads: Option<usize>,
    /// Most environments that one session may have
    #[arg(long, default_value_t = 4096)]
    max_envs: u32,
    /// Memory that all sessions together may take, e.g. 512MiB or 2GiB
    #[arg(long, default_value = "1GiB", value_parser = parse_bytes)]
    memory: u64,
    /// Close a session that sends nothing for so long, e.g. 90s, 10min or 1h
    #[arg(long, default_value = "1h", value_parser = parse_duration)]
    idle_limit: Duration,
    /// Serve the process tree of this process id, and end with it or with the last client
    #[arg(long, value_name = "PID", hide = true)]
    private: Option<u32>,
}

impl Serve {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let defaults = ServerConfig::new(self.name);
        let config = ServerConfig {
            threads: self.threads.unwrap_or(defaults.threads),
            max_envs: self.max_envs,
            memory_bytes: self.memory,
            idle_limit: self.idle_limit,
            private: self.private.map(|root| PrivateRule { root, linger: LINGER }),
            ..defaults
        };
        let stop = StopSignal::default();
        let on_signal = stop.clone();
        ctrlc::set_handler(move || on_signal.set())?;
        serve(Registry::builtin(), &config, &stop, || {})?;
        Ok(())
    }
}

fn parse_bytes(text: &str) -> Result<u64, String> {
    let (number, unit) = split_unit(text);
    let factor: u64 = match unit {
        "" | "B" => 1,
        "KiB" => 1 << 10,
        "MiB" => 1 << 20,
        "GiB" => 1 << 30,
        "kB" => 1000,
        "MB" => 1_000_000,
        "GB" => 1_000_000_000,
        _ => return Err("allowed units are B, KiB, MiB, GiB, kB, MB, GB".into()),
    };
    let number: u64 = number.parse().map_err(|_| "expected a number and a unit, as 512MiB")?;
    number.checked_mul(factor).ok_or_else(|| "too large".into())
}

fn parse_duration(text: &str) -> Result<Duration, String> {
    let (number, unit) = split_unit(text);
    let seconds: u64 = match unit {
        "" | "s" => 1,
        "min" | "m" => 60,
        "h" => 3600,
        _ => return Err("allowed units are s, min, h".into()),
    };
    let number: u64 = number.parse().map_err(|_| "expected a number and a unit, as 90s")?;
    number.checked_mul(seconds).map(Duration::from_secs).ok_or_else(|| "too large".into())
}

fn split_unit(text: &str) -> (&str, &str) {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    (&text[..end], text[end..].trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_times_have_units() {
        assert_eq!(parse_bytes("1GiB"), Ok(1 << 30));
        assert_eq!(parse_bytes("512 MiB"), Ok(512 << 20));
        assert!(parse_bytes("1.5GiB").is_err());
        assert!(parse_bytes("GiB").is_err());
        assert!(parse_bytes("99999999999999999GiB").is_err());
        assert_eq!(parse_duration("90s"), Ok(Duration::from_secs(90)));
        assert_eq!(parse_duration("1h"), Ok(Duration::from_secs(3600)));
        assert!(parse_duration("1 day").is_err());
    }
}
