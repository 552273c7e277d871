//! Spherical Gaussians, BRDFs, SSDF decoding and visible-region integrators: WGSL with a
//! CPU twin of each.

pub mod accuracy;
pub mod ambient;
pub mod background;
pub mod brdf;
pub mod camera;
pub mod catcher;
pub mod cells;
mod contribution;
pub mod glossy;
pub mod gpu;
pub mod local_light;
pub mod motion;
pub mod occluders;
pub mod octahedral;
pub mod pack;
pub mod pixel_visibility;
pub mod polar;
pub mod prefiltered;
pub mod reference;
pub mod shade;
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
