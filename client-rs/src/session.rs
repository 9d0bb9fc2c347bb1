//! A session: N environments of one task, stepped by one message.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use trocar_proto::control::{ControlCalls, SessionInfo, SessionRequest};
use trocar_proto::wire::{
    Header, MAX_IN_FLIGHT, PictureLayout, ReplyLayout, RequestLayout, flag, kind,
};
use trocar_proto::{Code, Placement, Rejection, TaskSpec, part};

use crate::client::Client;
use crate::error::CallError;
use crate::reply::{EnvIds, Reply};
use crate::snapshot::{Dropped, Snapshot};
use crate::transport::{DataPort, Owned, Pending, SLICE, refusal};

/// How many groups of environments a session remembers.
const GROUPS: usize = 8;

/// N environments of one task, which live in the server until this is dropped.
#[derive(Debug)]
pub struct Session {
    in_flight: VecDeque<InFlight>,
    port: Owned<DataPort>,
    info: Arc<SessionInfo>,
    request_layout: RequestLayout,
    reply_layout: Arc<ReplyLayout>,
    picture_layout: Option<Arc<PictureLayout>>,
    pub(crate) want_expert: bool,
    /// What it was opened with, and where.
    pub(crate) request: SessionRequest,
    pub(crate) client: Client,
    /// The states to go on from should the server be lost.
    pub(crate) checkpoint: Option<Vec<u8>>,
    /// The groups of environments that were asked for last: asked for again, they cost no memory.
    groups: VecDeque<Arc<[u32]>>,
    /// Numbers of snapshots that the client has dropped and that the server still keeps.
    dropped: Dropped,
    requests: u64,
    /// A request was not answered, and none will be.
    ended: bool,
}

/// A request that was not answered yet. Declared order is drop order.
#[derive(Debug)]
struct InFlight {
    pending: Owned<Pending>,
    kind: u32,
    env_ids: EnvIds,
    /// Environments that it changes or reads.
    touched: EnvIds,
    /// No caller waits for the reply any more; it is received and dropped.
    abandoned: bool,
}

impl Session {
    pub(crate) fn new(
        client: Client,
        request: SessionRequest,
        info: SessionInfo,
    ) -> Result<Self, CallError> {
        let envs = info.envs as usize;
        let request_layout = RequestLayout::new(envs, &info.spec);
        let reply_layout = Arc::new(ReplyLayout::new(envs, &info.spec));
        let picture_layout = info.view.as_ref().map(|view| Arc::new(PictureLayout::new(view)));
        let link = Arc::clone(client.link());
        let port = DataPort::open(link, &info, request_layout.bytes).inspect_err(|_| {
            let (session, node) = (info.session, client.link().node_id());
            client.link().close_session(session, node).ok();
        })?;
        let port = Owned::new(port);
        let info = Arc::new(info);
        let in_flight = VecDeque::with_capacity(MAX_IN_FLIGHT);
        Ok(Self {
            in_flight,
            port,
            info,
            request_layout,
            reply_layout,
            picture_layout,
            want_expert: false,
            request,
            client,
            checkpoint: None,
            groups: VecDeque::with_capacity(GROUPS),
            dropped: Dropped::default(),
            requests: 0,
            ended: false,
        })
    }

    /// The session, as the server opened it.
    pub fn info(&self) -> &SessionInfo {
        &self.info
    }

    /// The task under the session's options.
    pub fn spec(&self) -> &TaskSpec {
        &self.info.spec
    }

    /// Number of environments.
    pub fn envs(&self) -> usize {
        self.info.envs as usize
    }

    /// Whether replies shall carry the scripted expert's action for the state they return.
    pub fn want_expert(&mut self, wanted: bool) {
        self.want_expert = wanted;
    }

    /// Resets every environment to the next episode of its seed (the first one, at first).
    pub fn reset(&mut self) -> Result<Reply, CallError> {
        self.start_reset(None, None)?;
        self.recv()
    }

    /// Resets the environments `env_ids` (strictly increasing), to the first episode of
    /// `seeds[i]` where seeds are given, else to the next episode of their seed.
    pub fn reset_envs(
        &mut self,
        env_ids: &[u32],
        seeds: Option<&[u64]>,
    ) -> Result<Reply, CallError> {
        self.start_reset(Some(env_ids), seeds)?;
        self.recv()
    }

