//! Textures of materials: levels from fine to coarse, where they lie on the GPU, and what a pixel
//! sees of them.
//!
//! A pixel sees the part of a texture that its square covers on the surface: an ellipse in texels (Heckbert
//! 1989, section 3). Up to [`TAPS`] points along its longer axis are looked up, each between two levels whose
//! texels are as wide as the rest (Williams 1983; the taps as in `EXT_texture_filter_anisotropic`). Texels that
//! are wider than pixels are interpolated and nothing else.
//!
//! Weights are computed, here and in `wgsl/textures.wgsl` by the same arithmetic: samplers of GPUs round
//! them to 8 bits and choose taps as they like, and would need an array for each size of texture, of which WebGPU has
//! 16 in all. On the GPU all levels of all textures lie in the layers of one texture of 32-bit words, decoded as
//! they are read, so that every GPU and the CPU see the same.

use std::sync::OnceLock;

use glam::{Vec2, Vec3, Vec4};
use relight_format::math;
use relight_format::{Scene, Texture, TextureEncoding, TextureShape, TextureSlot, Vertex};

use crate::camera::View;
use crate::gpu::LimitError;

/// Exponent of a ratio's texel that multiplies its bytes by 1.
pub(crate) const RGBE_BIAS: i32 = 136;
/// Most points of one level that are looked up for a pixel.
pub const TAPS: f32 = 8.0;
/// Most points of an app's image that are averaged for a texel, per side.
const MOST_TAPS: u32 = 16;
/// Most layers of the texture that holds them: places have six bits for it.
pub const MAX_LAYERS: u32 = 1 << (32 - 2 * SIDE_BITS);
/// Longest side of a layer and of a texture: WebGPU's default limit.
pub const MAX_SIDE: u32 = 1 << SIDE_BITS;
/// Of a place, for each of column and row.
const SIDE_BITS: u32 = 13;
/// Most texture coordinates that a pixel may cover: far beyond, squares overflow.
const WIDEST: f32 = 1e3;

/// Of [`crate::gpu::TextureSlot::flags`]: red, green and blue are sRGB encoded.
pub const SRGB: u32 = 1;
/// Of the same: looked up by vertices' second texture coordinates.
pub const SECOND_UV: u32 = 2;

/// The texture of half the width and height; nothing below one texel and for tables.
///
/// Colours are averaged as light. Of a side of odd length three texels go into one, by their shares of it.
pub fn coarser(texture: &Texture) -> Option<Texture> {
    let (width, height) = (texture.width, texture.height);
    if (width, height) == (1, 1) || texture.encoding == TextureEncoding::Rgbe {
        return None;
    }
    let srgb = texture.encoding == TextureEncoding::Srgb;
    let (columns, rows) = ((width / 2).max(1), (height / 2).max(1));
    let mut texels = Vec::with_capacity(4 * columns as usize * rows as usize);
    for row in 0..rows {
        let rows = shares(height, row);
        for column in 0..columns {
            let columns = shares(width, column);
            let mut sum = [0.0f32; 4];
            for &(y, weight_y) in rows.iter().filter(|share| share.1 > 0.0) {
                for &(x, weight_x) in columns.iter().filter(|share| share.1 > 0.0) {
                    let first = 4 * (y as usize * width as usize + x as usize);
                    let bytes = &texture.texels[first..first + 4];
                    for (channel, (sum, &byte)) in sum.iter_mut().zip(bytes).enumerate() {
                        let value = if srgb && channel < 3 {
                            light_of()[usize::from(byte)]
                        } else {
                            f32::from(byte) / 255.0
                        };
                        *sum += weight_x * weight_y * value;
                    }
                }
            }
            texels.extend((0..).zip(sum).map(|(channel, value)| {
                if srgb && channel < 3 {
                    nearest_code()[(value * (CODES - 1) as f32 + 0.5) as usize]
                } else {
                    (value * 255.0 + 0.5) as u8
                }
            }));
        }
    }
    Some(Texture {
        width: columns,
        height: rows,
        encoding: texture.encoding,
        texels,
    })
}

