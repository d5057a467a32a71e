//! moca-monitor: the dashboard of a MOCA-S robot.

use anyhow::{Context, anyhow};
use clap::{Parser, ValueEnum};
use eframe::egui;
use moca_monitor::{
    logic::Playback,
    ui::{App, Screenshot},
};
use moca_telemetry::net::{Connection, DEFAULT_ADDRESS};
use std::{net::SocketAddr, path::PathBuf, time::Duration};

/// Shows a MOCA-S robot: its cover, its motion, its health; and passes on what you ask.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Where the daemon listens. Another machine's daemon comes in through an SSH tunnel.
    #[arg(long, default_value = DEFAULT_ADDRESS)]
    connect: SocketAddr,
    /// Show a recorded run instead: an MCAP file of `mocad run --record`.
    #[arg(long, value_name = "FILE", conflicts_with = "connect")]
    log: Option<PathBuf>,
    /// Save a PNG of the window and quit.
    #[arg(long, value_name = "FILE")]
    screenshot: Option<PathBuf>,
    /// When to take the screenshot, s after the start.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, requires = "screenshot")]
    after: f64,
    /// Colours; without it the last choice, or the desktop's.
    #[arg(long)]
    theme: Option<Theme>,
    /// Size of the window, points.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<egui::Vec2>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Theme {
    Light,
    Dark,
}

fn size(text: &str) -> anyhow::Result<egui::Vec2> {
    let (width, height) = text.split_once('x').context("a size is WIDTHxHEIGHT, such as 1280x800")?;
    let side = |text: &str| match text.parse::<f32>() {
        Ok(side) if (100.0..=10_000.0).contains(&side) => Ok(side),
        _ => Err(anyhow!("{text} points is not a side between 100 and 10000 points")),
    };
    Ok(egui::vec2(side(width)?, side(height)?))
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let screenshot = match arguments.screenshot {
        Some(path) => {
            let after = Duration::try_from_secs_f64(arguments.after);
            Some(Screenshot::new(path, after.with_context(|| format!("--after {} s", arguments.after))?))
        }
        None => None,
    };
    let failure = screenshot.as_ref().map(Screenshot::failure);
    let mut viewport = egui::ViewportBuilder::default()
        .with_title("MOCA-S monitor")
        .with_app_id("moca-monitor")
        .with_inner_size([1280.0, 800.0])
        .with_min_inner_size([1000.0, 640.0]);
    if let Some(size) = arguments.size {
        viewport = viewport.with_inner_size(size).with_min_inner_size(size.min(egui::vec2(1000.0, 640.0)));
    }
    // A given size, or a picture, must not depend on how the last window was left.
    let persist_window = arguments.size.is_none() && screenshot.is_none();
    let options = eframe::NativeOptions { viewport, persist_window, ..Default::default() };
    let created = eframe::run_native(
        "moca-monitor",
        options,
        Box::new(move |cc| {
            if let Some(theme) = arguments.theme {
                cc.egui_ctx.set_theme(match theme {
                    Theme::Light => egui::Theme::Light,
                    Theme::Dark => egui::Theme::Dark,
                });
            }
            let ctx = cc.egui_ctx.clone();
            let wake = move || ctx.request_repaint_after(App::FRAME);
            let address = arguments.connect.to_string();
            Ok(Box::new(match arguments.log {
                Some(path) => App::new(&cc.egui_ctx, Playback::open(path, wake)?, address, screenshot),
                None => {
                    let connection = Connection::spawn(arguments.connect, wake)?;
                    App::new(&cc.egui_ctx, connection, address, screenshot)
                }
            }))
        }),
    );
    created.map_err(|error| anyhow!("cannot open a window: {error}"))?;
    match failure.and_then(|f| f.lock().ok()?.take()) {
        Some(error) => Err(anyhow!(error)),
        None => Ok(()),
    }
}
