//! Hostile control messages, judged in-process, and hostile snapshots: none of them panics, and
//! memory does not grow. 50,000 messages and 5,000 snapshots, or 1,000,000 and 100,000 where
//! `TROCAR_SOAK` is set.

mod mutation;

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

use mutation::Mutator;
use trocar_proto::control::ControlRequest;
use trocar_proto::part::fingerprint;
use trocar_proto::snapshot::Recipe;
use trocar_proto::{Options, Rejection};
use trocar_server::Registry;
use trocar_server::service::{Admission, Admitted, Footprint, ServerConfig, Usage};

/// Messages after which whatever is allocated once has been.
const WARM_UP: usize = 10_000;

/// Growth that the allocator's own bookkeeping may cause, bytes.
const SLACK: usize = 8 << 20;

#[test]
fn hostile_control_messages_neither_panic_nor_take_memory() {
    let count = if std::env::var_os("TROCAR_SOAK").is_some() { 1_000_000 } else { 50_000 };
    let registry = Registry::builtin();
    let ids: Vec<String> = registry.ids().map(str::to_string).collect();
    let ids: Vec<&str> = ids.iter().map(String::as_str).collect();
    let mut mutator = Mutator::new(20_261_121, &ids);
    let config = ServerConfig::new("fuzz".parse().unwrap());
    let registry = Arc::new(registry);
    let admission = Admission::new(Arc::clone(&registry), &config, 1);

    let (mut refused, mut described, mut opened, mut warm) = (0, 0, 0, 0);
    for index in 0..count {
        let message = mutator.next();
        let judged = catch_unwind(AssertUnwindSafe(|| {
            let memory = Footprint { shared: index as u64 % (1 << 31), private: 0 };
            let usage = Usage { memory, sessions: index % 600, ..Usage::default() };
            let checked = admission.check(&message.header, &message.bytes, &usage)?;
            if let ControlRequest::DescribeTask { task, options } = &checked.request {
                registry.spec(task, options)?;
            }
            Ok::<_, Rejection>(checked)
        }));
        match judged {
            Ok(Err(refusal)) => {
                assert!(!refusal.field.is_empty() && !refusal.allowed.is_empty(), "{refusal:?}");
                refused += 1;
            }
            Ok(Ok(Admitted { request, .. })) => match request {
                ControlRequest::DescribeTask { .. } => described += 1,
                ControlRequest::OpenSession { .. } => opened += 1,
                _ => {}
            },
            Err(panic) => {
                eprintln!("message {index} made the server panic: {message:?}");
                resume_unwind(panic);
            }
        }
        if index == WARM_UP {
            warm = resident_bytes();
        }
    }
    // Messages that never get past the first check would test nothing.
    let enough = refused > count / 10 && described > count / 200 && opened > count / 200;
    assert!(enough, "{refused} refused, {described} described, {opened} opened");
    let grown = resident_bytes().saturating_sub(warm);
    assert!(grown < SLACK, "memory grew by {grown} bytes");
}

#[test]
fn hostile_snapshots_neither_panic_nor_become_other_states() {
    let count = if std::env::var_os("TROCAR_SOAK").is_some() { 100_000 } else { 5_000 };
    let registry = Registry::builtin();
    let mut mutator = Mutator::new(99, &["EcmReach-v0"]);
    let mut env = registry.make("EcmReach-v0", &Options::new()).expect("a registered task");
    env.reset(Some(5));
    env.step(&[0.5, -0.25, 1.0]).expect("a good action");
    let bytes = env.export().expect("it was reset");
    let good = Recipe::from_bytes(&bytes).expect("it was just written");
    let mut refused = [0, 0];
    for index in 0..count {
        // Half of them carry a good checksum, as an attacker's would.
        let changed = mutator.change(&bytes);
        let sealed = index % 2 == 1;
        let changed = if sealed { seal(&changed) } else { changed };
        match catch_unwind(AssertUnwindSafe(|| env.import(&changed))) {
            Ok(Ok(imported)) => {
                // What is taken is a state that actions lead to.
                let recipe = Recipe::from_bytes(&changed).expect("it was taken");
                let told = (imported.seed(), imported.episode(), imported.steps() as usize);
                assert_eq!(told, (recipe.seed, recipe.episode, recipe.actions.len() / 3));
                assert_eq!(recipe.fingerprint, good.fingerprint);
            }
            Ok(Err(refusal)) => {
                assert!(!refusal.field.is_empty() && !refusal.allowed.is_empty(), "{refusal:?}");
                refused[usize::from(sealed)] += 1;
            }
            Err(panic) => {
                eprintln!("snapshot {index} made the server panic: {changed:?}");
                resume_unwind(panic);
            }
        }
    }
    assert!(refused.iter().all(|refused| *refused > count / 4), "{refused:?}");
}

/// The same bytes with the length and the checksum that fit them.
fn seal(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    if let Some((head, body)) = bytes.split_at_mut_checked(24) {
        head[12..16].copy_from_slice(&(body.len() as u32).to_le_bytes());
        head[16..].copy_from_slice(&fingerprint(body.iter().copied()).to_le_bytes());
    }
    bytes
}

/// Memory of this process, bytes.
fn resident_bytes() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").expect("Linux has it");
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kibibytes = line.and_then(|line| line.trim().strip_suffix(" kB")?.parse::<usize>().ok());
    kibibytes.expect("it says how many kB are resident") << 10
}
