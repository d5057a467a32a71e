//! Messages of a page, judged: signs of life dated by this gateway's clock, presses, requests and stops.

use crate::{
    access::{Role, devices::Device},
    gateway::Gateway,
    holder::{Duty, Holder, PageId},
    picture::Extras,
    rate::{Bucket, Rate},
};
use moca_msgs::{GripperRequest, Law, Request};
use moca_telemetry::{
    calibration::CalibrationRequest,
    net::access::{CALIBRATE, least_role},
};
use serde::Deserialize;
use serde_json::json;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::{
    sync::{mpsc, oneshot},
    time::Instant,
};

/// One page, as its tasks share it.
pub(crate) struct Page<'a> {
    pub(crate) id: PageId,
    pub(crate) device: Device,
    pub(crate) gateway: &'a Gateway,
    pub(crate) answers: mpsc::Sender<String>,
    ears: Mutex<Ears>,
}

impl<'a> Page<'a> {
    /// A page that has said nothing yet.
    pub(crate) fn new(
        id: PageId,
        device: Device,
        gateway: &'a Gateway,
        answers: mpsc::Sender<String>,
    ) -> Self {
        Self { id, device, gateway, answers, ears: Mutex::new(Ears::new(std::time::Instant::now())) }
    }

    pub(crate) fn ears(&self) -> MutexGuard<'_, Ears> {
        self.ears.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Messages of a page; stops are not counted.
const MESSAGES: Rate = Rate { burst: 60.0, per_s: 60.0 };
/// Pictures whose time of sending is remembered: 2 s.
const SENT: usize = 64;

/// A message of a page.
#[derive(Debug, Deserialize)]
#[serde(tag = "t", rename_all = "lowercase", deny_unknown_fields)]
enum Message {
    /// A picture has been drawn.
    Beat {
        /// Rises with every message.
        n: u32,
        /// Newest picture that was drawn.
        drawn: u32,
        /// Number of the press that holds the robot now; 0 without one.
        press: u32,
    },
    /// A request.
    Ask { n: u32, drawn: u32, what: What },
    /// Stop.
    Stop {
        /// Number of this stop, which a later picture confirms.
        stop: u32,
    },
}

/// A request of a page.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
enum What {
    Tare,
    Resume,
    Law(Law),
    Gripper(GripperRequest),
    PressTaxel { taxel: u8, force_n: f64 },
    MaskTaxel { taxel: u8, masked: bool },
    SetParameter { name: String, values: Vec<f64> },
    Calibrate { taxel: u8, presses: u8 },
    SaveCalibration { model: u8 },
    CancelCalibration,
}

/// A request as the robot takes it.
enum Order {
    Ask(Request),
    Calibrate(CalibrationRequest),
}

/// Outcome of a message.
pub(crate) enum Heard {
    Nothing,
    /// Refused, with the answer.
    Refused(String),
    /// The page breaks the protocol and is closed.
    Broken(&'static str),
}

/// When a picture was sent, and how many stops there had been.
#[derive(Clone, Copy, Debug)]
struct Sent {
    number: u32,
    at: Instant,
    stops: u64,
}

/// Memory of one page.
pub(crate) struct Ears {
    bucket: Bucket,
    heard: u32,
    heard_at: Instant,
    number: u32,
    sent: [Option<Sent>; SENT],
    drawn: Option<Sent>,
    /// Press that holds now, 0 without one.
    press: u32,
    /// Newest press: an older one never holds again.
    newest_press: u32,
    /// Newest stop of the page, and its number at the gateway.
    stop: Option<(u32, u64)>,
    stop_confirmed: u32,
}

impl Ears {
    pub(crate) fn new(now: std::time::Instant) -> Self {
        Self {
            bucket: Bucket::full(MESSAGES, now),
            heard: 0,
            heard_at: now.into(),
            number: 0,
            sent: [None; SENT],
            drawn: None,
            press: 0,
            newest_press: 0,
            stop: None,
            stop_confirmed: 0,
        }
    }

