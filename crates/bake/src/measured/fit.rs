//! A measured BRDF as a Lambertian base and a few lobes of the half vector.
//!
//! With roughnesses given, the BRDF is linear in the colours: those of the base and, per
//! lobe, those at normal and at grazing incidence. They are eliminated, non-negative and
//! with the table's own energy, so that only the roughnesses are searched: a new lobe is
//! the best of a fixed choice, then all are refined one after the other.
//!
//! What is minimised is ∫∫ (fit − table)² (n·i)² / (table n·i + floor) over light directions
//! and, at equal projected solid angles, of view: as if light were counted, and with both as
//! lights of some width see them. Without the width, a peak narrower than any lobe fits nowhere,
//! and its energy ends where squares are cheapest, in the base. Plain squares see nothing but the
//! peak; weights that favour the faint parts more lose the highlight. What is reported are plain
//! squares.
//!
//! The base is no brighter than the table where it is dark.

use glam::{Vec2, Vec3};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use relight_format::math;
use relight_format::{FittedLobe, MAX_FITTED_LOBES, Specular, Surface, Texture, TextureSlot};
use relight_shading::brdf::specular_lobes;
use relight_shading::surface::{
    Appearance, MIN_ALPHA, Model, Reflection, fitted_reflection, local_point,
};
use relight_shading::{models, reference};

use super::{Table, radical_inverse, ratio};
use crate::solve::amplitude;

/// When to stop adding lobes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// At this many, 1 to [`MAX_FITTED_LOBES`].
    Lobes(usize),
    /// When a lobe takes less than this fraction off the error that is minimised and off the plain
    /// one as it is shaded, or at the most lobes.
    Gain(f64),
}

impl Default for Stop {
    /// A twentieth.
    fn default() -> Self {
        Self::Gain(0.05)
    }
}

/// A fit and how good it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Linear Rec.709 albedo of the base.
    pub diffuse: [f32; 3],
    /// The lobes, widest first.
    pub lobes: Vec<FittedLobe>,
    /// Relative L2 error of the fitted model, cosine included.
    pub relative_l2: f64,
    /// The same of the spherical Gaussians that the runtime makes of it.
    pub shaded_relative_l2: f64,
    /// Largest error of the albedo towards one of the view directions, as a fraction of it.
    pub albedo_error: f64,
}

impl Fit {
    /// As a surface of an asset; `path` names the table, `ratio` the texture of what is missing.
    pub fn surface(&self, path: String, ratio: Option<TextureSlot>) -> Surface {
        Surface::DiffuseSpecular {
            diffuse: self.diffuse,
            specular: Specular::Lobes {
                path,
                lobes: self.lobes.clone(),
                ratio,
            },
        }
    }

    /// As what the reference models evaluate.
    pub(crate) fn appearance(&self) -> Appearance<'static> {
        let reflections: Vec<_> = self.lobes.iter().map(fitted_reflection).collect();
        Appearance::new(Vec3::from(self.diffuse), &reflections)
    }
}

/// View elevations, and light directions for each.
const VIEWS: u32 = 14;
const LIGHTS: u32 = 512;
/// Roughnesses a new lobe is chosen from.
const CHOICES: usize = 28;
/// Of the lights that see table and fit: a spherical Gaussian about 5° wide, as environments have
/// them, and wider than the narrowest lobe.
const LIGHT_SHARPNESS: f32 = 500.0;
/// Exponent from which on a light is dark.
const NEGLIGIBLE: f32 = 9.0;
/// Floor of the weights, as a fraction of the mean reflected light.
const FLOOR: f64 = 0.1;
/// The base is at most what the table exceeds in all but this part of the projected solid angle.
const DARK: f64 = 0.25;
/// Passes over all roughnesses after a lobe was added.
const SWEEPS: usize = 3;

/// One measured value to be fitted.
struct Pair {
    light: Vec3,
    view: Vec3,
    value: Vec3,
    /// Solid angle that the light direction stands for.
    solid_angle: f64,
}

