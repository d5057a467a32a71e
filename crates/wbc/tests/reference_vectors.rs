//! The reference configurations (Pinocchio kinematics and dynamics, torques in 50 digits).
#![allow(clippy::unwrap_used, reason = "tests")]

use moca_wbc::testing::reference_file as compare;

#[test]
fn every_quantity_of_the_reference_file_agrees() {
    let text = include_str!("../../../tests/fixtures/wbc.json");
    let errors = compare::compare(&serde_json::from_str(text).unwrap()).unwrap();
    for (name, error) in errors {
        assert!(error.is_some_and(compare::passes), "{name}: {error:?}");
    }
}
