//! Light that bounces: what other surfaces reflect to a point, and what surfaces emit.
//!
//! Distant light is projected on real spherical harmonics, every group of clusters makes rows of
//! colours of it once per frame ([`PackedTransfer::products`]), every vertex weighs the rows (Sloan et al.
//! 2003, "Clustered Principal Components for Precomputed Radiance Transfer"), and pixels
//! interpolate the weights.

use relight_format::math;
use std::f32::consts::{FRAC_1_PI, PI};
use std::sync::OnceLock;

use glam::Vec3;
use relight_format::{MAX_TRANSFER_ORDER, MAX_TRANSFER_RANK, Scene, Transfer};

use crate::spherical_gaussian::SphericalGaussian;
use crate::ssdf::SignedDistance;
use crate::surface::{MIN_ALPHA, Model, Reflection, SurfacePoint};
use crate::tables::Tables;
use crate::{ambient, brdf, gpu, models};

/// Texels per row of the texture of colours, and of that of weights.
pub const TEXTURE_WIDTH: u32 = 1024;
/// Outputs of a row at most: the vector irradiance, then radiance as a constant and a slope.
pub const MAX_OUTPUTS: usize = 7;
/// Of these the first are the vector irradiance.
const IRRADIANCE_OUTPUTS: usize = 3;
/// Texels of a group in the texture of colours.
const STRIDE: usize = (MAX_TRANSFER_RANK as usize + 1) * MAX_OUTPUTS;
/// A local light counts as distant where it is this many radii from the middle of the
/// scene; nearer ones do not bounce.
const DISTANT: f32 = 2.0;

/// Real orthonormal spherical harmonics up to an order, without the Condon-Shortley phase:
/// number l (l + 1) + m, polar axis z.
#[derive(Clone, Debug)]
pub struct Harmonics {
    order: usize,
    /// The two factors of the recurrence in l, by number of the harmonic; m ≥ 0.
    factors: Vec<[f32; 2]>,
}

impl Harmonics {
    /// Those up to `order`.
    pub fn new(order: u32) -> Self {
        let order = order as usize;
        let mut factors = vec![[0.0; 2]; (order + 1) * (order + 1)];
        for l in 1..=order {
            for m in 0..l {
                let (l2, m2) = ((l * l) as f64, (m * m) as f64);
                let below = ((l - 1) * (l - 1)) as f64;
                let a = ((4.0 * l2 - 1.0) / (l2 - m2)).sqrt();
                let b = ((below - m2).max(0.0) / (4.0 * below - 1.0))
                    .max(0.0)
                    .sqrt();
                factors[l * (l + 1) + m] = [a as f32, (a * b) as f32];
            }
        }
        Self { order, factors }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        (self.order + 1) * (self.order + 1)
    }

    /// Their values in a unit direction, into the first [`Self::count`] elements.
    ///
    /// # Panics
    /// If `values` has fewer.
    pub fn evaluate(&self, direction: Vec3, values: &mut [f32]) {
        let Vec3 { x, y, z } = direction;
        // (x + iy)^m, and the harmonic of l = m without it.
        let (mut real, mut imaginary) = (1.0f32, 0.0f32);
        let mut start = (0.25 * f64::from(FRAC_1_PI)).sqrt() as f32;
        for m in 0..=self.order {
            if m > 0 {
                (real, imaginary) = (real * x - imaginary * y, real * y + imaginary * x);
                start *= ((2 * m + 1) as f32 / (2 * m) as f32).sqrt();
            }
            let (mut below, mut value) = (0.0, start);
            for l in m..=self.order {
                if l > m {
                    let [a, b] = self.factors[l * (l + 1) + m];
                    (below, value) = (value, a * z * value - b * below);
                }
                let middle = l * (l + 1);
                if m == 0 {
                    values[middle] = value;
                } else {
                    values[middle + m] = std::f32::consts::SQRT_2 * value * real;
                    values[middle - m] = std::f32::consts::SQRT_2 * value * imaginary;
                }
            }
        }
    }
}

