//! Choosing a log: a list of those in the folder, a path, or a file dropped on the window.

use super::requests::PageRequests;
use egui::{Button, Context, ScrollArea, TextEdit, Window};
use std::path::{Path, PathBuf};

/// Logs listed at most.
const LISTED: usize = 50;

/// The window that chooses a log, while it is open.
pub(super) struct Files {
    /// Where logs are looked for and recordings go.
    pub(super) folder: PathBuf,
    open: bool,
    path: String,
    found: Vec<String>,
}

impl Default for Files {
    fn default() -> Self {
        Self { folder: PathBuf::from("."), open: false, path: String::new(), found: Vec::new() }
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
        self.found = logs(&self.folder);
    }

    /// Draws the window, if it is open, and notes which log was chosen.
    pub(super) fn show(&mut self, ctx: &Context, pressed: &mut PageRequests) {
        let Self { folder, open, path, found } = self;
        let mut still = *open;
        Window::new("Open a log").open(&mut still).default_width(460.0).show(ctx, |ui| {
            ui.label(
                "An MCAP file of `mocad --record` or of this window. Dropping one on the window works too.",
            );
            ui.horizontal(|ui| {
                let edit = TextEdit::singleline(path).hint_text("path/to/run.mcap").desired_width(360.0);
                let label = ui.label("Path");
                let entered = ui.add(edit).labelled_by(label.id).lost_focus()
                    && ui.input(|i| i.key_pressed(egui::Key::Enter));
                let clicked = ui.add_enabled(!path.is_empty(), Button::new("Open")).clicked();
                if (entered || clicked) && !path.is_empty() {
                    pressed.open_log = Some(PathBuf::from(path.as_str()));
                }
            });
            ui.separator();
            if found.is_empty() {
                ui.weak(format!("No .mcap file in {}.", folder.display()));
            }
            ScrollArea::vertical().max_height(300.0).show(ui, |ui| {
                for name in found.iter() {
                    if ui.button(name).clicked() {
                        pressed.open_log = Some(folder.join(name));
                    }
                }
            });
        });
        *open = still && pressed.open_log.is_none();
    }
}

/// Names of the logs in `folder`, newest first.
fn logs(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut found: Vec<_> = entries
        .flatten()
        .filter(|entry| entry.path().extension().is_some_and(|e| e == "mcap"))
        .map(|entry| {
            let changed = entry.metadata().and_then(|m| m.modified()).ok();
            (changed, entry.file_name().to_string_lossy().into_owned())
        })
        .collect();
    found.sort_by(|a, b| b.cmp(a));
    found.into_iter().map(|(_, name)| name).take(LISTED).collect()
}
