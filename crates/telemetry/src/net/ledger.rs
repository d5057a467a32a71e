//! Requests and their answers on their way to the log: counted, a line a second for each kind, never waited for.
//!
//! The telemetry's thread writes it. The loop has no part in it.

use crate::audit::{Asked, CONNECT};
use moca_msgs::{Outcome, Refusal, Request};
use std::{
    collections::BTreeMap,
    sync::mpsc::{SyncSender, TrySendError},
    time::{Duration, Instant},
};

/// Shortest time between two lines of one kind: the first of a series is said at once, the others are counted.
const SAY_EVERY: Duration = Duration::from_secs(1);
/// Most kinds that are told apart at a time; all beyond them are one.
const KINDS_MAX: usize = 256;
/// Most kinds of connections that are not let in: a crowd hides nobody who is.
const STRANGERS_MAX: usize = 64;

/// Lines of one second.
pub(super) struct Ledger {
    to: Option<SyncSender<Asked>>,
    /// Names of the parameters.
    parameters: Vec<String>,
    kinds: BTreeMap<Kind, Counted>,
}

/// Requests that share a line.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Kind {
    who: String,
    what: String,
    answer: Result<String, String>,
}

/// Requests of one kind.
struct Counted {
    unsaid: u64,
    said: Option<Instant>,
}

impl Ledger {
    /// A ledger for a robot with these parameters; without a receiver it does nothing.
    pub(super) const fn new(to: Option<SyncSender<Asked>>, parameters: Vec<String>) -> Self {
        Self { to, parameters, kinds: BTreeMap::new() }
    }

    /// Notes the answer to a request.
    pub(super) fn answered(&mut self, who: &str, request: &Request, outcome: Outcome, now: Instant) {
        if self.to.is_some() {
            let what = self.words(request);
            let answer = outcome.map(|()| String::new()).map_err(|refusal| reason(request, refusal));
            self.note(who, what, answer, now);
        }
    }

    /// Notes something else that a client did, or may not do.
    pub(super) fn note(
        &mut self,
        who: &str,
        what: impl Into<String>,
        answer: Result<String, String>,
        now: Instant,
    ) {
        self.note_up_to(KINDS_MAX, Kind { who: who.to_owned(), what: what.into(), answer }, now);
    }

    /// Notes that a connection was not let in.
    pub(super) fn turned_away(&mut self, who: &str, reason: String, now: Instant) {
        let kind = Kind { who: who.to_owned(), what: CONNECT.into(), answer: Err(reason) };
        self.note_up_to(STRANGERS_MAX, kind, now);
    }

    fn note_up_to(&mut self, most: usize, mut kind: Kind, now: Instant) {
        let Some(to) = &self.to else { return };
        if self.kinds.len() >= most && !self.kinds.contains_key(&kind) {
            let answer = Err(format!("more than {most} kinds in a second"));
            kind = Kind { who: "others".into(), what: "requests".into(), answer };
        }
        let counted = self.kinds.entry(kind.clone()).or_insert(Counted { unsaid: 0, said: None });
        counted.unsaid += 1;
        say(to, &kind, counted, now);
    }

    /// Says what has been counted and is due.
    pub(super) fn say_due(&mut self, now: Instant) {
        let Some(to) = &self.to else { return };
        self.kinds.retain(|kind, counted| {
            say(to, kind, counted, now);
            counted.unsaid > 0 || counted.said.is_some_and(|said| now < said + SAY_EVERY)
        });
    }

    /// Says all that is left, when the server ends.
    pub(super) fn say_all(&mut self, now: Instant) {
        self.kinds.values_mut().for_each(|counted| counted.said = None);
        self.say_due(now);
    }

    /// Words for a request.
    fn words(&self, request: &Request) -> String {
        let name = match request {
            Request::SetParameter { parameter, .. } => self.parameters.get(usize::from(*parameter)),
            _ => None,
        };
        name.map_or_else(|| request.to_string(), |name| format!("set {name}"))
    }
}

