//! Measurements behind the numbers that the documentation states, one module each.

pub mod brdf;
pub mod compression;
