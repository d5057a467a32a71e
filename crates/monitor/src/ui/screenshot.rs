//! A picture of the window for papers and READMEs.

use egui::{ColorImage, Context, ViewportCommand};
use std::{
    path::PathBuf,
    sync::{Arc, Mutex},
    time::Duration,
};

/// Takes one picture of the window after a while, then closes it.
pub struct Screenshot {
    path: PathBuf,
    after: Duration,
    asked: bool,
    failure: Arc<Mutex<Option<String>>>,
}

impl Screenshot {
    /// A PNG at `path`, `after` the start.
    pub fn new(path: PathBuf, after: Duration) -> Self {
        Self { path, after, asked: false, failure: Arc::default() }
    }

    /// Where it says why it failed, if it did.
    pub fn failure(&self) -> Arc<Mutex<Option<String>>> {
        Arc::clone(&self.failure)
    }

    /// To be called each frame, with the time since the start, s.
    pub(super) fn tick(&mut self, ctx: &Context, now_s: f64) {
        let left = self.after.saturating_sub(Duration::try_from_secs_f64(now_s).unwrap_or_default());
        if !left.is_zero() {
            ctx.request_repaint_after(left);
        } else if !self.asked {
            self.asked = true;
            let (path, failure, close) = (self.path.clone(), Arc::clone(&self.failure), ctx.clone());
            ctx.request_screenshot(move |image| {
                if let Err(error) = save(&image, &path)
                    && let Ok(mut failure) = failure.lock()
                {
                    *failure = Some(format!("cannot save the screenshot {}: {error}", path.display()));
                }
                close.send_viewport_cmd(ViewportCommand::Close);
                close.request_repaint();
            });
            ctx.request_repaint();
        }
    }
}

fn save(image: &ColorImage, path: &std::path::Path) -> image::ImageResult<()> {
    let [width, height] = image.size.map(|side| u32::try_from(side).unwrap_or(u32::MAX));
    let bytes: Vec<u8> = image.pixels.iter().flat_map(|p| [p.r(), p.g(), p.b()]).collect();
    let Some(picture) = image::RgbImage::from_raw(width, height, bytes) else {
        return Err(std::io::Error::other("its size does not fit its pixels").into());
    };
    picture.save_with_format(path, image::ImageFormat::Png)
}
