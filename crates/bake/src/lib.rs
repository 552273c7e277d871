//! Bakes a mesh, its materials and an HDR environment into `.relight` assets.
//!
//! Scenes are loaded by [`scene::load`] and baked by [`scene::bake`]; images are fitted by
//! [`environment::fit`], measured BRDFs by [`measured::fit`]. `public-api.txt` lists what can be named.
//!
//! In WebAssembly there are the fits alone: [`environment::fit`] and [`measured::fit`], of bytes.

#![warn(unreachable_pub)]

#[cfg(not(target_family = "wasm"))]
pub mod clock;
#[cfg(not(target_family = "wasm"))]
mod compress;
pub mod environment;
pub mod error;
#[cfg(not(target_family = "wasm"))]
pub mod files;
#[cfg(not(target_family = "wasm"))]
pub mod import;
#[cfg(not(target_family = "wasm"))]
pub mod internals;
pub mod measured;
#[cfg(not(target_family = "wasm"))]
mod memory;
#[cfg(not(target_family = "wasm"))]
pub mod mesh;
pub mod monitor;
#[cfg(not(target_family = "wasm"))]
mod report;
#[cfg(not(target_family = "wasm"))]
pub mod scene;
#[cfg(not(target_family = "wasm"))]
pub mod simd;
mod solve;
#[cfg(not(target_family = "wasm"))]
mod ssdf;
#[cfg(not(target_family = "wasm"))]
mod transfer;
#[cfg(not(target_family = "wasm"))]
mod visibility;
