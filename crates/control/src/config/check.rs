//! Checks across rows: numbers that do not go together.

use super::bodies::carried;
use super::default_gains::defaults;
use super::stability::Stability;
use super::{
    AUTO_LISTEN, AUTO_PORT, AssumedModel, BarrierReadings, Config, Ports, ProtectionConfig, TelemetryConfig,
};
use crate::approach::STOPS;
use crate::compensation::SHORTEST_S;
use crate::robot::{ArmDriver, BaseDriver, Believed, FlangeSensorKind, GripperKind, Parts, PlantKind};
use moca_msgs::ParameterValues;
use moca_msgs::params::CONTROLLER;
use moca_msgs::robot::Drive;
use moca_tactile::cover::MaskPolicy;
use moca_telemetry::net::Address;
use moca_telemetry::{ParameterDescription, ParameterValue};
use std::net::IpAddr;

/// Duration of the ramps of a scripted press, s, with a moment of rest.
const PRESS_RAMPS_S: f64 = 0.7;
/// Two taxels nearer than this are one, m.
const TAXELS_APART_M: f64 = 0.01;

/// Takes (dotted path, message).
type Report<'a> = &'a mut dyn FnMut(&str, String);

pub(super) fn check(config: &Config, report: Report<'_>) {
    lists(config, report);
    if config.plant.parts.has_cover() {
        geometry(config, report);
        wiring(config, report);
        masks(config, report);
    }
    hand(config, report);
    protection(&config.protection, report);
    drive(config, report);
    ros2(config, report);
    uncalibrated(config, report);
    readings(config, report);
    telemetry(&config.telemetry, report);
    plant(config, report);
    timeout(config, report);
    carried(config, report);
    compensation(config, report);
    flange_sensor(config, report);
    super::self_collision::check(config, report);
}

/// Compensation of loads: slower than the observer that it follows, and with an observer.
fn compensation(config: &Config, report: Report<'_>) {
    let (name, time_s) = ("control.compensation.time_s", config.control.compensation.time_s);
    if time_s > 0.0 && time_s < SHORTEST_S {
        report(name, format!("{name} = {time_s} s is outside {SHORTEST_S} to 10 s; 0 s compensates nothing"));
    }
    let (name, friction_nm) = ("control.compensation.friction_nm", &config.control.compensation.friction_nm);
    let joints = config.arm().joints;
    if ![0, joints].contains(&friction_nm.len()) {
        report(
            name,
            format!(
                "{name} has {} values; allowed: none, or one for each of {joints} joints",
                friction_nm.len()
            ),
        );
    }
    let (name, time_s) = ("control.compensation.time_s", config.control.compensation.time_s);
    if time_s > 0.0 && config.plant.arm.external_wrench == Believed::Arm {
        report(
            name,
            format!(
                "{name} = {time_s} s follows the momentum observer, which does not run with plant.arm.external_wrench = \"arm\"; \
                 set that to \"ours\", or {name} to 0"
            ),
        );
    }
}

/// A flange sensor needs an arm that has one, and is the only source of the wrench.
fn flange_sensor(config: &Config, report: Report<'_>) {
    let (plant, name) = (&config.plant, "plant.flange_sensor");
    let word = match plant.flange_sensor {
        FlangeSensorKind::None => return,
        FlangeSensorKind::Simulated => "simulated",
        FlangeSensorKind::Own => "own",
    };
    if plant.kind == PlantKind::None || !plant.parts.has_arm() {
        report(name, format!("{name} = \"{word}\" needs an arm; allowed without one: \"none\""));
        return;
    }
    let is_simulated = plant.kind == PlantKind::Simulated || plant.arm.driver == ArmDriver::Simulated;
    if is_simulated != (plant.flange_sensor == FlangeSensorKind::Simulated) {
        let (arm, allowed) = if is_simulated { ("simulated", "simulated") } else { ("real", "own") };
        report(
            name,
            format!(
                "{name} = \"{word}\" is of another arm than this one; allowed with a {arm} arm: \"none\", \"{allowed}\""
            ),
        );
    }
    if plant.arm.external_wrench == Believed::Arm {
        report(
            name,
            format!(
                "{name} = \"{word}\" and plant.arm.external_wrench = \"arm\" both give the wrench at the flange; set the first \
                 to \"none\" or the second to \"ours\""
            ),
        );
    }
    let (name, time_s) = ("control.compensation.time_s", config.control.compensation.time_s);
    if time_s > 0.0 {
        report(
            name,
            format!(
                "{name} = {time_s} s follows the momentum observer, which does not run with plant.flange_sensor = \"{word}\"; set \
                 that to \"none\", or {name} to 0 s"
            ),
        );
    }
}