/// Reason of a refusal without the numbers of the moment: each would be a kind of its own.
fn reason(request: &Request, refusal: Refusal) -> String {
    match refusal {
        Refusal::Touched { taxel, .. } => format!("T{} is touched", u16::from(taxel) + 1),
        Refusal::FarFromPosture { joint, .. } => {
            format!("joint {} is far from its posture", u16::from(joint) + 1)
        }
        Refusal::Target(_) => "a target that is not taken".into(),
        refusal => request.refused(refusal).to_string(),
    }
}

/// Sends a line unless one of its kind was sent within [`SAY_EVERY`]. Without room it stays counted.
fn say(to: &SyncSender<Asked>, kind: &Kind, counted: &mut Counted, now: Instant) {
    if counted.unsaid == 0 || counted.said.is_some_and(|said| now < said + SAY_EVERY) {
        return;
    }
    let (Ok(answer) | Err(answer)) = kind.answer.clone();
    let line = Asked {
        who: kind.who.clone(),
        what: kind.what.clone(),
        accepted: kind.answer.is_ok(),
        answer,
        times: counted.unsaid,
    };
    if !matches!(to.try_send(line), Err(TrySendError::Full(_))) {
        *counted = Counted { unsaid: 0, said: Some(now) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, sync_channel};

    fn ledger(room: usize) -> (Ledger, Receiver<Asked>) {
        let (to, lines) = sync_channel(room);
        (Ledger::new(Some(to), vec!["control.law".into()]), lines)
    }

    fn times(lines: &Receiver<Asked>) -> Vec<u64> {
        lines.try_iter().map(|line| line.times).collect()
    }

    #[test]
    fn flood_is_counted_and_hides_no_other_request() {
        let (mut ledger, lines) = ledger(1000);
        let start = Instant::now();
        for i in 0..10_000 {
            ledger.answered(
                "flood",
                &Request::Tare,
                Err(Refusal::ReadOnly),
                start + Duration::from_micros(i),
            );
        }
        ledger.answered("lab-pc", &Request::Arm, Ok(()), start);
        ledger.answered("flood", &Request::Stop, Ok(()), start);
        assert_eq!(times(&lines), [1, 1, 1]);
        ledger.say_due(start + SAY_EVERY);
        assert_eq!(times(&lines), [9999]);
        ledger.say_due(start + 3 * SAY_EVERY);
        assert!(ledger.kinds.is_empty(), "nothing is kept of what is said");
    }

    #[test]
    fn full_log_loses_no_count() {
        let (mut ledger, lines) = ledger(1);
        let start = Instant::now();
        let ask = |ledger: &mut Ledger, request| ledger.answered("lab-pc", &request, Ok(()), start);
        ask(&mut ledger, Request::Arm);
        (0..3).for_each(|_| ask(&mut ledger, Request::Disarm));
        assert_eq!(times(&lines), [1]);
        ledger.say_all(start);
        let line = lines.try_recv().unwrap();
        assert_eq!((line.what.as_str(), line.times, line.accepted), ("disarm", 3, true));
    }

    #[test]
    fn number_of_kinds_is_bounded() {
        let (mut ledger, lines) = ledger(10_000);
        let now = Instant::now();
        (0..1000).for_each(|i| ledger.turned_away(&format!("machine {i}"), "no".into(), now));
        assert_eq!(ledger.kinds.len(), STRANGERS_MAX + 1, "a crowd leaves room for others");
        (0..1000).for_each(|i| ledger.note(&format!("program {i}"), "leave", Ok(String::new()), now));
        assert!(ledger.kinds.len() <= KINDS_MAX + 1);
        ledger.say_all(now);
        assert_eq!(times(&lines).iter().sum::<u64>(), 2000);
    }

    #[test]
    fn request_is_named_with_its_taxel_or_parameter() {
        let (ledger, _lines) = ledger(1);
        let values = moca_msgs::ParameterValues::default();
        for (request, words) in [
            (Request::MaskTaxel { taxel: 2, masked: true }, "mask T3"),
            (Request::SetParameter { parameter: 0, values }, "set control.law"),
            (Request::SetParameter { parameter: u8::MAX, values }, "set parameter 255"),
            (Request::SelectLaw(moca_msgs::Law::FollowMe), "law follow-me"),
        ] {
            assert_eq!(ledger.words(&request), words);
        }
    }
}
