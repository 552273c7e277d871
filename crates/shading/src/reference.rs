//! The exact reflection models that `brdf` approximates by lobes, with the sampling that
//! a path tracer needs. On the CPU only.
//!
//! All directions are unit vectors in the surface's frame: x along the tangent, y along
//! the bitangent, z along the shading normal, pointing away from the surface. `wi` is
//! where light comes from, `wo` where it goes. A direction below the surface reflects
//! nothing.
//!
//! Masking and shadowing of the microfacet models is Smith's, separable:
//! `G(wi, wo) = G1(wi) G1(wo)` (Walter et al. 2007), as in Mitsuba 3 `roughconductor`.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::{Vec2, Vec3};

use crate::surface::{Appearance, Model};

/// BRDF in 1/sr: Lambert plus the specular model, without the cosine.
pub fn evaluate(appearance: &Appearance, wi: Vec3, wo: Vec3) -> Vec3 {
    if wi.z <= 0.0 || wo.z <= 0.0 {
        return Vec3::ZERO;
    }
    appearance.diffuse * FRAC_1_PI + evaluate_specular(appearance, wi, wo)
}

/// The specular part of [`evaluate`].
pub fn evaluate_specular(appearance: &Appearance, wi: Vec3, wo: Vec3) -> Vec3 {
    if wi.z <= 0.0 || wo.z <= 0.0 || appearance.model == Model::None {
        return Vec3::ZERO;
    }
    let half = (wi + wo).normalize();
    appearance.specular_color(half.dot(wo))
        * (appearance.half_vector_factor(half)
            * appearance.direction_factor(wi)
            * appearance.direction_factor(wo))
}

/// Draws an incident direction from three uniform numbers in [0, 1). `None` where the
/// draw falls below the surface: such a sample counts, with weight zero.
pub fn sample(appearance: &Appearance, wo: Vec3, u: [f32; 3]) -> Option<Vec3> {
    if wo.z <= 0.0 {
        return None;
    }
    let probability = diffuse_probability(appearance, wo)?;
    let wi = if u[0] < probability {
        let (sin, cos) = (2.0 * PI * u[2]).sin_cos();
        let radius = u[1].sqrt();
        Vec3::new(radius * cos, radius * sin, (1.0 - u[1]).sqrt())
    } else {
        let half = sample_half_vector(appearance, wo, u[1], u[2]);
        2.0 * half.dot(wo) * half - wo
    };
    (wi.z > 0.0).then_some(wi)
}

/// Density of [`sample`] at `wi`, per steradian. Its integral over the hemisphere is the
/// probability that [`sample`] returns a direction.
pub fn pdf(appearance: &Appearance, wi: Vec3, wo: Vec3) -> f32 {
    if wi.z <= 0.0 || wo.z <= 0.0 {
        return 0.0;
    }
    let Some(probability) = diffuse_probability(appearance, wo) else {
        return 0.0;
    };
    let half = (wi + wo).normalize();
    let specular = half_vector_pdf(appearance, half, wo) / (4.0 * half.dot(wo));
    probability * wi.z * FRAC_1_PI + (1.0 - probability) * specular
}

/// Draws an incident direction of the specular part alone, with its weight
/// `f(wi, wo) n·wi / pdf` for a specular colour of 1 at every angle.
pub(crate) fn sample_specular(appearance: &Appearance, wo: Vec3, u: f32, v: f32) -> Option<(Vec3, f32)> {
    let half = sample_half_vector(appearance, wo, u, v);
    let wi = 2.0 * half.dot(wo) * half - wo;
    let density = half_vector_pdf(appearance, half, wo) / (4.0 * half.dot(wo));
    let value = appearance.half_vector_factor(half)
        * appearance.direction_factor(wi)
        * appearance.direction_factor(wo);
    (wi.z > 0.0).then_some((wi, value * wi.z / density))
}

