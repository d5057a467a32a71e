//! `mocad doctor --board` on virtual boards: a report that says which firmware it is and what came.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

use moca_sim::{PtyBoard, SharedForces, VirtualBoardConfig};
use moca_tactile::Firmware;
use moca_tests::Limited;
use std::path::PathBuf;
use std::process::Command;

fn report(firmwares: &[Firmware], name: &str) -> String {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let boards: Vec<PtyBoard> = firmwares
        .iter()
        .enumerate()
        .map(|(i, &firmware)| {
            let config = VirtualBoardConfig { firmware, ..VirtualBoardConfig::default() };
            let path = folder.join(format!("doctor-{name}-{i}-{}", std::process::id()));
            PtyBoard::spawn(config, SharedForces::default(), &path).unwrap()
        })
        .collect();
    let ports: Vec<String> = boards.iter().map(|board| format!("{:?}", board.path())).collect();
    let taxels = if boards.len() > 1 { "[1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2]" } else { "[]" };
    let text =
        format!("plant.kind = \"none\"\nboard.port = [{}]\nrobot.cover.board = {taxels}\n", ports.join(", "));
    let config = folder.join(format!("doctor-{name}.toml"));
    std::fs::write(&config, text).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"))
        .args(["doctor", "--board", "--seconds", "1", "--config"])
        .arg(&config)
        .run()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    text
}

#[test]
fn firmware_is_named_and_stock_board_has_no_clock() {
    for firmware in [Firmware::Moca, Firmware::Stock2018, Firmware::Stock2015] {
        let named = format!("firmware                    {}", firmware.name());
        let is_right = |text: &str| {
            ["BOARD REPORT", &named, "E11  at rest", "The board sends good frames."]
                .iter()
                .all(|part| text.contains(part))
                && text.contains("board's clock") == (firmware == Firmware::Moca)
        };
        // A machine with other work holds the simulated board up, which then has another rate: one of three is right.
        let is_named = (0..3).any(|_| {
            let text = report(&[firmware], firmware.name());
            println!("{text}");
            is_right(&text)
        });
        assert!(is_named, "{named}");
    }
}

#[test]
fn two_boards_have_two_reports() {
    let text = report(&[Firmware::Moca, Firmware::Stock2015], "two");
    assert_eq!(text.matches("BOARD REPORT").count(), 2, "{text}");
    assert!(text.contains("    stock-") && text.contains("    moca "), "{text}");
}
