//! What an arm measures of itself: its joints, its tip.

use trocar_proto::spec::Element;

use super::PsmArm;
use super::orientation::wrist_from_link;
use crate::robots::JointLimit;
use crate::sim::frames::{self, Pose};
use crate::sim::instrument::TIP_OFFSET;
use crate::sim::world::World;
use crate::tasks::options;

/// Force on a finger from which on contact is told as this, N.
const MOST_FORCE: f64 = 10.0;

impl PsmArm {
    /// The elements of [`Self::measured_joints`].
    pub fn joint_elements(&self) -> Vec<Element> {
        let names = ["yaw", "pitch", "insertion", "roll", "wrist pitch", "wrist yaw"];
        let joint = |(name, limit): (&str, &JointLimit)| {
            let is_length = name == "insertion";
            let beyond = if is_length { 0.0 } else { options::MOST_JOINT_OFFSET };
            let (min, max) = (limit.min - beyond, limit.max + beyond);
            let unit = if is_length { "m" } else { "rad" };
            Element::new(&format!("{name} joint"), "joint", unit, min as f32, max as f32)
        };
        let joints = names.into_iter().zip(self.kinematics.limits()).map(joint);
        joints.chain([Element::new("jaw joint", "joint", "rad", -0.1, 1.0)]).collect()
    }

    /// What the joint sensors report: yaw, pitch (rad), insertion (m), roll, wrist pitch, wrist yaw, jaw (rad).
    pub fn measured_joints(&self, world: &World) -> impl Iterator<Item = f32> {
        self.joints.into_iter().chain([self.opening(world)]).map(|number| number as f32)
    }

    /// The elements of [`Self::measured_tip`].
    pub fn tip_elements(&self) -> Vec<Element> {
        let tip = self.reach.grown(TIP_OFFSET + 1e-3);
        let mut elements = options::position_elements("tip", "scene", &tip, self.preset);
        elements.extend(options::euler_elements("measured wrist link", "scene"));
        elements
    }

    /// The tip of the closed jaws (x, y, z) and the extrinsic XYZ Euler angles of the wrist link (rad), as the
    /// joint sensors report them.
    pub fn measured_tip(&self) -> impl Iterator<Item = f32> {
        let tip = self.scene_from_wrist * Pose::translation(0.0, 0.0, TIP_OFFSET);
        let position = tip.translation.vector * options::position_scale(self.preset);
        let angles = frames::euler_xyz(&(self.scene_from_wrist.rotation * wrist_from_link()));
        let numbers = [position.x, position.y, position.z].into_iter().chain(angles);
        numbers.map(|number| number as f32)
    }

    /// The elements of [`Self::measured_contact`].
    pub fn contact_elements(&self) -> Vec<Element> {
        let of_finger = |finger: usize| {
            let named = |what: &str| format!("finger {finger} {what}");
            let contact = Element::new(&named("contact"), "", "1", 0.0, 1.0);
            [contact, Element::new(&named("force"), "", "N", 0.0, MOST_FORCE as f32)]
        };
        [1, 2].into_iter().flat_map(of_finger).collect()
    }

    /// For each finger, 1 where it presses on an object, else 0, and how hard everything presses on it, N.
    pub fn measured_contact(&self, world: &World) -> impl Iterator<Item = f32> {
        let contacts = self.instrument.contacts(world);
        let forces = self.instrument.pressures(world);
        let numbers = move |finger: usize| {
            [f64::from(u8::from(contacts[finger])), forces[finger].min(MOST_FORCE)]
        };
        [0, 1].into_iter().flat_map(numbers).map(|number| number as f32)
    }
}
