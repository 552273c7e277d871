//! Truth of the whole method: the original environment image and the original reflection
//! models, by multiple importance sampling of both ([`super::path`]).

use std::f32::consts::PI;

use glam::{Mat3, Vec3};
use relight_bake::environment::hdr::LatLong;
use relight_bake::error::Error;
use relight_bake::internals::transfer::bare_scene;
use relight_bake::measured::Table;
use relight_bake::scene::load::SceneInput;
use relight_format::Scene;
use relight_shading::gpu;

use super::path::{DistantLight, Draws, Part, Paths, Reflector};
use super::random::hash;
use super::{Estimate, Filter, Geometry, Options, REPLICAS, estimate_image};
use crate::display::luminance;
use crate::image_file::Image;

/// The scene of an input file as the runtime would see it but without visibility: nothing
/// that [`render`] reads is missing.
pub fn unbaked(input: &SceneInput) -> Scene {
    Scene {
        name: input.name.clone(),
        camera: input.camera,
        ..bare_scene(&input.mesh)
    }
}

/// The measured tables of an input file, by material.
pub fn tables(input: &SceneInput) -> Result<Vec<Option<Table>>, Error> {
    let mut tables: Vec<_> = input.mesh.materials.iter().map(|_| None).collect();
    for (material, path) in &input.measured {
        tables[*material] = Some(Table::load(path)?);
    }
    Ok(tables)
}

/// Estimates the image. `measured[m]` is the table of the scene's material m, if it has
/// one. A sample is a path: at every surface that it meets a pair of rays, one drawn from the
/// environment and one from the reflection, and another pair for each local light, a sphere
/// that only what lies before it blocks; with [`Filter::Box`] every sample has its own point of
/// the pixel.
pub fn render(
    geometry: &Geometry,
    measured: &[Option<Table>],
    environment: &EnvironmentSampler,
    local: &[gpu::LocalLight],
    size: [u32; 2],
    options: &Options,
    row_done: &(dyn Fn() + Sync),
) -> Image {
    let samples = options.samples.div_ceil(REPLICAS);
    let paths = Paths {
        geometry,
        measured,
        distant: environment,
        local,
        bounces: options.bounces,
    };
    estimate_image(size, row_done, &|| true, |x, y| {
        let seed = hash(hash(options.seed, x), y);
        let at = |[u, v]: [f32; 2]| -> Option<Reflector> {
            let seen = geometry.seen(x as f32 + u, y as f32 + v, options.filter)?;
            Some(paths.reflector(seen.point, seen.triangle, seen.emission))
        };
        let center = (options.filter == Filter::Center).then(|| at([0.5; 2]));
        std::array::from_fn(|replica| -> Estimate {
            let seed = hash(seed, replica as u32);
            let (mut radiance, mut coverage) = (Vec3::ZERO, 0.0);
            for sample in 0..samples {
                let draws = Draws { sample, seed };
                let boxed;
                let reflector = if let Some(center) = &center {
                    center
                } else {
                    boxed = at(draws.pair(0));
                    &boxed
                };
                if let Some(reflector) = reflector {
                    radiance += paths.radiance(reflector, Part::Whole, draws);
                    coverage += 1.0;
                }
            }
            (radiance / samples as f32, coverage / samples as f32)
        })
    })
}

/// Draws directions from a lat-long image in proportion to luminance.
///
/// The density is the bilinear interpolation between pixel centres of luminance times
/// solid angle, by the rules of [`LatLong::sample`], so that density and radiance vanish
/// and peak together: a pixel is drawn, then a point under its tent.
pub struct EnvironmentSampler<'a> {
    image: &'a LatLong,
    /// World to image.
    rotation: Mat3,
    /// Luminance times solid angle of every pixel over the sum of all.
    weights: Vec<f32>,
    /// Running sums of `weights` over rows, and within each row.
    rows: Vec<f64>,
    columns: Vec<f64>,
}

