//! One page that is connected: what it asks for, and what it is sent.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message as Frame, WebSocket, close_code};
use tokio::sync::{oneshot, watch};
use tokio::time::{Instant, Interval, MissedTickBehavior, interval, timeout};

use super::camera_worker::{CameraWorker, Painting};
use super::message::{self, Command, Message, Notice, SceneEncoder};
use super::source::{FrameChannel, Moment, Pace, Source};

/// How often the list of sessions is sent.
const LIST: Duration = Duration::from_secs(1);

/// Least time between two pictures of the endoscope. It is also at least [`SHARE`] times the processor time that
/// one took.
const PICTURE: Duration = Duration::from_millis(100);

/// The camera worker takes for a page at most one part in so many of what a core can do: trainers want it too.
const SHARE: u32 = 50;

/// A page that takes nothing for so long is not there any more.
const PATIENCE: Duration = Duration::from_secs(30);

/// Numbers of pages, none of which comes twice.
static NEXT: AtomicU64 = AtomicU64::new(0);

/// Serves a page until it goes or `ending` says that the server does.
pub(super) async fn serve(
    socket: WebSocket,
    source: Arc<dyn Source>,
    camera: CameraWorker,
    may_drive: bool,
    mut ending: watch::Receiver<bool>,
) {
    let mut list = interval(LIST);
    list.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut page = Page {
        number: NEXT.fetch_add(1, Ordering::Relaxed),
        may_drive,
        has_driven: false,
        socket,
        source,
        camera,
        list,
        encoder: SceneEncoder::default(),
        watching: None,
        paused: false,
    };
    let server_ends = async { drop(ending.wait_for(|ends| *ends).await) };
    let over = tokio::select! {
        over = page.run() => Some(over),
        () = server_ends => None,
    };
    let code = match over {
        Some(Over(code)) => code,
        None => match page.say(&Notice::Bye).await {
            Ok(()) => Some(close_code::AWAY),
            Err(Over(code)) => code,
        },
    };
    if let Some(code) = code {
        let close = Frame::Close(Some(CloseFrame { code, reason: "".into() }));
        timeout(PATIENCE, page.socket.send(close)).await.ok();
    }
}

/// The connection is over; with a code to close it with where it still stands.
struct Over(Option<u16>);

struct Page {
    number: u64,
    may_drive: bool,
    /// Whether there may be arms that it drives.
    has_driven: bool,
    socket: WebSocket,
    source: Arc<dyn Source>,
    camera: CameraWorker,
    list: Interval,
    encoder: SceneEncoder,
    watching: Option<Watching>,
    paused: bool,
}

impl Drop for Page {
    fn drop(&mut self) {
        self.let_go();
    }
}

/// An environment that is watched. Its channel closes with it.
struct Watching {
    session: u64,
    env: u32,
    channel: Arc<FrameChannel>,
    picture: Picture,
}

impl Drop for Watching {
    fn drop(&mut self) {
        self.channel.close();
    }
}

/// The endoscope's picture.
enum Picture {
    /// None is drawn now; the next one from this moment on.
    NotBefore(Instant),
    /// One is being drawn since then.
    Ordered(Instant, oneshot::Receiver<Painting>),
}

/// What a page waits for.
#[expect(clippy::large_enum_variant, reason = "there is one at a time")]
enum Event {
    Asked(Option<Result<Frame, axum::Error>>),
    List,
    Moment(Option<Moment>),
    Picture(Option<Painting>),
}

impl Page {
    async fn run(&mut self) -> Over {
        let Err(over) = self.converse().await;
        over
    }

    async fn converse(&mut self) -> Result<Infallible, Over> {
        self.say(&Notice::Hello { about: &self.source.about() }).await?;
        loop {
            let event = tokio::select! {
                asked = self.socket.recv() => Event::Asked(asked),
                _ = self.list.tick() => Event::List,
                event = next(&mut self.watching) => event,
            };
            match event {
                Event::Asked(Some(Ok(Frame::Text(text)))) => self.obey(text.as_str()).await?,
                Event::Asked(Some(Ok(Frame::Binary(_)))) => {
                    self.refuse("commands are text").await?;
                }
                Event::Asked(Some(Ok(Frame::Ping(_) | Frame::Pong(_)))) => {}
                Event::Asked(Some(Err(_))) => return Err(Over(Some(close_code::PROTOCOL))),
                Event::Asked(None | Some(Ok(Frame::Close(_)))) => return Err(Over(None)),
                Event::List => {
                    let list = self.source.sessions();
                    self.say(&Notice::Sessions { list: &list }).await?;
                }
                Event::Moment(moment) => self.show(moment).await?,
                Event::Picture(painting) => self.show_picture(painting).await?,
            }
        }
    }

