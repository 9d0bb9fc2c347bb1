//! The n-th call of the kernel fails while sessions are opened, stepped, closed and reclaimed: in a client, or in the
//! server. `strace` makes them fail; it counts the calls of each thread by itself.
//!
//! Not tested is what no program of Rust survives: a thread that is just begun cannot map its signal stack, or the heap
//! cannot grow. Nor are errors that Linux does not give: for files in `/dev/shm` and whole mappings (`unlink`, `munmap`),
//! and where a thread wakes another one up. `strace` cannot tell a `futex` that wakes from one that waits. So none of the
//! server fails, which has many threads: a thread that is not woken up would sleep for ever.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::Write as _;
use std::path::PathBuf;
use std::process::{Command, ExitStatus};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use trocar_client::Client;

use crate::harness::{
    Process, Server, Watchdog, client, client_command, eventually, serve, soak, unique_name,
};
use crate::twin::{Bystander, digest};

/// What fails: a call, with an error, where what is written of the call has this in it.
#[derive(Debug, Clone, Copy)]
struct Kind {
    call: &'static str,
    error: &'static str,
    only: &'static str,
}

const fn kind(call: &'static str, error: &'static str, only: &'static str) -> Kind {
    Kind { call, error, only }
}

const KINDS: &[Kind] = &[
    kind("openat", "EMFILE", ""),
    kind("openat", "ENOMEM", ""),
    kind("openat", "ENOSPC", "O_CREAT"),
    kind("mkdir", "ENOSPC", ""),
    kind("ftruncate", "ENOMEM", ""),
    kind("fallocate", "ENOSPC", ""),
    kind("fallocate", "EINTR", ""),
    kind("mmap", "ENOMEM", "MAP_SHARED"),
    kind("newfstatat", "ENOMEM", ""),
    kind("statx", "ENOMEM", ""),
    kind("statfs", "EINTR", ""),
    kind("access", "ENOMEM", ""),
    kind("fchmod", "ENOMEM", ""),
    kind("getdents64", "ENOMEM", ""),
    kind("read", "EIO", "/dev/shm"),
    kind("pread64", "EIO", "/dev/shm"),
    kind("write", "ENOSPC", "/dev/shm"),
    kind("fsync", "EIO", ""),
    kind("flock", "EINTR", ""),
    kind("flock", "ENOLCK", ""),
    kind("fcntl", "ENOLCK", "F_SETLK"),
    kind("futex", "EINTR", "FUTEX_WAIT"),
    kind("clone3", "EAGAIN", ""),
    kind("socket", "EMFILE", ""),
    kind("sendto", "ENOBUFS", ""),
    kind("sendto", "EINTR", ""),
    kind("recvfrom", "EINTR", ""),
];

/// What an error is called, by the kernel, by Rust or by the transport.
const NAMES: &[(&str, &[&str])] = &[
    ("EMFILE", &["open files", "file handle", "file descriptors"]),
    ("ENOMEM", &["allocate memory", "ENOMEM", "insufficient memory", "insufficient resources"]),
    ("ENOSPC", &["space left", "storage space", "enough space", "ENOSPC"]),
    ("EINTR", &["nterrupt"]),
    ("EIO", &["nput/output", "I/O", "EIO"]),
    ("ENOLCK", &["locks available", "ENOLCK"]),
    ("EAGAIN", &["temporarily unavailable"]),
    ("ENOBUFS", &["buffer"]),
];

/// What a client is told where the server could not go on with its session: the cause is in the server's log.
const IN_THE_LOG: &str = "a fault in its log";

/// How a thread that begins maps its signal stack; Rust's standard library ends the process where that fails.
const SIGNAL_STACK: &str = "PROT_WRITE, MAP_PRIVATE|MAP_ANONYMOUS|MAP_STACK";

/// How long anything may take in which a call failed.
const LIMIT: Duration = Duration::from_secs(10);

/// How long a server may take to have back what a client had.
const SETTLING: Duration = Duration::from_secs(3);

/// Open files and pieces of shared memory that may stay until the server ends where a call failed while it cleared a
/// dead client away: the transport tries that once.
const UNCLEARED: (usize, usize) = (3, 4);

/// Faults for which one server is used: its watchdog allows for so many.
const A_SERVER: usize = 100;

