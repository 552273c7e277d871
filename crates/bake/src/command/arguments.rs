//! What the command line may say.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use relight_bake::environment::{self, hdr};
use relight_bake::error::Objection;
use relight_bake::files::Access;
use relight_bake::scene;
use relight_format as format;

const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    the input is not what it should be; the message says where and why
  2    the command line is wrong
  3    a file could not be read or written
  130  interrupted; no output is half-written, and --resume continues a scene bake

Only regular files are read. What an input refers to is read only below the input's own folder,
or below --root. Outputs replace regular files or nothing, and never an input.
--json is described by bake.schema.json beside the sources of this command.";

/// Bakes meshes and HDR environments into .relight assets.
#[derive(Parser)]
#[command(name = "bake", version, after_help = EXIT_CODES)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
    /// Print one JSON object to standard output instead of text, for errors as well.
    #[arg(long, global = true)]
    pub json: bool,
    /// As --json, and before it one JSON object per line for progress.
    #[arg(long, global = true)]
    pub json_progress: bool,
    /// Worker threads, from 0 to 64, or to the number of cores where there are more; 0 means one per
    /// core.
    #[arg(long, global = true, default_value_t = 0, value_name = "N")]
    pub threads: usize,
    /// Give way to everything else that runs on the machine.
    #[cfg(unix)]
    #[arg(long, global = true)]
    pub low_priority: bool,
}

#[derive(Subcommand)]
pub enum Command {
    /// Bake a scene file (.toml) or a mesh (.gltf, .glb, .obj).
    Scene(SceneArguments),
    /// Join the shards of a scene into the asset that a single bake would write.
    Merge {
        /// The files that `bake scene --shard` wrote, each shard once.
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
    /// Print what an asset contains.
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
    /// To look at a scene within seconds: fine meshes are sampled at a part of their vertices.
    Draft,
    Standard,
    /// Small errors at several times the size and time.
    High,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum RepresentationArgument {
    /// Principal components per cluster of vertices.
    Clustered,
    /// Principal components of the whole scene, as in the paper.
    Global,
}

/// Bounds on what the input may refer to and take.
#[derive(Args)]
#[command(next_help_heading = "What may be read")]
pub struct AccessArguments {
    /// Folder that holds whatever the input refers to: meshes, buffers, textures, tables. Links
    /// are followed if they stay inside [default: the input's own folder].
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Bytes of all input files together, at least 1 [default: 2147483648].
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u64).range(1..))]
    limit_bytes: Option<u64>,
    /// Texels of all textures together, at least 1; each takes 4 bytes, and up to 8 more while it
    /// is decoded [default: 134217728].
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
    /// Scene file or mesh.
    pub input: PathBuf,
    /// Asset to write; with --shard, the part to write.
    #[arg(short, long, value_name = "OUT.relight")]
    pub output: PathBuf,
    /// Continue from OUT.relight.parts, which an interrupted bake leaves behind; start from the
    /// beginning if there is none.
    #[arg(long)]
    pub resume: bool,
    /// Bake the I-th of N parts, I from 1; `bake merge` joins them.
    #[arg(long, value_name = "I/N", value_parser = shard)]
    pub shard: Option<Shard>,
    /// OBJ files without normals and smoothing groups: faces that bend by more than this meet at a
    /// hard edge, from 0 (all flat) to 180 (all smooth); a scene file's own angle wins
    /// [default: 80].
    #[arg(long, value_name = "DEGREES", value_parser = crease)]
    pub crease: Option<f32>,
    /// Also cast one ray per texel at every vertex; any difference is an error.
    #[arg(long)]
    pub verify_visibility: bool,
    /// Starting point for the options below.
    #[arg(long, value_enum, default_value_t = Preset::Standard)]
    preset: Preset,
    /// How visibility is represented [default: clustered].
    #[arg(long, value_enum, hide = !scene::PAPER)]
    representation: Option<RepresentationArgument>,
    /// Global representation: components besides the mean, 0 to 31 [default: 24].
    #[arg(long, value_name = "K", hide = !scene::PAPER,
          value_parser = clap::value_parser!(u32).range(0..=31))]
    rank: Option<u32>,
    /// Target RMS displacement of shadow boundaries, radians, more than
    /// 0. It includes the error of compression, which more bytes lower, and that of interpolation
    /// between vertices, which --max-edge and --refine-error lower [default: none; each preset
    /// weighs errors against bytes].
    #[arg(long, value_name = "RADIANS", value_parser = positive, allow_negative_numbers = true)]
    max_error: Option<f32>,
    /// Largest size of the asset, textures included, at least 1; the
    /// bake looks for the smallest error that fits.
    #[arg(long, value_name = "BYTES", conflicts_with_all = ["max_error", "shard"],
          value_parser = clap::value_parser!(u64).range(1..))]
    max_bytes: Option<u64>,
    /// How many images the visibility of neighbouring vertices is mixed from, at most: four times this
    /// number, which is 1 to 8. More images follow shadows more closely and take more bytes
    /// [default: 2 for draft, 4 for standard, 6 for high].
    #[arg(long, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=i64::from(format::MAX_TILES_PER_CLUSTER)))]
    max_tiles: Option<u32>,
    /// Longest edge after refinement, as a fraction of the diagonal of the scene without
    /// its ground, more than 0; a scene file's own bound wins [default: 0.08 for draft, 0.02 for
    /// standard, 0.06 for high].
    #[arg(long, value_name = "FRACTION", value_parser = positive, allow_negative_numbers = true)]
    pub max_edge: Option<f32>,
    /// Also divide edges where interpolating visibility between their ends displaces shadow
    /// boundaries by more than this, radians, more than 0. The bound is for edges of 0.02 of the
    /// diagonal of the scene without its ground; it is twice as large for edges of half that
    /// length. A scene file's own bound wins [default: off; 0.01 for high].
    #[arg(long, value_name = "RADIANS", value_parser = positive, allow_negative_numbers = true)]
    pub refine_error: Option<f32>,
    /// Refinement stops before the mesh has more vertices than this, at least 1
    /// [default: 1000000].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub max_vertices: Option<usize>,
    /// Bounces of light to follow: auto (until the next adds less than 0.5 %) or a number, 0 to 64;
    /// 0 for none. They turn and change with the light, but have the materials of the bake.
    #[arg(long, value_name = "N|auto", default_value = "auto", value_parser = bounces)]
    bounces: Bounces,
    /// Texels per side of the visibility samples, 8 to 256, a multiple of the basis images'
    /// [default: 32 for draft, else 128].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=256))]
    sample_resolution: Option<u32>,
    /// Texels per side of the basis images, 8 to 256 [default: 32 for draft, else 64].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=256))]
    basis_resolution: Option<u32>,
    #[command(flatten)]
    access: AccessArguments,
    /// Vertices, and triangles, of the mesh as its file has it, 1 to 33554432; a bake takes
    /// about 500 bytes for each [default: 8388608].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    limit_vertices: Option<usize>,
}

