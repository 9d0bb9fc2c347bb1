//! Control messages: both sides' decoding, and what the server decides.

use std::sync::{Arc, LazyLock};

use serde::Serialize;
use serde::de::DeserializeOwned;
use trocar_proto::control::{
    self, Autoreset, ClientInfo, ControlReply, ControlRequest, MAX_MESSAGE, SessionInfo,
    SessionRequest,
};
use trocar_proto::spec::OptionValue;
use trocar_proto::wire::Header;
use trocar_proto::{Code, Options, Placement, Rejection};
use trocar_server::Registry;
use trocar_server::service::{Admission, Admitted, Footprint, ServerConfig, Usage};

use crate::input::Input;

/// Memory that all sessions may take, bytes.
const BUDGET: u64 = 64 << 20;

static ADMISSION: LazyLock<Admission> = LazyLock::new(|| {
    let config = ServerConfig {
        memory_bytes: BUDGET,
        max_envs: 64,
        ..ServerConfig::new("fuzz".parse().expect("a name"))
    };
    Admission::new(Arc::new(Registry::builtin()), &config, 1)
});

static REGISTRY: LazyLock<Registry> = LazyLock::new(Registry::builtin);

/// A byte that says which fields of the header follow, those fields, and the message.
pub(crate) fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let mask = input.byte();
    let mut header = header(mask, &mut input);
    let bytes = input.rest();
    let request = agree::<ControlRequest>(bytes);
    agree::<ControlReply>(bytes);
    // What is not in the mask fits the message, so that the message is looked at.
    if let Some(request) = request.filter(|_| mask & KIND == 0) {
        header.kind = request.kind();
    }
    if mask & LENGTH == 0 {
        header.length = bytes.len() as u32;
    }
    let usage = Usage {
        memory: Footprint { shared: 0, private: BUDGET / 2 },
        sessions: 3,
        ..Usage::default()
    };
    let Admitted { request, footprint } = match ADMISSION.check(&header, bytes, &usage) {
        Ok(admitted) => admitted,
        Err(refusal) => return check(&refusal),
    };
    match request {
        ControlRequest::DescribeTask { task, options } => {
            let reply = match REGISTRY.spec(&task, &options) {
                Ok(spec) => ControlReply::DescribeTask(spec.into()),
                Err(refusal) => return check(&refusal),
            };
            let told = encode(&reply).expect("a client can be told");
            assert_eq!(control::decode::<ControlReply>(&told), Ok(reply));
        }
        ControlRequest::OpenSession { request, .. } => {
            assert!(footprint.total() <= BUDGET / 2 && request.envs <= 64, "{request:?}");
            let env = REGISTRY.make(&request.task, &request.options);
            let env = env.expect("the admission has made one like it");
            assert!(env.memory_bytes() * u64::from(request.envs) <= footprint.private);
        }
        _ => {}
    }
}

const KIND: u8 = 1;
const LENGTH: u8 = 2;

fn header(mask: u8, input: &mut Input<'_>) -> Header {
    let mut header = Header::new(0);
    if mask & KIND != 0 {
        header.kind = input.u32();
    }
    if mask & LENGTH != 0 {
        header.length = input.u32();
    }
    if mask & 4 != 0 {
        header.magic = input.u32();
    }
    if mask & 8 != 0 {
        header.protocol = input.u32();
    }
    if mask & 16 != 0 {
        (header.flags, header.rows, header.status) = (input.u32(), input.u32(), input.u32());
        (header.request, header.session, header.epoch) = (input.u64(), input.u64(), input.u64());
    }
    header
}

/// What is decoded is encoded again to what decodes to the same, in no more bytes.
fn agree<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let value: T = match control::decode(bytes) {
        Ok(value) => value,
        Err(refusal) => {
            check(&refusal);
            return None;
        }
    };
    let again = encode(&value).expect("it was read from a message");
    assert!(again.len() <= bytes.len());
    let twice: T = control::decode(&again).expect("it was just encoded");
    assert_eq!(encode(&twice), Ok(again));
    Some(value)
}

