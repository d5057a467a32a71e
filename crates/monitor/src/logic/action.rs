//! What an operator may ask, and when it makes sense. The daemon has the last word; this only greys out buttons.

use moca_msgs::params::CONTROLLER;
use moca_msgs::{Law, Mode, Refusal, Request};

/// A button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Measure the cover's zero.
    Tare,
    /// Hand the robot to the law.
    Arm,
    /// Take it back.
    Disarm,
    /// Choose the law.
    Select(Law),
    /// Leave the protective stop.
    Resume,
    /// Protective stop. Always allowed.
    Stop,
}

impl Action {
    /// The request behind the button.
    pub fn request(self) -> Request {
        match self {
            Self::Tare => Request::Tare,
            Self::Arm => Request::Arm,
            Self::Disarm => Request::Disarm,
            Self::Select(law) => Request::SelectLaw(law),
            Self::Resume => Request::Resume,
            Self::Stop => Request::Stop,
        }
    }

    /// What is written on the button, which is also its accessible label.
    pub fn label(self) -> &'static str {
        match self {
            Self::Tare => "Tare",
            Self::Arm => "Arm",
            Self::Disarm => "Disarm",
            Self::Select(Law::Impedance) => "Impedance",
            Self::Select(Law::FollowMe) => "Follow-me",
            Self::Resume => "Resume",
            Self::Stop => "STOP (space)",
        }
    }

    /// What the button does, for a tooltip.
    pub fn explanation(self) -> &'static str {
        match self {
            Self::Tare => "Measure the cover's zero. Nobody may touch the robot.",
            Self::Arm => "Hand the robot to the chosen law: it moves when it is touched.",
            Self::Disarm => "Take the robot back: it holds still.",
            Self::Select(Law::Impedance) => "The flange keeps its place, the base gives way.",
            Self::Select(Law::FollowMe) => "Base and arm follow the hand.",
            Self::Resume => "Leave the protective stop, once its cause is gone.",
            Self::Stop => "Protective stop: the base stops, the arm holds.",
        }
    }

    /// Whether the daemon would take it in `mode`; `None` is a daemon that has not said its mode yet.
    pub fn fits(self, mode: Option<Mode>) -> bool {
        match self {
            Self::Stop => true,
            Self::Tare => matches!(mode, Some(Mode::Ready | Mode::ProtectiveStop)),
            Self::Arm => mode == Some(Mode::Ready),
            Self::Disarm => mode.is_some_and(Mode::moves),
            Self::Select(_) => mode.is_some_and(|m| m != Mode::Fault),
            Self::Resume => mode == Some(Mode::ProtectiveStop),
        }
    }
}

/// A request in words.
pub fn request_words(request: Request) -> String {
    match request {
        Request::Tare => "Tare".into(),
        Request::Arm => "Arm".into(),
        Request::Disarm => "Disarm".into(),
        Request::SelectLaw(law) => format!("Select {}", Mode::from(law).name()),
        Request::Stop => "Stop".into(),
        Request::OperatorLost => "Stop, operator lost".into(),
        Request::Resume => "Resume".into(),
        Request::PressTaxel { taxel, force_n } if force_n > 0.0 => {
            format!("Push T{} with {force_n:.0} N", u16::from(taxel) + 1)
        }
        Request::PressTaxel { taxel, .. } => format!("Let go of T{}", u16::from(taxel) + 1),
        Request::MaskTaxel { taxel, masked } => {
            format!("{} T{}", if masked { "Mask" } else { "Use" }, u16::from(taxel) + 1)
        }
        Request::SetParameter { parameter, .. } => match CONTROLLER.get(usize::from(parameter)) {
            Some(spec) => format!("Set {}", spec.name),
            None => format!("Set parameter {parameter}"),
        },
    }
}

/// A refusal in words, with what to do.
pub fn refusal_words(refusal: Refusal) -> String {
    match refusal {
        Refusal::Mode(mode) => format!("not possible in mode {}", mode.name()),
        Refusal::CauseRemains(fault) => format!("the cause remains. {} {}", fault.text(), fault.remedy()),
        Refusal::ZeroInvalid => "the cover has no valid zero: tare first".into(),
        Refusal::NoRobot => "the daemon runs a cover without a robot".into(),
        Refusal::NotSimulated => "only a simulated robot can be pushed with the mouse".into(),
        Refusal::OutOfRange => "a number is out of range".into(),
        Refusal::NoSuchParameter => "the daemon has no such parameter".into(),
        Refusal::NotLive => "it is read at the start only: change the configuration file".into(),
        Refusal::Conflict => {
            "it does not go with another parameter (null_space_damping needs a virtual mass of 0.5 or more)"
                .into()
        }
        Refusal::NotCommander => {
            "another dashboard has the command: close it, or let it give the command back".into()
        }
        Refusal::NoAnswer => "the daemon does not answer".into(),
    }
}
