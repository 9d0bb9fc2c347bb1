//! The tray on its table with the pad in it, and the needle on the pad, in the scene frame of
//! [`psm_scene`](super::psm_scene).

use std::f64::consts::FRAC_PI_2;

use super::objects::Object;
use super::options::{Domain, Preset};
use super::pad::Pad;
use super::psm_scene::WORKSPACE;
use crate::assets::{Model, Scaled};
use crate::render::Scene;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, Motion, Solver, World};

/// Origin of the table: the floor below its middle, m. Source: the original.
const TABLE_ORIGIN: [f64; 3] = [0.5, 0.0, 0.001];

/// Origin of the tray and of the pad in it, m. Source: the original.
const TRAY_ORIGIN: [f64; 3] = [0.55, 0.0, 0.6751];

/// A world with the table, and the solver that the preset's objects need.
pub fn bare_table(preset: Preset) -> World {
    let mut world = World::new(match preset {
        Preset::Paper => Solver::LIGHT,
        Preset::Surrol => Solver::HEAVY,
    });
    furnish(&mut world, Model::table(), TABLE_ORIGIN);
    world
}

/// A world with table, tray and pad, and the solver that the preset's objects need.
pub fn furnished_world(preset: Preset) -> World {
    padded_world(preset, Domain::default()).0
}

/// The same, where the pad gives as `domain` has it, and the pad.
pub fn padded_world(preset: Preset, domain: Domain) -> (World, Pad) {
    let mut world = bare_table(preset);
    let tray = furnish(&mut world, Model::tray(), TRAY_ORIGIN);
    let pad = Pad::insert(&mut world, tray, domain);
    (world, pad)
}

/// Puts static bodies into the world, its origin at `origin` (m).
pub fn furnish(world: &mut World, model: &Model, origin: [f64; 3]) -> BodyId {
    let pose = frames::pose(origin, [0.0; 3]);
    world.insert(Motion::Fixed, &pose, model.friction, &model.parts)
}

/// Draws the tray with a rigid pad in it.
pub fn draw(scene: &mut Scene) {
    draw_tray(scene);
    scene.add_model("pad", Model::pad(), &scene_from_tray());
}

/// Draws the tray alone.
pub fn draw_tray(scene: &mut Scene) {
    scene.add_model("tray", Model::tray(), &scene_from_tray());
}

/// Draws the table, 1 mm lower than the original has it: there its top is above the tray's floor.
pub fn draw_table(scene: &mut Scene) {
    let [x, y, z] = TABLE_ORIGIN;
    scene.add_model("table", Model::table(), &frames::pose([x, y, z - 0.001], [0.0; 3]));
}

/// The pad on which objects lie, m.
pub fn pad() -> Aabb {
    Model::pad().aabb(&scene_from_tray())
}

/// The tray, and the pad in it where nothing presses on it, scene frame.
pub fn scene_from_tray() -> Pose {
    frames::pose(TRAY_ORIGIN, [0.0; 3])
}

/// The 40 mm suture needle.
#[derive(Debug, Clone)]
pub struct Needle {
    object: Object,
    domain: Domain,
}

impl Needle {
    /// Mass under `preset = "surrol"`, kg. Source: the original.
    const SURROL_MASS: f64 = 0.01;

    /// `spawn = "narrow"`: largest distance of the circle's centre from the workspace's along x and y, m. Source: the
    /// original.
    pub const NARROW: f64 = 0.01;

    /// Its sizes with which experts do their work: the wire must fit the jaws, the arc the pad.
    pub const SIZE: [f64; 2] = [0.8, 1.2];

    /// Puts a needle into the world, whose mass and size episodes draw from `domain`.
    pub fn insert(world: &mut World, preset: Preset, domain: Domain) -> Self {
        let model = Model::needle();
        let mass = match preset {
            Preset::Paper => model.mass,
            Preset::Surrol => Self::SURROL_MASS,
        };
        let at = resting(&model.scaled(1.0), pad().centre().x, pad().centre().y, 0.0);
        Self { object: Object::insert(world, model, mass, &at), domain }
    }

