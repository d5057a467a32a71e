//! The dashboard without a display: every control, by its accessible label, sends its command.
#![allow(clippy::unwrap_used, clippy::panic, reason = "test helpers fail by panicking")]

use egui::{Event, Key, Modifiers, PointerButton, Pos2, Vec2};
use egui_kittest::{Harness, kittest::Queryable};
use moca_monitor::{
    logic::source::{live::Live, playback::Playback},
    ui::App,
};
use moca_msgs::{
    Fault, Law, Mode, ParameterValues, Refusal, Request, Sample, TaxelReading, TaxelStatus, board::Diagnosis,
};
use moca_telemetry::{
    ParameterDescription, ParameterForm, ParameterValue, RobotDescription,
    calibration::{CalibrationFit, CalibrationProgress, CalibrationRequest, FittedModel},
    net::{Commander, Link, Reply, Status, Update},
};
use std::{
    cell::RefCell,
    collections::{BTreeMap, VecDeque},
    rc::Rc,
    sync::Arc,
};

/// A daemon that exists only as what it says and what it was asked.
#[derive(Default)]
struct Daemon {
    down: Option<String>,
    simulated: bool,
    no_cover: bool,
    commander: Commander,
    samples: VecDeque<Sample>,
    replies: Vec<Reply>,
    asked: Vec<Request>,
    parameters: Vec<ParameterDescription>,
    calibration: CalibrationProgress,
    calibrate: Vec<CalibrationRequest>,
    session: u64,
    signs_of_life: u32,
}

#[derive(Clone)]
struct Fake(Rc<RefCell<Daemon>>);

impl Live for Fake {
    fn poll(&mut self) -> Update {
        let mut daemon = self.0.borrow_mut();
        let parameters = daemon.parameters.clone();
        let mut robot = RobotDescription::paper("test robot", daemon.simulated);
        if daemon.no_cover {
            robot.taxels.clear();
        }
        let description = Arc::new(RobotDescription { parameters, ..robot });
        let link = match &daemon.down {
            Some(reason) => Link::Down { reason: reason.clone() },
            None => Link::Up { session: daemon.session, description },
        };
        let samples = daemon.samples.drain(..).collect();
        let replies = std::mem::take(&mut daemon.replies);
        Update {
            link,
            status: Status { commander: daemon.commander, ..Status::default() },
            samples,
            replies,
            calibration: daemon.calibration.clone(),
            unread_dropped: 0,
        }
    }

    fn alive(&mut self) {
        self.0.borrow_mut().signs_of_life += 1;
    }

    fn request(&mut self, request: Request) {
        self.0.borrow_mut().asked.push(request);
    }

    fn calibrate(&mut self, request: CalibrationRequest) {
        self.0.borrow_mut().calibrate.push(request);
    }
}

struct Bench {
    daemon: Rc<RefCell<Daemon>>,
    harness: Harness<'static, App>,
    tick: u64,
    masked: Option<usize>,
}

impl Bench {
    fn new() -> Self {
        let daemon = Rc::new(RefCell::new(Daemon { simulated: true, session: 1, ..Daemon::default() }));
        let app =
            App::new(&egui::Context::default(), Fake(Rc::clone(&daemon)), "127.0.0.1:7611".into(), None);
        let harness = Harness::builder().with_size([1280.0, 800.0]).build_ui_state(
            |ui, app: &mut App| {
                app.update(&ui.ctx().clone());
                app.show(ui);
            },
            app,
        );
        Self { daemon, harness, tick: 0, masked: None }
    }

    fn in_mode(mode: Mode) -> Self {
        let mut bench = Self::new();
        bench.frames(mode, None);
        bench
    }

    /// A few frames, each with a fresh sample.
    fn frames(&mut self, mode: Mode, fault: Option<Fault>) {
        for _ in 0..3 {
            let mut sample = sample(self.tick, mode, fault);
            if let Some(taxel) = self.masked {
                sample.taxels[taxel].status = TaxelStatus::Masked;
            }
            self.tick += 1;
            self.daemon.borrow_mut().samples.push_back(sample);
            self.harness.step();
        }
    }

