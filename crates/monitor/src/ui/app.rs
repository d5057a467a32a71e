//! The window: who gets which space, and what happens each frame.

use super::{
    files::Files, gauges, pages::Page, playback, requests::PageRequests, robot, screenshot::Screenshot,
    tab::Tab, toasts, top, view::View,
};
use crate::logic::{
    answers::{Answer, Answers},
    limited::Limited,
    model::Model,
    source::{Source, playback::Playback},
};
use egui::{CentralPanel, Color32, Context, Event, Frame, Id, Key, Panel, ScrollArea, Ui, Visuals};
use moca_msgs::Request;
use moca_telemetry::net::Address;
use std::{path::PathBuf, time::Duration};

/// Narrowest and widest column with robot and gauges, points, and its share of the window.
const LEFT_WIDTH: (f32, f32) = (400.0, 560.0);
const LEFT_SHARE: f32 = 0.3;
/// Height of the column below which some numbers are left to the page Loop, points.
const LITTLE_ROOM: f32 = 620.0;
/// Height of the numbers below the robot in the first frame, points.
const NUMBERS: f32 = 420.0;
/// Period at which ages and silence are checked while nothing new comes.
const LOOK: Duration = Duration::from_millis(250);

/// The dashboard: one robot or log in front, others behind it.
pub struct App {
    tabs: Vec<Tab>,
    shown: usize,
    page: Page,
    files: Files,
    answers: Answers,
    screenshot: Option<Screenshot>,
    /// True once a picture has been laid out; it is on the screen once the next one is.
    laid_out: bool,
    /// Size of everything; 1 is the desktop's.
    zoom: f32,
}

impl App {
    /// Shortest time between two pictures.
    pub const FRAME: Duration = Duration::from_millis(33);

    /// A dashboard for what `source` delivers; `address` is shown when it delivers nothing.
    pub fn new(
        ctx: &Context,
        source: impl Into<Source>,
        address: String,
        screenshot: Option<Screenshot>,
    ) -> Self {
        ctx.all_styles_mut(|style| {
            style.spacing.item_spacing = egui::vec2(8.0, 5.0);
            style.spacing.button_padding = egui::vec2(9.0, 5.0);
        });
        let tabs = vec![Tab::new(source.into(), address)];
        let answers = Answers::default();
        Self {
            tabs,
            shown: 0,
            answers,
            page: Page::default(),
            files: Files::default(),
            screenshot,
            laid_out: false,
            zoom: 1.0,
        }
    }

    /// One more robot or log, behind the others.
    pub fn add(&mut self, source: impl Into<Source>, address: String) {
        self.tabs.push(Tab::new(source.into(), address));
    }

    /// Sets the folder for recordings and logs; the current folder without it.
    pub fn set_folder(&mut self, folder: PathBuf) {
        self.files.folder = folder;
    }

    /// Sets the length of the plots' axis of time, s.
    pub fn show_last_s(&mut self, span_s: f64) {
        self.front().view.axis.show(span_s);
    }

    /// Sets the size of everything; 1 is the desktop's, which knows of high resolution.
    pub fn zoom(&mut self, ctx: &Context, zoom: f32) {
        top::set_zoom(ctx, zoom);
    }

    /// The page in the middle.
    pub fn show_page(&mut self, page: Page) {
        self.page = page;
    }

    /// Returns the model of the robot in front.
    pub fn model(&self) -> &Model {
        &self.tabs[self.shown].model
    }

    fn front(&mut self) -> &mut Tab {
        &mut self.tabs[self.shown]
    }

