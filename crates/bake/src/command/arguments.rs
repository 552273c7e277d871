//! What the command line may say.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use relight_bake::environment::{self, hdr};
use relight_bake::error::Objection;
use relight_bake::files::Access;
use relight_bake::{import, scene};
use relight_format as format;

/// Heading of what every command takes.
const GLOBAL: &str = "Every command";

const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    the input is not what it should be; the message says where and why
  2    the command line is wrong
  3    a file could not be read or written
  130  interrupted; no output is half-written, and --resume continues a scene bake

Files that the input names (meshes, textures, tables) must be in the input's own folder or below it;
--root names a wider folder. An output may replace a file, but never an input, a folder or a link.
The fields of --json are described in bake.schema.json, beside the sources of this command.";

/// Turns meshes, HDR images of surroundings and measured materials into .relight files, which the
/// relight runtime draws under light that moves and changes.
#[derive(Parser)]
#[command(name = "bake", version, after_help = EXIT_CODES)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
    /// Print one JSON object to standard output in place of text, for errors as well.
    #[arg(long, global = true, help_heading = GLOBAL)]
    pub json: bool,
    /// Like --json, with a JSON object on a line of its own for every step of progress before it.
    #[arg(long, global = true, help_heading = GLOBAL)]
    pub json_progress: bool,
    /// How many threads work: 0 to 64, or to the number of cores if that is larger. 0 stands for one
    /// per core. The output is the same with any number.
    #[arg(long, global = true, default_value_t = 0, value_name = "N", help_heading = GLOBAL)]
    pub threads: usize,
    /// Let everything else on the machine run first.
    #[cfg(unix)]
    #[arg(long, global = true, help_heading = GLOBAL)]
    pub low_priority: bool,
}

#[derive(Subcommand)]
pub enum Command {
    /// Bake a mesh (.gltf, .glb, .obj), or a scene file (.toml) that names one and adds to it.
    ///
    /// Finds out from every vertex which directions are open and which are blocked by other parts of
    /// the mesh, and how light bounces between surfaces, and stores that with the mesh, its materials
    /// and textures. The runtime then draws shadows and bounced light under any environment. SCENE.md
    /// describes scene files.
    Scene(SceneArguments),
    /// Join the parts that `bake scene --shard` wrote on several machines.
    ///
    /// The result has the bytes that a bake on one machine would have written. FARM.md shows how.
    Merge {
        /// The parts, each of them once, in any order.
        #[arg(required = true)]
        shards: Vec<PathBuf>,
        /// The file to write.
        #[arg(short, long, value_name = "OUT.relight")]
        output: PathBuf,
    },
    /// Prepare an HDR image (.hdr, .exr) of the surroundings for lighting scenes.
    ///
    /// The image is a panorama in the usual lat-long layout, twice as wide as high. Small bright spots,
    /// such as the sun or a lamp, become light sources with sharp shadows; the rest is approximated by
    /// smooth blobs of light ("lobes", which are spherical Gaussians).
    Environment(EnvironmentArguments),
    /// Prepare a material that scene files can use: a measured BRDF (.bsdf, .binary), or one described
    /// in a text file (.toml) with its textures.
    ///
    /// Measured BRDFs are those of the RGL (.bsdf) and MERL (.binary) databases. They are approximated
    /// by a few simple reflections ("lobes") and a small table of what these miss. A text file describes
    /// a material with the keys that it has below `[materials]` in a scene file.
    Material(MaterialArguments),
    /// Print what a .relight file contains.
    Inspect {
        /// The file.
        file: PathBuf,
    },
    /// Check that a .relight file is complete and undamaged.
    Validate {
        /// The file.
        file: PathBuf,
    },
}

impl Command {
    /// As on the command line.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Scene(_) => "scene",
            Self::Merge { .. } => "merge",
            Self::Environment(_) => "environment",
            Self::Material(_) => "material",
            Self::Inspect { .. } => "inspect",
            Self::Validate { .. } => "validate",
        }
    }
}

/// The command line is wrong in a way that its syntax does not tell. The place is the option.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct Usage(pub Objection);