    fn asked(&self) -> Vec<Request> {
        std::mem::take(&mut self.daemon.borrow_mut().asked)
    }

    fn click(&mut self, label: &str) {
        self.harness.get_by_label(label).click();
        let latest = self.harness.state().model().latest.clone();
        let (mode, fault) = latest.map_or((Mode::Starting, None), |s| (s.mode, s.fault));
        self.frames(mode, fault);
    }

    fn pointer(&mut self, pos: Pos2, pressed: bool) {
        self.harness.hover_at(pos);
        self.harness.event(Event::PointerButton {
            pos,
            button: PointerButton::Primary,
            pressed,
            modifiers: Modifiers::NONE,
        });
    }

    fn shows(&self, text: &str) -> bool {
        self.harness.query_all_by_label_contains(text).next().is_some()
    }
}

fn sample(tick: u64, mode: Mode, fault: Option<Fault>) -> Sample {
    let mut sample = Sample {
        tick,
        time_ns: tick * 1_000_000,
        mode,
        fault,
        board: Diagnosis::Frames,
        frame_age_s: 0.02,
        ..Sample::default()
    };
    sample.q_rad.extend(moca_msgs::robot::PANDA.home_rad);
    sample.taxels.extend([TaxelReading { force_n: 0.0, status: TaxelStatus::Ok }; 11]);
    sample.counts.extend([720; 11]);
    sample
}

#[test]
fn an_arm_without_a_cover_shows_nothing_of_one() {
    let of_a_cover = ["Press and hold a taxel to push with", "Frame age", "Cover speed", "Speed limit"];
    for no_cover in [false, true] {
        let mut bench = Bench::new();
        bench.daemon.borrow_mut().no_cover = no_cover;
        bench.frames(Mode::Impedance, None);
        for text in of_a_cover {
            assert_eq!(bench.shows(text), !no_cover, "{text}");
        }
        assert!(bench.shows("Loop lateness"));
    }
}

#[test]
fn each_button_sends_its_command_when_it_makes_sense() {
    let cases = [
        ("Tare", Mode::Ready, Request::Tare),
        ("Tare", Mode::ProtectiveStop, Request::Tare),
        ("Arm", Mode::Ready, Request::Arm),
        ("Disarm", Mode::Impedance, Request::Disarm),
        ("Resume", Mode::ProtectiveStop, Request::Resume),
        ("Follow-me", Mode::Ready, Request::SelectLaw(Law::FollowMe)),
        ("Impedance", Mode::FollowMe, Request::SelectLaw(Law::Impedance)),
        ("STOP (space)", Mode::Impedance, Request::Stop),
        ("STOP (space)", Mode::Starting, Request::Stop),
    ];
    for (label, mode, request) in cases {
        let mut bench = Bench::in_mode(mode);
        bench.click(label);
        assert_eq!(bench.asked(), [request], "{label} in {}", mode.name());
    }
}

#[test]
fn a_button_that_makes_no_sense_does_nothing() {
    for (label, mode) in [
        ("Arm", Mode::Impedance),
        ("Tare", Mode::Impedance),
        ("Disarm", Mode::Ready),
        ("Resume", Mode::Ready),
    ] {
        let mut bench = Bench::in_mode(mode);
        bench.click(label);
        assert_eq!(bench.asked(), [], "{label} in {}", mode.name());
    }
}

#[test]
fn the_space_bar_stops_from_everywhere_and_does_nothing_else() {
    for mode in [Mode::Starting, Mode::Taring, Mode::Ready, Mode::Impedance, Mode::FollowMe] {
        let mut bench = Bench::in_mode(mode);
        bench.harness.key_press(Key::Space);
        bench.frames(mode, None);
        assert_eq!(bench.asked(), [Request::Stop], "in {}", mode.name());
    }
    // With the keyboard's focus on a button, space would press that button too.
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.harness.get_by_label("Arm").focus();
    bench.frames(Mode::Ready, None);
    assert!(bench.harness.get_by_label("Arm").is_focused());
    bench.harness.key_press(Key::Space);
    bench.frames(Mode::Ready, None);
    assert_eq!(bench.asked(), [Request::Stop]);
    // Enter still presses it.
    bench.harness.key_press(Key::Enter);
    bench.frames(Mode::Ready, None);
    assert_eq!(bench.asked(), [Request::Arm]);
}

