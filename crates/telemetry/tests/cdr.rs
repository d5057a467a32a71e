//! The messages against bytes that another implementation wrote (`cdr/write.py`), and against bytes that nobody should.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests stop at the first surprise")]

use moca_telemetry::ros::{
    Message,
    cdr::{self, CdrError, Decode},
    messages::*,
};
use proptest::prelude::*;

fn header(frame_id: &str) -> Header {
    Header { stamp: Time { sec: 1_700_000_000, nanosec: 123_456_789 }, frame_id: frame_id.into() }
}

fn twist() -> Twist {
    Twist { linear: Vector3::from([0.1, -0.2, 0.3]), angular: Vector3::from([-0.4, 0.5, -0.6]) }
}

fn turn() -> Quaternion {
    Quaternion::from([0.0, 0.0, 0.6, 0.8])
}

fn pose() -> Pose {
    Pose { position: Point::from([1.5, -2.25, 0.125]), orientation: turn() }
}

fn covariance() -> Covariance {
    Covariance(std::array::from_fn(|i| f64::from(u8::try_from(i).unwrap())))
}

fn odometry() -> Odometry {
    Odometry {
        header: header("odom"),
        child_frame_id: "base_footprint".into(),
        pose: PoseWithCovariance { pose: pose(), covariance: covariance() },
        twist: TwistWithCovariance { twist: twist(), covariance: covariance() },
    }
}

fn joint_state() -> JointState {
    JointState {
        header: header(""),
        name: vec!["a".into(), "joint_2".into()],
        position: vec![0.25, -0.5],
        velocity: vec![1.0, 2.0],
        effort: vec![],
    }
}

fn tf() -> TFMessage {
    let frame = |name: &str| TransformStamped {
        header: header("odom"),
        child_frame_id: name.into(),
        transform: Transform { translation: Vector3::from([7.0, 8.0, 9.0]), rotation: turn() },
    };
    TFMessage { transforms: vec![frame("base_link"), frame("f")] }
}

fn diagnostics() -> DiagnosticArray {
    let value = KeyValue { key: "overruns".into(), value: "3".into() };
    let status = DiagnosticStatus {
        level: 2,
        name: "mocad: loop".into(),
        message: "stopped".into(),
        hardware_id: String::new(),
        values: vec![value.clone(), value],
    };
    DiagnosticArray { header: header(""), status: vec![status] }
}

fn array() -> Float64MultiArray {
    let dim = MultiArrayDimension { label: "taxel".into(), size: 2, stride: 6 };
    Float64MultiArray {
        layout: MultiArrayLayout { dim: vec![dim], data_offset: 0 },
        data: vec![1.0, 2.0, 3.0],
    }
}

fn wrench() -> WrenchStamped {
    let wrench = Wrench { force: Vector3::from([1.0, 2.0, 3.0]), torque: Vector3::from([4.0, 5.0, 6.0]) };
    WrenchStamped { header: header("flange"), wrench }
}

/// Each message of the file: name, whether little-endian, payload.
fn fixtures() -> Vec<(&'static str, bool, Vec<u8>)> {
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    let lines = include_str!("cdr/messages.txt").lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| {
            let [name, order, hex] = line.split(' ').collect::<Vec<_>>().try_into().unwrap();
            (name, order == "little", hex.as_bytes().chunks(2).map(byte).collect())
        })
        .collect()
}

/// Reads both byte orders, writes the same bytes, and refuses every shorter and every longer payload.
fn check<T: Message + Decode + PartialEq + std::fmt::Debug>(message: &T) {
    let name = T::TYPE.0.rsplit('/').next().unwrap();
    let of_name: Vec<_> = fixtures().into_iter().filter(|(fixture, ..)| *fixture == name).collect();
    assert_eq!(of_name.len(), 2, "{name}");
    for (_, little, bytes) in of_name {
        assert_eq!(cdr::decode::<T>(&bytes).as_ref(), Ok(message), "{name}");
        if little {
            assert_eq!(cdr::encode(message), bytes, "{name}");
        }
        for end in 0..bytes.len() {
            assert!(cdr::decode::<T>(&bytes[..end]).is_err(), "{name} of {end} bytes");
        }
        let longer = [&bytes[..], &[0; 4]].concat();
        assert_eq!(cdr::decode::<T>(&longer), Err(CdrError::LeftOver { bytes: 4 }), "{name}");
    }
}