    /// Lets the episodes of the environments `env_ids` (strictly increasing; all if `None`), in which no step was
    /// taken, begin as placements ask for: the i-th as `placements[i]`, or all as the only one. The reply shows
    /// where they are. What one of them refuses is done in none.
    pub fn arrange(
        &mut self,
        env_ids: Option<&[u32]>,
        placements: &[Placement],
    ) -> Result<Reply, CallError> {
        self.start_arrange(env_ids, placements)?;
        self.recv()
    }

    /// Steps every environment; `actions` is (envs, action dim), row by row.
    pub fn step(&mut self, actions: &[f32]) -> Result<Reply, CallError> {
        self.start_step(None, actions)?;
        self.recv()
    }

    /// Starts a step of the environments `env_ids` (strictly increasing); `actions` is
    /// (env_ids.len(), action dim). Up to two disjoint groups may be under way; replies come in
    /// the order of the sends.
    pub fn send(&mut self, env_ids: &[u32], actions: &[f32]) -> Result<(), CallError> {
        self.start_step(Some(env_ids), actions)
    }

    /// Waits for the reply to the oldest request in flight.
    pub fn recv(&mut self) -> Result<Reply, CallError> {
        loop {
            if let Some(reply) = self.poll(SLICE)? {
                return Ok(reply);
            }
        }
    }

    /// Starts a reset of the environments `env_ids` (all if `None`); [`Self::recv`] or
    /// [`Self::poll`] gives the reply.
    pub fn start_reset(
        &mut self,
        env_ids: Option<&[u32]>,
        seeds: Option<&[u64]>,
    ) -> Result<(), CallError> {
        if let Some(seeds) = seeds {
            return self.start_reset_to(env_ids, seeds, &vec![0; seeds.len()]);
        }
        let env_ids = self.check_env_ids(env_ids)?;
        self.start(kind::RESET, 0, env_ids.clone(), env_ids, |_, _| {})
    }

    /// Starts a reset of the environments `env_ids` (all if `None`), the i-th to the episode
    /// `episodes[i]` of `seeds[i]`.
    pub fn start_reset_to(
        &mut self,
        env_ids: Option<&[u32]>,
        seeds: &[u64],
        episodes: &[u64],
    ) -> Result<(), CallError> {
        let env_ids = self.check_env_ids(env_ids)?;
        check_length("seeds", seeds.len(), env_ids.len(), Code::InvalidEnvIds)?;
        check_length("episodes", episodes.len(), env_ids.len(), Code::InvalidEnvIds)?;
        let RequestLayout { numbers, episodes: region, .. } = self.request_layout;
        let flags = flag::HAS_SEEDS;
        self.start(kind::RESET, flags, env_ids.clone(), env_ids, |payload, rows| {
            numbers.view_mut::<u64>(payload, rows).copy_from_slice(seeds);
            region.view_mut::<u64>(payload, rows).copy_from_slice(episodes);
        })
    }

    /// Starts a step of the environments `env_ids` (all if `None`).
    pub fn start_step(
        &mut self,
        env_ids: Option<&[u32]>,
        actions: &[f32],
    ) -> Result<(), CallError> {
        let env_ids = self.check_env_ids(env_ids)?;
        let expected = env_ids.len() * self.spec().action_dim();
        check_length("actions", actions.len(), expected, Code::InvalidAction)?;
        let region = self.request_layout.actions;
        self.start(kind::STEP, 0, env_ids.clone(), env_ids, |payload, rows| {
            region.view_mut::<f32>(payload, rows).copy_from_slice(actions);
        })
    }

    /// Saves the state of every environment. It stays in the server, counted against its memory
    /// budget, until the snapshot is dropped or the session ends.
    pub fn snapshot(&mut self) -> Result<Snapshot, CallError> {
        self.start_snapshot(None)?;
        self.recv_snapshot()
    }

    /// Saves the state of the environments `env_ids` (strictly increasing).
    pub fn snapshot_envs(&mut self, env_ids: &[u32]) -> Result<Snapshot, CallError> {
        self.start_snapshot(Some(env_ids))?;
        self.recv_snapshot()
    }

    /// Lets every environment go on from a snapshot of as many, or of one. The reply shows where
    /// they are.
    pub fn restore(&mut self, snapshot: &Snapshot) -> Result<Reply, CallError> {
        self.start_restore(None, snapshot)?;
        self.recv()
    }

    /// Lets the environments `env_ids` (strictly increasing) go on from a snapshot: the i-th from
    /// the i-th of its states, or all from its only one.
    pub fn restore_envs(
        &mut self,
        env_ids: &[u32],
        snapshot: &Snapshot,
    ) -> Result<Reply, CallError> {
        self.start_restore(Some(env_ids), snapshot)?;
        self.recv()
    }

