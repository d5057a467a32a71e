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
    frame_times: Option<FrameTimes>,
}

/// Processor time of frames, ms: this thread's share, and that of all threads (a software rasteriser has some).
#[derive(Default)]
struct FrameTimes {
    thread_ms: Vec<f64>,
    process_ms: Vec<f64>,
    last: Option<[f64; 2]>,
}

impl FrameTimes {
    /// Notes that a frame begins; the last one ended when its pixels were handed over.
    fn note(&mut self) {
        let now = cpu_time_ms("/proc/thread-self").zip(process_time_ms()).map(|(thread, all)| [thread, all]);
        if let (Some(now), Some(last)) = (now, self.last) {
            self.thread_ms.push(now[0] - last[0]);
            self.process_ms.push(now[1] - last[1]);
        }
        self.last = now;
    }
}

/// Time on a processor of one thread, ms, from the kernel's scheduler.
fn cpu_time_ms(thread: &str) -> Option<f64> {
    let text = std::fs::read_to_string(format!("{thread}/schedstat")).ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-6)
}

fn process_time_ms() -> Option<f64> {
    let threads = std::fs::read_dir("/proc/self/task").ok()?.flatten();
    Some(threads.filter_map(|thread| cpu_time_ms(&thread.path().display().to_string())).sum())
}

impl Screenshot {
    /// A PNG at `path`, `after` the start.
    pub fn new(path: PathBuf, after: Duration) -> Self {
        Self { path, after, asked: false, failure: Arc::default(), frame_times: None }
    }

    /// Prints what frames cost the processor when the picture is taken.
    #[must_use]
    pub fn with_frame_times(self) -> Self {
        Self { frame_times: Some(FrameTimes::default()), ..self }
    }

    /// Returns the place of its error, if it failed.
    pub fn failure(&self) -> Arc<Mutex<Option<String>>> {
        Arc::clone(&self.failure)
    }

    /// To be called each frame, with the time since the start, s.
    pub(super) fn tick(&mut self, ctx: &Context, now_s: f64) {
        if let Some(times) = &mut self.frame_times {
            times.note();
        }
        let left = self.after.saturating_sub(Duration::try_from_secs_f64(now_s).unwrap_or_default());
        if !left.is_zero() {
            ctx.request_repaint_after(left);
        } else if !self.asked {
            self.asked = true;
            if let Some(FrameTimes { thread_ms, process_ms, .. }) = &mut self.frame_times {
                print_frame_times("drawing thread", thread_ms);
                print_frame_times("with the rasteriser's threads", process_ms);
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
fn print_frame_times(what: &str, frames_ms: &mut [f64]) {
    frames_ms.sort_by(f64::total_cmp);
    let at = |part: usize| frames_ms.get(frames_ms.len() * part / 100).copied().unwrap_or(f64::NAN);
    let (count, p50, p99) = (frames_ms.len(), at(50), at(99));
    println!("{count} frames, processor time, {what}: p50 {p50:.2} ms, p99 {p99:.2} ms");
}

fn save(image: &ColorImage, path: &std::path::Path) -> image::ImageResult<()> {
    let [width, height] = image.size.map(|side| u32::try_from(side).unwrap_or(u32::MAX));
    let bytes: Vec<u8> = image.pixels.iter().flat_map(|p| [p.r(), p.g(), p.b()]).collect();
    let Some(picture) = image::RgbImage::from_raw(width, height, bytes) else {
        return Err(std::io::Error::other("its size does not fit its pixels").into());
    };
    picture.save_with_format(path, image::ImageFormat::Png)
}
