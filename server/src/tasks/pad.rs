//! The pad on which an object lies: rigid, or one that gives as `domain` says.
//!
//! Where it gives, its upper part is a plate on a spring: jaws may be pressed into it, and what lies on it sinks
//! with it. So jaws that come down too low find the height of a grasp by touch.

use nalgebra::Vector3;

use super::options::Domain;
use super::tray;
use crate::assets::Model;
use crate::render::Scene;
use crate::sim::frames::Pose;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, GRAVITY, Motion, Part, Shape, Spring, SprungId, World};

/// The part of its mass that moves with the top of a layer that is fixed below: as of a spring.
const MOVED: f64 = 1.0 / 3.0;

/// Thickness of the plate, m: pressed in as far as may be, it is still in the pad.
const THICKNESS: f64 = 0.003;

/// The pad of an environment.
#[derive(Debug, Clone)]
pub struct Pad {
    soft: Option<Soft>,
}

/// A pad that gives.
#[derive(Debug, Clone)]
struct Soft {
    plate: SprungId,
    spring: Spring,
    domain: Domain,
}

impl Pad {
    /// Puts the pad into a world with `tray`; it gives where `domain` has it so.
    pub fn insert(world: &mut World, tray: BodyId, domain: Domain) -> Self {
        let model = Model::pad();
        // Any spring: every episode draws its own.
        let spring = domain.draw_pad(&Rng::new(0, 0));
        let soft = spring.map(|spring| {
            let (at, outline) = (tray::scene_from_tray(), model.aabb(&Pose::identity()));
            let half = 0.5 * outline.extents();
            let half = Vector3::new(half.x, half.y, 0.5 * THICKNESS);
            let middle = outline.centre() + Vector3::z() * (0.5 * outline.extents().z - half.z);
            let part = Part { body_from_part: Pose::from(middle), shape: Shape::Cuboid(half) };
            let mass = MOVED * model.mass;
            let plate = world.insert_sprung(tray, spring, mass, &at, model.friction, &[part]);
            Soft { plate, spring, domain }
        });
        if soft.is_none() {
            world.insert(Motion::Fixed, &tray::scene_from_tray(), model.friction, &model.parts);
        }
        Self { soft }
    }

    /// Draws how this episode's pad gives, where it does; what lies on it must be laid anew.
    pub fn vary(&mut self, world: &mut World, rng: &Rng) {
        let Some(soft) = &mut self.soft else { return };
        if let Some(spring) = soft.domain.draw_pad(rng) {
            soft.spring = spring;
            world.set_spring(&soft.plate, spring);
        }
    }

    /// Lets an object that was laid on it, at rest, sink as far as it does by its weight.
    pub fn bear(&self, world: &mut World, object: BodyId) {
        let Some(soft) = &self.soft else { return };
        let sag = soft.spring.sag(world.inertia(object).mass * GRAVITY);
        self.sink(world, sag);
        let sink = Pose::translation(0.0, 0.0, -sag);
        let laid = world.pose(object);
        world.place(object, &(sink * laid));
    }

    /// How far it is pressed in now, m.
    pub fn sunk(&self, world: &World) -> f64 {
        let height = |pose: &Pose| pose.translation.z;
        self.soft.as_ref().map_or(0.0, |soft| {
            height(&tray::scene_from_tray()) - height(&world.pose(soft.plate.body()))
        })
    }

    /// Presses it in, at once; what lies on it must be placed anew. `depth`: m.
    pub fn sink(&self, world: &mut World, depth: f64) {
        let Some(soft) = &self.soft else { return };
        let sink = Pose::translation(0.0, 0.0, -depth);
        world.place(soft.plate.body(), &(sink * tray::scene_from_tray()));
    }

    /// How far jaws may be pressed into it, m.
    pub fn depth(&self) -> f64 {
        self.soft.as_ref().map_or(0.0, |soft| soft.spring.travel)
    }

    /// Draws it.
    pub fn draw(&self, world: &World, scene: &mut Scene) {
        let at = self.soft.as_ref().map(|soft| world.pose(soft.plate.body()));
        scene.add_model("pad", Model::pad(), &at.unwrap_or_else(tray::scene_from_tray));
    }
}

#[cfg(test)]
mod tests {
    use trocar_proto::{OptionValue, Options};

    use super::*;
    use crate::sim::frames::Aabb;
    use crate::sim::world::SUBSTEPS_PER_SECOND;
    use crate::tasks::options::{MOST_PAD_DEPTH, Preset};
    use crate::tasks::tray::Needle;

    fn domain(stiffness: f64, depth: f64) -> Domain {
        let rows = [("pad_stiffness", stiffness), ("pad_depth", depth)]
            .map(|(row, number)| (row.to_string(), vec![number; 2]));
        let rows = OptionValue::Table(rows.into());
        Domain::of(&Options::new().with("domain", rows)).unwrap()
    }

    #[test]
    fn a_needle_that_is_laid_on_it_lies_at_rest_where_it_has_sunk() {
        for preset in [Preset::Paper, Preset::Surrol] {
            for stiffness in [50.0, 1000.0] {
                let domain = domain(stiffness, MOST_PAD_DEPTH);
                let (mut world, mut pad) = tray::padded_world(preset, domain);
                let mut needle = Needle::insert(&mut world, preset, domain);
                let mut rng = Rng::new(3, 0);
                for _ in 0..5 {
                    pad.vary(&mut world, &rng);
                    needle.lay_anywhere(&mut world, &mut rng);
                    let flat = world.pose(needle.body()).translation.z;
                    pad.bear(&mut world, needle.body());
                    assert!(world.at_rest());
                    let laid = world.pose(needle.body());
                    let weight = GRAVITY * world.inertia(needle.body()).mass;
                    let sag = (weight / stiffness).min(MOST_PAD_DEPTH);
                    assert!((flat - laid.translation.z - sag).abs() < 1e-7);
                    world.wake(needle.body());
                    for _ in 0..SUBSTEPS_PER_SECOND as u32 {
                        world.advance();
                    }
                    assert!(world.at_rest(), "it falls asleep again");
                    let moved =
                        world.pose(needle.body()).translation.vector - laid.translation.vector;
                    assert!(moved.norm() < 0.02e-3, "{moved}");
                }
            }
        }
    }

    #[test]
    fn pressed_in_as_far_as_it_gives_its_plate_stays_in_the_pad_above_the_tray() {
        let outline: Aabb = tray::pad();
        assert!(outline.max.z - THICKNESS - MOST_PAD_DEPTH > outline.min.z);
    }
}