    /// Lets the environments `env_ids` (strictly increasing) go on from the present states of
    /// others: the i-th from environment `sources[i]`, or all from the only source. Sources may
    /// repeat, and be among `env_ids`: what counts is their state before.
    pub fn fork(&mut self, sources: &[u32], env_ids: &[u32]) -> Result<Reply, CallError> {
        self.start_fork(sources, Some(env_ids))?;
        self.recv()
    }

    /// A snapshot as bytes: a few hundred for each environment, good for [`Self::import`] anywhere.
    pub fn export(&mut self, snapshot: &Snapshot) -> Result<Vec<u8>, CallError> {
        let (session, link) = (self.info.session, self.port.get()?.link());
        let (numbers, node) = (snapshot.numbers_for(&self.info, snapshot.len())?, link.node_id());
        let mut bytes = vec![];
        for snapshot in numbers {
            bytes.extend(link.export_snapshot(session, node, snapshot)?);
        }
        Ok(bytes)
    }

    /// Brings a snapshot that was exported by a session of the same task and options, by the same
    /// release, into this one. Its states are rebuilt when they are first restored, which takes as
    /// long as their episodes took up to there.
    pub fn import(&mut self, bytes: &[u8]) -> Result<Snapshot, CallError> {
        let (session, link) = (self.info.session, self.port.get()?.link());
        let (parts, node) = (part::split(bytes)?, link.node_id());
        let mut imported = Snapshot::new(&self.info, &[], &self.dropped);
        for part in parts {
            let number = link.import_snapshot(session, node, part.to_vec())?;
            imported.push(&Snapshot::new(&self.info, &[number], &self.dropped));
        }
        Ok(imported)
    }

    /// Starts an arrangement of the environments `env_ids` (all if `None`), as [`Self::arrange`] does. It first
    /// brings the placements to the server, and waits for that.
    pub fn start_arrange(
        &mut self,
        env_ids: Option<&[u32]>,
        placements: &[Placement],
    ) -> Result<(), CallError> {
        let env_ids = self.check_env_ids(env_ids)?;
        let rows = env_ids.len();
        if placements.len() != 1 {
            check_length("placements", placements.len(), rows, Code::InvalidOption)?;
        }
        placements.iter().try_for_each(Placement::check)?;
        self.forget_dropped()?;
        let (session, link) = (self.info.session, self.port.get()?.link());
        let node = link.node_id();
        // They are dropped with this, and the server told so once the request was answered.
        let mut imported = Snapshot::new(&self.info, &[], &self.dropped);
        for placement in placements {
            let number = link.import_placement(session, node, placement.clone())?;
            imported.push(&Snapshot::new(&self.info, &[number], &self.dropped));
        }
        let numbers = imported.numbers_for(&self.info, rows)?;
        let region = self.request_layout.numbers;
        self.start(kind::ARRANGE, 0, env_ids.clone(), env_ids, |payload, rows| {
            region.view_mut::<u64>(payload, rows).copy_from_slice(&numbers);
        })
    }

    /// Starts a snapshot of the environments `env_ids` (all if `None`); the reply has it.
    pub fn start_snapshot(&mut self, env_ids: Option<&[u32]>) -> Result<(), CallError> {
        let env_ids = self.check_env_ids(env_ids)?;
        self.forget_dropped()?;
        self.start(kind::SNAPSHOT, 0, env_ids.clone(), env_ids, |_, _| {})
    }

    /// Starts a restore of the environments `env_ids` (all if `None`).
    pub fn start_restore(
        &mut self,
        env_ids: Option<&[u32]>,
        snapshot: &Snapshot,
    ) -> Result<(), CallError> {
        let env_ids = self.check_env_ids(env_ids)?;
        let numbers = snapshot.numbers_for(&self.info, env_ids.len())?;
        let region = self.request_layout.numbers;
        self.start(kind::RESTORE, 0, env_ids.clone(), env_ids, |payload, rows| {
            region.view_mut::<u64>(payload, rows).copy_from_slice(&numbers);
        })
    }

