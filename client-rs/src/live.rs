//! A live world: its arms answer the commands of dVRK scripts.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_proto::control::{ControlCalls, SessionInfo};
use trocar_proto::dvrk::record::{
    AnswerRecord, CommandRecord, EventRecord, Question, QuestionRecord,
};
use trocar_proto::dvrk::{ArmRecord, Command, Event, LiveInfo, TICKS_PER_SECOND, WorldRecord};
use trocar_proto::part::MAX_PART;
use trocar_proto::wire::{
    Header, LiveReplyLayout, LiveRequestLayout, MAX_COMMANDS, MAX_TICKS, PictureLayout, flag, kind,
};
use trocar_proto::{Code, Rejection, TaskSpec};

use crate::client::Client;
use crate::error::CallError;
use crate::snapshot::{Dropped, Snapshot};
use crate::transport::{DataPort, Owned, Pending, RawReply, SLICE, refusal};

/// Shortest and longest pause between two looks at a world that has a pace of its own.
const PAUSES: [Duration; 2] = [Duration::from_micros(500), Duration::from_millis(20)];

/// A world in the server whose arms this client commands, until this is dropped.
///
/// In lock-step, time passes by [`Self::advance`] only, so the same commands give the same bits. Where the world has a
/// pace of its own ([`LiveRequest::speed`](trocar_proto::dvrk::LiveRequest::speed)), `advance` waits until so many
/// ticks have passed.
///
/// ```no_run
/// use trocar_client::proto::dvrk::{Command, LiveRequest, StateCommand};
/// use trocar_client::{Client, SessionRequest};
///
/// let request = SessionRequest::new("NeedlePick-v0").live(LiveRequest::default());
/// let mut world = Client::connect("lab")?.open_live(&request)?;
/// for word in [StateCommand::Enable, StateCommand::Home] {
///     world.command("PSM1", &Command::State(word))?;
/// }
/// world.advance(480)?; // two seconds
/// world.command("PSM1", &Command::MoveJp(vec![0.2, 0.0, 0.12, 0.0, 0.0, 0.0]))?;
/// world.advance(240)?;
/// println!("{:?}", world.arm("PSM1")?.measured_position);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct LiveWorld {
    /// The request that was not answered yet. Dropped first.
    pending: Option<Owned<Pending>>,
    port: Owned<DataPort>,
    info: Arc<SessionInfo>,
    live: LiveInfo,
    client: Client,
    request_layout: LiveRequestLayout,
    reply_layout: LiveReplyLayout,
    queued: Vec<CommandRecord>,
    /// What is still to be waited for.
    wait: Wait,
    seen: Seen,
    events: VecDeque<Event>,
    /// Numbers of snapshots that were dropped and that the server still keeps.
    dropped: Dropped,
    requests: u64,
    /// A request was not answered, and none will be.
    ended: bool,
}

/// What is waited for.
#[derive(Debug, Default)]
struct Wait {
    /// Ticks that are still to pass, in lock-step.
    left: u32,
    /// Ticks at which it ends, at a world's own pace.
    until: u64,
    until_event: bool,
    /// Ticks that have passed.
    passed: u32,
    /// When to look again.
    pause: Option<Instant>,
}

/// A world as its latest reply showed it.
#[derive(Debug, Clone, Default)]
struct Seen {
    world: WorldRecord,
    arms: Vec<ArmRecord>,
    objects: Vec<[f64; 7]>,
    observation: Vec<f32>,
    achieved_goal: Vec<f32>,
    desired_goal: Vec<f32>,
}

impl LiveWorld {
    pub(crate) fn new(client: Client, info: SessionInfo) -> Result<Self, CallError> {
        let malformed = || CallError::Malformed("the session has no live world".into());
        let live = *info.live.clone().ok_or_else(malformed)?;
        let (request_layout, reply_layout) =
            (LiveRequestLayout::new(), LiveReplyLayout::new(&live, &info.spec));
        let link = Arc::clone(client.link());
        let port = DataPort::open(link, &info, request_layout.bytes).inspect_err(|_| {
            let (session, node) = (info.session, client.link().node_id());
            client.link().close_session(session, node).ok();
        })?;
        let mut world = Self {
            pending: None,
            port: Owned::new(port),
            info: Arc::new(info),
            live,
            client,
            request_layout,
            reply_layout,
            queued: Vec::with_capacity(MAX_COMMANDS),
            wait: Wait::default(),
            seen: Seen::default(),
            events: VecDeque::new(),
            dropped: Dropped::default(),
            requests: 0,
            ended: false,
        };
        world.look()?;
        Ok(world)
    }

    /// The session, as the server opened it.
    pub fn info(&self) -> &SessionInfo {
        &self.info
    }

