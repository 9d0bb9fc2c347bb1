//! Sleep: what hardly moves costs nothing until something touches it.

use rapier3d::prelude::{ContactPair, RigidBodyHandle};

use super::{SUBSTEPS_PER_SECOND, World};
use crate::sim::frames::SCALE;

/// Velocity below which a body may fall asleep, m/s.
const STILL: f64 = 0.5e-3;

/// Rate of turning below which it may, rad/s.
const STILL_TURN: f32 = 0.5;

impl World {
    /// Wakes what sleeps where something touches it that moves.
    pub(super) fn wake_touched(&mut self) {
        loop {
            let touched = self.moving().copied().find(|body| {
                self.bodies[*body].is_enabled()
                    && self.bodies[*body].is_sleeping()
                    && self.pairs_of(*body).any(|(pair, other)| self.moves(other) && is_near(pair))
            });
            let Some(body) = touched else { return };
            self.bodies[body].wake_up(true);
        }
    }

    /// The pairs of a body's parts with those of others, and whose these are.
    fn pairs_of(
        &self,
        body: RigidBodyHandle,
    ) -> impl Iterator<Item = (&ContactPair, RigidBodyHandle)> {
        let parts = self.bodies[body].colliders().iter();
        parts.flat_map(move |part| {
            self.narrow_phase.contact_pairs_with(*part).map(move |pair| {
                let met = if pair.collider1 == *part { pair.collider2 } else { pair.collider1 };
                (pair, self.colliders[met].parent().expect("every collider belongs to a body"))
            })
        })
    }

    /// Whether anything rigid is as near to a body as contacts are looked at.
    pub(super) fn is_near_rigid(&self, body: RigidBodyHandle) -> bool {
        self.pairs_of(body).any(|(pair, _)| is_near(pair))
    }

    /// Whether a body is awake, or driven from one place to another.
    fn moves(&self, body: RigidBodyHandle) -> bool {
        let body = &self.bodies[body];
        let is_awake = body.is_dynamic() && !body.is_sleeping();
        body.is_enabled() && (is_awake || body.is_moving())
    }

    /// Lets what of `awake` has hardly moved for a while fall asleep, where all that it touches may, too.
    pub(super) fn let_sleep(&mut self, awake: &[RigidBodyHandle]) {
        let still = (STILL * SCALE) as f32;
        let mut restless: Vec<_> = self.hinges.iter().map(|hinge| hinge.body).collect();
        for handle in awake {
            let body = &mut self.bodies[*handle];
            let is_still = body.linvel().length() < still && body.angvel().length() < STILL_TURN;
            let activation = body.activation_mut();
            let since = activation.time_since_can_sleep + (1.0 / SUBSTEPS_PER_SECOND) as f32;
            activation.time_since_can_sleep = if is_still { since } else { 0.0 };
            if activation.time_since_can_sleep < activation.time_until_sleep {
                restless.push(*handle);
            }
        }
        // What touches what may not sleep may not either.
        let mut next = 0;
        while let Some(body) = restless.get(next).copied() {
            for contact in &self.impulses {
                let [one, other] = contact.bodies;
                let met = if one == body { other } else { one };
                let touches = contact.bodies.contains(&body);
                if touches && awake.contains(&met) && !restless.contains(&met) {
                    restless.push(met);
                }
            }
            next += 1;
        }
        for body in awake.iter().filter(|body| !restless.contains(body)) {
            self.bodies[*body].sleep();
        }
    }
}

fn is_near(pair: &ContactPair) -> bool {
    pair.manifolds().iter().any(|manifold| !manifold.data.solver_contacts.is_empty())
}
