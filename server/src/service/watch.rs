//! Sessions as the viewer sees them. A page subscribes to a session with a channel. The session owns the
//! environments: after each message it looks for channels, and sends what is wanted.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use trocar_proto::wire::{ReplyLayout, kind};

use super::handle::Shared;
use crate::env::Env;
use crate::view::source::{About, FrameChannel, Mark, Moment, Pace, SessionCard, Source, Wish};

/// Least time between two moments of the present.
const PERIOD: Duration = Duration::from_millis(33);

/// A session shows its present for one part in so many of its time, at most.
const SHARE: u32 = 100;

/// Most steps that are kept until the next moment; of more, only the latest are.
const MOST_MARKS: usize = 1024;

/// The sessions of a server, for its viewer.
pub(super) struct WatchRegistry {
    about: About,
    /// What pages must know that drive arms.
    token: String,
    sessions: Mutex<BTreeMap<u64, Arc<Shared>>>,
}

impl WatchRegistry {
    /// No sessions yet. Pages that drive arms must know `token`.
    pub(super) fn new(about: About, token: String) -> Self {
        Self { about, token, sessions: Mutex::default() }
    }

    /// What pages must know that drive arms.
    pub(super) fn token(&self) -> &str {
        &self.token
    }

    /// Shows a session until the guard is dropped.
    pub(super) fn register(self: &Arc<Self>, id: u64, session: Arc<Shared>) -> Registration {
        self.lock().insert(id, session);
        Registration { watch: Arc::clone(self), id }
    }