/// Refuses options that would have no effect.
fn refuse(options: &[(&'static str, bool)], expected: &str) -> Result<(), Usage> {
    match options.iter().find(|(_, given)| *given) {
        None => Ok(()),
        Some((place, _)) => Err(Usage(Objection::new(place, expected, "it, without effect"))),
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum Preset {
    /// For a first look within seconds: of a fine mesh, only some vertices are sampled. Rooms are sampled more finely
    /// while they are small, unless settings below say how.
    Draft,
    /// For most uses.
    Standard,
    /// For small errors, at several times the size and time.
    High,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum RepresentationArgument {
    /// Each group of neighbouring vertices by itself.
    Clustered,
    /// The whole scene at once, as in the paper of Wang et al. 2013.
    Global,
}

/// Bounds on what the input may refer to and take.
#[derive(Args)]
#[command(next_help_heading = "What may be read")]
pub struct AccessArguments {
    /// Folder that must hold every file that the input names: meshes, buffers, textures, tables. Links
    /// are followed if they stay inside it [default: the input's own folder].
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Most bytes of all input files together, at least 1 [default: 2147483648].
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u64).range(1..))]
    limit_bytes: Option<u64>,
    /// Most texels of all textures together, at least 1. Each takes 4 bytes of memory, and up to 8 more
    /// while it is decoded [default: 134217728].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    limit_texels: Option<u64>,
}

impl AccessArguments {
    pub fn access(&self) -> Access {
        let default = Access::default();
        Access {
            root: self.root.clone(),
            max_bytes: self.limit_bytes.unwrap_or(default.max_bytes),
            max_texels: self.limit_texels.unwrap_or(default.max_texels),
            ..default
        }
    }
}

#[derive(Args)]
pub struct SceneArguments {
    /// The mesh or scene file.
    pub input: PathBuf,
    /// The file to write; with --shard, the part.
    #[arg(short, long, value_name = "OUT.relight")]
    pub output: PathBuf,
    /// Continue a bake that was interrupted, from the OUT.relight.parts that it left behind. Without such a
    /// file the bake starts from the beginning.
    #[arg(long)]
    pub resume: bool,
    /// Bake only part I of N, with I from 1 to N, so that N machines can share the work; `bake merge` joins
    /// the parts.
    #[arg(long, value_name = "I/N", value_parser = shard)]
    pub shard: Option<Shard>,
    /// For OBJ files that have neither normals nor smoothing groups: neighbouring faces whose directions
    /// differ by more than this angle meet at a hard edge, others are shaded smoothly; from 0 (all flat)
    /// to 180 (all smooth). An angle in the scene file takes precedence [default: 80].
    #[arg(long, value_name = "DEGREES", value_parser = crease)]
    pub crease: Option<f32>,
    /// Check the result against a ray in every direction at every vertex, which is slow; any
    /// difference is an error.
    #[arg(long)]
    pub verify_visibility: bool,
    /// Trade speed and size against accuracy; the options below change single settings of it.
    #[arg(long, value_enum, default_value_t = Preset::Standard)]
    preset: Preset,
    /// How the open directions of vertices are compressed [default: clustered].
    #[arg(long, value_enum, hide = !scene::PAPER)]
    representation: Option<RepresentationArgument>,
    /// With --representation global: how many principal components are kept besides the mean, 0 to 31
    /// [default: 24].
    #[arg(long, value_name = "K", hide = !scene::PAPER,
          value_parser = clap::value_parser!(u32).range(0..=31))]
    rank: Option<u32>,
    /// How far edges of shadows may be off, as the root mean square over the surface of an angle in
    /// radians, above 0. Compression adds to this error, which more bytes lower, and so does
    /// interpolation between vertices, which --max-edge and --refine-error lower [default: none; each
    /// preset balances errors and bytes].
    #[arg(long, value_name = "RADIANS", value_parser = positive, allow_negative_numbers = true)]
    max_error: Option<f32>,
    /// How large the file may be, textures included, at least 1. The bake finds the smallest error
    /// that fits.
    #[arg(long, value_name = "BYTES", conflicts_with_all = ["max_error", "shard"],
          value_parser = clap::value_parser!(u64).range(1..))]
    max_bytes: Option<u64>,
    /// How many images the shadows of a group of neighbouring vertices are mixed from, at most, in fours:
    /// 1 to 8 stand for 4 to 32 images. More images follow shadows more closely and take more bytes
    /// [default: 2 for draft, 4 for standard, 6 for high].
    #[arg(long, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=i64::from(format::MAX_TILES_PER_CLUSTER)))]
    max_tiles: Option<u32>,
    /// Divide edges of triangles that are longer than this, as a fraction of the scene's diagonal without
    /// its ground, above 0. Shadows are stored at vertices, so a finer mesh has finer shadows. Beside what
    /// is less than a twentieth as large as the scene, as a figure on a field, it is a fraction of that. A bound
    /// in the scene file takes precedence. A draft of few vertices divides edges down to a quarter of it
    /// [default: 0.08 for draft, 0.02 for standard, 0.06 for high].
    #[arg(long, value_name = "FRACTION", value_parser = positive, allow_negative_numbers = true)]
    pub max_edge: Option<f32>,
    /// Also divide edges of triangles along which a shadow would be off by more than this angle, in
    /// radians, above 0. The bound is for edges of 0.02 of the scene's diagonal without its ground;
    /// for edges of half that length it is twice as large. A bound in the scene file takes precedence
    /// [default: off; 0.01 for high].
    #[arg(long, value_name = "RADIANS", value_parser = positive, allow_negative_numbers = true)]
    pub refine_error: Option<f32>,
    /// Stop dividing edges before the mesh has more vertices than this, at least 1 [default: 1000000].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub max_vertices: Option<usize>,
    /// How often light bounces between surfaces: a number from 0 (not at all) to 64, or auto, which stops
    /// when all further bounces would add less than 0.5 % to what a place has. Bounced light follows the light as it changes, but
    /// keeps the colours that materials had in the bake.
    #[arg(long, value_name = "N|auto", default_value = "auto", value_parser = bounces)]
    bounces: Bounces,
    /// In how many directions a vertex looks for what blocks light: this number squared. 8 to 256, a
    /// multiple of --basis-resolution [default: 32 for draft, else 128].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=256))]
    sample_resolution: Option<u32>,
    /// Width and height of the images that shadows are mixed from, 8 to 256 texels [default: 32 for draft,
    /// else 64].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=256))]
    basis_resolution: Option<u32>,
    #[command(flatten)]
    access: AccessArguments,
    /// Most vertices, and most triangles, that the mesh may have in its file, 1 to 33554432. A bake takes
    /// about 500 bytes of memory for each [default: 8388608].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    limit_vertices: Option<usize>,
}