#[test]
fn a_taxel_is_pushed_while_the_mouse_holds_it() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    let at = bench.harness.get_by_label("Push T6").rect().center();
    bench.pointer(at, true);
    bench.frames(Mode::Impedance, None);
    bench.frames(Mode::Impedance, None);
    assert_eq!(
        bench.asked(),
        [Request::PressTaxel { taxel: 5, force_n: 20.0 }],
        "one request, however long it is held"
    );
    bench.pointer(at, false);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [Request::PressTaxel { taxel: 5, force_n: 0.0 }]);
}

#[test]
fn each_taxel_is_masked_and_taken_back_by_its_button_unless_the_robot_moves() {
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.click("Cover");
    for taxel in 0..11 {
        bench.click(&format!("Mask T{}", taxel + 1));
        assert_eq!(bench.asked(), [Request::MaskTaxel { taxel, masked: true }]);
    }
    bench.masked = Some(3);
    bench.frames(Mode::Ready, None);
    bench.click("Use T4");
    assert_eq!(bench.asked(), [Request::MaskTaxel { taxel: 3, masked: false }]);
    bench.frames(Mode::Impedance, None);
    bench.click("Mask T1");
    assert_eq!(bench.asked(), [], "while a law moves the robot");
    assert!(bench.shows("Disarm to change masks"));
}

#[test]
fn a_taxel_is_pushed_with_the_keyboard_too() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.harness.get_by_label("Push T3").focus();
    bench.frames(Mode::Impedance, None);
    bench.harness.key_down(Key::Enter);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [Request::PressTaxel { taxel: 2, force_n: 20.0 }]);
    bench.harness.key_up(Key::Enter);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [Request::PressTaxel { taxel: 2, force_n: 0.0 }]);
}

#[test]
fn a_push_ends_when_the_mouse_leaves_the_window() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    let at = bench.harness.get_by_label("Push T1").rect().center();
    bench.pointer(at, true);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked().len(), 1);
    bench.harness.remove_cursor();
    bench.pointer(at + Vec2::new(5000.0, 0.0), false);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [Request::PressTaxel { taxel: 0, force_n: 0.0 }]);
}

#[test]
fn a_real_robot_cannot_be_pushed_with_the_mouse() {
    let mut bench = Bench::new();
    bench.daemon.borrow_mut().simulated = false;
    bench.frames(Mode::Impedance, None);
    let at = bench.harness.get_by_label("Push T6").rect().center();
    bench.pointer(at, true);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), []);
}

#[test]
fn it_works_without_a_daemon_and_when_one_comes_and_goes() {
    let mut bench = Bench::new();
    bench.daemon.borrow_mut().down = Some("nobody listens".into());
    bench.harness.step();
    assert!(bench.shows("no daemon") && bench.shows("nobody listens") && bench.shows("cargo run --release"));

    bench.daemon.borrow_mut().down = None;
    bench.frames(Mode::Impedance, None);
    assert!(bench.shows("impedance") && bench.shows("test robot") && !bench.shows("no daemon"));

    bench.daemon.borrow_mut().down = Some("the daemon closed the connection".into());
    bench.harness.step();
    assert!(bench.shows("no daemon"));
    assert!(bench.harness.get_by_label("Push T6").rect().area() > 0.0, "the last picture stays");

    bench.daemon.borrow_mut().down = None;
    bench.daemon.borrow_mut().session += 1;
    bench.tick = 0;
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("ready"));
    assert_eq!(bench.harness.state().model().history.len(), 3, "a new daemon starts a new history");
}

#[test]
fn samples_that_stop_coming_are_shown_as_old() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.harness.run_steps(4);
    assert!(bench.shows("no samples") && bench.shows("what is shown is old"));
    bench.click("STOP (space)");
    assert_eq!(bench.asked(), [Request::Stop], "stop works all the same");
}

