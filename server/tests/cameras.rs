//! Cameras of observations as data: what the specification says of them is where they are.

use nalgebra::{Matrix3x4, Point3, Vector3, Vector4};
use trocar_proto::spec::ImageSpec;
use trocar_proto::{Code, OptionValue, Options};
use trocar_server::Env;
use trocar_server::Registry;
use trocar_server::render::Lens;

const SIZE: [usize; 2] = [96, 128];

fn seen_from(camera: &str) -> Options {
    let kinds = ["depth", "mask", "points"].map(String::from);
    Options::new()
        .with("observation", OptionValue::Texts(kinds.to_vec()))
        .with("image_size", OptionValue::Numbers(SIZE.map(|pixels| pixels as f64).to_vec()))
        .with_text("camera", camera)
}

fn placed(eye: [f64; 3], target: [f64; 3], view: f64) -> Options {
    seen_from("placed")
        .with("camera_eye", OptionValue::Numbers(eye.to_vec()))
        .with("camera_target", OptionValue::Numbers(target.to_vec()))
        .with("camera_view", OptionValue::Number(view))
}

fn env(id: &str, options: &Options) -> Env {
    let mut env = Registry::builtin().make(id, options).unwrap();
    env.reset(Some(3));
    env
}

fn images(env: &Env) -> &ImageSpec {
    env.spec().images.as_ref().unwrap()
}

/// The axes of the camera of a view: a point of the world seen from there, m.
fn seen(images: &ImageSpec, view: usize, point: &Point3<f64>) -> Vector3<f64> {
    let rows = images.camera_from_world[view];
    let matrix = Matrix3x4::from_fn(|row, column| rows[row][column]);
    matrix * Vector4::new(point.x, point.y, point.z, 1.0)
}

/// Column and row at which it is seen.
fn pixel(images: &ImageSpec, seen: &Vector3<f64>) -> [f64; 2] {
    let [fx, fy, cx, cy] = images.intrinsics;
    [fx * seen.x / seen.z + cx, fy * seen.y / seen.z + cy]
}

#[test]
fn a_placed_camera_is_where_it_was_placed() {
    let (eye, target) = ([0.7, -0.3, 1.0], [0.52, 0.01, 0.70]);
    let env = env("NeedlePick-v0", &placed(eye, target, 30.0));
    let images = images(&env);
    assert!(seen(images, 0, &eye.into()).norm() < 1e-12);
    let middle = seen(images, 0, &target.into());
    let distance = (Vector3::from(eye) - Vector3::from(target)).norm();
    assert!((middle - Vector3::new(0.0, 0.0, distance)).norm() < 1e-12, "{middle}");
    // What is above is above in the picture, and the view is as high as was said.
    let above = seen(images, 0, &Point3::new(target[0], target[1], target[2] + 0.01));
    assert!(above.y < 0.0 && above.x.abs() < 1e-12);
    let half = (0.5 * SIZE[0] as f64 / images.intrinsics[1]).atan().to_degrees();
    assert!((half - 15.0).abs() < 1e-9, "{half}");
}