/// Gains that are each in range and together make the robot's loop unstable. Only files are checked for this, and after
/// every other check: an experiment may want such gains, a robot may not have them.
pub(super) fn stability(config: &Config, report: Report<'_>) {
    let (parameters, stability) = (config.parameters(), Stability::new(config));
    if config.plant.kind == PlantKind::None {
        return;
    }
    if let Some((joint, needed_nm, most_nm)) = stability.too_heavy(&parameters) {
        let (name, joint) = ("control.gains.posture_rad", joint + 1);
        let object = config.plant.gripper.table();
        let object = object
            .map_or_else(String::new, |gripper| format!(" with {} kg in its gripper", gripper.object_max_kg));
        report(
            name,
            format!(
                "{name}: joint {joint} needs {needed_nm:.1} N·m there to carry the arm{object}, limits.torque_nm has {most_nm} N·m; \
                 give a posture (arm.home_rad of an arm of your own) that needs less"
            ),
        );
        return;
    }
    if stability.is_stable(&parameters, &parameters.gains.posture_rad) {
        if !stability.is_compensation_stable(&parameters, &parameters.gains.posture_rad) {
            let (name, time_s) = ("control.compensation.time_s", config.control.compensation.time_s);
            report(
                name,
                format!(
                    "{name} = {time_s} s is not stable with these gains on an arm a quarter heavier or lighter than its table; \
                     give a longer time, or 0 s for no compensation"
                ),
            );
        }
        return;
    }
    let defaults = defaults(config);
    let rate_hz = config.control_loop.rate_hz;
    if let Some(one) = stability.one_to_blame(&parameters, &defaults.parameters()) {
        let row = &CONTROLLER[one.number];
        let (unit, place) = (row.units.get(one.element).or(row.units.first()).unwrap_or(&""), one.place());
        report(
            row.name,
            format!(
                "{}{place} = {} {unit} is not stable at loop.rate_hz = {rate_hz} Hz in control.gains.posture_rad; the nearest \
                 stable value is {} {unit}",
                row.name, one.value, one.nearest
            ),
        );
    } else if let Some((number, value, nearest)) = stability.to_blame(&parameters, &defaults.parameters()) {
        let row = &CONTROLLER[number];
        let described = ParameterDescription {
            name: row.name.into(),
            units: row.units.iter().map(|unit| (*unit).into()).collect(),
            min: row.min,
            max: row.max,
            ..ParameterDescription::default()
        };
        let value = ParameterValue::Numbers(value.as_slice().to_vec());
        report(row.name, format!("{} = {value} is {}", row.name, described.unstable(&nearest)));
    } else {
        let nearest = stability.nearest_together(&parameters, &defaults.parameters());
        if nearest.is_none() && stability.is_singular(&parameters) {
            let name = "control.gains.posture_rad";
            report(
                name,
                format!(
                    "{name}: the arm is singular there, its flange cannot move in every direction; give a posture (arm.home_rad \
                     of an arm of your own) that is not, or, where two joints turn about one line, another arm.tip_link"
                ),
            );
            return;
        }
        let remedy = nearest.map_or_else(
            || "lower stiffnesses and dampings or raise the rate".to_owned(),
            |gains| {
                let named = |(number, values): &(usize, ParameterValues)| {
                    let value = ParameterValue::Numbers(values.as_slice().to_vec());
                    format!("{} = {value}", CONTROLLER[*number].name)
                };
                let nearest: Vec<String> = gains.iter().map(named).collect();
                format!("stable, on the way there from the defaults: {}", nearest.join(", "))
            },
        );
        report(
            "control.gains",
            format!(
                "control.gains: not stable in control.gains.posture_rad at loop.rate_hz = {rate_hz} Hz, though each is in \
                 its range; {remedy}"
            ),
        );
    }
}

