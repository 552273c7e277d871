//! What the command line may say.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use relight_lab::truth::lobes;
use relight_lab::{experiments, render};

const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  the input is not what it should be; the message says where and why
  2  the command line is wrong
  3  a file could not be read or written
  4  --device gpu, and no GPU that can do it";

/// Draws baked scenes as the runtime does, computes the same pictures exactly by ray tracing (the
/// "truth"), and measures how far the two are apart.
#[derive(Parser)]
#[command(name = "lab", version, after_help = EXIT_CODES)]
pub(super) struct Cli {
    #[command(subcommand)]
    pub(super) command: Command,
    /// Print the result as one JSON object to standard output.
    #[arg(long, global = true)]
    pub(super) json: bool,
}

#[derive(Subcommand)]
pub(super) enum Command {
    /// Draw a baked scene as the runtime does.
    Render(Render),
    /// Compute a picture of a scene exactly, by ray tracing, with how noisy each pixel is.
    Truth(Truth),
    /// Measure how far a picture is from the truth.
    Compare(Compare),
    /// Draw a scene by every method: the time and work that each takes, and its error against the truth.
    ///
    /// `seconds` are those that shading takes on a GPU that tells, else the whole frame. `turning` and `still` are seconds
    /// of a whole frame on a GPU, among frames that follow one another as an app's do: with the light turned from one
    /// to the next, and with the eye moved alone. `samples`, `fetches`, `at vert.` (fetches at vertices when the light
    /// turns) and `rays` are work per covered pixel.
    Bench(Bench),
    /// Make a small scene and an environment, bake both, draw them, and compare with the truth.
    Demo(Demo),
    /// Run experiments, those of the paper (Wang et al. 2013) and others: tables, plots, pictures and a
    /// report.html of all.
    Experiments(Experiments),
}

