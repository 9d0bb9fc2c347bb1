//! The gauze in its tray, in the scene frame of [`psm_scene`](super::psm_scene).

use nalgebra::Vector3;

use super::objects::Object;
use super::options::{Domain, Preset};
use super::pad::Pad;
use super::psm_scene::WORKSPACE;
use super::tray;
use crate::assets::{Model, Scaled};
use crate::render::Scene;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// Origin of the tray, m: a little higher than with a pad in it. Source: the original.
const TRAY_ORIGIN: [f64; 3] = [0.55, 0.0, 0.6781];

/// A world with table and tray, and the solver that the preset's objects need; and the pad in the tray, where
/// `domain` has one that gives.
pub fn furnished_world(preset: Preset, domain: Domain) -> (World, Option<Pad>) {
    if domain.has_soft_pad() {
        let (world, pad) = tray::padded_world(preset, domain);
        return (world, Some(pad));
    }
    let mut world = tray::bare_table(preset);
    tray::furnish(&mut world, Model::tray(), TRAY_ORIGIN);
    (world, None)
}

/// Height on which the gauze lies, m: of the tray's floor, or of the pad in it that `domain` has.
pub fn floor(domain: Domain) -> f64 {
    if domain.has_soft_pad() {
        tray::pad().max.z
    } else {
        Model::tray().parts[0].aabb(&scene_from_tray()).max.z
    }
}

/// Height of the tray's rim, m.
pub fn rim() -> f64 {
    Model::tray().aabb(&scene_from_tray()).max.z
}

fn scene_from_tray() -> Pose {
    frames::pose(TRAY_ORIGIN, [0.0; 3])
}

/// A folded swab with a pleat by which it is gripped.
#[derive(Debug, Clone)]
pub struct Gauze {
    object: Object,
    domain: Domain,
}

impl Gauze {
    /// Mass under `preset = "surrol"`, kg. Source: the original.
    const SURROL_MASS: f64 = 0.05;

    /// `spawn = "narrow"`: largest distance of its middle from the workspace's centre along x and y, m. Source: the
    /// original.
    pub const NARROW: f64 = 0.01;

    /// Its sizes with which the expert does its work: the pleat must fit the jaws.
    pub const SIZE: [f64; 2] = [0.8, 1.2];

    /// Puts a gauze into the world, whose mass and size episodes draw from `domain`.
    pub fn insert(world: &mut World, preset: Preset, domain: Domain) -> Self {
        let model = Model::gauze();
        let mass = match preset {
            Preset::Paper => model.mass,
            Preset::Surrol => Self::SURROL_MASS,
        };
        let centre = WORKSPACE.centre();
        let at = resting(&model.scaled(1.0), centre.x, centre.y, floor(domain));
        Self { object: Object::insert(world, model, mass, &at), domain }
    }

    /// The body in the world.
    pub fn body(&self) -> BodyId {
        self.object.body()
    }

    /// Lays the gauze on the floor of the tray, at rest, its pleat along x; `x` and `y` of its middle,
    /// m.
    pub fn lay(&self, world: &mut World, x: f64, y: f64) {
        world.place(self.body(), &resting(self.object.form(), x, y, floor(self.domain)));
    }

    /// Lays the gauze anywhere that is wholly in the workspace.
    pub fn lay_anywhere(&mut self, world: &mut World, rng: &mut Rng) {
        self.vary(world, rng);
        let half = self.outline().extents() * 0.5;
        let mut along = |axis: usize| {
            rng.uniform(WORKSPACE.min[axis] + half[axis], WORKSPACE.max[axis] - half[axis])
        };
        let (x, y) = (along(0), along(1));
        self.lay(world, x, y);
    }

    /// Lays the gauze with its middle within 10 mm of the workspace's along x and y.
    pub fn lay_near_the_middle(&mut self, world: &mut World, rng: &mut Rng) {
        self.vary(world, rng);
        let centre = WORKSPACE.centre();
        let x = centre.x + rng.uniform(-Self::NARROW, Self::NARROW);
        let y = centre.y + rng.uniform(-Self::NARROW, Self::NARROW);
        self.lay(world, x, y);
    }

