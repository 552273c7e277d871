//! How far reflections of other surfaces are off: a picture that lacks them is announced.
//!
//! Vertices know what is about them as a constant and a slope ([`super::gather`]), and surfaces about them as if each sent
//! on its light evenly. So a rough surface shows matt ones about it as they are; edges, lamps and mirrors in a smooth one
//! are spread.

use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;
use relight_format::math;
use relight_shading::surface::{Appearance, SurfacePoint, surface_point};
use relight_shading::{models, reference};

use super::gather::Receiver;
use super::radiosity::{Radiosity, hash, unit};
use super::surfaces::Place;
use crate::monitor::{Interrupted, Monitor};
use crate::visibility::ray::RayCaster;

/// Points of a material that are looked at, about, and views of each about its normal, at this cosine.
const POINTS: usize = 64;
const VIEWS: u32 = 4;
const VIEW_COSINE: f32 = 0.7;
/// Directions drawn for each of these.
const DRAWS: u32 = 16;
/// Rays of a point that tell what it sees.
const RAYS: u32 = 64;

/// How far reflections of a material are off, root mean square over points and views, in the mean of all light that it
/// sends there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ReflectionError {
    /// By a sky of radiance 1: what is known less what is there, and as much as the light that mirrors send on, which under
    /// a sky of some contrast is another.
    pub sky: f32,
    /// By what surfaces emit; 0 where it gets nothing of that.
    pub lamps: f32,
}

/// Light by sky and by lamps.
type Kinds = [Vec3; 2];

/// What one view has, by sky and by lamps: its squared error and its light, means of the channels.
type View = [[f32; 2]; 2];

impl Radiosity {
    /// How far reflections of a material are off. Nothing where it has no surface.
    pub(crate) fn reflection_error(
        &self,
        caster: &RayCaster,
        material: usize,
        monitor: Monitor,
    ) -> Result<Option<ReflectionError>, Interrupted> {
        monitor.step("bounces", 0.0)?;
        let triangles = self.surfaces.of_material(material);
        let area = |&triangle: &usize| self.surfaces.area(triangle);
        let step = triangles.iter().map(area).sum::<f64>() / POINTS as f64;
        let places = self.surfaces.spread(
            triangles
                .iter()
                .map(|&triangle| self.surfaces.whole(triangle)),
            step,
        );
        let views: Vec<Vec<View>> = (places.par_iter().enumerate())
            .map(|(index, place)| self.look_at(caster, place, index as u32))
            .collect();
        let count = views.iter().flatten().count() as f32;
        if count == 0.0 {
            return Ok(None);
        }
        let of_kind = |kind: usize| {
            let mean = |i: usize| {
                views
                    .iter()
                    .flatten()
                    .map(|view| view[kind][i])
                    .sum::<f32>()
                    / count
            };
            let (squares, light) = (mean(0), mean(1));
            if light > 0.0 {
                squares.sqrt() / light
            } else {
                0.0
            }
        };
        Ok(Some(ReflectionError {
            sky: of_kind(0),
            lamps: of_kind(1),
        }))
    }

    /// What a place shows to views of it.
    fn look_at(&self, caster: &RayCaster, place: &Place, seed: u32) -> Vec<View> {
        let normal = self.surfaces.normal(place.triangle, place.barycentrics);
        let origin =
            place.position + self.ray_offset * self.surfaces.geometric_normal(place.triangle);
        let receiver = Receiver { origin, normal };
        let gathered = self.gather(caster, &receiver, RAYS, false, |_| false);
        let outputs: Vec<Kinds> = (gathered.outputs.chunks_exact(3 * self.columns()))
            .map(|values| self.by_sky_and_lamps(values))
            .collect();
        let along = |first: usize, kind: usize, direction: Vec3| -> Vec3 {
            let axes = outputs[first..first + 3].iter().zip(direction.to_array());
            axes.map(|(values, along)| values[kind] * along).sum()
        };
        let open: f32 = (self.hemisphere(normal, RAYS, hash(seed, 1)))
            .filter(|ray| !caster.any_hit(origin, ray.direction))
            .map(|ray| ray.cosine * (2.0 * PI / RAYS as f32))
            .sum();
        let straight = [Vec3::splat(open), gathered.lamps.dot_normal(normal)];
        let irradiance = [0, 1].map(|kind| straight[kind] + along(0, kind, normal));
        let known = |direction| {
            [0, 1].map(|kind| (outputs[3][kind] + along(4, kind, direction)).max(Vec3::ZERO))
        };
        let (x, y) = normal.any_orthonormal_pair();
        let view = |number: u32| {
            let turn = 2.0 * PI * (number as f32 + unit(hash(seed, 2))) / VIEWS as f32;
            let (sin, cos) = math::sin_cos(turn);
            let sine = (1.0 - VIEW_COSINE * VIEW_COSINE).sqrt();
            let eye = place.position + VIEW_COSINE * normal + sine * (cos * x + sin * y);
            let point = surface_point(
                self.surfaces.scene(),
                place.triangle,
                place.barycentrics,
                eye,
            );
            let seed = hash(seed, 3 + number);
            self.view(caster, (&point, origin), (irradiance, &known), seed)
        };
        (0..VIEWS).map(view).collect()
    }

