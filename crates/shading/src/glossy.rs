//! What a specular reflection shows of one light: a single Gaussian that carries the
//! reflection model's own value.
//!
//! The lobes of [`crate::brdf`] give the shape. A light times a handful of them is as many
//! Gaussians. How bright each is says the model: its value over that of all lobes, averaged over
//! five points of the Gaussian. So tails, grazing angles, Fresnel and masking are the model's
//! where lobes are only near it. Of a light that is wide beside the lobes five points tell less than the lobes, which
//! together have the model's albedo. Then one Gaussian replaces them, of the same integral over the cosine, mean direction
//! and spread, and visibility is integrated once for every light and reflection.

use glam::Vec3;
use relight_format::math;

use crate::brdf::{MAX_SPECULAR_LOBES, SpecularLobes, local_lobes};
use crate::contribution::negligible;
use crate::models;
use crate::spherical_gaussian::{SphericalGaussian, energy};
use crate::surface::{Reflection, SurfacePoint};
use crate::tables::Tables;

/// Points beside the centre lie at this many standard deviations along two axes: with the
/// weights below, the Gauss-Hermite rule of degree 3 in each.
const POINT_DEVIATIONS: f32 = 1.732_050_8;
const CENTER_WEIGHT: f32 = 1.0 / 3.0;
const POINT_WEIGHT: f32 = 1.0 / 6.0;
/// Largest tangent of the angle between the centre and another point.
const FARTHEST_POINT: f32 = 2.0;
/// Points of a Gaussian that look at the model.
const POINTS: usize = 5;
/// Least mean cosine over the points of a Gaussian that reflects at all.
const LEAST_COSINE: f32 = 1e-4;
/// Least mean cosine over all of the Gaussian that replaces them: of less, what is visible is known to few digits.
const LEAST_MEAN_COSINE: f32 = 0.004;
/// How sharp a light is, over the mean of the lobes that reflect it and times the cosine of the view and
/// [`VIEW_COSINE`], at which points count for as much as lobes.
const LOBE_PART: f32 = 0.025;
/// Added to the cosine of the view.
const VIEW_COSINE: f32 = 0.05;
/// Mean cosine of a Gaussian on the horizon, in its standard deviation.
const DEVIATION_COSINE: f32 = 0.4;
/// Least 1 − |mean vector|² of a Gaussian: below, roundings of unit vectors are as large.
const LEAST_SPREAD: f32 = 1e-7;
/// Least integral of a light's products, or of those times the cosine: below, their quotients are roundings.
const LEAST_MASS: f32 = 1e-30;
/// Products below this part of a light's are left to the others.
const LEAST_PART: f32 = 0.01;
/// Products below this part of a light's are as bright as the model is at their centre.
const MINOR_PART: f32 = 0.05;
/// So are those of a light that is so many times as sharp as their lobe: the model is one all over them.
const SHARPER: f32 = 64.0;
/// So are those that would add less than this to what has been gathered before, were the lobes the
/// model.
const FAINT: f32 = 0.002;
/// The model's value may exceed that of the lobes by this factor where a light is too faint to be
/// looked at.
const TAIL: f32 = 30.0;
/// Most by which a light's reflection may exceed its energy times the model's value at a point.
const EXCESS: f32 = 8.0;

/// One specular reflection of a surface point towards its eye, ready to meet lights.
pub struct Glossy<'a> {
    point: &'a SurfacePoint<'a>,
    reflection: &'a Reflection<'a>,
    /// In the point's frame.
    view: Vec3,
    /// In the point's frame, grey.
    shapes: SpecularLobes,
    /// What their amplitudes are multiplied by.
    color: Vec3,
}

impl<'a> Glossy<'a> {
    /// The reflection `reflection` of `point`.
    pub fn new(point: &'a SurfacePoint<'a>, reflection: &'a Reflection) -> Self {
        let view = point.to_local(point.view);
        let (shapes, color) = local_lobes(reflection, view);
        Self {
            point,
            reflection,
            view,
            shapes,
            color,
        }
    }

