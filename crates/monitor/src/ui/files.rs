//! Choosing a log: those that were opened last, those in a folder, a path, or a file dropped on the window.

use super::requests::PageRequests;
use egui::{Button, Context, Grid, Key, Modifiers, ScrollArea, TextEdit, Ui, Window};
use std::{
    path::{Path, PathBuf},
    time::SystemTime,
};

/// Logs and folders listed at most.
const LISTED: usize = 200;
/// Logs remembered at most.
const REMEMBERED: usize = 8;

/// The window that chooses a log, while it is open.
pub(super) struct Files {
    /// Folder of recordings and tables, in which the search for logs begins.
    pub(super) folder: PathBuf,
    /// Logs that were opened, the last one first.
    pub(super) recent: Vec<PathBuf>,
    open: bool,
    path: String,
    listed: Folder,
}

/// Contents of a folder.
#[derive(Default)]
struct Folder {
    path: PathBuf,
    folders: Vec<String>,
    logs: Vec<Log>,
    failure: Option<String>,
}

/// A log in a folder.
struct Log {
    name: String,
    bytes: u64,
    changed: Option<SystemTime>,
}

impl Default for Files {
    fn default() -> Self {
        Self {
            folder: PathBuf::from("."),
            recent: Vec::new(),
            open: false,
            path: String::new(),
            listed: Folder::default(),
        }
    }
}

impl Files {
    /// Files dropped on the window.
    pub(super) fn dropped(&self, ctx: &Context) -> Vec<PathBuf> {
        ctx.input(|i| i.raw.dropped_files.iter().map(|file| file.path().to_path_buf()).collect())
    }

    /// Lists what is there and opens the window.
    pub(super) fn choose(&mut self) {
        self.open = true;
        let whole = self.folder.canonicalize();
        self.listed = Folder::list(whole.unwrap_or_else(|_| self.folder.clone()));
        self.recent.retain(|log| log.exists());
    }

    /// Remembers a log that was opened.
    pub(super) fn remember(&mut self, log: &Path) {
        let whole = log.canonicalize().unwrap_or_else(|_| log.to_path_buf());
        self.recent.retain(|other| *other != whole);
        self.recent.insert(0, whole);
        self.recent.truncate(REMEMBERED);
    }

    /// Draws the window, if it is open, and notes which log was chosen.
    pub(super) fn show(&mut self, ctx: &Context, pressed: &mut PageRequests) {
        if self.open && ctx.input_mut(|input| input.consume_key(Modifiers::NONE, Key::Escape)) {
            self.open = false;
        }
        let mut still = self.open;
        let window = Window::new("Open a log").open(&mut still).default_width(520.0);
        // The mode stays in sight.
        window.default_pos([420.0, 140.0]).show(ctx, |ui| {
            ui.label(
                "An MCAP file of `mocad --record` or of this window. Dropping one on the window works too.",
            );
            self.typed(ui, pressed);
            if !self.recent.is_empty() {
                ui.separator();
                ui.strong("Opened last");
                for log in &self.recent {
                    let name = log.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
                    let label = format!("{name} (again)");
                    if ui.button(label).on_hover_text(log.display().to_string()).clicked() {
                        pressed.open_log = Some(log.clone());
                    }
                }
            }
            ui.separator();
            self.browse(ui, pressed);
        });
        self.open = still && pressed.open_log.is_none();
    }

    fn typed(&mut self, ui: &mut Ui, pressed: &mut PageRequests) {
        ui.horizontal(|ui| {
            let edit =
                TextEdit::singleline(&mut self.path).hint_text("path/to/run.mcap").desired_width(360.0);
            let label = ui.label("Path");
            let entered = ui.add(edit).labelled_by(label.id).lost_focus()
                && ui.input(|i| i.key_pressed(egui::Key::Enter));
            let clicked = ui.add_enabled(!self.path.is_empty(), Button::new("Open")).clicked();
            if (entered || clicked) && !self.path.is_empty() {
                pressed.open_log = Some(PathBuf::from(self.path.as_str()));
            }
        });
    }

    fn browse(&mut self, ui: &mut Ui, pressed: &mut PageRequests) {
        let mut go_to = None;
        let Folder { path, folders, logs, failure } = &self.listed;
        ui.horizontal_wrapped(|ui| {
            if ui.add_enabled(path.parent().is_some(), Button::new("Folder above")).clicked() {
                go_to = path.parent().map(Path::to_path_buf);
            }
            ui.strong(path.display().to_string());
        });
        if let Some(failure) = failure {
            ui.colored_label(super::theme::BAD, failure);
        } else if logs.is_empty() {
            ui.weak("No .mcap file in this folder.");
        }
        ScrollArea::vertical().max_height(280.0).show(ui, |ui| {
            Grid::new("logs").num_columns(3).striped(true).show(ui, |ui| {
                for Log { name, bytes, changed } in logs {
                    if ui.button(name).clicked() {
                        pressed.open_log = Some(path.join(name));
                    }
                    ui.weak(size(*bytes));
                    ui.weak(
                        changed
                            .and_then(|at| at.elapsed().ok())
                            .map_or_else(String::new, |age| ago(age.as_secs())),
                    );
                    ui.end_row();
                }
            });
            for name in folders {
                if ui.button(format!("{name}/")).clicked() {
                    go_to = Some(path.join(name));
                }
            }
        });
        if let Some(path) = go_to {
            self.listed = Folder::list(path);
        }
    }
}

impl Folder {
    /// Lists the folder at `path`: logs, the newest first, and folders that are not hidden.
    fn list(path: PathBuf) -> Self {
        let entries = match std::fs::read_dir(&path) {
            Ok(entries) => entries,
            Err(error) => {
                let failure = Some(format!("cannot read {}: {error}", path.display()));
                return Self { path, failure, ..Self::default() };
            }
        };
        let (mut folders, mut logs) = (Vec::new(), Vec::new());
        for entry in entries.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let Ok(about) = std::fs::metadata(entry.path()) else { continue };
            if about.is_dir() && !name.starts_with('.') {
                folders.push(name);
            } else if about.is_file() && entry.path().extension().is_some_and(|e| e == "mcap") {
                logs.push(Log { name, bytes: about.len(), changed: about.modified().ok() });
            }
        }
        folders.sort();
        logs.sort_by_key(|log| std::cmp::Reverse(log.changed));
        folders.truncate(LISTED);
        logs.truncate(LISTED);
        Self { path, folders, logs, failure: None }
    }
}

/// Bytes in a unit that reads well.
fn size(bytes: u64) -> String {
    match bytes {
        0..1_000_000 => format!("{} kB", bytes.div_ceil(1000)),
        1_000_000..1_000_000_000 => format!("{} MB", bytes / 1_000_000),
        _ => format!("{}.{} GB", bytes / 1_000_000_000, bytes / 100_000_000 % 10),
    }
}

/// Describes an age in a suitable unit.
fn ago(seconds: u64) -> String {
    match seconds {
        0..120 => "just now".into(),
        120..7200 => format!("{} min ago", seconds / 60),
        7200..172_800 => format!("{} h ago", seconds / 3600),
        _ => format!("{} days ago", seconds / 86_400),
    }
}
