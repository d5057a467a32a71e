//! The window: who gets which space, and what happens each frame.

use super::{
    Screenshot, View,
    files::Files,
    gauges,
    page::{Asked, Page},
    playback, robot, top,
};
use crate::logic::{Action, Model, Playback, Recording, Source, model::Freshness};
use egui::{CentralPanel, Color32, Context, Event, Frame, Key, Panel, ScrollArea, Ui, Visuals};
use std::{net::SocketAddr, path::Path, path::PathBuf, time::Duration};

/// Narrowest and widest column with robot and gauges, points, and its share of the window.
const LEFT_WIDTH: (f32, f32) = (400.0, 560.0);
const LEFT_SHARE: f32 = 0.3;
/// How often ages and silence are looked at while nothing new comes.
const LOOK: Duration = Duration::from_millis(250);

/// The dashboard: one robot or log in front, others behind it.
pub struct App {
    robots: Vec<Robot>,
    shown: usize,
    page: Page,
    files: Files,
    screenshot: Option<Screenshot>,
}

/// A robot or a log, and how it is looked at.
struct Robot {
    source: Box<dyn Source>,
    address: String,
    model: Model,
    view: View,
    recording: Option<Recording>,
}

impl Robot {
    fn new(mut source: Box<dyn Source>, address: String) -> Self {
        let mut model = Model::default();
        model.recorded = source.playback().is_some();
        Self { source, address, model, view: View::default(), recording: None }
    }

    /// What it is called on its button.
    fn name(&self) -> String {
        let name = &self.model.robot.name;
        let what = if name.is_empty() { &self.address } else { name };
        if self.model.recorded { format!("log of {what}") } else { what.clone() }
    }

    fn update(&mut self, now_s: f64) {
        let update = self.source.poll(now_s);
        if let Some(recording) = &mut self.recording {
            update.samples.iter().for_each(|sample| recording.add(sample));
        }
        if self.recording.as_ref().is_some_and(|r| !r.is_writing()) {
            self.stop_recording();
        }
        self.model.take(update, now_s);
    }

    fn record(&mut self, folder: &Path) {
        if self.recording.is_some() {
            return self.stop_recording();
        }
        let now_ns = self.model.latest.as_ref().map_or(0, |s| s.time_ns);
        match Recording::start(folder, &self.model.robot, now_ns) {
            Ok(recording) => self.recording = Some(recording),
            Err(error) => self.view.note = Some(error.to_string()),
        }
    }

    fn stop_recording(&mut self) {
        if let Some(recording) = self.recording.take() {
            self.view.note = Some(recording.finish().unwrap_or_else(|error| error));
        }
    }
}

impl App {
    /// Shortest time between two pictures.
    pub const FRAME: Duration = Duration::from_millis(33);

    /// A dashboard for what `source` delivers; `address` is shown when it delivers nothing.
    pub fn new(
        ctx: &Context,
        source: impl Into<Box<dyn Source>>,
        address: String,
        screenshot: Option<Screenshot>,
    ) -> Self {
        ctx.all_styles_mut(|style| {
            style.spacing.item_spacing = egui::vec2(8.0, 5.0);
            style.spacing.button_padding = egui::vec2(9.0, 5.0);
        });
        let robots = vec![Robot::new(source.into(), address)];
        Self { robots, shown: 0, page: Page::default(), files: Files::default(), screenshot }
    }

    /// One more robot or log, behind the others.
    pub fn add(&mut self, source: impl Into<Box<dyn Source>>, address: String) {
        self.robots.push(Robot::new(source.into(), address));
    }

    /// Where recordings go and logs are looked for; the current folder without it.
    pub fn set_folder(&mut self, folder: PathBuf) {
        self.files.folder = folder;
    }

    /// Sets the length of the plots' axis of time, s.
    pub fn show_last_s(&mut self, span_s: f64) {
        self.front().view.axis.show(span_s);
    }