impl Appearance {
    /// Colour of the specular reflection about a half vector at `cosine = h·o`.
    fn specular_color(&self, cosine: f32) -> Vec3 {
        match self.model {
            Model::None | Model::BlinnPhong | Model::Ward => self.specular,
            Model::CookTorrance | Model::Ggx => {
                self.specular + (Vec3::ONE - self.specular) * schlick(cosine)
            }
        }
    }

    /// The factor of the BRDF that depends on the half vector alone: the normal
    /// distribution, or its exponential, with the model's constants.
    pub(crate) fn half_vector_factor(&self, h: Vec3) -> f32 {
        if h.z <= 0.0 {
            return 0.0;
        }
        let Vec2 { x, y } = self.alpha;
        let slope_squared = ((h.x / x).powi(2) + (h.y / y).powi(2)) / (h.z * h.z);
        match self.model {
            Model::None => 0.0,
            Model::BlinnPhong => (x + 8.0) / (8.0 * PI) * h.z.powf(x),
            Model::Ward => (-slope_squared).exp() / (4.0 * PI * x * y),
            Model::CookTorrance => (-slope_squared).exp() / (PI * x * y * h.z.powi(4)),
            Model::Ggx => ggx(h, self.alpha),
        }
    }

    /// The factor of the BRDF that depends on `wi` (or, by reciprocity, `wo`) alone: for
    /// a microfacet model `G1(w) / (2 n·w)`. Finite down to the horizon except for Ward.
    pub(crate) fn direction_factor(&self, w: Vec3) -> f32 {
        let projected = Vec2::new(w.x * self.alpha.x, w.y * self.alpha.y).length();
        match self.model {
            Model::None | Model::BlinnPhong => 1.0,
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

/// Schlick's (1 − cosθ)⁵.
pub(crate) fn schlick(cosine: f32) -> f32 {
    (1.0 - cosine).clamp(0.0, 1.0).powi(5)
}

fn ggx(h: Vec3, alpha: Vec2) -> f32 {
    let d = (h.x / alpha.x).powi(2) + (h.y / alpha.y).powi(2) + h.z * h.z;
    1.0 / (PI * alpha.x * alpha.y * d * d)
}

/// How often [`sample`] chooses the diffuse lobe; `None` for a black surface.
fn diffuse_probability(appearance: &Appearance, wo: Vec3) -> Option<f32> {
    let diffuse = appearance.diffuse.element_sum();
    let specular = match appearance.model {
        Model::None => 0.0,
        _ => appearance.specular_color(wo.z).element_sum(),
    };
    let sum = diffuse + specular;
    (sum > 0.0).then(|| diffuse / sum)
}

/// Draws a half vector; for GGX among those visible from `wo` (Heitz 2018).
fn sample_half_vector(appearance: &Appearance, wo: Vec3, u: f32, v: f32) -> Vec3 {
    let Vec2 { x, y } = appearance.alpha;
    let (sin, cos) = (2.0 * PI * v).sin_cos();
    match appearance.model {
        Model::None | Model::BlinnPhong => {
            let z = (1.0 - u).powf(1.0 / (x + 1.0));
            let radius = (1.0 - z * z).max(0.0).sqrt();
            Vec3::new(radius * cos, radius * sin, z)
        }
        Model::Ward | Model::CookTorrance => {
            let radius = (-(1.0 - u).ln()).sqrt();
            Vec3::new(x * radius * cos, y * radius * sin, 1.0).normalize()
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
fn half_vector_pdf(appearance: &Appearance, h: Vec3, wo: Vec3) -> f32 {
    let Vec2 { x, y } = appearance.alpha;
    match appearance.model {
        Model::None => 0.0,
        Model::BlinnPhong => (x + 1.0) / (2.0 * PI) * h.z.powf(x),
        Model::Ward | Model::CookTorrance => {
            let slope_squared = ((h.x / x).powi(2) + (h.y / y).powi(2)) / (h.z * h.z);
            (-slope_squared).exp() / (PI * x * y * h.z.powi(3))
        }
        Model::Ggx => {
            2.0 * appearance.direction_factor(wo) * h.dot(wo).max(0.0) * ggx(h, appearance.alpha)
        }
    }
}
