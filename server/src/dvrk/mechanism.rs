//! What dVRK's controllers know of an arm's mechanics: joints, limits, and kinematics with dVRK's answers.
//!
//! [`Psm`] and [`Ecm`] give the exact answers or refuse. dVRK's controllers answer otherwise, and scripts rely on it
//! (`InverseKinematics` in its PSM and ECM components):
//!
//! - A PSM takes any pose but at the remote centre. A shaft that would be too short is made longer, and what is out of
//!   reach is clipped later, joint by joint.
//! - An ECM drops the part of an orientation that four joints cannot take, and refuses what is out of its limits.
//!
//! Poses here are in the arm's base frame, the remote centre: dVRK's `local/*`. That of a PSM is the wrist-yaw axis,
//! 10.2 mm above the tip of closed jaws.

use arrayvec::ArrayVec;
use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix3xX, Matrix6xX};
pub use trocar_proto::dvrk::Pose;

use super::planner::AxisLimit;
use crate::robots::{ArmModel, Axes, Ecm, Endoscope, IkError, JointLimit, MAX_AXES, Psm};

/// How far below the remote centre dVRK keeps the wrist-pitch axis of a PSM, m (`SafeDistanceFromRCM`).
const SAFE_DEPTH: f64 = 0.045;

/// How much less than [`SAFE_DEPTH`] still allows Cartesian commands, m (`SafeDistanceFromRCMBuffer`).
const SAFE_DEPTH_BUFFER: f64 = 0.002;

/// Distance from the remote centre below which a PSM's inverse is refused, m.
const NEAREST: f64 = 1e-3;

/// Least insertion that an ECM's inverse gives, m.
const ECM_LEAST_INSERTION: f64 = 0.04;

/// Insertion after homing in dVRK's kinematic simulation, m.
const HOME_INSERTION: f64 = 0.12;

/// Least ratio at which a trajectory is planned: it would take months.
const LEAST_RATIO: f64 = 1e-6;

/// Names of a PSM's joints, then of its jaw; those of an ECM are the first four.
const NAMES: [&str; 7] = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"];

/// Names of what a PSM without a tool has: three joints and the discs that would drive the tool.
pub(super) const DISC_NAMES: [&str; 7] =
    ["yaw", "pitch", "insertion", "disc_1", "disc_2", "disc_3", "disc_4"];

/// Why an inverse or a forward kinematics has no answer.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoSolution {
    /// The wrist would be at the remote centre.
    #[error("the goal is {:.1} mm from the remote centre: less than 1 mm has no solution", distance * 1e3)]
    AtRemoteCentre {
        /// Distance from the remote centre, m.
        distance: f64,
    },
    /// The camera would be above the remote centre.
    #[error("the goal is above the remote centre")]
    AboveRemoteCentre,
    /// The arm does not get there.
    #[error(transparent)]
    Unreachable(#[from] IkError),
    /// There is another number of joints than the arm has.
    #[error("incorrect number of joints: {got}, the arm has {expected}")]
    WrongCount {
        /// How many there were.
        got: usize,
        /// How many there should be.
        expected: usize,
    },
    /// There are more joints than the arm has.
    #[error("too many joints: {got}, the arm has {most}")]
    TooManyJoints {
        /// How many there were.
        got: usize,
        /// How many there may be.
        most: usize,
    },
}

/// The mechanics of one arm.
#[expect(clippy::large_enum_variant, reason = "constants, one for each arm")]
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mechanism {
    /// A PSM with its Large Needle Driver.
    Psm(Psm),
    /// An ECM with its endoscope.
    Ecm(Ecm),
}

impl Mechanism {
    /// How many joints it has, without the jaw.
    pub const fn joints(&self) -> usize {
        match self {
            Self::Psm(_) => Psm::JOINTS,
            Self::Ecm(_) => Ecm::JOINTS,
        }
    }

    /// How many axes move in one trajectory: the joints, and the jaw of a PSM behind them.
    pub const fn axes(&self) -> usize {
        match self {
            Self::Psm(_) => Psm::JOINTS + 1,
            Self::Ecm(_) => Ecm::JOINTS,
        }
    }

