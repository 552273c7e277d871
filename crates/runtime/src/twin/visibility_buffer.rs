//! Which triangle each pixel sees: a software rasteriser with the rules of a GPU's, so
//! that both agree on every pixel but for rounding at the last bit. Vertices snap to
//! 1/256 of a pixel, pixel centres are sampled, edges shared by two triangles belong to
//! one of them (top-left rule), back faces are culled, nearer depth wins.

use glam::{Vec3, Vec4};
use rayon::prelude::*;
use relight_format::Scene;
use relight_shading::camera::View;
use relight_shading::surfaces::{PATTERN, SAMPLES};

/// Steps per pixel that vertices snap to: 8 bits, what GPUs have.
const SUBPIXELS: i64 = 256;
/// Rows per parallel task.
const BAND: usize = 16;
/// Subpixel coordinates are clamped to ± this, so that edge functions fit 64 bits.
const MAX_COORDINATE: f32 = (1 << 29) as f32;

/// A triangle ready to be sampled.
struct Projected {
    /// What pixels that see it have.
    id: u32,
    /// Edge functions a x + b y + c in subpixels, positive inside; edge i is opposite to
    /// vertex i.
    edges: [[i64; 3]; 3],
    /// Depth at the vertices over twice the area.
    depth: Vec3,
    /// First and last column that may have samples inside.
    columns: [usize; 2],
    /// First and last row that may have samples inside.
    rows: [usize; 2],
}

/// For every pixel, row 0 first: index of the visible triangle + 1, or 0 on the background.
pub fn visibility_buffer(scene: &Scene, view: &View, width: u32, height: u32) -> Vec<u32> {
    let mut nearest = Nearest::new([width, height], &CENTRE);
    nearest.draw(scene, view, 1);
    nearest.ids
}

/// The middle of a pixel, in subpixels.
pub(super) const CENTRE: [[i64; 2]; 1] = [[SUBPIXELS / 2; 2]];

/// The samples of a pixel that shows several surfaces, in subpixels.
pub(super) fn pattern() -> [[i64; 2]; SAMPLES] {
    PATTERN.map(|at| at.map(|eighths| i64::from(eighths) * SUBPIXELS / 8))
}

/// What is nearest in every sample of every pixel.
pub(super) struct Nearest<'a> {
    size: [usize; 2],
    samples: &'a [[i64; 2]],
    pub(super) ids: Vec<u32>,
    /// Reversed; 0 on the background.
    pub(super) depths: Vec<f32>,
}

impl<'a> Nearest<'a> {
    /// `samples`: where they are in a pixel, in subpixels.
    pub(super) fn new(size: [u32; 2], samples: &'a [[i64; 2]]) -> Self {
        let size = size.map(|side| side as usize);
        let count = size[0] * size[1] * samples.len();
        Self {
            size,
            samples,
            ids: vec![0; count],
            depths: vec![0.0; count],
        }
    }

    /// Draws a scene whose first triangle has the id `first_id`.
    pub(super) fn draw(&mut self, scene: &Scene, view: &View, first_id: u32) {
        let projected = project_scene(scene, view, first_id, self.size);
        let row = self.size[0];
        let samples = self.samples;
        let texels = row * BAND * samples.len();
        (self.ids.par_chunks_mut(texels))
            .zip(self.depths.par_chunks_mut(texels))
            .enumerate()
            .for_each(|(band, (ids, depths))| {
                for triangle in &projected {
                    draw(triangle, band * BAND, row, samples, ids, depths);
                }
            });
    }
}

fn project_scene(scene: &Scene, view: &View, first_id: u32, size: [usize; 2]) -> Vec<Projected> {
    let clip: Vec<Vec4> = scene
        .vertices
        .par_iter()
        .map(|vertex| view.view_projection * Vec3::from(vertex.position).extend(1.0))
        .collect();
    scene
        .triangles
        .par_iter()
        .enumerate()
        .flat_map_iter(|(index, triangle)| {
            let polygon = clip_near(triangle.vertices.map(|vertex| clip[vertex as usize]));
            (2..polygon.len()).filter_map(move |i| {
                let mut corners = [polygon[0], polygon[i - 1], polygon[i]];
                if view.mirrored {
                    // Front faces turn the other way.
                    corners.swap(0, 2);
                }
                project(index as u32 + first_id, corners, size)
            })
        })
        .collect()
}