    /// Draws the gauze and its tray, where it has no pad.
    pub fn draw(&self, world: &World, scene: &mut Scene) {
        if self.domain.has_soft_pad() {
            tray::draw_tray(scene);
        } else {
            scene.add_model("tray", Model::tray(), &scene_from_tray());
        }
        self.object.draw(world, "gauze", scene);
    }

    /// How many times as large as the model it is in this episode.
    pub fn size(&self) -> f64 {
        self.object.form().size()
    }

    /// The middle of the crest of its pleat in the gauze, m.
    pub fn crest(&self) -> Vector3<f64> {
        Vector3::z() * self.outline().max.z
    }

    /// Height of the sheet beside the pleat in the gauze, m.
    pub fn sheet(&self) -> f64 {
        let sheet = self.object.form().parts().next().expect("a gauze has a sheet");
        sheet.aabb(&Pose::identity()).max.z
    }

    fn outline(&self) -> Aabb {
        self.object.form().aabb(&Pose::identity())
    }

    /// Draws this episode's mass and size, where they vary.
    pub fn vary(&mut self, world: &mut World, rng: &Rng) {
        if let Some(variation) = self.domain.draw_variation(rng) {
            self.object.vary(world, variation);
        }
    }
}

/// Where a gauze lies flat on a `floor` (m).
fn resting(gauze: &Scaled, x: f64, y: f64, floor: f64) -> Pose {
    frames::pose([x, y, floor - gauze.aabb(&Pose::identity()).min.z], [0.0; 3])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gauze_that_is_dropped_lies_on_the_floor_not_in_it() {
        let (mut world, _) = furnished_world(Preset::Paper, Domain::default());
        let gauze = Gauze::insert(&mut world, Preset::Paper, Domain::default());
        for (index, height) in [0.01, 0.03, 0.05].into_iter().enumerate() {
            let tilt = 0.1 * index as f64;
            let mut pose = frames::pose([0.55, 0.0, 0.0], [tilt, 0.5 * tilt, 0.0]);
            pose.translation.z = floor(Domain::default()) + height;
            world.place(gauze.body(), &pose);
            world.wake(gauze.body());
            for _ in 0..480 {
                world.advance();
            }
            assert!(world.at_rest());
            let sunk =
                floor(Domain::default()) - Model::gauze().aabb(&world.pose(gauze.body())).min.z;
            assert!(sunk.abs() < 0.1e-3, "from {height} m: {sunk} m");
        }
    }

    #[test]
    fn a_gauze_lies_in_tray_and_workspace_and_stays_where_it_is_laid() {
        for preset in [Preset::Paper, Preset::Surrol] {
            let (mut world, _) = furnished_world(preset, Domain::default());
            let mut gauze = Gauze::insert(&mut world, preset, Domain::default());
            let mut rng = Rng::new(3, 0);
            for _ in 0..20 {
                gauze.lay_anywhere(&mut world, &mut rng);
                let laid = world.pose(gauze.body());
                world.wake(gauze.body());
                for _ in 0..240 {
                    world.advance();
                }
                assert!(world.at_rest(), "it falls asleep again");
                let moved = world.pose(gauze.body()).inv_mul(&laid);
                assert!(moved.translation.vector.norm() < 0.02e-3, "{moved}");
                let outline = Model::gauze().aabb(&laid);
                assert!((outline.min.z - floor(Domain::default())).abs() < 1e-6);
                for axis in 0..2 {
                    assert!(WORKSPACE.min[axis] < outline.min[axis] + 1e-9, "{outline:?}");
                    assert!(outline.max[axis] < WORKSPACE.max[axis] + 1e-9, "{outline:?}");
                }
            }
        }
    }
}
