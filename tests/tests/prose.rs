//! Plain technical English, counted: the numbers may fall and never rise.
//!
//! When a count falls, lower its entry of [`ALLOWED`] in the same commit.
#![allow(clippy::unwrap_used, reason = "a test that cannot read its input has to stop")]

use std::path::{Path, PathBuf};

/// A rule and the largest number of places that may break it.
struct Limit {
    rule: &'static str,
    most: usize,
}

/// Words that no doc comment begins with: a reader expects a noun phrase or a verb.
const FORBIDDEN_STARTS: [&str; 10] =
    ["What", "Who", "Whose", "Whom", "How", "Where", "Whether", "Of", "So", "The same"];
/// Longest name of a test, letters.
const TEST_NAME_LETTERS: usize = 60;
/// Longest sentence of a document, words.
const SENTENCE_WORDS: usize = 25;
/// Largest mean length of the sentences in `docs/`, tenths of a word.
const MEAN_SENTENCE_TENTHS: usize = 160;

/// Today's counts.
const ALLOWED: [Limit; 4] = [
    Limit { rule: "doc comments that begin with a forbidden word", most: 0 },
    Limit { rule: "\"that is none\" and \"that are none\"", most: 0 },
    Limit { rule: "test names over 60 letters", most: 0 },
    Limit { rule: "sentences in docs/ over 25 words", most: 95 },
];

fn files(folder: &Path, end: &str) -> Vec<PathBuf> {
    let skipped = ["target", "third_party", "node_modules", "mujoco"];
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut found: Vec<PathBuf> = entries
        .flat_map(|path| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_symlink() || name.starts_with('.') || skipped.contains(&name.as_str()) {
                Vec::new()
            } else if path.is_dir() {
                files(&path, end)
            } else if name.ends_with(end) {
                vec![path]
            } else {
                Vec::new()
            }
        })
        .collect();
    found.sort();
    found
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn rust() -> impl Iterator<Item = (PathBuf, String)> {
    ["crates", "tests", "python"]
        .into_iter()
        .flat_map(|folder| files(&root().join(folder), ".rs"))
        .map(|file| (file.clone(), std::fs::read_to_string(file).unwrap()))
}

/// Text of a doc comment's line, without its mark.
fn doc(line: &str) -> Option<&str> {
    let line = line.trim_start();
    line.strip_prefix("/// ").or_else(|| line.strip_prefix("//! "))
}

fn begins_badly(text: &str) -> bool {
    FORBIDDEN_STARTS.iter().any(|start| {
        text.strip_prefix(start).is_some_and(|rest| !rest.starts_with(|c: char| c.is_alphanumeric()))
    })
}

fn test_name(line: &str) -> Option<&str> {
    let line = line.trim_start();
    let name = line.strip_prefix("async ").unwrap_or(line).strip_prefix("fn ")?;
    name.split(['(', '<']).next()
}

/// Sentences of a document: no code, no tables, no headings, no generated text.
fn sentences(document: &str) -> Vec<String> {
    let mut paragraphs = vec![String::new()];
    let (mut code, mut generated) = (false, false);
    for line in document.lines().map(str::trim) {
        if line.starts_with("```") {
            code = !code;
        } else if line.starts_with("<!--") {
            generated = line.contains("moca-lab docs") || line.contains("generated");
        } else if code || generated || line.starts_with(['|', '#']) || line.starts_with("![") {
            // No sentence of ours.
        } else {
            let item = line.starts_with("- ") || line.starts_with("* ");
            if line.is_empty() || item {
                paragraphs.push(String::new());
            }
            if let Some(last) = paragraphs.last_mut() {
                last.push(' ');
                last.push_str(line);
            }
        }
    }
    let mut found = Vec::new();
    for paragraph in paragraphs {
        let mut sentence = Vec::new();
        for word in paragraph.split_whitespace() {
            sentence.push(word);
            if word.trim_end_matches(['*', '`', ')', '"']).ends_with(['.', '!', '?']) {
                found.push(sentence.join(" "));
                sentence.clear();
            }
        }
        found.push(sentence.join(" "));
    }
    found.retain(|sentence| sentence.split_whitespace().count() > 2);
    found
}

fn documents() -> Vec<(PathBuf, String)> {
    let documents = files(&root().join("docs"), ".md");
    documents.into_iter().map(|file| (file.clone(), std::fs::read_to_string(file).unwrap())).collect()
}

/// Places that break each rule of [`ALLOWED`], in its order.
fn breaches() -> [Vec<String>; 4] {
    let mut found: [Vec<String>; 4] = Default::default();
    for (file, text) in rust() {
        let mut in_comment = false;
        for (at, line) in text.lines().enumerate() {
            let place = format!("{}:{}: {}", file.display(), at + 1, line.trim());
            if let Some(text) = doc(line) {
                if !in_comment && begins_badly(text) {
                    found[0].push(place.clone());
                }
                in_comment = true;
            } else {
                in_comment = false;
            }
            if ["that is none", "that are none"].iter().any(|phrase| line.contains(phrase))
                && !line.contains("phrase")
                && !line.contains("rule:")
            {
                found[1].push(place.clone());
            }
            if test_name(line).is_some_and(|name| name.len() > TEST_NAME_LETTERS) {
                found[2].push(place);
            }
        }
    }
    for (file, text) in documents() {
        let long = sentences(&text);
        let long = long.iter().filter(|sentence| sentence.split_whitespace().count() > SENTENCE_WORDS);
        found[3].extend(long.map(|sentence| format!("{}: {sentence}", file.display())));
    }
    found
}

#[test]
fn breaches_of_the_rules_for_words_never_increase() {
    for (limit, places) in ALLOWED.iter().zip(breaches()) {
        println!("{}: {} of at most {}", limit.rule, places.len(), limit.most);
        assert!(
            places.len() <= limit.most,
            "{}: {} places, at most {} allowed:\n{}",
            limit.rule,
            places.len(),
            limit.most,
            places.join("\n")
        );
    }
}

#[test]
fn mean_sentence_length_of_documents_never_increases() {
    let words: Vec<usize> = documents()
        .iter()
        .flat_map(|(_, text)| sentences(text))
        .map(|sentence| sentence.split_whitespace().count())
        .collect();
    let tenths = words.iter().sum::<usize>() * 10 / words.len();
    println!("{} sentences in docs/, {}.{} words on average", words.len(), tenths / 10, tenths % 10);
    assert!(tenths <= MEAN_SENTENCE_TENTHS, "{tenths} tenths of a word a sentence");
}

#[test]
fn sentences_are_counted_as_a_reader_would() {
    let text = "# A heading\n\nOne two three. Four five six:\n- seven eight nine\n\n| a | table |\n```\ncode here now\n```\n";
    assert_eq!(sentences(text), ["One two three.", "Four five six:", "- seven eight nine"]);
    assert!(
        begins_badly("What a reader sees.") && !begins_badly("Office hours") && !begins_badly("Somebody")
    );
}
