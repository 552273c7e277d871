//! Truth under the runtime's own lights and lobes: only visibility and its integration
//! differ from a rendering. What other surfaces reflect to the point that is seen is that of
//! the exact reflection models, there and everywhere.

use std::f32::consts::TAU;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use relight_format::Scene;
use relight_runtime::Frame;
use relight_shading::camera::View;
use relight_shading::gpu;
use relight_shading::occluders::Occluders;
use relight_shading::octahedral;
use relight_shading::shade::{Lighting, product_lobes};
use relight_shading::sources::Lit;
use relight_shading::spherical_gaussian::{SphericalGaussian, cosine_moment, energy, first_moment};
use relight_shading::ssdf::{Basis, SignedDistance as _, Ssdf};
use relight_shading::surface::SurfacePoint;

use super::path::{DistantLight, Draws, Part, Paths, Reflector};
use super::random::{hash, kronecker_pair, sobol_pair, unit};
use super::{Estimate, Filter, Geometry, Options, REPLICAS, Trees, estimate_image, sources};
use crate::display::luminance;
use crate::image_file::Image;

/// Where what is visible is known from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Visibility {
    /// Rays against the mesh.
    Exact,
    /// The scene's SSDFs: what is left against a rendering is the error of its integrator.
    Baked,
}

/// Estimates what the runtime would draw of a scene. Whatever the frame says of methods and
/// reflections has no part in it.
pub fn of_frame(
    scene: &Scene,
    frame: &Frame,
    size: [u32; 2],
    options: &Options,
    visibility: Visibility,
    row_done: &(dyn Fn() + Sync),
) -> Image {
    let geometry = Geometry::new(scene, view_of(frame, size));
    of_geometry(
        &geometry,
        frame,
        size,
        options,
        visibility,
        (row_done, &|| true),
    )
}

/// [`of_frame`] with exact visibility and trees that were built before, for as long as it is `wanted`,
/// which is asked at every pixel: `None` once it is not.
pub fn of_frame_while(
    scene: &Scene,
    trees: &Arc<Trees>,
    frame: &Frame,
    size: [u32; 2],
    options: &Options,
    wanted: &(dyn Fn() -> bool + Sync),
) -> Option<Image> {
    let geometry = Geometry::of(scene, view_of(frame, size), trees.clone());
    let exact = Visibility::Exact;
    let image = of_geometry(&geometry, frame, size, options, exact, (&|| (), wanted));
    wanted().then_some(image)
}

fn view_of(frame: &Frame, [width, height]: [u32; 2]) -> View {
    let view = frame.camera.view(width, height, 1.0);
    view.expect("a camera with rays")
}

/// Called with every row, and asked at every pixel.
type Watch<'a> = (&'a (dyn Fn() + Sync), &'a (dyn Fn() -> bool + Sync));

fn of_geometry(
    geometry: &Geometry,
    frame: &Frame,
    size: [u32; 2],
    options: &Options,
    visibility: Visibility,
    watch: Watch,
) -> Image {
    let local: Vec<gpu::LocalLight> = frame.local_lights.iter().map(Into::into).collect();
    let sources = frame.rotated_sources();
    // Rays are cast by `geometry`.
    let occluders = Occluders::default();
    let lighting = Lighting {
        lights: &frame.rotated_lights(),
        local: &local,
        sources: sources.as_ref().map(|sources| Lit {
            sources,
            occluders: &occluders,
            ray_offset: 0.0,
            pixel: None,
            shadow_map: None,
        }),
        ..Lighting::default()
    };
    estimate(geometry, &lighting, visibility, size, options, watch)
}

