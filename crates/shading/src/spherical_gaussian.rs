//! Spherical Gaussians, G(ω; p, λ, μ) = μ exp(λ(p·ω − 1)), and the one-dimensional
//! integrals along a meridian that everything else is built on.
//!
//! Formulas after Wang et al. 2009 ("All-Frequency Rendering of Dynamic,
//! Spatially-Varying Reflectance"), rearranged so that no difference of nearly equal
//! numbers is formed in `f32`.

use relight_format::math;
use std::f32::consts::PI;

use glam::{Mat3, Vec3};
use relight_format::Lobe;

/// A spherical Gaussian with a colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphericalGaussian {
    /// Unit vector p, world space.
    pub axis: Vec3,
    /// λ ≥ 0.
    pub sharpness: f32,
    /// μ, the value at the axis.
    pub amplitude: Vec3,
}

impl From<&Lobe> for SphericalGaussian {
    fn from(lobe: &Lobe) -> Self {
        Self {
            axis: Vec3::from(lobe.axis).normalize(),
            sharpness: lobe.sharpness,
            amplitude: Vec3::from(lobe.amplitude),
        }
    }
}

impl SphericalGaussian {
    /// The value in the unit direction `direction`.
    pub fn evaluate(&self, direction: Vec3) -> Vec3 {
        let chord = direction - self.axis;
        self.amplitude * decay(-0.5 * self.sharpness * chord.dot(chord))
    }

    /// The product with `other`, again a spherical Gaussian.
    #[must_use]
    pub fn product(&self, other: &Self) -> Self {
        let sum = self.sharpness * self.axis + other.sharpness * other.axis;
        let sharpness = sum.length();
        let chord = self.axis - other.axis;
        let total = (sharpness + self.sharpness + other.sharpness).max(f32::MIN_POSITIVE);
        let exponent = -self.sharpness * other.sharpness / total * chord.dot(chord);
        // Equal lobes back to back have a constant product: any axis will do.
        let axis = if sharpness > 0.0 {
            sum / sharpness
        } else {
            self.axis
        };
        Self {
            axis,
            sharpness,
            amplitude: self.amplitude * other.amplitude * decay(exponent),
        }
    }

    /// The integral over the sphere.
    pub fn integral(&self) -> Vec3 {
        self.amplitude * energy(self.sharpness)
    }

    /// The same lobe after `rotation`, which must be orthonormal.
    #[must_use]
    pub fn rotate(&self, rotation: &Mat3) -> Self {
        Self {
            axis: *rotation * self.axis,
            ..*self
        }
    }
}

/// The exponential of something not above 0. What is no number of full precision is as good as
/// none, and takes some libraries several times as long.
fn decay(exponent: f32) -> f32 {
    if exponent < -87.0 {
        0.0
    } else {
        math::exp(exponent)
    }
}

/// ∫ exp(λ(p·ω − 1)) dω over the sphere: 4π at λ = 0, 2π/λ for large λ.
pub fn energy(sharpness: f32) -> f32 {
    2.0 * PI * sine_moment(sharpness, 2.0)
}

/// ∫ exp(λ(p·ω − 1)) p·ω dω over the sphere: `energy` times the length of the lobe's mean
/// vector.
pub fn first_moment(sharpness: f32) -> f32 {
    2.0 * PI * cosine_moment(sharpness, 2.0)
}

/// ∫₀^θ exp(λ(cos t − 1)) sin t dt, with `q` = 1 − cos θ in 0..=2.
pub fn sine_moment(sharpness: f32, q: f32) -> f32 {
    q * decay_0(sharpness * q)
}

/// g₁ = ∫₀^θ exp(λ(cos t − 1)) cos t sin t dt, with `q` = 1 − cos θ in 0..=2.
pub fn cosine_moment(sharpness: f32, q: f32) -> f32 {
    q * (decay_0(sharpness * q) - q * decay_1(sharpness * q))
}

/// Below this exponent the closed forms cancel and series are used.
const SERIES_LIMIT: f32 = 0.25;

/// From here on 1 − e⁻ᶻ is 1; an exponential that is not taken is time saved.
const NO_DECAY_LEFT: f32 = 18.0;

