//! The command line: arguments in, assets and messages out.

mod bake_scene;

use std::error::Error;
use std::fmt::Write;
use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use clap::{Args, Parser, Subcommand, ValueEnum};
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use relight_bake::environment::{self, hdr};
use relight_bake::import;
use relight_bake::measured::fit;
use relight_bake::monitor::{Interrupted, Monitor, Progress};
use relight_bake::scene::{self, load};
use relight_format as format;
use serde_json::{Value, json};

const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    the input is not what it should be; the message says where and why
  2    the command line is wrong
  3    a file could not be read or written
  130  interrupted; no output is half-written, and --resume continues a scene bake";

/// Largest niceness that Unix knows.
#[cfg(unix)]
const LOWEST_PRIORITY: i32 = 19;

/// Bakes meshes and HDR environments into .relight assets.
#[derive(Parser)]
#[command(name = "bake", version, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print one JSON object to standard output instead of text.
    #[arg(long, global = true)]
    json: bool,
    /// Worker threads; 0 means one per core.
    #[arg(long, global = true, default_value_t = 0, value_name = "N")]
    threads: usize,
    /// Yield to everything else on the machine.
    #[cfg(unix)]
    #[arg(long, global = true)]
    low_priority: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Bake a scene file (.toml) or a mesh (.gltf, .glb, .obj).
    Scene(SceneArguments),
    /// Join the shards of a scene into the asset that one bake gives.
    Merge {
        /// What `bake scene --shard` wrote, every shard once.
        #[arg(required = true)]
        shards: Vec<PathBuf>,
        /// Asset to write.
        #[arg(short, long, value_name = "OUT.relight")]
        output: PathBuf,
    },
    /// Fit spherical Gaussians to a lat-long HDR image (.hdr, .exr).
    Environment(EnvironmentArguments),
    /// Fit lobes to a measured BRDF (RGL .bsdf, MERL .binary), or pack a material written as
    /// in a scene file (.toml) with its textures.
    Material(MaterialArguments),
    /// Show what an asset holds.
    Inspect {
        /// The asset.
        file: PathBuf,
    },
    /// Check every byte of an asset.
    Validate {
        /// The asset.
        file: PathBuf,
    },
}

#[derive(Clone, Copy, ValueEnum)]
enum Preset {
    Draft,
    Standard,
    High,
}

#[derive(Clone, Copy, ValueEnum)]
enum RepresentationArgument {
    /// Principal components per cluster of vertices.
    Clustered,
    /// Principal components of the whole scene, as in the paper.
    Global,
}

#[derive(Args)]
pub(crate) struct SceneArguments {
    /// Scene file or mesh.
    pub(crate) input: PathBuf,
    /// Asset to write, or with --shard the part.
    #[arg(short, long, value_name = "OUT.relight")]
    pub(crate) output: PathBuf,
    /// Continue from OUT.relight.parts, which an interrupted or killed bake leaves; start
    /// from the beginning if there is none.
    #[arg(long)]
    pub(crate) resume: bool,
    /// Bake the I-th of N parts, I from 1; `bake merge` joins them.
    #[arg(long, value_name = "I/N", value_parser = shard)]
    pub(crate) shard: Option<Shard>,
    /// Also cast one ray per texel at every vertex; any difference is an error.
    #[arg(long)]
    pub(crate) verify_visibility: bool,
    /// Starting point for the options below.
    #[arg(long, value_enum, default_value_t = Preset::Standard)]
    preset: Preset,
    /// How visibility is represented [default: clustered].
    #[arg(long, value_enum)]
    representation: Option<RepresentationArgument>,
    /// Global representation: components besides the mean [default: 24].
    #[arg(long, value_name = "K")]
    rank: Option<u32>,
    /// Clustered representation: how far visibility boundaries on the surface shall be off,
    /// the angle by which a wall's edge would be, root mean square, of compression and of
    /// interpolation between vertices together. What interpolation alone costs, --max-edge and
    /// --refine-error lower [default: as the preset's rate of bytes for accuracy has it].
    #[arg(long, value_name = "RADIANS")]
    max_error: Option<f32>,
    /// Clustered representation: size of the asset, textures included; the least error that
    /// fits is found.
    #[arg(long, value_name = "BYTES", conflicts_with_all = ["max_error", "shard"])]
    max_bytes: Option<u64>,
    /// Clustered representation: tiles of four basis images per cluster, at most.
    #[arg(long, value_name = "N")]
    max_tiles: Option<u32>,
    /// Longest edge after refinement, as a fraction of the diagonal of the scene without
    /// its ground; a scene file's own bound wins.
    #[arg(long, value_name = "FRACTION")]
    max_edge: Option<f32>,
    /// Also cut edges where interpolated visibility is off by more than this: the angle by
    /// which a wall's edge would have to be. It holds for edges of 0.02 of the diagonal of the
    /// scene without its ground; one of half that length may be twice as wrong. A scene file's
    /// own bound wins.
    #[arg(long, value_name = "RADIANS")]
    refine_error: Option<f32>,
    /// Refinement stops at this many vertices.
    #[arg(long, value_name = "N")]
    max_vertices: Option<usize>,
    /// Texels per side of the visibility samples.
    #[arg(long, value_name = "N")]
    sample_resolution: Option<u32>,
    /// Texels per side of the basis images.
    #[arg(long, value_name = "N")]
    basis_resolution: Option<u32>,
}

