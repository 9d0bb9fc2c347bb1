//! Tissue manipulation: a PSM brings a marked point of a sheet of fat to a place.
//!
//! # Description
//!
//! A sheet of fat of 60 mm × 60 mm × 8 mm lies on the pad in the tray. Its edge at the lowest x is held where it is, and its
//! free edge faces the endoscope. Jaws hold it by friction alone. The sheet is a lattice of 288 hexahedra
//! ([`soft`](crate::sim::soft)) of the material `fat` of `assets/materials.csv`, with a Young's modulus of 5 kPa.
//! A point of its upper face is marked, 10 to 20 mm from the free edge. PSM1 is to grasp the edge beside it and to move it so
//! that the mark comes within 3 mm of a place above the pad. LapGym's tissue manipulation is its model.
//!
//! # Action Space
//!
//! `action = "paper"`, each number in [−1, 1]; the other modes are in [`psm_scene`](super::psm_scene).
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | dx, scene frame | −1 | 1 | 10 mm |
//! | 1 | dy, scene frame | −1 | 1 | 10 mm |
//! | 2 | dz, scene frame | −1 | 1 | 10 mm |
//! | 3 | turn of the jaws about the vertical | −1 | 1 | 30° |
//! | 4 | jaw: below 0 close, else open to 40° | −1 | 1 | – |
//!
//! The movement starts from the sensed wrist, takes 0.2 s along a smooth profile, and is confined
//! to the workspace: see [`psm_scene`](super::psm_scene).
//!
//! # Observation Space
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | wrist x (wrist-yaw axis, as sensed), scene frame | 0.493 | 0.607 | m |
//! | 1 | wrist y | −0.057 | 0.057 | m |
//! | 2 | wrist z | 0.6822 | 0.7742 | m |
//! | 3 | roll of the wrist link; −π/2 under `paper` | −π | π | rad |
//! | 4 | pitch; 0 under `paper` | −π/2 | π/2 | rad |
//! | 5 | yaw | −π | π | rad |
//! | 6 | jaw angle: the opening between the fingers | −0.1 | 1.6 | rad |
//! | 7–9 | marked point x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 10–12 | the same less wrist x, y, z, scene frame | −0.313, −0.323, −0.1722 | 0.213, 0.323, 0.2158 | m |
//! | 13–15 | point 1 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 16–18 | point 2 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 19–21 | point 3 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 22–24 | point 4 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 25–27 | point 5 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 28–30 | point 6 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 31–33 | point 7 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 34–36 | point 8 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 37–39 | point 9 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 40–42 | point 10 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 43–45 | point 11 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 46–48 | point 12 of the upper face x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 49–50 | how hard each finger is pressed | 0 | 20 | N |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll), of the wrist-yaw link, whose y axis points along
//! the jaws and whose z axis is their hinge. The 12 points are at x = 5, 17 and 29 mm and y = −29, −10, 10 and 29 mm from
//! the sheet's middle. What is outside its range is shown at its end.
//!
//! # Goal
//!
//! | Num | Part | Achieved | Desired | Reached within | 1 in the dense reward |
//! |---|---|---|---|---|---|
//! | 0–2 | `mark` | the marked point x, y, z, m | its place | 3 mm | 10 mm |
//! | 3 | `held` | the share of the last three steps after which both fingers press on the sheet | 1 | 0.1 | 1 |
//! | 4 | `peak pull` | the largest force of the sheet on the jaws so far, at the ends of steps, N | 0 | 3 N | 3 N |
//!
//! # Rewards
//!
//! `sparse` (default): 0 where every part of the goal is reached, −1 otherwise. `dense`: minus the sum of all parts'
//! distances, each over what the table says. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The wrist at the corner (0.50, 0.05, 0.7202) m, jaws closed and straight down. The sheet is at rest. The mark is within
//! 10 mm of the middle along the edge; its place is 4 to 14 mm higher, up to 10 mm back or 2 mm forward, and up to 6 mm aside.
//!
//! # Episode End
//!
//! Truncated after 60 steps; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, and:
//!
//! - `instrument`: `tissue_forceps`: jaws 5 mm broad and profiled; `needle_driver`: 1.8 mm broad and smooth, which fat slips
//!   out of.
//! - `squeeze`: force with which each finger squeezes, 0.5 to 4 N; 1 N. Source: clamps of 1 to 4 N in Guo 2021.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see [`psm_scene`](super::psm_scene).
//! - `grasp = "approx"`: the skin between closed jaws, or up to `grasp_distance` (2 mm) from there, is attached to the wrist
//!   without friction. It counts as held. Simulators that drag vertices along do so; real jaws do not.
//! - `domain`: `modulus` (3,000 to 8,000 Pa; Young's modulus), `thickness` (6 to 10 mm, in m; 8 mm), `friction` (coefficient
//!   of profiled jaws on the sheet), `strength` (ultimate strain, which `overstretched` and `crushed` in infos go by; 0.38),
//!   and `observation_noise`, `joint_offset`, `latency` and the others that all PSM tasks have.
//! - `setup`: `base` (x, y, z in m and turn in rad of the arm's base), `table_height` (m). The arm
//!   must reach the whole workspace.
//!
//! # Version History
//!
//! - v0: first version.

