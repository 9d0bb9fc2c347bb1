//! A live world on ROS 2: looks at it, gives commands, publishes.

use std::time::{Duration, Instant};

use anyhow::Context as _;
use trocar_client::proto::dvrk::record::Question;
use trocar_client::proto::dvrk::{Command, State, StateCommand, TICKS_PER_SECOND};
use trocar_client::{CallError, LiveWorld};

use crate::arm::Arm;
use crate::bus::Bus;
use crate::clock::{self, WorldClock};
use crate::console::{Console, System};
use crate::messages::{Content, OperatingState, Stamp};
use crate::truth::Truth;

/// How long after a tick it is looked for.
const AFTER_TICK: Duration = Duration::from_micros(200);

/// Shortest time between two looks at a world that has not gone on, and longest.
const PAUSES: [Duration; 2] = [Duration::from_micros(500), Duration::from_millis(5)];

/// The node's view of a world, and what it tells of it.
pub(crate) struct Dvrk {
    world: LiveWorld,
    arms: Vec<Arm>,
    truth: Truth,
    pub(crate) console: Console,
    pub(crate) system: System,
    clock: WorldClock,
    /// Arms that were commanded since the latest look.
    commanded: Vec<usize>,
    /// Ticks of the world that were seen.
    ticks: u64,
    next_look: Instant,
    /// Time between two publications of states.
    period: Duration,
    next_state: Instant,
}

impl Dvrk {
    /// Offers the arms of a world that has a pace. States are published `rate` times a second.
    pub(crate) fn new(
        bus: &mut Bus<Self>,
        world: LiveWorld,
        rate: f64,
        status: &str,
    ) -> anyhow::Result<Self> {
        let live = world.live().clone();
        let speed = live.speed.context("the world has no pace")?;
        let arms = live.arms.iter().enumerate();
        let arms = arms.map(|(place, info)| Arm::new(bus, place, info, status));
        let arms = arms.collect::<anyhow::Result<Vec<_>>>()?;
        Ok(Self {
            truth: Truth::new(bus, &world)?,
            console: Console::new(bus)?,
            system: System::new(bus)?,
            arms,
            clock: WorldClock::new(speed),
            commanded: vec![],
            ticks: 0,
            next_look: Instant::now(),
            period: Duration::from_secs_f64(1.0 / rate),
            next_state: Instant::now(),
            world,
        })
    }

    /// Has the poses of all arms in the frame of the world, as if they were registered.
    pub(crate) fn register(&mut self) {
        let bases = self.world.live().arms.clone().into_iter().map(|arm| arm.world_from_base);
        for (place, base) in bases.enumerate() {
            let content =
                Content { numbers: base.to_vec(), text: "world".into(), ..Content::default() };
            self.command(place, "set_base_frame", &content);
        }
    }

    /// Gives the command of a topic to the arm at a place, with the next look.
    pub(crate) fn command(&mut self, place: usize, topic: &str, content: &Content) {
        let Content { numbers, more, text } = content;
        let command = Command::of(topic, numbers, more, text);
        let arm = &self.arms[place];
        arm.announce(topic, text, numbers.first().copied().unwrap_or_default());
        let name = arm.name().to_string();
        let given = command
            .map_err(CallError::from)
            .and_then(|command| self.world.command(&name, &command));
        match given {
            Ok(()) => self.commanded.push(place),
            Err(error) => self.arms[place].refuse(error.to_string()),
        }
    }

    /// Gives all arms a command of state, or those that have faulted.
    pub(crate) fn command_all(&mut self, command: &StateCommand, only_faulted: bool) {
        for place in 0..self.arms.len() {
            let record = self.world.arm(self.arms[place].name());
            let is_faulted =
                record.is_ok_and(|record| record.operating_state().state == State::Fault);
            if is_faulted || !only_faulted {
                let content = Content { text: command.word().into(), ..Content::default() };
                self.command(place, "state_command", &content);
            }
        }
    }

