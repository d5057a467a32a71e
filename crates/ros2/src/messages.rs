//! The ROS 2 messages that this robot speaks, field for field as their definitions have them.
//!
//! ```
//! use moca_ros2::messages::{Message, Odometry, Quaternion, TwistStamped};
//!
//! assert_eq!(Odometry::TYPE.0, "nav_msgs/msg/Odometry");
//! assert_eq!(TwistStamped::TYPE.dds(), "geometry_msgs::msg::dds_::TwistStamped_");
//! assert!((Quaternion::about_z(0.3).yaw_rad() - 0.3).abs() < 1e-15);
//! ```

use crate::cdr::{Cdr, CdrError, Reader, Writer};

/// Name of a type as ROS writes it: `geometry_msgs/msg/Twist`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TypeName(pub &'static str);

impl TypeName {
    /// As DDS and zenoh see it: `geometry_msgs::msg::dds_::Twist_`.
    pub fn dds(self) -> String {
        let mut parts = self.0.split('/');
        let mut next = || parts.next().unwrap_or_default();
        format!("{}::{}::dds_::{}_", next(), next(), next())
    }
}

/// A message that can be a topic's.
pub trait Message: Cdr {
    /// Its name.
    const TYPE: TypeName;
}

macro_rules! fields {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident : $type:ty),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct $name { $($(#[$field_doc])* pub $field: $type),* }

        impl Cdr for $name {
            const BYTES_MIN: usize = 0 $(+ <$type as Cdr>::BYTES_MIN)*;

            fn write(&self, to: &mut Writer) {
                $(self.$field.write(to);)*
            }

            fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
                Ok(Self { $($field: Cdr::read(from)?),* })
            }
        }
    };
}

