//! Textures of materials: many, large, and far away.

use glam::{Quat, Vec3};
use relight_format::{
    Camera, FieldOfView, Material, Scene, Surface, Texture, TextureEncoding, TextureSlot,
};
use relight_runtime::offscreen::Gpu;
use relight_runtime::{
    CellsOptions, Error, Frame, Image, Method, SphericalGaussian, Viewpoint, twin, wgpu,
};
use relight_shading::textures::coarser;
use wgpu::util::{DeviceExt as _, TextureDataOrder};

use crate::{
    CELLS_RELATIVE_RMSE, FRAME_RELATIVE_RMSE, Outcome, POLAR, frame, lights, looseness,
    relative_rmse, scenes,
};

/// Sides of a pixel that the reference is averaged over.
const FINE: u32 = 8;
/// Part of the error of one point per pixel that is left, at most: .14 is measured, and 2.4 % of error.
const LEFT: f32 = 0.2;

/// Of the scene's spheres and plane, materials with base colour, roughness and normals of their own.
pub fn textured(side: u32) -> Scene {
    let mut scene = scenes::sphere_over_plane();
    scene.textures.clear();
    let slot = |texture| {
        Some(TextureSlot {
            transform: [[1.5, 0.2, 0.1], [-0.3, 2.0, 0.4]],
            ..TextureSlot::whole(texture)
        })
    };
    let material = |index: u32| Material {
        base_color_texture: slot(3 * index),
        metallic_roughness_texture: slot(3 * index + 1),
        normal_texture: slot(3 * index + 2),
        surface: Surface::MetallicRoughness {
            base_color: [0.9; 3],
            metallic: 0.5,
            roughness: 1.0,
            anisotropy_strength: 0.0,
            anisotropy_rotation: 0.0,
        },
        ..scenes::sphere_over_plane().materials[0].clone()
    };
    scene.materials = (0..5).map(material).collect();
    for index in 0..15u32 {
        let normal = index % 3 == 2;
        let texel = |i: u32| {
            let [x, y] = [i % side, i / side].map(|x| x * 64 / side);
            let wave = (17 * index + 5 * x) ^ (11 * y);
            if normal {
                [
                    118 + (wave % 20) as u8,
                    118 + (wave / 3 % 20) as u8,
                    250,
                    255,
                ]
            } else {
                [
                    wave as u8 | 0x40,
                    (3 * wave) as u8 | 0x60,
                    (7 * wave) as u8,
                    255,
                ]
            }
        };
        scene.textures.push(Texture {
            width: side,
            height: side,
            encoding: if index % 3 == 0 {
                TextureEncoding::Srgb
            } else {
                TextureEncoding::Linear
            },
            texels: (0..side * side).flat_map(texel).collect(),
        });
    }
    for (index, triangle) in scene.triangles.iter_mut().enumerate() {
        triangle.material = (index / 2 % 5) as u16;
    }
    scene
}

/// 240 MiB of them, at WebGPU's default limits.
pub fn fifteen_maps_of_2048_are_drawn(gpu: &mut Gpu) -> Outcome {
    let scene = textured(2048);
    let lights = lights();
    let frame = frame(&lights, POLAR);
    let uploaded = gpu.upload(&scene)?;
    let (width, height) = (120, 90);
    let found = gpu.render(&uploaded, &frame, width, height)?.linear;
    let expected = twin::render(&scene, &frame, width, height)?;
    let error = relative_rmse(&found, &expected);
    println!("relative RMSE {error:e}");
    assert!(error <= FRAME_RELATIVE_RMSE, "{error}");
    Ok(())
}

