//! Processor time of one picture: `cargo bench -p moca-monitor --bench frame_time`.
//!
//! 1. The whole dashboard with a full minute at 1 kHz in every plot: layout, curves and triangles, without the
//!    graphics driver.
//! 2. The window with the page 3-D, every plate pressed, and with a page that holds a line of text, in turns: the robot
//!    in three dimensions costs the difference.
//! 3. The plot of 11 taxels alone, decimated by the pyramid and raw, in turns in the same run.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use egui::{Context, RawInput, Rect, Ui, pos2, vec2};
use egui_plot::{Line, Plot, PlotPoints};
use moca_monitor::{
    logic::{
        signals::{history::History, panel::Signal},
        source::playback::Playback,
    },
    ui::{App, Page},
};
use moca_msgs::{Mode, Sample, TaxelReading, TaxelStatus, board::Diagnosis};
use moca_telemetry::RobotDescription;
use std::time::Instant;

const MINUTE: u32 = 60_000;
const PICTURES: u32 = 200;

fn main() {
    let samples: Vec<Sample> = (0..MINUTE + 20_000).map(sample).collect();
    let taxels: Vec<Signal> = (0..11).map(Signal::Taxel).collect();
    let mut history = History::new(taxels.clone());
    let pushing = Instant::now();
    samples.iter().take(MINUTE as usize).for_each(|s| history.push(s));
    let push_ns = pushing.elapsed().as_nanos() / u128::from(MINUTE);

    println!("{:<46} {:>8} {:>8} {:>8}", "ms of processor time for a picture", "p50", "p99", "max");
    whole_dashboard(samples);
    for round in 1..=3 {
        print_row(
            &format!("11 taxels, decimated (round {round})"),
            plot_alone(&history, &taxels, 800, PICTURES),
        );
        print_row(
            &format!("11 taxels, raw (round {round})"),
            plot_alone(&history, &taxels, usize::MAX / 4, 20),
        );
    }
    println!("\ntaking in one sample of 11 signals: {push_ns} ns");
}

fn sample(tick: u32) -> Sample {
    let t = f64::from(tick) * 1e-3;
    let mut sample = Sample {
        tick: u64::from(tick),
        time_ns: u64::from(tick) * 1_000_000,
        mode: Mode::Impedance,
        board: Diagnosis::Frames,
        base_pose_world: [t.sin(), t.cos(), 0.1 * t],
        base_velocity_world: [t.cos(), -t.sin(), 0.1],
        flange_position_world: [0.5 + 1e-3 * t.sin(), 1e-3 * t.cos(), 1.1],
        flange_desired_position_world: [0.5, 0.0, 1.1],
        flange_quaternion_world: [1.0, 0.0, 0.0, 0.0],
        flange_desired_quaternion_world: [1.0, 0.0, 0.0, 0.0],
        flange_wrench_world: [t.sin(), t.cos(), (3.0 * t).sin(), 0.0, 0.0, 0.0],
        cover_wrench_base: [10.0 * t.sin(), 5.0 * t.cos(), t.sin()],
        frame_age_s: 0.03,
        lateness_s: 40e-6,
        ..Sample::default()
    };
    sample.q_rad.extend(moca_msgs::robot::PANDA.home_rad);
    for i in 0..11 {
        let force_n =
            20.0 + 20.0 * (t * (1.0 + 0.3 * f64::from(i)) + (f64::from(tick) * 12.9898).sin()).sin();
        // A sample has room for 24.
        let _ = sample.taxels.push(TaxelReading { force_n, status: TaxelStatus::Ok });
    }
    sample
}

fn whole_dashboard(samples: Vec<Sample>) {
    let window = |page: Page, name: &str| print_row(name, pictures_of(page, samples.clone()));
    window(Page::Plots, "whole dashboard, 60 s at 1 kHz in every plot");
    for round in 1..=3 {
        window(Page::Robot3d, &format!("whole dashboard, page 3-D (round {round})"));
        window(Page::Calibrate, &format!("whole dashboard, a page of text (round {round})"));
    }
}

fn pictures_of(page: Page, samples: Vec<Sample>) -> Vec<f64> {
    let ctx = Context::default();
    let mut log = Playback::of(RobotDescription::paper("bench", true), samples);
    log.seek(f64::from(MINUTE) * 1e-3);
    let mut app = App::new(&ctx, log, String::new(), None);
    app.show_last_s(60.0);
    app.show_page(page);
    pictures(&ctx, PICTURES, |ui| {
        app.update(&ui.ctx().clone());
        app.show(ui);
    })
}

fn plot_alone(history: &History, taxels: &[Signal], pixels: usize, count: u32) -> Vec<f64> {
    let ctx = Context::default();
    pictures(&ctx, count, |ui| {
        Plot::new("taxels").show(ui, |plot| {
            plot.set_plot_bounds_x(-60.0..=0.0);
            plot.set_plot_bounds_y(0.0..=50.0);
            for signal in taxels {
                for piece in history.curve(*signal, 0.0..60.0, pixels).pieces {
                    plot.line(Line::new("", PlotPoints::from(piece)).allow_hover(false));
                }
            }
        });
    })
}

/// Milliseconds of `count` pictures of 1280 × 800 points, 33 ms apart, after ten to warm up.
fn pictures(ctx: &Context, count: u32, mut draw: impl FnMut(&mut Ui)) -> Vec<f64> {
    let mut times = Vec::new();
    for i in 0..count + 10 {
        let input = RawInput {
            screen_rect: Some(Rect::from_min_size(pos2(0.0, 0.0), vec2(1280.0, 800.0))),
            time: Some(f64::from(i) * 0.033),
            ..RawInput::default()
        };
        let start = Instant::now();
        let mut output = ctx.run_ui(input, &mut draw);
        let triangles = ctx.tessellate(std::mem::take(&mut output.shapes), output.pixels_per_point);
        std::hint::black_box(triangles);
        if i >= 10 {
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        output.drop_without_applying_deltas();
    }
    times
}

fn print_row(name: &str, mut ms: Vec<f64>) {
    ms.sort_by(f64::total_cmp);
    let at = |part: usize| ms.get((ms.len() * part / 1000).min(ms.len() - 1)).copied().unwrap_or(0.0);
    println!("{name:<46} {:>8.2} {:>8.2} {:>8.2}", at(500), at(990), at(1000));
}