    /// Notes that the next picture is sent now, and gives its numbers.
    pub(crate) fn note_sent(&mut self, now: Instant, stops: u64) -> Extras {
        self.number = self.number.wrapping_add(1).max(1);
        self.sent[self.number as usize % SENT] = Some(Sent { number: self.number, at: now, stops });
        let since = |at: Instant| now.saturating_duration_since(at);
        let drawn_age = self.drawn.map(|drawn| since(drawn.at).as_millis());
        Extras {
            number: self.number,
            heard: self.heard,
            heard_before: u16::try_from(since(self.heard_at).as_micros() / 100).unwrap_or(u16::MAX),
            drawn_age_ms: drawn_age.and_then(|age| u16::try_from(age).ok()).unwrap_or(u16::MAX),
            stop_confirmed: self.stop_confirmed,
            ..Extras::default()
        }
    }

    /// Confirms the page's stop once the daemon has answered it and the robot stands.
    pub(crate) fn confirm_stop(&mut self, answered: u64, stands: bool) {
        if let Some((stop, number)) = self.stop
            && stands
            && answered >= number
        {
            self.stop_confirmed = stop;
        }
    }

    /// Takes the numbers of a message; the picture that it names, if it is remembered.
    fn take(&mut self, n: u32, drawn: u32, now: Instant) -> Result<Option<Sent>, &'static str> {
        if !self.bucket.take(MESSAGES, now.into_std()) {
            return Err("too many messages");
        }
        if n <= self.heard {
            return Err("a message came twice");
        }
        if drawn > self.number {
            return Err("a picture that was never sent");
        }
        (self.heard, self.heard_at) = (n, now);
        let named = self.sent[drawn as usize % SENT].filter(|sent| sent.number == drawn);
        if let Some(named) = named
            && self.drawn.is_none_or(|newest| named.number > newest.number)
        {
            self.drawn = Some(named);
        }
        Ok(named)
    }
}

/// Hears one message of a page.
pub(crate) fn hear(text: &str, page: &Page<'_>) -> Heard {
    let now = Instant::now();
    match serde_json::from_str(text) {
        Err(_) => Heard::Broken("a message that no page of this robot sends"),
        Ok(Message::Stop { stop }) => {
            hear_stop(stop, page);
            Heard::Nothing
        }
        Ok(Message::Beat { n, drawn, press }) => {
            let taken = page.ears().take(n, drawn, now);
            taken.map_or_else(Heard::Broken, |named| beat(press, named, page, now))
        }
        Ok(Message::Ask { n, drawn, what }) => {
            let taken = page.ears().take(n, drawn, now);
            taken.map_or_else(Heard::Broken, |named| ask(what, named, page, now))
        }
    }
}

/// From every role, never too late and never too often: one on its way stands for all.
fn hear_stop(stop: u32, page: &Page<'_>) {
    let number = page.gateway.stop(&page.device.name);
    page.ears().stop = Some((stop, number));
    page.gateway.audit.note(&page.device.name, "stop", "passed on");
}

fn beat(press: u32, named: Option<Sent>, page: &Page<'_>, now: Instant) -> Heard {
    if let Some(named) = named {
        page.gateway.commander.beat(page.id, named.at);
    }
    let mut ears = page.ears();
    if press == ears.press {
        return Heard::Nothing;
    }
    let (before, newest) = (ears.press, ears.newest_press);
    ears.press = press;
    ears.newest_press = newest.max(press);
    drop(ears);
    if before != 0 {
        page.gateway.commander.release(page.id);
    }
    if press == 0 {
        return Heard::Nothing;
    }
    let refused = if press <= newest {
        Some("this press has ended: press again".to_owned())
    } else {
        refusal(Some(Role::Operator), named, page, now)
    };
    let Some(drawn) = named.filter(|_| refused.is_none()) else {
        return refuse(page, "run", refused);
    };
    let (answer, answered) = oneshot::channel();
    page.gateway.commander.take(holder(page), Duty::Run, drawn.at, answer);
    answer_later("run".into(), answered, page);
    Heard::Nothing
}

fn ask(what: What, named: Option<Sent>, page: &Page<'_>, now: Instant) -> Heard {
    let name = format!("{what:?}");
    let order = match order(what, page) {
        Ok(order) => order,
        Err(refused) => return refuse(page, &name, Some(refused)),
    };
    let refused = match &order {
        // What stops the fingers is taken from an old picture too.
        Order::Ask(request @ Request::Gripper(GripperRequest::Stop)) => unfit(least_role(request), page),
        Order::Ask(request) => refusal(least_role(request), named, page, now),
        Order::Calibrate(_) => refusal(Some(CALIBRATE), named, page, now),
    };
    if let Some(refused) = refused {
        return refuse(page, &name, Some(refused));
    }
    let (answer, answered) = oneshot::channel();
    match (order, named) {
        (Order::Calibrate(request), Some(drawn)) => {
            page.gateway.commander.take(holder(page), Duty::Calibrate(request), drawn.at, answer);
        }
        (Order::Ask(request), _) => page.gateway.commander.ask(holder(page), request, answer),
        (Order::Calibrate(_), None) => {}
    }
    answer_later(name, answered, page);
    Heard::Nothing
}

/// The request that is meant.
fn order(what: What, page: &Page<'_>) -> Result<Order, String> {
    Ok(Order::Ask(match what {
        What::Tare => Request::Tare,
        What::Resume => Request::Resume,
        What::Law(law) => Request::SelectLaw(law),
        What::Gripper(request) => Request::Gripper(request),
        What::PressTaxel { taxel, force_n } => Request::PressTaxel { taxel, force_n },
        What::MaskTaxel { taxel, masked } => Request::MaskTaxel { taxel, masked },
        What::Calibrate { taxel, presses } => {
            return Ok(Order::Calibrate(CalibrationRequest::Start { taxel, presses }));
        }
        What::SaveCalibration { model } => return Ok(Order::Calibrate(CalibrationRequest::Save { model })),
        What::CancelCalibration => return Ok(Order::Calibrate(CalibrationRequest::Cancel)),
        What::SetParameter { name, values } => {
            let robot = page.gateway.look.borrow().robot.clone().unwrap_or_default();
            let place = robot.parameters.iter().position(|parameter| parameter.name == name);
            let place = place.ok_or_else(|| format!("no parameter is called {name:?}"))?;
            let values = robot.parameters[place].checked(&values)?;
            let parameter =
                u8::try_from(place).map_err(|_| format!("{name:?} cannot be changed from here"))?;
            Request::SetParameter { parameter, values }
        }
    }))
}

/// Returns the refusal of a page whose role is below `least`.
fn unfit(least: Option<Role>, page: &Page<'_>) -> Option<String> {
    let role = page.device.role;
    least.is_none_or(|least| role < least).then(|| format!("a {} may not do this", role.name()))
}

/// Why something that moves or changes the robot is refused: the role, an old picture, or a stop that it does not show.
fn refusal(least: Option<Role>, named: Option<Sent>, page: &Page<'_>, now: Instant) -> Option<String> {
    if let Some(refused) = unfit(least, page) {
        return Some(refused);
    }
    let fresh = |sent: &Sent| now.saturating_duration_since(sent.at) < page.gateway.commander.lease();
    match named.filter(fresh) {
        None => Some("the link is too slow: nothing was done".into()),
        Some(sent) if sent.stops != page.gateway.stop_count() => {
            Some("the robot has been stopped meanwhile: nothing was done".into())
        }
        Some(_) => None,
    }
}

fn refuse(page: &Page<'_>, what: &str, refused: Option<String>) -> Heard {
    let refused = refused.unwrap_or_default();
    page.gateway.audit.note(&page.device.name, what, refused.as_str());
    Heard::Refused(reply(what, Err(refused)))
}

fn holder(page: &Page<'_>) -> Holder {
    Holder { page: page.id, who: page.device.name.clone() }
}

/// Writes the answer down and passes it on, without waiting for it here.
fn answer_later(what: String, answered: oneshot::Receiver<Result<(), String>>, page: &Page<'_>) {
    let (audit, who, answers) =
        (Arc::clone(&page.gateway.audit), page.device.name.clone(), page.answers.clone());
    tokio::spawn(async move {
        let outcome = answered.await.unwrap_or_else(|_| Err("it has ended before the robot answered".into()));
        audit.note(&who, &what, outcome.as_ref().err().map_or("done", String::as_str));
        // A page that asks and takes no answers goes without.
        let _ = answers.try_send(reply(&what, outcome));
    });
}

fn reply(what: &str, outcome: Result<(), String>) -> String {
    json!({"t": "reply", "what": what, "ok": outcome.is_ok(), "text": outcome.err()}).to_string()
}
