//! The command line, in one program; `load.rs` is another, since it should have the machine to itself.

#![allow(clippy::unwrap_used)] // a panic is a test's report

mod command;
mod demos;
mod documents;
mod films;
mod network;
mod pictures;
mod recordings;