/// ∫₀¹ exp(−z t) dt = (1 − e⁻ᶻ) / z.
fn decay_0(z: f32) -> f32 {
    if z < SERIES_LIMIT {
        return 1.0 - z * (1.0 / 2.0 - z * (1.0 / 6.0 - z * (1.0 / 24.0 - z / 120.0)));
    }
    if z > NO_DECAY_LEFT {
        return 1.0 / z;
    }
    (1.0 - math::exp(-z)) / z
}

/// ∫₀¹ t exp(−z t) dt = (1 − (1 + z) e⁻ᶻ) / z².
fn decay_1(z: f32) -> f32 {
    if z < SERIES_LIMIT {
        return 1.0 / 2.0 - z * (1.0 / 3.0 - z * (1.0 / 8.0 - z * (1.0 / 30.0 - z / 144.0)));
    }
    (1.0 - (1.0 + z) * math::exp(-z)) / (z * z)
}

/// π and the constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!(
        "const PI: f32 = {PI:?};\nconst SPHERICAL_GAUSSIAN_SERIES_LIMIT: f32 = {SERIES_LIMIT:?};\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative error of f32 expressions of a few terms, with exponentials of arguments up
    /// to ten.
    const TOLERANCE: f32 = 1e-5;

    #[test]
    fn moments_match_quadrature() {
        for exponent in -30..=20 {
            let sharpness = 2f64.powi(exponent);
            for share in [1e-3, 0.1, 0.5, 1.0] {
                let q = share * (10.0 / sharpness).min(2.0);
                // Both integrands in u = 1 − cos t, where they are smooth.
                let n = 4000;
                let (mut sine, mut cosine) = (0.0, 0.0);
                for i in 0..n {
                    let u = (f64::from(i) + 0.5) / f64::from(n) * q;
                    let weight = math::exp(-sharpness * u) * q / f64::from(n);
                    sine += weight;
                    cosine += weight * (1.0 - u);
                }
                let found = sine_moment(sharpness as f32, q as f32);
                let error = (found - sine as f32).abs() / sine as f32;
                assert!(
                    error < TOLERANCE,
                    "sine_moment({sharpness}, {q}) is off by {error}"
                );
                // The cosine changes sign on the way: measured against the sine.
                let found = cosine_moment(sharpness as f32, q as f32);
                let error = (found - cosine as f32).abs() / sine as f32;
                assert!(
                    error < TOLERANCE,
                    "cosine_moment({sharpness}, {q}) is off by {error}"
                );
            }
        }
    }

    #[test]
    fn product_is_pointwise() {
        let lobe = |axis: Vec3, sharpness, amplitude| SphericalGaussian {
            axis: axis.normalize(),
            sharpness,
            amplitude,
        };
        let lobes = [
            lobe(Vec3::new(1.0, 2.0, 3.0), 5.0, Vec3::new(1.0, 2.0, 3.0)),
            lobe(Vec3::new(-1.0, 0.5, 2.0), 0.3, Vec3::splat(2.0)),
            lobe(Vec3::new(1.1, 2.0, 3.0), 300.0, Vec3::X),
            lobe(Vec3::new(-1.0, -2.0, -3.0), 5.0, Vec3::ONE),
        ];
        for a in &lobes {
            for b in &lobes {
                let product = a.product(b);
                for direction in lobes.map(|lobe| lobe.axis).into_iter().chain([Vec3::Y]) {
                    let expected = a.evaluate(direction) * b.evaluate(direction);
                    let found = product.evaluate(direction);
                    // Exponents of some hundreds carry that many roundings.
                    let exponent = a.sharpness + b.sharpness;
                    let bound = TOLERANCE * (1.0 + 0.1 * exponent) * expected.max_element();
                    assert!(
                        found.abs_diff_eq(expected, bound + f32::MIN_POSITIVE),
                        "{a:?} × {b:?} at {direction}: {found}, expected {expected}"
                    );
                }
            }
        }
    }

    #[test]
    #[allow(clippy::disallowed_methods)]
    fn rotation_moves_the_axis_alone() {
        let lobe = SphericalGaussian {
            axis: Vec3::X,
            sharpness: 4.0,
            amplitude: Vec3::ONE,
        };
        let turned = lobe.rotate(&Mat3::from_rotation_y(0.5 * PI));
        assert!(turned.axis.abs_diff_eq(Vec3::NEG_Z, TOLERANCE));
        assert_eq!(
            (turned.sharpness, turned.amplitude),
            (lobe.sharpness, lobe.amplitude)
        );
    }
}