/// Textures by second coordinates are those by first ones where both are the same numbers, and pictures of both at
/// once, emission among them, are the twin's.
pub fn second_coordinates_are_drawn(gpu: &mut Gpu) -> Outcome {
    let first = textured(64);
    let lights = lights();
    let frame = frame(&lights, POLAR);
    let (width, height) = (60, 45);
    let uploaded = gpu.upload(&first)?;
    let expected = gpu.render(&uploaded, &frame, width, height)?.linear;
    let mut second = first.clone();
    second.second_uvs = first.vertices.iter().map(|vertex| vertex.uv).collect();
    for (index, vertex) in second.vertices.iter_mut().enumerate() {
        vertex.uv = [0.37 * index as f32, -0.61 * index as f32];
    }
    for slot in second.materials.iter_mut().flat_map(Material::slots_mut) {
        slot.second_uv = true;
    }
    let uploaded = gpu.upload(&second)?;
    let found = gpu.render(&uploaded, &frame, width, height)?.linear;
    assert!(found == expected);
    let mut both = first.clone();
    both.second_uvs = (first.vertices.iter())
        .map(|vertex| [3.0 * vertex.uv[1] + 0.2, -2.0 * vertex.uv[0]])
        .collect();
    for (index, material) in both.materials.iter_mut().enumerate() {
        material.emission = [0.2, 0.1, 0.3];
        material.emission_texture = Some(TextureSlot::whole(3 * index as u32));
        for (slot, bit) in material.slots_mut().zip(0..) {
            slot.second_uv = (0b01_1010_0110 >> (index + bit)) & 1 == 1;
        }
    }
    // Cells without thresholds: close to one, one of the two may divide a cell and the other not.
    let even = CellsOptions {
        uniform: Some([2, 8]),
        ..CellsOptions::default()
    };
    let mut without = both.clone();
    (without.materials.iter_mut().flat_map(Material::slots_mut))
        .for_each(|slot| slot.second_uv = false);
    let uploaded = gpu.upload(&both)?;
    for method in [POLAR, Method::Cells(even)] {
        let frame = Frame { method, ..frame };
        let found = gpu.render(&uploaded, &frame, width, height)?.linear;
        let error = relative_rmse(&found, &twin::render(&both, &frame, width, height)?);
        let other = relative_rmse(&found, &twin::render(&without, &frame, width, height)?);
        println!("relative RMSE {error:e}; by first coordinates alone {other}");
        assert!(error <= looseness(gpu) * CELLS_RELATIVE_RMSE, "{error}");
        assert!(other > 0.05, "{other}");
    }
    // A material may not ask for what vertices do not have.
    let uploaded = gpu.upload(&first)?;
    assert!(uploaded.set_material(0, &both.materials[1]).is_err());
    Ok(())
}

/// A checkerboard that goes far away, under light that is nearly the same from everywhere.
pub fn distant_textures_are_averaged(gpu: &mut Gpu) -> Outcome {
    let mut scene = scenes::sphere_over_plane();
    let slot = scene.materials[0].base_color_texture.as_mut();
    slot.expect("the checkerboard").transform = [[9.0, 4.0, 0.0], [-4.0, 9.0, 0.0]];
    let lights = [SphericalGaussian {
        axis: Vec3::Y,
        sharpness: 0.5,
        amplitude: Vec3::ONE,
    }];
    let camera = Camera {
        position: [0.0, 0.25, 2.2],
        target: [0.0, 0.1, 0.0],
        up: [0.0, 1.0, 0.0],
        field_of_view: FieldOfView::X(0.9),
    };
    let frame = Frame {
        camera: camera.into(),
        rotation: Quat::IDENTITY,
        ..frame(&lights, Method::Ambient)
    };
    let (width, height) = (120, 60);
    let fine = twin::render(&scene, &frame, FINE * width, FINE * height)?;
    let at = |x: u32, y: u32| fine.pixels[(y * FINE * width + x) as usize];
    let each = |pixel: &dyn Fn(u32, u32) -> [f32; 4]| Image {
        width,
        height,
        pixels: (0..width * height)
            .map(|i| pixel(i % width, i / width))
            .collect(),
    };
    let averaged = each(&|x, y| {
        let mut sum = [0.0; 4];
        for fine_y in FINE * y..FINE * (y + 1) {
            for fine_x in FINE * x..FINE * (x + 1) {
                let pixel = at(fine_x, fine_y);
                (sum.iter_mut().zip(pixel)).for_each(|(sum, value)| *sum += value);
            }
        }
        sum.map(|sum| sum / (FINE * FINE) as f32)
    });
    let points = each(&|x, y| at(FINE * x + FINE / 2, FINE * y + FINE / 2));
    let uploaded = gpu.upload(&scene)?;
    let found = gpu.render(&uploaded, &frame, width, height)?.linear;
    let expected = twin::render(&scene, &frame, width, height)?;
    let error = relative_rmse(&found, &expected);
    let [of_points, of_filter] = [&points, &expected].map(|image| relative_rmse(image, &averaged));
    println!("relative RMSE {error:e}; of points {of_points}, of the filter {of_filter}");
    if let Some(folder) = std::env::var_os("RELIGHT_TEST_PICTURES") {
        let folder = std::path::PathBuf::from(folder);
        for (name, image) in [
            ("points", &points),
            ("filtered", &found),
            ("averaged", &averaged),
        ] {
            let display = twin::tonemap(image, 1.0);
            let path = folder.join(format!("textures_{name}.png"));
            image::save_buffer(path, &display, width, height, image::ColorType::Rgba8)?;
        }
    }
    assert!(error <= FRAME_RELATIVE_RMSE, "{error}");
    assert!(of_filter <= LEFT * of_points, "{of_filter} of {of_points}");
    Ok(())
}

