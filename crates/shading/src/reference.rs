//! Sampling of the exact reflection models of `models`, as a path tracer and a fit need it. On the CPU only.

use relight_format::math;
use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use crate::models::{half_vector_pdf, sample_half_vector};
use crate::surface::{Appearance, MAX_REFLECTIONS, Model};

/// Draws an incident direction from three uniform numbers in [0, 1). `None` where the
/// draw falls below the surface: such a sample counts, with weight zero.
pub fn sample(appearance: &Appearance, wo: Vec3, u: [f32; 3]) -> Option<Vec3> {
    if wo.z <= 0.0 {
        return None;
    }
    let [diffuse, specular @ ..] = probabilities(appearance, wo)?;
    let mut rest = u[0] - diffuse;
    let mut chosen = None;
    if rest >= 0.0 {
        for (reflection, probability) in appearance.reflections.iter().zip(specular) {
            if probability > 0.0 {
                chosen = Some(reflection);
                rest -= probability;
                if rest < 0.0 {
                    break;
                }
            }
        }
    }
    let wi = if let Some(reflection) = chosen {
        let half = sample_half_vector(reflection, wo, u[1], u[2]);
        2.0 * half.dot(wo) * half - wo
    } else {
        let (sin, cos) = math::sin_cos(2.0 * PI * u[2]);
        let radius = u[1].sqrt();
        Vec3::new(radius * cos, radius * sin, (1.0 - u[1]).sqrt())
    };
    (wi.z > 0.0).then_some(wi)
}

/// Density of [`sample`] at `wi`, per steradian. Its integral over the hemisphere is the
/// probability that [`sample`] returns a direction.
pub fn pdf(appearance: &Appearance, wi: Vec3, wo: Vec3) -> f32 {
    if wi.z <= 0.0 || wo.z <= 0.0 {
        return 0.0;
    }
    let Some([diffuse, specular @ ..]) = probabilities(appearance, wo) else {
        return 0.0;
    };
    let half = (wi + wo).normalize();
    let mut density = diffuse * wi.z * FRAC_1_PI;
    for (reflection, probability) in appearance.reflections.iter().zip(specular) {
        if probability > 0.0 {
            density += probability * half_vector_pdf(reflection, half, wo) / (4.0 * half.dot(wo));
        }
    }
    density
}