/// A refusal says what is wrong, and a client can be told.
pub(crate) fn check(refusal: &Rejection) {
    assert!(!refusal.field.is_empty() && !refusal.allowed.is_empty(), "{refusal:?}");
    let told = encode(refusal).expect("a client can be told");
    assert_eq!(control::decode::<Rejection>(&told).as_ref(), Ok(refusal));
}

pub(crate) fn encode(message: &impl Serialize) -> Result<Vec<u8>, Rejection> {
    let mut bytes = vec![0; MAX_MESSAGE];
    let length = control::encode(message, &mut bytes)?;
    bytes.truncate(length);
    Ok(bytes)
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let message = |bytes: Vec<u8>| [vec![0], bytes].concat();
    let mut seeds: Vec<_> =
        requests().iter().map(|request| message(encode(request).expect("short"))).collect();
    seeds.extend(replies().iter().map(|reply| message(encode(reply).expect("short"))));
    seeds
}

fn requests() -> Vec<ControlRequest> {
    let client = ClientInfo { node: 0x1234_5678 << 64, pid: 77, language: "rust".into() };
    let (session, node) = (1, client.node);
    let table = |row: &str, numbers: &[f64]| {
        OptionValue::Table([(row.to_string(), numbers.to_vec())].into())
    };
    let options = [
        Options::new(),
        Options::new().with_text("reward", "dense").with_text("action", "joint"),
        Options::new().with_text("preset", "surrol"),
        Options::new().with("image_size", OptionValue::Numbers(vec![16.0, 16.0])),
        Options::new().with("observation", OptionValue::Texts(vec!["state".into(), "rgb".into()])),
        Options::new().with("domain", table("latency", &[0.0, 2.0])),
        Options::new().with("grasp_distance", OptionValue::Number(0.001)),
    ];
    let placement = Placement {
        goal: Some(vec![0.55, 0.0, 0.72]),
        objects: [("needle".into(), vec![0.55, 0.0, 0.68])].into(),
        tip: None,
    };
    let mut requests = vec![
        ControlRequest::Hello { client: client.clone() },
        ControlRequest::ListTasks,
        ControlRequest::CloseSession { session, node },
        ControlRequest::Status,
        ControlRequest::Shutdown,
        ControlRequest::Viewer,
        ControlRequest::DropSnapshots { session, node, snapshots: vec![1, 2] },
        ControlRequest::ExportSnapshot { session, node, snapshot: 1 },
        ControlRequest::ImportSnapshot { session, node, bytes: vec![1, 2, 3] },
        ControlRequest::ImportPlacement { session, node, placement },
        ControlRequest::Record { session, env: 0, every: 10 },
        ControlRequest::Recorded { session },
    ];
    for (task, options) in ["NeedleReach-v0", "EcmReach-v0"].into_iter().zip(options.chunks(4)) {
        for options in options {
            let describe = (task.to_string(), options.clone());
            requests.push(ControlRequest::DescribeTask { task: describe.0, options: describe.1 });
            let request = SessionRequest::new(task).envs(3).seed(u64::MAX).options(options.clone());
            let view = Options::new().with_text("camera", "endoscope");
            let request = request.autoreset(Autoreset::SameStep).view(view);
            requests.push(ControlRequest::OpenSession { request, client: client.clone() });
        }
    }
    requests
}

fn replies() -> Vec<ControlReply> {
    let spec = REGISTRY.spec("EcmReach-v0", &Options::new()).expect("a task");
    let info = SessionInfo {
        session: 1,
        epoch: 2,
        slot: 3,
        envs: 4,
        spec: spec.clone(),
        view: None,
        live: None,
    };
    vec![
        ControlReply::Hello(ADMISSION.info().clone()),
        ControlReply::ListTasks(REGISTRY.ids().map(str::to_string).collect()),
        ControlReply::DescribeTask(spec.into()),
        ControlReply::OpenSession(info.into()),
        ControlReply::Shutdown(()),
        ControlReply::Refused(Rejection::new(Code::Malformed, "field", 1, "allowed")),
        ControlReply::ExportSnapshot(vec![1, 2, 3]),
        ControlReply::ImportSnapshot(4),
        ControlReply::Recorded((vec![1, 2], 3)),
        ControlReply::Viewer(([127, 0, 0, 1], 80).into()),
    ]
}