/// ∫ exp(λ(cos θ − 1)) Pₗ(cos θ) dω for l from 0 to 9: what the projection of a spherical Gaussian
/// has in place of the harmonics' own length (Funk & Hecke), 4π e^(−λ) iₗ(λ) with the
/// modified spherical Bessel functions.
fn zonal(sharpness: f32) -> [f32; MAX_TRANSFER_ORDER as usize + 1] {
    const COUNT: usize = MAX_TRANSFER_ORDER as usize + 1;
    let lambda = f64::from(sharpness);
    let mut values = [0.0; COUNT];
    if lambda < 1e-6 {
        values[0] = 4.0 * PI;
        return values;
    }
    let whole = 2.0 * std::f64::consts::PI * -math::exp_m1(-2.0 * lambda) / lambda;
    if lambda > 40.0 {
        // Upwards: each from the two before, stable while l stays below λ.
        let slope = 1.0 / (math::tanh(lambda)) - 1.0 / lambda;
        let (mut before, mut value) = (1.0, slope);
        values[0] = whole as f32;
        for (l, stored) in values.iter_mut().enumerate().skip(1) {
            *stored = (whole * value) as f32;
            (before, value) = (value, before - (2 * l + 1) as f64 / lambda * value);
        }
        return values;
    }
    // Downwards from where they vanish (Miller), then to scale.
    let (mut above, mut value) = (0.0, 1e-300);
    let mut ratios = [0.0; COUNT];
    for l in (0..=120usize).rev() {
        if l < COUNT {
            ratios[l] = value;
        }
        (above, value) = (value, above + (2 * l + 1) as f64 / lambda * value);
        if value > 1e200 {
            (above, value) = (above * 1e-200, value * 1e-200);
            for ratio in &mut ratios {
                *ratio *= 1e-200;
            }
        }
    }
    for (value, ratio) in values.iter_mut().zip(ratios) {
        *value = (whole * ratio / ratios[0]) as f32;
    }
    values
}

/// Distant light as [`Transfer`] takes it: per channel `columns` numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct DistantLight {
    columns: usize,
    values: Vec<f32>,
}

impl DistantLight {
    /// The sum of lobes, for the orders of `transfer`.
    pub fn new<'a>(
        transfer: &Transfer,
        lobes: impl IntoIterator<Item = &'a SphericalGaussian>,
    ) -> Self {
        let harmonics = Harmonics::new(transfer.order);
        let columns = transfer.columns();
        let mut light = Self {
            columns,
            values: vec![0.0; 3 * columns],
        };
        let mut values = vec![0.0; harmonics.count()];
        for lobe in lobes {
            let zonal = zonal(lobe.sharpness);
            harmonics.evaluate(lobe.axis, &mut values);
            for (l, zonal) in zonal.iter().enumerate().take(transfer.order as usize + 1) {
                for value in &mut values[l * l..(l + 1) * (l + 1)] {
                    *value *= zonal;
                }
            }
            for (channel, amplitude) in lobe.amplitude.to_array().into_iter().enumerate() {
                let sums = &mut light.values[channel * columns..];
                for (sum, value) in sums.iter_mut().zip(&values) {
                    *sum += amplitude * value;
                }
            }
        }
        if transfer.emitted {
            for channel in 0..3 {
                light.values[(channel + 1) * columns - 1] = 1.0;
            }
        }
        light
    }

    /// One channel's numbers.
    pub fn channel(&self, channel: usize) -> &[f32] {
        &self.values[channel * self.columns..][..self.columns]
    }
}

/// A scene's transfer as textures: weights once, colours frame by frame.
#[derive(Clone, Debug)]
pub struct PackedTransfer {
    transfer: Transfer,
    /// For every group its first word, less what its first vertex's number takes, and rank and
    /// outputs; then four weights per word, vertex after vertex.
    words: Vec<u32>,
    /// Group of every cluster.
    groups: Vec<u32>,
    /// Middle of the scene and half its diagonal.
    middle: Vec3,
    radius: f32,
}

