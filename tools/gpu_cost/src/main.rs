//! `gpu-cost`: a table of what compilers of real GPUs make of the shading kernels.

use std::process::ExitCode;

use relight_gpu_cost::{Target, default_root, is_ready, make_root, measure, measure_source};
use relight_shading::wgsl::{KERNELS, source};

const USAGE: &str = "usage: gpu-cost [KERNEL...] [--from FILE] [--dump]

Makes the root that the compilers live in, if it is not there (Linux, as root, a minute, a gigabyte;
in $GPU_COST_ROOT, else below ~/.cache), and prints what they tell of every kernel, or of those named.

--from FILE  the kernel's text, in place of the one that the crate holds
--dump       prints the text of the kernels instead";

fn main() -> ExitCode {
    match run() {
        Ok(code) => code,
        Err(error) => {
            eprintln!("gpu-cost: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> anyhow::Result<ExitCode> {
    let mut names = Vec::new();
    let mut text = None;
    let mut dump = false;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match (argument.as_str(), argument.starts_with("--")) {
            ("--dump", _) => dump = true,
            ("--from", _) => {
                let path = arguments.next().unwrap_or_default();
                text = Some(std::fs::read_to_string(&path)?);
            }
            (_, true) => {
                eprintln!("{USAGE}");
                return Ok(ExitCode::from(2));
            }
            _ => names.push(argument),
        }
    }
    let chosen = (KERNELS.iter())
        .filter(|kernel| names.is_empty() || names.iter().any(|name| name == kernel.name));
    if dump {
        for kernel in chosen {
            println!("{}", source(kernel.entry));
        }
        return Ok(ExitCode::SUCCESS);
    }
    let root = default_root();
    make_root(&root)?;
    is_ready(&root).map_err(anyhow::Error::msg)?;
    println!(
        "| kernel | compiler | registers | resident | scratch, B | spills | code, KB | cycles |"
    );
    println!("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |");
    for &kernel in chosen {
        for target in Target::ALL {
            let cost = match &text {
                None => measure(&root, kernel, target),
                Some(text) => measure_source(&root, kernel, target, text),
            }?;
            println!(
                "| {} | {} | {} | {} | {} | {} | {:.1} | {} |",
                kernel.name,
                target.name(),
                cost.registers,
                cost.resident,
                cost.scratch,
                cost.spills,
                cost.code as f64 / 1024.0,
                cost.cycles
            );
        }
    }
    Ok(ExitCode::SUCCESS)
}
