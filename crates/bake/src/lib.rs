//! Bakes a mesh, its materials and an HDR environment into `.relight` assets.

pub mod cluster;
pub mod compress;
pub mod contour;
pub mod hdr;
pub mod measured;
pub mod monitor;
pub mod ray;
pub mod ssdf;
pub mod visibility;
