//! The exact reflection models that `brdf` approximates by lobes.
//!
//! All directions are unit vectors in the surface's frame: x along the tangent, y along
//! the bitangent, z along the shading normal, pointing away from the surface. `wi` is
//! where light comes from, `wo` where it goes. A direction below the surface reflects
//! nothing.
//!
//! Masking and shadowing of the microfacet models is Smith's, separable:
//! `G(wi, wo) = G1(wi) G1(wo)` (Walter et al. 2007), as in Mitsuba 3 `roughconductor`.

use relight_format::math;
use std::f32::consts::{FRAC_1_PI, PI};

use glam::{Vec2, Vec3};

use crate::surface::{Appearance, Model, Reflection, sample_ratio};

/// BRDF in 1/sr: Lambert plus the specular reflections, without the cosine.
pub fn evaluate(appearance: &Appearance, wi: Vec3, wo: Vec3) -> Vec3 {
    if wi.z <= 0.0 || wo.z <= 0.0 {
        return Vec3::ZERO;
    }
    let specular: Vec3 = appearance
        .reflections()
        .map(|reflection| evaluate_specular(reflection, wi, wo))
        .sum();
    appearance.diffuse * FRAC_1_PI + specular
}

/// One of the specular parts of [`evaluate`].
pub fn evaluate_specular(reflection: &Reflection, wi: Vec3, wo: Vec3) -> Vec3 {
    if wi.z <= 0.0 || wo.z <= 0.0 || reflection.model == Model::None {
        return Vec3::ZERO;
    }
    let half = (wi + wo).normalize();
    let value = reflection.color(half.dot(wo))
        * (reflection.half_vector_factor(half) * reflection.geometry(wi, wo, half.dot(wo)));
    match reflection.ratio {
        None => value,
        Some(ratio) => value * sample_ratio(ratio, wi, wo),
    }
}

/// Draws an incident direction of one reflection alone, with its weight
/// `f(wi, wo) n·wi / pdf` for a specular colour of 1 at every angle.
pub(crate) fn sample_specular(
    reflection: &Reflection,
    wo: Vec3,
    u: f32,
    v: f32,
) -> Option<(Vec3, f32)> {
    let half = sample_half_vector(reflection, wo, u, v);
    let wi = 2.0 * half.dot(wo) * half - wo;
    let density = half_vector_pdf(reflection, half, wo) / (4.0 * half.dot(wo));
    let value = reflection.half_vector_factor(half) * reflection.geometry(wi, wo, half.dot(wo));
    (wi.z > 0.0).then_some((wi, value * wi.z / density))
}

impl Reflection<'_> {
    /// The factor of the BRDF that depends on the half vector alone: the normal
    /// distribution, or its exponential, with the model's constants.
    fn half_vector_factor(&self, h: Vec3) -> f32 {
        if h.z <= 0.0 {
            return 0.0;
        }
        let Vec2 { x, y } = self.alpha;
        let slope_squared = ((h.x / x).powi(2) + (h.y / y).powi(2)) / (h.z * h.z);
        match self.model {
            Model::None => 0.0,
            Model::BlinnPhong => (x + 8.0) / (8.0 * PI) * math::powf(h.z, x),
            Model::Ward => math::exp(-slope_squared) / (4.0 * PI * x * y),
            Model::CookTorrance => math::exp(-slope_squared) / (PI * x * y * h.z.powi(4)),
            Model::Ggx => ggx(h, self.alpha),
            Model::AshikhminShirley => 0.25 * ashikhmin_shirley(h, self.alpha),
        }
    }

    /// The factor of the BRDF that depends on both directions and varies slowly.
    fn geometry(&self, wi: Vec3, wo: Vec3, half_cosine: f32) -> f32 {
        if self.model == Model::AshikhminShirley {
            return self.incident_factor(wi, wo, half_cosine);
        }
        self.direction_factor(wi) * self.direction_factor(wo)
    }

    /// The part of the geometry that varies with `wi`.
    pub(crate) fn incident_factor(&self, wi: Vec3, wo: Vec3, half_cosine: f32) -> f32 {
        if self.model == Model::AshikhminShirley {
            1.0 / (half_cosine * wi.z.max(wo.z))
        } else {
            self.direction_factor(wi)
        }
    }

    /// The factor of the BRDF that depends on `wi` (or, by reciprocity, `wo`) alone: for
    /// a microfacet model `G1(w) / (2 n·w)`. Finite down to the horizon except for Ward.
    fn direction_factor(&self, w: Vec3) -> f32 {
        let projected = Vec2::new(w.x * self.alpha.x, w.y * self.alpha.y).length();
        match self.model {
            Model::None | Model::BlinnPhong | Model::AshikhminShirley => 1.0,
            Model::Ward => 1.0 / w.z,
            Model::CookTorrance => {
                // Walter et al. 2007, eq. 27, with a = w.z / projected: multiplied out so
                // that the quotient by w.z stays finite at the horizon.
                if w.z >= 1.6 * projected {
                    return 0.5 / w.z;
                }
                let a = w.z / projected;
                0.5 * (3.535 + 2.181 * a) / ((1.0 + (2.276 + 2.577 * a) * a) * projected)
            }
            Model::Ggx => 1.0 / (w.z + (w.z * w.z + projected * projected).sqrt()),
        }
    }
}

