//! The ROS 2 messages that this robot speaks, field for field as their definitions have them.
//!
//! ```
//! use moca_telemetry::ros::{Message, messages::{Odometry, Quaternion, TwistStamped}};
//!
//! assert_eq!(Odometry::TYPE.0, "nav_msgs/msg/Odometry");
//! assert_eq!(TwistStamped::TYPE.dds(), "geometry_msgs::msg::dds_::TwistStamped_");
//! assert!((Quaternion::about_z(0.3).yaw_rad() - 0.3).abs() < 1e-15);
//! ```

use super::cdr::{CdrError, Decode, Field, Reader, Writer};
use super::message;

message! { "builtin_interfaces/msg/Time" =
    /// Since the Unix epoch.
    pub struct Time {
        /// s.
        sec: i32,
        /// ns within the second.
        nanosec: u32,
    }
}
message! { "std_msgs/msg/Header" =
    /// When, and in which frame.
    pub struct Header {
        /// When it was measured, by the sender's clock.
        stamp: Time,
        /// The frame's name.
        frame_id: String,
    }
}
message! { "geometry_msgs/msg/Vector3" =
    /// A vector.
    pub struct Vector3 {
        /// x.
        x: f64,
        /// y.
        y: f64,
        /// z.
        z: f64,
    }
}
message! { "geometry_msgs/msg/Point" =
    /// A point.
    pub struct Point {
        /// m.
        x: f64,
        /// m.
        y: f64,
        /// m.
        z: f64,
    }
}
message! { "geometry_msgs/msg/Quaternion" =
    /// An orientation as a unit quaternion.
    pub struct Quaternion {
        /// x.
        x: f64,
        /// y.
        y: f64,
        /// z.
        z: f64,
        /// w.
        w: f64,
    }
}
message! { "geometry_msgs/msg/Pose" =
    /// Position, m, and orientation.
    pub struct Pose {
        /// m.
        position: Point,
        /// As a unit quaternion.
        orientation: Quaternion,
    }
}
message! { "geometry_msgs/msg/PoseWithCovariance" =
    /// A pose and how uncertain it is.
    pub struct PoseWithCovariance {
        /// The pose.
        pose: Pose,
        /// 6 × 6, row by row.
        covariance: Covariance,
    }
}
message! { "geometry_msgs/msg/TwistWithCovariance" =
    /// A twist and how uncertain it is.
    pub struct TwistWithCovariance {
        /// The twist.
        twist: Twist,
        /// 6 × 6, row by row.
        covariance: Covariance,
    }
}
message! { "geometry_msgs/msg/Wrench" =
    /// Force, N, and torque, N·m.
    pub struct Wrench {
        /// N.
        force: Vector3,
        /// N·m.
        torque: Vector3,
    }
}
message! { "geometry_msgs/msg/Transform" =
    /// A frame in its parent.
    pub struct Transform {
        /// m.
        translation: Vector3,
        /// As a unit quaternion.
        rotation: Quaternion,
    }
}
message! { "geometry_msgs/msg/TransformStamped" =
    /// A frame in its parent, at a time.
    pub struct TransformStamped {
        /// When, and the parent's name.
        header: Header,
        /// The frame's name.
        child_frame_id: String,
        /// Pose of the child frame.
        transform: Transform,
    }
}
message! { "diagnostic_msgs/msg/KeyValue" =
    /// A value with its name.
    pub struct KeyValue {
        /// Name.
        key: String,
        /// Value, as text.
        value: String,
    }
}
message! { "diagnostic_msgs/msg/DiagnosticStatus" =
    /// Status of a part.
    pub struct DiagnosticStatus {
        /// 0 fine, 1 warning, 2 error, 3 stale.
        level: u8,
        /// Which part.
        name: String,
        /// One sentence.
        message: String,
        /// Which piece of it.
        hardware_id: String,
        /// Details.
        values: Vec<KeyValue>,
    }
}
message! { "std_msgs/msg/MultiArrayDimension" =
    /// One dimension of a list.
    pub struct MultiArrayDimension {
        /// Name of the dimension.
        label: String,
        /// Size of it.
        size: u32,
        /// Elements from one to the next, times `size`.
        stride: u32,
    }
}
message! { "std_msgs/msg/MultiArrayLayout" =
    /// Dimensions of a list, outermost first.
    pub struct MultiArrayLayout {
        /// The dimensions.
        dim: Vec<MultiArrayDimension>,
        /// Elements before the first that counts.
        data_offset: u32,
    }
}

