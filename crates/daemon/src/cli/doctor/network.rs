//! The network card behind which a part of the robot is, and which cores its interrupts take.

use super::finding::Finding;
use std::fs;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};

/// Finds out if interrupts of the card to `host` stay away from the loop's core.
pub(super) fn card_of(host: &str, loop_cpu: Option<usize>) -> Finding {
    let Some(card) = address_towards(host).and_then(card_with) else {
        return Finding::new(WHAT, false, format!("none leads to {host}"))
            .or("an address on the arm's network for this PC");
    };
    let interrupts = fs::read_to_string("/proc/interrupts").unwrap_or_default();
    let cores: Vec<String> = interrupts_of(&interrupts, &card)
        .filter_map(|number| fs::read_to_string(format!("/proc/irq/{number}/smp_affinity_list")).ok())
        .map(|list| list.trim().to_owned())
        .collect();
    judged(&card, &cores, loop_cpu)
}

const WHAT: &str = "network card";

fn judged(card: &str, cores: &[String], loop_cpu: Option<usize>) -> Finding {
    if cores.is_empty() {
        return Finding::new(WHAT, true, format!("{card}, without interrupts of its own"));
    }
    let meets = loop_cpu.is_some_and(|cpu| cores.iter().any(|list| holds(list, cpu)));
    Finding::new(WHAT, !meets, format!("{card}, interrupts on cores {}", cores.join("; "))).or(
        "keep them off the loop's core (realtime.cpu): echo CORE > /proc/irq/N/smp_affinity_list, and stop irqbalance",
    )
}

/// Numbers of the interrupts whose name has `card` in it.
fn interrupts_of<'a>(table: &'a str, card: &'a str) -> impl Iterator<Item = u32> + 'a {
    table.lines().filter_map(move |line| {
        let (number, rest) = line.split_once(':')?;
        let named = rest.split_whitespace().any(|word| word.split(['-', '@']).any(|part| part == card));
        number.trim().parse().ok().filter(|_| named)
    })
}

/// Returns true if a list such as `0-3,5` holds `cpu`.
fn holds(list: &str, cpu: usize) -> bool {
    list.split(',').any(|range| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        first.parse().is_ok_and(|first: usize| first <= cpu)
            && last.parse().is_ok_and(|last: usize| cpu <= last)
    })
}

/// This PC's address on the way to `host`. Nothing is sent.
fn address_towards(host: &str) -> Option<Ipv4Addr> {
    let host = if host.contains(':') { host.to_owned() } else { format!("{host}:1337") };
    let socket = UdpSocket::bind("0.0.0.0:0").ok()?;
    socket.connect(host).ok()?;
    match socket.local_addr().ok()? {
        SocketAddr::V4(address) => Some(*address.ip()),
        SocketAddr::V6(_) => None,
    }
}

fn card_with(address: Ipv4Addr) -> Option<String> {
    let addresses = nix::ifaddrs::getifaddrs().ok()?;
    let on = |card: &nix::ifaddrs::InterfaceAddress| {
        card.address.as_ref()?.as_sockaddr_in().map(|own| own.ip() == address)
    };
    addresses.into_iter().find(|card| on(card) == Some(true)).map(|card| card.interface_name)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: &str = "           CPU0       CPU1\n  24:  0  7  PCI-MSI 1-edge  eth0-rx-0\n 25:  0  7  PCI-MSI 2-edge  \
                         eth0-tx-0\n 26: 1 1 PCI-MSI 3-edge eth01\n NMI: 0 0 Non-maskable\n 27: 4 4 PCI-MSI 4-edge eth0\n";

    #[test]
    fn a_card_has_its_interrupts_and_no_others() {
        assert!(interrupts_of(TABLE, "eth0").eq([24, 25, 27]));
        assert_eq!(interrupts_of(TABLE, "lo").count(), 0);
    }

    #[test]
    fn interrupts_on_the_loops_core_are_told() {
        assert!(holds("0-3,5", 5) && holds("0-3,5", 2) && !holds("0-3,5", 4) && !holds("", 0));
        let cores = ["0-1".to_owned(), "3".to_owned()];
        assert!(!judged("eth0", &cores, Some(3)).good && judged("eth0", &cores, Some(2)).good);
        assert!(judged("eth0", &cores, None).good && judged("lo", &[], Some(0)).good);
    }

    #[test]
    fn the_way_to_this_pc_is_its_loopback() {
        assert_eq!(card_with(address_towards("127.0.0.1:1").unwrap()).as_deref(), Some("lo"));
    }
}
