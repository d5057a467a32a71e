//! Choices of the user about the view.

use crate::logic::{
    camera::OrbitCamera,
    event::Event,
    gripper::Draft,
    model::Model,
    signals::{axis::TimeAxis, history::History},
};
use moca_msgs::TwistAxes;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Range;

/// View of one robot.
pub(super) struct View {
    /// The plots' axis of time.
    pub(super) axis: TimeAxis,
    /// Range of a log's strip, s of loop time; `None` is all.
    pub(super) strip_s: Option<Range<f64>>,
    /// Place of the mouse on the axis of time, s of loop time.
    pub(super) cursor_s: Option<f64>,
    /// Contents of the plots when they were paused: they stay, however long that is.
    paused: Option<Box<Paused>>,
    /// Force of a push with the mouse, N.
    pub(super) push_n: f64,
    /// Speed of the jog pad, m/s, and in whose axes.
    pub(super) jog: (f64, TwistAxes),
    /// Numbers of the gripper's next motion.
    pub(super) gripper: Draft,
    /// Choices on the page of the calibration.
    pub(super) calibration: CalibrationChoice,
    /// Parameters that were edited and not applied yet, by number.
    pub(super) drafts: BTreeMap<usize, Vec<f64>>,
    /// From where the robot is seen on the page 3-D.
    pub(super) camera: OrbitCamera,
    /// The plate that the mouse holds pressed there, 0 is T1.
    pub(super) held_plate: Option<u8>,
}

struct Paused {
    history: History,
    events: VecDeque<Event>,
}

impl Default for View {
    fn default() -> Self {
        Self {
            axis: TimeAxis::default(),
            strip_s: None,
            cursor_s: None,
            paused: None,
            push_n: 20.0,
            jog: (0.05, TwistAxes::World),
            gripper: Draft::default(),
            calibration: CalibrationChoice::default(),
            drafts: BTreeMap::new(),
            camera: OrbitCamera::default(),
            held_plate: None,
        }
    }
}

impl View {
    /// Keeps what the plots show while they are paused. To be called whenever the axis may have been held or released.
    pub(super) fn keep_while_paused(&mut self, model: &Model) {
        if !self.axis.held() {
            self.paused = None;
        } else if self.paused.is_none() {
            let (history, events) = (model.history.clone(), model.events.clone());
            self.paused = Some(Box::new(Paused { history, events }));
        }
    }

    /// The signals that the plots show.
    pub(super) fn history<'a>(&'a self, model: &'a Model) -> &'a History {
        self.paused.as_ref().map_or(&model.history, |paused| &paused.history)
    }

    /// The events that the plots show.
    pub(super) fn events<'a>(&'a self, model: &'a Model) -> &'a VecDeque<Event> {
        self.paused.as_ref().map_or(&model.events, |paused| &paused.events)
    }
}

/// Choices on the page of the calibration.
pub(super) struct CalibrationChoice {
    /// 0 is T1.
    pub(super) taxel: u8,
    /// Presses of each taxel.
    pub(super) presses: u8,
    /// Place of the model in the fit.
    pub(super) model: usize,
    /// Taxel for whose fit the best model has been chosen.
    pub(super) model_chosen_for: Option<u8>,
    /// True while the simulated hand presses.
    pub(super) simulated_press: bool,
    /// Since when, s.
    pub(super) pressing_since_s: Option<f64>,
    /// True if the next taxel follows by itself.
    pub(super) all: bool,
    /// Taxels that are in the file.
    pub(super) done: BTreeSet<u8>,
    /// Taxels that are left out this time.
    pub(super) skipped: BTreeSet<u8>,
    /// When the next taxel begins, s.
    pub(super) next_at_s: Option<f64>,
}

impl Default for CalibrationChoice {
    fn default() -> Self {
        Self {
            taxel: 0,
            presses: 3,
            model: 0,
            model_chosen_for: None,
            simulated_press: true,
            pressing_since_s: None,
            all: false,
            done: BTreeSet::new(),
            skipped: BTreeSet::new(),
            next_at_s: None,
        }
    }
}
