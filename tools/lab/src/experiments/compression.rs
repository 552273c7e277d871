//! Bytes against errors: every representation of visibility on the same scenes.
//!
//! Each is baked, written and read; a diffuse and a glossy material everywhere are rendered
//! with it and compared with ray-traced truth of the same lights and lobes.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use relight_bake::files::{Access, Files};
use relight_bake::import::plain_material;
use relight_bake::internals::plot::{self, Curve};
use relight_bake::monitor::Monitor;
use relight_bake::scene::Options;
use relight_bake::scene::{self, load, seam};
use relight_format::{self as format, Limits, Representation, Specular, Surface};
use relight_runtime::Frame;
use relight_shading::spherical_gaussian::SphericalGaussian;
use serde::Serialize;

use crate::compare::compare;
use crate::render::{Device, Renderer};
use crate::truth;
use crate::truth::lobes::{self, Visibility};

/// The laboratory's scenes that are measured where none are named.
pub const SCENES: [&str; 5] = [
    "bunny",
    "armadillo",
    "dragon_100k",
    "walk_1",
    "FlightHelmet",
];

/// What to measure.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Folder for tables and plots.
    pub folder: PathBuf,
    /// Scene files or meshes.
    pub scenes: Vec<PathBuf>,
    /// Picture size, pixels.
    pub size: [u32; 2],
    /// Truth samples per pixel.
    pub samples: u32,
    /// Where to render.
    pub device: Device,
    /// Start of every bake.
    pub bake: Options,
}

/// What fits into so many bytes, with at most so many vertices, where shadows fall. A mesh of
/// more may have a quarter as many again.
const TO_A_SIZE: &str = "clusters, refined, to a size";
const SIZES: [(u64, usize); 2] = [(5_000_000, 50_000), (15_000_000, 200_000)];

/// One representation of one scene.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Name of the scene.
    pub scene: String,
    /// Name of the curve.
    pub curve: String,
    /// The aim of [`Options`], radians, the bytes that are allowed, or the rank of a global
    /// basis.
    pub setting: f64,
    /// Vertices before clusters share any.
    pub vertices: usize,
    /// Bytes of the file without textures.
    pub bytes: usize,
    /// Bytes of the file per vertex.
    pub bytes_per_vertex: f64,
    /// Fetches of four basis texels that an SSDF sample takes, mean over vertices.
    pub tiles_per_sample: f64,
    /// How far visibility boundaries are off on the surface, root mean square, radians.
    pub surface_error: f32,
    /// The same at vertices, by compression alone.
    pub compression_error: f32,
    /// Root mean square jump at vertices that clusters share, radians.
    pub seam_rms: f32,
    /// Relative RMSE of a diffuse material, noise of the truth removed.
    pub diffuse: f64,
    /// Relative RMSE of a glossy material, noise of the truth removed.
    pub specular: f64,
    /// Wall-clock seconds of the bake.
    pub seconds: f64,
}

/// Curves and their points: name, setting and bake options.
fn curves(start: &Options) -> Vec<(&'static str, f64, Options)> {
    let mut all = Vec::new();
    for (name, basis_resolution, max_tiles, aims) in [
        (
            "clusters, 64x64, to 4 tiles",
            64,
            4,
            &[0.01, 0.005, 0.0025][..],
        ),
        ("clusters, 32x32, to 4 tiles", 32, 4, &[0.005]),
    ] {
        for &aim in aims {
            let options = Options {
                basis_resolution,
                max_tiles,
                aim,
                ..start.clone()
            };
            all.push((name, f64::from(aim), options));
        }
    }
    for (bytes, max_vertices) in SIZES {
        let options = Options {
            max_bytes: Some(bytes),
            max_vertices,
            ..Options::high()
        };
        all.push((TO_A_SIZE, bytes as f64, options));
    }
    for rank in [10, 24] {
        let options = Options {
            representation: Representation::GlobalPca,
            global_rank: rank,
            ..start.clone()
        };
        all.push(("global components", f64::from(rank), options));
    }
    all
}

/// Runs everything; writes `compression.csv` and a plot per scene into the folder after
/// every scene.
pub fn run(
    settings: &Settings,
    lights: &[SphericalGaussian],
    monitor: Monitor,
) -> anyhow::Result<Vec<Row>> {
    crate::display::create_folder(&settings.folder)?;
    let mut renderer = Renderer::open(settings.device)?;
    let mut rows = Vec::new();
    for path in &settings.scenes {
        let first = rows.len();
        measure(path, settings, lights, &mut renderer, &mut rows, monitor)?;
        write_table(&settings.folder.join("compression.csv"), &rows)?;
        write_plots(&settings.folder, &rows[first..])?;
    }
    Ok(rows)
}

/// The diffuse material that errors are measured with.
const DIFFUSE: Surface = Surface::DiffuseSpecular {
    diffuse: [0.5; 3],
    specular: Specular::None,
};

/// The glossy one.
const GLOSSY: Surface = Surface::DiffuseSpecular {
    diffuse: [0.0; 3],
    specular: Specular::Ggx {
        f0: [0.5; 3],
        alpha: [0.25; 2],
    },
};

