//! The renderer as an engine uses it: in the app's own passes, with the app's cameras.

use glam::camera::rh::proj::directx as project;
use glam::camera::rh::view::look_at_mat4;
use glam::{Mat4, Quat, Vec3};
use relight_format::Scene;
use relight_runtime::offscreen::Gpu;
use relight_runtime::{
    Background, Before, Error, Frame, Image, Instance, Method, Options, Output, Placement,
    Renderer, View, Viewpoint, twin, wgpu,
};
use relight_shading::camera::View as Projection;
use relight_shading::gpu::MAX_BATCH;

use crate::support::attachment;
use crate::{
    DIFFERENT_PIXELS, DISPLAY_CODES, FRAME_RELATIVE_RMSE, OTHER_RAYS, Outcome, POLAR, frame,
    lights, looseness, relative_rmse, render, scenes, sources, stripes, target, with_options,
};

const SIZE: [u32; 2] = [160, 120];
/// What an app keeps beside: a depth that does not depend on wherever the scene's box is.
const NEAR_PLANE: f32 = 0.05;

fn look() -> Mat4 {
    let camera = scenes::camera();
    look_at_mat4(
        camera.position.into(),
        camera.target.into(),
        camera.up.into(),
    )
}

/// Depth from 1 in front to 0 behind.
fn reversed(projection: Mat4) -> Mat4 {
    let flip = Mat4::from_translation(Vec3::Z) * Mat4::from_scale(Vec3::new(1.0, 1.0, -1.0));
    flip * projection
}

pub fn matrices(projection: Mat4) -> Viewpoint {
    Viewpoint::Matrices {
        view: look(),
        projection,
    }
}

fn aspect() -> f32 {
    SIZE[0] as f32 / SIZE[1] as f32
}

/// Pixels that one of two pictures covers.
fn coverage_difference(a: &Image, b: &Image) -> f32 {
    let pairs = a.pixels.iter().zip(&b.pixels);
    pairs.filter(|(a, b)| a[3] != b[3]).count() as f32 / a.pixels.len() as f32
}

fn compare(name: &str, found: &Image, expected: &Image) {
    let covered = expected
        .pixels
        .iter()
        .filter(|pixel| pixel[3] == 1.0)
        .count();
    let (error, coverage) = (
        relative_rmse(found, expected),
        coverage_difference(found, expected),
    );
    println!("{name}: {covered} pixels, relative RMSE {error:e}, coverage {coverage:e}");
    assert!(covered > 500, "{name}: a nearly empty picture");
    assert!(
        error <= FRAME_RELATIVE_RMSE,
        "{name}: relative RMSE {error}"
    );
    assert!(coverage <= DIFFERENT_PIXELS, "{name}: coverage {coverage}");
}

