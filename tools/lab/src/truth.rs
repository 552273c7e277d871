//! Ray-traced truth in two kinds that are never mixed, of direct light or with light that
//! bounces.
//!
//! [`lobes`] has the runtime's own lights and reflection lobes under exact visibility: the
//! difference to a rendering is the error of visibility and integration alone. [`full`]
//! has the original environment and the original reflection models: the difference is
//! that of the whole method.
//!
//! In both the cosine and the horizon are those of the shading normal, and rays start at
//! the point moved a little along the geometric normal; behind the triangle itself nothing is visible. Every pixel is
//! estimated [`REPLICAS`] times independently, which gives the variance of the mean; its
//! random numbers depend on the seed and the pixel alone.

pub mod full;
pub mod lobes;
pub mod path;
mod random;
mod sources;

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;
use relight_bake::internals::visibility::{RayCaster, ray_offset};
use relight_format::{Material, Scene};
use relight_shading::camera::View;
use relight_shading::surface::{SurfacePoint, emission, surface_seen};
use relight_shading::textures::{self, Mipmaps};

use crate::image_file::Image;

/// Independent estimates per pixel. Few, so that each is well stratified; enough that
/// their spread says something.
pub const REPLICAS: u32 = 8;

/// Where in a pixel radiance is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// At its centre, as the runtime shades.
    Center,
    /// Averaged over its square.
    Box,
}

/// As good as all: paths end by chance long before.
pub const ALL_BOUNCES: u32 = 64;

/// Random numbers of everything that asks for no others.
pub const SEED: u32 = 0;

/// Distance that rays start from a surface, in diagonals of the scene's bounding box, or as a part of that at which
/// visibility is sampled: less than that, so that its error is measured.
const RAY_OFFSET: f32 = 2e-6;
const OF_SAMPLES: f32 = 0.2;

/// How much work to do and where.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Samples per pixel, rounded up to a multiple of [`REPLICAS`].
    pub samples: u32,
    /// Where in the pixel.
    pub filter: Filter,
    /// Selects the random numbers.
    pub seed: u32,
    /// Reflections that light may take before it meets the surface that is seen; 0: direct
    /// light only.
    pub bounces: u32,
}

impl Options {
    /// With all bounces where the asset has any.
    #[must_use]
    pub fn of(self, scene: &Scene) -> Self {
        Self {
            bounces: scene.transfer.as_ref().map_or(0, |_| ALL_BOUNCES),
            ..self
        }
    }

    /// At pixel centres, as the runtime shades.
    pub fn centers(samples: u32) -> Self {
        Self {
            samples,
            filter: Filter::Center,
            seed: SEED,
            bounces: 0,
        }
    }
}

/// A scene that rays can be traced in, seen by one camera.
pub struct Geometry<'a> {
    scene: &'a Scene,
    view: View,
    trees: Arc<Trees>,
    mipmaps: Mipmaps,
    /// Some material emits.
    emits: bool,
}

/// What rays are traced through: worth keeping for as long as triangles and eye stay.
pub struct Trees {
    /// Everything, from both sides: what blocks light.
    occluders: Arc<RayCaster>,
    /// Distance of the starts of rays from their surface.
    ray_offset: f32,
    /// The triangles whose front the eye is on: what a rasteriser that culls backs draws.
    facing: RayCaster,
    /// Their indices in the scene.
    facing_triangles: Vec<usize>,
}

/// What is under a pixel.
struct Seen<'a> {
    point: SurfacePoint<'a>,
    /// Radiance that it emits.
    emission: Vec3,
    /// Index in the scene.
    triangle: usize,
    barycentrics: Vec3,
}

impl Trees {
    /// Those of `scene` for pictures of this eye.
    pub fn new(scene: &Scene, eye: Vec3) -> Self {
        let corners = corners(scene);
        let occluders = Arc::new(RayCaster::new(&corners));
        let mut places = corners.iter().flatten();
        let first = places.next().copied().unwrap_or_default();
        let bounds = places.fold([first; 2], |[low, high], &p| [low.min(p), high.max(p)]);
        // Small things in a wide scene are sampled more closely.
        let of_scene = RAY_OFFSET * bounds[0].distance(bounds[1]);
        let offset = match scene.visibility.ray_offset {
            samples if samples > 0.0 => of_scene.min(OF_SAMPLES * samples),
            _ => of_scene,
        };
        let offset = offset.max(ray_offset(bounds, 0.0));
        Self::with(occluders, offset, scene, eye)
    }

    /// Those of the same scene for another eye.
    #[must_use]
    pub fn moved(&self, scene: &Scene, eye: Vec3) -> Self {
        Self::with(self.occluders.clone(), self.ray_offset, scene, eye)
    }

