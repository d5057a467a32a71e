//! moca-monitor.
fn main() {}
