//! Joint limits and a serial chain described by modified (Craig) Denavit–Hartenberg parameters.

use nalgebra::{
    ComplexField, Isometry3, Matrix3, RealField, Rotation3, SMatrix, Translation3, UnitQuaternion,
    Vector3,
};

/// What a joint may do. Units: rad for revolute joints, m for the insertion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimit {
    /// Name of the joint, as in the URDF.
    pub name: &'static str,
    /// Smallest position, rad or m.
    pub min: f64,
    /// Largest position, rad or m.
    pub max: f64,
    /// Largest speed that dVRK's trajectories use, rad/s or m/s.
    pub max_velocity: f64,
    /// Largest acceleration that dVRK's trajectories use, rad/s² or m/s².
    pub max_acceleration: f64,
    /// Largest torque or force, N·m or N.
    pub max_effort: f64,
}

impl JointLimit {
    /// The allowed position nearest to `value`, rad or m.
    pub fn clamp(&self, value: f64) -> f64 {
        value.clamp(self.min, self.max)
    }

    /// Whether `value` (rad or m) is allowed. NaN never is.
    pub fn contains(&self, value: f64) -> bool {
        (self.min..=self.max).contains(&value)
    }
}

/// The angle alpha between successive joint axes: every da Vinci link has a quarter turn or none,
/// so its sine and cosine are exact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Twist {
    /// alpha = 0.
    None,
    /// alpha = +π/2.
    Plus,
    /// alpha = −π/2.
    Minus,
}

impl Twist {
    const fn sin_cos(self) -> (f64, f64) {
        match self {
            Self::None => (0.0, 1.0),
            Self::Plus => (1.0, 0.0),
            Self::Minus => (-1.0, 0.0),
        }
    }
}

/// Which parameter the joint variable adds to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about its z axis: theta + q.
    Revolute,
    /// Slides along its z axis: d + q.
    Prismatic,
}

/// One row of a modified DH table: `RotX(twist) · TransX(a) · RotZ(theta) · TransZ(d)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// What the joint variable does.
    pub kind: JointKind,
    /// Angle between the previous joint's axis and this one's.
    pub twist: Twist,
    /// Distance between the previous joint's axis and this one's, m.
    pub a: f64,
    /// Angle at joint value zero, rad.
    pub theta: f64,
    /// Offset along the joint axis at joint value zero, m.
    pub d: f64,
}

impl Link {
    /// A revolute joint.
    pub const fn revolute(twist: Twist, a: f64, theta: f64, d: f64) -> Self {
        Self { kind: JointKind::Revolute, twist, a, theta, d }
    }

    /// A prismatic joint whose frame lies at `d` along its axis when the joint value is zero.
    pub const fn prismatic(twist: Twist, d: f64) -> Self {
        Self { kind: JointKind::Prismatic, twist, a: 0.0, theta: 0.0, d }
    }

    /// The link frame in its parent's frame at joint value `q`.
    fn parent_from_link(&self, q: f64) -> Frame {
        let (sin_twist, cos_twist) = self.twist.sin_cos();
        let (theta, d) = match self.kind {
            JointKind::Revolute => (self.theta + q, self.d),
            JointKind::Prismatic => (self.theta, self.d + q),
        };
        let (s, c) = sin_cos(theta);
        Frame {
            #[rustfmt::skip]
            rotation: Matrix3::new(
                c, -s, 0.0,
                cos_twist * s, cos_twist * c, -sin_twist,
                sin_twist * s, sin_twist * c, cos_twist,
            ),
            position: Vector3::new(self.a, -sin_twist * d, cos_twist * d),
        }
    }
}

/// A link frame in the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Columns are the frame's axes in base coordinates.
    pub rotation: Matrix3<f64>,
    /// The frame's origin in base coordinates, m.
    pub position: Vector3<f64>,
}

