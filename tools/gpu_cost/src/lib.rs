//! What compilers of real GPUs make of the shading kernels: registers, waves that fit beside one
//! another, memory for what does not fit into registers, size of the code. No GPU is needed: Mesa's
//! drivers compile for hardware that is not there, with a library that answers in the kernel's
//! place. They live in a root of their own, which `make_root.sh` makes.
//!
//! All of it is static. It ranks variants of a kernel; it is no frame time.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, bail, ensure};
use relight_shading::wgsl::{Kernel, source};

/// A compiler, and the chip that it compiles for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// AMD's RDNA 3, Radeon RX 7900, by Mesa's ACO.
    Navi31,
    /// NVIDIA's GA102, GeForce RTX 3080, by Mesa's NAK.
    Ampere,
}

impl Target {
    /// Both of them.
    pub const ALL: [Self; 2] = [Self::Navi31, Self::Ampere];

    /// As tables name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Navi31 => "RADV Navi 31",
            Self::Ampere => "NAK Ampere",
        }
    }

    fn environment(self) -> [(&'static str, &'static str); 3] {
        let shims = match self {
            Self::Navi31 => "/usr/lib/x86_64-linux-gnu/libamdgpu_noop_drm_shim.so",
            Self::Ampere => "/usr/lib/x86_64-linux-gnu/libnouveau_noop_drm_shim.so",
        };
        match self {
            Self::Navi31 => [
                ("LD_PRELOAD", shims),
                ("AMDGPU_GPU_ID", "navi31"),
                (
                    "VK_ICD_FILENAMES",
                    "/usr/share/vulkan/icd.d/radeon_icd.json",
                ),
            ],
            Self::Ampere => [
                ("LD_PRELOAD", shims),
                ("NOUVEAU_CHIPSET", "172"),
                (
                    "VK_ICD_FILENAMES",
                    "/usr/share/vulkan/icd.d/nouveau_icd.json",
                ),
            ],
        }
    }
}

/// What one compiler tells of one kernel.
#[derive(Clone, Debug)]
pub struct Cost {
    /// The kernel.
    pub kernel: Kernel,
    /// The compiler.
    pub target: Target,
    /// Registers of a lane.
    pub registers: u64,
    /// Waves or warps that a scheduler (of AMD: of 16) or a multiprocessor (of NVIDIA: of 48) holds.
    pub resident: u64,
    /// Bytes of memory of a lane for what has no register, and for arrays that are indexed.
    pub scratch: u64,
    /// Registers that were moved to memory.
    pub spills: u64,
    /// Bytes of instructions.
    pub code: u64,
    /// The compiler's own estimate of cycles, every loop taken once.
    pub cycles: u64,
}

/// The root to use: `GPU_COST_ROOT`, else one below the user's cache.
pub fn default_root() -> PathBuf {
    let variable = |name| std::env::var_os(name).map(PathBuf::from);
    variable("GPU_COST_ROOT").unwrap_or_else(|| {
        let home = variable("HOME").unwrap_or_else(std::env::temp_dir);
        variable("XDG_CACHE_HOME")
            .unwrap_or_else(|| home.join(".cache"))
            .join("gpu_cost")
    })
}

/// Makes the root, or says why it cannot be.
pub fn make_root(root: &Path) -> anyhow::Result<()> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("make_root.sh");
    let status = Command::new("bash").arg(script).arg(root).status()?;
    ensure!(status.success(), "make_root.sh: {status}");
    Ok(())
}

/// Whether [`measure`] can be asked: the root is there, and this process may enter it.
pub fn is_ready(root: &Path) -> Result<(), String> {
    if !root.join("relight-statistics").exists() {
        return Err(format!(
            "no {}: cargo xtask gpu-cost makes it",
            root.display()
        ));
    }
    let entered = enter(root).arg("/bin/true").output();
    match entered {
        Ok(output) if output.status.success() => Ok(()),
        _ => Err(format!("cannot enter {}: needs to be root", root.display())),
    }
}

/// Compiles `kernel` for `target` in `root`.
pub fn measure(root: &Path, kernel: Kernel, target: Target) -> anyhow::Result<Cost> {
    measure_source(root, kernel, target, &source(kernel.entry))
}

