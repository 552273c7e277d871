//! Spherical Gaussians, BRDFs, SSDF decoding and visible-region integrators: WGSL with a
//! CPU twin of each.

pub mod camera;
pub mod gpu;
pub mod octahedral;
pub mod reference;
pub mod surface;
pub mod wgsl;
