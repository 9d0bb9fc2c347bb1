//! Gives Prometheus what the meter counts, over HTTP.

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;

use axum::Router;
use axum::http::{StatusCode, header};
use axum::routing::get;
use tokio::sync::oneshot;

use super::meter::Meter;

/// The format of the answers, as Prometheus is told it.
const FORMAT: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Answers `GET /metrics` until it is dropped.
pub(super) struct Exporter {
    /// Where it listens.
    pub(super) address: SocketAddr,
    /// Dropped to end the thread.
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Exporter {
    /// Listens at `address`; port 0 is one that is free.
    pub(super) fn start(address: SocketAddr, meter: Arc<Meter>) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        listener.set_nonblocking(true)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
        let (end, ended) = oneshot::channel();
        let serve = async move {
            let page = move || async move {
                match meter.text() {
                    Ok(text) => Ok(([(header::CONTENT_TYPE, FORMAT)], text)),
                    Err(error) => Err((StatusCode::INTERNAL_SERVER_ERROR, error.to_string())),
                }
            };
            let app = Router::new().route("/metrics", get(page));
            let listener = tokio::net::TcpListener::from_std(listener)?;
            // Connections that are still open are not waited for.
            tokio::select! {
                served = axum::serve(listener, app).into_future() => served,
                _ = ended => Ok(()),
            }
        };
        let thread =
            std::thread::Builder::new().name("trocar-metrics".into()).spawn(move || {
                if let Err(error) = runtime.block_on(serve) {
                    tracing::error!(%error, "metrics are not served any more");
                }
            })?;
        Ok(Self { address, end: Some(end), thread: Some(thread) })
    }
}

impl Drop for Exporter {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}
