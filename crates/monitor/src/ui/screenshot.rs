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
    frames_ms: Option<Vec<f64>>,
}

impl Screenshot {
    /// A PNG at `path`, `after` the start.
    pub fn new(path: PathBuf, after: Duration) -> Self {
        Self { path, after, asked: false, failure: Arc::default(), frames_ms: None }
    }

    /// Prints what frames cost the processor when the picture is taken.
    #[must_use]
    pub fn with_frame_times(self) -> Self {
        Self { frames_ms: Some(Vec::new()), ..self }
    }

    /// Notes the processor time of a frame, s.
    pub(super) fn note_frame(&mut self, seconds: f32) {
        if let Some(frames_ms) = &mut self.frames_ms {
            frames_ms.push(f64::from(seconds) * 1e3);
        }
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
            if let Some(frames_ms) = &mut self.frames_ms {
                print_frame_times(frames_ms);
            }
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

#[expect(clippy::print_stdout, reason = "asked for on the command line")]
fn print_frame_times(frames_ms: &mut [f64]) {
    frames_ms.sort_by(f64::total_cmp);
    let at = |part: usize| frames_ms.get(frames_ms.len() * part / 100).copied().unwrap_or(f64::NAN);
    println!(
        "{} frames, processor time p50 {:.2} ms, p99 {:.2} ms",
        frames_ms.len(),
        at(50),
        at(99).max(at(50))
    );
}

fn save(image: &ColorImage, path: &std::path::Path) -> image::ImageResult<()> {
    let [width, height] = image.size.map(|side| u32::try_from(side).unwrap_or(u32::MAX));
    let bytes: Vec<u8> = image.pixels.iter().flat_map(|p| [p.r(), p.g(), p.b()]).collect();
    let Some(picture) = image::RgbImage::from_raw(width, height, bytes) else {
        return Err(std::io::Error::other("its size does not fit its pixels").into());
    };
    picture.save_with_format(path, image::ImageFormat::Png)
}
