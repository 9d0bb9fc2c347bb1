//! The patient-side manipulator (PSM) with a Large Needle Driver: 6 joints and a jaw.
//!
//! Joints 1–3 (yaw, pitch, insertion) move the shaft through the remote centre of motion; joint 4
//! rolls the instrument about its shaft; joints 5 and 6 bend the wrist about two axes that lie
//! 9.1 mm apart. Two end frames are kept apart by name: the *wrist* frame on the wrist-yaw axis is
//! dVRK's `measured_cp`; the *tip* frame lies at the end of the closed jaws.

use crate::robots::chain::{
    Chain, Link, SINGULAR, Twist, atan2, shaft_direction, sin_cos, yaw_pitch_of,
};
use crate::robots::error::{IkError, LIMIT_ROUNDING, check_limits, check_reach};
use crate::robots::{ArmModel, JointLimit};
use nalgebra::{Isometry3, Matrix3, Matrix6, Translation3, Vector3};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, TAU};

/// Distance between the wrist-pitch and wrist-yaw axes, m.
const PITCH_TO_YAW: f64 = 0.0091;

/// Within which the roll and wrist joints of a solution are near a seed's, rad: 60°.
const NEARBY: f64 = FRAC_PI_3;

/// Columns: the wrist frame's axes in the last DH frame (dVRK's tool-tip rotation).
const LINK_FROM_WRIST: Matrix3<f64> = Matrix3::new(
    0.0, -1.0, 0.0, //
    0.0, 0.0, 1.0, //
    -1.0, 0.0, 0.0,
);

/// One PSM: constants only, so it is copied freely and shared by any number of environments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Psm {
    model: ArmModel,
    chain: Chain<6>,
    jaw: JointLimit,
}

impl Psm {
    /// Number of joints, without the jaw.
    pub const JOINTS: usize = 6;

    /// Distance from the wrist-yaw axis to the tip of the closed jaws, m.
    pub const TIP_DISTANCE: f64 = 0.0102;

    /// PSM Classic with Large Needle Driver 400006.
    pub const CLASSIC: Self = Self::new(ArmModel::Classic);

    /// PSM Si with Large Needle Driver 420006 (a longer shaft; equal joint values give the same
    /// pose as the Classic).
    pub const SI: Self = Self::new(ArmModel::Si);

    /// The arm of one generation, with its Large Needle Driver.
    pub const fn new(model: ArmModel) -> Self {
        let (insertion_offset, roll_offset) = match model {
            ArmModel::Classic => (-0.4318, 0.4162),
            ArmModel::Si => (-0.4826, 0.4670),
        };
        let links = [
            Link::revolute(Twist::Plus, 0.0, FRAC_PI_2, 0.0),
            Link::revolute(Twist::Minus, 0.0, -FRAC_PI_2, 0.0),
            Link::prismatic(Twist::Plus, insertion_offset),
            Link::revolute(Twist::None, 0.0, 0.0, roll_offset),
            Link::revolute(Twist::Minus, 0.0, -FRAC_PI_2, 0.0),
            Link::revolute(Twist::Minus, PITCH_TO_YAW, -FRAC_PI_2, 0.0),
        ];
        let (yaw, pitch, insertion, jaw_min) = match model {
            ArmModel::Classic => (
                slow("yaw", -1.588, 1.588, 3.316_101),
                slow("pitch", -0.925_025, 0.925_025, 3.316_101),
                slide(0.24, 9.877_926),
                -0.698_132,
            ),
            ArmModel::Si => (
                slow("yaw", -2.964, 2.964, 17.0845),
                slow("pitch", -1.265, 1.301, 17.0845),
                slide(0.29, 40.9063),
                -0.349_066,
            ),
        };
        let limits = [
            yaw,
            pitch,
            insertion,
            fast("roll", -4.537_86, 4.537_86, 0.33),
            fast("wrist_pitch", -1.396_26, 1.396_26, 0.25),
            fast("wrist_yaw", -1.396_26, 1.396_26, 0.20),
        ];
        Self { model, chain: Chain { links, limits }, jaw: fast("jaw", jaw_min, 1.396_26, 0.16) }
    }

