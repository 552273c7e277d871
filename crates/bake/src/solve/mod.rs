//! Numerical methods that several fits share.

pub(crate) mod amplitude;
mod minimise;
#[cfg(not(target_family = "wasm"))]
mod orthonormal;

pub(crate) use minimise::minimise;
#[cfg(not(target_family = "wasm"))]
pub(crate) use orthonormal::orthonormal;
