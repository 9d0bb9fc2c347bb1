//! One arm on ROS 2: its topics and services, as the list of topics has them.

use std::rc::Rc;

use anyhow::bail;
use ros2_client::Publisher;
use trocar_client::LiveWorld;
use trocar_client::proto::dvrk::record::Question;
use trocar_client::proto::dvrk::topics::{Direction, TOPICS, Topic};
use trocar_client::proto::dvrk::{ArmInfo, Report};

use crate::bus::{Bus, Keeps, publish};
use crate::dvrk::Dvrk;
use crate::messages::{
    Bool, CartesianImpedance, CartesianServo, Commanding, Empty, Float64, ForwardAnswer,
    ForwardQuestion, InverseAnswer, InverseQuestion, JointState, Joy, OperatingState, PoseStamped,
    RosMessage, Stamp, StateAnswer, StringStamped, Text, TwistStamped, WrenchStamped,
};
use crate::reading::Reading;
use crate::statistics::Statistics;

/// The topics for which the server is asked for Jacobians.
const WITH_JACOBIANS: [&str; 4] =
    ["body/jacobian", "spatial/jacobian", "local/measured_cv", "setpoint_cv"];

/// Publishes the message of one topic.
type Publish = Box<dyn Fn(&Reading)>;

/// A topic that is published at the rate of states.
struct Stream {
    name: String,
    needs_jacobians: bool,
    publish: Publish,
}

/// What is published when it happens.
struct Events {
    operating_state: Publisher<OperatingState>,
    goal_reached: Publisher<Bool>,
    ratios: [Publisher<Float64>; 3],
    desired_state: Publisher<Text>,
    error: Publisher<Text>,
    warning: Publisher<Text>,
    status: Publisher<Text>,
    /// The tool or the endoscope.
    tool_type: Publisher<Text>,
    /// Whether there is an adapter and a tool.
    present: [Publisher<Joy>; 2],
    /// Topics that nothing is ever said on.
    _silent: (Vec<Publisher<Joy>>, Option<Publisher<Text>>),
}

/// An arm.
pub(crate) struct Arm {
    info: Rc<ArmInfo>,
    streams: Vec<Stream>,
    events: Events,
    statistics: Statistics,
    /// The latest stamp of an event, ns since 1970: clients ignore states that are not newer.
    latest: i64,
}

impl Arm {
    /// The arm at a `place` of a world, whose commands go to it from now on.
    pub(crate) fn new(
        bus: &mut Bus<Dvrk>,
        place: usize,
        info: &ArmInfo,
        status: &str,
    ) -> anyhow::Result<Self> {
        let mut streams = vec![];
        for topic in TOPICS.iter().filter(|topic| topic.is_of(info.has_jaw)) {
            let name = format!("/{}/{}", info.name, topic.name);
            match topic.direction {
                // Its type is not known.
                _ if topic.message.is_empty() => {}
                Direction::Subscribes => subscribe(bus, &name, topic, place)?,
                Direction::Publishes => streams.extend(stream(bus, name, topic.name)?),
                Direction::Serves => serve(bus, &name, topic, place)?,
            }
        }
        let events = Events::new(bus, info)?;
        publish(&events.status, Text { data: status.into() });
        for ratio in &events.ratios {
            publish(ratio, Float64 { data: 1.0 });
        }
        let name = format!("/{}/period_statistics", info.name);
        let statistics = Statistics::new(bus.publisher(&name, Keeps::Nothing)?);
        Ok(Self { info: Rc::new(info.clone()), streams, events, statistics, latest: 0 })
    }

    pub(crate) fn name(&self) -> &str {
        &self.info.name
    }

    /// Publishes how the arm is, if a subscriber listens.
    pub(crate) fn publish_state(
        &mut self,
        bus: &Bus<Dvrk>,
        world: &mut LiveWorld,
        stamp: i64,
    ) -> anyhow::Result<()> {
        self.statistics.count(stamp);
        let heard: Vec<_> =
            self.streams.iter().filter(|stream| bus.is_listened(&stream.name)).collect();
        if heard.is_empty() {
            return Ok(());
        }
        let with_jacobians = heard.iter().any(|stream| stream.needs_jacobians);
        let reading = Reading::new(world, &self.info, Stamp::of(stamp), with_jacobians)?;
        for stream in heard {
            (stream.publish)(&reading);
        }
        Ok(())
    }