impl Frame {
    const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        position: Vector3::new(0.0, 0.0, 0.0),
    };

    fn then(&self, next: &Self) -> Self {
        Self {
            rotation: self.rotation * next.rotation,
            position: self.position + self.rotation * next.position,
        }
    }

    /// The frame as a pose.
    pub fn isometry(&self) -> Isometry3<f64> {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Isometry3::from_parts(
            Translation3::from(self.position),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }

    /// The same origin with the axes turned by `rotation` (columns in this frame).
    #[must_use]
    pub fn turned(&self, rotation: &Matrix3<f64>) -> Self {
        Self { rotation: self.rotation * rotation, position: self.position }
    }
}

/// A serial chain of `N` links, base to tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chain<const N: usize> {
    /// The DH table.
    pub links: [Link; N],
    /// The joints' limits, in the same order.
    pub limits: [JointLimit; N],
}

impl<const N: usize> Chain<N> {
    /// Every link frame in the base frame.
    pub fn frames(&self, q: &[f64; N]) -> [Frame; N] {
        let mut frame = Frame::IDENTITY;
        std::array::from_fn(|i| {
            frame = frame.then(&self.links[i].parent_from_link(q[i]));
            frame
        })
    }

    /// The last link frame in the base frame.
    pub fn end(&self, q: &[f64; N]) -> Frame {
        let links = self.links.iter().zip(q);
        links.fold(Frame::IDENTITY, |frame, (link, q)| frame.then(&link.parent_from_link(*q)))
    }

    /// The geometric Jacobian at the last frame's origin in base axes: rows are linear velocity
    /// (m/s), then angular velocity (rad/s), per unit of each joint's velocity (rad/s or m/s).
    pub fn jacobian(&self, q: &[f64; N]) -> SMatrix<f64, 6, N> {
        let frames = self.frames(q);
        let end = frames[N - 1].position;
        let mut jacobian = SMatrix::<f64, 6, N>::zeros();
        for (i, frame) in frames.iter().enumerate() {
            let axis: Vector3<f64> = frame.rotation.column(2).into();
            let (linear, angular) = match self.links[i].kind {
                JointKind::Revolute => (axis.cross(&(end - frame.position)), axis),
                JointKind::Prismatic => (axis, Vector3::zeros()),
            };
            jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&linear);
            jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&angular);
        }
        jacobian
    }
}

/// Sine and cosine with the same bits on every machine (not the C library's).
pub(super) fn sin_cos(angle: f64) -> (f64, f64) {
    ComplexField::sin_cos(angle)
}

/// The cosine with the same bits on every machine (not the C library's).
pub(super) fn cos(angle: f64) -> f64 {
    ComplexField::cos(angle)
}

/// The angle of (x, y) with the same bits on every machine (not the C library's), in ]−π, π].
pub(super) fn atan2(y: f64, x: f64) -> f64 {
    RealField::atan2(y, x)
}

/// Yaw and pitch (rad) of the remote-centre mechanism that both arms share, for a shaft along the
/// unit vector `shaft` from the remote centre; the inverse of [`shaft_direction`].
///
/// A shaft along the yaw axis leaves the yaw open: it then keeps `seed_yaw`.
pub(super) fn yaw_pitch_of(shaft: &Vector3<f64>, seed_yaw: f64) -> (f64, f64) {
    let across = (shaft.x * shaft.x + shaft.z * shaft.z).sqrt();
    let yaw = if across < SINGULAR { seed_yaw } else { atan2(shaft.x, -shaft.z) };
    (yaw, atan2(-shaft.y, across))
}

/// Unit vector along the shaft, from the remote centre towards the tip, at this yaw and pitch.
pub(super) fn shaft_direction(yaw: f64, pitch: f64) -> Vector3<f64> {
    let ((s1, c1), (s2, c2)) = (sin_cos(yaw), sin_cos(pitch));
    Vector3::new(c2 * s1, -s2, -c2 * c1)
}

/// Lengths (m, or of unit vectors) below this have no usable direction. It is far above rounding
/// (1e-17) and far below every tolerance (1e-9), so that a pose stays exact on either side.
pub(super) const SINGULAR: f64 = 1e-12;