impl SceneArguments {
    /// What the mesh does not say itself.
    pub fn import_options(&self) -> import::Options {
        import::Options {
            crease_degrees: self.crease,
            cut_triangles: match self.preset {
                Preset::Draft => Some(1 << 16),
                Preset::Standard => Some(1 << 17),
                Preset::High => None,
            },
            ..import::Options::default()
        }
    }

    /// What may be read.
    pub fn access(&self) -> Access {
        let access = self.access.access();
        Access {
            max_vertices: self.limit_vertices.unwrap_or(access.max_vertices),
            ..access
        }
    }

    /// What the bake is to do.
    pub fn options(&self) -> Result<scene::Options, Usage> {
        let clustered = [
            ("--max-error", self.max_error.is_some()),
            ("--max-bytes", self.max_bytes.is_some()),
            ("--max-tiles", self.max_tiles.is_some()),
        ];
        let rank = [("--rank", self.rank.is_some())];
        let global = self.representation == Some(RepresentationArgument::Global);
        for (place, given, what) in [
            ("--representation", global, " for global"),
            ("--rank", self.rank.is_some(), ""),
        ] {
            if given && !scene::PAPER {
                let expected = format!("a build with the feature `paper`{what}");
                return Err(Usage(Objection::new(place, expected, "one without")));
            }
        }
        if global {
            refuse(&clustered, "--representation clustered with it")?;
        } else {
            refuse(&rank, "--representation global with it")?;
        }
        let mut options = match self.preset {
            Preset::Draft => scene::Options::draft(),
            Preset::Standard => scene::Options::standard(),
            Preset::High => scene::Options::high(),
        };
        let representation = self.representation.map(|value| match value {
            RepresentationArgument::Clustered => format::Representation::ClusteredPca,
            RepresentationArgument::Global => format::Representation::GlobalPca,
        });
        replace(&mut options.representation, representation);
        replace(&mut options.global_rank, self.rank);
        options.max_error = self.max_error;
        options.max_bytes = self.max_bytes;
        replace(&mut options.max_tiles, self.max_tiles);
        replace(&mut options.max_edge, self.max_edge);
        replace(&mut options.refine_error, self.refine_error);
        replace(&mut options.max_vertices, self.max_vertices);
        replace(&mut options.sample_resolution, self.sample_resolution);
        replace(&mut options.basis_resolution, self.basis_resolution);
        // What is given holds for all scenes.
        options.finer_rooms &= self.max_tiles.is_none()
            && self.max_edge.is_none()
            && self.sample_resolution.is_none()
            && self.basis_resolution.is_none();
        options.transfer.bounces = self.bounces.0;
        let (sample, basis) = (options.sample_resolution, options.basis_resolution);
        if basis > sample || !sample.is_multiple_of(basis) {
            let expected = format!("a multiple of the basis resolution, {basis}");
            return Err(Usage(Objection::new(
                "--sample-resolution",
                expected,
                sample,
            )));
        }
        Ok(options)
    }
}

