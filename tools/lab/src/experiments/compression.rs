//! Bytes against errors: every representation of visibility on the same scenes.
//!
//! Each is baked, written and read; a diffuse and a glossy material everywhere are drawn
//! with it and compared with ray-traced truth of the same lights and lobes.

use std::path::Path;
use std::time::Instant;

use anyhow::Context as _;
use relight_bake::files::{Access, Files};
use relight_bake::import::plain_material;
use relight_bake::internals::plot::Curve;
use relight_bake::scene::{self, Options, load, seam};
use relight_format::{self as format, Limits, Representation, Specular, Surface};
use relight_runtime::Frame;
use relight_shading::spherical_gaussian::SphericalGaussian;

use super::report::{Section, Table};
use super::{Laboratory, camera, percent_of};
use crate::compare::{Comparison, compare};

/// The laboratory's scenes that are measured where none are named.
const SCENES: [&str; 2] = ["bunny", "walk_1"];
const LOBES: usize = 16;

/// What fits into so many bytes, with at most so many vertices, where shadows fall, and so many times those of the mesh:
/// a small mesh would be all of what is added. A mesh of more may have a quarter as many again.
const TO_A_SIZE: &str = "clusters, refined, to a size";
const SIZE: (u64, usize) = (5_000_000, 50_000);
const FINER: usize = 20;

/// Components of a basis for the whole scene.
const GLOBAL_RANK: u32 = 24;

/// One representation of one scene.
struct Row {
    /// Name of the curve.
    curve: &'static str,
    /// The aim of [`Options`], radians, the bytes that are allowed, or the rank of a global
    /// basis.
    setting: f64,
    /// Vertices before clusters share any.
    vertices: usize,
    /// Bytes of the file without textures.
    bytes: usize,
    /// Fetches of four basis texels that an SSDF sample takes, mean over vertices.
    tiles_per_sample: f64,
    /// How far visibility boundaries are off on the surface, root mean square, radians.
    surface_error: f32,
    /// The same at vertices, by compression alone.
    compression_error: f32,
    /// Root mean square jump at vertices that clusters share, radians.
    seam_rms: f32,
    /// Of a diffuse and of a glossy material.
    found: [Comparison; 2],
    /// Wall-clock seconds of the bake.
    seconds: f64,
}

impl Row {
    fn bytes_per_vertex(&self) -> f64 {
        self.bytes as f64 / self.vertices as f64
    }
}

/// Curves and their points: name, setting and bake options.
fn curves(start: &Options) -> Vec<(&'static str, f64, Options)> {
    let mut all = Vec::new();
    for aim in [0.01, 0.005, 0.0025] {
        let options = Options {
            aim,
            ..start.clone()
        };
        all.push(("clusters, default edges", f64::from(aim), options));
    }
    let (bytes, max_vertices) = SIZE;
    let options = Options {
        max_bytes: Some(bytes),
        max_vertices,
        ..Options::high()
    };
    all.push((TO_A_SIZE, bytes as f64, options));
    let options = Options {
        representation: Representation::GlobalPca,
        global_rank: GLOBAL_RANK,
        ..start.clone()
    };
    all.push(("global components", f64::from(GLOBAL_RANK), options));
    all
}

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![format!(
        "A diffuse and a GGX material (α = 0.25) everywhere, under grace with {LOBES} lobes unless \
         `--environment` names another light. `Setting` is the error asked for, radians, the size asked for, bytes, \
         or the number of components of a basis for the whole scene, as the paper has it. `{TO_A_SIZE}` is the \
         preset `high`, whose sizes are estimated from some chunks with room to spare. A sample fetches \
         four texels of as many images as it has tiles."
    )];
    let mut paths = laboratory.settings.scenes.clone();
    if paths.is_empty() {
        let (folder, data) = (&laboratory.settings.folder, &laboratory.settings.data);
        for name in SCENES {
            paths.push(super::scene_file(name, folder, data)?);
        }
    }
    let lights = match &laboratory.settings.lights {
        Some(lights) => lights.clone(),
        None => laboratory.light("grace", LOBES)?.lobes.clone(),
    };
    let mut table = Table::new(
        "compression",
        "Bytes against errors",
        &[
            "scene",
            "curve",
            "setting",
            "vertices",
            "bytes",
            "bytes per vertex",
            "tiles per sample",
            "surface error, rad",
            "compression error, rad",
            "jump at seams, rad",
            "diffuse, %",
            "specular, %",
            "seconds",
        ],
    );
    for path in &paths {
        let (name, rows) = measure(laboratory, path, &lights)?;
        for row in &rows {
            table.row([
                name.as_str().into(),
                row.curve.into(),
                row.setting.into(),
                row.vertices.into(),
                row.bytes.into(),
                row.bytes_per_vertex().into(),
                row.tiles_per_sample.into(),
                f64::from(row.surface_error).into(),
                f64::from(row.compression_error).into(),
                f64::from(row.seam_rms).into(),
                percent_of(&row.found[0]),
                percent_of(&row.found[1]),
                row.seconds.into(),
            ]);
        }
        plot(laboratory, section, &name, &rows)?;
    }
    section.tables.push(table);
    Ok(())
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

