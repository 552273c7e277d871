//! The command line: arguments in, assets and messages out.

mod arguments;
mod bake_scene;
mod inspect;
mod show;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::Parser as _;
use relight_bake::environment::{self, hdr};
use relight_bake::error::{Error, Objection};
use relight_bake::files::{self, Access, Files, OutputError};
use relight_bake::import;
use relight_bake::measured::{self, fit};
use relight_bake::monitor::{Interrupted, Monitor};
use relight_bake::scene::load;
use relight_bake::simd;
use relight_format as format;
use serde_json::{Value, json};

use arguments::{Cli, Command, EnvironmentArguments, MaterialArguments, Usage};
use show::{Output, Show, Summary};

/// Largest niceness that Unix knows.
#[cfg(unix)]
const LOWEST_PRIORITY: i32 = 19;
/// Most threads, unless there are more cores: more would only take memory.
const MOST_THREADS: usize = 64;
/// How often brighter the lower half of an image may be before that is mentioned.
const UPSIDE_DOWN: f64 = 4.0;
/// Files of an environment's report.
const REPORT: [&str; 5] = [
    "original.png",
    "fit.png",
    "difference.png",
    "curve.csv",
    "curve.svg",
];

/// How long a command may take to stop by itself when it is asked to.
fn patience(command: &Command) -> Duration {
    match command {
        // It finishes the chunks at hand, and says what can be continued.
        Command::Scene(_) | Command::Merge { .. } => Duration::from_secs(30),
        _ => Duration::from_secs(1),
    }
}

/// Set when somebody asks to stop.
static STOP: AtomicBool = AtomicBool::new(false);
/// Held while an output is written: it takes moments, and an end then would leave debris.
static WRITING: Mutex<()> = Mutex::new(());

/// Ends the process some time after it was asked to stop, at once if it is asked twice. Most
/// stages stop by themselves, but not all: reading a mesh, fitting a table.
fn handle_interrupts(show: &'static Show, patience: Duration) {
    let end = || {
        let _writing = WRITING
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        let code = show.finish(&Err(Interrupted.into()));
        std::process::exit(code.into());
    };
    // Without a handler Ctrl-C ends the process at once, which leaves nothing behind
    // either: outputs are renamed into place.
    let _ = ctrlc::set_handler(move || {
        if STOP.swap(true, Ordering::Relaxed) {
            end();
        }
        std::thread::spawn(move || {
            std::thread::sleep(patience);
            end();
        });
    });
}

/// Parses the command line, does the work and reports.
pub fn run() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return not_a_command(&error),
    };
    #[cfg(unix)]
    if cli.low_priority {
        // Before any other thread starts: they inherit it. A refusal costs speed alone.
        let _ = rustix::process::setpriority_process(None, LOWEST_PRIORITY);
    }
    let output = match (cli.json_progress, cli.json) {
        (true, _) => Output::JsonLines,
        (false, true) => Output::Json,
        (false, false) => Output::Text,
    };
    // Lives as long as the process, which the handler of interrupts may outlive `main` in.
    let show: &'static Show = Box::leak(Box::new(Show::new(output, cli.command.name())));
    handle_interrupts(show, patience(&cli.command));
    let report = |progress| show.progress(progress);
    let monitor = Monitor {
        report: &report,
        stop: &STOP,
    };
    let ready = start_threads(cli.threads).and_then(|()| check_instructions());
    let result = ready.and_then(|()| match &cli.command {
        Command::Scene(arguments) => bake_scene::bake(arguments, monitor),
        Command::Merge { shards, output } => bake_scene::merge(shards, output, monitor),
        Command::Environment(arguments) => bake_environment(arguments, monitor),
        Command::Material(arguments) => bake_material(arguments, monitor),
        Command::Inspect { file } => inspect::inspect(file),
        Command::Validate { file } => inspect::validate(file),
    });
    ExitCode::from(show.finish(&result))
}