/// The call that fails, of those of its kind in each thread.
#[derive(Debug, Clone, Copy)]
struct Fault {
    kind: Kind,
    when: usize,
}

/// Every fault of the kinds that are `tried` in what `calls`, a log, has; every 17th unless this is a soak test.
fn faults_in(calls: &str, tried: impl Fn(&Kind) -> bool) -> Vec<Fault> {
    let mut counts = BTreeMap::<(&str, &str), usize>::new();
    let (mut found, mut fatal) = (BTreeSet::new(), BTreeSet::new());
    for line in calls.lines() {
        let Some((thread, call)) = line.split_once(' ') else { continue };
        let Some((name, _)) = call.trim_start().split_once('(') else { continue };
        let count = counts.entry((thread, name)).or_default();
        *count += 1;
        if call.contains(SIGNAL_STACK) {
            fatal.insert((name, *count));
        }
        for (number, kind) in KINDS.iter().enumerate() {
            if kind.call == name && call.contains(kind.only) && tried(kind) {
                found.insert((number, *count));
            }
        }
    }
    found.retain(|(kind, when)| !fatal.contains(&(KINDS[*kind].call, *when)));
    let every = if soak() { 1 } else { 17 };
    let faults = found.into_iter().map(|(kind, when)| Fault { kind: KINDS[kind], when });
    faults.step_by(every).collect()
}

/// `strace` of a running process.
struct Strace {
    process: Process,
    log: PathBuf,
}

impl Strace {
    /// Traces all threads of `pid`; `None` where this user may not do that.
    fn attach(pid: u32, arguments: &[String]) -> Option<Self> {
        let log = temporary("calls");
        let mut command = Command::new("strace");
        command.args(["-f", "-y", "-qq", "-o"]).arg(&log).args(arguments);
        command.args(["-p", &pid.to_string()]);
        let mut process = Process::spawn(&mut command);
        eventually("strace traces it", || process.poll().is_some() || is_traced(pid));
        is_traced(pid).then_some(Self { process, log })
    }

    /// Writes down the calls of a process.
    fn of_calls(pid: u32) -> Self {
        let calls: BTreeSet<_> = KINDS.iter().map(|kind| kind.call).collect();
        let calls = Vec::from_iter(calls).join(",");
        Self::attach(pid, &["-e".into(), format!("trace={calls}")])
            .expect("it could be traced before")
    }

    /// Lets a call fail in each thread of a process.
    fn of_fault(pid: u32, Fault { kind: Kind { call, error, .. }, when }: Fault) -> Self {
        let trace = format!("trace={call}");
        let inject = format!("inject={call}:error={error}:when={when}");
        Self::attach(pid, &["-e".into(), trace, "-e".into(), inject])
            .expect("it could be traced before")
    }

    /// Lets the process go, if it is there still; returns what was written down.
    fn detach(mut self) -> String {
        if self.process.poll().is_none() {
            self.process.signal(Signal::INT);
        }
        self.process.wait();
        let calls = fs::read_to_string(&self.log).unwrap();
        fs::remove_file(&self.log).unwrap();
        calls
    }
}

fn is_traced(pid: u32) -> bool {
    let Ok(tasks) = fs::read_dir(format!("/proc/{pid}/task")) else { return false };
    tasks.flatten().all(|task| {
        let status = fs::read_to_string(task.path().join("status")).unwrap_or_default();
        !status.contains("TracerPid:\t0\n")
    })
}

/// Whether this user may trace processes at all.
fn may_trace() -> bool {
    let sleeper = Process::spawn(Command::new("sleep").arg("60"));
    let strace = Strace::attach(sleeper.pid(), &[]);
    let traced = strace.map(Strace::detach).is_some();
    if !traced {
        eprintln!("left out: this user may not trace processes (ptrace)");
    }
    traced
}

fn temporary(label: &str) -> PathBuf {
    std::env::temp_dir().join(format!("trocar-{}-{label}", unique_name()))
}

/// What a process printed, and how it ended.
struct End {
    status: ExitStatus,
    printed: String,
    said: String,
}

/// A client whose errors are kept.
struct Subject {
    process: Process,
    errors: PathBuf,
}

