//! One cell of the scan: who is met where, felt by which board, at which share of what physics allows.

use anyhow::Result;
use moca_control::config::{AssumedModel, BarrierReadings, Config, ProtectionConfig};
use moca_experiments::bound;
use moca_experiments::collision;
use moca_experiments::meeting::Meeting;
use moca_experiments::settings::{Sensor, Settings};
use moca_msgs::Law as Mode;
use moca_sim::foam::Foam;
use moca_sim::sensor::Noise;
use moca_tactile::Firmware;

/// Phases of the sensor against the motion: the worst counts.
pub(super) const PHASES: u32 = 16;
/// Time for which the base is led before the touch: as long as it needs to run evenly, s.
const LEAD_S: f64 = 2.0;

/// Centres of the taxels, the front corners, off the middle, a seam, and two at once.
const PLACES: [Place; 19] = [
    Place::at("T1", 0, 0.0),
    Place::at("T2", 1, 0.0),
    Place::at("T3", 2, 0.0),
    Place::at("T4", 3, 0.0),
    Place::at("T5", 4, 0.0),
    Place::at("T6", 5, 0.0),
    Place::at("T7", 6, 0.0),
    Place::at("T8", 7, 0.0),
    Place::at("T9", 8, 0.0),
    Place::at("T10", 9, 0.0),
    Place::at("T11", 10, 0.0),
    Place::at("corner T4", 3, -0.11),
    Place::at("corner T8", 7, 0.11),
    Place::at("off T6", 5, 0.1),
    Place::at("off T5", 4, -0.1),
    Place { sharing: 2.0, ..Place::at("seam T5 T6", 5, bound::TO_THE_SEAM_M) },
    Place::two("T5 and T7", 4, 6),
    Place::two("T2 and T4", 1, 3),
    Place::two("T2 and T9", 1, 8),
];
/// Those of them that go all round: the taxels, the corners and the seam.
pub(super) const AROUND: [usize; 14] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15];
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
/// Forces of the leans at each of them, N.
const LEANS_N: [f64; 3] = [10.0, 20.0, 40.0];
const MEETINGS: [Meeting; 4] = [Meeting::Led, Meeting::Walks, Meeting::Leans, Meeting::ByHand];
/// Name; what the base brakes with, how late its servo is and what the cover reads, over what is believed of it.
const TRUTHS: [(&str, [f64; 3]); 5] = [
    ("as described", [1.0, 1.0, 1.0]),
    ("brakes 30 % less", [0.7, 1.0, 1.0]),
    ("servo twice as late", [1.0, 2.0, 1.0]),
    ("reads 20 % less", [1.0, 1.0, 0.8]),
    ("reads 20 % more", [1.0, 1.0, 1.2]),
];
const SEEDS: [u64; 3] = [1, 2, 3];

/// Place of a meeting.
#[derive(Clone, Copy, Debug)]
struct Place {
    name: &'static str,
    /// 0 is T1.
    taxel: usize,
    offset_m: f64,
    /// Another one at the same time.
    also: Option<usize>,
    /// Number of taxels that read equal parts of a body there.
    sharing: f64,
}

impl Place {
    const fn at(name: &'static str, taxel: usize, offset_m: f64) -> Self {
        Self { name, taxel, offset_m, also: None, sharing: 1.0 }
    }

    const fn two(name: &'static str, taxel: usize, also: usize) -> Self {
        Self { name, taxel, offset_m: 0.0, also: Some(also), sharing: 1.0 }
    }
}

/// Protection of the person.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Law {
    /// The speed limit alone: the base is slow.
    SpeedLimit,
    /// As shipped for a cover that has not been calibrated: the speed limit, and a cap on the push.
    Uncalibrated,
    /// The contact barrier with the speed limit that goes with it.
    Barrier,
    /// The contact barrier alone: the speed is the cell's.
    BarrierAlone,
}

