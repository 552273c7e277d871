//! Three integrals of spherical Gaussians that have no closed form, tabulated over
//! sharpness and one angle. Shared, value for value, with the GPU as the buffer `tables`.
//!
//! The values are embedded (`tables.bin`); the tests compute them, in `f64`, and
//! `RELIGHT_UPDATE_TABLES=1 cargo test --release -p relight-shading tables` writes them anew.
//!
//! Rows run over t = λ / (λ + HALF), which covers every λ from 0 to ∞. Columns run over a
//! chord or sine scaled by `max(1, √(λ / WIDE))`: from λ = WIDE on the column axis shrinks
//! with the lobe, so that a table sees the same shape at every sharpness. Entries are
//! scaled by (λ + SCALE)^1.5, which leaves them of order 1 in every row.

use relight_format::math;
use std::f32::consts::PI;
use std::sync::OnceLock;

use crate::spherical_gaussian::first_moment;

/// Intervals between rows. A multiple of four, so that the kink of the column axis at
/// λ = `WIDE` falls on a row.
pub const ROWS: usize = 48;
/// Intervals between columns.
pub const COLUMNS: usize = 64;
/// Sharpness from which the column axis shrinks with the lobe.
pub const WIDE: f32 = 16.0;
/// Added to the sharpness before the power of 1.5 that entries are scaled by.
pub const SCALE: f32 = 2.0;
/// Sharpness at the middle row.
pub const HALF: f32 = WIDE / 3.0;

/// Floats in one table.
const LENGTH: usize = (ROWS + 1) * (COLUMNS + 1);
/// First value of each table.
const SINE_SQUARED: usize = 0;
const BELOW_HORIZON: usize = LENGTH;
const FRACTION: usize = 2 * LENGTH;

/// All values, little-endian `f32`: the tables of this module, then those of
/// [`brdf`](crate::brdf::table_values).
static EMBEDDED: &[u8] = include_bytes!("tables.bin");

fn embedded() -> &'static [f32] {
    static VALUES: OnceLock<Vec<f32>> = OnceLock::new();
    VALUES.get_or_init(|| {
        let values = EMBEDDED.as_chunks::<4>().0.iter();
        values.map(|bytes| f32::from_le_bytes(*bytes)).collect()
    })
}

/// What follows the tables of this module.
pub(crate) fn others() -> &'static [f32] {
    &embedded()[3 * LENGTH..]
}

/// The tables.
pub struct Tables {
    values: &'static [f32],
}

impl Tables {
    /// The tables.
    pub fn get() -> &'static Self {
        static TABLES: OnceLock<Tables> = OnceLock::new();
        TABLES.get_or_init(|| Self {
            values: &embedded()[..3 * LENGTH],
        })
    }

    /// All values: the beginning of the GPU buffer `tables`.
    pub fn values(&self) -> &[f32] {
        self.values
    }

    /// g₂ = ∫₀^θ exp(λ(cos t − 1)) sin² t dt, with `half_chord` = sin(θ/2) in 0..=1.
    pub fn sine_squared_moment(&self, sharpness: f32, half_chord: f32) -> f32 {
        self.lookup(SINE_SQUARED, sharpness, half_chord) / scale(sharpness)
    }

    /// ∫ exp(λ(p·ω − 1)) max(n·ω, 0) dω, with `cosine` = n·p.
    ///
    /// The parts above and below the horizon differ by n·p times the first moment, in
    /// closed form; the table holds the smaller one.
    pub fn cosine_integral(&self, sharpness: f32, cosine: f32) -> f32 {
        let below = self.lookup(BELOW_HORIZON, sharpness, cosine.abs()) / scale(sharpness);
        cosine.max(0.0) * first_moment(sharpness) + below
    }

    /// The fraction of the lobe's integral inside a half-space whose bounding great circle
    /// is at the signed angular distance `distance` from the axis, + inside, radians,
    /// clamped to ±π/2.
    pub fn hemisphere_fraction(&self, sharpness: f32, distance: f32) -> f32 {
        let sine = math::sin(distance.clamp(-0.5 * PI, 0.5 * PI));
        let tail = self.lookup(FRACTION, sharpness, sine.abs());
        if sine > 0.0 { 1.0 - tail } else { tail }
    }

    /// Bilinear interpolation; `x` in 0..=1 before scaling, clamped to the last column.
    fn lookup(&self, table: usize, sharpness: f32, x: f32) -> f32 {
        let row = sharpness / (sharpness + HALF) * ROWS as f32;
        let column = x * (sharpness / WIDE).sqrt().max(1.0) * COLUMNS as f32;
        let i = (row as usize).min(ROWS - 1);
        let j = (column as usize).min(COLUMNS - 1);
        let u = (row - i as f32).min(1.0);
        let v = (column - j as f32).min(1.0);
        let first = table + i * (COLUMNS + 1) + j;
        let second = first + COLUMNS + 1;
        let a = self.values[first] + v * (self.values[first + 1] - self.values[first]);
        let b = self.values[second] + v * (self.values[second + 1] - self.values[second]);
        a + u * (b - a)
    }
}

