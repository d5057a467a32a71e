//! Logs, and what a window remembers.

use crate::bench::{Bench, sample};
use egui_kittest::{Harness, kittest::Queryable};
use moca_monitor::{logic::source::playback::Playback, ui::App};
use moca_msgs::{Mode, Sample};
use moca_telemetry::{
    RobotDescription,
    log::{LogWriter, Meta},
};
use std::collections::BTreeMap;

/// A window of this size on a log of these samples.
fn replayed(samples: Vec<Sample>, size: [f32; 2]) -> Harness<'static, App> {
    let log = Playback::of(RobotDescription::paper("logged robot", true), samples);
    let app = App::new(&egui::Context::default(), log, String::new(), None);
    Harness::builder().with_size(size).build_ui_state(
        |ui, app: &mut App| {
            app.update(&ui.ctx().clone());
            app.show(ui);
        },
        app,
    )
}

#[test]
fn a_recorded_run_can_be_held_scrubbed_and_never_commanded() {
    let samples =
        (0..30_000).map(|tick| sample(tick, if tick < 20_000 { Mode::Ready } else { Mode::Impedance }, None));
    let mut harness = replayed(samples.collect(), [1280.0, 800.0]);
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

/// State that a window leaves behind, as eframe writes it to a file.
#[derive(Default)]
pub(crate) struct Memory(pub(crate) BTreeMap<String, String>);

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
    let ctx = next.harness.ctx.clone();
    next.harness.state_mut().restore(&ctx, &memory);
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
    let ctx = next.harness.ctx.clone();
    next.harness.state_mut().restore(&ctx, &memory);
    next.frames(Mode::Ready, None);
    assert!(next.harness.query_by_label("Plot Base force in N").is_some(), "the first page");
    eframe::App::save(next.harness.state_mut(), &mut again);
    assert_eq!((again.0["span_s"].as_str(), again.0["push_n"].as_str()), ("10", "200"));
    assert_eq!(App::last_connected(&memory), ["1.2.3.4:5".parse().unwrap()]);
}

/// Regression test: the strip under a log whose length rounds took the window, and STOP, down with it.
#[test]
fn any_log_under_the_mouse_leaves_the_window_alive() {
    let mut seed = 1_u64;
    let mut random = |most: u64| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) % most
    };
    for _ in 0..6 {
        let (first_ns, step_ns) = (random(1 << 60), 1 + random(1 << 30));
        let samples = (0..8).map(|tick| {
            let mut sample = sample(tick, Mode::Impedance, None);
            sample.time_ns = first_ns + tick * step_ns;
            sample.taxels[5].force_n = if tick == 3 { 1e300 } else { 0.0 };
            sample
        });
        let mut harness = replayed(samples.collect(), [1160.0, 640.0]);
        harness.run_steps(2);
        let strip = harness.get_by_label("Time of the log").rect();
        for part in [0.0, 0.6] {
            harness.hover_at(strip.left_center() + egui::vec2(part * strip.width(), 0.0));
            for delta in [400.0, -4000.0] {
                harness.event(egui::Event::MouseWheel {
                    unit: egui::MouseWheelUnit::Point,
                    delta: egui::vec2(0.0, delta),
                    phase: egui::TouchPhase::Move,
                    source: egui::MouseWheelSource::Unknown,
                    modifiers: egui::Modifiers::NONE,
                });
                harness.run_steps(2);
            }
        }
        assert!(harness.query_by_label_contains("cannot be drawn").is_none(), "{first_ns} {step_ns}");
    }
}

