//! Bakes a mesh, its materials and an HDR environment into `.relight` assets.
//!
//! In WebAssembly there are the fits alone: [`environment::fit`] and [`measured::fit`], of bytes.

#[cfg(not(target_family = "wasm"))]
pub mod compress;
pub mod environment;
pub mod error;
#[cfg(not(target_family = "wasm"))]
pub mod files;
#[cfg(not(target_family = "wasm"))]
pub mod import;
pub mod measured;
#[cfg(not(target_family = "wasm"))]
pub mod mesh;
pub mod monitor;
#[cfg(not(target_family = "wasm"))]
pub mod report;
#[cfg(not(target_family = "wasm"))]
pub mod scene;
#[cfg(not(target_family = "wasm"))]
pub mod simd;
mod solve;
#[cfg(not(target_family = "wasm"))]
pub mod ssdf;
#[cfg(not(target_family = "wasm"))]
pub mod transfer;
#[cfg(not(target_family = "wasm"))]
pub mod visibility;