#[test]
fn a_fault_is_told_in_words_with_its_remedy_and_a_sick_taxel_is_named() {
    let mut bench = Bench::new();
    bench.frames(Mode::ProtectiveStop, Some(Fault::BoardLost));
    assert!(bench.shows(Fault::BoardLost.text()) && bench.shows(Fault::BoardLost.remedy()));
}

#[test]
fn a_refusal_and_another_commander_are_told() {
    let mut bench = Bench::in_mode(Mode::Ready);
    let refused = Reply { request: Request::Arm, outcome: Err(Refusal::ZeroInvalid) };
    bench.daemon.borrow_mut().replies.push(refused);
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("Arm: refused, the cover has no valid zero"));

    bench.daemon.borrow_mut().commander = Commander::Another;
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("another dashboard has the command"));
    bench.click("Arm");
    assert_eq!(bench.asked(), []);
    bench.click("STOP (space)");
    assert_eq!(bench.asked(), [Request::Stop], "anyone may stop");
}

#[test]
fn plots_can_be_paused_and_their_window_chosen() {
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.click("60 s");
    bench.click("Pause plots");
    assert!(bench.shows("paused, 0 s behind"));
    for _ in 0..1500 {
        let next = sample(bench.tick, Mode::Ready, None);
        bench.tick += 1;
        bench.daemon.borrow_mut().samples.push_back(next);
    }
    bench.harness.step();
    assert!(bench.shows("paused, 2 s behind"));
    bench.click("Pause plots");
    assert!(!bench.shows("paused"));
    assert_eq!(bench.asked(), []);
}

#[test]
fn the_loop_page_tells_every_stage_of_a_tick() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.click("Loop");
    assert!(bench.shows("This run was not timed."));
    let stages_ns = [900, 5_000, 20_000, 312_000, 700];
    let timed = Sample { stages_ns, ..sample(bench.tick, Mode::Impedance, None) };
    bench.tick += 1;
    bench.daemon.borrow_mut().samples.push_back(timed);
    bench.frames(Mode::Impedance, None);
    assert!(!bench.shows("This run was not timed."));
    for stage in moca_msgs::STAGES {
        assert!(bench.harness.query_by_label(stage).is_some(), "{stage}");
    }
    assert_eq!(bench.harness.query_all_by_label("312").count(), 4, "p50, p99, p99.9 and max of the plant");
    for histogram in ["Loop lateness", "From tick to tick", "Age of cover data", "Stages of a tick"] {
        assert!(bench.harness.query_by_label(&format!("Histogram {histogram}")).is_some());
    }
}