impl Pair {
    fn energy(&self) -> f64 {
        f64::from(self.value.element_sum() * self.light.z) * self.solid_angle
    }
}

/// The pairs as lights of [`LIGHT_SHARPNESS`] see them, and the weights of squares.
struct Measure<'a> {
    pairs: &'a [Pair],
    /// Per pair: the pairs of the same view that a light about it sees, and their parts of it.
    seen: Vec<Vec<(u32, f32)>>,
    /// By the light that a pair reflects over a floor; roots, times those of solid angles.
    roots: Vec<f64>,
}

impl<'a> Measure<'a> {
    fn new(pairs: &'a [Pair]) -> Self {
        let mut first = 0;
        let mut seen = Vec::with_capacity(pairs.len());
        for view in pairs.chunk_by(|a, b| a.view == b.view) {
            seen.par_extend(view.par_iter().map(|pair| {
                let others = view.iter().zip(first..).filter_map(|(other, index)| {
                    let aside = 0.5 * (pair.light - other.light).length_squared();
                    let exponent = LIGHT_SHARPNESS * aside;
                    let part = other.solid_angle as f32 * math::exp(-exponent);
                    (exponent < NEGLIGIBLE).then_some((index, part))
                });
                // Where directions are sparse a light sees that about which it is.
                let mut seen: Vec<(u32, f32)> = others.collect();
                let whole: f32 = seen.iter().map(|(_, part)| part).sum();
                for (_, part) in &mut seen {
                    *part /= whole;
                }
                seen
            }));
            first += view.len() as u32;
        }
        let mut measure = Self {
            pairs,
            seen,
            roots: Vec::new(),
        };
        let cosine = |pair: &Pair| f64::from(pair.value.element_sum() * pair.light.z);
        let values = measure.see(&pairs.iter().map(cosine).collect::<Vec<_>>());
        let energy: f64 = pairs.iter().map(Pair::energy).sum();
        let total: f64 = pairs.iter().map(|pair| pair.solid_angle).sum();
        let floor = FLOOR * energy / total;
        let root = |(pair, value): (&Pair, &f64)| {
            (pair.solid_angle / (value + floor).max(f64::MIN_POSITIVE)).sqrt()
        };
        measure.roots = pairs.iter().zip(&values).map(root).collect();
        measure
    }

    fn see(&self, values: &[f64]) -> Vec<f64> {
        let sum = |seen: &Vec<(u32, f32)>| {
            let parts = seen.iter();
            parts
                .map(|&(index, part)| f64::from(part) * values[index as usize])
                .sum()
        };
        self.seen.par_iter().map(sum).collect()
    }
}

/// A table's lobes, and what they are multiplied by to be the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Corrected {
    /// The lobes.
    pub fit: Fit,
    /// The ratio between the table and them, `ratio::texture`.
    pub ratio: Texture,
    /// Relative L2 error of both together, cosine included.
    pub relative_l2: f64,
}

/// Fits a table: what scenes, `bake material` and viewers show.
pub fn corrected(table: &Table, stop: Stop) -> Corrected {
    let pairs = pairs(table);
    let fit = fit_pairs(&pairs, stop);
    let ratio = ratio::texture(table, &fit.appearance());
    let mut appearance = fit.appearance();
    for reflection in &mut appearance.reflections[..fit.lobes.len()] {
        reflection.ratio = Some(&ratio);
    }
    let relative_l2 = measure(&pairs, &appearance).relative_l2;
    Corrected {
        fit,
        ratio,
        relative_l2,
    }
}

