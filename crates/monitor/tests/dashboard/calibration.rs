//! Calibration from the dashboard.

use crate::bench::Bench;
use moca_msgs::{Mode, Request};
use moca_telemetry::calibration::{CalibrationFit, CalibrationProgress, CalibrationRequest, FittedModel};

#[test]
fn calibration_goes_step_by_step_and_asks_the_daemon() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.click("Calibrate");
    bench.click("Start calibration");
    let asked = |bench: &Bench| std::mem::take(&mut bench.daemon.borrow_mut().calibrate);
    assert_eq!(asked(&bench), [], "not while a law moves the robot");
    bench.frames(Mode::Ready, None);
    bench.click("Start calibration");
    assert_eq!(asked(&bench), [CalibrationRequest::Start { taxel: 0, presses: 3 }]);

    let press = CalibrationProgress::Press {
        taxel: 0,
        presses: 1,
        presses_wanted: 3,
        counts: 17.0,
        force_n: Some(21.5),
    };
    bench.daemon.borrow_mut().calibration = press;
    for _ in 0..30 {
        bench.frames(Mode::Ready, None);
    }
    assert!(bench.shows("17 counts below rest") && bench.shows("21.5 N"));
    let pushes = bench.asked();
    let pushes_t1 = |r: &Request| matches!(r, Request::PressTaxel { taxel: 0, force_n } if *force_n <= 80.0);
    assert!(pushes.len() > 1 && pushes.iter().all(pushes_t1), "the simulated hand presses: {pushes:?}");

    let model = |name: &str, usable| FittedModel {
        name: name.into(),
        usable,
        rmse_n: 1.23,
        worst_n: 4.0,
        force_max_n: 80.0,
        residuals: vec![[10.0, 0.5], [70.0, -1.0]],
        ..FittedModel::default()
    };
    let models = vec![model("line-with-intercept", false), model("line", true), model("monotone", true)];
    bench.daemon.borrow_mut().calibration =
        CalibrationProgress::Fitted(CalibrationFit { taxel: 0, rest_counts: 719.6, models });
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("719.6 counts at rest") && bench.shows("1.23"));
    bench.click("line");
    bench.click("Save calibration");
    assert_eq!(asked(&bench), [CalibrationRequest::Save { model: 1 }]);
    bench.click("Cancel calibration");
    assert_eq!(asked(&bench), [CalibrationRequest::Cancel]);

    bench.daemon.borrow_mut().calibration =
        CalibrationProgress::Saved { path: "/lab/calibration.toml".into(), taxels: vec![1, 6] };
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("/lab/calibration.toml with T1, T6") && bench.shows("once all 11 taxels"));
}

#[test]
fn real_board_shows_gauge_and_disables_mouse_press() {
    let mut bench = Bench::new();
    bench.daemon.borrow_mut().simulated = false;
    bench.frames(Mode::Ready, None);
    bench.click("Calibrate");
    bench.daemon.borrow_mut().calibration =
        CalibrationProgress::Unavailable("it has no reference force: set board.gauge".into());
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("cannot calibrate from here: it has no reference force: set board.gauge"));

    let press =
        CalibrationProgress::Press { taxel: 3, presses: 0, presses_wanted: 3, counts: 2.0, force_n: None };
    bench.daemon.borrow_mut().calibration = press;
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("no reading of the reference yet") && bench.shows("Press with the force gauge"));
    assert!(!bench.shows("simulated hand"));
    assert_eq!(bench.asked(), []);
    // The daemon gives up by itself, for instance because somebody armed the robot.
    bench.daemon.borrow_mut().calibration = CalibrationProgress::Failed("a law moves the robot".into());
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("That did not work: a law moves the robot"));
    bench.click("Start calibration");
    assert_eq!(bench.daemon.borrow().calibrate.len(), 1, "it can be started again");
}

#[test]
fn taxels_are_calibrated_in_turn_with_progress() {
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.click("Calibrate");
    bench.click("Calibrate all");
    let asked = |bench: &Bench| std::mem::take(&mut bench.daemon.borrow_mut().calibrate);
    let start = |taxel| CalibrationRequest::Start { taxel, presses: 3 };
    assert_eq!(asked(&bench), [start(0)]);
    let finish = |bench: &mut Bench, taxel: u8, file: &[u8]| {
        let rest = CalibrationProgress::Rest { taxel, frames: 3, frames_wanted: 40 };
        bench.daemon.borrow_mut().calibration = rest;
        bench.frames(Mode::Ready, None);
        assert!(bench.shows(&format!("T{} now", taxel + 1)));
        let taxels = file.to_vec();
        bench.daemon.borrow_mut().calibration =
            CalibrationProgress::Saved { path: "/lab/calibration.toml".into(), taxels };
        bench.frames(Mode::Ready, None);
    };
    finish(&mut bench, 0, &[1, 3]);
    assert!(bench.shows("T1 done") && bench.shows("T3 done") && bench.shows("T2 follows"));
    assert_eq!(asked(&bench), [], "there is time to step away");
    (0..5).for_each(|_| bench.frames(Mode::Ready, None));
    assert_eq!(asked(&bench), [start(1)]);
    // T3 is in the file already.
    finish(&mut bench, 1, &[1, 2, 3]);
    bench.click("Leave out T4");
    (0..5).for_each(|_| bench.frames(Mode::Ready, None));
    assert_eq!(asked(&bench), [start(4)]);
    finish(&mut bench, 4, &[1, 2, 3, 5, 6, 7, 8, 9, 10, 11]);
    (0..8).for_each(|_| bench.frames(Mode::Ready, None));
    assert_eq!(asked(&bench), [], "all but the one that was left out are done");
    // A law that moves the robot ends it.
    bench.daemon.borrow_mut().calibration = CalibrationProgress::Idle;
    bench.frames(Mode::Ready, None);
    bench.click("Calibrate all");
    assert_eq!(asked(&bench), [start(3)]);
    (0..8).for_each(|_| bench.frames(Mode::Impedance, None));
    assert_eq!(asked(&bench), []);
}