message! { "geometry_msgs/msg/Twist" =
    /// Linear velocity, m/s, and angular velocity, rad/s.
    pub struct Twist {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    }
}
message! { "geometry_msgs/msg/TwistStamped" =
    /// A twist with time and frame.
    pub struct TwistStamped {
        /// When, and in which axes.
        header: Header,
        /// The twist.
        twist: Twist,
    }
}
message! { "geometry_msgs/msg/PoseStamped" =
    /// A pose with time and frame.
    pub struct PoseStamped {
        /// When, and in which frame.
        header: Header,
        /// The pose.
        pose: Pose,
    }
}
message! { "geometry_msgs/msg/WrenchStamped" =
    /// A wrench with time and frame.
    pub struct WrenchStamped {
        /// When, and in which axes.
        header: Header,
        /// The wrench.
        wrench: Wrench,
    }
}
message! { "nav_msgs/msg/Odometry" =
    /// Pose of a base in `header.frame_id`, and its velocity in `child_frame_id`.
    pub struct Odometry {
        /// When, and the frame of the pose.
        header: Header,
        /// The frame of the twist.
        child_frame_id: String,
        /// Pose of `child_frame_id`.
        pose: PoseWithCovariance,
        /// Twist in the axes of `child_frame_id`.
        twist: TwistWithCovariance,
    }
}
message! { "sensor_msgs/msg/JointState" =
    /// Joints by name; a list is empty where nothing is known.
    pub struct JointState {
        /// When.
        header: Header,
        /// Names.
        name: Vec<String>,
        /// rad, or m of a joint that slides.
        position: Vec<f64>,
        /// rad/s or m/s.
        velocity: Vec<f64>,
        /// N·m or N.
        effort: Vec<f64>,
    }
}
message! { "tf2_msgs/msg/TFMessage" =
    /// Frames in their parents.
    pub struct TFMessage {
        /// One for each frame.
        transforms: Vec<TransformStamped>,
    }
}
message! { "diagnostic_msgs/msg/DiagnosticArray" =
    /// Status of the parts of a robot.
    pub struct DiagnosticArray {
        /// When.
        header: Header,
        /// One for each part.
        status: Vec<DiagnosticStatus>,
    }
}
message! { "std_msgs/msg/Float64MultiArray" =
    /// Numbers in rows.
    pub struct Float64MultiArray {
        /// Layout of the numbers.
        layout: MultiArrayLayout,
        /// The numbers.
        data: Vec<f64>,
    }
}
message! { "std_msgs/msg/Float64" =
    /// A number.
    pub struct Float64 {
        /// The number.
        data: f64,
    }
}
message! { "control_msgs/msg/GripperCommand" =
    /// A motion of a gripper.
    pub struct GripperCommand {
        /// m.
        position: f64,
        /// N.
        max_effort: f64,
    }
}
message! { "std_msgs/msg/String" =
    /// A text.
    pub struct Text {
        /// The text.
        data: String,
    }
}
message! { "std_msgs/msg/Empty" =
    /// A sign of life: nothing, which IDL gives one byte.
    pub struct Empty {
        /// Field without a meaning.
        structure_needs_at_least_one_member: u8,
    }
}
message! { "std_srvs/srv/Trigger_Request" =
    /// The question of a trigger: nothing, which IDL gives one byte.
    pub struct TriggerRequest {
        /// Field without a meaning.
        structure_needs_at_least_one_member: u8,
    }
}
message! { "std_srvs/srv/Trigger_Response" =
    /// The answer of a trigger.
    pub struct TriggerResponse {
        /// True if it was carried out.
        success: bool,
        /// Why not, or what was done.
        message: String,
    }
}

/// 6 × 6, row by row: x, y, z, then the rotations about them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance(pub [f64; 36]);

impl Default for Covariance {
    fn default() -> Self {
        Self([0.0; 36])
    }
}

impl Field for Covariance {
    fn ros_type() -> String {
        <[f64; 36]>::ros_type()
    }

    fn write(&self, to: &mut Writer) {
        self.0.write(to);
    }
}

impl Decode for Covariance {
    const BYTES_MIN: usize = <[f64; 36]>::BYTES_MIN;

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        Ok(Self(Decode::read(from)?))
    }
}

impl Time {
    /// From ns since the Unix epoch; what lies beyond 2038 is held there, as the type has no later time.
    pub fn from_unix_ns(unix_ns: u64) -> Self {
        let sec = i32::try_from(unix_ns / 1_000_000_000).unwrap_or(i32::MAX);
        // Below 10⁹.
        Self { sec, nanosec: u32::try_from(unix_ns % 1_000_000_000).unwrap_or(0) }
    }

    /// ns since the Unix epoch; 0 for times before it.
    pub fn unix_ns(&self) -> u64 {
        u64::try_from(self.sec).map_or(0, |sec| sec * 1_000_000_000 + u64::from(self.nanosec))
    }
}

impl Header {
    /// Builds the header of `frame_id` at `stamp`.
    pub fn new(stamp: &Time, frame_id: &str) -> Self {
        Self { stamp: stamp.clone(), frame_id: frame_id.into() }
    }
}

macro_rules! array {
    ($($name:ident = [$($axis:ident),*] of $n:literal),*) => {$(
        impl From<[f64; $n]> for $name {
            fn from([$($axis),*]: [f64; $n]) -> Self {
                Self { $($axis),* }
            }
        }

        impl $name {
            /// Its fields in their order.
            pub const fn array(&self) -> [f64; $n] {
                [$(self.$axis),*]
            }
        }
    )*};
}
array!(Vector3 = [x, y, z] of 3, Point = [x, y, z] of 3, Quaternion = [x, y, z, w] of 4);

impl Quaternion {
    /// A turn about z, rad.
    pub fn about_z(yaw_rad: f64) -> Self {
        let (z, w) = (0.5 * yaw_rad).sin_cos();
        Self { x: 0.0, y: 0.0, z, w }
    }

    /// The turn about z of what is flat, rad.
    pub fn yaw_rad(&self) -> f64 {
        let Self { x, y, z, w } = self;
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
    }
}
