//! The scene bake: every stage in order, from an imported scene to the asset.
//!
//! Clusters are made from geometry alone, before visibility is known, so the bake streams:
//! a chunk of triangles is sampled, transformed, compressed and handed over before the
//! next. What is held grows with neither vertices × texels nor threads.

mod assemble;
mod bake;
mod bounce;
mod budget;
mod darkness;
pub mod description;
mod error;
pub mod fingerprint;
mod highlights;
mod kept;
mod layout;
pub mod load;
mod material;
mod options;
mod overlaps;
pub mod parts;
mod plan;
mod queue;
mod sample;
pub mod seam;
mod statistics;
mod surface;

pub use assemble::{Cluster, assemble};
pub use bake::{Bake, bake};
pub use error::Error;
pub use options::{Options, PAPER};
pub use statistics::Statistics;
pub use surface::ErrorSums;

pub use crate::transfer::Options as TransferOptions;
