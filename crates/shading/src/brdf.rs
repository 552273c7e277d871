//! Reflection models as spherical Gaussians over incident directions.
//!
//! Every model here is, up to slowly varying factors, a radial profile of the half
//! vector: with (x, y) the half vector's tangent coordinates divided by the model's two
//! widths and r² = x² + y², GGX is exactly 1/(1 + r²)² and the others are close to
//! exp(−r²). Reflecting the view direction about the half vector maps the profile to
//! incident directions, stretched by 2 in the plane of incidence and by 2 n·o across it
//! (Wang et al. 2009, section 4, take the geometric mean of the two and thereby keep the
//! lobe round). The singular values of "widths, then reflection" give the ratio ρ by
//! which the profile is stretched on the sphere, be it by an anisotropic material, by
//! grazing view or by both, and a small mixture of round Gaussians along the long axis,
//! fitted once for every ρ, follows it. Masking is taken at the centre of each Gaussian.
//! At last the sum is scaled to the model's exact albedo, Fresnel included, which is
//! tabulated over roughness and angle.

use std::sync::OnceLock;

use glam::{Vec2, Vec3};

use crate::reference;
use crate::spherical_gaussian::SphericalGaussian;
use crate::surface::{Appearance, MAX_EXPONENT, MIN_ALPHA, Model, SurfacePoint};
use crate::tables::Tables;

/// Most spherical Gaussians that a specular model becomes: those of an anisotropic one.
pub const MAX_SPECULAR_LOBES: usize = 1 + 2 * MAX_PAIRS;

/// Pairs of Gaussians beside the central one: isotropic and anisotropic materials.
const PAIRS: [usize; 2] = [1, MAX_PAIRS];
const MAX_PAIRS: usize = 3;
/// Materials whose roughnesses differ by less than this factor count as isotropic.
const ISOTROPIC_RATIO: f32 = 1.01;
/// Stretch below which the Gaussians of a pair lie so close that one does for both.
const ROUND_RATIO: f32 = 1.02;
/// Smallest n·o: closer to the horizon the lobe keeps the shape it has here.
const MIN_COSINE: f32 = 0.05;
/// Smallest 1 − α² of a GGX lobe: a rougher one is as good as constant.
const MIN_GGX_COMPLEMENT: f32 = 0.04;

/// Mixtures are tabulated at ρ = 2^(i / MIXTURES_PER_OCTAVE).
const MIXTURES: usize = 16;
const MIXTURES_PER_OCTAVE: f32 = 3.0;
/// ln s₀, ln w₀, then ln s, ln w, t of each pair, padded.
const MIXTURE_STRIDE: usize = 12;
/// Entries of the albedo table per axis: √alpha from √MIN_ALPHA to 1 and √(n·o) from 0 to 1.
const ALBEDOS: usize = 16;
/// First value of the albedo table.
const ALBEDO_OFFSET: usize = 2 * PAIRS.len() * MIXTURES * MIXTURE_STRIDE;
const VALUES: usize = ALBEDO_OFFSET + 4 * ALBEDOS * ALBEDOS * 2;

/// The Gaussians of one specular model seen from one direction.
#[derive(Clone, Copy, Debug)]
pub struct SpecularLobes {
    /// How many of `lobes` are in use.
    pub count: usize,
    /// Lobes over incident directions, world space, 1/sr, without the cosine.
    pub lobes: [SphericalGaussian; MAX_SPECULAR_LOBES],
}

impl SpecularLobes {
    const EMPTY: Self = Self {
        count: 0,
        lobes: [SphericalGaussian { axis: Vec3::Z, sharpness: 0.0, amplitude: Vec3::ZERO }; MAX_SPECULAR_LOBES],
    };

    /// The lobes in use.
    pub fn as_slice(&self) -> &[SphericalGaussian] {
        &self.lobes[..self.count]
    }

    fn push(&mut self, axis: Vec3, sharpness: f32, amplitude: f32) {
        self.lobes[self.count] = SphericalGaussian { axis, sharpness, amplitude: Vec3::splat(amplitude) };
        self.count += 1;
    }
}

