//! Puts the parts of a robot together as the configuration asks for them.

use crate::calibration::service::{self, Reference};
use crate::config::{Config, contact_limits};
use crate::control::law::Motion;
use crate::control::protection::Protection;
use crate::control::supervisor::{Automatic, Supervisor};
#[cfg(feature = "sim")]
use crate::control::tick::ControlLoop;
use crate::devices::board_events::{BoardEvents, NumberedEvent};
use crate::devices::force_gauge::Gauge;
use crate::devices::ports;
use crate::devices::touch_board::ByteCover;
use crate::inject::{self, Cable, FaultSite, Injection, Named};
use crate::robot::{PlantKind, TAXELS};
use crate::runtime::clock::Clock;
use crate::runtime::realtime::{self, Raised};
#[cfg(feature = "sim")]
use anyhow::anyhow;
use anyhow::{Context, Result};
use moca_tactile::Cover;
use moca_telemetry::net::CalibrationPort;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Events on their way to the calibrator: over ten seconds of a Touch Board.
const RING_EVENTS: usize = 4096;

/// The supervisor that the configuration asks for.
pub fn supervisor(config: &Config) -> Supervisor {
    let simulated = config.plant.kind == PlantKind::Simulated;
    let automatic = Automatic { tare: config.startup.tare, arm: config.startup.arm && simulated };
    let supervisor = Supervisor::new(config.startup.law, automatic);
    if config.plant.kind == PlantKind::None { supervisor.without_robot() } else { supervisor }
}

/// The controller and the protection that the configuration asks for.
///
/// # Errors
/// A parameter outside its range, every mistake in the file of contact limits.
pub fn motion(config: &Config) -> Result<Motion> {
    let thresholds = &config.protection.thresholds;
    let limits = if thresholds.is_empty() {
        [contact_limits::ContactLimits::default(); TAXELS]
    } else {
        contact_limits::load(thresholds.as_ref(), config.robot.cover.count())?
    };
    Ok(Motion::new(config, Protection::new(config, limits)?)?)
}

/// The cover that the configuration asks for.
///
/// # Errors
/// The calibration file cannot be used.
pub fn cover_config(config: &Config) -> Result<moca_tactile::CoverConfig<TAXELS>> {
    config.cover().with_context(|| format!("board.calibration = {:?}", config.board.calibration))
}

/// Whether one virtual Touch Board can feel the whole cover.
///
/// # Errors
/// A taxel on an electrode that it does not have.
#[cfg(feature = "sim")]
pub(crate) fn one_board(config: &Config) -> Result<()> {
    use moca_tactile::datastream::ELECTRODES;
    let electrodes = config.robot.cover.electrodes();
    match electrodes.iter().position(|electrode| *electrode >= ELECTRODES) {
        Some(taxel) => Err(anyhow!(
            "robot.cover: T{} is on electrode {}; the virtual Touch Board has 0 to {}",
            taxel + 1,
            electrodes[taxel],
            ELECTRODES - 1
        )),
        None => Ok(()),
    }
}

/// The virtual Touch Board under the cover that the configuration asks for.
#[cfg(feature = "sim")]
pub fn board_config(config: &Config) -> moca_sim::VirtualBoardConfig {
    let foam = crate::devices::simulated_robot::foam(config);
    moca_sim::VirtualBoardConfig {
        firmware: config.board.firmware,
        seed: config.simulation.seed,
        foam,
        ..Default::default()
    }
}

/// A simulated robot with everything that a live loop needs; the board and its reader end with it.
#[cfg(feature = "sim")]
pub(crate) struct Assembled {
    pub(crate) control: ControlLoop<crate::devices::simulated_robot::SimulatedRobot, Option<ByteCover>>,
    pub(crate) virtual_board: Option<moca_sim::PtyBoard>,
    pub(crate) board: Option<HeldBoard>,
}

