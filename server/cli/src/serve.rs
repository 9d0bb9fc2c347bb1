//! `trocar serve`: start a server that trainers can connect to.

use std::time::Duration;

use clap::Args;
use trocar_proto::endpoint::ServerName;
use trocar_server::service::{Cpus, ServerConfig, StopSignal, serve};
use trocar_server::tasks::Registry;

/// How long a private server outlives its last client.
const LINGER: Duration = Duration::from_secs(3);

/// Start a server that trainers can connect to.
///
/// It serves any number of processes of the same user on this machine, in Rust and Python, until
/// Ctrl-C, SIGTERM or `trocar stop`. A client that dies costs the others nothing.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar serve                                 the server `default`
  trocar serve --name lab --threads 8          another one beside it
  trocar serve --name lab --cpus 4-7           on four processors and no others
  trocar serve --name lab --memory 4GiB --idle-limit 10min

Connect with gym.make(\"trocar/NeedleReach-v0\", server=\"lab\") in Python, with
Client::connect(\"lab\") in Rust, or set TROCAR_SERVER=lab for programs that name no server.")]
pub(crate) struct Serve {
    /// Name that clients connect to: 1 to 24 letters, digits, - or _
    #[arg(long, default_value = "default")]
    name: ServerName,
    /// Threads that step environments [default: one per core, or per processor of --cpus]
    #[arg(long)]
    threads: Option<usize>,
    /// Processors that the server uses, as 0-3 or 0,2,4-5 [default: all]
    #[arg(long, value_name = "LIST")]
    cpus: Option<Cpus>,
    /// Most environments that one session may have
    #[arg(long, default_value_t = 4096)]
    max_envs: u32,
    /// Memory that all sessions together may take, e.g. 512MiB or 2GiB
    #[arg(long, value_name = "BYTES", default_value = "1GiB", value_parser = parse_bytes)]
    memory: u64,
    /// Close a session that sends nothing for so long, e.g. 90s, 10min or 1h
    #[arg(long, value_name = "TIME", default_value = "1h", value_parser = parse_duration)]
    idle_limit: Duration,
    /// End with the process of this id, however it ends
    #[arg(long, value_name = "PID")]
    follow: Option<u32>,
    /// As --follow, and end a few seconds after the last client
    #[arg(long, value_name = "PID", hide = true)]
    private: Option<u32>,
}

impl Serve {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let defaults = ServerConfig::new(self.name.clone());
        let config = ServerConfig {
            threads: self
                .threads
                .or(self.cpus.as_ref().map(Cpus::count))
                .unwrap_or(defaults.threads),
            cpus: self.cpus,
            max_envs: self.max_envs,
            memory_bytes: self.memory,
            idle_limit: self.idle_limit,
            follow: self.private.or(self.follow),
            linger: self.private.map(|_| LINGER),
            ..defaults
        };
        let stop = StopSignal::default();
        let on_signal = stop.clone();
        ctrlc::set_handler(move || on_signal.set())?;
        let registry = Registry::builtin();
        let tasks = registry.ids().count();
        serve(registry, &config, &stop, || {
            // A private server has no user who would read this.
            if config.linger.is_none() {
                announce(&config, tasks);
            }
        })?;
        Ok(())
    }
}

/// Says that clients may come, and how.
fn announce(config: &ServerConfig, tasks: usize) {
    let name = &config.name;
    eprintln!(
        "\
Server {name} is ready: {tasks} tasks, {threads} threads, process {pid}.
  Python  gym.make(\"trocar/NeedleReach-v0\", server=\"{name}\")
  Rust    Client::connect(\"{name}\")
  shell   trocar status --name {name} --watch
Ctrl-C or `trocar stop --name {name}` ends it.",
        threads = config.threads,
        pid = std::process::id(),
    );
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
        assert_eq!(parse_duration("1h"), Ok(Duration::from_hours(1)));
        assert!(parse_duration("1 day").is_err());
    }
}