/// A base that is driven over ROS 2.
fn ros2(config: &Config, report: Report<'_>) {
    let (plant, timeout_s) = (&config.plant.base, config.robot.base.command_timeout_s);
    if plant.driver != BaseDriver::Ros2 {
        return;
    }
    // The zero goes out with the first order after the silence.
    let (silence_s, order_s) = (plant.ros2.silence_s, 1.0 / plant.ros2.order_rate_hz);
    if silence_s + order_s >= timeout_s {
        let name = "plant.base.ros2.silence_s";
        report(
            name,
            format!(
                "{name} = {silence_s} s and the {order_s} s between two orders are not below robot.base.command_timeout_s = \
                 {timeout_s} s: the base would stop by itself first"
            ),
        );
    }
    let router = &plant.ros2.router;
    let socket = router.strip_prefix("tcp/").and_then(|socket| socket.rsplit_once(':'));
    if !router.is_empty()
        && !socket.is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok())
    {
        let name = "plant.base.ros2.router";
        report(name, format!("{name} = {router:?}; allowed: such as \"tcp/192.168.0.200:7447\", or empty"));
    }
    let address = &plant.ros2.interface;
    if !address.is_empty() && !router.is_empty() {
        let name = "plant.base.ros2.interface";
        report(
            name,
            format!("{name} is of DDS, and plant.base.ros2.router = {router:?} of zenoh: leave one empty"),
        );
    }
    if !address.is_empty() && address.parse::<IpAddr>().is_err() {
        let name = "plant.base.ros2.interface";
        report(
            name,
            format!(
                "{name} = {address:?} is no address of this PC; allowed: such as \"192.168.0.10\", or empty"
            ),
        );
    }
}

fn drive(config: &Config, report: Report<'_>) {
    if config.robot.base.drive == Drive::Differential {
        report(
            "robot.base.drive",
            "robot.base.drive = \"differential\": a hand on the side of such a base cannot push it away, and the law would \
             answer with a turn; allowed: \"holonomic\" (mecanum, omni or steered wheels)"
                .into(),
        );
    }
}

/// Lists that go taxel by taxel, and numbers of taxels.
fn lists(config: &Config, report: Report<'_>) {
    let cover = &config.robot.cover;
    let taxels = cover.count();
    if taxels == 0 {
        report("robot.cover.x_m", "robot.cover.x_m is empty; a cover has 1 to 48 taxels".into());
    }
    for (key, count) in [("y_m", cover.y_m.len()), ("inward_rad", cover.inward_rad.len())] {
        if count != taxels {
            let name = format!("robot.cover.{key}");
            let message =
                format!("{name} has {count} elements; robot.cover.x_m has {taxels}, one for each taxel");
            report(&name, message);
        }
    }
    for (name, count) in
        [("robot.cover.electrode", cover.electrode.len()), ("robot.cover.board", cover.board.len())]
    {
        if count != 0 && count != taxels {
            let message =
                format!("{name} has {count} elements; allowed: {taxels}, one for each taxel, or none");
            report(name, message);
        }
    }
    for (name, numbers) in
        [("board.masked", &config.board.masked), ("simulation.hand.taxels", &config.simulation.hand.taxels)]
    {
        if let Some(number) = numbers.iter().find(|number| **number > taxels) {
            report(name, format!("{name} = {number}: the cover's taxels are 1 to {taxels}"));
        }
    }
}

