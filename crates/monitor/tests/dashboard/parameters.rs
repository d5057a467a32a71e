//! Parameters.

use crate::bench::{Bench, parameter};
use egui::Key;
use egui_kittest::kittest::Queryable;
use moca_msgs::{Mode, ParameterValues, Request};
use moca_telemetry::{ParameterDescription, ParameterForm, ParameterValue};

/// A vector of a base's motion.
fn vector(name: &str, value: &[f64]) -> ParameterDescription {
    let units = ["N·s/m", "N·s/m", "N·m·s/rad"].map(Into::into).to_vec();
    ParameterDescription { units, ..parameter(name, ParameterForm::Number, value, true) }
}

#[test]
fn a_live_parameter_is_edited_checked_and_applied() {
    let mut bench = Bench::new();
    bench.daemon.borrow_mut().parameters = vec![
        vector("control.gains.virtual_damping", &[80.0, 80.0, 60.0]),
        parameter("control.corrections.base_coupling", ParameterForm::Flag, &[1.0], true),
        parameter("limits.torque_nm", ParameterForm::Number, &[87.0], false),
    ];
    bench.frames(Mode::Impedance, None);
    bench.click("Parameters");
    assert!(bench.shows("0 to 1000 N·s/m") && bench.shows("What it is for."));
    assert!(!bench.shows("Apply torque_nm"), "it is read at the start only");
    bench.click("Apply virtual_damping");
    assert_eq!(bench.asked(), [], "nothing is changed yet");

    bench.harness.get_by_label("virtual_damping y").focus();
    bench.frames(Mode::Impedance, None);
    bench.harness.get_by_label("virtual_damping y").type_text("120");
    bench.frames(Mode::Impedance, None);
    bench.harness.key_press(Key::Enter);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [], "not before it is applied");
    bench.click("Apply virtual_damping");
    let values = ParameterValues::new(&[80.0, 120.0, 60.0]).unwrap();
    assert_eq!(bench.asked(), [Request::SetParameter { parameter: 0, values }]);

    bench.click("base_coupling value");
    bench.click("Apply base_coupling");
    let values = ParameterValues::new(&[0.0]).unwrap();
    assert_eq!(bench.asked(), [Request::SetParameter { parameter: 1, values }]);

    // A change that the daemon tells, by whomever, is shown and starts no new history.
    let before = bench.harness.state().model().history.len();
    bench.daemon.borrow_mut().parameters[1].value = ParameterValue::Numbers(vec![0.0]);
    bench.frames(Mode::Impedance, None);
    assert!(bench.harness.state().model().history.len() > before);
    assert_eq!(bench.harness.state().model().robot.parameters[1].value, ParameterValue::Numbers(vec![0.0]));
}

#[test]
fn invalid_typed_value_is_kept_red_with_range() {
    let mut bench = Bench::new();
    let damping = parameter("control.gains.damping_ratio", ParameterForm::Number, &[0.9], true);
    bench.daemon.borrow_mut().parameters = vec![ParameterDescription { max: 5.0, ..damping }];
    bench.frames(Mode::Ready, None);
    bench.click("Parameters");
    let type_in = |bench: &mut Bench, text: &str| {
        bench.harness.get_by_label("damping_ratio value").focus();
        bench.frames(Mode::Ready, None);
        bench.harness.get_by_label("damping_ratio value").type_text(text);
        bench.frames(Mode::Ready, None);
        bench.harness.key_press(Key::Enter);
        bench.frames(Mode::Ready, None);
    };
    type_in(&mut bench, "77");
    assert!(bench.shows("damping_ratio = 77 N·s/m is outside 0 to 5 N·s/m"));
    bench.click("Apply damping_ratio");
    assert_eq!(bench.asked(), []);
    type_in(&mut bench, "4.5");
    assert!(!bench.shows("is outside"));
    bench.click("Apply damping_ratio");
    assert_eq!(bench.asked().len(), 1);
}

#[test]
fn tuned_parameters_go_back_to_their_defaults_and_into_a_file() {
    let folder = std::env::temp_dir().join(format!("moca-tuned-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut bench = Bench::new();
    bench.harness.state_mut().set_folder(folder.clone());
    bench.daemon.borrow_mut().parameters = vec![vector("control.gains.virtual_damping", &[80.0, 80.0, 60.0])];
    bench.frames(Mode::Ready, None);
    bench.click("Parameters");
    bench.click("Save as TOML");
    assert!(bench.shows("Nothing is saved"));
    let tuned = ParameterValue::Numbers(vec![80.0, 120.0, 60.0]);
    bench.daemon.borrow_mut().parameters[0].value = tuned;
    bench.frames(Mode::Ready, None);
    for name in ["virtual_damping x", "virtual_damping y", "virtual_damping yaw"] {
        assert!(bench.harness.query_by_label(name).is_some(), "{name}");
    }
    bench.click("Save as TOML");
    let file = std::fs::read_dir(&folder).unwrap().next().expect("a file was saved").unwrap();
    let text = std::fs::read_to_string(file.path()).unwrap();
    assert!(text.contains("[control.gains]\nvirtual_damping = [80.0, 120.0, 60.0]"), "{text}");
    assert!(bench.shows("1 values that differ"));
    bench.click("Default virtual_damping");
    assert_eq!(bench.asked(), [], "it is applied first");
    bench.click("Apply all (1)");
    let values = ParameterValues::new(&[80.0, 80.0, 60.0]).unwrap();
    assert_eq!(bench.asked(), [Request::SetParameter { parameter: 0, values }]);
    std::fs::remove_dir_all(&folder).unwrap();
}