    /// Draws this episode's mass and size, where they vary; the needle must be laid anew.
    pub fn vary(&mut self, world: &mut World, rng: &Rng) {
        if let Some(variation) = self.domain.draw_variation(rng) {
            self.object.vary(world, variation);
        }
    }

    /// Its shapes and frames in this episode.
    pub fn form(&self) -> &Scaled<'static> {
        self.object.form()
    }

    /// The body in the world.
    pub fn body(&self) -> BodyId {
        self.object.body()
    }

    /// Lays the needle flat on the pad, at rest: `x` and `y` of the circle's centre, m, and turn
    /// about the vertical, rad.
    pub fn lay(&self, world: &mut World, x: f64, y: f64, yaw: f64) {
        world.place(self.body(), &resting(self.form(), x, y, yaw));
    }

    /// Lays the needle flat, turned by up to 90° either way, anywhere that is wholly on the pad and
    /// in the workspace.
    pub fn lay_anywhere(&mut self, world: &mut World, rng: &mut Rng) {
        self.vary(world, rng);
        let yaw = rng.uniform(-FRAC_PI_2, FRAC_PI_2);
        let outline = self.form().aabb(&frames::pose([0.0; 3], [0.0, 0.0, yaw]));
        let pad = pad();
        let mut along = |axis: usize| {
            let low = pad.min[axis].max(WORKSPACE.min[axis]) - outline.min[axis];
            rng.uniform(low, pad.max[axis].min(WORKSPACE.max[axis]) - outline.max[axis])
        };
        let (x, y) = (along(0), along(1));
        self.lay(world, x, y, yaw);
    }

    /// Lays the needle flat, turned by up to 90° either way, the centre of its circle within
    /// 10 mm of the workspace's along x and y.
    pub fn lay_near_the_middle(&mut self, world: &mut World, rng: &mut Rng) {
        self.vary(world, rng);
        let centre = WORKSPACE.centre();
        let x = centre.x + rng.uniform(-Self::NARROW, Self::NARROW);
        let y = centre.y + rng.uniform(-Self::NARROW, Self::NARROW);
        let yaw = rng.uniform(-FRAC_PI_2, FRAC_PI_2);
        self.lay(world, x, y, yaw);
    }

    /// Draws the needle.
    pub fn draw(&self, world: &World, scene: &mut Scene) {
        self.object.draw(world, "needle", scene);
    }

    /// The middle of the arc, scene frame: x towards the centre of the arc, y along the wire.
    pub fn scene_from_middle(&self, world: &World) -> Pose {
        world.pose(self.body()) * self.form().body_from("mid_arc")
    }
}

/// Where a needle touches the pad along its whole length.
fn resting(needle: &Scaled, x: f64, y: f64, yaw: f64) -> Pose {
    let below = needle.aabb(&Pose::identity()).min.z;
    frames::pose([x, y, pad().max.z - below], [0.0, 0.0, yaw])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_needle_lies_on_pad_and_workspace_and_stays_where_it_is_laid() {
        let mut world = furnished_world(Preset::Paper);
        let mut needle = Needle::insert(&mut world, Preset::Paper, Domain::default());
        let mut rng = Rng::new(3, 0);
        for _ in 0..20 {
            needle.lay_anywhere(&mut world, &mut rng);
            let laid = world.pose(needle.body());
            world.wake(needle.body());
            for _ in 0..24 {
                world.advance();
            }
            let moved = world.pose(needle.body()).translation.vector - laid.translation.vector;
            assert!(moved.norm() < 0.02e-3, "{moved}");
            let outline = Model::needle().aabb(&laid);
            let inside = |area: &Aabb, axis: usize| {
                area.min[axis] - 1e-9 <= outline.min[axis]
                    && outline.max[axis] <= area.max[axis] + 1e-9
            };
            assert!((0..2).all(|axis| inside(&WORKSPACE, axis) && inside(&pad(), axis)));
        }
    }
}
