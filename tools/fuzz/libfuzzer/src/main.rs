//! One binary for all targets: `RELIGHT_FUZZ_TARGET` names one.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use relight_fuzz::{TARGETS, Target, mutate};

static TARGET: LazyLock<Target> = LazyLock::new(|| {
    let name = std::env::var("RELIGHT_FUZZ_TARGET").unwrap_or_default();
    let found = TARGETS.into_iter().find(|target| target.name == name);
    found.unwrap_or_else(|| {
        let names: Vec<_> = TARGETS.iter().map(|target| target.name).collect();
        eprintln!("RELIGHT_FUZZ_TARGET: expected one of {}", names.join(", "));
        std::process::exit(2);
    })
});

fuzz_target!(|bytes: &[u8]| (TARGET.read)(bytes));

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut change = |bytes: &mut Vec<u8>| {
        let length = bytes.len();
        bytes.resize(length + 64, 0);
        let changed = fuzzer_mutate(bytes, length, length + 64);
        bytes.truncate(changed);
    };
    // One in eight is a plain mutant, which also tests the checksums.
    let whole = (seed % 8 != 0)
        .then(|| mutate::mutant(TARGET.repair, &data[..size], seed >> 3, max_size, &mut change))
        .flatten();
    match whole {
        Some(mutant) => {
            data[..mutant.len()].copy_from_slice(&mutant);
            mutant.len()
        }
        None => fuzzer_mutate(data, size, max_size),
    }
});
