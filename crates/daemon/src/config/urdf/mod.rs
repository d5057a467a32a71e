//! An arm from a URDF file, and a robot as one. The chain between two links becomes a table of [`moca_msgs::robot`]: any
//! axis, since the frame of a link is ours to choose; fixed joints vanish into their neighbours, and what hangs on the
//! chain by fixed joints is weighed with the link that carries it.

mod chain;
mod document;
mod frames;
mod write;

pub use chain::{Limit, UrdfArm, UrdfJoint, read};
pub use write::urdf;

#[cfg(test)]
mod tests;