    /// Which generation it is.
    pub const fn model(&self) -> ArmModel {
        self.model
    }

    /// The joints' limits in the order yaw, pitch, insertion, roll, wrist pitch, wrist yaw:
    /// rad, rad/s, rad/s², N·m; for the insertion (index 2) m, m/s, m/s², N.
    pub fn limits(&self) -> &[JointLimit; 6] {
        &self.chain.limits
    }

    /// The jaw's limits. The value is the full opening between both fingers, rad: 0 is closed, each
    /// finger turns by half of it, and a negative value squeezes.
    pub fn jaw_limit(&self) -> JointLimit {
        self.jaw
    }

    /// The wrist frame (dVRK's `local/measured_cp`) in the base frame: origin on the wrist-yaw
    /// axis, z along the jaws towards the tip, x against the wrist-yaw axis.
    ///
    /// `q`: joint values, rad; index 2 in m. They are not checked against the limits.
    pub fn base_from_wrist(&self, q: &[f64; 6]) -> Isometry3<f64> {
        self.chain.end(q).turned(&LINK_FROM_WRIST).isometry()
    }

    /// The tip frame in the base frame: the wrist frame moved by [`Self::TIP_DISTANCE`] along z.
    ///
    /// `q`: joint values, rad; index 2 in m.
    pub fn base_from_tip(&self, q: &[f64; 6]) -> Isometry3<f64> {
        self.base_from_wrist(q) * Self::wrist_from_tip()
    }

    /// The tip frame in the wrist frame: 10.2 mm along z.
    pub fn wrist_from_tip() -> Translation3<f64> {
        Translation3::new(0.0, 0.0, Self::TIP_DISTANCE)
    }

    /// Every DH link frame in the base frame: yaw, pitch, insertion, roll, wrist pitch, wrist yaw.
    /// They are the link frames of `assets/psm/model.urdf`.
    ///
    /// `q`: joint values, rad; index 2 in m.
    pub fn base_from_links(&self, q: &[f64; 6]) -> [Isometry3<f64>; 6] {
        self.chain.frames(q).map(|frame| frame.isometry())
    }

    /// The geometric Jacobian at the wrist frame's origin in base axes: rows vx vy vz (m/s) and
    /// wx wy wz (rad/s), columns per rad/s of each joint (index 2: per m/s).
    ///
    /// `q`: joint values, rad; index 2 in m.
    pub fn jacobian(&self, q: &[f64; 6]) -> Matrix6<f64> {
        self.chain.jacobian(q)
    }

    /// The joint values that bring the wrist frame to `base_from_wrist`, in closed form.
    ///
    /// Inside the limits of both wrist joints (±80°, so that the cosine of each is positive) every
    /// joint is determined by the pose, apart from whole turns of the roll. So the solution nearest
    /// to `seed`, in any weighted joint distance, is the one whose roll is nearest; it is chosen
    /// among those within the limits (±260° hold one or two). Where the nearest turn is past the
    /// limit, the result is a whole turn away from the seed: callers that move in small steps
    /// compare.
    ///
    /// Two poses leave a joint open, both with the wrist inside the cannula; there the seed decides:
    /// - where the wrist-pitch axis is at the remote centre, the shaft's direction is open;
    /// - where the remote centre is on the wrist-yaw axis, the direction from one wrist axis to the
    ///   other is open.
    ///
    /// The roll and wrist-yaw axes align at 90° of wrist pitch, outside the limits.
    ///
    /// `seed`: joint values, rad; index 2 in m; it need not be within the limits.
    pub fn inverse(
        &self,
        base_from_wrist: &Isometry3<f64>,
        seed: &[f64; 6],
    ) -> Result<[f64; 6], IkError> {
        check_finite(base_from_wrist, seed)?;
        let [_, _, insertion_limit, roll_limit, ..] = self.chain.limits;
        let reach = insertion_limit.max + self.depth_offset() + PITCH_TO_YAW;
        check_reach(&base_from_wrist.translation.vector, reach)?;
        let mut q = self.solve(base_from_wrist, seed, Branch::Limited);
        q[3] = nearest_turn(q[3], seed[3], &roll_limit);
        check_limits(&self.chain.limits, q)
    }

