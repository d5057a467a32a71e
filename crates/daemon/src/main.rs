//! mocad.
fn main() {}