fn ggx(h: Vec3, alpha: Vec2) -> f32 {
    let d = (h.x / alpha.x).powi(2) + (h.y / alpha.y).powi(2) + h.z * h.z;
    1.0 / (PI * alpha.x * alpha.y * d * d)
}

/// Density of half vectors of Ashikhmin & Shirley 2000, eq. 6, with exponents n = 2/α².
fn ashikhmin_shirley(h: Vec3, alpha: Vec2) -> f32 {
    let exponents = 2.0 / (alpha * alpha);
    let sine_squared = h.x * h.x + h.y * h.y;
    let exponent = if sine_squared > 0.0 {
        (exponents.x * h.x * h.x + exponents.y * h.y * h.y) / sine_squared
    } else {
        0.0
    };
    let scale = ((exponents.x + 1.0) * (exponents.y + 1.0)).sqrt() / (2.0 * PI);
    scale * math::powf(h.z.max(0.0), exponent)
}

/// Draws a half vector; for GGX among those visible from `wo` (Heitz 2018).
pub(crate) fn sample_half_vector(reflection: &Reflection, wo: Vec3, u: f32, v: f32) -> Vec3 {
    let Vec2 { x, y } = reflection.alpha;
    let (sin, cos) = math::sin_cos(2.0 * PI * v);
    match reflection.model {
        Model::None | Model::BlinnPhong => {
            let z = math::powf(1.0 - u, 1.0 / (x + 1.0));
            let radius = (1.0 - z * z).max(0.0).sqrt();
            Vec3::new(radius * cos, radius * sin, z)
        }
        Model::Ward | Model::CookTorrance => {
            let radius = (-math::ln(1.0 - u)).sqrt();
            Vec3::new(x * radius * cos, y * radius * sin, 1.0).normalize()
        }
        Model::AshikhminShirley => {
            let exponents = 2.0 / (reflection.alpha * reflection.alpha);
            let azimuth = math::atan2(
                (exponents.x + 1.0).sqrt() * sin,
                (exponents.y + 1.0).sqrt() * cos,
            );
            let (sin, cos) = math::sin_cos(azimuth);
            let exponent = exponents.x * cos * cos + exponents.y * sin * sin;
            let z = math::powf(1.0 - u, 1.0 / (exponent + 1.0));
            let radius = (1.0 - z * z).max(0.0).sqrt();
            Vec3::new(radius * cos, radius * sin, z)
        }
        Model::Ggx => {
            let stretched = Vec3::new(x * wo.x, y * wo.y, wo.z).normalize();
            let length_squared = stretched.x * stretched.x + stretched.y * stretched.y;
            let first = if length_squared > 0.0 {
                Vec3::new(-stretched.y, stretched.x, 0.0) / length_squared.sqrt()
            } else {
                Vec3::X
            };
            let second = stretched.cross(first);
            let radius = u.sqrt();
            let p = radius * cos;
            let s = 0.5 * (1.0 + stretched.z);
            let q = (1.0 - s) * (1.0 - p * p).max(0.0).sqrt() + s * radius * sin;
            let h = first * p + second * q + stretched * (1.0 - p * p - q * q).max(0.0).sqrt();
            Vec3::new(x * h.x, y * h.y, h.z.max(0.0)).normalize()
        }
    }
}

/// Density of [`sample_half_vector`], per steradian of half vectors.
pub(crate) fn half_vector_pdf(reflection: &Reflection, h: Vec3, wo: Vec3) -> f32 {
    let Vec2 { x, y } = reflection.alpha;
    match reflection.model {
        Model::None => 0.0,
        Model::BlinnPhong => (x + 1.0) / (2.0 * PI) * math::powf(h.z, x),
        Model::Ward | Model::CookTorrance => {
            let slope_squared = ((h.x / x).powi(2) + (h.y / y).powi(2)) / (h.z * h.z);
            math::exp(-slope_squared) / (PI * x * y * h.z.powi(3))
        }
        Model::AshikhminShirley => ashikhmin_shirley(h, reflection.alpha),
        Model::Ggx => {
            2.0 * reflection.direction_factor(wo) * h.dot(wo).max(0.0) * ggx(h, reflection.alpha)
        }
    }
}