/// Directions drawn from highlights of every width, and from the table's own density.
fn pairs(table: &Table) -> Vec<Pair> {
    let proposal = Appearance::new(
        Vec3::ONE,
        &[0.02, 0.06, 0.2, 0.5]
            .map(|alpha| Reflection::new(Model::Ggx, Vec3::ONE, Vec2::splat(alpha))),
    );
    let mut pairs = Vec::new();
    for elevation in 0..VIEWS {
        let sine = ((elevation as f32 + 0.5) / VIEWS as f32).sqrt();
        let view = Vec3::new(sine, 0.0, (1.0 - sine * sine).sqrt());
        for index in 0..LIGHTS {
            let uniform = [
                (index as f32 + 0.5) / LIGHTS as f32,
                radical_inverse(index),
                (index as f32 * 0.618_034).fract(),
            ];
            let draws = [
                reference::sample(&proposal, view, uniform),
                table.sample(view, uniform),
            ];
            for light in draws.into_iter().flatten() {
                let density = reference::pdf(&proposal, light, view) + table.pdf(light, view);
                let solid_angle = 1.0 / (f64::from(density) * f64::from(LIGHTS));
                let value = table.evaluate(light, view).max(Vec3::ZERO);
                if solid_angle.is_finite() && value.is_finite() {
                    pairs.push(Pair {
                        light,
                        view,
                        value,
                        solid_angle,
                    });
                }
            }
        }
    }
    pairs
}

/// Albedos of the brightest base, by [`DARK`].
fn brightest_base(pairs: &[Pair]) -> [f64; 3] {
    [0, 1, 2].map(|channel| {
        let mut values: Vec<(f32, f64)> = pairs
            .iter()
            .map(|pair| {
                let projected = pair.solid_angle * f64::from(pair.light.z);
                (pair.value[channel], projected)
            })
            .collect();
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut left: f64 = DARK * values.iter().map(|(_, projected)| projected).sum::<f64>();
        let dark = values.iter().find(|(_, projected)| {
            left -= projected;
            left <= 0.0
        });
        dark.map_or(0.0, |(value, _)| std::f64::consts::PI * f64::from(*value))
    })
}

/// Values of one basis function at all pairs, times cosine, as lights see them, times the roots of
/// solid angle and weight; and their energy.
#[derive(Clone)]
struct Column {
    values: Vec<f64>,
    energy: f64,
}

impl Column {
    fn new(measure: &Measure, function: impl Fn(&Pair) -> f32) -> Self {
        let mut energy = 0.0;
        let plain: Vec<f64> = (measure.pairs.iter())
            .map(|pair| {
                let value = f64::from(function(pair)) * f64::from(pair.light.z);
                energy += value * pair.solid_angle;
                value
            })
            .collect();
        let mut values = measure.see(&plain);
        for (value, root) in values.iter_mut().zip(&measure.roots) {
            *value *= root;
        }
        Self { values, energy }
    }

    fn dot(&self, other: &Self) -> f64 {
        self.values
            .iter()
            .zip(&other.values)
            .map(|(a, b)| a * b)
            .sum()
    }

    /// The two functions of a lobe: the colours at normal and at grazing incidence.
    fn of_lobe(measure: &Measure, roughness: f32) -> [Self; 2] {
        let lobe = |specular: f32, grazing: f32| Reflection {
            grazing: Vec3::splat(grazing),
            ..Reflection::new(
                Model::CookTorrance,
                Vec3::splat(specular),
                Vec2::splat(roughness),
            )
        };
        [lobe(1.0, 0.0), lobe(0.0, 1.0)].map(|reflection| {
            Self::new(measure, |pair| {
                models::evaluate_specular(&reflection, pair.light, pair.view).x
            })
        })
    }
}

/// Colours of all basis functions, channel by channel, and the squared error.
struct Solution {
    colors: [Vec<f64>; 3],
    error: f64,
}

