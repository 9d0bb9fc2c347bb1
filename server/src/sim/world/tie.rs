//! What holds a body to a driven one without friction: the grasp modes that imitate others.

use rapier3d::prelude::{
    FixedJointBuilder, Group, ImpulseJointHandle, InteractionGroups, InteractionTestMode,
};

use super::{BodyId, World};

/// What ties two bodies together; see [`World::tie`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TieId(ImpulseJointHandle);

impl World {
    /// Ties `object` to the driven body `carrier` where both are.
    pub fn tie(&mut self, carrier: BodyId, object: BodyId) -> TieId {
        let world_from_carrier = *self.bodies[carrier.0].position();
        let carrier_from_object = world_from_carrier.inverse() * *self.bodies[object.0].position();
        let joint =
            FixedJointBuilder::new().local_frame1(carrier_from_object).contacts_enabled(false);
        TieId(self.impulse_joints.insert(carrier.0, object.0, joint, true))
    }

    /// Unties what `tie` holds.
    pub fn untie(&mut self, tie: TieId) {
        self.impulse_joints.remove(tie.0, true);
    }

    /// Lets hinged bodies pass through `object`.
    pub fn ignore_hinged(&mut self, object: BodyId) {
        // Hinged bodies are in the groups from the second on, everything else is in all.
        let groups = InteractionGroups::new(Group::ALL, Group::GROUP_1, InteractionTestMode::And);
        for handle in self.bodies[object.0].colliders() {
            self.colliders[*handle].set_collision_groups(groups);
        }
    }
}
