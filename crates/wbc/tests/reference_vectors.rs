//! The reference configurations (Pinocchio kinematics and dynamics, torques in 50 digits).
#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "../../lab/src/vectors/compare.rs"]
mod compare;

#[test]
fn every_quantity_of_the_reference_file_agrees() {
    let text = include_str!("../../../tests/fixtures/wbc.json");
    let errors = compare::compare(&serde_json::from_str(text).unwrap()).unwrap();
    let not_built = ["adm.v1_euler", "adm.v1_semi"]; // integrators that the crate does not offer
    for (name, error) in errors {
        match error {
            Some(error) => assert!(compare::passes(error), "{name}: {error:.3e}"),
            None => assert!(not_built.contains(&name.as_str()), "{name} is not checked"),
        }
    }
}
