//! Which surfaces a pixel shows, for pictures without stairs: four samples of visibility, and
//! every distinct surface among them shaded once.
//!
//! Samples show one surface where they are of one material and instance, their triangles lie
//! nearly in one plane, and one point in the other's. So a pixel within a
//! smooth surface is shaded once, however many triangles it shows, and a silhouette twice.

use glam::{Vec2, Vec3};

use crate::camera::View;
use crate::octahedral;

/// Samples of a pixel.
pub const SAMPLES: usize = 4;

/// Where they are in it, eighths of a pixel from its upper left corner: what WebGPU, Vulkan, Metal
/// and Direct3D call the standard pattern.
pub const PATTERN: [[u32; 2]; SAMPLES] = [[3, 1], [7, 3], [1, 5], [5, 7]];

/// Pixels per side of a tile.
pub const TILE: u32 = 8;

/// Surfaces of a tile's pixels beyond the first of each. Where there are more, those left
/// show the first of their pixel.
pub const EXTRAS: u32 = TILE * TILE / 2;

/// Least cosine between normals of one surface.
const LEAST_COSINE: f32 = 0.8;
/// Most distance from the other's plane, as a part of the distance from the other.
const MOST_SLOPE: f32 = 0.5;

/// A sample of visibility.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// The triangle; 0 on the background.
    pub id: u32,
    /// [`key`] of the triangle.
    pub key: u32,
    /// Reversed.
    pub depth: f32,
}

/// What is shaded once: a triangle, and the point of the image through which it is seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Item {
    /// The triangle; 0 if nothing.
    pub id: u32,
    /// Pixels from the upper left corner.
    pub at: Vec2,
}

/// Where a triangle lies and what it is made of: its unit normal, world space, in 16 bits, and 16
/// bits of anything that differs between materials and instances.
pub fn key(normal: Vec3, tag: u32) -> u32 {
    let at = octahedral::encode(normal) * 255.0 + 0.5;
    (at.x as u32) | (at.y as u32) << 8 | tag << 16
}

/// Anything that differs between materials and instances, mostly.
pub fn tag(material: u32, instance: u32) -> u32 {
    (material + instance * 0x9e37) & 0xffff
}

fn normal(key: u32) -> Vec3 {
    let at = Vec2::new((key & 255) as f32, (key >> 8 & 255) as f32) / 255.0;
    octahedral::decode(at).normalize()
}

/// Where sample `index` of a pixel is, pixels.
pub fn place([x, y]: [u32; 2], index: usize) -> Vec2 {
    let [right, down] = PATTERN[index];
    Vec2::new((8 * x + right) as f32, (8 * y + down) as f32) * 0.125
}

/// The point that a sample shows, world space.
fn point(view: &View, at: Vec2, depth: f32) -> Vec3 {
    let ray = view.ray(at);
    let [z, w] = [2, 3].map(|index| view.view_projection.row(index));
    let (origin, direction) = (ray.origin.extend(1.0), ray.direction.extend(0.0));
    let distance =
        (z.dot(origin) - depth * w.dot(origin)) / (depth * w.dot(direction) - z.dot(direction));
    ray.origin + distance * ray.direction
}

/// For every sample of a pixel the number of its surface, from 1 in the order of samples; 0 is
/// background. With it the sample that each surface was first seen by.
pub fn distinct(
    view: &View,
    pixel: [u32; 2],
    samples: &[Sample; SAMPLES],
) -> ([u32; SAMPLES], Vec<usize>) {
    let points: [Vec3; SAMPLES] =
        std::array::from_fn(|index| point(view, place(pixel, index), samples[index].depth));
    let (mut surfaces, mut first) = ([0; SAMPLES], Vec::new());
    for (index, sample) in samples.iter().enumerate() {
        if sample.id == 0 {
            continue;
        }
        let same = |&other: &usize| {
            let known = &samples[other];
            if known.id == sample.id {
                return true;
            }
            let (facing, between) = (normal(known.key), points[index] - points[other]);
            known.key >> 16 == sample.key >> 16
                && facing.dot(normal(sample.key)) >= LEAST_COSINE
                && facing.dot(between).abs() <= MOST_SLOPE * between.length()
        };
        let number = first.iter().position(same).unwrap_or_else(|| {
            first.push(index);
            first.len() - 1
        });
        surfaces[index] = number as u32 + 1;
    }
    (surfaces, first)
}