/// Estimates the image. Rays shadow sources, whatever `visibility` says, and the exact models reflect
/// them, as many samples for each as for all lobes. Local lights are seen as the runtime has them: as lobes, blocked by
/// what lies behind them as well. A sample is one ray; with [`Filter::Box`] a replica's rays share
/// one point of the pixel.
pub fn render(
    geometry: &Geometry,
    lighting: &Lighting,
    visibility: Visibility,
    size: [u32; 2],
    options: &Options,
    row_done: &(dyn Fn() + Sync),
) -> Image {
    let watch: Watch = (row_done, &|| true);
    estimate(geometry, lighting, visibility, size, options, watch)
}

fn estimate(
    geometry: &Geometry,
    lighting: &Lighting,
    visibility: Visibility,
    size: [u32; 2],
    options: &Options,
    (row_done, wanted): Watch,
) -> Image {
    let rays = options.samples.div_ceil(REPLICAS);
    let basis = (visibility == Visibility::Baked).then(|| Basis::new(geometry.scene));
    let mut lights = lighting.lights.to_vec();
    if let Some(lit) = &lighting.sources {
        lights.extend(lit.sources.lobes());
    }
    let distant = LobeSampler::new(&lights);
    let paths = Paths {
        geometry,
        measured: &[],
        distant: &distant,
        local: lighting.local,
        bounces: options.bounces,
    };
    let bounced = |reflector: &Reflector, seed: u32| -> Vec3 {
        let path = |sample| paths.radiance(reflector, Part::Bounced, Draws { sample, seed });
        (0..rays).map(path).sum::<Vec3>() / rays as f32
    };
    estimate_image(size, row_done, wanted, |x, y| {
        let seed = hash(hash(options.seed, x), y);
        let at = |[u, v]: [f32; 2]| -> Option<(Mixture, Option<Ssdf>, Reflector)> {
            let seen = geometry.seen(x as f32 + u, y as f32 + v, options.filter)?;
            let field = (basis.as_ref()).map(|basis| {
                Ssdf::interpolate(geometry.scene, basis, seen.triangle, seen.barycentrics)
            });
            let reflector = paths.reflector(seen.point, seen.triangle, seen.emission);
            Some((Mixture::new(&seen.point, lighting), field, reflector))
        };
        let center = (options.filter == Filter::Center).then(|| at([0.5; 2]));
        let replicas: [_; REPLICAS as usize] = std::array::from_fn(|replica| {
            let boxed;
            let mixture = if let Some(center) = &center {
                center
            } else {
                boxed = at(sobol_pair(replica as u32, seed));
                &boxed
            };
            let seed = hash(seed, replica as u32);
            mixture.as_ref().map(|(mixture, field, reflector)| {
                let visible = |direction| match field {
                    Some(field) => field.distance(direction) > 0.0,
                    None => geometry.visible(&mixture.point, direction),
                };
                let mut gathered = mixture.trace(visible, rays, seed);
                if let Some(lit) = &lighting.sources {
                    gathered.sources =
                        sources::reflected(geometry, &mixture.point, lit.sources, rays, seed);
                }
                gathered.bounced = reflector.emission;
                if options.bounces > 0 {
                    gathered.bounced += bounced(reflector, seed);
                }
                gathered
            })
        });
        combine(&replicas)
    })
}

/// Lobes below this fraction of what all lobes would reflect with nothing below the horizon
/// or blocked are left out: hundreds of them are far below a thousandth of a deep shadow.
const NEGLIGIBLE: f32 = 1e-8;

/// Position on the Z-order curve (Morton 1966) of a point in the unit square.
fn morton(point: Vec2) -> u32 {
    let spread = |x: f32| {
        let bits = (x * 65535.0) as u32;
        (0..16)
            .map(|bit| (bits >> bit & 1) << (2 * bit))
            .sum::<u32>()
    };
    spread(point.x) | spread(point.y) << 1
}

/// What the rays of one replica gathered.
#[derive(Clone, Copy, Default)]
struct Gathered {
    /// Estimate of the radiance.
    visible: Vec3,
    /// Estimate, from the same rays, of the radiance if nothing were blocked.
    unoccluded: Vec3,
    /// The radiance if nothing were blocked.
    expected: Vec3,
    /// Estimate of what sources add to the radiance.
    sources: Vec3,
    /// What the surface emits, and an estimate, from rays of its own, of the radiance that other
    /// surfaces are the cause of.
    bounced: Vec3,
}

