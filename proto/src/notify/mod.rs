//! How a server and its clients tell each other that a message is there, and where they sleep until then.
//!
//! | module | holds |
//! |---|---|
//! | [`doorbell`] | clients to server: which sessions have sent something |
//! | [`reply_event`] | server to client: the replies of one session, as an [`event_count`] |
//! | [`spin_wait`] | waiting awake before sleeping |
//! | [`futex`] | sleeping on a word in shared memory |
//! | `platform.rs` | the atomics and futexes that both protocols are written for: Linux, and the model of `loom` |
//! | `shm.rs` | words in a file that several processes map |
//!
//! Both protocols have one shape. A *producer* publishes, then looks whether the other side sleeps. A *sleeper*
//! announces that it sleeps, then looks whether something was published:
//!
//! | producer | sleeper |
//! |---|---|
//! | 1. stores what it publishes | 1. stores the announcement |
//! | 2. `fence(SeqCst)` | 2. `fence(SeqCst)` |
//! | 3. loads the announcement, and wakes the sleeper if there is one | 3. loads what is published, and does not sleep if there is something |
//!
//! The two fences are ordered, one before the other. The side whose fence comes second sees the other side's store. So
//! the producer wakes the sleeper, or the sleeper does not sleep: no wake-up is lost. `make test-loom` lets `loom` try
//! every order of these accesses, for two producers and a sleeper, and shows that it finds the loss where a fence is
//! missing.
//!
//! Every client of a server can write to these words. A wrong word costs time and nothing else: a bit says that a
//! message may be there and not that one is, and every wait has an end.

pub mod doorbell;
pub mod event_count;
pub mod futex;
mod platform;
pub mod reply_event;
mod shm;
pub mod spin_wait;

#[cfg(feature = "loom")]
pub use platform::{FutexWord, Model, Platform};
