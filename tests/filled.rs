//! Another program fills `/dev/shm` at any moment of a session's life: no process dies of it, errors name it, and the
//! bits of the sessions that are there stay. Each test runs in a process whose `/dev/shm` is small and its own.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::Stdio;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::process::Signal;
use trocar_client::{Autoreset, Client, Options, Session, SessionRequest};
use trocar_proto::endpoint::Endpoint;

use crate::harness::{
    Process, Server, Watchdog, binary, client, eventually, serve, soak, unique_name,
};
use crate::namespaces::unshare;
use crate::rows::{Policy, Row, act, policies};
use crate::twin::{Bystander, Twin};

/// What says to this process that `/dev/shm` is its own.
const INSIDE: &str = "TROCAR_TEST_INSIDE";

/// Whether this process has a `/dev/shm` of its own; where it has not, the test `name` is run in one that has, if this
/// user may make such a thing.
fn inside(name: &str) -> bool {
    if std::env::var_os(INSIDE).is_some() {
        return true;
    }
    let _watchdog = Watchdog::start();
    let Some(mut command) = unshare() else { return false };
    let script = "mount -t tmpfs -o size=24m tmpfs /dev/shm && exec \"$0\" --exact \"$1\" --include-ignored --nocapture";
    command.args(["sh", "-c", script]).arg(std::env::current_exe().unwrap()).arg(name);
    command.env(INSIDE, "1").env("TROCAR_BINARY", binary());
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("1 passed"), "{said}");
    false
}

/// All of `/dev/shm` that was free, until this is dropped.
struct Filler(File);

impl Filler {
    const PATH: &str = "/dev/shm/filler";

    fn full() -> Self {
        let filler = Self(File::create(Self::PATH).unwrap());
        filler.fill();
        filler
    }

    fn fill(&self) {
        let mut size = self.0.metadata().unwrap().len();
        loop {
            let free = Endpoint::free_memory().unwrap();
            if free == 0 {
                return;
            }
            // Fails where another process was faster; then there is less to fill.
            if fallocate(&self.0, FallocateFlags::empty(), size, free).is_ok() {
                size += free;
            }
        }
    }
}

impl Drop for Filler {
    fn drop(&mut self) {
        std::fs::remove_file(Self::PATH).unwrap();
    }
}

fn assert_names(said: &str, parts: &[&str]) {
    for part in parts {
        assert!(said.contains(part), "{said:?} does not name {part:?}");
    }
}

