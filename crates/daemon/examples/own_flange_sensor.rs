//! A force-torque sensor of your own at the flange: implement [`FlangeSensor`], return it from `Plant::flange_sensor`, and set
//! `plant.flange_sensor = "own"`. This one sends datagrams of six numbers, N and N·m; a second of a sensor that reads a tool of 1 kg.
//!
//! `cargo run --example own_flange_sensor`

use moca_control::flange_sensor::{FlangeReading, FlangeSensor};
use std::net::UdpSocket;
use std::time::{Duration, Instant};

/// Your driver: the newest datagram and its arrival.
struct UdpSensor {
    socket: UdpSocket,
    newest: Option<([f64; 6], Instant)>,
}

impl UdpSensor {
    fn new(address: &str) -> std::io::Result<Self> {
        let socket = UdpSocket::bind(address)?;
        socket.set_nonblocking(true)?; // the loop never waits for it
        Ok(Self { socket, newest: None })
    }
}

impl FlangeSensor for UdpSensor {
    fn latest(&mut self) -> Option<FlangeReading> {
        let mut bytes = [0; 6 * 8];
        // Bounded, however fast datagrams come.
        for _ in 0..16 {
            match self.socket.recv(&mut bytes) {
                Ok(length) if length == bytes.len() => {
                    let mut wrench = [0.0; 6];
                    for (value, bytes) in wrench.iter_mut().zip(bytes.as_chunks().0) {
                        *value = f64::from_le_bytes(*bytes);
                    }
                    self.newest = Some((wrench, Instant::now()));
                }
                Ok(_) => {}      // not a reading
                Err(_) => break, // nothing more has arrived
            }
        }
        // Range, NaN, age and repeated bits are checked by the loop.
        self.newest.map(|(wrench, arrived)| FlangeReading { wrench, age_s: arrived.elapsed().as_secs_f64() })
    }
}

fn main() -> std::io::Result<()> {
    let mut sensor = UdpSensor::new("127.0.0.1:0")?;
    let hardware = UdpSocket::bind("127.0.0.1:0")?;
    for millinewtons in 0..100 {
        let wrench = [0.0, 0.0, -9.81 + 1e-3 * f64::from(millinewtons % 7), 0.0, 0.0, 0.0];
        hardware.send_to(wrench.map(f64::to_le_bytes).as_flattened(), sensor.socket.local_addr()?)?;
        std::thread::sleep(Duration::from_millis(10));
        eprintln!("{:?}", sensor.latest());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newest_whole_datagram_is_the_reading() {
        let mut sensor = UdpSensor::new("127.0.0.1:0").unwrap();
        assert_eq!(sensor.latest(), None);
        let hardware = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = sensor.socket.local_addr().unwrap();
        let wrenches = [[1.0; 6], [0.5, -2.0, 3.0, 0.1, -0.2, f64::MAX]];
        for wrench in wrenches {
            hardware.send_to(wrench.map(f64::to_le_bytes).as_flattened(), address).unwrap();
        }
        hardware.send_to(b"not a reading", address).unwrap();
        let read = |sensor: &mut UdpSensor| sensor.latest().unwrap();
        let first = read(&mut sensor);
        assert_eq!(first.wrench.map(f64::to_bits), wrenches[1].map(f64::to_bits));
        assert!(read(&mut sensor).age_s >= first.age_s, "silence makes it older");
    }
}
