//! The word `scaled` of the option `observation`.

use trocar_proto::scaled::Range;
use trocar_proto::spec::Element;
use trocar_proto::{OptionValue, Options};
use trocar_server::Registry;
use trocar_server::env::Env;

use crate::look;

/// Steps of an episode.
const STEPS: u32 = 12;

fn with_words(words: &[&str]) -> Options {
    let words = words.iter().map(ToString::to_string).collect();
    Options::new().with("observation", OptionValue::Texts(words))
}

fn make(id: &str, words: &[&str]) -> Env {
    Registry::builtin().make(id, &with_words(words)).unwrap()
}

fn check_unscaled(id: &str, scaled: &[f32], plain: &[f32], elements: &[Element]) {
    assert_eq!([scaled.len(), plain.len()], [elements.len(); 2], "{id}");
    for ((scaled, plain), element) in scaled.iter().zip(plain).zip(elements) {
        assert!((-1.0..=1.0).contains(scaled), "{id}: {scaled} of {element:?}");
        let error = (Range::of(element).unscale(*scaled) - plain).abs();
        let largest = element.min.abs().max(element.max.abs()).max(1e-3);
        assert!(error <= 2.0 * f32::EPSILON * largest, "{id}: {error} of {element:?}");
    }
}

#[test]
fn unscaling_returns_the_plain_observation_and_rewards_are_equal() {
    for id in Registry::builtin().ids() {
        for words in [[&["scaled"][..], &["state"]], [&["scaled", "joints"], &["state", "joints"]]]
        {
            let [mut scaled, mut plain] = words.map(|words| make(id, words));
            scaled.reset(Some(3));
            plain.reset(Some(3));
            let mut action = vec![0.0; plain.spec().action_dim()];
            for _ in 0..STEPS {
                let spec = plain.spec();
                let goal: Vec<_> =
                    spec.goal.iter().flat_map(|goal| goal.elements.clone()).collect();
                let ([observation, achieved, desired], seen) = (look(&scaled), look(&plain));
                check_unscaled(id, &observation, &seen[0], &spec.observation);
                check_unscaled(id, &achieved, &seen[1], &goal);
                check_unscaled(id, &desired, &seen[2], &goal);
                plain.expert(&mut action);
                let steps = [&mut scaled, &mut plain].map(|env| env.step(&action).unwrap());
                assert_eq!(steps[0], steps[1], "{id}");
            }
        }
    }
}

#[test]
fn scaled_numbers_beside_relative_features_are_refused() {
    let options = with_words(&["scaled", "relative"]);
    let refused = Registry::builtin().make("NeedlePick-v0", &options).err().unwrap();
    assert_eq!(refused.field, "options.observation");
}