/// The specular reflection at `point` towards its `view` as lobes over incident
/// directions, world space. None where the view is below the shading horizon.
pub fn specular_lobes(point: &SurfacePoint) -> SpecularLobes {
    let wo = point.to_local(point.view);
    let appearance = &point.appearance;
    if appearance.model == Model::None || wo.z <= 0.0 {
        return SpecularLobes::EMPTY;
    }
    let values = table_values();
    let mut lobes = shape(values, appearance, wo);
    let scale = albedo_scale(values, appearance, wo.z);
    let color = appearance.specular * scale.x + Vec3::splat(scale.y);
    for lobe in &mut lobes.lobes[..lobes.count] {
        lobe.axis = point.to_world(lobe.axis);
        lobe.amplitude *= color;
    }
    lobes
}

/// The lobes in the local frame for a Fresnel factor of 1, before the albedo is matched.
fn shape(values: &[f32], appearance: &Appearance, wo: Vec3) -> SpecularLobes {
    let width = profile_width(appearance);
    let cosine = wo.z.max(MIN_COSINE);
    let horizontal = wo.truncate().length();
    let e = if horizontal > 0.0 { wo.truncate() / horizontal } else { Vec2::X };
    // AᵀA of the map A from profile to incident directions: 4 W (e eᵀ + cos² f fᵀ) W.
    let c2 = cosine * cosine;
    let xx = 4.0 * width.x * width.x * (e.x * e.x + c2 * e.y * e.y);
    let yy = 4.0 * width.y * width.y * (e.y * e.y + c2 * e.x * e.x);
    let xy = 4.0 * width.x * width.y * (1.0 - c2) * e.x * e.y;
    let half_difference = 0.5 * (xx - yy);
    let root = (half_difference * half_difference + xy * xy).sqrt();
    let major = 0.5 * (xx + yy) + root;
    // The product of the singular values is known, so that the small one is exact.
    let minor = 16.0 * (width.x * width.y).powi(2) * c2 / major;
    let long_axis = if root > 0.0 {
        // Of the two proportional forms of the eigenvector, the one that does not cancel.
        if half_difference >= 0.0 {
            Vec2::new(half_difference + root, xy).normalize()
        } else {
            Vec2::new(xy, root - half_difference).normalize()
        }
    } else {
        Vec2::X
    };
    let ratio = (major / minor).sqrt();
    let limit = 2f32.powf((MIXTURES - 1) as f32 / MIXTURES_PER_OCTAVE);
    // Beyond the table the lobe is kept as long and made wider.
    let minor = minor.max(major / (limit * limit));
    let ratio = ratio.min(limit);

    let profile = usize::from(appearance.model == Model::Ggx);
    let isotropic = appearance.alpha.max_element() < ISOTROPIC_RATIO * appearance.alpha.min_element();
    let family = usize::from(!isotropic);
    let position = ratio.log2() * MIXTURES_PER_OCTAVE;
    let node = (position as usize).min(MIXTURES - 2);
    let first = ((profile * PAIRS.len() + family) * MIXTURES + node) * MIXTURE_STRIDE;
    let mix = |i: usize| {
        let (a, b) = (values[first + i], values[first + MIXTURE_STRIDE + i]);
        a + (b - a) * (position - node as f32)
    };

    let peak = appearance.half_vector_factor(Vec3::Z) * appearance.direction_factor(wo);
    let step = long_axis * width / ratio;
    let mut lobes = SpecularLobes::EMPTY;
    let mut push = |offset: Vec2, sharpness: f32, weight: f32| {
        let h = offset.extend(1.0).normalize();
        let axis = 2.0 * h.dot(wo) * h - wo;
        // The mean of the clamped cosine over the lobe.
        let spread = 0.64 * (1.0 - axis.z * axis.z).max(0.0) / (sharpness + 1.0);
        let cosine = 0.5 * (axis.z + (axis.z * axis.z + spread).sqrt());
        let masking = appearance.direction_factor(axis.truncate().extend(cosine.max(MIN_COSINE)));
        lobes.push(axis, sharpness, peak * weight * masking);
    };
    let to_sharpness = 2.0 / minor;
    if ratio < ROUND_RATIO && profile == 0 {
        push(Vec2::ZERO, to_sharpness, 1.0);
        return lobes;
    }
    push(Vec2::ZERO, to_sharpness * mix(0).exp(), mix(1).exp());
    let spacing = (ratio * ratio - 1.0).max(0.0).sqrt();
    for pair in 0..PAIRS[family] {
        let sharpness = to_sharpness * mix(2 + 3 * pair).exp();
        let weight = mix(3 + 3 * pair).exp();
        if ratio < ROUND_RATIO {
            push(Vec2::ZERO, sharpness, 2.0 * weight);
        } else {
            let offset = step * (spacing * mix(4 + 3 * pair));
            push(offset, sharpness, weight);
            push(-offset, sharpness, weight);
        }
    }
    lobes
}

