//! Spherical Gaussians, G(ω; p, λ, μ) = μ exp(λ(p·ω − 1)), and the one-dimensional
//! integrals along a meridian that everything else is built on.
//!
//! Formulas after Wang et al. 2009 ("All-Frequency Rendering of Dynamic,
//! Spatially-Varying Reflectance"), rearranged so that no difference of nearly equal
//! numbers is formed in `f32`.

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
        self.amplitude * (-0.5 * self.sharpness * chord.dot(chord)).exp()
    }

    /// The product with `other`, again a spherical Gaussian.
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
            amplitude: self.amplitude * other.amplitude * exponent.exp(),
        }
    }

    /// The integral over the sphere.
    pub fn integral(&self) -> Vec3 {
        self.amplitude * energy(self.sharpness)
    }

    /// The same lobe after `rotation`, which must be orthonormal.
    pub fn rotate(&self, rotation: &Mat3) -> Self {
        Self {
            axis: *rotation * self.axis,
            ..*self
        }
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

/// ∫₀¹ exp(−z t) dt = (1 − e⁻ᶻ) / z.
fn decay_0(z: f32) -> f32 {
    if z < SERIES_LIMIT {
        return 1.0 - z * (1.0 / 2.0 - z * (1.0 / 6.0 - z * (1.0 / 24.0 - z / 120.0)));
    }
    (1.0 - (-z).exp()) / z
}

/// ∫₀¹ t exp(−z t) dt = (1 − (1 + z) e⁻ᶻ) / z².
fn decay_1(z: f32) -> f32 {
    if z < SERIES_LIMIT {
        return 1.0 / 2.0 - z * (1.0 / 3.0 - z * (1.0 / 8.0 - z * (1.0 / 30.0 - z / 144.0)));
    }
    (1.0 - (1.0 + z) * (-z).exp()) / (z * z)
}

/// π and the constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!(
        "const PI: f32 = {PI:?};\nconst SPHERICAL_GAUSSIAN_SERIES_LIMIT: f32 = {SERIES_LIMIT:?};\n"
    )
}