/// Help, the version, or a command line that does not parse.
fn not_a_command(error: &clap::Error) -> ExitCode {
    let json = std::env::args_os().any(|word| word == "--json" || word == "--json-progress");
    if error.use_stderr() {
        let _ = error.print();
        if json {
            // The exit code says it as well.
            let _ = show::print(&show::usage_object(&error.to_string()));
        }
        return ExitCode::from(2);
    }
    match show::print(&error.to_string()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            show::say(&format!("error: standard output: {error}"));
            ExitCode::from(3)
        }
    }
}

/// Starts the workers, no more than help.
fn start_threads(asked: usize) -> anyhow::Result<()> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let most = cores.max(MOST_THREADS);
    if asked > most {
        show::warn(format!(
            "--threads {asked}: {most} are started, more would not help"
        ));
    }
    // 0 stands for one per core, or what RAYON_NUM_THREADS says.
    let threads = if asked > 0 {
        asked.min(most)
    } else {
        rayon_threads().min(most)
    };
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(std::io::Error::other)
        .with_context(|| format!("cannot start {threads} threads"))
}

/// Refuses instructions that this processor has not.
fn check_instructions() -> anyhow::Result<()> {
    simd::chosen().map(|_| ()).map_err(|found| {
        let expected = "plain, or avx2 or avx512 on a processor that has it";
        Usage(Objection::new(simd::VARIABLE, expected, found)).into()
    })
}

/// What `RAYON_NUM_THREADS` asks for; 0 if nothing.
fn rayon_threads() -> usize {
    let text = std::env::var("RAYON_NUM_THREADS").unwrap_or_default();
    text.parse().unwrap_or(0)
}

/// A path as it is told; JSON knows no other text than Unicode.
fn lossy(path: &Path) -> String {
    path.display().to_string()
}

/// The files that a command writes besides those that it reads.
struct Outputs(Vec<PathBuf>);

impl Outputs {
    /// The asset, and what the report's folder will hold, which is made. All are checked.
    fn new(
        asset: &Path,
        report: Option<&Path>,
        names: &[&str],
        inputs: &Files,
    ) -> anyhow::Result<Self> {
        let mut paths = vec![asset.to_owned()];
        if let Some(folder) = report {
            std::fs::create_dir_all(folder).map_err(|source| {
                let expected = "a folder that can be written";
                Error::refused(folder, "--report", expected, source)
            })?;
            paths.extend(names.iter().map(|name| folder.join(name)));
        }
        let outputs = Self(paths);
        outputs.check(inputs)?;
        Ok(outputs)
    }

    /// Again, before they are written: hours may have passed.
    fn check(&self, inputs: &Files) -> Result<(), OutputError> {
        (self.0.iter()).try_for_each(|path| files::check_output_beside(path, inputs))
    }
}

