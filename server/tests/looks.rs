//! What tissue looks like, and the light of a cavity.

use std::sync::Arc;

use nalgebra::Vector3;
use trocar_proto::{Code, OptionValue, Options};
use trocar_server::env::Pictures;
use trocar_server::recording::{self, Recorder};
use trocar_server::render::material::{self, Material};
use trocar_server::render::mesh::Mesh;
use trocar_server::render::{Lens, Look, Renderer, Scene, Software, Viewpoint};
use trocar_server::sim::frames::{self, Aabb, Pose};
use trocar_server::sim::random::Rng;
use trocar_server::sim::soft::{self, Form, Skin, SoftBody, box_distance};
use trocar_server::sim::world::{Solver, World};
use trocar_server::{Env, Registry};

const PIXELS: usize = 96;

/// The picture of a sheet of fat at `place` in an episode, from above, in the same light from all sides.
fn sheet(place: [f64; 3], episode: u64) -> Vec<u8> {
    let half = Vector3::new(0.02, 0.02, 4e-3);
    let bounds = Aabb { min: -half, max: half };
    let fat = soft::Material::named("fat").unwrap();
    let form = Form::carved(&bounds, 4e-3, fat, box_distance(&half)).unwrap();
    let skin = Skin::new(&form, &bounds, 2e-3, box_distance(&half));
    let mut world = World::new(Solver::LIGHT);
    let at = frames::pose(place, [0.0; 3]);
    world.insert_soft(SoftBody::new(
        "fat",
        [0.93, 0.78, 0.42],
        Arc::new(form),
        Arc::new(skin),
        &at,
    ));
    let mut scene = Scene::default();
    scene.add_others(&world, &mut Rng::appearance(1, episode));
    let eye = Vector3::from(place) + Vector3::new(0.0, 0.01, 0.06);
    scene.overview = Viewpoint::towards(eye.into(), place, 0.6);
    scene.light.lamp = [0.0; 3];
    scene.light.ground = scene.light.sky;
    let camera = scene.camera(Lens::Overview, PIXELS, PIXELS).unwrap();
    Software::default().picture(&scene, &camera).rgb
}

/// Part of the pixels that differ by more than rounding.
fn different(one: &[u8], other: &[u8]) -> f64 {
    let pixels = one.chunks(3).zip(other.chunks(3));
    let differs = |(a, b): (&[u8], &[u8])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 3);
    pixels.filter(|pair| differs(*pair)).count() as f64 / (PIXELS * PIXELS) as f64
}

#[test]
fn colours_move_with_the_tissue_and_each_episode_has_its_own() {
    let first = sheet([0.0; 3], 0);
    assert_eq!(first, sheet([0.0; 3], 0));
    assert!(different(&first, &sheet([0.013, -0.007, 0.02], 0)) < 0.01);
    assert!(different(&first, &sheet([0.0; 3], 1)) > 0.3);
    let mut colours: Vec<_> = first.chunks(3).collect();
    colours.sort_unstable();
    colours.dedup();
    assert!(colours.len() > 500, "{} colours", colours.len());
}

/// The light that a card sends back that the endoscope sees at this distance, m; and what is beside it.
fn card(look: Look, distance: f64) -> [f32; 2] {
    let mut scene = Scene::default();
    scene.endoscope = Some(Viewpoint::towards([0.0; 3], [1.0, 0.0, 0.0], 1.0));
    scene.begin("card");
    let mesh = Mesh::cuboid(&Vector3::new(1e-3, 0.02, 0.02));
    let grey = Material::named("foam").coloured([0.6; 3]);
    scene.draw(Arc::new(mesh), Pose::translation(distance + 1e-3, 0.0, 0.0), grey);
    scene.set_look(look);
    let camera = scene.camera(Lens::Endoscope, PIXELS, PIXELS).unwrap();
    let rgb = Software::default().picture(&scene, &camera).rgb;
    let light = |pixel: usize| material::linear(f32::from(rgb[3 * pixel]) / 255.0);
    [light(PIXELS * PIXELS / 2 + PIXELS / 2), light(0)]
}

#[test]
fn the_lamp_at_the_endoscope_falls_with_the_square_of_the_distance() {
    let [[near, dark], [far, _]] = [0.16, 0.32].map(|distance| card(Look::Cavity, distance));
    let mean = |[one, other]: [f32; 2]| one / other;
    assert!((3.0..4.2).contains(&mean([near, far])), "{near} and {far}");
    assert!(near > 0.25 && dark < 0.02, "{near} on the card, {dark} beside it");
    let [bench, beside] = card(Look::Bench, 0.16);
    assert!((card(Look::Bench, 0.32)[0] / bench - 1.0).abs() < 0.05 && beside > 0.5);
}

fn env(id: &str, look: &str) -> Env {
    let observation = ["state", "rgb", "mask"].map(String::from).to_vec();
    let options = Options::new()
        .with("observation", OptionValue::Texts(observation))
        .with("image_size", OptionValue::Numbers(vec![32.0, 32.0]))
        .with("look", OptionValue::Text(look.into()));
    let mut env = Registry::builtin().make(id, &options).unwrap();
    env.reset(Some(3));
    env
}

#[test]
fn every_task_has_a_cavity_that_changes_its_colours_and_nothing_else() {
    for id in Registry::builtin().ids() {
        let [bench, cavity] = ["bench", "cavity"].map(|look| env(id, look));
        assert!(bench.world().bits().eq(cavity.world().bits()), "{id}");
        let [bench, cavity] = [bench, cavity].map(|env| Pictures::of(&env));
        assert_eq!(bench.mask, cavity.mask, "{id}");
        let light = |pictures: &Pictures| pictures.rgb.iter().map(|byte| u64::from(*byte)).sum();
        let [bench, cavity]: [u64; 2] = [light(&bench), light(&cavity)];
        assert!(cavity > 0 && cavity < bench, "{id}: {bench} and {cavity}");
    }
}

#[test]
fn other_looks_are_refused_by_name_and_recordings_keep_theirs() {
    let night = Options::new().with("look", OptionValue::Text("night".into()));
    let refusal = Registry::builtin().make("NeedleReach-v0", &night).err().unwrap();
    assert_eq!((refusal.code, refusal.field.as_str()), (Code::InvalidOption, "options.look"));
    assert!(refusal.to_string().contains("cavity"), "{refusal}");

    let mut env = env("NeedleReach-v0", "cavity");
    let (mut recorder, mut bytes) = (Recorder::new(10), vec![]);
    env.step(&vec![0.0; env.spec().action_dim()]).unwrap();
    bytes.extend(recorder.after_step(&env).into_iter().flatten());
    bytes.extend(recorder.before_leaving(&env).into_iter().flatten());
    let courses = recording::read(&bytes).unwrap();
    assert_eq!(courses[0].options().text("look"), Some("cavity"));
}
