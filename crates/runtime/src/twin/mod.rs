//! The stages of a frame on the CPU. Same bytes on any number of threads.

mod visibility_buffer;

use rayon::prelude::*;
use relight_format::Scene;
use relight_shading::shade::{self, Lighting, Reflections};
use relight_shading::ssdf::Ssdf;
use relight_shading::surface::surface_point;

pub use visibility_buffer::visibility_buffer;

use crate::frame::{check_local_lights, near_plane};
use crate::{Error, Frame, Image};

/// The linear radiance of one frame, not exposed. The scene is one that
/// [`relight_format::read_scene`] returned or [`relight_format::write_scene`] accepts.
pub fn render(scene: &Scene, frame: &Frame, width: u32, height: u32) -> Result<Image, Error> {
    if width == 0 || height == 0 {
        return Err(Error::EmptyImage { width, height });
    }
    let view = frame.view(width, height, near_plane(scene));
    let visible = visibility_buffer(scene, &view, width, height);
    let lights = frame.rotated_lights();
    let local = frame.packed_local_lights();
    check_local_lights(local.len()).map_err(Error::Frame)?;
    let lighting = Lighting {
        lights: &lights,
        local: &local,
        reflections: frame.reflections.map(|image| Reflections {
            image,
            rotation: frame.reflection_rotation(),
        }),
    };
    let shade_pixel = |(index, &id): (usize, &u32)| {
        let Some(triangle) = (id as usize).checked_sub(1) else {
            return [0.0; 4];
        };
        let [a, b, c] = scene.triangles[triangle]
            .vertices
            .map(|vertex| scene.vertices[vertex as usize].position.into());
        let (x, y) = (index as u32 % width, index as u32 / width);
        let weights = view.barycentrics([a, b, c], view.pixel_direction(x, y));
        let point = surface_point(scene, triangle, weights, view.eye);
        let field = Ssdf::interpolate(scene, triangle, weights);
        shade::shade(&point, &lighting, &field, &frame.method)
            .extend(1.0)
            .to_array()
    };
    let pixels = visible
        .par_iter()
        .enumerate()
        // Short runs of pixels: some cost a hundred times what others do.
        .with_max_len(256)
        .map(shade_pixel)
        .collect();
    Ok(Image {
        width,
        height,
        pixels,
    })
}

/// Tone-mapped sRGB RGBA8 of a linear image, row 0 first.
pub fn tonemap(image: &Image, exposure: f32) -> Vec<u8> {
    image
        .pixels
        .iter()
        .flat_map(|&pixel| relight_shading::tonemap::pixel(pixel, exposure))
        .collect()
}
