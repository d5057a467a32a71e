//! The page that commands. It has a connection of its own to the daemon: when its lease ends that connection is closed, and the
//! daemon stops the robot by its own rule. The same happens when this process ends.

use crate::{audit::Audit, link::Link, look::Look};
use moca_msgs::Request;
use moca_telemetry::{
    calibration::{CalibrationProgress, CalibrationRequest},
    net::Address,
};
use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};
use tokio::{
    sync::{mpsc, oneshot, watch},
    task::AbortHandle,
    time::Instant,
};

/// Number of a page, unique in a gateway's life.
pub(crate) type PageId = u64;
/// Way of an answer back to its page.
pub(crate) type Answer = oneshot::Sender<Result<(), String>>;

/// Longest time after which the daemon's progress shows what was asked of the calibration.
const CALIBRATION_SEEN: Duration = Duration::from_secs(1);
/// Orders that wait for the daemon.
const ORDERS: usize = 8;

/// A page that holds the command, for everybody to see.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Holder {
    pub(crate) page: PageId,
    pub(crate) who: String,
}

/// Task of a holder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Duty {
    /// Run the robot while a press lasts.
    Run,
    /// Calibrate the cover.
    Calibrate(CalibrationRequest),
}

enum Order {
    Ask(Request, Answer),
    Calibrate(CalibrationRequest, Answer),
    Release,
}

struct Place {
    number: u64,
    holder: Holder,
    /// When the newest picture that the page has drawn was sent.
    drawn: watch::Sender<Instant>,
    orders: mpsc::Sender<Order>,
    task: AbortHandle,
}

/// The one place of a holder.
pub(crate) struct Commander {
    daemon: Address,
    lease: Duration,
    look: watch::Receiver<Look>,
    place: Mutex<Option<Place>>,
    numbers: AtomicU64,
    shown: watch::Sender<Option<Holder>>,
    audit: Arc<Audit>,
}

impl Commander {
    pub(crate) fn new(
        daemon: Address,
        lease: Duration,
        look: watch::Receiver<Look>,
        audit: Arc<Audit>,
    ) -> Arc<Self> {
        let (shown, _) = watch::channel(None);
        let (place, numbers) = (Mutex::new(None), AtomicU64::new(0));
        Arc::new(Self { daemon, lease, look, place, numbers, shown, audit })
    }

    /// Life of a sign of life.
    pub(crate) const fn lease(&self) -> Duration {
        self.lease
    }

    /// The holder, now and later.
    pub(crate) fn holder(&self) -> watch::Receiver<Option<Holder>> {
        self.shown.subscribe()
    }

    /// Takes the command for a page whose newest drawn picture was sent at `drawn`.
    pub(crate) fn take(self: &Arc<Self>, holder: Holder, duty: Duty, drawn: Instant, answer: Answer) {
        let mut place = self.place();
        if let Some(present) = &*place {
            let refused = if present.holder.page == holder.page {
                match duty {
                    Duty::Calibrate(request) => return send(present, Order::Calibrate(request, answer)),
                    Duty::Run => "this page holds the command already: let go first".to_owned(),
                }
            } else {
                format!("{} holds the command", present.holder.who)
            };
            let _ = answer.send(Err(refused));
            return;
        }
        let (drawn_to, drawn) = watch::channel(drawn);
        let (orders_to, orders) = mpsc::channel(ORDERS);
        let number = self.numbers.fetch_add(1, Ordering::Relaxed);
        let work = Arc::clone(self).work(number, holder.clone(), duty, drawn, orders, answer);
        let task = tokio::spawn(work).abort_handle();
        self.shown.send_replace(Some(holder.clone()));
        *place = Some(Place { number, holder, drawn: drawn_to, orders: orders_to, task });
    }

    /// Notes that a page has drawn a picture that was sent at `drawn`.
    pub(crate) fn beat(&self, page: PageId, drawn: Instant) {
        if let Some(place) = self.place().as_ref().filter(|place| place.holder.page == page) {
            place.drawn.send_modify(|newest| *newest = (*newest).max(drawn));
        }
    }

    /// Ends what a page holds, in order: the robot is disarmed.
    pub(crate) fn release(&self, page: PageId) {
        let full =
            |place: &Place| place.holder.page == page && place.orders.try_send(Order::Release).is_err();
        let no_room = self.place().as_ref().is_some_and(full);
        if no_room {
            // A release must not be lost.
            self.lose(page);
        }
    }

    /// Takes the command from a page that is gone: its connection is closed, and a robot that it armed stops.
    pub(crate) fn lose(&self, page: PageId) {
        let mut place = self.place();
        if let Some(gone) = place.take_if(|place| place.holder.page == page) {
            gone.task.abort();
            self.shown.send_replace(None);
            self.audit.note(&gone.holder.who, "gone while holding", "the robot stops");
        }
    }

    /// Asks the loop for a page, over its own connection if it holds, else over one that is closed again.
    pub(crate) fn ask(self: &Arc<Self>, asks: Holder, request: Request, answer: Answer) {
        match &*self.place() {
            Some(place) if place.holder.page == asks.page => send(place, Order::Ask(request, answer)),
            Some(place) => {
                let _ = answer.send(Err(format!("{} holds the command", place.holder.who)));
            }
            None => {
                let commander = Arc::clone(self);
                tokio::spawn(async move {
                    let _ = answer.send(commander.ask_once(&asks.who, request).await);
                });
            }
        }
    }