/// The name of a scene and all representations of it.
fn measure(
    laboratory: &mut Laboratory,
    path: &Path,
    lights: &[SphericalGaussian],
) -> anyhow::Result<(String, Vec<Row>)> {
    let surfaces = [DIFFUSE, GLOSSY];
    let (mut name, mut rows, mut truths) = (String::new(), Vec::new(), Vec::new());
    for (curve, setting, mut options) in curves(&laboratory.settings.bake) {
        let start = Instant::now();
        let mut input = load::load_from(&Files::new(path, &Access::anywhere())?, path)?;
        // A bound below what the mesh has would leave nothing for shadows.
        let imported = input.mesh.vertices.len();
        if curve == TO_A_SIZE {
            options.max_vertices = options.max_vertices.min(FINER * imported);
        }
        if imported > options.max_vertices {
            options.max_vertices = imported + imported / 4;
        }
        // Bytes are those of visibility and geometry.
        input.mesh.textures.clear();
        put_on(&mut input.mesh.materials, &surfaces[0]);
        let (baked, _) = scene::bake(input, &options, laboratory.monitor)
            .with_context(|| path.display().to_string())?;
        let seconds = start.elapsed().as_secs_f64();
        let bytes = format::write_scene(&baked)?;
        let mut scene = format::read_scene(&bytes, &Limits::default())?;
        let frame = Frame::new(camera(&scene)?, lights);
        let seams = seam::measure(&scene);
        let mut compared = |index: usize| -> anyhow::Result<Comparison> {
            put_on(&mut scene.materials, &surfaces[index]);
            if truths.len() == index {
                truths.push(laboratory.truth(&scene, &frame)?);
            }
            Ok(compare(&laboratory.draw(&scene, &frame)?, &truths[index])?)
        };
        let found = [compared(0)?, compared(1)?];
        let own = scene.vertices.len() - usize::try_from(seams.pairs)?;
        let fetches: f64 = (scene.clusters.iter())
            .map(|cluster| f64::from(cluster.tiles) * f64::from(cluster.vertex_count))
            .sum();
        name.clone_from(&scene.name);
        rows.push(Row {
            curve,
            setting,
            vertices: own,
            bytes: bytes.len(),
            tiles_per_sample: fetches / scene.vertices.len() as f64,
            surface_error: scene.report.errors.surface,
            compression_error: scene.report.errors.compression,
            seam_rms: seams.rms,
            found,
            seconds,
        });
    }
    Ok((name, rows))
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

/// Errors of both materials against bytes, a curve for every kind of representation.
fn plot(
    laboratory: &Laboratory,
    section: &mut Section,
    scene: &str,
    rows: &[Row],
) -> anyhow::Result<()> {
    let mut names: Vec<&str> = rows.iter().map(|row| row.curve).collect();
    names.sort_unstable();
    names.dedup();
    for (index, material) in ["diffuse", "specular"].into_iter().enumerate() {
        let curve = |name: &&str| Curve {
            name: (*name).to_owned(),
            points: (rows.iter().filter(|row| row.curve == *name))
                .map(|row| [row.bytes_per_vertex(), 100.0 * row.found[index].noiseless()])
                .collect(),
        };
        let curves: Vec<Curve> = names.iter().map(curve).collect();
        laboratory.plot(
            section,
            &format!("{scene}-{material}"),
            &format!("{scene}: {material}"),
            ["bytes per vertex", "relative RMSE, %"],
            &curves,
        )?;
    }
    Ok(())
}
