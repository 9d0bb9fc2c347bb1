//! The node on ROS 2: publishers, subscriptions and services, and which of them there is something for.

use std::collections::HashSet;
use std::net::IpAddr;
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context, Message, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile,
    ServiceMapping, ServiceTypeName, Subscription,
};
use rustdds::DomainParticipantBuilder;
use rustdds::mio1::event::Source;
use rustdds::mio1::{Events, Interest, Poll, Token};

use crate::messages::RosMessage;

/// Messages that a publisher or a subscription keeps.
const DEPTH: usize = 100;

/// Messages of one topic that are taken before others get their turn.
const AT_ONCE: usize = 1000;

/// How often the node looks for subscribers.
const LOOK: Duration = Duration::from_millis(200);

/// Whether a publisher keeps what it published for later subscribers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Keeps {
    /// States, which are published again and again.
    Nothing,
    /// Events.
    Latest,
}

/// Takes what there is of one topic or service; whether there may be more.
type Inlet<C> = Box<dyn FnMut(&mut C) -> bool>;

/// A node. What comes is handed to a `C`.
pub(crate) struct Bus<C> {
    /// Dropped first.
    inlets: Vec<Inlet<C>>,
    poll: Poll,
    events: Events,
    /// Those of which more was there than was taken at once.
    unfinished: Vec<usize>,
    node: Node,
    context: Context,
    listened: HashSet<String>,
    looked: Option<Instant>,
}

