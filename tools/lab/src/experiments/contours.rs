//! Boundaries from where contours cross between texels against boundaries from midpoints, on
//! thin features.

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use relight_bake::import;
use relight_bake::internals::DistanceTransform;
use relight_bake::internals::visibility::ContourMesh;
use relight_bake::internals::visibility::{Bitmap, Crossings, Directions};
use relight_shading::octahedral::Footprint;

use super::Laboratory;
use super::report::{Section, Table};

/// Meshes in the folder of data.
const MESHES: [(&str, &str); 3] = [
    ("carbon60", "meshes/thin/carbon60.glb"),
    ("simple_pole", "meshes/thin/simple_pole.glb"),
    ("walk_1", "meshes/figures/cesium_man_walk/walk_1.obj"),
];
/// Samples and texels per side, whether crossings are looked for, and whether distances are
/// fitted to vanish there.
const VARIANTS: [(u32, u32, bool, bool); 6] = [
    (128, 64, false, false),
    (128, 64, true, false),
    (128, 64, true, true),
    (64, 64, true, true),
    (128, 128, false, false),
    (128, 128, true, true),
];
/// Directions per side whose visibility is compared.
const REFERENCE: u32 = 1024;
/// Points per side of the grid that looks at the mesh from below.
const POINTS: u32 = 8;
const LIMIT: f32 = 0.5;

/// One way to make distances.
struct Variant {
    directions: Directions,
    transform: DistanceTransform,
    resolution: u32,
    crossings: bool,
    fitted: bool,
}

impl Variant {
    fn new((samples, resolution, crossings, fitted): (u32, u32, bool, bool)) -> Self {
        let directions = Directions::new(samples);
        Self {
            transform: DistanceTransform::new(&directions, resolution),
            directions,
            resolution,
            crossings,
            fitted,
        }
    }

    fn distances(&self, contours: &ContourMesh, origin: Vec3) -> Vec<f32> {
        let mut scratch = contours.scratch(&self.directions);
        let (bitmap, _) = contours.sample(origin, &self.directions, &mut scratch);
        let none = Crossings::default();
        let crossings = if self.crossings {
            contours.crossings(&bitmap, &mut scratch)
        } else {
            &none
        };
        if self.fitted {
            self.transform.apply(&bitmap, crossings, LIMIT)
        } else {
            self.transform.at_centres(&bitmap, crossings, LIMIT)
        }
    }

    /// Solid angle where interpolated distances have the wrong sign, steradians.
    fn wrong(&self, distances: &[f32], visible: &Bitmap, solid_angles: &[f64]) -> f64 {
        let scale = self.resolution as f32 / REFERENCE as f32;
        (solid_angles.iter().enumerate())
            .filter(|(index, _)| {
                let place = Vec2::new(
                    (*index as u32 % REFERENCE) as f32,
                    (*index as u32 / REFERENCE) as f32,
                );
                let texel = (place + 0.5) * scale - 0.5;
                let distance = Footprint::new(texel, self.resolution).read(distances);
                (distance > 0.0) != visible.get(*index)
            })
            .map(|(_, solid_angle)| solid_angle)
            .sum()
    }
}

/// Length of the boundary, radians: a line in any direction crosses π/4 links per texel's
/// width, on average, in each of both directions of links.
fn boundary_length(visible: &Bitmap, solid_angles: &[f64]) -> f64 {
    let side = REFERENCE as usize;
    let differ = |a: usize, b: usize| f64::from(u8::from(visible.get(a) != visible.get(b)));
    (solid_angles.iter().enumerate())
        .map(|(index, solid_angle)| {
            let mut links = 0.0;
            if (index + 1) % side != 0 {
                links += differ(index, index + 1);
            }
            if index + side < solid_angles.len() {
                links += differ(index, index + side);
            }
            links * solid_angle.sqrt() * std::f64::consts::FRAC_PI_4
        })
        .sum()
}

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![format!(
        "How far the boundary of visibility is off where interpolated distances vanish: the \
         solid angle of the wrong class among {REFERENCE}x{REFERENCE} directions over the \
         boundary's length. From samples alone the boundary lies midway between texels of \
         different class; crossings are where contours separate them; fitted distances are \
         moved to vanish there. {} points under each mesh.",
        POINTS * POINTS
    )];
    let mut table = Table::new(
        "contours",
        "Mean displacement of the boundary, thousandths of a radian",
        &[
            "mesh",
            "128 to 64",
            "128 to 64, crossings",
            "128 to 64, fitted",
            "64 to 64, fitted",
            "128 to 128",
            "128 to 128, fitted",
        ],
    );
    let variants = VARIANTS.map(Variant::new);
    let reference = Directions::new(REFERENCE);
    // The octahedral map shrinks by the third power of the distance to the octahedron's face
    // (Engelhardt & Dachsbacher 2008).
    let texel = 4.0 / f64::from(REFERENCE).powi(2);
    let solid_angles: Vec<f64> = (reference.as_slice().iter())
        .map(|direction| texel * f64::from(direction.abs().element_sum()).powi(3))
        .collect();
    for (name, path) in MESHES {
        laboratory.monitor.step("sample thin features", 0.0)?;
        let mesh = import::mesh(&laboratory.settings.data.join(path))?;
        let contours = ContourMesh::new(&mesh.soup());
        let (low, high) = mesh.bounds().unwrap_or_default();
        let below = low.y - 0.02 * (high.y - low.y);
        let found: Vec<([f64; VARIANTS.len()], f64)> = (0..POINTS * POINTS)
            .into_par_iter()
            .map(|index| {
                let place = Vec2::new((index % POINTS) as f32, (index / POINTS) as f32) + 0.5;
                let Vec2 { x, y } = place / POINTS as f32;
                let at = low + (high - low) * Vec3::new(x, 0.0, y);
                let origin = Vec3::new(at.x, below, at.z);
                let mut scratch = contours.scratch(&reference);
                let (visible, _) = contours.sample(origin, &reference, &mut scratch);
                let wrong = variants.each_ref().map(|variant| {
                    let distances = variant.distances(&contours, origin);
                    variant.wrong(&distances, &visible, &solid_angles)
                });
                (wrong, boundary_length(&visible, &solid_angles))
            })
            .collect();
        let length: f64 = found.iter().map(|(_, length)| length).sum();
        let mut row = vec![name.into()];
        for variant in 0..VARIANTS.len() {
            let wrong: f64 = found.iter().map(|(wrong, _)| wrong[variant]).sum();
            row.push((1e3 * wrong / length.max(f64::MIN_POSITIVE)).into());
        }
        table.rows.push(row);
    }
    section.tables.push(table);
    Ok(())
}
