//! How many may be connected, and from where.

use std::future::Future;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::http::{HeaderMap, HeaderName, header};
use axum::serve::Listener;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep, sleep};

/// First bytes of the response that makes a connection a WebSocket.
const SWITCHING: &[u8] = b"HTTP/1.1 101";

/// Lets so many connections in at a time; the others wait outside.
pub(super) struct ConnectionLimit {
    listener: TcpListener,
    places: Arc<Semaphore>,
    idle_limit: Duration,
}

impl ConnectionLimit {
    /// `idle_limit` is the longest time from the start of a connection, or from its last response, to
    /// the end of its next request. WebSockets have no such limit.
    pub(super) fn new(listener: TcpListener, places: usize, idle_limit: Duration) -> Self {
        Self { listener, places: Arc::new(Semaphore::new(places)), idle_limit }
    }
}

impl Listener for ConnectionLimit {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        let place = Arc::clone(&self.places).acquire_owned().await.expect("it is never closed");
        let (stream, address) = Listener::accept(&mut self.listener).await;
        // Frames are small and each is worth sending at once.
        stream.set_nodelay(true).ok();
        let idle_limit = self.idle_limit;
        let deadline = Some(Box::pin(sleep(idle_limit)));
        (Connection { stream, deadline, idle_limit, _place: place }, address)
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// A connection, with the place that it takes.
pub(super) struct Connection {
    stream: TcpStream,
    /// End of the time for the next request; none for WebSockets.
    deadline: Option<Pin<Box<Sleep>>>,
    idle_limit: Duration,
    _place: OwnedSemaphorePermit,
}

impl Connection {
    /// An error if the deadline has passed; otherwise pending until then.
    fn poll_deadline<T>(&mut self, context: &mut Context<'_>) -> Poll<io::Result<T>> {
        let Some(deadline) = &mut self.deadline else { return Poll::Pending };
        ready!(deadline.as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }

    /// Moves the deadline after a write that began with `bytes`.
    fn extend(&mut self, bytes: &[u8]) {
        if bytes.starts_with(SWITCHING) {
            self.deadline = None;
        }
        if let Some(deadline) = &mut self.deadline {
            deadline.as_mut().reset(Instant::now() + self.idle_limit);
        }
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        match Pin::new(&mut self.stream).poll_read(context, buffer) {
            Poll::Pending => self.poll_deadline(context),
            Poll::Ready(read) => Poll::Ready(read),
        }
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        if written.is_pending() {
            return self.poll_deadline(context);
        }
        self.extend(bytes);
        written
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        if written.is_pending() {
            return self.poll_deadline(context);
        }
        self.extend(slices.first().map_or(&[], |slice| slice));
        written
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

/// Which requests are answered: a browser lets every page of the web connect to this machine's ports, and
/// names of the web may lead to this machine.
#[derive(Debug, Clone, Copy)]
pub(super) struct AllowedHosts {
    /// It listens on loopback, so that it goes by this machine's names only.
    local: bool,
}

impl AllowedHosts {
    pub(super) fn of(address: SocketAddr) -> Self {
        Self { local: address.ip().is_loopback() }
    }

    /// Whether only this machine gets here.
    pub(super) fn is_local(self) -> bool {
        self.local
    }

    /// Whether a request comes from our own page, or from no page; an error says why not.
    pub(super) fn check(self, headers: &HeaderMap) -> Result<(), &'static str> {
        let text = |name: HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
        let host = text(header::HOST).unwrap_or_default();
        if self.local && !is_local(host) {
            return Err("this viewer goes by localhost and 127.0.0.1 only");
        }
        let origin = text(header::ORIGIN);
        let is_ours = |origin: &str| origin.split_once("://").is_some_and(|(_, of)| of == host);
        if origin.is_some_and(|origin| !is_ours(origin)) {
            return Err("another site's page may not look in here");
        }
        Ok(())
    }
}

/// Whether a host, with or without a port, is this machine by a name that no other machine has.
fn is_local(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let address = name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    name.eq_ignore_ascii_case("localhost") || address.is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use tokio::io::AsyncReadExt;

    use super::*;

    #[test]
    fn idle_connections_lose_their_place() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let mut limit = ConnectionLimit::new(listener, 1, Duration::from_millis(50));
            let address = limit.local_addr().unwrap();
            // The second connection has a place only after the first one has lost it.
            for _ in 0..2 {
                let _silent = TcpStream::connect(address).await.unwrap();
                let (mut connection, _) = limit.accept().await;
                let error = connection.read_u8().await.unwrap_err();
                assert_eq!(error.kind(), io::ErrorKind::TimedOut);
            }
            let _page = TcpStream::connect(address).await.unwrap();
            let (mut connection, _) = limit.accept().await;
            connection.extend(b"HTTP/1.1 101 Switching Protocols");
            let read = tokio::time::timeout(Duration::from_millis(200), connection.read_u8());
            assert!(read.await.is_err(), "a WebSocket has no deadline");
        });
    }

    #[test]
    fn pages_of_other_sites_do_not_look_in() {
        let check = |address: &str, host: &str, origin: Option<&str>| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, host.parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            AllowedHosts::of(address.parse().unwrap()).check(&headers).is_ok()
        };
        // A tunnel has any port at its other end.
        for host in ["localhost:9000", "127.0.0.1:8080", "[::1]:8080", "LOCALHOST", "127.0.0.1"] {
            assert!(check("127.0.0.1:8080", host, None), "{host}");
            assert!(check("127.0.0.1:8080", host, Some(&format!("http://{host}"))), "{host}");
            assert!(!check("127.0.0.1:8080", host, Some("https://example.org")), "{host}");
            assert!(!check("127.0.0.1:8080", host, Some("null")), "{host}");
        }
        for host in ["example.org:8080", "localhost.example.org", "10.0.0.3:8080", ""] {
            assert!(!check("127.0.0.1:8080", host, None), "{host}");
        }
        // A user that lets the network in chooses the names.
        assert!(check("0.0.0.0:8080", "lab.example.org", Some("http://lab.example.org")));
        assert!(!check("0.0.0.0:8080", "lab.example.org", Some("http://example.org")));
    }
}