/// Levels of a scene's texture, as an app's own image in some format.
fn image(gpu: &Gpu, texture: &Texture, format: wgpu::TextureFormat, levels: u32) -> wgpu::Texture {
    let mut texels = Vec::new();
    let mut level = Some(texture.clone());
    for _ in 0..levels {
        let finer = level.expect("as many levels");
        texels.extend_from_slice(&finer.texels);
        level = coarser(&finer);
    }
    image_of(
        gpu,
        [texture.width, texture.height],
        format,
        levels,
        &texels,
    )
}

/// An app's own image, of such bytes.
fn image_of(
    gpu: &Gpu,
    [width, height]: [u32; 2],
    format: wgpu::TextureFormat,
    levels: u32,
    bytes: &[u8],
) -> wgpu::Texture {
    gpu.device.create_texture_with_data(
        &gpu.queue,
        &wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d {
                width,
                height,
                depth_or_array_layers: 1,
            },
            mip_level_count: levels,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        TextureDataOrder::LayerMajor,
        bytes,
    )
}

/// A scene whose textures are replaced by images looks as if it had been uploaded with them: with their levels,
/// and without.
pub fn images_take_the_place_of_textures(gpu: &mut Gpu) -> Outcome {
    let side = 64;
    let scene = textured(side);
    let mut other = scene.clone();
    other.textures.rotate_left(3);
    for texture in &mut other.textures {
        texture.texels.iter_mut().for_each(|byte| *byte ^= 0x15);
    }
    let lights = lights();
    let mut frame = frame(&lights, POLAR);
    // Far enough away for levels.
    if let Viewpoint::Pinhole(camera) = &mut frame.camera {
        camera.position = camera.position.map(|x| 2.0 * x);
    }
    let (width, height) = (120, 90);
    let uploaded = gpu.upload(&other)?;
    let expected = gpu.render(&uploaded, &frame, width, height)?.linear;
    let uploaded = gpu.upload(&scene)?;
    let before = gpu.render(&uploaded, &frame, width, height)?.linear;
    assert!(relative_rmse(&before, &expected) > 0.05);
    let levels = side.ilog2() + 1;
    for (levels, most) in [(levels, 1e-3), (1, 2e-2)] {
        let uploaded = gpu.upload(&scene)?;
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for (index, texture) in other.textures.iter().enumerate() {
            let format = match texture.encoding {
                TextureEncoding::Srgb => wgpu::TextureFormat::Rgba8UnormSrgb,
                _ => wgpu::TextureFormat::Rgba8Unorm,
            };
            let view = image(gpu, texture, format, levels)
                .create_view(&wgpu::TextureViewDescriptor::default());
            (gpu.renderer).set_texture(&mut encoder, &uploaded, index, &view)?;
        }
        gpu.queue.submit([encoder.finish()]);
        let found = gpu.render(&uploaded, &frame, width, height)?.linear;
        let error = relative_rmse(&found, &expected);
        println!("{levels} levels: relative RMSE {error:e}");
        assert!(error <= most, "{levels} levels: {error}");
    }
    if (gpu.device.features()).contains(wgpu::Features::TEXTURE_COMPRESSION_BC) {
        let error = compressed_image(gpu, &scene, &frame)?;
        println!("BC1: relative RMSE {error:e}");
        assert!(error <= 2e-2, "BC1: {error}");
    } else {
        println!("this device has no BC");
    }
    // A view without the finest level shows what an image of the others does.
    let linear = wgpu::TextureFormat::Rgba8Unorm;
    let mut pictures = Vec::new();
    for left_out in [0, 1] {
        let mut texture = scene.textures[1].clone();
        if left_out == 1 {
            texture = coarser(&texture).ok_or("another level")?;
        }
        let of_coarser = wgpu::TextureViewDescriptor {
            base_mip_level: 1 - left_out,
            ..Default::default()
        };
        let view = image(gpu, &texture, linear, levels - left_out).create_view(&of_coarser);
        let uploaded = gpu.upload(&scene)?;
        let descriptor = wgpu::CommandEncoderDescriptor::default();
        let mut encoder = gpu.device.create_command_encoder(&descriptor);
        (gpu.renderer).set_texture(&mut encoder, &uploaded, 1, &view)?;
        gpu.queue.submit([encoder.finish()]);
        pictures.push(gpu.render(&uploaded, &frame, width, height)?.linear);
    }
    assert!(relative_rmse(&pictures[0], &before) > 1e-4);
    assert!(pictures[0] == pictures[1]);
    // What cannot be sampled, and what is not there.
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let numbers = image(gpu, &scene.textures[0], wgpu::TextureFormat::R32Uint, 1);
    let view = numbers.create_view(&wgpu::TextureViewDescriptor::default());
    let found = (gpu.renderer).set_texture(&mut encoder, &uploaded, 0, &view);
    assert!(matches!(found, Err(Error::Image { .. })), "{found:?}");
    let found = (gpu.renderer).set_texture(&mut encoder, &uploaded, 15, &view);
    assert!(
        matches!(found, Err(Error::NoSuchTexture { .. })),
        "{found:?}"
    );
    Ok(())
}