#[derive(Args)]
pub(super) struct Experiments {
    /// Which experiment. `all` takes an hour or more, less of it with small pictures and few samples.
    #[arg(value_parser = experiment_names())]
    pub(super) name: String,
    /// Folder for everything that is written. The report also shows what earlier runs left there.
    #[arg(long)]
    pub(super) out: PathBuf,
    /// Folder of meshes, environments and measured BRDFs.
    #[arg(long, default_value = "../shared/data", env = "RELIGHT_DATA")]
    pub(super) data: PathBuf,
    /// Width and height of the pictures.
    #[arg(long, default_value = "400x300", value_parser = parse_size)]
    pub(super) size: [u32; 2],
    /// Samples per pixel of the truth: four times as many halve its noise.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) samples: u32,
    /// The preset of `bake scene` that scenes are baked with.
    #[arg(long, value_enum, default_value = "standard")]
    pub(super) preset: PresetName,
    /// What draws: `auto` is a GPU if there is one, else the processor.
    #[arg(long, value_enum, default_value = "auto")]
    pub(super) device: DeviceName,
    /// Markdown file in which what is between `<!-- experiments -->` and `<!-- /experiments -->` is
    /// replaced by the tables of all experiments in the folder.
    #[arg(long)]
    pub(super) results: Option<PathBuf>,
    /// With `compression`: scene files with a camera, in place of those that come with lab.
    #[arg(long, num_args = 1..)]
    pub(super) scenes: Vec<PathBuf>,
    /// With `compression`: a baked environment, in place of the image `grace` with 16 lobes.
    #[arg(long)]
    pub(super) environment: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
pub(super) enum PresetName {
    Draft,
    Standard,
    High,
}

fn experiment_names() -> clap::builder::PossibleValuesParser {
    let own = experiments::ALL.iter().map(|experiment| {
        clap::builder::PossibleValue::new(experiment.name).help(experiment.title)
    });
    let all = clap::builder::PossibleValue::new("all").help("All of them");
    own.chain([all]).collect::<Vec<_>>().into()
}

#[derive(Args)]
pub(super) struct Bench {
    /// The scene, a .relight file of `bake scene`.
    pub(super) scene: PathBuf,
    /// The light, a .relight file of `bake environment`.
    #[arg(long)]
    pub(super) environment: PathBuf,
    /// Width and height of the pictures.
    #[arg(long, default_value = "400x300", value_parser = parse_size)]
    pub(super) size: [u32; 2],
    /// Samples per pixel of the truth: four times as many halve its noise.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) samples: u32,
    /// How many frames each method draws; the fastest counts.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) repetitions: u32,
    #[command(flatten)]
    pub(super) camera: CameraArguments,
    /// What draws: `auto` is a GPU if there is one, else the processor.
    #[arg(long, value_enum, default_value = "auto")]
    pub(super) device: DeviceName,
}

#[derive(Args)]
pub(super) struct Demo {
    /// Folder for baked files and pictures.
    #[arg(long, default_value = "out/demo")]
    pub(super) out: PathBuf,
    /// Width and height of each of the three pictures.
    #[arg(long, default_value = "480x360", value_parser = parse_size)]
    pub(super) size: [u32; 2],
    /// Samples per pixel of the truth: four times as many halve its noise.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) samples: u32,
    /// What draws: `auto` is a GPU if there is one, else the processor.
    #[arg(long, value_enum, default_value = "auto")]
    pub(super) device: DeviceName,
}

#[derive(Args)]
pub(super) struct Render {
    /// The scene, a .relight file of `bake scene`.
    pub(super) scene: PathBuf,
    /// The light, a .relight file of `bake environment`.
    #[arg(long)]
    pub(super) environment: PathBuf,
    #[command(flatten)]
    pub(super) picture: Picture,
    /// How the light that reaches a surface past what blocks it is added up.
    #[arg(long, value_enum, default_value = "polar")]
    pub(super) method: MethodName,
    /// Smooth silhouettes and edges: every pixel looks for surfaces at four points, and shades each surface
    /// that it finds once. Compare such pictures with `truth --filter box`.
    #[arg(long)]
    pub(super) antialias: bool,
    /// What surfaces reflect of the environment: its lobes alone, or also the finer detail that its image
    /// has beyond them.
    #[arg(long, value_enum, default_value = "auto")]
    pub(super) reflections: ReflectionsName,
    /// With the method polar: how finely lobes are looked at; a number of spokes.
    #[arg(long, value_enum, default_value = "standard")]
    pub(super) quality: QualityName,
    /// With the method polar: spokes per lobe, 1 to 64, in place of those of --quality.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub(super) spokes: Option<u32>,
    /// With the method cells: how far a shadow's edge may be off, radians.
    #[arg(long, value_name = "RADIANS", value_parser = parse_at_least_zero, allow_hyphen_values = true)]
    pub(super) boundary_error: Option<f32>,
    /// With the method cells: how wrong the lobes in a cell may be, as a part of all their light.
    #[arg(long, value_name = "PART", value_parser = parse_at_least_zero, allow_hyphen_values = true)]
    pub(super) lobe_error: Option<f32>,
    /// With the method cells: so many even cells instead, ROWSxCOLUMNS of polar angle and azimuth.
    #[arg(long, value_parser = parse_size, value_name = "ROWSxCOLUMNS")]
    pub(super) partition: Option<[u32; 2]>,
    /// What draws: `auto` is a GPU if there is one, else the processor.
    #[arg(long, value_enum, default_value = "auto")]
    pub(super) device: DeviceName,
}

#[derive(Args)]
pub(super) struct Truth {
    /// For the kind `lobes` a .relight file of `bake scene`; for `full` a scene file or a mesh.
    pub(super) scene: PathBuf,
    /// What to compute. `lobes`: what the runtime draws, but with exact shadows. `full`: the original
    /// image of the environment and the exact reflection models, without anything baked.
    #[arg(long, value_enum)]
    pub(super) kind: Kind,
    /// With `lobes`: shadows by rays against the mesh, or those of the baked file, so that only the errors
    /// of adding up light are left.
    #[arg(long, value_enum, default_value = "exact")]
    pub(super) visibility: VisibilityName,
    /// With `lobes` a .relight file of `bake environment`; with `full` a lat-long .hdr or .exr, by default
    /// that of the scene file.
    #[arg(long)]
    pub(super) environment: Option<PathBuf>,
    /// With `full`: folder that must hold every file that the scene file names, as in `bake scene`
    /// [default: the scene file's own folder].
    #[arg(long, value_name = "DIR")]
    pub(super) root: Option<PathBuf>,
    #[command(flatten)]
    pub(super) picture: Picture,
    /// Samples per pixel; rounded up to a multiple of 8.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) samples: u32,
    /// Where samples lie in a pixel: at its centre, as the runtime shades it, or all over its square.
    #[arg(long, value_enum, default_value = "center")]
    pub(super) filter: FilterName,
    /// Another number gives another draw of the same noise.
    #[arg(long, default_value_t = 0)]
    pub(super) seed: u32,
    /// How often light may bounce off other surfaces before it reaches the one that is seen, 0 to 256; 0 is
    /// direct light only: that of the surroundings, of lights, and with `--kind full` of surfaces that emit, which
    /// are bounced light to the runtime. From the fifth bounce on paths also end by chance, without bias, so that 64
    /// stands for all [default: 64 for a baked file with bounced light, else 0].
    #[arg(long, value_parser = clap::value_parser!(u32).range(0..=256))]
    pub(super) bounces: Option<u32>,
}

#[derive(Args)]
pub(super) struct Compare {
    /// The picture to measure, .exr.
    pub(super) candidate: PathBuf,
    /// The truth, .exr.
    pub(super) truth: PathBuf,
}

/// What render and truth share.
#[derive(Args)]
pub(super) struct Picture {
    #[command(flatten)]
    pub(super) camera: CameraArguments,
    /// Width and height in pixels.
    #[arg(long, default_value = "800x600", value_parser = parse_size)]
    pub(super) size: [u32; 2],
    /// Turn the environment by so many degrees about +Y, counter-clockwise seen from above.
    #[arg(long, default_value_t = 0.0, value_parser = parse_finite, allow_hyphen_values = true)]
    pub(super) rotate: f32,
    /// Add the `lights` of this scene file, up to 128. `truth --kind full` has those of its own scene file
    /// without this.
    #[arg(long, value_name = "SCENE.toml")]
    pub(super) lights: Option<PathBuf>,
    /// Make a PNG brighter by so many stops, or darker if negative. An EXR stays as it is.
    #[arg(long, default_value_t = 0.0, value_parser = parse_finite, allow_hyphen_values = true)]
    pub(super) exposure: f32,
    /// The picture to write: .exr with linear radiance and coverage, or .png to look at.
    #[arg(short, long)]
    pub(super) output: PathBuf,
}

/// By default the scene's camera or, where it has none, one that shows all of it.
#[derive(Args)]
pub(super) struct CameraArguments {
    /// Camera file: TOML with position, target, up and fov_x_degrees or fov_y_degrees.
    #[arg(long)]
    pub(super) camera: Option<PathBuf>,
    /// Replaces the camera's position, as X,Y,Z.
    #[arg(long, value_parser = parse_point, allow_hyphen_values = true)]
    pub(super) position: Option<Point>,
    /// Replaces the point that it looks at.
    #[arg(long, value_parser = parse_point, allow_hyphen_values = true)]
    pub(super) target: Option<Point>,
    /// Replaces the up direction.
    #[arg(long, value_parser = parse_point, allow_hyphen_values = true)]
    pub(super) up: Option<Point>,
    /// Replaces the field of view: full vertical angle in degrees.
    #[arg(long, conflicts_with = "fov_x", value_parser = parse_angle, allow_hyphen_values = true)]
    pub(super) fov_y: Option<f32>,
    /// Replaces the field of view: full horizontal angle in degrees.
    #[arg(long, value_parser = parse_angle, allow_hyphen_values = true)]
    pub(super) fov_x: Option<f32>,
}

/// Three numbers, as one value on the command line.
#[derive(Clone, Copy)]
pub(super) struct Point(pub(super) [f32; 3]);

#[derive(Clone, Copy, ValueEnum)]
pub(super) enum MethodName {
    /// Along spokes about the middle of every lobe
    Polar,
    /// As if everything beyond one straight edge per lobe were blocked (Wang et al. 2009): fast and rough
    Ambient,
    /// In cells with straight edges, divided where needed (Wang et al. 2013)
    Cells,
}

#[derive(Clone, Copy, ValueEnum)]
pub(super) enum QualityName {
    Draft,
    Standard,
    High,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ReflectionsName {
    /// The image where the environment has one
    Auto,
    Lobes,
    Prefiltered,
}

#[derive(Clone, Copy, ValueEnum)]
pub(super) enum DeviceName {
    Auto,
    Gpu,
    Cpu,
}

impl From<DeviceName> for render::Device {
    fn from(name: DeviceName) -> Self {
        match name {
            DeviceName::Auto => Self::Auto,
            DeviceName::Gpu => Self::Gpu,
            DeviceName::Cpu => Self::Cpu,
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Kind {
    Lobes,
    Full,
}

#[derive(Clone, Copy, ValueEnum)]
pub(super) enum VisibilityName {
    Exact,
    Baked,
}

impl From<VisibilityName> for lobes::Visibility {
    fn from(name: VisibilityName) -> Self {
        match name {
            VisibilityName::Exact => Self::Exact,
            VisibilityName::Baked => Self::Baked,
        }
    }
}

#[derive(Clone, Copy, ValueEnum)]
pub(super) enum FilterName {
    Center,
    Box,
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let sides = text
        .split_once('x')
        .and_then(|(width, height)| Some([width.parse().ok()?, height.parse().ok()?]));
    sides
        .filter(|sides: &[u32; 2]| sides.iter().all(|side| (1..=16384).contains(side)))
        .ok_or_else(|| "expected WIDTHxHEIGHT, each from 1 to 16384".into())
}

fn parse_number(text: &str, expected: &str, valid: fn(f32) -> bool) -> Result<f32, String> {
    let number = text.parse().ok().filter(|number| valid(*number));
    number.ok_or_else(|| format!("expected {expected}"))
}

fn parse_finite(text: &str) -> Result<f32, String> {
    parse_number(text, "a finite number", f32::is_finite)
}

fn parse_at_least_zero(text: &str) -> Result<f32, String> {
    parse_number(text, "a number of at least 0", |number| {
        number >= 0.0 && number.is_finite()
    })
}

fn parse_angle(text: &str) -> Result<f32, String> {
    parse_number(text, "degrees above 0 and below 180", |degrees| {
        degrees > 0.0 && degrees < 180.0
    })
}

fn parse_point(text: &str) -> Result<Point, String> {
    let numbers: Vec<f32> = text
        .split(',')
        .filter_map(|part| part.trim().parse().ok())
        .collect();
    <[f32; 3]>::try_from(numbers)
        .ok()
        .filter(|numbers| numbers.iter().all(|number| number.is_finite()))
        .map(Point)
        .ok_or_else(|| "expected three numbers X,Y,Z".into())
}
