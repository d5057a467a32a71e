//! Arms and logs from elsewhere: what passes the check runs, in every law and in a stop; what ends badly says so.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::expect_used,
    reason = "a test that cannot go on has to stop"
)]

use moca_control::config::{Config, HandConfig};
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::virtual_boards::board_config;
use moca_msgs::{Mode, Request, Sample};
use std::path::PathBuf;
use std::process::{Command, Output};

fn mocad(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mocad-under-test")).args(arguments).output().expect("mocad starts")
}

fn file(name: &str, contents: &[u8]) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, contents).unwrap();
    path
}

/// Tared and armed within 1.5 s; then two seconds in its law, a protective stop and a second in it. Nothing moves by itself.
fn runs_and_stops(name: &str, config: Config) {
    let config = Config {
        simulation: moca_control::config::SimulationConfig { hand: HandConfig::none(), ..config.simulation },
        ..config
    };
    let scene = free_scene(&config);
    let board = board_config(&config);
    let mut world = LockStep::with_board(&config, &scene, board, None)
        .unwrap_or_else(|error| panic!("{name}: {error:#}"));
    let rate_hz = u64::from(config.control_loop.rate_hz);
    let joints = config.arm().joints;
    let mut run = |tenths: u64, request| {
        let mut sample = world.step(request).0;
        for _ in 1..tenths * rate_hz / 10 {
            sample = world.step(None).0;
        }
        sample
    };
    let still = |sample: &Sample, when: &str| {
        let (q, home) = (&sample.q_rad, &config.control.gains.posture_rad);
        let off_rad = q.iter().zip(home).map(|(q, home)| (q - home).abs()).fold(0.0, f64::max);
        let fastest_rad_s = sample.dq_rad_s.iter().map(|dq| dq.abs()).fold(0.0, f64::max);
        assert!(q.len() == joints && off_rad < 0.02, "{name}, {when}: {off_rad} rad off in {q:?}");
        assert!(fastest_rad_s < 1e-3, "{name}, {when}: {:?} rad/s", sample.dq_rad_s);
    };
    let armed = run(35, None);
    assert_eq!((armed.mode, armed.fault), (Mode::Impedance, None), "{name}");
    still(&armed, "in impedance");
    let stopped = run(10, Some(Request::Stop));
    assert_eq!(stopped.mode, Mode::ProtectiveStop, "{name}");
    still(&stopped, "in a stop");
}

fn fixture(name: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/arms")).join(name)
}

