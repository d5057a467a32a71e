//! An arm from a URDF file, and a robot as one. The chain between two links becomes a table of [`moca_msgs::robot`]: any
//! axis, since the frame of a link is ours to choose; fixed joints vanish into their neighbours, and what hangs on the
//! chain is weighed with the link that carries it, joints of it held at 0 or at the end of their range nearest to that.

mod capsules;
mod chain;
mod document;
mod frames;
mod text;
mod write;

pub use capsules::capsules;
pub use chain::{Given, Limit, Part, UrdfArm, UrdfJoint, read};
pub use write::urdf;

#[cfg(test)]
mod foreign;
#[cfg(test)]
mod tests;
