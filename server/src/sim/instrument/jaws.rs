//! What an instrument has at the end of its wrist: two fingers on one hinge.

use nalgebra::{Point3, Vector3};

use crate::sim::frames::{Aabb, Pose};

/// Half extents of a finger, m: across (along the hinge), thickness, length. Source: the
/// original's collision box, 1.4 mm × 10.2 mm × 1.8 mm.
pub const FINGER_HALF: Vector3<f64> = Vector3::new(0.9e-3, 0.7e-3, 5.1e-3);

/// Sides of the fingers: the sign of their y axis.
pub(super) const SIDES: [f64; 2] = [-1.0, 1.0];

/// What an instrument has at the end of its wrist.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jaws {
    /// Half extents of a finger, m: across (along the hinge), thickness, length.
    pub finger_half: Vector3<f64>,
    /// Whether soft bodies meet fingers that are profiled.
    pub is_profiled: bool,
}

impl Jaws {
    /// Of a needle driver.
    pub const NEEDLE_DRIVER: Self = Self { finger_half: FINGER_HALF, is_profiled: false };

    /// Of a tissue forceps: broad and profiled, as those of ProGrasp and Cadière forceps. They end where those of
    /// the needle driver do, since kinematics are those of the arm.
    pub const TISSUE_FORCEPS: Self =
        Self { finger_half: Vector3::new(2.5e-3, 0.75e-3, 5.1e-3), is_profiled: true };

    /// A finger in its own frame: hinge at the origin, length along z.
    pub(super) fn finger_box(&self, side: f64) -> Aabb {
        let half = self.finger_half;
        let centre = Vector3::new(0.0, side * half.y, half.z);
        Aabb { min: centre - half, max: centre + half }
    }
}

/// The room between the fingers of an instrument, whichever way they are turned.
#[derive(Debug, Clone, Copy)]
pub struct BetweenFingers {
    world_from_fingers: [Pose; 2],
    half: Vector3<f64>,
}

impl BetweenFingers {
    /// Of fingers that are there.
    pub(super) fn new(jaws: &Jaws, world_from_fingers: [Pose; 2]) -> Self {
        Self { world_from_fingers, half: jaws.finger_half }
    }

    /// Whether a point is there, or up to `reach` (m) from there.
    pub fn has(&self, point: &Point3<f64>, reach: f64) -> bool {
        // From the inner face of a finger on, the other finger is on the side of its y axis, or on the other side.
        self.world_from_fingers.iter().zip(SIDES).all(|(world_from_finger, side)| {
            let at = world_from_finger.inverse_transform_point(point);
            at.x.abs() < self.half.x + reach
                && (-reach..2.0 * self.half.z + reach).contains(&at.z)
                && side * at.y < reach
        })
    }
}