/// The texels of a side of `length` that texel `index` of half as many covers, and their weights.
fn shares(length: u32, index: u32) -> [(u32, f32); 3] {
    let first = 2 * index;
    match (length, length % 2) {
        (1, _) => [(0, 1.0), (0, 0.0), (0, 0.0)],
        (_, 0) => [(first, 0.5), (first + 1, 0.5), (0, 0.0)],
        _ => {
            let half = length / 2;
            let share = |part: u32| part as f32 / length as f32;
            [
                (first, share(half - index)),
                (first + 1, share(half)),
                (first + 2, share(index + 1)),
            ]
        }
    }
}

/// Steps in which light is looked up for its code: a fifth of the narrowest code's width.
const CODES: usize = 1 << 14;

/// Light of every sRGB code.
fn light_of() -> &'static [f32; 256] {
    static LIGHT: OnceLock<[f32; 256]> = OnceLock::new();
    LIGHT.get_or_init(|| std::array::from_fn(|code| decode_srgb(code as f32 / 255.0)))
}

/// The sRGB code whose light is nearest.
fn nearest_code() -> &'static [u8] {
    static CODE: OnceLock<Vec<u8>> = OnceLock::new();
    CODE.get_or_init(|| {
        let mut code = 0;
        let nearest = |step: usize| {
            let light = step as f32 / (CODES - 1) as f32;
            let between = |code: usize| 0.5 * (light_of()[code] + light_of()[code + 1]);
            while code < 255 && light > between(code) {
                code += 1;
            }
            code as u8
        };
        (0..CODES).map(nearest).collect()
    })
}

/// IEC 61966-2-1.
pub(crate) fn decode_srgb(encoded: f32) -> f32 {
    if encoded <= 0.040_45 {
        encoded / 12.92
    } else {
        math::powf((encoded + 0.055) / 1.055, 2.4)
    }
}

/// Levels of a texture, itself included.
pub fn level_count(shape: TextureShape) -> u32 {
    match shape.encoding {
        TextureEncoding::Rgbe => 1,
        _ => 1 + shape.width.max(shape.height).max(1).ilog2(),
    }
}

/// The coarser levels of a scene's textures, each made when it is first looked at.
#[derive(Debug, Default)]
pub struct Mipmaps {
    levels: Vec<OnceLock<Vec<Texture>>>,
}

impl Mipmaps {
    /// Of the textures of a scene, and of no others.
    pub fn new(scene: &Scene) -> Self {
        Self {
            levels: scene.textures.iter().map(|_| OnceLock::new()).collect(),
        }
    }

    /// Level `level` of a texture, which has it.
    fn level<'a>(&'a self, scene: &'a Scene, texture: u32, level: u32) -> &'a Texture {
        let finest = &scene.textures[texture as usize];
        if level == 0 {
            return finest;
        }
        let levels = self.levels[texture as usize].get_or_init(|| {
            let mut levels: Vec<Texture> = Vec::new();
            while let Some(next) = coarser(levels.last().unwrap_or(finest)) {
                levels.push(next);
            }
            levels
        });
        &levels[level as usize - 1]
    }
}

/// What textures are seen through; without, they are looked up at a point.
#[derive(Clone, Copy, Debug)]
pub struct Filter<'a> {
    /// Whose pixels.
    pub view: &'a View,
    /// Of the scene.
    pub mipmaps: &'a Mipmaps,
}

/// How far vertices' texture coordinates go from one pixel to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// From column to column.
    pub x: Vec2,
    /// From row to row.
    pub y: Vec2,
}

impl Footprint {
    /// A point.
    pub const NONE: Self = Self {
        x: Vec2::ZERO,
        y: Vec2::ZERO,
    };

    /// At a `position` on a triangle, of texture coordinates of its corners.
    pub fn new(view: &View, corners: [&Vertex; 3], uvs: [Vec2; 3], position: Vec3) -> Self {
        let [pa, pb, pc] = corners.map(|vertex| Vec3::from(vertex.position));
        let (ab, ac) = (pb - pa, pc - pa);
        let normal = ab.cross(ac);
        let area = normal.length_squared();
        let Some(steps) = view.steps(normal, position) else {
            return Self::NONE;
        };
        if area == 0.0 {
            return Self::NONE;
        }
        let (uv_b, uv_c) = (uvs[1] - uvs[0], uvs[2] - uvs[0]);
        let along = |step: Vec3| {
            let to_b = normal.dot(step.cross(ac)) / area;
            let to_c = normal.dot(ab.cross(step)) / area;
            (to_b * uv_b + to_c * uv_c).clamp(Vec2::splat(-WIDEST), Vec2::splat(WIDEST))
        };
        let [x, y] = steps.map(along);
        Self { x, y }
    }
}

