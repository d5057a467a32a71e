//! A base's thread, and the loop's end of it: neither waits for the other.

use super::odometry::{BaseReading, OdometryJudge, Refused};
use super::order::OrderWatch;
use crate::Message;
use crate::cdr;
use crate::messages::{Header, Odometry, Time, Twist, TwistStamped, Vector3};
use crate::transport::{
    Qos, ReaderId, Transport, TransportError, WriterId, problems_of_reader, problems_of_writer, unix_ns,
};
use std::mem::Discriminant;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use triple_buffer::{Input, Output, triple_buffer};

/// Period at which other nodes on the topics are looked up, ns.
const LOOK_AROUND_NS: u64 = 1_000_000_000;

/// Which way lost messages are sent again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reliable {
    /// Orders: a reliable writer goes with every reader.
    pub orders: bool,
    /// Odometry: a best-effort reader goes with every writer.
    pub odom: bool,
}

impl Default for Reliable {
    fn default() -> Self {
        Self { orders: true, odom: false }
    }
}

/// A base, as its owner describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseSettings {
    /// Topic of the velocity orders.
    pub cmd_vel: String,
    /// True for orders as `TwistStamped`, false for `Twist`.
    pub stamped: bool,
    /// Frame named in a `TwistStamped`.
    pub frame: String,
    /// Topic of the odometry.
    pub odom: String,
    /// Rate of orders, Hz.
    pub rate_hz: f64,
    /// Without an order of the loop for so long zero is sent, s.
    pub silence_s: f64,
    /// Oldest odometry that is driven with, s.
    pub deadline_s: f64,
    /// Retransmission of lost orders and lost odometry. The other end has to offer or accept it.
    pub reliable: Reliable,
    /// Fastest that this base moves: m/s, m/s, rad/s. What is faster in its odometry is a jump.
    pub velocity_max: [f64; 3],
}

/// Events so far.
#[derive(Debug, Default)]
pub struct BaseCounts {
    /// Orders sent.
    pub sent: AtomicU64,
    /// Orders that the transport did not take.
    pub unsent: AtomicU64,
    /// Odometry that was used.
    pub odometry: AtomicU64,
    /// Payloads that are no odometry.
    pub garbled: AtomicU64,
    /// Odometry that was not used, for whatever reason of [`Refused`].
    pub refused: AtomicU64,
    /// Times that a moving base was stopped because the loop ordered nothing.
    pub silences: AtomicU64,
    /// Least difference between this PC's clock and the stamps of odometry, ns: how far the clocks are apart, and the way here.
    pub clock_offset_ns: AtomicI64,
}

/// Order of the loop.
#[derive(Clone, Copy, Debug)]
struct Order {
    /// When, ns since the start.
    ordered_ns: u64,
    velocity_body: [f64; 3],
}

#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    counts: BaseCounts,
    problems: Mutex<Vec<String>>,
}

/// The loop's end: a velocity-controlled base whose thread does all the waiting.
pub struct Ros2Base {
    shared: Arc<Shared>,
    start: Instant,
    readings: Output<Option<BaseReading>>,
    orders: Input<Option<Order>>,
    deadline_ns: u64,
    thread: Option<JoinHandle<()>>,
}

/// The base at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseState {
    /// Pose of B in the odometry's frame, carried on to now: m, m, rad.
    pub pose_world: [f64; 3],
    /// Its rate: m/s, m/s, rad/s.
    pub velocity_world: [f64; 3],
    /// Age of the odometry behind it, s.
    pub age_s: f64,
}

impl Ros2Base {
    /// Announces the topics on `transport`, and serves them from a thread of its own. `say` hears in sentences what is wrong on
    /// the network, once each time that it begins, and when it is over.
    ///
    /// # Errors
    /// A topic that has no name, or no thread.
    pub fn spawn(
        settings: BaseSettings,
        mut transport: Box<dyn Transport + Send>,
        mut say: impl FnMut(&str) + Send + 'static,
    ) -> Result<Self, TransportError> {
        let (start, shared) = (Instant::now(), Arc::new(Shared::default()));
        let deadline_ns = ns(settings.deadline_s);
        let (to_loop, readings) = triple_buffer(&None);
        let (orders, from_loop) = triple_buffer(&None);
        let mut worker = Worker::new(transport.as_mut(), settings, to_loop, from_loop)?;
        let in_thread = Arc::clone(&shared);
        let serve = move || {
            while !in_thread.stop.load(Ordering::Acquire) {
                let next_ns =
                    worker.step(transport.as_mut(), &in_thread, &|| since(start), unix_ns(), &mut say);
                transport.wait(Duration::from_nanos(next_ns.saturating_sub(since(start))));
            }
            worker.send(transport.as_mut(), &in_thread.counts, [0.0; 3], unix_ns());
        };
        let thread = std::thread::Builder::new().name("ros2-base".into()).spawn(serve);
        let thread = thread.map_err(|error| TransportError(format!("no thread for the base: {error}")))?;
        Ok(Self { shared, start, readings, orders, deadline_ns, thread: Some(thread) })
    }