#[test]
fn a_recorded_run_can_be_held_scrubbed_and_never_commanded() {
    let samples =
        (0..30_000).map(|tick| sample(tick, if tick < 20_000 { Mode::Ready } else { Mode::Impedance }, None));
    let log = Playback::of(RobotDescription::paper("logged robot", true), samples.collect());
    let app = App::new(&egui::Context::default(), log, String::new(), None);
    let mut harness = Harness::builder().with_size([1280.0, 800.0]).build_ui_state(
        |ui, app: &mut App| {
            app.update(&ui.ctx().clone());
            app.show(ui);
        },
        app,
    );
    harness.run_steps(3);
    assert!(harness.query_by_label_contains("A recorded run of logged robot").is_some());
    harness.get_by_label("Next event").click();
    harness.run_steps(3);
    let shown = harness.state().model().latest.as_ref().map(|s| (s.tick, s.mode));
    assert_eq!(shown, Some((20_200, Mode::Impedance)));
    harness.run_steps(5);
    assert_eq!(harness.state().model().latest.as_ref().map(|s| s.tick), Some(20_200), "it holds still");
    let next =
        |harness: &Harness<'_, App>| harness.output().viewport_output[&egui::ViewportId::ROOT].repaint_delay;
    assert_eq!(next(&harness), std::time::Duration::MAX, "and nothing is drawn anew");
    harness.get_by_label("Play").click();
    harness.run_steps(5);
    assert!(next(&harness) <= App::FRAME);
    assert!(harness.state().model().latest.as_ref().is_some_and(|s| s.tick > 20_200));
    assert!(!harness.state().model().can_push());
    harness.get_by_label("Calibrate").click();
    harness.run_steps(3);
    assert!(harness.query_by_label_contains("this is a recorded run").is_some());
    assert!(harness.query_by_label("Start calibration").is_none());
    for label in ["Disarm", "STOP (space)"] {
        harness.get_by_label(label).click();
        harness.run_steps(2);
        assert!(harness.query_by_label_contains("refused").is_none(), "{label} is greyed out");
    }
}

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
fn beside_a_real_board_the_gauge_is_named_and_nobody_pushes_by_mouse() {
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

/// What a window leaves behind, as eframe writes it to a file.
#[derive(Default)]
struct Memory(BTreeMap<String, String>);

impl eframe::Storage for Memory {
    fn get_string(&self, key: &str) -> Option<String> {
        self.0.get(key).cloned()
    }

    fn set_string(&mut self, key: &str, value: String) {
        self.0.insert(key.into(), value);
    }

    fn remove_string(&mut self, key: &str) {
        self.0.remove(key);
    }

    fn flush(&mut self) {}
}

#[test]
fn the_next_window_looks_at_what_the_last_one_did() {
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.click("Loop");
    bench.click("30 s");
    let mut memory = Memory::default();
    eframe::App::save(bench.harness.state_mut(), &mut memory);
    assert_eq!(App::last_connected(&memory), ["127.0.0.1:7611".parse().unwrap()]);

    let mut next = Bench::in_mode(Mode::Ready);
    assert!(!next.shows("Histogram Loop lateness"));
    next.harness.state_mut().restore(&memory);
    next.frames(Mode::Ready, None);
    assert!(next.shows("Histogram Loop lateness"));
    let mut again = Memory::default();
    eframe::App::save(next.harness.state_mut(), &mut again);
    assert_eq!(again.0, memory.0);
    assert_eq!(again.0["span_s"], "30");

    // A file from elsewhere does no harm: what makes no sense is left out.
    for (key, value) in
        [("page", "Nowhere"), ("span_s", "NaN"), ("push_n", "1e9"), ("connect", "x 1.2.3.4:5 ")]
    {
        memory.0.insert(key.into(), value.into());
    }
    let mut next = Bench::in_mode(Mode::Ready);
    next.harness.state_mut().restore(&memory);
    next.frames(Mode::Ready, None);
    assert!(next.harness.query_by_label("Plot Base force in N").is_some(), "the first page");
    eframe::App::save(next.harness.state_mut(), &mut again);
    assert_eq!((again.0["span_s"].as_str(), again.0["push_n"].as_str()), ("10", "200"));
    assert_eq!(App::last_connected(&memory), ["1.2.3.4:5".parse().unwrap()]);
}

fn parameter(name: &str, form: ParameterForm, value: &[f64], live: bool) -> ParameterDescription {
    ParameterDescription {
        name: name.into(),
        form,
        units: vec!["N·s/m".into()],
        min: 0.0,
        max: 1000.0,
        live,
        description: "What it is for.".into(),
        default: ParameterValue::Numbers(value.to_vec()),
        value: ParameterValue::Numbers(value.to_vec()),
    }
}

#[test]
fn a_live_parameter_is_edited_checked_and_applied() {
    let mut bench = Bench::new();
    bench.daemon.borrow_mut().parameters = vec![
        parameter("control.gains.virtual_damping", ParameterForm::Number, &[80.0, 80.0, 60.0], true),
        parameter("control.corrections.base_coupling", ParameterForm::Flag, &[1.0], true),
        parameter("limits.torque_nm", ParameterForm::Number, &[87.0], false),
    ];
    bench.frames(Mode::Impedance, None);
    bench.click("Parameters");
    assert!(bench.shows("0 to 1000 N·s/m") && bench.shows("What it is for."));
    assert!(!bench.shows("Apply torque_nm"), "it is read at the start only");
    bench.click("Apply virtual_damping");
    assert_eq!(bench.asked(), [], "nothing is changed yet");

    bench.harness.get_by_label("virtual_damping 2").focus();
    bench.frames(Mode::Impedance, None);
    bench.harness.get_by_label("virtual_damping 2").type_text("120");
    bench.frames(Mode::Impedance, None);
    bench.harness.key_press(Key::Enter);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [], "not before it is applied");
    bench.click("Apply virtual_damping");
    let values = ParameterValues::new(&[80.0, 120.0, 60.0]).unwrap();
    assert_eq!(bench.asked(), [Request::SetParameter { parameter: 0, values }]);

    bench.click("base_coupling 1");
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
fn the_space_bar_stops_while_plots_are_paused_on_every_page_and_while_typing() {
    for page in ["Plots", "Loop", "Parameters", "Cover", "Calibrate"] {
        let mut bench = Bench::in_mode(Mode::Impedance);
        bench.click("Pause plots");
        bench.click(page);
        bench.click("Open log");
        bench.harness.get_by_label("Path").focus();
        bench.frames(Mode::Impedance, None);
        bench.harness.key_press(Key::Space);
        bench.frames(Mode::Impedance, None);
        assert_eq!(bench.asked(), [Request::Stop], "on page {page}");
        assert!(bench.harness.query_by_label("STOP (space)").is_some(), "the button is there too");
    }
}

#[test]
fn several_robots_have_names_and_stop_stops_them_all() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    let other = Rc::new(RefCell::new(Daemon { simulated: true, session: 1, ..Daemon::default() }));
    bench.harness.state_mut().add(Fake(Rc::clone(&other)), "127.0.0.1:7612".into());
    other.borrow_mut().samples.push_back(sample(0, Mode::Ready, None));
    bench.frames(Mode::Impedance, None);
    let count = bench.harness.query_all_by_label_contains("test robot: ").count();
    assert_eq!(count, 2, "one button for each robot");
    bench.harness.query_all_by_label_contains("test robot: ").nth(1).unwrap().click();
    let step = |bench: &mut Bench, tick| {
        other.borrow_mut().samples.push_back(sample(tick, Mode::Ready, None));
        bench.harness.step();
    };
    (1..3).for_each(|tick| step(&mut bench, tick));
    assert!(bench.harness.query_by_label("ready").is_some(), "the second robot is in front");
    // The next window, too, begins with the second one.
    let mut memory = Memory::default();
    eframe::App::save(bench.harness.state_mut(), &mut memory);
    bench.harness.query_all_by_label_contains("test robot: ").next().unwrap().click();
    bench.frames(Mode::Impedance, None);
    assert!(bench.harness.query_by_label("impedance").is_some(), "the first robot is in front");
    bench.harness.state_mut().restore(&memory);
    (3..6).for_each(|tick| step(&mut bench, tick));
    assert!(bench.harness.query_by_label("ready").is_some(), "the second robot is in front again");
    bench.harness.get_by_label("Arm").click();
    (6..9).for_each(|tick| step(&mut bench, tick));
    assert_eq!(other.borrow_mut().asked, [Request::Arm]);
    assert_eq!(bench.asked(), [], "the first robot is not armed with it");
    other.borrow_mut().asked.clear();
    bench.harness.get_by_label("STOP (space)").click();
    bench.harness.step();
    bench.harness.step();
    assert_eq!((other.borrow().asked.clone(), bench.asked()), (vec![Request::Stop], vec![Request::Stop]));
}