/// Cuts away what lies in front of the near plane: reversed depth z/w above 1.
fn clip_near(corners: [Vec4; 3]) -> Vec<Vec4> {
    let inside = |corner: Vec4| corner.w - corner.z;
    if corners.iter().all(|&corner| inside(corner) >= 0.0) {
        return corners.to_vec();
    }
    let mut polygon = Vec::with_capacity(4);
    for (from, to) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (corners[i], corners[j])) {
        let (a, b) = (inside(from), inside(to));
        if a >= 0.0 {
            polygon.push(from);
        }
        if (a >= 0.0) != (b >= 0.0) {
            polygon.push(from.lerp(to, a / (a - b)));
        }
    }
    polygon
}

/// `None` for triangles that face away, have no area or lie outside the image.
fn project(id: u32, corners: [Vec4; 3], [width, height]: [usize; 2]) -> Option<Projected> {
    let snap = |value: f32| {
        let steps = (value * SUBPIXELS as f32).clamp(-MAX_COORDINATE, MAX_COORDINATE);
        steps.round_ties_even() as i64
    };
    let points = corners.map(|corner| {
        let x = (corner.x / corner.w * 0.5 + 0.5) * width as f32;
        let y = (0.5 - corner.y / corner.w * 0.5) * height as f32;
        [snap(x), snap(y)]
    });
    let edges = [(1, 2), (2, 0), (0, 1)].map(|(i, j)| {
        let ([x0, y0], [x1, y1]) = (points[i], points[j]);
        // Rows count downwards, so this is positive left of an edge as seen.
        let (a, b) = (y1 - y0, x0 - x1);
        [a, b, -(a * x0 + b * y0)]
    });
    let [[x0, y0], ..] = points;
    let area = edges[0][0] * x0 + edges[0][1] * y0 + edges[0][2];
    if area <= 0 {
        return None;
    }
    // Pixel i reaches from i SUBPIXELS to (i + 1) SUBPIXELS.
    let range = |axis: usize, size: usize| {
        let values = points.map(|point| point[axis]);
        let first = values.into_iter().min()?.div_euclid(SUBPIXELS).max(0) as usize;
        let last = values.into_iter().max()?.div_euclid(SUBPIXELS);
        let last = usize::try_from(last).ok()?.min(size - 1);
        (first <= last).then_some([first, last])
    };
    Some(Projected {
        id,
        edges,
        depth: Vec3::from(corners.map(|corner| corner.z / corner.w)) / area as f32,
        columns: range(0, width)?,
        rows: range(1, height)?,
    })
}

/// Draws the rows from `first_row` on that `ids` and `depths` hold.
fn draw(
    triangle: &Projected,
    first_row: usize,
    width: usize,
    samples: &[[i64; 2]],
    ids: &mut [u32],
    depths: &mut [f32],
) {
    let end_row = first_row + ids.len() / (width * samples.len());
    let rows = triangle.rows[0].max(first_row)..(triangle.rows[1] + 1).min(end_row);
    for row in rows {
        for column in triangle.columns[0]..=triangle.columns[1] {
            let first = ((row - first_row) * width + column) * samples.len();
            for (index, [right, down]) in (first..).zip(samples) {
                let x = column as i64 * SUBPIXELS + right;
                let y = row as i64 * SUBPIXELS + down;
                let weights = triangle.edges.map(|[a, b, c]| a * x + b * y + c);
                let covered = weights
                    .iter()
                    .zip(&triangle.edges)
                    // A sample on an edge counts for left edges and for top ones.
                    .all(|(&weight, &[a, b, _])| {
                        weight > 0 || weight == 0 && (a > 0 || a == 0 && b > 0)
                    });
                let weights = Vec3::from(weights.map(|weight| weight as f32));
                let depth = triangle.depth.dot(weights);
                if covered && depth > depths[index] {
                    depths[index] = depth;
                    ids[index] = triangle.id;
                }
            }
        }
    }
}
