//! Messages of ROS 2 that viewers know by name; fields as in its packages of the same names.

use super::cdr::message;

message! { "builtin_interfaces/msg/Time" =
    /// Since the Unix epoch.
    struct Time { sec: i32, nanosec: u32 }
}
message! { "builtin_interfaces/msg/Duration" =
    struct Duration { sec: i32, nanosec: u32 }
}
message! { "std_msgs/msg/Header" =
    /// When, and in which frame.
    struct Header { stamp: Time, frame_id: String }
}
message! { "std_msgs/msg/String" =
    struct Text { data: String }
}
message! { "std_msgs/msg/ColorRGBA" =
    struct Color { r: f32, g: f32, b: f32, a: f32 }
}
message! { "geometry_msgs/msg/Vector3" =
    struct Vector3 { x: f64, y: f64, z: f64 }
}
message! { "geometry_msgs/msg/Point" =
    struct Point { x: f64, y: f64, z: f64 }
}
message! { "geometry_msgs/msg/Quaternion" =
    struct Quaternion { x: f64, y: f64, z: f64, w: f64 }
}
message! { "geometry_msgs/msg/Transform" =
    struct Transform { translation: Vector3, rotation: Quaternion }
}
message! { "geometry_msgs/msg/TransformStamped" =
    struct TransformStamped { header: Header, child_frame_id: String, transform: Transform }
}
message! { "tf2_msgs/msg/TFMessage" =
    struct Transforms { transforms: Vec<TransformStamped> }
}
message! { "geometry_msgs/msg/Pose" =
    struct Pose { position: Point, orientation: Quaternion }
}
message! { "geometry_msgs/msg/PoseStamped" =
    struct PoseStamped { header: Header, pose: Pose }
}
message! { "geometry_msgs/msg/Wrench" =
    struct Wrench { force: Vector3, torque: Vector3 }
}
message! { "geometry_msgs/msg/WrenchStamped" =
    struct WrenchStamped { header: Header, wrench: Wrench }
}
message! { "sensor_msgs/msg/JointState" =
    struct JointState {
        header: Header,
        name: Vec<String>,
        position: Vec<f64>,
        velocity: Vec<f64>,
        effort: Vec<f64>,
    }
}
message! { "rcl_interfaces/msg/Log" =
    struct Log {
        stamp: Time,
        level: u8,
        name: String,
        msg: String,
        file: String,
        function: String,
        line: u32,
    }
}
message! { "sensor_msgs/msg/CompressedImage" =
    struct CompressedImage { header: Header, format: String, data: Vec<u8> }
}
message! { "visualization_msgs/msg/UVCoordinate" =
    struct UvCoordinate { u: f32, v: f32 }
}
message! { "visualization_msgs/msg/MeshFile" =
    struct MeshFile { filename: String, data: Vec<u8> }
}
message! { "visualization_msgs/msg/Marker" =
    struct Marker {
        header: Header,
        ns: String,
        id: i32,
        r#type: i32,
        action: i32,
        pose: Pose,
        scale: Vector3,
        color: Color,
        lifetime: Duration,
        frame_locked: bool,
        points: Vec<Point>,
        colors: Vec<Color>,
        texture_resource: String,
        texture: CompressedImage,
        uv_coordinates: Vec<UvCoordinate>,
        text: String,
        mesh_resource: String,
        mesh_file: MeshFile,
        mesh_use_embedded_materials: bool,
    }
}
message! { "visualization_msgs/msg/MarkerArray" =
    struct Markers { markers: Vec<Marker> }
}

impl Time {
    /// From ns since the Unix epoch.
    pub(super) fn from_unix_ns(unix_ns: u64) -> Self {
        Self {
            sec: i32::try_from(unix_ns / 1_000_000_000).unwrap_or(i32::MAX),
            nanosec: u32::try_from(unix_ns % 1_000_000_000).unwrap_or(0),
        }
    }
}

impl Header {
    pub(super) fn new(stamp: &Time, frame: &str) -> Self {
        Self { stamp: stamp.clone(), frame_id: frame.into() }
    }
}

impl From<[f64; 3]> for Vector3 {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Self { x, y, z }
    }
}

impl From<[f64; 3]> for Point {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Self { x, y, z }
    }
}

impl From<[f64; 4]> for Quaternion {
    fn from([x, y, z, w]: [f64; 4]) -> Self {
        Self { x, y, z, w }
    }
}
