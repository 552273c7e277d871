//! Visibility of the sphere of directions from a point: one bit per octahedral texel.

mod arrange;
pub(crate) mod clutter;
pub(crate) mod contour;
pub(crate) mod places;
pub(crate) mod ray;
pub(crate) mod sparse;
mod wide;

use glam::Vec3;
use relight_shading::octahedral;

use crate::visibility::ray::RayCaster;
pub use arrange::arrange;

/// The directions of an octahedral map's texel centres, row after row.
#[derive(Debug)]
pub struct Directions {
    resolution: u32,
    directions: Vec<Vec3>,
}

impl Directions {
    /// Texel centres of a `resolution` × `resolution` map.
    pub fn new(resolution: u32) -> Self {
        let directions = (0..resolution * resolution)
            .map(|i| octahedral::texel_direction(i % resolution, i / resolution, resolution))
            .collect();
        Self {
            resolution,
            directions,
        }
    }

    /// Texels per side.
    pub(crate) fn resolution(&self) -> u32 {
        self.resolution
    }

    /// All directions, unit length.
    pub fn as_slice(&self) -> &[Vec3] {
        &self.directions
    }
}

/// One bit per texel, row after row: set where the direction is visible.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bitmap {
    words: Vec<u64>,
}

impl Bitmap {
    /// A bitmap of `texels` texels, set where `visible` says so.
    pub(crate) fn from_fn(texels: usize, mut visible: impl FnMut(usize) -> bool) -> Self {
        let words = (0..texels.div_ceil(64))
            .map(|word| {
                let bits = 64.min(texels - word * 64);
                (0..bits).fold(0, |bits, bit| {
                    bits | u64::from(visible(word * 64 + bit)) << bit
                })
            })
            .collect();
        Self { words }
    }

    /// A bitmap set where an element equals `value`.
    #[inline(always)]
    pub(crate) fn equal(elements: &[i32], value: i32) -> Self {
        let words = elements
            .chunks(64)
            .map(|elements| {
                let mut bits = [0; 64];
                for (bit, element) in bits.iter_mut().zip(elements) {
                    *bit = u8::from(*element == value);
                }
                pack_bits(&bits)
            })
            .collect();
        Self { words }
    }

    /// Calls back for every link between neighbours within the map, `n` texels to a row, that
    /// differ: column and row of the first texel, and whether the other lies below it and not
    /// to its right. Those of 4 × 4 texels follow each other.
    #[inline(always)]
    pub(crate) fn for_links(&self, n: usize, mut call: impl FnMut(usize, usize, bool)) {
        const SIDE: usize = 4;
        for (top, left) in (0..n)
            .step_by(SIDE)
            .flat_map(|y| (0..n).step_by(64).map(move |x| (y, x)))
        {
            let columns = |count: usize| if count < 64 { (1 << count) - 1 } else { !0 };
            let (own, with_next) = (columns(n - left), columns(n - 1 - left));
            // To the right, then below.
            let mut differing = [0; 2 * SIDE];
            for y in 0..SIDE.min(n - top) {
                let start = (top + y) * n + left;
                let bits = self.bits(start);
                differing[y] = (bits ^ self.bits(start + 1)) & with_next;
                if top + y + 1 < n {
                    differing[SIDE + y] = (bits ^ self.bits(start + n)) & own;
                }
            }
            let mut some = differing.iter().fold(0, |some, row| some | row);
            while some != 0 {
                let first = some.trailing_zeros() as usize / SIDE * SIDE;
                some &= !(0xf << first);
                let rows = differing.iter().enumerate();
                let links = rows.fold(0, |links, (row, bits)| {
                    links | (bits >> first & 0xf) << (SIDE * row)
                });
                for link in ones(links) {
                    let (x, y) = (link % SIDE, link / SIDE);
                    call(left + first + x, top + y % SIDE, y >= SIDE);
                }
            }
        }
    }

    /// The 64 bits from `start` on; zeros beyond the end.
    #[inline(always)]
    pub(crate) fn bits(&self, start: usize) -> u64 {
        let word = |index: usize| self.words.get(index).copied().unwrap_or(0);
        let (index, shift) = (start / 64, start % 64);
        if shift == 0 {
            word(index)
        } else {
            word(index) >> shift | word(index + 1) << (64 - shift)
        }
    }

