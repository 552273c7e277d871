//! Spherical Gaussians, BRDFs, SSDF decoding and visible-region integrators: WGSL with a
//! CPU twin of each.
//!
//! # Features
//!
//! None is on by default, and none changes what the others do. `paper` adds `cells`, the integrator of Wang et al.
//! (2013), for comparisons. `reference` adds sampling of the exact reflection models, for path tracers and fits, and
//! `accuracy` how far lobes are from them.

#[cfg(feature = "accuracy")]
pub mod accuracy;
pub mod ambient;
pub mod background;
pub mod brdf;
pub mod camera;
pub mod catcher;
#[cfg(feature = "paper")]
pub mod cells;
mod contribution;
pub mod glossy;
pub mod gpu;
pub mod local_light;
pub mod models;
pub mod motion;
pub mod occluders;
pub mod octahedral;
pub mod pack;
pub mod pixel_visibility;
pub mod polar;
pub mod prefiltered;
#[cfg(feature = "reference")]
pub mod reference;
pub mod shade;
#[cfg(feature = "paper")]
pub mod shade_cells;
pub mod shadow_map;
pub mod slots;
pub mod sources;
pub mod spherical_gaussian;
pub mod ssdf;
pub mod surface;
pub mod surfaces;
pub mod tables;
pub mod textures;
pub mod tile;
pub mod tonemap;
pub mod transfer;
pub mod vertex_visibility;
pub mod wgsl;
