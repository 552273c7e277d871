//! Radiance of a surface point by the cells of Wang et al. (2013): lights times reflection, by the group of lobes.

use std::f32::consts::{FRAC_1_PI, FRAC_PI_2};

use glam::Vec3;

use crate::contribution::negligible;
use crate::glossy::Glossy;
use crate::shade::{
    CellsOptions, EVENLY, Lighting, Reflections, diffused, image_reflected, image_seen,
};
use crate::spherical_gaussian::SphericalGaussian;
use crate::ssdf::SignedDistance;
use crate::surface::SurfacePoint;
use crate::tables::Tables;
use crate::{cells, polar, slots};

/// Radiance from `point` towards the eye, by cells, but for that of sources; adds the number of groups of lobes that
/// were integrated.
pub(crate) fn radiance(
    point: &SurfacePoint,
    lighting: &Lighting,
    field: &impl SignedDistance,
    options: &CellsOptions,
    integrals: &mut u64,
) -> Vec3 {
    let lit = point.normal.dot(point.view) > 0.0;
    let mut radiance = Vec3::ZERO;
    groups(point, lighting, |about, lobes| {
        *integrals += 1;
        radiance += cells::integrate(field, about, point.normal, lobes, options);
    });
    if let Some(reflections) = lighting.reflections.as_ref().filter(|_| lit) {
        radiance += diffused(point, reflections, field, integrals);
        for reflection in point.appearance.reflections() {
            let glossy = Glossy::new(point, reflection);
            let visible = |lobe: &SphericalGaussian| {
                *integrals += 1;
                let about = (lobe.axis, polar::support_radius(lobe.sharpness));
                let lobe = SphericalGaussian {
                    amplitude: Vec3::ONE,
                    ..*lobe
                };
                cells::integrate(field, about, point.normal, &[lobe], options).x
            };
            radiance += reflected(&glossy, point, lighting, reflections, visible);
        }
    }
    radiance
}

/// The lobes that a reflection makes of lights, one after the other to `integrate`, which is given what
/// it returned last and returns it with what the lobe adds. In rounds: lobes are made of the lights until
/// [`slots::WAITING`] of them wait, of those that can add to what was gathered before.
fn in_rounds(
    glossy: &Glossy,
    lights: &[SphericalGaussian],
    mut integrate: impl FnMut(&SphericalGaussian, Vec3) -> Vec3,
) -> Vec3 {
    let mut gathered = Vec3::ZERO;
    let mut waiting = Vec::with_capacity(slots::WAITING as usize);
    for light in lights {
        let lobe = glossy.reflected(light, gathered);
        waiting.extend(lobe.filter(|lobe| !negligible(lobe.integral(), gathered)));
        if waiting.len() == slots::WAITING as usize {
            gathered = (waiting.drain(..)).fold(gathered, |sum, lobe| integrate(&lobe, sum));
        }
    }
    (waiting.drain(..)).fold(gathered, |sum, lobe| integrate(&lobe, sum))
}

/// Calls `visit` with lobes that share cells, the cells' pole and how far they reach: about the
/// normal all wide lights' diffuse reflection, about the mean axis of every specular reflection's
/// lobes its products with them, about their own axes all that is of narrow lights (Wang et al.
/// 2013, §5.1).
pub fn groups(
    point: &SurfacePoint,
    lighting: &Lighting,
    mut visit: impl FnMut((Vec3, f32), &[SphericalGaussian]),
) {
    if point.normal.dot(point.view) <= 0.0 {
        return;
    }
    let mut add = |about, lobes: &[SphericalGaussian]| {
        if !lobes.is_empty() {
            visit(about, lobes);
        }
    };
    let diffuse = point.appearance.diffuse * FRAC_1_PI;
    if diffuse != Vec3::ZERO {
        let (mut wide, mut narrow) = (Vec::new(), Vec::new());
        for light in lighting.at(point.position) {
            let group = if light.sharpness > cells::NARROW {
                &mut narrow
            } else {
                &mut wide
            };
            group.push(SphericalGaussian {
                amplitude: light.amplitude * diffuse,
                ..light
            });
        }
        add((point.normal, FRAC_PI_2), &wide);
        for lobe in narrow {
            add((lobe.axis, polar::support_radius(lobe.sharpness)), &[lobe]);
        }
    }
    for reflection in point.appearance.reflections() {
        let glossy = Glossy::new(point, reflection);
        let (mut wide, mut narrow) = (Vec::new(), Vec::new());
        let mut carried = Vec3::ZERO;
        for light in lighting.reflected_at(point.position) {
            let Some(product) = glossy.reflected(&light, Vec3::ZERO) else {
                continue;
            };
            carried += product.integral();
            if light.sharpness > cells::NARROW {
                narrow.push(product);
            } else {
                wide.push(product);
            }
        }
        let lobes: Vec<_> = glossy.lobes().collect();
        add(cells::around(&lobes), &wide);
        for lobe in narrow {
            if !negligible(lobe.integral(), carried) {
                add((lobe.axis, polar::support_radius(lobe.sharpness)), &[lobe]);
            }
        }
    }
}

/// What a specular reflection shows of the environment, by cells.
fn reflected(
    glossy: &Glossy,
    point: &SurfacePoint,
    lighting: &Lighting,
    reflections: &Reflections,
    mut visible: impl FnMut(&SphericalGaussian) -> f32,
) -> Vec3 {
    let normal = point.normal;
    let mut seen = Vec3::ZERO;
    let scaled = in_rounds(glossy, lighting.lights, |lobe, sum| {
        let cosine = normal.dot(lobe.axis);
        let whole = lobe.amplitude * Tables::get().cosine_integral(lobe.sharpness, cosine);
        if negligible(whole, sum) {
            return sum;
        }
        seen += lobe.amplitude * visible(lobe);
        sum + whole
    });
    let Some(even) = glossy.reflected(&EVENLY, Vec3::ZERO) else {
        return Vec3::ZERO;
    };
    let cosine = normal.dot(even.axis);
    let whole = Tables::get().cosine_integral(even.sharpness, cosine);
    let part = visible(&even) / whole.max(f32::MIN_POSITIVE);
    image_seen(image_reflected(glossy, reflections), scaled, seen, part)
}
