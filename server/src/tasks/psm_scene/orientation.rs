//! How wrists are turned: straight down, and where only the pitch of their link turns.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Quaternion, Unit, UnitQuaternion, Vector3};

use crate::sim::frames::Pose;

/// Roll and yaw of the wrist links of PSM1 and PSM2 where only their pitch turns, rad: the jaws point
/// along the scene's x axis and turn about it. Source: the original.
pub(super) const PITCHED: [[f64; 2]; 2] = [[0.0, -FRAC_PI_2], [-PI, FRAC_PI_2]];

/// The wrist at `position`, jaws straight down, turned as every episode begins.
pub(in crate::tasks) fn straight_down(position: [f64; 3]) -> Pose {
    Pose::from_parts(Vector3::from(position).into(), down())
}

/// Orientation of a wrist whose jaws point straight down: Euler angles of the link (−90°, 0, 90°).
/// Source: the original.
pub(in crate::tasks) fn down() -> UnitQuaternion<f64> {
    let scene_from_link = UnitQuaternion::from_euler_angles(-FRAC_PI_2, 0.0, FRAC_PI_2);
    scene_from_link * wrist_from_link().inverse()
}

/// Orientation of the wrist of `arm` (0 or 1) whose link has this pitch (rad), and roll and yaw as where
/// only the pitch turns: jaws along the scene's x axis.
pub fn pitched(arm: usize, pitch: f64) -> UnitQuaternion<f64> {
    let [roll, yaw] = PITCHED[arm];
    UnitQuaternion::from_euler_angles(roll, pitch, yaw) * wrist_from_link().inverse()
}

/// The pitch of a wrist of `arm` that is oriented as in [`pitched`], rad.
pub fn pitch_of(arm: usize, wrist: &UnitQuaternion<f64>) -> f64 {
    pitch_along(arm, &hinge(wrist))
}

/// The pitch, in [−π/2, π/2], at which jaws of `arm` as in [`pitched`] close across the direction `along`.
pub fn pitch_across(arm: usize, along: &Vector3<f64>) -> f64 {
    let pitch = pitch_along(arm, along);
    pitch - PI * (pitch / PI).round() // either finger may be on either side
}

/// The pitch at which the hinge of jaws as in [`pitched`] lies along `direction`, as far as it can.
fn pitch_along(arm: usize, direction: &Vector3<f64>) -> f64 {
    let [level, upright] = [0.0, FRAC_PI_2].map(|pitch| hinge(&pitched(arm, pitch)));
    libm::atan2(direction.dot(&upright), direction.dot(&level))
}

/// The axis on which the fingers of a wrist turn.
fn hinge(wrist: &UnitQuaternion<f64>) -> Vector3<f64> {
    wrist * wrist_from_link() * Vector3::z()
}

/// The wrist-yaw link (y along the jaws, z along their hinge) in the frame of dVRK's `measured_cp`
/// (z along the jaws). Its Euler angles are the original's and, pointing down, far from a wrap.
pub(super) fn wrist_from_link() -> UnitQuaternion<f64> {
    Unit::new_unchecked(Quaternion::new(0.5, 0.5, -0.5, -0.5))
}