/// A point of a triangle by one of its pairs of texture coordinates: where textures are looked up, and through what.
#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    uv: Vec2,
    filter: Option<(&'a Mipmaps, Footprint)>,
}

impl<'a> Place<'a> {
    /// At `barycentrics`, which are those of `position`; by the second pair where the scene has it, or by the first.
    pub(crate) fn new(
        scene: &Scene,
        corners: [u32; 3],
        (barycentrics, position): (Vec3, Vec3),
        filter: Option<Filter<'a>>,
        second: bool,
    ) -> Self {
        let vertices = corners.map(|vertex| &scene.vertices[vertex as usize]);
        let uvs = if second {
            corners.map(|vertex| Vec2::from(scene.second_uvs[vertex as usize]))
        } else {
            vertices.map(|vertex| Vec2::from(vertex.uv))
        };
        Self {
            uv: uvs[0] * barycentrics.x + uvs[1] * barycentrics.y + uvs[2] * barycentrics.z,
            filter: filter.map(|filter| {
                let footprint = Footprint::new(filter.view, vertices, uvs, position);
                (filter.mipmaps, footprint)
            }),
        }
    }
}

/// Which points of which levels a footprint takes, in texture coordinates.
struct Taps {
    count: u32,
    first: Vec2,
    step: Vec2,
    level: u32,
    /// Of the next level.
    fraction: f32,
}

impl Taps {
    /// `x` and `y` are sides of a pixel in texels.
    fn new(uv: Vec2, [x, y]: [Vec2; 2], size: Vec2, levels: u32) -> Self {
        // Squares of the ellipse about the unit circle's image.
        let p = x.x * x.x + y.x * y.x;
        let q = x.x * x.y + y.x * y.y;
        let r = x.y * x.y + y.y * y.y;
        let difference = 0.5 * (p - r);
        let root = (difference * difference + q * q).sqrt();
        let longest = (0.5 * (p + r) + root).sqrt();
        let shortest = (x.x * y.y - x.y * y.x).abs() / longest.max(1e-20);
        let count = (longest / shortest.max(1.0) + 0.5).floor().clamp(1.0, TAPS);
        let level = math::log2((longest / count).max(1.0)).min((levels - 1) as f32);
        let axis = if difference >= 0.0 {
            Vec2::new(difference + root, q)
        } else {
            Vec2::new(q, root - difference)
        };
        let step = axis * (longest / count / axis.length().max(1e-20)) / size;
        Self {
            count: count as u32,
            first: uv - step * (0.5 * (count - 1.0)),
            step,
            level: level as u32,
            fraction: level - level.floor(),
        }
    }
}

/// RGBA of a texture slot at vertices' texture coordinates, unfiltered.
pub fn sample_point(textures: &[Texture], slot: &TextureSlot, uv: Vec2) -> Vec4 {
    bilinear(&textures[slot.texture as usize], transformed(slot, uv))
}

/// Vertices' texture coordinates -> those of a slot's texture.
fn transformed(slot: &TextureSlot, uv: Vec2) -> Vec2 {
    let [row_u, row_v] = slot.transform.map(Vec3::from);
    Vec2::new(row_u.dot(uv.extend(1.0)), row_v.dot(uv.extend(1.0)))
}

