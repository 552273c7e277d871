//! The stages of a frame on the CPU. Same bytes on any number of threads.

mod visibility_buffer;

use std::cell::Cell;

use glam::Vec3;
use rayon::prelude::*;
use relight_format::Scene;
use relight_shading::occluders::Occluders;
use relight_shading::shade::{self, Lighting, Reflections};
use relight_shading::sources::Lit;
use relight_shading::ssdf::{Basis, SignedDistance, Ssdf};
use relight_shading::surface::{SurfacePoint, emission, surface_point};
use relight_shading::transfer::{Bounced, PackedTransfer};

pub use visibility_buffer::visibility_buffer;

use crate::frame::{check_local_lights, near_plane};
use crate::{Error, Frame, Image, occluders};

/// The linear radiance of one frame, not exposed. The scene is one that
/// [`relight_format::read_scene`] returned or [`relight_format::write_scene`] accepts.
pub fn render(scene: &Scene, frame: &Frame, width: u32, height: u32) -> Result<Image, Error> {
    let bounced = BouncedLight::new(scene, frame);
    let shade_pixel = |seen: &Seen, lighting: &Lighting, field: &Ssdf| {
        let direct = shade::shade(&seen.point, lighting, field, &frame.method);
        let emitted = emission(scene, seen.triangle, seen.barycentrics);
        let bounced = bounced.as_ref().map_or(Vec3::ZERO, |light| {
            light.at(scene, seen).reflected(&seen.point, field)
        });
        (direct + bounced + emitted).extend(1.0).to_array()
    };
    let pixels = map_seen(scene, frame, [width, height], shade_pixel)?;
    Ok(Image {
        width,
        height,
        pixels,
    })
}

/// Light of one frame that other surfaces reflect.
struct BouncedLight {
    packed: PackedTransfer,
    products: Vec<[f32; 4]>,
}

impl BouncedLight {
    /// `None` where the asset has none.
    fn new(scene: &Scene, frame: &Frame) -> Option<Self> {
        let packed = PackedTransfer::new(scene)?;
        let light = packed.light(&frame.bouncing_lights(), &frame.packed_local_lights());
        let products = packed.products(&light);
        Some(Self { packed, products })
    }

    fn at(&self, scene: &Scene, seen: &Seen) -> Bounced {
        let triangle = &scene.triangles[seen.triangle];
        let cluster = usize::from(triangle.cluster);
        let weights = seen.barycentrics;
        (self.packed).interpolate(&self.products, cluster, triangle.vertices, weights)
    }
}

/// What is under a pixel.
struct Seen {
    point: SurfacePoint,
    triangle: usize,
    barycentrics: Vec3,
}

/// What shading a frame takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Pixels that the scene covers.
    pub pixels: u64,
    /// Lobes integrated over what is visible of them; with `cells` groups of lobes.
    pub integrals: u64,
    /// Directions in which an SSDF was evaluated.
    pub samples: u64,
    /// Texels of four basis images that were interpolated for it.
    pub fetches: u64,
    /// Rays cast towards sources.
    pub rays: u64,
}

/// Counts what [`render`] does.
pub fn work(scene: &Scene, frame: &Frame, width: u32, height: u32) -> Result<Work, Error> {
    let counts = map_pixels(scene, frame, [width, height], |point, lighting, field| {
        let counted = Counted {
            field,
            samples: Cell::new(0),
        };
        let mut integrals = 0;
        shade::shade_counting(point, lighting, &counted, &frame.method, &mut integrals);
        let samples = counted.samples.get();
        let mut rays = 0;
        if let Some(sources) = &lighting.sources
            && point.normal.dot(point.view) > 0.0
        {
            sources.radiance(point, &mut rays);
        }
        [1, integrals, samples, samples * field.tiles() as u64, rays]
    })?;
    let sum = |index: usize| counts.iter().map(|counts| counts[index]).sum();
    Ok(Work {
        pixels: sum(0),
        integrals: sum(1),
        samples: sum(2),
        fetches: sum(3),
        rays: sum(4),
    })
}

struct Counted<'a> {
    field: &'a Ssdf<'a>,
    samples: Cell<u64>,
}

impl SignedDistance for Counted<'_> {
    fn distance(&self, direction: Vec3) -> f32 {
        self.samples.set(self.samples.get() + 1);
        self.field.distance(direction)
    }

    fn limit(&self) -> f32 {
        self.field.limit()
    }
}

/// What `shade` makes of the surface under every pixel, its light and its visibility, row by
/// row; the default where there is none.
pub fn map_pixels<T: Default + Send>(
    scene: &Scene,
    frame: &Frame,
    size: [u32; 2],
    shade: impl Fn(&SurfacePoint, &Lighting, &Ssdf) -> T + Sync,
) -> Result<Vec<T>, Error> {
    map_seen(scene, frame, size, |seen, lighting, field| {
        shade(&seen.point, lighting, field)
    })
}

fn map_seen<T: Default + Send>(
    scene: &Scene,
    frame: &Frame,
    [width, height]: [u32; 2],
    shade: impl Fn(&Seen, &Lighting, &Ssdf) -> T + Sync,
) -> Result<Vec<T>, Error> {
    if width == 0 || height == 0 {
        return Err(Error::EmptyImage { width, height });
    }
    let view = frame.view(width, height, near_plane(scene));
    let visible = visibility_buffer(scene, &view, width, height);
    let lights = frame.rotated_lights();
    let local = frame.packed_local_lights();
    check_local_lights(local.len()).map_err(Error::Frame)?;
    let sources = frame.rotated_sources();
    let occluders = match sources {
        Some(_) => occluders::build(scene),
        None => Occluders::default(),
    };
    let lighting = Lighting {
        sources: sources.as_ref().map(|sources| Lit {
            sources,
            occluders: &occluders,
            ray_offset: scene.visibility.ray_offset,
        }),
        lights: &lights,
        local: &local,
        reflections: frame.reflections.map(|image| Reflections {
            image,
            rotation: frame.reflection_rotation(),
        }),
    };
    let basis = Basis::new(scene);
    let shade_pixel = |(index, &id): (usize, &u32)| {
        let Some(triangle) = (id as usize).checked_sub(1) else {
            return T::default();
        };
        let [a, b, c] = scene.triangles[triangle]
            .vertices
            .map(|vertex| scene.vertices[vertex as usize].position.into());
        let (x, y) = (index as u32 % width, index as u32 / width);
        let weights = view.barycentrics([a, b, c], view.pixel_direction(x, y));
        let seen = Seen {
            point: surface_point(scene, triangle, weights, view.eye),
            triangle,
            barycentrics: weights,
        };
        let field = Ssdf::interpolate(scene, &basis, triangle, weights);
        shade(&seen, &lighting, &field)
    };
    Ok(visible
        .par_iter()
        .enumerate()
        // Short runs of pixels: some cost a hundred times what others do.
        .with_max_len(256)
        .map(shade_pixel)
        .collect())
}

/// Tone-mapped sRGB RGBA8 of a linear image, row 0 first.
pub fn tonemap(image: &Image, exposure: f32) -> Vec<u8> {
    image
        .pixels
        .iter()
        .flat_map(|&pixel| relight_shading::tonemap::pixel(pixel, exposure))
        .collect()
}
