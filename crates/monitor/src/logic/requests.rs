//! Requests of an operator: when they make sense, and their labels. The daemon decides; this only greys out buttons.

use moca_msgs::{Law, Mode, Request};

/// Returns the label of a request's button, also its accessible label; empty for requests without one.
pub fn label(request: Request) -> &'static str {
    match request {
        Request::Tare => "Tare",
        Request::Arm => "Arm",
        Request::Disarm => "Disarm",
        Request::SelectLaw(Law::Impedance) => "Impedance",
        Request::SelectLaw(Law::FollowMe) => "Follow-me",
        Request::Resume => "Resume",
        Request::Recentre => "Recentre",
        Request::Stop => "STOP (space)",
        _ => "",
    }
}

/// Returns the tooltip of a request's button.
pub fn explanation(request: Request) -> &'static str {
    match request {
        Request::Tare => "Measure the cover's zero. Nobody may touch the robot.",
        Request::Arm => "Hand the robot to the chosen law: it moves when it is touched.",
        Request::Disarm => "Take the robot back: it holds still.",
        Request::SelectLaw(Law::Impedance) => "The flange keeps its place, the base gives way.",
        Request::SelectLaw(Law::FollowMe) => "Base and arm follow the hand.",
        Request::Resume => "Leave the protective stop, once its cause is gone.",
        Request::Recentre => "Drive the base slowly back under the arm. A touch ends it.",
        Request::Stop => "Protective stop of every robot that is connected: the base stops, the arm holds.",
        _ => "",
    }
}

/// Returns true if the daemon would take it in `mode`; `None` is a daemon without a known mode. A stop is never greyed out.
pub fn fits(request: Request, mode: Option<Mode>) -> bool {
    request == Request::Stop || mode.is_some_and(|mode| request.taken_in().contains(&mode))
}

/// A request as a sentence about it begins.
pub fn request_text(request: Request) -> String {
    let mut text = request.to_string();
    text[..1].make_ascii_uppercase();
    text
}
