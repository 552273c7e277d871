//! Tests that cross crates, run binaries, read real data or need a GPU.
//!
//! A module per subject exports `trials()`, listed below. A trial is a function that
//! panics or returns an error when it fails. One that needs something a machine may lack
//! is made by [`support::with_data`] or [`support::with_gpu`] and counts as skipped there,
//! never as passed.

mod import;
#[allow(dead_code)]
mod support;

use std::process::ExitCode;

fn main() -> ExitCode {
    let trials = import::trials();
    libtest_mimic::run(&libtest_mimic::Arguments::from_args(), trials).exit_code()
}
