//! Deterministic, well-distributed numbers.

/// A 32-bit hash of two numbers (PCG output function, O'Neill 2014).
pub fn hash(a: u32, b: u32) -> u32 {
    let mut x = a.wrapping_mul(0x9e37_79b9) ^ b.wrapping_mul(0x85eb_ca6b).rotate_left(16);
    x = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    x = ((x >> ((x >> 28) + 4)) ^ x).wrapping_mul(277_803_737);
    (x >> 22) ^ x
}

/// Uniform in [0, 1) from 32 random bits.
pub fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 / 16_777_216.0
}

/// Point `index` of the two-dimensional Sobol sequence, shuffled and Owen-scrambled by
/// `seed` (Burley 2020, "Practical Hash-based Owen Scrambling").
pub fn sobol_pair(index: u32, seed: u32) -> [f32; 2] {
    let index = nested_uniform(index.reverse_bits(), hash(seed, 0)).reverse_bits();
    // The second dimension's direction numbers are rows of Pascal's triangle modulo 2.
    let (mut second, mut direction) = (0u32, 1u32 << 31);
    for bit in 0..32 {
        if index >> bit & 1 == 1 {
            second ^= direction;
        }
        direction ^= direction >> 1;
    }
    [
        unit(nested_uniform_bits(index.reverse_bits(), hash(seed, 1))),
        unit(nested_uniform_bits(second, hash(seed, 2))),
    ]
}

/// Owen scrambling of the bits of `x`, most significant first.
fn nested_uniform_bits(x: u32, seed: u32) -> u32 {
    nested_uniform(x.reverse_bits(), seed).reverse_bits()
}

/// The Laine-Karras permutation with Burley's constants: every bit is flipped depending on
/// the bits below it alone.
fn nested_uniform(mut x: u32, seed: u32) -> u32 {
    x = x.wrapping_add(seed);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^ x.wrapping_mul(0x8d22_f6e6)
}

/// Point `index` of the R2 sequence (Roberts 2018), shifted by `seed` around the torus: any
/// run of successive points is evenly spread.
pub fn kronecker_pair(index: u32, seed: u32) -> [f32; 2] {
    // 1/ρ and 1/ρ² in 0.32 fixed point, ρ the real root of x³ = x + 1.
    const STEPS: [u32; 2] = [0xc13f_a9a9, 0x91e1_0da5];
    [0, 1].map(|i| {
        unit(
            index
                .wrapping_mul(STEPS[i])
                .wrapping_add(hash(seed, i as u32)),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest deviation of the share of points in boxes at the origin from their area.
    fn discrepancy(points: &[[f32; 2]]) -> f32 {
        let mut worst = 0f32;
        for i in 1..16 {
            for j in 1..16 {
                let corner = [i as f32 / 16.0, j as f32 / 16.0];
                let inside = points
                    .iter()
                    .filter(|p| p[0] < corner[0] && p[1] < corner[1]);
                let share = inside.count() as f32 / points.len() as f32;
                worst = worst.max((share - corner[0] * corner[1]).abs());
            }
        }
        worst
    }

    #[test]
    fn sequences_fill_the_square_evenly() {
        // Independent points would deviate by about 1/√256 = 0.06.
        for seed in 0..20 {
            let sobol: Vec<_> = (0..256).map(|i| sobol_pair(i, seed)).collect();
            assert!(discrepancy(&sobol) < 0.02, "{}", discrepancy(&sobol));
            let kronecker: Vec<_> = (999..999 + 256).map(|i| kronecker_pair(i, seed)).collect();
            assert!(
                discrepancy(&kronecker) < 0.03,
                "{}",
                discrepancy(&kronecker)
            );
        }
    }

    #[test]
    fn sobol_points_are_stratified_in_every_elementary_box() {
        for seed in 0..5 {
            for (columns, rows) in [(1, 64), (8, 8), (64, 1), (16, 4)] {
                let mut hit = [false; 64];
                for i in 0..64 {
                    let [x, y] = sobol_pair(i, seed);
                    hit[(x * columns as f32) as usize * rows + (y * rows as f32) as usize] = true;
                }
                assert!(hit.iter().all(|&hit| hit), "{columns}x{rows}, seed {seed}");
            }
        }
    }

    #[test]
    fn seeds_give_independent_means() {
        // The mean of first coordinates over many seeds at one index is that of uniforms.
        let mean = (0..4096).map(|seed| sobol_pair(3, seed)[0]).sum::<f32>() / 4096.0;
        // Four standard errors of 1/√(12·4096).
        assert!((mean - 0.5).abs() < 0.018, "{mean}");
    }
}
