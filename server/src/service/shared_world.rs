//! A live world of one or several sessions: its time, what its arms told, and which session drives which arm.
//!
//! - The session that makes a world owns it: the world ends with that session. Others may share it.
//! - The first session that commands an arm drives it. Commands of other sessions to that arm are refused by name.
//! - A page of the viewer takes arms over from a session that lets it, and from no other.
//! - A session that ends, however that is, frees its arms, which then hold.
//! - In lock-step, time passes by the ticks that any of its sessions asks for. Else it passes at the world's pace. Time
//!   for which the server had no processor is left out: the world is then late, and never hurries.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use trocar_proto::control::SessionRequest;
use trocar_proto::dvrk::record::{
    AnswerRecord, CommandRecord, EventRecord, Question, QuestionRecord, WorldRecord,
};
use trocar_proto::dvrk::recording::Beginning;
use trocar_proto::dvrk::{
    ArmInfo, Command, LiveInfo, LiveRequest, PoseMessage, StateCommand, TICKS_PER_SECOND,
};
use trocar_proto::wire::{LiveReplyLayout, MAX_EVENTS};
use trocar_proto::{Code, Rejection};

use super::driver::Driver;
use super::real_time::RealTime;
use super::store::Ledger;
use crate::dvrk::{ArmController, Pose};
use crate::env::{Env, LiveWorld};
use crate::recording::live::LiveLog;
use crate::registry::Registry;
use crate::view::source::Motion;

mod recording;
mod state;

use state::{MOST_EVENTS, WorldState};
pub(super) use state::{Passed, SavedWorld};

/// A live world, and what its sessions have of it.
pub(super) struct SharedWorld {
    /// What it was made with.
    request: SessionRequest,
    info: LiveInfo,
    state: Mutex<WorldState>,
    /// Where the memory of its recording is counted.
    ledger: Arc<Ledger>,
}

impl SharedWorld {
    /// The world that a session asks for.
    pub(super) fn new(
        registry: &Registry,
        ledger: &Arc<Ledger>,
        request: &SessionRequest,
        live: LiveRequest,
    ) -> Result<Self, Rejection> {
        let env = registry.make(&request.task, &request.options)?;
        let SavedWorld { world, log } = begun(env, request, request.seed)?;
        let arms = world.arms().map(|arm| arm_info(&world, arm)).collect();
        let objects = world.objects().map(|(name, _)| name.to_string()).collect();
        let info = LiveInfo { arms, objects, speed: live.speed };
        let real_time = live.speed.map(RealTime::new);
        let state = WorldState {
            drivers: info.arms.iter().map(|_| None).collect(),
            events: VecDeque::with_capacity(MOST_EVENTS),
            told: 0,
            ticks: 0,
            real_time,
            seen: {
                let spec = world.env().spec();
                let goal = vec![0.0; spec.goal_dim()];
                [vec![0.0; spec.observation_dim()], goal.clone(), goal]
            },
            over: None,
            log,
            paid: 0,
            fetched: None,
            world,
        };
        let (state, ledger) = (Mutex::new(state), Arc::clone(ledger));
        Ok(Self { request: request.clone(), info, state, ledger })
    }

    /// The world as its clients see it.
    pub(super) fn info(&self) -> &LiveInfo {
        &self.info
    }

    /// How long a tick takes at its pace, where it has one.
    pub(super) fn period(&self) -> Option<Duration> {
        self.info
            .speed
            .map(|speed| Duration::from_secs_f64(1.0 / (TICKS_PER_SECOND as f64 * speed)))
    }

    /// Whether a session that wants this may share it.
    pub(super) fn check_shared(&self, wanted: &SessionRequest) -> Result<(), Rejection> {
        let refuse = |field: &str, value: String, is: String| {
            let allowed = format!("the world that is to be shared has {is}");
            Err(Rejection::new(Code::InvalidOption, field, value, allowed))
        };
        let own = &self.request;
        let speed = wanted.live.and_then(|live| live.speed);
        if wanted.task != own.task {
            refuse("task", wanted.task.clone(), own.task.clone())
        } else if wanted.options != own.options {
            refuse("options", format!("{:?}", wanted.options.0), format!("{:?}", own.options.0))
        } else if speed != self.info.speed {
            refuse("live.speed", format!("{speed:?}"), format!("{:?}", self.info.speed))
        } else {
            Ok(())
        }
    }