/// Every kind of camera, by name.
pub fn projections() -> [(&'static str, Mat4); 9] {
    let perspective = project::perspective(0.6, aspect(), NEAR_PLANE, 50.0);
    let jitter = Mat4::from_translation(Vec3::new(0.7 / 160.0, -0.4 / 120.0, 0.0));
    let mirror = Mat4::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    let orthographic = project::orthographic(-1.6, 1.6, -1.2, 1.2, NEAR_PLANE, 50.0);
    [
        ("perspective", perspective),
        ("reversed", reversed(perspective)),
        (
            "infinite",
            project::perspective_infinite(0.6, aspect(), NEAR_PLANE),
        ),
        (
            "infinite, reversed",
            project::perspective_infinite_reverse(0.6, aspect(), NEAR_PLANE),
        ),
        (
            "off-centre",
            project::frustum(-0.02, 0.01, -0.005, 0.015, NEAR_PLANE, 50.0),
        ),
        ("jittered", jitter * perspective),
        ("mirrored", mirror * perspective),
        ("orthographic", orthographic),
        ("orthographic, reversed", reversed(orthographic)),
    ]
}

pub fn matrices_match_twin(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let scene = scenes::sphere_over_plane();
    for (name, projection) in projections() {
        let frame = Frame {
            camera: matrices(projection),
            ..frame(&lights, POLAR)
        };
        let found = render(gpu, &frame, SIZE[0], SIZE[1])?.linear;
        let expected = twin::render(&scene, &frame, SIZE[0], SIZE[1])?;
        compare(name, &found, &expected);
    }
    Ok(())
}

/// A pinhole and its matrices are one camera; so is a mirror's picture, mirrored.
pub fn cameras_agree(_: &mut Gpu) -> Outcome {
    let lights = lights();
    let scene = scenes::sphere_over_plane();
    let draw = |camera| {
        let frame = Frame {
            camera,
            ..frame(&lights, Method::Ambient)
        };
        twin::render(&scene, &frame, SIZE[0], SIZE[1])
    };
    let pinhole = draw(Viewpoint::Pinhole(scenes::camera()))?;
    let camera = Projection::new(&scenes::camera(), SIZE[0], SIZE[1], NEAR_PLANE);
    let view = Mat4::IDENTITY;
    let projection = camera.view_projection;
    let found = draw(Viewpoint::Matrices { view, projection })?;
    compare("pinhole's matrix", &found, &pinhole);
    let projection = Mat4::from_scale(Vec3::new(-1.0, 1.0, 1.0)) * projection;
    let mut mirrored = draw(Viewpoint::Matrices { view, projection })?;
    for row in mirrored.pixels.chunks_mut(SIZE[0] as usize) {
        row.reverse();
    }
    // Columns on an edge fall to the other side.
    let error = relative_rmse(&mirrored, &pinhole);
    assert!(
        error <= FRAME_RELATIVE_RMSE,
        "mirrored: relative RMSE {error}"
    );
    Ok(())
}

/// Three placements, of which one is hidden in part by another.
fn placements() -> [Placement; 3] {
    [
        Placement::IDENTITY,
        Placement {
            rotation: Quat::from_rotation_y(0.9) * Quat::from_rotation_x(0.5),
            translation: Vec3::new(0.9, 0.4, 0.3),
            scale: 0.4,
        },
        Placement {
            rotation: Quat::from_rotation_z(-0.7),
            translation: Vec3::new(-0.8, 0.9, -0.4),
            scale: 0.5,
        },
    ]
}

fn radiance(gpu: &Gpu, view: &View) -> Result<Image, Error> {
    let [width, height] = view.size();
    Ok(Image {
        width,
        height,
        pixels: gpu.read_radiance(view)?,
    })
}

/// The radiance of a frame.
pub fn prepare(
    gpu: &Gpu,
    view: &mut View,
    instances: &[Instance],
    frame: &Frame,
) -> Result<Image, Error> {
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    gpu.renderer.prepare(&mut encoder, view, instances, frame)?;
    gpu.queue.submit([encoder.finish()]);
    radiance(gpu, view)
}

pub fn instances_match_twin(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let scenes = [scenes::sphere_over_plane(), scenes::noise(7)];
    let uploaded = [gpu.upload(&scenes[0])?, gpu.upload(&scenes[1])?];
    let which = [0, 1, 0];
    let lamp = relight_runtime::LocalLight {
        position: Vec3::new(0.4, 1.4, 0.9),
        radius: 0.1,
        radiance: Vec3::new(60.0, 50.0, 20.0),
        spot: None,
    };
    let instances: Vec<Instance> = (placements().into_iter().zip(which))
        .map(|(placement, which)| Instance {
            scene: &uploaded[which],
            placement,
        })
        .collect();
    let placed: Vec<twin::Placed> = (placements().into_iter().zip(which))
        .map(|(placement, which)| twin::Placed {
            scene: &scenes[which],
            placement,
        })
        .collect();
    let mut view = gpu.renderer.view(SIZE)?;
    for (name, camera) in [
        ("pinhole", Viewpoint::Pinhole(scenes::camera())),
        (
            "orthographic",
            matrices(project::orthographic(
                -1.6, 1.6, -1.2, 1.2, NEAR_PLANE, 50.0,
            )),
        ),
    ] {
        let frame = Frame {
            camera,
            local_lights: std::slice::from_ref(&lamp),
            ..frame(&lights, POLAR)
        };
        let found = prepare(gpu, &mut view, &instances, &frame)?;
        let expected = twin::render_instances(&placed, &frame, SIZE[0], SIZE[1])?;
        compare(name, &found, &expected);
        let alone = prepare(gpu, &mut view, &instances[..1], &frame)?;
        assert!(
            relative_rmse(&alone, &expected) > 0.05,
            "{name}: the others are not seen"
        );
        // The one that is left shows what it did before, where the others were not.
        let again = prepare(gpu, &mut view, &instances, &frame)?;
        assert!(again == found);
    }
    Ok(())
}

/// Instances of one scene are shaded together, each under its own light, until one of them turns or there are
/// more than fit.
pub fn batches_match_twin(gpu: &mut Gpu) -> Outcome {
    let (lights, sources, image) = (lights(), sources(), stripes());
    let mut scene = scenes::sphere_over_plane();
    scene.visibility.ray_offset = 1e-4;
    let uploaded = gpu.upload(&scene)?;
    let lamp = relight_runtime::LocalLight {
        position: Vec3::new(0.4, 1.4, 0.9),
        radius: 0.1,
        radiance: Vec3::new(60.0, 50.0, 20.0),
        spot: None,
    };
    let frame = Frame {
        local_lights: std::slice::from_ref(&lamp),
        sources: Some(&sources),
        reflections: Some(&image),
        ..frame(&lights, POLAR)
    };
    let placed = |turn: f32, translation, scale| Placement {
        rotation: Quat::from_rotation_y(turn) * Quat::from_rotation_x(0.3 * turn),
        translation,
        scale,
    };
    // The third is behind the camera.
    let few = [
        Placement::IDENTITY,
        placed(0.9, Vec3::new(0.9, 0.4, 0.3), 0.4),
        placed(0.2, Vec3::new(0.0, 0.0, 500.0), 0.4),
        placed(2.1, Vec3::new(-0.8, 0.9, -0.4), 0.3),
    ];
    let mut turned = few;
    turned[1].rotation = Quat::from_rotation_y(1.4);
    let many: Vec<Placement> = (0..MAX_BATCH as usize + 9)
        .map(|i| {
            let cell = Vec3::new((i % 12) as f32 - 5.5, 0.0, (i / 12) as f32 - 5.5);
            placed(0.1 * i as f32, 0.32 * cell, 0.07)
        })
        .collect();
    let size = [96, 72];
    let mut view = gpu.renderer.view(size)?;
    for (name, placements) in [("few", &few[..]), ("one turned", &turned), ("many", &many)] {
        let instances: Vec<Instance> = (placements.iter())
            .map(|&placement| Instance {
                scene: &uploaded,
                placement,
            })
            .collect();
        let placed: Vec<twin::Placed> = (placements.iter())
            .map(|&placement| twin::Placed {
                scene: &scene,
                placement,
            })
            .collect();
        let found = prepare(gpu, &mut view, &instances, &frame)?;
        let expected = twin::render_instances(&placed, &frame, size[0], size[1])?;
        let pairs = found.pixels.iter().zip(&expected.pixels);
        let far = |(a, b): &(&[f32; 4], &[f32; 4])| {
            (0..4).any(|channel| (a[channel] - b[channel]).abs() > 1e-3 * (0.1 + b[channel]))
        };
        let different = pairs.filter(far).count();
        let covered = expected.pixels.iter().filter(|pixel| pixel[3] == 1.0);
        let covered = covered.count();
        println!("{name}: {different} of {covered} pixels differ");
        assert!(covered > 900, "{name}: {covered} pixels");
        // Where rounding sends a ray to the other side of an edge.
        assert!(
            different as f32 <= OTHER_RAYS * covered as f32,
            "{name}: {different}"
        );
    }
    // Out of sight and back.
    let instance = |placement| Instance {
        scene: &uploaded,
        placement,
    };
    let few = few.map(instance);
    let before = prepare(gpu, &mut view, &few, &frame)?;
    let nothing = prepare(gpu, &mut view, &few[2..3], &frame)?;
    assert!(nothing.pixels.iter().all(|pixel| pixel[3] == 0.0));
    assert!(prepare(gpu, &mut view, &few, &frame)? == before);
    Ok(())
}

/// Pixels in which a sample may show another surface, as a fraction: of those that show several,
/// where samples are tested in differently rounded arithmetic.
const DIFFERENT_SAMPLES: f32 = 1e-3;

/// Root mean square difference of all pixels, over the mean of `b`.
fn picture_rmse(a: &Image, b: &Image) -> f32 {
    let (mut square, mut sum) = (0.0, 0.0);
    for (a, b) in a.pixels.iter().zip(&b.pixels) {
        for channel in 0..4 {
            square += (a[channel] - b[channel]).powi(2);
            sum += b[channel];
        }
    }
    (square * 4.0 * b.pixels.len() as f32).sqrt() / sum
}

pub fn antialiasing_matches_twin(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let scenes = [scenes::sphere_over_plane(), scenes::noise(7)];
    let uploaded = [gpu.upload(&scenes[0])?, gpu.upload(&scenes[1])?];
    let [first, second, third] = placements();
    let placements = [(0, first), (1, second), (0, third)];
    let instances = placements.map(|(which, placement)| Instance {
        scene: &uploaded[which],
        placement,
    });
    let placed = placements.map(|(which, placement)| twin::Placed {
        scene: &scenes[which],
        placement,
    });
    // No whole number of tiles.
    for size in [[160, 120], [93, 61]] {
        let aspect = size[0] as f32 / size[1] as f32;
        for (name, camera) in [
            ("pinhole", Viewpoint::Pinhole(scenes::camera())),
            (
                "perspective",
                matrices(project::perspective(0.6, aspect, NEAR_PLANE, 50.0)),
            ),
            (
                "orthographic",
                matrices(project::orthographic(
                    -1.6, 1.6, -1.2, 1.2, NEAR_PLANE, 50.0,
                )),
            ),
        ] {
            let frame = Frame {
                camera,
                antialias: true,
                ..frame(&lights, POLAR)
            };
            let mut view = gpu.renderer.view(size)?;
            let mut encoder = gpu
                .device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            gpu.renderer
                .prepare(&mut encoder, &mut view, &instances, &frame)?;
            gpu.queue.submit([encoder.finish()]);
            let found = Image {
                width: size[0],
                height: size[1],
                pixels: gpu.read_radiance(&view)?,
            };
            let expected = twin::render_instances(&placed, &frame, size[0], size[1])?;
            let partly = expected
                .pixels
                .iter()
                .filter(|pixel| pixel[3] > 0.0 && pixel[3] < 1.0);
            let partly = partly.count();
            let differs = |(a, b): &(&[f32; 4], &[f32; 4])| {
                a.iter()
                    .zip(*b)
                    .any(|(a, b)| (a - b).abs() > 1e-3 * b.abs().max(0.1))
            };
            let pairs = found.pixels.iter().zip(&expected.pixels);
            let different = pairs.filter(differs).count();
            println!("{name}: {different} pixels differ, {partly} show background in part");
            assert!(partly > 50, "{name}: {partly} pixels");
            if gpu.is_software() {
                assert!(different as f32 <= DIFFERENT_SAMPLES * found.pixels.len() as f32);
            } else {
                // A card's weights and its edges, which it rounds to 256ths of a pixel, are seen in more of them.
                let error = relative_rmse(&found, &expected);
                println!("{name}: relative RMSE {error:e}");
                assert!(error <= looseness(gpu) * FRAME_RELATIVE_RMSE, "{error}");
            }
        }
    }
    Ok(())
}

/// Of pictures that the mean of as many as [`MANY`] squared samples per pixel is taken as the truth of.
const MANY: u32 = 6;

/// The mean of many pixels for each.
fn mean_of_many(scene: &Scene, frame: &Frame) -> Result<Image, Error> {
    let large = twin::render(scene, frame, MANY * SIZE[0], MANY * SIZE[1])?;
    let mean = |index: u32| {
        let (x, y) = (index % SIZE[0] * MANY, index / SIZE[0] * MANY);
        let mut sum = glam::Vec4::ZERO;
        for (dx, dy) in (0..MANY).flat_map(|dy| (0..MANY).map(move |dx| (dx, dy))) {
            sum += glam::Vec4::from(large.pixels[((y + dy) * large.width + x + dx) as usize]);
        }
        (sum / (MANY * MANY) as f32).to_array()
    };
    Ok(Image {
        width: SIZE[0],
        height: SIZE[1],
        pixels: (0..SIZE[0] * SIZE[1]).map(mean).collect(),
    })
}

/// A small sun's light is that of whole pixels, on either side of every edge of a shadow.
pub fn edges_of_shadows_have_no_stairs(_: &mut Gpu) -> Outcome {
    let sources = sources();
    let mut scene = scenes::sphere_over_plane();
    scene.visibility.ray_offset = 1e-4;
    for material in &mut scene.materials {
        material.base_color_texture = None;
        material.normal_texture = None;
        material.metallic_roughness_texture = None;
        material.anisotropy_texture = None;
    }
    let plain = Frame {
        sources: Some(&sources),
        ..frame(&[], Method::Ambient)
    };
    let smooth = Frame {
        antialias: true,
        ..plain.clone()
    };
    let truth = mean_of_many(&scene, &plain)?;
    let [one, four] = [&plain, &smooth].map(|frame| twin::render(&scene, frame, SIZE[0], SIZE[1]));
    let (one, four) = (one?, four?);
    // Silhouettes apart.
    let (mut errors, mut edges) = ([0.0; 2], 0);
    for ((truth, one), four) in truth.pixels.iter().zip(&one.pixels).zip(&four.pixels) {
        if truth[3] == 1.0 && four[3] == 1.0 && (one[1] - four[1]).abs() > 0.1 * truth[1] {
            edges += 1;
            errors[0] += (one[1] - truth[1]).powi(2);
            errors[1] += (four[1] - truth[1]).powi(2);
        }
    }
    println!("{edges} pixels of edges, square errors of points and squares: {errors:?}");
    assert!(edges > 50, "{edges}");
    assert!(errors[1] < 0.25 * errors[0], "{errors:?}");
    Ok(())
}

/// Four samples are closer to many than one is, and cost little more.
pub fn antialiasing_is_closer_to_the_truth(_: &mut Gpu) -> Outcome {
    let lights = lights();
    let scene = scenes::sphere_over_plane();
    let plain = frame(&lights, Method::Ambient);
    let smooth = Frame {
        antialias: true,
        ..plain.clone()
    };
    let truth = mean_of_many(&scene, &plain)?;
    let [one, four] = [&plain, &smooth].map(|frame| twin::render(&scene, frame, SIZE[0], SIZE[1]));
    let errors = [one?, four?].map(|image| picture_rmse(&image, &truth));
    println!(
        "relative RMSE of one sample and four against {}: {errors:?}",
        MANY * MANY
    );
    assert!(errors[1] < 0.6 * errors[0], "{errors:?}");
    Ok(())
}

/// What is composited is what the linear picture says, blended over what was there.
pub fn antialiased_edges_blend(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let frame = Frame {
        camera: matrices(project::perspective(0.6, aspect(), NEAR_PLANE, 50.0)),
        antialias: true,
        ..frame(&lights, Method::Ambient)
    };
    let scene = scenes::sphere_over_plane();
    // Behind everything, so that what is not covered is blue.
    let hidden = Quad {
        corners: [Vec3::splat(900.0); 4],
        color: [0.0; 4],
    };
    let mut pictures = Vec::new();
    let mut linear = None;
    for samples in [1, 4] {
        let options = Options {
            target_format: wgpu::TextureFormat::Rgba16Float,
            depth_stencil: Some(wgpu::DepthStencilState {
                format: wgpu::TextureFormat::Depth32Float,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Less),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState {
                count: samples,
                ..Default::default()
            },
            ..Options::default()
        };
        let matrix = project::perspective(0.6, aspect(), NEAR_PLANE, 50.0) * look();
        let picture = with_options(gpu, options, |gpu| {
            let uploaded = gpu.upload(&scene)?;
            let mut view = gpu.renderer.view(SIZE)?;
            let mut encoder = gpu
                .device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            let instances = [Instance::from(&uploaded)];
            gpu.renderer
                .prepare(&mut encoder, &mut view, &instances, &frame)?;
            gpu.queue.submit([encoder.finish()]);
            linear = Some(gpu.read_radiance(&view)?);
            Ok(draw_in_a_pass(
                gpu,
                &view,
                matrix,
                false,
                [&hidden, &hidden],
            )?)
        })?;
        pictures.push(picture);
    }
    let linear = linear.expect("two pictures");
    let mut partly = 0;
    for (index, pixel) in linear.iter().enumerate() {
        let blue = (1.0 - pixel[3]) + pixel[2] * frame.exposure;
        partly += usize::from(pixel[3] > 0.0 && pixel[3] < 1.0);
        for picture in &pictures {
            let half = u16::from_le_bytes([picture[8 * index + 4], picture[8 * index + 5]]);
            let found = half_to_f32(half);
            // Half floats have eleven bits, and four samples are added in them.
            assert!(
                (found - blue).abs() <= 4e-3 * blue.max(0.1),
                "pixel {index}: {found}, not {blue}"
            );
        }
    }
    assert!(partly > 100, "{partly} pixels");
    Ok(())
}

/// Of normal numbers and zero.
fn half_to_f32(half: u16) -> f32 {
    let (exponent, mantissa) = (i32::from(half >> 10 & 31), f32::from(half & 1023));
    match exponent {
        0 => mantissa * 2f32.powi(-24),
        _ => (1.0 + mantissa / 1024.0) * 2f32.powi(exponent - 15),
    }
}

/// Camera, light and scene turned alike: the same picture.
pub fn turning_the_world_changes_nothing(_: &mut Gpu) -> Outcome {
    let lights = lights();
    let scene = scenes::sphere_over_plane();
    let plain = frame(&lights, POLAR);
    let expected = twin::render(&scene, &plain, SIZE[0], SIZE[1])?;
    let placement = Placement {
        rotation: Quat::from_rotation_x(0.8) * Quat::from_rotation_z(1.1),
        translation: Vec3::new(3.0, -2.0, 1.0),
        scale: 2.5,
    };
    let pinhole = Projection::new(&scenes::camera(), SIZE[0], SIZE[1], NEAR_PLANE);
    let turned = Frame {
        camera: Viewpoint::Matrices {
            view: placement.matrix().inverse(),
            projection: pinhole.view_projection,
        },
        rotation: placement.rotation * plain.rotation,
        ..plain
    };
    let placed = twin::Placed {
        scene: &scene,
        placement,
    };
    let found = twin::render_instances(&[placed], &turned, SIZE[0], SIZE[1])?;
    compare("turned", &found, &expected);
    Ok(())
}

/// What an app draws beside the scene: a quad.
const APP: &str = "
struct Quad { matrix: mat4x4<f32>, corners: array<vec4<f32>, 4>, color: vec4<f32> }
@group(0) @binding(0) var<uniform> quad: Quad;
@vertex fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return quad.matrix * quad.corners[index];
}
@fragment fn paint() -> @location(0) vec4<f32> { return quad.color; }
";

struct Quad {
    corners: [Vec3; 4],
    color: [f32; 4],
}

fn app_pipeline(device: &wgpu::Device, options: &Options) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("app"),
        source: wgpu::ShaderSource::Wgsl(APP.into()),
    });
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("app"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("corner"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("paint"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(options.target_format.into())],
        }),
        primitive: wgpu::PrimitiveState {
            topology: wgpu::PrimitiveTopology::TriangleStrip,
            ..Default::default()
        },
        depth_stencil: options.depth_stencil.clone(),
        multisample: options.multisample,
        multiview_mask: None,
        cache: None,
    })
}