use nalgebra::{Point3, Vector3};
use trocar_proto::builtin::{self, TaskInfo};
use trocar_proto::spec::Element;
use trocar_proto::{Options, Rejection};

use super::State;
use super::tissue::Sheet;
use super::tissue_task::{Handling, Purpose};
use crate::render::Scene;
use crate::render::material::Material;
use crate::render::mesh::Mesh;
use crate::sim::frames::Pose;
use crate::sim::random::Rng;
use crate::sim::world::World;

/// Where the marked point is, m, sheet's frame: x from, to, and how far from the middle along y.
const MARKED: [f64; 2] = [10e-3, 20e-3];
const ASIDE: f64 = 10e-3;

/// Its place from where it lies, m: along x and up from, to, and how far to either side.
const ALONG: [f64; 2] = [-10e-3, 2e-3];
const UP: [f64; 2] = [4e-3, 14e-3];
const SIDEWAYS: f64 = 6e-3;

/// Radius of the mark in pictures, m.
const MARK: f64 = 1.5e-3;

/// The task; see the module's description.
pub type TissuePoint = Handling<Placing>;

/// A marked point.
#[derive(Debug, Clone)]
pub struct Placing;

impl Purpose for Placing {
    const INFO: TaskInfo = builtin::TISSUE_POINT;
    const POINT: &'static str = "mark";
    const NEAR: f64 = 3e-3;
    const CONSTANT: &'static [&'static str] = &[];

    fn new(_: &Options) -> Result<Self, Rejection> {
        Ok(Self)
    }

    fn begin(&mut self, rng: &mut Rng) -> ([f64; 2], Vector3<f64>) {
        let place = [rng.uniform(MARKED[0], MARKED[1]), rng.uniform(-ASIDE, ASIDE)];
        let x = rng.uniform(ALONG[0], ALONG[1]);
        let y = rng.uniform(-SIDEWAYS, SIDEWAYS);
        (place, Vector3::new(x, y, rng.uniform(UP[0], UP[1])))
    }

    fn look(&mut self, _: &Sheet, _: &World) {}

    fn parts() -> Vec<(Element, f32, f32)> {
        vec![]
    }

    fn goals(&self, _: &mut [f32], _: &mut [f32]) {}

    fn state(&self, _: &mut State<'_>) {}

    fn draw(&self, point: &Vector3<f64>, scene: &mut Scene) {
        scene.begin("mark");
        let ball = Mesh::capsule(&Point3::origin(), &Point3::origin(), MARK);
        scene.draw(ball.into(), Pose::from(*point), Material::named("accent"));
    }
}
