//! A daemon that exists only as what it says and what it was asked, and a window in front of it.

use egui::{Event, Modifiers, PointerButton, Pos2};
use egui_kittest::{Harness, kittest::Queryable};
use moca_monitor::{
    logic::source::{live::Live, playback::Playback},
    ui::App,
};
use moca_msgs::{Fault, GripperState, Mode, Request, Sample, TaxelReading, TaxelStatus, board::Diagnosis};
use moca_telemetry::{
    ParameterDescription, ParameterForm, ParameterValue, RobotDescription,
    calibration::{CalibrationProgress, CalibrationRequest},
    net::{Commander, Link, Reply, Status, Update},
};
use std::{cell::RefCell, collections::VecDeque, rc::Rc, sync::Arc};

/// A daemon that exists only as what it says and what it was asked.
#[derive(Default)]
pub(crate) struct Daemon {
    pub(crate) down: Option<String>,
    pub(crate) simulated: bool,
    pub(crate) no_cover: bool,
    pub(crate) commander: Commander,
    pub(crate) samples: VecDeque<Sample>,
    pub(crate) replies: Vec<Reply>,
    pub(crate) asked: Vec<Request>,
    pub(crate) parameters: Vec<ParameterDescription>,
    pub(crate) calibration: CalibrationProgress,
    pub(crate) calibrate: Vec<CalibrationRequest>,
    pub(crate) session: u64,
    pub(crate) signs_of_life: u32,
}

#[derive(Clone)]
pub(crate) struct Fake(pub(crate) Rc<RefCell<Daemon>>);

impl Live for Fake {
    fn poll(&mut self) -> Update {
        let mut daemon = self.0.borrow_mut();
        let parameters = daemon.parameters.clone();
        let mut robot = RobotDescription::paper("test robot", daemon.simulated);
        if daemon.no_cover {
            robot.taxels.clear();
        }
        let description = Arc::new(RobotDescription { parameters, ..robot });
        let link = match &daemon.down {
            Some(reason) => Link::Down { reason: reason.clone() },
            None => Link::Up { session: daemon.session, description },
        };
        let samples = daemon.samples.drain(..).collect();
        let replies = std::mem::take(&mut daemon.replies);
        Update {
            link,
            status: Status { commander: daemon.commander, ..Status::default() },
            samples,
            replies,
            calibration: daemon.calibration.clone(),
            notices: Vec::new(),
            unread_dropped: 0,
        }
    }

    fn alive(&mut self) {
        self.0.borrow_mut().signs_of_life += 1;
    }

    fn request(&mut self, request: Request) {
        self.0.borrow_mut().asked.push(request);
    }

    fn calibrate(&mut self, request: CalibrationRequest) {
        self.0.borrow_mut().calibrate.push(request);
    }
}

pub(crate) struct Bench {
    pub(crate) daemon: Rc<RefCell<Daemon>>,
    pub(crate) harness: Harness<'static, App>,
    pub(crate) tick: u64,
    pub(crate) masked: Option<usize>,
    pub(crate) board: Diagnosis,
    pub(crate) gripper: Option<GripperState>,
}

impl Bench {
    pub(crate) fn new() -> Self {
        let daemon = Rc::new(RefCell::new(Daemon { simulated: true, session: 1, ..Daemon::default() }));
        let app =
            App::new(&egui::Context::default(), Fake(Rc::clone(&daemon)), "127.0.0.1:7611".into(), None);
        let harness = Harness::builder().with_size([1280.0, 800.0]).build_ui_state(
            |ui, app: &mut App| {
                app.update(&ui.ctx().clone());
                app.show(ui);
            },
            app,
        );
        Self { daemon, harness, tick: 0, masked: None, board: Diagnosis::Frames, gripper: None }
    }

    pub(crate) fn in_mode(mode: Mode) -> Self {
        let mut bench = Self::new();
        bench.frames(mode, None);
        bench
    }

    /// A few frames, each with a fresh sample.
    pub(crate) fn frames(&mut self, mode: Mode, fault: Option<Fault>) {
        for _ in 0..3 {
            let mut sample = sample(self.tick, mode, fault);
            if let Some(taxel) = self.masked {
                sample.taxels[taxel].status = TaxelStatus::Masked;
            }
            sample.board = self.board;
            sample.gripper = self.gripper;
            self.tick += 1;
            self.daemon.borrow_mut().samples.push_back(sample);
            self.harness.step();
        }
    }

    pub(crate) fn asked(&self) -> Vec<Request> {
        std::mem::take(&mut self.daemon.borrow_mut().asked)
    }

    pub(crate) fn click(&mut self, label: &str) {
        self.harness.get_by_label(label).click();
        let latest = self.harness.state().model().latest.clone();
        let (mode, fault) = latest.map_or((Mode::Starting, None), |s| (s.mode, s.fault));
        self.frames(mode, fault);
    }

    pub(crate) fn pointer(&mut self, pos: Pos2, pressed: bool) {
        self.harness.hover_at(pos);
        self.harness.event(Event::PointerButton {
            pos,
            button: PointerButton::Primary,
            pressed,
            modifiers: Modifiers::NONE,
        });
    }

    pub(crate) fn shows(&self, text: &str) -> bool {
        self.harness.query_all_by_label_contains(text).next().is_some()
    }
}

pub(crate) fn sample(tick: u64, mode: Mode, fault: Option<Fault>) -> Sample {
    let mut sample = Sample {
        tick,
        time_ns: tick * 1_000_000,
        mode,
        fault,
        board: Diagnosis::Frames,
        frame_age_s: 0.02,
        ..Sample::default()
    };
    sample.q_rad.extend(moca_msgs::robot::PANDA.home_rad);
    sample.taxels.extend([TaxelReading { force_n: 0.0, status: TaxelStatus::Ok }; 11]);
    sample.counts.extend([720; 11]);
    sample
}

pub(crate) fn parameter(name: &str, form: ParameterForm, value: &[f64], live: bool) -> ParameterDescription {
    ParameterDescription {
        name: name.into(),
        form,
        units: vec!["N·s/m".into()],
        min: 0.0,
        max: 1000.0,
        live,
        description: "What it is for.".into(),
        default: ParameterValue::Numbers(value.to_vec()),
        value: ParameterValue::Numbers(value.to_vec()),
    }
}

/// A log whose robot moves all the time.
pub(crate) fn moving_log() -> Playback {
    let samples = (0..1000).map(|tick| sample(tick, Mode::Impedance, None));
    Playback::of(RobotDescription::paper("logged robot", true), samples.collect())
}
