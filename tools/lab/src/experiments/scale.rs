//! What a frame costs against lobes, pixels, triangles and clusters, counted by the twin.

use std::collections::HashMap;

use glam::Vec3;
use relight_bake::internals::plot::Curve;
use relight_bake::mesh::{Mesh, Triangle, Vertex};
use relight_bake::scene;
use relight_format::Scene;
use relight_runtime::{Frame, twin};

use super::report::{Section, Table};
use super::{Laboratory, camera, percent_of};
use crate::compare::compare;

const LOBES: [usize; 6] = [8, 16, 32, 64, 128, 256];
/// Quarters of the experiment's width and height.
const SIZES: [u32; 4] = [1, 2, 4, 8];
/// Times that every triangle is divided into four.
const DIVISIONS: [u32; 3] = [0, 1, 2];
/// Lobes where something else varies.
const USUAL_LOBES: usize = 32;
/// Bytes of four texels of four channels, which one fetch interpolates.
const FETCH_BYTES: f64 = 16.0;

const COLUMNS: [&str; 14] = [
    "what varies",
    "is",
    "triangles",
    "clusters",
    "asset, MB",
    "pixels covered",
    "integrals per pixel",
    "samples per pixel",
    "fetches per pixel",
    "bytes fetched per pixel",
    "fetches per pixel for vertices",
    "nanoseconds per pixel",
    "relative RMSE, %",
    "floor, fetches per pixel",
];

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![format!(
        "Spot over its ground under grace, one thing varied at a time: lobes of the light; width and \
         height of the picture; triangles, each divided into four again and again, baked as drafts. Else {USUAL_LOBES} lobes. A fetch \
         interpolates four texels of four basis images, {FETCH_BYTES} bytes that neighbouring pixels mostly \
         share. What vertices take is for light that has just turned: while it stands still there is none. \
         The floor: every integral decided by a single sample, one fetch for each four coefficients \
         of the clusters in the middle. Time is the whole frame's, on the processor that the report names."
    )];
    let mut table = Table::new("scale", "Work of polar per covered pixel", &COLUMNS);
    let usual = laboratory.settings.size;
    let mut plot = |laboratory: &mut Laboratory, name: &str, axis: &str, points: Vec<Costs>| {
        let curve = |name: &str, of: &dyn Fn(&Costs) -> f64| Curve {
            name: name.to_owned(),
            points: (points.iter()).map(|point| [point.at, of(point)]).collect(),
        };
        let curves = [
            curve("samples", &|costs| costs.samples),
            curve("fetches", &|costs| costs.fetches),
            curve("fetches for vertices", &|costs| costs.vertex_fetches),
        ];
        let axes = [axis, "per covered pixel"];
        laboratory.plot(
            section,
            &format!("scale-{name}"),
            &format!("Work against {axis}"),
            axes,
            &curves,
        )
    };

    let spot = laboratory.scene("spot")?;
    let mut points = Vec::new();
    for lobes in LOBES {
        let case = ("lobes", lobes as f64, lobes);
        points.push(measure(laboratory, &mut table, &spot, case)?);
    }
    plot(laboratory, "lobes", "lobes", points)?;

    let mut points = Vec::new();
    for size in SIZES {
        laboratory.settings.size = usual.map(|side| (side * size / 4).max(1));
        let [width, height] = laboratory.settings.size;
        let case = ("pixels", f64::from(width * height), USUAL_LOBES);
        points.push(measure(laboratory, &mut table, &spot, case)?);
    }
    laboratory.settings.size = usual;
    plot(laboratory, "pixels", "pixels of the picture", points)?;

    let mut points = Vec::new();
    for divisions in DIVISIONS {
        let mut input = laboratory.input("spot")?;
        input.name = format!("spot-divided-{divisions}");
        for _ in 0..divisions {
            input.mesh = divided(&input.mesh);
        }
        let triangles = input.mesh.triangles.len();
        let options = scene::Options {
            // As many triangles as the table says.
            least_vertices: 0,
            ..scene::Options::draft()
        };
        let scene = laboratory.bake(input, &options)?;
        let case = ("triangles", triangles as f64, USUAL_LOBES);
        points.push(measure(laboratory, &mut table, &scene, case)?);
    }
    plot(laboratory, "triangles", "triangles of the mesh", points)?;
    section.tables.push(table);
    Ok(())
}

/// One point of the curves.
struct Costs {
    at: f64,
    samples: f64,
    fetches: f64,
    vertex_fetches: f64,
}

/// Adds a row: what varies, its value, and the lobes of the light.
fn measure(
    laboratory: &mut Laboratory,
    table: &mut Table,
    scene: &Scene,
    (what, value, lobes): (&str, f64, usize),
) -> anyhow::Result<Costs> {
    let light = laboratory.light("grace", lobes)?;
    let frame: Frame = light.frame(camera(scene)?);
    let [width, height] = laboratory.settings.size;
    let work = twin::work(scene, &frame, width, height)?;
    let timed = laboratory.time(scene, &frame)?;
    let truth = laboratory.truth(scene, &frame)?;
    let pixels = work.pixels.max(1) as f64;
    let per_pixel = |count: u64| count as f64 / pixels;
    let costs = Costs {
        at: value,
        samples: per_pixel(work.samples),
        fetches: per_pixel(work.fetches),
        vertex_fetches: per_pixel(work.vertex_fetches),
    };
    let mut tiles: Vec<_> = (scene.clusters.iter())
        .map(|cluster| cluster.tiles)
        .collect();
    tiles.sort_unstable();
    let middle = tiles
        .get(tiles.len() / 2)
        .map_or(0.0, |&tiles| f64::from(tiles));
    table.row([
        what.into(),
        value.into(),
        scene.triangles.len().into(),
        scene.clusters.len().into(),
        (relight_format::write_scene(scene)?.len() as f64 / 1e6).into(),
        pixels.into(),
        per_pixel(work.integrals).into(),
        costs.samples.into(),
        costs.fetches.into(),
        (FETCH_BYTES * costs.fetches).into(),
        costs.vertex_fetches.into(),
        (1e9 * timed.shading.as_secs_f64() / pixels).into(),
        percent_of(&compare(&timed.image, &truth)?),
        (per_pixel(work.integrals) * middle).into(),
    ]);
    Ok(costs)
}

/// Each triangle as four, of the same surface.
fn divided(mesh: &Mesh) -> Mesh {
    let mut vertices = mesh.vertices.clone();
    let mut between = HashMap::new();
    let mut triangles = Vec::with_capacity(4 * mesh.triangles.len());
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.vertices;
        let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[from, to]| {
            let ends = [from.min(to), from.max(to)];
            *between.entry(ends).or_insert_with(|| {
                vertices.push(middle(ends.map(|end| mesh.vertices[end as usize])));
                vertices.len() as u32 - 1
            })
        });
        for corners in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
            triangles.push(Triangle {
                vertices: corners,
                ..*triangle
            });
        }
    }
    Mesh {
        vertices,
        triangles,
        ..mesh.clone()
    }
}

fn middle([a, b]: [Vertex; 2]) -> Vertex {
    let normal = (a.normal + b.normal).normalize_or(a.normal);
    let tangent: Vec3 = a.tangent + b.tangent;
    let across = normal.any_orthonormal_vector();
    Vertex {
        position: 0.5 * (a.position + b.position),
        normal,
        tangent: (tangent - tangent.dot(normal) * normal).normalize_or(across),
        uv: 0.5 * (a.uv + b.uv),
        second_uv: 0.5 * (a.second_uv + b.second_uv),
        ..a
    }
}