impl PackedTransfer {
    /// That of a valid scene, if it has one with something in it.
    pub fn new(scene: &Scene) -> Option<Self> {
        let transfer = scene.transfer.as_ref().filter(|t| !t.groups.is_empty())?;
        let mut words = vec![0; 2 * transfer.groups.len()];
        let mut groups = vec![0; scene.clusters.len()];
        let mut weights = &transfer.weights[..];
        for (number, (group, vertices)) in (transfer
            .groups
            .iter()
            .zip(transfer.vertices(&scene.clusters)))
        .enumerate()
        {
            for slot in &mut groups[group.first_cluster as usize..] {
                *slot = number as u32;
            }
            let first_vertex = scene.clusters[group.first_cluster as usize].first_vertex;
            let per_vertex = group.rank.div_ceil(4);
            words[2 * number] =
                (words.len() as u32).wrapping_sub(first_vertex.wrapping_mul(per_vertex));
            words[2 * number + 1] = group.rank | group.outputs << 8;
            let rank = group.rank as usize;
            let (own, rest) = weights.split_at(vertices * rank);
            weights = rest;
            if rank > 0 {
                words.extend(own.chunks_exact(rank).flat_map(|weights| {
                    weights.chunks(4).map(|four| {
                        let byte = |i: usize| four.get(i).map_or(0, |w| w.cast_unsigned());
                        u32::from_le_bytes([0, 1, 2, 3].map(byte))
                    })
                }));
            }
        }
        let positions = || scene.vertices.iter().map(|v| Vec3::from(v.position));
        let low = positions().fold(Vec3::INFINITY, Vec3::min);
        let high = positions().fold(Vec3::NEG_INFINITY, Vec3::max);
        Some(Self {
            transfer: transfer.clone(),
            words,
            groups,
            middle: 0.5 * (low + high),
            radius: 0.5 * low.distance(high),
        })
    }

    /// Texels of the texture of weights.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// The group of a cluster.
    pub fn group(&self, cluster: usize) -> u32 {
        self.groups[cluster]
    }

    /// Distant light, and local light from far away as it reaches the middle of the scene.
    pub fn light(&self, lights: &[SphericalGaussian], local: &[gpu::LocalLight]) -> DistantLight {
        let far = local.iter().filter(|light| {
            self.middle.distance(Vec3::from(light.position)) > DISTANT * self.radius
        });
        let far: Vec<_> = far.map(|light| light.lobe(self.middle)).collect();
        DistantLight::new(&self.transfer, lights.iter().chain(&far))
    }

    /// Texels of the texture of colours.
    pub fn product_count(&self) -> usize {
        self.transfer.groups.len() * STRIDE
    }

    /// These texels: rows of groups under some light.
    pub fn products(&self, light: &DistantLight) -> Vec<[f32; 4]> {
        let transfer = &self.transfer;
        let columns = transfer.columns();
        let mut texels = vec![[0.0; 4]; self.product_count()];
        let mut scales = transfer.scales.iter();
        let mut numbers = transfer.basis.chunks_exact(columns);
        for (group, texels) in transfer.groups.iter().zip(texels.chunks_exact_mut(STRIDE)) {
            for row in 0..=group.rank as usize {
                for output in 0..group.outputs as usize {
                    let scale = scales.next().copied().unwrap_or(0.0) / 127.0;
                    let texel = &mut texels[row * MAX_OUTPUTS + output];
                    for (channel, value) in texel[..3].iter_mut().enumerate() {
                        let own = numbers.next().unwrap_or(&[]);
                        let light = light.channel(channel);
                        let dot = |(a, b): (&i8, &f32)| f32::from(*a) * b;
                        *value = scale * own.iter().zip(light).map(dot).sum::<f32>();
                    }
                }
            }
        }
        texels
    }