    /// Does something with the environment as it is.
    pub(super) fn with_env<T>(&self, act: impl FnOnce(&Env) -> T) -> T {
        act(self.lock().world.env())
    }

    /// Gives commands, all of them or none.
    pub(super) fn command(
        &self,
        driver: Driver,
        records: &[CommandRecord],
    ) -> Result<(), Rejection> {
        let mut commands =
            ArrayVec::<(usize, Command), { trocar_proto::wire::MAX_COMMANDS }>::new();
        for record in records {
            commands.push((self.place(record.arm)?, record.command()?));
        }
        let mut state = self.lock();
        if let Some(over) = &state.over {
            return Err(over.clone());
        }
        for (place, _) in &commands {
            let other = state.drivers[*place].filter(|other| *other != driver);
            if let Some(other) = other.filter(|other| !driver.takes_over(*other)) {
                return Err(other.refusal(&self.info.arms[*place].name));
            }
        }
        for ((place, command), record) in commands.iter().zip(records) {
            state.drivers[*place] = Some(driver);
            state.give(*place, command, record);
        }
        self.pay(&mut state);
        state.listen();
        Ok(())
    }

    /// The state of the world, to come back to.
    pub(super) fn save(&self) -> Result<SavedWorld, Rejection> {
        let mut state = self.lock();
        let WorldState { world, log, over, .. } = &mut *state;
        if let Some(over) = over {
            return Err(over.clone());
        }
        log.close(world);
        let saved = SavedWorld { world: world.clone(), log: log.clone() };
        self.pay(&mut state);
        Ok(saved)
    }

    /// Brings the world back to a state that was kept. Time goes on from where it is.
    pub(super) fn restore(&self, driver: Driver, saved: &SavedWorld) -> Result<(), Rejection> {
        let mut state = self.lock();
        self.check_alone(&state, driver, |_| false)?;
        state.go_on_from(saved.clone());
        Ok(())
    }

    /// Begins the first episode of a seed. Time goes on from where it is; a page that took the arms over lets go.
    pub(super) fn reset(&self, driver: Driver, seed: u64) -> Result<(), Rejection> {
        let mut state = self.lock();
        self.check_alone(&state, driver, |other| other.takes_over(driver))?;
        let env = state.world.clone().into_env();
        state.go_on_from(begun(env, &self.request, seed)?);
        for place in &mut state.drivers {
            place.take_if(|other| other.takes_over(driver));
        }
        Ok(())
    }

    /// Whether a driver may bring the world into another state: no other drives an arm, but for those that may.
    fn check_alone(
        &self,
        state: &WorldState,
        driver: Driver,
        may: impl Fn(Driver) -> bool,
    ) -> Result<(), Rejection> {
        if let Some(over) = state.over.as_ref().filter(|over| over.code == Code::UnknownSession) {
            return Err(over.clone());
        }
        let others = state.drivers.iter().zip(&self.info.arms);
        let mut others = others.filter_map(|(other, arm)| Some((other.as_ref()?, &arm.name)));
        match others.find(|(other, _)| **other != driver && !may(**other)) {
            Some((other, name)) => Err(other.refusal(name)),
            None => Ok(()),
        }
    }

    /// Lets up to so many ticks pass in lock-step.
    pub(super) fn advance(&self, ticks: u32, until_event: bool) -> Result<Passed, Rejection> {
        let mut state = self.lock();
        if state.real_time.is_some() {
            let allowed = "0: its time passes at its own pace, which live.speed has set";
            return Err(Rejection::new(Code::Unsupported, "ticks", ticks, allowed));
        }
        state.tick(ticks, until_event)
    }

    /// Ticks that are due by now at the world's own pace.
    pub(super) fn due(&self) -> u64 {
        let mut state = self.lock();
        let ticks = state.ticks;
        state.real_time.as_mut().map_or(0, |time| time.due(ticks, Instant::now()))
    }

    /// Lets ticks pass that are due. What goes wrong is told to the next request.
    pub(super) fn catch_up(&self, ticks: u32) {
        self.lock().tick(ticks, false).ok();
    }

