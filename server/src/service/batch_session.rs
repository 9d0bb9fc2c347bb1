//! A session of environments that are reset and stepped by its client's messages.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use trocar_proto::control::{Autoreset, SessionRequest};
use trocar_proto::wire::{Header, PictureLayout, ReplyLayout, RequestLayout, flag, kind};
use trocar_proto::{Code, Rejection};

use super::batch::{self, Batch, BatchCommand};
use super::handle::Shared;
use super::meter::TaskMeter;
use super::observer::StepObserver;
use super::rows::Rows;
use super::scheduler::Quantum;
use super::session::{Description, ServerContext, SessionKind};
use super::store::{self, Saved};
use crate::env::{Env, Imaging, Rebuild};

/// The environments of a session, and what reads its requests.
pub(super) struct BatchSession {
    context: Arc<ServerContext>,
    shared: Arc<Shared>,
    meter: TaskMeter,
    batch: Batch,
    /// Whether the step after an episode's end resets instead of stepping.
    next_step: bool,
    request_layout: RequestLayout,
    reply_layout: ReplyLayout,
    /// How its environments are drawn when that is asked for.
    view: Option<(Imaging, PictureLayout)>,
    inbox: Inbox,
}

/// A request's arrays, copied out of shared memory before anything looks at them, since their
/// client could still change them.
#[derive(Debug, Default)]
struct Inbox {
    env_ids: Vec<u32>,
    actions: Vec<f32>,
    numbers: Vec<u64>,
    episodes: Vec<u64>,
}

impl BatchSession {
    /// The environments that a request asks for.
    pub(super) fn new(
        context: &Arc<ServerContext>,
        shared: &Arc<Shared>,
        wanted: &SessionRequest,
    ) -> Result<Self, Rejection> {
        let batch = Batch::new(&context.registry, wanted)?;
        let spec = batch.spec();
        let (envs, action_dim) = (wanted.envs as usize, spec.action_dim());
        let view = view_of(context, wanted)?;
        Ok(Self {
            meter: context.meter.task(&shared.task),
            next_step: wanted.autoreset == Autoreset::NextStep,
            request_layout: RequestLayout::new(envs, spec),
            reply_layout: ReplyLayout::new(envs, spec),
            inbox: Inbox {
                env_ids: vec![0; envs],
                actions: vec![0.0; envs * action_dim],
                numbers: vec![0; envs],
                episodes: vec![0; envs],
            },
            batch,
            view,
            context: Arc::clone(context),
            shared: Arc::clone(shared),
        })
    }

    /// Counts what a request has done; returns how many steps environments took.
    fn count(&self, asked: &Header, reply: &[u8], time: Duration) -> u64 {
        let rows = asked.rows as usize;
        if !matches!(asked.kind, kind::STEP | kind::RESET) {
            return 0;
        }
        let steps: &[u32] = self.reply_layout.steps.view(reply, rows);
        let faults: &[u8] = self.reply_layout.fault.view(reply, rows);
        let begun = steps.iter().filter(|steps| **steps == 0).count() as u64;
        let failed = faults.iter().filter(|fault| **fault != 0).count() as u64;
        self.meter.resets.inc_by(begun);
        self.meter.failures.inc_by(failed);
        if asked.kind == kind::RESET {
            return 0;
        }
        self.tally(reply, rows);
        let steps = rows as u64 - if self.next_step { begun } else { 0 };
        self.meter.steps.inc_by(steps);
        self.meter.stepped(time);
        steps
    }

    /// Counts the episodes that ended with a step.
    fn tally(&self, reply: &[u8], rows: usize) {
        let layout = &self.reply_layout;
        let terminated: &[u8] = layout.terminated.view(reply, rows);
        let truncated: &[u8] = layout.truncated.view(reply, rows);
        let is_success: &[u8] = layout.is_success.view(reply, rows);
        let any = |flags: &[u8]| flags.iter().fold(0, |any, flag| any | flag) != 0;
        if any(terminated) || any(truncated) {
            let mut pace = self.shared.pace.lock().unwrap_or_else(PoisonError::into_inner);
            for row in (0..rows).filter(|row| terminated[*row] | truncated[*row] != 0) {
                pace.tally.ended(is_success[row] != 0);
            }
        }
    }

