//! Replays kept inputs and seeds of every target, as `make fuzz` found or made them.

use trocar_fuzz::{Target, corpus};

/// Runs every input of a target.
fn replay(name: &str) {
    let target = Target::named(name);
    let (kept, seeds) = (corpus::read(name).expect("it can be read"), (target.seeds)());
    assert!(!seeds.is_empty());
    for input in kept.iter().chain(&seeds) {
        let run = std::panic::catch_unwind(|| (target.run)(input));
        assert!(run.is_ok(), "{name}: {} bytes: {:?}", input.len(), &input[..input.len().min(400)]);
    }
}

macro_rules! replayed {
    ($($name:ident)*) => {$(
        #[test]
        fn $name() {
            replay(stringify!($name));
        }
    )*

        #[test]
        fn every_target_is_replayed() {
            let names = trocar_fuzz::TARGETS.map(|target| target.name);
            assert_eq!(names.as_slice(), [$(stringify!($name)),*]);
        }
    };
}

replayed! { control data live words snapshots recordings urdf policies options }
