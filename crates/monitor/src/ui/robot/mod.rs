//! The robot with its ring of taxels: from above, and in three dimensions.

mod legend;
mod scale;
mod top_view;
mod view_3d;

pub(super) use legend::legend;
pub(super) use top_view::{height, show};
pub(super) use view_3d::{plate_at, view_3d};
