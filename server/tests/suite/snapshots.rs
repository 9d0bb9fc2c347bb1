//! An episode goes on from a snapshot as it did, in a clone and from bytes; bytes of others are refused.

use trocar_proto::snapshot::Recipe;
use trocar_proto::{Code, Options};
use trocar_server::Registry;
use trocar_server::env::Env;

use super::{
    Actions, Seen, begin_anew_where_it_ended, domain, is_slow, make, soak, tasks, towards_the_goal,
    variants,
};

#[test]
fn a_snapshot_goes_on_bit_by_bit_like_the_original_as_clone_and_as_bytes() {
    let mut variants = variants();
    variants.extend(tasks().map(domain::everything));
    let prepared = |id: &&str| {
        Registry::builtin().make(id, &Options::new().with_text("start", "lift")).is_ok()
    };
    variants.extend(Registry::builtin().ids().filter(prepared).map(|id| {
        let (id, options) = domain::everything(id);
        (id, options.with_text("start", "lift"))
    }));
    for variant in variants {
        let fresh = make(&variant);
        let seeds = if is_slow(&variant.0) { 1..2 } else { 0..2 };
        for seed in if soak() { 0..40 } else { seeds } {
            let mut env = fresh.clone();
            env.reset(Some(seed));
            let mut actions = Actions::new(seed);
            if seed % 2 == 1 {
                env.reset(None);
            }
            // From the first state to the last, at random.
            for _ in 0..actions.0.index(env.spec().max_steps as usize + 1) {
                env.step(&towards_the_goal(&mut actions, &env)).unwrap();
                begin_anew_where_it_ended(&mut env);
            }
            let bytes = env.export().unwrap();
            let mut copies = vec![env.clone(), fresh.import(&bytes).unwrap()];
            assert_eq!(copies[1].export().unwrap(), bytes);
            // Every second time into the next episode.
            for _ in 0..25 {
                assert_eq!(Seen::of(&env).bits(), Seen::of(&copies[0]).bits(), "{variant:?}");
                assert_eq!(Seen::of(&env).bits(), Seen::of(&copies[1]).bits(), "{variant:?}");
                if env.needs_reset() {
                    env.reset(None);
                    for copy in &mut copies {
                        copy.reset(None);
                    }
                    continue;
                }
                let action = towards_the_goal(&mut actions, &env);
                let step = env.step(&action).unwrap();
                for copy in &mut copies {
                    assert_eq!(copy.step(&action).unwrap(), step);
                }
            }
        }
    }
}

#[test]
fn a_held_object_is_held_in_its_snapshots() {
    // The expert's last state: with the object in the jaws, where there is one.
    let registry = Registry::builtin();
    let plain = tasks().map(|id| (id.to_string(), Options::new()));
    let ends = registry.ids().filter(|id| !is_slow(id)).map(domain::ends_of_objects);
    for variant in plain.chain(ends) {
        let fresh = make(&variant);
        let mut env = fresh.clone();
        env.reset(Some(3));
        while env.steps() + 8 < env.spec().max_steps {
            env.step(&Seen::of(&env).expert).unwrap();
        }
        let mut copies = vec![env.clone(), fresh.import(&env.export().unwrap()).unwrap()];
        while !env.needs_reset() {
            let action = Seen::of(&env).expert;
            let step = env.step(&action).unwrap();
            for copy in &mut copies {
                assert_eq!(copy.step(&action).unwrap(), step);
                assert_eq!(Seen::of(copy).bits(), Seen::of(&env).bits(), "{variant:?}");
            }
        }
    }
}

/// Something that is done to a recipe.
type Change = fn(&mut Recipe);

#[test]
fn bytes_that_are_not_of_this_task_and_these_options_are_refused_by_name() {
    let registry = Registry::builtin();
    let options = Options::new().with_text("action", "joint");
    for id in registry.ids() {
        let mut env = registry.make(id, &Options::new()).unwrap();
        assert_eq!(env.export().unwrap_err().code, Code::ResetNeeded);
        env.reset(Some(1));
        env.step(&vec![0.5; env.spec().action_dim()]).unwrap();
        let bytes = env.export().unwrap();
        let refuse = |env: &Env, bytes: &[u8]| env.import(bytes).err().unwrap();
        let refusal = refuse(&registry.make(id, &options).unwrap(), &bytes);
        assert_eq!(refusal.code, Code::InvalidSnapshot);
        assert_eq!(refusal.field, "snapshot.options.action", "{refusal}");
        for other in registry.ids().filter(|other| *other != id) {
            let refusal = refuse(&registry.make(other, &Options::new()).unwrap(), &bytes);
            assert_eq!(refusal.field, "snapshot.task", "{refusal}");
            assert!(refusal.to_string().contains(id) && refusal.to_string().contains(other));
        }
        let mut recipe = Recipe::from_bytes(&bytes).unwrap();
        recipe.fingerprint ^= 1;
        assert_eq!(refuse(&env, &recipe.to_bytes().unwrap()).field, "snapshot.fingerprint");
        let good = Recipe::from_bytes(&bytes).unwrap();
        // One number more is one step more where an action is one number.
        let whole = env.spec().action_dim() == 1;
        let one_more = if whole { "snapshot.fingerprint" } else { "snapshot.actions" };
        let changes: [(&str, Change); 4] = [
            ("snapshot.version", |recipe| recipe.version.push('0')),
            (one_more, |recipe| recipe.actions.push(0.0)),
            ("snapshot.actions", |recipe| recipe.actions[0] = f32::NAN),
            ("snapshot.actions", |recipe| recipe.actions = vec![0.0; 12_000]),
        ];
        for (field, change) in changes {
            let mut recipe = good.clone();
            change(&mut recipe);
            let refusal = refuse(&env, &recipe.to_bytes().unwrap());
            assert_eq!((refusal.code, refusal.field.as_str()), (Code::InvalidSnapshot, field));
        }
    }
}
