//! All topics and services of arms, console and system: the lists from which interfaces to clients are made.
//!
//! Names are below the arm's own, as `PSM1/measured_js`. A client of dVRK (`crtk.ral.check_connections`) waits until
//! all topics of its class have a peer. So an interface subscribes also what its arm ignores.

use self::Arms::{All, Ecm, Psm};
use self::Direction::{Publishes, Serves, Subscribes};
use self::Need::{Crtk, Optional, Required, Trocar};

/// Which way messages go, seen from the arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Clients send, the arm takes.
    Subscribes,
    /// The arm sends.
    Publishes,
    /// Clients ask, the arm answers.
    Serves,
}

/// Which arms have a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arms {
    /// PSM and ECM.
    All,
    /// PSM.
    Psm,
    /// ECM.
    Ecm,
}

/// What a topic is there for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Need {
    /// dVRK's Python clients do not start without it.
    Required,
    /// A real arm has it.
    Optional,
    /// CRTK has it, dVRK has not.
    Crtk,
    /// Trocar has it, no real arm has.
    Trocar,
}

/// A topic or service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic {
    /// Its name below the arm's, `system` or `console`.
    pub name: &'static str,
    /// The type of its messages, `package/Type`; empty where that of dVRK was not found out, and so nothing is offered.
    pub message: &'static str,
    /// Which way messages go.
    pub direction: Direction,
    /// Which arms have it.
    pub arms: Arms,
    /// What it is there for.
    pub need: Need,
}

const fn topic(
    name: &'static str,
    message: &'static str,
    direction: Direction,
    arms: Arms,
    need: Need,
) -> Topic {
    Topic { name, message, direction, arms, need }
}

const BOOL: &str = "std_msgs/Bool";
const EMPTY: &str = "std_msgs/Empty";
const FLOAT: &str = "std_msgs/Float64";
const STRING: &str = "std_msgs/String";
const MATRIX: &str = "std_msgs/Float64MultiArray";
const JOINTS: &str = "sensor_msgs/JointState";
const BUTTON: &str = "sensor_msgs/Joy";
const POSE: &str = "geometry_msgs/PoseStamped";
const TWIST: &str = "geometry_msgs/TwistStamped";
const WRENCH: &str = "geometry_msgs/WrenchStamped";
const WORD: &str = "crtk_msgs/StringStamped";

impl Topic {
    /// Whether an arm has it: one with a jaw is a PSM.
    pub fn is_of(&self, has_jaw: bool) -> bool {
        match self.arms {
            All => true,
            Psm => has_jaw,
            Ecm => !has_jaw,
        }
    }
}

