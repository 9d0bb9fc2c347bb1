//! The connection to a server.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_proto::control::{
    ClientInfo, ClientLimits, ControlCalls, ControlReply, ServerInfo, ServerStatus, SessionRequest,
};
use trocar_proto::endpoint::{Endpoint, Membership, ServerName, ServerState};
use trocar_proto::open_files::{OpenFiles, SESSION_FILES};
use trocar_proto::spec::Options;
use trocar_proto::wire::Header;
use trocar_proto::{Code, Rejection, TaskSpec};

use crate::error::{CallError, ConnectError};
use crate::live::LiveWorld;
use crate::private;
use crate::session::Session;
use crate::transport::{Link, Owned};

/// How long a client waits for a server that is just starting.
const PATIENCE: Duration = Duration::from_secs(10);

/// The longest pause between two looks for a server that is to come back.
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// A connection to one server. Clones share it; it ends with the last clone or session.
#[derive(Debug, Clone)]
pub struct Client {
    link: Arc<Owned<Link>>,
    info: ClientInfo,
    server: ServerInfo,
    origin: Origin,
}

/// Where a server is found again.
#[derive(Debug, Clone)]
enum Origin {
    /// Under this name, where a user starts it.
    Named(ServerName),
    /// It is started where it does not run.
    Private(private::PrivateServer),
}

impl Client {
    /// Connects to the running server of that name.
    pub fn connect(name: &str) -> Result<Self, ConnectError> {
        Self::connect_as(name, "rust")
    }

    /// Connects to `$TROCAR_SERVER`, else to the private server of this process tree, which is
    /// started if it does not run yet and ends when its last client has been gone for a while. An empty
    /// variable is none.
    pub fn connect_private() -> Result<Self, ConnectError> {
        match private::set("TROCAR_SERVER") {
            Some(name) => Self::connect(&name.to_string_lossy()),
            None => Self::launch(&private::PrivateServer::of_this_process_tree()?, "rust"),
        }
    }

    /// [`Self::connect`] for a client in another language.
    #[doc(hidden)]
    pub fn connect_as(name: &str, language: &str) -> Result<Self, ConnectError> {
        Origin::Named(name.parse()?).connect(language)
    }

    /// Connects to a private server, which is started where it does not run.
    #[doc(hidden)]
    pub fn launch(server: &private::PrivateServer, language: &str) -> Result<Self, ConnectError> {
        Origin::Private(server.clone()).connect(language)
    }

