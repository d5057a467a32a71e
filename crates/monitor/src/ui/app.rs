//! The window: who gets which space, and what happens each frame.

use super::{Screenshot, gauges, playback, plots, robot, top};
use crate::logic::{Action, Model, Source};
use egui::{CentralPanel, Context, Event, Key, Panel, ScrollArea, Ui};
use std::time::Duration;

/// Width of the column with robot and gauges, points.
const LEFT_WIDTH: f32 = 400.0;

/// The dashboard of one robot.
pub struct App {
    source: Box<dyn Source>,
    address: String,
    model: Model,
    view: View,
    screenshot: Option<Screenshot>,
}

/// What the user has chosen to look at.
pub(super) struct View {
    /// Length of the plots' axis of time, s.
    pub(super) window_s: f64,
    /// End of the axis while it is paused, s of loop time.
    pub(super) paused_at_s: Option<f64>,
    /// Where the mouse points on the axis of time, s of loop time.
    pub(super) cursor_s: Option<f64>,
    /// Force of a push with the mouse, N.
    pub(super) push_n: f64,
    /// What became of the last export.
    pub(super) exported: Option<String>,
}

impl App {
    /// Shortest time between two pictures.
    pub const FRAME: Duration = Duration::from_millis(33);

    /// A dashboard for what `source` delivers; `address` is shown when it delivers nothing.
    pub fn new(
        ctx: &Context,
        source: impl Source + 'static,
        address: String,
        screenshot: Option<Screenshot>,
    ) -> Self {
        ctx.all_styles_mut(|style| {
            style.spacing.item_spacing = egui::vec2(8.0, 5.0);
            style.spacing.button_padding = egui::vec2(9.0, 5.0);
        });
        let mut source: Box<dyn Source> = Box::new(source);
        let mut model = Model::default();
        model.recorded = source.playback().is_some();
        let view = View { window_s: 10.0, paused_at_s: None, cursor_s: None, push_n: 20.0, exported: None };
        Self { source, address, model, view, screenshot }
    }

    /// Sets the length of the plots' axis of time, s.
    pub fn show_last_s(&mut self, window_s: f64) {
        self.view.window_s = window_s;
    }

    /// What it knows.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Takes in what is new, and the space bar before any widget can have it.
    pub fn update(&mut self, ctx: &Context) {
        let now_s = ctx.input(|i| i.time);
        self.model.take(self.source.poll(now_s), now_s);
        if take_space_bar(ctx) {
            self.source.request(Action::Stop.request());
        }
        if let Some(screenshot) = &mut self.screenshot {
            screenshot.tick(ctx, now_s);
        }
        if self.source.playback().is_some_and(|p| p.playing()) {
            ctx.request_repaint_after(Self::FRAME);
        }
        // Ages and the connection's state go on without samples.
        ctx.request_repaint_after(Duration::from_millis(250));
    }

    /// Draws everything and passes on what was pressed.
    pub fn show(&mut self, ui: &mut Ui) {
        let now_s = ui.input(|i| i.time);
        let Self { model, view, source, .. } = self;
        let mut asked = Vec::new();
        Panel::top("top").show(ui, |ui| top::show(ui, model, &self.address, now_s, &mut asked));
        if let Some(recorded) = source.playback() {
            Panel::bottom("playback").show(ui, |ui| playback::show(ui, recorded));
        }
        let left = Panel::left("left").exact_size(LEFT_WIDTH).resizable(false);
        let pushed = left.show(ui, |ui| {
            ScrollArea::vertical().show(ui, |ui| {
                let pushed = robot::show(ui, model, view, now_s);
                gauges::show(ui, model, now_s);
                pushed
            })
        });
        CentralPanel::default().show(ui, |ui| plots::show(ui, model, view));
        for action in asked {
            source.request(action.request());
        }
        for request in model.push(pushed.inner.inner) {
            source.request(request);
        }
    }
}

impl eframe::App for App {
    fn logic(&mut self, ctx: &Context, _frame: &mut eframe::Frame) {
        self.update(ctx);
    }

    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }

    fn save(&mut self, _storage: &mut dyn eframe::Storage) {}
}

/// Whether the space bar was pressed. Nobody else gets to see it: on a focused button it would also be a click.
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
