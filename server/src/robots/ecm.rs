//! The endoscopic camera manipulator (ECM): 4 joints and an endoscope.

use crate::robots::chain::{
    Chain, Link, SINGULAR, Twist, atan2, cos, shaft_direction, yaw_pitch_of,
};
use crate::robots::error::{IkError, check_limits, check_reach};
use crate::robots::{ArmModel, JointLimit};
use nalgebra::{Isometry3, Matrix3, SMatrix, Vector3};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_6};

/// Where the endoscope looks, relative to its shaft.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Endoscope {
    /// Along the shaft.
    Straight,
    /// 30° up: the optical axis tilts towards the camera's +y.
    Up30,
    /// 30° down: the optical axis tilts towards the camera's −y.
    Down30,
}

/// One ECM: constants only, so it is copied freely and shared by any number of environments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ecm {
    model: ArmModel,
    chain: Chain<4>,
    endoscope: Endoscope,
}

impl Ecm {
    /// Number of joints.
    pub const JOINTS: usize = 4;

    /// ECM Classic with a straight endoscope.
    pub const CLASSIC: Self = Self::new(ArmModel::Classic, Endoscope::Straight);

    /// ECM Si with a straight endoscope.
    pub const SI: Self = Self::new(ArmModel::Si, Endoscope::Straight);

    /// The arm of one generation with one endoscope.
    pub const fn new(model: ArmModel, endoscope: Endoscope) -> Self {
        let links = [
            Link::revolute(Twist::Plus, 0.0, FRAC_PI_2, 0.0),
            Link::revolute(Twist::Minus, 0.0, -FRAC_PI_2, 0.0),
            Link::prismatic(Twist::Plus, -0.3822),
            Link::revolute(Twist::None, 0.0, 0.0, 0.3829),
        ];
        let limits = match model {
            ArmModel::Classic => [
                turn("yaw", -FRAC_PI_2, FRAC_PI_2, 26.932_08),
                turn("pitch", -0.767_94, 1.1344, 26.932_08),
                slide(0.0, 0.255, 80.658_948_3),
                turn("roll", -1.552, 1.552, 0.876_588_08),
            ],
            ArmModel::Si => [
                turn("yaw", -2.964, 2.964, 17.0845),
                turn("pitch", -1.10, 1.04, 34.0845),
                slide(0.001, 0.259, 70.900),
                turn("roll", -1.54, 1.54, 6.819_23),
            ],
        };
        Self { model, chain: Chain { links, limits }, endoscope }
    }

    /// Which generation it is.
    pub const fn model(&self) -> ArmModel {
        self.model
    }

    /// The same arm with another endoscope.
    #[must_use]
    pub const fn with_endoscope(self, endoscope: Endoscope) -> Self {
        Self { endoscope, ..self }
    }

    /// Where the endoscope looks.
    pub const fn endoscope(&self) -> Endoscope {
        self.endoscope
    }

    /// The joints' limits in the order yaw, pitch, insertion, roll: rad, rad/s, rad/s², N·m; for
    /// the insertion (index 2) m, m/s, m/s², N.
    pub fn limits(&self) -> &[JointLimit; 4] {
        &self.chain.limits
    }

    /// The camera frame (dVRK's `local/measured_cp`) in the base frame: origin at the end of the
    /// endoscope, z along the optical axis away from the camera, y up in the image.
    ///
    /// `q`: joint values, rad; index 2 in m. They are not checked against the limits.
    pub fn base_from_camera(&self, q: &[f64; 4]) -> Isometry3<f64> {
        self.chain.end(q).turned(&self.link_from_camera()).isometry()
    }

    /// Every DH link frame in the base frame: yaw, pitch, insertion, roll. They are the link frames
    /// of `assets/ecm/model.urdf`.
    ///
    /// `q`: joint values, rad; index 2 in m.
    pub fn base_from_links(&self, q: &[f64; 4]) -> [Isometry3<f64>; 4] {
        self.chain.frames(q).map(|frame| frame.isometry())
    }

    /// The geometric Jacobian at the camera frame's origin in base axes: rows vx vy vz (m/s) and
    /// wx wy wz (rad/s), columns per rad/s of each joint (index 2: per m/s).
    ///
    /// `q`: joint values, rad; index 2 in m.
    pub fn jacobian(&self, q: &[f64; 4]) -> SMatrix<f64, 6, 4> {
        self.chain.jacobian(q)
    }