    /// What a point shows to its eye, which gets `irradiance` and knows what is about it by direction.
    fn view(
        &self,
        caster: &RayCaster,
        (point, origin): (&SurfacePoint, Vec3),
        (irradiance, known): (Kinds, &impl Fn(Vec3) -> Kinds),
        seed: u32,
    ) -> View {
        let mut light = irradiance.map(|irradiance| point.appearance.diffuse / PI * irradiance);
        let (mut off, mut mirrored) = ([Vec3::ZERO; 2], Vec3::ZERO);
        let mut values = vec![0.0; 3 * self.columns()];
        for (number, (direction, weight)) in (0..).zip(drawn(point, seed)) {
            let Some(hit) = caster.closest_hit(origin, direction) else {
                light[0] += weight;
                continue;
            };
            let met = self.surfaces.meet(hit.triangle, hit.barycentrics, origin);
            let sender = self.sender(caster, &met, 1.0, hash(seed, 4 + number));
            let (values, color) = self.radiance(&sender, &mut values);
            let mut seen = self
                .by_sky_and_lamps(values)
                .map(|radiance| radiance * color);
            seen[1] += sender.emission + sender.beyond;
            let known = known(direction);
            for kind in 0..2 {
                off[kind] += weight * (known[kind] - seen[kind]);
                light[kind] += weight * seen[kind];
            }
            let there = surface_point(
                self.surfaces.scene(),
                hit.triangle,
                hit.barycentrics,
                origin,
            );
            let diffuse = there.appearance.diffuse.element_sum();
            let all = met.albedo.element_sum().max(f32::MIN_POSITIVE);
            mirrored += weight * seen[0] * (1.0 - diffuse / all).max(0.0);
        }
        let squares = off.map(Vec3::length_squared);
        let squares = [squares[0] + mirrored.length_squared(), squares[1]];
        [0, 1].map(|kind| [squares[kind] / 3.0, light[kind].element_sum() / 3.0])
    }

    /// What a sky of radiance 1 and what lamps make of numbers per channel.
    fn by_sky_and_lamps(&self, values: &[f32]) -> Kinds {
        // The first harmonic's coefficient of such a sky.
        let even = (4.0 * PI).sqrt();
        let sky = [0, 1, 2].map(|channel| even * values[channel * self.columns()]);
        let lamps = if self.surfaces.emit() {
            self.emitted_of(values)
        } else {
            Vec3::ZERO
        };
        [sky.into(), lamps]
    }
}

/// Directions that a point's specular reflections show, with what light from each counts.
fn drawn(point: &SurfacePoint, seed: u32) -> Vec<(Vec3, Vec3)> {
    let specular = Appearance {
        diffuse: Vec3::ZERO,
        ..point.appearance
    };
    let view = point.to_local(point.view);
    let draw = |index: u32| {
        // Evenly, from a place by chance on (Roberts 2018).
        let steps = [(0, 0.819_172_5), (1, 0.671_043_6), (2, 0.549_700_5)];
        let uniform =
            steps.map(|(axis, step)| (unit(hash(seed, axis)) + index as f32 * step).fract());
        let local = reference::sample(&specular, view, uniform)?;
        let density = reference::pdf(&specular, local, view).max(f32::MIN_POSITIVE);
        let weight = models::evaluate(&specular, local, view) * local.z / (density * DRAWS as f32);
        let direction = point.to_world(local);
        (direction.dot(point.geometric_normal) > 0.0).then_some((direction, weight))
    };
    (0..DRAWS).filter_map(draw).collect()
}

#[cfg(test)]
mod tests {
    use relight_format::{Specular, Surface};

    use super::*;
    use crate::mesh::Mesh;
    use crate::monitor::SILENT;
    use crate::transfer::radiosity::tests::{join, solve, squares};

    /// A floor that reflects so roughly, and another mesh: the floor's material is the first.
    fn floor_below(other: Mesh, alpha: f32) -> ReflectionError {
        let mut mesh = squares(&[[Vec3::ZERO, Vec3::Z, Vec3::X]], 0.0, 0.0);
        let specular = Specular::Ggx {
            f0: [0.8; 3],
            alpha: [alpha; 2],
        };
        mesh.materials[0].surface = Surface::DiffuseSpecular {
            diffuse: [0.1; 3],
            specular,
        };
        join(&mut mesh, other);
        let (solved, caster) = solve(&mesh, None);
        let found = solved.reflection_error(&caster, 0, SILENT).unwrap();
        println!("{found:?}");
        found.expect("the floor has a surface")
    }

    #[test]
    fn lamps_and_edges_in_smooth_surfaces_are_off_and_walls_in_rough_ones_are_not() {
        // Above the floor, facing down.
        let lamp = || {
            squares(
                &[[Vec3::new(0.4, 0.5, 0.4), 0.2 * Vec3::X, 0.2 * Vec3::Z]],
                0.0,
                5.0,
            )
        };
        let smooth = floor_below(lamp(), 0.05);
        assert!(smooth.lamps > 0.5, "{smooth:?}");
        // One wall, and one of stripes that are black and white by turns.
        let wall = squares(&[[Vec3::ZERO, Vec3::Y, Vec3::Z]], 0.5, 0.0);
        let rough = floor_below(wall, 0.5);
        assert!(rough.sky < 0.04 && rough.lamps == 0.0, "{rough:?}");
        let stripe = |number: u8| {
            let corner = Vec3::new(0.0, 0.0, 0.125 * f32::from(number));
            let white = f32::from(number % 2);
            squares(&[[corner, Vec3::Y, 0.125 * Vec3::Z]], white, 0.0)
        };
        let mut stripes = stripe(0);
        (1..8).for_each(|number| join(&mut stripes, stripe(number)));
        let smooth = floor_below(stripes, 0.05);
        assert!(smooth.sky > 0.1, "{smooth:?}");
    }
}