/// Half-vector coordinates at which the profile's argument r is 1.
fn profile_width(appearance: &Appearance) -> Vec2 {
    let squared = appearance.alpha * appearance.alpha;
    match appearance.model {
        Model::None => Vec2::ONE,
        Model::BlinnPhong => Vec2::splat((2.0 / appearance.alpha.x).sqrt()),
        Model::Ward | Model::CookTorrance => appearance.alpha,
        Model::Ggx => {
            let complement = (Vec2::ONE - squared).max(Vec2::splat(MIN_GGX_COMPLEMENT));
            Vec2::new((squared.x / complement.x).sqrt(), (squared.y / complement.y).sqrt())
        }
    }
}

/// Factors of the specular colour and of white that give the lobes of [`shape`] the
/// albedo of the model.
fn albedo_scale(values: &[f32], appearance: &Appearance, cosine: f32) -> Vec2 {
    let alpha = match appearance.model {
        Model::BlinnPhong => (2.0 / appearance.alpha.x).sqrt(),
        _ => (appearance.alpha.x * appearance.alpha.y).sqrt(),
    };
    let low = MIN_ALPHA.sqrt();
    let last = (ALBEDOS - 1) as f32;
    let row = ((alpha.sqrt() - low) / (1.0 - low)).clamp(0.0, 1.0) * last;
    let column = cosine.clamp(0.0, 1.0).sqrt() * last;
    let i = (row as usize).min(ALBEDOS - 2);
    let j = (column as usize).min(ALBEDOS - 2);
    let model = appearance.model as usize - 1;
    let at = |i: usize, j: usize| {
        let index = ALBEDO_OFFSET + ((model * ALBEDOS + i) * ALBEDOS + j) * 2;
        Vec2::new(values[index], values[index + 1])
    };
    let (u, v) = (row - i as f32, column - j as f32);
    at(i, j).lerp(at(i, j + 1), v).lerp(at(i + 1, j).lerp(at(i + 1, j + 1), v), u)
}

/// The fitted mixtures and the albedo factors, computed at the first call: what follows
/// [`Tables::values`] in the GPU buffer `tables`.
pub fn table_values() -> &'static [f32] {
    static VALUES_ONCE: OnceLock<Vec<f32>> = OnceLock::new();
    VALUES_ONCE.get_or_init(|| {
        let mut values = Vec::with_capacity(VALUES);
        for profile in [fit::gaussian, fit::ggx] {
            for pairs in PAIRS {
                for mixture in fit::mixtures(profile, pairs) {
                    values.extend(mixture);
                }
            }
        }
        for model in [Model::BlinnPhong, Model::Ward, Model::CookTorrance, Model::Ggx] {
            for i in 0..ALBEDOS {
                for j in 0..ALBEDOS {
                    let scale = fit_albedo(&values, model, i, j);
                    values.extend([scale.x, scale.y]);
                }
            }
        }
        values
    })
}

/// One entry of the albedo table: exact albedo over the albedo of the lobes.
fn fit_albedo(values: &[f32], model: Model, i: usize, j: usize) -> Vec2 {
    let last = (ALBEDOS - 1) as f32;
    let low = MIN_ALPHA.sqrt();
    let alpha = (low + (1.0 - low) * i as f32 / last).powi(2);
    let alpha = match model {
        Model::BlinnPhong => (2.0 / (alpha * alpha)).min(MAX_EXPONENT),
        _ => alpha,
    };
    // At the horizon itself some models diverge: the first column stands a little above.
    let cosine = (j as f32 / last).max(0.25 / last).powi(2);
    let wo = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
    let appearance = Appearance { diffuse: Vec3::ZERO, specular: Vec3::ONE, model, alpha: Vec2::splat(alpha) };
    let [all, grazing] = reference_albedo(&appearance, wo);
    let tables = Tables::get();
    let lobes: f32 = shape(values, &appearance, wo)
        .as_slice()
        .iter()
        .map(|lobe| lobe.amplitude.x * tables.cosine_integral(lobe.sharpness, lobe.axis.z))
        .sum();
    Vec2::new((all - grazing) as f32, grazing as f32) / lobes
}

