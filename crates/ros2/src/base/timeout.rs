//! A base's own time-out, measured: how long it drives on without orders.

use super::driver::{qos, twist_payload};
use super::{BaseSettings, odometry_velocity};
use crate::Message;
use crate::messages::{Odometry, Twist, TwistStamped};
use crate::transport::{Transport, TransportError, unix_ns};
use std::time::{Duration, Instant};

/// Slower than this share of the speed that was ordered, a base has stopped.
const STOPPED: f64 = 0.3;
/// Faster than this share it drives.
const DRIVES: f64 = 0.7;
/// Longest wait for the base to start, and to stop.
const PATIENCE: Duration = Duration::from_secs(3);

/// Behaviour of a base after its last order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AfterSilence {
    /// It never drove as ordered.
    NeverDrove,
    /// It stopped so long after the last order, s: its time-out and what its wheels and odometry take.
    Stopped(f64),
    /// It was still driving after this long, s, and was then ordered to stop.
    DroveOn(f64),
}

/// Drives forwards at `speed_m_s` until the base does, says nothing more, and waits for it to stop. Ends with an order to
/// stand, whatever happened. Nothing else may order this base meanwhile.
///
/// # Errors
/// A topic that has no name, or a transport that is gone.
pub fn measure(
    transport: &mut dyn Transport,
    settings: &BaseSettings,
    speed_m_s: f64,
) -> Result<AfterSilence, TransportError> {
    let of = if settings.stamped { TwistStamped::TYPE } else { Twist::TYPE };
    let cmd_vel = transport.writer(&settings.cmd_vel, of, qos(settings.reliable.orders))?;
    let odom = transport.reader(&settings.odom, Odometry::TYPE, qos(settings.reliable.odom))?;
    let order = |transport: &mut dyn Transport, x_m_s: f64| {
        transport.write(cmd_vel, &twist_payload(settings, [x_m_s, 0.0, 0.0], unix_ns()))
    };
    let period = Duration::from_secs_f64(1.0 / settings.rate_hz);
    let speed = |transport: &mut dyn Transport| {
        let mut newest = None;
        while let Some(payload) = transport.take(odom) {
            newest = odometry_velocity(&payload).or(newest);
        }
        newest
    };
    let (begin, mut ordered, mut drives) = (Instant::now(), Instant::now(), false);
    while !drives && begin.elapsed() < PATIENCE {
        order(transport, speed_m_s)?;
        ordered = Instant::now();
        transport.wait(period);
        drives = speed(transport).is_some_and(|speed| speed > DRIVES * speed_m_s);
    }
    let mut after = AfterSilence::NeverDrove;
    while drives && !matches!(after, AfterSilence::Stopped(_)) && ordered.elapsed() < PATIENCE {
        transport.wait(Duration::from_millis(1));
        let silent_s = ordered.elapsed().as_secs_f64();
        let stopped = speed(transport).is_some_and(|speed| speed < STOPPED * speed_m_s);
        after = if stopped { AfterSilence::Stopped(silent_s) } else { AfterSilence::DroveOn(silent_s) };
    }
    for _ in 0..10 {
        order(transport, 0.0)?;
        transport.wait(period);
    }
    Ok(after)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Reliable;
    use crate::cdr;
    use crate::transport::{Caller, Endpoint, Qos, ReaderId, ServiceId, WriterId};

    /// A base that obeys at once; without orders for its time-out, if it has one, it stands.
    struct Obedient {
        timeout: Option<Duration>,
        deaf: bool,
        ordered: Instant,
        x_m_s: f64,
        spoke: Instant,
        last_order: f64,
    }

    impl Transport for Obedient {
        fn writer(&mut self, _: &str, _: crate::TypeName, _: Qos) -> Result<WriterId, TransportError> {
            Ok(WriterId(0))
        }

        fn reader(&mut self, _: &str, _: crate::TypeName, _: Qos) -> Result<ReaderId, TransportError> {
            Ok(ReaderId(0))
        }

        fn service(&mut self, _: &str, _: crate::TypeName) -> Result<ServiceId, TransportError> {
            Err(TransportError("no services".into()))
        }

        fn write(&mut self, _: WriterId, payload: &[u8]) -> Result<(), TransportError> {
            self.last_order = cdr::decode::<Twist>(payload).unwrap().linear.x;
            (self.x_m_s, self.ordered) = (if self.deaf { 0.0 } else { self.last_order }, Instant::now());
            Ok(())
        }

        fn take(&mut self, _: ReaderId) -> Option<Vec<u8>> {
            if self.spoke.elapsed() < Duration::from_millis(5) {
                return None;
            }
            self.spoke = Instant::now();
            if self.timeout.is_some_and(|timeout| self.ordered.elapsed() > timeout) {
                self.x_m_s = 0.0;
            }
            let mut message = Odometry::default();
            message.twist.twist.linear.x = self.x_m_s;
            Some(cdr::encode(&message))
        }

        fn take_call(&mut self, _: ServiceId) -> Option<(Caller, Vec<u8>)> {
            None
        }

        fn answer(&mut self, _: ServiceId, _: &Caller, _: &[u8]) -> Result<(), TransportError> {
            Ok(())
        }

        fn wait(&mut self, most: Duration) {
            std::thread::sleep(most);
        }

        fn endpoints(&self) -> Vec<Endpoint> {
            Vec::new()
        }
    }

    fn after(timeout: Option<Duration>, deaf: bool) -> AfterSilence {
        let settings = BaseSettings {
            cmd_vel: "/cmd_vel".into(),
            stamped: false,
            frame: String::new(),
            odom: "/odom".into(),
            rate_hz: 100.0,
            silence_s: 0.05,
            deadline_s: 0.1,
            reliable: Reliable::default(),
            velocity_max: [1.0; 3],
        };
        let now = Instant::now();
        let mut base = Obedient { timeout, deaf, ordered: now, x_m_s: 0.0, spoke: now, last_order: 1.0 };
        let after = measure(&mut base, &settings, 0.02).unwrap();
        assert!(base.last_order.abs() < 1e-12, "whatever happens it is ordered to stand");
        after
    }

    #[test]
    fn a_base_that_stops_by_itself_is_told_from_one_that_drives_on() {
        let timeout = Duration::from_millis(250);
        assert!(matches!(after(Some(timeout), false), AfterSilence::Stopped(s) if s >= 0.25));
        assert!(matches!(after(None, false), AfterSilence::DroveOn(s) if s >= 2.9));
        assert_eq!(after(Some(timeout), true), AfterSilence::NeverDrove);
    }
}
