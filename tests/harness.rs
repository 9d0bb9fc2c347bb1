//! Starts servers and clients in processes of their own under unique names, ends them with the
//! test, and looks for what they leave. Every wait is bounded.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use trocar_client::{Client, Session, SessionRequest};
use trocar_proto::builtin::{ALL, TaskInfo};
use trocar_proto::endpoint::{Endpoint, ServerState};

/// How long anything may take that takes milliseconds on an idle machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// How long a whole test may take.
const WATCHDOG: Duration = Duration::from_mins(4);

/// The same for the long runs of `make soak`.
const SOAK_WATCHDOG: Duration = Duration::from_hours(2);

/// Whether the long runs are wanted.
pub(crate) fn soak() -> bool {
    std::env::var_os("TROCAR_SOAK").is_some()
}

/// The tasks that sessions are tried with: every one, but of those that handle tissue, whose steps take long, the
/// first alone, unless in a soak.
pub(crate) fn tasks() -> impl Iterator<Item = &'static str> {
    let mut tissue = ALL.iter().filter(|task| task.has("tissue")).map(|task| task.id);
    let first = tissue.next();
    let is_tried = move |task: &TaskInfo| !task.has("tissue") || Some(task.id) == first || soak();
    ALL.iter().filter(move |task| is_tried(task)).map(|task| task.id)
}

/// The processes that tests have started and not yet ended.
static CHILDREN: Mutex<BTreeSet<u32>> = Mutex::new(BTreeSet::new());

/// A server in a process of its own.
pub(crate) struct Server {
    name: String,
    child: Process,
    _watchdog: Watchdog,
}

impl Server {
    /// A server with two threads and a unique name.
    pub(crate) fn start() -> Self {
        Self::start_with(&["--threads", "2"])
    }

    /// The same with the arguments of `trocar serve`.
    pub(crate) fn start_with(arguments: &[&str]) -> Self {
        Self::start_named(&unique_name(), arguments)
    }

    /// The same under a given name.
    pub(crate) fn start_named(name: &str, arguments: &[&str]) -> Self {
        Self::start_command(name, serve(name).args(arguments))
    }

    /// The same by a command that [`serve`] began.
    pub(crate) fn start_command(name: &str, command: &mut Command) -> Self {
        let watchdog = Watchdog::start();
        let mut child = Process::spawn(command);
        eventually("the server runs", || {
            assert!(child.poll().is_none(), "the server {name} ended: {:?}", child.poll());
            matches!(endpoint(name).server_state(), ServerState::Running { .. })
        });
        Self { name: name.into(), child, _watchdog: watchdog }
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn endpoint(&self) -> Endpoint {
        endpoint(&self.name)
    }

    pub(crate) fn connect(&self) -> Client {
        Client::connect(&self.name).expect("the server runs")
    }

    /// Opens a session that wants the expert's actions.
    pub(crate) fn open(&self, request: &SessionRequest) -> Session {
        let mut session = self.connect().open(request).expect("the request is good");
        session.want_expert(true);
        session
    }

    pub(crate) fn process(&mut self) -> &mut Process {
        &mut self.child
    }

    /// Number of its open files.
    pub(crate) fn open_files(&self) -> usize {
        self.child.open_files()
    }

    /// Memory of its own that it takes, bytes.
    pub(crate) fn memory(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.pid())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() << 10
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if self.child.poll().is_none() {
            self.child.signal(Signal::TERM);
        }
        if std::thread::panicking() {
            // The report is out; what can be removed is, if only for the next look. A stopped server hears only this.
            if self.child.poll().is_none() {
                self.child.signal(Signal::KILL);
            }
            drop(self.child.child.wait());
            self.endpoint().remove_if_unused().ok();
            return;
        }
        self.child.wait();
        assert_nothing_is_left(&self.name);
    }
}

/// A process that ends with the test.
pub(crate) struct Process {
    child: Child,
    lines: Option<BufReader<ChildStdout>>,
}

impl Process {
    /// Starts it, with its standard output in a pipe.
    pub(crate) fn spawn(command: &mut Command) -> Self {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?}: {error}"));
        CHILDREN.lock().unwrap().insert(child.id());
        let lines = child.stdout.take().map(BufReader::new);
        Self { child, lines }
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    pub(crate) fn signal(&self, signal: Signal) {
        let pid = Pid::from_raw(self.child.id().cast_signed()).expect("a process has a number");
        kill_process(pid, signal).expect("the process was not waited for yet");
    }

    /// Stops it, and waits until all of its threads are.
    pub(crate) fn stop(&self) {
        self.signal(Signal::STOP);
        eventually("it is stopped", || {
            let tasks = std::fs::read_dir(format!("/proc/{}/task", self.pid())).unwrap();
            tasks.flatten().all(|task| {
                let stat = std::fs::read_to_string(task.path().join("stat")).unwrap();
                stat.rsplit_once(')').is_some_and(|(_, fields)| fields.trim().starts_with('T'))
            })
        });
    }

