//! The jog pad: as long as a button is held the flange moves, at most a window's picture longer than the daemon allows.

use crate::logic::{
    model::{Freshness, Model},
    requests::fits,
};
use crate::ui::{requests::PageRequests, row, view::View};
use egui::{Button, RichText, Sense, Slider, Ui};
use moca_msgs::target::{SPEED_MAX_M_S, SPEED_MAX_RAD_S};
use moca_msgs::{Request, Target, TimedTarget, TwistAxes};

/// Turning speed for each m/s of the slider, rad/m.
const TURN_RAD_M: f64 = SPEED_MAX_RAD_S / SPEED_MAX_M_S;
/// Labels of the buttons, and their elements of the twist.
const BUTTONS: [(&str, usize, f64); 12] = [
    ("−x", 0, -1.0),
    ("+x", 0, 1.0),
    ("−y", 1, -1.0),
    ("+y", 1, 1.0),
    ("−z", 2, -1.0),
    ("+z", 2, 1.0),
    ("−roll", 3, -1.0),
    ("+roll", 3, 1.0),
    ("−pitch", 4, -1.0),
    ("+pitch", 4, 1.0),
    ("−yaw", 5, -1.0),
    ("+yaw", 5, 1.0),
];

/// Draws the pad where there is a flange that could be led, and asks for what is held.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View, now_s: f64, pressed: &mut PageRequests) {
    if model.recorded || !model.robot.has_arm() {
        return;
    }
    let (speed, axes) = &mut view.jog;
    let mode = model.live_mode(now_s);
    let possible = model.freshness(now_s) == Freshness::Live && fits(Request::EndTarget, mode);
    ui.horizontal_wrapped(|ui| {
        let label = ui.label("Jog");
        let hint =
            "Press and hold a button: the flange moves in these axes, within the arm's reach and the leash";
        for (name, choice) in
            [("world", TwistAxes::World), ("base", TwistAxes::Base), ("flange", TwistAxes::Flange)]
        {
            ui.selectable_value(axes, choice, name);
        }
        // In a row of its own: it is drawn before its width is known, and does not go to the next row by itself.
        ui.end_row();
        let slider = Slider::new(speed, 0.01..=SPEED_MAX_M_S).suffix(" m/s").fixed_decimals(2);
        ui.add(slider).labelled_by(label.id).on_hover_text("Speed; 4 rad for each metre");
        ui.end_row();
        for (name, element, sign) in BUTTONS {
            let button = Button::new(name).sense(Sense::click_and_drag());
            let button = ui.add_enabled(possible, button).on_hover_text(hint);
            if button.is_pointer_button_down_on() {
                let mut twist = [0.0; 6];
                twist[element] = sign * *speed * if element < 3 { 1.0 } else { TURN_RAD_M };
                let target = TimedTarget::new(Target::Twist { axes: *axes, twist });
                pressed.requests.push(Request::Target(target));
                ui.ctx().request_repaint();
            }
            if button.drag_stopped() || button.clicked() {
                pressed.requests.push(Request::EndTarget);
            }
        }
        if let Some(target) = model.latest.as_ref().and_then(|sample| sample.target) {
            row::rest(ui, RichText::new(format!("{}: {}", target.kind.name(), target.phase.name())).weak());
        }
    });
}
