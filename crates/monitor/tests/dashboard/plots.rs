//! Plots and histograms.

use crate::bench::{Bench, sample};
use egui::Vec2;
use egui_kittest::kittest::Queryable;
use moca_msgs::{Mode, Sample};

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
fn plots_zoom_pan_and_show_cursor_values() {
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

fn feed(bench: &mut Bench, ticks: u64) {
    let first = bench.tick;
    let samples = (first..first + ticks).map(|tick| {
        let mut sample = sample(tick, Mode::Ready, None);
        sample.taxels[5].force_n = 17.5;
        sample
    });
    bench.daemon.borrow_mut().samples.extend(samples);
    bench.tick += ticks;
    bench.frames(Mode::Ready, None);
}

#[test]
fn paused_plots_keep_what_they_show_however_long_the_pause_is() {
    let folder = std::env::temp_dir().join(format!("moca-pause-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.harness.state_mut().set_folder(folder.clone());
    feed(&mut bench, 2000);
    bench.click("Pause plots");
    // Two minutes: what is kept behind it is the last one.
    (0..12).for_each(|_| feed(&mut bench, 10_000));
    bench.click("Export CSV");
    let table = std::fs::read_dir(&folder).unwrap().next().expect("a table was saved").unwrap();
    let table = std::fs::read_to_string(table.path()).unwrap();
    assert!(table.lines().count() > 2000 && table.contains("17.5"), "{} lines", table.lines().count());
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn an_empty_export_is_an_error_and_leaves_no_file() {
    let folder = std::env::temp_dir().join(format!("moca-empty-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut bench = Bench::new();
    bench.harness.state_mut().set_folder(folder.clone());
    bench.harness.get_by_label("Export CSV").click();
    bench.harness.run_steps(3);
    assert!(bench.shows("Nothing is exported"));
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_cursor_tells_what_is_not_zero() {
    let mut bench = Bench::in_mode(Mode::Ready);
    feed(&mut bench, 5000);
    let at = bench.harness.get_by_label("Plot Taxel forces in N").rect().center();
    bench.harness.hover_at(at + Vec2::new(60.0, 0.0));
    (0..4).for_each(|_| feed(&mut bench, 33));
    assert!(bench.shows("17.5 N T6"));
    assert!(bench.shows("0.0 N the others"));
    assert!(!bench.shows("N T7"), "a taxel that nobody touches");
}
