//! Stages that every part of Relight builds on, function by function: what shaders compute, what the CPU's twin
//! computes, and what they should.
//!
//! `functions` has an oracle in `f64` for each, with what either may be off by. `visibility` and `reflection` need
//! a scene: there the twin is the oracle, but for decoded SSDFs, which have one of their own; what lobes are off by is a matter of
//! approximation, which the tests of `relight_shading::brdf` bound against the exact models.

pub mod functions;
mod oracle;
pub mod reflection;
pub mod visibility;