#[test]
fn only_a_picture_that_was_drawn_is_a_sign_of_life() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    let signs = |bench: &Bench| std::mem::take(&mut bench.daemon.borrow_mut().signs_of_life);
    assert!(signs(&bench) > 0);
    // A window that takes in what comes and draws nothing: hidden, or hung in its driver.
    let ctx = bench.harness.ctx.clone();
    for _ in 0..10 {
        bench.harness.state_mut().update(&ctx);
    }
    assert_eq!(signs(&bench), 0);
    bench.harness.step();
    assert_eq!(signs(&bench), 1);
    // It draws often enough while nothing new comes, or the daemon would miss it.
    let delay = bench.harness.output().viewport_output[&egui::ViewportId::ROOT].repaint_delay;
    assert!(delay <= std::time::Duration::from_millis(500), "{delay:?}");
}

/// A log whose robot moves all the time.
fn moving_log() -> Playback {
    let samples = (0..1000).map(|tick| sample(tick, Mode::Impedance, None));
    Playback::of(RobotDescription::paper("logged robot", true), samples.collect())
}

#[test]
fn stop_works_while_a_log_is_in_front_and_the_robot_behind_it_stays_in_sight() {
    let mut bench = Bench::in_mode(Mode::FollowMe);
    bench.harness.state_mut().add(moving_log(), "run.mcap".into());
    bench.frames(Mode::FollowMe, None);
    bench.harness.get_by_label("log of logged robot").click();
    bench.frames(Mode::FollowMe, None);
    assert!(bench.shows("A recorded run of logged robot"), "the log is in front");
    assert!(bench.shows("test robot: follow-me"), "what the robot does is seen");
    bench.harness.get_by_label("STOP (space)").click();
    bench.frames(Mode::FollowMe, None);
    assert_eq!(bench.asked(), [Request::Stop]);
    bench.daemon.borrow_mut().down = Some("gone".into());
    bench.frames(Mode::FollowMe, None);
    bench.harness.get_by_label("STOP (space)").click();
    bench.frames(Mode::FollowMe, None);
    assert_eq!(bench.asked(), [], "there is nobody to stop");
}