impl<'a> EnvironmentSampler<'a> {
    /// Prepares `image`, turned by `rotation` radians counter-clockwise about +Y.
    pub fn new(image: &'a LatLong, rotation: f32) -> Self {
        let width = image.width as usize;
        let mut columns = Vec::with_capacity(image.pixels.len());
        let mut rows = Vec::with_capacity(image.height as usize);
        let mut total = 0.0;
        for (row, pixels) in image.pixels.chunks_exact(width).enumerate() {
            let solid_angle = image.solid_angle(row as u32);
            let mut sum = 0.0;
            columns.extend(pixels.iter().map(|&pixel| {
                sum += f64::from(luminance(pixel)) * solid_angle;
                sum
            }));
            total += sum;
            rows.push(total);
        }
        let weights = columns.chunks_exact(width).flat_map(|row| {
            row.iter().scan(0.0, move |before, &sum| {
                let weight = if total > 0.0 {
                    (sum - *before) / total
                } else {
                    0.0
                };
                *before = sum;
                Some(weight as f32)
            })
        });
        Self {
            rotation: Mat3::from_rotation_y(-rotation),
            weights: weights.collect(),
            image,
            rows,
            columns,
        }
    }
}

impl DistantLight for EnvironmentSampler<'_> {
    fn sample(&self, [u, v]: [f32; 2]) -> Vec3 {
        let (row, v) = draw(&self.rows, f64::from(v));
        let width = self.image.width as usize;
        let (column, u) = draw(&self.columns[row * width..(row + 1) * width], f64::from(u));
        // Folding at the poles is what holding the first and last row does to the density.
        let height = f64::from(self.image.height);
        let y = (row as f64 + 0.5 + tent(v)) / height;
        let y = if y < 0.0 { -y } else { 1.0 - (1.0 - y).abs() };
        let x = (column as f64 + 0.5 + tent(u)) / width as f64;
        self.rotation.transpose() * LatLong::direction_at(x, y).as_vec3()
    }

    fn lookup(&self, direction: Vec3) -> (Vec3, f32) {
        let direction = self.rotation * direction;
        let (width, height) = (self.image.width as usize, self.image.height as usize);
        let (u, v) = LatLong::coordinates(direction.as_dvec3());
        let x = u * width as f64 - 0.5;
        let y = (v * height as f64 - 0.5).clamp(0.0, (height - 1) as f64);
        let left = (x.floor() as i64).rem_euclid(width as i64) as usize;
        let right = (left + 1) % width;
        let top = y.floor() as usize;
        let bottom = (top + 1).min(height - 1);
        let (fx, fy) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
        let (mut radiance, mut weight) = (Vec3::ZERO, 0.0);
        for (column, row, share) in [
            (left, top, (1.0 - fx) * (1.0 - fy)),
            (right, top, fx * (1.0 - fy)),
            (left, bottom, (1.0 - fx) * fy),
            (right, bottom, fx * fy),
        ] {
            let index = row * width + column;
            radiance += share * Vec3::from(self.image.pixels[index]);
            weight += share * self.weights[index];
        }
        // dω = (2π/W) (π/H) sinθ dx dy.
        let sine = direction.x.hypot(direction.z).max(1e-6);
        let pixel = 2.0 * PI * PI * sine / (width * height) as f32;
        (radiance, weight / pixel)
    }
}

/// The interval of a running sum that `u` in [0, 1) falls into, and where in it.
fn draw(sums: &[f64], u: f64) -> (usize, f64) {
    let target = u * sums[sums.len() - 1];
    let index = sums
        .partition_point(|&sum| sum <= target)
        .min(sums.len() - 1);
    let before = if index == 0 { 0.0 } else { sums[index - 1] };
    let size = sums[index] - before;
    (
        index,
        if size > 0.0 {
            ((target - before) / size).clamp(0.0, 1.0)
        } else {
            0.5
        },
    )
}