/// RGBA of a texture slot at a place by its pair of texture coordinates.
pub(crate) fn sample(scene: &Scene, slot: &TextureSlot, place: Place) -> Vec4 {
    let Some((mipmaps, footprint)) = place.filter else {
        return sample_point(&scene.textures, slot, place.uv);
    };
    let texture = &scene.textures[slot.texture as usize];
    let uv = transformed(slot, place.uv);
    let [row_u, row_v] = slot.transform.map(Vec3::from);
    let size = Vec2::new(texture.width as f32, texture.height as f32);
    let side =
        |side: Vec2| Vec2::new(row_u.truncate().dot(side), row_v.truncate().dot(side)) * size;
    let sides = [side(footprint.x), side(footprint.y)];
    let taps = Taps::new(uv, sides, size, level_count(texture.shape()));
    let mut sum = Vec4::ZERO;
    let levels = if taps.fraction > 0.0 { 2 } else { 1 };
    for index in 0..taps.count * levels * 2 {
        let (tap, above) = (index / 2 / levels, index / 2 % levels);
        let weight = if above == 0 {
            1.0 - taps.fraction
        } else {
            taps.fraction
        };
        let level = mipmaps.level(scene, slot.texture, taps.level + above);
        sum += weight * row(level, taps.first + tap as f32 * taps.step, index % 2);
    }
    sum / taps.count as f32
}

fn bilinear(texture: &Texture, uv: Vec2) -> Vec4 {
    row(texture, uv, 0) + row(texture, uv, 1)
}

/// One of the two rows around a point, times its part in what is interpolated there.
fn row(texture: &Texture, uv: Vec2, row: u32) -> Vec4 {
    let size = Vec2::new(texture.width as f32, texture.height as f32);
    // In texels from the first texel's centre, -½ to N - ½.
    let p = (uv - uv.floor()) * size - 0.5;
    let low = p.floor();
    let f = p - low;
    // Adding N makes the first operand of the remainder positive.
    let x0 = (low.x as i32 + texture.width as i32) as u32 % texture.width;
    let y = ((low.y as i32 + texture.height as i32) as u32 + row) % texture.height;
    let x1 = (x0 + 1) % texture.width;
    let weight = if row == 0 { 1.0 - f.y } else { f.y };
    weight * texel(texture, x0, y).lerp(texel(texture, x1, y), f.x)
}

/// Ward 1991, "Real pixels", without the half that is added to each byte there.
pub fn decode_rgbe([r, g, b, exponent]: [u8; 4]) -> Vec3 {
    // 2 to the power of exponent - RGBE_BIAS, which may be less than the least normal f32. Not by powi, a call with a loop:
    // measured reflections read eight texels for every direction.
    let bits = (i64::from(exponent) - i64::from(RGBE_BIAS) + 1023) as u64;
    let scale = f64::from_bits(bits << 52) as f32;
    Vec3::new(f32::from(r), f32::from(g), f32::from(b)) * scale
}

fn texel(texture: &Texture, x: u32, y: u32) -> Vec4 {
    let start = (y as usize * texture.width as usize + x as usize) * 4;
    let bytes: [u8; 4] = std::array::from_fn(|channel| texture.texels[start + channel]);
    match texture.encoding {
        TextureEncoding::Linear => Vec4::from(bytes.map(f32::from)) / 255.0,
        TextureEncoding::Rgbe => decode_rgbe(bytes).extend(1.0),
        TextureEncoding::Srgb => {
            let [red, green, blue, alpha] = bytes.map(usize::from);
            let light = light_of();
            Vec4::new(light[red], light[green], light[blue], alpha as f32 / 255.0)
        }
    }
}

/// Size of the texture that holds all levels of a scene's textures, a 32-bit word each (red in the low
/// byte).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageLayout {
    /// Texels per row of a layer.
    pub width: u32,
    /// Rows of a layer.
    pub height: u32,
    /// Layers.
    pub layers: u32,
}

impl PageLayout {
    /// What the texture takes of memory.
    pub fn bytes(&self) -> u64 {
        4 * u64::from(self.width) * u64::from(self.height) * u64::from(self.layers)
    }
}

/// Where the levels of one texture lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PackedTexture {
    /// First texel: column | row << 13 | layer << 26.
    pub place: u32,
    /// The same of level 1. The others stand to its right, one above the other.
    pub coarser: u32,
    /// Its size and the meaning of its bytes.
    pub shape: TextureShape,
}