fn bake_environment(arguments: &EnvironmentArguments, monitor: Monitor) -> anyhow::Result<Summary> {
    files::check_output(&arguments.output)?;
    let start = Instant::now();
    monitor.step("reading the image", 0.0)?;
    let files = Files::new(&arguments.input, &arguments.access())?;
    let image = hdr::load_from(&files, &arguments.input, &arguments.reading())?;
    let outputs = Outputs::new(
        &arguments.output,
        arguments.report.as_deref(),
        &REPORT,
        &files,
    )?;
    let (upper, lower) = image.mean_luminance();
    if lower > UPSIDE_DOWN * upper {
        show::warn(format!(
            "{}: the lower half is {:.0} times as bright as the upper one; if the image is upside \
             down, --flip turns it",
            arguments.input.display(),
            lower / upper.max(f64::MIN_POSITIVE),
        ));
    }
    let options = arguments.options();
    let fitted = environment::bake(&arguments.input, &image, &options, monitor)
        .with_context(|| arguments.input.display().to_string())?;
    let of_all = fitted.irradiance_error_of_all();
    let environment::Fitted {
        environment,
        curve,
        source_light,
    } = fitted;
    let irradiance_error = curve.last().map_or(0.0, |last| last.irradiance_error);
    let bytes = format::write_environment(&environment)?;
    outputs.check(&files)?;
    write_checked(&arguments.output, &bytes, |bytes| {
        let read = format::read_environment(bytes, &format::Limits::default());
        read.map(|read| read == environment)
    })?;
    if let Some(folder) = &arguments.report {
        let pictures = environment::report::pictures(&image, &environment)?;
        let contents = [
            Some(pictures.original),
            Some(pictures.fit),
            Some(pictures.difference),
            Some(environment::report::curve_csv(&curve).into()),
            environment::report::curve_svg(&curve).map(String::into_bytes),
        ];
        for (name, bytes) in REPORT.into_iter().zip(contents) {
            if let Some(bytes) = bytes {
                format::write_file(&folder.join(name), &bytes)?;
            }
        }
    }
    let report = &environment.report;
    if report.repaired_pixels > 0 {
        show::warn(format!(
            "{} NaN, infinite or negative pixels repaired",
            report.repaired_pixels
        ));
    }
    let seconds = start.elapsed().as_secs_f64();
    Ok(Summary {
        text: format!(
            "{}: {} sources, {} lobes, {} bytes\n{}\
             of the rest: relative L2 error {:.4}, energy error {:.4?}, irradiance error \
             {irradiance_error:.4}; of all light: irradiance error {of_all:.4}\n{seconds:.1} s\n",
            arguments.output.display(),
            environment.sources.len(),
            environment.lobes.len(),
            bytes.len(),
            sources_text(&environment.sources, &source_light),
            report.relative_l2,
            report.energy_error,
        ),
        json: json!({
            "output": lossy(&arguments.output),
            "bytes": bytes.len(),
            "lobes": environment.lobes.len(),
            "sources": sources_json(&environment.sources, &source_light),
            "relative_l2": report.relative_l2,
            "energy_error": report.energy_error,
            "irradiance_error": irradiance_error,
            "irradiance_error_of_all": of_all,
            "repaired_pixels": report.repaired_pixels,
            "seconds": seconds,
        }),
    })
}

/// A line for every source.
fn sources_text(sources: &[format::Source], light: &[f32]) -> String {
    let line = |(source, light): (&format::Source, &f32)| {
        let ([x, y, z], [height, width]) = (source.direction(), source.extent());
        format!(
            "source at ({x:.3}, {y:.3}, {z:.3}), {width:.4} x {height:.4} rad: {:.1} % of the light\n",
            100.0 * light
        )
    };
    sources.iter().zip(light).map(line).collect()
}

fn sources_json(sources: &[format::Source], light: &[f32]) -> Vec<Value> {
    let object = |(source, light): (&format::Source, &f32)| {
        let [height, width] = source.extent();
        json!({
            "direction": source.direction(),
            "width": width,
            "height": height,
            "texels": [source.columns, source.rows],
            "part_of_light": light,
        })
    };
    sources.iter().zip(light).map(object).collect()
}

/// The lobes of a table, the texture that multiplies them, and their errors.
fn fit_table(
    arguments: &MaterialArguments,
    table: &measured::Table,
    report: &mut format::MaterialReport,
) -> anyhow::Result<(format::Material, Vec<format::Texture>)> {
    let stop =
        (arguments.lobes).map_or(fit::Stop::default(), |lobes| fit::Stop::Lobes(lobes.into()));
    let fitted = fit::corrected(table, stop);
    let (fit, corrected) = (fitted.fit, fitted.relative_l2);
    if let Some(most) = arguments.max_error
        && corrected > f64::from(most)
    {
        let place = "relative L2 error (--max-error)";
        let expected = format!("at most {most}");
        let found = format!("{corrected:.4}");
        return Err(Error::invalid(&arguments.input, place, expected, found).into());
    }
    report.relative_l2 = fit.relative_l2 as f32;
    report.shaded_relative_l2 = fit.shaded_relative_l2 as f32;
    report.albedo_error = fit.albedo_error as f32;
    report.corrected_relative_l2 = corrected as f32;
    if let Some(folder) = &arguments.report {
        let picture = measured::report::sphere(table, &fit)?;
        format::write_file(&folder.join("sphere.png"), &picture)?;
    }
    let slot = format::TextureSlot::whole(0);
    let surface = fit.surface(report.source.clone(), Some(slot));
    Ok((import::plain_material("", surface), vec![fitted.ratio]))
}

