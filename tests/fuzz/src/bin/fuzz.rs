//! What libFuzzer calls: the target that `FUZZ_TARGET` names.

#![no_main]

use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::Target;

static RUN: OnceLock<fn(&[u8])> = OnceLock::new();

fuzz_target!(
    init: {
        // By default every panic ends the process, also one that is caught and becomes a refusal. One that is
        // not caught in the target ends it still.
        drop(std::panic::take_hook());
        let name = std::env::var("FUZZ_TARGET").expect("FUZZ_TARGET names a target");
        let target = Target::named(&name);
        // What is made once is no input's coverage.
        (target.seeds)();
        RUN.get_or_init(|| target.run);
    },
    |data: &[u8]| RUN.get().expect("it was initialised")(data)
);
