//! Protection of the people around the robot, as a client sees it: speed limit in force, and contacts.
//!
//! ```
//! use moca_msgs::{SpeedLimit, SpeedLimitReason};
//!
//! let unknown = SpeedLimit::default();
//! assert_eq!((unknown.m_s, unknown.reason), (0.0, SpeedLimitReason::Stale), "what is not known does not move");
//! assert_eq!(unknown.to_string(), "0.000 m/s (stale data)");
//! ```

use core::fmt;

/// Contacts up to this long are transient, longer ones quasi-static, s (ISO/TS 15066, 5.5.4).
pub const TRANSIENT_S: f64 = 0.5;
/// Most contact events a sample can carry; further ones wait for the next tick.
pub const MAX_CONTACT_EVENTS: usize = 4;
/// Most taxels whose [`ContactRow`] a sample can carry.
pub const MAX_CONTACT_ROWS: usize = 4;
/// Smallest excess over a row of the contact barrier that is an event, m/s.
pub const NO_ROOM_M_S: f64 = 0.02;

/// Displacement of the base from which on recentring is worth it, m and rad.
const OFFSET_M: f64 = 0.02;
const OFFSET_RAD: f64 = 0.05;

/// Largest speed of any point of the cover, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SpeedLimit {
    /// m/s.
    pub m_s: f64,
    /// Why.
    pub reason: SpeedLimitReason,
}

/// Why the speed limit is what it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum SpeedLimitReason {
    /// The board is fast enough: `limits.base_velocity` allows less than it would.
    Configured,
    /// Force limit over contact stiffness and delay, for the measured rate and age of the board.
    BoardRate,
    /// The board's rate is unknown, or its data is older than one frame of it explains.
    #[default]
    Stale,
    /// The configuration states another limit and why.
    Overridden,
    /// A contact crossed a limit of the user's and the reaction is to slow down.
    Contact,
    /// The base stops later than its measured stopping distance says.
    BaseLate,
}

impl SpeedLimitReason {
    /// Name as shown to users.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Configured => "configured",
            Self::BoardRate => "board rate",
            Self::Stale => "stale data",
            Self::Overridden => "overridden",
            Self::Contact => "contact",
            Self::BaseLate => "late base",
        }
    }
}

/// `0.047 m/s (board rate)`.
impl fmt::Display for SpeedLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3} m/s ({})", self.m_s, self.reason.name())
    }
}

/// Reaction of the robot to a contact that crosses a limit, until that contact ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum ContactReaction {
    /// The base goes on at a lower speed.
    Slow,
    /// The touched part of the cover no longer moves outward; every other motion goes on.
    #[default]
    #[cfg_attr(feature = "serde", serde(alias = "stop_direction"))]
    StopDirection,
    /// The base moves away from the touched part of the cover, a stated way, then as `StopDirection`.
    Retreat,
}

crate::choice!(ContactReaction { Slow: "slow", StopDirection: "stop-direction", Retreat: "retreat" });

/// Displacement of the base from where it stands with the tool in its place and the arm in its posture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PostureOffset {
    /// Distance, m.
    pub distance_m: f64,
    /// Angle about the vertical, rad.
    pub angle_rad: f64,
    /// True while the base drives back on request.
    pub recentring: bool,
}

impl PostureOffset {
    /// Returns true if the base is so far off that recentring is worth it.
    pub const fn is_large(&self) -> bool {
        self.distance_m > OFFSET_M || self.angle_rad.abs() > OFFSET_RAD
    }
}

/// `off by 0.031 m and 2.4°, going back`.
impl fmt::Display for PostureOffset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "off by {:.3} m and {:.1}°", self.distance_m, self.angle_rad.to_degrees())?;
        f.write_str(if self.recentring { ", going back" } else { "" })
    }
}

impl ContactReaction {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Slow, Self::StopDirection, Self::Retreat];

    /// Name as in the configuration.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Slow => "slow",
            Self::StopDirection => "stop-direction",
            Self::Retreat => "retreat",
        }
    }
}

/// Event in the course of a contact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ContactPhase {
    /// The taxel began to feel a force.
    #[default]
    Started,
    /// The force crossed the limit of its kind.
    LimitCrossed,
    /// The taxel feels nothing any more.
    Finished,
    /// The taxel became unusable while in contact: how the contact ended is unknown.
    Lost,
    /// The base cannot make the room that the contact barrier asks for: somebody else, or its own limits.
    NoRoom,
}

impl ContactPhase {
    /// Returns true if somebody should look after the contact.
    pub const fn is_warning(self) -> bool {
        matches!(self, Self::LimitCrossed | Self::Lost | Self::NoRoom)
    }

    /// Name as shown to users.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Started => "started",
            Self::LimitCrossed => "limit crossed",
            Self::Finished => "finished",
            Self::Lost => "lost",
            Self::NoRoom => "no room",
        }
    }
}

/// Class of a contact by its duration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ContactKind {
    /// Up to [`TRANSIENT_S`].
    #[default]
    Transient,
    /// Longer: a clamp, or somebody who leans.
    QuasiStatic,
}

impl ContactKind {
    /// Name as shown to users.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Transient => "transient",
            Self::QuasiStatic => "quasi-static",
        }
    }
}