fn scale(sharpness: f32) -> f32 {
    let base = sharpness + SCALE;
    base * base.sqrt()
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!(
        "const TABLES_ROWS: u32 = {ROWS}u;\n\
         const TABLES_COLUMNS: u32 = {COLUMNS}u;\n\
         const TABLES_WIDE: f32 = {WIDE:?};\n\
         const TABLES_HALF: f32 = {HALF:?};\n\
         const TABLES_SCALE: f32 = {SCALE:?};\n\
         const TABLES_SINE_SQUARED: u32 = {SINE_SQUARED}u;\n\
         const TABLES_BELOW_HORIZON: u32 = {BELOW_HORIZON}u;\n\
         const TABLES_FRACTION: u32 = {FRACTION}u;\n"
    )
}

/// Stands for an infinite sharpness in the last row: its lobe is flat to `f64` precision.
#[cfg(test)]
const INFINITE: f64 = 1e10;

/// The tables from their integrals.
#[cfg(test)]
fn compute() -> Vec<f32> {
    let mut values = vec![0.0; 3 * LENGTH];
    for row in 0..=ROWS {
        let t = row as f64 / ROWS as f64;
        let sharpness = (f64::from(HALF) * t / (1.0 - t)).min(INFINITE);
        let zoom = (sharpness / f64::from(WIDE)).sqrt().max(1.0);
        let scale = math::powf(sharpness + f64::from(SCALE), 1.5);
        let total = quadrature::energy(sharpness);
        let mut sine_squared = 0.0;
        for column in 0..=COLUMNS {
            let x = |column: usize| column as f64 / COLUMNS as f64 / zoom;
            let index = row * (COLUMNS + 1) + column;
            if column > 0 {
                sine_squared += quadrature::sine_squared(sharpness, x(column - 1), x(column));
            }
            values[SINE_SQUARED + index] = (scale * sine_squared) as f32;
            let (below, cosine_below) = quadrature::below_horizon(sharpness, x(column));
            values[BELOW_HORIZON + index] = (scale * cosine_below) as f32;
            values[FRACTION + index] = (below / total) as f32;
        }
    }
    values
}

/// The integrals behind the tables, in `f64`.
#[cfg(test)]
mod quadrature {
    use relight_format::math;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// ∫ exp(λ(p·ω − 1)) dω.
    pub fn energy(sharpness: f64) -> f64 {
        if sharpness == 0.0 {
            return 4.0 * PI;
        }
        -2.0 * PI * math::exp_m1(-2.0 * sharpness) / sharpness
    }

    /// ∫ exp(λ(cos t − 1)) sin² t dt between sin(t/2) = `from` and `to`. With u = sin(t/2)
    /// = sin v the integrand is exp(−2λu²) 8 u² cos² v dv.
    pub fn sine_squared(sharpness: f64, from: f64, to: f64) -> f64 {
        gauss(math::asin(from), math::asin(to.min(1.0)), |v| {
            let u = math::sin(v);
            8.0 * math::exp(-2.0 * sharpness * u * u) * (u * math::cos(v)).powi(2)
        })
    }