/// Radiance of every replica. How far its unoccluded estimate is off is known, and what
/// that says about its radiance is taken out (a control variate), in the proportion of
/// visible to unoccluded light that the *other* replicas saw, which keeps it unbiased.
fn combine(replicas: &[Option<Gathered>; REPLICAS as usize]) -> [Estimate; REPLICAS as usize] {
    std::array::from_fn(|own| {
        let Some(gathered) = replicas[own] else {
            return (Vec3::ZERO, 0.0);
        };
        let (mut visible, mut unoccluded) = (Vec3::ZERO, Vec3::ZERO);
        for (index, other) in replicas.iter().enumerate() {
            if let Some(other) = other.filter(|_| index != own) {
                visible += other.visible;
                unoccluded += other.unoccluded;
            }
        }
        let share = visible / unoccluded.max(Vec3::splat(f32::MIN_POSITIVE));
        (
            gathered.visible
                + share * (gathered.expected - gathered.unoccluded)
                + gathered.sources
                + gathered.bounced,
            1.0,
        )
    })
}

/// The product lobes of a point, to be chosen from by their unoccluded luminance.
struct Mixture<'a> {
    point: SurfacePoint<'a>,
    lobes: Vec<SphericalGaussian>,
    /// Running sum of the lobes' unoccluded luminances.
    cumulative: Vec<f32>,
    /// Radiance if nothing were blocked.
    unoccluded: Vec3,
}

impl<'a> Mixture<'a> {
    fn new(point: &SurfacePoint<'a>, lighting: &Lighting) -> Self {
        let mut lobes = Vec::new();
        let mut bound = 0.0;
        product_lobes(point, lighting, |lobe| {
            bound += luminance(lobe.integral().into());
            lobes.push(lobe);
            // Nothing is to be left out.
            Vec3::ZERO
        });
        lobes.retain(|lobe| luminance(lobe.integral().into()) > NEGLIGIBLE * bound);
        // Neighbours in direction become neighbours in the sums, so that systematic sampling
        // of the sums also spreads rays over directions.
        lobes.sort_by_cached_key(|lobe| morton(octahedral::encode(lobe.axis)));
        let mut mixture = Self {
            point: *point,
            lobes: Vec::with_capacity(lobes.len()),
            cumulative: Vec::with_capacity(lobes.len()),
            unoccluded: Vec3::ZERO,
        };
        let mut total = 0.0;
        for lobe in lobes {
            let cosine = point.normal.dot(lobe.axis);
            let radiance = lobe.amplitude * cosine_integral(lobe.sharpness, cosine);
            let weight = luminance(radiance.into());
            if weight > 0.0 {
                total += weight;
                mixture.lobes.push(lobe);
                mixture.cumulative.push(total);
                mixture.unoccluded += radiance;
            }
        }
        mixture
    }

    /// Traces `count` rays.
    fn trace(&self, visible: impl Fn(Vec3) -> bool, count: u32, seed: u32) -> Gathered {
        let Some(&total) = self.cumulative.last() else {
            return Gathered::default();
        };
        let start = unit(hash(seed, 7));
        let mut gathered = Gathered {
            expected: self.unoccluded,
            ..Gathered::default()
        };
        let mut lobe = 0;
        for ray in 0..count {
            // Systematic sampling of the lobes; the rays of one lobe are successive.
            let target = total * ((ray as f32 + start) / count as f32);
            while lobe + 1 < self.lobes.len() && self.cumulative[lobe] <= target {
                lobe += 1;
            }
            let before = if lobe == 0 {
                0.0
            } else {
                self.cumulative[lobe - 1]
            };
            let probability = (self.cumulative[lobe] - before) / total;
            let gaussian = &self.lobes[lobe];
            let direction = sample(gaussian, kronecker_pair(ray, seed));
            let cosine = self.point.normal.dot(direction);
            if cosine > 0.0 {
                let value = gaussian.integral() * (cosine / (probability * count as f32));
                gathered.unoccluded += value;
                if visible(direction) {
                    gathered.visible += value;
                }
            }
        }
        gathered
    }
}