#[test]
fn a_log_never_looks_like_a_robot_that_runs() {
    let mut bench = Bench::in_mode(Mode::Ready);
    assert!(bench.harness.query_by_label("ready").is_some(), "the banner of a robot is its mode");
    bench.harness.state_mut().add(moving_log(), "run.mcap".into());
    bench.frames(Mode::Ready, None);
    bench.harness.get_by_label("log of logged robot").click();
    bench.frames(Mode::Ready, None);
    assert!(bench.harness.query_by_label("recorded").is_some(), "the banner of a log");
    assert!(bench.harness.query_by_label("impedance").is_none());
    assert!(bench.shows("then in mode impedance"), "its mode is told beside it");
}

#[test]
fn the_window_records_and_opens_what_it_recorded() {
    let folder = std::env::temp_dir().join(format!("moca-dashboard-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.harness.state_mut().set_folder(folder.clone());
    bench.click("Record");
    bench.frames(Mode::Impedance, None);
    bench.click("Stop recording");
    assert!(bench.shows("samples"));
    let file = std::fs::read_dir(&folder).unwrap().next().unwrap().unwrap().file_name();
    bench.click("Open log");
    bench.click(file.to_str().unwrap());
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(20);
    while !bench.shows("A recorded run of test robot") {
        assert!(std::time::Instant::now() < deadline, "the log was not read");
        std::thread::sleep(std::time::Duration::from_millis(10));
        bench.harness.step();
    }
    bench.click("Close log");
    assert!(!bench.shows("A recorded run"));
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn plots_zoom_with_the_wheel_pan_with_the_mouse_and_show_values_under_the_cursor() {
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.daemon.borrow_mut().samples.extend((10..2000).map(|tick| sample(tick, Mode::Ready, None)));
    bench.tick = 2000;
    bench.frames(Mode::Ready, None);
    let at = bench.harness.get_by_label("Plot Base force in N").rect().center();
    bench.click("Zoom in");
    bench.click("Zoom in");
    bench.harness.hover_at(at);
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("N fx") || bench.shows("fx"), "values under the cursor");
    bench.pointer(at, true);
    bench.harness.hover_at(at + Vec2::new(60.0, 0.0));
    bench.frames(Mode::Ready, None);
    bench.pointer(at + Vec2::new(60.0, 0.0), false);
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("paused"), "dragging holds the plots");
}
