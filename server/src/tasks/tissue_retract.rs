//! Tissue retraction: a PSM lifts the free edge of a sheet of fat, so that what lies under it is exposed.
//!
//! # Description
//!
//! A sheet of fat of 60 mm × 60 mm × 8 mm lies on the pad in the tray. Its edge at the lowest x is held where it is, and its
//! free edge faces the endoscope. Jaws hold it by friction alone. The sheet is a lattice of 288 hexahedra
//! ([`soft`](crate::sim::soft)) of the material `fat` of `assets/materials.csv`, with a Young's modulus of 5 kPa.
//! Under it, near the free edge, is a target of 10 mm. PSM1 is to grasp the edge and to bring a point of it 18 to 24 mm up and
//! 15 to 22 mm back, so that the endoscope sees the target. UnityFlexML's task of the same name is its model.
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
//! | 7–9 | point of the free edge before the target x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
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
//! | 51–53 | middle of the target x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 54 | share of the target that is exposed | 0 | 1 | 1 |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll), of the wrist-yaw link, whose y axis points along
//! the jaws and whose z axis is their hinge. The 12 points are at x = 5, 17 and 29 mm and y = −29, −10, 10 and 29 mm from
//! the sheet's middle. What is outside its range is shown at its end.
//!
//! # Goal
//!
//! | Num | Part | Achieved | Desired | Reached within | 1 in the dense reward |
//! |---|---|---|---|---|---|
//! | 0–2 | `edge` | the point of the edge x, y, z, m | its place | 8 mm | 10 mm |
//! | 3 | `held` | the share of the last three steps after which both fingers press on the sheet | 1 | 0.1 | 1 |
//! | 4 | `peak pull` | the largest force of the sheet on the jaws so far, at the ends of steps, N | 0 | 3 N | 3 N |
//! | 5 | `exposed` | the share of the target that the endoscope sees past the sheet | 1 | 0.2 | 1 |
//!
//! The share is that of 64 points spread over the target; instruments hide nothing.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where every part of the goal is reached, −1 otherwise. `dense`: minus the sum of all parts'
//! distances, each over what the table says. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The wrist at the corner (0.50, 0.05, 0.7202) m, jaws closed and straight down. The sheet is at rest. The target's middle is
//! 8 to 14 mm from the free edge and within 10 mm of the middle of its length.
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

use nalgebra::Vector3;
use trocar_proto::builtin::{self, TaskInfo};
use trocar_proto::spec::Element;
use trocar_proto::{Options, Rejection};

use super::State;
use super::exposure;
use super::objects::{self, THEATRE};
use super::options::{self, Preset};
use super::tissue::{self, Sheet};
use super::tissue_task::{self, Handling, Purpose};
use super::tray;
use crate::render::Scene;
use crate::sim::random::Rng;
use crate::sim::world::World;

/// Radius of the target, m.
const RADIUS: f64 = 5e-3;

/// How far the target's middle is from the free edge, m: from, to.
const UNDER: [f64; 2] = [8e-3, 14e-3];

/// How far from the middle of the edge target and taken point are, m.
const ASIDE: f64 = 10e-3;

/// The point's place from where it lies, m: to the held edge and up, from, to.
const BACK: [f64; 2] = [15e-3, 22e-3];
const UP: [f64; 2] = [18e-3, 24e-3];

/// Share of the target that may be hidden, exclusive.
const HIDDEN: f32 = 0.2;

/// The task; see the module's description.
pub type TissueRetract = Handling<Exposing>;

/// A target under the sheet.
#[derive(Debug, Clone)]
pub struct Exposing {
    eye: Vector3<f64>,
    target: Vector3<f64>,
    exposed: f64,
    /// How often the sheet had moved when that was found.
    found_at: Option<u64>,
}

impl Purpose for Exposing {
    const INFO: TaskInfo = builtin::TISSUE_RETRACT;
    const POINT: &'static str = "edge";
    const NEAR: f64 = 8e-3;
    const CONSTANT: &'static [&'static str] = &["target z"];

    fn new(options: &Options) -> Result<Self, Rejection> {
        let eye = exposure::eye(options::arm_of(options)?);
        Ok(Self { eye, target: Vector3::zeros(), exposed: 0.0, found_at: None })
    }

    fn begin(&mut self, rng: &mut Rng) -> ([f64; 2], Vector3<f64>) {
        let edge = tissue::HALF.x;
        let (under, y) = (rng.uniform(UNDER[0], UNDER[1]), rng.uniform(-ASIDE, ASIDE));
        let middle = Sheet::pose().translation.vector;
        self.target = Vector3::new(middle.x + edge - under, middle.y + y, tray::pad().max.z);
        self.found_at = None;
        let (back, up) = (rng.uniform(BACK[0], BACK[1]), rng.uniform(UP[0], UP[1]));
        ([edge, y], Vector3::new(-back, 0.0, up))
    }

    fn look(&mut self, sheet: &Sheet, world: &World) {
        let body = world.soft(sheet.soft());
        if self.found_at != Some(body.moves()) {
            self.exposed = exposure::share(&self.eye, &self.target, RADIUS, body);
            self.found_at = Some(body.moves());
        }
    }

    fn parts() -> Vec<(Element, f32, f32)> {
        vec![(Element::new("exposed", "", "1", 0.0, 1.0), HIDDEN, 1.0)]
    }

    fn goals(&self, achieved: &mut [f32], desired: &mut [f32]) {
        (achieved[0], desired[0]) = (self.exposed as f32, 1.0);
    }

    fn state(&self, state: &mut State<'_>) {
        objects::position("target", &THEATRE, Preset::Paper, &self.target, state);
        state.field(|| Element::new("exposed", "", "1", 0.0, 1.0), self.exposed);
    }

    fn draw(&self, _: &Vector3<f64>, scene: &mut Scene) {
        tissue_task::draw_disc("target", &self.target, RADIUS, scene);
    }
}
