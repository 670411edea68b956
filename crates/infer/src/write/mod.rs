//! Results as files: the JSON, the raw maps, the coloured scans.

mod npy;
mod ply;

pub use npy::{write_npy_grid, write_npy_row};
pub use ply::write_coloured_ply;