    /// What reaches a point of a triangle of `cluster` with the given vertices.
    pub fn interpolate(
        &self,
        products: &[[f32; 4]],
        cluster: usize,
        vertices: [u32; 3],
        barycentrics: Vec3,
    ) -> Bounced {
        let group = self.group(cluster) as usize;
        let (first, shape) = (self.words[2 * group], self.words[2 * group + 1]);
        let (rank, outputs) = ((shape & 0xff) as usize, (shape >> 8) as usize);
        let texels = &products[group * STRIDE..][..STRIDE];
        let mut colors = [Vec3::ZERO; MAX_OUTPUTS];
        let color = |[r, g, b, _]: [f32; 4]| Vec3::new(r, g, b);
        for (output, sum) in colors[..outputs].iter_mut().enumerate() {
            *sum = color(texels[output]);
        }
        let per_vertex = rank.div_ceil(4) as u32;
        for row in 0..rank {
            let mut weight = 0.0;
            for (vertex, share) in vertices.into_iter().zip(barycentrics.to_array()) {
                let word = first
                    .wrapping_add(vertex.wrapping_mul(per_vertex))
                    .wrapping_add(row as u32 / 4);
                let byte = self.words[word as usize].to_le_bytes()[row % 4].cast_signed();
                weight += share * (f32::from(byte) / 127.0);
            }
            let texels = &texels[(row + 1) * MAX_OUTPUTS..];
            for (output, sum) in colors[..outputs].iter_mut().enumerate() {
                *sum += weight * color(texels[output]);
            }
        }
        Bounced {
            colors,
            reflects: outputs == MAX_OUTPUTS,
        }
    }
}

/// Light at a point that other surfaces reflect or emit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounced {
    /// As [`Transfer`] has them.
    colors: [Vec3; MAX_OUTPUTS],
    /// Whether radiance is among them, or is to be told from irradiance.
    reflects: bool,
}

impl Bounced {
    /// Irradiance of a surface with the unit normal `normal`.
    pub fn irradiance(&self, normal: Vec3) -> Vec3 {
        let sum: Vec3 = (0..IRRADIANCE_OUTPUTS)
            .map(|axis| normal[axis] * self.colors[axis])
            .sum();
        sum.max(Vec3::ZERO)
    }

    /// Mean radiance of what blocks the distance about a direction.
    fn radiance(&self, direction: Vec3, normal: Vec3) -> Vec3 {
        if !self.reflects {
            return self.irradiance(normal) * FRAC_1_PI;
        }
        let slope: Vec3 = (0..3)
            .map(|axis| direction[axis] * self.colors[IRRADIANCE_OUTPUTS + 1 + axis])
            .sum();
        (self.colors[IRRADIANCE_OUTPUTS] + slope).max(Vec3::ZERO)
    }

    /// Where most of it comes from.
    fn towards(&self, normal: Vec3) -> Vec3 {
        let sums = [0, 1, 2].map(|axis: usize| self.colors[axis].element_sum());
        Vec3::from(sums).normalize_or(normal)
    }

    /// Radiance towards the eye that `point` reflects of it. Where a specular lobe does not see
    /// the distance, which `field` tells as in [`ambient`], it sees what blocks it. Of lobes wider than the field
    /// tells of, that would miss what lies near the horizon: they see all of it in one direction.
    pub fn reflected(&self, point: &SurfacePoint, field: &impl SignedDistance) -> Vec3 {
        if point.normal.dot(point.view) <= 0.0 {
            return Vec3::ZERO;
        }
        let irradiance = self.irradiance(point.normal);
        let mut radiance = point.appearance.diffuse * FRAC_1_PI * irradiance;
        let towards = self.towards(point.normal);
        for reflection in point.appearance.reflections() {
            for lobe in brdf::specular_lobes(point, reflection).as_slice() {
                let whole =
                    Tables::get().cosine_integral(lobe.sharpness, point.normal.dot(lobe.axis));
                let visible = ambient::integrate(field, lobe.sharpness, lobe.axis, point.normal);
                let about = self.radiance(lobe.axis, point.normal) * (whole - visible).max(0.0);
                let along = math::exp(lobe.sharpness * (lobe.axis.dot(towards) - 1.0));
                let beyond =
                    ambient::beyond(field.limit(), lobe.sharpness, lobe.axis, point.normal);
                radiance += lobe.amplitude * about.lerp(along * irradiance, beyond);
            }
        }
        radiance
    }
}