/// All topics and services of the arms.
pub const TOPICS: &[Topic] = &[
    topic("state_command", WORD, Subscribes, All, Required),
    topic("hold", EMPTY, Subscribes, All, Required),
    topic("free", EMPTY, Subscribes, All, Required),
    topic("servo_jp", JOINTS, Subscribes, All, Required),
    topic("servo_jr", JOINTS, Subscribes, All, Required),
    topic("servo_jf", JOINTS, Subscribes, All, Required),
    topic("servo_cp", POSE, Subscribes, All, Required),
    topic("move_jp", JOINTS, Subscribes, All, Required),
    topic("move_jr", JOINTS, Subscribes, All, Required),
    topic("move_cp", POSE, Subscribes, All, Required),
    topic("spatial/servo_cf", WRENCH, Subscribes, All, Required),
    topic("body/servo_cf", WRENCH, Subscribes, All, Required),
    topic("body/set_cf_orientation_absolute", BOOL, Subscribes, All, Required),
    topic("use_gravity_compensation", BOOL, Subscribes, All, Required),
    topic("trajectory_j/set_ratio", FLOAT, Subscribes, All, Required),
    topic("emulate_tool_present", BOOL, Subscribes, Psm, Required),
    topic("jaw/servo_jp", JOINTS, Subscribes, Psm, Required),
    topic("jaw/move_jp", JOINTS, Subscribes, Psm, Required),
    topic("jaw/servo_jf", JOINTS, Subscribes, Psm, Required),
    topic("set_base_frame", POSE, Subscribes, All, Optional),
    topic("servo_cs", "crtk_msgs/CartesianServo", Subscribes, All, Optional),
    topic("servo_ci", "crtk_msgs/CartesianImpedance", Subscribes, All, Optional),
    topic("trajectory_j/set_ratio_v", FLOAT, Subscribes, All, Optional),
    topic("trajectory_j/set_ratio_a", FLOAT, Subscribes, All, Optional),
    topic("set_tool_type", STRING, Subscribes, Psm, Optional),
    topic("emulate_adapter_present", BOOL, Subscribes, Psm, Optional),
    topic("set_endoscope_type", STRING, Subscribes, Ecm, Optional),
    topic("servo_jv", JOINTS, Subscribes, All, Crtk),
    topic("servo_cv", TWIST, Subscribes, All, Crtk),
    topic("servo_cr", POSE, Subscribes, All, Crtk),
    topic("move_cr", POSE, Subscribes, All, Crtk),
    topic("emulate_fault", STRING, Subscribes, All, Trocar),
    topic("operating_state", "crtk_msgs/OperatingState", Publishes, All, Required),
    topic("measured_js", JOINTS, Publishes, All, Required),
    topic("setpoint_js", JOINTS, Publishes, All, Required),
    topic("measured_cp", POSE, Publishes, All, Required),
    topic("setpoint_cp", POSE, Publishes, All, Required),
    topic("local/measured_cp", POSE, Publishes, All, Required),
    topic("local/setpoint_cp", POSE, Publishes, All, Required),
    topic("measured_cv", TWIST, Publishes, All, Required),
    topic("spatial/measured_cf", WRENCH, Publishes, All, Required),
    topic("spatial/jacobian", MATRIX, Publishes, All, Required),
    topic("body/measured_cf", WRENCH, Publishes, All, Required),
    topic("body/jacobian", MATRIX, Publishes, All, Required),
    topic("trajectory_j/ratio", FLOAT, Publishes, All, Required),
    topic("jaw/measured_js", JOINTS, Publishes, Psm, Required),
    topic("jaw/setpoint_js", JOINTS, Publishes, Psm, Required),
    topic("goal_reached", BOOL, Publishes, All, Optional),
    topic("desired_state", STRING, Publishes, All, Optional),
    topic("error", STRING, Publishes, All, Optional),
    topic("warning", STRING, Publishes, All, Optional),
    topic("status", STRING, Publishes, All, Optional),
    topic("trajectory_j/ratio_v", FLOAT, Publishes, All, Optional),
    topic("trajectory_j/ratio_a", FLOAT, Publishes, All, Optional),
    topic("measured_cs", "crtk_msgs/CartesianState", Publishes, All, Optional),
    topic("local/measured_cv", TWIST, Publishes, All, Optional),
    topic("setpoint_cv", TWIST, Publishes, All, Optional),
    topic("period_statistics", "cisst_msgs/IntervalStatistics", Publishes, All, Optional),
    topic("tool_type", STRING, Publishes, Psm, Optional),
    topic("tool_type_request", STRING, Publishes, Psm, Optional),
    topic("arm_clutch", BUTTON, Publishes, All, Optional),
    topic("IO/adapter", BUTTON, Publishes, All, Optional),
    topic("IO/tool", BUTTON, Publishes, All, Optional),
    topic("IO/arm_clutch", BUTTON, Publishes, All, Optional),
    topic("IO/SUJ_clutch", BUTTON, Publishes, All, Optional),
    topic("endoscope_type", STRING, Publishes, Ecm, Optional),
    topic("goal_js", JOINTS, Publishes, All, Crtk),
    topic("goal_cp", POSE, Publishes, All, Crtk),
    topic("forward_kinematics", "crtk_msgs/QueryForwardKinematics", Serves, All, Required),
    topic("local/forward_kinematics", "crtk_msgs/QueryForwardKinematics", Serves, All, Required),
    topic("inverse_kinematics", "crtk_msgs/QueryInverseKinematics", Serves, All, Required),
    topic("operating_state", "crtk_msgs/TriggerOperatingState", Serves, All, Optional),
    topic("crtk_version", "", Serves, All, Optional),
    topic("actuator_to_joint_position", "cisst_msgs/ConvertFloat64Array", Serves, All, Optional),
];

/// The topics below `system`, which has the power of all arms.
pub const SYSTEM: &[Topic] = &[
    topic("power_on", EMPTY, Subscribes, All, Required),
    topic("power_off", EMPTY, Subscribes, All, Required),
    topic("home", EMPTY, Subscribes, All, Required),
    topic("set_volume", FLOAT, Subscribes, All, Required),
    topic("beep", MATRIX, Subscribes, All, Required),
    topic("string_to_speech", STRING, Subscribes, All, Required),
    topic("volume", FLOAT, Publishes, All, Required),
];

/// The topics below `console`, which has the pedals and pairs arms with masters.
pub const CONSOLE: &[Topic] = &[
    topic("teleop/enable", BOOL, Subscribes, All, Required),
    topic("teleop/set_scale", FLOAT, Subscribes, All, Required),
    topic("teleop/select", STRING, Subscribes, All, Required),
    topic("teleop/unselect", STRING, Subscribes, All, Required),
    topic("emulate_operator_present", BUTTON, Subscribes, All, Optional),
    topic("emulate_clutch", BUTTON, Subscribes, All, Optional),
    topic("emulate_camera", BUTTON, Subscribes, All, Optional),
    topic("teleop/enabled", BOOL, Publishes, All, Required),
    topic("teleop/scale", FLOAT, Publishes, All, Required),
    topic("teleop/selected", STRING, Publishes, All, Required),
    topic("teleop/unselected", STRING, Publishes, All, Required),
    topic("operator_present", BUTTON, Publishes, All, Optional),
    topic("clutch", BUTTON, Publishes, All, Optional),
    topic("camera", BUTTON, Publishes, All, Optional),
];
