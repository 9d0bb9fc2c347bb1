//! Pictures agree with geometry: depth and bodies with rays, points with places, bytes with each other.

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};
use parry::math::Pose;
use parry::query::{Ray, RayCast};
use parry::shape::TriMesh;
use rapier3d::parry;
use trocar_proto::{OptionValue, Options};
use trocar_server::Env;
use trocar_server::Registry;
use trocar_server::render::mesh::Mesh;
use trocar_server::render::{Camera, Lens, Picture, Renderer, Scene, Software, Viewpoint};

const LENSES: [Lens; 4] = [Lens::Endoscope, Lens::Left, Lens::Right, Lens::Overview];

/// An environment some steps into the expert's episode.
fn env(id: &str, seed: u64, steps: usize) -> Env {
    let mut env = Registry::builtin().make(id, &Options::new()).unwrap();
    env.reset(Some(seed));
    let mut action = vec![0.0; env.spec().action_dim()];
    for _ in 0..steps {
        env.expert(&mut action);
        env.step(&action).unwrap();
    }
    env
}

/// Lengths of rays in a metre: in metres, parry takes triangles below 0.3 mm for nothing.
const SCALE: f64 = 1000.0;

fn vector(vector: Vector3<f64>) -> parry::math::Vector {
    parry::math::Vector::new(vector.x as f32, vector.y as f32, vector.z as f32)
}

/// What rays meet: the same triangles as shapes of the engine.
struct Rays {
    shapes: Vec<(TriMesh, i32)>,
}

impl Rays {
    fn of(scene: &Scene) -> Self {
        let shape = |instance: &trocar_server::render::scene::Instance| {
            let place = |vertex: Point3<f32>| {
                let vertex = vertex.cast::<f64>() * instance.size;
                let [x, y, z] = (instance.world_from_mesh * vertex).coords.into();
                vector(Vector3::new(x, y, z) * SCALE)
            };
            let vertices = instance.mesh.vertices().map(place).collect();
            let mesh = TriMesh::new(vertices, instance.mesh.triangles().to_vec()).unwrap();
            (mesh, instance.body)
        };
        Self { shapes: scene.instances().iter().map(shape).collect() }
    }

    /// Depth (m) and body of what the ray through a pixel meets first beyond the near plane.
    fn cast(&self, camera: &Camera, column: f64, row: f64) -> (f64, i32) {
        let start = camera.back_project(column, row, camera.near);
        let along = camera.world_from_camera * camera.ray(column, row);
        let ray = Ray::new(vector(start.coords * SCALE), vector(along * SCALE));
        let most = (camera.far - camera.near) as f32;
        let mut first = (camera.far, 0);
        for (shape, body) in &self.shapes {
            // The picture shows surfaces from outside only.
            let hit = shape.cast_ray_and_get_normal(&Pose::IDENTITY, &ray, most, false);
            if let Some(hit) = hit {
                let depth = camera.near + f64::from(hit.time_of_impact);
                if depth < first.0 {
                    first = (depth, *body);
                }
            }
        }
        first
    }
}

/// Whether all pixels around one show surfaces that belong together: the same body, and depths as on one
/// plane.
fn is_within(picture: &Picture, column: usize, row: usize) -> bool {
    let at = |dx: isize, dy: isize| {
        let x = column.checked_add_signed(dx).filter(|x| *x < picture.width)?;
        let y = row.checked_add_signed(dy).filter(|y| *y < picture.height)?;
        let index = y * picture.width + x;
        Some((picture.mask[index], f64::from(picture.depth[index])))
    };
    let Some((body, depth)) = at(0, 0) else { return false };
    let flat = |a: Option<(i32, f64)>, b: Option<(i32, f64)>| match (a, b) {
        (Some((one, before)), Some((other, after))) => {
            let bend = (1.0 / before + 1.0 / after - 2.0 / depth).abs() * depth;
            one == body && other == body && bend < 0.01
        }
        _ => false,
    };
    [(1, 0), (0, 1), (1, 1), (1, -1)].iter().all(|(x, y)| flat(at(*x, *y), at(-x, -y)))
}