impl Subject {
    fn start(server: &Server, role: &str) -> Self {
        let errors = temporary("errors");
        let mut command = client_command(server.name(), role);
        command.stderr(File::create(&errors).unwrap()).env("RUST_BACKTRACE", "0");
        Self { process: Process::spawn(&mut command), errors }
    }

    fn end(mut self) -> End {
        let start = Instant::now();
        self.process.close_input();
        while self.process.poll().is_none() {
            assert!(start.elapsed() < LIMIT, "no end within {LIMIT:?}");
            std::thread::sleep(Duration::from_millis(1));
        }
        let (status, printed) = self.process.finish();
        let said = fs::read_to_string(&self.errors).unwrap();
        fs::remove_file(&self.errors).unwrap();
        End { status, printed: printed.trim().into(), said }
    }
}

/// A server, what it has, and a client that steps all the while.
struct Trial {
    server: Server,
    errors: PathBuf,
    bystander: Option<Bystander>,
    held: (usize, usize),
    expected: String,
    /// Faults that a call really met, and those after which something stayed.
    met: usize,
    uncleared: usize,
}

impl Trial {
    /// One in which other clients step, too.
    fn beside_others() -> Self {
        let mut trial = Self::start();
        trial.bystander = Some(Bystander::start(&trial.server));
        trial.settle();
        trial
    }

    fn start() -> Self {
        let (name, errors) = (unique_name(), temporary("errors"));
        let mut command = serve(&name);
        command.args(["--threads", "2"]).env("RUST_BACKTRACE", "0");
        let server = Server::start_command(&name, command.stderr(File::create(&errors).unwrap()));
        let mut trial = Self {
            server,
            errors,
            bystander: None,
            held: (usize::MAX, usize::MAX),
            expected: digest(),
            met: 0,
            uncleared: 0,
        };
        trial.check_next_session();
        trial.settle();
        trial
    }

    /// Open files of the server, and pieces of its shared memory.
    fn holds(&self) -> (usize, usize) {
        (self.server.open_files(), self.server.endpoint().remains().unwrap().len())
    }

    /// The least that it holds in a while: it opens files for moments.
    fn least(&self) -> (usize, usize) {
        let held = (0..50).map(|_| {
            std::thread::sleep(Duration::from_millis(10));
            self.holds()
        });
        held.min().unwrap()
    }

    /// Takes what it has for what it is to have.
    fn settle(&mut self) {
        self.held = self.least();
    }