fn app_group(
    device: &wgpu::Device,
    pipeline: &wgpu::RenderPipeline,
    matrix: Mat4,
    quad: &Quad,
) -> wgpu::BindGroup {
    use wgpu::util::DeviceExt as _;
    let mut values: Vec<f32> = matrix.to_cols_array().to_vec();
    for corner in quad.corners {
        values.extend(corner.extend(1.0).to_array());
    }
    values.extend(quad.color);
    let buffer = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: None,
        contents: bytemuck::cast_slice(&values),
        usage: wgpu::BufferUsages::UNIFORM,
    });
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[wgpu::BindGroupEntry {
            binding: 0,
            resource: buffer.as_entire_binding(),
        }],
    })
}

/// Draws quads of the app's, then the scene, then another quad, in one pass; returns the picture.
fn draw_in_a_pass(
    gpu: &Gpu,
    view: &View,
    matrix: Mat4,
    reversed: bool,
    quads: [&Quad; 2],
) -> Result<Vec<u8>, Error> {
    let options = gpu.renderer.options();
    let samples = options.multisample.count;
    let pipeline = app_pipeline(&gpu.device, options);
    let groups = quads.map(|quad| app_group(&gpu.device, &pipeline, matrix, quad));
    let drawn =
        |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
    let color = attachment(&gpu.device, SIZE, options.target_format, 1);
    let resolved = drawn(&color);
    let many = drawn(&attachment(
        &gpu.device,
        SIZE,
        options.target_format,
        samples,
    ));
    let format = options.depth_stencil.as_ref().expect("with depth").format;
    let depth = drawn(&attachment(&gpu.device, SIZE, format, samples));
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("app"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: if samples == 1 { &resolved } else { &many },
                depth_slice: None,
                resolve_target: (samples > 1).then_some(&resolved),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLUE),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(if reversed { 0.0 } else { 1.0 }),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &groups[0], &[]);
        pass.draw(0..4, 0..1);
        gpu.renderer.composite(view, &mut pass)?;
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &groups[1], &[]);
        pass.draw(0..4, 0..1);
    }
    gpu.queue.submit([encoder.finish()]);
    gpu.read_texture(&color)
}