    /// Writes the present into a reply, and the events that come after the first `heard`.
    pub(super) fn write(
        &self,
        layout: &LiveReplyLayout,
        reply: &mut [u8],
        passed: Passed,
        heard: &mut u64,
    ) -> Result<(), Rejection> {
        let mut state = self.lock();
        let state = &mut *state;
        if let Some(over) = &state.over {
            return Err(over.clone());
        }
        let oldest = state.told - state.events.len() as u64;
        let lost = oldest.saturating_sub(*heard);
        let first = (*heard).max(oldest);
        let news = state.events.range((first - oldest) as usize..).take(MAX_EVENTS);
        let records = layout.events.view_mut::<EventRecord>(reply, 1);
        let mut events = 0;
        for (room, event) in records.iter_mut().zip(news) {
            *room = *event;
            events += 1;
        }
        *heard = first + u64::from(events);
        for ((room, arm), driver) in
            layout.arms.view_mut(reply, 1).iter_mut().zip(state.world.arms()).zip(&state.drivers)
        {
            *room = arm.record();
            room.driver = driver.map_or(0, Driver::pid);
        }
        let rooms = layout.objects.view_mut::<f64>(reply, 1).chunks_exact_mut(7);
        for (room, (_, pose)) in rooms.zip(state.world.objects()) {
            room.copy_from_slice(&crate::dvrk::numbers_of(&pose));
        }
        let [observation, achieved, desired] = &mut state.seen;
        let step = state.world.observe(observation, achieved, desired);
        let regions = [layout.observation, layout.achieved_goal, layout.desired_goal];
        for (region, numbers) in regions.iter().zip(&state.seen) {
            region.view_mut(reply, 1).copy_from_slice(numbers);
        }
        layout.world.view_mut(reply, 1)[0] = WorldRecord {
            ticks: state.ticks,
            lost_events: lost,
            passed: passed.ticks,
            events,
            has_more: u32::from(*heard < state.told),
            steps: state.world.env().steps(),
            reward: step.reward,
            is_success: u32::from(step.is_success),
            terminated: u32::from(step.terminated),
            late: state.real_time.as_ref().map_or(0, |time| time.late() as u32),
        };
        Ok(())
    }

    /// Answers a question about an arm's kinematics.
    pub(super) fn answer(&self, question: &QuestionRecord) -> Result<AnswerRecord, Rejection> {
        let (place, which) = (self.place(question.arm)?, question.which()?);
        let [first, second] = question.numbers.read("joints")?;
        let mut state = self.lock();
        let by_task = match which {
            Question::TaskSetPoint => Some(state.world.task_set_point(place, first)),
            Question::TaskAction => Some(state.world.task_action(place, first, second)),
            _ => None,
        };
        if let Some(answer) = by_task {
            return Ok(AnswerRecord::new(answer.as_deref().map_err(String::as_str)));
        }
        let arm = state.world.arms().nth(place).expect("its place was checked");
        let pose = |pose: Pose| crate::dvrk::numbers_of(&pose).to_vec();
        let words = |why: crate::dvrk::NoSolution| why.to_string();
        let rows = |jacobian: Option<nalgebra::Matrix6xX<f64>>| {
            let jacobian = jacobian.ok_or("the arm has no tool")?;
            Ok(jacobian.transpose().as_slice().to_vec())
        };
        let answer: Result<Vec<f64>, String> = match which {
            Question::ForwardKinematics => arm.forward_kinematics(first).map(pose).map_err(words),
            Question::LocalForwardKinematics => {
                arm.local_forward_kinematics(first).map(pose).map_err(words)
            }
            Question::InverseKinematics => match *first {
                [x, y, z, ref turn @ ..] if turn.len() == 4 => {
                    let orientation = [turn[0], turn[1], turn[2], turn[3]];
                    let (frame, position) = (String::new(), [x, y, z]);
                    let goal = PoseMessage { frame, position, orientation };
                    let joints = arm.inverse_kinematics(&goal, second);
                    joints.map(|joints| joints.to_vec()).map_err(words)
                }
                _ => Err(format!("{} numbers, expected 7 of a pose", first.len())),
            },
            Question::ActuatorToJointPosition => {
                let joints = arm.actuator_to_joint_position(first);
                joints.map(|joints| joints.to_vec()).map_err(words)
            }
            Question::BodyJacobian => rows(arm.body_jacobian()),
            Question::SpatialJacobian => rows(arm.spatial_jacobian()),
            Question::TaskSetPoint | Question::TaskAction => unreachable!("answered above"),
        };
        Ok(AnswerRecord::new(answer.as_deref().map_err(String::as_str)))
    }

