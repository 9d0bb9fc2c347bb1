//! The models in `assets/`: every URDF agrees with the kinematics, every mesh is sound.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use trocar_server::robots::{ArmModel, Ecm, Endoscope, JointLimit, Psm};
use urdf_rs::{Geometry, Joint, JointType, Pose, Robot};

/// Largest difference between the URDF and the DH chain, m and rad.
const AGREEMENT: f64 = 1e-9;
/// Largest mesh file, bytes.
const LARGEST_FILE: u64 = 200_000;

fn assets() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets")
}

fn read(path: &str) -> Robot {
    urdf_rs::read_file(assets().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Every URDF below `assets/`, as `folder/file`.
fn urdfs() -> Vec<String> {
    let mut found = BTreeSet::new();
    for folder in std::fs::read_dir(assets()).expect("assets exist") {
        let folder = folder.expect("a readable entry");
        if !folder.file_type().expect("a file type").is_dir() {
            continue;
        }
        for file in std::fs::read_dir(folder.path()).expect("a readable folder") {
            let name = file.expect("a readable entry").file_name().into_string().expect("UTF-8");
            if Path::new(&name).extension().is_some_and(|extension| extension == "urdf") {
                let folder = folder.file_name().into_string().expect("UTF-8");
                found.insert(format!("{folder}/{name}"));
            }
        }
    }
    found.into_iter().collect()
}

fn isometry(pose: &Pose) -> Isometry3<f64> {
    let [r, p, y] = *pose.rpy;
    let rotation = Rotation3::from_euler_angles(r, p, y);
    Isometry3::from_parts(Translation3::from(Vector3::from(*pose.xyz)), rotation.into())
}

/// Pose of `link` in the root's frame, from the URDF's own origins, axes and mimic joints.
fn base_from_link(robot: &Robot, link: &str, q: &BTreeMap<&str, f64>) -> Isometry3<f64> {
    let Some(joint) = robot.joints.iter().find(|joint| joint.child.link == link) else {
        return Isometry3::identity();
    };
    let axis = Vector3::from(*joint.axis.xyz);
    let motion = match joint.joint_type {
        JointType::Revolute => Isometry3::rotation(axis * position(joint, q)),
        JointType::Prismatic => Isometry3::translation(0.0, 0.0, position(joint, q)),
        JointType::Fixed => Isometry3::identity(),
        ref other => panic!("{} is {other:?}", joint.name),
    };
    base_from_link(robot, &joint.parent.link, q) * isometry(&joint.origin) * motion
}

fn position(joint: &Joint, q: &BTreeMap<&str, f64>) -> f64 {
    match &joint.mimic {
        Some(mimic) => q[mimic.joint.as_str()] * mimic.multiplier.unwrap_or(1.0),
        None => q[joint.name.as_str()],
    }
}

fn random_joints(limits: &[JointLimit], rng: &mut ChaCha8Rng) -> Vec<f64> {
    limits.iter().map(|limit| rng.random_range(limit.min..=limit.max)).collect()
}

fn named(limits: &[JointLimit], q: &[f64]) -> BTreeMap<&'static str, f64> {
    limits.iter().map(|limit| limit.name).zip(q.iter().copied()).collect()
}

#[track_caller]
fn assert_same_pose(found: &Isometry3<f64>, expected: &Isometry3<f64>, what: &str) {
    let apart = (found.translation.vector - expected.translation.vector).norm();
    let chord = (found.rotation.to_rotation_matrix().matrix()
        - expected.rotation.to_rotation_matrix().matrix())
    .norm();
    assert!(apart < AGREEMENT && chord < AGREEMENT, "{what}: {apart:e} m, {chord:e} rad");
}

#[track_caller]
fn assert_same_limits(robot: &Robot, limits: &[JointLimit]) {
    for limit in limits {
        let joint = robot.joints.iter().find(|joint| joint.name == limit.name);
        let found = &joint.unwrap_or_else(|| panic!("no joint {}", limit.name)).limit;
        let pairs = [
            (found.lower, limit.min),
            (found.upper, limit.max),
            (found.velocity, limit.max_velocity),
            (found.effort, limit.max_effort),
        ];
        for (found, expected) in pairs {
            assert!((found - expected).abs() < AGREEMENT, "{}: {found} {expected}", limit.name);
        }
    }
}

#[test]
fn the_psm_urdf_moves_as_its_dh_chain() {
    for (path, psm) in [("psm/model.urdf", Psm::CLASSIC), ("psm_si/model.urdf", Psm::SI)] {
        let robot = read(path);
        let mut limits = psm.limits().to_vec();
        assert_same_limits(&robot, &limits);
        limits.push(psm.jaw_limit());
        assert_same_limits(&robot, &limits);

        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..200 {
            let values = random_joints(&limits, &mut rng);
            let q: [f64; 6] = values[..6].try_into().expect("six joints");
            let urdf = named(&limits, &values);
            let links = psm.base_from_links(&q);
            for (limit, link) in limits.iter().zip(&links) {
                let name = format!("{}_link", limit.name);
                assert_same_pose(&base_from_link(&robot, &name, &urdf), link, &name);
            }
            let wrist = base_from_link(&robot, "wrist", &urdf);
            assert_same_pose(&wrist, &psm.base_from_wrist(&q), "wrist");
            let tip = base_from_link(&robot, "tip", &urdf);
            assert_same_pose(&tip, &psm.base_from_tip(&q), "tip");
        }
    }
}

#[test]
fn the_ecm_urdfs_move_as_their_dh_chain() {
    let endoscopes = [
        ("model", Endoscope::Straight),
        ("model_up30", Endoscope::Up30),
        ("model_down30", Endoscope::Down30),
    ];
    for (folder, model) in [("ecm", ArmModel::Classic), ("ecm_si", ArmModel::Si)] {
        for (file, endoscope) in endoscopes {
            let robot = read(&format!("{folder}/{file}.urdf"));
            let ecm = Ecm::new(model, endoscope);
            let limits = ecm.limits();
            assert_same_limits(&robot, limits);
            let mut rng = ChaCha8Rng::seed_from_u64(2);
            for _ in 0..200 {
                let values = random_joints(limits, &mut rng);
                let q: [f64; 4] = values[..].try_into().expect("four joints");
                let urdf = named(limits, &values);
                for (limit, link) in limits.iter().zip(ecm.base_from_links(&q)) {
                    let name = format!("{}_link", limit.name);
                    assert_same_pose(&base_from_link(&robot, &name, &urdf), &link, &name);
                }
                let camera = base_from_link(&robot, "camera", &urdf);
                assert_same_pose(&camera, &ecm.base_from_camera(&q), "camera");
            }
        }
    }
}

#[test]
fn each_finger_opens_by_half_the_jaw_angle_towards_its_own_side() {
    let robot = read("psm/model.urdf");
    let jaw = 0.8;
    let mut q = named(Psm::CLASSIC.limits(), &[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]);
    q.insert("jaw", jaw);
    let wrist_yaw = base_from_link(&robot, "wrist_yaw_link", &q);
    for (name, side) in [("jaw_1_link", -1.0), ("jaw_2_link", 1.0)] {
        let finger = wrist_yaw.inverse() * base_from_link(&robot, name, &q);
        let along = finger.rotation * Vector3::y();
        let (sin, cos) = (jaw / 2.0).sin_cos();
        assert!((along - Vector3::new(side * sin, cos, 0.0)).norm() < AGREEMENT, "{name}: {along}");
        let link = robot.links.iter().find(|link| link.name == name).expect("the finger");
        let centre = Vector3::from(*link.collision[0].origin.xyz);
        assert!((centre - Vector3::new(side * 0.0007, 0.0051, 0.0)).norm() < AGREEMENT);
    }
}

/// The bars are drawn only, but they must stay on the rail's pivots at every pitch.
#[test]
fn the_parallelogram_stays_closed() {
    for (path, limits) in [
        ("psm/model.urdf", Psm::CLASSIC.limits().to_vec()),
        ("psm_si/model.urdf", Psm::SI.limits().to_vec()),
        ("ecm/model.urdf", Ecm::CLASSIC.limits().to_vec()),
        ("ecm_si/model.urdf", Ecm::SI.limits().to_vec()),
    ] {
        let robot = read(path);
        let back = robot.joints.iter().find(|joint| joint.name == "pitch_back").expect("a pivot");
        let front_end = Point3::new(-back.origin.xyz[2], 0.0, 0.0);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for name in ["bottom_link", "top_link"] {
            let mut front_in_rail = |pitch: Option<f64>| {
                let mut q = named(&limits, &random_joints(&limits, &mut rng));
                q.extend(pitch.map(|pitch| ("pitch", pitch)));
                let bar = base_from_link(&robot, name, &q);
                base_from_link(&robot, "pitch_link", &q).inverse() * bar * front_end
            };
            let pivot = front_in_rail(Some(0.0));
            for _ in 0..50 {
                let front = front_in_rail(None);
                assert!((front - pivot).norm() < AGREEMENT, "{path} {name}: {front} {pivot}");
            }
        }
    }
}

#[test]
fn every_model_has_plausible_inertia() {
    let models = urdfs();
    assert_eq!(models.len(), 18, "{models:?}");
    for path in models {
        for link in read(&path).links.iter().filter(|link| !link.visual.is_empty()) {
            let inertia = &link.inertial.inertia;
            assert!(link.inertial.mass.value > 0.0, "{path} {}", link.name);
            #[rustfmt::skip]
            let tensor = Matrix3::new(
                inertia.ixx, inertia.ixy, inertia.ixz,
                inertia.ixy, inertia.iyy, inertia.iyz,
                inertia.ixz, inertia.iyz, inertia.izz,
            );
            let mut moments: Vec<f64> = tensor.symmetric_eigenvalues().iter().copied().collect();
            moments.sort_by(f64::total_cmp);
            assert!(moments[0] > 0.0, "{path} {}: {moments:?}", link.name);
            // No body has a principal moment above the sum of the others (text has six digits).
            assert!(moments[0] + moments[1] > 0.9999 * moments[2], "{path} {}", link.name);
        }
    }
}

#[test]
fn the_needle_weighs_what_its_steel_does() {
    let robot = read("needle/model.urdf");
    let mass = robot.links[0].inertial.mass.value;
    // A half circle of 1 mm wire, R 20 mm, less its taper and bore.
    let wire = 7850.0 * std::f64::consts::PI.powi(2) * 0.0005_f64.powi(2) * 0.02;
    assert!(mass > 0.9 * wire && mass < wire, "{mass} kg of {wire} kg");
}

#[test]
fn block_and_gauze_weigh_what_their_materials_do() {
    let mass = |path: &str| read(path).links[0].inertial.mass.value;
    // A ring between triangles of 5.8 and 4.2 mm apothem, whose outer corners are cut at 8.9 mm from
    // the axis; its edges are rounded.
    let triangle = |apothem: f64| 3.0 * 3.0_f64.sqrt() * apothem * apothem;
    let corner = (2.0 * 0.0058 - 0.0089_f64).powi(2) / 3.0_f64.sqrt();
    let area = triangle(0.0058) - triangle(0.0042) - 3.0 * corner;
    let acetal = 1410.0 * area * 0.0145;
    assert!((0.98..1.02).contains(&(mass("block/model.urdf") / acetal)), "{acetal} kg");
    // The sheet and the pleat above it, up to the mean height of the weave.
    let cotton = 1040.0 * 0.0152 * (0.0255 * 0.00074 + 0.0018 * 0.00155);
    assert!((0.98..1.02).contains(&(mass("gauze/model.urdf") / cotton)), "{cotton} kg");
}

#[test]
fn the_readme_tells_materials_and_masses() {
    let text = |path: &str| std::fs::read_to_string(assets().join(path)).expect("a text");
    let (readme, materials) = (text("README.md"), text("materials.csv"));
    let rows = readme.lines().filter(|line| line.starts_with("| `"));
    let mut found = 0;
    for row in rows {
        let cells: Vec<_> = row.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
        let [_, model, material, density, friction, mass, _] = cells[..] else { continue };
        let line = materials.lines().find(|line| line.split(',').next() == Some(material));
        let columns: Vec<_> = line.expect("a material of the table").split(',').collect();
        assert_eq!((columns[4], columns[5]), (density, friction), "{row}");
        let link = &read(&format!("{model}/model.urdf")).links[0];
        assert_eq!(link.visual[0].material.as_ref().expect("a material").name, material);
        assert_eq!(format!("{:.2}", link.inertial.mass.value * 1e3), mass, "{row}");
        found += 1;
    }
    assert_eq!(found, 5);
}

/// Every wall of the block is where its frame says, 1.6 mm thick.
#[test]
fn the_block_is_a_ring_of_three_walls_about_its_frames() {
    let robot = read("block/model.urdf");
    assert_eq!(robot.links[0].collision.len(), 3);
    for (collision, joint) in robot.links[0].collision.iter().zip(&robot.joints) {
        let wall = isometry(&collision.origin);
        assert_same_pose(&wall, &isometry(&joint.origin), &joint.name);
        let Geometry::Box { size } = &collision.geometry else { panic!("walls are boxes") };
        assert!((size[0] - 0.0016).abs() < AGREEMENT && (size[2] - 0.0145).abs() < AGREEMENT);
        let to_axis = wall * Point3::new(0.005, 0.0, 0.0);
        assert!(to_axis.coords.norm() < 1e-8, "{to_axis}");
    }
}

/// The needle's capsules against its arc: the end spheres' centres and the chords between them.
#[test]
fn the_needle_capsules_follow_the_arc() {
    let robot = read("needle/model.urdf");
    let mut ends = Vec::new();
    for collision in &robot.links[0].collision {
        let Geometry::Capsule { radius, length } = collision.geometry else {
            panic!("{:?} is no capsule", collision.geometry);
        };
        assert!((radius - 0.0005).abs() < AGREEMENT);
        let pose = isometry(&collision.origin);
        for i in 0..=10 {
            let along = length * (f64::from(i) / 10.0 - 0.5);
            let point = pose * Point3::new(0.0, 0.0, along);
            assert!(point.z.abs() < AGREEMENT);
            assert!((point.coords.norm() - 0.02).abs() < 0.000_19, "{point}");
        }
        ends.push([-0.5, 0.5].map(|end| pose * Point3::new(0.0, 0.0, end * length)));
    }
    assert_eq!(ends.len(), 8);
    for pair in ends.windows(2) {
        let gap = pair[0].iter().flat_map(|a| pair[1].map(|b| (a - b).norm())).fold(1.0, f64::min);
        assert!(gap < 1e-8, "{pair:?}");
    }
}

struct Mesh {
    material: String,
    vertices: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    /// Three (vertex, normal) pairs each.
    faces: Vec<[(usize, usize); 3]>,
}

fn read_mesh(path: &Path) -> Mesh {
    let text =
        std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut mesh =
        Mesh { material: String::new(), vertices: vec![], normals: vec![], faces: vec![] };
    for line in text.lines() {
        let (kind, rest) = line.split_once(' ').expect("a kind and its values");
        let vector = || {
            let values: Vec<f64> =
                rest.split(' ').map(|value| value.parse().expect("a number")).collect();
            Vector3::from_column_slice(&values)
        };
        match kind {
            "#" | "o" => {}
            "usemtl" => rest.clone_into(&mut mesh.material),
            "v" => mesh.vertices.push(vector().into()),
            "vn" => mesh.normals.push(vector()),
            "f" => {
                let corners: Vec<(usize, usize)> = rest
                    .split(' ')
                    .map(|corner| {
                        let (vertex, normal) = corner.split_once("//").expect("vertex//normal");
                        let index = |text: &str| text.parse::<usize>().expect("an index") - 1;
                        (index(vertex), index(normal))
                    })
                    .collect();
                mesh.faces.push(corners.try_into().expect("three corners"));
            }
            other => panic!("{}: line kind {other}", path.display()),
        }
    }
    mesh
}

/// Every mesh that a model shows: file and the material that the URDF gives it.
fn meshes() -> BTreeMap<PathBuf, String> {
    let mut found = BTreeMap::new();
    for path in urdfs() {
        for visual in read(&path).links.iter().flat_map(|link| &link.visual) {
            let Geometry::Mesh { filename, scale: None } = &visual.geometry else {
                panic!("{path}: {:?}", visual.geometry);
            };
            let folder = assets().join(&path).parent().expect("a folder").to_owned();
            let file = folder.join(filename).canonicalize();
            let file = file.unwrap_or_else(|error| panic!("{path}: {filename}: {error}"));
            let material = &visual.material.as_ref().expect("a material").name;
            found.insert(file, material.clone());
        }
    }
    found
}

#[test]
fn every_mesh_is_closed_small_and_smoothly_shaded() {
    let meshes = meshes();
    assert!(meshes.len() > 40);
    for (path, material) in meshes {
        let name = path.display();
        let mesh = read_mesh(&path);
        let size = std::fs::metadata(&path).expect("it was just read").len();
        assert!(size < LARGEST_FILE, "{name}: {size} bytes");
        assert_eq!(mesh.material, material, "{name}");

        let mut edges = BTreeSet::new();
        let mut volume = 0.0;
        for face in &mesh.faces {
            let [a, b, c] = face.map(|(vertex, _)| mesh.vertices[vertex].coords);
            volume += a.dot(&b.cross(&c)) / 6.0;
            let outwards = (b - a).cross(&(c - a)).normalize();
            for (i, (vertex, normal)) in face.iter().enumerate() {
                let edge = (*vertex, face[(i + 1) % 3].0);
                assert!(edges.insert(edge), "{name}: edge {edge:?} twice");
                let normal = mesh.normals[*normal];
                assert!((normal.norm() - 1.0).abs() < 1e-3, "{name}: normal {normal}");
                assert!(normal.dot(&outwards) > 0.5, "{name}: normal {normal} on {outwards}");
            }
        }
        let open = edges.iter().find(|(a, b)| !edges.contains(&(*b, *a)));
        assert_eq!(open, None, "{name} is open");
        assert!(volume > 0.0, "{name}: {volume} m³");
    }
}

#[test]
fn meshes_have_the_size_of_the_real_parts() {
    // Extent along x, y, z in mm.
    let expected = [
        ("psm/meshes/jaw.obj", [5.0, 12.7, 2.34]),
        ("psm/meshes/shaft.obj", [8.4, 8.4, 368.2]),
        ("psm_si/meshes/shaft.obj", [8.4, 8.4, 419.0]),
        ("ecm/meshes/scope_straight.obj", [12.0, 12.0, 402.9]),
        ("needle/meshes/needle.obj", [20.5, 40.8, 1.0]),
        ("cylinder/meshes/cylinder.obj", [2.5, 2.5, 6.0]),
        ("pad/meshes/pad.obj", [101.0, 170.0, 5.2]),
        ("tray/meshes/tray.obj", [120.0, 196.0, 22.75]),
        ("table/meshes/top.obj", [416.0, 537.0, 50.0]),
        ("gauze/meshes/gauze.obj", [15.2, 25.5, 2.45]),
        ("block/meshes/block.obj", [14.7, 16.9, 14.5]),
        ("pegboard/meshes/board.obj", [103.0, 154.0, 22.0]),
        ("cube/meshes/cube_100.obj", [100.0; 3]),
        ("cube/meshes/cube_80.obj", [80.0; 3]),
    ];
    for (path, expected) in expected {
        let mesh = read_mesh(&assets().join(path));
        for (axis, expected) in expected.into_iter().enumerate() {
            let values = || mesh.vertices.iter().map(|vertex| vertex[axis] * 1e3);
            let extent = values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min);
            assert!((extent - expected).abs() < 0.2, "{path} axis {axis}: {extent} mm");
        }
    }
}

