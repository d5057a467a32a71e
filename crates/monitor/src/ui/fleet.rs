//! Several robots in one window: a list that only watches, and the dashboard of the robot that was opened.

use super::{app::App, screenshot::Screenshot, theme, top};
use crate::logic::fleet::Row;
use egui::{
    Button, CentralPanel, Context, Direction, Frame, Grid, Label, Layout, Panel, RichText, ScrollArea, Sense,
    Ui, UiBuilder, Visuals, vec2,
};
use moca_msgs::Mode;
use std::time::Duration;

/// Period at which the list is drawn.
const LOOK: Duration = Duration::from_millis(200);
/// Size of the letters of a row, of the place of its mode, and of its health, points.
const TEXT: f32 = 16.0;
const MODE: egui::Vec2 = vec2(170.0, 30.0);
const HEALTH: egui::Vec2 = vec2(54.0, 20.0);
/// Bars of the health.
const BARS: u8 = 5;
/// Label of the button that goes back to the list.
const ALL: &str = "All robots";

/// Returns what is known of every robot of the list.
pub type Look = Box<dyn FnMut() -> Vec<Row>>;
/// Makes a dashboard for the robot in a place of the list, or says why not.
pub type Open = Box<dyn FnMut(&Context, usize) -> Result<App, String>>;

/// A window for several robots. Nothing in the list reaches a robot: commands and STOP are on the page of the one that is open.
pub struct FleetWindow {
    look: Look,
    open: Open,
    rows: Vec<Row>,
    front: Option<(usize, App)>,
    refused: String,
    screenshot: Option<Screenshot>,
}

impl FleetWindow {
    /// A window that begins with the list.
    pub fn new(look: Look, open: Open, screenshot: Option<Screenshot>) -> Self {
        Self { look, open, rows: Vec::new(), front: None, refused: String::new(), screenshot }
    }

    /// Takes in what is new.
    pub fn update(&mut self, ctx: &Context) {
        self.rows = (self.look)();
        ctx.request_repaint_after(LOOK);
        if let Some((_, app)) = &mut self.front {
            app.update(ctx);
        }
        if let Some(screenshot) = &mut self.screenshot {
            screenshot.tick(ctx, ctx.input(|i| i.time));
        }
    }

    /// Draws the list, or the robot that is open with the others above it.
    pub fn show(&mut self, ui: &mut Ui) {
        let Some((front, app)) = &mut self.front else {
            return self.list(ui);
        };
        let mut chosen = *front + 1;
        Panel::top("robots").frame(Frame::side_top_panel(ui.style())).show(ui, |ui| {
            let all = top::TabName { name: ALL.into(), longest: ALL.into(), mode: None };
            top::tabs(ui, std::iter::once(all).chain(self.rows.iter().map(tab)), &mut chosen);
        });
        app.show(ui);
        match chosen.checked_sub(1) {
            // Its connection closes: a robot that this window commanded stops, as when the window is closed.
            None => self.front = None,
            Some(other) if other != *front => self.open(ui.ctx(), other),
            Some(_) => {}
        }
    }

    fn open(&mut self, ctx: &Context, place: usize) {
        match (self.open)(ctx, place) {
            Ok(app) => (self.front, self.refused) = (Some((place, app)), String::new()),
            Err(why) => (self.front, self.refused) = (None, why),
        }
    }

    fn list(&mut self, ui: &mut Ui) {
        let mut chosen = None;
        CentralPanel::default().show(ui, |ui| {
            let well = self.rows.iter().filter(|row| row.trouble().is_empty()).count();
            ui.heading(format!("{} robots, {well} without trouble", self.rows.len()));
            ui.label("This list only watches. Open a robot to command it, or to stop it.");
            if !self.refused.is_empty() {
                ui.label(RichText::new(&self.refused).color(theme::BAD));
            }
            ui.separator();
            ScrollArea::vertical().show(ui, |ui| {
                let grid = Grid::new("fleet").num_columns(7).striped(true).spacing([18.0, 8.0]);
                grid.show(ui, |ui| {
                    for title in ["robot", "mode", "contact", "health", "", "cover data", ""] {
                        ui.weak(title);
                    }
                    ui.end_row();
                    for (place, row) in self.rows.iter().enumerate() {
                        if robot(ui, row) {
                            chosen = Some(place);
                        }
                    }
                });
            });
        });
        if let Some(place) = chosen {
            self.open(ui.ctx(), place);
        }
    }
}

/// Draws a robot's row; true if it is to be opened.
fn robot(ui: &mut Ui, row: &Row) -> bool {
    let open = ui.add(Button::new(RichText::new(&row.name).size(TEXT)).min_size(vec2(150.0, 48.0))).clicked();
    let (place, _) = ui.allocate_exact_size(MODE, Sense::hover());
    ui.painter().rect_filled(place, 4.0, theme::mode(row.seen.as_ref().ok().map(|glance| glance.mode)));
    let text = RichText::new(row.mode()).size(TEXT).strong().color(egui::Color32::WHITE);
    // Not `put`, which would take a cell of the grid too.
    let layout = Layout::centered_and_justified(Direction::TopDown);
    let mut inside = ui.new_child(UiBuilder::new().max_rect(place).layout(layout));
    inside.add(Label::new(text).selectable(false));
    let [force, taxels, age] = row.contact();
    ui.label(RichText::new(force).size(TEXT));
    health(ui, row.health());
    ui.label(taxels);
    ui.label(age);
    let trouble = Label::new(RichText::new(row.trouble()).color(theme::BAD)).wrap();
    ui.add_sized([ui.available_width().max(200.0), 48.0], trouble);
    ui.end_row();
    open
}

/// Draws a battery with as many bars as the robot is well.
fn health(ui: &mut Ui, share: f32) {
    let (place, _) = ui.allocate_exact_size(HEALTH, Sense::hover());
    let colour = match share {
        share if share > 0.99 => theme::GOOD,
        share if share > 0.5 => theme::WARNING,
        _ => theme::BAD,
    };
    let outline = egui::Stroke::new(1.5, ui.visuals().weak_text_color());
    ui.painter().rect_stroke(place, 3.0, outline, egui::StrokeKind::Inside);
    let width = (place.width() - 4.0) / f32::from(BARS);
    for bar in 0..BARS {
        if share * f32::from(BARS) > f32::from(bar) {
            let left = place.left() + 3.0 + f32::from(bar) * width;
            let bar = egui::Rect::from_min_size(
                egui::pos2(left, place.top() + 3.0),
                vec2(width - 2.0, place.height() - 6.0),
            );
            ui.painter().rect_filled(bar, 1.0, colour);
        }
    }
}

fn tab(row: &Row) -> top::TabName {
    let mode = row.seen.as_ref().ok().map(|glance| glance.mode);
    let longest = format!("{}: {}", row.name, Mode::ProtectiveStop.name());
    top::TabName { name: format!("{}: {}", row.name, row.mode()), longest, mode }
}

impl eframe::App for FleetWindow {
    fn clear_color(&self, visuals: &Visuals) -> [f32; 4] {
        visuals.panel_fill.to_normalized_gamma_f32()
    }

    fn logic(&mut self, ctx: &Context, _frame: &mut eframe::Frame) {
        self.update(ctx);
    }

    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }
}
