//! Every setting is read by somebody: changed alone, it changes how the robot moves or what is refused. The rows come
//! from the tables, so that a new one without a reader fails here.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::cast_possible_truncation,
    reason = "tests; what fails is named, and whole numbers here are small"
)]

use moca_control::config::Config;
use moca_control::robot::GripperKind;
use moca_lockstep::LockStep;
use moca_lockstep::ideal_cover::IdealCover;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::virtual_boards::board_config;
use moca_msgs::table::{ParameterKind, ParameterSpec};
use moca_msgs::{GripperRequest, Request, Sample};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;
use toml::{Table, Value};

/// Settings that act outside of what a run in lock-step shows, and the file that reads each: `.field` stands there.
const READ_ELSEWHERE: &[(&str, &str)] = &[
    ("robot.name", "daemon/src/runtime/clients.rs"),
    ("robot.base_name", "daemon/src/cli/report.rs"),
    ("arm.name", "control/src/config/own_arm.rs"),
    ("robot.base.size_m", "telemetry/src/description.rs"),
    ("realtime.priority", "daemon/src/runtime/realtime.rs"),
    ("realtime.lock_memory", "daemon/src/runtime/realtime.rs"),
    ("realtime.cpu", "daemon/src/runtime/realtime.rs"),
    ("realtime.dma_latency", "daemon/src/runtime/realtime.rs"),
    ("plant.arm.driver", "daemon/src/runtime/run.rs"),
    ("plant.arm.host", "daemon/src/devices/franka_arm.rs"),
    ("plant.arm.answer_s", "daemon/src/devices/franka_arm.rs"),
    ("plant.arm.collision_torque_nm", "daemon/src/devices/franka_arm.rs"),
    ("plant.arm.collision_wrench", "daemon/src/devices/franka_arm.rs"),
    ("plant.arm.payload", "daemon/src/devices/franka_arm.rs"),
    ("plant.arm.external_wrench", "daemon/src/devices/franka_arm.rs"),
    ("plant.arm.deadline_s", "control/src/law.rs"),
    ("plant.flange_sensor_deadline_s", "control/src/flange_sensor.rs"),
    ("plant.flange_sensor_range", "control/src/flange_sensor.rs"),
    ("plant.base.driver", "daemon/src/runtime/run.rs"),
    ("plant.base.deadline_s", "control/src/law.rs"),
    ("plant.base.ros2.domain", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.router", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.interface", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.cmd_vel", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.stamped", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.frame", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.odom", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.reliable_orders", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.reliable_odom", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.order_rate_hz", "daemon/src/devices/ros2_base.rs"),
    ("plant.base.ros2.silence_s", "daemon/src/devices/ros2_base.rs"),
    ("board.name", "control/src/config/mod.rs"),
    ("board.gauge", "daemon/src/runtime/assemble.rs"),
    ("board.gauge_baud", "daemon/src/runtime/assemble.rs"),
    ("telemetry.listen", "control/src/config/mod.rs"),
    ("telemetry.mode", "control/src/config/mod.rs"),
    ("telemetry.watch", "control/src/config/mod.rs"),
    ("telemetry.token", "control/src/config/mod.rs"),
    ("telemetry.tls", "daemon/src/runtime/clients.rs"),
    ("flight_recorder.folder", "daemon/src/record/flight_recorder.rs"),
    ("protection.assessed_forces_n", "lab/src/cover/latency.rs"),
    ("protection.stopping_measured", "control/src/protection.rs"),
    ("robot.tool.capsule_ends_m", "control/src/config/self_collision.rs"),
    ("robot.tool.capsule_radius_m", "control/src/config/self_collision.rs"),
    ("control.compensation.push_nm", "control/src/compensation.rs"),
    ("control.compensation.bound_nm", "control/src/compensation.rs"),
    ("simulation.true.arm.tool_com_m", "msgs/src/truth.rs"),
    ("simulation.true.foam.scale", "sim/src/foam.rs"),
    ("simulation.true.foam.creep", "sim/src/foam.rs"),
    ("simulation.true.foam.kind", "lockstep/src/simulated_robot.rs"),
    ("simulation.true.sensor.extra_age_ms", "lockstep/src/simulated_robot.rs"),
    ("simulation.true.flange_sensor.delay_ms", "sim/src/flange_sensor.rs"),
];

/// Tick of the request to the gripper, where there is one.
const GRASPS_AT_TICK: u32 = 300;

/// A robot, and the loads it is looked at under.
struct Scenario {
    name: &'static str,
    /// Differences from the defaults.
    differs: String,
    /// From bytes, as a board sends them, or with true forces.
    bytes: bool,
    ticks: u64,
}

fn scenarios() -> Vec<Scenario> {
    let carried = "[robot.tool]\nmass_kg = 1.0\ncom_m = [0.01, 0.0, 0.05]\ninertia_com = [0.002, 0.0, 0.0, 0.002, 0.0, 0.001]\n\
                   [robot.load]\nmass_kg = 0.5\ncom_m = [0.02, 0.0, 0.1]\ninertia_com = [0.001, 0.0, 0.0, 0.001, 0.0, 0.001]\n";
    let hand = "[simulation.hand]\ntaxels = [6, 2]\nforce_n = 40.0\nevery_s = 1.0\nhold_s = 0.2\n";
    let limits = std::env::temp_dir().join("moca-fields-contact-limits.toml");
    let text = "source = \"test\"\n[T6]\ntransient_n = 5.0\nquasi_static_n = 5.0\n";
    std::fs::write(&limits, text).unwrap();
    let reaction = |reaction: &str| {
        format!(
            "[protection]\nthresholds = {:?}\nuncalibrated_statement = \"a test\"\nreaction = \"{reaction}\"\n{hand}",
            limits.display().to_string()
        )
    };
    let scenario = |name, differs: String, bytes, ticks| Scenario { name, differs, bytes, ticks };
    vec![
        scenario("pushed", format!("{carried}{hand}"), false, 1200),
        scenario(
            "followed",
            format!(
                "[startup]\nlaw = \"follow-me\"\n[control.corrections]\nflange_wrench_feedforward = true\n{hand}"
            ),
            false,
            1200,
        ),
        scenario(
            "turned",
            format!("[control.gains]\nstiffness = [800.0, 800.0, 800.0, 0.0, 0.0, 0.0]\n{hand}")
                .replace("40.0", "150.0"),
            false,
            1500,
        ),
        scenario("kept soft", format!("[protection]\ncontact_barrier = \"foam\"\n{hand}"), false, 1200),
        scenario(
            "kept soft by a foam in two numbers",
            format!("[protection]\ncontact_barrier = \"foam\"\n[robot.cover]\nfoam = \"hyperbolic\"\n{hand}"),
            false,
            1200,
        ),
        scenario("own arm", own_arm(), false, 900),
        scenario("its URDF", urdf_arm(), false, 5),
        scenario("slowed", reaction("slow"), false, 1200),
        scenario("retreating", reaction("retreat"), false, 1200),
        scenario("from bytes", hand.replace("every_s = 1.0", "every_s = 3.6"), true, 2800),
        scenario(
            "with a taxel masked",
            format!("[board]\nmasked = [3]\nmask_policy = \"{}\"\n{hand}", mask_policy()),
            true,
            2400,
        ),
        scenario(
            "with a flange sensor",
            format!(
                "[plant]\nflange_sensor = \"simulated\"\nflange_sensor_origin = [0.0, 0.0, 0.04, 0.0, 0.0, 0.5]\n\
                 [startup]\nlaw = \"follow-me\"\n\
                 [simulation.true.flange_sensor]\nbias_n = [5.0, 0.0, 0.0]\nbias_nm = [0.1, 0.0, 0.0]\nnoise_n = 0.5\n\
                 noise_nm = 0.02\ndrift_n_s = 0.01\ndrift_nm_s = 0.001\ndelay_ms = 3.0\n{carried}"
            ),
            false,
            800,
        ),
        scenario("slowly", format!("[loop]\nrate_hz = 150\n{hand}"), false, 180),
        scenario(
            "grasping",
            "[plant]\ngripper = \"simulated\"\n[simulation.true.object]\nmass_kg = 0.5\n[simulation.hand]\ntaxels = []\n".into(),
            false,
            1500,
        ),
    ]
}

/// The word for a robot that moves with a masked taxel: the second of the choice.
fn mask_policy() -> &'static str {
    let mut word = "";
    Config::default().each(&mut |row, _| {
        if let ("board.mask_policy", ParameterKind::Choice(words)) = (row.name, row.kind) {
            word = words[1];
        }
    });
    word
}

