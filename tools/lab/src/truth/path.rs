//! Paths of light: how much arrives at a point from the distance and from local lights, by
//! reflections off other surfaces as well.
//!
//! Light is drawn at every surface that a path meets, and so is the next direction; both
//! may find the distance and are weighed by the balance heuristic (Veach & Guibas 1995). Light
//! that is met from behind a triangle is reflected as from its front, as what blocks light does
//! so from both sides; the eye alone sees fronts only.

use std::f32::consts::PI;

use glam::Vec3;
use relight_bake::measured::Table;
use relight_shading::gpu;
use relight_shading::surface::{SurfacePoint, emission, surface_point};
use relight_shading::{models, reference};

use super::random::{hash, sobol_pair};
use super::{Geometry, faces};

/// Reflections after which paths begin to end by chance.
const SURE_BOUNCES: u32 = 3;
/// Paths that lose next to nothing still end, one in twenty per reflection.
const MOST_SURVIVAL: f32 = 0.95;
/// Pairs of random numbers of one surface of a path, before those for local lights: the
/// point of the pixel, distant light, the reflection's direction and choice, the path's end.
const DIMENSIONS: u32 = 5;

/// Light from infinitely far away that can be drawn from.
pub trait DistantLight: Sync {
    /// A direction from two uniform numbers.
    fn sample(&self, uniform: [f32; 2]) -> Vec3;

    /// Radiance from a unit direction and the density of [`Self::sample`] there, 1/sr.
    fn lookup(&self, direction: Vec3) -> (Vec3, f32);
}

/// A scene and its light.
pub struct Paths<'a, L> {
    /// What reflects.
    pub geometry: &'a Geometry<'a>,
    /// Tables of measured materials, by material; may be shorter.
    pub measured: &'a [Option<Table>],
    /// Distant light.
    pub distant: &'a L,
    /// Spheres that emit, which only what lies before them blocks, and which block nothing.
    pub local: &'a [gpu::LocalLight],
    /// Reflections that count besides the one at the point that is seen.
    pub bounces: u32,
}

/// Which part of the light a path gathers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// All of it.
    Whole,
    /// What other surfaces reflect to the point that is seen.
    Bounced,
}

/// The random numbers of one path.
#[derive(Clone, Copy)]
pub struct Draws {
    /// Number of the path among those with the same seed.
    pub sample: u32,
    /// Of its pixel and replica.
    pub seed: u32,
}

impl Draws {
    /// Pair number `dimension`.
    pub fn pair(self, dimension: u32) -> [f32; 2] {
        sobol_pair(self.sample, hash(self.seed, dimension))
    }
}

impl<'a, L: DistantLight> Paths<'a, L> {
    /// The point and its material's exact reflection, and the radiance that it emits.
    pub fn reflector(
        &self,
        point: SurfacePoint<'a>,
        triangle: usize,
        emission: Vec3,
    ) -> Reflector<'a> {
        let scene = self.geometry.scene;
        let material = scene.triangles[triangle].material as usize;
        Reflector {
            point,
            table: self.measured.get(material).and_then(Option::as_ref),
            emission,
        }
    }

    /// One estimate of the radiance from `first` towards the eye.
    pub fn radiance(&self, first: &Reflector<'a>, part: Part, draws: Draws) -> Vec3 {
        let stride = DIMENSIONS + self.local.len() as u32;
        let (mut radiance, mut throughput) = (Vec3::ZERO, Vec3::ONE);
        let mut reflector = Reflector { ..*first };
        for bounce in 0..=self.bounces {
            let pair = |dimension| draws.pair(bounce * stride + dimension);
            if bounce > 0 || part == Part::Whole {
                radiance += throughput * reflector.emission;
            }
            let view = reflector.point.to_local(reflector.point.view);
            if view.z <= 0.0 {
                break;
            }
            let counts = bounce > 0 || part == Part::Whole;
            let [choice, _] = pair(3);
            let [u, v] = pair(2);
            let uniform = [choice, u, v];
            if counts {
                let toward = self.distant.sample(pair(1));
                radiance += throughput * self.distant_part(&reflector, view, toward);
                for (light, dimension) in self.local.iter().zip(DIMENSIONS..) {
                    let pair = pair(dimension);
                    radiance += throughput * reflector.local(self.geometry, light, pair, uniform);
                }
            }
            let Some(light) = reflector.sample(view, uniform) else {
                break;
            };
            let direction = reflector.point.to_world(light);
            // Only what emits is worth a search for what the last ray meets.
            if bounce == self.bounces && !self.geometry.emits {
                radiance += throughput * self.distant_part(&reflector, view, direction);
                break;
            }
            let density = reflector.density(light, view);
            let value = reflector.evaluate(light, view) * light.z;
            if !(density > 0.0 && value != Vec3::ZERO && faces(&reflector.point, direction)) {
                break;
            }
            let Some(next) = self.next(&reflector.point, direction) else {
                if counts {
                    let (sky, sky_density) = self.distant.lookup(direction);
                    radiance += throughput * value * sky / (density + sky_density);
                }
                break;
            };
            throughput *= value / density;
            if bounce == self.bounces {
                radiance += throughput * next.emission;
                break;
            }
            if bounce >= SURE_BOUNCES {
                let survival = throughput.max_element().min(MOST_SURVIVAL);
                if pair(4)[0] >= survival {
                    break;
                }
                throughput /= survival;
            }
            reflector = next;
        }
        radiance
    }

    /// What `reflector` has reflected from `direction`, if that sees the distance: one of two
    /// ways to draw it, weighed against the other.
    fn distant_part(&self, reflector: &Reflector, view: Vec3, direction: Vec3) -> Vec3 {
        let light = reflector.point.to_local(direction);
        if light.z <= 0.0 {
            return Vec3::ZERO;
        }
        let (radiance, light_density) = self.distant.lookup(direction);
        let density = light_density + reflector.density(light, view);
        let value = reflector.evaluate(light, view) * radiance * (light.z / density);
        let counts = density > 0.0 && value != Vec3::ZERO;
        if counts && self.geometry.visible(&reflector.point, direction) {
            value
        } else {
            Vec3::ZERO
        }
    }

    /// The surface that a ray meets, as seen from where the ray begins. Backs emit nothing.
    fn next(&self, from: &SurfacePoint, direction: Vec3) -> Option<Reflector<'a>> {
        let geometry = self.geometry;
        let origin = geometry.origin(from);
        let hit = geometry.trees.occluders.closest_hit(origin, direction)?;
        let mut point = surface_point(geometry.scene, hit.triangle, hit.barycentrics, origin);
        let behind = point.geometric_normal.dot(direction) > 0.0;
        if behind {
            point.geometric_normal = -point.geometric_normal;
            point.normal = -point.normal;
            point.bitangent = -point.bitangent;
        }
        let emission = emission(geometry.scene, hit.triangle, hit.barycentrics, None);
        let mut next = self.reflector(point, hit.triangle, emission);
        if behind {
            next.emission = Vec3::ZERO;
        }
        Some(next)
    }
}