/// Distance along a ray, in its direction's lengths, to a plane through three points.
fn distance(ray: &relight_shading::camera::Ray, [a, b, c]: [Vec3; 3]) -> f32 {
    let normal = (b - a).cross(c - a);
    (a - ray.origin).dot(normal) / ray.direction.dot(normal)
}

/// Least difference of distances, as a part of them, of pixels that are compared: closer, samples
/// of one pixel may see either.
const DEPTH_GAP: f32 = 0.02;

#[allow(clippy::too_many_lines, reason = "one pixel's objects after the other")]
pub fn scenes_stand_among_the_apps_objects(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let scene = scenes::sphere_over_plane();
    // One upright through the middle of the sphere, drawn before; one that leans into it, after.
    let upright = Quad {
        corners: [[-0.9, -0.5], [0.2, -0.5], [-0.9, 1.6], [0.2, 1.6]]
            .map(|[x, y]| Vec3::new(x, y, 0.05)),
        color: [0.0, 1.0, 0.0, 1.0],
    };
    let leaning = Quad {
        corners: [[-0.1, 0.0], [1.0, 0.0], [-0.1, 1.4], [1.0, 1.4]]
            .map(|[x, y]| Vec3::new(x, y + 0.1, 0.9 - y)),
        color: [1.0, 0.0, 0.0, 1.0],
    };
    let perspective = project::perspective(0.6, aspect(), NEAR_PLANE, 50.0);
    for (projection, reversed) in [
        (perspective, false),
        (
            project::perspective_infinite_reverse(0.6, aspect(), NEAR_PLANE),
            true,
        ),
        (
            project::orthographic(-1.6, 1.6, -1.2, 1.2, NEAR_PLANE, 50.0),
            false,
        ),
    ] {
        for samples in [1, 4] {
            let options = Options {
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: wgpu::TextureFormat::Depth32Float,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(if reversed {
                        wgpu::CompareFunction::Greater
                    } else {
                        wgpu::CompareFunction::Less
                    }),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState {
                    count: samples,
                    ..Default::default()
                },
                ..Options::default()
            };
            // Where the app draws nothing there is its own picture, or what is behind the scene.
            let color = Vec3::new(0.3, 0.1, 0.05);
            let (background, sky) = if reversed {
                let pixel = color.extend(1.0).to_array();
                let [r, g, b, _] = relight_shading::tonemap::pixel(pixel, 0.8);
                (Background::Color(color), [r, g, b])
            } else {
                (Background::Transparent, [0, 0, 255])
            };
            let frame = Frame {
                camera: matrices(projection),
                background,
                exposure: 0.8,
                ..frame(&lights, Method::Ambient)
            };
            let matrix = projection * look();
            let (picture, alone) = with_options(gpu, options, |gpu| {
                let uploaded = gpu.upload(&scene)?;
                let mut view = gpu.renderer.view(SIZE)?;
                let linear = prepare(gpu, &mut view, &[(&uploaded).into()], &frame)?;
                let quads = [&upright, &leaning];
                Ok((draw_in_a_pass(gpu, &view, matrix, reversed, quads)?, linear))
            })?;
            let camera = Projection::from_matrix(matrix, SIZE[0], SIZE[1]).expect("regular");
            let ids = twin::visibility_buffer(&scene, &camera, SIZE[0], SIZE[1]);
            let shown = twin::tonemap(&alone, frame.exposure);
            let mut counts = [0; 4];
            for (index, &id) in ids.iter().enumerate() {
                let (x, y) = (index as u32 % SIZE[0], index as u32 / SIZE[0]);
                let ray = camera.pixel_ray(x, y);
                let mut hits = vec![(f32::INFINITY, 0, sky)];
                if id > 0 {
                    let corners = scene.triangles[id as usize - 1]
                        .vertices
                        .map(|vertex| scene.vertices[vertex as usize].position.into());
                    let pixel = &shown[4 * index..][..3];
                    hits.push((distance(&ray, corners), 1, [pixel[0], pixel[1], pixel[2]]));
                }
                for (quad, (number, color)) in [&upright, &leaning]
                    .into_iter()
                    .zip([(2, [0, 255, 0]), (3, [255, 0, 0])])
                {
                    let [a, b, c, _] = quad.corners;
                    let at = distance(&ray, [a, b, c]);
                    let point = ray.origin + at * ray.direction - a;
                    let place =
                        [(b - a), (c - a)].map(|edge| point.dot(edge) / edge.length_squared());
                    // Not close to an edge.
                    if place.iter().all(|&at| (0.02..0.98).contains(&at)) {
                        hits.push((at, number, color));
                    } else if place.iter().all(|&at| (-0.02..1.02).contains(&at)) {
                        hits.clear();
                        break;
                    }
                }
                hits.sort_by(|a, b| a.0.total_cmp(&b.0));
                let same_around = [0, 1, 2].iter().all(|dy| {
                    [0, 1, 2].iter().all(|dx| {
                        let (x, y) = (x as i64 + dx - 1, y as i64 + dy - 1);
                        let inside =
                            x >= 0 && y >= 0 && x < i64::from(SIZE[0]) && y < i64::from(SIZE[1]);
                        inside && (ids[(y * i64::from(SIZE[0]) + x) as usize] == 0) == (id == 0)
                    })
                });
                let (Some(nearest), true) = (hits.first(), same_around) else {
                    continue;
                };
                if hits
                    .get(1)
                    .is_some_and(|next| next.0 - nearest.0 < DEPTH_GAP * nearest.0.abs())
                {
                    continue;
                }
                counts[nearest.1] += 1;
                let found = &picture[4 * index..][..3];
                assert!(
                    found
                        .iter()
                        .zip(nearest.2)
                        .all(|(a, b)| a.abs_diff(b) <= DISPLAY_CODES),
                    "{samples} samples, pixel ({x}, {y}): expected {nearest:?}, found {found:?}"
                );
            }
            println!(
                "reversed {reversed}, {samples} samples: {counts:?} pixels of sky, scene and quads"
            );
            assert!(counts.iter().all(|&count| count > 100), "{counts:?}");
        }
    }
    Ok(())
}

