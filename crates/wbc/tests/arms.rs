//! Other arms, mounts, payloads and tools against Pinocchio: nothing but the tables changes.
#![allow(clippy::unwrap_used, reason = "tests")]

use moca_wbc::ArmModel;
use moca_wbc::robot::{FR3, LinkInertial, UR10E};
use moca_wbc::{ArmTable, Mount, Payload};
use serde_json::Value;

const TOLERANCE: f64 = 1e-12;

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        other => vec![other.as_f64().unwrap()],
    }
}

fn array<const D: usize>(value: &Value) -> [f64; D] {
    numbers(value).try_into().unwrap()
}

fn assert_close(what: &str, values: &[f64], reference: &Value) {
    let reference = numbers(reference);
    assert_eq!(values.len(), reference.len(), "{what}");
    let scale = reference.iter().fold(1.0_f64, |most, r| most.max(r.abs()));
    for (value, reference) in values.iter().zip(&reference) {
        let error = (value - reference).abs() / scale;
        assert!(error <= TOLERANCE, "{what}: {value} against {reference}");
    }
}

fn check<const N: usize>(arm: &ArmTable<N>, case: &Value) {
    let [x, y, z, roll, pitch, yaw] = array::<6>(&case["mount"]);
    let mount = Mount { position_base_m: [x, y, z], rpy_rad: [roll, pitch, yaw] };
    let payload = Payload {
        inertial: LinkInertial {
            mass_kg: case["payload"]["mass"].as_f64().unwrap(),
            com_m: array(&case["payload"]["com"]),
            inertia_com: array(&case["payload"]["inertia"]),
        },
        tool_origin: array(&case["tool"]),
    };
    let model = ArmModel::<N, f64>::new(arm, &mount, &payload).unwrap();
    let dynamics = model.dynamics(case["yaw"].as_f64().unwrap(), &array(&case["q"]), &array(&case["dq"]));
    let kinematics = &dynamics.kinematics;
    assert_close("tool", kinematics.tool_from_base().as_slice(), &case["tool_from_base"]);
    assert_close("axes", kinematics.tool_rotation.transpose().as_slice(), &case["tool_rotation"]);
    assert_close("Jacobian", kinematics.arm_jacobian().transpose().as_slice(), &case["jacobian"]);
    assert_close("mass matrix", dynamics.mass.as_slice(), &case["mass"]);
    assert_close("bias", &dynamics.bias, &case["bias"]);
    assert_close("gravity", &dynamics.gravity(), &case["gravity"]);
}

#[test]
fn fr3_and_ur10e_agree_with_pinocchio() {
    let document: Value = serde_json::from_str(include_str!("../../../tests/fixtures/arms.json")).unwrap();
    for case in document["fr3"].as_array().unwrap() {
        check(&FR3, case);
    }
    for case in document["ur10e"].as_array().unwrap() {
        check(&UR10E, case);
    }
}
