//! The table of attacks in docs/safety.md names tests that are there.
#![allow(clippy::unwrap_used, reason = "a test that cannot read its input has to stop")]

use std::path::Path;

#[test]
fn every_attack_has_its_test() {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let text = std::fs::read_to_string(repository.join("docs/safety.md")).unwrap();
    let (_, table) = text.split_once("| attack | file | test |\n|---|---|---|\n").unwrap();
    let rows: Vec<&str> = table.lines().take_while(|line| line.starts_with('|')).collect();
    assert!(rows.len() >= 25, "{} attacks", rows.len());
    for row in rows {
        let quoted: Vec<&str> =
            row.rsplit('|').skip(1).take(2).map(|cell| cell.trim().trim_matches('`')).collect();
        let [test, file] = quoted[..] else { unreachable!("{row}") };
        let code = std::fs::read_to_string(repository.join(file)).unwrap_or_default();
        assert!(
            code.contains(&format!("#[test]\nfn {test}()"))
                || code.contains(&format!("#[test]\n    fn {test}()")),
            "{row}"
        );
    }
}
