//! Findings of a doctor.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

/// Result of one check of a robot or its PC.
#[derive(Debug)]
pub(super) struct Finding {
    what: &'static str,
    pub(super) good: bool,
    pub(super) found: String,
    remedy: &'static str,
}

impl Finding {
    pub(super) fn new(what: &'static str, good: bool, found: impl Into<String>) -> Self {
        Self { what, good, found: found.into(), remedy: "" }
    }

    /// Sets the remedy, shown where the finding is not good.
    pub(super) fn or(self, remedy: &'static str) -> Self {
        Self { remedy, ..self }
    }
}

/// Prints a heading and its findings: one line for what is well, two for what is not.
pub(super) fn print(heading: &str, findings: &[Finding]) {
    println!("{heading}");
    for Finding { what, good, found, remedy } in findings {
        println!("  {} {what}: {found}", if *good { "ok  " } else { "CARE" });
        if !good {
            println!("       {remedy}");
        }
    }
}