/// ∫ exp(λ(p·ω − 1)) max(n·ω, 0) dω with `cosine` = n·p, by quadrature: nothing here may
/// rest on the tables that rendering uses. Relative error 1e-5 of the lobe's integral.
fn cosine_integral(sharpness: f32, cosine: f32) -> f32 {
    // exp(−18) of the lobe is left out.
    let reach = (1.0 - 18.0 / sharpness).clamp(-1.0, 1.0).acos();
    let elevation = cosine.clamp(-1.0, 1.0).asin();
    if elevation >= reach {
        return cosine * first_moment(sharpness);
    }
    if elevation <= -reach {
        return 0.0;
    }
    // ∫ max(n·ω, 0) dφ around a ring at θ from the axis, where n·ω = a + b cos φ.
    let ring = |theta: f32| {
        let (sine, co) = theta.sin_cos();
        let (a, b) = (cosine * co, elevation.cos() * sine);
        let half = if b > 0.0 {
            (-a / b).clamp(-1.0, 1.0).acos()
        } else {
            0.0
        };
        let chord = (0.5 * theta).sin();
        (-2.0 * sharpness * chord * chord).exp() * sine * 2.0 * (a * half + b * half.sin())
    };
    // Rings begin and end to cross the horizon at these angles. Above it they are whole.
    let first = elevation.abs();
    let last = (std::f32::consts::PI - first).min(reach);
    let whole = if elevation > 0.0 {
        let chord = (0.5 * first).sin();
        TAU * cosine * cosine_moment(sharpness, 2.0 * chord * chord)
    } else {
        0.0
    };
    // What lies beyond `last` is whole again where the axis is below the horizon.
    let beyond = if elevation < 0.0 && last < reach {
        gauss(last, reach, ring)
    } else {
        0.0
    };
    whole + gauss(first, last, ring) + beyond
}

/// Sixteen-point Gauss-Legendre quadrature.
fn gauss(from: f32, to: f32, f: impl Fn(f32) -> f32) -> f32 {
    const NODES: [(f32, f32); 8] = [
        (0.095_012_51, 0.189_450_6),
        (0.281_603_55, 0.182_603_42),
        (0.458_016_78, 0.169_156_52),
        (0.617_876_24, 0.149_595_99),
        (0.755_404_4, 0.124_628_97),
        (0.865_631_2, 0.095_158_51),
        (0.944_575, 0.062_253_52),
        (0.989_400_9, 0.027_152_46),
    ];
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let pair = |&(x, w): &(f32, f32)| w * (f(middle - half * x) + f(middle + half * x));
    half * NODES.iter().map(pair).sum::<f32>()
}

/// Draws directions from the sum of some lobes, each in proportion to its luminance.
struct LobeSampler<'a> {
    lobes: &'a [SphericalGaussian],
    /// Running sum of the lobes' shares.
    cumulative: Vec<f32>,
}

impl<'a> LobeSampler<'a> {
    fn new(lobes: &'a [SphericalGaussian]) -> Self {
        let weights = || lobes.iter().map(|lobe| luminance(lobe.integral().into()));
        let total = weights().sum::<f32>().max(f32::MIN_POSITIVE);
        let cumulative = weights().scan(0.0, |sum, weight| {
            *sum += weight / total;
            Some(*sum)
        });
        Self {
            lobes,
            cumulative: cumulative.collect(),
        }
    }
}

