//! One cell of the scan: who is met where, felt by which board, at which share of what physics allows.

use crate::paper::collision;
use crate::rig::bound;
use crate::rig::settings::{Sensor, Settings};
use anyhow::Result;
use moca_daemon::config::{AssumedModel, BarrierReadings, Config, ProtectionConfig};
use moca_msgs::Law as Mode;
use moca_sim::foam::Foam;
use moca_sim::sensor::Noise;
use moca_tactile::Firmware;

/// Phases of the sensor against the motion: the worst counts.
pub(super) const PHASES: u32 = 8;
/// Time for which the base is led before the touch: as long as it needs to run evenly, s.
const LEAD_S: f64 = 2.0;

/// Centres of the taxels, and beside two of them the front corners.
const PLACES: [(&str, usize, f64); 15] = [
    ("T1", 0, 0.0),
    ("T2", 1, 0.0),
    ("T3", 2, 0.0),
    ("T4", 3, 0.0),
    ("T5", 4, 0.0),
    ("T6", 5, 0.0),
    ("T7", 6, 0.0),
    ("T8", 7, 0.0),
    ("T9", 8, 0.0),
    ("T10", 9, 0.0),
    ("T11", 10, 0.0),
    ("corner T4", 3, -0.11),
    ("corner T8", 7, 0.11),
    ("off T6", 5, 0.1),
    ("off T5", 4, -0.1),
];
const BOARDS: [Firmware; 3] = [Firmware::Stock2018, Firmware::Stock2015, Firmware::Moca];
/// Name, stiffness in N/m, held against a wall or standing free.
const PERSONS: [(&str, f64, bool); 6] = [
    ("free 50 N/mm", 50e3, false),
    ("held 5 N/mm", 5e3, true),
    ("held 20 N/mm", 20e3, true),
    ("held 50 N/mm", 50e3, true),
    ("held 75 N/mm", 75e3, true),
    ("held rigid", 1e7, true),
];
const FOAMS: [f64; 3] = [0.5, 1.0, 2.0];
const SHARES: [f64; 3] = [0.6, 0.8, 0.95];
const MEETINGS: [Meeting; 2] = [Meeting::Led, Meeting::Walks];

/// Who comes to whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Meeting {
    /// The flange is led, and the base goes into the person.
    Led,
    /// The person walks into the standing base.
    Walks,
}

/// What protects the person.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Law {
    /// As shipped for a cover that has not been calibrated: the base is slow.
    Shipped,
    /// The contact barrier with the speed limit that goes with it.
    Barrier,
    /// The contact barrier alone: the speed is the cell's.
    BarrierAlone,
}