    /// ∫ exp(λ(p·ω − 1)) {1, −n·ω} dω over n·ω < 0, with n·p = `sine` ≥ 0. Rings of
    /// constant depression β under the horizon integrate to a Bessel function I₀.
    pub fn below_horizon(sharpness: f64, sine: f64) -> (f64, f64) {
        let alpha = math::asin(sine.min(1.0));
        let ring = |beta: f64| {
            let chord = math::sin(0.5 * (alpha + beta));
            let cosine = math::cos(beta);
            let exponent = -2.0 * sharpness * chord * chord;
            2.0 * PI
                * cosine
                * math::exp(exponent)
                * bessel_i0e(sharpness * math::cos(alpha) * cosine)
        };
        // exp(−½ reach²) is below f32's smallest step relative to the lobe's peak.
        let reach = 7.0;
        let end = (reach / sharpness.sqrt()).min(FRAC_PI_2);
        let middle = 0.35 * end;
        let sum = |f: &dyn Fn(f64) -> f64| gauss(0.0, middle, f) + gauss(middle, end, f);
        (sum(&ring), sum(&|beta| ring(beta) * math::sin(beta)))
    }

    /// exp(−|x|) I₀(x) (Abramowitz & Stegun 1964, 9.8.1 and 9.8.2; relative error 2e-7).
    fn bessel_i0e(x: f64) -> f64 {
        let horner = |t: f64, c: &[f64]| c.iter().rev().fold(0.0, |sum, c| sum * t + c);
        if x < 3.75 {
            let c = [
                1.0,
                3.515_622_9,
                3.089_942_4,
                1.206_749_2,
                0.265_973_2,
                0.036_076_8,
                0.004_581_3,
            ];
            return math::exp(-x) * horner((x / 3.75).powi(2), &c);
        }
        let c = [
            0.398_942_28,
            0.013_285_92,
            0.002_253_19,
            -0.001_575_65,
            0.009_162_81,
            -0.020_577_06,
            0.026_355_37,
            -0.016_476_33,
            0.003_923_77,
        ];
        horner(3.75 / x, &c) / x.sqrt()
    }

