//! Requests of an operator: when they make sense, and their labels. The daemon decides; this only greys out buttons.

use moca_msgs::{GripperRequest, Law, Mode, Request};

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
        Request::Gripper(request) => match request {
            GripperRequest::Home => "Home",
            GripperRequest::Move { .. } => "Move to width",
            GripperRequest::Grasp { .. } => "Grasp",
            GripperRequest::Release => "Open",
            GripperRequest::Stop => "Stop fingers",
        },
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
        Request::Gripper(request) => match request {
            GripperRequest::Home => {
                "Open, close and open the fingers to find their range. It lets go of an object."
            }
            GripperRequest::Move { .. } => {
                "Move the fingers to the width. A larger one than the object's lets go of it."
            }
            GripperRequest::Grasp { .. } => {
                "Close the fingers on an object of the width, and hold it with the force."
            }
            GripperRequest::Release => "Open the fingers as far as they go. It lets go of an object.",
            GripperRequest::Stop => "Stop the fingers where they are. An object that is held stays held.",
        },
        _ => "",
    }
}

/// Returns true if the daemon would take it in `mode`; `None` is a daemon without a known mode. A stop, of the robot or
/// of its fingers, is never greyed out.
pub fn fits(request: Request, mode: Option<Mode>) -> bool {
    let stops = matches!(request, Request::Stop | Request::Gripper(GripperRequest::Stop));
    stops || mode.is_some_and(|mode| request.taken_in().contains(&mode))
}

/// A request as a sentence about it begins.
pub fn request_text(request: Request) -> String {
    let mut text = request.to_string();
    text[..1].make_ascii_uppercase();
    text
}
