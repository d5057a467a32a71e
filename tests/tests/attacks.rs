//! The tables of attacks and of bad input in the documents name tests that are there.
#![allow(clippy::unwrap_used, reason = "a test that cannot read its input has to stop")]

use std::path::Path;

/// Checks that each row of the table under `head` ends with a file and a test in it.
fn every_row_has_its_test(document: &str, head: &str, least: usize) {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let text = std::fs::read_to_string(repository.join(document)).unwrap();
    let (_, table) = text.split_once(head).unwrap();
    let rows: Vec<&str> = table.lines().skip(2).take_while(|line| line.starts_with('|')).collect();
    assert!(rows.len() >= least, "{} rows", rows.len());
    for row in rows {
        let quoted: Vec<&str> =
            row.rsplit('|').skip(1).take(2).map(|cell| cell.trim().trim_matches('`')).collect();
        let [test, file] = quoted[..] else { unreachable!("{row}") };
        let code = std::fs::read_to_string(repository.join(file)).unwrap_or_default();
        let heads = ["#[test]\nfn", "#[test]\n    fn", "#[tokio::test]\nasync fn"];
        assert!(heads.iter().any(|head| code.contains(&format!("{head} {test}()"))), "{row}");
    }
}

#[test]
fn every_attack_has_its_test() {
    every_row_has_its_test("docs/safety.md", "| attack | file | test |", 45);
}

#[test]
fn every_kind_of_bad_input_has_its_test() {
    every_row_has_its_test("docs/command-line.md", "| what is sent | what happens | file | test |", 15);
}