    /// Publishes what the arm has told, with this stamp or a later one.
    pub(crate) fn tell(&mut self, stamp: i64, report: Report) {
        self.latest = stamp.max(self.latest + 1);
        let events = &self.events;
        let number = |data| Float64 { data };
        match report {
            Report::OperatingState(state) => {
                let message = OperatingState::new(Stamp::of(self.latest), state);
                publish(&events.operating_state, message);
            }
            Report::GoalReached(data) => publish(&events.goal_reached, Bool { data }),
            Report::Ratio(ratio) => publish(&events.ratios[0], number(ratio)),
            Report::RatioV(ratio) => publish(&events.ratios[1], number(ratio)),
            Report::RatioA(ratio) => publish(&events.ratios[2], number(ratio)),
            Report::ToolType(data) | Report::EndoscopeType(data) => {
                publish(&events.tool_type, Text { data });
            }
            Report::Warning(data) => publish(&events.warning, Text { data }),
            Report::Error(data) => publish(&events.error, Text { data }),
        }
    }

    /// Says on `error` why a command did not reach the arm.
    pub(crate) fn refuse(&self, why: String) {
        publish(&self.events.error, Text { data: why });
    }

    /// Tells what a command leads to before the arm does: the state that is wanted, the tool that is there.
    pub(crate) fn announce(&self, command: &str, word: &str, number: f64) {
        let state = match (command, word) {
            ("state_command", "enable" | "home" | "resume") => "ENABLED",
            ("state_command", "disable") => "DISABLED",
            ("state_command", "pause") => "PAUSED",
            ("emulate_adapter_present" | "emulate_tool_present", _) => {
                let is_tool = usize::from(command == "emulate_tool_present");
                let button = i32::from(number != 0.0);
                publish(
                    &self.events.present[is_tool],
                    Joy { buttons: vec![button], ..Joy::default() },
                );
                return;
            }
            _ => return,
        };
        publish(&self.events.desired_state, Text { data: state.into() });
    }
}

impl Events {
    fn new(bus: &mut Bus<Dvrk>, info: &ArmInfo) -> anyhow::Result<Self> {
        let named = |topic: &str| format!("/{}/{topic}", info.name);
        let text = |bus: &mut Bus<Dvrk>, topic| bus.publisher::<Text>(&named(topic), Keeps::Latest);
        let number =
            |bus: &mut Bus<Dvrk>, topic| bus.publisher::<Float64>(&named(topic), Keeps::Latest);
        let button =
            |bus: &mut Bus<Dvrk>, topic| bus.publisher::<Joy>(&named(topic), Keeps::Latest);
        Ok(Self {
            operating_state: bus.publisher(&named("operating_state"), Keeps::Latest)?,
            goal_reached: bus.publisher(&named("goal_reached"), Keeps::Latest)?,
            ratios: [
                number(bus, "trajectory_j/ratio")?,
                number(bus, "trajectory_j/ratio_v")?,
                number(bus, "trajectory_j/ratio_a")?,
            ],
            desired_state: text(bus, "desired_state")?,
            error: text(bus, "error")?,
            warning: text(bus, "warning")?,
            status: text(bus, "status")?,
            tool_type: text(bus, if info.has_jaw { "tool_type" } else { "endoscope_type" })?,
            present: [button(bus, "IO/adapter")?, button(bus, "IO/tool")?],
            _silent: (
                vec![
                    button(bus, "arm_clutch")?,
                    button(bus, "IO/arm_clutch")?,
                    button(bus, "IO/SUJ_clutch")?,
                ],
                if info.has_jaw { Some(text(bus, "tool_type_request")?) } else { None },
            ),
        })
    }
}

/// What makes the messages of a topic that is published at the rate of states; nothing for events.
fn stream(bus: &mut Bus<Dvrk>, name: String, topic: &str) -> anyhow::Result<Option<Stream>> {
    let needs_jacobians = WITH_JACOBIANS.contains(&topic);
    let publish = match topic {
        "measured_js" => making(bus, &name, |reading| Some(reading.measured_js())),
        "setpoint_js" => making(bus, &name, |reading| Some(reading.setpoint_js())),
        "jaw/measured_js" => making(bus, &name, Reading::jaw_measured_js),
        "jaw/setpoint_js" => making(bus, &name, Reading::jaw_setpoint_js),
        "measured_cp" => making(bus, &name, Reading::measured_cp),
        "setpoint_cp" => making(bus, &name, Reading::setpoint_cp),
        "local/measured_cp" => making(bus, &name, Reading::local_measured_cp),
        "local/setpoint_cp" => making(bus, &name, Reading::local_setpoint_cp),
        "measured_cv" => making(bus, &name, Reading::measured_cv),
        "local/measured_cv" => making(bus, &name, Reading::local_measured_cv),
        "setpoint_cv" => making(bus, &name, Reading::setpoint_cv),
        "body/measured_cf" | "spatial/measured_cf" => making(bus, &name, Reading::measured_cf),
        "body/jacobian" => making(bus, &name, Reading::body_jacobian),
        "spatial/jacobian" => making(bus, &name, Reading::spatial_jacobian),
        "measured_cs" => making(bus, &name, |reading| Some(reading.measured_cs())),
        _ => return Ok(None),
    }?;
    Ok(Some(Stream { name, needs_jacobians, publish }))
}

