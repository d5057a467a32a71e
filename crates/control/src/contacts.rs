//! Contacts, taxel by taxel: how long, how hard, and whether a limit of the user's was crossed. Pure, no allocation.

use crate::config::contact_limits::ContactLimits;
use crate::robot::TAXELS;
use heapless::Deque;
use moca_msgs::protection::{ContactKind, ContactPhase, NO_ROOM_M_S, TRANSIENT_S};
use moca_msgs::{ContactEvent, ContactReaction, ContactRow, TaxelReading, TaxelStatus, seconds};
use serde::{Deserialize, Serialize};

/// Events that wait for a sample with room. A frame makes at most four a taxel, and a tick takes four away: with 4 ms
/// between frames, the sensor chip's fastest, they do not pile up.
const WAITING: usize = 4 * TAXELS;

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Contact {
    started_ns: u64,
    force_n: f64,
    peak_n: f64,
    impulse_n_s: f64,
    clamp_n_s: f64,
    clamp_s: f64,
    clamp_max_n: f64,
    crossed_n: Option<f64>,
    /// Which limits have been crossed, in the order of [`ContactKind`].
    crossed: [bool; 2],
    /// It has been said that there is no room for it.
    no_room: bool,
}

/// Every taxel's contact, and the events that no sample has carried yet.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ContactTracker {
    #[serde(with = "serde_big_array::BigArray")]
    limits: [ContactLimits; TAXELS],
    reaction: ContactReaction,
    #[serde(with = "serde_big_array::BigArray")]
    contacts: [Option<Contact>; TAXELS],
    taxels: usize,
    waiting: Deque<ContactEvent, WAITING>,
    last_ns: u64,
}

impl ContactTracker {
    /// Nothing touched yet of a cover of `taxels` taxels. `reaction` is what events say is done about a crossed limit.
    pub const fn new(taxels: usize, limits: [ContactLimits; TAXELS], reaction: ContactReaction) -> Self {
        Self { limits, reaction, contacts: [None; TAXELS], taxels, waiting: Deque::new(), last_ns: 0 }
    }

    /// Takes the readings of the tick at `now_ns`; each stands until the next tick. Returns true if any taxel is in contact.
    pub fn update(&mut self, now_ns: u64, taxels: &[TaxelReading; TAXELS]) -> bool {
        let dt_s = seconds(now_ns.saturating_sub(self.last_ns));
        self.last_ns = now_ns;
        let taxels = taxels.get(..self.taxels).unwrap_or(taxels);
        let is_touch = |reading: &TaxelReading| reading.force_n > 0.0 && reading.status == TaxelStatus::Ok;
        // most of the time nobody touches
        if !taxels.iter().any(is_touch) && !self.is_touched() {
            return false;
        }
        for (i, reading) in taxels.iter().enumerate() {
            let valid = reading.status == TaxelStatus::Ok;
            let touched = is_touch(reading);
            let Some(contact) = &mut self.contacts[i] else {
                if touched {
                    self.contacts[i] = Some(Contact::new(now_ns));
                    self.take_force(i, now_ns, reading.force_n, Some(ContactPhase::Started));
                }
                continue;
            };
            contact.stood_for(dt_s, now_ns);
            if touched {
                self.take_force(i, now_ns, reading.force_n, None);
            } else {
                let phase = if valid { ContactPhase::Finished } else { ContactPhase::Lost };
                let event = contact.event(i, phase, now_ns, self.reaction);
                self.contacts[i] = None;
                self.say(event);
            }
        }
        self.is_touched()
    }

    /// Hears what the contact barrier could not keep at `now_ns`; once a contact that is an event.
    pub fn squeezed(&mut self, now_ns: u64, rows: &[ContactRow]) {
        for row in rows.iter().filter(|row| row.excess_m_s > NO_ROOM_M_S) {
            let contact = self.contacts.get_mut(usize::from(row.taxel)).and_then(Option::as_mut);
            let Some(contact) = contact.filter(|contact| !contact.no_room) else { continue };
            contact.no_room = true;
            let event = contact.event(usize::from(row.taxel), ContactPhase::NoRoom, now_ns, self.reaction);
            self.say(ContactEvent { excess_m_s: row.excess_m_s, ..event });
        }
    }