impl PackedTexture {
    /// Column, row and layer of the first texel of a level, and its width and height.
    pub fn level(&self, level: u32) -> ([u32; 3], [u32; 2]) {
        let side = |length: u32, level: u32| (length >> level).max(1);
        let size = [self.shape.width, self.shape.height].map(|length| side(length, level));
        let place = if level == 0 { self.place } else { self.coarser };
        let mask = MAX_SIDE - 1;
        let [mut x, mut y] = [place & mask, (place >> SIDE_BITS) & mask];
        if level > 1 {
            let [columns, rows] = Self::beside(self.shape, level);
            x += columns;
            y += rows;
        }
        ([x, y, place >> (2 * SIDE_BITS)], size)
    }

    /// Every level of the texture that it was made for: its first texel as in [`Self::level`], and its
    /// texels, row after row. Ends with the first error.
    pub fn visit<E>(
        &self,
        texture: &Texture,
        mut visit: impl FnMut([u32; 3], &Texture) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut made: Option<Texture> = None;
        for level in 0..level_count(self.shape) {
            if level > 0 {
                made = coarser(made.as_ref().unwrap_or(texture));
            }
            let texture = if level == 0 {
                Some(texture)
            } else {
                made.as_ref()
            };
            if let Some(texture) = texture {
                visit(self.level(level).0, texture)?;
            }
        }
        Ok(())
    }

    /// The two rectangles that it takes: the finest level, and the others if there are any.
    fn rectangles(shape: TextureShape) -> [[u32; 2]; 2] {
        let finest = [shape.width, shape.height];
        let levels = level_count(shape);
        if levels == 1 {
            return [finest, [0; 2]];
        }
        let side = |length: u32, level: u32| (length >> level).max(1);
        let [mut width, mut height] = [shape.width, shape.height].map(|length| side(length, 1));
        if levels > 2 {
            let [columns, rows] = Self::beside(shape, levels - 1);
            width = columns + side(shape.width, 2);
            height = height.max(rows + 1);
        }
        [finest, [width, height]]
    }

    /// From level 1 to `level`, which is coarser: columns to the right, and rows. Each of those between takes
    /// as many rows as it has or more, in all as many as half of a power of two.
    fn beside(shape: TextureShape, level: u32) -> [u32; 2] {
        let (width, height) = (shape.width, shape.height);
        // Up to this level one row is half of two.
        let halvings = height.ilog2().max(1) + 1;
        let rows = (height >> 1) - (height >> (level - 1)) + level.saturating_sub(halvings);
        [(width >> 1).max(1), rows]
    }
}

/// Finds places for textures of these shapes, in layers of the size that wastes least.
pub fn place(shapes: &[TextureShape]) -> Result<(PageLayout, Vec<PackedTexture>), LimitError> {
    let mut rectangles: Vec<([u32; 2], usize)> = (shapes.iter())
        .flat_map(|&shape| PackedTexture::rectangles(shape))
        .zip(0..)
        .collect();
    let longest = (rectangles.iter().flat_map(|(size, _)| size))
        .copied()
        .max()
        .unwrap_or(1);
    let most = u64::from(MAX_SIDE);
    LimitError::check("max_texture_dimension_2d", u64::from(longest), most)?;
    rectangles.retain(|&([width, height], _)| width > 0 && height > 0);
    // Tallest first: what is placed on a shelf is no taller than it.
    rectangles
        .sort_by_key(|&([width, height], index)| (u32::MAX - height, u32::MAX - width, index));
    let sides = (0..=SIDE_BITS).flat_map(|bits| [1 << bits, 3 << bits]);
    let shelved = sides
        .filter(|side| (longest..=MAX_SIDE).contains(side))
        .map(|side| shelve(&rectangles, side))
        .min_by_key(|(layout, _)| (layout.bytes(), layout.layers));
    let (layout, places) = shelved.expect("the longest side there may be is among them");
    LimitError::check(
        "layers of textures",
        u64::from(layout.layers),
        u64::from(MAX_LAYERS),
    )?;
    let mut packed: Vec<PackedTexture> = (shapes.iter())
        .map(|&shape| PackedTexture {
            place: 0,
            coarser: 0,
            shape,
        })
        .collect();
    for ((_, index), [x, y, layer]) in rectangles.iter().zip(places) {
        let place = x | (y << SIDE_BITS) | (layer << (2 * SIDE_BITS));
        let texture = &mut packed[index / 2];
        if index % 2 == 0 {
            texture.place = place;
        } else {
            texture.coarser = place;
        }
    }
    Ok((layout, packed))
}