    /// The lobes in world space.
    pub fn lobes(&self) -> impl Iterator<Item = SphericalGaussian> {
        let shapes = self.shapes.as_slice().iter();
        shapes.map(|shape| SphericalGaussian {
            axis: self.point.to_world(shape.axis),
            amplitude: shape.amplitude.x * self.color,
            ..*shape
        })
    }

    /// The same, and what each reflects of a radiance of 1 from everywhere.
    pub fn whites(&self) -> impl Iterator<Item = (SphericalGaussian, Vec3)> {
        self.lobes().map(|lobe| {
            let cosine = self.point.normal.dot(lobe.axis);
            let integral = Tables::get().cosine_integral(lobe.sharpness, cosine);
            (lobe, lobe.amplitude * integral)
        })
    }

    /// What the reflection shows of `light`: the radiance towards the eye is the integral of the
    /// Gaussian times the cosine with the normal over what is visible. None where there is
    /// nothing to see, or nothing beside `gathered`.
    pub fn reflected(
        &self,
        light: &SphericalGaussian,
        gathered: Vec3,
    ) -> Option<SphericalGaussian> {
        if self.shapes.count == 0 {
            return None;
        }
        let white = SphericalGaussian {
            axis: self.point.to_local(light.axis),
            amplitude: Vec3::ONE,
            ..*light
        };
        let scale = self.color.element_sum();
        // Each with its integral, and a bound on that times the cosine.
        let mut products = [(white, 0.0, 0.0); MAX_SPECULAR_LOBES];
        let products = &mut products[..self.shapes.count];
        let (mut all, mut own) = (0.0, 0.0);
        for (shape, (product, part, shown)) in self.shapes.as_slice().iter().zip(&mut *products) {
            *product = white.product(&SphericalGaussian {
                amplitude: shape.amplitude * scale,
                ..*shape
            });
            *part = product.amplitude.x * energy(product.sharpness);
            *shown = *part * most_cosine(product);
            all += *shown;
            own += *shown * shape.sharpness;
        }
        let color = light.amplitude * (self.color / scale);
        if all < LEAST_MASS || negligible(TAIL * all * color, gathered) {
            return None;
        }
        // The part of the light up to which a product is faint.
        let faint = FAINT * gathered / color.max(Vec3::splat(f32::MIN_POSITIVE));
        let faint = faint.min_element();
        let by_points = self.by_points(light.sharpness, own / all);
        // Directions are differences to one among them, which keeps the digits of narrow
        // lobes.
        let mut origin = None;
        let (mut used, mut total) = (0.0, Vec3::ZERO);
        let (mut rest, mut squares, mut mean) = (0.0, 0.0, Vec3::ZERO);
        for (&(product, part, shown), shape) in products.iter().zip(self.shapes.as_slice()) {
            if shown < LEAST_PART * all {
                continue;
            }
            used += shown;
            let is_small = shown <= faint || shown < MINOR_PART * all;
            let points = if is_small || light.sharpness > SHARPER * shape.sharpness {
                1
            } else {
                POINTS
            };
            let most = EXCESS * energy(light.sharpness);
            let by_lobe = part * self.color / scale;
            let scaled = by_lobe.lerp(self.scaled(&product, part, most, points), by_points);
            let scaled = scaled * mean_cosine(product.sharpness, product.axis.z);
            total += scaled;
            let weight = scaled.element_sum();
            let short = shortening(product.sharpness);
            let offset = product.axis - *origin.get_or_insert(product.axis);
            rest += weight * short;
            mean += weight * (1.0 - short) * offset;
            squares += weight * (1.0 - short) * offset.length_squared();
        }
        let mass = total.element_sum();
        if mass < LEAST_MASS {
            return None;
        }
        let origin = origin?;
        (rest, mean, squares) = (rest / mass, mean / mass, squares / mass);
        // 1 − |m|² for the mean vector m = (1 − rest) origin + mean, without the difference
        // of nearly equal numbers: origin · mean is half the sum of squared offsets, below 0.
        let spread = rest * (2.0 - rest) + (1.0 - rest) * squares - mean.length_squared();
        let spread = spread.clamp(LEAST_SPREAD, 1.0);
        let sharpness = (1.0 - spread).sqrt() * (2.0 + spread) / spread;
        let axis = unit_or((1.0 - rest) * origin + mean, origin);
        let integral = energy(sharpness) * mean_cosine(sharpness, axis.z).max(LEAST_MEAN_COSINE);
        Some(SphericalGaussian {
            axis: self.point.to_world(axis),
            sharpness,
            amplitude: light.amplitude * total * (all / (used * integral)),
        })
    }

