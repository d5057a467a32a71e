//! A URDF's text as other readers of URDFs take it: a document type without entities, blank lines before the XML
//! declaration and prefixes that no namespace is bound to are accepted.

use roxmltree::{Document, Error, ParsingOptions};
use std::borrow::Cow;

/// Most prefixes without a namespace.
const PREFIXES_MAX: usize = 16;
/// Most nodes of a document.
const NODES_MAX: u32 = 200_000;

/// The text with its lines where they were, as a text that [`parse`] takes.
///
/// # Errors
/// Why it is no XML, or an entity, which no URDF needs and which can stand for any amount of text.
pub(super) fn prepared(text: &str) -> Result<Cow<'_, str>, String> {
    if text.contains("<!ENTITY") {
        return Err("it declares an XML entity, which is not read: write its text where it is used".into());
    }
    let mut text = without_late_declaration(text);
    for _ in 0..PREFIXES_MAX {
        let Err(Error::UnknownNamespace(prefix, _)) = document(&text) else { break };
        let Some(root) = text.find("<robot") else { break };
        text.to_mut().insert_str(root + "<robot".len(), &format!(" xmlns:{prefix}=\"unbound:{prefix}\""));
    }
    Ok(text)
}

/// The document in a prepared text.
///
/// # Errors
/// Why it is no XML.
pub(super) fn parse(text: &str) -> Result<Document<'_>, String> {
    document(text).map_err(|error| format!("no XML: {error}"))
}

fn document(text: &str) -> Result<Document<'_>, Error> {
    let options = ParsingOptions { allow_dtd: true, nodes_limit: NODES_MAX, ..ParsingOptions::default() };
    Document::parse_with_options(text, options)
}

/// XML wants its declaration first; after blank lines it becomes blanks.
fn without_late_declaration(text: &str) -> Cow<'_, str> {
    let start = text.len() - text.trim_start_matches(|c: char| c.is_whitespace() || c == '\u{feff}').len();
    let declaration = text[start..].starts_with("<?xml").then(|| text[start..].find("?>")).flatten();
    match declaration {
        Some(length) if start > 0 => {
            let end = start + length + "?>".len();
            let blanks = |part: &str| -> String {
                part.chars().map(|c| if c.is_whitespace() { c } else { ' ' }).collect()
            };
            Cow::Owned(format!("{}{}", blanks(&text[..end]), &text[end..]))
        }
        _ => Cow::Borrowed(text),
    }
}