/// The first column is the base, each channel of which is at most `brightest` unless it is alone.
fn solve(columns: &[&Column], targets: &[Column; 3], brightest: [f64; 3]) -> Solution {
    let norms: Vec<f64> = columns
        .iter()
        .map(|column| column.dot(column).sqrt().max(f64::MIN_POSITIVE))
        .collect();
    let count = columns.len();
    let mut gram = DMatrix::zeros(count, count);
    for i in 0..count {
        for j in 0..=i {
            let dot = columns[i].dot(columns[j]) / (norms[i] * norms[j]);
            gram[(i, j)] = dot;
            gram[(j, i)] = dot;
        }
    }
    let scaled = |f: &dyn Fn(&Column) -> f64| {
        DVector::from_iterator(
            count,
            columns
                .iter()
                .zip(&norms)
                .map(|(column, norm)| f(column) / norm),
        )
    };
    let energy = scaled(&|column| column.energy);
    let mut error = 0.0;
    let colors = [0, 1, 2].map(|channel| {
        let (target, most) = (&targets[channel], brightest[channel] * norms[0]);
        let projected = scaled(&|column| column.dot(target));
        let mut free = vec![true; count];
        let mut amplitudes =
            amplitude::solve(&gram, &projected, &energy, target.energy, &mut free).values;
        if amplitudes[0] > most && count > 1 {
            // The lobes have what the base at its brightest leaves of the target.
            let rest = gram.view((1, 1), (count - 1, count - 1)).into_owned();
            let left = projected.rows(1, count - 1) - most * gram.view((1, 0), (count - 1, 1));
            let left_energy = target.energy - most * energy[0];
            let energy = energy.rows(1, count - 1).into_owned();
            let mut free = vec![true; count - 1];
            let lobes = amplitude::solve(&rest, &left, &energy, left_energy, &mut free).values;
            amplitudes = std::iter::once(most).chain(lobes).collect();
        }
        let x = DVector::from_column_slice(&amplitudes);
        error += target.dot(target) - 2.0 * x.dot(&projected) + x.dot(&(&gram * &x));
        amplitudes
            .iter()
            .zip(&norms)
            .map(|(value, norm)| value / norm)
            .collect()
    });
    Solution { colors, error }
}