#[test]
fn pixels_of_a_placed_camera_lie_on_the_body_that_they_show() {
    for eye in [[0.7, -0.3, 1.0], [0.5, 0.0, 1.2]] {
        let env = env("NeedlePick-v0", &placed(eye, [0.5, 0.0, 0.69], 15.0));
        let images = images(&env);
        let pixels = SIZE[0] * SIZE[1];
        let (mut depth, mut mask) = (vec![0.0; pixels], vec![0; pixels]);
        let mut points = vec![0.0; 3 * pixels];
        env.show(&mut [], &mut depth, &mut mask, &mut points);
        let body = images.bodies.iter().position(|name| name == "needle").unwrap() as i32 + 1;
        let scene = env.scene();
        let needle = scene.instances().iter().find(|instance| instance.body == body).unwrap();
        let mut found = 0;
        for index in (0..pixels).filter(|index| mask[*index] == body) {
            let at = Vector3::from_fn(|axis, _| f64::from(points[3 * index + axis]));
            assert!((at.z - f64::from(depth[index])).abs() < 1e-9);
            let [column, row] = pixel(images, &at);
            assert!((column - (index % SIZE[1]) as f64).abs() < 1e-3);
            assert!((row - (index / SIZE[1]) as f64).abs() < 1e-3);
            // From the camera's axes to the world: the transposed rotation of what is left of the shift.
            let rows = images.camera_from_world[0];
            let turn = nalgebra::Matrix3::from_fn(|row, column| rows[row][column]);
            let shift = Vector3::from_fn(|row, _| rows[row][3]);
            let in_world = Point3::from(turn.transpose() * (at - shift));
            // Its wire lies on an arc with a radius of 20 mm.
            let on_needle = needle.world_from_mesh.inverse_transform_point(&in_world);
            assert!((on_needle.coords.xy().norm() - 0.02).abs() < 1.5e-3, "{on_needle}");
            assert!(on_needle.z.abs() < 1e-3, "{on_needle}");
            found += 1;
        }
        assert!(found > 20, "{eye:?}: {found}");
    }
}

#[test]
fn cameras_that_stand_still_have_their_places_in_the_specification() {
    for id in Registry::builtin().ids() {
        let moves = ["EcmReach-v0", "MisOrient-v0", "StaticTrack-v0", "ActiveTrack-v0"];
        let moves = moves.contains(&id);
        let views = [
            ("endoscope", vec![Lens::Endoscope], moves),
            ("stereo", vec![Lens::Left, Lens::Right], moves),
            ("overview", vec![Lens::Overview], false),
        ];
        for (camera, lenses, moves) in views {
            let mut env = env(id, &seen_from(camera));
            let images = images(&env).clone();
            assert_eq!(images.camera_from_world.len(), if moves { 0 } else { lenses.len() });
            for step in 0..4 {
                let scene = env.scene();
                for (view, lens) in lenses.iter().enumerate().filter(|_| !moves) {
                    let camera = scene.camera(*lens, SIZE[1], SIZE[0]).unwrap();
                    let point = Point3::new(0.4, 0.1, 0.6);
                    let [column, row, depth] = camera.project(&point).unwrap();
                    let seen = seen(&images, view, &point);
                    let at = pixel(&images, &seen);
                    let off = (at[0] - column).abs() + (at[1] - row).abs() + (seen.z - depth).abs();
                    assert!(off < 1e-9, "{id} {camera:?} after {step}: {off}");
                }
                let mut action = vec![0.0; env.spec().action_dim()];
                env.expert(&mut action);
                env.step(&action).unwrap();
            }
        }
    }
}

#[test]
fn places_from_which_nothing_can_be_seen_are_refused_by_name() {
    let refusal = |options: Options| {
        let refusal = Registry::builtin().spec("EcmReach-v0", &options).unwrap_err();
        assert_eq!(refusal.code, Code::InvalidOption);
        refusal.field
    };
    let good = placed([1.0, 0.0, 1.0], [0.0; 3], 60.0);
    let numbers = |numbers: &[f64]| OptionValue::Numbers(numbers.to_vec());
    let same = good.clone().with("camera_target", numbers(&[1.0, 0.0, 1.0]));
    assert_eq!(refusal(same), "options.camera_eye");
    for (name, value) in [
        ("camera_eye", numbers(&[1.0, 0.0])),
        ("camera_eye", numbers(&[11.0, 0.0, 0.0])),
        ("camera_target", numbers(&[f64::NAN, 0.0, 0.0])),
        ("camera_target", OptionValue::Number(1.0)),
        ("camera_view", OptionValue::Number(0.0)),
        ("camera_view", OptionValue::Number(170.0)),
    ] {
        assert_eq!(refusal(good.clone().with(name, value)), format!("options.{name}"));
    }
    assert!(Registry::builtin().spec("EcmReach-v0", &good).is_ok());
}