    /// Whether it has no more than before, soon.
    fn has_all_back(&self) -> bool {
        let start = Instant::now();
        while start.elapsed() < SETTLING {
            let (files, pieces) = self.holds();
            if files <= self.held.0 && pieces <= self.held.1 {
                return true;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        false
    }

    fn check_next_session(&self) {
        let mut next = client(self.server.name(), "digest");
        assert_eq!(next.line(), self.expected, "the next session");
        assert!(next.finish().0.success());
    }

    /// A client lives while one of its calls fails.
    fn of_client(&mut self, fault: Fault) {
        let (strace, end) = self.live(|pid| Strace::of_fault(pid, fault));
        let calls = strace.detach();
        self.check(fault, &calls, &end, &[]);
        assert!(self.has_all_back(), "{:?} instead of {:?}", self.holds(), self.held);
    }

    /// A client that is traced from when it is about to connect.
    fn live(&self, trace: impl FnOnce(u32) -> Strace) -> (Strace, End) {
        let mut subject = Subject::start(&self.server, "faulted");
        assert_eq!(subject.process.line(), "ready");
        let strace = trace(subject.process.pid());
        writeln!(subject.process.input(), "go").unwrap();
        (strace, subject.end())
    }

    /// One of the server's calls fails while a client lives and another is killed.
    fn of_server(&mut self, fault: Fault) {
        let (strace, end) = self.serve(|pid| Strace::of_fault(pid, fault));
        let calls = strace.detach();
        self.check(fault, &calls, &end, &[IN_THE_LOG]);
        if !self.has_all_back() {
            let (held, left) = (self.held, self.least());
            let few = left.0 <= held.0 + UNCLEARED.0 && left.1 <= held.1 + UNCLEARED.1;
            assert!(few, "{left:?} after {held:?}");
            self.uncleared += 1;
            self.held = left;
        }
    }

    /// The server while one client lives and another one is killed.
    fn serve(&mut self, trace: impl FnOnce(u32) -> Strace) -> (Strace, End) {
        let mut victim = client(self.server.name(), "hold");
        assert_eq!(victim.line(), "ready");
        let strace = trace(self.server.process().pid());
        victim.kill();
        let end = Subject::start(&self.server, "digest").end();
        // It may fail to clear the victim away, which is looked at later.
        self.has_all_back();
        (strace, end)
    }

    /// Whether it went as it may.
    fn check(&mut self, fault: Fault, calls: &str, end: &End, also: &[&str]) {
        let met = calls.lines().any(|line| line.ends_with("(INJECTED)"));
        self.met += usize::from(met);
        let End { status, printed, said } = end;
        match status.code() {
            Some(0) => assert_eq!(*printed, self.expected),
            Some(1) => {
                let (_, names) = NAMES.iter().find(|(name, _)| *name == fault.kind.error).unwrap();
                let named = names.iter().chain(also).any(|name| said.contains(name));
                assert!(named && met, "the cause is not named: {said}");
            }
            _ => panic!("{status}: {said}"),
        }
        assert!(!said.contains("panicked"), "{said}");
        assert!(self.server.process().poll().is_none(), "the server ended: {}", self.log());
        assert!(!self.log().contains("panicked"), "{}", self.log());
        let status = Client::connect(self.server.name()).unwrap().status().unwrap();
        assert!(status.sessions.iter().all(|session| session.pid != 0));
        self.check_next_session();
    }

    fn log(&self) -> String {
        fs::read_to_string(&self.errors).unwrap()
    }

    /// Ends it; returns how many faults were met.
    fn end(self) -> (usize, usize) {
        self.bystander.into_iter().for_each(Bystander::finish);
        drop(self.server);
        fs::remove_file(self.errors).unwrap();
        (self.met, self.uncleared)
    }
}

/// Tries every fault; says which one a failure is about.
fn try_all(whose: &str, faults: &[Fault], mut attempt: impl FnMut(&mut Trial, Fault)) {
    let (start, mut met, mut uncleared) = (Instant::now(), 0, 0);
    for some in faults.chunks(A_SERVER) {
        let mut trial = Trial::beside_others();
        for fault in some {
            let about = About(whose, *fault);
            attempt(&mut trial, *fault);
            std::mem::forget(about);
        }
        let (more, left) = trial.end();
        (met, uncleared) = (met + more, uncleared + left);
    }
    let (all, seconds) = (faults.len(), start.elapsed().as_secs());
    eprintln!("{whose}: {met} of {all} calls failed, {uncleared} left something; {seconds} s");
    // On a busy machine, the server makes fewer of them than were counted.
    assert!(4 * met > all, "calls are counted otherwise");
}

/// Says which fault it was when a test fails.
struct About<'a>(&'a str, Fault);

impl Drop for About<'_> {
    fn drop(&mut self) {
        let Self(whose, Fault { kind: Kind { call, error, .. }, when }) = self;
        eprintln!("in the {whose}, {call} number {when} of a thread gave {error}");
    }
}

#[test]
#[ignore = "needs strace: make test-faults"]
fn a_client_survives_any_call_that_fails_or_names_it() {
    let watchdog = Watchdog::start();
    if !may_trace() {
        return;
    }
    let trial = Trial::start();
    let (strace, end) = trial.live(Strace::of_calls);
    assert!(end.status.success(), "{}", end.said);
    let faults = faults_in(&strace.detach(), |_| true);
    trial.end();
    drop(watchdog);
    try_all("client", &faults, Trial::of_client);
}

#[test]
#[ignore = "needs strace: make test-faults"]
fn a_server_survives_any_call_that_fails() {
    let watchdog = Watchdog::start();
    if !may_trace() {
        return;
    }
    let mut trial = Trial::start();
    let (strace, end) = trial.serve(Strace::of_calls);
    assert!(end.status.success(), "{}", end.said);
    let faults = faults_in(&strace.detach(), |kind| kind.call != "futex");
    trial.end();
    drop(watchdog);
    try_all("server", &faults, Trial::of_server);
}