impl Law {
    /// Those of a campaign.
    pub(super) const ALL: [Self; 3] = [Self::SpeedLimit, Self::Barrier, Self::BarrierAlone];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::SpeedLimit => "speed-limit",
            Self::Uncalibrated => "uncalibrated",
            Self::Barrier => "barrier",
            Self::BarrierAlone => "barrier-alone",
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    place: Place,
    pub(super) meeting: Meeting,
    pub(super) board: Firmware,
    person: (&'static str, f64, bool),
    pub(super) foam: f64,
    pub(super) share: f64,
    truth: (&'static str, [f64; 3]),
    seed: u64,
}

/// Names of a cell's columns.
pub(super) const COLUMNS: &str = "place,meeting,board,person,foam,share,truth,seed,speed_m_s";

impl Cell {
    /// The whole grid: all seeds of a robot as described, one of each that is otherwise.
    fn grid() -> Vec<Self> {
        let mut cells = Vec::new();
        for place in PLACES {
            for meeting in MEETINGS {
                for board in BOARDS {
                    for person in PERSONS {
                        for (foam, share) in FOAMS.iter().flat_map(|foam| SHARES.map(|share| (*foam, share)))
                        {
                            let cell = |truth, seed| Self {
                                place,
                                meeting,
                                board,
                                person,
                                foam,
                                share,
                                truth,
                                seed,
                            };
                            cells.extend(SEEDS.map(|seed| cell(TRUTHS[0], seed)));
                            cells.extend(TRUTHS[1..].iter().map(|truth| cell(*truth, SEEDS[0])));
                        }
                    }
                }
            }
        }
        cells
    }

    /// A held leg of 50 N/mm at one of [`PLACES`], met at a speed instead of a share of the bound.
    pub(super) fn at_speed(place: usize, meeting: Meeting, board: Firmware, speed_m_s: f64) -> Result<Self> {
        let cell = Self {
            place: PLACES[place],
            meeting,
            board,
            person: PERSONS[3],
            foam: 1.0,
            share: 1.0,
            truth: TRUTHS[0],
            seed: SEEDS[0],
        };
        Ok(Self { share: speed_m_s / cell.bound_m_s()?, ..cell })
    }

    pub(super) const fn place_name(place: usize) -> &'static str {
        PLACES[place].name
    }

    /// Every place in each way, with every board, body, foam and share among them, of a robot as described.
    pub(super) fn short() -> Vec<Self> {
        let count = PLACES.len() * MEETINGS.len();
        let cell = |i: usize| Self {
            place: PLACES[i % PLACES.len()],
            meeting: MEETINGS[i / PLACES.len()],
            board: BOARDS[(i + i / 6) % BOARDS.len()],
            person: PERSONS[i % PERSONS.len()],
            foam: FOAMS[(i / 2 + i / PLACES.len()) % FOAMS.len()],
            share: SHARES[(i / 3 + i / 9) % SHARES.len()],
            truth: TRUTHS[0],
            seed: SEEDS[0],
        };
        (0..count).map(cell).collect()
    }

    /// Returns a number of cells of the grid, or all, in a random order: a larger number adds cells to a smaller one.
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

    /// Describes place, mover, board, body, foam and speed.
    pub(super) fn words(&self) -> String {
        let Self { place, meeting, board, person, foam, share, .. } = self;
        let (place, meeting, board, person) = (place.name, meeting.name(), board.name(), person.0);
        format!("{place}, {meeting}, {board}, {person}, foam × {foam}, {share}")
    }

    /// As [`COLUMNS`].
    pub(super) fn columns(&self) -> Result<String> {
        let speed_m_s = if self.meeting == Meeting::Leans { 0.0 } else { self.share * self.bound_m_s()? };
        let Self { place, meeting, board, person, foam, share, truth, seed } = self;
        let (place, meeting, board) = (place.name, meeting.name(), board.name());
        Ok(format!("{place},{meeting},{board},{},{foam},{share},{},{seed},{speed_m_s:.4}", person.0, truth.0))
    }

    /// Largest speed that physics allows here for a robot as described, m/s.
    pub(super) fn bound_m_s(&self) -> Result<f64> {
        Self { truth: TRUTHS[0], ..*self }.meeting_there().bound_m_s()
    }

    /// Cover and body, and the base as it really is.
    pub(super) fn meeting_there(&self) -> bound::Meeting {
        let base = Config::default().robot.base;
        let [braking, servo, _] = self.truth.1;
        bound::Meeting {
            foam: Foam::COLLISION_ASSUMED.stiffened(self.foam),
            tissue_n_m: self.person.1,
            limit_n: ProtectionConfig::default().force_limit_n,
            deceleration_m_s2: braking * base.acceleration_max_m_s2,
            servo_s: servo * base.servo_time_constant_s,
            order_delay_s: 0.0,
            board: self.board,
            sharing: self.place.sharing,
        }
    }

    /// The run of one phase under a law.
    pub(super) fn settings(&self, law: Law, phase: u32) -> Result<Settings> {
        let follows = self.meeting == Meeting::ByHand;
        let mut settings = Settings::paper(if follows { Mode::FollowMe } else { Mode::Impedance });
        collision::defaults(&mut settings);
        settings.config.control.corrections.null_space_damping = true;
        settings.config.control.corrections.base_coupling = true;
        settings.config.board.model = AssumedModel::PuLd30;
        if law != Law::BarrierAlone {
            settings.config.protection = ProtectionConfig::default();
        }
        settings.config.protection.contact_barrier = match law {
            Law::SpeedLimit => BarrierReadings::Off,
            Law::Uncalibrated => BarrierReadings::Auto,
            Law::Barrier | Law::BarrierAlone => BarrierReadings::PuLd30,
        };
        if matches!(law, Law::Barrier | Law::BarrierAlone) {
            // on by default where the cover is calibrated, which says how stiff its foam is
            settings.config.robot.cover.foam_stiffness_n_m *= self.foam;
        }
        let speed_m_s = self.share * self.bound_m_s()?;
        settings.sensor = Sensor::Stock;
        settings.firmware = self.board;
        settings.config.simulation.truth.foam.scale = self.foam;
        settings.shift_phase(f64::from(phase) / f64::from(PHASES));
        let [braking, servo, reading] = self.truth.1;
        let (base, believed) = (&mut settings.config.simulation.truth.base, &settings.config.robot.base);
        base.acceleration_m_s2 = braking * believed.acceleration_max_m_s2;
        base.servo_ms = 1e3 * (servo * believed.servo_time_constant_s);
        settings.true_reading = reading;
        settings.config.simulation.seed = self.seed;
        let (_, stiffness, held) = self.person;
        settings.person.taxel = self.place.taxel;
        settings.person.offset_m = self.place.offset_m;
        settings.person.also = self.place.also;
        settings.person.stiffness = Some(stiffness);
        settings.person.fixed = held;
        settings.person.steps_away_s = 1000.0;
        settings.person.gap_m = LEAD_S * speed_m_s;
        match self.meeting {
            Meeting::Led | Meeting::ByHand => settings.speed_m_s = speed_m_s.min(0.25),
            Meeting::Walks => (settings.speed_m_s, settings.person.walk_m_s) = (0.0, speed_m_s),
            Meeting::Leans => {
                let share = SHARES.iter().position(|share| share.total_cmp(&self.share).is_eq());
                (settings.speed_m_s, settings.person.gap_m) = (0.0, 0.002);
                settings.person.at_s = 0.1; // not into the tare
                (settings.person.lean_n, settings.person.fixed) = (LEANS_N[share.unwrap_or(0)], false);
            }
        }
        settings.check()?;
        Ok(settings)
    }
}