    /// Taxels in a contact that has crossed a limit; `None` where none is.
    pub fn crossed(&self) -> Option<[bool; TAXELS]> {
        let crossed = |contact: &Contact| contact.crossed_n.is_some();
        self.contacts().iter().flatten().any(crossed).then(|| self.taxels_with(crossed))
    }

    fn is_touched(&self) -> bool {
        self.contacts().iter().any(Option::is_some)
    }

    /// Taxels in contact.
    pub fn touched(&self) -> [bool; TAXELS] {
        self.taxels_with(|_| true)
    }

    /// Returns the contacts of the existing taxels.
    fn contacts(&self) -> &[Option<Contact>] {
        self.contacts.get(..self.taxels).unwrap_or(&self.contacts)
    }

    fn taxels_with(&self, is: impl Fn(&Contact) -> bool) -> [bool; TAXELS] {
        std::array::from_fn(|i| self.contacts[i].as_ref().is_some_and(&is))
    }

    /// `taken` becomes the oldest events that no sample has carried.
    pub fn take<const N: usize>(&mut self, taken: &mut heapless::Vec<ContactEvent, N>) {
        taken.clear();
        while !taken.is_full()
            && let Some(event) = self.waiting.pop_front()
        {
            // There is room: the loop has looked.
            let _ = taken.push(event);
        }
    }

    fn take_force(&mut self, taxel: usize, now_ns: u64, force_n: f64, phase: Option<ContactPhase>) {
        let Some(contact) = &mut self.contacts[taxel] else { return };
        contact.force_n = force_n;
        contact.peak_n = contact.peak_n.max(force_n);
        let kind = contact.kind(now_ns);
        if kind == ContactKind::QuasiStatic {
            contact.clamp_max_n = contact.clamp_max_n.max(force_n);
        }
        let started = phase.map(|phase| contact.event(taxel, phase, now_ns, self.reaction));
        let limit_n = match kind {
            ContactKind::Transient => self.limits[taxel].transient_n,
            ContactKind::QuasiStatic => self.limits[taxel].quasi_static_n,
        };
        let newly = limit_n.filter(|limit_n| force_n > *limit_n && !contact.crossed[kind as usize]);
        let crossed = newly.map(|limit_n| {
            contact.crossed[kind as usize] = true;
            contact.crossed_n = Some(contact.crossed_n.map_or(limit_n, |crossed_n| crossed_n.min(limit_n)));
            contact.event(taxel, ContactPhase::LimitCrossed, now_ns, self.reaction)
        });
        for event in started.into_iter().chain(crossed) {
            self.say(event);
        }
    }

    fn say(&mut self, event: ContactEvent) {
        // Full only behind a source that chatters faster than any board: the newest is dropped.
        let _ = self.waiting.push_back(event);
    }
}

impl Contact {
    const fn new(started_ns: u64) -> Self {
        Self {
            started_ns,
            force_n: 0.0,
            peak_n: 0.0,
            impulse_n_s: 0.0,
            clamp_n_s: 0.0,
            clamp_s: 0.0,
            clamp_max_n: 0.0,
            crossed_n: None,
            crossed: [false; 2],
            no_room: false,
        }
    }

    /// The last reading stood until `now_ns`, for `dt_s`.
    fn stood_for(&mut self, dt_s: f64, now_ns: u64) {
        self.impulse_n_s += self.force_n * dt_s;
        if self.kind(now_ns) == ContactKind::QuasiStatic {
            self.clamp_n_s += self.force_n * dt_s;
            self.clamp_s += dt_s;
        }
    }

    fn duration_s(&self, now_ns: u64) -> f64 {
        seconds(now_ns.saturating_sub(self.started_ns))
    }

    fn kind(&self, now_ns: u64) -> ContactKind {
        if self.duration_s(now_ns) > TRANSIENT_S { ContactKind::QuasiStatic } else { ContactKind::Transient }
    }

