//! The robot with its ring of taxels.

mod top_view;

pub(super) use top_view::show;
