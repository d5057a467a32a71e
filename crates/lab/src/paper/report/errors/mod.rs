//! Errors of the printed figures: step of the physics, phase of the sensor, noise.
//!
//! Each closed loop is run at the printed step, at half of it, and by the leapfrog at a quarter and an eighth of a
//! millisecond. The last of these is the limit, up to its last step's change.

mod scenes;

use anyhow::{Context, Result, ensure};
use moca_experiments::parallel;
use std::fmt::Write as _;

/// Seeds after the printed one.
const SEEDS: [u64; 3] = [0, 1, 2];

/// A figure that is printed: of which push or cell, name with unit, digits after the point, value.
#[derive(Clone, Debug)]
struct Figure {
    item: String,
    what: &'static str,
    digits: usize,
    value: f64,
}

/// The printed step and finer ones: half of it, then the limit and the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Printed,
    Half,
    Before,
    Limit,
}

/// Difference of a run from the printed one.
#[derive(Clone, Copy, Debug)]
struct Variation {
    /// Index of the phase.
    phase: usize,
    /// Added to the seed.
    seed: u64,
    step: Step,
}

/// One closed loop with the figures that it prints.
struct Scene {
    /// Phases of the sensor that it is run in; none, if no sensor has any.
    phases: usize,
    /// True if the printed phase is the one with the largest first figure; else it is the first phase.
    worst: bool,
    /// True if anything in it is random.
    seeds: bool,
    run: Box<dyn Fn(Variation) -> Result<Vec<Figure>> + Send + Sync>,
}

/// A figure with its errors.
#[derive(Clone, Debug)]
struct Bar {
    printed: Figure,
    half: f64,
    before: f64,
    limit: f64,
    /// Least and most.
    by_phase: Option<[f64; 2]>,
    by_seed: Option<[f64; 2]>,
}

impl Scene {
    fn bars(&self) -> Result<Vec<Bar>> {
        let at = |phase, seed, step| (self.run)(Variation { phase, seed, step });
        let mut by_phase = Vec::new();
        for phase in 0..self.phases.max(1) {
            by_phase.push(at(phase, 0, Step::Printed)?);
        }
        let first = |figures: &[Figure]| figures.first().map_or(f64::NEG_INFINITY, |figure| figure.value);
        let hardest =
            (0..by_phase.len()).max_by(|&a, &b| first(&by_phase[a]).total_cmp(&first(&by_phase[b])));
        let phase = hardest.filter(|_| self.worst).unwrap_or(0);
        let printed = by_phase[phase].clone();
        let [half, before, limit] = [Step::Half, Step::Before, Step::Limit].map(|step| at(phase, 0, step));
        let (half, before, limit) = (half?, before?, limit?);
        let mut by_seed = vec![printed.clone()];
        for &seed in SEEDS.iter().skip(1).filter(|_| self.seeds) {
            by_seed.push(at(phase, seed, Step::Printed)?);
        }
        let finer = [&half, &before, &limit];
        let same = |run: &&Vec<Figure>| run.len() == printed.len();
        ensure!(finer.iter().all(same), "a run that ended early has no error: {printed:?}");
        let spread = |runs: &[Vec<Figure>], i: usize| {
            let values = || runs.iter().filter_map(|run| run.get(i)).map(|figure| figure.value);
            let ends = [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)];
            (runs.len() > 1).then_some(ends)
        };
        let bar = |(i, printed): (usize, &Figure)| Bar {
            printed: printed.clone(),
            half: half[i].value,
            before: before[i].value,
            limit: limit[i].value,
            by_phase: spread(&by_phase, i),
            by_seed: spread(&by_seed, i),
        };
        Ok(printed.iter().enumerate().map(bar).collect())
    }
}

impl Bar {
    fn off(&self) -> f64 {
        self.printed.value - self.limit
    }

    /// The row of this figure; `all` are those of its name in its group.
    fn row(&self, group: &str, all: &[&Self]) -> String {
        let Figure { item, what, digits, value } = &self.printed;
        let digits = *digits;
        let of = |item: &str| if all.len() > 1 { format!(" ({item})") } else { String::new() };
        let signed = |off: f64| format!("{off:+.digits$}");
        let width = |ends: Option<[f64; 2]>| ends.map_or(f64::NEG_INFINITY, |[least, most]| most - least);
        let spread = |pick: fn(&Self) -> Option<[f64; 2]>| {
            let widest = all.iter().max_by(|a, b| width(pick(a)).total_cmp(&width(pick(b))));
            match widest.and_then(|widest| Some((widest, pick(widest)?))) {
                Some((widest, [least, most])) => {
                    let whose = &widest.printed.item;
                    let whose = if whose == item { String::new() } else { of(whose) };
                    format!("{least:.digits$} to {most:.digits$}{whose}")
                }
                None => "–".into(),
            }
        };
        format!(
            "| {group} | {what}{} | {value:.digits$} | {:.digits$} | {} | {} | {} | {} | {} |",
            of(item),
            self.limit,
            signed(self.off()),
            signed(2.0 * (value - self.half)),
            signed(self.limit - self.before),
            spread(|bar| bar.by_phase),
            spread(|bar| bar.by_seed),
        )
    }
}

/// The rows of a group: of several figures of one name, the one that is furthest off, and the widest spreads.
fn rows_of(group: &str, bars: &[Bar]) -> Vec<String> {
    let mut names: Vec<&str> = Vec::new();
    for bar in bars {
        if !names.contains(&bar.printed.what) {
            names.push(bar.printed.what);
        }
    }
    let row = |what: &&str| {
        let all: Vec<&Bar> = bars.iter().filter(|bar| bar.printed.what == *what).collect();
        let worst = all.iter().max_by(|a, b| a.off().abs().total_cmp(&b.off().abs()));
        worst.map(|worst| worst.row(group, &all))
    };
    names.iter().filter_map(row).collect()
}

/// The rows of the groups that `chosen` picks by name.
pub(crate) fn rows(chosen: impl Fn(&str) -> bool) -> Result<Vec<String>> {
    let mut scenes = Vec::new();
    for (name, make) in scenes::GROUPS.iter().filter(|(name, _)| chosen(name)) {
        scenes.extend(make()?.into_iter().map(|scene| (*name, scene)));
    }
    let of = |(name, scene): &(&str, Scene)| scene.bars().with_context(|| (*name).to_owned());
    let bars = parallel::run("error bars", &scenes, of)?;
    let mut rows = Vec::new();
    for (name, _) in scenes::GROUPS.iter().filter(|(name, _)| chosen(name)) {
        let own = scenes.iter().zip(&bars).filter(|((group, _), _)| group == name);
        rows.extend(rows_of(name, &own.flat_map(|(_, bars)| bars.clone()).collect::<Vec<_>>()));
    }
    Ok(rows)
}

/// Every figure with its errors as a table in Markdown.
pub(crate) fn markdown() -> Result<String> {
    let mut out = String::from(
        "| run | figure | printed | limit | error of the step | as half the step says | limit's own | by sensor phase | by seed |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for row in rows(|_| true)? {
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{row}");
    }
    Ok(out)
}