fn urdf_arm() -> String {
    let folder =
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/robots")).canonicalize().unwrap();
    format!(
        "[robot]\narm = \"own\"\n[arm]\nurdf = {:?}\nbase_link = \"base_link\"\ntip_link = \"tool0\"\n\
         home_rad = [0.0, -2.0, 2.0, -1.57, -1.57, 0.0]\n",
        folder.join("ur10e.urdf").display().to_string()
    )
}

/// Returns the arm as lists, with a speed envelope.
fn own_arm() -> String {
    let mut lists = Config::parse(&urdf_arm()).unwrap().to_toml()["arm"].as_table().unwrap().clone();
    lists.insert("speed_offset_rad_s".into(), vec![0.1; 6].into());
    lists.insert("speed_deceleration_rad_s2".into(), vec![10.0; 6].into());
    let section: Table = [("arm".to_owned(), Value::from(lists))].into_iter().collect();
    let hand = "[simulation.hand]\ntaxels = [6]\nforce_n = 40.0\nevery_s = 1.0\nhold_s = 0.1\n";
    format!("[robot]\narm = \"own\"\n{hand}{}", toml::to_string(&section).unwrap())
}

/// Returns what a run of `config` shows of the robot, as a number; or the reason why it does not run.
fn observed(config: &Table, scenario: &Scenario) -> Result<u64, String> {
    let config = Config::parse(&toml::to_string(config).unwrap()).map_err(|error| error.to_string())?;
    let scene = free_scene(&config);
    let refused = |error: &dyn std::fmt::Display| format!("{error:#}");
    let (mut tick, grasps) = (0, config.plant.gripper != GripperKind::None);
    // As little force as holds the cube of the scenario.
    let grasp = GripperRequest::Grasp {
        width_m: 0.05,
        speed_m_s: 0.1,
        force_n: 5.0,
        tolerance_m: 0.01,
        mass_kg: 0.5,
    };
    let mut request = || {
        tick += 1;
        (grasps && tick == GRASPS_AT_TICK).then_some(Request::Gripper(grasp))
    };
    if !config.plant.parts.has_cover() {
        let mut world = LockStep::without_cover(&config, &scene).map_err(|error| refused(&error))?;
        return Ok(shown(scenario.ticks, || world.step(None).0));
    }
    if scenario.bytes {
        let world = LockStep::with_board(&config, &scene, board_config(&config), None);
        let mut world = world.map_err(|error| refused(&error))?;
        return Ok(shown(scenario.ticks, || world.step(None).0));
    }
    let world = LockStep::with_true_forces(&config, &scene, IdealCover::new(10, 0));
    let mut world = world.map_err(|error| refused(&error))?;
    Ok(shown(scenario.ticks, || world.step(request()).0))
}

