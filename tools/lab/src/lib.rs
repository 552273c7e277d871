//! Render, truth, compare, demo and experiments, as functions over data in memory. The
//! `lab` binary puts them on a command line.

pub mod bench;
pub mod camera;
pub mod compare;
pub mod demo;
pub mod display;
pub mod experiments;
pub mod image_file;
pub mod render;
pub mod shapes;
pub mod truth;
