//! Golden traces: what the experiments did when the code was last judged right, channel by channel.
//!
//! `MOCA_BLESS=1 cargo test --bin moca-lab golden` writes them anew; the difference in `git diff` is then what a change
//! did to the robot.

use super::push;
use super::pushes;
use moca_experiments::c_library;
use moca_experiments::closed_loop::{Rig, Row};
use moca_experiments::collision;
use moca_experiments::settings::Settings;
use moca_msgs::Law;
use std::fmt::Write as _;
use std::path::PathBuf;

/// A channel: name with unit, tolerance, value.
type Channel = (&'static str, f64, fn(&Row) -> f64);

/// 10 µm and 10 µrad, 0.1 mm/s, 10 mN: far below what anybody feels, far above another compiler's rounding.
const CHANNELS: [Channel; 16] = [
    ("base_x_m", 1e-5, |row| row.base_pose_world[0]),
    ("base_y_m", 1e-5, |row| row.base_pose_world[1]),
    ("base_yaw_rad", 1e-5, |row| row.base_pose_world[2]),
    ("base_vx_m_s", 1e-4, |row| row.base_velocity_world[0]),
    ("base_vy_m_s", 1e-4, |row| row.base_velocity_world[1]),
    ("base_yaw_rate_rad_s", 1e-4, |row| row.base_velocity_world[2]),
    ("flange_x_m", 1e-5, |row| row.flange_world[0]),
    ("flange_y_m", 1e-5, |row| row.flange_world[1]),
    ("flange_z_m", 1e-5, |row| row.flange_world[2]),
    ("q4_rad", 1e-5, |row| row.q_rad[3]),
    ("fx_true_n", 1e-2, |row| row.wrench_true[0]),
    ("fy_true_n", 1e-2, |row| row.wrench_true[1]),
    ("mz_true_nm", 1e-2, |row| row.wrench_true[2]),
    ("fx_sensed_n", 1e-2, |row| row.wrench_sensed[0]),
    ("fy_sensed_n", 1e-2, |row| row.wrench_sensed[1]),
    ("mz_sensed_nm", 1e-2, |row| row.wrench_sensed[2]),
];

fn header() -> String {
    let names: Vec<&str> = CHANNELS.iter().map(|(name, ..)| *name).collect();
    format!("t_s,{}", names.join(","))
}

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/golden").join(name)
}

/// The committed text, written anew first if asked.
fn golden(name: &str, fresh: &str) -> String {
    if std::env::var_os("MOCA_BLESS").is_some() {
        std::fs::write(path(name), fresh).unwrap();
    }
    std::fs::read_to_string(path(name)).unwrap()
}

/// Every `every`th row against the committed ones.
fn compare(name: &str, rows: &[Row], every: usize) {
    let rows: Vec<&Row> = rows.iter().step_by(every).collect();
    let mut fresh = header() + "\n";
    for row in &rows {
        write!(fresh, "{:.3}", row.t_s).unwrap();
        for (.., pick) in CHANNELS {
            write!(fresh, ",{:.6}", pick(row)).unwrap();
        }
        fresh.push('\n');
    }
    let golden = golden(name, &fresh);
    let mut lines = golden.lines();
    assert_eq!(lines.next(), Some(header().as_str()), "{name}: channels");
    let lines: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|v| v.parse().unwrap()).collect()).collect();
    assert_eq!(lines.len(), rows.len(), "{name}: rows");
    for (i, (channel, tolerance, pick)) in CHANNELS.iter().enumerate() {
        let (t_s, off) = rows
            .iter()
            .zip(&lines)
            .map(|(row, line)| (row.t_s, (pick(row) - line[i + 1]).abs()))
            .fold((0.0, 0.0), |worst, now| if now.1 > worst.1 || now.1.is_nan() { now } else { worst });
        assert!(
            off <= *tolerance,
            "{name}: {channel} differs by {off:e} at {t_s} s, allowed is {tolerance:e}"
        );
    }
}

fn with(law: Law, assignments: &[&str]) -> Settings {
    let mut settings = Settings::paper(law);
    settings.set_all(assignments).unwrap();
    settings
}

#[test]
fn golden_b1() {
    let run = pushes::b1(&with(Law::Impedance, &["sensor=ideal"])).unwrap();
    compare("b1.csv", &run.rows, 100);
}

#[test]
fn golden_b2() {
    let run = pushes::b2(&with(Law::FollowMe, &["sensor=ideal"])).unwrap();
    compare("b2.csv", &run.rows, 100);
}

#[test]
fn golden_collision() {
    let mut settings = with(Law::Impedance, &["sensor=ideal"]);
    collision::defaults(&mut settings);
    compare("collision.csv", &collision::once(&settings).unwrap().rows, 50);
}

#[test]
fn golden_push_through_the_stock_board_is_exact_to_the_bit() {
    let settings = with(Law::Impedance, &["push_s=1", "rest_s=0.5"]);
    let mut rig = Rig::start(&settings, &settings.free_scene()).unwrap();
    push::run(&mut rig, &settings, &[push::single(&[1], 20.0)]).unwrap();
    let mut fresh = format!("{:016x}\n{}\n", c_library(), header());
    for row in rig.rows.iter().step_by(20) {
        write!(fresh, "{:.3}", row.t_s).unwrap();
        for (.., pick) in CHANNELS {
            write!(fresh, ",{:016x}", pick(row).to_bits()).unwrap();
        }
        fresh.push('\n');
    }
    let golden = golden("push-bits.csv", &fresh);
    if golden.lines().next() == fresh.lines().next() {
        for (golden, fresh) in golden.lines().zip(fresh.lines()) {
            assert_eq!(golden, fresh);
        }
        assert_eq!(golden.len(), fresh.len());
        return;
    }
    // Another C library rounds its sines in another way: the tolerances of the other traces hold.
    for (golden, row) in golden.lines().skip(2).zip(rig.rows.iter().step_by(20)) {
        for (bits, (channel, tolerance, pick)) in golden.split(',').skip(1).zip(CHANNELS) {
            let value = f64::from_bits(u64::from_str_radix(bits, 16).unwrap());
            assert!((value - pick(row)).abs() <= tolerance, "{channel} {value} {}", pick(row));
        }
    }
}
