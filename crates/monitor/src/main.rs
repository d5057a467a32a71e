//! moca-monitor: the dashboard of a MOCA-S robot.

use anyhow::{Context, anyhow};
use clap::{Parser, ValueEnum};
use eframe::egui;
use moca_monitor::{
    logic::{
        fleet::Row,
        signals::axis::SPAN_S,
        source::{Source, playback::Playback},
    },
    ui::{App, FleetWindow, Page, Screenshot},
};
use moca_telemetry::net::{
    Address, Connection,
    fleet::{Entry, Fleet, parse},
};
use std::{
    path::{Path, PathBuf},
    time::Duration,
};

const FEATURES: &[&str] = if cfg!(feature = "accessible") { &["accessible"] } else { &[] };

/// Shows a MOCA-S robot: its cover, its motion, its health; and passes on what you ask.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Address of a daemon: unix:PATH, HOST:PORT on this machine, or tls://HOST:PORT with a certificate; may be given more than once.
    /// Without it the last ones, or else this machine's: the service's socket, or 127.0.0.1:7611.
    #[arg(long, value_name = "ADDRESS")]
    address: Vec<Address>,
    /// Show a list of robots, and open any: a file robots.toml with name and address of each.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["address", "log", "page", "last"])]
    fleet: Option<PathBuf>,
    /// Show a recorded run instead: an MCAP file of `mocad run --record`. May be given more than once.
    #[arg(long, value_name = "FILE", conflicts_with = "address")]
    log: Vec<PathBuf>,
    /// Page to begin with; without it the last one.
    #[arg(long, value_parser = page)]
    page: Option<Page>,
    /// Length of the plots at first; without it as last time.
    #[arg(long, value_name = "SECONDS", value_parser = span)]
    last: Option<f64>,
    /// Folder for logs and recordings.
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    folder: PathBuf,
    /// Save a PNG of the window and quit.
    #[arg(long, value_name = "FILE")]
    screenshot: Option<PathBuf>,
    /// When to take the screenshot, s after the start.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, requires = "screenshot")]
    after: f64,
    /// Print what the frames until the screenshot cost the processor.
    #[arg(long, requires = "screenshot")]
    frame_times: bool,
    /// Colours; without it the last choice, or the desktop's.
    #[arg(long)]
    theme: Option<Theme>,
    /// Size of everything, 0.7 to 2.5; 1 is the desktop's. Without it as last time.
    #[arg(long, value_name = "FACTOR", value_parser = zoom)]
    zoom: Option<f32>,
    /// Size of the window, points.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<egui::Vec2>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Theme {
    Light,
    Dark,
}

fn page(text: &str) -> anyhow::Result<Page> {
    let names = || Page::ALL.map(Page::name).join(", ");
    Page::named(text).with_context(|| format!("{text:?} is no page: choose one of {}", names()))
}

fn span(text: &str) -> anyhow::Result<f64> {
    match text.parse::<f64>() {
        Ok(span_s) if (SPAN_S.start..=SPAN_S.end).contains(&span_s) => Ok(span_s),
        _ => Err(anyhow!("{text} s is not a span between {} and {} s", SPAN_S.start, SPAN_S.end)),
    }
}

fn zoom(text: &str) -> anyhow::Result<f32> {
    let factor = text.parse().ok().filter(|factor| (0.7..=2.5).contains(factor));
    factor.with_context(|| format!("{text} is not a size between 0.7 and 2.5"))
}

fn size(text: &str) -> anyhow::Result<egui::Vec2> {
    let (width, height) = text.split_once('x').context("a size is WIDTHxHEIGHT, such as 1280x800")?;
    let side = |text: &str| match text.parse::<f32>() {
        Ok(side) if (100.0..=10_000.0).contains(&side) => Ok(side),
        _ => Err(anyhow!("{text} points is not a side between 100 and 10000 points")),
    };
    Ok(egui::vec2(side(width)?, side(height)?))
}

/// Bytes that the allocator may keep between two pictures.
const KEPT_BYTES: usize = 16 << 20;