/// Puts what was given in place of a default.
fn replace<T: Copy>(option: &mut T, given: Option<T>) {
    *option = given.unwrap_or(*option);
}

fn positive(text: &str) -> Result<f32, String> {
    text.parse()
        .ok()
        .filter(|value: &f32| *value > 0.0 && value.is_finite())
        .ok_or_else(|| "expected a number above 0".to_owned())
}

fn crease(text: &str) -> Result<f32, String> {
    text.parse()
        .ok()
        .filter(|degrees| (0.0..=180.0).contains(degrees))
        .ok_or_else(|| "expected a number from 0 to 180".to_owned())
}

fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse()
        .ok()
        .filter(|value| *value >= 1)
        .ok_or_else(|| "expected a whole number of at least 1".to_owned())
}

fn lobes(text: &str) -> Result<usize, String> {
    text.parse()
        .ok()
        .filter(|value| (1..=environment::MAX_LOBES).contains(value))
        .ok_or_else(|| format!("expected a number from 1 to {}", environment::MAX_LOBES))
}

/// One of several parts of a scene.
#[derive(Clone, Copy)]
pub struct Shard {
    /// From 1.
    pub number: u32,
    pub count: u32,
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
pub struct EnvironmentArguments {
    /// The image: twice as wide as high, its first row straight up, its first column towards -Z.
    pub input: PathBuf,
    /// The file to write.
    #[arg(short, long, value_name = "OUT.relight")]
    pub output: PathBuf,
    /// How many lobes approximate the image, 1 to 1024; with --max-error, at most so many. More lobes
    /// follow the image more closely and take longer to draw [default: as few as leave .35 % of irradiance
    /// wrong, 8 to 64; with --max-error at most 256].
    #[arg(long, value_name = "N", value_parser = lobes)]
    lobes: Option<usize>,
    /// Add lobes until the relative L2 error is at most this, above 0 (0.1 is 10 %). If that takes more
    /// lobes than are allowed, nothing is written.
    #[arg(long, value_name = "E", value_parser = positive, allow_negative_numbers = true)]
    max_error: Option<f32>,
    /// How many suns, lamps and windows may become light sources of their own, with sharp shadows, 0 to 8.
    /// 0 leaves all light to the lobes.
    #[arg(long, value_name = "N", default_value_t = environment::MAX_SOURCES as u8,
          value_parser = clap::value_parser!(u8).range(..=environment::MAX_SOURCES as i64))]
    sources: u8,
    /// Also write pictures of the image, of what approximates it and of their difference (PNG), and the
    /// error by the number of lobes (CSV, SVG), into this folder.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// Turn the image over: its first row is straight down.
    #[arg(long)]
    flip: bool,
    /// Exchange left and right: the image shows the surroundings as seen from outside.
    #[arg(long)]
    mirror: bool,
    /// Accept an image that is not twice as wide as high, and take it as lat-long.
    #[arg(long)]
    any_shape: bool,
    /// Most bytes of the file, at least 1 [default: 2147483648].
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u64).range(1..))]
    limit_bytes: Option<u64>,
    /// Most pixels of the image, 1 to 536870912. Each takes about 25 bytes of memory [default: 33554432,
    /// as of 8192x4096].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=hdr::MAX_PIXELS))]
    limit_pixels: Option<u64>,
}

