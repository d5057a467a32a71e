//! Connections of other machines that have not shown a certificate yet.
//!
//! Their number is bounded, and beyond it the address that has most of them loses its oldest one. So a crowd of one machine, or of a
//! few, displaces itself, and a client of any other address is read at once.

use super::command::ClientId;
use std::{
    cell::RefCell,
    collections::VecDeque,
    net::{IpAddr, Ipv6Addr},
    rc::Rc,
};

/// Most connections over TLS that are not served yet.
const STRANGERS_MAX: usize = 64;
/// Bits of an IPv6 address that name a network: one machine has all addresses of its network.
const NETWORK_BITS: u32 = 64;

/// The connections, oldest first.
#[derive(Default)]
pub(super) struct Strangers(RefCell<VecDeque<(IpAddr, ClientId)>>);

/// Place of one of them; dropping it leaves.
pub(super) struct Place {
    of: Rc<Strangers>,
    id: ClientId,
}

impl Strangers {
    /// Gives a newcomer a place, and names the connection that has to go for it.
    pub(super) fn enter(self: &Rc<Self>, address: IpAddr, id: ClientId) -> (Place, Option<ClientId>) {
        let mut present = self.0.borrow_mut();
        present.push_back((network(address), id));
        let displaced = (present.len() > STRANGERS_MAX).then(|| oldest_of_most(&present)).flatten();
        let displaced = displaced.and_then(|at| present.remove(at)).map(|(_, id)| id);
        drop(present);
        (Place { of: Rc::clone(self), id }, displaced)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.of.0.borrow_mut().retain(|(_, id)| *id != self.id);
    }
}

/// Place of the oldest connection of the address that has most.
fn oldest_of_most(present: &VecDeque<(IpAddr, ClientId)>) -> Option<usize> {
    let of_address = |address| present.iter().filter(|(other, _)| *other == address).count();
    let counts: Vec<usize> = present.iter().map(|(address, _)| of_address(*address)).collect();
    let most = counts.iter().max()?;
    counts.iter().position(|count| count == most)
}

fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() >> NETWORK_BITS << NETWORK_BITS).into(),
        address => address,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine(number: u8) -> IpAddr {
        [192, 168, 0, number].into()
    }

    #[test]
    fn crowd_displaces_its_own_oldest_connection() {
        let strangers = Rc::new(Strangers::default());
        let mut places = Vec::new();
        let mut enter = |address, id| {
            let (place, displaced) = strangers.enter(address, id);
            places.push(place);
            displaced
        };
        assert_eq!(enter(machine(1), 1000), None);
        for id in 0..STRANGERS_MAX as u64 - 1 {
            assert_eq!(enter(machine(2), id), None);
        }
        for id in 0..200 {
            assert_eq!(
                enter(machine(2), id + STRANGERS_MAX as u64 - 1),
                Some(id),
                "its own, not the other's"
            );
        }
        assert_eq!(enter(machine(3), 2000), Some(200), "a third machine gets in");
        assert_eq!(strangers.0.borrow().len(), STRANGERS_MAX);
        drop(places);
        assert!(strangers.0.borrow().is_empty());
    }

    #[test]
    fn machines_of_one_connection_each_take_turns() {
        let strangers = Rc::new(Strangers::default());
        let mut places = Vec::new();
        for id in 0..200 {
            let (place, displaced) = strangers.enter(machine(u8::try_from(id).unwrap()), id);
            places.push(place);
            assert_eq!(displaced, id.checked_sub(STRANGERS_MAX as u64));
        }
    }

    #[test]
    fn addresses_of_one_network_count_as_one() {
        let address = |text: &str| network(text.parse().unwrap());
        assert_eq!(address("2001:db8::1"), address("2001:db8::ffff:2"));
        assert_ne!(address("2001:db8::1"), address("2001:db8:0:1::1"));
        assert_eq!(address("::ffff:192.168.0.1"), machine(1));
    }
}
