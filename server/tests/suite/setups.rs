//! Arms whose bases stand elsewhere do the same work.

use trocar_proto::Options;
use trocar_server::Registry;

use super::{Row, Seen, make, soak, table};

#[test]
fn a_moved_arm_shows_and_does_the_same() {
    let setups: [(&str, &[Row]); 8] = [
        ("NeedleReach-v0", &[("table_height", &[0.67])]),
        ("NeedleReach-v0", &[("base", &[0.06, 0.25, 0.845, -1.9]), ("table_height", &[0.672])]),
        ("NeedlePick-v0", &[("table_height", &[0.67])]),
        ("GauzeRetrieve-v0", &[("table_height", &[0.67])]),
        ("PegTransfer-v0", &[("table_height", &[0.67])]),
        ("BiPegTransfer-v0", &[("base_2", &[0.06, -0.235, 0.85, -1.25])]),
        ("NeedleRegrasp-v0", &[("base", &[0.055, 0.235, 0.85, -1.9]), ("table_height", &[0.673])]),
        ("EcmReach-v0", &[("base", &[-0.04, 0.01, 1.01, 0.5])]),
    ];
    let models = ["classic", "si"];
    for ((id, rows), model) in setups.into_iter().flat_map(|setup| models.map(|it| (setup, it))) {
        let nominal = Options::new().with_text("arm", model);
        let moved = nominal.clone().with("setup", table(rows));
        let [mut moved, mut nominal] =
            [moved, nominal].map(|options| Registry::builtin().make(id, &options).unwrap());
        // A block that is pressed onto the board moves the arm, and a needle between two pairs of jaws moves both,
        // by up to 2.5 mm. Rounding moves block and needle.
        let tolerance = match id {
            "PegTransfer-v0" | "BiPegTransfer-v0" => 1e-3,
            "NeedleRegrasp-v0" => 3e-3,
            _ => 1e-5,
        };
        for seed in 0..if soak() { 20 } else { 5 } {
            moved.reset(Some(seed));
            nominal.reset(Some(seed));
            for _ in 0..50 {
                let (there, here) = (Seen::of(&moved), Seen::of(&nominal));
                for (a, b) in there.observation[..3].iter().zip(&here.observation[..3]) {
                    assert!((a - b).abs() < tolerance, "{id} {model}: {there:?} for {here:?}");
                }
                moved.step(&here.expert).unwrap();
                nominal.step(&here.expert).unwrap();
            }
            let seen = Seen::of(&moved);
            assert!(moved.spec().is_success(&seen.achieved, &seen.desired));
        }
    }
}

#[test]
fn a_moved_endoscope_still_levels_and_centres() {
    let base = table(&[("base", &[-0.03, 0.02, 1.02, 0.55])]);
    let options = Options::new().with("setup", base);
    for (id, model) in [
        ("MisOrient-v0", "classic"),
        ("MisOrient-v0", "si"),
        ("StaticTrack-v0", "classic"),
        ("StaticTrack-v0", "si"),
    ] {
        let options = options.clone().with_text("arm", model);
        let mut env = Registry::builtin().make(id, &options).unwrap();
        for seed in 0..20 {
            env.reset(Some(seed));
            let mut step = env.step(&Seen::of(&env).expert).unwrap();
            while !env.needs_reset() {
                step = env.step(&Seen::of(&env).expert).unwrap();
            }
            assert!(step.is_success, "{id} {model}: {seed}");
        }
    }
}

#[test]
fn the_si_works_from_where_the_classic_does_not_reach() {
    let high = table(&[("base", &[0.05, 0.24, 0.90, -1.92])]);
    let options = Options::new().with("setup", high);
    let classic = Registry::builtin().make("NeedlePick-v0", &options);
    assert_eq!(classic.err().unwrap().field, "options.setup");
    let mut env = make(&("NeedlePick-v0".into(), options.with_text("arm", "si")));
    for seed in 0..10 {
        env.reset(Some(seed));
        let mut step = env.step(&Seen::of(&env).expert).unwrap();
        while !env.needs_reset() {
            step = env.step(&Seen::of(&env).expert).unwrap();
        }
        assert!(step.is_success, "{seed}");
    }
}