    /// The base now; `None` before the first odometry. Never waits.
    pub fn state(&mut self) -> Option<BaseState> {
        let reading = (*self.readings.read())?;
        let now_ns = since(self.start);
        let (pose_world, velocity_world) = reading.predicted(now_ns, self.deadline_ns);
        Some(BaseState { pose_world, velocity_world, age_s: reading.age_s(now_ns) })
    }

    /// Orders a velocity in the axes of B: m/s, m/s, rad/s. Never waits.
    pub fn order(&mut self, velocity_body: [f64; 3]) {
        self.orders.write(Some(Order { ordered_ns: since(self.start), velocity_body }));
    }

    /// Returns the events so far.
    pub fn counts(&self) -> &BaseCounts {
        &self.shared.counts
    }

    /// Returns the problems of the network, in sentences, looked up once a second. Not for the loop: it may wait for a lock.
    pub fn problems(&self) -> Vec<String> {
        self.shared.problems.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Ros2Base {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic there has been printed by its own thread, and its base stops by its own time-out.
            let _ = thread.join();
        }
    }
}

/// Work of the thread, a step at a time.
struct Worker {
    settings: BaseSettings,
    cmd_vel: WriterId,
    odom: ReaderId,
    readings: Input<Option<BaseReading>>,
    ordered: Output<Option<Order>>,
    orders: OrderWatch,
    judge: OdometryJudge,
    look_ns: u64,
    /// Why odometry was not used last, since the last look around, and at that.
    refused: Option<Refused>,
    refused_before: Option<Discriminant<Refused>>,
    told: Told,
    rejoined: u64,
}

/// Network problems that were already reported.
#[derive(Debug, Default)]
struct Told {
    /// Problems of the last look around.
    seen: Vec<String>,
    said: Vec<String>,
}

impl Told {
    /// Says what is wrong for the second time in a row, as nodes take a moment to find each other, and what no longer is.
    fn look(&mut self, problems: &[String], say: &mut dyn FnMut(&str)) {
        self.said.retain(|problem| {
            let remains = problems.contains(problem);
            if !remains {
                say(&format!("over: {problem}"));
            }
            remains
        });
        for problem in problems.iter().filter(|problem| self.seen.contains(problem)) {
            if !self.said.contains(problem) {
                say(problem);
                self.said.push(problem.clone());
            }
        }
        self.seen = problems.to_vec();
    }
}

impl Worker {
    fn new(
        transport: &mut dyn Transport,
        settings: BaseSettings,
        readings: Input<Option<BaseReading>>,
        ordered: Output<Option<Order>>,
    ) -> Result<Self, TransportError> {
        let of = if settings.stamped { TwistStamped::TYPE } else { Twist::TYPE };
        let cmd_vel = transport.writer(&settings.cmd_vel, of, qos(settings.reliable.orders))?;
        let odom = transport.reader(&settings.odom, Odometry::TYPE, qos(settings.reliable.odom))?;
        let orders = OrderWatch::new(ns(1.0 / settings.rate_hz), ns(settings.silence_s));
        let judge = OdometryJudge::new(ns(settings.deadline_s), settings.velocity_max);
        Ok(Self {
            settings,
            cmd_vel,
            odom,
            readings,
            ordered,
            orders,
            judge,
            look_ns: 0,
            refused: None,
            refused_before: None,
            told: Told::default(),
            rejoined: 0,
        })
    }