    /// Unsets those that `keep`, asked for each that is set, does not want.
    pub(crate) fn retain(&mut self, mut keep: impl FnMut(usize) -> bool) {
        for (index, word) in self.words.iter_mut().enumerate() {
            for bit in ones(*word) {
                *word &= !(u64::from(!keep(64 * index + bit)) << bit);
            }
        }
    }

    /// Texels that are set, in order.
    #[inline(always)]
    pub(crate) fn set_texels(&self) -> impl Iterator<Item = usize> {
        let words = self.words.iter().enumerate();
        words.flat_map(|(index, word)| ones(*word).map(move |bit| 64 * index + bit))
    }

    /// Takes from `other` what is set in `mask`.
    pub(crate) fn replace(&mut self, mask: &Self, other: &Self) {
        for (own, (mask, other)) in self
            .words
            .iter_mut()
            .zip(mask.words.iter().zip(&other.words))
        {
            *own = *own & !mask | other & mask;
        }
    }

    /// Unsets all.
    pub(crate) fn clear(&mut self) {
        self.words.fill(0);
    }

    /// Sets whether the direction of texel `index` is visible.
    #[inline(always)]
    pub(crate) fn set(&mut self, index: usize, visible: bool) {
        let bit = 1 << (index % 64);
        let word = &mut self.words[index / 64];
        *word = if visible { *word | bit } else { *word & !bit };
    }

    /// Whether the direction of texel `index` is visible.
    pub fn get(&self, index: usize) -> bool {
        self.words[index / 64] >> (index % 64) & 1 == 1
    }
}

/// Where contours cross the links between neighbouring sample texels of different class.
#[derive(Debug, Default)]
pub struct Crossings {
    /// Per link between texels of different class, from its first texel to the other, 0 to 1, or 0 to −1 if the first is the
    /// visible one; NaN where no contour was found. The links to the right of every texel are followed by
    /// those to the texel below. Empty if nothing is known.
    pub(crate) positions: Vec<f32>,
}

impl Crossings {
    /// On a link, 0 to 1: midway where no contour was found.
    pub(crate) fn position(&self, link: usize) -> f32 {
        match self.positions.get(link) {
            Some(position) if !position.is_nan() => position.abs(),
            _ => 0.5,
        }
    }
}

/// Numbers of the set bits.
#[inline(always)]
pub(crate) fn ones(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = (word != 0).then(|| word.trailing_zeros() as usize);
        word &= word.wrapping_sub(1);
        bit
    })
}

/// A word of the lowest bits of up to 64 bytes, a multiple of 8.
#[inline(always)]
pub(crate) fn pack_bits<const COUNT: usize>(bits: &[u8; COUNT]) -> u64 {
    let mut word = 0;
    for (byte, eight) in bits.as_chunks::<8>().0.iter().enumerate() {
        // Gathers the lowest bit of each byte into the top byte.
        let eight = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        word |= eight << (8 * byte);
    }
    word
}

/// Casts one ray per texel from `origin`. Directions below the tangent plane are traced
/// like any other: the horizon of the shading normal is applied when shading.
pub fn sample(caster: &RayCaster, origin: Vec3, directions: &Directions) -> Bitmap {
    let directions = directions.as_slice();
    Bitmap::from_fn(directions.len(), |index| {
        !caster.any_hit(origin, directions[index])
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Deterministic numbers in [0, 1).
    pub(crate) fn random(state: &mut u64) -> f32 {
        *state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*state >> 40) as f32 / (1u64 << 24) as f32
    }

    #[test]
    fn a_large_plane_blocks_exactly_the_lower_hemisphere() {
        let s = 1e5;
        let [a, b, c, d] = [[-s, -s], [-s, s], [s, s], [s, -s]].map(|[x, z]| Vec3::new(x, 0.0, z));
        let caster = RayCaster::new(&[[a, b, c], [a, c, d]]);
        let directions = Directions::new(32);
        let bitmap = sample(&caster, Vec3::new(0.3, 0.01, -0.2), &directions);
        for (index, direction) in directions.as_slice().iter().enumerate() {
            assert_eq!(
                bitmap.get(index),
                direction.y >= 0.0,
                "direction {direction}"
            );
        }
    }
}