fn measure(
    path: &Path,
    settings: &Settings,
    lights: &[SphericalGaussian],
    renderer: &mut Renderer,
    rows: &mut Vec<Row>,
    monitor: Monitor,
) -> anyhow::Result<()> {
    let surfaces = [DIFFUSE, GLOSSY];
    let mut truths = Vec::new();
    for (curve, setting, mut options) in curves(&settings.bake) {
        let start = Instant::now();
        let mut input = load::load_from(&Files::new(path, &Access::anywhere())?, path)?;
        // A bound below what the mesh has would leave nothing for shadows.
        let imported = input.mesh.vertices.len();
        if imported > options.max_vertices {
            options.max_vertices = imported + imported / 4;
        }
        // Bytes are those of visibility and geometry.
        input.mesh.textures.clear();
        put_on(&mut input.mesh.materials, &surfaces[0]);
        let (baked, _) =
            scene::bake(input, &options, monitor).with_context(|| path.display().to_string())?;
        let seconds = start.elapsed().as_secs_f64();
        let bytes = format::write_scene(&baked)?;
        let mut scene = format::read_scene(&bytes, &Limits::default())?;
        let camera = scene.camera.with_context(|| {
            format!(
                "{}: expected a scene file with a camera, found none",
                path.display()
            )
        })?;
        let frame = Frame::new(camera, lights);
        let seams = seam::measure(&scene);
        let mut errors = Vec::new();
        for (index, surface) in surfaces.iter().enumerate() {
            put_on(&mut scene.materials, surface);
            if truths.len() == index {
                monitor.step("trace truth", 0.0)?;
                let Settings { size, samples, .. } = *settings;
                let (options, exact) = (truth::Options::centers(samples), Visibility::Exact);
                let truth = lobes::of_frame(&scene, &frame, size, &options, exact, &|| ());
                truths.push(truth);
            }
            let image = renderer.render(&scene, &frame, settings.size)?;
            let found = compare(&image, &truths[index])?;
            errors.push(found.noiseless());
        }
        let own = scene.vertices.len() - usize::try_from(seams.pairs)?;
        let fetches: f64 = (scene.clusters.iter())
            .map(|cluster| f64::from(cluster.tiles) * f64::from(cluster.vertex_count))
            .sum();
        rows.push(Row {
            scene: scene.name.clone(),
            curve: curve.to_owned(),
            setting,
            vertices: own,
            bytes: bytes.len(),
            bytes_per_vertex: bytes.len() as f64 / own as f64,
            tiles_per_sample: fetches / scene.vertices.len() as f64,
            surface_error: scene.report.errors.surface,
            compression_error: scene.report.errors.compression,
            seam_rms: seams.rms,
            diffuse: errors[0],
            specular: errors[1],
            seconds,
        });
    }
    Ok(())
}

/// Makes everything diffuse.
pub fn put_diffuse(scene: &mut format::Scene) {
    put_on(&mut scene.materials, &DIFFUSE);
}

/// Gives everything the same surface.
fn put_on(materials: &mut [format::Material], surface: &Surface) {
    for material in materials {
        *material = plain_material("plain", surface.clone());
    }
}

fn write_table(path: &Path, rows: &[Row]) -> anyhow::Result<()> {
    let mut text = "scene,curve,setting,vertices,bytes,bytes_per_vertex,tiles_per_sample,\
                    surface_error,compression_error,seam_rms,diffuse,specular,seconds\n"
        .to_owned();
    for row in rows {
        text += &format!(
            "{},\"{}\",{},{},{},{:.1},{:.2},{:.5},{:.5},{:.5},{:.5},{:.5},{:.1}\n",
            row.scene,
            row.curve,
            row.setting,
            row.vertices,
            row.bytes,
            row.bytes_per_vertex,
            row.tiles_per_sample,
            row.surface_error,
            row.compression_error,
            row.seam_rms,
            row.diffuse,
            row.specular,
            row.seconds,
        );
    }
    relight_format::write_file(path, text.as_bytes())?;
    Ok(())
}

/// A figure of a row.
type Figure = fn(&Row) -> f64;

fn write_plots(folder: &Path, rows: &[Row]) -> anyhow::Result<()> {
    let mut names: Vec<&str> = rows.iter().map(|row| row.curve.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let Some(first) = rows.first() else {
        return Ok(());
    };
    let figures: [(&str, Figure); 2] = [
        ("diffuse", |row| row.diffuse),
        ("specular", |row| row.specular),
    ];
    for (figure, value) in figures {
        let curves: Vec<Curve> = (names.iter())
            .map(|name| Curve {
                name: (*name).to_owned(),
                points: (rows.iter().filter(|row| row.curve == *name))
                    .map(|row| [row.bytes_per_vertex, 100.0 * value(row)])
                    .collect(),
            })
            .collect();
        let path = folder.join(format!("compression-{}-{figure}.svg", first.scene));
        let svg = plot::svg(
            &format!("{}: {figure}", first.scene),
            ["bytes per vertex", "relative RMSE, %"],
            &curves,
        )
        .with_context(|| format!("{}: nothing to plot", path.display()))?;
        relight_format::write_file(&path, svg.as_bytes())?;
    }
    Ok(())
}
