//! Division of a control period into physics steps: as the scene says, or as many as an accuracy asks for.

use crate::SimError;
use crate::people::{People, Stage};

/// Scale of an error of 1: the force of an impact that people tolerate (ISO/TS 15066 allows more), N, and the error of the paper's
/// flange, m and rad.
const SCALE_N: f64 = 25.0;
const SCALE_M: f64 = 0.015;
/// A period in which somebody is first touched, or let go, sets out or steps away, takes at least this many steps at an
/// accuracy of 1e-3, and of second order more for a finer one: halved steps hardly see when within a step that falls.
const AT_TOUCH: u32 = 32;
const AT_TOUCH_FOR: f64 = 1e-3;
/// No period takes more: 1 µs each at 1 kHz.
const STEPS_MAX: u32 = 1024;
/// Half as many steps are tried in the next period if the error is below this share of what was asked for: of second order,
/// twice the step has four times the error.
const COARSEN_BELOW: f64 = 0.125;

/// Cost of the chosen steps so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepsSpent {
    /// Control periods.
    pub periods: u64,
    /// Physics steps of them, those of the estimates included.
    pub steps: u64,
    /// Physics steps whose result was kept.
    pub kept: u64,
    /// Periods that were not within the accuracy with the most steps.
    pub missed: u64,
}

/// The number of steps that is chosen, and a period's start.
#[derive(Clone, Debug)]
pub(crate) struct Stepping {
    accuracy: f64,
    least: u32,
    at_touch: u32,
    /// Steps of the coarser of two runs through a period.
    steps: u32,
    pub spent: StepsSpent,
}

/// Everything that a period changes.
#[derive(Debug)]
pub(crate) struct Start {
    pub(crate) time_s: f64,
    pub(crate) positions: Vec<f64>,
    pub(crate) rates: Vec<f64>,
    pub(crate) people: People,
    pub(crate) contact_peak_n: f64,
}

/// State by which two runs through a period are compared.
#[derive(Debug, Default)]
pub(crate) struct End {
    pub(crate) positions: Vec<f64>,
    pub(crate) forces_n: Vec<f64>,
    /// Stages of all people, [`People::stages`].
    pub(crate) stages: Vec<Stage>,
}

/// Simulation that can go through a period again.
pub(crate) trait Repeatable {
    fn start(&self) -> Start;
    fn put_back(&mut self, start: &Start);
    /// Runs a number of physics steps of this length.
    fn run(&mut self, steps: u32, step_s: f64) -> Result<(), SimError>;
    fn end(&self) -> End;
}

impl End {
    fn off(&self, other: &Self) -> f64 {
        let largest = |a: &[f64], b: &[f64], scale: f64| {
            a.iter().zip(b).map(|(a, b)| (a - b).abs() / scale).fold(0.0, f64::max)
        };
        largest(&self.positions, &other.positions, SCALE_M).max(largest(
            &self.forces_n,
            &other.forces_n,
            SCALE_N,
        ))
    }
}

impl Stepping {
    /// `least` is the scene's own number of steps.
    pub(crate) fn new(accuracy: f64, least: u32) -> Self {
        let finer = (AT_TOUCH_FOR / accuracy).sqrt().clamp(1.0, f64::from(STEPS_MAX / AT_TOUCH));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "32 to 1024")]
        let at_touch = (f64::from(AT_TOUCH) * finer) as u32;
        Self { accuracy, least, at_touch, steps: least, spent: StepsSpent::default() }
    }

    /// Takes `plant` through one control period.
    pub(crate) fn period(&mut self, plant: &mut impl Repeatable, period_s: f64) -> Result<(), SimError> {
        let start = plant.start();
        let before: Vec<Stage> = start.people.stages(start.time_s).collect();
        let mut coarse = self.through(plant, self.steps, period_s)?;
        loop {
            let twice = 2 * self.steps;
            plant.put_back(&start);
            let fine = self.through(plant, twice, period_s)?;
            let error = fine.off(&coarse);
            let changes = fine.stages != before || coarse.stages != before;
            let enough = error <= self.accuracy && (!changes || twice >= self.at_touch);
            if enough || 2 * twice > STEPS_MAX {
                self.spent.periods += 1;
                self.spent.kept += u64::from(twice);
                self.spent.missed += u64::from(!enough);
                if error < COARSEN_BELOW * self.accuracy {
                    self.steps = (self.steps / 2).max(self.least);
                }
                return Ok(());
            }
            (coarse, self.steps) = (fine, twice);
        }
    }

    fn through(&mut self, plant: &mut impl Repeatable, steps: u32, period_s: f64) -> Result<End, SimError> {
        plant.run(steps, period_s / f64::from(steps))?;
        self.spent.steps += u64::from(steps);
        Ok(plant.end())
    }
}