    /// Does what is asked.
    fn obey(
        &mut self,
        asked: &Header,
        payload: &[u8],
        reply: &mut [u8],
        quantum: &mut Quantum<'_>,
    ) -> Result<(), Rejection> {
        let malformed = |field: &str, value: u64, allowed: String| {
            Rejection::new(Code::Malformed, field, value, allowed)
        };
        let rows = asked.rows as usize;
        if !(1..=self.shared.envs as usize).contains(&rows) {
            let allowed = format!("allowed is 1 to {}", self.shared.envs);
            return Err(malformed("header.rows", rows as u64, allowed));
        }
        if payload.len() < self.request_layout.bytes {
            let allowed = format!("expected {} bytes", self.request_layout.bytes);
            return Err(malformed("payload", payload.len() as u64, allowed));
        }
        let Inbox { env_ids, actions, numbers, episodes } = &mut self.inbox;
        let layout = &self.request_layout;
        let seeded = asked.kind == kind::RESET && asked.flags & flag::HAS_SEEDS != 0;
        if seeded {
            episodes[..rows].copy_from_slice(layout.episodes.view(payload, rows));
        }
        if seeded || asked.kind > kind::STEP {
            numbers[..rows].copy_from_slice(layout.numbers.view(payload, rows));
        }
        let numbers = &numbers[..rows];
        env_ids[..rows].copy_from_slice(layout.env_ids.view(payload, rows));
        let env_ids = &env_ids[..rows];
        if asked.kind == kind::RENDER {
            let Some((imaging, layout)) = &self.view else {
                return Err(no_view());
            };
            return if asked.flags & flag::DEPTH == 0 {
                let rgb = layout.rgb.view_mut(reply, 1);
                self.batch.draw(env_ids, imaging, rgb, &mut [], quantum)
            } else {
                let depth = layout.depth.view_mut(reply, 1);
                self.batch.draw(env_ids, imaging, &mut [], depth, quantum)
            };
        }
        let mut out = Rows::of(&self.reply_layout, reply, rows);
        let states;
        let command = match asked.kind {
            kind::STEP => {
                let sent: &[f32] = layout.actions.view(payload, rows);
                actions[..sent.len()].copy_from_slice(sent);
                BatchCommand::Step(&actions[..sent.len()])
            }
            kind::RESET => BatchCommand::Reset(seeded.then_some((numbers, &episodes[..rows]))),
            kind::SNAPSHOT => {
                let mut room = self.shared.with_store(|store| store.make_room(rows))?;
                let copies = self.batch.copies(env_ids, quantum)?;
                self.shared.with_store(|store| {
                    for (row, copy) in copies.into_iter().enumerate() {
                        out.snapshot.row(row)[0] = store.put(&mut room, Saved::State(copy));
                    }
                    Ok(())
                })?;
                return Ok(());
            }
            kind::RESTORE => {
                states = saved(&self.shared, &self.batch, numbers, quantum)?;
                BatchCommand::Restore(&states)
            }
            kind::ARRANGE => {
                let placements = self.shared.with_store(|store| {
                    numbers.iter().map(|number| store.placement(*number)).collect::<Result<_, _>>()
                })?;
                states = self.batch.arranged(env_ids, placements, quantum)?;
                BatchCommand::Restore(&states)
            }
            kind::FORK => {
                states = self.batch.sources(numbers, quantum)?;
                BatchCommand::Restore(&states)
            }
            other => {
                let (first, last) = (kind::RESET, kind::ARRANGE);
                let allowed = format!("allowed are {first} (reset) to {last} (arrange)");
                return Err(malformed("header.kind", other.into(), allowed));
            }
        };
        let want_expert = asked.flags & flag::WANT_EXPERT != 0;
        let failures = self.context.failures.as_ref();
        let observer = StepObserver { failures, recording: &self.shared.recording };
        self.batch.apply(command, env_ids, want_expert, observer, out, quantum)
    }
}