/// Roughnesses at which the albedo of specular reflections is tabulated, from [`MIN_ALPHA`] on.
const ALPHAS: usize = 16;

/// Part of diffuse light that a surface reflects, all of it taken for diffuse: what it sends on
/// to others. Colours go from normal to grazing incidence as Schlick's mean over the
/// hemisphere does (1/21 of the way).
pub fn albedo(point: &SurfacePoint) -> Vec3 {
    let specular = point.appearance.reflections().map(|reflection| {
        let color = if reflection.has_fresnel() {
            reflection.specular.lerp(reflection.grazing, 1.0 / 21.0)
        } else {
            reflection.specular
        };
        color * uncolored(reflection)
    });
    (point.appearance.diffuse + specular.sum::<Vec3>()).min(Vec3::ONE)
}

/// The same of a reflection with a colour of 1.
fn uncolored(reflection: &Reflection) -> f32 {
    static TABLE: OnceLock<Vec<[f32; ALPHAS]>> = OnceLock::new();
    let alpha_at = |i: usize| MIN_ALPHA + (1.0 - MIN_ALPHA) * i as f32 / (ALPHAS - 1) as f32;
    let table = TABLE.get_or_init(|| {
        let of = |model: Model| std::array::from_fn(|i| integrated(model, alpha_at(i)));
        Model::ALL.into_iter().map(of).collect()
    });
    let Some(row) = Model::ALL
        .iter()
        .position(|model| *model == reflection.model)
    else {
        return 0.0;
    };
    let roughness = reflection.roughness();
    let mean = (roughness.x * roughness.y).sqrt();
    let place = (mean - MIN_ALPHA) / (1.0 - MIN_ALPHA) * (ALPHAS - 1) as f32;
    let place = place.clamp(0.0, (ALPHAS - 1) as f32);
    let low = (place as usize).min(ALPHAS - 2);
    let (a, b) = (table[row][low], table[row][low + 1]);
    a + (b - a) * (place - low as f32)
}