#[test]
fn messages_are_those_of_another_implementation_to_the_byte() {
    check(&twist());
    check(&TwistStamped { header: header("base_link"), twist: twist() });
    check(&PoseStamped { header: header("odom"), pose: pose() });
    check(&wrench());
    check(&odometry());
    check(&joint_state());
    check(&tf());
    check(&diagnostics());
    check(&array());
    check(&Float64 { data: 0.2 });
    check(&GripperCommand { position: 0.025, max_effort: 40.0 });
    check(&Text { data: "ein Gruß".into() });
    check(&TriggerRequest::default());
    check(&TriggerResponse { success: true, message: "ready".into() });
}

#[test]
fn one_twist_is_not_the_other() {
    let stamped = TwistStamped { header: header(""), twist: twist() };
    assert_eq!(cdr::decode::<Twist>(&cdr::encode(&stamped)), Err(CdrError::LeftOver { bytes: 16 }));
    assert!(cdr::decode::<TwistStamped>(&cdr::encode(&twist())).is_err());
}

#[test]
fn a_list_that_announces_more_than_there_is_takes_no_memory() {
    let mut bytes = cdr::encode(&array());
    let count = bytes.len() - 3 * 8 - 4;
    bytes[count..count + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(cdr::decode::<Float64MultiArray>(&bytes), Err(CdrError::Truncated { .. })));
}

#[test]
fn nan_travels_and_is_for_the_reader_to_judge() {
    let mut message = odometry();
    message.pose.pose.position.x = f64::NAN;
    message.twist.twist.angular.z = f64::NEG_INFINITY;
    let back = cdr::decode::<Odometry>(&cdr::encode(&message)).unwrap();
    assert!(back.pose.pose.position.x.is_nan() && back.twist.twist.angular.z == f64::NEG_INFINITY);
}

fn survives<T: Decode>(bytes: &[u8]) {
    // Whatever it is, what can be read can be written, and then read again to the same bytes.
    if let Ok(message) = cdr::decode::<T>(bytes) {
        let written = cdr::encode(&message);
        let again = cdr::decode::<T>(&written).unwrap();
        assert_eq!(cdr::encode(&again), written);
    }
}

proptest! {
    #[test]
    fn no_bytes_are_too_strange(bytes in proptest::collection::vec(any::<u8>(), 0..400), order in 0_u8..2) {
        let payload = [&[0, order, 0, 0], &bytes[..]].concat();
        for bytes in [&bytes[..], &payload[..]] {
            survives::<Odometry>(bytes);
            survives::<JointState>(bytes);
            survives::<TFMessage>(bytes);
            survives::<DiagnosticArray>(bytes);
            survives::<Float64MultiArray>(bytes);
            survives::<TriggerResponse>(bytes);
        }
    }

    #[test]
    fn a_byte_changed_anywhere_is_survived(at in 0_usize..400, value: u8) {
        for (_, _, mut bytes) in fixtures() {
            let place = at % bytes.len();
            bytes[place] = value;
            survives::<DiagnosticArray>(&bytes);
            survives::<JointState>(&bytes);
            survives::<TFMessage>(&bytes);
        }
    }

    #[test]
    fn any_text_and_any_numbers_come_back(name in ".{0,20}", data in proptest::collection::vec(any::<f64>(), 0..20)) {
        let joints = JointState { name: vec![name], position: data, ..JointState::default() };
        let bytes = cdr::encode(&joints);
        let back = cdr::decode::<JointState>(&bytes).unwrap();
        prop_assert_eq!(cdr::encode(&back), bytes);
        prop_assert_eq!(back.name, joints.name);
    }
}