    /// Starts a fork into the environments `env_ids` (all if `None`).
    pub fn start_fork(
        &mut self,
        sources: &[u32],
        env_ids: Option<&[u32]>,
    ) -> Result<(), CallError> {
        let env_ids = self.check_env_ids(env_ids)?;
        let (rows, envs) = (env_ids.len(), self.info.envs);
        let refuse = |value: String, allowed: String| {
            CallError::from(Rejection::new(Code::InvalidEnvIds, "source", value, allowed))
        };
        if sources.len() != rows && sources.len() != 1 {
            let found = format!("{} numbers", sources.len());
            return Err(refuse(found, format!("expected 1, or {rows} as there are env_ids")));
        }
        if let Some(number) = sources.iter().find(|number| **number >= envs) {
            return Err(refuse(number.to_string(), format!("allowed are numbers below {envs}")));
        }
        let touched = env_ids.and(sources);
        let region = self.request_layout.numbers;
        self.start(kind::FORK, 0, env_ids, touched, |payload, rows| {
            let numbers = region.view_mut::<u64>(payload, rows);
            for (number, source) in numbers.iter_mut().zip(sources.iter().cycle()) {
                *number = u64::from(*source);
            }
        })
    }

    /// Draws environment `env_id` as the view shows it with which the session was opened
    /// ([`SessionRequest::view`]): colours, [`Reply::picture_rgb`], or `depth`, [`Reply::picture_depth`].
    pub fn render(&mut self, env_id: u32, depth: bool) -> Result<Reply, CallError> {
        self.start_render(env_id, depth)?;
        self.recv()
    }

    /// Starts a picture of environment `env_id`.
    pub fn start_render(&mut self, env_id: u32, depth: bool) -> Result<(), CallError> {
        let env_ids = self.check_env_ids(Some(&[env_id]))?;
        let flags = if depth { flag::DEPTH } else { 0 };
        self.start(kind::RENDER, flags, env_ids.clone(), env_ids, |_, _| {})
    }

    fn recv_snapshot(&mut self) -> Result<Snapshot, CallError> {
        let missing = || CallError::Malformed("the reply is to another request".into());
        self.recv()?.into_snapshot().ok_or_else(missing)
    }

    /// Tells the server which snapshots the client has dropped. Where requests are in flight, some
    /// of these may be about them: then later.
    fn forget_dropped(&mut self) -> Result<(), CallError> {
        /// As many numbers as surely fit into a message.
        const AT_A_TIME: usize = 4096;
        if !self.in_flight.is_empty() {
            return Ok(());
        }
        let link = self.port.get()?.link();
        let (session, node) = (self.info.session, link.node_id());
        for numbers in self.dropped.take().chunks(AT_A_TIME) {
            link.drop_snapshots(session, node, numbers.to_vec())?;
        }
        Ok(())
    }

    /// Waits at most `patience` for the reply to the oldest request in flight.
    pub fn poll(&mut self, patience: Duration) -> Result<Option<Reply>, CallError> {
        let port = self.port.get_mut()?;
        let Some(oldest) = self.in_flight.front_mut() else {
            return Err(CallError::NothingInFlight);
        };
        let raw = match port.receive(&mut oldest.pending, patience) {
            Ok(Some(raw)) => raw,
            Ok(None) => return Ok(None),
            // It is still to be had, once others were dropped, or the server goes on.
            Err(error @ (CallError::TooManyHeld | CallError::Timeout { .. })) => return Err(error),
            Err(error) => {
                self.in_flight.clear();
                self.ended = true;
                return Err(error);
            }
        };
        let InFlight { pending, kind, env_ids, .. } =
            self.in_flight.pop_front().expect("the oldest is there");
        drop(pending);
        if raw.user_header().status != 0 {
            return Err(refusal(&raw));
        }
        let expected = match (kind, &self.picture_layout) {
            (kind::RENDER, Some(layout)) => layout.bytes,
            _ => self.reply_layout.bytes,
        };
        if raw.payload().len() < expected {
            return Err(CallError::Malformed("the payload is too short".into()));
        }
        let taken = (kind == kind::SNAPSHOT).then(|| {
            let numbers = self.reply_layout.snapshot.view(raw.payload(), env_ids.len());
            Snapshot::new(&self.info, numbers, &self.dropped)
        });
        Ok(Some(Reply {
            raw: Owned::new(raw),
            taken,
            env_ids,
            info: Arc::clone(&self.info),
            layout: Arc::clone(&self.reply_layout),
            picture: self.picture_layout.clone().filter(|_| kind == kind::RENDER),
            _link: Arc::clone(port.link()),
        }))
    }

