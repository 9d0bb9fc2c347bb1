//! `trocar serve`: start a server that trainers can connect to.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use trocar_proto::endpoint::ServerName;
use trocar_server::Registry;
use trocar_server::service::{Cpus, Quota, ServerConfig, StopSignal, serve};

use crate::inherited;
use crate::logging::Logging;
use crate::process::set;

/// How long a private server outlives its last client.
const LINGER: Duration = Duration::from_secs(3);

/// Start a server that trainers can connect to.
///
/// It serves any number of processes of the same user on this machine, in Rust and Python, until
/// Ctrl-C, SIGTERM or `trocar stop`. Then it opens no more sessions, answers the steps that it is
/// at, and ends; a second signal ends it at once. A client that dies costs the others nothing.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar serve                                 the server `default`
  trocar serve --name lab --threads 8          another one beside it
  trocar serve --name lab --cpus 4-7           on four processors and no others
  trocar serve --name lab --memory 4GiB --idle-limit 10min
  trocar serve --name lab --client-envs 256 --client-threads 2    no client gets more
  trocar serve --name lab --view 8080          watch it at http://127.0.0.1:8080
  trocar serve --name lab --metrics 9100 --log-format json        for Prometheus and a log collector

A client is a process; by default it may have all that the server has. Metrics are at
http://127.0.0.1:9100/metrics, in Prometheus's text format.

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
    /// When told to end, wait at most so long for steps in progress
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = parse_duration)]
    drain_limit: Duration,
    /// Most sessions of one client
    #[arg(long, value_name = "N")]
    client_sessions: Option<usize>,
    /// Most environments of all sessions of one client
    #[arg(long, value_name = "N")]
    client_envs: Option<u64>,
    /// Memory that all sessions of one client may take, their snapshots included
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes)]
    client_memory: Option<u64>,
    /// Most threads that step environments of one client at a time
    #[arg(long, value_name = "N")]
    client_threads: Option<usize>,
    /// Serve metrics at this address: a port of 127.0.0.1, or ADDRESS:PORT
    #[arg(long, value_name = "ADDR", value_parser = parse_address)]
    metrics: Option<SocketAddr>,
    /// Record episodes in which the simulation fails or an object is lost in this folder, a hundred at most;
    /// none records nothing [default: trocar/failures in $XDG_STATE_HOME or ~/.local/state]
    #[arg(long, value_name = "FOLDER")]
    failures: Option<PathBuf>,
    /// Serve a page that shows what is simulated, at this address: a port of 127.0.0.1, or ADDRESS:PORT
    #[arg(long, value_name = "ADDR", value_parser = parse_address)]
    view: Option<SocketAddr>,
    #[command(flatten)]
    logging: Logging,
    /// End with the process of this id, however it ends
    #[arg(long, value_name = "PID")]
    follow: Option<u32>,
    /// As --name, and end a few seconds after the last client
    #[arg(long, value_name = "NAME", hide = true, conflicts_with = "name")]
    private: Option<ServerName>,
}

impl Serve {
    pub(crate) fn start_logging(&self) -> anyhow::Result<()> {
        // No user reads what a private server says, unless it does not start.
        self.logging.start(if self.private.is_some() { "warn" } else { "info" })
    }

    pub(crate) fn run(self) -> anyhow::Result<()> {
        inherited::close_shared_memory();
        let linger = self.private.as_ref().map(|_| LINGER);
        let defaults = ServerConfig::new(self.private.unwrap_or(self.name));
        let all = Quota::default();
        let config = ServerConfig {
            threads: self
                .threads
                .or(self.cpus.as_ref().map(Cpus::count))
                .unwrap_or(defaults.threads),
            cpus: self.cpus,
            max_envs: self.max_envs,
            memory_bytes: self.memory,
            client: Quota {
                sessions: self.client_sessions.unwrap_or(all.sessions),
                envs: self.client_envs.unwrap_or(all.envs),
                memory_bytes: self.client_memory.unwrap_or(all.memory_bytes),
                threads: self.client_threads.unwrap_or(all.threads),
            },
            idle_limit: self.idle_limit,
            drain_limit: self.drain_limit,
            metrics: self.metrics,
            failures: failures(self.failures),
            view: self.view,
            follow: self.follow,
            linger,
            ..defaults
        };
        let stop = StopSignal::default();
        let on_signal = stop.clone();
        ctrlc::set_handler(move || on_signal.set())?;
        let registry = Registry::builtin();
        let tasks = registry.ids().count();
        serve(registry, &config, &stop, || {
            // No user of a private server would read this, and a log collector does not want it.
            if config.linger.is_none() && !self.logging.is_json() {
                announce(&config, tasks);
            }
        })?;
        Ok(())
    }
}

/// The folder for recordings of failures.
fn failures(given: Option<PathBuf>) -> Option<PathBuf> {
    match given {
        Some(folder) if folder.as_os_str() == "none" => None,
        Some(folder) => Some(folder),
        None => {
            let state = set("XDG_STATE_HOME").map(PathBuf::from);
            let home = || Some(PathBuf::from(set("HOME")?).join(".local/state"));
            state.or_else(home).map(|state| state.join("trocar/failures"))
        }
    }
}

/// Says that clients may come, and how.
fn announce(config: &ServerConfig, tasks: usize) {
    let name = &config.name;
    // Which port is free, the log says.
    let view = config.view.filter(|address| address.port() > 0);
    let view = view.map_or(String::new(), |address| format!("  browser http://{address}/\n"));
    eprintln!(
        "\
Server {name} is ready: {tasks} tasks, {threads} threads, process {pid}.
  Python  gym.make(\"trocar/NeedleReach-v0\", server=\"{name}\")
  Rust    Client::connect(\"{name}\")
  shell   trocar status --name {name} --watch
{view}Ctrl-C or `trocar stop --name {name}` ends it.",
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

pub(crate) fn parse_address(text: &str) -> Result<SocketAddr, String> {
    if let Ok(port) = text.trim_start_matches(':').parse() {
        return Ok((Ipv4Addr::LOCALHOST, port).into());
    }
    text.parse().map_err(|_| "expected a port, as 9100, or ADDRESS:PORT, as 0.0.0.0:9100".into())
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

    #[test]
    fn a_port_alone_is_one_of_this_machine() {
        assert_eq!(parse_address("9100"), Ok("127.0.0.1:9100".parse().unwrap()));
        assert_eq!(parse_address(":9100"), parse_address("9100"));
        assert_eq!(parse_address("0.0.0.0:9100"), Ok("0.0.0.0:9100".parse().unwrap()));
        assert!(parse_address("host:9100").unwrap_err().contains("9100"));
        assert!(parse_address("99999").is_err());
    }
}
