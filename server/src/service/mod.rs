//! Hosting: sessions of many clients over shared memory.
//!
//! | file | holds |
//! |---|---|
//! | [`mod@self`] | [`serve`]: the life of a server, from its lock to its last file |
//! | `control.rs` | the control loop: rare messages, opening and closing sessions |
//! | `admission.rs` | what a control message means, without any transport |
//! | `meter.rs`, `exporter.rs` | what is counted, and how Prometheus gets it |
//! | `watch.rs` | sessions as the viewer sees them |
//! | `liveness.rs` | which clients are alive: reclaims what dead clients leave |
//! | `session.rs` | a session: answers its client's messages |
//! | `handle.rs` | a session as others see it: the control loop, the viewer |
//! | `batch_session.rs` | a session of environments: what its messages ask for |
//! | `live_session.rs` | a session with a live world: what its messages ask for |
//! | `shared_world.rs` | a live world of one or several sessions: time, events, which session drives which arm |
//! | `driver.rs` | what drives an arm of a live world: a session, a page |
//! | `real_time.rs` | the pace of a live world whose time passes by itself |
//! | `batch.rs` | the environments of a session: reset, step, autoreset |
//! | `drawing.rs` | pictures of environments, once all of a message were stepped |
//! | `heap.rs` | gives memory back that sessions have freed |
//! | `ports.rs` | the ends of the transport: how services are made, what a reply is |
//! | `rows.rs` | the arrays of a reply, row by row |
//! | `store.rs` | the snapshots of a session, and the memory that they take |
//! | `observer.rs` | what is written down while environments step: failures, recordings |
//! | `cpus.rs` | which processors a server uses |
//! | [`scheduler`] | which session's message is answered next, and by which thread |
//! | `unfinished.rs` | removes shared memory that a process began and never finished |
//!
//! Every session has its own data service and environments. Whichever thread is free answers the message of the
//! session that is next; long ones are interrupted after quanta of about two milliseconds, so a slow session never
//! holds up a fast one. Next is the session that has had the threads for the least time.

mod admission;
mod batch;
mod batch_session;
mod control;
mod cpus;
mod drawing;
mod driver;
mod exporter;
mod handle;
mod heap;
mod live_session;
mod liveness;
mod meter;
mod observer;
mod ports;
mod real_time;
mod rows;
mod scheduler;
mod session;
mod shared_world;
mod store;
mod unfinished;
mod watch;

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

use trocar_proto::cause;
use trocar_proto::endpoint::{Endpoint, Membership, ServerLock, ServerName, ServerState};
use trocar_proto::missing_page::guarded;
use trocar_proto::notify::reply_event::ReplyEvent;
use trocar_proto::{Code, Rejection};

use self::unfinished::Remover;
use crate::registry::Registry;

pub use admission::{Admission, Admitted, Footprint, Holding, Quota, Usage};
pub use cpus::Cpus;

/// How long a server that is ending may take before its name is said to be in use: its drain limit,
/// unless that is unusual, and some more.
const ENDING: Duration = Duration::from_secs(10);

/// Shared memory that a server needs to begin at all, bytes.
const FIRST_BYTES: u64 = 64 << 10;

/// How a server is set up. [`Self::new`] gives the defaults.
#[derive(Debug, Clone)]
pub struct ServerConfig {
    /// The name clients connect to.
    pub name: ServerName,
    /// Threads that step environments.
    pub threads: usize,
    /// The processors that it uses; every one that it may if `None`.
    pub cpus: Option<Cpus>,
    /// Most environments that one session may have.
    pub max_envs: u32,
    /// Memory that all sessions together may take, bytes.
    pub memory_bytes: u64,
    /// What one client may have of all that.
    pub client: Quota,
    /// A session that sends nothing for so long is closed.
    pub idle_limit: Duration,
    /// How long steps in progress may take when the server ends.
    pub drain_limit: Duration,
    /// Where Prometheus may ask for metrics over HTTP; port 0 is one that is free.
    pub metrics: Option<SocketAddr>,
    /// Where the live viewer is served over HTTP; port 0 is one that is free.
    pub view: Option<SocketAddr>,
    /// The process whose end ends the server.
    pub follow: Option<u32>,
    /// How long the server outlives its last client; for ever if `None`.
    pub linger: Option<Duration>,
    /// The folder where episodes that fail are recorded, a hundred at most; nowhere if `None`.
    pub failures: Option<PathBuf>,
}

impl ServerConfig {
    /// The defaults: one thread per core, 4096 environments, 1 GiB, one hour; 5 s to end.
    pub fn new(name: ServerName) -> Self {
        Self {
            name,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            cpus: None,
            max_envs: 4096,
            memory_bytes: 1 << 30,
            client: Quota::default(),
            idle_limit: Duration::from_hours(1),
            drain_limit: Duration::from_secs(5),
            metrics: None,
            view: None,
            follow: None,
            linger: None,
            failures: None,
        }
    }
}

/// Asks a server to end; may be set from a signal handler.
#[derive(Debug, Clone, Default)]
pub struct StopSignal(Arc<AtomicU8>);