/// Every taxel has an electrode of its own on a board that there is, and every board a taxel.
fn wiring(config: &Config, report: Report<'_>) {
    let (wiring, boards) = (config.robot.cover.wiring(), config.board.port.len());
    let twice = wiring.iter().enumerate().find(|(i, wire)| wiring[..*i].contains(wire));
    if let Some((i, wire)) = twice {
        let name = "robot.cover.electrode";
        report(name, format!("{name}: {} of T{} is another taxel's too", wire.electrode, i + 1));
    }
    if let Some(message) =
        config.board.port.are_virtual().then(|| config.robot.cover.beyond_one_chip()).flatten()
    {
        report("robot.cover.electrode", message);
    }
    if let Some(taxel) = wiring.iter().position(|wire| usize::from(wire.board) >= boards) {
        let (name, board) = ("robot.cover.board", wiring[taxel].board + 1);
        report(name, format!("{name} = {board} of T{}: board.port names {boards} board(s)", taxel + 1));
    }
    if let Some(board) =
        (0..boards).find(|board| !wiring.iter().any(|wire| usize::from(wire.board) == *board))
    {
        let name = "robot.cover.board";
        report(
            name,
            format!(
                "{name}: no taxel is on board {}, {:?} in board.port",
                board + 1,
                config.board.port[board]
            ),
        );
    }
}

fn geometry(config: &Config, report: Report<'_>) {
    let taxels = config.robot.cover.placements();
    for (i, taxel) in taxels.iter().enumerate() {
        let [x, y] = taxel.position_base_m;
        let (sin, cos) = taxel.inward_angle_base_rad.sin_cos();
        // The base's middle is B's origin.
        let off_rad = (x * sin - y * cos).atan2(-x * cos - y * sin).abs();
        if off_rad >= std::f64::consts::FRAC_PI_2 {
            report(
                "robot.cover.inward_rad",
                format!(
                    "robot.cover.inward_rad: T{} at ({x} m, {y} m) would be pressed away from the base, {:.0}° off the way \
                     to its middle; allowed: below 90°, or the base drives into the hand",
                    i + 1,
                    off_rad.to_degrees()
                ),
            );
        }
        for (j, other) in taxels.iter().enumerate().take(i) {
            let [other_x, other_y] = other.position_base_m;
            let apart_m = (x - other_x).hypot(y - other_y);
            if apart_m < TAXELS_APART_M {
                report(
                    "robot.cover.x_m",
                    format!(
                        "robot.cover: T{} and T{} are {apart_m} m apart; allowed: {TAXELS_APART_M} m or more",
                        j + 1,
                        i + 1
                    ),
                );
            }
        }
    }
}

fn masks(config: &Config, report: Report<'_>) {
    let masked = |taxel: usize| config.board.masked.contains(&taxel);
    if config.board.mask_policy == MaskPolicy::Ignore && (1..=config.robot.cover.count()).all(masked) {
        report(
            "board.masked",
            "board.masked: every taxel is masked and board.mask_policy = \"ignore\" would move a base that feels nothing; \
             leave one in use, or use mask_policy = \"stop\""
                .into(),
        );
    }
}

fn hand(config: &Config, report: Report<'_>) {
    let hand = &config.simulation.hand;
    if hand.hold_s > hand.every_s - PRESS_RAMPS_S {
        let (path, most_s) = ("simulation.hand.hold_s", hand.every_s - PRESS_RAMPS_S);
        report(path, format!("{path} = {} s is longer than every_s - 0.7 = {most_s} s", hand.hold_s));
    }
}

