//! The messages of ROS 2 that an arm sends and takes, field by field as CDR has them.

use ros2_client::Message;
use ros2_client::builtin_interfaces::Time;
use serde::{Deserialize, Serialize};
use trocar_client::proto::dvrk;

/// A message and the name of its type.
pub(crate) trait RosMessage: Message + Clone + Send + 'static {
    /// `package/Type`.
    const NAME: &'static str;
}

/// Declares messages, and parts of messages where there is no name.
macro_rules! messages {
    ($($(#[$doc:meta])* $($name:literal)? $type:ident { $($field:ident: $of:ty),* $(,)? })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
        #[serde(default)]
        pub(crate) struct $type {
            $(pub(crate) $field: $of),*
        }
        impl Message for $type {}
        $(impl RosMessage for $type { const NAME: &'static str = $name; })?
    )*};
}

messages! {
    /// When, and in which frame.
    Header { stamp: Stamp, frame_id: String }
    Point { x: f64, y: f64, z: f64 }
    Quaternion { x: f64, y: f64, z: f64, w: f64 }
    Pose { position: Point, orientation: Quaternion }
    Twist { linear: Point, angular: Point }
    Wrench { force: Point, torque: Point }
    Dimension { label: String, size: u32, stride: u32 }
    Layout { dim: Vec<Dimension>, data_offset: u32 }
    Region { x_offset: u32, y_offset: u32, height: u32, width: u32, do_rectify: bool }
    Mode { value: u8 }
    HalfPlane { p: Point, d: Point, bias: Point, deadband: Point }

    /// CDR has a byte where ROS has none.
    "std_msgs/Empty" Empty { nothing: u8 }
    "std_msgs/Bool" Bool { data: bool }
    "std_msgs/Float64" Float64 { data: f64 }
    "std_msgs/String" Text { data: String }
    "std_msgs/Float64MultiArray" Numbers { layout: Layout, data: Vec<f64> }
    "sensor_msgs/JointState" JointState {
        header: Header, name: Vec<String>, position: Vec<f64>, velocity: Vec<f64>, effort: Vec<f64>,
    }
    "sensor_msgs/Joy" Joy { header: Header, axes: Vec<f32>, buttons: Vec<i32> }
    "sensor_msgs/CompressedImage" CompressedImage { header: Header, format: String, data: Vec<u8> }
    "sensor_msgs/CameraInfo" CameraInfo {
        header: Header, height: u32, width: u32, distortion_model: String, d: Vec<f64>, k: [f64; 9], r: [f64; 9],
        p: [f64; 12], binning_x: u32, binning_y: u32, roi: Region,
    }
    "geometry_msgs/PoseStamped" PoseStamped { header: Header, pose: Pose }
    "geometry_msgs/TwistStamped" TwistStamped { header: Header, twist: Twist }
    "geometry_msgs/WrenchStamped" WrenchStamped { header: Header, wrench: Wrench }
    "crtk_msgs/StringStamped" StringStamped { header: Header, string: String }
    "crtk_msgs/OperatingState" OperatingState { header: Header, state: String, is_homed: bool, is_busy: bool }
    "crtk_msgs/CartesianState" CartesianState {
        header: Header, pose: Pose, pose_is_valid: Bool, twist: Twist, twist_is_valid: Bool, wrench: Wrench,
        wrench_is_valid: Bool,
    }
    "crtk_msgs/CartesianServo" CartesianServo {
        header: Header, task_frame: Pose, pose: Pose, twist: Twist, wrench: Wrench, axis_mode: [Mode; 6],
    }
    "crtk_msgs/CartesianImpedance" CartesianImpedance {
        header: Header, force_orientation: Quaternion, force_position: Point, torque_orientation: Quaternion,
        position_positive: HalfPlane, position_negative: HalfPlane, orientation_positive: HalfPlane,
        orientation_negative: HalfPlane,
    }
    "cisst_msgs/IntervalStatistics" IntervalStatistics {
        header: Header, period_avg: f64, period_std_dev: f64, period_min: f64, period_max: f64, compute_time_avg: f64,
        compute_time_std_dev: f64, compute_time_min: f64, compute_time_max: f64, number_of_samples: i64,
        number_of_overruns: i64, statistics_interval: f64, user_data: i64,
    }

    /// The request of `crtk_msgs/QueryForwardKinematics`, and below it the reply.
    ForwardQuestion { jp: Vec<f64>, cp: Pose }
    ForwardAnswer { cp: Pose, result: bool, message: String }
    /// Those of `crtk_msgs/QueryInverseKinematics`.
    InverseQuestion { cp: Pose, jp: Vec<f64> }
    InverseAnswer { jp: Vec<f64>, result: bool, message: String }
    /// The reply of `crtk_msgs/TriggerOperatingState`; its request is [`Empty`].
    StateAnswer { operating_state: OperatingState }
}

/// A time since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Stamp(Time);

impl Stamp {
    /// That of so many ns since 1970.
    pub(crate) fn of(nanoseconds: i64) -> Self {
        Self(Time::from_nanos(nanoseconds))
    }
}

impl Default for Stamp {
    fn default() -> Self {
        Self(Time::ZERO)
    }
}

impl Header {
    pub(crate) fn new(stamp: Stamp, frame: &str) -> Self {
        Self { stamp, frame_id: frame.into() }
    }
}

impl From<[f64; 3]> for Point {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Self { x, y, z }
    }
}

impl From<[f64; 7]> for Pose {
    fn from([x, y, z, i, j, k, w]: [f64; 7]) -> Self {
        Self { position: Point { x, y, z }, orientation: Quaternion { x: i, y: j, z: k, w } }
    }
}

impl From<[f64; 6]> for Twist {
    fn from([x, y, z, a, b, c]: [f64; 6]) -> Self {
        Self { linear: [x, y, z].into(), angular: [a, b, c].into() }
    }
}

impl Pose {
    /// x, y, z; x, y, z, w.
    pub(crate) fn numbers(&self) -> [f64; 7] {
        let (at, turn) = (&self.position, &self.orientation);
        [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]
    }
}

impl OperatingState {
    pub(crate) fn new(stamp: Stamp, state: dvrk::OperatingState) -> Self {
        Self {
            header: Header::new(stamp, ""),
            state: state.state.name().into(),
            is_homed: state.is_homed,
            is_busy: state.is_busy,
        }
    }
}

impl Numbers {
    /// A matrix of so many rows, row by row.
    pub(crate) fn matrix(rows: usize, data: Vec<f64>) -> Self {
        let size = data.len() as u32;
        let columns = size / rows as u32;
        let dimension = |label: &str, size, stride| Dimension { label: label.into(), size, stride };
        let dim =
            vec![dimension("rows", rows as u32, size), dimension("columns", columns, columns)];
        Self { layout: Layout { dim, data_offset: 0 }, data }
    }
}

/// What a command's message holds, as [`dvrk::Command::of`] takes it.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Content {
    pub(crate) numbers: Vec<f64>,
    pub(crate) more: Vec<f64>,
    pub(crate) text: String,
}

impl Content {
    fn numbers(numbers: impl Into<Vec<f64>>) -> Self {
        Self { numbers: numbers.into(), ..Self::default() }
    }

    fn text(text: String) -> Self {
        Self { text, ..Self::default() }
    }
}

/// A message that commands come by.
pub(crate) trait Commanding: RosMessage {
    /// What the command of a topic needs of it.
    fn content(self, topic: &str) -> Content;
}

macro_rules! commanding {
    ($($type:ident: |$message:pat_param, $topic:pat_param| $content:expr;)*) => {$(
        impl Commanding for $type {
            fn content(self, $topic: &str) -> Content {
                let $message = self;
                $content
            }
        }
    )*};
}

commanding! {
    Empty: |_, _| Content::default();
    Bool: |is, _| Content::numbers([f64::from(is.data)]);
    Float64: |number, _| Content::numbers([number.data]);
    Text: |text, _| Content::text(text.data);
    StringStamped: |text, _| Content::text(text.string);
    JointState: |joints, topic| match topic {
        "servo_jv" => Content::numbers(joints.velocity),
        "servo_jp" => Content { numbers: joints.position, more: joints.velocity, ..Content::default() },
        _ => Content::numbers(joints.position),
    };
    PoseStamped: |of, _| Content { text: of.header.frame_id, ..Content::numbers(of.pose.numbers()) };
    TwistStamped: |of, _| {
        let (linear, angular) = (of.twist.linear, of.twist.angular);
        Content::numbers([linear.x, linear.y, linear.z, angular.x, angular.y, angular.z])
    };
    // No efforts are simulated: what they are makes no difference.
    WrenchStamped: |_, _| Content::default();
    CartesianServo: |_, _| Content::default();
    CartesianImpedance: |_, _| Content::default();
}

#[cfg(test)]
mod tests {
    use rustdds::serialization::{RepresentationIdentifier, deserialize_from_cdr_with_rep_id};

    use super::*;

    /// Numbers that look random (SplitMix64).
    struct Random(u64);

    impl Random {
        fn below(&mut self, end: usize) -> usize {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (mixed ^ (mixed >> 31)) as usize % end
        }
    }

    /// Reads bytes that are no message, and messages of zeros with a few bytes that are wrong; how many were read.
    fn read<M: RosMessage>(rng: &mut Random) -> usize {
        let mut count = 0;
        for round in 0..2000 {
            let is_rubbish = round % 2 == 0;
            let mut bytes = vec![0; rng.below(800)];
            let wrong = if is_rubbish { bytes.len() } else { rng.below(5).min(bytes.len()) };
            for place in 0..wrong {
                let at = if is_rubbish { place } else { rng.below(bytes.len()) };
                bytes[at] = rng.below(256) as u8;
            }
            let encoding = RepresentationIdentifier::CDR_LE;
            count += usize::from(deserialize_from_cdr_with_rep_id::<M>(&bytes, encoding).is_ok());
        }
        count
    }

    #[test]
    fn bytes_that_are_no_message_are_refused_without_a_panic() {
        let mut rng = Random(1);
        let read = [
            read::<Empty>(&mut rng),
            read::<Bool>(&mut rng),
            read::<Float64>(&mut rng),
            read::<Text>(&mut rng),
            read::<StringStamped>(&mut rng),
            read::<JointState>(&mut rng),
            read::<Joy>(&mut rng),
            read::<Numbers>(&mut rng),
            read::<PoseStamped>(&mut rng),
            read::<TwistStamped>(&mut rng),
            read::<WrenchStamped>(&mut rng),
            read::<CartesianServo>(&mut rng),
            read::<CartesianImpedance>(&mut rng),
        ];
        assert!(read.iter().all(|count| (10..2000).contains(count)), "{read:?}");
    }

    #[test]
    fn what_a_message_holds_is_what_its_command_needs() {
        let joints = JointState {
            position: vec![1.0, 2.0],
            velocity: vec![3.0, 4.0],
            effort: vec![5.0],
            ..JointState::default()
        };
        let content = |topic: &str| joints.clone().content(topic);
        assert_eq!(content("servo_jp").more, [3.0, 4.0]);
        assert_eq!(content("move_jp"), Content::numbers([1.0, 2.0]));
        assert_eq!(content("servo_jv"), Content::numbers([3.0, 4.0]));
        let header = Header::new(Stamp::default(), "world");
        let pose = Pose::from([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
        let content = PoseStamped { header, pose }.content("servo_cp");
        assert_eq!((content.numbers.len(), content.text.as_str()), (7, "world"));
        assert_eq!(content.numbers[..3], [1.0, 2.0, 3.0]);
    }
}
