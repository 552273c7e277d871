//! No kernel may outgrow what it was last made to fit in.

use std::process::ExitCode;

use libtest_mimic::{Completion, Failed, Trial};
use relight_gpu_cost::{Cost, Target, default_root, is_ready, measure};
use relight_shading::wgsl::{KERNELS, Kernel};

/// Most registers of each kernel on Navi 31 and on Ampere: 96, of which 12 waves and 20 warps fit beside one another. None
/// may take memory for registers, but for those that shade by cells, which are not bounded.
const BOUNDS: &[(&str, [u64; 2])] = &[
    ("vertices mark", [24, 24]),
    ("vertices", [84, 96]),
    ("textures", [48, 56]),
    ("textures, second", [48, 64]),
    ("diffuse", [84, 88]),
    ("diffuse, ambient", [60, 80]),
    ("reflections", [72, 96]),
    ("reflections, next", [60, 88]),
    ("products", [96, 96]),
    ("products, image", [96, 96]),
    ("integrals", [84, 96]),
    ("integrals, image", [84, 96]),
    ("integrals, ambient", [60, 80]),
    ("integrals, image, ambient", [60, 80]),
    ("around, bounced light", [84, 96]),
    ("around, image", [84, 80]),
    ("images", [60, 64]),
    ("shade", [48, 72]),
    ("shade, second", [48, 80]),
    ("sources, coarse", [72, 96]),
    ("sources", [72, 96]),
    ("sources, shadow map", [72, 96]),
    ("sources, shown", [48, 80]),
];

/// Most bytes of code: more than what Ampere's caches of instructions hold takes its time from memory.
const MOST_CODE: u64 = 64 * 1024;

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
    let fits = cost.registers <= registers && cost.code <= MOST_CODE;
    if fits && cost.scratch == 0 && cost.spills == 0 {
        return Ok(());
    }
    let name = kernel.name;
    Err(format!(
        "{name}: at most {registers} registers, {MOST_CODE} bytes of code, no memory: {cost:?}"
    )
    .into())
}
