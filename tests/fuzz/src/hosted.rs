//! A server in this process, and clients of it.

use std::sync::mpsc::channel;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::thread;

use trocar_client::{Client, Reply, Session, SessionRequest};
use trocar_proto::endpoint::Endpoint;
use trocar_server::Registry;
use trocar_server::service::{ServerConfig, StopSignal, serve};

/// Memory of its sessions and their snapshots, bytes.
const BUDGET: u64 = 64 << 20;

/// A server, until this process ends.
pub(crate) struct Hosted {
    pub(crate) client: Client,
    pub(crate) endpoint: Endpoint,
}

/// The server, for one target at a time.
pub(crate) fn server() -> MutexGuard<'static, Hosted> {
    static SERVER: LazyLock<Mutex<Hosted>> = LazyLock::new(|| Mutex::new(Hosted::start()));
    SERVER.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hosted {
    fn start() -> Self {
        let name = format!("fuzz-{}", std::process::id()).parse().expect("a name");
        let endpoint = Endpoint::new(&name);
        let config = ServerConfig { threads: 1, memory_bytes: BUDGET, ..ServerConfig::new(name) };
        let (ready, begun) = channel();
        let hosted = config.clone();
        thread::spawn(move || {
            let tell = move || ready.send(()).expect("it is waited for");
            serve(Registry::builtin(), &hosted, &StopSignal::default(), tell).expect("it serves");
        });
        begun.recv().expect("the server begins");
        let client = Client::connect(config.name.as_str()).expect("it runs");
        Self { client, endpoint }
    }

    /// A session whose bits are known.
    pub(crate) fn open(&self, request: &SessionRequest) -> Known {
        let mut session = self.client.open(request).expect("there is room");
        let first = episode(&mut session);
        Known { session, first }
    }
}

/// A session, and what it shows at first.
pub(crate) struct Known {
    pub(crate) session: Session,
    first: Vec<u32>,
}

impl Known {
    /// Whatever has happened, the same seeds give the same bits.
    pub(crate) fn check(&mut self) {
        assert_eq!(episode(&mut self.session), self.first);
    }
}

/// What two steps of the first episode of seed 7 show.
fn episode(session: &mut Session) -> Vec<u32> {
    session.want_expert(false);
    let envs = session.envs();
    let actions = vec![0.5; envs * session.spec().action_dim()];
    session.start_reset_to(None, &vec![7; envs], &vec![0; envs]).expect("it is asked");
    let mut seen = bits(&session.recv().expect("a session answers"));
    for _ in 0..2 {
        seen.extend(bits(&session.step(&actions).expect("a session answers")));
    }
    seen
}

fn bits(reply: &Reply) -> Vec<u32> {
    let numbers = reply.observation().iter().chain(reply.achieved_goal()).chain(reply.reward());
    numbers.map(|number| number.to_bits()).chain(reply.steps().iter().copied()).collect()
}