    /// As [`Self::inverse`], whatever the limits of the joints, for a shaft of any length that leaves the remote
    /// centre. The wrist-yaw joint is within ±90°, the roll is the turn nearest to the seed's.
    ///
    /// A pose has a second solution, in which the wrist is bent over backwards, beyond 90° in both joints. It is taken
    /// where it is nearby and the first is further: so a wrist that is led past its limits does not turn round at
    /// once.
    ///
    /// `seed`: joint values, rad; index 2 in m; it need not be within the limits.
    pub fn inverse_unlimited(
        &self,
        base_from_wrist: &Isometry3<f64>,
        seed: &[f64; 6],
    ) -> Result<[f64; 6], IkError> {
        check_finite(base_from_wrist, seed)?;
        let solutions = [Branch::Unlimited, Branch::BentOver].map(|branch| {
            let mut q = self.solve(base_from_wrist, seed, branch);
            q[3] += TAU * ((seed[3] - q[3]) / TAU).round();
            q
        });
        let way = |q: &[f64; 6]| (3..6).map(|i| (q[i] - seed[i]).abs()).fold(0.0, f64::max);
        let [upright, bent_over] = solutions;
        Ok(if way(&bent_over) < NEARBY.min(way(&upright)) { bent_over } else { upright })
    }

    /// Depth of the wrist-pitch axis below the remote centre at insertion zero, m.
    pub const fn depth_offset(&self) -> f64 {
        self.chain.links[2].d + self.chain.links[3].d
    }

    /// Joint values for a pose, the roll in any turn.
    fn solve(&self, base_from_wrist: &Isometry3<f64>, seed: &[f64; 6], branch: Branch) -> [f64; 6] {
        let wrist = base_from_wrist.translation.vector;
        let axes = *base_from_wrist.rotation.to_rotation_matrix().matrix();
        let depth_offset = self.depth_offset();

        let jaws: Vector3<f64> = axes.column(2).into();
        let yaw_axis: Vector3<f64> = -axes.column(0);

        // The wrist-pitch axis, both wrist axes' common perpendicular and the remote centre lie in
        // the plane across the wrist-pitch axis, which holds the wrist-yaw axis. So the
        // perpendicular points along what is left of the wrist point across the wrist-yaw axis. It
        // points to the side on which the jaws are (|wrist yaw| < 90°).
        let forward = direction_across(&wrist, &yaw_axis)
            .or_else(|| direction_across(&seed_forward(seed), &yaw_axis))
            .unwrap_or(jaws);
        let is_away = (forward.dot(&jaws) < 0.0) != (branch == Branch::BentOver);
        let forward = if is_away { -forward } else { forward };
        let pitch_axis = forward.cross(&yaw_axis);

        // The wrist-pitch axis crosses the shaft, which passes through the remote centre and is
        // bent by less than 90° against the perpendicular.
        let shaft_end = wrist - PITCH_TO_YAW * forward;
        let shaft = shaft_end
            .try_normalize(SINGULAR)
            .or_else(|| direction_across(&shaft_direction(seed[0], seed[1]), &pitch_axis))
            .unwrap_or(forward);
        let is_above = branch == Branch::Limited && shaft.dot(&forward) < 0.0;
        let shaft = if is_above { -shaft } else { shaft };

        let (yaw, pitch) = yaw_pitch_of(&shaft, seed[0]);
        let insertion = shaft_end.dot(&shaft) - depth_offset;
        let ((s1, c1), (s2, c2)) = (sin_cos(yaw), sin_cos(pitch));
        let roll_x = Vector3::new(-s2 * s1, -c2, s2 * c1);
        let roll_y = Vector3::new(-c1, 0.0, -s1);
        let roll = atan2(-pitch_axis.dot(&roll_x), pitch_axis.dot(&roll_y));
        let wrist_pitch = atan2(forward.dot(&pitch_axis.cross(&shaft)), forward.dot(&shaft));
        let wrist_yaw = atan2(-jaws.dot(&pitch_axis), jaws.dot(&forward));
        [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw]
    }
}