pub fn float_targets_hold_linear_radiance(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let frame = Frame {
        exposure: 32.0,
        ..frame(&lights, Method::Ambient)
    };
    let options = Options {
        target_format: wgpu::TextureFormat::Rgba32Float,
        blend: None,
        ..Options::default()
    };
    let read = |gpu: &mut Gpu| -> Result<(Image, Vec<[f32; 4]>), libtest_mimic::Failed> {
        let picture = render(gpu, &frame, 64, 48)?;
        Ok((
            picture.linear,
            bytemuck::pod_collect_to_vec(&picture.display),
        ))
    };
    let (linear, target) = with_options(gpu, options.clone(), read)?;
    assert!(
        target.iter().any(|pixel| pixel[0] > 1.0),
        "nothing brighter than 1"
    );
    for (linear, target) in linear.pixels.iter().zip(&target) {
        let [r, g, b, a] = *linear;
        assert_eq!([32.0 * r, 32.0 * g, 32.0 * b, a], *target);
    }
    let display = Options {
        output: Output::Display,
        ..options
    };
    let (_, shown) = with_options(gpu, display, read)?;
    let codes = twin::tonemap(&linear, frame.exposure);
    for (shown, codes) in shown.iter().zip(codes.chunks(4)) {
        let code = (shown[1] * 255.0).round() as u8;
        assert!(code.abs_diff(codes[1]) <= DISPLAY_CODES);
    }
    Ok(())
}