/// The surfaces of an image.
#[derive(Clone, Debug)]
pub struct Surfaces {
    /// What is shaded: the first of every pixel, row by row, and the others.
    pub items: Vec<Item>,
    /// For every sample of every pixel the item that it shows; `None` is background.
    pub shown: Vec<[Option<u32>; SAMPLES]>,
}

impl Surfaces {
    /// Those of `samples`, row by row, `width` per row, as `view` sees the world.
    pub fn new(view: &View, width: u32, samples: &[[Sample; SAMPLES]]) -> Self {
        let height = samples.len() as u32 / width.max(1);
        let mut items = vec![Item::default(); samples.len()];
        let mut shown = vec![[None; SAMPLES]; samples.len()];
        for top in (0..height).step_by(TILE as usize) {
            for left in (0..width).step_by(TILE as usize) {
                let mut extras = 0;
                for y in top..(top + TILE).min(height) {
                    for x in left..(left + TILE).min(width) {
                        let index = (y * width + x) as usize;
                        let (surfaces, first) = distinct(view, [x, y], &samples[index]);
                        let kept = (first.len() as u32).min(1 + EXTRAS - extras);
                        let base = items.len() as u32;
                        for (number, &sample) in (0..kept).zip(&first) {
                            let item = Item {
                                id: samples[index][sample].id,
                                at: place([x, y], sample),
                            };
                            if number == 0 {
                                items[index] = item;
                            } else {
                                items.push(item);
                            }
                        }
                        extras += kept.saturating_sub(1);
                        if samples[index]
                            .iter()
                            .all(|sample| sample.id == samples[index][0].id)
                        {
                            items[index].at = Vec2::new(x as f32, y as f32) + 0.5;
                        }
                        shown[index] = surfaces.map(|surface| match surface {
                            0 => None,
                            more if more > 1 && more <= kept => Some(base + more - 2),
                            _ => Some(index as u32),
                        });
                    }
                }
            }
        }
        Self { items, shown }
    }

    /// The image of what items are: the mean of every pixel's samples.
    pub fn resolve(&self, items: &[[f32; 4]]) -> Vec<[f32; 4]> {
        let pixel = |shown: &[Option<u32>; SAMPLES]| {
            let mut sum = glam::Vec4::ZERO;
            for &item in shown.iter().flatten() {
                sum += glam::Vec4::from(items[item as usize]);
            }
            (sum / SAMPLES as f32).to_array()
        };
        self.shown.iter().map(pixel).collect()
    }
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let pattern = PATTERN.map(|[x, y]| format!("vec2({x}u, {y}u)")).join(", ");
    format!(
        "const SURFACES_PATTERN = array<vec2<u32>, {SAMPLES}>({pattern});\n\
         const SURFACES_TILE: u32 = {TILE}u;\n\
         const SURFACES_EXTRAS: u32 = {EXTRAS}u;\n\
         const SURFACES_LEAST_COSINE: f32 = {LEAST_COSINE:?};\n\
         const SURFACES_MOST_SLOPE: f32 = {MOST_SLOPE:?};\n"
    )
}

#[cfg(test)]
mod tests {
    use relight_format::{Camera, FieldOfView};

    use super::*;

    fn view() -> View {
        let camera = Camera {
            position: [0.0, 0.0, 5.0],
            target: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            field_of_view: FieldOfView::Y(0.8),
        };
        View::new(&camera, 64, 64, 0.01)
    }