/// When it is full, and what happens then.
type Moment = (&'static str, fn(&Server));

/// A session, and the same in-process.
struct Pair {
    session: Session,
    twin: Twin,
    policies: Vec<Policy>,
    rows: Vec<Row>,
}

impl Pair {
    const ENVS: u32 = 8;

    fn request() -> SessionRequest {
        SessionRequest::new("NeedleReach-v0").envs(Self::ENVS).seed(5)
    }

    fn open(server: &Server) -> Self {
        let request = Self::request();
        let session = server.open(&request);
        let twin = Twin::new(&request.task, &request.options, Self::ENVS as usize, request.seed);
        Self { session, twin, policies: policies(5, Self::ENVS as usize), rows: vec![] }
    }

    fn reset(&mut self) {
        self.rows = Row::all(&self.session.reset().unwrap(), Autoreset::NextStep);
        assert_eq!(self.rows, self.twin.reset(&self.twin.all(), None));
    }

    fn step(&mut self) -> trocar_client::Reply {
        let actions = act(&mut self.policies, &self.rows);
        let reply = self.session.step(&actions).unwrap();
        self.rows = Row::all(&reply, Autoreset::NextStep);
        assert_eq!(self.rows, self.twin.step(&self.twin.all(), &actions).unwrap());
        reply
    }
}

fn a_server_starts() {
    let _full = Filler::full();
    let mut command = serve(&unique_name());
    let output = command.stdin(Stdio::null()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("/dev/shm") || said.contains("No space left"), "{said}");
}

fn a_client_connects(server: &Server) {
    let full = Filler::full();
    let refused = Client::connect(server.name()).unwrap_err().to_string();
    assert_names(&refused, &["0 KiB of /dev/shm", "a client needs", "--shm-size"]);
    drop(full);
    server.connect();
}

fn a_session_is_to_be_opened(server: &Server) {
    let client = server.connect();
    let full = Filler::full();
    let refused = client.open(&Pair::request()).unwrap_err().to_string();
    assert_names(&refused, &["the session needs", "of /dev/shm", "--shm-size"]);
    drop(full);
    client.open(&Pair::request()).unwrap();
}

fn it_was_not_reset_yet(server: &Server) {
    let mut pair = Pair::open(server);
    let _full = Filler::full();
    pair.reset();
    pair.step();
}

fn it_was_reset(server: &Server) {
    let mut pair = Pair::open(server);
    pair.reset();
    let _full = Filler::full();
    (0..60).for_each(|_| drop(pair.step())); // over an episode's end
}

fn replies_are_held(server: &Server) {
    let mut pair = Pair::open(server);
    pair.reset();
    let first = (pair.step(), pair.rows.clone());
    let _full = Filler::full();
    let second = (pair.step(), pair.rows.clone());
    (0..5).for_each(|_| drop(pair.step()));
    for (reply, rows) in [first, second] {
        assert_eq!(Row::all(&reply, Autoreset::NextStep), rows);
    }
}

fn states_are_kept_and_restored(server: &Server) {
    let mut pair = Pair::open(server);
    pair.reset();
    pair.step();
    let _full = Filler::full();
    let actions = act(&mut pair.policies, &pair.rows);
    let snapshot = pair.session.snapshot().unwrap();
    let bytes = pair.session.export(&snapshot).unwrap();
    let imported = pair.session.import(&bytes).unwrap();
    let mut outcomes = vec![];
    for snapshot in [&snapshot, &imported] {
        pair.session.restore(snapshot).unwrap();
        outcomes.push(Row::all(&pair.session.step(&actions).unwrap(), Autoreset::NextStep));
    }
    let expected = pair.twin.step(&pair.twin.all(), &actions).unwrap();
    assert_eq!(outcomes, [expected.clone(), expected]);
}

fn pictures_are_drawn(server: &Server) {
    let request = Pair::request().view(Options::new());
    let mut session = server.open(&request);
    session.reset().unwrap();
    let before = session.render(0, false).unwrap().picture_rgb().to_vec();
    let _full = Filler::full();
    assert!(session.render(0, false).unwrap().picture_rgb() == before);
    assert!(!session.render(1, true).unwrap().picture_depth().is_empty());
}

fn it_is_closed(server: &Server) {
    let (observer, mut pair) = (server.connect(), Pair::open(server));
    pair.reset();
    let sessions = || observer.status().unwrap().sessions.len();
    let before = sessions();
    let _full = Filler::full();
    drop(pair);
    eventually("it is closed", || sessions() == before - 1);
}

fn a_killed_client_is_reclaimed(server: &Server) {
    let observer = server.connect();
    let sessions = || observer.status().unwrap().sessions.len();
    let remains = || server.endpoint().remains().unwrap().len();
    let (few, before) = (sessions(), remains());
    let mut victim = client(server.name(), "hold");
    assert_eq!(victim.line(), "ready");
    let _full = Filler::full();
    victim.kill();
    eventually("its session is gone", || sessions() == few);
    eventually("so are its files", || remains() <= before);
}

fn the_viewer_is_asked_for(server: &Server) {
    let observer = server.connect();
    let _full = Filler::full();
    let mut stream = TcpStream::connect(observer.viewer().unwrap()).unwrap();
    write!(stream, "GET / HTTP/1.0\r\nHost: localhost\r\n\r\n").unwrap();
    let mut page = [0; 15];
    stream.read_exact(&mut page).unwrap();
    assert_eq!(&page[9..], b"200 OK");
}

#[test]
fn shared_memory_may_be_full_at_any_moment_of_a_session() {
    if !inside("filled::shared_memory_may_be_full_at_any_moment_of_a_session") {
        return;
    }
    a_server_starts();
    let mut server = Server::start();
    let bystander = Bystander::start(&server);
    let moments: [Moment; 10] = [
        ("a client connects", a_client_connects),
        ("a session is to be opened", a_session_is_to_be_opened),
        ("it was not reset yet", it_was_not_reset_yet),
        ("it was reset", it_was_reset),
        ("replies are held", replies_are_held),
        ("states are kept and restored", states_are_kept_and_restored),
        ("pictures are drawn", pictures_are_drawn),
        ("it is closed", it_is_closed),
        ("a killed client is reclaimed", a_killed_client_is_reclaimed),
        ("the viewer is asked for", the_viewer_is_asked_for),
    ];
    for (moment, live) in moments {
        eprintln!("/dev/shm is full when {moment}");
        live(&server);
        assert!(server.process().poll().is_none(), "the server ended");
    }
    bystander.finish();
    eprintln!("/dev/shm is full when the server ends");
    let _full = Filler::full();
    server.process().signal(Signal::TERM);
    assert_eq!(server.process().wait().code(), Some(0));
}

/// Nothing is as sudden as a program that fills all of it, and lets go, a hundred times a second.
#[test]
fn shared_memory_may_fill_while_sessions_open_and_close() {
    if !inside("filled::shared_memory_may_fill_while_sessions_open_and_close") {
        return;
    }
    let times = if soak() { 10_000 } else { 150 };
    let mut server = Server::start();
    let bystander = Bystander::start(&server);
    let mut clients: Vec<Process> = (0..2).map(|_| client(server.name(), "open-anyway")).collect();
    for client in &mut clients {
        assert_eq!(client.line(), "ready");
    }
    let filler = Filler::full();
    for _ in 0..times {
        filler.fill();
        std::thread::yield_now();
        filler.0.set_len(0).unwrap();
        std::thread::yield_now();
    }
    drop(filler);
    for mut client in clients {
        let (status, counts) = client.finish();
        assert!(status.success(), "{status}: {counts}");
        let counts: Vec<usize> =
            counts.split_whitespace().map(|count| count.parse().expect("only counts")).collect();
        eprintln!("sessions that stepped, and that were refused: {counts:?}");
        assert!(counts.len() == 2 && counts.iter().all(|count| *count > 0), "{counts:?}");
    }
    assert!(server.process().poll().is_none(), "the server ended");
    bystander.finish();
}