/// A surface point and the exact way it reflects.
#[derive(Clone, Copy)]
pub struct Reflector<'a> {
    /// The point.
    pub point: SurfacePoint<'a>,
    /// The measured table, where there is one.
    pub table: Option<&'a Table>,
    /// Radiance that the surface emits.
    pub emission: Vec3,
}

impl Reflector<'_> {
    /// One sample of what a local light has reflected: a direction within the cone of its
    /// sphere, and one of the reflection, weighted against each other.
    pub fn local(
        &self,
        geometry: &Geometry,
        source: &gpu::LocalLight,
        light_uniform: [f32; 2],
        reflection_uniform: [f32; 3],
    ) -> Vec3 {
        let view = self.point.to_local(self.point.view);
        let offset = Vec3::from(source.position) - self.point.position;
        let (squared, radius_squared) = (offset.length_squared(), source.radius.powi(2));
        let axis = offset.normalize_or_zero();
        let radiance = Vec3::from(source.radiance) * source.spot(axis);
        if view.z <= 0.0 || squared <= radius_squared || radiance == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let cap = source.cap(squared);
        let contribution = |direction: Vec3| -> Vec3 {
            let light = self.point.to_local(direction);
            if light.z <= 0.0 {
                return Vec3::ZERO;
            }
            let density = 1.0 / (2.0 * PI * cap) + self.density(light, view);
            let value = self.evaluate(light, view) * radiance * (light.z / density);
            let along = direction.dot(offset);
            let aside = (offset - along * direction).length_squared();
            let distance = along - (radius_squared - aside).max(0.0).sqrt();
            if value != Vec3::ZERO && geometry.visible_at(&self.point, direction, distance) {
                value
            } else {
                Vec3::ZERO
            }
        };
        let [u, v] = light_uniform;
        let (height, azimuth) = (u * cap, 2.0 * PI * v);
        let (x, y) = axis.any_orthonormal_pair();
        let aside = x * azimuth.cos() + y * azimuth.sin();
        let toward = axis * (1.0 - height) + aside * (height * (2.0 - height)).sqrt();
        let reflected = self
            .sample(view, reflection_uniform)
            .map(|light| self.point.to_world(light))
            .filter(|direction| 0.5 * direction.distance_squared(axis) < cap);
        contribution(toward) + reflected.map_or(Vec3::ZERO, contribution)
    }

    fn evaluate(&self, light: Vec3, view: Vec3) -> Vec3 {
        match self.table {
            Some(table) => table.evaluate(light, view),
            None => models::evaluate(&self.point.appearance, light, view),
        }
    }

    fn density(&self, light: Vec3, view: Vec3) -> f32 {
        match self.table {
            Some(table) => table.pdf(light, view),
            None => reference::pdf(&self.point.appearance, light, view),
        }
    }

    fn sample(&self, view: Vec3, uniform: [f32; 3]) -> Option<Vec3> {
        match self.table {
            Some(table) => table.sample(view, uniform),
            None => reference::sample(&self.point.appearance, view, uniform),
        }
    }
}