    async fn ask_once(&self, who: &str, request: Request) -> Result<(), String> {
        let mut link = Link::open(&self.daemon, self.lease, who).await?;
        let outcome = link.ask(request).await;
        link.release().await;
        outcome
    }

    async fn work(
        self: Arc<Self>,
        number: u64,
        holder: Holder,
        duty: Duty,
        drawn: watch::Receiver<Instant>,
        orders: mpsc::Receiver<Order>,
        answer: Answer,
    ) {
        // Dropping `serve` closes the connection. The lease is watched beside it, whatever it awaits.
        let end = tokio::select! {
            biased;
            age = lease_ends(drawn.clone(), self.lease) => {
                format!("newest picture {} ms old: the robot stops", age.as_millis())
            }
            end = self.serve(&holder.who, duty, drawn, orders, answer) => end,
        };
        let mut place = self.place();
        if place.take_if(|place| place.number == number).is_some() {
            self.shown.send_replace(None);
        }
        drop(place);
        self.audit.note(&holder.who, "hold ended", end);
    }

    /// Works until the page lets go, the robot stops by itself or the daemon is gone; says which.
    async fn serve(
        &self,
        who: &str,
        duty: Duty,
        mut drawn: watch::Receiver<Instant>,
        mut orders: mpsc::Receiver<Order>,
        answer: Answer,
    ) -> String {
        let mut link = match Link::open(&self.daemon, self.lease, who).await {
            Ok(link) => link,
            Err(error) => {
                let _ = answer.send(Err(error.clone()));
                return error;
            }
        };
        let begun = match duty {
            Duty::Run => link.ask(Request::Arm).await,
            Duty::Calibrate(request) => link.calibrate(request).await,
        };
        let _ = answer.send(begun.clone());
        if let Err(error) = begun {
            link.release().await;
            return error;
        }
        let mut look = self.look.clone();
        let (mut ran, stops) = (false, look.borrow().stops);
        let mut asked = Instant::now();
        loop {
            let sent = tokio::select! {
                biased;
                order = orders.recv() => match order {
                    Some(Order::Ask(request, answer)) => {
                        let _ = answer.send(link.ask(request).await);
                        Ok(())
                    }
                    Some(Order::Calibrate(request, answer)) => {
                        let sent = link.calibrate(request).await;
                        let _ = answer.send(sent.clone());
                        asked = Instant::now();
                        sent
                    }
                    Some(Order::Release) | None => return let_go(&mut link, duty).await,
                },
                Ok(()) = drawn.changed() => {
                    let at = *drawn.borrow_and_update();
                    let over = asked.elapsed() > CALIBRATION_SEEN && is_over(&look.borrow().calibration);
                    if over && matches!(duty, Duty::Calibrate(_)) {
                        link.release().await;
                        return "the calibration is over".into();
                    }
                    if at.elapsed() < self.lease { link.alive().await } else { Ok(()) }
                }
                Ok(()) = look.changed() => {
                    let (moves, stopped) = {
                        let newest = look.borrow_and_update();
                        (newest.moves(), newest.stops != stops)
                    };
                    ran |= moves;
                    if duty == Duty::Run && !moves && (ran || stopped) {
                        link.release().await;
                        return "the robot has stopped".into();
                    }
                    Ok(())
                }
                gone = link.closed() => Err(gone),
            };
            if let Err(error) = sent {
                return error;
            }
        }
    }

    fn place(&self) -> MutexGuard<'_, Option<Place>> {
        self.place.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// True if the daemon waits for nothing more of a calibration.
const fn is_over(calibration: &CalibrationProgress) -> bool {
    use CalibrationProgress as Is;
    match calibration {
        Is::Unavailable(_) | Is::Idle | Is::Saved { .. } | Is::Failed(_) => true,
        Is::Rest { .. } | Is::Press { .. } | Is::Fitted(_) => false,
    }
}

/// Gives the command back; a robot that runs is disarmed first.
async fn let_go(link: &mut Link, duty: Duty) -> String {
    let end = match duty {
        Duty::Run => link.ask(Request::Disarm).await,
        Duty::Calibrate(_) => Ok(()),
    };
    link.release().await;
    end.map_or_else(|refused| format!("let go: {refused}"), |()| "let go".into())
}

/// Ends when the newest drawn picture is older than `lease`, with its age.
async fn lease_ends(drawn: watch::Receiver<Instant>, lease: Duration) -> Duration {
    loop {
        let newest = *drawn.borrow();
        if newest.elapsed() >= lease {
            return newest.elapsed();
        }
        tokio::time::sleep_until(newest + lease).await;
    }
}

fn send(place: &Place, order: Order) {
    let refused = place.orders.try_send(order).map_err(mpsc::error::TrySendError::into_inner);
    if let Err(Order::Ask(_, answer) | Order::Calibrate(_, answer)) = refused {
        let _ = answer.send(Err("too many requests wait for the robot".into()));
    }
}