impl EnvironmentArguments {
    /// What may be read.
    pub fn access(&self) -> Access {
        let default = Access::default();
        Access {
            max_bytes: self.limit_bytes.unwrap_or(default.max_bytes),
            ..default
        }
    }

    /// How the image is to be read.
    pub fn reading(&self) -> hdr::Reading {
        hdr::Reading {
            max_pixels: (self.limit_pixels).unwrap_or(hdr::Reading::default().max_pixels),
            any_shape: self.any_shape,
            flip: self.flip,
            mirror: self.mirror,
        }
    }

    /// How it is to be fitted.
    pub fn options(&self) -> environment::FitOptions {
        let as_asked = match (self.lobes, self.max_error) {
            (None, None) => environment::FitOptions::default(),
            (lobes, _) => environment::FitOptions::with_lobes(lobes.unwrap_or(256)),
        };
        environment::FitOptions {
            max_error: self.max_error,
            sources: usize::from(self.sources),
            ..as_asked
        }
    }
}

#[derive(Args)]
pub struct MaterialArguments {
    /// The measured BRDF (.bsdf, .binary) or the text file (.toml).
    pub input: PathBuf,
    /// The file to write.
    #[arg(short, long, value_name = "OUT.relight")]
    pub output: PathBuf,
    /// Measured BRDFs: how many lobes give reflections their shape, 1 to 7 [default: until another one
    /// would take less than a twentieth off the error].
    #[arg(long, value_name = "N",
          value_parser = clap::value_parser!(u8).range(1..=format::MAX_FITTED_LOBES as i64))]
    pub lobes: Option<u8>,
    /// Measured BRDFs: write nothing unless the relative L2 error is at most this, above 0 (0.1 is
    /// 10 %).
    #[arg(long, value_name = "ERROR", value_parser = positive, allow_negative_numbers = true)]
    pub max_error: Option<f32>,
    /// Measured BRDFs: also write sphere.png into this folder: a lit sphere as measured, one as the lobes
    /// have it, and their difference, doubled.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    #[command(flatten)]
    access: AccessArguments,
}

impl MaterialArguments {
    /// Whether the input is a material file, not a table.
    pub fn packed(&self) -> bool {
        (self.input.extension()).is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
    }

    /// What may be read.
    pub fn access(&self) -> Result<Access, Usage> {
        if self.packed() {
            let tables = [
                ("--lobes", self.lobes.is_some()),
                ("--max-error", self.max_error.is_some()),
                ("--report", self.report.is_some()),
            ];
            refuse(&tables, "a table (.bsdf, .binary) with it")?;
        } else {
            let files = [
                ("--root", self.access.root.is_some()),
                ("--limit-texels", self.access.limit_texels.is_some()),
            ];
            refuse(&files, "a material file (.toml) with it")?;
        }
        Ok(self.access.access())
    }
}

/// What `--bounces` takes at most.
const MOST_BOUNCES: u32 = 64;

/// How many bounces to follow, if a number is given.
#[derive(Clone, Copy)]
struct Bounces(Option<u32>);

fn bounces(text: &str) -> Result<Bounces, String> {
    match text.parse() {
        Ok(count) if count <= MOST_BOUNCES => Ok(Bounces(Some(count))),
        Err(_) if text == "auto" => Ok(Bounces(None)),
        _ => Err(format!(
            "expected auto or a number from 0 to {MOST_BOUNCES}"
        )),
    }
}
