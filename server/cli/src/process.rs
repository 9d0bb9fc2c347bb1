//! Processes that this one starts, which never outlive the values that stand for them.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use rustix::process::{Pid, Signal, kill_process};
use trocar_client::{Client, ConnectError};
use trocar_proto::endpoint::{Endpoint, ServerName};

/// Names the Python that has the package trocar.
pub(crate) const PYTHON: &str = "TROCAR_PYTHON";

/// The Python of Python clients.
pub(crate) fn python() -> PathBuf {
    set(PYTHON).map_or_else(|| "python3".into(), PathBuf::from)
}

/// The value of an environment variable; an empty one is none.
pub(crate) fn set(variable: &str) -> Option<OsString> {
    std::env::var_os(variable).filter(|value| !value.is_empty())
}

/// A child process; killed when dropped.
#[derive(Debug)]
pub(crate) struct Process {
    name: &'static str,
    child: Child,
}

impl Process {
    /// Starts `command`; its stderr is ours.
    pub(crate) fn start(name: &'static str, mut command: Command) -> anyhow::Result<Self> {
        let child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // A group of its own: Ctrl-C is for this process, which then ends the others.
            .process_group(0)
            .spawn()
            .with_context(|| format!("{name}: {}", command.get_program().display()))?;
        Ok(Self { name, child })
    }

    /// Sends every line that it says, and `None` at its end, from a thread of its own.
    pub(crate) fn report_to(&mut self, index: usize, reports: Sender<(usize, Option<String>)>) {
        let stdout = self.child.stdout.take().expect("stdout is piped and taken once");
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if reports.send((index, Some(line))).is_err() {
                    return;
                }
            }
            reports.send((index, None)).ok();
        });
    }

    /// Its process id.
    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Tells it something: a line on its stdin.
    pub(crate) fn tell(&mut self, line: &str) -> anyhow::Result<()> {
        let stdin = self.child.stdin.as_mut().expect("stdin is piped");
        let told = writeln!(stdin, "{line}").and_then(|()| stdin.flush());
        told.with_context(|| format!("{} is gone", self.name))
    }

    /// Says that there is nothing more to tell: ends its stdin.
    pub(crate) fn end_input(&mut self) {
        drop(self.child.stdin.take());
    }

    /// Sends a signal, unless it has ended and that is known.
    pub(crate) fn signal(&self, signal: Signal) -> anyhow::Result<()> {
        let pid = i32::try_from(self.pid()).ok().and_then(Pid::from_raw);
        kill_process(pid.expect("a process has a number"), signal)
            .with_context(|| format!("signal to {}", self.name))
    }

    /// An error if it has ended.
    pub(crate) fn check(&mut self) -> anyhow::Result<()> {
        match self.child.try_wait()? {
            Some(status) => bail!("{} ended with {status}", self.name),
            None => Ok(()),
        }
    }

    /// Ends it at once.
    pub(crate) fn kill(&mut self) {
        // Where it has ended already, there is nothing to kill.
        self.child.kill().ok();
        self.child.wait().ok();
    }

    /// Waits for its end, which must be a success.
    pub(crate) fn wait(&mut self, patience: Duration) -> anyhow::Result<()> {
        let start = Instant::now();
        loop {
            match self.child.try_wait()? {
                Some(status) if status.success() => return Ok(()),
                Some(status) => bail!("{} ended with {status}", self.name),
                None if start.elapsed() > patience => bail!("{} does not end", self.name),
                None => std::thread::sleep(Duration::from_millis(10)),
            }
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A server that ends with this value.
#[derive(Debug)]
pub(crate) struct OwnServer {
    client: Option<Client>,
    process: Process,
    endpoint: Endpoint,
}

impl OwnServer {
    /// How long it may take to start or end.
    const PATIENCE: Duration = Duration::from_mins(1);

    /// Starts a server under `name` with more arguments of `trocar serve`.
    pub(crate) fn start(name: &ServerName, arguments: &[&str]) -> anyhow::Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        // Private: should this process be killed, the server ends by itself.
        command.args(["serve", "--private", name.as_str()]);
        command.args(arguments).env("TROCAR_LOG", "error");
        let mut process = Process::start("server", command)?;
        let start = Instant::now();
        let client = loop {
            match Client::connect(name.as_str()) {
                Ok(client) => break client,
                Err(ConnectError::NoServer { .. }) if start.elapsed() < Self::PATIENCE => {
                    process.check()?;
                    std::thread::sleep(Duration::from_millis(5));
                }
                Err(error) => return Err(error.into()),
            }
        };
        Ok(Self { client: Some(client), process, endpoint: Endpoint::new(name) })
    }

    /// The name that clients connect to.
    pub(crate) fn name(&self) -> &str {
        self.endpoint.name().as_str()
    }

    /// Its process id.
    pub(crate) fn pid(&self) -> u32 {
        self.process.pid()
    }

    /// The address of its live viewer, which is started if need be.
    pub(crate) fn viewer(&self) -> anyhow::Result<SocketAddr> {
        let client = self.client.as_ref().expect("it is there until the server is stopped");
        Ok(client.viewer()?)
    }

    /// Ends it in order.
    pub(crate) fn stop(mut self) -> anyhow::Result<()> {
        if let Some(client) = self.client.take() {
            client.shut_down()?;
        }
        self.process.wait(Self::PATIENCE)
    }
}

impl Drop for OwnServer {
    fn drop(&mut self) {
        drop(self.client.take());
        // However it ends, nothing is left of it.
        self.process.kill();
        self.endpoint.remove_if_unused().ok();
    }
}