    /// How much points count for beside lobes, 0 to 1, for a light of some sharpness on lobes whose mean is `own`.
    fn by_points(&self, light: f32, own: f32) -> f32 {
        // The albedo of lobes that were fitted to a table is not the table's.
        if self.reflection.ratio.is_some() {
            return 1.0;
        }
        let sharp = light * (self.view.z + VIEW_COSINE);
        sharp / (sharp + LOBE_PART * own).max(f32::MIN_POSITIVE)
    }

    /// The integral of a product of a white light and a lobe, `part`, as the model makes it: in
    /// all at most `most` times the model's value. Of five points the first `points`.
    fn scaled(&self, product: &SphericalGaussian, part: f32, most: f32, points: usize) -> Vec3 {
        let reach = (POINT_DEVIATIONS / (product.sharpness + 0.5).sqrt()).min(FARTHEST_POINT);
        let (u, v) = frame(product.axis);
        let aside = |offset: Vec3| (product.axis + reach * offset).normalize();
        let scale = self.color.element_sum();
        let (mut sum, mut whole) = (Vec3::ZERO, 0.0);
        for index in 0..points {
            let direction = [Vec3::ZERO, u, -u, v, -v][index];
            let direction = if index == 0 {
                product.axis
            } else {
                aside(direction)
            };
            if direction.z > 0.0 {
                let shapes = self.shapes.as_slice().iter();
                let lobes: f32 = shapes.map(|shape| shape.evaluate(direction).x).sum();
                let model = models::evaluate_specular(self.reflection, direction, self.view);
                let weight = if index == 0 {
                    CENTER_WEIGHT
                } else {
                    POINT_WEIGHT
                };
                let times = (part / (lobes * scale).max(f32::MIN_POSITIVE)).min(most);
                sum += weight * direction.z * times * model;
                whole += weight * direction.z;
            }
        }
        sum / whole.max(LEAST_COSINE)
    }
}

/// A bound on [`mean_cosine`], near it for lobes that are narrow and above the horizon.
fn most_cosine(lobe: &SphericalGaussian) -> f32 {
    lobe.axis.z.max(0.0) + DEVIATION_COSINE / (lobe.sharpness + 1.0).sqrt()
}

/// Of a lobe's integral the part that is left of it times the cosine with the normal, to which its axis has `cosine`.
fn mean_cosine(sharpness: f32, cosine: f32) -> f32 {
    Tables::get().cosine_integral(sharpness, cosine) / energy(sharpness)
}

/// By how much a lobe's mean vector is shorter than 1: 1 − coth λ + 1/λ.
fn shortening(sharpness: f32) -> f32 {
    if sharpness < 0.25 {
        return 1.0 - sharpness * (1.0 / 3.0 - sharpness * sharpness / 45.0);
    }
    1.0 / sharpness - 2.0 / (math::exp(2.0 * sharpness.min(40.0)) - 1.0)
}

