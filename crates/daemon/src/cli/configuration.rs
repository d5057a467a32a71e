//! Entering of measured values into a configuration file.

use crate::config::Config;
use anyhow::{Context, Result};
use std::fs;
use std::path::Path;

/// Text of a configuration file.
///
/// # Errors
/// A file that cannot be read.
pub(super) fn read(path: &Path) -> Result<String> {
    fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// `text` with `values` in the section of this path; everything else as it was.
///
/// # Errors
/// A text that is not TOML, or in which the section is something else.
pub(super) fn entered<const N: usize>(
    text: &str,
    section: &[&str],
    values: [(&str, toml_edit::Value); N],
) -> Result<String> {
    let mut document: toml_edit::DocumentMut = text.parse().context("not a TOML file")?;
    let mut at = document.as_item_mut();
    for name in section {
        let within =
            at.as_table_like_mut().with_context(|| format!("[{}] is no section", section.join(".")))?;
        at = within.entry(name).or_insert_with(|| {
            let mut table = toml_edit::Table::new();
            table.set_implicit(true);
            toml_edit::Item::Table(table)
        });
    }
    let table = at.as_table_like_mut().with_context(|| format!("[{}] is no section", section.join(".")))?;
    for (key, value) in values {
        table.insert(key, toml_edit::Item::Value(value));
    }
    Ok(document.to_string())
}

/// Puts `text` in the place of a configuration, whole and valid or not at all.
///
/// # Errors
/// A text with mistakes, and a folder that cannot be written; the file then is as it was.
pub(super) fn replace(path: &Path, text: &str) -> Result<()> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".new");
    let beside = Path::new(&beside);
    let write = || -> Result<()> {
        fs::write(beside, text)?;
        fs::set_permissions(beside, fs::metadata(path)?.permissions())?;
        Config::load(beside)?;
        Ok(fs::rename(beside, path)?)
    };
    write()
        .inspect_err(|_| drop(fs::remove_file(beside)))
        .with_context(|| format!("{} is left as it was", path.display()))
}
