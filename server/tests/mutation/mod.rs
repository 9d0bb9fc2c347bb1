//! Hostile control messages: valid ones of every kind, and what chance makes of them.

use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trocar_proto::control::{
    self, Autoreset, ClientInfo, ControlRequest, MAX_MESSAGE, SessionRequest,
};
use trocar_proto::snapshot::Recipe;
use trocar_proto::spec::OptionValue;
use trocar_proto::wire::Header;
use trocar_proto::{Options, Placement};

/// A control message as it lies in shared memory.
#[derive(Debug, Clone)]
pub(crate) struct Message {
    /// Its header.
    pub(crate) header: Header,
    /// Its payload.
    pub(crate) bytes: Vec<u8>,
}

/// Makes messages, the same ones for the same seed.
pub(crate) struct Mutator {
    rng: ChaCha8Rng,
    corpus: Vec<Message>,
}

/// Bytes that mean something to the encoding: ends of ranges, and its markers of longer integers.
const TELLING: [u8; 12] = [0, 1, 2, 0x7f, 0x80, 0xfa, 0xfb, 0xfc, 0xfd, 0xfe, 0xff, b'"'];

impl Mutator {
    /// A mutator of messages about `tasks`.
    pub(crate) fn new(seed: u64, tasks: &[&str]) -> Self {
        let corpus = requests(tasks).iter().map(Message::of).collect();
        Self { rng: ChaCha8Rng::seed_from_u64(seed), corpus }
    }

    /// The next message: a valid one after one to six mutations.
    pub(crate) fn next(&mut self) -> Message {
        let mut message = self.pick();
        for _ in 0..=self.below(6) {
            self.mutate(&mut message);
        }
        // Most headers fit what they carry, so that it is looked at.
        if self.below(4) > 0 {
            message.header.length = message.bytes.len() as u32;
        }
        message
    }

    fn pick(&mut self) -> Message {
        let index = self.below(self.corpus.len());
        self.corpus[index].clone()
    }

    fn below(&mut self, end: usize) -> usize {
        (self.rng.next_u64() % end as u64) as usize
    }

    /// `bytes` after one to six mutations.
    #[allow(dead_code, reason = "not every test that has this module needs it")]
    pub(crate) fn change(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut message = Message { header: Header::new(0), bytes: bytes.to_vec() };
        for _ in 0..=self.below(6) {
            self.mutate(&mut message);
        }
        message.bytes
    }

    fn mutate(&mut self, message: &mut Message) {
        let what = self.below(12);
        let bytes = &mut message.bytes;
        if bytes.is_empty() || what == 0 {
            return self.mutate_header(&mut message.header);
        }
        let at = (self.rng.next_u64() % bytes.len() as u64) as usize;
        let span = (self.rng.next_u64() % (bytes.len() - at) as u64) as usize;
        match what {
            1 | 2 => bytes[at] ^= 1 << (self.rng.next_u32() % 8),
            3 | 4 => bytes[at] = TELLING[self.rng.next_u32() as usize % TELLING.len()],
            5 => bytes[at] = self.rng.next_u32() as u8,
            6 => bytes.truncate(at),
            7 => drop(bytes.drain(at..at + span)),
            8 => bytes.extend_from_within(at..at + span),
            9 => {
                let number = self.rng.next_u64() >> (self.rng.next_u32() % 64);
                bytes.splice(at..at + span.min(8), number.to_le_bytes());
            }
            10 => {
                let other = self.pick().bytes;
                let from = self.below(other.len().max(1)).min(other.len());
                message.bytes.splice(at.., other[from..].iter().copied());
            }
            _ => {
                let repeats = self.below(600);
                let byte = message.bytes[at];
                message.bytes.splice(at..at, std::iter::repeat_n(byte, repeats));
            }
        }
        message.bytes.truncate(MAX_MESSAGE);
    }

    fn mutate_header(&mut self, header: &mut Header) {
        let number = self.rng.next_u64() >> (self.rng.next_u32() % 64);
        match self.below(10) {
            0 => header.magic = number as u32,
            1 => header.protocol = number as u32,
            2 => header.kind = number as u32,
            3 => header.kind = self.below(40) as u32,
            4 => header.flags = number as u32,
            5 => header.session = number,
            6 => header.epoch = number,
            7 => header.rows = number as u32,
            8 => header.status = number as u32,
            _ => header.length = number as u32,
        }
    }
}

impl Message {
    fn of(request: &ControlRequest) -> Self {
        let mut bytes = vec![0; MAX_MESSAGE];
        let length = control::encode(request, &mut bytes).expect("the request is short");
        bytes.truncate(length);
        let header = Header { length: length as u32, ..Header::new(request.kind()) };
        Self { header, bytes }
    }
}

/// Valid requests of every kind, with every sort of option.
fn requests(tasks: &[&str]) -> Vec<ControlRequest> {
    let client = ClientInfo { node: 0x1234_5678 << 64, pid: 77, language: "rust".into() };
    let rows = |numbers: &[f64]| [("latency".to_string(), numbers.to_vec())].into();
    let values = [
        ("reward", OptionValue::Text("dense".into())),
        ("action", OptionValue::Text("joint".into())),
        ("preset", OptionValue::Text("surrol".into())),
        ("grasp_distance", OptionValue::Number(f64::NAN)),
        ("image_size", OptionValue::Numbers(vec![128.0, f64::INFINITY, -0.0])),
        ("observation", OptionValue::Texts(vec!["state".into(), "rgb".into()])),
        ("domain", OptionValue::Table(rows(&[0.0, 2.0]))),
        ("setup", OptionValue::Table(rows(&[]))),
    ];
    let mut requests = vec![
        ControlRequest::Hello { client: client.clone() },
        ControlRequest::ListTasks,
        ControlRequest::CloseSession { session: 1, node: client.node },
        ControlRequest::Status,
        ControlRequest::Shutdown,
        ControlRequest::DropSnapshots { session: 1, node: client.node, snapshots: vec![1, 2] },
        ControlRequest::ExportSnapshot { session: 1, node: client.node, snapshot: 1 },
    ];
    let (node, placement) = (client.node, placement());
    requests.push(ControlRequest::ImportPlacement { session: 1, node, placement });
    requests.extend(tasks.iter().map(|task| {
        let bytes = recipe(task).to_bytes().expect("it is short");
        ControlRequest::ImportSnapshot { session: 1, node: client.node, bytes }
    }));
    for task in tasks {
        let plain = SessionRequest::new(task).envs(3).seed(u64::MAX);
        let mut options = vec![Options::new()];
        options.extend(values.iter().map(|(name, value)| Options::new().with(name, value.clone())));
        for options in options {
            let task = (*task).to_string();
            requests.push(ControlRequest::DescribeTask { task, options: options.clone() });
            let request = plain.clone().options(options).autoreset(Autoreset::SameStep);
            requests.push(ControlRequest::OpenSession { request, client: client.clone() });
        }
    }
    requests
}

/// How an episode shall begin.
fn placement() -> Placement {
    let objects = [("needle".into(), vec![0.55, 0.0, 0.68])].into();
    Placement { goal: Some(vec![0.55, 0.0, 0.72]), objects, tip: None }
}

/// What led to the state of an environment that was never observed.
fn recipe(task: &str) -> Recipe {
    Recipe {
        version: env!("CARGO_PKG_VERSION").into(),
        task: task.into(),
        options: Options::new().with_text("reward", "sparse"),
        seed: 1,
        episode: 0,
        placement: placement(),
        actions: vec![0.5; 30],
        fingerprint: 0,
    }
}
