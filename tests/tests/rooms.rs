//! Which file may import which: no circle between the files of a crate, and `control` is pure. And no robot but in tables.
#![allow(clippy::unwrap_used, reason = "a test that cannot read its input has to stop")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Module path within its crate → the modules of the crate that it imports.
type Imports = BTreeMap<String, BTreeSet<String>>;

fn crates() -> Vec<PathBuf> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../crates");
    std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let rust = files.into_iter().filter(|file| file.extension().is_some_and(|end| end == "rs"));
    rust.chain(folders.iter().flat_map(|folder| sources(folder))).collect()
}

/// `a::b` of `src/a/b.rs` and of `src/a/b/mod.rs`; `None` for a crate's root, which only puts together.
fn module(source: &Path, file: &Path) -> Option<String> {
    let mut parts: Vec<_> = file
        .strip_prefix(source)
        .unwrap()
        .with_extension("")
        .iter()
        .map(|part| part.to_str().unwrap().to_owned())
        .collect();
    match parts.last().map(String::as_str) {
        Some("lib" | "main") if parts.len() == 1 => return None,
        Some("mod") => drop(parts.pop()),
        _ => {}
    }
    Some(parts.join("::"))
}

/// Code without comments and without what is only there for tests.
fn code(file: &Path) -> String {
    let text = std::fs::read_to_string(file).unwrap();
    let text = text.split("\nmod tests {").next().unwrap();
    text.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

/// `a::{b, c::{d, e}}` → `a::b`, `a::c::d`, `a::c::e`.
fn flattened(tree: &str) -> Vec<String> {
    let Some((prefix, rest)) = tree.split_once('{') else { return vec![tree.trim().to_owned()] };
    let (mut parts, mut depth, mut start) = (Vec::new(), 0, 0);
    let inner = &rest[..rest.rfind('}').unwrap_or(rest.len())];
    for (at, letter) in inner.char_indices() {
        match letter {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(&inner[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&inner[start..]);
    let whole = |part: &str| format!("{}{}", prefix.trim(), part.trim());
    parts.iter().filter(|part| !part.trim().is_empty()).flat_map(|part| flattened(&whole(part))).collect()
}

/// Every path that begins with `crate` or `super`, in imports and in the code. Re-exports are not imports: they say
/// where a name can be found, not what the file needs.
fn paths(code: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = String::new();
    for statement in code.split_inclusive(';') {
        let at = statement.find("use ").filter(|&at| {
            statement[..at].trim_end().ends_with(|c: char| ";}]".contains(c))
                || statement[..at].trim().is_empty()
        });
        match at {
            Some(at) => found.extend(flattened(statement[at + 4..].trim_end_matches(';'))),
            None if statement.trim_start().starts_with("pub use ") => {}
            None => rest.push_str(statement),
        }
    }
    let word = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    found.extend(rest.split(|c| !word(c)).map(str::to_owned));
    found.retain(|path| ["crate::", "super::"].iter().any(|start| path.starts_with(start)));
    found
}

/// The module of `known` that `path`, seen from `from`, leads to.
fn target(path: &str, from: &str, known: &BTreeSet<String>) -> Option<String> {
    let mut place: Vec<&str> = from.split("::").collect();
    let mut parts = path.split("::").peekable();
    if parts.next_if_eq(&"crate").is_some() {
        place.clear();
    }
    while parts.next_if_eq(&"super").is_some() {
        place.pop();
    }
    place.extend(parts);
    (1..=place.len()).rev().map(|length| place[..length].join("::")).find(|module| known.contains(module))
}

/// Modules that a crate's root places itself: module → its file without the ending.
fn placed(source: &Path) -> Vec<(String, String)> {
    let root = std::fs::read_to_string(source.join("lib.rs")).unwrap_or_default();
    let place = |text: &str| {
        let (path, rest) = text.split_once("\"]")?;
        let name = rest.split("mod ").nth(1)?.split(';').next()?;
        Some((name.to_owned(), path.trim_end_matches(".rs").trim_end_matches("/mod").replace('/', "::")))
    };
    root.split("#[path = \"").skip(1).filter_map(place).collect()
}

fn imports(source: &Path) -> Imports {
    let placed = placed(source);
    let module = |file: &Path| {
        let by_folders = module(source, file)?;
        let below = |path: &str| {
            let below = by_folders.strip_prefix(path)?;
            (below.is_empty() || below.starts_with("::")).then_some(below)
        };
        let within = placed.iter().filter_map(|(name, path)| Some((path.len(), name, below(path)?)));
        let renamed = within.max().map(|(_, name, below)| format!("{name}{below}"));
        Some(renamed.unwrap_or(by_folders))
    };
    let files: Vec<(String, PathBuf)> =
        sources(source).into_iter().filter_map(|file| Some((module(&file)?, file))).collect();
    let known: BTreeSet<String> = files.iter().map(|(module, _)| module.clone()).collect();
    let of = |module: &String, file: &PathBuf| {
        let targets = paths(&code(file))
            .iter()
            .filter_map(|path| target(path, module, &known))
            .collect::<BTreeSet<_>>();
        targets.into_iter().filter(|target| target != module).collect()
    };
    files.iter().map(|(module, file)| (module.clone(), of(module, file))).collect()
}

/// A way from `from` back to itself, if there is one.
fn circle(imports: &Imports, from: &str) -> Option<Vec<String>> {
    let mut ways = vec![vec![from.to_owned()]];
    let mut seen = BTreeSet::new();
    while let Some(way) = ways.pop() {
        for next in &imports[way.last().unwrap()] {
            if next == from {
                return Some(way);
            }
            if seen.insert(next) {
                ways.push([way.as_slice(), std::slice::from_ref(next)].concat());
            }
        }
    }
    None
}

#[test]
fn no_file_of_a_crate_imports_itself_through_others() {
    for folder in crates() {
        let imports = imports(&folder.join("src"));
        let circles: Vec<_> = imports.keys().filter_map(|module| circle(&imports, module)).collect();
        assert!(circles.is_empty(), "{}: {circles:#?}", folder.display());
    }
}

/// The rooms of `wbc`, each using only those before it.
const ROOMS: [&str; 5] = ["math", "model", "protect", "reference", "law"];

#[test]
fn wbc_room_uses_only_rooms_before_it() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/wbc/src");
    let placed = placed(&source);
    let room = |module: &str| {
        let first = module.split("::").next().unwrap();
        let (_, path) = placed.iter().find(|(name, _)| name == first)?;
        ROOMS.iter().position(|room| path.split("::").next() == Some(room))
    };
    let imports = imports(&source);
    let in_rooms = imports.keys().filter(|module| room(module).is_some()).count();
    assert!(in_rooms > 30, "{in_rooms} files are in rooms");
    for (module, targets) in &imports {
        let later: Vec<_> = targets.iter().filter(|target| room(target) > room(module)).collect();
        assert!(room(module).is_none() || later.is_empty(), "{module} imports {later:?}");
    }
}

#[test]
fn what_a_tick_decides_knows_no_thread_clock_or_file() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/control/src");
    let files = sources(&source);
    assert!(files.len() > 20, "the crate has moved");
    for file in files.iter().filter(|file| !file.starts_with(source.join("config"))) {
        let code = code(file);
        for impure in
            ["std::thread", "std::fs", "std::io", "std::net", "Instant", "SystemTime", "rtrb", "println!"]
        {
            assert!(!code.contains(impure), "{}: {impure}", file.display());
        }
    }
}

#[test]
fn robot_without_a_clock_knows_no_clock_thread_or_socket() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/lockstep/src");
    let files = sources(&source);
    assert!(files.len() > 10, "the crate has moved");
    for file in &files {
        let code = code(file);
        for impure in ["spawn", "thread::Builder", "std::fs", "std::net", "Instant", "SystemTime", "println!"]
        {
            // The firmware's simulator is a program of its own, behind a pipe.
            let pipe = impure == "spawn" && file.ends_with("firmware_board.rs");
            assert!(pipe || !code.contains(impure), "{}: {impure}", file.display());
        }
    }
}

#[test]
fn a_circle_is_found_and_a_tree_of_imports_flattened() {
    let imports: Imports = [("a", vec!["b"]), ("b", vec!["c"]), ("c", vec!["a"]), ("d", vec!["a"])]
        .map(|(from, to)| (from.to_owned(), to.into_iter().map(str::to_owned).collect()))
        .into();
    assert_eq!(circle(&imports, "a").unwrap(), ["a", "b", "c"]);
    assert_eq!(circle(&imports, "d"), None);
    assert_eq!(
        flattened("crate::a::{self, b::{C, D}}"),
        ["crate::a::self", "crate::a::b::C", "crate::a::b::D"]
    );
    let known = BTreeSet::from(["a".to_owned(), "a::b".to_owned()]);
    assert_eq!(target("super::b::C", "a::x", &known).unwrap(), "a::b");
    assert_eq!(paths("use std::fmt;\nuse crate::a;\nfn f() { crate::a::b::g() }").len(), 2);
}

/// Numbers that are not counts of joints or taxels: tables state those.
const NO_ROBOT: &[(&str, &str)] = &[
    ("control/src/controller.rs", "<7>"), // which controllers there are
    ("control/src/loop_state.rs", "<7>"), // the same
    ("control/src/config/self_collision.rs", "<7>"), // the same
    ("control/src/config/stability.rs", "<7>"), // the same
    ("control/src/config/default_gains.rs", "<7>"), // the same
    ("sim/src/mechanics/analytic.rs", "<7>"), // which arms it is built for
    ("monitor/src/ui/theme.rs", "; 11]"), // colours
    ("monitor/src/ui/pages/mod.rs", "; 7]"), // pages
    ("figures/src/drawing.rs", "; 7]"),   // colours
    ("control/src/config/mod.rs", "; 7]"), // thresholds of an arm that speaks FCI
    ("franka/src/mode.rs", "; 7]"),       // what such an arm can say that it does
];
/// File of the built-in tables.
const TABLES: &str = "msgs/src/robot.rs";

#[test]
fn only_the_built_in_tables_know_a_robot() {
    const LENGTHS: [&str; 9] =
        ["; 7]", "; 11]", "<7>", "<7,", "<11>", ", 11>", "..=11", "..11)", ": usize = 11;"];
    let mut found = Vec::new();
    for folder in crates() {
        for file in sources(&folder.join("src")) {
            let name = file.strip_prefix(folder.parent().unwrap()).unwrap().display().to_string();
            let only_tests = name.ends_with("tests.rs") || name.contains("/testing/");
            let code = code(&file);
            let lengths = LENGTHS.into_iter().filter(|_| !only_tests && name != TABLES);
            for length in lengths.filter(|length| code.contains(length)) {
                if !NO_ROBOT.contains(&(name.as_str(), length)) {
                    found.push(format!("{name}: {length}"));
                }
            }
            if code.contains("SUMMIT_XL") && !only_tests && name != TABLES {
                found.push(format!("{name}: SUMMIT_XL"));
            }
        }
    }
    assert!(found.is_empty(), "numbers of joints or taxels that no table says:\n{}", found.join("\n"));
    let stale = |(name, length): &&(&str, &str)| {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../crates/");
        !code(&Path::new(folder).join(name)).contains(length)
    };
    assert_eq!(NO_ROBOT.iter().find(stale), None, "an exception that nobody needs");
}