impl SceneArguments {
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
    /// Lat-long image: twice as wide as high, first row up, first column towards -Z.
    pub input: PathBuf,
    /// Asset to write.
    #[arg(short, long, value_name = "OUT.relight")]
    pub output: PathBuf,
    /// Spherical Gaussians to fit, 1 to 1024; with --max-error, at most [default: 64, with
    /// --max-error 256].
    #[arg(long, value_name = "N", value_parser = lobes)]
    lobes: Option<usize>,
    /// Add lobes until the relative L2 error is at most this, more than 0; fail where that takes
    /// too many.
    #[arg(long, value_name = "E", value_parser = positive, allow_negative_numbers = true)]
    max_error: Option<f32>,
    /// Suns, lamps and windows to take out of the image at most, 0 to 8, as sources that rays
    /// shadow; the lobes fit the rest. 0 leaves all light to the lobes.
    #[arg(long, value_name = "N", default_value_t = environment::MAX_SOURCES as u8,
          value_parser = clap::value_parser!(u8).range(..=environment::MAX_SOURCES as i64))]
    sources: u8,
    /// Also write the original, the fit and their difference (PNG) and the error over the number
    /// of lobes (CSV, SVG) into this folder.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// The image is upside down: its first row is the nadir.
    #[arg(long)]
    flip: bool,
    /// The image is seen from outside the sphere: left and right are exchanged.
    #[arg(long)]
    mirror: bool,
    /// Take the image as lat-long even if it is not twice as wide as high.
    #[arg(long)]
    any_shape: bool,
    /// Bytes of the file, at least 1 [default: 2147483648].
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u64).range(1..))]
    limit_bytes: Option<u64>,
    /// Pixels of the image, 1 to 536870912; each takes about 25 bytes [default: 33554432, as of
    /// 8192x4096].
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
        environment::FitOptions {
            lobes: self.lobes.unwrap_or(match self.max_error {
                Some(_) => 256,
                None => environment::FitOptions::default().lobes,
            }),
            max_error: self.max_error,
            sources: usize::from(self.sources),
        }
    }
}

#[derive(Args)]
pub struct MaterialArguments {
    /// Table or material file.
    pub input: PathBuf,
    /// Asset to write.
    #[arg(short, long, value_name = "OUT.relight")]
    pub output: PathBuf,
    /// Tables: lobes that give reflections their shape, 1 to 7; what they miss of the table
    /// multiplies them [default: until one takes less than a twentieth off the error].
    #[arg(long, value_name = "N",
          value_parser = clap::value_parser!(u8).range(1..=format::MAX_FITTED_LOBES as i64))]
    pub lobes: Option<u8>,
    /// Tables: fail unless the relative L2 error is at most this, more than 0.
    #[arg(long, value_name = "ERROR", value_parser = positive, allow_negative_numbers = true)]
    pub max_error: Option<f32>,
    /// Tables: also write sphere.png into this folder: a lit sphere of the table, of the lobes,
    /// and their difference, doubled.
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