    /// The page in the middle.
    pub fn show_page(&mut self, page: Page) {
        self.page = page;
    }

    /// What it knows of the robot in front.
    pub fn model(&self) -> &Model {
        &self.robots[self.shown].model
    }

    fn front(&mut self) -> &mut Robot {
        &mut self.robots[self.shown]
    }

    /// Takes in what is new, and the space bar before any widget can have it.
    pub fn update(&mut self, ctx: &Context) {
        let now_s = ctx.input(|i| i.time);
        for robot in &mut self.robots {
            robot.update(now_s);
            // A log does not grow old while it stands still.
            let ages = !robot.model.recorded && robot.model.freshness(now_s) == Freshness::Live;
            if ages || robot.model.message(now_s).is_some() {
                ctx.request_repaint_after(LOOK);
            }
            if robot.source.playback().is_some_and(|p| p.playing()) {
                ctx.request_repaint_after(Self::FRAME);
            }
        }
        if take_space_bar(ctx) {
            self.stop_all();
        }
        for path in self.files.dropped(ctx) {
            self.open(ctx, path);
        }
        if let Some(screenshot) = &mut self.screenshot {
            screenshot.tick(ctx, now_s);
        }
    }

    /// Who presses stop in a hurry does not look which robot is in front.
    fn stop_all(&mut self) {
        for robot in self.robots.iter_mut().filter(|r| !r.model.recorded) {
            robot.source.request(Action::Stop.request());
        }
    }

    fn open(&mut self, ctx: &Context, path: PathBuf) {
        let name = path.display().to_string();
        let ctx = ctx.clone();
        match Playback::open(path, move || ctx.request_repaint()) {
            Ok(log) => {
                self.add(log, name);
                self.shown = self.robots.len() - 1;
            }
            Err(error) => self.front().view.note = Some(format!("cannot read {name}: {error}")),
        }
    }

    fn close_front(&mut self) {
        if self.robots.len() > 1 {
            self.robots.remove(self.shown);
            self.shown = self.shown.saturating_sub(1);
        }
    }

    /// Draws everything and passes on what was pressed.
    pub fn show(&mut self, ui: &mut Ui) {
        let now_s = ui.input(|i| i.time);
        let mut asked = Vec::new();
        self.top(ui, now_s, &mut asked);
        let closable = self.robots.len() > 1;
        let Self { robots, shown, page, files, .. } = self;
        let Robot { source, model, view, recording, .. } = &mut robots[*shown];
        let (mut close, bare) = (false, Bare::new(ui));
        if let Some(recorded) = source.playback() {
            close = Panel::bottom("playback")
                .frame(bare.side)
                .show(ui, |ui| playback::show(ui, recorded, view, closable))
                .inner;
        }
        let width = (ui.available_width() * LEFT_SHARE).clamp(LEFT_WIDTH.0, LEFT_WIDTH.1);
        let left = Panel::left("left").frame(bare.side).exact_size(width).resizable(false);
        let pushed = left.show(ui, |ui| {
            let height = ui.available_height();
            ScrollArea::vertical().show(ui, |ui| {
                let pushed = robot::show(ui, model, view, now_s, height);
                gauges::show(ui, model, now_s);
                pushed
            })
        });
        let mut of_page = Asked::default();
        let mut files_asked = files.show(ui.ctx());
        CentralPanel::default().frame(bare.centre).show(ui, |ui| {
            page.tabs(ui, model, recording.as_ref(), view, &mut files_asked);
            page.show(ui, model, view, now_s, &mut of_page);
        });
        let mut requests = of_page.requests;
        requests.extend(model.push(pushed.inner.inner.or(of_page.push)));
        if let Some(request) = of_page.calibrate {
            source.calibrate(request);
        }
        requests.extend(asked.iter().filter(|a| **a != Action::Stop).map(|a| a.request()));
        for request in requests {
            source.request(request);
        }
        if asked.contains(&Action::Stop) {
            self.stop_all();
        }
        if files_asked.choose {
            self.files.choose();
        }
        if files_asked.record {
            let folder = self.files.folder.clone();
            self.front().record(&folder);
        }
        if let Some(path) = files_asked.open {
            self.open(ui.ctx(), path);
        }
        if close {
            self.close_front();
        }
    }

