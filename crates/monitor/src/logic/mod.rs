//! Contents of the dashboard and its requests, without a screen.
//!
//! [`model`] takes in what a [`source`] delivers and remembers it: [`signals`] over time, [`event`]s, the latest sample.
//! [`requests`] says what may be asked when · [`answers`] what came of it ·
//! [`fleet`] several robots at a glance · [`tuning`] what differs from its default parameters ·
//! [`kinematics`] where the arm's joints are, [`camera`] where they are in a picture ·
//! [`gripper`] what is held, and the numbers of a grasp · [`simulated_press`] presses a simulated taxel slowly ·
//! [`format`](mod@format) turns numbers and states into text · [`limited`] holds a value between two bounds, [`time_window`] the strip inside its log.

pub mod answers;
pub mod camera;
pub mod event;
pub mod fleet;
pub mod format;
pub mod gripper;
pub mod kinematics;
pub mod limited;
pub mod model;
pub mod requests;
pub mod signals;
pub mod simulated_press;
pub mod source;
pub mod time_window;
pub mod tuning;
