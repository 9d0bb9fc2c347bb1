//! Why an operation of the transport failed. Its errors name what could not be done (`UnableToCreateDataSegment`), its
//! log names why (the limit of open files was reached), so this keeps what it logs until an error is reported.

use std::cell::RefCell;
use std::fmt;
use std::io::Write as _;
use std::sync::Once;

use iceoryx2::prelude::{LogLevel, set_log_level, set_log_level_from_env_or, set_logger};
use iceoryx2_log_types::Log;

/// Messages that are kept for a thread; of the chain of an error, the first is the cause.
const KEPT: usize = 16;

/// What the transport says where it makes what it looks for.
const EXPECTED: &str = "does not exist";

thread_local! {
    static SAID: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

/// Keeps what the transport logs, by thread.
struct Keeper;

impl Log for Keeper {
    fn log(&self, level: LogLevel, _: fmt::Arguments<'_>, message: fmt::Arguments<'_>) {
        if level == LogLevel::Fatal {
            writeln!(std::io::stderr(), "{message}").ok();
        }
        SAID.with_borrow_mut(|said| {
            if said.len() < KEPT {
                said.push(message.to_string());
            }
        });
    }
}

/// Keeps the transport's log from now on; with `$IOX2_LOG_LEVEL`, it goes to standard error instead.
pub(crate) fn keep() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        if std::env::var_os("IOX2_LOG_LEVEL").is_some() {
            set_log_level_from_env_or(LogLevel::Fatal);
        } else if set_logger(&Keeper) {
            set_log_level(LogLevel::Debug);
        }
    });
}

/// Forgets what was logged on this thread: what is logged from now on is about what is done next.
pub fn forget() {
    SAID.with_borrow_mut(Vec::clear);
}

/// The transport's error, and why it came about, if its log has said so on this thread.
pub fn explain<E: fmt::Debug>(error: &E) -> String {
    match take() {
        Some(cause) => format!("{error:?}: {cause}"),
        None => format!("{error:?}"),
    }
}

/// The first thing that went wrong on this thread since [`forget`], in the transport's words.
pub fn take() -> Option<String> {
    let said = SAID.with_borrow_mut(std::mem::take);
    let cause = said.into_iter().find(|message| !message.contains(EXPECTED))?;
    Some(cause.trim().trim_end_matches('.').to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cause_is_what_went_wrong_first() {
        let say =
            |words: &str| Keeper.log(LogLevel::Debug, format_args!(""), format_args!("{words}"));
        say("an earlier failure");
        forget();
        say("Unable to open shared memory since the shared memory does not exist.");
        say("Unable to create shared memory since the per-process file handle limit was reached.");
        say("Failed to create a port.");
        let said = explain(&"NoPort");
        assert_eq!(
            said,
            "\"NoPort\": Unable to create shared memory since the per-process file handle limit was reached"
        );
        assert_eq!(explain(&"NoPort"), "\"NoPort\"");
        (0..100).for_each(|_| say("once more"));
        assert_eq!(SAID.with_borrow(Vec::len), KEPT);
    }
}