    /// The world's arms, objects and pace.
    pub fn live(&self) -> &LiveInfo {
        &self.live
    }

    /// The task under the session's options.
    pub fn spec(&self) -> &TaskSpec {
        &self.info.spec
    }

    /// Gives a command to an arm, with the next [`Self::advance`] or [`Self::look`]. What an arm does not do as it is
    /// told, an event says.
    pub fn command(&mut self, arm: &str, command: &Command) -> Result<(), CallError> {
        let record = CommandRecord::new(self.live.arm(arm)?, command)?;
        if self.queued.len() == MAX_COMMANDS {
            self.look()?;
        }
        self.queued.push(record);
        Ok(())
    }

    /// Gives the commands, and lets so many ticks of 1/240 s pass. Returns how many did.
    pub fn advance(&mut self, ticks: u32) -> Result<u32, CallError> {
        self.start(ticks, false)?;
        self.recv()
    }

    /// As [`Self::advance`], and stops after a tick in which an arm told something.
    pub fn advance_until_event(&mut self, most: u32) -> Result<u32, CallError> {
        self.start(most, true)?;
        self.recv()
    }

    /// Gives the commands and looks at the world; time stands still meanwhile, unless it has a pace of its own.
    pub fn look(&mut self) -> Result<(), CallError> {
        self.advance(0).map(|_| ())
    }

    /// Starts [`Self::advance`]; [`Self::poll`] ends it.
    pub fn start(&mut self, ticks: u32, until_event: bool) -> Result<(), CallError> {
        while self.pending.is_some() {
            self.poll(SLICE)?;
        }
        let until = self.seen.world.ticks + u64::from(ticks);
        let left = if self.live.speed.is_none() { ticks } else { 0 };
        self.wait = Wait { left, until, until_event, ..Wait::default() };
        self.send()
    }