impl DistantLight for LobeSampler<'_> {
    fn sample(&self, [u, v]: [f32; 2]) -> Vec3 {
        let Some(last) = self.lobes.len().checked_sub(1) else {
            return Vec3::Y;
        };
        let index = self.cumulative.partition_point(|&sum| sum <= u).min(last);
        let before = if index == 0 {
            0.0
        } else {
            self.cumulative[index - 1]
        };
        let share = (self.cumulative[index] - before).max(f32::MIN_POSITIVE);
        let within = ((u - before) / share).clamp(0.0, 1.0 - f32::EPSILON);
        sample(&self.lobes[index], [within, v]).normalize()
    }

    fn lookup(&self, direction: Vec3) -> (Vec3, f32) {
        let (mut radiance, mut density, mut before) = (Vec3::ZERO, 0.0, 0.0);
        for (lobe, &sum) in self.lobes.iter().zip(&self.cumulative) {
            let value = (lobe.sharpness * (lobe.axis.dot(direction) - 1.0)).exp();
            radiance += lobe.amplitude * value;
            density += (sum - before) * value / energy(lobe.sharpness);
            before = sum;
        }
        (radiance, density)
    }
}

/// A direction distributed as the lobe, scaled to integrate to one (Jakob 2012, "Numerically
/// stable sampling of the von Mises-Fisher distribution").
fn sample(lobe: &SphericalGaussian, [u, v]: [f32; 2]) -> Vec3 {
    // q = 1 − cos θ has the density exp(−λq) on [0, 2].
    let q = if lobe.sharpness < 1e-3 {
        2.0 * u
    } else {
        -(u * (-2.0 * lobe.sharpness).exp_m1()).ln_1p() / lobe.sharpness
    };
    let sine = (q * (2.0 - q)).max(0.0).sqrt();
    let (sin, cos) = (TAU * v).sin_cos();
    let (x, y) = lobe.axis.any_orthonormal_pair();
    x * (sine * cos) + y * (sine * sin) + lobe.axis * (1.0 - q)
}

#[cfg(test)]
mod tests {
    use super::super::test_scene;
    use super::*;

    fn lobe(axis: Vec3, sharpness: f32, amplitude: Vec3) -> SphericalGaussian {
        SphericalGaussian {
            axis: axis.normalize(),
            sharpness,
            amplitude,
        }
    }

    fn options(samples: u32, seed: u32) -> Options {
        Options {
            samples,
            filter: Filter::Center,
            seed,
            bounces: 0,
        }
    }

    fn render_patch(
        triangles: &[[Vec3; 3]],
        lights: &[SphericalGaussian],
        options: &Options,
    ) -> Image {
        let scene = test_scene::scene([0.8, 0.5, 0.2], triangles);
        let geometry = Geometry::new(&scene, test_scene::view(8));
        let lighting = Lighting {
            lights,
            ..Lighting::default()
        };
        render(
            &geometry,
            &lighting,
            Visibility::Exact,
            [8, 8],
            options,
            &|| (),
        )
    }

    #[test]
    fn samples_follow_the_lobe() {
        for sharpness in [0.0, 0.5, 20.0, 3e4] {
            let gaussian = lobe(Vec3::new(0.3, -0.5, 0.8), sharpness, Vec3::ONE);
            let count = 4096;
            let mean = (0..count)
                .map(|i| gaussian.axis.dot(sample(&gaussian, kronecker_pair(i, 1))))
                .sum::<f32>()
                / count as f32;
            let expected = first_moment(sharpness) / energy(sharpness);
            // Quasi-random quadrature of a smooth function with 4,096 points.
            assert!(
                (mean - expected).abs() < 1e-3,
                "λ = {sharpness}: {mean}, not {expected}"
            );
        }
    }