/// One of several parts of a scene.
#[derive(Clone, Copy)]
pub(crate) struct Shard {
    /// From 1.
    pub(crate) number: u32,
    pub(crate) count: u32,
}

fn shard(text: &str) -> Result<Shard, String> {
    text.split_once('/')
        .and_then(|(number, count)| {
            let (number, count) = (number.parse().ok()?, count.parse().ok()?);
            (1..=count)
                .contains(&number)
                .then_some(Shard { number, count })
        })
        .ok_or_else(|| "expected I/N with I from 1 to N".to_owned())
}

#[derive(Args)]
struct EnvironmentArguments {
    /// Lat-long image.
    input: PathBuf,
    /// Asset to write.
    #[arg(short, long, value_name = "OUT.relight")]
    output: PathBuf,
    /// Spherical Gaussians to fit; with --max-error, at most. Default 32, with --max-error 256.
    #[arg(long, value_name = "N")]
    lobes: Option<usize>,
    /// Add lobes until the relative L2 error is at most this; fail where that takes too many.
    #[arg(long, value_name = "E")]
    max_error: Option<f32>,
    /// Also write the original, the fit and their difference (PNG) and the error over the number
    /// of lobes (CSV, SVG) into this folder.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
}

#[derive(Args)]
struct MaterialArguments {
    /// Table or material file.
    input: PathBuf,
    /// Asset to write.
    #[arg(short, long, value_name = "OUT.relight")]
    output: PathBuf,
    /// Lobes to fit, 1 to 7 [default: until one takes less than a twentieth off the error].
    #[arg(long, value_name = "N", conflicts_with = "max_error",
          value_parser = clap::value_parser!(u8).range(1..=format::MAX_FITTED_LOBES as i64))]
    lobes: Option<u8>,
    /// Add lobes until the relative L2 error is at most this, 7 lobes at most.
    #[arg(long, value_name = "ERROR")]
    max_error: Option<f64>,
    /// Also write sphere.png into this folder: a lit sphere of the table, of the lobes, and
    /// their difference, doubled.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
}

