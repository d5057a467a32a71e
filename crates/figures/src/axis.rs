//! Mapping of an axis to pixels, and the labels beside it.

/// Mapping of an axis's numbers to pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Equal steps are equal lengths.
    Linear,
    /// Equal ratios are equal lengths.
    Log,
}

/// Most labels on a logarithmic axis.
const DECADES_MAX: i32 = 8;

/// One axis: its range and where that lies, px.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis {
    pub(crate) range: [f64; 2],
    pub(crate) scale: Scale,
    pub(crate) start_px: f64,
    /// Negative upwards.
    pub(crate) length_px: f64,
}

impl Axis {
    pub(crate) fn place(&self, value: f64) -> f64 {
        let [low, high] = self.range;
        let share = match self.scale {
            Scale::Linear => (value - low) / (high - low),
            // What has no logarithm has no place.
            Scale::Log if value > 0.0 => (value / low).log10() / (high / low).log10(),
            Scale::Log => f64::NAN,
        };
        self.start_px + share * self.length_px
    }

    /// Values that are labelled, with their labels.
    pub(crate) fn ticks(&self) -> Vec<(f64, String)> {
        match self.scale {
            Scale::Linear => linear_ticks(self.range, (self.length_px.abs() / 90.0).clamp(4.0, 8.0))
                .into_iter()
                .map(|v| (v, number(v)))
                .collect(),
            Scale::Log => {
                let [from, to] = self.decades();
                let every = (to - from) / DECADES_MAX + 1;
                let decades = (from..=to).filter(|decade| (decade - from) % every == 0);
                decades.map(|decade| (10f64.powi(decade), power_of_ten(decade))).collect()
            }
        }
    }

    /// Values between the labelled ones that get a short line.
    pub(crate) fn minor_ticks(&self) -> Vec<f64> {
        let [from, to] = match self.scale {
            Scale::Linear => return Vec::new(),
            Scale::Log => self.decades(),
        };
        if to - from > 2 * DECADES_MAX {
            return Vec::new();
        }
        (from..to).flat_map(|decade| (2..10).map(move |m| f64::from(m) * 10f64.powi(decade))).collect()
    }

    fn decades(&self) -> [i32; 2] {
        #[expect(clippy::cast_possible_truncation, reason = "decades of a finite number")]
        let decades = self.range.map(|value| value.log10().round() as i32);
        decades
    }
}

/// Range that holds `values`: whole decades, or a margin above and below if `margin`.
pub(crate) fn range(values: impl Iterator<Item = f64>, scale: Scale, margin: bool) -> [f64; 2] {
    let usable = values.filter(|v| v.is_finite() && (scale == Scale::Linear || *v > 0.0));
    let [low, high] =
        usable.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)]);
    if low > high {
        return [0.1, 1.0];
    }
    match scale {
        Scale::Log => {
            let low = low.log10().floor();
            [10f64.powf(low), 10f64.powf(high.log10().ceil().max(low + 1.0))]
        }
        Scale::Linear if margin => {
            let margin = 0.06 * (high - low).max(1e-9 + 0.02 * high.abs().max(low.abs()));
            [low - margin, high + margin]
        }
        Scale::Linear => [low, if high > low { high } else { low + 1.0 }],
    }
}

/// Round values in a range, about `count` of them.
fn linear_ticks([low, high]: [f64; 2], count: f64) -> Vec<f64> {
    let rough = (high - low) / count;
    let decade = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|s| *s >= rough).unwrap_or(rough);
    let mut tick = (low / step).ceil() * step;
    let mut ticks = Vec::new();
    while tick <= high + 1e-9 * step && ticks.len() < 20 {
        ticks.push(if tick.abs() < 1e-9 * step { 0.0 } else { tick });
        tick += step;
    }
    ticks
}

fn power_of_ten(decade: i32) -> String {
    match decade {
        0 => "1".into(),
        1 => "10".into(),
        _ => format!("10{}", superscript(decade)),
    }
}

fn superscript(value: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let digit = |c: char| c.to_digit(10).and_then(|d| DIGITS.get(usize::try_from(d).ok()?)).copied();
    value.to_string().chars().map(|c| digit(c).unwrap_or('⁻')).collect()
}

/// Short and exact enough for an axis; powers of ten as such.
pub fn number(value: f64) -> String {
    let size = value.abs();
    if size >= 1e5 || (size > 0.0 && size < 1e-3) {
        #[expect(clippy::cast_possible_truncation, reason = "decades of a finite number")]
        let decade = size.log10().floor() as i32;
        let lead = number((value / 10f64.powi(decade) * 1e3).round() / 1e3);
        return if lead == "1" { power_of_ten(decade) } else { format!("{lead}·{}", power_of_ten(decade)) };
    }
    let text = format!("{value:.3}");
    let text = text.trim_end_matches('0').trim_end_matches('.').replace('-', "−");
    if text == "−0" { "0".into() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(range: [f64; 2], scale: Scale) -> Axis {
        Axis { range, scale, start_px: 10.0, length_px: 100.0 }
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(linear_ticks([0.0, 10.0], 4.0).len(), 3);
        assert!(linear_ticks([-0.37, 0.21], 4.0).iter().all(|t| (-0.37..=0.21).contains(t)));
        let log = axis([1e-3, 1e1], Scale::Log);
        let labels: Vec<String> = log.ticks().into_iter().map(|(_, label)| label).collect();
        assert_eq!(labels, ["10⁻³", "10⁻²", "10⁻¹", "1", "10"]);
        assert_eq!(log.minor_ticks().len(), 32);
        assert!((log.place(1e-1) - 60.0).abs() < 1e-9);
        assert!(axis([1e-16, 1e4], Scale::Log).ticks().len() <= 9);
    }

    #[test]
    fn numbers_are_short_and_have_a_real_minus() {
        let shown = [0.0, -0.25, 100.0, 2.5e-5, 1e6, -3e7].map(number);
        assert_eq!(shown, ["0", "−0.25", "100", "2.5·10⁻⁵", "10⁶", "−3·10⁷"]);
    }

    #[test]
    fn a_range_of_nothing_or_of_one_value_is_still_one() {
        let [low, high] = range([f64::NAN, -1.0].into_iter(), Scale::Log, true);
        assert!(low > 0.0 && high > low && high.is_finite());
        let [low, high] = range([3.0, 3.0].into_iter(), Scale::Linear, true);
        assert!(low < 3.0 && high > 3.0);
    }
}
