//! Cylinder reach: the closed jaw tip of a PSM goes to a point just above a standing cylinder.
//!
//! # Description
//!
//! A steel pin 6 mm long and 2.5 mm thick stands on a pad in a tray. The tip of PSM1's closed jaws, which points straight
//! down, must come within 5 mm of a point 5 mm above its upper end. The pin is a real object: the instrument can push
//! it over, and the goal stays where it was.
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
//! | 3 | ignored (turn in other tasks) | −1 | 1 | – |
//! | 4 | ignored (jaw in other tasks) | −1 | 1 | – |
//!
//! The movement starts from the sensed wrist, takes 0.2 s along a smooth profile, and is confined
//! to the workspace: see [`psm_scene`](super::psm_scene). The jaws stay closed in every mode.
//!
//! # Observation Space
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | wrist x (wrist-yaw axis, as sensed), scene frame | 0.495 | 0.605 | m |
//! | 1 | wrist y | −0.055 | 0.055 | m |
//! | 2 | wrist z | 0.6842 | 0.7722 | m |
//! | 3 | roll of the wrist link; −π/2 under `paper` | −π | π | rad |
//! | 4 | pitch; 0 under `paper` | −π/2 | π/2 | rad |
//! | 5 | yaw; π/2 under `paper` | −π | π | rad |
//! | 6 | jaw angle; always 0 | −0.1 | 1.6 | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll), of the wrist-yaw link,
//! whose y axis points along the jaws and whose z axis is their hinge. Achieved goal: the true tip
//! (x, y, z, m), 10.2 mm from the wrist; desired goal: the point above the cylinder. Both ignore
//! `domain`'s noise and encoder errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where the goals are less than 5 mm apart, −1 otherwise. `dense`: minus
//! their distance, m. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The wrist at the corner (0.50, 0.05, 0.7552) m, jaws closed and straight down. The cylinder stands on its end.
//! `spawn = "workspace"`: anywhere on the part of the pad that lies in the 10 cm workspace. `spawn = "narrow"`: within
//! ±25 mm of the workspace's centre along x and y.
//!
//! # Episode End
//!
//! Truncated after 50 steps; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, `spawn`, and:
//!
//! - `preset = "surrol"`: positions, goals and tolerance in units of 0.2 m (metres × 5), cylinder of
//!   10 g, `spawn = "narrow"` unless given.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see
//!   [`psm_scene`](super::psm_scene); not with `preset = "surrol"`.
//! - `domain`: `mass` (0.5 to 5; factor on the mass, besides what the size makes of it: stiffness
//!   of contacts is per mass, so fingers sink into what is lighter), `size` (0.8 to 1.2; factor on
//!   all lengths) of the cylinder, `observation_noise` (m, on observed positions), `joint_offset`
//!   (rad, on every rotary joint), `latency` (steps; the arm holds until the first action
//!   arrives).
//! - `setup`: `base` (x, y, z in m and turn in rad of the arm's base), `table_height` (m). The arm
//!   must reach the whole workspace.
//!
//! # Differences from dVRL's Reach
//!
//! - The goal is above a cylinder, which the instrument can push over; dVRL's is a point in the air.
//! - An action moves by up to 10 mm in 0.2 s; dVRL's by up to 1 mm.
//! - Success is 5 mm, as in all tasks; dVRL's 3 mm is `tolerance = 0.6`.
//! - Metres in the scene frame; dVRL divides positions by 50 mm.
//!
//! # Version History
//!
//! - v0: first version.

use nalgebra::Vector3;
use trocar_proto::builtin::{self, TaskInfo};

use super::cylinder::Cylinder;
use super::options::{Domain, Preset};
use super::reaching::{Reachable, Reaching};
use crate::render::Scene;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// The task; see the module's description.
pub type CylinderReach = Reaching<Cylinder>;

impl Reachable for Cylinder {
    const INFO: TaskInfo = builtin::CYLINDER_REACH;
    const NAME: &'static str = "cylinder";
    const SIZE: [f64; 2] = Cylinder::SIZE;

    fn insert(world: &mut World, preset: Preset, domain: Domain) -> Self {
        Cylinder::insert(world, preset, domain)
    }

    fn body(&self) -> BodyId {
        Cylinder::body(self)
    }

    fn lay(&mut self, narrow: bool, world: &mut World, rng: &mut Rng) {
        self.stand(narrow, world, rng);
    }

    fn reached(&self, world: &World) -> Vector3<f64> {
        self.upper_end(world).translation.vector
    }

    fn draw(&self, world: &World, scene: &mut Scene) {
        Cylinder::draw(self, world, scene);
    }
}