#[test]
fn escape_closes_the_window_that_chooses_a_log() {
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.click("Open log");
    assert!(bench.shows("An MCAP file of"));
    bench.harness.key_press(egui::Key::Escape);
    bench.frames(Mode::Ready, None);
    assert!(!bench.shows("An MCAP file of"));
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
fn logs_are_found_in_folders_and_the_last_ones_are_remembered() {
    let folder = std::env::temp_dir().join(format!("moca-chooser-{}", std::process::id()));
    let inner = folder.join("yesterday");
    std::fs::create_dir_all(&inner).unwrap();
    std::fs::write(inner.join("bump.mcap"), "not a log").unwrap();
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.harness.state_mut().set_folder(folder.clone());
    bench.click("Open log");
    assert!(bench.shows("No .mcap file in this folder"));
    bench.click("yesterday/");
    assert!(bench.shows("1 kB") && bench.shows("just now"));
    bench.click("Folder above");
    bench.click("yesterday/");
    bench.click("bump.mcap");
    assert!(bench.shows("log of"), "it is in front, and says that it is none");
    let mut memory = Memory::default();
    eframe::App::save(bench.harness.state_mut(), &mut memory);
    let mut next = Bench::in_mode(Mode::Ready);
    let ctx = next.harness.ctx.clone();
    next.harness.state_mut().restore(&ctx, &memory);
    next.click("Open log");
    next.click("bump.mcap (again)");
    assert!(next.shows("log of"));
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_strip_under_a_log_goes_where_it_is_clicked() {
    let samples = (0..20_000).map(|tick| sample(tick, Mode::Ready, None)).collect();
    let mut harness = replayed(samples, [1160.0, 640.0]);
    harness.run_steps(3);
    harness.get_by_label("Pause").click();
    harness.run_steps(2);
    // The middle of the widget is the middle of the log.
    harness.get_by_label("Time of the log").click();
    harness.run_steps(3);
    let at = harness.state().model().latest.as_ref().map_or(0, |s| s.tick);
    assert!((9_900..10_100).contains(&at), "{at}");
}

/// Eight hours in a file, a touch in the sixth: the strip shows the whole, and plots its ten milliseconds.
#[test]
fn eight_hour_log_zooms_down_to_ten_ms() {
    const TOUCH_S: u64 = 5 * 3600 + 1234;
    let path = std::env::temp_dir().join(format!("moca-eight-hours-{}.mcap", std::process::id()));
    let meta = Meta { description: RobotDescription::paper("logged robot", true), start_unix_ns: 0 };
    let mut log =
        LogWriter::new(std::io::BufWriter::new(std::fs::File::create(&path).unwrap()), &meta).unwrap();
    for second in (0..8 * 3600).step_by(10) {
        log.sample(&sample(1000 * second, Mode::Impedance, None)).unwrap();
        // One after the other where somebody touches.
        if (second..second + 10).contains(&TOUCH_S) {
            for tick in 1000 * TOUCH_S - 500..1000 * TOUCH_S + 500 {
                let mut sample = sample(tick, Mode::Impedance, None);
                sample.taxels[5].force_n = if tick >= 1000 * TOUCH_S { 17.5 } else { 0.0 };
                log.sample(&sample).unwrap();
            }
        }
    }
    log.finish().unwrap();
    let playback = Playback::open(path.clone(), || {}).unwrap();
    let app = App::new(&egui::Context::default(), playback, String::new(), None);
    let mut harness = Harness::builder().with_size([1280.0, 800.0]).build_ui_state(
        |ui, app: &mut App| {
            app.update(&ui.ctx().clone());
            app.show(ui);
        },
        app,
    );
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(20);
    let until = |harness: &mut Harness<'_, App>, done: &dyn Fn(&Harness<'_, App>) -> bool| {
        while !done(harness) {
            let shown = harness.state().model().latest.as_ref().map(|sample| sample.tick);
            assert!(std::time::Instant::now() < deadline, "the log was not read: {shown:?}");
            std::thread::sleep(std::time::Duration::from_millis(5));
            harness.step();
        }
    };
    let tick = |harness: &Harness<'_, App>| harness.state().model().latest.as_ref().map(|s| s.tick);
    until(&mut harness, &|harness| tick(harness).is_some());
    harness.get_by_label("Pause").click();
    harness.run_steps(2);
    harness.get_by_label("Next touch").click();
    // A little after its beginning, so that it is seen.
    until(&mut harness, &|harness| tick(harness) == Some(1000 * TOUCH_S + 200));
    let mut memory = Memory::default();
    for _ in 0..60 {
        harness.get_by_label("Zoom in").click();
        harness.run_steps(2);
    }
    eframe::App::save(harness.state_mut(), &mut memory);
    assert_eq!(memory.0["span_s"], "0.01");
    let plot = harness.get_by_label("Plot Taxel forces in N").rect();
    let shows =
        |harness: &Harness<'_, App>, text: &str| harness.query_all_by_label_contains(text).next().is_some();
    harness.hover_at(plot.center());
    harness.run_steps(60);
    assert!(shows(&harness, "17.5 N T6") && shows(&harness, "0.0 N the others"));
    std::fs::remove_file(&path).unwrap();
}