impl SessionKind for BatchSession {
    fn describe(&self) -> Description {
        Description {
            spec: (**self.batch.spec()).clone(),
            view: self.view.as_ref().map(|(imaging, _)| Box::new(imaging.spec().clone())),
            live: None,
        }
    }

    fn like(&self) -> Arc<Env> {
        Arc::new(self.batch.like().clone())
    }

    fn reply_bytes(&self, kind: u32) -> usize {
        match &self.view {
            Some((_, layout)) if kind == kind::RENDER => layout.bytes,
            _ => self.reply_layout.bytes,
        }
    }

    fn carry_out(
        &mut self,
        asked: &Header,
        payload: &[u8],
        reply: &mut [u8],
        start: Instant,
        quantum: &mut Quantum<'_>,
    ) -> Result<u64, Rejection> {
        self.obey(asked, payload, reply, quantum)?;
        if self.shared.subscriptions.is_watched() && asked.kind != kind::RENDER {
            let env_ids = &self.inbox.env_ids[..asked.rows as usize];
            self.shared.subscriptions.note(asked.kind, env_ids, &self.reply_layout, reply);
        }
        Ok(self.count(asked, reply, start.elapsed()))
    }

    fn show(&mut self) {
        self.shared.subscriptions.show(|env| self.batch.env(env));
    }

    fn learn(&mut self, time: Duration) {
        self.batch.learn(time);
    }
}

/// How a session's environments are drawn, where it asks for that.
pub(super) fn view_of(
    context: &ServerContext,
    wanted: &SessionRequest,
) -> Result<Option<(Imaging, PictureLayout)>, Rejection> {
    let Some(view) = &wanted.view else { return Ok(None) };
    let imaging = context.registry.view(&wanted.task, &wanted.options, view)?;
    let layout = PictureLayout::new(imaging.spec());
    Ok(Some((imaging, layout)))
}

/// The refusal of a picture.
pub(super) fn no_view() -> Rejection {
    let why = "the session was opened without a view; open it with one";
    Rejection::new(Code::Unsupported, "render", "no view", why)
}

/// The states that a session keeps under these numbers; imported ones are rebuilt first.
fn saved(
    shared: &Shared,
    batch: &Batch,
    numbers: &[u64],
    quantum: &mut Quantum<'_>,
) -> Result<Vec<Arc<Env>>, Rejection> {
    let found: Vec<Saved> =
        shared.with_store(|store| numbers.iter().map(|number| store.get(*number)).collect())?;
    let mut recipes = BTreeMap::new();
    for (number, saved) in numbers.iter().zip(&found) {
        match saved {
            Saved::State(_) => {}
            Saved::Recipe(recipe) => {
                recipes.insert(*number, Arc::clone(recipe));
            }
            Saved::Placement(_) | Saved::World(_) => return Err(store::no_state(*number)),
        }
    }
    let rebuilds = recipes.values().map(|recipe| Rebuild::new(batch.like(), (**recipe).clone()));
    let go_on = || !shared.stop.load(Ordering::Acquire);
    let Some(rebuilt) = batch::rebuild(rebuilds.collect(), quantum, go_on) else {
        return Err(shared.being_closed());
    };
    let mut states = BTreeMap::new();
    for (number, env) in recipes.into_keys().zip(rebuilt) {
        states.insert(number, Arc::new(env?));
    }
    shared.with_store(|store| {
        for (number, state) in &states {
            store.replace(*number, state);
        }
        Ok(())
    })?;
    let state = |(number, saved): (&u64, Saved)| match saved {
        Saved::State(env) => env,
        _ => Arc::clone(&states[number]),
    };
    Ok(numbers.iter().zip(found).map(state).collect())
}