/// Parses the command line, does the work and reports.
pub fn run() -> ExitCode {
    static STOP: AtomicBool = AtomicBool::new(false);
    let cli = Cli::parse();
    #[cfg(unix)]
    if cli.low_priority {
        // Before any other thread starts: they inherit it. A refusal costs speed alone.
        let _ = rustix::process::setpriority_process(None, LOWEST_PRIORITY);
    }
    // Without a handler Ctrl-C ends the process at once, which leaves nothing behind
    // either: outputs are renamed into place.
    let _ = ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed));
    if cli.threads > 0 {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(cli.threads)
            .build_global();
        if let Err(error) = pool {
            eprintln!("error: cannot start {} threads: {error}", cli.threads);
            return ExitCode::from(3);
        }
    }
    let show = Show::new(cli.json);
    let report = |progress| show.progress(progress);
    let monitor = Monitor {
        report: &report,
        stop: &STOP,
    };
    let result = match &cli.command {
        Command::Scene(arguments) => bake_scene::bake(arguments, monitor),
        Command::Merge { shards, output } => bake_scene::merge(shards, output, monitor),
        Command::Environment(arguments) => bake_environment(arguments, monitor),
        Command::Material(arguments) => bake_material(arguments),
        Command::Inspect { file } => inspect(file),
        Command::Validate { file } => validate(file),
    };
    show.finish();
    match result {
        Ok(summary) if cli.json => println!("{}", summary.json),
        Ok(summary) => print!("{}", summary.text),
        Err(error) => {
            eprintln!("error: {error:#}");
            return ExitCode::from(exit_code(&error));
        }
    }
    ExitCode::SUCCESS
}

fn exit_code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if is_interruption(cause) {
            return 130;
        }
        if cause.is::<std::io::Error>() {
            return 3;
        }
    }
    1
}

