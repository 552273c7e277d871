//! No kernel may outgrow what it was last made to fit in.

use std::process::ExitCode;

use libtest_mimic::{Completion, Failed, Trial};
use relight_gpu_cost::{Cost, Target, default_root, is_ready, measure};
use relight_shading::wgsl::{KERNELS, Kernel};

/// Most registers, and bytes of memory of a lane, of each kernel on Navi 31 and on Ampere. Kernels
/// that are short of what they are wanted to be (96 registers, no memory) are held where they are.
const BOUNDS: &[(&str, [[u64; 2]; 2])] = &[
    ("vertices mark", [[24, 0], [32, 0]]),
    ("vertices", [[96, 0], [128, 0]]),
    ("diffuse", [[120, 0], [152, 0]]),
    ("shade", [[252, 0], [255, 256]]),
    ("shade, bounced light", [[256, 0], [255, 512]]),
    ("shade, prefiltered", [[256, 0], [255, 768]]),
    ("shade, both", [[256, 0], [255, 1024]]),
    ("sources", [[128, 0], [192, 0]]),
];

fn main() -> ExitCode {
    let root = default_root();
    let ready = is_ready(&root);
    let trials = Target::ALL.into_iter().flat_map(|target| {
        let (root, ready) = (&root, &ready);
        KERNELS.iter().filter_map(move |&kernel| {
            let (_, bounds) = BOUNDS.iter().find(|(name, _)| *name == kernel.name)?;
            let bounds = bounds[usize::from(target == Target::Ampere)];
            let (root, ready) = (root.clone(), ready.clone());
            let name = format!("{} on {}", kernel.name, target.name());
            Some(Trial::ignorable_test(name, move || {
                if let Err(why) = ready {
                    println!("skipped: {why}");
                    return Ok(Completion::ignored_with(why));
                }
                check(&measure(&root, kernel, target)?, kernel, bounds)?;
                Ok(Completion::Completed)
            }))
        })
    });
    let arguments = libtest_mimic::Arguments::from_args();
    libtest_mimic::run(&arguments, trials.collect()).exit_code()
}

fn check(cost: &Cost, kernel: Kernel, [registers, scratch]: [u64; 2]) -> Result<(), Failed> {
    if cost.registers <= registers && cost.scratch <= scratch {
        return Ok(());
    }
    let name = kernel.name;
    Err(format!("{name}: at most {registers} registers, {scratch} bytes: {cost:?}").into())
}