/// Albedo under diffuse light, by quadrature.
fn integrated(model: Model, alpha: f32) -> f32 {
    const VIEWS: usize = 8;
    const DRAWS: usize = 128;
    let alpha = glam::Vec2::splat(model.from_alpha(alpha));
    let reflection = Reflection::new(model, Vec3::ONE, alpha);
    let mut sum = 0.0;
    for i in 0..VIEWS {
        // Even in cos² is even in projected solid angle.
        let cosine = ((i as f32 + 0.5) / VIEWS as f32).sqrt();
        let view = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
        for j in 0..DRAWS {
            let (u, v) = (
                (j as f32 + 0.5) / DRAWS as f32,
                (j as f32 * 0.618_034).fract(),
            );
            let drawn = models::sample_specular(&reflection, view, u, v);
            sum += drawn.map_or(0.0, |(_, weight)| weight);
        }
    }
    (sum / (VIEWS * DRAWS) as f32).min(1.0)
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!(
        "const TRANSFER_TEXTURE_WIDTH: u32 = {TEXTURE_WIDTH}u;\n\
         const TRANSFER_STRIDE: u32 = {STRIDE}u;\n\
         const TRANSFER_OUTPUTS: u32 = {MAX_OUTPUTS}u;\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Roundings of sums of a few hundred numbers of order 1.
    const ROUNDING: f32 = 2e-4;

    /// Directions of a midpoint grid over the sphere, each with its solid angle.
    fn sphere(rows: u32) -> impl Iterator<Item = (Vec3, f32)> {
        (0..rows).flat_map(move |row| {
            let z = 1.0 - 2.0 * (row as f32 + 0.5) / rows as f32;
            let sine = (1.0 - z * z).sqrt();
            (0..2 * rows).map(move |column| {
                let (sin, cos) = math::sin_cos(PI * (column as f32 + 0.5) / rows as f32);
                let area = 4.0 * PI / (2 * rows * rows) as f32;
                (Vec3::new(sine * cos, sine * sin, z), area)
            })
        })
    }

    #[test]
    fn harmonics_are_orthonormal() {
        let harmonics = Harmonics::new(6);
        let count = harmonics.count();
        // Hundreds of thousands of terms: more than single precision adds up.
        let mut sums = vec![0.0f64; count * count];
        let mut values = vec![0.0; count];
        for (direction, area) in sphere(400) {
            harmonics.evaluate(direction, &mut values);
            for (i, a) in values.iter().enumerate() {
                for (j, b) in values.iter().enumerate() {
                    sums[i * count + j] += f64::from(a * b * area);
                }
            }
        }
        for i in 0..count {
            for j in 0..count {
                let expected = if i == j { 1.0 } else { 0.0 };
                let found = sums[i * count + j];
                // The midpoint rule's error is below 1e-3 here.
                assert!((found - expected).abs() < 2e-3, "{i} {j}: {found}");
            }
        }
    }

    #[test]
    fn lobes_project_as_quadrature_says() {
        let transfer = Transfer {
            order: 6,
            ..Transfer::default()
        };
        let harmonics = Harmonics::new(6);
        for sharpness in [0.0, 0.3, 3.0, 30.0, 60.0] {
            let lobe = SphericalGaussian {
                axis: Vec3::new(0.3, -0.5, 0.8).normalize(),
                sharpness,
                amplitude: Vec3::new(1.0, 2.0, 0.5),
            };
            let light = DistantLight::new(&transfer, [&lobe]);
            let mut sums = vec![0.0f64; harmonics.count()];
            let mut values = vec![0.0; sums.len()];
            for (direction, area) in sphere(400) {
                harmonics.evaluate(direction, &mut values);
                let radiance = lobe.evaluate(direction).x * area;
                for (sum, value) in sums.iter_mut().zip(&values) {
                    *sum += f64::from(radiance * value);
                }
            }
            for (index, sum) in sums.iter().enumerate() {
                for (channel, factor) in [1.0, 2.0, 0.5].into_iter().enumerate() {
                    let found = light.channel(channel)[index];
                    let error = (f64::from(found) - factor * sum).abs();
                    assert!(error < 3e-3, "{sharpness} {index}: {found} for {sum}");
                }
            }
        }
        // Where upward and downward recurrences meet.
        for (a, b) in zonal(39.9999).into_iter().zip(zonal(40.0001)) {
            assert!((a - b).abs() < 1e-4 * a, "{a} {b}");
        }
        // A narrow lobe has all of its light in every order.
        let narrow = zonal(1e6);
        assert!((narrow[6] / narrow[0] - 1.0).abs() < 1e-4);
    }

    #[test]
    fn a_mirror_sends_on_nearly_all_and_a_rough_one_less() {
        let of = |alpha: f32| {
            uncolored(&Reflection::new(
                Model::Ggx,
                Vec3::ONE,
                glam::Vec2::splat(alpha),
            ))
        };
        assert!(of(0.02) > 0.98, "{}", of(0.02));
        assert!(of(1.0) < 0.75 && of(1.0) > 0.3, "{}", of(1.0));
        assert!(of(0.5) < of(0.2));
    }

    #[test]
    fn irradiance_is_the_vector_along_the_normal() {
        let mut colors = [Vec3::ZERO; MAX_OUTPUTS];
        colors[0] = Vec3::new(1.0, 2.0, 3.0);
        colors[2] = Vec3::new(-4.0, 0.0, 4.0);
        let bounced = Bounced {
            colors,
            reflects: false,
        };
        let normal = Vec3::new(0.6, 0.0, 0.8);
        let expected = Vec3::new(0.0, 1.2, 5.0);
        assert!(bounced.irradiance(normal).distance(expected) < ROUNDING);
    }
}
