//! What only a simulator knows: where objects are, and whether the task is done.

use trocar_client::LiveWorld;

use crate::bus::{Bus, Keeps, publish};
use crate::dvrk::Dvrk;
use crate::messages::{Bool, Float64, Header, Numbers, PoseStamped, RosMessage, Stamp};

/// The frame that it is all in.
const FRAME: &str = "world";

/// Publishes the message of one topic.
type Publish = Box<dyn Fn(&LiveWorld, Stamp)>;

/// A topic that is published at the rate of states.
struct Stream {
    topic: String,
    publish: Publish,
}

/// The topics of objects and of the task.
pub(crate) struct Truth {
    streams: Vec<Stream>,
}

impl Truth {
    /// Those of a world.
    pub(crate) fn new(bus: &mut Bus<Dvrk>, world: &LiveWorld) -> anyhow::Result<Self> {
        let mut streams = vec![];
        for name in &world.live().objects {
            let topic = format!("/{}/measured_cp", name.replace(' ', "_"));
            let name = name.clone();
            streams.push(stream(bus, topic, move |world, stamp| {
                let pose = (*world.object(&name).ok()?).into();
                Some(PoseStamped { header: Header::new(stamp, FRAME), pose })
            })?);
        }
        let task = |topic: &str| format!("/task/{topic}");
        let row = |numbers: &[f32]| {
            let numbers = numbers.iter().map(|number| f64::from(*number)).collect();
            Some(Numbers::matrix(1, numbers))
        };
        streams
            .push(stream(bus, task("achieved_goal"), move |world, _| row(world.achieved_goal()))?);
        streams.push(stream(bus, task("desired_goal"), move |world, _| row(world.desired_goal()))?);
        streams.push(stream(bus, task("is_success"), |world, _| {
            Some(Bool { data: world.world().is_success != 0 })
        })?);
        streams.push(stream(bus, task("reward"), |world, _| {
            Some(Float64 { data: f64::from(world.world().reward) })
        })?);
        Ok(Self { streams })
    }

    /// Publishes what is listened to.
    pub(crate) fn publish(&self, bus: &Bus<Dvrk>, world: &LiveWorld, stamp: Stamp) {
        for stream in self.streams.iter().filter(|stream| bus.is_listened(&stream.topic)) {
            (stream.publish)(world, stamp);
        }
    }
}

fn stream<M: RosMessage>(
    bus: &mut Bus<Dvrk>,
    topic: String,
    make: impl Fn(&LiveWorld, Stamp) -> Option<M> + 'static,
) -> anyhow::Result<Stream> {
    let publisher = bus.publisher::<M>(&topic, Keeps::Nothing)?;
    let publish = move |world: &LiveWorld, stamp: Stamp| {
        if let Some(message) = make(world, stamp) {
            publish(&publisher, message);
        }
    };
    Ok(Stream { topic, publish: Box::new(publish) })
}
