//! Colours of vertices -> a texture, so that they are what every other colour is: in the bake, in
//! pictures, for light that bounces.
//!
//! A triangle of one colour lies at the middle of a cell of 2 by 2 texels that hold it. Any other has a
//! cell of its own, with its corners at the middles of three texels; the fourth completes them to a
//! plane, on which bilinear interpolation is linear: the colours that the specification asks for.

use std::collections::HashMap;

use glam::Vec2;
use relight_format::{Texture, TextureEncoding, math};

use super::MAX_IMAGE_SIZE;
use crate::mesh::Vertex;

/// Cells per row.
const COLUMNS: u32 = 512;
/// Most cells.
const MAX_CELLS: usize = (COLUMNS * MAX_IMAGE_SIZE / 2) as usize;

/// A colour as textures have it.
type Texel = [u8; 3];

/// Linear reflectance to a texel.
pub(super) fn texel(linear: [f32; 3]) -> Texel {
    linear.map(|x| {
        let x = x.clamp(0.0, 1.0);
        let encoded = if x <= 0.003_130_8 {
            12.92 * x
        } else {
            1.055 * math::powf(x, 1.0 / 2.4) - 0.055
        };
        (encoded * 255.0).round() as u8
    })
}

/// sRGB, from 0 to 1, to linear.
pub(super) fn linear(x: f32) -> f32 {
    if x <= 0.040_45 {
        x / 12.92
    } else {
        math::powf((x + 0.055) / 1.055, 2.4)
    }
}

fn decoded(texel: Texel) -> [f32; 3] {
    texel.map(|x| linear(f32::from(x) / 255.0))
}

/// Cells of a texture of colours.
#[derive(Default)]
pub(super) struct Palette {
    known: HashMap<[Texel; 4], u32>,
    cells: Vec<[Texel; 4]>,
}

impl Palette {
    /// Gives vertices of these colours their places, in texels; copies those that triangles need
    /// at several. `None`, with nothing changed, if the texture has no room.
    pub(super) fn paint(
        &mut self,
        vertices: &mut Vec<Vertex>,
        triangles: &mut [[u32; 3]],
        colors: &[Texel],
    ) -> Option<()> {
        if self.cells.len() + triangles.len() > MAX_CELLS {
            return None;
        }
        let given = vertices.len();
        let mut placed = vec![None; given];
        let mut copies: HashMap<(u32, [u32; 2]), u32> = HashMap::new();
        for triangle in triangles {
            let places = self.places(triangle.map(|vertex| colors[vertex as usize]));
            for (vertex, place) in triangle.iter_mut().zip(places) {
                let key = place.to_array().map(f32::to_bits);
                let first = placed[*vertex as usize].get_or_insert(place);
                if *first != place {
                    let old = *vertex;
                    *vertex = *copies.entry((old, key)).or_insert_with(|| {
                        vertices.push(Vertex {
                            uv: place,
                            ..vertices[old as usize]
                        });
                        vertices.len() as u32 - 1
                    });
                }
            }
        }
        for (vertex, place) in vertices.iter_mut().zip(placed) {
            vertex.uv = place.unwrap_or(vertex.uv);
        }
        Some(())
    }

    /// Places of a triangle's corners.
    fn places(&mut self, corners: [Texel; 3]) -> [Vec2; 3] {
        if corners == [corners[0]; 3] {
            let middle = self.cell([corners[0]; 4]) + Vec2::ONE;
            return [middle; 3];
        }
        // The fourth texel may not be a colour; the corner across from it is chosen so that it is
        // as nearly one as can be.
        let fourth = |first: usize| {
            let [a, b, c] = [0, 1, 2].map(|k| decoded(corners[(first + k) % 3]));
            std::array::from_fn(|channel| b[channel] + c[channel] - a[channel])
        };
        let beyond =
            |color: [f32; 3]| -> f32 { color.iter().map(|x| (x - x.clamp(0.0, 1.0)).abs()).sum() };
        let first = (0..3)
            .min_by(|&a, &b| beyond(fourth(a)).total_cmp(&beyond(fourth(b))))
            .unwrap_or(0);
        let [a, b, c] = [0, 1, 2].map(|k| corners[(first + k) % 3]);
        let low = self.cell([a, b, c, texel(fourth(first))]) + 0.5;
        let mut places = [low, low + Vec2::X, low + Vec2::Y];
        places.rotate_right(first);
        places
    }

