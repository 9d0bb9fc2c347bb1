//! Where an instrument is, and how large what it has at the end of its wrist.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::jaws::{Jaws, SIDES};
use crate::robots::Psm;
use crate::sim::frames::{self, Aabb, Pose};

/// From the wrist-yaw axis to the tip of the closed jaws, m, along the approach axis (the z axis
/// of the wrist frame).
pub const TIP_OFFSET: f64 = Psm::TIP_DISTANCE;

/// Jaw angle of closed jaws, rad. The angle is the opening between both fingers.
pub const JAW_CLOSED: f64 = 0.0;

/// Jaw angle of open jaws, rad (40°, as the original's tasks open them).
pub const JAW_OPEN: f64 = 0.698_131_700_797_731_8;

/// Radius of the clevis between the wrist's pitch and yaw axes, m (8 mm shaft, tapered).
pub(super) const CLEVIS_RADIUS: f64 = 2.5e-3;

/// Distance of the wrist's pitch and yaw axes, m. Source: dVRK, `a` of the sixth joint.
pub(super) const CLEVIS_LENGTH: f64 = 0.0091;

/// Where an instrument is and how far its jaws are open.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posture {
    /// The wrist-yaw frame of dVRK's `measured_cp`: z along the jaws, x along their hinge.
    pub world_from_wrist: Pose,
    /// Opening between the fingers that is asked for, rad.
    pub jaw: f64,
}

impl Posture {
    /// The frame at the tip of the closed jaws, parallel to the wrist's.
    pub fn world_from_tip(&self) -> Pose {
        self.world_from_wrist * Pose::translation(0.0, 0.0, TIP_OFFSET)
    }

    /// The way of the wrist from this posture (0) to another (1), and that of the jaw angle.
    #[must_use]
    pub fn towards(&self, end: &Self, wrist: f64, jaw: f64) -> Self {
        let world_from_wrist =
            frames::interpolate(&self.world_from_wrist, &end.world_from_wrist, wrist);
        Self { world_from_wrist, jaw: self.jaw + (end.jaw - self.jaw) * jaw }
    }

    /// The finger of side −1 or +1: it turns by half the opening.
    pub(super) fn world_from_finger(&self, side: f64) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -0.5 * side * self.jaw);
        self.world_from_wrist * turn
    }

    /// How far the clevises of instruments in two postures are apart, m; below 0 they overlap.
    pub fn gap(&self, other: &Self) -> f64 {
        let clevis = |posture: &Self| clevis_ends().map(|end| posture.world_from_wrist * end);
        frames::segment_distance(&clevis(self), &clevis(other)) - 2.0 * CLEVIS_RADIUS
    }

    /// A box around fingers and clevis.
    pub(super) fn aabb(&self, jaws: &Jaws) -> Aabb {
        let [left, right] = SIDES;
        self.aabb_with(jaws, [self.world_from_finger(left), self.world_from_finger(right)])
    }

    /// A box around fingers that are there, and the clevis.
    pub(super) fn aabb_with(&self, jaws: &Jaws, world_from_fingers: [Pose; 2]) -> Aabb {
        let finger =
            |index: usize| jaws.finger_box(SIDES[index]).placed(&world_from_fingers[index]);
        let fingers = [finger(0), finger(1)];
        let [yaw, pitch] = clevis_ends();
        let clevis = Aabb::around([self.world_from_wrist * yaw, self.world_from_wrist * pitch]);
        fingers[0].merged(&fingers[1]).merged(&clevis.grown(CLEVIS_RADIUS))
    }
}

/// The clevis' axis in the wrist frame, from the yaw to the pitch axis of a straight wrist.
pub(super) fn clevis_ends() -> [Point3<f64>; 2] {
    [Point3::origin(), Point3::new(0.0, 0.0, -CLEVIS_LENGTH)]
}
