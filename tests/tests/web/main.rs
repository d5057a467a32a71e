//! The page's gateway beside a running daemon: who is let in, what is obeyed, what stops the robot.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

mod browser;
mod doors;
mod floods;
mod gripper;
mod hold;
mod robot;