/// Whether somebody asked to stop. The scene's own error hides what it passes on.
pub(crate) fn is_interruption(cause: &(dyn Error + 'static)) -> bool {
    cause.is::<Interrupted>() || matches!(cause.downcast_ref(), Some(scene::Error::Interrupted(_)))
}

/// What a command says at its end.
pub(crate) struct Summary {
    pub(crate) text: String,
    pub(crate) json: Value,
}

/// A bar on a terminal, a line every few seconds elsewhere, nothing with `--json`.
struct Show {
    bar: Option<ProgressBar>,
    plain: Option<Mutex<Plain>>,
}

struct Plain {
    stage: &'static str,
    start: Instant,
    last: Instant,
}

/// Stages report what is proportional to the work, so the rest takes as long per part as
/// what is done.
fn time_left(elapsed: Duration, fraction: f32) -> Option<Duration> {
    let seconds = elapsed.as_secs_f64() * (1.0 / f64::from(fraction) - 1.0);
    Duration::try_from_secs_f64(seconds.round()).ok()
}

impl Show {
    const PLAIN_INTERVAL: Duration = Duration::from_secs(5);

    fn new(json: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let style = ProgressStyle::with_template(
            "{msg:<28} {bar:40} {percent:>3} %  elapsed {elapsed}  left {left}",
        )
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .with_key("left", |state: &ProgressState, out: &mut dyn Write| {
            if let Some(left) = time_left(state.elapsed(), state.fraction()) {
                let _ = write!(out, "{}", HumanDuration(left));
            }
        });
        let now = Instant::now();
        let plain = Plain {
            stage: "",
            start: now,
            last: now,
        };
        Self {
            bar: (terminal && !json).then(|| ProgressBar::new(1000).with_style(style)),
            plain: (!terminal && !json).then(|| Mutex::new(plain)),
        }
    }

    fn progress(&self, progress: Progress) {
        let Progress { stage, fraction } = progress;
        if let Some(bar) = &self.bar {
            if bar.message() != stage {
                bar.set_message(stage);
                bar.reset_elapsed();
            }
            bar.set_position((fraction * 1000.0) as u64);
        }
        if let Some(plain) = &self.plain {
            let mut plain = plain
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner);
            if plain.stage != stage {
                (plain.stage, plain.start) = (stage, Instant::now());
            }
            if plain.last.elapsed() >= Self::PLAIN_INTERVAL {
                plain.last = Instant::now();
                let left = time_left(plain.start.elapsed(), fraction)
                    .map(|left| format!(", {} left", HumanDuration(left)));
                eprintln!(
                    "{stage}: {:.0} %{}",
                    fraction * 100.0,
                    left.unwrap_or_default()
                );
            }
        }
    }

    fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Puts what was given in place of a default.
fn replace<T: Copy>(option: &mut T, given: Option<T>) {
    *option = given.unwrap_or(*option);
}

pub(crate) fn scene_options(arguments: &SceneArguments) -> scene::Options {
    let mut options = match arguments.preset {
        Preset::Draft => scene::Options::draft(),
        Preset::Standard => scene::Options::standard(),
        Preset::High => scene::Options::high(),
    };
    let representation = arguments.representation.map(|value| match value {
        RepresentationArgument::Clustered => format::Representation::ClusteredPca,
        RepresentationArgument::Global => format::Representation::GlobalPca,
    });
    replace(&mut options.representation, representation);
    replace(&mut options.global_rank, arguments.rank);
    options.max_error = arguments.max_error;
    options.max_bytes = arguments.max_bytes;
    replace(&mut options.max_tiles, arguments.max_tiles);
    replace(&mut options.max_edge, arguments.max_edge);
    replace(&mut options.refine_error, arguments.refine_error);
    replace(&mut options.max_vertices, arguments.max_vertices);
    replace(&mut options.sample_resolution, arguments.sample_resolution);
    replace(&mut options.basis_resolution, arguments.basis_resolution);
    options
}

fn bake_environment(arguments: &EnvironmentArguments, monitor: Monitor) -> anyhow::Result<Summary> {
    check_output(&arguments.output)?;
    let start = Instant::now();
    let options = environment::FitOptions {
        lobes: arguments.lobes.unwrap_or(match arguments.max_error {
            Some(_) => 256,
            None => environment::FitOptions::default().lobes,
        }),
        max_error: arguments.max_error,
    };
    let environment::Fitted { environment, curve } =
        environment::bake(&arguments.input, &options, monitor).map_err(|error| match error {
            // It names the file itself.
            environment::Error::Image(_) => error.into(),
            error => anyhow::Error::new(error).context(arguments.input.display().to_string()),
        })?;
    let irradiance_error = curve.last().map_or(0.0, |last| last.irradiance_error);
    let bytes = format::write_environment(&environment)?;
    write_checked(&arguments.output, &bytes, |bytes| {
        let read = format::read_environment(bytes, &format::Limits::default());
        read.map(|read| read == environment)
    })?;
    if let Some(folder) = &arguments.report {
        let image = hdr::load(&arguments.input)?;
        let pictures = environment::report::pictures(&image, &environment.lobes)?;
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let files = [
            ("original.png", pictures.original),
            ("fit.png", pictures.fit),
            ("difference.png", pictures.difference),
            ("curve.csv", environment::report::curve_csv(&curve).into()),
        ];
        let plot = environment::report::curve_svg(&curve);
        let plot = plot.map(|svg| ("curve.svg", svg.into_bytes()));
        for (name, bytes) in files.into_iter().chain(plot) {
            format::write_file(&folder.join(name), &bytes)?;
        }
    }
    let report = &environment.report;
    if report.repaired_pixels > 0 {
        eprintln!(
            "warning: {} NaN, infinite or negative pixels repaired",
            report.repaired_pixels
        );
    }
    let seconds = start.elapsed().as_secs_f64();
    Ok(Summary {
        text: format!(
            "{}: {} lobes, {} bytes\n\
             relative L2 error {:.4}, energy error {:.4?}, irradiance error {irradiance_error:.4}\n\
             {seconds:.1} s\n",
            arguments.output.display(),
            environment.lobes.len(),
            bytes.len(),
            report.relative_l2,
            report.energy_error,
        ),
        json: json!({
            "output": arguments.output,
            "bytes": bytes.len(),
            "lobes": environment.lobes.len(),
            "relative_l2": report.relative_l2,
            "energy_error": report.energy_error,
            "irradiance_error": irradiance_error,
            "repaired_pixels": report.repaired_pixels,
            "seconds": seconds,
        }),
    })
}

fn bake_material(arguments: &MaterialArguments) -> anyhow::Result<Summary> {
    check_output(&arguments.output)?;
    let start = Instant::now();
    let name =
        |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    let source = name(arguments.input.file_name());
    let mut report = format::MaterialReport {
        source: source.clone(),
        ..format::MaterialReport::default()
    };
    let packed = arguments.input.extension().is_some_and(|e| e == "toml");
    let (mut material, textures) = if packed {
        load::load_material(&arguments.input)?
    } else {
        let table = load::load_table(&arguments.input)?;
        let stop = match (arguments.lobes, arguments.max_error) {
            (Some(lobes), _) => fit::Stop::Lobes(lobes.into()),
            (None, Some(error)) => fit::Stop::Error(error),
            (None, None) => fit::Stop::default(),
        };
        let fit = fit::fit(&table, stop);
        report.relative_l2 = fit.relative_l2 as f32;
        report.shaded_relative_l2 = fit.shaded_relative_l2 as f32;
        report.albedo_error = fit.albedo_error as f32;
        if let Some(folder) = &arguments.report {
            std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
            let picture = relight_bake::measured::report::sphere(&table, &fit)?;
            format::write_file(&folder.join("sphere.png"), &picture)?;
        }
        (import::plain_material("", fit.surface(source)), Vec::new())
    };
    material.name = name(arguments.input.file_stem());
    let asset = format::MaterialAsset {
        report,
        material,
        textures,
    };
    let bytes = format::write_material(&asset)?;
    write_checked(&arguments.output, &bytes, |bytes| {
        let read = format::read_material(bytes, &format::Limits::default());
        read.map(|read| read == asset)
    })?;
    let seconds = start.elapsed().as_secs_f64();
    let report = &asset.report;
    let mut text = format!(
        "{}: {} textures, {} bytes\n",
        arguments.output.display(),
        asset.textures.len(),
        bytes.len(),
    );
    let mut object = json!({
        "output": arguments.output,
        "bytes": bytes.len(),
        "material": asset.material,
        "textures": asset.textures.len(),
        "seconds": seconds,
    });
    if let format::Surface::Layered {
        specular: format::Specular::Lobes { lobes, .. },
        ..
    } = &asset.material.surface
        && !packed
    {
        text += &format!(
            "{} lobes, relative L2 error {:.4}, as shaded {:.4}, albedo error {:.4}\n{seconds:.1} s\n",
            lobes.len(),
            report.relative_l2,
            report.shaded_relative_l2,
            report.albedo_error,
        );
        object["lobes"] = json!(lobes.len());
        object["relative_l2"] = json!(report.relative_l2);
        object["shaded_relative_l2"] = json!(report.shaded_relative_l2);
        object["albedo_error"] = json!(report.albedo_error);
    }
    Ok(Summary { text, json: object })
}

/// Fails early, before hours of work, if the output's folder does not exist.
pub(crate) fn check_output(output: &Path) -> anyhow::Result<()> {
    let folder = output
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let metadata = std::fs::metadata(folder)
        .with_context(|| format!("{}: cannot write there", folder.display()))?;
    if metadata.is_dir() {
        Ok(())
    } else {
        Err(std::io::Error::from(std::io::ErrorKind::NotADirectory))
            .with_context(|| format!("{}: cannot write there", folder.display()))
    }
}

/// Writes an asset, reads it back and compares it with what was meant.
pub(crate) fn write_checked(
    path: &Path,
    bytes: &[u8],
    same: impl FnOnce(&[u8]) -> Result<bool, format::Error>,
) -> anyhow::Result<()> {
    format::write_file(path, bytes)?;
    let read = read(path)?;
    if read != bytes || !same(&read).with_context(|| path.display().to_string())? {
        bail!(
            "{}: what was read back is not what was written",
            path.display()
        );
    }
    Ok(())
}

fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(path).with_context(|| path.display().to_string())
}