#[test]
fn every_arm_of_the_fixtures_runs_and_stops() {
    let mut names: Vec<_> = std::fs::read_dir(fixture(""))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.retain(|name| name.ends_with(".toml"));
    names.sort();
    assert!(names.len() >= 11, "{names:?}");
    for name in names {
        let config = Config::load(&fixture(&name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        runs_and_stops(&name, config);
    }
}

/// The hold law of these used to be unstable: the run ended in NaN within 0.2 s.
#[test]
fn built_in_arm_runs_and_stops_at_rates_below_a_kilohertz() {
    for rate_hz in [200, 250, 333] {
        let toml = format!("[robot]\narm = \"ur10e\"\n[loop]\nrate_hz = {rate_hz}\n");
        runs_and_stops(&format!("ur10e at {rate_hz} Hz"), Config::parse(&toml).unwrap());
    }
}

/// The example's file as somebody else would have written it, one change each: a run of three seconds, or one sentence with
/// the remedy.
#[test]
fn every_variant_of_the_example_runs_or_is_refused_with_remedy() {
    let maker = include_str!("../../examples/robots/ur10e.urdf");
    let changed = |from: &str, to: &str| {
        assert!(maker.contains(from), "{from}");
        maker.replace(from, to)
    };
    let efforts = |to: &str| {
        ["330", "150", "56"].into_iter().fold(maker.to_owned(), |text, effort| {
            text.replace(&format!("effort=\"{effort}\""), &format!("effort=\"{to}\""))
        })
    };
    let tool = |body: &str| {
        let link = format!("<link name=\"tool0\"><inertial>{body}</inertial></link>");
        changed("<link name=\"tool0\"/>", &link)
    };
    let inertia = |value: &str| {
        format!("<inertia ixx=\"{value}\" ixy=\"0\" ixz=\"0\" iyy=\"{value}\" iyz=\"0\" izz=\"{value}\"/>")
    };
    let base = maker.find("<link name=\"base_link_inertia\">").unwrap();
    let base_end = base + maker[base..].find("</link>").unwrap() + "</link>".len();
    let finger = |name: &str, mimic: &str| {
        format!(
            "<link name=\"{name}\"/><joint name=\"{name}_joint\" type=\"revolute\">{mimic}<parent link=\"tool0\"/>\
             <child link=\"{name}\"/><axis xyz=\"0 0 1\"/><limit lower=\"0\" upper=\"0.8\" effort=\"1\" velocity=\"1\"/>\
             </joint>"
        )
    };
    let fingers = finger("left", "") + &finger("right", "<mimic joint=\"left_joint\" multiplier=\"1\"/>");
    let fixed = "<child link=\"base_link_inertia\"/>";
    let said_torques = "torque_max_nm = [330.0, 330.0, 150.0, 56.0, 56.0, 56.0]\n";
    for (name, text, more, refused) in [
        (
            "effort0",
            efforts("0"),
            "",
            "effort is 0 or missing: not said; set arm.torque_max_nm = [?, ?, ?, ?, ?, ?] N·m",
        ),
        ("effort0-list", efforts("0"), said_torques, ""),
        ("effort1000", efforts("1000"), "", ""),
        (
            "fixed-limit0",
            changed(fixed, &format!("{fixed}<limit effort=\"0\" lower=\"0\" upper=\"0\" velocity=\"0\"/>")),
            "",
            "",
        ),
        (
            "link0-none",
            format!("{}<link name=\"base_link_inertia\"/>{}", &maker[..base], &maker[base_end..]),
            "",
            "",
        ),
        (
            "continuous",
            changed("type=\"revolute\"", "type=\"continuous\""),
            "",
            "joint \"shoulder_pan_joint\" and 5 more: continuous, so without a range; set arm.q_min_rad = [?, ",
        ),
        ("zero-inertia", tool(&format!("<mass value=\"0.1\"/>{}", inertia("0"))), "", ""),
        (
            "massless-inertia",
            tool(&format!("<mass value=\"0\"/>{}", inertia("0.1"))),
            "",
            "link \"tool0\": <mass value=\"0\"> with an <inertia> that is not 0; give it its mass, or take <inertial> out",
        ),
        ("doctype", maker.replacen("?>", "?>\n<!DOCTYPE robot>", 1), "", ""),
        ("blank-first", format!("\n\n{maker}"), "", ""),
        ("mimic", maker.replace("</robot>", &format!("{fingers}</robot>")), "", ""),
    ] {
        let urdf = file(&format!("case-{name}.urdf"), text.as_bytes());
        let toml = format!(
            "[robot]\narm = \"own\"\n[arm]\nurdf = {urdf:?}\nbase_link = \"base_link\"\ntip_link = \"tool0\"\n\
             home_rad = [0.0, -2.0, 2.0, -1.5707963267948966, -1.5707963267948966, 0.0]\n{more}"
        );
        match Config::load(&file(&format!("case-{name}.toml"), toml.as_bytes())) {
            Ok(config) => {
                assert!(refused.is_empty(), "{name} is accepted; expected: {refused}");
                runs_and_stops(name, config);
            }
            Err(error) => {
                let said = error.to_string();
                assert!(!refused.is_empty() && said.contains(refused), "{name}: {said}");
                assert_eq!(said.lines().count(), 1, "{name}: one sentence: {said}");
            }
        }
    }
}

/// Soft gains for the laws do not make the hold law soft.
#[test]
fn built_in_arm_with_soft_gains_runs_and_stops_at_250_hz() {
    let soft = |value: f64| vec![value; 6];
    let toml = format!(
        "[robot]\narm = \"ur10e\"\n[loop]\nrate_hz = 250\n[control.gains]\nposture_stiffness = {:?}\n\
         posture_damping = {:?}\nstiffness = [200.0, 200.0, 200.0, 5.0, 5.0, 5.0]\n",
        soft(2.0),
        soft(0.2)
    );
    runs_and_stops("ur10e, soft", Config::parse(&toml).unwrap());
}

#[test]
fn run_that_ends_in_a_fault_says_so_by_its_exit_code() {
    let config = file("fault-exit.toml", b"[telemetry]\nlisten = \"\"\n[flight_recorder]\nfolder = \"\"\n");
    let run = |more: &[&str]| {
        let run = ["--as-fast-as-possible", "--duration", "3", "--log-level", "error", "--config"];
        let output = mocad(&[&run, &[config.to_str().unwrap()][..], more].concat());
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, said) = run(&["--inject", "joint-nan@2"]);
    assert!(code == Some(6) && said.contains("the run ended in a fault: "), "{code:?} {said}");
    assert_eq!(run(&[]).0, Some(0));
}

#[test]
fn file_that_is_no_log_is_refused_by_log_and_replay_alike() {
    let header =
        [&[1_u8][..], &26_u64.to_le_bytes(), &8_u32.to_le_bytes(), b"moca-s/4", &10_u32.to_le_bytes()]
            .concat();
    for (name, contents, said) in [
        ("magic.mcap", mcap_magic().to_vec(), "ends within its header: nothing in it can be read"),
        (
            "header.mcap",
            [&mcap_magic()[..], &header].concat(),
            "ends within its header: nothing in it can be read",
        ),
        ("bag.mcap", b"#ROSBAG V2.0\n".to_vec(), "is not an MCAP file"),
    ] {
        let path = file(name, &contents);
        for command in ["log", "replay"] {
            let output = mocad(&[command, path.to_str().unwrap()]);
            let text = String::from_utf8(output.stderr).unwrap();
            assert!(output.status.code() == Some(2) && text.contains(said), "{command} {name}: {text}");
            assert!(output.stdout.is_empty(), "{command} {name}");
        }
    }
}

const fn mcap_magic() -> [u8; 8] {
    [0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n']
}
