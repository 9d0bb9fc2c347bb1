//! Hostile control messages, judged in-process: none of them panics, and memory does not grow.
//! 50,000 messages, or 1,000,000 where `TROCAR_SOAK` is set.

mod mutation;

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

use mutation::Mutator;
use trocar_proto::control::ControlReply;
use trocar_server::service::{Answer, Desk, Footprint, ServerConfig};
use trocar_server::tasks::Registry;

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
    let desk = Desk::new(Arc::new(registry), &config, 1);

    let (mut refused, mut described, mut opened, mut warm) = (0, 0, 0, 0);
    for index in 0..count {
        let message = mutator.next();
        let judged = catch_unwind(AssertUnwindSafe(|| {
            let used = Footprint { shared: index as u64 % (1 << 31), private: 0 };
            desk.judge(&message.header, &message.bytes, used, index % 600)
        }));
        match judged {
            Ok(Answer::Reply(ControlReply::Refused(refusal))) => {
                assert!(!refusal.field.is_empty() && !refusal.allowed.is_empty(), "{refusal:?}");
                refused += 1;
            }
            Ok(Answer::Reply(ControlReply::Task(_))) => described += 1,
            Ok(Answer::Open { .. }) => opened += 1,
            Ok(_) => {}
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

/// Memory of this process, bytes.
fn resident_bytes() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").expect("Linux has it");
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kibibytes = line.and_then(|line| line.trim().strip_suffix(" kB")?.parse::<usize>().ok());
    kibibytes.expect("it says how many kB are resident") << 10
}