    /// The sample of a plane z = `height`, whatever its normal is said to be.
    fn sample(at: Vec2, height: f32, id: u32, key: u32) -> Sample {
        let ray = view().ray(at);
        let distance = (height - ray.origin.z) / ray.direction.z;
        let clip = view().view_projection * (ray.origin + distance * ray.direction).extend(1.0);
        let depth = clip.z / clip.w;
        Sample { id, key, depth }
    }

    #[test]
    fn points_are_found_again() {
        for index in 0..SAMPLES {
            let at = place([20, 45], index);
            let found = point(&view(), at, sample(at, -1.5, 1, 0).depth);
            assert!((found.z + 1.5).abs() < 1e-4, "{found}");
        }
    }

    #[test]
    fn keys_keep_normals() {
        for axis in [Vec3::Z, Vec3::NEG_Y, Vec3::new(0.3, -0.8, 0.5).normalize()] {
            let key = key(axis, 0x1234);
            assert!(normal(key).distance(axis) < 0.02 && key >> 16 == 0x1234);
        }
    }

    #[test]
    fn surfaces_are_told_apart() {
        let up = key(Vec3::Z, 0);
        let tilted = key(Vec3::new(0.2, 0.0, 1.0).normalize(), 0);
        let cases = [
            // One plane in four triangles; a slight edge; an edge; another material; a step; a hole.
            (
                [(0.0, 1, up), (0.0, 2, up), (0.0, 3, up), (0.0, 4, up)],
                [1, 1, 1, 1],
            ),
            (
                [(0.0, 1, up), (0.0, 2, tilted), (0.0, 1, up), (0.0, 1, up)],
                [1, 1, 1, 1],
            ),
            (
                [
                    (0.0, 1, up),
                    (0.0, 2, key(Vec3::X, 0)),
                    (0.0, 1, up),
                    (0.0, 1, up),
                ],
                [1, 2, 1, 1],
            ),
            (
                [
                    (0.0, 1, up),
                    (0.0, 2, key(Vec3::Z, 9)),
                    (0.0, 3, up),
                    (0.0, 2, up),
                ],
                [1, 2, 1, 1],
            ),
            (
                [(0.0, 1, up), (-0.5, 2, up), (-0.5, 3, up), (0.0, 1, up)],
                [1, 2, 2, 1],
            ),
            (
                [(0.0, 0, 0), (0.0, 1, up), (-0.5, 2, up), (-1.5, 3, up)],
                [0, 1, 2, 3],
            ),
        ];
        for (samples, expected) in cases {
            let mut index = 0;
            let samples = samples.map(|(height, id, key)| {
                index += 1;
                sample(place([30, 33], index - 1), height, id, key)
            });
            assert_eq!(distinct(&view(), [30, 33], &samples).0, expected);
        }
    }

    #[test]
    fn tiles_have_room_for_so_many_and_no_more() {
        let up = key(Vec3::Z, 0);
        let samples: Vec<[Sample; SAMPLES]> = (0..64)
            .map(|pixel| {
                let pixel = [pixel % 8, pixel / 8];
                std::array::from_fn(|index| {
                    let height = -0.5 * (index / 2) as f32;
                    sample(place(pixel, index), height, index as u32 / 2 + 1, up)
                })
            })
            .collect();
        let surfaces = Surfaces::new(&view(), 8, &samples);
        assert_eq!(surfaces.items.len(), 64 + EXTRAS as usize);
        let values: Vec<[f32; 4]> = surfaces
            .items
            .iter()
            .map(|item| [item.id as f32; 4])
            .collect();
        let means: Vec<f32> = surfaces
            .resolve(&values)
            .iter()
            .map(|mean| mean[0])
            .collect();
        assert!(means[..32].iter().all(|&mean| mean == 1.5), "{means:?}");
        assert!(means[32..].iter().all(|&mean| mean == 1.0), "{means:?}");
    }
}
