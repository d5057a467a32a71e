//! The part of a robot's state that changes seldom, as text for a page.

use crate::{ears::Page, holder::Holder};
use moca_msgs::{GripperState, Mode, gripper::GripperQuantity};
use moca_telemetry::{
    calibration::CalibrationProgress,
    net::{Commander, access::CALIBRATE},
};
use serde_json::{Value, json};
use tokio::sync::watch;

/// The whole text; sent when it differs from the one before.
pub(crate) fn state(page: &Page<'_>, holder: &watch::Receiver<Option<Holder>>) -> String {
    let look = page.gateway.look.borrow();
    let (robot, sample) = (look.robot.as_ref(), &look.sample);
    let mut who = holder.borrow().as_ref().map(|holder| holder.who.clone());
    if who.is_none() && look.commander == Commander::Another {
        who = Some("another program".into());
    }
    let calibration = (page.device.role >= CALIBRATE).then(|| progress(&look.calibration));
    json!({
        "t": "state",
        "you": page.device.name,
        "role": page.device.role,
        "holder": who,
        "down": robot.is_none().then_some(&look.why),
        "name": robot.map(|robot| &robot.name),
        "simulated": robot.is_some_and(|robot| robot.simulated),
        "mode": sample.mode.name(),
        "moves": sample.mode.moves(),
        "law": sample.law.map(|law| Mode::from(law).name()),
        "fault": sample.fault.map(|fault| json!({"text": fault.text(), "remedy": fault.remedy()})),
        "gripper": sample.gripper.as_ref().map(gripper),
        "uncalibrated": robot.map(|robot| &robot.uncalibrated),
        "notice": look.notice,
        "size": robot.map(|robot| robot.base_size_m),
        "taxels": robot.map(|robot| robot.taxels.iter().map(|taxel| taxel.position_base_m).collect::<Vec<_>>()),
        "calibration": calibration,
    })
    .to_string()
}

/// Fault of a gripper, and the ranges of a grasp. What changes while its fingers move is in the pictures.
fn gripper(state: &GripperState) -> Value {
    let ranges = state.table();
    json!({
        "width_m": ranges.range(GripperQuantity::Width),
        "force_n": ranges.range(GripperQuantity::Force),
        "mass_kg": ranges.range(GripperQuantity::Mass),
        "fault": state.fault.map(|fault| json!({"text": fault.text(), "remedy": fault.remedy()})),
    })
}

/// Progress of a calibration in few words; the models of a fit with their errors.
fn progress(progress: &CalibrationProgress) -> Value {
    match progress {
        CalibrationProgress::Unavailable(why) => json!({"step": "unavailable", "text": why}),
        CalibrationProgress::Idle => json!({"step": "idle"}),
        CalibrationProgress::Rest { taxel, frames, frames_wanted } => {
            json!({"step": "rest", "taxel": taxel, "done": frames, "wanted": frames_wanted})
        }
        CalibrationProgress::Press { taxel, presses, presses_wanted, force_n, .. } => {
            // Rounded, or each frame would be a new text.
            let force_n = force_n.map(f64::round);
            json!({"step": "press", "taxel": taxel, "done": presses, "wanted": presses_wanted, "force_n": force_n})
        }
        CalibrationProgress::Fitted(fit) => {
            let models = fit.models.iter().map(|model| {
                json!({"name": model.name, "usable": model.usable, "rmse_n": model.rmse_n, "worst_n": model.worst_n})
            });
            json!({"step": "fitted", "taxel": fit.taxel, "models": models.collect::<Vec<_>>()})
        }
        CalibrationProgress::Saved { path, taxels } => {
            json!({"step": "saved", "text": path, "taxels": taxels})
        }
        CalibrationProgress::Failed(why) => json!({"step": "failed", "text": why}),
    }
}