/// How often [`sample`] chooses the diffuse base, then each reflection; `None` for a black
/// surface.
fn probabilities(appearance: &Appearance, wo: Vec3) -> Option<[f32; 1 + MAX_REFLECTIONS]> {
    let mut weights = [0.0; 1 + MAX_REFLECTIONS];
    weights[0] = appearance.diffuse.element_sum();
    for (weight, reflection) in weights[1..].iter_mut().zip(&appearance.reflections) {
        if reflection.model != Model::None {
            *weight = reflection.color(wo.z).element_sum();
        }
    }
    let sum: f32 = weights.iter().sum();
    (sum > 0.0).then(|| weights.map(|weight| weight / sum))
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use crate::models::evaluate;
    use crate::surface::Reflection;

    /// Surfaces of every model, smooth and rough, isotropic and not where the model can.
    fn appearances() -> impl Iterator<Item = Appearance<'static>> {
        let base = Vec3::new(0.3, 0.2, 0.1);
        let reflection =
            |model, x, y| Reflection::new(model, Vec3::new(0.5, 0.6, 0.7), Vec2::new(x, y));
        let surface = move |model, x, y| Appearance::new(base, &[reflection(model, x, y)]);
        let diffuse = surface(Model::None, 1.0, 1.0);
        let mixed = Appearance::new(
            base,
            &[
                reflection(Model::Ggx, 0.1, 0.3),
                Reflection {
                    grazing: Vec3::splat(0.4),
                    ..reflection(Model::CookTorrance, 0.4, 0.4)
                },
                reflection(Model::Ward, 0.2, 0.2),
            ],
        );
        [diffuse, mixed]
            .into_iter()
            .chain(Model::ALL.into_iter().flat_map(move |model| {
                let alphas = match model {
                    Model::BlinnPhong => [(4.0, 4.0), (40.0, 40.0)],
                    Model::CookTorrance => [(0.15, 0.15), (0.6, 0.6)],
                    _ => [(0.15, 0.5), (0.6, 0.6)],
                };
                alphas.map(|(x, y)| surface(model, x, y))
            }))
    }

    fn views() -> impl Iterator<Item = Vec3> {
        [(5.0f32, 0.3f32), (40.0, 1.2), (70.0, -2.0)]
            .into_iter()
            .map(|(degrees, azimuth)| {
                let (sin, cos) = math::sin_cos(degrees.to_radians());
                Vec3::new(sin * math::cos(azimuth), sin * math::sin(azimuth), cos)
            })
    }

    /// The unit square, stratified and jittered by a golden-ratio sequence: the same
    /// numbers on every run.
    fn draws(n: u32) -> impl Iterator<Item = [f32; 3]> {
        // Roberts 2018, "The unreasonable effectiveness of quasirandom sequences", d = 3.
        let steps = [
            0.819_172_513_396_164_4_f64,
            0.671_043_606_703_789_2,
            0.549_700_477_901_970_8,
        ];
        (0..n).map(move |i| steps.map(|step| (f64::from(i) * step).fract() as f32))
    }

    /// Directions of a midpoint grid over the upper hemisphere with their solid angle.
    fn hemisphere(rows: u32, columns: u32) -> impl Iterator<Item = (Vec3, f32)> {
        (0..rows).flat_map(move |row| {
            // Quadratic in z: dense near the horizon, where densities change fast.
            let u = (row as f32 + 0.5) / rows as f32;
            let z = u * u;
            let solid_angle = 2.0 * u / rows as f32 * 2.0 * PI / columns as f32;
            (0..columns).map(move |column| {
                let azimuth = 2.0 * PI * (column as f32 + 0.5) / columns as f32;
                let sine = (1.0 - z * z).sqrt();
                (
                    Vec3::new(sine * math::cos(azimuth), sine * math::sin(azimuth), z),
                    solid_angle,
                )
            })
        })
    }

    /// A few roundings in quotients of `f32`.
    const ROUNDING: f32 = 1e-4;

    #[test]
    fn reflection_is_reciprocal_and_ends_at_the_horizon() {
        for appearance in appearances() {
            for wo in views() {
                for (wi, _) in hemisphere(7, 11) {
                    let there = evaluate(&appearance, wi, wo);
                    let back = evaluate(&appearance, wo, wi);
                    let scale = there.max_element().max(1e-3);
                    assert!(
                        there.distance(back) < ROUNDING * scale,
                        "{appearance:?} {wi} {wo}"
                    );
                    let below = Vec3::new(wi.x, wi.y, -wi.z);
                    assert_eq!(evaluate(&appearance, below, wo), Vec3::ZERO);
                    assert_eq!(evaluate(&appearance, wi, -wo), Vec3::ZERO);
                    assert_eq!(pdf(&appearance, below, wo), 0.0);
                }
            }
        }
    }

    /// Quadrature and 4096 quasi-random draws, each to about half a per cent.
    const INTEGRAL_TOLERANCE: f64 = 0.01;
    const DRAWS: u32 = 4096;

    #[test]
    fn densities_integrate_to_how_often_sampling_succeeds() {
        for appearance in appearances() {
            for wo in views() {
                let integral: f64 = hemisphere(256, 256)
                    .map(|(wi, solid_angle)| f64::from(pdf(&appearance, wi, wo) * solid_angle))
                    .sum();
                let drawn = draws(DRAWS)
                    .filter(|&u| sample(&appearance, wo, u).is_some())
                    .count();
                let drawn = drawn as f64 / f64::from(DRAWS);
                assert!(
                    (integral - drawn).abs() < INTEGRAL_TOLERANCE,
                    "{appearance:?} {wo}: {integral} and {drawn}"
                );
                assert!(drawn > 0.5);
            }
        }
    }

    /// Share of all draws by which a cell's count may be off: three standard deviations of
    /// independent draws for the fullest cell would be 0.023.
    const CELL_TOLERANCE: f64 = 0.012;

    #[test]
    fn samples_are_distributed_as_the_density_says() {
        const RINGS: usize = 6;
        const SECTORS: usize = 8;
        let cell = |w: Vec3| {
            let ring = ((w.z * RINGS as f32) as usize).min(RINGS - 1);
            let turn = math::atan2(w.y, w.x) / (2.0 * PI) + 0.5;
            ring * SECTORS + ((turn * SECTORS as f32) as usize).min(SECTORS - 1)
        };
        for appearance in appearances() {
            for wo in views() {
                let mut expected = [0.0; RINGS * SECTORS];
                for (wi, solid_angle) in hemisphere(256, 256) {
                    expected[cell(wi)] += f64::from(pdf(&appearance, wi, wo) * solid_angle);
                }
                let mut found = [0.0; RINGS * SECTORS];
                for wi in draws(DRAWS).filter_map(|u| sample(&appearance, wo, u)) {
                    found[cell(wi)] += 1.0 / f64::from(DRAWS);
                }
                for (expected, found) in expected.iter().zip(found) {
                    assert!(
                        (expected - found).abs() < CELL_TOLERANCE,
                        "{appearance:?} {wo}: {expected} and {found}"
                    );
                }
            }
        }
    }

    /// Albedo of a white surface by sampling.
    fn albedo(model: Model, alpha: f32, diffuse: f32, wo: Vec3) -> f64 {
        let reflection = Reflection::new(model, Vec3::ONE, Vec2::splat(alpha));
        let appearance = Appearance::new(Vec3::splat(diffuse), &[reflection]);
        let sum: f64 = draws(DRAWS)
            .filter_map(|u| sample(&appearance, wo, u))
            .map(|wi| {
                let value = evaluate(&appearance, wi, wo).x * wi.z;
                f64::from(value / pdf(&appearance, wi, wo))
            })
            .sum();
        sum / f64::from(DRAWS)
    }

    #[test]
    fn no_model_creates_energy() {
        // The usual Blinn-Phong factor (n + 8)/8π exceeds the exact one by up to 7 %, and
        // Ward's model with the Duer normalisation diverges at the horizon, which these views
        // stay away from: both are as published.
        let bounds = [
            (Model::BlinnPhong, [1.0, 10.0, 1000.0], 1.07),
            (Model::Ward, [0.02, 0.2, 1.0], 1.0),
            (Model::CookTorrance, [0.02, 0.2, 1.0], 1.0),
            (Model::Ggx, [0.02, 0.2, 1.0], 1.0),
            (Model::AshikhminShirley, [0.02, 0.2, 1.0], 1.0),
        ];
        for (model, alphas, bound) in bounds {
            for alpha in alphas {
                for wo in views() {
                    let found = albedo(model, alpha, 0.0, wo);
                    println!(
                        "{model:?} {alpha} at {:.0}°: {found:.3}",
                        math::acos(wo.z).to_degrees()
                    );
                    assert!(
                        found <= bound + INTEGRAL_TOLERANCE,
                        "{model:?} {alpha} {wo}: {found}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_white_furnace_is_white() {
        for wo in views() {
            // Smooth enough that no light is lost to masking.
            const ALPHA: f32 = 0.02;
            // Ashikhmin-Shirley's 1 / max(n·i, n·o) loses the mean of 1 − n·i / n·o where that
            // is positive. A half vector tilted by δ in the plane of incidence, of variance
            // α²/2, changes n·i / n·o by −2δ tan θ: it is α tan θ / √π, to first order in α.
            let tangent = wo.truncate().length() / wo.z;
            let lost = f64::from(ALPHA * tangent / PI.sqrt());
            for (model, expected) in [
                (Model::Ward, 1.0),
                (Model::CookTorrance, 1.0),
                (Model::Ggx, 1.0),
                (Model::AshikhminShirley, 1.0 - lost),
            ] {
                let found = albedo(model, ALPHA, 0.0, wo);
                assert!(
                    (found - expected).abs() < INTEGRAL_TOLERANCE,
                    "{model:?} {wo}: {found}, not {expected}"
                );
            }
            let found = albedo(Model::None, 1.0, 1.0, wo);
            assert!(
                (found - 1.0).abs() < INTEGRAL_TOLERANCE,
                "diffuse {wo}: {found}"
            );
        }
    }
}
