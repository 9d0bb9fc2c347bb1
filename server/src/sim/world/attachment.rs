//! What holds a body to a driven one without friction: the grasp modes that imitate others.

use rapier3d::math::{Pose as EnginePose, Vector};
use rapier3d::prelude::{Group, InteractionGroups, InteractionTestMode, RigidBodyHandle};

use super::constraint::{Constraints, Joint, Spatial};
use super::{BodyId, World, frames};

/// What attaches a body to another; see [`World::attach`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AttachmentId {
    carrier: RigidBodyHandle,
    object: RigidBodyHandle,
}

/// An attachment, and where the object is to be, in engine units.
#[derive(Debug, Clone)]
pub(super) struct Attachment {
    pub id: AttachmentId,
    carrier_from_object: EnginePose,
    /// What it bore at the end of the last substep, along and about each axis in turn.
    pub impulses: [f32; 6],
}

impl AttachmentId {
    pub(super) fn bodies(self) -> [RigidBodyHandle; 2] {
        [self.carrier, self.object]
    }
}

impl World {
    /// Attaches `object` to the driven body `carrier` where both are.
    pub fn attach(&mut self, carrier: BodyId, object: BodyId) -> AttachmentId {
        let world_from_carrier = *self.bodies[carrier.0].position();
        let carrier_from_object = world_from_carrier.inverse() * *self.bodies[object.0].position();
        let id = AttachmentId { carrier: carrier.0, object: object.0 };
        self.attachments.push(Attachment { id, carrier_from_object, impulses: [0.0; 6] });
        self.bodies[object.0].wake_up(true);
        id
    }

    /// Detaches what `attachment` holds, if it is still there.
    pub fn detach(&mut self, attachment: AttachmentId) {
        let attachments = self.attachments.len();
        self.attachments.retain(|attached| attached.id != attachment);
        if self.attachments.len() < attachments {
            self.bodies[attachment.object].wake_up(true);
        }
    }

    /// Adds the rows of an attachment: along the axes of the world, and about those of the object's inertia. They do not act on
    /// each other, since all are at its centre of mass.
    pub(super) fn add_attachment(
        &self,
        attachment: &Attachment,
        number: usize,
        constraints: &mut Constraints,
    ) {
        let [carrier, object] = attachment.id.bodies().map(|body| &self.bodies[body]);
        let mass = &object.mass_properties().local_mprops;
        let wanted = *carrier.position() * attachment.carrier_from_object;
        let centre = object.center_of_mass();
        let offset = centre - wanted.transform_point(mass.local_com);
        let turn = frames::rotation_vector(*object.rotation() * wanted.rotation.inverse());
        let [velocity, rate] = [carrier.velocity_at_point(centre), carrier.angvel()];
        let principal = *object.rotation() * mass.principal_inertia_local_frame;
        for (index, axis) in [Vector::X, Vector::Y, Vector::Z].into_iter().enumerate() {
            let [force, torque] =
                [attachment.impulses[2 * index], attachment.impulses[2 * index + 1]];
            let along = Spatial::new(axis, Vector::ZERO);
            let lock = Joint::Lock { position: offset.dot(axis), impulse: force };
            constraints.add_joint(number, along, velocity.dot(axis), lock);
            let axis = principal.mul_vec3(axis);
            let about = Spatial::new(Vector::ZERO, axis);
            let lock = Joint::Lock { position: turn.dot(axis), impulse: torque };
            constraints.add_joint(number, about, rate.dot(axis), lock);
        }
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
