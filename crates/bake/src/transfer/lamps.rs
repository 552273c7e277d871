//! What surfaces emit, and what others send on of it, as it reaches a place.
//!
//! Little of either may be large: rays over the hemisphere alone would meet it once in a while.

use std::f32::consts::PI;

use glam::Vec3;

use super::emitters::Choice;
use super::radiosity::{Radiosity, hash, unit};
use super::surfaces::Met;
use crate::visibility::ray::RayCaster;

/// Rays from a place to surfaces that emit, and as many to those that send it on.
const EMITTER_RAYS: u32 = 64;

/// What emits, as a place sees it: by rays over the hemisphere that happen to meet it and by rays to
/// points of it, each weighted by how likely both together make it (the balance heuristic of Veach and
/// Guibas 1995). Neither does alone: the first miss what is small, the second have no bound near by.
pub(super) struct Lamps<'a> {
    light: &'a Radiosity,
    /// None where nothing emits above the place.
    choice: Option<Choice>,
    /// The same of points that send light on.
    relays: Option<Choice>,
    origin: Vec3,
    normal: Vec3,
    /// Rays over the hemisphere per solid angle.
    rays: f32,
}

impl Radiosity {
    /// Rays to what emits beside so many over the hemisphere, which meet some of it.
    pub(super) fn lamps(&self, origin: Vec3, normal: Vec3, rays: u32) -> Lamps<'_> {
        Lamps {
            light: self,
            choice: self.surfaces.emitters().seen_from(origin, normal),
            relays: self.relays.seen_from(origin, normal),
            origin,
            normal,
            rays: rays as f32 / (2.0 * PI),
        }
    }
}

impl Lamps<'_> {
    /// One over the rays of both kinds per solid angle, where so many are drawn per area.
    fn weight(&self, density: f32, offset: Vec3, cosine: f32) -> f32 {
        let drawn = EMITTER_RAYS as f32 * density * offset.length_squared();
        1.0 / (self.rays + drawn / cosine.max(f32::MIN_POSITIVE))
    }

    fn density(&self, choice: &Choice, triangle: usize) -> f32 {
        let surfaces = &self.light.surfaces;
        (surfaces.emitters()).density(choice, triangle, surfaces.radiance(triangle))
    }

    fn relay_density(&self, choice: &Choice, point: usize) -> f32 {
        let radiance = self.light.sent_on(point).element_sum();
        self.light.relays.density(choice, point, radiance)
    }

    /// What a ray over the hemisphere adds.
    pub(super) fn met(&self, met: &Met, direction: Vec3) -> Emitted {
        if met.emission == Vec3::ZERO {
            return Emitted::default();
        }
        let cosine = -direction.dot(met.normal);
        let density =
            (self.choice.as_ref()).map_or(0.0, |choice| self.density(choice, met.triangle));
        let weight = self.weight(density, met.position - self.origin, cosine);
        Emitted::new(met.emission * weight, direction)
    }

    /// What a ray over the hemisphere counts of emitted light that a point sends on.
    pub(super) fn share(&self, met: &Met, direction: Vec3, point: usize) -> f32 {
        let Some(choice) = &self.relays else {
            return 1.0;
        };
        let cosine = -direction.dot(met.normal);
        let density = self.relay_density(choice, point);
        self.rays * self.weight(density, met.position - self.origin, cosine)
    }

    /// What rays to points that emit add.
    pub(super) fn drawn(&self, caster: &RayCaster, seed: u32) -> Emitted {
        let mut sum = Emitted::default();
        let Some(choice) = &self.choice else {
            return sum;
        };
        let surfaces = &self.light.surfaces;
        for numbers in numbers(seed) {
            let point = surfaces.emitters().draw(choice, numbers);
            let Some((offset, cosine)) = self.towards(point.position, point.normal) else {
                continue;
            };
            let distance = offset.length();
            let direction = offset / distance;
            let reached = caster
                .closest_hit(self.origin, direction)
                .is_none_or(|hit| hit.distance >= distance - 4.0 * self.light.ray_offset);
            if reached {
                let light = surfaces.emission(point.triangle, point.barycentrics);
                let density = self.density(choice, point.triangle);
                sum += Emitted::new(light * self.weight(density, offset, cosine), direction);
            }
        }
        sum
    }

    /// What rays to points add that send emitted light on.
    pub(super) fn sent_on(&self, caster: &RayCaster, seed: u32) -> Emitted {
        let mut sum = Emitted::default();
        let Some(choice) = &self.relays else {
            return sum;
        };
        for numbers in numbers(hash(seed, 4004)) {
            let index = self.light.relays.draw(choice, numbers).triangle;
            let point = &self.light.points.as_slice()[index];
            let place = point.position + self.light.ray_offset * point.geometric_normal;
            let Some((offset, cosine)) = self.towards(place, point.geometric_normal) else {
                continue;
            };
            if !caster.blocked(self.origin, place) {
                let density = self.relay_density(choice, index);
                let weight = self.weight(density, offset, cosine);
                sum += Emitted::new(self.light.sent_on(index) * weight, offset.normalize());
            }
        }
        sum
    }

    /// Offset of a point, and the cosine at it, where each is in front of the other.
    fn towards(&self, position: Vec3, normal: Vec3) -> Option<(Vec3, f32)> {
        let offset = position - self.origin;
        let direction = offset.try_normalize()?;
        let cosine = -direction.dot(normal);
        (cosine > 0.0 && direction.dot(self.normal) > 0.0).then_some((offset, cosine))
    }
}

/// Three numbers per ray, evenly from all of [0, 1) (the R2 sequence of Roberts, "The Unreasonable Effectiveness of
/// Quasirandom Sequences", 2018, beside equal steps), shifted by what the seed says.
fn numbers(seed: u32) -> impl Iterator<Item = [f32; 3]> {
    let shifts = [1001, 2002, 3003].map(|salt| unit(hash(seed, salt)));
    (0..EMITTER_RAYS).map(move |i| {
        let i = i as f32;
        let which = (i + shifts[0]) / EMITTER_RAYS as f32;
        let [u, v] = [0.754_877_7 * i + shifts[1], 0.569_840_3 * i + shifts[2]];
        [which, u.fract(), v.fract()]
    })
}

/// Vector irradiance, x, y and z, of a colour.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Emitted(pub [Vec3; 3]);

impl Emitted {
    pub(super) fn new(color: Vec3, direction: Vec3) -> Self {
        Self(direction.to_array().map(|along| color * along))
    }

    /// Irradiance of a surface with the given normal.
    pub(super) fn dot_normal(&self, normal: Vec3) -> Vec3 {
        self.0[0] * normal.x + self.0[1] * normal.y + self.0[2] * normal.z
    }
}

impl std::ops::AddAssign for Emitted {
    fn add_assign(&mut self, other: Self) {
        for (sum, color) in self.0.iter_mut().zip(other.0) {
            *sum += color;
        }
    }
}
