//! Colours that mean something, for light and dark.

use crate::logic::limited::Limited;
use egui::{Color32, Visuals};
use moca_msgs::Mode;

/// Colours of curves, far apart for eyes of every kind (Okabe and Ito), then tints of them.
const CURVES: [Color32; 11] = [
    Color32::from_rgb(0, 114, 178),
    Color32::from_rgb(213, 94, 0),
    Color32::from_rgb(0, 158, 115),
    Color32::from_rgb(204, 121, 167),
    Color32::from_rgb(230, 159, 0),
    Color32::from_rgb(86, 180, 233),
    Color32::from_rgb(160, 140, 0),
    Color32::from_rgb(150, 90, 200),
    Color32::from_rgb(180, 60, 60),
    Color32::from_rgb(90, 130, 90),
    Color32::from_rgb(140, 140, 140),
];

/// Colour of the n-th curve of a plot.
pub(super) fn curve(index: usize) -> Color32 {
    CURVES[index % CURVES.len()]
}

/// Everything is well.
pub(super) const GOOD: Color32 = Color32::from_rgb(0, 140, 95);
/// Look at it.
pub(super) const WARNING: Color32 = Color32::from_rgb(214, 130, 0);
/// It has stopped, or will.
pub(super) const BAD: Color32 = Color32::from_rgb(205, 45, 40);
/// The arrow of the base's force.
pub(super) const WRENCH: Color32 = Color32::from_rgb(213, 94, 0);
/// The arc of the base's moment.
pub(super) const MOMENT: Color32 = Color32::from_rgb(160, 140, 0);

/// The arrow of the force on the flange.
pub(super) const FLANGE_WRENCH: Color32 = Color32::from_rgb(150, 90, 200);
/// The double arrow of the moment on the flange.
pub(super) const FLANGE_MOMENT: Color32 = Color32::from_rgb(86, 180, 233);

/// Share by which a value held at its limit may exceed it.
pub(super) const OVER: f64 = 1.05;

/// Colour of a share of a limit; one that is not known is as bad as one that is passed.
pub(super) fn share(part: f64) -> Color32 {
    match part {
        r if r < 0.5 => GOOD,
        r if r < OVER => WARNING,
        _ => BAD,
    }
}

/// Colour of a mode, dark enough for white text.
pub(super) fn mode(mode: Option<Mode>) -> Color32 {
    match mode {
        None | Some(Mode::Starting) => Color32::from_rgb(105, 105, 105),
        Some(Mode::Taring) => Color32::from_rgb(125, 90, 170),
        Some(Mode::Ready) => Color32::from_rgb(0, 100, 160),
        Some(Mode::Impedance | Mode::FollowMe) => Color32::from_rgb(0, 120, 80),
        Some(Mode::ProtectiveStop) => Color32::from_rgb(185, 85, 0),
        Some(Mode::Fault) => Color32::from_rgb(185, 30, 30),
    }
}

/// Colour of a force from 0 to `max_n`: from the background's grey over yellow to red.
pub(super) fn force(force_n: f64, max_n: f64, visuals: &Visuals) -> Color32 {
    #[expect(clippy::cast_possible_truncation, reason = "a fraction")]
    let part = (force_n / max_n).limited(0.0, 1.0).sqrt() as f32;
    let none = if visuals.dark_mode { Color32::from_gray(70) } else { Color32::from_gray(200) };
    let (from, to, part) = if part < 0.5 {
        (none, Color32::from_rgb(235, 180, 20), part * 2.0)
    } else {
        (Color32::from_rgb(235, 180, 20), BAD, part * 2.0 - 1.0)
    };
    from.lerp_to_gamma(to, part)
}

/// Text colour that stands out on a panel: black or white.
pub(super) fn strong(visuals: &Visuals) -> Color32 {
    if visuals.dark_mode { Color32::WHITE } else { Color32::BLACK }
}