    fn top(&mut self, ui: &mut Ui, now_s: f64, asked: &mut Vec<Action>) {
        let Self { robots, shown, .. } = self;
        Panel::top("top").frame(Bare::new(ui).side).show(ui, |ui| {
            if robots.len() > 1 {
                let names = robots.iter().map(|r| (r.name(), r.model.mode(now_s)));
                top::robots(ui, names, shown);
            }
            let Robot { model, address, .. } = &robots[*shown];
            top::show(ui, model, address, now_s, asked);
        });
    }
}

/// Panels without a background of their own: the window is cleared with it. A software rasteriser pays for each pixel
/// each time it is painted.
struct Bare {
    side: Frame,
    centre: Frame,
}

impl Bare {
    fn new(ui: &Ui) -> Self {
        let [side, centre] = [Frame::side_top_panel(ui.style()), Frame::central_panel(ui.style())];
        Self { side: side.fill(Color32::TRANSPARENT), centre: centre.fill(Color32::TRANSPARENT) }
    }
}

impl eframe::App for App {
    fn clear_color(&self, visuals: &Visuals) -> [f32; 4] {
        visuals.panel_fill.to_normalized_gamma_f32()
    }

    fn logic(&mut self, ctx: &Context, _frame: &mut eframe::Frame) {
        self.update(ctx);
    }

    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        let front = &self.robots[self.shown];
        let View { axis, push_n, .. } = &front.view;
        storage.set_string("page", self.page.name().to_owned());
        storage.set_string("span_s", axis.span_s().to_string());
        storage.set_string("push_n", push_n.to_string());
        let live = self.robots.iter().filter(|robot| !robot.model.recorded);
        let addresses: Vec<&str> = live.map(|robot| robot.address.as_str()).collect();
        // Who looked at a log only has not left the robots.
        if !addresses.is_empty() {
            storage.set_string("connect", addresses.join(" "));
        }
        if !front.model.recorded {
            storage.set_string("front", front.address.clone());
        }
    }
}

impl App {
    /// Where the robots listened that were shown when the last window was closed.
    pub fn last_connected(storage: &dyn eframe::Storage) -> Vec<SocketAddr> {
        let list = storage.get_string("connect").unwrap_or_default();
        list.split(' ').filter_map(|address| address.parse().ok()).collect()
    }

    /// Takes up what was looked at when the last window was closed.
    pub fn restore(&mut self, storage: &dyn eframe::Storage) {
        let text = |key| storage.get_string(key);
        let number = |key| text(key)?.parse::<f64>().ok().filter(|v| v.is_finite());
        self.page = text("page").and_then(|name| Page::named(&name)).unwrap_or_default();
        let front = text("front").and_then(|front| self.robots.iter().position(|r| r.address == front));
        self.shown = front.unwrap_or(self.shown);
        for robot in &mut self.robots {
            if let Some(span_s) = number("span_s") {
                robot.view.axis.show(span_s);
            }
            if let Some(push_n) = number("push_n") {
                robot.view.push_n = push_n.clamp(1.0, moca_msgs::request::PRESS_FORCE_MAX_N);
            }
        }
    }
}

/// Whether the space bar was pressed. Nobody else gets to see it: on a focused button it would also be a click, and a
/// stop must not depend on where the keyboard's focus is.
fn take_space_bar(ctx: &Context) -> bool {
    ctx.input_mut(|input| {
        let mut pressed = false;
        input.events.retain(|event| match event {
            Event::Key { key: Key::Space, pressed: down, repeat, .. } => {
                pressed |= *down && !repeat;
                false
            }
            Event::Text(text) => text != " ",
            _ => true,
        });
        pressed
    })
}
