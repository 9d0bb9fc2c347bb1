//! The cylinder on its pad, in the scene frame of [`psm_scene`](super::psm_scene).

use super::objects::Object;
use super::options::{Domain, Preset};
use super::psm_scene::WORKSPACE;
use super::tray;
use crate::assets::Model;
use crate::render::Scene;
use crate::sim::frames::{self, Pose};
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// A steel pin that stands on its end.
#[derive(Debug, Clone)]
pub struct Cylinder {
    object: Object,
    domain: Domain,
}

impl Cylinder {
    /// Mass under `preset = "surrol"`, kg: that of the original's needle.
    const SURROL_MASS: f64 = 0.01;

    /// Its sizes with which the expert does its work: it must fit the jaws.
    pub const SIZE: [f64; 2] = [0.8, 1.2];

    /// `spawn = "narrow"`: how far it is from the workspace's centre along x and y, m. Source: dVRL's Pick.
    pub const NARROW: f64 = 0.025;

    /// Puts a cylinder into the world, whose mass and size episodes draw from `domain`.
    pub fn insert(world: &mut World, preset: Preset, domain: Domain) -> Self {
        let model = Model::cylinder();
        let mass = match preset {
            Preset::Paper => model.mass,
            Preset::Surrol => Self::SURROL_MASS,
        };
        let at = Pose::from(WORKSPACE.centre());
        Self { object: Object::insert(world, model, mass, &at), domain }
    }

    /// The body in the world.
    pub fn body(&self) -> BodyId {
        self.object.body()
    }

    /// How many times as large as the model it is in this episode.
    pub fn size(&self) -> f64 {
        self.object.form().size()
    }

    /// Half its length in this episode, m.
    pub fn half_length(&self) -> f64 {
        self.object.form().aabb(&Pose::identity()).max.z
    }

    /// The middle of its upper end; z is its axis.
    pub fn upper_end(&self, world: &World) -> Pose {
        world.pose(self.body()) * Pose::translation(0.0, 0.0, self.half_length())
    }

    /// Lets it stand on the pad, at rest: anywhere in the workspace, or `narrow`, near its middle.
    pub fn stand(&mut self, narrow: bool, world: &mut World, rng: &mut Rng) {
        self.vary(world, rng);
        let outline = self.object.form().aabb(&Pose::identity());
        let mut along = |axis: usize| {
            let middle = WORKSPACE.centre()[axis];
            let half = if narrow {
                Self::NARROW
            } else {
                0.5 * WORKSPACE.extents()[axis] - outline.max[axis]
            };
            rng.uniform(middle - half, middle + half)
        };
        let (x, y) = (along(0), along(1));
        let z = tray::pad().max.z + self.half_length();
        world.place(self.body(), &frames::pose([x, y, z], [0.0; 3]));
    }

    /// Draws mass and size of the episode, if they vary; it must be placed anew.
    pub fn vary(&mut self, world: &mut World, rng: &Rng) {
        if let Some(variation) = self.domain.draw_variation(rng) {
            self.object.vary(world, variation);
        }
    }

    /// Draws it.
    pub fn draw(&self, world: &World, scene: &mut Scene) {
        self.object.draw(world, "cylinder", scene);
    }
}