fn shown(ticks: u64, mut step: impl FnMut() -> Sample) -> u64 {
    let mut hasher = DefaultHasher::new();
    for _ in 0..ticks {
        let sample = step();
        format!("{:?} {:?} {:?}", sample.mode, sample.fault, sample.speed_limit).hash(&mut hasher);
        let lists = [
            &sample.q_rad[..],
            &sample.arm_torque_nm,
            &sample.base_velocity_command_body,
            &sample.base_pose_world,
        ];
        let numbers = lists
            .into_iter()
            .flatten()
            .chain(&sample.flange_wrench_world)
            .chain(&sample.flange_position_world);
        numbers.for_each(|number| number.to_bits().hash(&mut hasher));
        sample.taxels.iter().for_each(|taxel| taxel.force_n.to_bits().hash(&mut hasher));
    }
    hasher.finish()
}

/// Other values that this row may have.
fn others(row: &ParameterSpec, present: &Value) -> Vec<Value> {
    match row.kind {
        ParameterKind::Flag => vec![Value::Boolean(present != &Value::Boolean(true))],
        // where there is no other word, that any other is refused is what it is read for
        ParameterKind::Choice([_]) => vec!["another".into()],
        ParameterKind::Choice(words) => {
            words.iter().filter(|word| Some(**word) != present.as_str()).map(|word| (*word).into()).collect()
        }
        ParameterKind::Text => vec!["".into(), "changed".into()],
        ParameterKind::Number | ParameterKind::Integer => {
            let changed = |change: &dyn Fn(f64) -> f64| with_numbers(row, present, change);
            let towards = |end: f64| move |value: f64| value + 0.02 * (end - value);
            vec![
                changed(&|value| if value == 0.0 { 0.01 } else { 1.01 * value }),
                changed(&towards(row.max)),
                changed(&towards(row.min)),
                changed(&|_| row.max),
                changed(&|_| row.min),
            ]
        }
    }
}