#[test]
fn depth_and_bodies_are_those_of_rays() {
    let soak = std::env::var_os("TROCAR_SOAK").is_some();
    let every = if soak { 1 } else { 5 };
    for (id, seed, steps) in
        [("NeedlePick-v0", 3, 20), ("BiPegTransfer-v0", 5, 12), ("StaticTrack-v0", 2, 0)]
    {
        let scene = env(id, seed, steps).scene();
        let rays = Rays::of(&scene);
        for lens in LENSES {
            let camera = scene.camera(lens, 160, 120).unwrap();
            let picture = Software::default().picture(&scene, &camera);
            let (mut looked_at, mut wrong_depth, mut wrong_body) = (0, 0, 0);
            for index in (0..picture.depth.len()).step_by(every) {
                let (column, row) = (index % picture.width, index / picture.width);
                if !is_within(&picture, column, row) {
                    continue;
                }
                let (depth, body) = rays.cast(&camera, column as f64, row as f64);
                looked_at += 1;
                wrong_body += usize::from(picture.mask[index] != body);
                let off = f64::from(picture.depth[index]) - depth;
                wrong_depth += usize::from(off.abs() > 1e-4);
            }
            let what = format!("{id} {lens:?}: {looked_at}, {wrong_depth}, {wrong_body}");
            println!("{what}");
            assert!(looked_at * every > picture.depth.len() / 3, "{what}");
            assert!(wrong_depth * 1000 <= looked_at, "{what}");
            assert!(wrong_body * 1000 <= looked_at, "{what}");
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let scene = env("NeedleRegrasp-v0", 1, 10).scene();
    let pictures = |threads: usize, samples: usize| -> Vec<Picture> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let renderer = Software { samples, parallel: threads > 1, ..Software::default() };
        pool.install(|| {
            let cameras = LENSES.map(|lens| scene.camera(lens, 200, 150).unwrap());
            cameras.iter().map(|camera| renderer.picture(&scene, camera)).collect()
        })
    };
    for samples in [1, 2] {
        let alone = pictures(1, samples);
        assert!(alone == pictures(2, samples) && alone == pictures(8, samples));
        assert!(alone == pictures(1, samples));
    }
}

#[test]
fn only_colours_depend_on_how_smooth_they_are() {
    let scene = env("PegTransfer-v0", 1, 5).scene();
    let camera = scene.camera(Lens::Endoscope, 130, 70).unwrap();
    let rough = Software::default().picture(&scene, &camera);
    let fine = Software::fine().picture(&scene, &camera);
    assert!(rough.depth == fine.depth && rough.mask == fine.mask);
    assert_ne!(rough.rgb, fine.rgb);
    let off = rough.rgb.iter().zip(&fine.rgb).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>();
    assert!(off / (rough.rgb.len() as u64) < 4, "{off}");
    // Where a pixel shows one face, two samples a side are shaded once: they are nearer to the truth all the same.
    let film = Software { samples: 2, ..Software::fine() }.picture(&scene, &camera);
    let pairs = || film.rgb.iter().zip(&fine.rgb).map(|(a, b)| a.abs_diff(*b));
    let often = pairs().filter(|off| *off > 16).count();
    assert!(often * 50 < film.rgb.len(), "{often} of {}", film.rgb.len());
    let film_off = pairs().map(u64::from).sum::<u64>();
    assert!(2 * film_off < off, "{film_off} {off}");
    // What is not asked for is not needed for the rest.
    let mut depth = vec![0.0; 130 * 70];
    let canvas = trocar_server::render::Canvas { depth: Some(&mut depth), ..Default::default() };
    Software::default().render(&scene, &camera, canvas);
    assert_eq!(depth, rough.depth);
}

/// A cube of 0.2 m whose middle is at the origin.
fn cube() -> Scene {
    let mut scene = Scene::default();
    scene.begin("cube");
    let mesh = Mesh::cuboid(&Vector3::repeat(0.1));
    let material = trocar_server::render::material::Material::named("foam");
    scene.draw(mesh.into(), Pose3::identity(), material);
    scene
}

type Pose3 = trocar_server::sim::frames::Pose;

#[test]
fn surfaces_are_cut_at_the_near_plane_and_end_at_the_far_plane() {
    let mut scene = cube();
    // A floor below, that reaches from far behind the camera to far ahead.
    scene.add_floor(-0.2);
    for near in [0.02, 0.11, 0.4] {
        for far in [0.6, 3.0, 50.0] {
            let view =
                Viewpoint { near, far, ..Viewpoint::towards([0.5, 0.02, 0.0], [0.0; 3], 1.2) };
            let camera = view.camera(96, 96);
            let picture = Software::default().picture(&scene, &camera);
            let rays = Rays::of(&scene);
            for index in 0..picture.depth.len() {
                let (depth, body) = (f64::from(picture.depth[index]), picture.mask[index]);
                assert!(depth >= near * (1.0 - 1e-6) && depth <= far * (1.0 + 1e-6));
                assert_eq!(body == 0, depth == f64::from(far as f32));
                let (column, row) = (index % 96, index / 96);
                // From inside a cut cube its inner side is not seen, but rays meet it.
                if near < 0.4 && is_within(&picture, column, row) {
                    let (expected, hit) = rays.cast(&camera, column as f64, row as f64);
                    assert_eq!(hit, body, "near {near} far {far} at {column}, {row}");
                    assert!((depth - expected).abs() < 1e-4 * (1.0 + depth), "{depth} {expected}");
                }
            }
            assert_eq!(picture.mask.contains(&1), near < 0.6);
        }
    }
}

#[test]
fn from_any_side_a_closed_mesh_has_no_holes() {
    // Every ray from near the lens to the middle of a ball meets it: no crack between faces lets one through.
    let mut scene = Scene::default();
    scene.begin("ball");
    let ball = Mesh::capsule(&Point3::origin(), &Point3::origin(), 0.1);
    let material = trocar_server::render::material::Material::named("steel");
    scene.draw(ball.into(), Pose3::identity(), material);
    for step in 0..200 {
        let angle = f64::from(step) * 0.7;
        let eye = [0.3 * angle.cos(), 0.3 * angle.sin(), 0.25 * (angle * 0.37).sin()];
        let camera = Viewpoint::towards(eye, [0.0; 3], 0.2).camera(61, 43);
        let picture = Software { shadow: 0, ..Software::default() }.picture(&scene, &camera);
        assert!(picture.mask.iter().all(|body| *body == 1), "{step}");
    }
}

/// Row and column of the middle of all pixels that show a body.
fn centroid(picture: &Picture, body: i32) -> Option<[f64; 2]> {
    let pixels = picture.mask.iter().enumerate().filter(|(_, at)| **at == body);
    let (mut count, mut sum) = (0.0, [0.0, 0.0]);
    for (index, _) in pixels {
        count += 1.0;
        sum[0] += (index % picture.width) as f64;
        sum[1] += (index / picture.width) as f64;
    }
    (count > 0.0).then(|| sum.map(|sum| sum / count))
}

#[test]
fn the_image_point_of_a_target_is_the_centroid_of_its_pixels() {
    const SIZE: usize = 512;
    let soak = std::env::var_os("TROCAR_SOAK").is_some();
    // A camera that is mounted askew, about which neither arm nor picture know anything.
    let askew = OptionValue::Table([("camera_pose_angle".to_string(), vec![-0.004, 0.004])].into());
    let askew = Options::new().with("domain", askew);
    let mut compared = 0;
    for (id, options) in [
        ("StaticTrack-v0", Options::new()),
        ("StaticTrack-v0", askew),
        ("ActiveTrack-v0", Options::new()),
    ] {
        let mut env = Registry::builtin().make(id, &options).unwrap();
        let mut observation = vec![0.0; env.spec().observation_dim()];
        for seed in 0..if soak { 200 } else { 12 } {
            env.reset(Some(seed));
            let mut action = vec![0.0; env.spec().action_dim()];
            for _ in 0..seed % 5 {
                env.expert(&mut action);
                env.step(&action).unwrap();
            }
            let mut goals = [vec![0.0; env.spec().goal_dim()], vec![0.0; env.spec().goal_dim()]];
            let [achieved, desired] = &mut goals;
            env.observe(&mut observation, achieved, desired);
            let scene = env.scene();
            let target = scene.body("target").unwrap();
            let camera = scene.camera(Lens::Endoscope, SIZE, SIZE).unwrap();
            let picture = Software::default().picture(&scene, &camera);
            // Alone, it shows what others hide of it.
            let alone = {
                let mut alone = Scene::default();
                let own = scene.instances().iter().filter(|instance| instance.body == target);
                alone.begin("target");
                for instance in own {
                    alone.draw(instance.mesh.clone(), instance.world_from_mesh, instance.material);
                }
                Software::default().picture(&alone, &camera)
            };
            let count =
                |picture: &Picture, body| picture.mask.iter().filter(|at| **at == body).count();
            if count(&picture, target) == 0 || count(&picture, target) != count(&alone, 1) {
                continue;
            }
            let [column, row] = centroid(&picture, target).unwrap();
            // −1 is the left edge of the picture, half a pixel beside the middle of its first column.
            let pixel = |number: f32| (f64::from(number) + 1.0) * 0.5 * SIZE as f64 - 0.5;
            let off = [column - pixel(observation[7]), row - pixel(observation[8])];
            assert!(off.iter().all(|off| off.abs() < 0.5), "{id} {seed}: {off:?}");
            compared += 1;
        }
    }
    assert!(compared >= 18, "{compared}");
}

#[test]
fn a_target_that_is_projected_back_is_where_the_state_has_it() {
    let mut compared = 0;
    for seed in 0..6 {
        for (id, steps) in [("NeedleReach-v0", 3), ("PegTransfer-v0", 2), ("GauzeRetrieve-v0", 2)] {
            let scene = env(id, seed, steps).scene();
            let camera = scene.camera(Lens::Endoscope, 640, 480).unwrap();
            let picture = Software::default().picture(&scene, &camera);
            let goal = scene.body("goal").unwrap();
            let ball = scene.instances().iter().find(|instance| instance.body == goal).unwrap();
            let centre = Point3::from(ball.world_from_mesh.translation.vector);
            let radius =
                ball.mesh.vertices().map(|at| f64::from(at.coords.norm())).fold(0.0, f64::max);
            let Some([column, row, depth]) = camera.project(&centre) else { continue };
            let (column, row) = (column.round(), row.round());
            if !(0.0..640.0).contains(&column) || !(0.0..480.0).contains(&row) {
                continue;
            }
            let index = row as usize * 640 + column as usize;
            if picture.mask[index] != goal {
                continue; // something is in front of it
            }
            let surface = camera.back_project(column, row, f64::from(picture.depth[index]));
            let along =
                (centre - Point3::from(camera.world_from_camera.translation.vector)).normalize();
            let found = surface + along * radius;
            assert!((found - centre).norm() < 0.5e-3, "{id} {seed}: {found} {centre} at {depth}");
            compared += 1;
        }
    }
    assert!(compared >= 6, "{compared}");
}

#[test]
fn a_needle_on_the_pad_is_seen_where_the_state_has_it() {
    for seed in 0..5 {
        let env = env("NeedleReach-v0", seed, 0);
        let scene = env.scene();
        let camera = scene.camera(Lens::Endoscope, 640, 480).unwrap();
        let picture = Software::default().picture(&scene, &camera);
        let body = scene.body("needle").unwrap();
        let needle = scene.instances().iter().find(|instance| instance.body == body).unwrap();
        let mut seen = 0;
        for (point, found) in picture.points(&camera).zip(&picture.mask) {
            if *found == body {
                // Its wire is 1 mm thick, on an arc with a radius of 20 mm.
                let at = needle.world_from_mesh.inverse_transform_point(&point);
                let beside = at.coords.xy().norm() - 0.02;
                let off = (beside.hypot(at.z) - 0.5e-3).abs();
                assert!(off < 0.1e-3 || at.x > -0.005, "{seed}: {off}");
                seen += 1;
            }
        }
        assert!(seen > 100, "{seed}: {seen}");
    }
}

#[test]
fn every_task_shows_the_same_bodies_all_the_time_and_has_every_camera() {
    for id in Registry::builtin().ids() {
        let names = |seed: u64, steps: usize| {
            let scene = env(id, seed, steps).scene();
            scene.bodies().iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        let first = names(0, 0);
        assert_eq!(first, names(4, 6), "{id}");
        let options = Options::new().with("observation", OptionValue::Texts(vec!["mask".into()]));
        let spec = Registry::builtin().spec(id, &options).unwrap();
        assert_eq!(first, spec.images.unwrap().bodies, "{id}");
        assert_eq!(
            first.iter().collect::<BTreeSet<_>>().len(),
            first.len(),
            "{id}: twice the same"
        );
        let scene = env(id, 0, 2).scene();
        for lens in LENSES {
            let camera = scene.camera(lens, 64, 64).unwrap();
            let picture = Software::default().picture(&scene, &camera);
            let bodies: BTreeSet<_> = picture.mask.iter().collect();
            let colours: BTreeSet<_> = picture.rgb.chunks_exact(3).collect();
            // Nothing is 0, and is no body.
            let shown = bodies.iter().filter(|body| ***body != 0).count();
            assert!(shown > 0 && colours.len() > 20, "{id} {lens:?}: {shown} bodies");
        }
    }
}

#[test]
fn stereo_lenses_are_beside_each_other() {
    let scene = env("NeedlePick-v0", 0, 0).scene();
    let [middle, left, right] =
        [Lens::Endoscope, Lens::Left, Lens::Right].map(|lens| scene.camera(lens, 64, 64).unwrap());
    let point = Point3::new(0.55, 0.0, 0.69);
    let [[at, row, depth], [at_left, row_left, _], [at_right, row_right, _]] =
        [middle, left, right].map(|camera| camera.project(&point).unwrap());
    // Disparity is focal length times distance over depth.
    let disparity = middle.intrinsics.fx * 4.2e-3 / depth;
    assert!((at_left - at_right - disparity).abs() < 1e-9);
    assert!((0.5 * (at_left + at_right) - at).abs() < 1e-9);
    assert!((row_left - row).abs() < 1e-9 && (row_right - row).abs() < 1e-9);
}

#[test]
fn the_drawn_jaws_are_where_the_simulated_fingers_are() {
    for (id, steps, arms) in
        [("NeedlePick-v0", 0, 1), ("NeedlePick-v0", 14, 1), ("NeedleRegrasp-v0", 9, 2)]
    {
        let env = env(id, 3, steps);
        let scene = env.scene();
        let mut found = 0;
        for arm in ["psm1", "psm2"] {
            let part = |name: &str| {
                let body = scene.body(&format!("{arm} {name}"))?;
                let found = scene.instances().iter().find(|instance| instance.body == body)?;
                Some(found.world_from_mesh)
            };
            let Some(axle) = part("wrist_yaw_link") else { continue };
            found += 1;
            for jaw in ["jaw_1_link", "jaw_2_link"] {
                let jaw = part(jaw).unwrap();
                let off = (jaw.translation.vector - axle.translation.vector).norm();
                assert!(off < 0.2e-3, "{id} after {steps} {arm}: {off}");
                // Both blades point along +y of their link, at most the opening apart from the wrist's.
                let turn = (jaw.rotation * Vector3::y()).angle(&(axle.rotation * Vector3::y()));
                assert!(turn < 0.5, "{id} after {steps} {arm}: {turn}");
            }
        }
        assert_eq!(found, arms, "{id}");
    }
}
