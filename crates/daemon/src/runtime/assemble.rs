//! Puts the parts of a robot together as the configuration asks for them.

use crate::calibration::reference::Reference;
use crate::calibration::service;
use crate::config::Config;
use crate::control::assemble::cover_config;
#[cfg(feature = "sim")]
use crate::control::assemble::{motion, supervisor};
#[cfg(feature = "sim")]
use crate::control::tick::ControlLoop;
use crate::devices::force_gauge::Gauge;
#[cfg(feature = "sim")]
use crate::devices::live_firmware::LiveFirmware;
use crate::devices::ports;
use crate::inject;
use crate::runtime::clock::Clock;
use crate::runtime::realtime::{self, Raised};
use anyhow::{Context, Result};
use moca_lockstep::board_events::{BoardEvents, NumberedEvent};
use moca_lockstep::inject::{Cable, FaultSite, Injection, Named};
use moca_lockstep::touch_board::ByteCover;
use moca_tactile::Cover;
use moca_telemetry::net::CalibrationPort;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Events on their way to the calibrator: over ten seconds of a Touch Board.
const RING_EVENTS: usize = 4096;

/// A simulated robot with everything that a live loop needs; the boards and their readers end with it.
#[cfg(feature = "sim")]
pub(crate) struct Assembled {
    pub(crate) control: ControlLoop<moca_lockstep::simulated_robot::SimulatedRobot, Option<ByteCover>>,
    _virtual_boards: (Vec<moca_sim::PtyBoard>, Option<LiveFirmware>),
    pub(crate) board: Option<HeldBoard>,
}

#[cfg(feature = "sim")]
pub(crate) fn assemble(
    config: &Config,
    clock: Clock,
    injection: Option<&Injection>,
    mut subscribers: Subscribers,
) -> Result<Assembled> {
    use moca_lockstep::simulated_robot::{SimulatedRobot, free_scene, true_foam};
    use moca_lockstep::virtual_boards;
    use moca_sim::PtyBoard;

    let (mut forces, mut virtual_boards, mut firmware) = (Vec::new(), Vec::new(), None);
    let mut ports = config.board.port.to_vec();
    if config.plant.parts.has_cover() && config.board.port.are_simulated() {
        virtual_boards::fit(config)?;
        for (number, port) in ports.iter_mut().enumerate() {
            let true_forces = moca_sim::SharedForces::default();
            let (_raised, _) = Raised::below(config.realtime.priority);
            let path = PtyBoard::default_path(number);
            *port = path.display().to_string();
            if let Some(program) = config.board.port.firmware_program() {
                let board =
                    LiveFirmware::start(&program, true_foam(config), Arc::clone(&true_forces), &path)?;
                subscribers.board_pulses.push(board.pulse());
                firmware = Some(board);
            } else {
                let board = virtual_boards::nth_board(virtual_boards::board_config(config), number);
                let board = PtyBoard::spawn(board, Arc::clone(&true_forces), &path)?;
                subscribers.board_pulses.push(board.pulse());
                virtual_boards.push(board);
            }
            forces.push(true_forces);
        }
        let (forces, wiring) = (forces.clone(), config.robot.cover.wiring());
        let force_n = move |taxel: usize| {
            let wire = wiring.get(taxel)?;
            let cell = forces.get(usize::from(wire.board))?.get(usize::from(wire.electrode))?;
            Some(f64::from_bits(cell.load(std::sync::atomic::Ordering::Relaxed)))
        };
        subscribers.reference = Some(Reference::Simulated(Box::new(force_n)));
    }
    let (cover, board) = if config.plant.parts.has_cover() {
        let open = open_boards(config, clock, ports, injection, subscribers)?;
        (Some(open.cover), Some(open.held))
    } else {
        (None, None)
    };
    let mut plant = SimulatedRobot::new(config, &free_scene(config), forces)?.as_sensors_tell();
    if let Some(injection) = injection {
        plant.inject(injection);
    }
    let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let control = ControlLoop::new(plant, cover, supervisor(config), motion(config)?, period_s);
    Ok(Assembled { control, _virtual_boards: (virtual_boards, firmware), board })
}

/// Further receivers of the board's events, and their needs.
#[derive(Default)]
pub(crate) struct Subscribers {
    pub(crate) copies: Option<rtrb::Producer<NumberedEvent>>,
    pub(crate) moving: Arc<AtomicBool>,
    pub(crate) reference: Option<Reference>,
    /// Signs of life of threads without which no bytes come, besides the readers'.
    pub(crate) pulses: Vec<Arc<AtomicU64>>,
    /// Heartbeats of the threads that make each virtual board's bytes.
    pub(crate) board_pulses: Vec<Arc<AtomicU64>>,
}

/// Connection between the ports of the Touch Boards and the loop.
pub(crate) struct OpenBoard {
    pub(crate) cover: ByteCover,
    pub(crate) held: HeldBoard,
}

/// The parts of it that only have to live as long as the loop.
pub(crate) struct HeldBoard {
    /// The ports as they were opened.
    pub(crate) ports: String,
    pub(crate) calibration: Option<CalibrationPort>,
    /// Priority of the threads that bring the bytes.
    pub(crate) priority: Option<realtime::Step>,
    _threads: (service::Calibrator, Vec<ports::Reader>),
}

pub(crate) fn open_boards(
    config: &Config,
    clock: Clock,
    ports: Vec<String>,
    injection: Option<&Injection>,
    Subscribers { copies, moving, mut reference, pulses, board_pulses }: Subscribers,
) -> Result<OpenBoard> {
    let (raised, priority) = Raised::below(config.realtime.priority);
    let (mut readers, mut rings, mut all_pulses) = (Vec::new(), Vec::new(), Vec::new());
    let mut board_pulses = board_pulses.into_iter();
    for port in &ports {
        let asked = || format!("a cover (plant.parts), read live at board.port = {:?}", config.board.port);
        let (reader, events) = ports::open(port, clock.instant()).with_context(asked)?;
        let mut own = pulses.clone();
        own.push(reader.pulse());
        own.extend(board_pulses.next());
        all_pulses.push(own);
        rings.push(events);
        readers.push(reader);
    }
    if let Some(Injection { fault: Named { site: FaultSite::Cable(fault), .. }, at_ns }) = injection {
        let first = rings.remove(0);
        rings.insert(0, inject::relay(Cable::new(*fault, *at_ns, config.simulation.seed), first, clock)?);
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
        BoardEvents::new(rings).with_recorder(copies).with_calibrator(to_calibrator).with_pulses(all_pulses);
    let cover = ByteCover::new(Cover::new(cover_config)?, events);
    let (ports, calibration) = (ports.join(", "), Some(calibration));
    let held = HeldBoard { ports, calibration, priority, _threads: (calibrator, readers) };
    Ok(OpenBoard { cover, held })
}