    fn event(
        &self,
        taxel: usize,
        phase: ContactPhase,
        now_ns: u64,
        reaction: ContactReaction,
    ) -> ContactEvent {
        ContactEvent {
            taxel: u8::try_from(taxel).unwrap_or(u8::MAX),
            phase,
            kind: self.kind(now_ns),
            started_ns: self.started_ns,
            duration_s: self.duration_s(now_ns),
            peak_n: self.peak_n,
            clamp_mean_n: if self.clamp_s > 0.0 { self.clamp_n_s / self.clamp_s } else { 0.0 },
            clamp_max_n: self.clamp_max_n,
            impulse_n_s: self.impulse_n_s,
            crossed_n: self.crossed_n,
            reaction: self.crossed_n.map(|_| reaction),
            excess_m_s: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn reading(taxel: usize, force_n: f64) -> [TaxelReading; TAXELS] {
        let mut taxels = [TaxelReading { force_n: 0.0, status: TaxelStatus::Ok }; TAXELS];
        taxels[taxel].force_n = force_n;
        taxels
    }

    fn taken(tracker: &mut ContactTracker) -> heapless::Vec<ContactEvent, 4> {
        let mut events = heapless::Vec::new();
        tracker.take(&mut events);
        events
    }

    /// Feeds T3 a force for each millisecond; returns the events with the ms they came in.
    fn feed(tracker: &mut ContactTracker, forces: impl IntoIterator<Item = f64>) -> Vec<(u64, ContactEvent)> {
        let mut events = Vec::new();
        for (ms, force_n) in (1..).zip(forces) {
            tracker.update(ms * MS, &reading(2, force_n));
            events.extend(taken(tracker).into_iter().map(|event| (ms, event)));
        }
        events
    }

    fn limits(transient_n: f64, quasi_static_n: f64) -> [ContactLimits; TAXELS] {
        [ContactLimits { transient_n: Some(transient_n), quasi_static_n: Some(quasi_static_n) }; TAXELS]
    }

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-9
    }

    #[test]
    fn a_short_touch_is_transient_and_has_peak_and_impulse() {
        let mut tracker = ContactTracker::new(11, [ContactLimits::default(); TAXELS], ContactReaction::Slow);
        let touch = [0.0, 10.0, 30.0, 20.0, 0.0, 0.0];
        let events = feed(&mut tracker, touch);
        assert_eq!(
            events.iter().map(|(ms, e)| (*ms, e.phase)).collect::<Vec<_>>(),
            [(2, ContactPhase::Started), (5, ContactPhase::Finished)]
        );
        let (_, end) = events[1];
        assert_eq!((end.taxel, end.kind, end.started_ns), (2, ContactKind::Transient, 2 * MS));
        assert!(near(end.duration_s, 0.003) && near(end.peak_n, 30.0) && near(end.impulse_n_s, 0.060));
        assert!(near(end.clamp_mean_n, 0.0) && near(end.clamp_max_n, 0.0));
        assert_eq!((end.crossed_n, end.reaction), (None, None));
    }

    #[test]
    fn half_a_second_is_transient_and_a_tick_more_is_not() {
        for (ms, kind) in [(500, ContactKind::Transient), (501, ContactKind::QuasiStatic)] {
            let mut tracker =
                ContactTracker::new(11, [ContactLimits::default(); TAXELS], ContactReaction::Slow);
            let events = feed(&mut tracker, std::iter::repeat_n(10.0, ms).chain([0.0]));
            assert_eq!(events[1].1.kind, kind, "{ms} ms");
        }
    }

    #[test]
    fn the_clamp_force_is_what_presses_after_half_a_second() {
        let mut tracker = ContactTracker::new(11, [ContactLimits::default(); TAXELS], ContactReaction::Slow);
        let forces = std::iter::repeat_n(80.0, 500).chain(std::iter::repeat_n(20.0, 500)).chain([40.0, 0.0]);
        let (_, end) = feed(&mut tracker, forces)[1];
        assert!(near(end.peak_n, 80.0) && near(end.clamp_max_n, 40.0), "{end:?}");
        // 1 ms of 40 N and 500 of 20 N
        assert!(near(end.clamp_mean_n, (500.0 * 20.0 + 40.0) / 501.0), "{end:?}");
        assert!(near(end.impulse_n_s, 40.0 + 10.0 + 0.040), "{end:?}");
    }

    #[test]
    fn each_limit_is_crossed_in_its_own_time_and_once() {
        let mut tracker = ContactTracker::new(11, limits(50.0, 15.0), ContactReaction::Retreat);
        let forces = std::iter::repeat_n(20.0, 600).chain([60.0, 0.0]);
        let events = feed(&mut tracker, forces);
        let crossings: Vec<_> =
            events.iter().filter(|(_, e)| e.phase == ContactPhase::LimitCrossed).collect();
        assert_eq!(crossings.len(), 1, "60 N come after half a second: only the quasi-static limit counts");
        let (ms, event) = crossings[0];
        assert_eq!((*ms, event.kind, event.crossed_n), (502, ContactKind::QuasiStatic, Some(15.0)));
        assert_eq!(event.reaction, Some(ContactReaction::Retreat));
        assert_eq!(tracker.crossed(), None, "over with the contact");

        let mut tracker = ContactTracker::new(11, limits(50.0, 15.0), ContactReaction::Retreat);
        feed(&mut tracker, [0.0, 50.0]);
        assert_eq!(tracker.crossed(), None, "the limit itself is not beyond it");

        let mut tracker = ContactTracker::new(11, limits(50.0, 15.0), ContactReaction::Retreat);
        let events = feed(&mut tracker, [0.0, 51.0]);
        assert_eq!(events[1].1.crossed_n, Some(50.0));
        assert_eq!(tracker.crossed(), Some(core::array::from_fn(|i| i == 2)));
    }

    #[test]
    fn a_taxel_that_is_lost_in_contact_has_not_let_go() {
        let mut tracker = ContactTracker::new(11, [ContactLimits::default(); TAXELS], ContactReaction::Slow);
        feed(&mut tracker, [10.0]);
        let mut stale = reading(2, 10.0);
        stale[2].status = TaxelStatus::Stale;
        tracker.update(2 * MS, &stale);
        assert_eq!(taken(&mut tracker)[0].phase, ContactPhase::Lost);
    }

    #[test]
    fn what_the_barrier_cannot_keep_is_said_once_a_contact() {
        let mut tracker = ContactTracker::new(11, [ContactLimits::default(); TAXELS], ContactReaction::Slow);
        feed(&mut tracker, [10.0, 10.0]);
        let row = |taxel, excess_m_s| ContactRow { taxel, excess_m_s, ..ContactRow::default() };
        tracker.squeezed(2 * MS, &[row(2, NO_ROOM_M_S)]);
        assert!(taken(&mut tracker).is_empty(), "rounding and braking are no event");
        tracker.squeezed(3 * MS, &[row(1, 0.2), row(2, 0.05)]);
        tracker.squeezed(4 * MS, &[row(2, 0.3)]);
        let events = taken(&mut tracker);
        let [event] = &events[..] else { panic!("{events:?}") };
        assert_eq!((event.taxel, event.phase), (2, ContactPhase::NoRoom));
        assert!(near(event.excess_m_s, 0.05) && near(event.peak_n, 10.0));
    }

    #[test]
    fn no_event_is_lost_when_every_taxel_is_struck_at_once() {
        let mut tracker = ContactTracker::new(TAXELS, limits(5.0, 5.0), ContactReaction::Slow);
        let struck = [TaxelReading { force_n: 9.0, status: TaxelStatus::Ok }; TAXELS];
        let let_go = [TaxelReading { force_n: 0.0, status: TaxelStatus::Ok }; TAXELS];
        tracker.update(MS, &struck);
        assert_eq!((tracker.touched(), tracker.crossed()), ([true; TAXELS], Some([true; TAXELS])));
        tracker.update(2 * MS, &let_go);
        assert_eq!((tracker.touched(), tracker.crossed()), ([false; TAXELS], None));
        let taken = std::iter::repeat_with(|| taken(&mut tracker)).take_while(|events| !events.is_empty());
        let phases: Vec<ContactPhase> = taken.flatten().map(|event| event.phase).collect();
        for phase in [ContactPhase::Started, ContactPhase::LimitCrossed, ContactPhase::Finished] {
            assert_eq!(phases.iter().filter(|p| **p == phase).count(), TAXELS, "{phase:?}");
        }
    }

    #[test]
    fn more_events_than_a_sample_holds_wait_for_the_next() {
        let mut tracker = ContactTracker::new(11, [ContactLimits::default(); TAXELS], ContactReaction::Slow);
        let mut taxels = [TaxelReading { force_n: 0.0, status: TaxelStatus::Ok }; TAXELS];
        taxels[..11].fill(TaxelReading { force_n: 9.0, status: TaxelStatus::Ok });
        tracker.update(MS, &taxels);
        let counts = [4, 4, 3, 0].map(|expected| (taken(&mut tracker).len(), expected));
        assert!(counts.iter().all(|(count, expected)| count == expected), "{counts:?}");
    }
}