/// Two unit vectors at right angles to the unit vector `axis` (Duff et al. 2017).
fn frame(axis: Vec3) -> (Vec3, Vec3) {
    let sign = if axis.z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + axis.z);
    let b = axis.x * axis.y * a;
    (
        Vec3::new(1.0 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x),
        Vec3::new(b, sign + axis.y * axis.y * a, -axis.y),
    )
}

fn unit_or(vector: Vec3, otherwise: Vec3) -> Vec3 {
    let squared = vector.length_squared();
    if squared > 1e-30 {
        vector / squared.sqrt()
    } else {
        otherwise
    }
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let reals = [
        ("POINT_DEVIATIONS", POINT_DEVIATIONS),
        ("CENTER_WEIGHT", CENTER_WEIGHT),
        ("POINT_WEIGHT", POINT_WEIGHT),
        ("FARTHEST_POINT", FARTHEST_POINT),
        ("LEAST_COSINE", LEAST_COSINE),
        ("LEAST_MEAN_COSINE", LEAST_MEAN_COSINE),
        ("DEVIATION_COSINE", DEVIATION_COSINE),
        ("LEAST_SPREAD", LEAST_SPREAD),
        ("LEAST_MASS", LEAST_MASS),
        ("LEAST_PART", LEAST_PART),
        ("MINOR_PART", MINOR_PART),
        ("SHARPER", SHARPER),
        ("FAINT", FAINT),
        ("TAIL", TAIL),
        ("EXCESS", EXCESS),
        ("LOBE_PART", LOBE_PART),
        ("VIEW_COSINE", VIEW_COSINE),
    ];
    reals
        .map(|(name, value)| format!("const GLOSSY_{name}: f32 = {value:?};\n"))
        .concat()
        + &format!("const GLOSSY_POINTS: u32 = {POINTS}u;\n")
}

#[cfg(test)]
mod tests {
    use std::f32::consts::TAU;

    use glam::Vec2;

    use super::*;
    use crate::surface::{Appearance, Model, local_point};

    /// Of the brightest light's reflection, root mean square over the lights.
    const TOLERANCE: f32 = 0.03;

    /// Light from `light` that `reflection` sends to `view`, by quadrature over the hemisphere.
    fn exact(reflection: &Reflection, view: Vec3, light: &SphericalGaussian) -> f32 {
        const ROWS: u32 = 300;
        const COLUMNS: u32 = 600;
        let mut sum = 0.0;
        for row in 0..ROWS {
            let z = (row as f32 + 0.5) / ROWS as f32;
            for column in 0..COLUMNS {
                let azimuth = TAU * (column as f32 + 0.5) / COLUMNS as f32;
                let sine = (1.0 - z * z).sqrt();
                let wi = Vec3::new(sine * math::cos(azimuth), sine * math::sin(azimuth), z);
                sum += light.evaluate(wi).x * models::evaluate_specular(reflection, wi, view).x * z;
            }
        }
        sum * TAU / (ROWS * COLUMNS) as f32
    }

