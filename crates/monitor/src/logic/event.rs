//! Changes worth a mark on the axis of time.

use moca_msgs::{Fault, Mode, protection::ContactEvent};

/// A change of mode or fault, or a contact that crossed a limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// When, s of loop time.
    pub time_s: f64,
    /// Mode from then on.
    pub mode: Mode,
    /// Fault from then on.
    pub fault: Option<Fault>,
    /// The contact that crossed a limit, if that is what happened.
    pub contact: Option<ContactEvent>,
}

impl Event {
    /// One line for the user.
    pub fn text(&self) -> String {
        match (self.contact, self.fault) {
            (Some(contact), _) => contact.to_string(),
            (None, Some(fault)) => format!("{}: {fault}", self.mode.name()),
            (None, None) => self.mode.name().to_owned(),
        }
    }
}

/// The event nearest to `time_s`, if one is within `reach_s`.
pub fn nearest<'a>(
    events: impl IntoIterator<Item = &'a Event>,
    time_s: f64,
    reach_s: f64,
) -> Option<&'a Event> {
    let distance = |event: &Event| (event.time_s - time_s).abs();
    let nearest = events.into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    (distance(nearest) <= reach_s).then_some(nearest)
}
