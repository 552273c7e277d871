//! Texels of textures as differences from what their neighbours predict, plane after plane.
//!
//! The prediction is the median of LOCO-I (Weinberger, Seroussi & Sapiro 2000, section III.A): textures have edges, at
//! which the linear one of basis images goes too far. Compressed, what is left takes about seven tenths of what texels
//! take, and the fastest level makes it as small as any.

use crate::material::TextureShape;
use crate::{Error, Issue, SectionKind, Texture};

/// Red, green, blue and alpha.
const PLANES: usize = 4;
type Texel = [u8; PLANES];

/// The version of the format from which on differences are stored.
const DIFFERENCES_SINCE: u32 = 5;

/// The section of some textures.
pub(crate) fn encode(textures: &[Texture]) -> Vec<u8> {
    let length = textures
        .iter()
        .map(|texture| 1 + texture.texels.len())
        .sum();
    let mut bytes = Vec::with_capacity(length);
    for texture in textures {
        let (texels, _) = texture.texels.as_chunks::<PLANES>();
        let differences = differences(texels, texture.width as usize);
        let less_green = |[red, green, blue, alpha]: Texel| {
            let [red, blue] = [red, blue].map(|own| own.wrapping_sub(green));
            [red, green, blue, alpha]
        };
        // Greys have the same differences in all planes, maps of normals each its own.
        let size = |of: &dyn Fn(Texel) -> Texel| -> u64 {
            let sizes = differences.iter().map(|&difference| {
                let [red, _, blue, _] = of(difference).map(|x| u64::from((x as i8).unsigned_abs()));
                red + blue
            });
            sizes.sum()
        };
        let by_green = size(&less_green) < size(&|difference| difference);
        bytes.push(u8::from(by_green));
        for plane in 0..PLANES {
            let stored = |difference: &Texel| {
                if by_green {
                    less_green(*difference)[plane]
                } else {
                    difference[plane]
                }
            };
            bytes.extend(differences.iter().map(stored));
        }
    }
    bytes
}

/// The inverse, of what a file of this version of the format has.
pub(crate) fn decode(
    shapes: &[TextureShape],
    bytes: &[u8],
    version: u32,
) -> Result<Vec<Texture>, Error> {
    let with_differences = version >= DIFFERENCES_SINCE;
    let mut left = bytes;
    let mut textures = Vec::new();
    for shape in shapes {
        let &TextureShape {
            width,
            height,
            encoding,
        } = shape;
        let number = textures.len();
        let ends_early = |left: &[u8]| {
            Error::section(
                Issue::BadLength,
                SectionKind::Texels,
                format_args!("{width}x{height} RGBA8 texels of texture {number}"),
                format_args!("{} of {} bytes left", left.len(), bytes.len()),
            )
        };
        let mut by_green = false;
        if with_differences {
            let (flag, rest) = left.split_first().ok_or_else(|| ends_early(left))?;
            by_green = match flag {
                0 => false,
                1 => true,
                other => {
                    return Err(Error::section(
                        Issue::ValueOutOfRange,
                        SectionKind::Texels,
                        format_args!("0 or 1 before texture {number}"),
                        other,
                    ));
                }
            };
            left = rest;
        }
        let split = texel_bytes(width, height).and_then(|length| left.split_at_checked(length));
        let (own, rest) = split.ok_or_else(|| ends_early(left))?;
        left = rest;
        textures.push(Texture {
            width,
            height,
            encoding,
            texels: if with_differences {
                sums(own, width as usize, by_green)
            } else {
                own.to_vec()
            },
        });
    }
    if left.is_empty() {
        Ok(textures)
    } else {
        Err(Error::section(
            Issue::BadLength,
            SectionKind::Texels,
            format_args!("{} bytes", bytes.len() - left.len()),
            format_args!("{} bytes", bytes.len()),
        ))
    }
}

/// Bytes of an RGBA8 image, or `None` if it has none or too many to address.
pub(crate) fn texel_bytes(width: u32, height: u32) -> Option<usize> {
    // Two 32-bit factors and a 4 can exceed even 64 bits.
    let bytes = u64::from(width)
        .checked_mul(u64::from(height))?
        .checked_mul(PLANES as u64)?;
    usize::try_from(bytes).ok().filter(|bytes| *bytes > 0)
}

