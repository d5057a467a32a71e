//! Findings of a doctor.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use std::borrow::Cow;

/// One thing that a robot or its PC has to have.
#[derive(Debug)]
pub(crate) struct Finding {
    pub(crate) what: &'static str,
    pub(crate) good: bool,
    pub(crate) found: String,
    pub(crate) remedy: Cow<'static, str>,
}

impl Finding {
    pub(crate) fn new(
        what: &'static str,
        good: bool,
        found: impl Into<String>,
        remedy: impl Into<Cow<'static, str>>,
    ) -> Self {
        Self { what, good, found: found.into(), remedy: remedy.into() }
    }
}

/// One line for what is well, two for what is not.
pub(crate) fn print(findings: &[Finding]) {
    for Finding { what, good, found, remedy } in findings {
        println!("  {} {what}: {found}", if *good { "ok  " } else { "CARE" });
        if !good {
            println!("       {remedy}");
        }
    }
}