fn fit_pairs(pairs: &[Pair], stop: Stop) -> Fit {
    let measure = &Measure::new(pairs);
    let base = Column::new(measure, |_| std::f32::consts::FRAC_1_PI);
    let targets = [0, 1, 2].map(|channel| Column::new(measure, |pair| pair.value[channel]));
    let brightest = brightest_base(pairs);
    let ratio = math::powf(MIN_ALPHA.recip(), 1.0 / (CHOICES - 1) as f32);
    let choices: Vec<(f32, [Column; 2])> = (0..CHOICES)
        .map(|i| {
            let roughness = (MIN_ALPHA * ratio.powi(i as i32)).min(1.0);
            (roughness, Column::of_lobe(measure, roughness))
        })
        .collect();
    let with = |lobes: &[(f32, [Column; 2])]| {
        let columns: Vec<&Column> = std::iter::once(&base)
            .chain(lobes.iter().flat_map(|(_, columns)| columns))
            .collect();
        solve(&columns, &targets, brightest)
    };
    // What is plainly seen counts as well as what is minimised.
    let plain = |lobes: &[(f32, [Column; 2])], solution: &Solution| {
        measured(pairs, lobes, solution).shaded_relative_l2
    };
    let most = match stop {
        Stop::Lobes(count) => count.clamp(1, MAX_FITTED_LOBES),
        Stop::Gain(_) => MAX_FITTED_LOBES,
    };
    let mut lobes: Vec<(f32, [Column; 2])> = Vec::new();
    let mut best = with(&lobes);
    while lobes.len() < most {
        let before = best.error;
        let mut candidate = lobes.clone();
        let (_, choice) = choices
            .iter()
            .map(|choice| {
                candidate.push(choice.clone());
                let error = with(&candidate).error;
                candidate.pop();
                (error, choice)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .expect("choices");
        candidate.push(choice.clone());
        let mut refined = with(&candidate);
        for sweep in 0..SWEEPS {
            let step = math::powf(ratio, 0.5f32.powi(sweep as i32 + 1));
            for index in 0..candidate.len() {
                for factor in [step, step.recip()] {
                    let old = candidate[index].clone();
                    let roughness = (old.0 * factor).clamp(MIN_ALPHA, 1.0);
                    candidate[index] = (roughness, Column::of_lobe(measure, roughness));
                    let changed = with(&candidate);
                    if changed.error < refined.error {
                        refined = changed;
                        break;
                    }
                    candidate[index] = old;
                }
            }
        }
        if let Stop::Gain(least) = stop
            && !lobes.is_empty()
        {
            let weighted = (refined.error.max(0.0) / before.max(f64::MIN_POSITIVE)).sqrt();
            let plain = plain(&candidate, &refined) / plain(&lobes, &best).max(f64::MIN_POSITIVE);
            if 1.0 - weighted.min(plain) < least {
                break;
            }
        }
        (lobes, best) = (candidate, refined);
    }
    measured(pairs, &lobes, &best)
}

/// The fit of a solution, with its errors.
fn measured(pairs: &[Pair], lobes: &[(f32, [Column; 2])], solution: &Solution) -> Fit {
    let color = |index: usize| [0, 1, 2].map(|channel| solution.colors[channel][index] as f32);
    let mut fitted: Vec<FittedLobe> = lobes
        .iter()
        .enumerate()
        .map(|(index, (roughness, _))| FittedLobe {
            f0: color(1 + 2 * index),
            f90: color(2 + 2 * index),
            roughness: *roughness,
        })
        .collect();
    fitted.sort_by(|a, b| b.roughness.total_cmp(&a.roughness));
    let fit = Fit {
        diffuse: color(0),
        lobes: fitted,
        relative_l2: 0.0,
        shaded_relative_l2: 0.0,
        albedo_error: 0.0,
    };
    let errors = measure(pairs, &fit.appearance());
    Fit {
        relative_l2: errors.relative_l2,
        shaded_relative_l2: errors.shaded_relative_l2,
        albedo_error: errors.albedo_error,
        ..fit
    }
}

/// The BRDF in 1/sr that the runtime's lobes come to, of the unit vector towards the light.
pub(super) fn as_shaded(appearance: &Appearance, view: Vec3) -> impl Fn(Vec3) -> Vec3 + use<> {
    let point = local_point(*appearance, view);
    let lobes: Vec<_> = appearance
        .reflections()
        .flat_map(|reflection| specular_lobes(&point, reflection).as_slice().to_vec())
        .collect();
    let diffuse = appearance.diffuse * std::f32::consts::FRAC_1_PI;
    move |light| lobes.iter().map(|lobe| lobe.evaluate(light)).sum::<Vec3>() + diffuse
}

/// How far an appearance is from the pairs.
struct Errors {
    relative_l2: f64,
    shaded_relative_l2: f64,
    albedo_error: f64,
}

fn measure(pairs: &[Pair], appearance: &Appearance) -> Errors {
    let mut albedo_error = 0f64;
    let (mut errors, mut norm) = ([0.0; 2], 0.0);
    for view in pairs.chunk_by(|a, b| a.view == b.view) {
        let as_shaded = as_shaded(appearance, view[0].view);
        let (mut albedo, mut exact) = (0.0, 0.0);
        for pair in view {
            let model = models::evaluate(appearance, pair.light, pair.view);
            let shaded = as_shaded(pair.light);
            let cosine = f64::from(pair.light.z);
            let square =
                |v: Vec3| f64::from(v.length_squared()) * cosine * cosine * pair.solid_angle;
            errors[0] += square(model - pair.value);
            errors[1] += square(shaded - pair.value);
            norm += square(pair.value);
            albedo += f64::from(shaded.element_sum()) * cosine * pair.solid_angle;
            exact += f64::from(pair.value.element_sum()) * cosine * pair.solid_angle;
        }
        albedo_error = albedo_error.max((albedo / exact - 1.0).abs());
    }
    let [relative_l2, shaded_relative_l2] =
        errors.map(|error| (error / norm.max(f64::MIN_POSITIVE)).sqrt());
    Errors {
        relative_l2,
        shaded_relative_l2,
        albedo_error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs whose values are those of a surface of the fitted kind.
    fn made(truth: &Appearance) -> Vec<Pair> {
        let proposal = [0.05, 0.2, 0.6]
            .map(|alpha| Reflection::new(Model::Ggx, Vec3::ONE, Vec2::splat(alpha)));
        let proposal = Appearance::new(Vec3::ONE, &proposal);
        let mut pairs = Vec::new();
        for sine in [0.1f32, 0.4, 0.7, 0.9] {
            let view = Vec3::new(sine, 0.0, (1.0 - sine * sine).sqrt());
            for index in 0..256 {
                let uniform = [
                    (index as f32 + 0.5) / 256.0,
                    radical_inverse(index),
                    (index as f32 * 0.618_034).fract(),
                ];
                if let Some(light) = reference::sample(&proposal, view, uniform) {
                    pairs.push(Pair {
                        light,
                        view,
                        value: models::evaluate(truth, light, view),
                        solid_angle: 1.0
                            / (256.0 * f64::from(reference::pdf(&proposal, light, view))),
                    });
                }
            }
        }
        pairs
    }

    #[test]
    fn lobes_of_the_fitted_kind_are_recovered() {
        let lobe = |f0: [f32; 3], f90: f32, roughness| FittedLobe {
            f0,
            f90: [f90; 3],
            roughness,
        };
        let lobes = [
            lobe([0.1, 0.2, 0.3], 0.4, 0.5),
            lobe([0.5, 0.4, 0.3], 0.9, 0.1),
        ];
        let truth = Appearance::new(
            Vec3::new(0.3, 0.2, 0.1),
            &lobes.map(|l| fitted_reflection(&l)),
        );
        let pairs = made(&truth);
        let one = fit_pairs(&pairs, Stop::Lobes(1));
        let two = fit_pairs(&pairs, Stop::Lobes(2));
        println!("{one:?}\n{two:?}");
        assert!(two.relative_l2 < 0.3 * one.relative_l2, "{two:?}");
        // The search ends within an eighth of its steps, which are factors of 1.16.
        for (found, expected) in two.lobes.iter().zip(lobes) {
            assert!(
                math::ln(found.roughness / expected.roughness).abs() < 0.1,
                "{found:?}"
            );
        }
    }

    #[test]
    fn a_peak_narrower_than_any_lobe_does_not_brighten_the_base() {
        let mut peak = Reflection::new(Model::Ggx, Vec3::splat(0.8), Vec2::splat(0.1));
        peak.alpha = Vec2::splat(0.3 * MIN_ALPHA);
        let base = Vec3::new(0.03, 0.02, 0.01);
        let fit = fit_pairs(&made(&Appearance::new(base, &[peak])), Stop::default());
        for (found, exact) in fit.diffuse.iter().zip(base.to_array()) {
            assert!(*found < 1.3 * exact, "{fit:?}");
        }
        let wide: f32 = (fit.lobes.iter().filter(|lobe| lobe.roughness > 0.3))
            .map(|lobe| lobe.f0[0])
            .sum();
        assert!(wide < 0.02 && fit.albedo_error < 0.1, "{fit:?}");
    }

    #[test]
    fn more_lobes_are_never_worse_and_keep_the_energy() {
        let truth = Appearance::new(
            Vec3::new(0.2, 0.1, 0.05),
            &[Reflection::new(
                Model::Ggx,
                Vec3::new(0.9, 0.6, 0.3),
                Vec2::splat(0.15),
            )],
        );
        let pairs = made(&truth);
        let energy = |f: &dyn Fn(&Pair) -> Vec3| -> f64 {
            pairs
                .iter()
                .map(|p| f64::from(f(p).element_sum() * p.light.z) * p.solid_angle)
                .sum()
        };
        let exact = energy(&|pair| pair.value);
        let mut last = f64::INFINITY;
        for count in 1..=4 {
            let fit = fit_pairs(&pairs, Stop::Lobes(count));
            assert!(fit.relative_l2 <= last, "{count}: {fit:?}");
            last = fit.relative_l2;
            let appearance = fit.appearance();
            let found = energy(&|p| models::evaluate(&appearance, p.light, p.view));
            // The constraint, and colours in f32.
            assert!(
                (found / exact - 1.0).abs() < 1e-4,
                "{count}: {}",
                found / exact
            );
        }
        // GGX is not a sum of a few Gaussians, but nearly.
        assert!(last < 0.05, "{last}");
    }
}