fn making<M: RosMessage>(
    bus: &mut Bus<Dvrk>,
    name: &str,
    make: impl Fn(&Reading) -> Option<M> + 'static,
) -> anyhow::Result<Publish> {
    let publisher = bus.publisher::<M>(name, Keeps::Nothing)?;
    Ok(Box::new(move |reading| {
        if let Some(message) = make(reading) {
            publish(&publisher, message);
        }
    }))
}

/// Hands the commands of a topic to the arm at a place.
fn subscribe(bus: &mut Bus<Dvrk>, name: &str, topic: &Topic, place: usize) -> anyhow::Result<()> {
    fn command<M: Commanding>(
        bus: &mut Bus<Dvrk>,
        name: &str,
        topic: &'static str,
        place: usize,
    ) -> anyhow::Result<()> {
        bus.subscribe::<M>(name, move |dvrk, message| {
            dvrk.command(place, topic, &message.content(topic));
        })
    }
    let of = topic.name;
    match topic.message {
        Empty::NAME => command::<Empty>(bus, name, of, place),
        Bool::NAME => command::<Bool>(bus, name, of, place),
        Float64::NAME => command::<Float64>(bus, name, of, place),
        Text::NAME => command::<Text>(bus, name, of, place),
        StringStamped::NAME => command::<StringStamped>(bus, name, of, place),
        JointState::NAME => command::<JointState>(bus, name, of, place),
        PoseStamped::NAME => command::<PoseStamped>(bus, name, of, place),
        TwistStamped::NAME => command::<TwistStamped>(bus, name, of, place),
        WrenchStamped::NAME => command::<WrenchStamped>(bus, name, of, place),
        CartesianServo::NAME => command::<CartesianServo>(bus, name, of, place),
        CartesianImpedance::NAME => command::<CartesianImpedance>(bus, name, of, place),
        other => bail!("{name} has messages of an unknown type, {other}"),
    }
}

/// Answers the requests of a service of the arm at a place.
fn serve(bus: &mut Bus<Dvrk>, name: &str, topic: &Topic, place: usize) -> anyhow::Result<()> {
    let forward = |question| {
        move |dvrk: &mut Dvrk, asked: ForwardQuestion| match dvrk.ask(
            place,
            question,
            [&asked.jp, &[]],
        ) {
            Ok(numbers) => match <[f64; 7]>::try_from(numbers) {
                Ok(cp) => ForwardAnswer { cp: cp.into(), result: true, message: String::new() },
                Err(_) => ForwardAnswer::default(),
            },
            Err(message) => ForwardAnswer { message, ..ForwardAnswer::default() },
        }
    };
    match topic.name {
        "forward_kinematics" => {
            bus.serve(name, topic.message, forward(Question::ForwardKinematics))
        }
        "local/forward_kinematics" => {
            bus.serve(name, topic.message, forward(Question::LocalForwardKinematics))
        }
        "inverse_kinematics" => {
            bus.serve(name, topic.message, move |dvrk: &mut Dvrk, asked: InverseQuestion| {
                let groups: [&[f64]; 2] = [&asked.cp.numbers(), &asked.jp];
                match dvrk.ask(place, Question::InverseKinematics, groups) {
                    Ok(jp) => InverseAnswer { jp, result: true, message: String::new() },
                    Err(message) => InverseAnswer { message, ..InverseAnswer::default() },
                }
            })
        }
        "operating_state" => bus.serve(name, topic.message, move |dvrk: &mut Dvrk, _: Empty| {
            StateAnswer { operating_state: dvrk.operating_state(place) }
        }),
        // The fields of its messages are not known.
        _ => Ok(()),
    }
}