    fn with(occluders: Arc<RayCaster>, ray_offset: f32, scene: &Scene, eye: Vec3) -> Self {
        let all = corners(scene);
        let faces_eye = |[a, b, c]: [Vec3; 3]| (b - a).cross(c - a).dot(eye - a) > 0.0;
        let facing_triangles: Vec<_> = (0..all.len())
            .filter(|&index| faces_eye(all[index]))
            .collect();
        let facing: Vec<_> = facing_triangles.iter().map(|&index| all[index]).collect();
        Self {
            occluders,
            ray_offset,
            facing: RayCaster::new(&facing),
            facing_triangles,
        }
    }
}

fn corners(scene: &Scene) -> Vec<[Vec3; 3]> {
    let place = |vertex: u32| Vec3::from(scene.vertices[vertex as usize].position);
    let triangles = scene.triangles.iter();
    (triangles.map(|triangle| triangle.vertices.map(place))).collect()
}

impl<'a> Geometry<'a> {
    /// Builds the trees for `scene` as `view` sees it.
    pub fn new(scene: &'a Scene, view: View) -> Self {
        Self::of(scene, view, Trees::new(scene, view.eye).into())
    }

    /// With trees of a scene of the same triangles for the same eye.
    pub fn of(scene: &'a Scene, view: View, trees: Arc<Trees>) -> Self {
        let emits = |material: &Material| material.emission != [0.0; 3];
        Self {
            scene,
            view,
            trees,
            mipmaps: Mipmaps::new(scene),
            emits: scene.materials.iter().any(emits),
        }
    }

    /// The surface seen through a point of the image, in pixels from its upper left corner. Of textures
    /// a pixel's centre shows what all of the pixel sees, as the runtime does.
    fn seen(&self, x: f32, y: f32, filter: Filter) -> Option<Seen<'_>> {
        let direction = self.view.corner + x * self.view.right + y * self.view.down;
        let hit = self.trees.facing.closest_hit(self.view.eye, direction)?;
        let triangle = self.trees.facing_triangles[hit.triangle];
        let filter = (filter == Filter::Center).then_some(textures::Filter {
            view: &self.view,
            mipmaps: &self.mipmaps,
        });
        let eye = self.view.eye.extend(1.0);
        Some(Seen {
            point: surface_seen(self.scene, triangle, hit.barycentrics, eye, filter),
            emission: emission(self.scene, triangle, hit.barycentrics, filter),
            triangle,
            barycentrics: hit.barycentrics,
        })
    }

    /// Whether distant light from `direction` reaches `point`.
    fn visible(&self, point: &SurfacePoint, direction: Vec3) -> bool {
        faces(point, direction) && !self.trees.occluders.any_hit(self.origin(point), direction)
    }

    /// Whether light from `direction` reaches `point` from the given distance.
    fn visible_at(&self, point: &SurfacePoint, direction: Vec3, distance: f32) -> bool {
        let hit = || (self.trees.occluders).closest_hit(self.origin(point), direction);
        faces(point, direction) && hit().is_none_or(|hit| hit.distance >= distance)
    }

    /// Where rays from `point` begin.
    fn origin(&self, point: &SurfacePoint) -> Vec3 {
        point.position + point.geometric_normal * self.trees.ray_offset
    }
}

/// Whether a direction leaves the triangle that `point` lies on on its front: interpolated normals reflect light from
/// behind it, too, where the surface itself is in the way. A ray that starts above it would pass beside it near its edges.
fn faces(point: &SurfacePoint, direction: Vec3) -> bool {
    point.geometric_normal.dot(direction) > 0.0
}

/// Radiance times coverage, and coverage, of one replica of a pixel.
type Estimate = (Vec3, f32);

/// Runs `estimate(x, y, replica)` for every replica of every pixel and sums up. `row_done`
/// is called once per finished row, from any thread. What is not `wanted` any more, which is asked at
/// every pixel, stays black.
fn estimate_image(
    [width, height]: [u32; 2],
    row_done: &(dyn Fn() + Sync),
    wanted: &(dyn Fn() -> bool + Sync),
    estimate: impl Fn(u32, u32) -> [Estimate; REPLICAS as usize] + Sync,
) -> Image {
    let rows: Vec<Vec<([f32; 4], [f32; 3])>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let pixel = |x| {
                if wanted() {
                    summarise(&estimate(x, y))
                } else {
                    Default::default()
                }
            };
            let row = (0..width).map(pixel).collect();
            row_done();
            row
        })
        .collect();
    let (pixels, variance) = rows.into_iter().flatten().unzip();
    Image {
        width,
        height,
        pixels,
        variance: Some(variance),
    }
}

