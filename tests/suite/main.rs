//! Tests that cross crates, run binaries, read real data or need a GPU.
//!
//! A module per subject exports `trials()`, listed below. A trial is a function that
//! panics or returns an error when it fails. One that needs something a machine may lack
//! is made by [`support::with_data`] or [`support::with_gpu`] and counts as skipped there,
//! never as passed.

#![expect(
    clippy::unnecessary_wraps,
    reason = "every trial has the same signature"
)]

mod browser;
mod cli;
mod command;
mod demo;
mod determinism;
mod errors;
mod farm;
mod features;
mod gpu;
mod import;
mod lab;
mod meshes;
mod modules;
mod real_meshes;
mod support;
mod truth;
mod viewer;

use std::process::ExitCode;

fn main() -> ExitCode {
    let trials = [
        browser::trials(),
        cli::trials(),
        demo::trials(),
        determinism::trials(),
        errors::trials(),
        farm::trials(),
        features::trials(),
        gpu::trials(),
        import::trials(),
        lab::trials(),
        modules::trials(),
        real_meshes::trials(),
        truth::trials(),
        viewer::trials(),
    ];
    let trials = trials.into_iter().flatten().collect();
    libtest_mimic::run(&libtest_mimic::Arguments::from_args(), trials).exit_code()
}