macro_rules! message {
    ($(#[$doc:meta])* $name:ident = $ros:literal { $($fields:tt)* }) => {
        fields! { $(#[$doc])* $name { $($fields)* } }

        impl Message for $name {
            const TYPE: TypeName = TypeName($ros);
        }
    };
}

fields! {
    /// Since the Unix epoch.
    Time {
        /// s.
        sec: i32,
        /// ns within the second.
        nanosec: u32,
    }
}
fields! {
    /// When, and in which frame.
    Header {
        /// When it was measured, by the sender's clock.
        stamp: Time,
        /// The frame's name.
        frame_id: String,
    }
}
fields! {
    /// A vector, or a point.
    Vector3 {
        /// x.
        x: f64,
        /// y.
        y: f64,
        /// z.
        z: f64,
    }
}
fields! {
    /// An orientation as a unit quaternion.
    Quaternion {
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
fields! {
    /// Position, m, and orientation.
    Pose {
        /// m.
        position: Vector3,
        /// As a unit quaternion.
        orientation: Quaternion,
    }
}
fields! {
    /// A pose and how uncertain it is.
    PoseWithCovariance {
        /// The pose.
        pose: Pose,
        /// 6 × 6, row by row.
        covariance: Covariance,
    }
}
fields! {
    /// A twist and how uncertain it is.
    TwistWithCovariance {
        /// The twist.
        twist: Twist,
        /// 6 × 6, row by row.
        covariance: Covariance,
    }
}
fields! {
    /// Force, N, and torque, N·m.
    Wrench {
        /// N.
        force: Vector3,
        /// N·m.
        torque: Vector3,
    }
}
fields! {
    /// A frame in its parent.
    Transform {
        /// m.
        translation: Vector3,
        /// As a unit quaternion.
        rotation: Quaternion,
    }
}
fields! {
    /// A frame in its parent, at a time.
    TransformStamped {
        /// When, and the parent's name.
        header: Header,
        /// The frame's name.
        child_frame_id: String,
        /// Where it is.
        transform: Transform,
    }
}
fields! {
    /// A value with its name.
    KeyValue {
        /// Name.
        key: String,
        /// Value, as text.
        value: String,
    }
}
fields! {
    /// How a part is.
    DiagnosticStatus {
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
fields! {
    /// One dimension of a list.
    MultiArrayDimension {
        /// What it counts.
        label: String,
        /// How many.
        size: u32,
        /// Elements from one to the next, times `size`.
        stride: u32,
    }
}
fields! {
    /// Dimensions of a list, outermost first.
    MultiArrayLayout {
        /// The dimensions.
        dim: Vec<MultiArrayDimension>,
        /// Elements before the first that counts.
        data_offset: u32,
    }
}

message! {
    /// Linear velocity, m/s, and angular velocity, rad/s.
    Twist = "geometry_msgs/msg/Twist" {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    }
}
message! {
    /// A twist with time and frame.
    TwistStamped = "geometry_msgs/msg/TwistStamped" {
        /// When, and in which axes.
        header: Header,
        /// The twist.
        twist: Twist,
    }
}
message! {
    /// A pose with time and frame.
    PoseStamped = "geometry_msgs/msg/PoseStamped" {
        /// When, and in which frame.
        header: Header,
        /// The pose.
        pose: Pose,
    }
}
message! {
    /// A wrench with time and frame.
    WrenchStamped = "geometry_msgs/msg/WrenchStamped" {
        /// When, and in which axes.
        header: Header,
        /// The wrench.
        wrench: Wrench,
    }
}
message! {
    /// Where a base is, in `header.frame_id`, and how it moves, in `child_frame_id`.
    Odometry = "nav_msgs/msg/Odometry" {
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
message! {
    /// Joints by name; a list is empty where nothing is known.
    JointState = "sensor_msgs/msg/JointState" {
        /// When.
        header: Header,
        /// Names.
        name: Vec<String>,
        /// rad.
        position: Vec<f64>,
        /// rad/s.
        velocity: Vec<f64>,
        /// N·m.
        effort: Vec<f64>,
    }
}
message! {
    /// Frames in their parents.
    TFMessage = "tf2_msgs/msg/TFMessage" {
        /// One for each frame.
        transforms: Vec<TransformStamped>,
    }
}
message! {
    /// How the parts of a robot are.
    DiagnosticArray = "diagnostic_msgs/msg/DiagnosticArray" {
        /// When.
        header: Header,
        /// One for each part.
        status: Vec<DiagnosticStatus>,
    }
}
message! {
    /// Numbers in rows.
    Float64MultiArray = "std_msgs/msg/Float64MultiArray" {
        /// How the numbers are laid out.
        layout: MultiArrayLayout,
        /// The numbers.
        data: Vec<f64>,
    }
}
message! {
    /// A number.
    Float64 = "std_msgs/msg/Float64" {
        /// The number.
        data: f64,
    }
}
message! {
    /// A text.
    Text = "std_msgs/msg/String" {
        /// The text.
        data: String,
    }
}
message! {
    /// A sign of life: nothing, which IDL gives one byte.
    Empty = "std_msgs/msg/Empty" {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    }
}
message! {
    /// The question of a trigger: nothing, which IDL gives one byte.
    TriggerRequest = "std_srvs/srv/Trigger_Request" {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    }
}
message! {
    /// The answer of a trigger.
    TriggerResponse = "std_srvs/srv/Trigger_Response" {
        /// Whether it was carried out.
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

impl Cdr for Covariance {
    const BYTES_MIN: usize = <[f64; 36]>::BYTES_MIN;

    fn write(&self, to: &mut Writer) {
        self.0.write(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        Ok(Self(Cdr::read(from)?))
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

impl Vector3 {
    /// From x, y, z.
    pub const fn of([x, y, z]: [f64; 3]) -> Self {
        Self { x, y, z }
    }

    /// x, y, z.
    pub const fn array(&self) -> [f64; 3] {
        [self.x, self.y, self.z]
    }
}

impl Quaternion {
    /// From x, y, z, w.
    pub const fn of([x, y, z, w]: [f64; 4]) -> Self {
        Self { x, y, z, w }
    }

    /// x, y, z, w.
    pub const fn array(&self) -> [f64; 4] {
        [self.x, self.y, self.z, self.w]
    }

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