/// Column, row and layer of rectangles, the tallest first, on the first shelf that has room.
fn shelve(rectangles: &[([u32; 2], usize)], side: u32) -> (PageLayout, Vec<[u32; 3]>) {
    struct Shelf {
        row: u32,
        layer: u32,
        used: u32,
    }
    let mut shelves: Vec<Shelf> = Vec::new();
    let (mut free_row, mut layers, mut height) = (0, 1, 1);
    let mut places = Vec::with_capacity(rectangles.len());
    for &([width, rows], _) in rectangles {
        let shelf = shelves.iter().position(|shelf| side - shelf.used >= width);
        let shelf = shelf.unwrap_or_else(|| {
            if side - free_row < rows {
                (free_row, layers) = (0, layers + 1);
            }
            shelves.push(Shelf {
                row: free_row,
                layer: layers - 1,
                used: 0,
            });
            free_row += rows;
            height = height.max(free_row);
            shelves.len() - 1
        });
        let shelf = &mut shelves[shelf];
        places.push([shelf.used, shelf.row, shelf.layer]);
        shelf.used += width;
    }
    let layout = PageLayout {
        width: side,
        height,
        layers,
    };
    (layout, places)
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!(
        "const TEXTURES_SRGB: u32 = {SRGB}u;\n\
         const TEXTURES_SECOND_UV: u32 = {SECOND_UV}u;\n\
         const TEXTURES_TAPS: f32 = {TAPS:?};\n\
         const TEXTURES_SIDE_BITS: u32 = {SIDE_BITS}u;\n\
         const TEXTURES_WIDEST: f32 = {WIDEST:?};\n\
         const TEXTURES_MOST_TAPS: u32 = {MOST_TAPS}u;\n",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(width: u32, height: u32, encoding: TextureEncoding) -> Texture {
        let byte = |i: u32| (i.wrapping_mul(2_654_435_761) >> 13) as u8;
        Texture {
            width,
            height,
            encoding,
            texels: (0..4 * width * height).map(byte).collect(),
        }
    }

    /// Mean of a channel as light.
    fn mean(texture: &Texture, channel: usize) -> f64 {
        let pixels = texture.texels.chunks_exact(4);
        let value = |pixel: &[u8]| match texture.encoding {
            TextureEncoding::Srgb if channel < 3 => {
                f64::from(light_of()[usize::from(pixel[channel])])
            }
            _ => f64::from(pixel[channel]) / 255.0,
        };
        pixels.map(value).sum::<f64>() / f64::from(texture.width * texture.height)
    }

    #[test]
    fn levels_keep_the_light() {
        for (width, height) in [(64, 64), (37, 50), (1, 29), (130, 1), (2, 2)] {
            for encoding in [TextureEncoding::Linear, TextureEncoding::Srgb] {
                let finest = texture(width, height, encoding);
                let mut levels = vec![finest.clone()];
                while let Some(next) = coarser(levels.last().expect("the finest")) {
                    levels.push(next);
                }
                assert_eq!(levels.len() as u32, level_count(finest.shape()));
                let last = levels.last().expect("one");
                assert_eq!((last.width, last.height), (1, 1));
                for level in &levels {
                    for channel in 0..4 {
                        let off = (mean(level, channel) - mean(&finest, channel)).abs();
                        // A rounding of each level to its nearest code.
                        assert!(off < 0.012, "{width} × {height} {encoding:?}: {off}");
                    }
                }
            }
        }
        assert!(coarser(&texture(4, 4, TextureEncoding::Rgbe)).is_none());
    }

    #[test]
    fn codes_come_back() {
        for (code, &light) in light_of().iter().enumerate() {
            let step = (light * (CODES - 1) as f32 + 0.5) as usize;
            assert_eq!(usize::from(nearest_code()[step]), code);
        }
    }

    #[test]
    fn places_do_not_overlap() {
        let shape = |width, height, encoding| TextureShape {
            width,
            height,
            encoding,
        };
        let mut shapes: Vec<_> = (0..40u32)
            .map(|i| {
                shape(
                    1 + i * 37 % 300,
                    1 + i * i * 13 % 500,
                    TextureEncoding::Srgb,
                )
            })
            .collect();
        shapes.push(shape(32, 1024, TextureEncoding::Rgbe));
        let (layout, packed) = place(&shapes).expect("fits");
        let [width, height, layers] = [layout.width, layout.height, layout.layers];
        let mut taken = vec![false; (width * height * layers) as usize];
        for packed in &packed {
            for level in 0..level_count(packed.shape) {
                let ([x, y, layer], [columns, rows]) = packed.level(level);
                assert!(x + columns <= width && y + rows <= height && layer < layers);
                for row in y..y + rows {
                    let first = ((layer * height + row) * width + x) as usize;
                    for texel in &mut taken[first..first + columns as usize] {
                        assert!(!std::mem::replace(texel, true), "{packed:?}, level {level}");
                    }
                }
            }
        }
        let used = taken.iter().filter(|&&taken| taken).count();
        assert!(2 * used > taken.len(), "{used} of {}", taken.len());
    }

    #[test]
    fn fifteen_large_maps_fit_and_waste_little() {
        let map = TextureShape {
            width: 2048,
            height: 2048,
            encoding: TextureEncoding::Srgb,
        };
        let (layout, _) = place(&[map; 15]).expect("fits");
        let finest = 15 * 4 * 2048 * 2048;
        println!("{layout:?}: {} of {finest}", layout.bytes());
        assert!(layout.bytes() * 10 < finest * 17, "{layout:?}");
        let wide = TextureShape {
            width: 16_384,
            ..map
        };
        let error = place(&[wide]).expect_err("wider than WebGPU allows");
        assert_eq!((error.needed, error.allowed), (16_384, 8192));
        assert_eq!(place(&[]).expect("nothing").0.bytes(), 4);
    }

    /// A pixel of a plane seen from above and from the side covers so many texels, and taps lie along
    /// the longer side.
    #[test]
    fn footprints_are_those_of_pixels() {
        let corner = |x: f32, z: f32| Vertex {
            position: [x, 0.0, z],
            normal: [0.0, 1.0, 0.0],
            tangent: [1.0, 0.0, 0.0, 1.0],
            uv: [x, z],
        };
        let corners = [corner(0.0, 0.0), corner(0.0, 1.0), corner(1.0, 0.0)];
        let corners = [&corners[0], &corners[1], &corners[2]];
        let camera = relight_format::Camera {
            position: [0.3, 0.2, 5.0],
            target: [0.3, 0.0, 0.3],
            up: [0.0, 1.0, 0.0],
            field_of_view: relight_format::FieldOfView::Y(0.3),
        };
        let view = View::new(&camera, 100, 80, 0.01);
        let uv = |at: Vec2| {
            let ray = view.ray(at);
            let hit = ray.origin - ray.direction * (ray.origin.y / ray.direction.y);
            Vec2::new(hit.x, hit.z)
        };
        let at = Vec2::new(53.0, 61.0);
        let place = uv(at);
        let position = Vec3::new(place.x, 0.0, place.y);
        let found = Footprint::new(
            &view,
            corners,
            corners.map(|corner| corner.uv.into()),
            position,
        );
        let step = 0.05;
        for (found, side) in [(found.x, Vec2::X), (found.y, Vec2::Y)] {
            let expected = (uv(at + step * side) - uv(at - step * side)) / (2.0 * step);
            assert!(
                found.distance(expected) < 0.01 * expected.length(),
                "{found} {expected}"
            );
        }
        let size = Vec2::splat(1024.0);
        let taps = Taps::new(place, [found.x * size, found.y * size], size, 11);
        assert_eq!(taps.count, 8);
        assert!(taps.step.y.abs() > 20.0 * taps.step.x.abs());
        let middle = taps.first + 0.5 * (taps.count - 1) as f32 * taps.step;
        assert!(middle.distance(place) < 1e-5);
        let one = Taps::new(place, [Vec2::X, Vec2::Y], size, 11);
        assert_eq!((one.count, one.level, one.fraction), (1, 0, 0.0));
    }
}
