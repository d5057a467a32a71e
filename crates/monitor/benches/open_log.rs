//! Cost of opening a log in the dashboard, of jumping in it and of keeping it open:
//! `cargo bench -p moca-monitor --bench open_log -- FILE`. Cargo starts it in this crate's folder: FILE is an absolute path.
//! `long_log` of `moca-telemetry` writes a long one.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use egui::{Context, RawInput, Rect, pos2, vec2};
use moca_monitor::{
    logic::source::{Source, playback::Playback},
    ui::App,
};
use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

/// Jumps to places all over the log.
const JUMPS: u32 = 50;
/// A log of which nothing has been shown after this long is given up.
const PATIENCE: Duration = Duration::from_secs(600);

fn resident_mb() -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with("VmRSS"));
    let kib = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<f64>().ok());
    kib.map_or(f64::NAN, |kib| kib * 1.024e-3)
}

/// Polls until samples come; gives how long that took.
fn shown(source: &mut Source, began: Instant) -> Result<Duration, String> {
    while began.elapsed() < PATIENCE {
        if !source.poll(0.0).samples.is_empty() {
            return Ok(began.elapsed());
        }
        std::thread::sleep(Duration::from_micros(200));
    }
    Err("nothing was shown: it is no log, or it is damaged".into())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let Some(path) = std::env::args().skip(1).find(|argument| argument != "--bench") else {
        println!("usage: cargo bench -p moca-monitor --bench open_log -- FILE");
        return Ok(());
    };
    let path = PathBuf::from(path);
    let began = Instant::now();
    let mut source: Source = Playback::open(path.clone(), || {})?.into();
    println!("first sample shown after {:.3} s", shown(&mut source, began)?.as_secs_f64());
    let mut took = Vec::new();
    for jump in 0..JUMPS {
        let log = source.log().ok_or("no log")?;
        log.play(false);
        let (first, last) = log.range_s();
        // Here and there: neighbours are far apart.
        let part = f64::from(jump * 19 % JUMPS) / f64::from(JUMPS) + 0.01;
        log.seek(first + part * (last - first));
        took.push(shown(&mut source, Instant::now())?.as_secs_f64());
    }
    took.sort_by(f64::total_cmp);
    let [p50, worst] = [took[took.len() / 2], took[took.len() - 1]];
    println!("{JUMPS} jumps, each with the minute before it: p50 {p50:.3} s, worst {worst:.3} s");
    let (log, marks) =
        (source.log().ok_or("no log")?.range_s(), source.log().map(|l| l.overview().marks.len()));
    println!("{:.2} h, {} marks", (log.1 - log.0) / 3600.0, marks.unwrap_or(0));

    let ctx = Context::default();
    let mut app = App::new(&ctx, source, path.display().to_string(), None);
    for picture in 0..60_u32 {
        let input = RawInput {
            screen_rect: Some(Rect::from_min_size(pos2(0.0, 0.0), vec2(1280.0, 800.0))),
            time: Some(f64::from(picture) * 0.033),
            ..RawInput::default()
        };
        let output = ctx.run_ui(input, |ui| {
            app.update(&ui.ctx().clone());
            app.show(ui);
        });
        output.drop_without_applying_deltas();
    }
    println!("memory with the dashboard around it, without a window: {:.0} MB", resident_mb());
    Ok(())
}