    /// Eight-point Gauss–Legendre quadrature.
    fn gauss(from: f64, to: f64, f: impl Fn(f64) -> f64) -> f64 {
        const NODES: [(f64, f64); 4] = [
            (0.183_434_642_495_649_8, 0.362_683_783_378_362),
            (0.525_532_409_916_329, 0.313_706_645_877_887_3),
            (0.796_666_477_413_626_7, 0.222_381_034_453_374_48),
            (0.960_289_856_497_536_3, 0.101_228_536_290_376_26),
        ];
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let pair = |&(x, w): &(f64, f64)| w * (f(middle - half * x) + f(middle + half * x));
        half * NODES.iter().map(pair).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What other processors and mathematical libraries may round differently, as a part of
    /// values of about 1.
    const ROUNDING: f32 = 1e-5;

    #[test]
    fn embedded_values_are_those_computed() {
        let mut computed = compute();
        computed.extend(crate::brdf::compute_table_values());
        if std::env::var_os("RELIGHT_UPDATE_TABLES").is_some() {
            let path = concat!(env!("CARGO_MANIFEST_DIR"), "/src/tables.bin");
            let bytes: Vec<u8> = computed.iter().flat_map(|x| x.to_le_bytes()).collect();
            std::fs::write(path, bytes).expect("a writable source folder");
            return;
        }
        assert_eq!(EMBEDDED.len(), 4 * computed.len());
        for (index, (embedded, computed)) in embedded().iter().zip(&computed).enumerate() {
            assert!(
                (embedded - computed).abs() <= ROUNDING * computed.abs().max(1.0),
                "value {index} is {embedded}, computed {computed}: see this module's heading"
            );
        }
    }

    /// Largest error of a lookup as a fraction of the lobe's integral over the sphere (for
    /// the fraction itself: absolute).
    const TOLERANCE: f64 = 1e-3;

    /// Midpoint rule with many points: slow and unlike the quadrature under test.
    fn midpoint(from: f64, to: f64, f: impl Fn(f64) -> f64) -> f64 {
        let n = 500;
        let step = (to - from) / f64::from(n);
        (0..n)
            .map(|i| f(from + (f64::from(i) + 0.5) * step))
            .sum::<f64>()
            * step
    }

    /// Sharpnesses from 2⁻⁶ to 2¹⁸, denser than the rows, and the extremes.
    fn sharpnesses() -> impl Iterator<Item = f32> {
        (-24..=72)
            .map(|i| math::powf(2f32, i as f32 / 4.0))
            .chain([0.0, 1e-6, 1e7])
    }

    #[test]
    fn sine_squared_moment_matches_quadrature() {
        let mut worst = 0f64;
        for sharpness in sharpnesses() {
            let lambda = f64::from(sharpness);
            let reach = (8.0 / lambda.sqrt()).min(2.0) * 0.5;
            for i in 0..=50 {
                let half_chord = reach * f64::from(i) / 50.0;
                let exact = midpoint(0.0, 2.0 * math::asin(half_chord), |t| {
                    math::exp(-2.0 * lambda * math::sin(0.5 * t).powi(2)) * math::sin(t).powi(2)
                });
                let found = Tables::get().sine_squared_moment(sharpness, half_chord as f32);
                let energy = quadrature::energy(lambda) / (2.0 * std::f64::consts::PI);
                let error = (f64::from(found) - exact).abs() / energy;
                worst = worst.max(error);
            }
        }
        println!("sine_squared_moment: worst error {worst:.2e} of the lobe's energy");
        assert!(worst < TOLERANCE);
    }

    #[test]
    fn cosine_integral_and_fraction_match_quadrature() {
        let mut worst = [0f64; 2];
        for sharpness in sharpnesses() {
            let lambda = f64::from(sharpness);
            let width = (1.0 / lambda.sqrt()).min(1.0);
            for i in -24..=24 {
                let elevation = (f64::from(i) / 24.0 * 5.0 * width).clamp(-1.5, 1.5);
                let [energy, inside, cosine] = hemisphere(lambda, elevation);
                let tables = Tables::get();
                let found = tables.cosine_integral(sharpness, math::sin(elevation) as f32);
                worst[0] = worst[0].max((f64::from(found) - cosine).abs() / energy);
                let found = tables.hemisphere_fraction(sharpness, elevation as f32);
                worst[1] = worst[1].max((f64::from(found) - inside / energy).abs());
            }
        }
        println!(
            "cosine_integral: {:.2e}, hemisphere_fraction: {:.2e}",
            worst[0], worst[1]
        );
        assert!(worst.iter().all(|&error| error < TOLERANCE));
    }

    /// ∫ G {1, \[n·ω > 0\], max(n·ω, 0)} dω on a polar grid about the lobe's axis; the
    /// azimuth integral over the visible arc is in closed form.
    fn hemisphere(lambda: f64, elevation: f64) -> [f64; 3] {
        use std::f64::consts::PI;
        let (sine, cosine) = math::sin_cos(elevation);
        let ring = |theta: f64| {
            let (a, b) = (sine * math::cos(theta), cosine * math::sin(theta));
            // n·ω = a + b cos φ.
            let half = math::acos((-a / b).clamp(-1.0, 1.0));
            let weight =
                math::exp(-2.0 * lambda * math::sin(0.5 * theta).powi(2)) * math::sin(theta);
            [
                weight * 2.0 * PI,
                weight * 2.0 * half,
                weight * 2.0 * (a * half + b * math::sin(half)),
            ]
        };
        let end = (9.0 / lambda.sqrt()).min(PI);
        [0, 1, 2].map(|i| midpoint(0.0, end, |theta| ring(theta)[i]))
    }
}
