//! Bakes a mesh, its materials and an HDR environment into `.relight` assets.

pub mod cluster;
pub mod compress;
pub mod contour;
pub mod environment;
pub mod fingerprint;
pub mod ground;
pub mod hdr;
pub mod import;
pub mod measured;
pub mod monitor;
pub mod parts;
mod picture;
pub mod plot;
pub mod ray;
pub mod refine;
pub mod scene;
pub mod scene_file;
pub mod scene_input;
pub mod seam;
pub mod ssdf;
pub mod tangent;
pub mod visibility;