    /// Where a cell begins.
    fn cell(&mut self, texels: [Texel; 4]) -> Vec2 {
        let number = *self.known.entry(texels).or_insert_with(|| {
            self.cells.push(texels);
            self.cells.len() as u32 - 1
        });
        Vec2::new((number % COLUMNS) as f32, (number / COLUMNS) as f32) * 2.0
    }

    pub(super) fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// The texture. Its sides are those that places are to be divided by.
    pub(super) fn texture(&self) -> Texture {
        let rows = (self.cells.len() as u32).div_ceil(COLUMNS).max(1);
        let (width, height) = (2 * COLUMNS, 2 * rows);
        let mut texels = vec![u8::MAX; (width * height * 4) as usize];
        for (number, cell) in self.cells.iter().enumerate() {
            let number = number as u32;
            for (k, texel) in cell.iter().enumerate() {
                let [x, y] = [k as u32 % 2, k as u32 / 2];
                let at = (2 * (number / COLUMNS) + y) * width + 2 * (number % COLUMNS) + x;
                texels[4 * at as usize..][..3].copy_from_slice(texel);
            }
        }
        Texture {
            width,
            height,
            encoding: TextureEncoding::Srgb,
            texels,
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    #[test]
    fn colours_between_corners_are_linear() {
        let colors = [
            [255, 0, 0],
            [0, 200, 10],
            [30, 60, 90],
            [30, 60, 90],
            [30, 60, 90],
        ];
        let vertex = Vertex {
            position: Vec3::ZERO,
            normal: Vec3::Y,
            tangent: Vec3::X,
            bitangent_sign: 1.0,
            uv: Vec2::ZERO,
            second_uv: Vec2::ZERO,
        };
        let mut vertices = vec![vertex; 5];
        let mut triangles = vec![[0, 1, 2], [1, 0, 3], [2, 3, 4], [3, 4, 2]];
        let mut palette = Palette::default();
        let corners = triangles.clone();
        palette
            .paint(&mut vertices, &mut triangles, &colors)
            .expect("room for four");
        // Of the last two, which have one colour, no vertex is copied for the other.
        assert_eq!(
            triangles[2],
            [triangles[3][2], triangles[3][0], triangles[3][1]]
        );
        let texture = palette.texture();
        let at = |x: f32, y: f32| {
            let texel = |x: u32, y: u32| {
                let at = 4 * (y.min(texture.height - 1) * texture.width + x) as usize;
                Vec3::from(decoded([0, 1, 2].map(|k| texture.texels[at + k])))
            };
            let (x, y) = (x - 0.5, y - 0.5);
            let (s, t) = (x.fract(), y.fract());
            let (i, j) = (x as u32, y as u32);
            let row = |j| texel(i, j) * (1.0 - s) + texel(i + 1, j) * s;
            row(j) * (1.0 - t) + row(j + 1) * t
        };
        for (triangle, old) in triangles.iter().zip(corners) {
            for weights in [
                [1.0, 0.0, 0.0],
                [0.2, 0.5, 0.3],
                [0.0, 0.4, 0.6],
                [0.3, 0.3, 0.4],
            ] {
                let uv: Vec2 = (0..3)
                    .map(|k| vertices[triangle[k] as usize].uv * weights[k])
                    .sum();
                let expected: Vec3 = (0..3)
                    .map(|k| Vec3::from(decoded(colors[old[k] as usize])) * weights[k])
                    .sum();
                let found = at(uv.x, uv.y);
                // A quarter of what the fourth texel lacks, and bytes.
                assert!(found.distance(expected) < 0.02, "{found} {expected}");
            }
        }
    }

    #[test]
    fn texels_round_trip() {
        for x in 0..=255 {
            assert_eq!(texel(decoded([x; 3])), [x; 3]);
        }
    }
}