#[cfg(feature = "sim")]
pub(crate) fn assemble(
    config: &Config,
    clock: Clock,
    injection: Option<&Injection>,
    mut subscribers: Subscribers,
) -> Result<Assembled> {
    use crate::devices::simulated_robot::{SimulatedRobot, free_scene};
    use moca_sim::PtyBoard;

    let (mut forces, mut virtual_board) = (None, None);
    let mut port = config.board.port.clone();
    if config.plant.parts.has_cover() && config.board.port == crate::config::VIRTUAL_PORT {
        one_board(config)?;
        let true_forces = moca_sim::SharedForces::default();
        let (_raised, _) = Raised::below(config.realtime.priority);
        let board =
            PtyBoard::spawn(board_config(config), Arc::clone(&true_forces), &PtyBoard::default_path())?;
        port = board.path().display().to_string();
        subscribers.pulses.push(board.pulse());
        (forces, virtual_board) = (Some(true_forces), Some(board));
    }
    subscribers.reference = forces.clone().map(|forces| {
        let electrodes = config.robot.cover.electrodes();
        let force_n = move |taxel: usize| {
            let electrode = *electrodes.get(taxel)?;
            Some(f64::from_bits(forces.get(electrode)?.load(std::sync::atomic::Ordering::Relaxed)))
        };
        Reference::Simulated(Box::new(force_n))
    });
    let (cover, board) = if config.plant.parts.has_cover() {
        let open = open_board(config, clock, port, injection, subscribers)?;
        (Some(open.cover), Some(open.held))
    } else {
        (None, None)
    };
    let mut plant = SimulatedRobot::new(config, &free_scene(config), forces)?;
    if let Some(injection) = injection {
        plant.inject(injection);
    }
    let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let control = ControlLoop::new(plant, cover, supervisor(config), motion(config)?, period_s);
    Ok(Assembled { control, virtual_board, board })
}

/// Who else gets what the board says, and what they need for it.
#[derive(Default)]
pub(crate) struct Subscribers {
    pub(crate) copies: Option<rtrb::Producer<NumberedEvent>>,
    pub(crate) moving: Arc<AtomicBool>,
    pub(crate) reference: Option<Reference>,
    /// Signs of life of the threads that bring the bytes, besides the reader's.
    pub(crate) pulses: Vec<Arc<AtomicU64>>,
}

/// What stands between a Touch Board's port and the loop.
pub(crate) struct OpenBoard {
    pub(crate) cover: ByteCover,
    pub(crate) held: HeldBoard,
}

/// The parts of it that only have to live as long as the loop.
pub(crate) struct HeldBoard {
    pub(crate) port: String,
    pub(crate) calibration: Option<CalibrationPort>,
    /// What the threads that bring its bytes were given.
    pub(crate) priority: Option<realtime::Step>,
    _threads: (service::Calibrator, ports::Reader),
}

pub(crate) fn open_board(
    config: &Config,
    clock: Clock,
    port: String,
    injection: Option<&Injection>,
    Subscribers { copies, moving, mut reference, mut pulses }: Subscribers,
) -> Result<OpenBoard> {
    let asked = || format!("a cover (plant.parts), read live at board.port = {:?}", config.board.port);
    let (raised, priority) = Raised::below(config.realtime.priority);
    let (reader, mut events) = ports::open(&port, clock.instant()).with_context(asked)?;
    pulses.push(reader.pulse());
    if let Some(Injection { fault: Named { site: FaultSite::Cable(fault), .. }, at_ns }) = injection {
        events = inject::relay(Cable::new(*fault, *at_ns, config.simulation.seed), events, clock)?;
    }
    drop(raised);
    let cover_config = cover_config(config)?;
    let (to_calibrator, calibrator_events) = rtrb::RingBuffer::new(RING_EVENTS);
    let settings = service::Settings::new(config, &cover_config.wiring[..cover_config.taxels]);
    if !config.board.gauge.is_empty() {
        let gauge = Gauge::open(&config.board.gauge, config.board.gauge_baud, clock.instant())?;
        reference = Some(Reference::Gauge(gauge));
    }
    let now_ns = move || clock.now_ns();
    let (calibrator, calibration) = service::spawn(settings, calibrator_events, reference, moving, now_ns)?;
    let events =
        BoardEvents::new(events).with_recorder(copies).with_calibrator(to_calibrator).with_pulses(pulses);
    let cover = ByteCover::new(Cover::new(cover_config)?, events);
    let held = HeldBoard { port, calibration: Some(calibration), priority, _threads: (calibrator, reader) };
    Ok(OpenBoard { cover, held })
}