    /// Sends any header and payload as a request of this session and waits for the reply, for
    /// tests of the server's defences.
    #[doc(hidden)]
    pub fn call_raw(
        &mut self,
        header: Header,
        fill: impl FnOnce(&mut [u8]),
    ) -> Result<Reply, CallError> {
        let pending = Owned::new(self.port.get_mut()?.send(header, fill)?);
        let env_ids = EnvIds::All(header.rows.min(self.info.envs));
        let kind = header.kind;
        let touched = env_ids.clone();
        let request = InFlight { pending, kind, env_ids, touched, abandoned: false };
        self.in_flight.push_back(request);
        self.recv()
    }

    /// Number of requests in flight whose replies were not given up on.
    pub fn in_flight(&self) -> usize {
        self.in_flight.iter().filter(|request| !request.abandoned).count()
    }

    /// Gives up on the replies of all requests in flight (after an interrupted wait). They are
    /// still carried out; [`Self::settle`], or the next request, waits for that.
    pub fn abandon(&mut self) {
        for request in &mut self.in_flight {
            request.abandoned = true;
        }
    }

    /// Waits at most `patience` for the replies that were given up on; whether none is left.
    pub fn settle(&mut self, patience: Duration) -> Result<bool, CallError> {
        while self.in_flight.front().is_some_and(|request| request.abandoned) {
            match self.poll(patience) {
                Ok(Some(_)) | Err(CallError::Refused(_)) => {}
                Ok(None) => return Ok(false),
                Err(error) => return Err(error),
            }
        }
        Ok(true)
    }

    fn start(
        &mut self,
        kind: u32,
        flags: u32,
        env_ids: EnvIds,
        touched: EnvIds,
        fill: impl FnOnce(&mut [u8], usize),
    ) -> Result<(), CallError> {
        while !self.settle(SLICE)? {}
        let port = self.port.get_mut()?;
        // Where the server takes no requests any more, sending them would come to wait for ever.
        if self.ended {
            return Err(port.why_unanswered());
        }
        if self.in_flight.len() == MAX_IN_FLIGHT {
            return Err(CallError::TooManyInFlight);
        }
        let busy = self.in_flight.iter().find_map(|other| other.touched.common(&touched));
        if let Some(busy) = busy {
            return Err(Rejection::new(
                Code::InvalidEnvIds,
                "env_ids",
                busy,
                "this environment is under way; receive its reply first",
            )
            .into());
        }
        self.requests += 1;
        let rows = env_ids.len();
        let header = Header {
            flags: flags | if self.want_expert { flag::WANT_EXPERT } else { 0 },
            request: self.requests,
            session: self.info.session,
            epoch: self.info.epoch,
            rows: rows as u32,
            ..Header::new(kind)
        };
        let region = self.request_layout.env_ids;
        let pending = port.send(header, |payload| {
            let ids = region.view_mut::<u32>(payload, rows);
            match &env_ids {
                EnvIds::All(count) => ids.iter_mut().zip(0..*count).for_each(|(id, i)| *id = i),
                EnvIds::Some(chosen) => ids.copy_from_slice(chosen),
            }
            fill(payload, rows);
        })?;
        let pending = Owned::new(pending);
        let request = InFlight { pending, kind, env_ids, touched, abandoned: false };
        self.in_flight.push_back(request);
        Ok(())
    }

    fn check_env_ids(&mut self, env_ids: Option<&[u32]>) -> Result<EnvIds, CallError> {
        let Some(ids) = env_ids else { return Ok(EnvIds::All(self.info.envs)) };
        if let Some(known) = self.groups.iter().find(|known| ***known == *ids) {
            return Ok(EnvIds::Some(Arc::clone(known)));
        }
        let increasing = ids.windows(2).all(|pair| pair[0] < pair[1]);
        let in_range = ids.last().is_some_and(|last| *last < self.info.envs);
        if increasing && in_range {
            let group: Arc<[u32]> = ids.into();
            self.groups.truncate(GROUPS - 1);
            self.groups.push_front(Arc::clone(&group));
            return Ok(EnvIds::Some(group));
        }
        Err(Rejection::new(
            Code::InvalidEnvIds,
            "env_ids",
            format!("{ids:?}"),
            format!("allowed are one or more increasing numbers below {}", self.info.envs),
        )
        .into())
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if let Ok(port) = self.port.get() {
            let (session, node) = (self.info.session, port.link().node_id());
            // Where the server is gone, so is the session.
            port.link().close_session(session, node).ok();
        }
    }
}

fn check_length(field: &str, found: usize, expected: usize, code: Code) -> Result<(), CallError> {
    if found == expected {
        return Ok(());
    }
    let found = format!("{found} numbers");
    Err(Rejection::new(code, field, found, format!("expected {expected}")).into())
}