/// How far off a picture is with a texture of BC1, of blocks of one colour each, from that with the same colours.
fn compressed_image(gpu: &mut Gpu, scene: &Scene, frame: &Frame) -> Result<f32, Error> {
    let side = scene.textures[0].width;
    let blocks = side / 4;
    let color = |block: u32| (2_654_435_769u32.wrapping_mul(block + 1) >> 16) as u16;
    let data: Vec<u8> = (0..blocks * blocks)
        .flat_map(|block| [color(block), color(block), 0, 0].map(u16::to_le_bytes))
        .flatten()
        .collect();
    let mut plain = scene.clone();
    plain.textures[0].texels = (0..side * side)
        .flat_map(|texel| {
            let color = u32::from(color(texel / side / 4 * blocks + texel % side / 4));
            let wide = |bits: u32, most: u32| ((bits & most) * 255 / most) as u8;
            [
                wide(color >> 11, 31),
                wide(color >> 5, 63),
                wide(color, 31),
                255,
            ]
        })
        .collect();
    let format = wgpu::TextureFormat::Bc1RgbaUnormSrgb;
    let image = image_of(gpu, [side; 2], format, 1, &data);
    let uploaded = gpu.upload(scene)?;
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let view = image.create_view(&wgpu::TextureViewDescriptor::default());
    (gpu.renderer).set_texture(&mut encoder, &uploaded, 0, &view)?;
    gpu.queue.submit([encoder.finish()]);
    let found = gpu.render(&uploaded, frame, 120, 90)?.linear;
    let uploaded = gpu.upload(&plain)?;
    let expected = gpu.render(&uploaded, frame, 120, 90)?.linear;
    Ok(relative_rmse(&found, &expected))
}