/// `present` with every number changed, inside the row's range; of an empty list one of three taxels.
fn with_numbers(row: &ParameterSpec, present: &Value, change: &dyn Fn(f64) -> f64) -> Value {
    let whole = row.kind == ParameterKind::Integer;
    let one = |value: &Value| {
        let before = value.as_float().or(value.as_integer().map(|value| value as f64)).unwrap();
        let after = change(before).clamp(row.min, row.max);
        if whole { Value::Integer(after.round() as i64) } else { Value::Float(after) }
    };
    match present {
        Value::Array(list) if list.is_empty() && whole => vec![row.min as i64 + 2].into(),
        Value::Array(list) if list.is_empty() => vec![change(1.0).clamp(row.min, row.max)].into(),
        Value::Array(list) => list.iter().map(one).collect::<Vec<_>>().into(),
        value => one(value),
    }
}

fn at<'a>(table: &'a mut Table, name: &str) -> &'a mut Value {
    let (first, rest) = name.split_once('.').unwrap();
    let mut value = table.get_mut(first).unwrap();
    for key in rest.split('.') {
        value = value.get_mut(key).unwrap();
    }
    value
}

/// Returns true if the robot shows another value of this row alone.
fn is_seen(row: &ParameterSpec, scenario: &Scenario, base: &Table, before: &Result<u64, String>) -> bool {
    let present = at(&mut base.clone(), row.name).clone();
    others(row, &present).into_iter().filter(|other| *other != present).any(|other| {
        let mut changed = base.clone();
        *at(&mut changed, row.name) = other;
        observed(&changed, scenario) != *before
    })
}

#[test]
fn every_setting_is_read_by_somebody() {
    let crates = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../crates"));
    let mut unread: Vec<&'static ParameterSpec> = Vec::new();
    Config::default().each(&mut |row, _| unread.push(row));
    for (name, file) in READ_ELSEWHERE {
        let text =
            std::fs::read_to_string(crates.join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
        let field = format!(".{}", name.rsplit('.').next().unwrap());
        assert!(code.contains(&field), "{name} is not read in {file}");
        assert!(unread.iter().any(|row| row.name == *name), "{name} is no setting");
        unread.retain(|row| row.name != *name);
    }
    let all = unread.len();
    for scenario in scenarios() {
        let config =
            Config::parse(&scenario.differs).unwrap_or_else(|error| panic!("{}: {error}", scenario.name));
        let mut base = config.to_toml();
        if scenario.differs.contains("urdf = ") {
            // as it was written: in a whole configuration what the file says is there already
            base = scenario.differs.parse().unwrap();
            for (key, empty) in Config::default().to_toml()["arm"].as_table().unwrap() {
                base["arm"].as_table_mut().unwrap().entry(key).or_insert_with(|| empty.clone());
            }
        }
        let before = observed(&base, &scenario);
        assert!(before.is_ok(), "{}: {before:?}", scenario.name);
        // what [arm] says is refused wherever the arm is a built-in one: that shows nothing
        let own = config.robot.arm.source == moca_control::robot::OWN_ARM;
        let (mine, later): (Vec<_>, Vec<_>) =
            unread.into_iter().partition(|row| row.name.starts_with("arm.") == own);
        let half = mine.len() / 2;
        let seen = |rows: &[&'static ParameterSpec]| -> Vec<&'static ParameterSpec> {
            rows.iter().filter(|row| !is_seen(row, &scenario, &base, &before)).copied().collect()
        };
        let left = std::thread::scope(|threads| {
            let first = threads.spawn(|| seen(&mine[..half]));
            let second = seen(&mine[half..]);
            [first.join().unwrap(), second].concat()
        });
        unread = [left, later].concat();
    }
    assert!(all > 80, "only {all} rows were looked at");
    let names: Vec<&str> = unread.iter().map(|row| row.name).collect();
    assert!(names.is_empty(), "nobody reads {names:?}");
}
