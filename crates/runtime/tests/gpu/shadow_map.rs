//! Shadow maps of an app's own over what is baked.

use glam::camera::rh::proj::directx::orthographic;
use glam::camera::rh::view::look_at_mat4;
use glam::{Mat4, Quat, Vec3};
use relight_runtime::offscreen::Gpu;
use relight_runtime::{
    DepthImage, Depths, Error, Frame, Image, Instance, Placement, ShadowMap, twin, wgpu,
};
use wgpu::util::{DeviceExt as _, TextureDataOrder};

use crate::engine::prepare;
use crate::{OTHER_RAYS, Outcome, POLAR, frame, lights, relative_rmse, scenes, sources};

const SIZE: [u32; 2] = [96, 72];
/// Texels of the map per side.
const SIDE: u32 = 64;

/// Depths of stripes near to the light.
fn stripes() -> Vec<u16> {
    (0..SIDE * SIDE)
        .map(|i| {
            if (i % SIDE + i / SIDE) % 16 < 6 {
                9_000
            } else {
                u16::MAX
            }
        })
        .collect()
}

fn texture(gpu: &Gpu, depths: &[u16]) -> wgpu::TextureView {
    let texture = gpu.device.create_texture_with_data(
        &gpu.queue,
        &wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d {
                width: SIDE,
                height: SIDE,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Depth16Unorm,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        TextureDataOrder::LayerMajor,
        bytemuck::cast_slice(depths),
    );
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

/// Pixels that differ from their twin by more than rounding.
fn different(found: &Image, expected: &Image) -> usize {
    let far = |a: &[f32; 4], b: &[f32; 4]| {
        (0..3).any(|channel| (a[channel] - b[channel]).abs() > 0.01 * (1e-3 + b[channel]))
    };
    (found.pixels.iter().zip(&expected.pixels))
        .filter(|(found, expected)| far(found, expected))
        .count()
}

pub fn shadow_maps_match_twin(gpu: &mut Gpu) -> Outcome {
    let (lights, sources) = (lights(), sources());
    let mut scene = scenes::sphere_over_plane();
    scene.visibility.ray_offset = 1e-4;
    let uploaded = gpu.upload(&scene)?;
    let placements = [
        Placement::IDENTITY,
        Placement {
            rotation: Quat::from_rotation_y(0.9),
            translation: Vec3::new(0.9, 0.6, 0.3),
            scale: 0.3,
        },
    ];
    let instances = placements.map(|placement| Instance {
        scene: &uploaded,
        placement,
    });
    let placed = placements.map(|placement| twin::Placed {
        scene: &scene,
        placement,
    });
    let without = Frame {
        sources: Some(&sources),
        ..frame(&lights, POLAR)
    };
    let turned = without.rotated_sources().expect("sources");
    let toward = turned.axis(0).expect("the first of them");
    let projection = orthographic(-3.0, 3.0, -3.0, 3.0, 0.0, 10.0);
    let matrix = projection * look_at_mat4(5.0 * toward, Vec3::ZERO, Vec3::Y);
    let falling = Mat4::from_translation(Vec3::Z) * Mat4::from_scale(Vec3::new(1.0, 1.0, -1.0));
    let nearer = stripes();
    let reversed: Vec<u16> = nearer.iter().map(|depth| u16::MAX - depth).collect();
    let mut view = gpu.renderer.view(SIZE)?;
    let unshadowed = prepare(gpu, &mut view, &instances, &without)?;
    let mut pictures = Vec::new();
    for (depths, matrix, reversed, antialias) in [
        (&nearer, matrix, false, false),
        (&reversed, falling * matrix, true, false),
        (&nearer, matrix, false, true),
    ] {
        let map = |depths| ShadowMap {
            depths,
            matrix,
            source: 0,
            reversed,
            bias: 1e-3,
        };
        let texture = texture(gpu, depths);
        let with = |depths| Frame {
            shadow_map: Some(map(depths)),
            antialias,
            ..without.clone()
        };
        let found = prepare(gpu, &mut view, &instances, &with(Depths::Texture(&texture)))?;
        let floats: Vec<f32> = depths.iter().map(|&d| f32::from(d) / 65535.0).collect();
        let image = Depths::Image(DepthImage {
            width: SIDE,
            height: SIDE,
            depths: &floats,
        });
        let expected = twin::render_instances(&placed, &with(image), SIZE[0], SIZE[1])?;
        let count = different(&found, &expected);
        println!("reversed {reversed}, antialias {antialias}: {count} pixels differ");
        assert!(count as f32 <= OTHER_RAYS * (SIZE[0] * SIZE[1]) as f32);
        assert!(different(&found, &unshadowed) > 500, "no shadow");
        pictures.push(found);
        // Each has depths where it cannot read them.
        let found = prepare(gpu, &mut view, &instances, &with(image));
        assert!(matches!(found, Err(Error::ShadowMap { .. })));
        let on_gpu = with(Depths::Texture(&texture));
        let found = twin::render_instances(&placed, &on_gpu, SIZE[0], SIZE[1]);
        assert!(matches!(found, Err(Error::ShadowMap { .. })));
        // A source that there is not.
        let mut other = on_gpu.clone();
        other.shadow_map.as_mut().expect("a map").source = 7;
        if !antialias {
            assert!(prepare(gpu, &mut view, &instances, &other)? == unshadowed);
        }
        other.shadow_map.as_mut().expect("a map").bias = f32::NAN;
        let found = prepare(gpu, &mut view, &instances, &other);
        assert!(matches!(found, Err(Error::ShadowMap { .. })));
    }
    assert!(relative_rmse(&pictures[0], &pictures[1]) < 1e-2);
    // It goes, and nothing of it is left.
    assert!(prepare(gpu, &mut view, &instances, &without)? == unshadowed);
    if let Some(folder) = std::env::var_os("RELIGHT_TEST_PICTURES") {
        let folder = std::path::PathBuf::from(folder);
        for (name, image) in [("without", &unshadowed), ("with", &pictures[0])] {
            let display = twin::tonemap(image, 1.0);
            let path = folder.join(format!("shadow_map_{name}.png"));
            image::save_buffer(path, &display, SIZE[0], SIZE[1], image::ColorType::Rgba8)?;
        }
    }
    Ok(())
}