/// Which of the joint vectors that lead to a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Branch {
    /// Both wrist joints within ±90°; the wrist-pitch axis may lie above the remote centre.
    Limited,
    /// The wrist-pitch axis below the remote centre, the wrist-yaw joint within ±90°.
    Unlimited,
    /// The wrist-pitch axis below the remote centre, the wrist-yaw joint beyond ±90°.
    BentOver,
}

/// Refuses a target or a seed that holds a NaN or an infinity.
fn check_finite(pose: &Isometry3<f64>, seed: &[f64; 6]) -> Result<(), IkError> {
    let (place, turn) = (&pose.translation.vector, &pose.rotation.coords);
    let are_finite = [place.as_slice(), turn.as_slice(), seed]
        .iter()
        .all(|numbers| numbers.iter().all(|number| number.is_finite()));
    if are_finite { Ok(()) } else { Err(IkError::NotFinite) }
}

/// Unit vector from the wrist-pitch axis to the wrist-yaw axis at joint values `q`.
fn seed_forward(q: &[f64; 6]) -> Vector3<f64> {
    let ((s1, c1), (s2, c2)) = (sin_cos(q[0]), sin_cos(q[1]));
    let ((s4, c4), (s5, c5)) = (sin_cos(q[3]), sin_cos(q[4]));
    let roll_x = Vector3::new(-s2 * s1, -c2, s2 * c1);
    let roll_y = Vector3::new(-c1, 0.0, -s1);
    s5 * (c4 * roll_x + s4 * roll_y) + c5 * shaft_direction(q[0], q[1])
}

/// The unit vector along the part of `v` across the unit vector `axis`, unless that part is too
/// short to have a direction. Rejecting twice keeps it square to `axis` however short it is.
fn direction_across(v: &Vector3<f64>, axis: &Vector3<f64>) -> Option<Vector3<f64>> {
    let reject = |v: Vector3<f64>| v - axis * v.dot(axis);
    reject(*v).try_normalize(SINGULAR).map(|across| reject(across).normalize())
}

/// The angle among `angle + k·2π` nearest to `seed` within the limits, which span more than a turn.
fn nearest_turn(angle: f64, seed: f64, limit: &JointLimit) -> f64 {
    let lowest = ((limit.min - LIMIT_ROUNDING - angle) / TAU).ceil();
    let highest = ((limit.max + LIMIT_ROUNDING - angle) / TAU).floor();
    angle + TAU * ((seed - angle) / TAU).round().clamp(lowest, highest)
}

/// A yaw or pitch joint: 90 °/s and 90 °/s².
const fn slow(name: &'static str, min: f64, max: f64, max_effort: f64) -> JointLimit {
    JointLimit { name, min, max, max_velocity: FRAC_PI_2, max_acceleration: FRAC_PI_2, max_effort }
}

/// The insertion: 0.2 m/s and 0.2 m/s².
const fn slide(max: f64, max_effort: f64) -> JointLimit {
    JointLimit {
        name: "insertion",
        min: 0.0,
        max,
        max_velocity: 0.2,
        max_acceleration: 0.2,
        max_effort,
    }
}

/// An instrument joint: 1080 °/s and 720 °/s².
const fn fast(name: &'static str, min: f64, max: f64, max_effort: f64) -> JointLimit {
    JointLimit { name, min, max, max_velocity: 3.0 * TAU, max_acceleration: 2.0 * TAU, max_effort }
}

#[cfg(test)]
#[path = "psm_tests.rs"]
mod tests;