/// Mean and variance of the mean of independent estimates.
fn summarise(estimates: &[Estimate; REPLICAS as usize]) -> ([f32; 4], [f32; 3]) {
    let count = REPLICAS as f32;
    let mean = estimates
        .iter()
        .map(|(radiance, _)| *radiance)
        .sum::<Vec3>()
        / count;
    let coverage = estimates.iter().map(|(_, coverage)| coverage).sum::<f32>() / count;
    let squares: Vec3 = estimates
        .iter()
        .map(|(radiance, _)| (*radiance - mean).powf(2.0))
        .sum();
    (
        mean.extend(coverage).into(),
        (squares / (count * (count - 1.0))).into(),
    )
}

#[cfg(test)]
pub(crate) mod test_scene {
    use super::*;
    use relight_format::{
        BakeReport, Representation, Specular, Surface, Triangle, Vertex, VisibilityParameters,
        plain_material,
    };

    /// Triangles with flat normals and one Lambertian material.
    pub fn scene(albedo: [f32; 3], triangles: &[[Vec3; 3]]) -> Scene {
        let vertices = triangles.iter().flat_map(|[a, b, c]| {
            let normal = (*b - *a).cross(*c - *a).normalize();
            [a, b, c].map(|position| Vertex {
                position: (*position).into(),
                normal: normal.into(),
                tangent: normal.any_orthonormal_vector().extend(1.0).into(),
                uv: [0.0; 2],
            })
        });
        Scene {
            name: "test".into(),
            visibility: VisibilityParameters {
                representation: Representation::ClusteredPca,
                sample_resolution: 128,
                basis_resolution: 64,
                distance_clamp: 0.5,
                ray_offset: 1e-3,
            },
            camera: None,
            materials: vec![plain_material(
                "grey",
                Surface::DiffuseSpecular {
                    diffuse: albedo,
                    specular: Specular::None,
                },
            )],
            textures: Vec::new(),
            report: BakeReport::default(),
            vertices: vertices.collect(),
            triangles: (0..triangles.len() as u32)
                .map(|i| Triangle {
                    vertices: [3 * i, 3 * i + 1, 3 * i + 2],
                    material: 0,
                    cluster: 0,
                })
                .collect(),
            clusters: Vec::new(),
            coefficients: Vec::new(),
            basis: Vec::new(),
            second_uvs: Vec::new(),
            transfer: None,
        }
    }

    /// A horizontal square of half side 10 facing up.
    pub fn plane() -> Vec<[Vec3; 3]> {
        let at = |x: f32, z: f32| Vec3::new(x, 0.0, z) * 10.0;
        let [a, b, c, d] = [at(-1.0, -1.0), at(-1.0, 1.0), at(1.0, 1.0), at(1.0, -1.0)];
        vec![[a, b, c], [a, c, d]]
    }

    /// The plane and, at x = 0, a wall that is endless by the measure of the plane.
    pub fn plane_and_wall() -> Vec<[Vec3; 3]> {
        let at = |y: f32, z: f32| Vec3::new(0.0, y, z) * 1e4;
        let [a, b, c, d] = [at(-1.0, -1.0), at(-1.0, 1.0), at(1.0, 1.0), at(1.0, -1.0)];
        let mut triangles = plane();
        triangles.extend([[a, b, c], [a, c, d]]);
        triangles
    }

    /// Looks straight down at a small patch of the plane just right of x = 0.
    pub fn view(size: u32) -> View {
        let camera = relight_format::Camera {
            position: [0.5, 2.0, 0.0],
            target: [0.5, 0.0, 0.0],
            up: [0.0, 0.0, -1.0],
            field_of_view: relight_format::FieldOfView::Y(0.1),
        };
        View::new(&camera, size, size, 0.01)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_is_mean_and_variance_of_the_mean() {
        let estimates = std::array::from_fn(|i| (Vec3::new(i as f32, 1.0, 0.0), 0.5));
        let (mean, variance) = summarise(&estimates);
        assert_eq!(mean, [3.5, 1.0, 0.0, 0.5]);
        // Σ(i − 3.5)² = 42 over 8 · 7.
        assert_eq!(variance, [0.75, 0.0, 0.0]);
    }

    #[test]
    fn backs_are_not_seen_but_block() {
        let scene = test_scene::scene([0.5; 3], &test_scene::plane_and_wall());
        let geometry = Geometry::new(&scene, test_scene::view(4));
        let Seen {
            point, triangle, ..
        } = geometry.seen(2.0, 2.0, Filter::Box).unwrap();
        assert!(triangle < 2, "the plane's");
        assert!(point.position.distance(Vec3::new(0.5, 0.0, 0.0)) < 1e-5);
        assert!(geometry.visible(&point, Vec3::new(0.1, 1.0, 0.0)));
        assert!(!geometry.visible(&point, Vec3::new(-0.1, 0.1, 0.0)));
        let mut below = test_scene::view(4);
        below.eye.y = -2.0;
        below.corner.y = 1.0;
        assert!(
            Geometry::new(&scene, below)
                .seen(2.0, 2.0, Filter::Box)
                .is_none()
        );
    }
}