    async fn obey(&mut self, text: &str) -> Result<(), Over> {
        match message::parse(text) {
            Ok(Command::Watch { session, env, pace }) => {
                self.watching = None;
                self.encoder.forget();
                let channel = FrameChannel::new(pace);
                if let Err(why) = self.source.watch(session, env, &channel) {
                    return self.refuse(&why).await;
                }
                if !self.paused {
                    channel.ask();
                }
                let picture = Picture::NotBefore(Instant::now());
                self.watching = Some(Watching { session, env, channel, picture });
            }
            Ok(Command::Leave) => self.watching = None,
            Ok(Command::More) => self.ask(),
            Ok(Command::Pause(paused)) => {
                self.paused = paused;
                self.ask();
            }
            Ok(Command::Drive(_)) if !self.may_drive => {
                return self.refuse("only a viewer at a loopback address lets pages drive").await;
            }
            Ok(Command::Drive(wish)) => {
                self.has_driven = true;
                if let Err(why) = self.source.drive(self.number, &wish) {
                    return self.refuse(&why).await;
                }
            }
            Ok(Command::LetGo) => self.let_go(),
            Err(why) => return self.refuse(&why).await,
        }
        Ok(())
    }

    fn let_go(&mut self) {
        if std::mem::take(&mut self.has_driven) {
            self.source.let_go(self.number);
        }
    }

    /// Asks for the next moment or episode.
    fn ask(&self) {
        if let Some(watching) = self.watching.as_ref().filter(|_| !self.paused) {
            watching.channel.ask();
        }
    }

    /// Sends a moment, and asks for the next one only when that is out.
    async fn show(&mut self, moment: Option<Moment>) -> Result<(), Over> {
        let Some(watching) = &mut self.watching else { return Ok(()) };
        let Some(moment) = moment else {
            let session = watching.session;
            self.watching = None;
            return self.say(&Notice::Gone { session }).await;
        };
        let (messages, scene) = self.encoder.tell(watching.session, watching.env, moment);
        let pace = watching.channel.pace();
        let is_due = matches!(watching.picture, Picture::NotBefore(due) if due <= Instant::now());
        if is_due && scene.endoscope.is_some() {
            watching.picture = Picture::Ordered(Instant::now(), self.camera.order(scene));
        }
        for message in messages {
            self.send(match message {
                Message::Text(text) => Frame::Text(text.into()),
                Message::Bytes(bytes) => Frame::Binary(bytes.into()),
            })
            .await?;
        }
        // Episodes are asked for by the page, which plays them.
        if pace == Pace::Live {
            self.ask();
        }
        Ok(())
    }

    async fn show_picture(&mut self, painting: Option<Painting>) -> Result<(), Over> {
        let Some(watching) = &mut self.watching else { return Ok(()) };
        if let Picture::Ordered(since, _) = watching.picture {
            let cost = painting.as_ref().map_or(Duration::ZERO, |painting| painting.cost);
            watching.picture = Picture::NotBefore(since + (SHARE * cost).max(PICTURE));
        }
        let (session, env) = (watching.session, watching.env);
        match painting {
            Some(painting) => {
                let picture = message::picture(session, env, &painting.png);
                self.send(Frame::Binary(picture.into())).await
            }
            None => Ok(()),
        }
    }

    async fn refuse(&mut self, why: &str) -> Result<(), Over> {
        self.say(&Notice::Error { message: why }).await
    }

    async fn say(&mut self, notice: &Notice<'_>) -> Result<(), Over> {
        self.send(Frame::Text(notice.text().into())).await
    }

    async fn send(&mut self, frame: Frame) -> Result<(), Over> {
        match timeout(PATIENCE, self.socket.send(frame)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) | Err(_) => Err(Over(None)),
        }
    }
}

/// The next thing that is to be shown.
async fn next(watching: &mut Option<Watching>) -> Event {
    let Some(Watching { channel, picture, .. }) = watching else {
        return std::future::pending().await;
    };
    let Picture::Ordered(_, answer) = picture else { return Event::Moment(channel.next().await) };
    tokio::select! {
        moment = channel.next() => Event::Moment(moment),
        painting = answer => Event::Picture(painting.ok()),
    }
}