    #[test]
    fn a_light_is_reflected_as_the_model_has_it() {
        for (model, x, y) in [
            (Model::Ggx, 0.2, 0.2),
            (Model::Ggx, 0.5, 0.5),
            (Model::CookTorrance, 0.25, 0.25),
            (Model::Ward, 0.15, 0.4),
            (Model::Ggx, 0.08, 0.4),
        ] {
            let reflection = Reflection::new(model, Vec3::splat(0.8), Vec2::new(x, y));
            for degrees in [10f32, 45.0, 65.0, 80.0] {
                let (sine, cosine) = math::sin_cos(degrees.to_radians());
                let view = Vec3::new(0.8 * sine, 0.6 * sine, cosine);
                let point = local_point(Appearance::new(Vec3::ZERO, &[reflection]), view);
                let glossy = Glossy::new(&point, &reflection);
                let mirror = Vec3::new(-view.x, -view.y, view.z);
                let (mut squares, mut brightest, mut count) = (0.0, 0f32, 0);
                for sharpness in [0.5, 3.0, 40.0, 400.0] {
                    for aside in [0.0, 0.3, 0.9] {
                        // As much light at every sharpness.
                        let light = SphericalGaussian {
                            axis: (mirror + aside * Vec3::new(0.3, -0.5, 0.8)).normalize(),
                            sharpness,
                            amplitude: Vec3::splat(1.0 / energy(sharpness)),
                        };
                        let lobe = glossy.reflected(&light, Vec3::ZERO).expect("some light");
                        let whole = Tables::get().cosine_integral(lobe.sharpness, lobe.axis.z);
                        let found = lobe.amplitude.x * whole;
                        let expected = exact(&reflection, view, &light);
                        println!(
                            "{model:?} {x} {y} {degrees}° {sharpness} {aside}: {found} for {expected}"
                        );
                        squares += (found - expected) * (found - expected);
                        brightest = brightest.max(expected);
                        count += 1;
                    }
                }
                let error = (squares / count as f32).sqrt() / brightest;
                assert!(error < TOLERANCE, "{model:?} {x} {y} {degrees}°: {error}");
            }
        }
    }

    /// At grazing angles few points of a Gaussian lie where the model reflects.
    #[test]
    fn light_from_everywhere_is_reflected_by_the_albedo() {
        for (model, x, y, least) in [
            (Model::Ggx, 0.08, 0.4, 0.05),
            (Model::Ggx, 0.2, 0.2, 0.05),
            (Model::CookTorrance, 0.3, 0.3, 0.05),
            (Model::Ward, 0.15, 0.3, 0.2),
        ] {
            let reflection = Reflection::new(model, Vec3::ONE, Vec2::new(x, y));
            for cosine in [least, 0.3, 0.8f32] {
                for azimuth in [0.03f32, 0.8, 1.5] {
                    let (sin, cos) = math::sin_cos(azimuth);
                    let view =
                        (Vec2::new(cos, sin) * (1f32 - cosine * cosine).sqrt()).extend(cosine);
                    let point = local_point(Appearance::new(Vec3::ZERO, &[reflection]), view);
                    let everywhere = SphericalGaussian {
                        axis: Vec3::new(0.6, 0.0, 0.8),
                        sharpness: 1e-3,
                        amplitude: Vec3::ONE,
                    };
                    let lobe = Glossy::new(&point, &reflection)
                        .reflected(&everywhere, Vec3::ZERO)
                        .expect("some light");
                    let whole = Tables::get().cosine_integral(lobe.sharpness, lobe.axis.z);
                    let found = lobe.amplitude.x * whole;
                    let expected = exact(&reflection, view, &everywhere);
                    assert!(
                        (found / expected - 1.0).abs() < 0.06,
                        "{model:?} {x} {y} {view}: {found} for {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_sharp_light_stays_where_and_as_sharp_as_it_is() {
        let reflection = Reflection::new(Model::Ggx, Vec3::ONE, Vec2::splat(0.3));
        let view = Vec3::new(0.5, 0.0, 0.75f32.sqrt());
        let point = local_point(Appearance::new(Vec3::ZERO, &[reflection]), view);
        let light = SphericalGaussian {
            axis: Vec3::new(-0.7, 0.2, 0.6).normalize(),
            sharpness: 1e5,
            amplitude: Vec3::ONE,
        };
        let glossy = Glossy::new(&point, &reflection);
        let lobe = glossy.reflected(&light, Vec3::ZERO).expect("some light");
        assert!(
            (lobe.sharpness / light.sharpness - 1.0).abs() < 0.05,
            "{lobe:?}"
        );
        assert!(lobe.axis.distance(light.axis) < 1e-3, "{lobe:?}");
        assert!(glossy.reflected(&light, Vec3::splat(1e9)).is_none());
    }
}