/// Buffers that are filled again, other sizes between, and two cameras in one submission: always the
/// picture that a fresh view would have.
pub fn views_are_used_again(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let scene = gpu.upload(&scenes::sphere_over_plane())?;
    let instances = [Instance::from(&scene)];
    let first = frame(&lights, POLAR);
    let second = Frame {
        camera: matrices(project::perspective(0.5, aspect(), NEAR_PLANE, 50.0)),
        lights: &lights[..2],
        rotation: Quat::from_rotation_x(0.3),
        ..first.clone()
    };
    let fresh = |frame: &Frame| {
        let mut view = gpu.renderer.view(SIZE)?;
        prepare(gpu, &mut view, &instances, frame)
    };
    let expected = [fresh(&first)?, fresh(&second)?];
    assert!(expected[0] != expected[1]);
    let mut view = gpu.renderer.view(SIZE)?;
    for index in [0, 1, 0, 1] {
        let frame = [&first, &second][index];
        assert!(prepare(gpu, &mut view, &instances, frame)? == expected[index]);
    }
    view.resize(&gpu.renderer, [40, 30])?;
    assert!(view.radiance().is_none());
    prepare(gpu, &mut view, &instances, &first)?;
    view.resize(&gpu.renderer, SIZE)?;
    assert!(prepare(gpu, &mut view, &instances, &first)? == expected[0]);

    let mut views = [gpu.renderer.view(SIZE)?, gpu.renderer.view(SIZE)?];
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    for (view, frame) in views.iter_mut().zip([&first, &second]) {
        gpu.renderer
            .prepare(&mut encoder, view, &instances, frame)?;
    }
    gpu.queue.submit([encoder.finish()]);
    for (view, expected) in views.iter().zip(&expected) {
        assert!(radiance(gpu, view)? == *expected);
    }
    // Nothing is left of what was seen before.
    let nothing = prepare(gpu, &mut views[0], &[], &first)?;
    assert!(nothing.pixels.iter().all(|pixel| *pixel == [0.0; 4]));
    Ok(())
}

