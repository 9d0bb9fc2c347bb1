//! Snapshots: bytes, their decoding, and the state that comes of them.

use std::sync::LazyLock;

use trocar_proto::part::{self, Kind, fingerprint};
use trocar_proto::snapshot::Recipe;
use trocar_proto::{Options, PROTOCOL_VERSION, Placement};
use trocar_server::{Env, Registry};

use crate::control::{check, encode};
use crate::input::Input;

/// Most actions before a snapshot is taken.
const MOST_ACTIONS: usize = 12;

/// An environment of every task, and some under options that change what an action is.
static ENVS: LazyLock<Vec<Env>> = LazyLock::new(|| {
    let registry = Registry::builtin();
    let plain = registry.ids().map(|id| (id, Options::new()));
    let others = ["cartesian", "cartesian_abs", "joint"].map(|action| {
        ("NeedlePick-v0", Options::new().with_text("action", action).with_text("reward", "dense"))
    });
    let make = |(id, options): (&str, Options)| registry.make(id, &options).expect("a task");
    plain.chain(others).map(make).collect()
});

/// A byte that says which environment, one that says how the rest is read, and the rest.
pub(crate) fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let env = &ENVS[input.byte() as usize % ENVS.len()];
    match input.byte() % 3 {
        0 => import(env, input.rest()),
        1 => import(env, &seal(Kind::Snapshot, input.rest())),
        _ => play(env.clone(), input),
    }
}

/// What is taken is a state that is exported as these bytes say.
fn import(env: &Env, bytes: &[u8]) {
    if let Ok(parts) = part::split(bytes) {
        assert_eq!(parts.concat(), bytes);
    }
    match env.import(bytes) {
        Ok(imported) => {
            let recipe = Recipe::from_bytes(bytes).expect("it was taken");
            assert_eq!(imported.export(), recipe.to_bytes());
        }
        Err(refusal) => check(&refusal),
    }
}

/// Plays an episode, exports its state, and imports it as it is and changed.
fn play(mut env: Env, mut input: Input<'_>) {
    env.reset_to(input.u64(), input.u64());
    if let Err(refusal) = env.arrange(&placement(&env, &mut input)) {
        check(&refusal);
    }
    let (at, flip) = (input.u16() as usize, input.byte());
    let mut action = vec![0.0; env.spec().action_dim()];
    for _ in 0..MOST_ACTIONS {
        if input.is_empty() || env.needs_reset() {
            break;
        }
        action.fill_with(|| input.unit());
        env.step(&action).ok();
    }
    let bytes = env.export().expect("it was reset");
    let again = env.import(&bytes).expect("it was exported");
    assert_eq!(again.export().as_ref(), Ok(&bytes));
    let mut body = bytes[HEAD..].to_vec();
    let at = at % body.len();
    body[at] ^= flip;
    import(&env, &seal(Kind::Snapshot, &body));
}

/// Objects, goal and tip at some place of the workspace, each where a bit asks for it.
fn placement(env: &Env, input: &mut Input<'_>) -> Placement {
    let asked = input.byte();
    let mut place = |middle: &[f64]| -> Vec<f64> {
        middle.iter().map(|middle| middle + 0.1 * f64::from(input.unit())).collect()
    };
    let mut placement = Placement::default();
    for ((name, pose), bit) in env.objects().zip(2..8) {
        if asked & 1 << bit != 0 {
            let middle = pose.translation.vector;
            placement.objects.insert(name.into(), place(middle.as_slice()));
        }
    }
    if asked & 1 != 0 {
        placement.goal = Some(place(&[0.55, 0.0, 0.7]));
    }
    if asked & 2 != 0 {
        placement.tip = Some(place(&[0.55, 0.0, 0.7]));
    }
    placement
}

/// Bytes before a part's body.
const HEAD: usize = 24;

/// A part of a kind with this body, whose head fits it.
pub(crate) fn seal(kind: Kind, body: &[u8]) -> Vec<u8> {
    let mut part = kind.magic().to_vec();
    part.extend(PROTOCOL_VERSION.to_le_bytes());
    part.extend((body.len() as u32).to_le_bytes());
    part.extend(fingerprint(body.iter().copied()).to_le_bytes());
    part.extend(body);
    part
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = vec![];
    for (number, env) in (0..).zip(ENVS.iter()) {
        let mut env = env.clone();
        env.reset(Some(3));
        let action = vec![0.5; env.spec().action_dim()];
        env.step(&action).ok();
        let bytes = env.export().expect("it was reset");
        let recipe = Recipe::from_bytes(&bytes).expect("it was exported");
        let body = encode(&recipe).expect("it is short");
        seeds.push([vec![number, 0], bytes].concat());
        seeds.push([vec![number, 1], body].concat());
        seeds.push([vec![number, 2], vec![0; 16], vec![number, 100, 5, 1], vec![64; 24]].concat());
    }
    seeds
}
