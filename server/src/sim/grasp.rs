//! What holds an object in the jaws: friction alone, or, to compare with others, an attachment.
//!
//! | mode | the object is held by |
//! |---|---|
//! | [`GraspMode::Interact`] | friction, and nothing else ever |
//! | [`GraspMode::Approx`] | an attachment, as soon as jaws are told to close whose tip is near its surface; fingers do not meet it |
//! | [`GraspMode::Weld`] | friction until it is lifted, then an attachment; it lets go when no finger touches |
//!
//! An attachment holds the object where it is to the wrist, until the jaws are told to open. One arm at a
//! time has an attachment.

use super::instrument::Instrument;
use super::world::{BodyId, World};

/// What may hold an object in the jaws.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GraspMode {
    /// Friction.
    Interact,
    /// Nearness. The paper's Approx@1, 2 and 3 mm.
    Approx {
        /// From the tip of the closed jaws to the object's surface, m.
        distance: f64,
    },
    /// Friction, then an attachment. What the original calls Interact.
    Weld,
}

/// The grasp of one object.
#[derive(Debug, Clone)]
pub struct Grasp {
    mode: GraspMode,
    object: BodyId,
    /// The arm whose fingers both touched when it was told to close (weld).
    seized_by: Option<usize>,
}

impl Grasp {
    /// How `object` is held in `world`, into which it was put.
    pub fn new(world: &mut World, mode: GraspMode, object: BodyId) -> Self {
        let mut grasp = Self { mode, object, seized_by: None };
        grasp.reset(world, object);
        grasp
    }

    /// Begins an episode in which `object` is to be grasped.
    pub fn reset(&mut self, world: &mut World, object: BodyId) {
        (self.object, self.seized_by) = (object, None);
        if matches!(self.mode, GraspMode::Approx { .. }) {
            world.ignore_hinged(object);
        }
    }

    /// What happens when arms are told to close (true) or open their jaws, before they move.
    pub fn command<const N: usize>(
        &mut self,
        world: &mut World,
        mut arms: [&mut Instrument; N],
        closing: [bool; N],
    ) {
        for (index, (arm, closing)) in arms.iter_mut().zip(closing).enumerate() {
            if !closing {
                arm.detach(world);
                self.seized_by = self.seized_by.filter(|by| *by != index);
            }
        }
        if arms.iter().any(|arm| arm.is_tied_to(self.object)) || self.seized_by.is_some() {
            return;
        }
        for (index, (arm, closing)) in arms.iter_mut().zip(closing).enumerate() {
            match self.mode {
                GraspMode::Approx { distance } if closing => {
                    let tip = arm.posture().world_from_tip().translation.vector.into();
                    if world.distance(self.object, &tip) <= distance {
                        arm.attach(world, self.object);
                        return;
                    }
                }
                GraspMode::Weld if closing && arm.holds(world, self.object) => {
                    self.seized_by = Some(index);
                    return;
                }
                _ => {}
            }
        }
    }

    /// What happens after arms moved; `is_lifted` tells whether an attachment may replace friction.
    pub fn settle<const N: usize>(
        &mut self,
        world: &mut World,
        mut arms: [&mut Instrument; N],
        is_lifted: bool,
    ) {
        if self.mode != GraspMode::Weld {
            return;
        }
        for (index, arm) in arms.iter_mut().enumerate() {
            if self.seized_by != Some(index) {
                continue; // what else attaches the object is not the business of this mode
            }
            if arm.is_tied_to(self.object) {
                if arm.fingers_touching(world, self.object) == 0 {
                    arm.detach(world);
                    self.seized_by = None;
                }
            } else if is_lifted {
                if arm.holds(world, self.object) {
                    arm.attach(world, self.object);
                } else {
                    self.seized_by = None;
                }
            }
        }
    }
}