    /// The names of all axes.
    pub fn names(&self) -> &'static [&'static str] {
        &NAMES[..self.axes()]
    }

    /// The names of what it has without a tool.
    pub fn raw_names(&self) -> &'static [&'static str] {
        match self {
            Self::Psm(_) => &DISC_NAMES,
            Self::Ecm(_) => self.names(),
        }
    }

    /// The limits of an axis: rad, rad/s, rad/s²; m, m/s, m/s² for the insertion (index 2).
    pub fn limit(&self, axis: usize) -> JointLimit {
        match self {
            Self::Psm(psm) => psm.limits().get(axis).copied().unwrap_or(psm.jaw_limit()),
            Self::Ecm(ecm) => ecm.limits()[axis],
        }
    }

    /// What trajectories of the axes keep to, at these ratios of velocity and acceleration in ]0, 1].
    pub fn axis_limits(&self, [velocity, acceleration]: [f64; 2]) -> ArrayVec<AxisLimit, MAX_AXES> {
        (0..self.axes())
            .map(|axis| self.limit(axis))
            .map(|limit| AxisLimit {
                velocity: velocity.max(LEAST_RATIO) * limit.max_velocity,
                acceleration: acceleration.max(LEAST_RATIO) * limit.max_acceleration,
            })
            .collect()
    }

    /// The nearest positions within the limits of the axes.
    pub fn clipped(&self, positions: &[f64]) -> Axes {
        positions.iter().enumerate().map(|(axis, value)| self.limit(axis).clamp(*value)).collect()
    }

    /// Where homing brings the axes, as dVRK's kinematic simulation has it.
    pub fn home(&self) -> Axes {
        (0..self.axes()).map(|axis| if axis == 2 { HOME_INSERTION } else { 0.0 }).collect()
    }

    /// How far the measured axes may be from their set-points before the arm faults, rad or m. Jaws squeeze by being
    /// asked to close further than they can, so they may be far.
    pub fn tolerances(&self) -> &'static [f64] {
        match self {
            Self::Psm(_) => &[0.5, 0.5, 0.05, 0.6, 0.6, 0.6, FRAC_PI_2],
            Self::Ecm(_) => &[0.6, 0.6, 0.03, 0.25],
        }
    }

    /// The wrist of a PSM or the camera of an ECM in the base frame.
    ///
    /// # Panics
    /// Where there are fewer positions than joints.
    pub fn forward(&self, positions: &[f64]) -> Pose {
        match self {
            Self::Psm(psm) => psm.base_from_wrist(&first(positions)),
            Self::Ecm(ecm) => ecm.base_from_camera(&first(positions)),
        }
    }

    /// The frame along the chain that these joints lead to: the base of none, the end of all.
    pub fn forward_along(&self, joints: &[f64]) -> Result<Pose, NoSolution> {
        let (got, most) = (joints.len(), self.joints());
        if got > most {
            return Err(NoSolution::TooManyJoints { got, most });
        }
        if joints.iter().any(|value| !value.is_finite()) {
            return Err(IkError::NotFinite.into());
        }
        if got == most {
            return Ok(self.forward(joints));
        }
        let mut all: Axes = joints.iter().copied().collect();
        all.extend((got..most).map(|_| 0.0));
        let link = |links: &[Pose]| got.checked_sub(1).map_or(Pose::identity(), |last| links[last]);
        Ok(match self {
            Self::Psm(psm) => link(&psm.base_from_links(&first(&all))),
            Self::Ecm(ecm) => link(&ecm.base_from_links(&first(&all))),
        })
    }

    /// The joints for a pose in the base frame, as dVRK's controllers find them, from joints nearby. They need not be
    /// within the limits.
    pub fn inverse(&self, base_from_end: &Pose, seed: &[f64]) -> Result<Axes, NoSolution> {
        let (got, expected) = (seed.len(), self.joints());
        if got != expected {
            return Err(NoSolution::WrongCount { got, expected });
        }
        match self {
            Self::Psm(psm) => {
                let distance = base_from_end.translation.vector.norm();
                if distance < NEAREST {
                    return Err(NoSolution::AtRemoteCentre { distance });
                }
                let mut joints = psm.inverse_unlimited(base_from_end, &first(seed))?;
                joints[2] = joints[2].max(SAFE_DEPTH - psm.depth_offset());
                Ok(joints.into_iter().collect())
            }
            Self::Ecm(ecm) => {
                if base_from_end.translation.z > 0.0 {
                    return Err(NoSolution::AboveRemoteCentre);
                }
                let mut joints = ecm.inverse(base_from_end, &first(seed))?;
                joints[2] = joints[2].max(ECM_LEAST_INSERTION);
                Ok(joints.into_iter().collect())
            }
        }
    }

    /// Whether instrument or endoscope is past the cannula, which Cartesian commands need.
    pub fn is_inserted(&self, joints: &[f64]) -> bool {
        match self {
            Self::Psm(psm) => joints[2] + psm.depth_offset() >= SAFE_DEPTH - SAFE_DEPTH_BUFFER,
            Self::Ecm(_) => true,
        }
    }

    /// The Jacobian at the wrist or camera in base axes: rows vx vy vz (m/s), wx wy wz (rad/s), a column per joint.
    pub fn jacobian(&self, positions: &[f64]) -> Matrix6xX<f64> {
        match self {
            Self::Psm(psm) => {
                Matrix6xX::from_column_slice(psm.jacobian(&first(positions)).as_slice())
            }
            Self::Ecm(ecm) => {
                Matrix6xX::from_column_slice(ecm.jacobian(&first(positions)).as_slice())
            }
        }
    }

    /// The Jacobian in the axes of the wrist or camera (dVRK's `body/jacobian`).
    pub fn body_jacobian(&self, positions: &[f64]) -> Matrix6xX<f64> {
        let end_from_base = self.forward(positions).rotation.to_rotation_matrix().transpose();
        let mut jacobian = self.jacobian(positions);
        for rows in [0, 3] {
            let turned: Matrix3xX<f64> = end_from_base.matrix() * jacobian.fixed_rows::<3>(rows);
            jacobian.fixed_rows_mut::<3>(rows).copy_from(&turned);
        }
        jacobian
    }

    /// The Jacobian of the point of wrist or camera that is at the base's origin (dVRK's `spatial/jacobian`).
    pub fn spatial_jacobian(&self, positions: &[f64]) -> Matrix6xX<f64> {
        let end = self.forward(positions).translation.vector;
        let mut jacobian = self.jacobian(positions);
        for mut column in jacobian.column_iter_mut() {
            let turn = column.fixed_rows::<3>(3).into_owned();
            let moved = column.fixed_rows::<3>(0) - turn.cross(&end);
            column.fixed_rows_mut::<3>(0).copy_from(&moved);
        }
        jacobian
    }

    /// The name of the tool or endoscope, as dVRK has it.
    pub fn tool(&self) -> &'static str {
        match self {
            Self::Psm(psm) => match psm.model() {
                ArmModel::Classic => "LARGE_NEEDLE_DRIVER:400006",
                ArmModel::Si => "LARGE_NEEDLE_DRIVER:420006",
            },
            Self::Ecm(ecm) => match (ecm.model(), ecm.endoscope()) {
                (ArmModel::Classic, Endoscope::Straight) => "Classic_HD_STRAIGHT",
                (ArmModel::Classic, Endoscope::Up30) => "Classic_HD_UP",
                (ArmModel::Classic, Endoscope::Down30) => "Classic_HD_DOWN",
                (ArmModel::Si, Endoscope::Straight) => "Si_HD_STRAIGHT",
                (ArmModel::Si, Endoscope::Up30) => "Si_HD_UP",
                (ArmModel::Si, Endoscope::Down30) => "Si_HD_DOWN",
            },
        }
    }

    /// The same arm with the endoscope of this name, if it is one of its generation's.
    pub fn with_endoscope(self, name: &str) -> Option<Self> {
        let Self::Ecm(ecm) = self else { return None };
        let prefixes = match ecm.model() {
            ArmModel::Classic => ["Classic_HD_", "Classic_SD_"],
            ArmModel::Si => ["Si_HD_"; 2],
        };
        let looks = prefixes.iter().find_map(|prefix| name.strip_prefix(prefix))?;
        let endoscope = match looks {
            "STRAIGHT" => Endoscope::Straight,
            "UP" => Endoscope::Up30,
            "DOWN" => Endoscope::Down30,
            _ => return None,
        };
        Some(Self::Ecm(ecm.with_endoscope(endoscope)))
    }

    /// The joints and the jaw that turns of a PSM's discs make, rad: roll, wrist pitch, wrist yaw, jaw. Source: the
    /// coupling of the Large Needle Driver.
    pub fn joints_from_discs([a, b, c, d]: [f64; 4]) -> [f64; 4] {
        [-1.5632 * a, 1.0186 * b, -0.8306 * b + 0.6089 * (c + d), 1.2177 * (d - c)]
    }

    /// The inverse of [`Self::joints_from_discs`].
    pub fn discs_from_joints([roll, wrist_pitch, wrist_yaw, jaw]: [f64; 4]) -> [f64; 4] {
        let second = wrist_pitch / 1.0186;
        let [sum, difference] = [(wrist_yaw + 0.8306 * second) / 0.6089, jaw / 1.2177];
        [roll / -1.5632, second, 0.5 * (sum - difference), 0.5 * (sum + difference)]
    }
}

/// The first `N` of some positions.
fn first<const N: usize>(positions: &[f64]) -> [f64; N] {
    std::array::from_fn(|index| positions[index])
}