#[test]
fn the_closed_jaws_meet_but_do_not_overlap_and_end_at_the_tip() {
    let mesh = read_mesh(&assets().join("psm/meshes/jaw.obj"));
    let blade = mesh.vertices.iter().filter(|vertex| vertex.y > 0.0026);
    assert!(blade.clone().all(|vertex| vertex.x <= 0.0), "the finger stays on its side");
    assert!(blade.clone().any(|vertex| vertex.x > -2e-5), "the teeth reach the middle");
    let end = blade.map(|vertex| vertex.y).fold(0.0, f64::max);
    assert!((end - Psm::TIP_DISTANCE).abs() < 1e-6, "{end} m");
}

#[test]
fn the_endoscope_ends_square_to_its_view() {
    for (file, endoscope) in [
        ("straight", Endoscope::Straight),
        ("up30", Endoscope::Up30),
        ("down30", Endoscope::Down30),
    ] {
        let ecm = Ecm::CLASSIC.with_endoscope(endoscope);
        let q = [0.0; 4];
        let link_from_base = ecm.base_from_links(&q)[3].inverse();
        let view: UnitQuaternion<f64> = (link_from_base * ecm.base_from_camera(&q)).rotation;
        let view = view * Vector3::z();
        let mesh = read_mesh(&assets().join(format!("ecm/meshes/scope_{file}.obj")));
        let foremost =
            mesh.vertices.iter().map(|vertex| vertex.coords.dot(&view)).fold(f64::MIN, f64::max);
        assert!(foremost.abs() < 1e-5, "{file}: the tube passes the lens by {foremost} m");
        let face = mesh.vertices.iter().filter(|vertex| vertex.coords.dot(&view).abs() < 1e-5);
        assert!(face.count() > 40, "{file}: the end face is not square to the view");
    }
}