fn main() -> anyhow::Result<()> {
    let arguments: Arguments = moca_manual::parse("moca-monitor", FEATURES);
    // glibc gives freed memory back to the kernel beyond twice the largest block freed so far (mallopt(3)); a picture's
    // triangles would be paged in anew each time, a third of its cost. These bytes are never touched.
    drop(std::hint::black_box(Vec::<u8>::with_capacity(KEPT_BYTES)));
    let screenshot = match arguments.screenshot {
        Some(path) => {
            let after = Duration::try_from_secs_f64(arguments.after);
            let after = after.with_context(|| format!("--after {} s", arguments.after))?;
            let screenshot = Screenshot::new(path, after);
            Some(if arguments.frame_times { screenshot.with_frame_times() } else { screenshot })
        }
        None => None,
    };
    let list = match &arguments.fleet {
        Some(path) => {
            let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
            Some(parse(&text).with_context(|| path.display().to_string())?)
        }
        None => None,
    };
    let failure = screenshot.as_ref().map(Screenshot::failure);
    let size = arguments.size.unwrap_or(egui::vec2(1280.0, 800.0));
    let viewport = egui::ViewportBuilder::default()
        .with_title("MOCA-S monitor")
        .with_app_id("moca-monitor")
        .with_inner_size(size)
        .with_min_inner_size(size.min(egui::vec2(680.0, 480.0)));
    // A given size, or a picture, must not depend on how the last window was left.
    let persist_window = arguments.size.is_none() && screenshot.is_none();
    // Dithering smooths gradients, of which there are none here.
    let options = eframe::NativeOptions { viewport, persist_window, dithering: false, ..Default::default() };
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
            let storage = cc.storage.filter(|_| persist_window);
            if !persist_window {
                // eframe has given it the size of the last window.
                cc.egui_ctx.send_viewport_cmd(egui::ViewportCommand::InnerSize(size));
            }
            if let Some(list) = list {
                cc.egui_ctx.set_zoom_factor(arguments.zoom.unwrap_or(1.0));
                return Ok(Box::new(fleet(list, &arguments.folder, screenshot)?));
            }
            let addresses = match (arguments.address, storage) {
                (given, _) if !given.is_empty() => given,
                (_, Some(storage)) => App::last_connected(storage),
                (_, None) => Vec::new(),
            };
            let mut sources = sources(addresses, arguments.log, &cc.egui_ctx)?.into_iter();
            let (first, name) = sources.next().context("nothing to show")?;
            let mut app = App::new(&cc.egui_ctx, first, name, screenshot);
            sources.for_each(|(source, name)| app.add(source, name));
            app.set_folder(arguments.folder);
            if let Some(storage) = storage {
                app.restore(&cc.egui_ctx, storage);
            }
            if let Some(zoom) = arguments.zoom {
                app.zoom(&cc.egui_ctx, zoom);
            }
            if let Some(page) = arguments.page {
                app.show_page(page);
            }
            if let Some(span_s) = arguments.last {
                app.show_last_s(span_s);
            }
            Ok(Box::new(app))
        }),
    );
    created.map_err(|error| anyhow!("cannot open a window: {error}"))?;
    match failure.and_then(|f| f.lock().ok()?.take()) {
        Some(error) => Err(anyhow!(error)),
        None => Ok(()),
    }
}

/// A window for the robots of a list.
fn fleet(list: Vec<Entry>, folder: &Path, screenshot: Option<Screenshot>) -> anyhow::Result<FleetWindow> {
    let mut fleet = Fleet::watch(list.clone())?;
    let folder = folder.to_owned();
    let open = move |ctx: &egui::Context, place: usize| {
        let Some(Entry { address, .. }) = list.get(place) else { return Err("no such robot".into()) };
        let connection = Connection::spawn(address.clone(), wake(ctx)).map_err(|error| error.to_string())?;
        let mut app = App::new(ctx, connection, address.to_string(), None);
        app.set_folder(folder.clone());
        Ok(app)
    };
    let look = move || fleet.poll().iter().map(Row::from).collect();
    Ok(FleetWindow::new(Box::new(look), Box::new(open), screenshot))
}

/// A call that has a picture drawn soon.
fn wake(ctx: &egui::Context) -> impl Fn() + Send + 'static {
    let ctx = ctx.clone();
    move || ctx.request_repaint_after(App::FRAME)
}

/// Logs, or else daemons, each with what it is called before it says its name.
fn sources(
    mut addresses: Vec<Address>,
    logs: Vec<PathBuf>,
    ctx: &egui::Context,
) -> anyhow::Result<Vec<(Source, String)>> {
    if logs.is_empty() {
        if addresses.is_empty() {
            addresses.push(Address::of_this_machine());
        }
        let connect = |address: Address| -> anyhow::Result<(Source, String)> {
            let name = address.to_string();
            Ok((Connection::spawn(address, wake(ctx))?.into(), name))
        };
        return addresses.into_iter().map(connect).collect();
    }
    let open = |path: PathBuf| -> anyhow::Result<(Source, String)> {
        let name = path.display().to_string();
        Ok((Playback::open(path, wake(ctx))?.into(), name))
    };
    logs.into_iter().map(open).collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn chapter_of_the_docs_is_what_the_command_line_says() {
        assert_eq!(moca_manual::check_chapter::<super::Arguments>("moca-monitor"), Ok(()));
    }
}