    /// Asks about the kinematics of the arm at a place.
    pub(crate) fn ask(
        &mut self,
        place: usize,
        question: Question,
        groups: [&[f64]; 2],
    ) -> Result<Vec<f64>, String> {
        let name = self.arms[place].name();
        match self.world.ask(name, question, groups) {
            Ok(answer) => answer,
            Err(error) => Err(error.to_string()),
        }
    }

    /// The present state of the arm at a place.
    pub(crate) fn operating_state(&self, place: usize) -> OperatingState {
        let record = self.world.arm(self.arms[place].name());
        record.map_or_else(
            |_| OperatingState::default(),
            |record| OperatingState::new(Stamp::of(clock::now()), record.operating_state()),
        )
    }

    /// How long nothing is to be done unless a message comes.
    pub(crate) fn patience(&self) -> Duration {
        self.next_look.saturating_duration_since(Instant::now())
    }

    /// Gives the commands, and publishes what has become of the world, where it is time for that.
    pub(crate) fn act(&mut self, bus: &mut Bus<Self>) -> anyhow::Result<()> {
        if self.commanded.is_empty() && Instant::now() < self.next_look {
            return Ok(());
        }
        let commanded = std::mem::take(&mut self.commanded);
        self.look(&commanded)?;
        self.listen(!commanded.is_empty())?;
        let ticks = self.world.world().ticks;
        let now = Instant::now();
        if ticks > self.ticks && now >= self.next_state {
            self.next_state += self.period;
            if self.next_state < now {
                self.next_state = now + self.period;
            }
            self.publish_states(bus)?;
        }
        bus.look();
        let pause = if ticks > self.ticks { self.until_tick()? } else { PAUSES[0] };
        self.ticks = ticks;
        self.next_look = Instant::now() + pause;
        Ok(())
    }

    /// Looks at the world. Commands that another process is in the way of are refused.
    fn look(&mut self, commanded: &[usize]) -> anyhow::Result<()> {
        match self.world.look() {
            Err(CallError::Refused(rejection)) if !commanded.is_empty() => {
                for place in commanded {
                    self.arms[*place].refuse(rejection.to_string());
                }
                self.world.look()?;
            }
            looked => looked?,
        }
        let world = *self.world.world();
        self.clock.see(self.stamp()?, world.late);
        Ok(())
    }

    /// The world's time, ns.
    fn stamp(&self) -> anyhow::Result<u64> {
        let arm = self.arms.first().context("the world has no arms")?;
        Ok(self.world.arm(arm.name())?.stamp)
    }

    /// Publishes what arms have told.
    fn listen(&mut self, has_commanded: bool) -> anyhow::Result<()> {
        let (stamp, now) = (self.stamp()?, clock::now());
        while let Some(event) = self.world.next_event() {
            // What was told since the latest tick is the answer to commands, which came just now.
            let is_answer = has_commanded && event.stamp >= stamp;
            let at = if is_answer { now } else { self.clock.system(event.stamp).min(now) };
            if let Some(arm) = self.arms.get_mut(event.arm as usize) {
                arm.tell(at, event.report);
            }
        }
        Ok(())
    }

    fn publish_states(&mut self, bus: &Bus<Self>) -> anyhow::Result<()> {
        let stamp = self.clock.system(self.stamp()?).min(clock::now());
        for arm in &mut self.arms {
            arm.publish_state(bus, &mut self.world, stamp)?;
        }
        self.truth.publish(bus, &self.world, Stamp::of(stamp));
        Ok(())
    }

    /// How long it is until the next tick has passed.
    fn until_tick(&self) -> anyhow::Result<Duration> {
        let next = self.stamp()? + 1_000_000_000 / TICKS_PER_SECOND;
        let left = (self.clock.system(next) - clock::now()).max(0) as u64;
        Ok((Duration::from_nanos(left) + AFTER_TICK).clamp(PAUSES[0], PAUSES[1]))
    }
}
