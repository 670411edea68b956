//! Pictures of predictions that a person understands at a glance.

mod canvas;
mod hand;
mod heat;
mod labels;
mod overlay;
mod sheet;
mod splat;
mod view;

pub use heat::{heat_colour, heat_end};
pub use overlay::draw_overlay;
pub use sheet::draw_sheet;
