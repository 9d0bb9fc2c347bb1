//! The arms of the da Vinci Research Kit: forward and inverse kinematics, Jacobians, joint limits.
//!
//! All quantities are SI in f64. The base frame of an arm is its remote centre of motion (RCM),
//! so `base_from_*` poses are what dVRK calls `local/*_cp`. Joint vectors hold radians, and metres
//! for the insertion (index 2). The numbers are those of dVRK's own kinematic files
//! (sawIntuitiveResearchKit, `share/kinematic` and `share/tool`), with exact quarter turns where
//! the files round π/2 to 1.5708.
//!
//! | module | holds |
//! |---|---|
//! | [`chain`] | joint limits and a chain of modified Denavit–Hartenberg links |
//! | [`psm`] | the instrument arm with a Large Needle Driver, 6 joints and a jaw |
//! | [`ecm`] | the endoscope arm, 4 joints |
//! | [`drivetrain`] | what lies between set-points, encoders and links |
//! | [`error`] | why an inverse does not exist |
//!
//! ```
//! use trocar_server::robots::Psm;
//!
//! let psm = Psm::CLASSIC;
//! let q = [0.3, -0.2, 0.15, 0.5, 0.4, -0.6];
//! let found = psm.inverse(&psm.base_from_wrist(&q), &[0.0, 0.0, 0.1, 0.0, 0.0, 0.0])?;
//! assert!(q.iter().zip(found).all(|(a, b)| (a - b).abs() < 1e-9));
//! # Ok::<(), trocar_server::robots::IkError>(())
//! ```

pub mod chain;
pub mod drivetrain;
pub mod ecm;
pub mod error;
pub mod psm;

pub use chain::JointLimit;
pub use drivetrain::{Axes, Drivetrain, MAX_AXES};
pub use ecm::{Ecm, Endoscope};
pub use error::IkError;
pub use psm::Psm;

/// Generation of an arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArmModel {
    /// First generation ("Classic").
    Classic,
    /// S and Si.
    Si,
}
