//! Tests that need a server and clients in processes of their own.
//!
//! | file | what it tests |
//! |---|---|
//! | `harness.rs` | starts servers and clients under unique names, ends them, looks for remains |
//! | `rows.rs` | what one environment showed after one message, as bits; actions by seed |
//! | `twin.rs` | the same environments in-process |
//! | `conformance.rs` | one suite on in-process environments and on a remote session |
//! | `parity.rs` | same seed and actions, same bits, however it is run |
//! | `lifecycle.rs` | whichever process is killed or stopped, the others go on and nothing is left |
//! | `live.rs` | live worlds: what dVRK's test scripts do, shared memory against in-process, two clients, bad input |
//! | `images.rs` | pictures through a session |
//! | `refusals.rs` | bad input is refused by name, and harms no other client |
//! | `snapshots.rs` | snapshot, restore, fork; bytes that go to another server |
//! | `placement.rs` | episodes that a reset arranges |
//! | `reconnect.rs` | sessions that survive the loss of their server |
//! | `operation.rs` | quotas, metrics, logs, an end in order |
//! | `view.rs` | the live viewer |
//! | `faults.rs` | calls of the kernel fail, one after the other |
//! | `filled.rs` | another program fills shared memory, at any moment |
//! | `fuzz.rs` | hostile bytes sent to a running server |
//! | `rubbish.rs` | rubbish in what a server shares with its clients |
//! | `namespaces.rs` | server and client in separate process namespaces |
//! | `dependencies.rs` | which crates may depend on what |
//!
//! Every test starts its own server, waits under a watchdog, and finds nothing left at its end.

#![expect(clippy::unwrap_used, reason = "a panic is a test's report, in its helpers too")]

mod conformance;
mod dependencies;
mod faults;
mod filled;
mod fuzz;
mod harness;
mod images;
mod lifecycle;
mod live;
mod live_scripts;
mod live_states;
mod namespaces;
mod operation;
mod parity;
mod placement;
mod reconnect;
mod refusals;
mod resources;
mod rows;
mod rubbish;
mod snapshots;
mod twin;
mod view;
