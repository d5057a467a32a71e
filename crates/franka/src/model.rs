//! Which arm answers: each speaks a version of FCI of its own.

/// An arm that speaks FCI.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// Franka Emika Panda.
    Panda,
    /// Franka Research 3.
    Fr3,
}

impl Model {
    /// Every one.
    pub const ALL: [Self; 2] = [Self::Panda, Self::Fr3];

    /// The one that speaks this version of FCI.
    pub fn of_version(version: u16) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.version() == version)
    }

    /// The one that `robot.arm` means by `key`.
    pub fn of_key(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.key() == key)
    }

    /// The version of FCI that it speaks.
    pub const fn version(self) -> u16 {
        match self {
            Self::Panda => 5,
            Self::Fr3 => 10,
        }
    }

    /// As a configuration calls it.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Panda => "panda",
            Self::Fr3 => "fr3",
        }
    }

    /// As its maker calls it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Panda => "Franka Emika Panda",
            Self::Fr3 => "Franka Research 3",
        }
    }
}