    /// Waits at most `patience` for the end of what was started: how many ticks passed.
    pub fn poll(&mut self, patience: Duration) -> Result<Option<u32>, CallError> {
        let deadline = Instant::now() + patience;
        loop {
            if let Some(due) = self.wait.pause {
                let now = Instant::now();
                std::thread::sleep(due.min(deadline).saturating_duration_since(now));
                if due > deadline {
                    return Ok(None);
                }
                self.wait.pause = None;
                self.send()?;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            let Some(raw) = self.receive(left)? else { return Ok(None) };
            let before = self.seen.world.ticks;
            let news = self.read(&raw)?;
            drop(raw);
            let world = self.seen.world;
            let is_paced = self.live.speed.is_some();
            let ticks = if is_paced { (world.ticks - before) as u32 } else { world.passed };
            self.wait.passed += ticks;
            let stops = self.wait.until_event && news && (is_paced || world.passed > 0);
            if stops {
                (self.wait.left, self.wait.until) = (0, world.ticks);
            }
            if world.has_more != 0 || self.wait.left > 0 {
                self.send()?;
            } else if is_paced && world.ticks < self.wait.until {
                let seconds = (self.wait.until - world.ticks) as f64 / TICKS_PER_SECOND as f64;
                let pause = Duration::from_secs_f64(seconds / self.live.speed.unwrap_or(1.0));
                // Of an event, a script is to hear soon.
                let longest = if self.wait.until_event { 2 * PAUSES[0] } else { PAUSES[1] };
                self.wait.pause = Some(Instant::now() + pause.clamp(PAUSES[0], longest));
            } else {
                return Ok(Some(self.wait.passed));
            }
        }
    }

    /// Asks about the kinematics of an arm: numbers, or why there are none.
    pub fn ask(
        &mut self,
        arm: &str,
        question: Question,
        groups: [&[f64]; 2],
    ) -> Result<Result<Vec<f64>, String>, CallError> {
        let question = QuestionRecord::new(self.live.arm(arm)?, question, groups)?;
        self.settle()?;
        let region = self.request_layout.question;
        let raw = self.call(kind::ASK, |payload| region.view_mut(payload, 1)[0] = question)?;
        let answer = &self.reply_layout.answer.view::<AnswerRecord>(raw.payload(), 1)[0];
        Ok(answer.read().map(<[f64]>::to_vec))
    }

    /// Keeps the state of the world in the server, with what its arms are about, until the snapshot is dropped or the
    /// session ends.
    pub fn snapshot(&mut self) -> Result<Snapshot, CallError> {
        self.settle()?;
        let numbers = self.dropped.take();
        if !numbers.is_empty() {
            let node = self.client.link().node_id();
            self.client.link().drop_snapshots(self.info.session, node, numbers)?;
        }
        let raw = self.call(kind::SNAPSHOT, |_| ())?;
        let number = self.reply_layout.snapshot.view::<u64>(raw.payload(), 1)[0];
        Ok(Snapshot::new(&self.info, &[number], &self.dropped))
    }

    /// Brings the world back to a state that was kept. Ticks and stamps go on from where they are, and every arm tells
    /// its operating state. Refused while another client drives an arm.
    pub fn restore(&mut self, snapshot: &Snapshot) -> Result<(), CallError> {
        let number = snapshot.numbers_for(&self.info, 1)?[0];
        self.settle()?;
        let region = self.request_layout.snapshot;
        let raw = self.call(kind::RESTORE, |payload| region.view_mut(payload, 1)[0] = number)?;
        self.read(&raw)?;
        Ok(())
    }

    /// Begins the first episode of a seed. Ticks and stamps go on from where they are, and every arm tells its operating
    /// state. Refused while another client drives an arm; a page of the viewer that took the arms over lets go.
    pub fn reset(&mut self, seed: u64) -> Result<(), CallError> {
        self.settle()?;
        let region = self.request_layout.seed;
        let raw = self.call(kind::RESET, |payload| region.view_mut(payload, 1)[0] = seed)?;
        self.read(&raw)?;
        Ok(())
    }

    /// What led to the present state of the world, from its beginning on: a file for `trocar replay`.
    pub fn recording(&mut self) -> Result<Vec<u8>, CallError> {
        self.settle()?;
        self.client.record(self.info.session, 0, 1)?;
        let mut recording = vec![];
        loop {
            let (parts, _) = self.client.recorded(self.info.session)?;
            // Others may go on commanding: a message that is not nearly full had all that there was.
            let is_all = parts.len() < MAX_PART / 2;
            recording.extend(parts);
            if is_all {
                return Ok(recording);
            }
        }
    }

    /// Gives the commands that are queued, and waits for what was started.
    fn settle(&mut self) -> Result<(), CallError> {
        if self.queued.is_empty() && self.pending.is_none() { Ok(()) } else { self.look() }
    }

    /// Sends a request and waits for its reply.
    fn call(&mut self, kind: u32, fill: impl FnOnce(&mut [u8])) -> Result<RawReply, CallError> {
        self.send_as(kind, 0, 0, fill)?;
        loop {
            if let Some(raw) = self.receive(SLICE)? {
                self.check(&raw)?;
                return Ok(raw);
            }
        }
    }

    /// Draws the world as it is now, as the view shows it with which the session was opened
    /// ([`SessionRequest::view`](crate::SessionRequest::view)): red, green, blue of every pixel, (views, height, width, 3).
    pub fn render(&mut self) -> Result<Vec<u8>, CallError> {
        self.picture(0, |layout, payload| layout.rgb.view::<u8>(payload, 1).to_vec())
    }

    /// As [`Self::render`], the depth of every pixel along the optical axis, m: (views, height, width).
    pub fn render_depth(&mut self) -> Result<Vec<f32>, CallError> {
        self.picture(flag::DEPTH, |layout, payload| layout.depth.view::<f32>(payload, 1).to_vec())
    }

    fn picture<T>(
        &mut self,
        flags: u32,
        read: impl Fn(&PictureLayout, &[u8]) -> T,
    ) -> Result<T, CallError> {
        self.settle()?;
        self.send_as(kind::RENDER, flags, 0, |_| ())?;
        loop {
            let Some(raw) = self.receive(SLICE)? else { continue };
            if raw.user_header().status != 0 {
                return Err(refusal(&raw));
            }
            let layout = self.info.view.as_ref().map(|view| PictureLayout::new(view));
            let layout = layout.filter(|layout| layout.bytes <= raw.payload().len());
            let malformed = || CallError::Malformed("the payload is no picture".into());
            return Ok(read(&layout.ok_or_else(malformed)?, raw.payload()));
        }
    }

    /// An arm as it was in the latest reply.
    pub fn arm(&self, name: &str) -> Result<&ArmRecord, CallError> {
        Ok(&self.seen.arms[self.live.arm(name)? as usize])
    }

    /// The next of the events that arms have told up to the latest reply, oldest first.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Ticks, reward and success as of the latest reply.
    pub fn world(&self) -> &WorldRecord {
        &self.seen.world
    }

    /// Where an object is in the world: x, y, z, m; x, y, z, w of a unit quaternion.
    pub fn object(&self, name: &str) -> Result<&[f64; 7], CallError> {
        let place = self.live.objects.iter().position(|known| known == name);
        let known = || format!("this world has {}", self.live.objects.join(", "));
        let refuse = || Rejection::new(Code::InvalidOption, "object", format!("{name:?}"), known());
        Ok(&self.seen.objects[place.ok_or_else(refuse)?])
    }

    /// The task's observation.
    pub fn observation(&self) -> &[f32] {
        &self.seen.observation
    }

    /// The achieved goal.
    pub fn achieved_goal(&self) -> &[f32] {
        &self.seen.achieved_goal
    }

    /// The desired goal.
    pub fn desired_goal(&self) -> &[f32] {
        &self.seen.desired_goal
    }

    /// Sends any header and payload as a request of this session and waits for the reply, for tests of the server's
    /// defences.
    #[doc(hidden)]
    pub fn call_raw(
        &mut self,
        header: Header,
        fill: impl FnOnce(&mut [u8]),
    ) -> Result<(), CallError> {
        self.pending = Some(Owned::new(self.port.get_mut()?.send(header, fill)?));
        loop {
            if let Some(raw) = self.receive(SLICE)? {
                return self.check(&raw);
            }
        }
    }

    /// Waits for the end of what was started.
    fn recv(&mut self) -> Result<u32, CallError> {
        loop {
            if let Some(passed) = self.poll(SLICE)? {
                return Ok(passed);
            }
        }
    }

    /// Sends what is queued and the next ticks.
    fn send(&mut self) -> Result<(), CallError> {
        let ticks = self.wait.left.min(MAX_TICKS);
        self.wait.left -= ticks;
        let flags = if self.wait.until_event { flag::UNTIL_EVENT } else { 0 };
        let LiveRequestLayout { ticks: region, commands, .. } = self.request_layout;
        let queued = std::mem::take(&mut self.queued);
        let sent = self.send_as(kind::LIVE, flags, queued.len(), |payload| {
            region.view_mut(payload, 1)[0] = ticks;
            commands.view_mut(payload, 1)[..queued.len()].copy_from_slice(&queued);
        });
        // Its room is used again.
        self.queued = queued;
        self.queued.clear();
        sent
    }

    fn send_as(
        &mut self,
        kind: u32,
        flags: u32,
        rows: usize,
        fill: impl FnOnce(&mut [u8]),
    ) -> Result<(), CallError> {
        let port = self.port.get_mut()?;
        // Where the server takes no requests any more, sending them would come to wait for ever.
        if self.ended {
            return Err(port.why_unanswered());
        }
        self.requests += 1;
        let header = Header {
            flags,
            request: self.requests,
            session: self.info.session,
            epoch: self.info.epoch,
            rows: rows as u32,
            ..Header::new(kind)
        };
        self.pending = Some(Owned::new(port.send(header, fill)?));
        Ok(())
    }

    fn receive(&mut self, patience: Duration) -> Result<Option<RawReply>, CallError> {
        let Some(pending) = &mut self.pending else { return Err(CallError::NothingInFlight) };
        match self.port.get_mut()?.receive(pending, patience) {
            Ok(None) => Ok(None),
            Ok(raw) => {
                self.pending = None;
                Ok(raw)
            }
            // It is still to be had once the server goes on.
            Err(error @ CallError::Timeout { .. }) => Err(error),
            Err(error) => {
                self.pending = None;
                self.ended = true;
                Err(error)
            }
        }
    }

    fn check(&self, raw: &RawReply) -> Result<(), CallError> {
        if raw.user_header().status != 0 {
            return Err(refusal(raw));
        }
        if raw.payload().len() < self.reply_layout.bytes {
            return Err(CallError::Malformed("the payload is too short".into()));
        }
        Ok(())
    }

    /// Copies a reply; whether it has events.
    fn read(&mut self, raw: &RawReply) -> Result<bool, CallError> {
        self.check(raw)?;
        let (layout, payload, seen) = (&self.reply_layout, raw.payload(), &mut self.seen);
        let copy = |room: &mut Vec<f32>, numbers: &[f32]| {
            room.clear();
            room.extend_from_slice(numbers);
        };
        seen.world = layout.world.view(payload, 1)[0];
        seen.arms.clear();
        seen.arms.extend_from_slice(layout.arms.view(payload, 1));
        seen.objects.clear();
        let objects = layout.objects.view::<f64>(payload, 1).as_chunks::<7>().0;
        seen.objects.extend_from_slice(objects);
        copy(&mut seen.observation, layout.observation.view(payload, 1));
        copy(&mut seen.achieved_goal, layout.achieved_goal.view(payload, 1));
        copy(&mut seen.desired_goal, layout.desired_goal.view(payload, 1));
        let records = layout.events.view::<EventRecord>(payload, 1);
        let count = (seen.world.events as usize).min(records.len());
        self.events.extend(records[..count].iter().filter_map(EventRecord::event));
        Ok(count > 0)
    }
}

impl Drop for LiveWorld {
    fn drop(&mut self) {
        if let Ok(port) = self.port.get() {
            let (session, node) = (self.info.session, port.link().node_id());
            // Where the server is gone, so is the session.
            self.client.link().close_session(session, node).ok();
        }
    }
}
