//! Messages of ROS 2 that only viewers read; fields as in its packages of the same names.

use crate::ros::{
    message,
    messages::{Header, Point, Pose, Time, Vector3},
};

message! { "builtin_interfaces/msg/Duration" =
    pub(super) struct Duration { sec: i32, nanosec: u32 }
}
message! { "std_msgs/msg/ColorRGBA" =
    pub(super) struct Color { r: f32, g: f32, b: f32, a: f32 }
}
message! { "rcl_interfaces/msg/Log" =
    pub(super) struct Log {
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
    pub(super) struct CompressedImage { header: Header, format: String, data: Vec<u8> }
}
message! { "visualization_msgs/msg/UVCoordinate" =
    pub(super) struct UvCoordinate { u: f32, v: f32 }
}
message! { "visualization_msgs/msg/MeshFile" =
    pub(super) struct MeshFile { filename: String, data: Vec<u8> }
}
message! { "visualization_msgs/msg/Marker" =
    pub(super) struct Marker {
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
    pub(super) struct Markers { markers: Vec<Marker> }
}