    /// Frees the arms that a session drove, which then hold; with the session that made it, the world ends.
    pub(super) fn leave(&self, session: u64, is_maker: bool) {
        let mut state = self.lock();
        state.free(
            |driver| matches!(driver, Driver::Session { session: its, .. } if its == session),
        );
        if is_maker {
            let why = "the session that made it has ended; open another";
            state.over = Some(Rejection::new(Code::UnknownSession, "world", session, why));
        }
    }

    /// Names of the arms.
    pub(super) fn arm_names(&self) -> Vec<String> {
        self.info.arms.iter().map(|arm| arm.name.clone()).collect()
    }

    /// Has an arm do what a page of the viewer wants.
    pub(super) fn drive(&self, page: u64, arm: &str, motion: &Motion) -> Result<(), Rejection> {
        let place = self.info.arm(arm)?;
        let commands = match motion {
            Motion::Enable => {
                vec![Command::State(StateCommand::Enable), Command::State(StateCommand::Home)]
            }
            Motion::Twist(twist) => vec![Command::ServoCv(self.in_reference(place, twist))],
            Motion::Jaw(angle) => vec![Command::JawMoveJp(vec![*angle])],
            Motion::Hold => vec![Command::Hold],
        };
        let records = commands.iter().map(|command| CommandRecord::new(place, command));
        self.command(Driver::Page(page), &records.collect::<Result<Vec<_>, _>>()?)
    }

    /// Has the arms hold that a page of the viewer has driven.
    pub(super) fn let_go(&self, page: u64) {
        self.lock().free(|driver| driver == Driver::Page(page));
    }

    /// A twist in the axes of an arm's reference frame, of one in the axes of the world.
    fn in_reference(&self, place: u32, twist: &[f64; 6]) -> [f64; 6] {
        let state = self.lock();
        let arm = state.world.arms().nth(place as usize).expect("its place was looked up");
        let world_from_base =
            state.world.world_from_base(arm.name()).expect("the arm is the world's");
        let reference_from_world = arm.base_frame().rotation * world_from_base.rotation.inverse();
        let turned =
            |at: usize| reference_from_world * Vector3::from_column_slice(&twist[at..at + 3]);
        let [velocity, turn] = [turned(0), turned(3)];
        [velocity.x, velocity.y, velocity.z, turn.x, turn.y, turn.z]
    }

    fn place(&self, arm: u32) -> Result<usize, Rejection> {
        let place = arm as usize;
        if place < self.info.arms.len() {
            return Ok(place);
        }
        let allowed = format!("allowed are numbers below {}", self.info.arms.len());
        Err(Rejection::new(Code::UnknownArm, "arm", arm, allowed))
    }

    fn lock(&self) -> MutexGuard<'_, WorldState> {
        self.state.lock().unwrap_or_else(|poisoned| {
            // A world that panicked in the middle of a tick is not to be trusted.
            let mut state = PoisonError::into_inner(poisoned);
            let why = "a fault of the server, which its log tells; open another world";
            state
                .over
                .get_or_insert_with(|| Rejection::new(Code::Internal, "world", "failed", why));
            state
        })
    }
}

impl Drop for SharedWorld {
    fn drop(&mut self) {
        let paid = self.lock().paid;
        self.ledger.give_back(paid);
    }
}

/// The world of a request at the beginning of a seed's first episode.
fn begun(mut env: Env, request: &SessionRequest, seed: u64) -> Result<SavedWorld, Rejection> {
    let homing = request.live.unwrap_or_default().homing;
    env.reset(Some(seed));
    let log = LiveLog::new(Beginning {
        version: env!("CARGO_PKG_VERSION").into(),
        task: request.task.clone(),
        options: request.options.clone(),
        seed,
        homing,
    })?;
    Ok(SavedWorld { world: LiveWorld::new(env, homing)?, log })
}

fn arm_info(world: &LiveWorld, arm: &ArmController) -> ArmInfo {
    let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
    let mechanism = arm.mechanism();
    let base = world.world_from_base(arm.name()).expect("the arm is the world's");
    ArmInfo {
        name: arm.name().into(),
        joints: names(&mechanism.names()[..mechanism.joints()]),
        raw_joints: names(mechanism.raw_names()),
        has_jaw: mechanism.axes() > mechanism.joints(),
        world_from_base: crate::dvrk::numbers_of(base),
    }
}
