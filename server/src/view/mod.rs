//! The live viewer: a page over HTTP that shows what is simulated. With a token it may drive the arms of live worlds.
//!
//! | module | holds |
//! |---|---|
//! | [`mod@self`] | [`View`]: the server of the page |
//! | [`source`] | what can be watched, and channels; a server's sessions are in `service/watch.rs` |
//! | [`replay_source`] | recordings |
//! | [`message`] | what page and server say to each other |
//! | `connection.rs` | one page that is connected |
//! | `camera_worker.rs` | draws the endoscope's picture |
//! | `access.rs` | how many may be connected, and from where |
//!
//! The page itself is built from `server/view` (`make viewer`). The simulating side puts *moments* into
//! *channels* where they are wanted. The viewer's threads turn poses into messages and draw the
//! endoscope's pictures. A page that is slow gets fewer moments.

mod access;
mod camera_worker;
mod connection;
pub mod message;
pub mod replay_source;
pub mod source;

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::extract::ws::WebSocketUpgrade;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tokio::sync::watch;

use access::{AllowedHosts, ConnectionLimit};
use camera_worker::CameraWorker;
use source::Source;

/// The page, with all that it needs in it.
const PAGE: &str = include_str!("../../view/page.html");

/// Whatever the page is made to do, it loads nothing from elsewhere.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; \
                      img-src blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// Most pages that watch at a time.
pub const MOST_PAGES: usize = 16;

/// Most connections at a time; further ones wait.
pub const MOST_CONNECTIONS: usize = 64;

/// Longest time for a request, and between two requests of a connection. Idle connections would otherwise keep
/// their places, and nobody else would get the page.
const IDLE_LIMIT: Duration = Duration::from_secs(10);

/// How long pages are waited for that are told that the server ends.
const GOODBYE: Duration = Duration::from_millis(500);

/// Serves the page until it is dropped.
#[derive(Debug)]
pub struct View {
    address: SocketAddr,
    ending: watch::Sender<bool>,
    threads: Vec<JoinHandle<()>>,
}

/// What all connections share.
#[derive(Clone)]
struct Shared {
    source: Arc<dyn Source>,
    camera: CameraWorker,
    pages: Arc<AtomicUsize>,
    hosts: AllowedHosts,
    ending: watch::Receiver<bool>,
}

impl View {
    /// Listens at `address`; port 0 is one that is free.
    pub fn start(address: SocketAddr, source: Arc<dyn Source>) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        listener.set_nonblocking(true)?;
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
        let (ending, ended) = watch::channel(false);
        let (camera, painting) = CameraWorker::start(MOST_PAGES)?;
        let pages = Arc::new(AtomicUsize::new(0));
        let shared = Shared {
            source,
            camera,
            pages: Arc::clone(&pages),
            hosts: AllowedHosts::of(address),
            ending: ended.clone(),
        };
        let serve = async move {
            let app = Router::new().route("/", get(page)).route("/live", get(live));
            let listener = ConnectionLimit::new(
                tokio::net::TcpListener::from_std(listener)?,
                MOST_CONNECTIONS,
                IDLE_LIMIT,
            );
            let end = until_end(ended, &pages);
            tokio::select! {
                served = axum::serve(listener, app.with_state(shared)).into_future() => served,
                () = end => Ok(()),
            }
        };
        let serving = std::thread::Builder::new().name("trocar-view".into()).spawn(move || {
            if let Err(error) = runtime.block_on(serve) {
                tracing::error!(%error, "the viewer is not served any more");
            }
        })?;
        Ok(Self { address, ending, threads: vec![serving, painting] })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for View {
    fn drop(&mut self) {
        self.ending.send_replace(true);
        for thread in self.threads.drain(..) {
            thread.join().ok();
        }
    }
}

/// Waits until the viewer ends and the pages that were told so are gone, but not for long.
async fn until_end(mut ended: watch::Receiver<bool>, pages: &AtomicUsize) {
    drop(ended.wait_for(|ends| *ends).await);
    let gone = async {
        while pages.load(Ordering::Acquire) > 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(GOODBYE, gone).await.ok();
}

async fn page(State(shared): State<Shared>, headers: HeaderMap) -> Response {
    if let Err(why) = shared.hosts.check(&headers) {
        return (StatusCode::FORBIDDEN, why).into_response();
    }
    let headers = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::CACHE_CONTROL, "no-cache"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    (headers, PAGE).into_response()
}

async fn live(
    State(shared): State<Shared>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Err(why) = shared.hosts.check(&headers) {
        return (StatusCode::FORBIDDEN, why).into_response();
    }
    let Some(place) = Place::take(&shared.pages) else {
        let why = format!("{MOST_PAGES} pages are connected, and no more may be; close one");
        return (StatusCode::SERVICE_UNAVAILABLE, why).into_response();
    };
    let longest = message::LONGEST_COMMAND;
    let upgrade = upgrade.max_message_size(longest).max_frame_size(longest);
    upgrade.on_upgrade(async move |socket| {
        let may_drive = shared.hosts.is_local();
        connection::serve(socket, shared.source, shared.camera, may_drive, shared.ending).await;
        drop(place);
    })
}

/// A place among the pages that may watch; it is free again when this is dropped.
struct Place(Arc<AtomicUsize>);

impl Place {
    fn take(pages: &Arc<AtomicUsize>) -> Option<Self> {
        let one_more = |count: usize| (count < MOST_PAGES).then_some(count + 1);
        let taken = pages.fetch_update(Ordering::AcqRel, Ordering::Acquire, one_more);
        taken.ok().map(|_| Self(Arc::clone(pages)))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}