/// A contact of one taxel when something happened to it; forces as the board reads them, so later and coarser than
/// they are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ContactEvent {
    /// 0 is T1.
    pub taxel: u8,
    /// Event of the contact.
    pub phase: ContactPhase,
    /// Class of the contact so far.
    pub kind: ContactKind,
    /// Loop time at which it was first felt, ns.
    pub started_ns: u64,
    /// Time since then, s.
    pub duration_s: f64,
    /// Largest force, N.
    pub peak_n: f64,
    /// Mean force after the first [`TRANSIENT_S`], N; 0 for a transient contact.
    pub clamp_mean_n: f64,
    /// Largest force after the first [`TRANSIENT_S`], N; 0 for a transient contact.
    pub clamp_max_n: f64,
    /// Time integral of the force, N·s.
    pub impulse_n_s: f64,
    /// The user's limit that the contact has crossed, N: the lower one if both.
    pub crossed_n: Option<f64>,
    /// Reaction of the robot.
    pub reaction: Option<ContactReaction>,
    /// Excess of the ordered outward speed over the contact barrier, m/s, when there was no room.
    pub excess_m_s: f64,
}

/// The taxel and what happened, with the contact's forces and the robot's reaction.
impl fmt::Display for ContactEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "T{} ", u16::from(self.taxel) + 1)?;
        f.write_str(match self.phase {
            ContactPhase::Started => return f.write_str("is touched"),
            ContactPhase::NoRoom => {
                let m_s = self.excess_m_s;
                return write!(
                    f,
                    "has no room: ordered {m_s:.3} m/s faster outward than the contact barrier allows"
                );
            }
            ContactPhase::LimitCrossed => "crossed a limit",
            ContactPhase::Finished => "was released",
            ContactPhase::Lost => "became unusable while it was touched",
        })?;
        write!(f, ": {} {:.2} s, peak {:.1} N", self.kind.name(), self.duration_s, self.peak_n)?;
        if self.kind == ContactKind::QuasiStatic {
            write!(f, ", clamp {:.1} N mean, {:.1} N at most", self.clamp_mean_n, self.clamp_max_n)?;
        }
        write!(f, ", impulse {:.2} N·s", self.impulse_n_s)?;
        match (self.crossed_n, self.reaction) {
            (Some(limit_n), Some(reaction)) => write!(f, " | above {limit_n} N: {}", reaction.name()),
            _ => Ok(()),
        }
    }
}

/// Bound of the contact barrier on a touched or lately released taxel, and its motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ContactRow {
    /// 0 is T1.
    pub taxel: u8,
    /// Compression as it is believed now, m; 0 after a release.
    pub depth_m: f64,
    /// The person's own speed towards the cover, m/s.
    pub person_m_s: f64,
    /// Fastest outward, m/s; below 0 it has to give way.
    pub allowed_m_s: f64,
    /// Outward, as measured, m/s.
    pub outward_m_s: f64,
    /// Excess of the ordered speed over the bound, m/s.
    pub excess_m_s: f64,
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::string::ToString;

    #[test]
    fn contact_is_told_with_its_forces_and_reaction() {
        let transient = ContactEvent {
            taxel: 2,
            duration_s: 0.31,
            peak_n: 12.04,
            impulse_n_s: 3.2,
            ..ContactEvent::default()
        };
        let clamp = ContactEvent {
            kind: ContactKind::QuasiStatic,
            clamp_mean_n: 50.0,
            clamp_max_n: 60.0,
            crossed_n: Some(65.0),
            reaction: Some(ContactReaction::Slow),
            excess_m_s: 0.025,
            ..transient
        };
        for (event, phase, words) in [
            (transient, ContactPhase::Started, "T3 is touched"),
            (
                transient,
                ContactPhase::Finished,
                "T3 was released: transient 0.31 s, peak 12.0 N, impulse 3.20 N·s",
            ),
            (
                clamp,
                ContactPhase::LimitCrossed,
                "T3 crossed a limit: quasi-static 0.31 s, peak 12.0 N, clamp 50.0 N mean, 60.0 N at most, impulse 3.20 N·s | above 65 \
                 N: slow",
            ),
            (
                clamp,
                ContactPhase::NoRoom,
                "T3 has no room: ordered 0.025 m/s faster outward than the contact barrier allows",
            ),
        ] {
            assert_eq!(ContactEvent { phase, ..event }.to_string(), words);
            assert_eq!(
                phase.is_warning(),
                matches!(phase, ContactPhase::LimitCrossed | ContactPhase::NoRoom)
            );
        }
        assert!(ContactPhase::Lost.is_warning());
    }

    #[test]
    fn posture_far_off_is_worth_recentring() {
        let offset = |distance_m, angle_rad| PostureOffset { distance_m, angle_rad, recentring: false };
        for (offset, is_large) in
            [(offset(0.02, 0.05), false), (offset(0.021, 0.0), true), (offset(0.0, -0.051), true)]
        {
            assert_eq!(offset.is_large(), is_large, "{offset}");
        }
        let back = PostureOffset { recentring: true, ..offset(0.031, -0.1) };
        assert_eq!(back.to_string(), "off by 0.031 m and -5.7°, going back");
    }
}