fn bake_material(arguments: &MaterialArguments, monitor: Monitor) -> anyhow::Result<Summary> {
    let access = arguments.access()?;
    files::check_output(&arguments.output)?;
    let start = Instant::now();
    monitor.step("fitting lobes", 0.0)?;
    let files = Files::new(&arguments.input, &access)?;
    let name =
        |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    let mut report = format::MaterialReport {
        source: name(arguments.input.file_name()),
        ..format::MaterialReport::default()
    };
    let packed = arguments.packed();
    let outputs = |files: &Files| {
        Outputs::new(
            &arguments.output,
            arguments.report.as_deref(),
            &["sphere.png"],
            files,
        )
    };
    let (mut material, textures) = if packed {
        let read = load::load_material(&files, &arguments.input)?;
        outputs(&files)?;
        read
    } else {
        let bytes = files.read_named(&arguments.input)?;
        outputs(&files)?;
        let table = load::parse_table(&arguments.input, &bytes)?;
        fit_table(arguments, &table, &mut report)?
    };
    material.name = name(arguments.input.file_stem());
    let asset = format::MaterialAsset {
        report,
        material,
        textures,
    };
    let bytes = format::write_material(&asset)?;
    outputs(&files)?.check(&files)?;
    monitor.step("write", 0.0)?;
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
        "output": lossy(&arguments.output),
        "bytes": bytes.len(),
        "material": asset.material,
        "textures": asset.textures.len(),
        "seconds": seconds,
    });
    if let format::Surface::DiffuseSpecular {
        specular: format::Specular::Lobes { lobes, .. },
        ..
    } = &asset.material.surface
        && !packed
    {
        text += &format!(
            "relative L2 error {:.4}; of its {} lobes alone {:.4}, as Gaussians {:.4}, their albedo's {:.4}\n{seconds:.1} s\n",
            report.corrected_relative_l2,
            lobes.len(),
            report.relative_l2,
            report.shaded_relative_l2,
            report.albedo_error,
        );
        object["lobes"] = json!(lobes.len());
        object["corrected_relative_l2"] = json!(report.corrected_relative_l2);
        object["relative_l2"] = json!(report.relative_l2);
        object["shaded_relative_l2"] = json!(report.shaded_relative_l2);
        object["albedo_error"] = json!(report.albedo_error);
    }
    Ok(Summary { text, json: object })
}

/// Writes an asset, reads it back and compares it with what was meant. `same` is told the bytes meanwhile.
pub(crate) fn write_checked(
    path: &Path,
    bytes: &[u8],
    same: impl FnOnce(&[u8]) -> Result<bool, format::Error> + Send,
) -> anyhow::Result<()> {
    let _writing = WRITING
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    files::check_output(path)?;
    let arrives = || {
        format::write_file(path, bytes)?;
        anyhow::Ok(read(path)? == bytes)
    };
    let (arrived, same) = rayon::join(arrives, || same(bytes));
    if !arrived? || !same.map_err(|error| Error::asset(path, error))? {
        let found = "other bytes when it was read back";
        return Err(Error::invalid(path, "output", "what was written", found).into());
    }
    Ok(())
}

/// An asset's bytes.
fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    let access = Access {
        max_bytes: format::Limits::default().max_bytes,
        ..Access::default()
    };
    Ok(Files::new(path, &access)?.read_named(path)?)
}
