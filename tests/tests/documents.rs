//! Links of the documents lead somewhere, and every page has its place in the site.
#![allow(clippy::unwrap_used, reason = "a test that cannot read its input has to stop")]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

fn pages(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(pages(&path));
        } else if path.extension().is_some_and(|end| end == "md") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Documents in the root of the repository that link to others.
fn documents() -> Vec<PathBuf> {
    let root = repository();
    let mut found = pages(&root.join("docs"));
    found.extend(["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"].map(|name| root.join(name)));
    found
}

/// Targets of `[text](target)` outside of code.
fn links(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut code = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            code = !code;
        }
        let mut rest = line;
        while let Some((_, after)) = rest.split_once("](").filter(|_| !code) {
            let (target, after) = after.split_once(')').unwrap_or((after, ""));
            found.push(target.to_owned());
            rest = after;
        }
    }
    found
}

/// Anchor of a heading, as GitHub and mdBook make it.
fn anchor(heading: &str) -> String {
    let text = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = text.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Links of `document` that lead nowhere.
fn broken(document: &Path, text: &str) -> Vec<String> {
    let leads_nowhere = |link: &String| {
        if link.starts_with("http") || link.starts_with("mailto:") {
            return false;
        }
        let (file, wanted) = link.split_once('#').unwrap_or((link, ""));
        let path = if file.is_empty() { document.to_owned() } else { document.parent().unwrap().join(file) };
        if !path.exists() {
            return true;
        }
        let has_anchor = || {
            let text = std::fs::read_to_string(&path).unwrap();
            text.lines().filter(|line| line.starts_with('#')).any(|line| anchor(line) == wanted)
        };
        !wanted.is_empty() && !has_anchor()
    };
    links(text).into_iter().filter(leads_nowhere).collect()
}

#[test]
fn every_link_of_a_document_leads_somewhere() {
    let mut count = 0;
    for document in documents() {
        let text = std::fs::read_to_string(&document).unwrap();
        count += links(&text).len();
        assert_eq!(broken(&document, &text), Vec::<String>::new(), "{}", document.display());
    }
    assert!(count > 100, "only {count} links found");
}

#[test]
fn links_of_the_site_stay_within_it() {
    let docs = repository().join("docs");
    for page in pages(&docs) {
        let text = std::fs::read_to_string(&page).unwrap();
        for link in links(&text).iter().filter(|link| !link.starts_with("http")) {
            let file = link.split('#').next().unwrap();
            let target = page.parent().unwrap().join(file).canonicalize().unwrap();
            assert!(target.starts_with(&docs), "{}: {link} is no page of the site", page.display());
        }
    }
}

#[test]
fn every_page_of_the_site_has_its_place_in_the_summary() {
    let docs = repository().join("docs");
    let summary = std::fs::read_to_string(docs.join("SUMMARY.md")).unwrap();
    let listed: BTreeSet<PathBuf> = links(&summary).iter().map(|link| docs.join(link)).collect();
    let pages = pages(&docs).into_iter().filter(|page| !page.ends_with("SUMMARY.md"));
    assert_eq!(listed, pages.collect::<BTreeSet<_>>());
}

#[test]
fn broken_links_are_found() {
    let here = repository().join("README.md");
    let text = "[a](LICENSE) [b](nowhere.md) [c](CONTRIBUTING.md#before-you-write) [d](README.md#no-such-title)\n```\n[e](code)\n```\n";
    assert_eq!(broken(&here, text), ["nowhere.md", "README.md#no-such-title"]);
}

/// Cells of a line of a file with commas, quoted where a cell holds one.
fn cells(line: &str) -> Vec<String> {
    let (mut cells, mut quoted) = (vec![String::new()], false);
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => cells.push(String::new()),
            c => cells.last_mut().unwrap().push(c),
        }
    }
    cells
}

/// The table of public arms counts the rows of its file, of which none was accepted and then failed.
#[test]
fn table_of_public_arms_counts_the_rows_of_its_file() {
    let root = repository();
    let data = std::fs::read_to_string(root.join("docs/data/arms.csv")).unwrap();
    let rows: Vec<Vec<String>> = data.lines().skip(2).map(cells).collect();
    assert!(rows.iter().all(|row| row.len() == 9), "nine columns");
    let collections: BTreeSet<&str> = rows.iter().filter_map(|row| row[0].split('/').next()).collect();
    let page = std::fs::read_to_string(root.join("docs/simulation.md")).unwrap();
    for name in collections.into_iter().chain(["all"]) {
        let some = || rows.iter().filter(|row| name == "all" || row[0].starts_with(&format!("{name}/")));
        let right = || some().filter(|row| row[4] == "right");
        let of_bodies = |how: &str| right().filter(|row| row[6] == how).count();
        let own =
            |limits: bool| right().filter(|row| row[6].is_empty() && row[5].is_empty() != limits).count();
        let refused = || some().filter(|row| row[4] == "refused");
        let mute = refused().filter(|row| row[8].is_empty() || row[8].contains('\n')).count();
        let line = format!(
            "| {name} | {} | {} | {} | {} | {} | {} | {} | {mute} | 0 |",
            some().count(),
            right().count(),
            own(false),
            own(true),
            of_bodies("mended"),
            of_bodies("made up"),
            refused().count(),
        );
        assert!(page.contains(&line), "docs/simulation.md has no line {line}");
    }
    assert!(rows.len() >= 199 && rows.iter().filter(|row| row[4] == "right").count() >= 150);
    for row in &rows {
        let off = row[7].parse::<f64>().is_ok_and(|off| off <= 1e-12);
        assert!(off == (row[4] == "right") && (off || row[4] == "refused"), "{row:?}");
    }
}