impl StopSignal {
    /// Asks the server to end: it answers what it was asked, which takes as long as steps in
    /// progress do, but no longer than [`ServerConfig::drain_limit`]. Asked once more, it does not
    /// wait for them.
    pub fn set(&self) {
        let once_more = |times: u8| Some(times.saturating_add(1));
        self.0.fetch_update(Ordering::AcqRel, Ordering::Acquire, once_more).ok();
    }

    /// Whether the server was asked to end.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Acquire) > 0
    }

    /// Whether it was asked more than once.
    pub fn is_urgent(&self) -> bool {
        self.0.load(Ordering::Acquire) > 1
    }
}

/// Why a server could not serve.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Another server of that name runs.
    #[error(
        "a server named {name:?} is running already (process {pid}); choose another --name, or stop it with `trocar stop --name {name}`"
    )]
    NameInUse {
        /// The name.
        name: String,
        /// The other server's process id, in its own process namespace.
        pid: u32,
    },
    /// The configuration asks for something impossible, or shared memory failed.
    #[error(transparent)]
    Refused(#[from] Rejection),
    /// The folder or the lock file failed.
    #[error("{path}")]
    Folder {
        /// The server's folder.
        path: String,
        /// What failed.
        source: io::Error,
    },
    /// The server cannot listen where metrics were to be had.
    #[error("--metrics {address}")]
    Metrics {
        /// Where that was.
        address: SocketAddr,
        /// What failed.
        source: io::Error,
    },
    /// The server cannot listen where the viewer was to be had.
    #[error("--view {address}")]
    View {
        /// Where that was.
        address: SocketAddr,
        /// What failed.
        source: io::Error,
    },
    /// Threads could not be started.
    #[error("threads: {0}")]
    Threads(String),
}

/// Serves the tasks of `registry` until `stop` is set, a client asks for it, or the private rule
/// says so. `ready` is called once clients can connect.
pub fn serve(
    registry: Registry,
    config: &ServerConfig,
    stop: &StopSignal,
    ready: impl FnOnce(),
) -> Result<(), ServeError> {
    admission::check_config(config)?;
    // Before any thread is started: they inherit it.
    if let Some(cpus) = &config.cpus {
        cpus.pin()?;
    }
    heap::limit(config.threads);
    raise_file_limit();
    let endpoint = Endpoint::new(&config.name);
    let folder =
        |source| ServeError::Folder { path: endpoint.folder().display().to_string(), source };
    let epoch = new_epoch();
    let membership = endpoint.join().map_err(folder)?;
    let lock = take_lock(&membership, epoch).map_err(folder)?;
    let lock = lock.map_err(|pid| ServeError::NameInUse { name: config.name.to_string(), pid })?;
    // Without that, not even the predecessor's remains can be looked through.
    Endpoint::check_free("a server", FIRST_BYTES).map_err(folder)?;
    let _remover =
        Remover::start(endpoint.clone()).map_err(|error| ServeError::Threads(error.to_string()))?;
    let node = guarded(|| membership.node()).map_err(folder)?;
    let node = Arc::new(node.map_err(internal("node"))?);
    // A predecessor may have died while its clients live: what it left goes first. So does what no
    // process uses under other names: those of private servers are not used again.
    node.try_cleanup_dead_nodes();
    ReplyEvent::clear(&endpoint).map_err(folder)?;
    for other in Endpoint::all().map_err(folder)? {
        other.remove_if_unused().ok();
    }
    Endpoint::check_free("a server", ports::START_BYTES).map_err(folder)?;
    let served =
        control::run(Arc::new(registry), config, &lock, &node, endpoint.clone(), stop, ready);
    node.try_cleanup_dead_nodes();
    // Of sessions that were left behind.
    ReplyEvent::clear(&endpoint).ok();
    drop(node);
    drop(lock);
    // The last one out removes the folder: this server, or a client that is still there.
    drop(membership);
    served
}

/// Takes the single-instance lock. Waits for a predecessor that is just ending, and for processes that
/// look whether there is a server: they share the lock for a moment.
fn take_lock(membership: &Membership, epoch: u64) -> io::Result<Result<ServerLock, u32>> {
    let start = Instant::now();
    loop {
        let taken = membership.become_server(epoch)?;
        let state = membership.endpoint().server_state();
        let in_use = matches!(state, ServerState::Running { .. });
        if taken.is_ok() || in_use || start.elapsed() > ENDING {
            return Ok(taken);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A number that tells this run of the server from every other: nanoseconds since 1970.
fn new_epoch() -> u64 {
    std::time::UNIX_EPOCH.elapsed().map_or(1, |time| time.as_nanos() as u64)
}

/// Every client takes about ten file descriptors; most systems allow 1024 unless asked for more.
fn raise_file_limit() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let limit = getrlimit(Resource::Nofile);
    let wanted = Rlimit { current: limit.maximum, maximum: limit.maximum };
    if let Err(error) = setrlimit(Resource::Nofile, wanted) {
        tracing::warn!(%error, "the limit of open files could not be raised");
    }
}

/// Names an operation of the transport that failed.
fn internal<E: std::fmt::Debug>(what: &'static str) -> impl FnOnce(E) -> Rejection {
    move |error| {
        Rejection::new(Code::Internal, what, cause::explain(&error), "see the server's log")
    }
}