impl Law {
    pub(super) const ALL: [Self; 3] = [Self::Shipped, Self::Barrier, Self::BarrierAlone];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Shipped => "shipped",
            Self::Barrier => "barrier",
            Self::BarrierAlone => "barrier-alone",
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    place: (&'static str, usize, f64),
    pub(super) meeting: Meeting,
    pub(super) board: Firmware,
    person: (&'static str, f64, bool),
    pub(super) foam: f64,
    pub(super) share: f64,
}

/// Names of a cell's columns.
pub(super) const COLUMNS: &str = "place,meeting,board,person,foam,share,speed_m_s";

impl Cell {
    /// The whole grid.
    fn grid() -> Vec<Self> {
        let mut cells = Vec::new();
        for place in PLACES {
            for meeting in MEETINGS {
                for board in BOARDS {
                    for person in PERSONS {
                        for foam in FOAMS {
                            cells.extend(SHARES.map(|share| Self {
                                place,
                                meeting,
                                board,
                                person,
                                foam,
                                share,
                            }));
                        }
                    }
                }
            }
        }
        cells
    }

    /// A leg that nothing holds back walks into the middle of `taxel` (0 is T1).
    pub(super) fn walk_in(board: Firmware, taxel: usize, walk_m_s: f64) -> Result<Self> {
        let cell = Self {
            place: PLACES[taxel],
            meeting: Meeting::Walks,
            board,
            person: PERSONS[3],
            foam: 1.0,
            share: 1.0,
        };
        Ok(Self { share: walk_m_s / cell.bound_m_s()?, ..cell })
    }

    /// Every place both ways, with every board, body, foam and share among them.
    pub(super) fn short() -> Vec<Self> {
        let count = PLACES.len() * MEETINGS.len();
        let cell = |i: usize| Self {
            place: PLACES[i % PLACES.len()],
            meeting: MEETINGS[i / PLACES.len()],
            board: BOARDS[(i + i / 6) % BOARDS.len()],
            person: PERSONS[i % PERSONS.len()],
            foam: FOAMS[(i / 2 + i / PLACES.len()) % FOAMS.len()],
            share: SHARES[(i / 3 + i / 9) % SHARES.len()],
        };
        (0..count).map(cell).collect()
    }

    /// So many cells of the grid, or all there are, in a random order: more are the same ones and others.
    pub(super) fn sample(count: usize, seed: u64) -> Vec<Self> {
        let mut cells = Self::grid();
        let mut draw = Noise::new(seed);
        for i in (1..cells.len()).rev() {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
            let other = (draw.uniform() * (i + 1) as f64) as usize;
            cells.swap(i, other.min(i));
        }
        cells.truncate(count);
        cells
    }

    /// As [`COLUMNS`].
    pub(super) fn columns(&self) -> Result<String> {
        let meeting = if self.meeting == Meeting::Led { "led" } else { "walks" };
        let (place, person, board) = (self.place.0, self.person.0, self.board.name());
        Ok(format!(
            "{place},{meeting},{board},{person},{},{},{:.4}",
            self.foam,
            self.share,
            self.share * self.bound_m_s()?
        ))
    }

    /// Largest speed that physics allows here, m/s.
    pub(super) fn bound_m_s(&self) -> Result<f64> {
        self.meeting_there().bound_m_s()
    }

    /// Cover and body.
    pub(super) fn meeting_there(&self) -> bound::Meeting {
        let base = Config::default().robot.base;
        bound::Meeting {
            foam: Foam::COLLISION_ASSUMED.stiffened(self.foam),
            tissue_n_m: self.person.1,
            limit_n: ProtectionConfig::default().force_limit_n,
            deceleration_m_s2: base.acceleration_max_m_s2,
            servo_s: base.servo_time_constant_s,
            board: self.board,
        }
    }

    /// The run of one phase under a law.
    pub(super) fn settings(&self, law: Law, phase: u32) -> Result<Settings> {
        let mut settings = Settings::paper(Mode::Impedance);
        collision::defaults(&mut settings);
        settings.config.control.corrections.null_space_damping = true;
        settings.config.control.corrections.base_coupling = true;
        settings.config.board.model = AssumedModel::PuLd30;
        if law != Law::BarrierAlone {
            settings.config.protection = ProtectionConfig::default();
        }
        if law != Law::Shipped {
            // on by default where the cover is calibrated, which says how stiff its foam is
            settings.config.protection.contact_barrier = BarrierReadings::PuLd30;
            settings.config.robot.cover.foam_stiffness_n_m *= self.foam;
        }
        let speed_m_s = self.share * self.bound_m_s()?;
        settings.sensor = Sensor::Stock;
        settings.firmware = self.board;
        settings.foam.scale = self.foam;
        settings.sensor_phase_ms = settings.period_ms() * f64::from(phase) / f64::from(PHASES);
        let (_, stiffness, held) = self.person;
        settings.person.taxel = self.place.1;
        settings.person.offset_m = self.place.2;
        settings.person.stiffness = Some(stiffness);
        settings.person.fixed = held;
        settings.person.steps_away_s = 1000.0;
        settings.person.gap_m = LEAD_S * speed_m_s;
        match self.meeting {
            Meeting::Led => settings.speed_m_s = speed_m_s.min(0.25),
            Meeting::Walks => (settings.speed_m_s, settings.person.walk_m_s) = (0.0, speed_m_s),
        }
        settings.check()?;
        Ok(settings)
    }
}