/// ∫ f(wi, wo) n·wi dwi of the specular part for a colour of 1, and the same weighted by
/// Schlick's (1 − h·o)⁵ (zero for models without Fresnel).
fn reference_albedo(appearance: &Appearance, wo: Vec3) -> [f64; 2] {
    const RADII: usize = 64;
    const ANGLES: usize = 32;
    let fresnel = matches!(appearance.model, Model::CookTorrance | Model::Ggx);
    let mut sum = [0.0; 2];
    for radius in 0..RADII {
        for angle in 0..ANGLES {
            // Squared: more samples where few half vectors carry much of a long tail.
            let u = (radius as f32 + 0.5) / RADII as f32;
            let v = (angle as f32 + 0.5) / ANGLES as f32;
            let Some((wi, weight)) = reference::sample_specular(appearance, wo, u, v) else {
                continue;
            };
            let half = (wi + wo).normalize();
            let fresnel = if fresnel { reference::schlick(half.dot(wo)) } else { 0.0 };
            sum[0] += f64::from(weight);
            sum[1] += f64::from(weight * fresnel);
        }
    }
    sum.map(|sum| sum / (RADII * ANGLES) as f64)
}

/// Least-squares fits of round Gaussians to a stretched radial profile.
mod fit {
    use super::{MAX_PAIRS, MIXTURES, MIXTURES_PER_OCTAVE, MIXTURE_STRIDE};

    /// exp(−r²).
    pub fn gaussian(r_squared: f64) -> f64 {
        (-r_squared).exp()
    }

    /// 1/(1 + r²)².
    pub fn ggx(r_squared: f64) -> f64 {
        1.0 / (1.0 + r_squared).powi(2)
    }

    const MAX_PARAMETERS: usize = 2 + 3 * MAX_PAIRS;
    type Parameters = [f64; MAX_PARAMETERS];
    type Normal = [[f64; MAX_PARAMETERS]; MAX_PARAMETERS];

    /// Points per axis of the quarter plane.
    const POINTS: usize = 32;
    const ITERATIONS: usize = 60;
    /// Weight of the squared relative error of the integral beside that of the profile.
    const ENERGY_WEIGHT: f64 = 1.0;

    /// The mixture for every tabulated ratio, each started from the one before.
    pub fn mixtures(profile: fn(f64) -> f64, pairs: usize) -> Vec<[f32; MIXTURE_STRIDE]> {
        let mut parameters = [0.0; MAX_PARAMETERS];
        // Widths from narrow to wide, positions from near to far, equal energies.
        parameters[1] = -1.0;
        for pair in 0..pairs {
            let rank = (pair + 1) as f64;
            parameters[2 + 3 * pair] = -0.7 * rank;
            parameters[3 + 3 * pair] = -1.0 - rank;
            parameters[4 + 3 * pair] = 0.5 * rank;
        }
        (0..MIXTURES)
            .map(|i| {
                let ratio = 2f64.powf(i as f64 / f64::from(MIXTURES_PER_OCTAVE));
                parameters = levenberg_marquardt(profile, ratio, pairs, parameters);
                let mut row = [0.0; MIXTURE_STRIDE];
                for (value, parameter) in row.iter_mut().zip(parameters) {
                    *value = parameter as f32;
                }
                row
            })
            .collect()
    }

