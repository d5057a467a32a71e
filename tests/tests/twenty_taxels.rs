//! A cover of 20 taxels on one board with two chips: from the bytes that the firmware sent to the base's motion.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "a few seconds"
)]

use moca_msgs::TaxelPlacement;
use moca_tactile::{Cover, CoverConfig, TareStatus};
use moca_wbc::{BaseController, BaseGuard, BaseInput, Parameters};
use std::f64::consts::TAU;
use std::path::Path;

/// Evenly around a circle of 0.5 m, each pushed towards its middle; T6 is at 90°, on the left.
fn ring() -> [TaxelPlacement; 20] {
    std::array::from_fn(|i| {
        let angle_rad = TAU * i as f64 / 20.0;
        let (sin, cos) = angle_rad.sin_cos();
        TaxelPlacement {
            position_base_m: [0.5 * cos, 0.5 * sin],
            inward_angle_base_rad: angle_rad - TAU / 2.0,
        }
    })
}

#[test]
fn a_press_on_one_of_twenty_taxels_moves_the_base_away_from_it() {
    let mut config = CoverConfig::<20>::default();
    for (number, wire) in (0u8..).zip(&mut config.wiring) {
        (wire.board, wire.electrode) = (0, number);
    }
    let mut cover = Cover::<20>::new(config).unwrap();
    let controller: BaseController<20> = BaseController::new(&ring(), &Parameters::PAPER).unwrap();
    let mut state = controller.enter();

    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/recordings/moca-touch-two-chips.txt");
    let stream = std::fs::read(&folder).unwrap();
    let times = std::fs::read_to_string(folder.with_extension("times")).unwrap();
    let mut reads = times.lines().map(|line| {
        let (seconds, count) = line.split_once(' ').unwrap();
        (seconds.parse::<f64>().unwrap(), count.parse::<usize>().unwrap())
    });
    let (mut next, mut at) = (reads.next(), 0);
    let (mut before_press, mut fastest) = (0.0f64, [0.0f64; 3]);
    for tick in 1..2500u64 {
        let now_ns = tick * 1_000_000;
        while let Some((seconds, count)) = next.filter(|(seconds, _)| *seconds <= 1e-3 * tick as f64) {
            cover.push(0, &stream[at..at + count], (seconds * 1e9) as u64);
            at += count;
            next = reads.next();
        }
        if tick == 1000 {
            cover.start_tare(now_ns);
        }
        let Ok(taxel_force_n) = cover.poll(now_ns).forces else {
            assert!(tick < 1900, "no forces at {tick} ms: {:?}", cover.tare_status());
            continue;
        };
        let input = BaseInput { yaw_world_rad: 0.0, taxel_force_n, guard: BaseGuard::NONE, dt_s: 1e-3 };
        let [vx, vy, yaw] = controller.step(&mut state, &input).unwrap().velocity_body;
        if tick < 2000 {
            before_press = before_press.max(vx.hypot(vy));
        }
        if vx.hypot(vy) > fastest[0].hypot(fastest[1]) {
            fastest = [vx, vy, yaw];
        }
    }
    assert!(matches!(cover.tare_status(), TareStatus::Done(_)));
    println!("untouched {before_press} m/s; pressed at T6: {fastest:?}");
    assert!(before_press == 0.0, "an untouched base stands");
    // T6 is the sixth of twenty: 90° around
    assert!(fastest[1] < -0.05, "{fastest:?}");
    assert!(fastest[0].abs() < 1e-9 * fastest[1].abs().max(1.0) && fastest[2].abs() < 1e-9, "{fastest:?}");
}