/// Each texel less what those before it predict.
fn differences(texels: &[Texel], width: usize) -> Vec<Texel> {
    let mut differences = Vec::with_capacity(texels.len());
    let outside = vec![[0; PLANES]; width];
    let mut above = &outside[..];
    for row in texels.chunks_exact(width.max(1)) {
        let (mut left, mut corner) = ([0; PLANES], [0; PLANES]);
        for (texel, above) in row.iter().zip(above) {
            differences.push(std::array::from_fn(|plane| {
                texel[plane].wrapping_sub(median(left[plane], above[plane], corner[plane]))
            }));
            (left, corner) = (*texel, *above);
        }
        above = row;
    }
    differences
}

/// Texels of a `width` that is not 0, from their planes of differences.
fn sums(planes: &[u8], width: usize, by_green: bool) -> Vec<u8> {
    let count = planes.len() / PLANES;
    let mut texels: Vec<Texel> = vec![[0; PLANES]; count];
    let planes: [&[u8]; PLANES] = std::array::from_fn(|plane| &planes[plane * count..][..count]);
    let outside = vec![[0; PLANES]; width.min(count)];
    for row in 0..count / width {
        let (before, from_here) = texels.split_at_mut(row * width);
        let above = match before.len().checked_sub(width) {
            Some(start) => &before[start..],
            None => &outside,
        };
        let planes = planes.map(|plane| &plane[row * width..][..width]);
        let (mut left, mut corner) = ([0; PLANES], [0; PLANES]);
        for (x, (texel, above)) in from_here.iter_mut().zip(above).enumerate() {
            let mut difference = planes.map(|plane| plane[x]);
            if by_green {
                difference[0] = difference[0].wrapping_add(difference[1]);
                difference[2] = difference[2].wrapping_add(difference[1]);
            }
            *texel = std::array::from_fn(|plane| {
                difference[plane].wrapping_add(median(left[plane], above[plane], corner[plane]))
            });
            (left, corner) = (*texel, *above);
        }
    }
    texels.into_flattened()
}

/// The median of the texel to the left, the one above, and what continues both: left plus above less the one between.
#[inline(always)]
fn median(left: u8, above: u8, corner: u8) -> u8 {
    let [left, above, corner] = [left, above, corner].map(i16::from);
    (left + above - corner).clamp(left.min(above), left.max(above)) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TextureEncoding;

    fn texture([width, height]: [u32; 2], texel: impl Fn(u32, u32) -> Texel) -> Texture {
        let at = |i: u32| texel(i % width, i / width);
        Texture {
            width,
            height,
            encoding: TextureEncoding::Linear,
            texels: (0..width * height).flat_map(at).collect(),
        }
    }

    #[test]
    fn textures_come_back() {
        let noise = |x: u32, y: u32| (x * 7919).wrapping_add(y * 104_729 * (x + 1)).to_le_bytes();
        let grey = |x: u32, y: u32| [(3 * x + y * y / 9) as u8; 4];
        let mut textures = Vec::new();
        for size in [[1, 1], [1, 9], [9, 1], [13, 8], [64, 64]] {
            textures.extend([texture(size, noise), texture(size, grey)]);
        }
        let stored = encode(&textures);
        let shapes: Vec<_> = textures.iter().map(Texture::shape).collect();
        let version = crate::VERSION;
        assert!(decode(&shapes, &stored, version).unwrap() == textures);
        // Version 4 had them as they are.
        let plain: Vec<u8> = (textures.iter())
            .flat_map(|texture| texture.texels.iter().copied())
            .collect();
        assert!(decode(&shapes, &plain, 4).unwrap() == textures);
    }

    #[test]
    fn edges_and_greys_leave_little() {
        // Squares of eight texels, in greys that differ by far, and in colours whose channels have nothing in common.
        let tile = |x: u32, y: u32| (37 * (x / 8) + 91 * (y / 8)) as u8;
        let grey = texture([64, 64], |x, y| [tile(x, y); 4]);
        let other = |x: u32, y: u32| [tile(x, 0), tile(0, y), 0, 255];
        let colored = texture([64, 64], other);
        for (texture, by_green) in [(grey, 1), (colored, 0)] {
            let stored = encode(&[texture]);
            assert_eq!(stored[0], by_green);
            let left = stored[1..].iter().filter(|byte| **byte != 0).count();
            assert!(left < 4 * 64 * 64 / 5, "{left}");
        }
    }
}