enum Asset {
    Scene(Box<format::Scene>),
    Environment(format::Environment),
    Material(Box<format::MaterialAsset>),
}

fn decode(path: &Path) -> anyhow::Result<(Vec<format::SectionInfo>, Asset)> {
    let bytes = read(path)?;
    let limits = format::Limits::default();
    let asset = || -> Result<_, format::Error> {
        let (kind, _, sections) = format::inspect(&bytes, &limits)?;
        let asset = match kind {
            format::Kind::Scene => Asset::Scene(Box::new(format::read_scene(&bytes, &limits)?)),
            format::Kind::Environment => {
                Asset::Environment(format::read_environment(&bytes, &limits)?)
            }
            format::Kind::Material => {
                Asset::Material(Box::new(format::read_material(&bytes, &limits)?))
            }
        };
        Ok((sections, asset))
    };
    asset().with_context(|| path.display().to_string())
}

fn validate(path: &Path) -> anyhow::Result<Summary> {
    decode(path)?;
    Ok(Summary {
        text: format!("{}: valid\n", path.display()),
        json: json!({ "file": path, "valid": true }),
    })
}

fn inspect(path: &Path) -> anyhow::Result<Summary> {
    let (sections, asset) = decode(path)?;
    let mut text = format!("{}: ", path.display());
    let mut object = match &asset {
        Asset::Scene(scene) => {
            let parameters = &scene.visibility;
            text += &format!(
                "scene {:?}, format version {}\n\
                 {} vertices, {} triangles, {} materials, {} textures\n\
                 {:?}: {} clusters, {} tiles of 4 images at {r}x{r}, sampled at {s}x{s}\n\
                 {}\n",
                scene.name,
                format::VERSION,
                scene.vertices.len(),
                scene.triangles.len(),
                scene.materials.len(),
                scene.textures.len(),
                parameters.representation,
                scene.clusters.len(),
                scene
                    .clusters
                    .iter()
                    .map(|cluster| cluster.tiles)
                    .sum::<u32>(),
                bake_scene::describe(&scene.report.errors),
                r = parameters.basis_resolution,
                s = parameters.sample_resolution,
            );
            json!({
                "kind": "scene",
                "name": scene.name,
                "vertices": scene.vertices.len(),
                "triangles": scene.triangles.len(),
                "clusters": scene.clusters.len(),
                "tiles": scene.clusters.iter().map(|cluster| cluster.tiles).sum::<u32>(),
                "visibility": parameters,
                "camera": scene.camera,
                "materials": scene.materials,
                "textures": scene.textures.iter().map(|t| json!([t.width, t.height])).collect::<Vec<_>>(),
                "report": scene.report,
            })
        }
        Asset::Environment(environment) => {
            text += &format!(
                "environment, format version {}\n{} lobes fitted to {} ({}x{}), relative L2 {:.4}, energy error {:?}\n",
                format::VERSION,
                environment.lobes.len(),
                environment.report.source,
                environment.report.source_size[0],
                environment.report.source_size[1],
                environment.report.relative_l2,
                environment.report.energy_error,
            );
            let lobes: Vec<Value> = (environment.lobes.iter())
                .map(
                    |l| json!({"axis": l.axis, "sharpness": l.sharpness, "amplitude": l.amplitude}),
                )
                .collect();
            json!({ "kind": "environment", "report": environment.report, "lobes": lobes })
        }
        Asset::Material(asset) => json!({
            "kind": "material",
            "report": asset.report,
            "material": asset.material,
            "textures": asset.textures.iter().map(|t| json!([t.width, t.height])).collect::<Vec<_>>(),
        }),
    };
    if let Asset::Material(asset) = &asset {
        text += &format!(
            "material, format version {}\n{:#?}\n{} textures; relative L2 {:.4}, as shaded {:.4}, albedo error {:.4}\n",
            format::VERSION,
            asset.material,
            asset.textures.len(),
            asset.report.relative_l2,
            asset.report.shaded_relative_l2,
            asset.report.albedo_error,
        );
    }
    let mut rows = Vec::new();
    for section in &sections {
        text += &format!(
            "{:>12?}  {:>12} bytes stored  {:>12} raw  crc {:08x}\n",
            section.kind, section.stored_length, section.raw_length, section.checksum,
        );
        rows.push(json!({
            "section": format!("{:?}", section.kind),
            "stored_length": section.stored_length,
            "raw_length": section.raw_length,
        }));
    }
    object["file"] = json!(path);
    object["version"] = json!(format::VERSION);
    object["sections"] = json!(rows);
    Ok(Summary { text, json: object })
}