    /// Kills it as `kill -9` does, and collects it.
    pub(crate) fn kill(&mut self) {
        self.signal(Signal::KILL);
        self.wait();
    }

    /// Its exit status, if it has ended.
    pub(crate) fn poll(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().expect("the process is ours")
    }

    /// Waits for its end.
    pub(crate) fn wait(&mut self) -> ExitStatus {
        eventually("the process ends", || self.poll().is_some());
        CHILDREN.lock().unwrap().remove(&self.child.id());
        self.poll().expect("it has ended")
    }

    /// The next line that it prints; the test's watchdog bounds the wait.
    pub(crate) fn line(&mut self) -> String {
        let mut line = String::new();
        let lines = self.lines.as_mut().expect("standard output is a pipe");
        lines.read_line(&mut line).expect("the process prints text");
        line.trim_end().to_string()
    }

    /// Its standard input.
    pub(crate) fn input(&mut self) -> &mut ChildStdin {
        self.child.stdin.as_mut().expect("standard input is a pipe that was not closed")
    }

    /// Ends its standard input, for which some wait.
    pub(crate) fn close_input(&mut self) {
        drop(self.child.stdin.take());
    }

    /// Waits for its end and returns what else it printed.
    pub(crate) fn finish(&mut self) -> (ExitStatus, String) {
        self.close_input();
        let mut rest = String::new();
        if let Some(mut lines) = self.lines.take() {
            lines.read_to_string(&mut rest).expect("the process prints text");
        }
        (self.wait(), rest)
    }

    /// Number of its open files.
    pub(crate) fn open_files(&self) -> usize {
        count_files(Path::new(&format!("/proc/{}/fd", self.pid())))
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.poll().is_none() {
            self.child.kill().ok();
            self.child.wait().ok();
        }
        CHILDREN.lock().unwrap().remove(&self.child.id());
    }
}

/// A client in a process of its own: `role` is a command of `trocar-test-client`.
pub(crate) fn client(server: &str, role: &str) -> Process {
    Process::spawn(&mut client_command(server, role))
}

/// The same, not started yet.
pub(crate) fn client_command(server: &str, role: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trocar-test-client"));
    command.args([role, server]);
    command
}

/// `trocar serve` under a name.
pub(crate) fn serve(name: &str) -> Command {
    let mut command = Command::new(binary());
    command.args(["serve", "--name", name]).env("TROCAR_LOG", "warn");
    command
}

/// The `trocar` program: `$TROCAR_BINARY`, else built once from this workspace.
pub(crate) fn binary() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| {
        if let Some(path) = std::env::var_os("TROCAR_BINARY") {
            return path.into();
        }
        let profile = if cfg!(debug_assertions) { "dev" } else { "release" };
        let status = Command::new(env!("CARGO"))
            // Of the whole workspace, so that dependencies are those that are built already.
            .args(["build", "--quiet", "--workspace", "--bin", "trocar", "--profile", profile])
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .status()
            .expect("cargo runs the tests");
        assert!(status.success(), "the trocar program could not be built");
        Path::new(env!("CARGO_BIN_EXE_trocar-test-client")).with_file_name("trocar")
    })
}

pub(crate) fn endpoint(name: &str) -> Endpoint {
    Endpoint::new(&name.parse().expect("the tests' names are good"))
}

/// A unique server name.
pub(crate) fn unique_name() -> String {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    format!("t{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed))
}

/// Waits until `holds`; returns how long that took.
pub(crate) fn eventually(what: &str, mut holds: impl FnMut() -> bool) -> Duration {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < PATIENCE, "waited {PATIENCE:?} in vain until {what}");
        std::thread::sleep(Duration::from_millis(1));
    }
    start.elapsed()
}

/// Fails where shared memory holds anything of the server `name`.
pub(crate) fn assert_nothing_is_left(name: &str) {
    let left = endpoint(name).remains().expect("shared memory can be listed");
    let some = &left[..left.len().min(5)];
    assert!(left.is_empty(), "{} files left in shared memory: {some:?}", left.len());
}

/// Number of entries of a folder.
pub(crate) fn count_files(folder: &Path) -> usize {
    std::fs::read_dir(folder).map_or(0, Iterator::count)
}

/// Ends the whole test run, with every process that it started, when a test hangs.
pub(crate) struct Watchdog(Option<Sender<()>>);

impl Watchdog {
    pub(crate) fn start() -> Self {
        let test = std::thread::current().name().unwrap_or("a test").to_string();
        let limit = if soak() { SOAK_WATCHDOG } else { WATCHDOG };
        let (alive, done) = channel();
        std::thread::spawn(move || {
            if done.recv_timeout(limit) != Err(RecvTimeoutError::Timeout) {
                return;
            }
            eprintln!("{test} hangs: no end after {limit:?}");
            for pid in CHILDREN.lock().unwrap().iter() {
                let pid = Pid::from_raw(pid.cast_signed()).expect("a process has a number");
                kill_process(pid, Signal::KILL).ok();
            }
            std::process::exit(101);
        });
        Self(Some(alive))
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        drop(self.0.take());
    }
}