#[allow(clippy::too_many_lines, reason = "a table of wrong uses")]
pub fn wrong_uses_are_errors(gpu: &mut Gpu) -> Outcome {
    let new = |options| Renderer::new(&gpu.device, &gpu.queue, options).map(|_| ());
    let with_format = |target_format| Options {
        target_format,
        ..Options::default()
    };
    for format in [
        wgpu::TextureFormat::R32Uint,
        wgpu::TextureFormat::Depth32Float,
        wgpu::TextureFormat::Rgb9e5Ufloat,
        wgpu::TextureFormat::Bc1RgbaUnorm,
        // It cannot be blended.
        wgpu::TextureFormat::Rgba32Float,
    ] {
        let error = new(with_format(format)).expect_err("a wrong format");
        assert!(
            matches!(error, Error::Format { format: found, .. } if found == format),
            "{error}"
        );
    }
    let samples = |count| Options {
        multisample: wgpu::MultisampleState {
            count,
            ..Default::default()
        },
        ..Options::default()
    };
    for count in [0, 2, 3, 8] {
        assert!(matches!(new(samples(count)), Err(Error::SampleCount { found }) if found == count));
    }
    let stencil = Options {
        depth_stencil: Some(wgpu::DepthStencilState::stencil(
            wgpu::TextureFormat::Stencil8,
            wgpu::StencilState::default(),
        )),
        ..Options::default()
    };
    assert!(matches!(new(stencil), Err(Error::Format { .. })));

    let lights = lights();
    let frame = frame(&lights, Method::Ambient);
    let scene = gpu.upload(&scenes::sphere_over_plane())?;
    let other = Gpu::new(&wgpu::Limits::default())?;
    let foreign = other.upload(&scenes::sphere_over_plane())?;
    let mut foreign_view = other.renderer.view(SIZE)?;
    let mut view = gpu.renderer.view(SIZE)?;
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let mut prepare = |view: &mut View, scene, placement, frame: &Frame| {
        let instance = Instance { scene, placement };
        gpu.renderer.prepare(&mut encoder, view, &[instance], frame)
    };
    let here = Placement::IDENTITY;
    assert!(matches!(
        prepare(&mut foreign_view, &scene, here, &frame),
        Err(Error::Foreign { what: "view" })
    ));
    assert!(matches!(
        prepare(&mut view, &foreign, here, &frame),
        Err(Error::Foreign { what: "scene" })
    ));
    let turned = Placement {
        rotation: Quat::from_xyzw(0.0, 1.0, 0.0, 1.0),
        ..here
    };
    assert!(matches!(
        prepare(&mut view, &scene, turned, &frame),
        Err(Error::Rotation { .. })
    ));
    for scale in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let scaled = Placement { scale, ..here };
        assert!(matches!(
            prepare(&mut view, &scene, scaled, &frame),
            Err(Error::Placement(_))
        ));
    }
    let spun = Frame {
        rotation: Quat::from_xyzw(0.0, 0.0, 0.0, 0.0),
        ..frame.clone()
    };
    assert!(matches!(
        prepare(&mut view, &scene, here, &spun),
        Err(Error::Rotation { .. })
    ));
    let flat = Frame {
        camera: matrices(Mat4::ZERO),
        ..frame.clone()
    };
    assert!(matches!(
        prepare(&mut view, &scene, here, &flat),
        Err(Error::Camera { .. })
    ));

    let wrong = [
        target(gpu, [64, 48], wgpu::TextureFormat::Rgba16Float),
        target(gpu, [63, 48], wgpu::TextureFormat::Rgba8Unorm),
        attachment(&gpu.device, [64, 48], wgpu::TextureFormat::Rgba8Unorm, 4),
    ];
    for texture in &wrong {
        let drawn = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let result = (gpu.renderer).render(&mut encoder, &scene, &frame, &drawn, [64, 48]);
        let error = result.expect_err("a wrong target");
        assert!(matches!(error, Error::Target { .. }), "{error}");
    }

    let texture = target(gpu, SIZE, wgpu::TextureFormat::Rgba8Unorm);
    let drawn = texture.create_view(&wgpu::TextureViewDescriptor::default());
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: None,
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: &drawn,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations::default(),
        })],
        ..Default::default()
    });
    let result = gpu.renderer.composite(&view, &mut pass);
    assert!(matches!(result, Err(Error::NotPrepared)), "{result:?}");
    Ok(())
}

/// Parts of a frame, one after the other, are the frame.
pub fn parts_make_a_frame(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let options = Options {
        rows_per_dispatch: Some(16),
        ..Options::default()
    };
    with_options(gpu, options, |gpu| {
        let scene = gpu.upload(&scenes::sphere_over_plane())?;
        let instances = [Instance::from(&scene)];
        for antialias in [false, true] {
            let frame = Frame {
                antialias,
                ..frame(&lights, Method::Ambient)
            };
            let mut view = gpu.renderer.view(SIZE)?;
            prepare(gpu, &mut view, &instances, &frame)?;
            let whole = gpu.read_radiance(&view)?;
            let mut view = gpu.renderer.view(SIZE)?;
            for first in (0..SIZE[1]).step_by(32) {
                let rows = first..first + 32;
                let mut encoder = gpu
                    .device
                    .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
                (gpu.renderer).prepare_rows(&mut encoder, &mut view, &instances, &frame, rows)?;
                gpu.queue.submit([encoder.finish()]);
            }
            assert!(gpu.read_radiance(&view)? == whole, "antialias: {antialias}");
        }
        Ok(())
    })
}

pub fn any_number_of_rows_is_dispatched(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let frame = frame(&lights, Method::Ambient);
    let whole = render(gpu, &frame, 50, 41)?;
    for rows in [0, 1, u32::MAX - 3, u32::MAX] {
        let options = Options {
            rows_per_dispatch: Some(rows),
            ..Options::default()
        };
        assert!(with_options(gpu, options, |gpu| render(gpu, &frame, 50, 41))? == whole);
    }
    Ok(())
}

