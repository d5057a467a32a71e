//! Memory over an hour of telemetry at 1 kHz, fed as fast as it is taken in:
//! `cargo bench -p moca-monitor --bench memory`.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use egui::{Context, RawInput, Rect, pos2, vec2};
use moca_monitor::{logic::source::live::Live, ui::App};
use moca_msgs::{Mode, Request, Sample, TaxelReading, TaxelStatus, board::Diagnosis};
use moca_telemetry::{
    RobotDescription,
    calibration::CalibrationRequest,
    net::{Link, Update},
};
use std::sync::Arc;

const HOUR_TICKS: u64 = 3_600_000;
/// Samples of one picture at 30 pictures a second.
const BATCH: u64 = 33;
/// A stop and its end every so many ticks: an hour of events.
const EVENT_TICKS: u64 = 5_000;

/// A daemon that speaks as fast as it is listened to.
struct Feed {
    tick: u64,
    robot: Arc<RobotDescription>,
}

impl Live for Feed {
    fn poll(&mut self) -> Update {
        let samples = (self.tick..self.tick + BATCH).map(sample).collect();
        self.tick += BATCH;
        Update::new(Link::Up { session: 1, description: Arc::clone(&self.robot) }, samples)
    }

    fn alive(&mut self) {}

    fn request(&mut self, _request: Request) {}

    fn calibrate(&mut self, _request: CalibrationRequest) {}
}

#[expect(clippy::cast_precision_loss, reason = "an hour of ticks is far below 2^53")]
fn sample(tick: u64) -> Sample {
    let t = tick as f64 * 1e-3;
    let mut sample = Sample {
        tick,
        time_ns: tick * 1_000_000,
        mode: if (tick / EVENT_TICKS).is_multiple_of(2) { Mode::Impedance } else { Mode::Ready },
        board: Diagnosis::Frames,
        base_pose_world: [t.sin(), t.cos(), 0.1],
        frame_age_s: 0.03,
        ..Sample::default()
    };
    for i in 0..11 {
        let force_n = 20.0 + 20.0 * (t + f64::from(i)).sin();
        // A sample has room for 24.
        let _ = sample.taxels.push(TaxelReading { force_n, status: TaxelStatus::Ok });
    }
    sample
}

fn resident_mib() -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with("VmRSS"));
    let kib = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<f64>().ok());
    kib.map_or(f64::NAN, |kib| kib / 1024.0)
}

fn main() {
    let ctx = Context::default();
    let feed = Feed { tick: 0, robot: Arc::new(RobotDescription::paper("feed", true)) };
    let mut app = App::new(&ctx, feed, String::new(), None);
    let (mut picture, mut next) = (0u64, 0);
    println!("{:>14} {:>14}", "telemetry min", "resident MiB");
    while picture * BATCH <= HOUR_TICKS {
        let minutes = picture * BATCH / 60_000;
        if minutes >= next {
            println!("{minutes:>14} {:>14.1}", resident_mib());
            next += if minutes < 2 { 1 } else { 10 };
        }
        // Every thirtieth picture is laid out: an hour in a minute.
        let input = RawInput {
            screen_rect: Some(Rect::from_min_size(pos2(0.0, 0.0), vec2(1280.0, 800.0))),
            #[expect(clippy::cast_precision_loss, reason = "an hour of pictures is far below 2^53")]
            time: Some(picture as f64 * 0.033),
            ..RawInput::default()
        };
        let laid_out = picture.is_multiple_of(30);
        let output = ctx.run_ui(input, |ui| {
            app.update(&ui.ctx().clone());
            if laid_out {
                app.show(ui);
            }
        });
        output.drop_without_applying_deltas();
        picture += 1;
    }
    println!("{:>14} {:>14.1}", "60", resident_mib());
}
