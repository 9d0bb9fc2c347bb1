//! Pictures through a session: the bits of the environment in-process, for every camera and kind.

use trocar_client::{Autoreset, Options, SessionRequest};
use trocar_proto::{Code, OptionValue};
use trocar_server::Registry;
use trocar_server::env::Pictures;

use crate::harness::Server;

const SIZE: [f64; 2] = [24.0, 40.0];

fn options(kinds: &[&str], camera: &str) -> Options {
    let words =
        |words: &[&str]| OptionValue::Texts(words.iter().map(ToString::to_string).collect());
    Options::new()
        .with("observation", words(kinds))
        .with("image_size", OptionValue::Numbers(SIZE.to_vec()))
        .with_text("camera", camera)
}

/// A row of an array of a reply.
fn row<T: Copy>(array: &[T], rows: usize, row: usize) -> Vec<T> {
    let width = array.len() / rows;
    array[row * width..][..width].to_vec()
}

#[test]
fn pictures_have_the_same_bits_in_process_and_through_a_session() {
    const ENVS: usize = 3;
    let server = Server::start();
    let everything = ["state", "rgb", "depth", "mask", "points"];
    for (task, kinds, camera) in [
        ("NeedlePick-v0", everything.as_slice(), "endoscope"),
        ("PegTransfer-v0", &["rgb", "points"], "stereo"),
        ("StaticTrack-v0", &["state", "mask"], "overview"),
        ("ActiveTrack-v0", &["perceived", "rgb"], "endoscope"),
        ("GauzeRetrieve-v0", &["rgb", "depth", "points"], "placed"),
    ] {
        let options = options(kinds, camera);
        let request = SessionRequest::new(task).envs(ENVS as u32).seed(7).options(options.clone());
        let mut session = server.open(&request);
        let registry = Registry::builtin();
        assert_eq!(*session.spec(), registry.spec(task, &options).unwrap());
        let mut twins = vec![registry.make(task, &options).unwrap(); ENVS];
        let mut reply = session.reset().unwrap();
        for (index, twin) in twins.iter_mut().enumerate() {
            twin.reset(Some(7 + index as u64));
        }
        for step in 0..4 {
            for (index, twin) in twins.iter().enumerate() {
                let found = Pictures {
                    rgb: row(reply.rgb(), ENVS, index),
                    depth: row(reply.depth(), ENVS, index),
                    mask: row(reply.mask(), ENVS, index),
                    points: row(reply.points(), ENVS, index),
                };
                assert!(found == Pictures::of(twin), "{task} {camera} {index} after {step}");
            }
            let actions = reply.expert_action().to_vec();
            drop(reply);
            reply = session.step(&actions).unwrap();
            let dim = session.spec().action_dim();
            for (twin, action) in twins.iter_mut().zip(actions.chunks_exact(dim)) {
                twin.step(action).unwrap();
            }
        }
    }
}

#[test]
fn the_last_pictures_of_an_episode_survive_a_same_step_autoreset() {
    let server = Server::start();
    let options = options(&["state", "rgb", "mask"], "endoscope");
    let request = SessionRequest::new("EcmReach-v0")
        .seed(3)
        .options(options.clone())
        .autoreset(Autoreset::SameStep);
    let mut session = server.open(&request);
    let mut twin = Registry::builtin().make("EcmReach-v0", &options).unwrap();
    twin.reset(Some(3));
    let mut actions = session.reset().unwrap().expert_action().to_vec();
    loop {
        let step = twin.step(&actions).unwrap();
        let reply = session.step(&actions).unwrap();
        if step.truncated {
            let last = Pictures::of(&twin);
            assert!(reply.final_rgb() == last.rgb && reply.final_mask() == last.mask);
            twin.reset(None);
            let first = Pictures::of(&twin);
            assert!(reply.rgb() == first.rgb && first.rgb != last.rgb);
            return;
        }
        actions = reply.expert_action().to_vec();
    }
}

#[test]
fn sizes_and_cameras_that_are_not_there_are_refused_by_name() {
    let server = Server::start();
    let client = server.connect();
    let rgb = options(&["rgb"], "endoscope");
    for (field, value) in [
        (
            "options.image_size",
            rgb.clone().with("image_size", OptionValue::Numbers(vec![12.5, 64.0])),
        ),
        (
            "options.image_size",
            rgb.clone().with("image_size", OptionValue::Numbers(vec![4.0, 64.0])),
        ),
        ("options.image_size", rgb.clone().with("image_size", OptionValue::Numbers(vec![64.0]))),
        ("options.camera", rgb.clone().with_text("camera", "ceiling")),
        (
            "options.camera_eye",
            rgb.clone()
                .with_text("camera", "placed")
                .with("camera_eye", OptionValue::Numbers(vec![0.5; 3]))
                .with("camera_target", OptionValue::Numbers(vec![0.5; 3])),
        ),
        ("options.camera_view", rgb.clone().with("camera_view", OptionValue::Number(180.0))),
        ("options.observation", options(&["perceived"], "endoscope")),
        ("options.observation", options(&["rgb", "smell"], "endoscope")),
    ] {
        let request = SessionRequest::new("NeedleReach-v0").options(value);
        let refused = client.open(&request).unwrap_err();
        let refused = match refused {
            trocar_client::CallError::Refused(refused) => refused,
            other => panic!("{other}"),
        };
        assert_eq!((refused.code, refused.field.as_str()), (Code::InvalidOption, field));
    }
}
