//! Basis images as differences from what their neighbours predict: smooth images leave
//! little, which compresses to half of the images themselves.
//!
//! The prediction is linear, by weights that least squares found for the images of real
//! scenes: what is left takes a tenth less than after the median of LOCO-I (Weinberger,
//! Seroussi & Sapiro 2000). In memory images lie as GPUs sample them, four to a texel;
//! differences lie image after image.

use crate::CHANNELS_PER_TILE;

/// Differences of every image of `basis`, tiles of `resolution`² texels. Bytes that are not
/// whole tiles stay as they are.
pub(crate) fn differences(basis: &[i8], resolution: u32) -> Vec<i8> {
    let Some((n, texels)) = sizes(resolution) else {
        return basis.to_vec();
    };
    let mut differences = basis.to_vec();
    let tiles = basis.chunks_exact(texels * CHANNELS_PER_TILE);
    let stored = differences.chunks_exact_mut(texels * CHANNELS_PER_TILE);
    for (tile, stored) in tiles.zip(stored) {
        let (tile, _) = tile.as_chunks::<CHANNELS_PER_TILE>();
        for texel in 0..texels {
            let predicted = predict(tile, texel, n);
            for (channel, predicted) in predicted.into_iter().enumerate() {
                stored[channel * texels + texel] = tile[texel][channel].wrapping_sub(predicted);
            }
        }
    }
    differences
}

/// The inverse of [`differences`].
pub(crate) fn sums(differences: Vec<i8>, resolution: u32) -> Vec<i8> {
    let Some((n, texels)) = sizes(resolution) else {
        return differences;
    };
    let mut basis = differences;
    // Not before there is a tile: the resolution may be a lie.
    if basis.len() < texels * CHANNELS_PER_TILE {
        return basis;
    }
    let mut stored = vec![0i8; texels * CHANNELS_PER_TILE];
    for tile in basis.chunks_exact_mut(texels * CHANNELS_PER_TILE) {
        stored.copy_from_slice(tile);
        let (tile, _) = tile.as_chunks_mut::<CHANNELS_PER_TILE>();
        for texel in 0..texels {
            let predicted = predict(tile, texel, n);
            tile[texel] = std::array::from_fn(|channel| {
                predicted[channel].wrapping_add(stored[channel * texels + texel])
            });
        }
    }
    basis
}

/// Texels of a row and of an image; none if a tile exceeds any memory.
fn sizes(resolution: u32) -> Option<(usize, usize)> {
    let n = usize::try_from(resolution).ok().filter(|n| *n > 0)?;
    let texels = n.checked_mul(n)?;
    texels.checked_mul(CHANNELS_PER_TILE)?;
    Some((n, texels))
}

/// What the texels before it, row by row, make of a texel of images of `n` texels a row.
#[inline(always)]
pub fn predict<const IMAGES: usize>(
    images: &[[i8; IMAGES]],
    texel: usize,
    n: usize,
) -> [i8; IMAGES] {
    let Some(texels) = predicted_from([texel % n, texel / n], n) else {
        return [0; IMAGES];
    };
    let texels = texels.map(|texel| images[texel]);
    std::array::from_fn(|image| predicted(texels.map(|texel| texel[image])))
}

/// The texels that one at a column and row of an image of `n` texels a row is predicted from, as [`predicted`] takes
/// them; the first from none.
#[inline(always)]
fn predicted_from([x, y]: [usize; 2], n: usize) -> Option<[usize; 6]> {
    let texel = y * n + x;
    let at = |left: usize, up: usize| texel - left - up * n;
    // Those outside are taken to be as their neighbours.
    let left = match (x, y) {
        (0, 0) => return None,
        (0, _) => at(0, 1),
        _ => at(1, 0),
    };
    let above = if y > 0 { at(0, 1) } else { left };
    let corner = match (x, y) {
        (_, 0) => left,
        (0, _) => above,
        _ => at(1, 1),
    };
    let right = if y > 0 && x + 1 < n {
        texel + 1 - n
    } else {
        above
    };
    let left_left = if x > 1 { at(2, 0) } else { left };
    let above_above = if y > 1 { at(0, 2) } else { above };
    Some([left, above, right, corner, left_left, above_above])
}

/// What a texel is predicted to be by those to the left of it, above, above to the right and to the left, and those two to
/// the left and above.
#[inline(always)]
fn predicted(texels: [i8; 6]) -> i8 {
    let [left, above, right, corner, left_left, above_above] = texels.map(i32::from);
    let sum = 12 * left + 6 * above + 6 * right - corner - 2 * left_left - 5 * above_above;
    ((sum + 8) >> 4).clamp(-127, 127) as i8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;

    #[test]
    fn images_come_back() {
        let mut state = 5u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as i8
        };
        for (resolution, tiles, rest) in [(1, 3, 0), (2, 1, 3), (5, 2, 0), (8, 3, 17), (0, 0, 9)] {
            let length = (resolution * resolution) as usize * CHANNELS_PER_TILE * tiles + rest;
            let basis: Vec<i8> = (0..length).map(|_| random()).collect();
            assert_eq!(sums(differences(&basis, resolution), resolution), basis);
        }
        let few = vec![1, 2, 3];
        assert_eq!(sums(few.clone(), u32::MAX), few);
    }

    #[test]
    fn smooth_images_leave_little() {
        let n = 32;
        let basis: Vec<i8> = (0..n * n * 4)
            .map(|i| {
                let (x, y) = (i / 4 % n, i / 4 / n);
                (60.0 * (math::sin(x as f32 * 0.1) + math::cos(y as f32 * 0.07 + (i % 4) as f32)))
                    as i8
            })
            .collect();
        let large = differences(&basis, n as u32)
            .iter()
            .filter(|difference| difference.unsigned_abs() > 4)
            .count();
        assert!(large < basis.len() / 20, "{large} of {}", basis.len());
    }
}