/// Reports contradictions between the values of `[protection]`.
fn protection(settings: &ProtectionConfig, report: Report<'_>) {
    if settings.threshold_force_n >= settings.force_limit_n {
        report(
            "protection.threshold_force_n",
            format!(
                "protection.threshold_force_n = {} N is not below protection.force_limit_n = {} N: no speed would be slow enough",
                settings.threshold_force_n, settings.force_limit_n
            ),
        );
    }
    if settings.foam_credible > 0.0 && settings.foam_credible < 1.0 {
        report(
            "protection.foam_credible",
            format!(
                "protection.foam_credible = {}; allowed: 0 (by the calibration's date), or 1 to 4: a foam becomes no softer",
                settings.foam_credible
            ),
        );
    }
    let (speeds, distances) = (&settings.stopping_speed_m_s, &settings.stopping_distance_m);
    if speeds.len() != distances.len() || speeds.len() > STOPS {
        report(
            "protection.stopping_distance_m",
            format!(
                "protection.stopping_distance_m has {} values for {} of protection.stopping_speed_m_s; allowed: as many, {STOPS} at \
                 most",
                distances.len(),
                speeds.len()
            ),
        );
    }
    if !rises(speeds) || !rises(distances) {
        report(
            "protection.stopping_speed_m_s",
            "protection.stopping_speed_m_s and protection.stopping_distance_m have to rise from value to value".into(),
        );
    }
    let stated = !settings.override_statement.trim().is_empty();
    let overridden = settings.override_speed_limit_m_s > 0.0;
    if overridden && !stated {
        report(
            "protection.override_speed_limit_m_s",
            format!(
                "protection.override_speed_limit_m_s = {} m/s switches off the limit that the board's rate sets; it \
                 needs protection.override_statement: who decided so, and what keeps contact forces low instead",
                settings.override_speed_limit_m_s
            ),
        );
    }
    if stated && !overridden {
        report(
            "protection.override_statement",
            "protection.override_statement is given but protection.override_speed_limit_m_s is 0 (no override)"
                .into(),
        );
    }
}

fn rises(values: &[f64]) -> bool {
    values.windows(2).all(|pair| pair[0] < pair[1])
}

fn uncalibrated(config: &Config, report: Report<'_>) {
    let limited = !config.protection.thresholds.is_empty();
    if let (true, Some(uncalibrated)) = (limited, config.uncalibrated())
        && config.protection.uncalibrated_statement.trim().is_empty()
    {
        report(
            "protection.thresholds",
            format!(
                "protection.thresholds limits contacts of a cover without board.calibration ({uncalibrated}); calibrate it, \
                 or say in protection.uncalibrated_statement who decided that such forces do"
            ),
        );
    }
}

/// A reading is undone by the curve that it was made with.
fn readings(config: &Config, report: Report<'_>) {
    let (board, name) = (&config.board, "protection.contact_barrier");
    let assumed = board.calibration.is_empty() && board.model == AssumedModel::PuLd30;
    if config.protection.contact_barrier == BarrierReadings::PuLd30 && !assumed {
        report(
            name,
            format!(
                "{name} = \"pu-ld30\" is of readings by board.model = \"pu-ld30\" without board.calibration; allowed for \
                 others: \"auto\", \"foam\", \"off\""
            ),
        );
    }
}

fn telemetry(settings: &TelemetryConfig, report: Report<'_>) {
    let listen = &settings.listen;
    let known = listen.is_empty() || listen == AUTO_LISTEN;
    if !known && !listen.parse().is_ok_and(|address: Address| address.is_local()) {
        let allowed = "\"auto\", unix:/ABSOLUTE/PATH, a loopback address with a port, or \"\" for none";
        report("telemetry.listen", format!("telemetry.listen = {listen:?}; allowed: {allowed}"));
    }
    if settings.socket_mode().is_none() {
        let message = format!(
            "telemetry.mode = {:?}; allowed: \"auto\", or \"0600\" to \"0777\", octal",
            settings.mode
        );
        report("telemetry.mode", message);
    }
    let watch = &settings.watch;
    let known = watch.is_empty() || watch == AUTO_LISTEN;
    if !known && !watch.parse().is_ok_and(|address| matches!(address, Address::Unix(_))) {
        let allowed = "\"auto\", unix:/ABSOLUTE/PATH, or \"\" for none";
        report("telemetry.watch", format!("telemetry.watch = {watch:?}; allowed: {allowed}"));
    }
    if !known && watch == listen {
        report(
            "telemetry.watch",
            format!("telemetry.watch = {watch:?} is telemetry.listen too; allowed: another path"),
        );
    }
    let token = &settings.token;
    if token != AUTO_LISTEN && !token.starts_with('/') {
        let allowed = "\"auto\" or the absolute path of a file of mode 0600";
        report("telemetry.token", format!("telemetry.token = {token:?}; allowed: {allowed}"));
    }
    let tls = &settings.tls;
    if !tls.is_empty() && tls.parse::<std::net::SocketAddr>().is_err() {
        let allowed = "an address and a port such as 0.0.0.0:7612, or \"\" for none";
        report("telemetry.tls", format!("telemetry.tls = {tls:?}; allowed: {allowed}"));
    }
}

