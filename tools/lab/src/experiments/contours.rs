//! Signed distances to where contours cross between texels against distances to midpoints, on
//! thin features.

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use relight_bake::contour::ContourMesh;
use relight_bake::import;
use relight_bake::ray::RayCaster;
use relight_bake::ssdf::{Crossings, Transform};
use relight_bake::visibility::Directions;

use super::Laboratory;
use super::report::{Section, Table};

/// Meshes in the folder of data.
const MESHES: [(&str, &str); 3] = [
    ("carbon60", "meshes/thin/carbon60.glb"),
    ("simple_pole", "meshes/thin/simple_pole.glb"),
    ("walk_1", "meshes/figures/cesium_man_walk/walk_1.obj"),
];
/// Samples per side, and whether crossings are looked for.
const VARIANTS: [(u32, bool); 4] = [(128, false), (128, true), (64, false), (64, true)];
/// Samples per side of what counts as exact.
const REFERENCE: u32 = 512;
/// Texels per side of the distances.
const RESOLUTION: u32 = 64;
/// Points per side of the grid that looks at the mesh from below.
const POINTS: u32 = 14;
/// Distances that count, radians: those that shade.
const NEAR: f32 = 0.1;
const LIMIT: f32 = 0.5;

/// One way to make distances.
struct Variant {
    directions: Directions,
    transform: Transform,
    crossings: bool,
}

impl Variant {
    fn new(samples: u32, crossings: bool) -> Self {
        let directions = Directions::new(samples);
        Self {
            transform: Transform::new(&directions, RESOLUTION),
            directions,
            crossings,
        }
    }

    fn distances(&self, contours: &ContourMesh, caster: &RayCaster, origin: Vec3) -> Vec<f32> {
        let mut scratch = contours.scratch(&self.directions);
        let (bitmap, _) = contours.sample(caster, origin, &self.directions, &mut scratch);
        let none = Crossings::default();
        let crossings = if self.crossings {
            contours.crossings(&bitmap, &mut scratch)
        } else {
            &none
        };
        self.transform.apply(&bitmap, crossings, LIMIT)
    }
}

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![format!(
        "Root mean square error of signed distances at {RESOLUTION}x{RESOLUTION} texels, where \
         they are below {NEAR} rad, against {REFERENCE}x{REFERENCE} samples with crossings: from \
         samples alone (the boundary lies midway between texels of different class) and from \
         where contours cross between them. {} points under each mesh.",
        POINTS * POINTS
    )];
    let mut table = Table::new(
        "contours",
        "Errors of signed distances, thousandths of a radian",
        &[
            "mesh",
            "128x128",
            "128x128, crossings",
            "64x64",
            "64x64, crossings",
        ],
    );
    let variants = VARIANTS.map(|(samples, crossings)| Variant::new(samples, crossings));
    let reference = Variant::new(REFERENCE, true);
    for (name, path) in MESHES {
        laboratory.monitor.step("sample thin features", 0.0)?;
        let mesh = import::mesh(&laboratory.settings.data.join(path))?;
        let corner = |&vertex: &u32| Vec3::from(mesh.vertices[vertex as usize].position);
        let soup: Vec<[Vec3; 3]> = (mesh.triangles.iter())
            .map(|triangle| triangle.vertices.each_ref().map(corner))
            .collect();
        let (contours, caster) = (ContourMesh::new(&soup), RayCaster::new(&soup));
        let (low, high) = mesh.bounds().unwrap_or_default();
        let below = low.y - 0.02 * (high.y - low.y);
        let squares: Vec<([f64; 4], u64)> = (0..POINTS * POINTS)
            .into_par_iter()
            .map(|index| {
                let place = Vec2::new((index % POINTS) as f32, (index / POINTS) as f32) + 0.5;
                let Vec2 { x, y } = place / POINTS as f32;
                let at = low + (high - low) * Vec3::new(x, 0.0, y);
                let origin = Vec3::new(at.x, below, at.z);
                let exact = reference.distances(&contours, &caster, origin);
                let sums = variants.each_ref().map(|variant| {
                    let found = variant.distances(&contours, &caster, origin);
                    let near = exact.iter().zip(&found);
                    near.filter(|(exact, _)| exact.abs() < NEAR)
                        .map(|(exact, found)| f64::from(found - exact).powi(2))
                        .sum::<f64>()
                });
                let count = exact.iter().filter(|exact| exact.abs() < NEAR).count();
                (sums, count as u64)
            })
            .collect();
        let count: u64 = squares.iter().map(|(_, count)| count).sum();
        let rms = |variant: usize| {
            let sum: f64 = squares.iter().map(|(sums, _)| sums[variant]).sum();
            1e3 * (sum / count.max(1) as f64).sqrt()
        };
        table.row([
            name.into(),
            rms(0).into(),
            rms(1).into(),
            rms(2).into(),
            rms(3).into(),
        ]);
    }
    section.tables.push(table);
    Ok(())
}