/// The same of another text.
pub fn measure_source(
    root: &Path,
    kernel: Kernel,
    target: Target,
    text: &str,
) -> anyhow::Result<Cost> {
    let (words, bindings) = compile(text, kernel)?;
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    let folder = root.join("spirv");
    std::fs::create_dir_all(&folder)?;
    let file = tempfile::Builder::new()
        .suffix(".spv")
        .tempfile_in(&folder)?;
    std::fs::write(file.path(), bytes)?;
    let name = file.path().file_name().context("a file has a name")?;
    let output = enter(root)
        .arg("/usr/bin/env")
        .args(
            target
                .environment()
                .map(|(name, value)| format!("{name}={value}")),
        )
        .args([
            "NVK_I_WANT_A_BROKEN_VULKAN_DRIVER=1",
            "MESA_SHADER_CACHE_DISABLE=1",
        ])
        .arg("/relight-statistics")
        .arg(Path::new("/spirv").join(name))
        .arg(kernel.entry_point)
        .args(bindings)
        .output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    if !output.status.success() {
        let why = String::from_utf8_lossy(&output.stderr);
        bail!("{} for {}: {why}", kernel.name, target.name());
    }
    let value = |names: &[&str]| -> anyhow::Result<u64> {
        let found = text.lines().find_map(|line| {
            let (name, value) = line.split_once('\t')?;
            names.contains(&name).then_some(value)
        });
        let found = found.with_context(|| format!("no {names:?} in\n{text}"))?;
        Ok(found.trim().parse()?)
    };
    let (registers, resident, scratch, spills, code, cycles): (&[_], &[_], &[_], &[_], &[_], &[_]) =
        match target {
            Target::Navi31 => (
                &["VGPRs"],
                &["Subgroups per SIMD"],
                &["Scratch size"],
                &["Spilled VGPRs"],
                &["Code size"],
                &["Inverse Throughput"],
            ),
            Target::Ampere => (
                &["Number of GPRs", "GPR count"],
                &["Max warps/SM"],
                &["SLM size"],
                &["Spills to memory", "Spills to mem"],
                &["Code size", "Code Size"],
                &["Static cycle count"],
            ),
        };
    Ok(Cost {
        kernel,
        target,
        registers: value(registers)?,
        resident: value(resident)?,
        scratch: value(scratch)?,
        spills: value(spills)?,
        code: value(code)?,
        cycles: value(cycles)?,
    })
}

/// A command that runs in the root, with `/proc` there.
fn enter(root: &Path) -> Command {
    let script =
        "mkdir -p \"$0/proc\" && mount -t proc proc \"$0/proc\" && exec chroot \"$0\" \"$@\"";
    let mut command = Command::new("unshare");
    command.args(["--mount", "bash", "-c", script]).arg(root);
    command
}

/// SPIR-V as wgpu makes it on drivers with `VK_EXT_robustness2`, and what the entry point binds.
fn compile(text: &str, kernel: Kernel) -> anyhow::Result<(Vec<u32>, Vec<String>)> {
    use naga::back::spv;
    use naga::proc::{BoundsCheckPolicies, BoundsCheckPolicy};

    let entry_point = kernel.entry_point;
    let module = naga::front::wgsl::parse_str(text)
        .map_err(|error| anyhow::anyhow!(error.emit_to_string(text)))?;
    let info = naga::valid::Validator::new(
        naga::valid::ValidationFlags::all(),
        naga::valid::Capabilities::empty(),
    )
    .validate(&module)
    .map_err(|error| anyhow::anyhow!(error.emit_to_string(text)))?;
    let constants = kernel.constants.iter();
    let constants = constants.map(|&(name, value)| (name.to_owned(), value));
    let (module, info) = naga::back::pipeline_constants::process_overrides(
        &module,
        &info,
        Some((naga::ShaderStage::Compute, entry_point)),
        &constants.collect(),
    )?;
    let options = spv::Options {
        lang_version: (1, 3),
        flags: spv::WriterFlags::empty(),
        fake_missing_bindings: true,
        bounds_check_policies: BoundsCheckPolicies {
            index: BoundsCheckPolicy::Restrict,
            buffer: BoundsCheckPolicy::Unchecked,
            image_load: BoundsCheckPolicy::Unchecked,
            binding_array: BoundsCheckPolicy::Unchecked,
        },
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::Native,
        ..Default::default()
    };
    let pipeline = spv::PipelineOptions {
        shader_stage: naga::ShaderStage::Compute,
        entry_point: entry_point.to_owned(),
    };
    let words = spv::write_vec(&module, &info, &options, Some(&pipeline))?;
    let index = (module.entry_points.iter())
        .position(|entry| entry.name == entry_point)
        .with_context(|| format!("no entry point {entry_point}"))?;
    let used = info.get_entry_point(index);
    let mut bindings = Vec::new();
    for (handle, variable) in module.global_variables.iter() {
        let Some(binding) = &variable.binding else {
            continue;
        };
        if used[handle].is_empty() {
            continue;
        }
        let kind = match (variable.space, &module.types[variable.ty].inner) {
            (naga::AddressSpace::Uniform, _) => 'u',
            (naga::AddressSpace::Storage { .. }, _) => 's',
            (_, naga::TypeInner::Sampler { .. }) => 'p',
            (_, naga::TypeInner::Image { class, .. }) => match class {
                naga::ImageClass::Storage { .. } => 'w',
                _ => 't',
            },
            other => bail!("binding of {other:?}"),
        };
        bindings.push(format!("{}.{}.{kind}", binding.group, binding.binding));
    }
    Ok((words, bindings))
}