    /// The stored variance over the true one, averaged over 64 pixels and three channels of
    /// eight replicas each, has a standard deviation of 0.1 or so.
    const VARIANCE_RATIO: std::ops::Range<f32> = 0.6..1.6;
    /// Standard errors of the mean over all pixels that a correct estimate stays within, but
    /// for one in a million.
    const MOST_STANDARD_ERRORS: f32 = 5.0;

    /// The stored variance must be that of the pixels about `expected`, and explain the
    /// difference of their mean.
    fn z_test(image: &Image, expected: Vec3) {
        let (mut bias, mut squares, mut variance) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
        for (pixel, own) in image.pixels.iter().zip(image.variance.as_ref().unwrap()) {
            let difference = Vec3::new(pixel[0], pixel[1], pixel[2]) - expected;
            bias += difference;
            squares += difference * difference;
            variance += Vec3::from(*own);
        }
        let count = image.pixels.len() as f32;
        // Rounding of f32 sums and the stated error of the quadrature.
        let rounding = 2e-5 * expected;
        let most = MOST_STANDARD_ERRORS * variance.powf(0.5) + count * rounding;
        assert!(
            bias.abs().cmple(most).all(),
            "bias {}, at most {}",
            bias / count,
            most / count
        );
        if variance.min_element() > count * rounding.max_element().powi(2) {
            let ratio = (squares / variance).element_sum() / 3.0;
            assert!(
                VARIANCE_RATIO.contains(&ratio),
                "variance is off by a factor {ratio}"
            );
        }
    }

    #[test]
    fn unoccluded_lobes_match_a_fine_grid() {
        for sharpness in [0.05f32, 1.0, 7.0, 60.0, 4000.0] {
            let width = 1.0 / sharpness.max(1.0).sqrt();
            for i in -12..=12 {
                let elevation = (i as f32 / 12.0 * 5.0 * width).clamp(-1.5, 1.5);
                let (sine, cosine) = (f64::from(elevation)).sin_cos();
                let end = (7.0 * f64::from(width)).min(std::f64::consts::PI);
                let (rows, columns) = (600, 600);
                let mut sum = 0.0;
                for row in 0..rows {
                    let theta = end * (f64::from(row) + 0.5) / f64::from(rows);
                    let chord = (0.5 * theta).sin();
                    let value = (-2.0 * f64::from(sharpness) * chord * chord).exp() * theta.sin();
                    for column in 0..columns {
                        let phi =
                            std::f64::consts::TAU * (f64::from(column) + 0.5) / f64::from(columns);
                        let n = sine * theta.cos() + cosine * theta.sin() * phi.cos();
                        sum += value * n.max(0.0);
                    }
                }
                let exact = sum * end * std::f64::consts::TAU / f64::from(rows * columns);
                let found = f64::from(cosine_integral(sharpness, elevation.sin()));
                let energy = f64::from(energy(sharpness));
                let error = (found - exact).abs() / energy;
                // The stated error and that of the grid.
                assert!(
                    error < 2e-5,
                    "λ = {sharpness}, {elevation}: {found}, not {exact}"
                );
            }
        }
    }

    #[test]
    fn constant_light_gives_the_albedo() {
        // A lobe of sharpness 0 is a furnace of radiance 1: the plane reflects its albedo.
        let light = lobe(Vec3::Y, 0.0, Vec3::ONE);
        let image = render_patch(&test_scene::plane(), &[light], &options(256, 3));
        z_test(&image, Vec3::new(0.8, 0.5, 0.2));
        // The control variate leaves rounding alone where nothing is blocked.
        assert!(image.relative_noise().unwrap() < 1e-5);
        assert!(image.pixels.iter().all(|pixel| pixel[3] == 1.0));
    }

