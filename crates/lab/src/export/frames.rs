//! Samples at equal distances, as learning takes them.

use moca_msgs::{Sample, seconds};

/// A longer time without a sample ends an episode, ns: a log shows one each 20 ms.
const GAP_NS: u64 = 100_000_000;

/// One instant of an episode.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame<'a> {
    /// The last sample that was there then.
    pub(super) sample: &'a Sample,
    /// Age of the cover's data at the frame, s.
    pub(super) age_s: f64,
}

/// The stretches of a log without a gap in which every sample is one to learn from.
pub(super) fn episodes(
    samples: &[Sample],
    learned: impl Fn(&Sample) -> bool,
) -> impl Iterator<Item = &[Sample]> {
    let near = |a: &Sample, b: &Sample| b.time_ns.saturating_sub(a.time_ns) <= GAP_NS;
    samples.split(move |sample| !learned(sample)).flat_map(move |stretch| stretch.chunk_by(near))
}

/// Frames of one stretch, `fps` each second, from its first sample on.
pub(super) fn frames(samples: &[Sample], fps: u32) -> Vec<Frame<'_>> {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return Vec::new() };
    let mut at = 0;
    let mut frames = Vec::new();
    for number in 0_u64.. {
        let time_ns = first.time_ns + number * 1_000_000_000 / u64::from(fps);
        if time_ns > last.time_ns {
            break;
        }
        while samples.get(at + 1).is_some_and(|next| next.time_ns <= time_ns) {
            at += 1;
        }
        let sample = &samples[at];
        frames.push(Frame { sample, age_s: seconds(time_ns - sample.time_ns) });
    }
    frames
}
