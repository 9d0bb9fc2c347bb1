//! What surrounds the arms in pictures: floor, table, the endoscope on its arm, and from where all is seen.
//! Nothing of it touches anything.

use std::sync::{Arc, LazyLock};

use nalgebra::Vector3;

use super::tray;
use crate::render::material::Material;
use crate::render::mesh::Mesh;
use crate::render::skeleton::Skeleton;
use crate::render::{Scene, Viewpoint};
use crate::robots::{ArmModel, Ecm, Endoscope};
use crate::sim::frames::{self, Aabb, Pose};

/// Radius of balls that mark goals, m.
pub const GOAL_RADIUS: f64 = 2.5e-3;

/// The remote centre of the endoscope's arm in the scenes of PSMs, m, and the pitch of the arm's base, rad:
/// that of the ECM tasks. It stands between the PSMs, as on a patient cart.
const RCM: [f64; 3] = [0.6925, 0.0, 0.8635];
const PITCH: f64 = std::f64::consts::PI / 6.0;

/// Joints of that arm where nothing moves it, rad; index 2 in m: its camera is 160 mm from the middle of the workspace,
/// 40° from the vertical.
pub const JOINTS: [f64; 4] = [0.0, 10.0 * std::f64::consts::PI / 180.0, 0.06, 0.0];

/// Half the distance of the joints between tiles of the floor, m, and half the tiles' number along a side.
const TILE: f64 = 0.25;
const TILES: i32 = 6;

/// The endoscope's arm beside PSMs of this generation, of the same, and where its remote centre is in the world.
pub fn endoscope(model: ArmModel) -> (Ecm, Pose) {
    let [x, y, z] = RCM;
    let turn = frames::pose([0.0; 3], [0.0, 0.0, -std::f64::consts::FRAC_PI_2]);
    let world_from_rcm = frames::pose([x, y, z], [0.0, PITCH, 0.0]) * turn;
    (Ecm::new(model, Endoscope::Straight), world_from_rcm)
}

/// Draws what is around PSMs of this generation.
pub fn draw(scene: &mut Scene, model: ArmModel) {
    scene.add_floor(0.0);
    tray::draw_table(scene);
    let (ecm, world_from_rcm) = endoscope(model);
    let joints = scene.endoscope_joints.unwrap_or(JOINTS);
    draw_ecm(scene, &ecm, &world_from_rcm, &joints);
    let is_fixed = scene.endoscope_joints.is_none();
    scene.look_through(&(world_from_rcm * ecm.base_from_camera(&joints)), is_fixed);
    scene.stage = Aabb::new([0.34, -0.22, 0.67], [0.72, 0.22, 0.80]);
    scene.overview = Viewpoint::towards([1.10, 0.62, 1.12], [0.52, 0.005, 0.785], 0.50);
}

/// Draws an ECM as `ecm`. `joints`: rad; index 2 in m.
pub fn draw_ecm(scene: &mut Scene, ecm: &Ecm, world_from_rcm: &Pose, joints: &[f64; 4]) {
    let joint = |name: &str| {
        let index = ["yaw", "pitch", "insertion", "roll"].iter().position(|other| *other == name);
        index.map_or(0.0, |index| joints[index])
    };
    Skeleton::ecm(ecm.model()).draw(scene, "ecm", world_from_rcm, joint, |_| None);
}

/// Draws a floor at z = 0 with dark joints between square tiles, so that pictures of it have a direction.
pub fn draw_tiles(scene: &mut Scene) {
    static JOINTS: LazyLock<[Arc<Mesh>; 2]> = LazyLock::new(|| {
        let half = f64::from(TILES) * TILE;
        [Vector3::new(half, 0.003, 0.001), Vector3::new(0.003, half, 0.001)]
            .map(|size| Arc::new(Mesh::cuboid(&size)))
    });
    scene.add_floor(0.0);
    let material = Material::named("joint");
    for line in -TILES..=TILES {
        let aside = f64::from(line) * TILE;
        for (mesh, at) in JOINTS.iter().zip([[0.0, aside, 0.0], [aside, 0.0, 0.0]]) {
            scene.draw(Arc::clone(mesh), frames::pose(at, [0.0; 3]), material);
        }
    }
}
