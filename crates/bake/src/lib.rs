//! Bakes a mesh, its materials and an HDR environment into `.relight` assets.

pub mod compress;
pub mod environment;
pub mod files;
pub mod import;
pub mod measured;
pub mod mesh;
pub mod monitor;
pub mod report;
pub mod scene;
pub mod simd;
mod solve;
pub mod ssdf;
pub mod transfer;
pub mod visibility;
