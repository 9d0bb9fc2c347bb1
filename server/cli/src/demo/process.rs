//! A process of the demonstration, which never outlives the value that stands for it.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

/// A child process; killed when dropped.
#[derive(Debug)]
pub(super) struct Process {
    name: &'static str,
    child: Child,
}

impl Process {
    /// Starts `command`; its stderr is ours.
    pub(super) fn start(name: &'static str, mut command: Command) -> anyhow::Result<Self> {
        let child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // A group of its own: Ctrl-C is for the demonstration, which then ends the others.
            .process_group(0)
            .spawn()
            .with_context(|| format!("{name}: {}", command.get_program().display()))?;
        Ok(Self { name, child })
    }

    /// Sends every line that it says, and `None` at its end, from a thread of its own.
    pub(super) fn report_to(&mut self, index: usize, reports: Sender<(usize, Option<String>)>) {
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

    /// Tells it to begin.
    pub(super) fn begin(&mut self) -> anyhow::Result<()> {
        let stdin = self.child.stdin.as_mut().expect("stdin is piped");
        stdin.write_all(b"go\n").with_context(|| format!("client {} is gone", self.name))
    }

    /// An error if it has ended.
    pub(super) fn check(&mut self) -> anyhow::Result<()> {
        match self.child.try_wait()? {
            Some(status) => bail!("{} ended with {status}", self.name),
            None => Ok(()),
        }
    }

    /// Waits for its end, which must be a success.
    pub(super) fn wait(&mut self, patience: Duration) -> anyhow::Result<()> {
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
        // Where it has ended already, there is nothing to kill.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