    #[test]
    fn the_sampler_of_lobes_draws_by_its_density() {
        let lights = [
            lobe(Vec3::new(0.4, 1.0, 0.1), 30.0, Vec3::new(1.0, 0.2, 0.1)),
            lobe(Vec3::new(-0.6, 0.3, 0.4), 4.0, Vec3::new(0.1, 0.9, 0.3)),
            lobe(Vec3::new(-0.05, 1.0, -0.3), 900.0, Vec3::new(3.0, 3.0, 9.0)),
        ];
        let sampler = LobeSampler::new(&lights);
        let count = 1 << 14;
        // E[L/density] = ∫L.
        let mean = (0..count)
            .map(|i| {
                let (radiance, density) = sampler.lookup(sampler.sample(sobol_pair(i, 5)));
                radiance / density
            })
            .sum::<Vec3>()
            / count as f32;
        let exact: Vec3 = lights.iter().map(SphericalGaussian::integral).sum();
        // Scrambled Sobol quadrature of weights below 10.
        assert!(
            (mean / exact - 1.0).abs().max_element() < 0.01,
            "{mean}, not {exact}"
        );
    }

    #[test]
    fn in_a_white_furnace_everything_is_white() {
        let light = lobe(Vec3::Y, 0.0, Vec3::ONE);
        let scene = test_scene::scene([1.0; 3], &test_scene::plane_and_wall());
        let geometry = Geometry::new(&scene, test_scene::view(8));
        let lighting = Lighting {
            lights: &[light],
            ..Lighting::default()
        };
        let options = Options {
            bounces: 64,
            ..options(256, 7)
        };
        let exact = Visibility::Exact;
        let image = render(&geometry, &lighting, exact, [8, 8], &options, &|| ());
        z_test(&image, Vec3::ONE);
    }

    #[test]
    fn a_wall_halves_constant_light() {
        // An endless wall at distance d hides the half of the sphere on its side.
        let light = lobe(Vec3::Z, 0.0, Vec3::ONE);
        let image = render_patch(&test_scene::plane_and_wall(), &[light], &options(256, 4));
        z_test(&image, Vec3::new(0.4, 0.25, 0.1));
    }

    #[test]
    fn many_lobes_agree_with_brute_force() {
        let lights = [
            lobe(Vec3::new(0.4, 1.0, 0.1), 30.0, Vec3::new(1.0, 0.2, 0.1)),
            lobe(Vec3::new(-0.6, 0.3, 0.4), 4.0, Vec3::new(0.1, 0.9, 0.3)),
            lobe(Vec3::new(-0.05, 1.0, -0.3), 900.0, Vec3::new(3.0, 3.0, 9.0)),
            lobe(Vec3::new(0.2, -0.6, 0.4), 6.0, Vec3::ONE),
        ];
        let triangles = test_scene::plane_and_wall();
        let image = render_patch(&triangles, &lights, &options(512, 5));
        // Midpoint rule over the visible quarter of the sphere, the same for every pixel:
        // the wall is endless.
        let (rows, columns) = (600, 1200);
        let mut integral = Vec3::ZERO;
        for row in 0..rows {
            let height = (row as f32 + 0.5) / rows as f32;
            let radius = (1.0 - height * height).sqrt();
            for column in 0..columns {
                let azimuth = TAU * (column as f32 + 0.5) / columns as f32;
                let direction = Vec3::new(radius * azimuth.cos(), height, radius * azimuth.sin());
                if direction.x > 0.0 {
                    let sum: Vec3 = lights.iter().map(|light| light.evaluate(direction)).sum();
                    integral += sum * height;
                }
            }
        }
        let integral = integral * (TAU / (rows * columns) as f32);
        z_test(
            &image,
            integral * Vec3::new(0.8, 0.5, 0.2) / std::f32::consts::PI,
        );
    }

    #[test]
    fn the_image_depends_on_the_seed_alone() {
        let light = lobe(Vec3::new(-0.5, 1.0, 0.0), 5.0, Vec3::ONE);
        let triangles = test_scene::plane_and_wall();
        let render = |seed| render_patch(&triangles, &[light], &options(32, seed));
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        assert_eq!(render(1), threads.install(|| render(1)));
        assert_ne!(render(1), render(2));
    }
}