impl<C: 'static> Bus<C> {
    /// A node on the network interface of this address.
    pub(crate) fn new(domain: u16, interface: IpAddr) -> anyhow::Result<Self> {
        let participant = DomainParticipantBuilder::new(domain)
            .with_only_networks([interface])
            .same_host_loopback(interface.is_loopback())
            .build()
            .map_err(|error| anyhow!("{error}"))
            .with_context(|| format!("DDS on {interface}, domain {domain}"))?;
        let context = Context::from_domain_participant(participant)?;
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let node = context.new_node(NodeName::new("/", "dvrk")?, options);
        Ok(Self {
            inlets: vec![],
            poll: Poll::new()?,
            events: Events::with_capacity(256),
            unfinished: vec![],
            node: node.map_err(|error| anyhow!("{error}"))?,
            context,
            listened: HashSet::new(),
            looked: None,
        })
    }

    /// A publisher to the topic of an absolute `name`.
    pub(crate) fn publisher<M: RosMessage>(
        &mut self,
        name: &str,
        keeps: Keeps,
    ) -> anyhow::Result<Publisher<M>> {
        let durability = match keeps {
            Keeps::Nothing => Durability::Volatile,
            Keeps::Latest => Durability::TransientLocal,
        };
        let depth = match keeps {
            Keeps::Nothing => DEPTH,
            Keeps::Latest => 10,
        };
        // One that takes nothing in must not hold up the others.
        let qos = qos(durability, depth).reliability_reliable(WhenFull::Fail);
        let topic = self.node.create_topic(&parsed(name)?, message_type::<M>(), &qos)?;
        Ok(self.node.create_publisher(&topic, None)?)
    }

    /// Hands the messages of a topic on.
    pub(crate) fn subscribe<M: RosMessage>(
        &mut self,
        name: &str,
        mut deliver: impl FnMut(&mut C, M) + 'static,
    ) -> anyhow::Result<()> {
        // A client's publisher may keep its commands: those are not to be done again.
        let qos = qos(Durability::Volatile, DEPTH);
        let topic = self.node.create_topic(&parsed(name)?, message_type::<M>(), &qos)?;
        let mut subscription: Subscription<M> = self.node.create_subscription(&topic, None)?;
        self.register(&mut subscription)?;
        let name = name.to_string();
        self.inlets.push(Box::new(move |receiver| {
            for _ in 0..AT_ONCE {
                match subscription.take() {
                    Ok(Some((message, _))) => deliver(receiver, message),
                    Ok(None) => return false,
                    Err(error) => tracing::warn!(topic = name, %error, "a message was not read"),
                }
            }
            true
        }));
        Ok(())
    }

    /// Answers the requests of a service.
    pub(crate) fn serve<Q, A>(
        &mut self,
        name: &str,
        service: &str,
        mut answer: impl FnMut(&mut C, Q) -> A + 'static,
    ) -> anyhow::Result<()>
    where
        Q: Message + Clone + 'static,
        A: Message + 'static,
    {
        let (package, of) = service.split_once('/').context("a service's type has a package")?;
        let [asked, answered] = [(); 2].map(|()| qos(Durability::Volatile, 10));
        let mut server = self.node.create_server::<Q, A>(
            ServiceMapping::Enhanced,
            &parsed(name)?,
            &ServiceTypeName::new(package, of),
            asked,
            answered,
        )?;
        self.register(&mut server)?;
        let name = name.to_string();
        self.inlets.push(Box::new(move |receiver| {
            for _ in 0..AT_ONCE {
                match server.receive_request() {
                    Ok(Some((id, question))) => {
                        if let Err(error) = server.send_response(id, answer(receiver, question)) {
                            tracing::warn!(service = name, %error, "an answer was not sent");
                        }
                    }
                    Ok(None) => return false,
                    Err(error) => tracing::warn!(service = name, %error, "a request was not read"),
                }
            }
            true
        }));
        Ok(())
    }

    fn register(&mut self, source: &mut impl Source) -> anyhow::Result<()> {
        let token = Token(self.inlets.len());
        Ok(self.poll.registry().register(source, token, Interest::READABLE)?)
    }

    /// Waits at most `patience` for messages, and hands them on.
    pub(crate) fn deliver(&mut self, receiver: &mut C, patience: Duration) -> anyhow::Result<()> {
        let patience = if self.unfinished.is_empty() { patience } else { Duration::ZERO };
        if let Err(error) = self.poll.poll(&mut self.events, Some(patience))
            && error.kind() != std::io::ErrorKind::Interrupted
        {
            return Err(error.into());
        }
        let mut ready = std::mem::take(&mut self.unfinished);
        ready.extend(self.events.iter().map(|event| event.token().0));
        for place in ready {
            if self.inlets[place](receiver) {
                self.unfinished.push(place);
            }
        }
        Ok(())
    }

    /// Whether the topic of an absolute name has a subscriber somewhere, as far as is known.
    pub(crate) fn is_listened(&self, name: &str) -> bool {
        self.listened.contains(name)
    }

    /// Looks for subscribers now and then.
    pub(crate) fn look(&mut self) {
        if self.looked.is_some_and(|looked| looked.elapsed() < LOOK) {
            return;
        }
        self.looked = Some(Instant::now());
        let readers = self.context.domain_participant().discovered_readers();
        let names = readers.iter().map(|reader| reader.subscription_topic_data.topic_name());
        self.listened =
            names.filter_map(|name| Some(name.strip_prefix("rt")?.to_string())).collect();
    }
}

/// Publishes, or says that it could not. A subscriber that takes nothing in misses messages.
pub(crate) fn publish<M: RosMessage>(to: &Publisher<M>, message: M) {
    if let Err(error) = to.publish(message) {
        tracing::debug!(message = M::NAME, %error, "not published");
    }
}

fn qos(durability: Durability, depth: usize) -> QosProfile {
    QosProfile::publisher_default()
        .reliability_reliable(WhenFull::DEFAULT)
        .durability(durability)
        .history(History::KeepLast { depth })
}

fn parsed(name: &str) -> anyhow::Result<Name> {
    Name::parse(name).map_err(|error| anyhow!("{name}: {error:?}"))
}

fn message_type<M: RosMessage>() -> MessageTypeName {
    let (package, of) = M::NAME.split_once('/').expect("types of messages have a package");
    MessageTypeName::new(package, of)
}
