//! The last bounce: what arrives at a vertex.

use std::f32::consts::PI;

use glam::{Mat4, Vec3, Vec4};

use super::lamps::Emitted;
use super::radiosity::{End, Radiosity, add_colored, hash, limit};
use crate::simd::vectorised;
use crate::visibility::ray::RayCaster;

/// Pull of the radiance's slope towards none, as a part of what the rays weigh: where few rays
/// meet anything its slope is unknown.
const SLOPE_PULL: f32 = 0.05;

/// Seed of the points of what emits: neighbours that are given the same ones err alike, not each in its own way.
const SAME_FOR_ALL: u32 = 0;

/// A vertex to gather for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Receiver {
    /// Where rays begin.
    pub origin: Vec3,
    /// Shading normal, unit length.
    pub normal: Vec3,
}

/// What arrives at a vertex.
#[derive(Clone, Debug)]
pub(crate) struct Gathered {
    /// As [`relight_format::Transfer`] has them, one after the other: per output and channel `columns` numbers;
    /// without radiance if there is to be irradiance alone.
    pub outputs: Vec<f32>,
    /// What comes straight from surfaces that emit, which `outputs` lack: it changes as fast as its shadows.
    pub lamps: Emitted,
    /// Mean of 1 over the distance to what rays meet, 1/metres, weighted by the cosine; 0 for those that meet nothing.
    pub nearness: f32,
    /// Rays that were cast.
    pub cast: u64,
}

impl Radiosity {
    /// What arrives at a vertex, with radiance unless there is to be `irradiance` alone. Of so many rays those are cast for
    /// which `is_clear` does not know that they meet nothing.
    pub(crate) fn gather(
        &self,
        caster: &RayCaster,
        receiver: &Receiver,
        rays: u32,
        irradiance: bool,
        is_clear: impl Fn(Vec3) -> bool,
    ) -> Gathered {
        let block = 3 * self.columns();
        let outputs = if irradiance { 3 } else { 7 };
        let mut sums = vec![0.0; outputs * block];
        let (mut cast, mut nearness) = (0, 0.0);
        let mut values = vec![0.0; block];
        // Of directions that are blocked: sums of w, w ω and w ω ωᵀ.
        let mut moments = Mat4::ZERO;
        let seed = receiver
            .origin
            .to_array()
            .into_iter()
            .fold(0, |seed, x| hash(seed, x.to_bits()));
        let area = 2.0 * PI / rays as f32;
        let lamps = self.lamps(receiver.origin, receiver.normal, rays);
        let mut straight = Emitted::default();
        let (mut beyond, mut beyond_factors) = (Vec::new(), Vec::new());
        for ray in self.hemisphere(receiver.normal, rays, seed) {
            if is_clear(ray.direction) {
                continue;
            }
            cast += 1;
            let Some(met) = self.meet(caster, receiver.origin, ray.direction) else {
                continue;
            };
            let distance = met.position.distance(receiver.origin);
            nearness += 2.0 * ray.cosine / rays as f32 / distance.max(f32::MIN_POSITIVE);
            straight += lamps.met(&met, ray.direction);
            let sender = self.sender(caster, &met, 1.0, ray.number);
            let row = ray.direction.extend(1.0);
            let weight = ray.cosine * area;
            let [x, y, z] = ray.direction.to_array();
            let factors = [
                area * x,
                area * y,
                area * z,
                weight,
                weight * x,
                weight * y,
                weight * z,
            ];
            let (known, color) = self.radiance(&sender, &mut values);
            vectorised!(
                <'a>
                sums: &'a mut [f32] = &mut sums,
                known: &'a [f32] = known,
                block: usize = block,
                factors: [f32; 7] = factors,
                color: Vec3 = color
                => () {
                    for (sums, factor) in sums.chunks_exact_mut(block).zip(factors) {
                        add_colored(sums, known, factor * color);
                    }
                }
            );
            if sender.beyond != Vec3::ZERO {
                beyond.push((sender.beyond, weight));
                beyond_factors.push(factors);
            }
            // The rest of the emitted light that a point sends on comes by rays to it.
            let mut rest = Vec3::ZERO;
            if let End::Point(point) = sender.end
                && sender.direct
            {
                let point = point as usize;
                let share = lamps.share(&met, ray.direction, point);
                rest = (share - 1.0) * color * self.emitted_at(point);
            }
            for (output, (sums, factor)) in sums.chunks_exact_mut(block).zip(factors).enumerate() {
                // Mirrors see what emits where rays meet it.
                let emitted = if output < 3 { rest } else { sender.emission };
                self.add_emitted(sums, factor * emitted);
            }
            moments += Mat4::from_cols(row * row.x, row * row.y, row * row.z, row) * weight;
        }
        straight += lamps.drawn(caster, SAME_FOR_ALL);
        self.add_irradiance(&mut sums, &lamps.sent_on(caster, seed));
        if !beyond.is_empty() {
            let along =
                |axis: usize| receiver.normal[axis] * self.emitted_of(&sums[axis * block..]);
            let rest = straight.dot_normal(receiver.normal) + (0..3).map(along).sum::<Vec3>();
            limit(&mut beyond, rest.element_sum().max(0.0));
            for ((radiance, _), factors) in beyond.into_iter().zip(beyond_factors) {
                for (sums, factor) in sums.chunks_exact_mut(block).zip(factors) {
                    self.add_emitted(sums, factor * radiance);
                }
            }
        }
        if !irradiance {
            let whole = moments.w_axis.w;
            if whole > 0.0 {
                fit_radiance(&mut sums[3 * block..], block, moments);
            }
        }
        Gathered {
            outputs: sums,
            lamps: straight,
            nearness,
            cast,
        }
    }
}

/// Turns the sums of w L and w ω L into the constant and the slope of the L that is nearest to
/// them, least squares.
fn fit_radiance(sums: &mut [f32], block: usize, mut moments: Mat4) {
    let pull = SLOPE_PULL * moments.w_axis.w;
    moments.x_axis.x += pull;
    moments.y_axis.y += pull;
    moments.z_axis.z += pull;
    let inverse = moments.inverse();
    for index in 0..block {
        let at = |output: usize| output * block + index;
        let right = Vec4::new(sums[at(1)], sums[at(2)], sums[at(3)], sums[at(0)]);
        let fitted = inverse * right;
        sums[at(0)] = fitted.w;
        sums[at(1)] = fitted.x;
        sums[at(2)] = fitted.y;
        sums[at(3)] = fitted.z;
    }
}