fn plant(config: &Config, report: Report<'_>) {
    let ports = &config.board.port;
    if config.plant.kind != PlantKind::Simulated && config.plant.parts.has_cover() && ports.are_simulated() {
        let allowed = "allowed: \"auto\" or a path when plant.kind is \"none\" or \"robot\"";
        report("board.port", format!("board.port = \"{ports}\" needs a simulated robot; {allowed}"));
    }
    if config.plant.kind == PlantKind::None && config.plant.parts != Parts::Whole {
        let message = "plant.parts names parts of a robot; plant.kind = \"none\" has none: leave it out";
        report("plant.parts", message.into());
    }
    gripper(config, report);
    if !config.plant.parts.has_cover() && !ports.are_virtual() {
        let message = "board.port: plant.parts = \"arm\" has no cover and reads no board: leave it out";
        report("board.port", message.into());
    }
    if ports.iter().any(String::is_empty) {
        report("board.port", "board.port is empty; allowed: \"virtual\", \"auto\" or a path".into());
    }
    if let Some(port) = ports.iter().find(|port| !port.is_empty() && **port == config.board.gauge) {
        report("board.gauge", format!("board.gauge = {port:?} is in board.port too; a port has one device"));
    }
    let alike = |i: usize, port: &String| ports[..i].contains(port) || *port == AUTO_PORT;
    let apart = ports.are_virtual() || ports.len() == 1;
    if let Some((_, port)) = ports.iter().enumerate().find(|(i, port)| !apart && alike(*i, port)) {
        let allowed =
            "allowed: names in their EEPROM (\"name:left\") or paths, each once, or \"virtual\" for both";
        report("board.port", format!("board.port: {port:?} does not tell two boards apart; {allowed}"));
    }
    let simulated = |port: &String| Ports::from(port.as_str()).are_simulated();
    if ports.len() > 1 && !ports.are_virtual() && ports.iter().any(simulated) {
        report(
            "board.port",
            "board.port: of two boards either both are \"virtual\" or none is simulated".into(),
        );
    }
}

/// A simulated gripper is on a simulated arm, and an object is there for a gripper.
fn gripper(config: &Config, report: Report<'_>) {
    let (plant, mass_kg) = (&config.plant, config.simulation.truth.object.mass_kg);
    let has_gripper = plant.gripper == GripperKind::Simulated;
    if has_gripper && !(plant.kind == PlantKind::Simulated && plant.parts.has_arm()) {
        let name = "plant.gripper";
        report(
            name,
            format!(
                "{name} = \"simulated\" needs a simulated arm: plant.kind = \"simulated\", plant.parts not \"base\""
            ),
        );
    }
    let on_franka =
        plant.kind == PlantKind::Robot && plant.parts.has_arm() && plant.arm.driver == ArmDriver::Fci;
    if plant.gripper == GripperKind::Fci && !on_franka {
        let name = "plant.gripper";
        report(
            name,
            format!(
                "{name} = \"fci\" needs a Franka arm: plant.kind = \"robot\", plant.arm.driver = \"fci\""
            ),
        );
    }
    if mass_kg > 0.0 && !has_gripper {
        let name = "simulation.true.object.mass_kg";
        report(
            name,
            format!("{name} = {mass_kg} kg needs a gripper: plant.gripper = \"simulated\", or 0 kg"),
        );
    }
}

fn timeout(config: &Config, report: Report<'_>) {
    let (timeout_s, rate_hz) = (config.robot.base.command_timeout_s, config.control_loop.rate_hz.max(1));
    let periods_s = 2.0 / f64::from(rate_hz);
    if timeout_s < periods_s {
        let name = "robot.base.command_timeout_s";
        report(
            name,
            format!(
                "{name} = {timeout_s} s is shorter than two control periods of loop.rate_hz = {rate_hz} Hz, {periods_s} s: \
                 a base that keeps stopping"
            ),
        );
    }
}