    /// The joint values that bring the camera frame's origin to `position` (m, base frame), in
    /// closed form; the roll stays as in `seed`.
    ///
    /// The solution is unique, because the camera is always below the remote centre. A target on
    /// the yaw axis leaves the yaw open (it keeps the seed's), but needs a pitch outside the limits.
    ///
    /// `seed`: joint values, rad; index 2 in m.
    pub fn inverse_position(
        &self,
        position: &Vector3<f64>,
        seed: &[f64; 4],
    ) -> Result<[f64; 4], IkError> {
        if !position.iter().chain(seed).all(|value| value.is_finite()) {
            return Err(IkError::NotFinite);
        }
        let depth_offset = self.chain.links[2].d + self.chain.links[3].d;
        check_reach(position, self.chain.limits[2].max + depth_offset)?;
        let shaft =
            position.try_normalize(SINGULAR).unwrap_or_else(|| shaft_direction(seed[0], seed[1]));
        let (yaw, pitch) = yaw_pitch_of(&shaft, seed[0]);
        let insertion = position.dot(&shaft) - depth_offset;
        check_limits(&self.chain.limits, [yaw, pitch, insertion, seed[3]])
    }

    /// The joint values that bring the camera frame's origin to that of `base_from_camera`, in closed form, and its
    /// axes as near to those as the roll allows: four joints cannot take every orientation.
    ///
    /// `seed`: joint values, rad; index 2 in m.
    pub fn inverse(
        &self,
        base_from_camera: &Isometry3<f64>,
        seed: &[f64; 4],
    ) -> Result<[f64; 4], IkError> {
        let axes = *base_from_camera.rotation.to_rotation_matrix().matrix();
        if !axes.iter().all(|value| value.is_finite()) {
            return Err(IkError::NotFinite);
        }
        let position = base_from_camera.translation.vector;
        let [yaw, pitch, insertion, _] =
            self.inverse_position(&position, &[seed[0], seed[1], seed[2], 0.0])?;
        let unrolled = self.chain.end(&[yaw, pitch, insertion, 0.0]).rotation;
        let turn = unrolled.transpose() * axes * self.link_from_camera().transpose();
        let roll = atan2(turn[(1, 0)] - turn[(0, 1)], turn[(0, 0)] + turn[(1, 1)]);
        check_limits(&self.chain.limits, [yaw, pitch, insertion, roll])
    }

    /// Length of the path of the end of the endoscope, m, where each joint moves evenly from `start` to `end`. It holds
    /// for movements of a step: two nodes of Gauss and Legendre are exact there to a millionth of it.
    ///
    /// `start`, `end`: joint values, rad; index 2 in m.
    pub fn tip_path(&self, start: &[f64; 4], end: &[f64; 4]) -> f64 {
        const NODES: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];
        let [yaw, pitch, insertion] = [0, 1, 2].map(|joint| end[joint] - start[joint]);
        if [yaw, pitch, insertion] == [0.0; 3] {
            return 0.0; // a turn about its own axis moves no tip
        }
        let depth = start[2] + self.chain.links[2].d + self.chain.links[3].d;
        let speed = |part: f64| {
            let cos = cos(start[1] + pitch * part);
            let across = depth + insertion * part;
            let turned = across * across * (pitch * pitch + cos * cos * yaw * yaw);
            (insertion * insertion + turned).sqrt()
        };
        0.5 * (speed(NODES[0]) + speed(NODES[1]))
    }

    /// Columns: the camera's axes in the last DH frame, dVRK's tool-tip rotation times
    /// RotX(∓30°) for an endoscope that looks up or down.
    fn link_from_camera(&self) -> Matrix3<f64> {
        const STRAIGHT: Matrix3<f64> = Matrix3::new(
            0.0, 1.0, 0.0, //
            -1.0, 0.0, 0.0, //
            0.0, 0.0, 1.0,
        );
        /// cos 30°; its sine is one half.
        const COS_30: f64 = 0.866_025_403_784_438_6;
        let sin = match self.endoscope {
            Endoscope::Straight => return STRAIGHT,
            Endoscope::Up30 => -0.5,
            Endoscope::Down30 => 0.5,
        };
        STRAIGHT * Matrix3::new(1.0, 0.0, 0.0, 0.0, COS_30, -sin, 0.0, sin, COS_30)
    }
}

/// A revolute joint: 30 °/s and 90 °/s².
const fn turn(name: &'static str, min: f64, max: f64, max_effort: f64) -> JointLimit {
    JointLimit { name, min, max, max_velocity: FRAC_PI_6, max_acceleration: FRAC_PI_2, max_effort }
}

/// The insertion: 60 mm/s and 60 mm/s².
const fn slide(min: f64, max: f64, max_effort: f64) -> JointLimit {
    JointLimit {
        name: "insertion",
        min,
        max,
        max_velocity: 0.06,
        max_acceleration: 0.06,
        max_effort,
    }
}

#[cfg(test)]
#[path = "ecm_tests.rs"]
mod tests;