/// Maps uniform [0, 1] to the tent density 1 − |t| on [−1, 1].
fn tent(u: f64) -> f64 {
    if u < 0.5 {
        (2.0 * u).sqrt() - 1.0
    } else {
        1.0 - (2.0 - 2.0 * u).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::super::random::sobol_pair;
    use super::super::{Seen, test_scene};
    use super::*;
    use relight_format::{Specular, Surface};
    use relight_shading::gpu;

    fn image(width: u32, height: u32, radiance: impl Fn(u32) -> [f32; 3]) -> LatLong {
        LatLong::repair(width, height, (0..width * height).map(radiance).collect())
    }

    fn mottled(i: u32) -> [f32; 3] {
        let value = unit_of(i);
        [value, value * value, if i == 37 { 40.0 } else { 0.3 }]
    }

    fn unit_of(i: u32) -> f32 {
        super::super::random::unit(hash(i, 99))
    }

    #[test]
    fn the_environment_density_is_that_of_the_samples() {
        let image = image(12, 6, mottled);
        let sampler = EnvironmentSampler::new(&image, 0.7);
        // E[g/density] = ∫g for several g; a wrong density anywhere biases one of them.
        let count = 1 << 16;
        let mut sums = [0f64; 4];
        for i in 0..count {
            let direction = sampler.sample(sobol_pair(i, 5));
            let (_, density) = sampler.lookup(direction);
            let tests = [
                1.0,
                direction.y * direction.y,
                direction.y.max(0.0),
                direction.x.max(0.0),
            ];
            for (sum, test) in sums.iter_mut().zip(tests) {
                *sum += f64::from(test / density);
            }
        }
        let pi = std::f64::consts::PI;
        for (sum, expected) in sums.iter().zip([4.0 * pi, 4.0 * pi / 3.0, pi, pi]) {
            let mean = sum / f64::from(count);
            // Scrambled Sobol quadrature with 65,536 points of weights up to 100.
            assert!(
                (mean / expected - 1.0).abs() < 0.01,
                "{mean}, not {expected}"
            );
        }
    }

    #[test]
    fn lookup_is_the_image_sample() {
        let image = image(9, 5, mottled);
        let sampler = EnvironmentSampler::new(&image, 0.0);
        for i in 0..500 {
            let [u, v] = sobol_pair(i, 1);
            let direction = LatLong::direction_at(f64::from(u), f64::from(v)).as_vec3();
            let found = sampler.lookup(direction).0;
            // Both interpolate in f32, in different orders.
            assert!(found.distance(image.sample(direction)) < 1e-4);
        }
    }

    fn render_patch(surface: Surface, environment: &LatLong, options: &Options) -> Image {
        let mut scene = test_scene::scene([0.0; 3], &test_scene::plane());
        scene.materials[0].surface = surface;
        let geometry = Geometry::new(&scene, test_scene::view(8));
        let sampler = EnvironmentSampler::new(environment, 0.0);
        render(&geometry, &[None], &sampler, &[], [8, 8], options, &|| ())
    }

    fn lambert(diffuse: [f32; 3]) -> Surface {
        Surface::DiffuseSpecular {
            diffuse,
            specular: Specular::None,
        }
    }

    /// Standard errors of the mean of 64 pixels that a correct estimate stays within, but
    /// for one in a million.
    const MOST_STANDARD_ERRORS: f32 = 5.0;

    fn mean_and_error(image: &Image) -> (Vec3, Vec3) {
        let count = image.pixels.len() as f32;
        let mean = image
            .pixels
            .iter()
            .map(|p| Vec3::new(p[0], p[1], p[2]))
            .sum::<Vec3>()
            / count;
        let variance = image
            .variance
            .as_ref()
            .unwrap()
            .iter()
            .map(|&v| Vec3::from(v))
            .sum::<Vec3>();
        (mean, variance.powf(0.5) / count)
    }

    #[test]
    fn a_sphere_light_gives_its_irradiance_unless_something_is_before_it() {
        let position = Vec3::new(0.5, 3.0, 0.0);
        let light = gpu::LocalLight::from(&relight_shading::local_light::LocalLight {
            position,
            radius: 1.0,
            radiance: Vec3::splat(9.0),
            spot: None,
        });
        let patch = test_scene::scene([0.5; 3], &test_scene::plane());
        let geometry = Geometry::new(&patch, test_scene::view(8));
        let Seen { point, .. } = geometry
            .seen(4.0, 4.0, Filter::Box)
            .expect("the patch is seen");
        // Something between the patch and the light, or behind the light.
        for (height, expected) in [(1.0, 0.0), (5.0, 1.0)] {
            let lid = [[
                Vec3::new(-90.0, height, -90.0),
                Vec3::new(0.0, height, 180.0),
                Vec3::new(90.0, height, -90.0),
            ]];
            let scene = test_scene::scene([0.5; 3], &[&test_scene::plane()[..], &lid].concat());
            let geometry = Geometry::new(&scene, test_scene::view(8));
            let reflector = Reflector {
                point,
                table: None,
                emission: Vec3::ZERO,
            };
            let count = 4096;
            let sum: Vec3 = (0..count)
                .map(|i| {
                    let pair = |dimension| sobol_pair(i, hash(3, dimension));
                    let [u, v] = pair(1);
                    reflector.local(&geometry, &light, pair(0), [0.5, u, v])
                })
                .sum();
            // E = π L sin²σ cos θ, radiance = albedo E / π.
            let offset = position - point.position;
            let cosine = offset.normalize().dot(point.normal);
            let exact = expected * 0.5 * 9.0 / offset.length_squared() * cosine;
            let found = sum.x / count as f32;
            assert!(
                (found - exact).abs() <= 0.01 * exact,
                "{height}: {found} for {exact}"
            );
        }
    }

    #[test]
    fn a_white_furnace_reflects_the_albedo() {
        let furnace = image(8, 4, |_| [1.0; 3]);
        for filter in [Filter::Center, Filter::Box] {
            let options = Options {
                samples: 64,
                filter,
                seed: 1,
                bounces: 0,
            };
            let albedo = Vec3::new(0.9, 0.5, 0.1);
            let (mean, error) =
                mean_and_error(&render_patch(lambert(albedo.into()), &furnace, &options));
            let most = MOST_STANDARD_ERRORS * error + 1e-6;
            assert!((mean - albedo).abs().cmple(most).all(), "{mean} ± {error}");
            assert!(error.max_element() < 0.01);
        }
    }

    #[test]
    fn light_of_a_surface_counts_as_that_of_the_distance() {
        // A black wall that glows takes half of what the plane sees.
        let albedo = Vec3::new(0.8, 0.5, 0.2);
        let mut triangles = test_scene::plane_and_wall();
        triangles[2..].iter_mut().for_each(|wall| wall.reverse());
        let mut scene = test_scene::scene(albedo.into(), &triangles);
        let mut glowing = scene.materials[0].clone();
        glowing.surface = lambert([0.0; 3]);
        glowing.emission = [1.0, 2.0, 3.0];
        scene.materials.push(glowing);
        scene.triangles[2..]
            .iter_mut()
            .for_each(|wall| wall.material = 1);
        let geometry = Geometry::new(&scene, test_scene::view(8));
        let dark = image(8, 4, |_| [0.0; 3]);
        let sampler = EnvironmentSampler::new(&dark, 0.0);
        for bounces in [0, 1, 3] {
            let options = Options {
                samples: 256,
                filter: Filter::Center,
                seed: 6,
                bounces,
            };
            let image = render(&geometry, &[], &sampler, &[], [8, 8], &options, &|| ());
            let (mean, error) = mean_and_error(&image);
            let exact = albedo * Vec3::new(0.5, 1.0, 1.5);
            let most = MOST_STANDARD_ERRORS * error + 1e-4;
            assert!(
                (mean - exact).abs().cmple(most).all(),
                "{bounces}: {mean} ± {error}, not {exact}"
            );
        }
    }

    #[test]
    fn a_lambertian_plane_sees_the_irradiance() {
        let environment = image(64, 32, mottled);
        let options = Options {
            samples: 128,
            filter: Filter::Center,
            seed: 2,
            bounces: 0,
        };
        let (mean, error) =
            mean_and_error(&render_patch(lambert([0.5; 3]), &environment, &options));
        let (rows, columns) = (512, 1024);
        let mut irradiance = Vec3::ZERO;
        for row in 0..rows / 2 {
            for column in 0..columns {
                let direction = LatLong::direction_at(
                    (f64::from(column) + 0.5) / f64::from(columns),
                    (f64::from(row) + 0.5) / f64::from(rows),
                )
                .as_vec3();
                let sine = direction.x.hypot(direction.z);
                irradiance += environment.sample(direction) * direction.y * sine;
            }
        }
        irradiance *= 2.0 * PI * PI / (rows * columns) as f32;
        let expected = irradiance * 0.5 / PI;
        // Plus the error of the midpoint rule on a bilinear image: half a percent.
        let most = MOST_STANDARD_ERRORS * error + 5e-3 * expected;
        assert!(
            (mean - expected).abs().cmple(most).all(),
            "{mean} ± {error}, not {expected}"
        );
    }

    #[test]
    fn anisotropy_follows_the_texture_coordinates() {
        let mut scene = test_scene::scene([0.5; 3], &test_scene::plane());
        // u along (1, 0, 2), v along (−2, 0, 1): mirrored, as texture rows run down.
        for vertex in &mut scene.vertices {
            let [x, _, z] = vertex.position;
            vertex.uv = [x + 2.0 * z, -2.0 * x + z];
        }
        let alpha = |alpha| Surface::DiffuseSpecular {
            diffuse: [0.0; 3],
            specular: Specular::Ggx {
                f0: [1.0; 3],
                alpha,
            },
        };
        let view = test_scene::view(4);
        let tangent = |scene: &Scene| {
            let geometry = Geometry::new(scene, view);
            let point = geometry.seen(2.0, 2.0, Filter::Box).unwrap().point;
            assert_eq!(point.bitangent, point.normal.cross(point.tangent));
            point.tangent
        };
        scene.materials[0].surface = alpha([0.1, 0.4]);
        assert!(tangent(&scene).distance(Vec3::new(1.0, 0.0, 2.0).normalize()) < 1e-6);
        scene.materials[0].surface = alpha([0.4, 0.4]);
        let vertex = tangent(&scene);
        assert!(vertex.distance(Vec3::new(1.0, 0.0, 2.0).normalize()) > 0.1);
        scene.materials[0].surface = alpha([0.1, 0.4]);
        for vertex in &mut scene.vertices {
            vertex.uv = [0.0; 2];
        }
        assert_eq!(tangent(&scene), vertex);
    }

    #[test]
    fn both_strategies_agree_on_a_glossy_surface() {
        // The environment's density carries the first image, the reflection's the second:
        // their light is one small source and one that is nearly constant.
        let glossy = |alpha: f32| Surface::DiffuseSpecular {
            diffuse: [0.2; 3],
            specular: Specular::Ggx {
                f0: [0.6; 3],
                alpha: [alpha; 2],
            },
        };
        for alpha in [0.1, 0.6] {
            let environment = image(32, 16, mottled);
            let render = |seed, samples| {
                let options = Options {
                    samples,
                    filter: Filter::Center,
                    seed,
                    bounces: 0,
                };
                mean_and_error(&render_patch(glossy(alpha), &environment, &options))
            };
            let (few, few_error) = render(1, 32);
            let (many, many_error) = render(2, 512);
            let most =
                MOST_STANDARD_ERRORS * (few_error * few_error + many_error * many_error).powf(0.5);
            assert!(
                (few - many).abs().cmple(most).all(),
                "{few} ± {few_error}, {many}"
            );
        }
    }
}
