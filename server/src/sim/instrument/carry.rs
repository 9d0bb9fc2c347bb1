//! Placement of an instrument together with the object in its jaws.

use nalgebra::UnitQuaternion;

use super::jaws::SIDES;
use super::{Fingers, Instrument, Posture, hinge};
use crate::sim::frames::Pose;
use crate::sim::world::{BodyId, World};

impl Instrument {
    /// Places the instrument at `posture` at once. Fingers keep their angles, times `widening`, and the caller places
    /// the held object. An attachment is made again at the new poses.
    pub(crate) fn carry(&mut self, world: &mut World, posture: Posture, widening: f64) {
        if self.stale {
            self.posture = posture;
            return;
        }
        let world_from_wrist = posture.world_from_wrist;
        match &self.fingers {
            Fingers::Locked(fingers) => {
                for (finger, side) in fingers.iter().zip(SIDES) {
                    world.place(*finger, &posture.world_from_finger(side));
                }
            }
            Fingers::Gripping { fingers, .. } => {
                let angles = fingers.each_ref().map(|finger| world.hinge_angle(finger));
                for ((finger, side), angle) in fingers.iter().zip(SIDES).zip(angles) {
                    let turn = UnitQuaternion::from_axis_angle(&hinge(side).axis, angle * widening);
                    world.place_hinged(finger, &(world_from_wrist * turn));
                }
            }
        }
        world.place(self.wrist, &world_from_wrist);
        self.posture = posture;
        if let Some((object, _)) = self.attached {
            self.attach(world, object);
        }
    }

    /// True if `body` is the wrist or a finger of this instrument.
    pub(crate) fn has_body(&self, body: BodyId) -> bool {
        self.bodies().contains(&body)
    }

    /// Deepest overlap of wrist and fingers with fixed bodies, m; 0 without overlap. Of an instrument that passes
    /// beside the world, the overlap with objects counts too.
    pub(crate) fn static_overlap(&self, world: &World) -> f64 {
        if self.stale {
            return self.deepest_overlap(world);
        }
        let depths = self.bodies().map(|body| world.meets_static(body, &Pose::identity()).depth);
        depths.into_iter().fold(0.0, f64::max)
    }
}