    /// Passes on what has come and sends what is due; says when to come again, ns.
    fn step(
        &mut self,
        transport: &mut dyn Transport,
        shared: &Shared,
        clock: &dyn Fn() -> u64,
        unix_ns: u64,
        say: &mut dyn FnMut(&str),
    ) -> u64 {
        while let Some(payload) = transport.take(self.odom) {
            // Asked after it has come: a thread that was held up in between would take it for one from the future, and by that
            // measure every later one for old.
            self.odometry(&payload, shared, clock());
            if let Some(offset_s) = self.judge.offset_s() {
                // Between the stamps and a clock that began when this did.
                let began_ns = i128::from(unix_ns) - i128::from(clock());
                let offset_ns = Duration::from_secs_f64(offset_s.abs()).as_nanos();
                let offset_ns = i128::try_from(offset_ns).unwrap_or(0);
                let apart = began_ns + if offset_s < 0.0 { -offset_ns } else { offset_ns };
                shared
                    .counts
                    .clock_offset_ns
                    .store(i64::try_from(apart).unwrap_or(i64::MAX), Ordering::Relaxed);
            }
        }
        let now_ns = clock();
        if self.ordered.update()
            && let Some(order) = *self.ordered.output_buffer()
        {
            self.orders.order(order.ordered_ns, order.velocity_body);
        }
        if let Some(velocity_body) = self.orders.due(now_ns) {
            self.send(transport, &shared.counts, velocity_body, unix_ns);
        }
        shared.counts.silences.store(self.orders.silences(), Ordering::Relaxed);
        if now_ns >= self.look_ns {
            self.look_ns = now_ns + LOOK_AROUND_NS;
            if transport.rejoined() != self.rejoined {
                self.rejoined = transport.rejoined();
                say(
                    "the network was joined anew: what served it had ended, as when a program or its computer is suspended",
                );
            }
            let mut problems = self.problems(transport);
            self.told.look(&problems, say);
            let kind = self.refused.as_ref().map(std::mem::discriminant);
            if let Some(refused) = self.refused.take() {
                let refused = refused.to_string();
                if self.refused_before != kind {
                    say(&refused);
                }
                problems.push(refused);
            }
            self.refused_before = kind;
            *shared.problems.lock().unwrap_or_else(PoisonError::into_inner) = problems;
        }
        self.orders.next_ns().clamp(now_ns + 1_000_000, now_ns + ns(1.0 / self.settings.rate_hz))
    }

    fn odometry(&mut self, payload: &[u8], shared: &Shared, now_ns: u64) {
        let Ok(message) = cdr::decode::<Odometry>(payload) else {
            shared.counts.garbled.fetch_add(1, Ordering::Relaxed);
            return;
        };
        match self.judge.judge(&message, now_ns) {
            Ok(reading) => {
                self.readings.write(Some(reading));
                shared.counts.odometry.fetch_add(1, Ordering::Relaxed);
            }
            Err(refused) => {
                shared.counts.refused.fetch_add(1, Ordering::Relaxed);
                if refused != Refused::Repeated {
                    self.refused = Some(refused);
                }
            }
        }
    }

    fn send(&self, transport: &mut dyn Transport, counts: &BaseCounts, velocity: [f64; 3], unix_ns: u64) {
        let payload = twist_payload(&self.settings, velocity, unix_ns);
        let outcome = transport.write(self.cmd_vel, &payload);
        let count = if outcome.is_ok() { &counts.sent } else { &counts.unsent };
        count.fetch_add(1, Ordering::Relaxed);
    }

    /// Returns the nodes that should not be on the topics, and those that are missing.
    fn problems(&self, transport: &dyn Transport) -> Vec<String> {
        if let Some(problem) = transport.problem() {
            return vec![problem];
        }
        let (endpoints, settings) = (transport.endpoints(), &self.settings);
        let of = if settings.stamped { TwistStamped::TYPE } else { Twist::TYPE };
        let mut problems = problems_of_writer(&endpoints, &settings.cmd_vel, of);
        problems.extend(problems_of_reader(&endpoints, &settings.odom, Odometry::TYPE));
        problems
    }
}

/// An order as this base wants it.
pub(super) fn twist_payload(settings: &BaseSettings, [x, y, yaw]: [f64; 3], unix_ns: u64) -> Vec<u8> {
    let twist = Twist { linear: Vector3::from([x, y, 0.0]), angular: Vector3::from([0.0, 0.0, yaw]) };
    if settings.stamped {
        let header = Header { stamp: Time::from_unix_ns(unix_ns), frame_id: settings.frame.clone() };
        cdr::encode(&TwistStamped { header, twist })
    } else {
        cdr::encode(&twist)
    }
}

pub(super) const fn qos(reliable: bool) -> Qos {
    if reliable { Qos::Reliable } else { Qos::BestEffort }
}

