//! No kernel may outgrow what it was last made to fit in.

use std::process::ExitCode;

use libtest_mimic::{Completion, Failed, Trial};
use relight_gpu_cost::{Cost, Target, default_root, is_ready, measure};
use relight_shading::wgsl::{KERNELS, Kernel};

/// Most registers of each kernel on Navi 31 and on Ampere, as they are: 96 are wanted. Kernels that look
/// textures up keep what waits for them across the loop over a pixel's points: 12 on Navi 31, 32 to 48 on Ampere. None may take
/// memory for registers, but for those that shade by cells, which are not bounded.
const BOUNDS: &[(&str, [u64; 2])] = &[
    ("vertices mark", [12, 24]),
    ("vertices", [84, 104]),
    ("diffuse", [108, 128]),
    ("reflections", [108, 160]),
    ("reflections, next", [96, 160]),
    ("products", [84, 128]),
    ("products, image", [84, 128]),
    ("integrals", [108, 112]),
    ("integrals, image", [108, 112]),
    ("around, bounced light", [96, 152]),
    ("around, image", [96, 112]),
    ("around, both", [96, 160]),
    ("images", [60, 72]),
    ("shade", [48, 72]),
    ("sources", [120, 200]),
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

fn check(cost: &Cost, kernel: Kernel, registers: u64) -> Result<(), Failed> {
    if cost.registers <= registers && cost.scratch == 0 && cost.spills == 0 {
        return Ok(());
    }
    let name = kernel.name;
    Err(format!("{name}: at most {registers} registers, no memory: {cost:?}").into())
}