    /// The open session of this number.
    pub(super) fn session(&self, id: u64) -> Option<Arc<Shared>> {
        self.lock().get(&id).cloned()
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<u64, Arc<Shared>>> {
        // Entries are put in and taken out as one, panic or not.
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Source for WatchRegistry {
    fn about(&self) -> About {
        self.about.clone()
    }

    fn sessions(&self) -> Vec<SessionCard> {
        let sessions: Vec<_> = self.lock().values().cloned().collect();
        sessions.iter().map(|session| session.card()).collect()
    }

    fn watch(&self, session: u64, env: u32, channel: &Arc<FrameChannel>) -> Result<(), String> {
        let sessions = self.lock();
        let found = sessions.get(&session);
        let found = found.ok_or_else(|| format!("there is no session {session}"))?;
        if env >= found.envs() {
            let last = found.envs() - 1;
            return Err(format!("session {session} has no environment {env}; the last is {last}"));
        }
        found.subscriptions().open(env, channel);
        Ok(())
    }

    fn drive(&self, page: u64, wish: &Wish) -> Result<(), String> {
        if !is_same(wish.token.as_bytes(), self.token.as_bytes()) {
            return Err(
                "this page may not drive: open it by the address that `trocar drive` prints".into(),
            );
        }
        let session = self.session(wish.session);
        let world = session.as_ref().and_then(|session| session.world.get());
        let no_world = || format!("session {} has no live world", wish.session);
        let driven = world.ok_or_else(no_world)?.drive(page, &wish.arm, &wish.motion);
        driven.map_err(|refusal| refusal.to_string())
    }

    fn let_go(&self, page: u64) {
        let sessions: Vec<_> = self.lock().values().cloned().collect();
        for world in sessions.iter().filter_map(|session| session.world.get()) {
            world.let_go(page);
        }
    }
}

/// Whether two texts are the same and not empty, in a time that does not say where they differ.
fn is_same(one: &[u8], other: &[u8]) -> bool {
    let differences = one.iter().zip(other).fold(0, |sum, (one, other)| sum | (one ^ other));
    !one.is_empty() && one.len() == other.len() && differences == 0
}

/// A session that can be watched. When it ends, its channels are closed.
pub(super) struct Registration {
    watch: Arc<WatchRegistry>,
    id: u64,
}

impl Drop for Registration {
    fn drop(&mut self) {
        // In this order, so that no page opens a channel that stays open.
        let session = self.watch.lock().remove(&self.id);
        if let Some(session) = session {
            session.subscriptions().close();
        }
    }
}

/// The channels through which a session is watched.
#[derive(Debug, Default)]
pub(super) struct Subscriptions {
    /// Whether there is any. All that a session without channels looks at.
    watched: AtomicBool,
    all: Mutex<Vec<Subscription>>,
}

/// A channel, and how far it has come.
#[derive(Debug)]
#[expect(clippy::struct_excessive_bools, reason = "they are independent of each other")]
struct Subscription {
    env: u32,
    channel: Arc<FrameChannel>,
    /// What has happened since the moment before.
    marks: Vec<Mark>,
    /// Nothing was shown yet.
    is_new: bool,
    /// The environment is not as it was shown.
    has_changed: bool,
    /// An episode began, or a state was restored, with the latest message.
    has_begun: bool,
    /// An episode ended with it.
    has_ended: bool,
    /// An episode is being shown step by step.
    follows: bool,
    /// Time that was spent on it since it was due.
    spent: Duration,
    /// Nothing more is shown before.
    due: Instant,
}

impl Subscriptions {
    /// Whether a page watches.
    pub(super) fn is_watched(&self) -> bool {
        self.watched.load(Ordering::Relaxed)
    }

    fn open(&self, env: u32, channel: &Arc<FrameChannel>) {
        let mut subscriptions = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        subscriptions.push(Subscription {
            env,
            channel: Arc::clone(channel),
            marks: vec![],
            is_new: true,
            has_changed: true,
            has_begun: false,
            has_ended: false,
            follows: false,
            spent: Duration::ZERO,
            due: Instant::now(),
        });
        self.watched.store(true, Ordering::Relaxed);
    }

    fn close(&self) {
        let mut subscriptions = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        subscriptions.drain(..).for_each(|subscription| subscription.channel.close());
    }

    /// The channels, unless another thread has them just now: a session does not wait for its pages.
    fn try_lock(&self) -> Option<MutexGuard<'_, Vec<Subscription>>> {
        match self.all.try_lock() {
            Ok(subscriptions) => Some(subscriptions),
            Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Takes down what a message that was carried out did to the environments that are watched; `env_ids`
    /// are those of its rows.
    pub(super) fn note(&self, kind: u32, env_ids: &[u32], layout: &ReplyLayout, reply: &[u8]) {
        if kind == kind::SNAPSHOT {
            return;
        }
        let (Some(mut subscriptions), rows) = (self.try_lock(), env_ids.len()) else { return };
        for subscription in &mut *subscriptions {
            let Ok(row) = env_ids.binary_search(&subscription.env) else { continue };
            let flag = |flags: &[u8]| flags[row] != 0;
            let ended = flag(layout.terminated.view(reply, rows))
                || flag(layout.truncated.view(reply, rows));
            let steps = layout.steps.view::<u32>(reply, rows)[row];
            if subscription.marks.len() == MOST_MARKS {
                subscription.marks.remove(0);
            }
            subscription.marks.push(Mark {
                // Where autoreset replaced the episode that ended, the row is of the next one.
                is_step: kind == kind::STEP && (steps > 0 || ended),
                reward: layout.reward.view::<f32>(reply, rows)[row],
                ended,
                is_success: flag(layout.is_success.view(reply, rows)),
            });
            (subscription.has_changed, subscription.has_ended) = (true, ended);
            subscription.has_begun = kind != kind::STEP || steps == 0;
        }
    }

    /// Takes note that the environments are not as they were shown, without a message that said so.
    pub(super) fn note_change(&self) {
        let Some(mut subscriptions) = self.try_lock() else { return };
        subscriptions.iter_mut().for_each(|subscription| subscription.has_changed = true);
    }

    /// Puts into the channels what is wanted and due.
    pub(super) fn show<'a>(&self, env_of: impl Fn(u32) -> &'a Env) {
        let Some(mut subscriptions) = self.try_lock() else { return };
        subscriptions.retain(|subscription| !subscription.channel.is_closed());
        if subscriptions.is_empty() {
            self.watched.store(false, Ordering::Relaxed);
        }
        let share = SHARE * subscriptions.len() as u32;
        for subscription in &mut *subscriptions {
            let env = env_of(subscription.env);
            if subscription.has_changed && env.was_reset() {
                subscription.has_changed = false;
                match subscription.channel.pace() {
                    Pace::Live => subscription.show_present(env, share),
                    Pace::Episodes => subscription.show_episode(env, share),
                }
                subscription.is_new = false;
            }
        }
    }
}

impl Subscription {
    fn show_present(&mut self, env: &Env, share: u32) {
        if !self.channel.is_wanted() || Instant::now() < self.due {
            self.has_changed = true;
            return;
        }
        // Before it is there: a page that takes it asks for the next one at once.
        self.channel.fulfil();
        if self.put(env) {
            self.rest(share);
        } else {
            self.channel.ask();
            self.has_changed = true;
        }
    }

    /// Goes on with an episode, or begins one. What is watched anew is shown at once.
    fn show_episode(&mut self, env: &Env, share: u32) {
        let is_due = || self.channel.is_wanted() && Instant::now() >= self.due;
        let begins = !self.follows && self.has_begun && is_due();
        if begins {
            let keep = self.marks.len().saturating_sub(1);
            self.marks.drain(..keep);
            self.follows = true;
            self.channel.fulfil();
        }
        if !self.follows && !self.is_new {
            self.marks.clear();
            return;
        }
        if !self.put(env) && self.follows {
            self.follows = false;
            self.channel.ask();
        }
        // Autoreset may replace an episode by the next one with its last step.
        if self.follows && (self.has_ended || self.has_begun) && !begins {
            self.follows = false;
            self.rest(share);
        }
    }

    /// Puts the environment as it is into the channel; false where that could not be.
    fn put(&mut self, env: &Env) -> bool {
        let start = Instant::now();
        let moment = Moment::of(env, std::mem::take(&mut self.marks));
        let is_put = self.channel.put(moment);
        self.spent += start.elapsed();
        is_put
    }

    /// Pauses for so many times as long as what was wanted took.
    fn rest(&mut self, share: u32) {
        self.due = Instant::now() + (share * std::mem::take(&mut self.spent)).max(PERIOD);
    }
}

#[cfg(test)]
mod tests {
    use trocar_proto::control::{Autoreset, SessionRequest};

    use super::super::observer::{LiveRecording, StepObserver};
    use super::*;
    use crate::registry::Registry;
    use crate::service::batch::{Batch, BatchCommand};
    use crate::service::rows::Rows;
    use crate::service::scheduler::tests::TestScheduler;
    use crate::service::scheduler::{Entity, ThreadQuota};

    /// A session's environments, which are watched.
    struct Stage {
        batch: Batch,
        layout: ReplyLayout,
        reply: Vec<u64>,
        test: TestScheduler,
        subscriptions: Subscriptions,
    }

    impl Stage {
        fn new(autoreset: Autoreset) -> Self {
            let request = SessionRequest::new("EcmReach-v0").envs(3).autoreset(autoreset);
            let batch = Batch::new(&Registry::builtin(), &request).unwrap();
            let layout = ReplyLayout::new(3, batch.spec());
            let reply = vec![0; layout.bytes / 8];
            let test = TestScheduler::new("watch", 1);
            Self { batch, layout, reply, test, subscriptions: Subscriptions::default() }
        }

        fn apply(&mut self, kind: u32, command: BatchCommand<'_>, env_ids: &[u32]) {
            let reply = bytemuck::cast_slice_mut(&mut self.reply);
            let rows = Rows::of(&self.layout, reply, env_ids.len());
            let observer = StepObserver { failures: None, recording: &LiveRecording::default() };
            let Self { batch, test, .. } = self;
            let entity = Entity::new(&ThreadQuota::new(1));
            test.compute(&entity, |quantum| {
                batch.apply(command, env_ids, false, observer, rows, quantum)
            })
            .unwrap();
            self.subscriptions.note(kind, env_ids, &self.layout, bytemuck::cast_slice(&self.reply));
            self.subscriptions.show(|env| self.batch.env(env));
        }

        fn reset(&mut self) {
            self.apply(kind::RESET, BatchCommand::Reset(None), &[0, 1, 2]);
        }

        fn step(&mut self, env_ids: &[u32]) {
            self.apply(kind::STEP, BatchCommand::Step(&vec![0.5; 3 * env_ids.len()]), env_ids);
        }
    }

    fn taken(channel: &FrameChannel) -> Vec<Moment> {
        channel.close();
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            let mut moments = vec![];
            while let Some(moment) = channel.next().await {
                moments.push(moment);
            }
            moments
        })
    }

    #[test]
    fn one_moment_is_shown_for_each_that_is_wanted_and_no_step_is_missed() {
        let mut stage = Stage::new(Autoreset::NextStep);
        let channel = FrameChannel::new(Pace::Live);
        stage.subscriptions.open(1, &channel);
        stage.subscriptions.show(|env| stage.batch.env(env)); // never reset: nothing to see
        channel.ask();
        stage.reset();
        for _ in 0..7 {
            stage.step(&[0, 1, 2]);
        }
        stage.step(&[0, 2]);
        std::thread::sleep(PERIOD);
        stage.subscriptions.show(|env| stage.batch.env(env)); // not wanted yet
        channel.ask();
        // However long it takes until this one is due.
        while channel.is_wanted() {
            stage.subscriptions.show(|env| stage.batch.env(env));
        }
        let moments = taken(&channel);
        assert_eq!(moments.iter().map(|each| each.steps).collect::<Vec<_>>(), [0, 7]);
        let [first, second] = [0, 1].map(|index| &moments[index].marks);
        assert!(first.len() == 1 && !first[0].is_step);
        assert!(second.len() == 7 && second.iter().all(|mark| mark.is_step && !mark.ended));
        assert_eq!((moments[0].seed, moments[0].episode), (1, 0));
        // A channel that was closed is forgotten, and then no page watches.
        assert!(stage.subscriptions.is_watched());
        stage.step(&[0, 1, 2]);
        assert!(!stage.subscriptions.is_watched());
    }

    #[test]
    fn an_episode_is_shown_from_its_beginning_to_its_end() {
        for autoreset in [Autoreset::NextStep, Autoreset::SameStep] {
            let mut stage = Stage::new(autoreset);
            stage.reset();
            stage.step(&[0, 1, 2]);
            let channel = FrameChannel::new(Pace::Episodes);
            stage.subscriptions.open(2, &channel);
            channel.ask();
            // The present at once, then the next whole episode, then nothing that is not wanted.
            for _ in 0..160 {
                stage.step(&[0, 1, 2]);
            }
            assert!(!channel.is_wanted());
            let moments = taken(&channel);
            let mut expected = vec![2];
            expected.extend(0..50);
            expected.push(if autoreset == Autoreset::NextStep { 50 } else { 0 });
            let steps: Vec<_> = moments.iter().map(|each| each.steps).collect();
            assert_eq!(steps, expected, "{autoreset:?}");
            assert!(moments.iter().skip(1).take(50).all(|each| each.episode == 1));
            assert!(moments.iter().all(|each| each.marks.len() == 1));
            let ends = moments.iter().filter(|each| each.marks[0].ended).count();
            assert!(ends == 1 + usize::from(autoreset == Autoreset::SameStep) || ends == 1);
            assert!(moments.last().unwrap().marks[0].ended);
        }
    }

    #[test]
    fn a_session_does_not_wait_for_who_is_at_its_windows() {
        let mut stage = Stage::new(Autoreset::NextStep);
        let channel = FrameChannel::new(Pace::Live);
        stage.subscriptions.open(0, &channel);
        channel.ask();
        let subscriptions = std::mem::take(&mut stage.subscriptions);
        let busy = subscriptions.all.lock().unwrap();
        subscriptions.note(kind::STEP, &[0], &stage.layout, bytemuck::cast_slice(&stage.reply));
        subscriptions.show(|env| stage.batch.env(env));
        drop(busy);
        assert!(channel.is_wanted() && taken(&channel).is_empty());
    }

    #[test]
    fn a_session_that_ends_closes_its_windows() {
        let subscriptions = Subscriptions::default();
        let channel = FrameChannel::new(Pace::Live);
        subscriptions.open(0, &channel);
        subscriptions.close();
        assert!(channel.is_closed());
    }
}