fn ns(seconds: f64) -> u64 {
    u64::try_from(Duration::from_secs_f64(seconds.clamp(0.0, 1e6)).as_nanos()).unwrap_or(u64::MAX)
}

fn since(start: Instant) -> u64 {
    u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are handed on unchanged, and zero")]
mod tests {
    use super::*;
    use crate::messages::Quaternion;
    use crate::transport::memory::Memory;
    use crate::transport::tests::end;

    const MS: u64 = 1_000_000;
    const UNIX_NS: u64 = 1_700_000_000_000_000_000;

    fn settings(stamped: bool) -> BaseSettings {
        BaseSettings {
            cmd_vel: "/cmd_vel".into(),
            stamped,
            frame: "base_link".into(),
            odom: "/odom".into(),
            rate_hz: 100.0,
            silence_s: 0.05,
            deadline_s: 0.1,
            reliable: Reliable::default(),
            velocity_max: [1.5, 1.5, 2.0],
        }
    }

    /// A worker on `memory`, and the loop's ends of what it hands on.
    fn worker(
        memory: &mut Memory,
        stamped: bool,
    ) -> (Worker, Output<Option<BaseReading>>, Input<Option<Order>>) {
        let (to_loop, readings) = triple_buffer(&None);
        let (orders, from_loop) = triple_buffer(&None);
        (Worker::new(memory, settings(stamped), to_loop, from_loop).unwrap(), readings, orders)
    }

    fn odometry(stamp_ns: u64, x: f64) -> Vec<u8> {
        let mut message = Odometry::default();
        message.header.stamp = Time::from_unix_ns(UNIX_NS + stamp_ns);
        message.pose.pose.position.x = x;
        message.pose.pose.orientation = Quaternion::about_z(0.0);
        cdr::encode(&message)
    }

    /// One step a millisecond; the loop orders 0.3 m/s every millisecond while `orders` says so.
    fn run(stamped: bool, ms: u64, orders: impl Fn(u64) -> bool) -> (Memory, Shared) {
        let (mut memory, shared) = (Memory::default(), Shared::default());
        let (mut worker, _readings, mut order) = worker(&mut memory, stamped);
        for now_ns in (0..ms).map(|ms| ms * MS) {
            if orders(now_ns / MS) {
                order.write(Some(Order { ordered_ns: now_ns, velocity_body: [0.3, 0.0, -0.1] }));
            }
            worker.step(&mut memory, &shared, &|| now_ns, UNIX_NS + now_ns, &mut |_| {});
        }
        (memory, shared)
    }

    #[test]
    fn a_loop_that_hangs_stops_the_base_before_the_base_does() {
        let (memory, shared) = run(false, 400, |ms| ms < 200);
        let sent: Vec<Twist> =
            memory.written[0].1.iter().map(|payload| cdr::decode(payload).unwrap()).collect();
        let driven = sent.iter().rposition(|twist| twist.linear.x > 0.0).unwrap();
        assert_eq!((sent.len(), driven), (40, 24), "the last order is of 199 ms, zero from 250 ms on");
        assert!(sent[..=driven].iter().all(|twist| twist.linear.array() == [0.3, 0.0, 0.0]));
        assert!(sent[driven + 1..].iter().all(|twist| *twist == Twist::default()));
        assert_eq!(shared.counts.silences.load(Ordering::Relaxed), 1);
    }

    #[test]
    fn a_stamped_twist_has_frame_and_time() {
        let (memory, _) = run(true, 20, |_| true);
        let second = cdr::decode::<TwistStamped>(&memory.written[0].1[1]).unwrap();
        assert_eq!(second.header.frame_id, "base_link");
        assert_eq!(second.header.stamp.unix_ns(), UNIX_NS + 10 * MS);
        assert_eq!(second.twist.angular.array(), [0.0, 0.0, -0.1]);
    }

    #[test]
    fn nobody_is_sent_anything_before_the_loop_orders() {
        let (memory, _) = run(false, 300, |_| false);
        assert!(memory.written[0].1.is_empty());
    }

    #[test]
    fn bad_odometry_is_counted_and_changes_nothing() {
        let (mut memory, shared) = (Memory::default(), Shared::default());
        let (mut worker, mut readings, _orders) = worker(&mut memory, false);
        let mut come = |memory: &mut Memory, now_ns, payload| {
            memory.unread[0].1.push_back(payload);
            worker.step(memory, &shared, &|| now_ns, UNIX_NS + now_ns, &mut |_| {});
        };
        come(&mut memory, 20 * MS, odometry(20 * MS, 0.0));
        let seen = *readings.read();
        assert!(seen.is_some());
        come(&mut memory, 40 * MS, odometry(40 * MS, f64::NAN));
        come(&mut memory, 60 * MS, odometry(60 * MS, 0.0)[..100].to_vec());
        come(&mut memory, 900 * MS, odometry(80 * MS, 0.0));
        assert_eq!(*readings.read(), seen);
        let counts = &shared.counts;
        let [used, garbled, refused] =
            [&counts.odometry, &counts.garbled, &counts.refused].map(|count| count.load(Ordering::Relaxed));
        assert_eq!((used, garbled, refused), (1, 1, 2));
    }

    #[test]
    fn delayed_thread_does_not_age_later_odometry() {
        let (told, took) = std::sync::mpsc::channel();
        let (mut memory, shared) = (Memory { took: Some(told), ..Memory::default() }, Shared::default());
        let (mut worker, _readings, _orders) = worker(&mut memory, false);
        for message in 1..=20_u64 {
            // The fifth comes while the thread is held up for 0.3 s, just before it looks.
            let late_ns = if message >= 5 { 300 * MS } else { 0 };
            let held_ns = std::cell::Cell::new(if message > 5 { 300 * MS } else { 0 });
            let clock = || {
                if took.try_recv().is_ok() {
                    held_ns.set(late_ns);
                }
                message * 20 * MS + held_ns.get()
            };
            memory.unread[0].1.push_back(odometry(message * 20 * MS + late_ns, 0.0));
            worker.step(&mut memory, &shared, &clock, UNIX_NS, &mut |_| {});
        }
        assert_eq!(shared.counts.odometry.load(Ordering::Relaxed), 20);
    }

    #[test]
    fn who_else_drives_is_named() {
        let (mut memory, shared) = (Memory::default(), Shared::default());
        memory.others = vec![
            end("/cmd_vel", Twist::TYPE, false, "the base"),
            end("/cmd_vel", Twist::TYPE, true, "pad_teleop"),
            end("/odom", Odometry::TYPE, true, "the base"),
        ];
        let (mut worker, _readings, _orders) = worker(&mut memory, false);
        worker.step(&mut memory, &shared, &|| 0, UNIX_NS, &mut |_| {});
        let problems = shared.problems.lock().unwrap().clone();
        assert!(problems.len() == 1 && problems[0].contains("pad_teleop"), "{problems:?}");
    }

    #[test]
    fn what_is_wrong_is_said_once_when_it_lasts_and_when_it_is_over() {
        let (mut memory, shared) = (Memory::default(), Shared::default());
        memory.others =
            vec![end("/cmd_vel", Twist::TYPE, false, "it"), end("/odom", Odometry::TYPE, true, "it")];
        let joy = end("/cmd_vel", Twist::TYPE, true, "pad_teleop");
        let (mut worker, _readings, _orders) = worker(&mut memory, false);
        let mut said = Vec::new();
        for second in 0..30 {
            match second {
                5 | 10 => memory.others.push(joy.clone()),
                6 | 20 => drop(memory.others.pop()),
                _ => {}
            }
            let now_ns = second * 1000 * MS;
            worker.step(&mut memory, &shared, &|| now_ns, UNIX_NS, &mut |text| {
                said.push((second, text.to_owned()))
            });
        }
        let [(11, named), (20, over)] = &said[..] else { panic!("{said:?}") };
        assert!(named.contains("also written by pad_teleop") && *over == format!("over: {named}"));
    }

    #[test]
    fn orders_pass_thread_and_end_with_stop() {
        let (heard, sent) = std::sync::mpsc::channel();
        let memory = Memory { heard: Some(heard), waiting: vec![odometry(MS, 0.25)], ..Memory::default() };
        let mut base = Ros2Base::spawn(settings(false), Box::new(memory), |_| {}).unwrap();
        while base.state().is_none() || base.counts().sent.load(Ordering::Relaxed) == 0 {
            base.order([0.2, 0.0, 0.0]);
        }
        assert_eq!(base.state().unwrap().pose_world, [0.25, 0.0, 0.0]);
        drop(base);
        let sent: Vec<Twist> = sent.iter().map(|payload| cdr::decode(&payload).unwrap()).collect();
        assert!(sent[0].linear.x > 0.0);
        assert_eq!(sent.last(), Some(&Twist::default()));
    }
}