    /// Connects again, to whichever server of that name runs within `patience`.
    pub(crate) fn again(&self, patience: Duration) -> Result<Self, ConnectError> {
        let deadline = Instant::now() + patience;
        let mut pause = Duration::from_millis(10);
        loop {
            match self.origin.connect(&self.info.language) {
                Err(ConnectError::NoServer { .. }) if Instant::now() < deadline => {}
                result => return result,
            }
            std::thread::sleep(pause.min(deadline.saturating_duration_since(Instant::now())));
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    fn over(
        membership: &Membership,
        language: &str,
        origin: &Origin,
    ) -> Result<Self, ConnectError> {
        let name = membership.endpoint().name().to_string();
        let start = Instant::now();
        let mut pause = Duration::from_millis(1);
        loop {
            match membership.endpoint().look().map_err(shared_memory)? {
                ServerState::Running { epoch, .. } => {
                    Link::check_room().map_err(ConnectError::Transport)?;
                    let endpoint = membership.endpoint().clone();
                    let joined = endpoint.join().map_err(shared_memory)?;
                    match Self::hello(joined, epoch, language, origin.clone()) {
                        // Its services are not there yet, or it ended meanwhile: look again.
                        Err(CallError::Transport(_) | CallError::ServerLost { .. })
                            if start.elapsed() < PATIENCE => {}
                        Err(CallError::Refused(refusal)) => return Err(refusal.into()),
                        Err(CallError::Transport(reason)) => {
                            return Err(ConnectError::Transport(reason));
                        }
                        Err(CallError::Timeout { name, seconds, .. }) => {
                            return Err(ConnectError::Timeout { name, seconds });
                        }
                        Err(_) => return Err(ConnectError::NoServer { name }),
                        Ok(client) => return Ok(client),
                    }
                }
                ServerState::Ending { .. } | ServerState::Closed { .. } | ServerState::Absent => {
                    return Err(ConnectError::NoServer { name });
                }
            }
            if start.elapsed() > PATIENCE {
                return Err(ConnectError::Timeout { name, seconds: PATIENCE.as_secs_f64() });
            }
            std::thread::sleep(pause);
            pause = (pause * 2).min(Duration::from_millis(100));
        }
    }

    fn hello(
        membership: Membership,
        epoch: u64,
        language: &str,
        origin: Origin,
    ) -> Result<Self, CallError> {
        let link = Link::open(membership, epoch)?;
        let info =
            ClientInfo { node: link.node_id(), pid: std::process::id(), language: language.into() };
        let server = link.hello(info.clone())?;
        Ok(Self { link: Arc::new(Owned::new(link)), info, server, origin })
    }

    /// The server, as it introduced itself.
    pub fn server(&self) -> &ServerInfo {
        &self.server
    }

    /// The ids of the tasks that the server offers.
    pub fn tasks(&self) -> Result<Vec<String>, CallError> {
        self.link.get()?.list_tasks()
    }

    /// What a task looks like under some options.
    pub fn describe(&self, task: &str, options: &Options) -> Result<TaskSpec, CallError> {
        self.link.get()?.describe_task(task.into(), options.clone()).map(|spec| *spec)
    }

    /// Opens a session: one task, N environments, one seed, its options.
    pub fn open(&self, request: &SessionRequest) -> Result<Session, CallError> {
        OpenFiles::now().check("a session", SESSION_FILES).map_err(CallError::Transport)?;
        if request.live.is_some() {
            let why = "Client::open_live opens a session with a live world";
            return Err(Rejection::new(Code::Unsupported, "live", "a live world", why).into());
        }
        let info = self.link.get()?.open_session(request.clone(), self.info.clone())?;
        // Where the server has died meanwhile, its successor may have removed the services.
        Session::new(self.clone(), request.clone(), *info)
            .map_err(|error| self.link.check_server().err().unwrap_or(error))
    }

    /// Opens a session with a live world: what [`SessionRequest::live`] asks for, or a world in lock-step.
    pub fn open_live(&self, request: &SessionRequest) -> Result<LiveWorld, CallError> {
        OpenFiles::now().check("a session", SESSION_FILES).map_err(CallError::Transport)?;
        let live = Some(request.live.unwrap_or_default());
        let request = SessionRequest { live, ..request.clone() };
        let info = self.link.get()?.open_session(request, self.info.clone())?;
        LiveWorld::new(self.clone(), *info)
            .map_err(|error| self.link.check_server().err().unwrap_or(error))
    }

    /// The server's clients and sessions, and how fast it runs.
    pub fn status(&self) -> Result<ServerStatus, CallError> {
        self.link.get()?.status()
    }

    /// What one client, a process, may have of the server.
    pub fn limits(&self) -> Result<ClientLimits, CallError> {
        self.link.get()?.limits()
    }

    /// Begins to record an environment of any session, its own or another client's: a snapshot each
    /// `every` steps and one at the end of each episode. [`Self::recorded`] fetches them.
    pub fn record(&self, session: u64, env: u32, every: u32) -> Result<(), CallError> {
        self.link.get()?.record(session, env, every)
    }

    /// The snapshots that were recorded since the last call, as bytes, and how many are missing
    /// because this call came too late. Call it at least twice a minute.
    pub fn recorded(&self, session: u64) -> Result<(Vec<u8>, u64), CallError> {
        self.link.get()?.recorded(session)
    }

    /// Where the server's live viewer is, a page over HTTP; it is started where there is none.
    pub fn viewer(&self) -> Result<SocketAddr, CallError> {
        self.link.get()?.viewer()
    }

    /// Where the viewer's page is that may drive the arms of live worlds: an address with a token, to be kept to oneself.
    pub fn driving_page(&self) -> Result<String, CallError> {
        let link = self.link.get()?;
        Ok(format!("http://{}/#token={}", link.viewer()?, link.drive_token()?))
    }

    /// Ends the server, for all of its clients.
    pub fn shut_down(&self) -> Result<(), CallError> {
        self.link.get()?.shutdown()
    }

    /// Sends arbitrary bytes as a control message, for tests of the server's defences.
    #[doc(hidden)]
    pub fn send_raw(&self, header: Header, bytes: &[u8]) -> Result<ControlReply, CallError> {
        self.link.get()?.call_raw(header, bytes, "raw bytes")
    }

    pub(crate) fn link(&self) -> &Arc<Owned<Link>> {
        &self.link
    }
}

impl Origin {
    fn connect(&self, language: &str) -> Result<Client, ConnectError> {
        let server = match self {
            Self::Named(name) => {
                let endpoint = Endpoint::new(name);
                let state = endpoint.look().map_err(shared_memory)?;
                if !matches!(state, ServerState::Running { .. }) {
                    return Err(ConnectError::NoServer { name: name.to_string() });
                }
                let membership = endpoint.join().map_err(shared_memory)?;
                return Client::over(&membership, language, self);
            }
            Self::Private(server) => server,
        };
        let membership = server.endpoint().join().map_err(shared_memory)?;
        let start = Instant::now();
        loop {
            server.start_if_absent(&membership)?;
            match Client::over(&membership, language, self) {
                // It ended just then, as its last client was gone: start another.
                Err(ConnectError::NoServer { .. }) if start.elapsed() < PATIENCE => {}
                result => return result,
            }
        }
    }
}

#[allow(clippy::needless_pass_by_value)] // for map_err
fn shared_memory(error: std::io::Error) -> ConnectError {
    ConnectError::Transport(error.to_string())
}