    /// Takes in what is new, and the space bar before any widget can have it.
    pub fn update(&mut self, ctx: &Context) {
        let now_s = ctx.input(|i| i.time);
        self.zoom = ctx.zoom_factor();
        for tab in &mut self.tabs {
            tab.update(now_s);
            // A robot grows old, and its commander must be seen to live; a log that stands still does neither.
            if tab.model.connected() {
                ctx.request_repaint_after(LOOK);
            }
            if tab.source.log().is_some_and(|log| log.playing()) {
                ctx.request_repaint_after(Self::FRAME);
            }
        }
        self.hear(now_s);
        if self.answers.at(now_s).next().is_some() {
            ctx.request_repaint_after(LOOK);
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

    /// Stops every connected robot: a person who presses stop in a hurry does not look which robot is in front.
    fn stop_all(&mut self) {
        for robot in self.tabs.iter_mut().filter_map(|tab| tab.source.live()) {
            robot.request(Request::Stop);
        }
    }

    /// Shows what the robots have answered; one of several is named.
    fn hear(&mut self, now_s: f64) {
        let several = self.tabs.len() > 1;
        for tab in &mut self.tabs {
            for mut answer in tab.take_answers() {
                if several {
                    answer.text = format!("{}: {}", tab.model.robot.name, answer.text);
                }
                self.answers.add(answer, now_s);
            }
        }
    }

    fn open(&mut self, ctx: &Context, path: PathBuf) {
        let name = path.display().to_string();
        let (wake, now_s) = (ctx.clone(), ctx.input(|i| i.time));
        match Playback::open(path.clone(), move || wake.request_repaint()) {
            Ok(log) => {
                self.files.remember(&path);
                self.add(log, name);
                self.shown = self.tabs.len() - 1;
            }
            Err(error) => self.answers.add(Answer::bad(format!("cannot read {name}: {error}")), now_s),
        }
    }

    fn close_front(&mut self) {
        if self.tabs.len() > 1 {
            self.tabs.remove(self.shown);
            self.shown = self.shown.saturating_sub(1);
        }
    }

    /// Draws everything and passes on what was pressed.
    pub fn show(&mut self, ui: &mut Ui) {
        if std::mem::replace(&mut self.laid_out, true) {
            self.tabs.iter_mut().filter_map(|tab| tab.source.live()).for_each(|robot| robot.alive());
        }
        let mut pressed = PageRequests::default();
        self.layout(ui, &mut pressed);
        self.carry_out(ui.ctx(), pressed);
        let now_s = ui.input(|i| i.time);
        toasts::show(ui.ctx(), &mut self.answers, now_s);
    }

    fn layout(&mut self, ui: &mut Ui, pressed: &mut PageRequests) {
        let now_s = ui.input(|i| i.time);
        let bare = Bare::new(ui);
        let closable = self.tabs.len() > 1;
        let anybody_to_stop = self.tabs.iter().any(|tab| tab.model.connected());
        let Self { tabs, shown, page, files, .. } = self;
        Panel::top("top").frame(bare.side).show(ui, |ui| {
            if tabs.len() > 1 {
                let names = tabs.iter().map(|tab| tab.name(now_s));
                top::tabs(ui, names, shown);
            }
            let Tab { model, address, .. } = &tabs[*shown];
            top::show(ui, model, address, now_s, anybody_to_stop, pressed);
        });
        let Tab { source, model, view, guard, recording, .. } = &mut tabs[*shown];
        if let Some(log) = source.log() {
            Panel::bottom("playback").frame(bare.side).show(ui, |ui| {
                guard.draw(ui, "The log", |ui| playback::show(ui, log, view, closable, pressed));
            });
        }
        let width = (ui.available_width() * LEFT_SHARE).limited(LEFT_WIDTH.0, LEFT_WIDTH.1);
        Panel::left("left").frame(bare.side).exact_size(width).resizable(false).show(ui, |ui| {
            guard.draw(ui, "The robot", |ui| left(ui, model, view, now_s, pressed));
        });
        files.show(ui.ctx(), pressed);
        CentralPanel::default().frame(bare.centre).show(ui, |ui| {
            page.tabs(ui, model, recording.as_ref(), pressed);
            guard.draw(ui, page.name(), |ui| page.show(ui, model, view, now_s, pressed));
        });
    }

    fn carry_out(&mut self, ctx: &Context, pressed: PageRequests) {
        let PageRequests { mut requests, calibrate, push, open_log, choose_log, close_log, .. } = pressed;
        if requests.contains(&Request::Stop) {
            self.stop_all();
        }
        let Tab { source, model, .. } = self.front();
        if let Some(robot) = source.live() {
            requests.retain(|request| *request != Request::Stop);
            requests.extend(model.push(push));
            requests.into_iter().for_each(|request| robot.request(request));
            calibrate.into_iter().for_each(|request| robot.calibrate(request));
        }
        if choose_log {
            self.files.choose();
        }
        let folder = self.files.folder.clone();
        if pressed.record {
            self.front().record(&folder);
        }
        if pressed.export {
            self.front().export(&folder);
        }
        if pressed.save_parameters {
            self.front().save_parameters(&folder);
        }
        let now_s = ctx.input(|i| i.time);
        pressed.answers.into_iter().for_each(|answer| self.answers.add(answer, now_s));
        self.hear(now_s);
        if let Some(path) = open_log {
            self.open(ctx, path);
        }
        if close_log {
            self.close_front();
        }
    }
}

/// Draws the column on the left: the robot from above and its numbers.
fn left(ui: &mut Ui, model: &Model, view: &mut View, now_s: f64, pressed: &mut PageRequests) {
    let height = ui.available_height();
    // The picture has what the numbers left of the column in the frame before.
    let numbers = ui.ctx().data(|data| data.get_temp(Id::unique("numbers"))).unwrap_or(NUMBERS);
    ScrollArea::vertical().show(ui, |ui| {
        let top = ui.cursor().top();
        let picture = height - numbers;
        pressed.push = robot::show(ui, model, view, now_s, picture);
        gauges::show(ui, model, now_s, height < LITTLE_ROOM, pressed);
        let numbers = ui.cursor().top() - top - robot::height(picture);
        ui.ctx().data_mut(|data| data.insert_temp(Id::unique("numbers"), numbers));
    });
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
        let front = &self.tabs[self.shown];
        let View { axis, push_n, .. } = &front.view;
        storage.set_string("page", self.page.name().to_owned());
        storage.set_string("span_s", axis.span_s().to_string());
        storage.set_string("push_n", push_n.to_string());
        storage.set_string("zoom", self.zoom.to_string());
        let live = self.tabs.iter().filter(|tab| !tab.model.recorded);
        let addresses: Vec<&str> = live.map(|tab| tab.address.as_str()).collect();
        // Who looked at a log only has not left the robots.
        if !addresses.is_empty() {
            storage.set_string("connect", addresses.join(" "));
        }
        let recent: Vec<String> = self.files.recent.iter().map(|log| log.display().to_string()).collect();
        storage.set_string("recent_logs", recent.join("\n"));
        if !front.model.recorded {
            storage.set_string("front", front.address.clone());
        }
    }
}

impl App {
    /// Returns the addresses of the robots that were shown when the last window was closed.
    pub fn last_connected(storage: &dyn eframe::Storage) -> Vec<Address> {
        let list = storage.get_string("connect").unwrap_or_default();
        list.split(' ').filter_map(|address| address.parse().ok()).collect()
    }

    /// Takes up what was looked at when the last window was closed.
    pub fn restore(&mut self, ctx: &Context, storage: &dyn eframe::Storage) {
        let text = |key| storage.get_string(key);
        let number = |key| text(key)?.parse::<f64>().ok().filter(|v| v.is_finite());
        self.page = text("page").and_then(|name| Page::named(&name)).unwrap_or_default();
        let front = text("front").and_then(|front| self.tabs.iter().position(|tab| tab.address == front));
        self.shown = front.unwrap_or(self.shown);
        let recent = text("recent_logs").unwrap_or_default();
        self.files.recent = recent.lines().map(PathBuf::from).collect();
        if let Some(zoom) = text("zoom").and_then(|zoom| zoom.parse().ok()) {
            self.zoom(ctx, zoom);
        }
        for tab in &mut self.tabs {
            if let Some(span_s) = number("span_s") {
                tab.view.axis.show(span_s);
            }
            if let Some(push_n) = number("push_n") {
                tab.view.push_n = push_n.limited(1.0, moca_msgs::request::PRESS_FORCE_MAX_N);
            }
        }
    }
}

/// Returns true if the space bar was pressed. No other widget receives it: on a focused button it would also be a click, and a
/// stop must not depend on the keyboard's focus.
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