/// Commands that are never submitted do not keep the clocks.
pub fn times_are_known_without_waiting(gpu: &mut Gpu) -> Outcome {
    if !gpu
        .device
        .features()
        .contains(wgpu::Features::TIMESTAMP_QUERY)
    {
        println!("the device has no timestamps");
        return Ok(());
    }
    let lights = lights();
    let frame = frame(&lights, Method::Ambient);
    let scene = gpu.upload(&scenes::sphere_over_plane())?;
    let instances = [Instance::from(&scene)];
    with_options(gpu, Options::default(), |gpu| {
        let mut view = gpu.renderer.view([40, 30])?;
        let encoder = |gpu: &Gpu| {
            gpu.device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
        };
        for _ in 0..10 {
            let mut dropped = encoder(gpu);
            gpu.renderer
                .prepare(&mut dropped, &mut view, &instances, &frame)?;
        }
        // More frames than there are clocks, then the results.
        let mut submitted = Vec::new();
        for _ in 0..10 {
            let mut encoder = encoder(gpu);
            gpu.renderer
                .prepare(&mut encoder, &mut view, &instances, &frame)?;
            submitted.push(encoder.finish());
        }
        assert_eq!(gpu.renderer.pass_times(), None);
        for commands in submitted {
            gpu.queue.submit([commands]);
        }
        gpu.device.poll(wgpu::PollType::wait_indefinitely())?;
        let times = gpu.renderer.pass_times().ok_or("times after a wait")?;
        assert!(
            !times.shade.is_zero() && times.tonemap.is_zero(),
            "{times:?}"
        );
        Ok(())
    })
}

/// Motion is that of the twin, for instances that moved, turned and grew, under a camera that did; what stands
/// still does not move, with antialiasing either.
#[allow(clippy::too_many_lines, reason = "one comparison after the other")]
pub fn motion_matches_twin(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let scene = scenes::sphere_over_plane();
    let uploaded = gpu.upload(&scene)?;
    let now = placements();
    let instances: Vec<Instance> = (now.iter())
        .map(|&placement| Instance {
            scene: &uploaded,
            placement,
        })
        .collect();
    let placed: Vec<twin::Placed> = (now.iter())
        .map(|&placement| twin::Placed {
            scene: &scene,
            placement,
        })
        .collect();
    let earlier: Vec<Placement> = (now.iter())
        .map(|placement| Placement {
            rotation: (placement.rotation * Quat::from_rotation_y(0.1)).normalize(),
            translation: placement.translation + Vec3::new(0.05, 0.02, -0.1),
            scale: placement.scale * 0.97,
        })
        .collect();
    let projection = |shift: f32| {
        let jitter = Mat4::from_translation(Vec3::new(shift, -0.5 * shift, 0.0));
        matrices(jitter * project::perspective(0.8, aspect(), NEAR_PLANE, 50.0))
    };
    let camera = projection(0.0);
    let mut view = gpu.renderer.view(SIZE)?;
    let mut motion = |before: &Before, antialias| -> Result<Vec<[f32; 2]>, Error> {
        let frame = Frame {
            camera,
            antialias,
            ..frame(&lights, Method::Ambient)
        };
        let descriptor = wgpu::CommandEncoderDescriptor::default();
        let mut encoder = gpu.device.create_command_encoder(&descriptor);
        (gpu.renderer).prepare(&mut encoder, &mut view, &instances, &frame)?;
        (gpu.renderer).motion(&mut encoder, &mut view, &instances, before)?;
        gpu.queue.submit([encoder.finish()]);
        let texture = view.motion().expect("just found");
        let bytes = relight_runtime::offscreen::read_texture(&gpu.device, &gpu.queue, texture)?;
        Ok(bytemuck::pod_collect_to_vec(&bytes))
    };
    let before = Before {
        camera: projection(0.03),
        placements: &earlier,
    };
    let found = motion(&before, false)?;
    let frame = Frame {
        camera,
        ..frame(&lights, Method::Ambient)
    };
    let expected = twin::motion(&placed, &frame, &before, SIZE)?;
    let moved = expected
        .iter()
        .filter(|motion| **motion != [0.0; 2])
        .count();
    assert!(moved * 3 > expected.len(), "{moved} pixels move");
    let off = |a: &[f32; 2], b: &[f32; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
    let different = (found.iter().zip(&expected))
        .filter(|(a, b)| off(a, b) > 1e-5)
        .count();
    println!("{different} of {moved} pixels differ");
    assert!(different as f32 <= DIFFERENT_PIXELS * found.len() as f32 + 1.0);
    let still = Before {
        camera,
        placements: &now,
    };
    for antialias in [false, true] {
        let found = motion(&still, antialias)?;
        let most = found
            .iter()
            .map(|motion| off(motion, &[0.0; 2]))
            .fold(0.0, f32::max);
        println!("what stands still moves by {most:e}, antialiased: {antialias}");
        // A hundredth of a pixel: places outside of their triangle by a rounding are moved onto it.
        assert!(most * (SIZE[0] as f32) < 0.01, "{most}");
    }
    // Where the camera was beyond them they were nowhere.
    let behind = Before {
        camera: Viewpoint::Matrices {
            view: look_at_mat4(
                Vec3::new(0.0, 0.0, -90.0),
                Vec3::new(0.0, 0.0, -95.0),
                Vec3::Y,
            ),
            projection: project::perspective(0.8, aspect(), NEAR_PLANE, 50.0),
        },
        placements: &now,
    };
    let found = motion(&behind, false)?;
    assert!(found.iter().filter(|motion| **motion == [4.0; 2]).count() * 3 > found.len());
    let fewer = motion(
        &Before {
            placements: &now[1..],
            ..still
        },
        false,
    );
    assert!(
        matches!(
            fewer,
            Err(Error::InstanceCount {
                expected: 3,
                found: 2
            })
        ),
        "{fewer:?}"
    );
    Ok(())
}