    /// Sum of squares and, into `normal` and `gradient`, JᵀJ and Jᵀr.
    fn accumulate(
        profile: fn(f64) -> f64,
        ratio: f64,
        pairs: usize,
        p: &Parameters,
        normal: &mut Normal,
        gradient: &mut Parameters,
    ) -> f64 {
        let n = 2 + 3 * pairs;
        let spacing = (ratio * ratio - 1.0).sqrt();
        let mut cost = 0.0;
        let mut add = |row: &Parameters, residual: f64, weight: f64| {
            cost += weight * residual * residual;
            for i in 0..n {
                gradient[i] += weight * row[i] * residual;
                for j in 0..=i {
                    normal[i][j] += weight * row[i] * row[j];
                }
            }
        };
        // Dense near the centre, reaching far into the tail.
        let coordinate = |i: usize| {
            let u = (i as f64 + 0.5) / POINTS as f64;
            (1.2 * u / (1.0 - u), 1.2 / ((1.0 - u).powi(2) * POINTS as f64))
        };
        // ∫ profile² dA, so that the cost is relative.
        let mut norm = 0.0;
        for i in 0..POINTS {
            for j in 0..POINTS {
                let ((x, dx), (y, dy)) = (coordinate(i), coordinate(j));
                norm += profile(x * x + y * y).powi(2) * dx * dy;
            }
        }
        for i in 0..POINTS {
            for j in 0..POINTS {
                let ((x, dx), (y, dy)) = (coordinate(i), coordinate(j));
                let target = profile(x * x + y * y);
                let x = x * ratio;
                let mut row = [0.0; MAX_PARAMETERS];
                let s = p[0].exp();
                let value = p[1].exp() * (-s * (x * x + y * y)).exp();
                row[0] = -s * (x * x + y * y) * value;
                row[1] = value;
                let mut sum = value;
                for pair in 0..pairs {
                    let k = 2 + 3 * pair;
                    let (s, w, d) = (p[k].exp(), p[k + 1].exp(), spacing * p[k + 2]);
                    for d in [d, -d] {
                        let r2 = (x - d) * (x - d) + y * y;
                        let value = w * (-s * r2).exp();
                        row[k] -= s * r2 * value;
                        row[k + 1] += value;
                        row[k + 2] += 2.0 * s * (x - d) * value * d / p[k + 2];
                        sum += value;
                    }
                }
                add(&row, sum - target, dx * dy / norm);
            }
        }
        // Integral over the plane in units of π ρ, which both profiles have.
        let mut row = [0.0; MAX_PARAMETERS];
        let energy = (p[1] - p[0]).exp() / ratio;
        (row[0], row[1]) = (-energy, energy);
        let mut sum = energy;
        for pair in 0..pairs {
            let k = 2 + 3 * pair;
            let energy = 2.0 * (p[k + 1] - p[k]).exp() / ratio;
            (row[k], row[k + 1]) = (-energy, energy);
            sum += energy;
        }
        add(&row, sum - 1.0, ENERGY_WEIGHT);
        cost
    }

    fn levenberg_marquardt(
        profile: fn(f64) -> f64,
        ratio: f64,
        pairs: usize,
        mut p: Parameters,
    ) -> Parameters {
        let n = 2 + 3 * pairs;
        let mut damping = 1e-3;
        let evaluate = |p: &Parameters| {
            let (mut normal, mut gradient) = ([[0.0; MAX_PARAMETERS]; MAX_PARAMETERS], [0.0; MAX_PARAMETERS]);
            let cost = accumulate(profile, ratio, pairs, p, &mut normal, &mut gradient);
            (cost, normal, gradient)
        };
        let (mut cost, mut normal, mut gradient) = evaluate(&p);
        for _ in 0..ITERATIONS {
            let mut damped = normal;
            for (i, row) in damped.iter_mut().enumerate().take(n) {
                row[i] += damping * (row[i] + 1e-6);
            }
            let step = solve(damped, gradient, n);
            let mut candidate = p;
            for i in 0..n {
                candidate[i] -= step[i].clamp(-0.5, 0.5);
            }
            let next = evaluate(&candidate);
            if next.0 < cost {
                p = candidate;
                (cost, normal, gradient) = next;
                damping = (damping * 0.3).max(1e-9);
            } else {
                damping *= 4.0;
            }
        }
        p
    }

    /// Solves the symmetric positive definite system whose lower triangle is `a` (Cholesky).
    fn solve(mut a: Normal, mut b: Parameters, n: usize) -> Parameters {
        for i in 0..n {
            for j in 0..=i {
                let mut sum = a[i][j];
                for k in 0..j {
                    sum -= a[i][k] * a[j][k];
                }
                a[i][j] = if i == j { sum.max(1e-300).sqrt() } else { sum / a[j][j] };
            }
        }
        for i in 0..n {
            for k in 0..i {
                b[i] -= a[i][k] * b[k];
            }
            b[i] /= a[i][i];
        }
        for i in (0..n).rev() {
            for k in i + 1..n {
                b[i] -= a[k][i] * b[k];
            }
            b[i] /= a[i][i];
        }
        b
    }
}
