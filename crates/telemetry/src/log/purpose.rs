//! Purposes that a log serves. Each has chunks of its own, so that a reader of one does not unpack the others.

use super::records::{LOOP_STATE_TOPIC, REPLAY_TOPIC, SERIAL_TOPICS};

/// Purpose of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Purpose {
    /// Contents for viewers.
    Display = 0,
    /// Bytes of the Touch Boards.
    Board = 1,
    /// Inputs of a replay.
    Replay = 2,
}

impl Purpose {
    pub(super) const ALL: [Self; 3] = [Self::Display, Self::Board, Self::Replay];

    /// Purpose of the messages of a topic.
    pub(super) fn of(topic: &str) -> Self {
        match topic {
            REPLAY_TOPIC | LOOP_STATE_TOPIC => Self::Replay,
            _ if SERIAL_TOPICS.contains(&topic) => Self::Board,
            _ => Self::Display,
        }
    }

    /// Compression level of its chunks, by zstd's numbers. Text for viewers gains by a search for repetitions. The high bytes of columns are
    /// zero and the low ones are noise, and neither gains.
    pub(super) const fn level(self) -> i32 {
        match self {
            Self::Display => 6,
            Self::Board => 6,
            Self::Replay => 1,
        }
    }
}

/// Set of purposes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Purposes(u8);

impl Purposes {
    /// Every purpose: of a chunk whose contents are not known.
    pub(super) const UNKNOWN: Self = Self(0b111);

    pub(super) const fn with(self, purpose: Purpose) -> Self {
        Self(self.0 | 1 << purpose as u8)
    }

    /// Adds the purpose of a channel; one that is not known may be of any.
    pub(super) fn and_of(self, channel: Option<&Purpose>) -> Self {
        channel.map_or(Self::UNKNOWN, |purpose| self.with(*purpose))
    }

    /// A chunk whose messages nobody lists may hold any.
    pub(super) fn or_unknown(self) -> Self {
        if self == Self::default() { Self::UNKNOWN } else { self }
    }

    pub(super) const fn has(self, purpose: Purpose) -> bool {
        self.0 & 1 << purpose as u8 != 0
    }

    /// Returns the purpose, if it is a single one.
    pub(super) fn single(self) -> Option<Purpose> {
        Purpose::ALL.into_iter().find(|purpose| self == Self::default().with(*purpose))
    }
}
