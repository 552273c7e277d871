//! The GPU against its twin, stage by stage. Without an adapter these fail, unless
//! `RELIGHT_NO_GPU=1` says that there is none: then they count as skipped.

mod background;
mod catcher;
mod conformance;
mod engine;
mod examples;
#[path = "../../../format/tests/format/generate.rs"]
#[allow(dead_code, reason = "the tests of the format use the rest")]
mod generate;
mod loading;
mod scenes;
mod shadow_map;
#[path = "../../examples/support/mod.rs"]
#[allow(clippy::duplicate_mod, reason = "every example has it as well")]
mod support;
mod textures;

use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};

use glam::{Quat, Vec3};
use libtest_mimic::{Completion, Failed, Trial};
use relight_format::{Camera, Environment, FieldOfView, Material, Scene, Surface};
use relight_runtime::offscreen::{Gpu, Picture};
use relight_runtime::{
    Background, CellsOptions, EnvironmentLight, Error, Frame, Image, Instance, LocalLight,
    MAX_LOCAL_LIGHTS, Method, Options, PolarOptions, Prefiltered, Sources, SphericalGaussian, Spot,
    twin, wgpu,
};
use relight_shading::camera::View;
use relight_shading::prefiltered::encode;

/// Pixels whose triangle may differ, as a fraction: vertices are projected by differently
/// rounded arithmetic, so that now and then one snaps to the neighbouring 1/256 pixel.
const DIFFERENT_PIXELS: f32 = 1e-4;
/// Pixels whose triangle may differ from what a ray through the centre hits: those whose
/// centre lies within half a snapping step of an edge.
const SNAPPED_PIXELS: f32 = 5e-3;
/// Most display codes that GPU and twin may differ by on the same radiance: one rounding.
const DISPLAY_CODES: u8 = 1;
/// Relative RMSE of a frame over pixels covered in both. Software Vulkan stays below 1e-5;
/// the rest is room for GPUs that interpolate the basis with 8-bit weights.
const FRAME_RELATIVE_RMSE: f32 = 1e-3;
/// The same by cells: where an error is close to its threshold, one divides a cell and the other
/// does not.
const CELLS_RELATIVE_RMSE: f32 = 5e-3;

/// How much further a graphics card may be from its twin than software, in what depends on where visibility changes: it
/// weighs the texels that it interpolates in 256ths. On an H200 the worst frame below is 1.1e-3 off, and by cells
/// 0.5 % of the pixels beside sources differ.
fn looseness(gpu: &Gpu) -> f32 {
    if gpu.is_software() { 1.0 } else { 4.0 }
}

/// A device at WebGPU's default limits, opened once.
static GPU: Mutex<Option<Gpu>> = Mutex::new(None);

type Outcome = Result<(), Failed>;

#[allow(clippy::too_many_lines, reason = "a table of tests")]
fn main() -> ExitCode {
    let no_gpu = std::env::var_os("RELIGHT_NO_GPU").is_some_and(|value| value == "1");
    let with_gpu = |name: &str, run: fn(&mut Gpu) -> Outcome| {
        Trial::ignorable_test(name, move || {
            if no_gpu {
                println!("skipped: RELIGHT_NO_GPU=1");
                return Ok(Completion::ignored_with("RELIGHT_NO_GPU=1"));
            }
            // A test that failed leaves the device as good as it was.
            let mut gpu = GPU.lock().unwrap_or_else(PoisonError::into_inner);
            if gpu.is_none() {
                *gpu = Some(Gpu::new(&wgpu::Limits::default())?);
            }
            run(gpu.as_mut().expect("just opened")).map(|()| Completion::Completed)
        })
    };
    let trials = vec![
        Trial::test("twin_visibility_matches_rays", || {
            twin_visibility_matches_rays();
            Ok(())
        }),
        Trial::test("twin_ignores_thread_count", twin_ignores_thread_count),
        Trial::test(
            "prepared_scenes_draw_the_same",
            prepared_scenes_draw_the_same,
        ),
        with_gpu("empty_scenes_are_background", empty_scenes_are_background),
        with_gpu("any_valid_assets_are_drawn", any_valid_assets_are_drawn),
        with_gpu(
            "visibility_buffer_matches_twin",
            visibility_buffer_matches_twin,
        ),
        with_gpu("near_clipping_matches_twin", near_clipping_matches_twin),
        with_gpu(
            "functions_match_oracle_and_twin",
            conformance::functions::functions_match_oracle_and_twin,
        ),
        with_gpu(
            "ssdf_and_integrators_match_twins",
            conformance::visibility::ssdf_and_integrators_match_twins,
        ),
        with_gpu(
            "surface_and_lobes_match_twins",
            conformance::reflection::surface_and_lobes_match_twins,
        ),
        with_gpu("frame_matches_twin", frame_matches_twin),
        with_gpu(
            "tiles_whose_pixels_all_disagree_match_twin",
            tiles_whose_pixels_all_disagree_match_twin,
        ),
        with_gpu(
            "light_at_vertices_is_kept_and_renewed",
            light_at_vertices_is_kept_and_renewed,
        ),
        with_gpu(
            "local_lights_and_reflections_match_twins",
            local_lights_and_reflections_match_twins,
        ),
        with_gpu("sources_match_twins", sources_match_twins),
        with_gpu("cells_match_twin", cells_match_twin),
        with_gpu("tonemap_matches_twin", tonemap_matches_twin),
        with_gpu("bands_do_not_show", bands_do_not_show),
        with_gpu(
            "one_encoder_holds_several_frames",
            one_encoder_holds_several_frames,
        ),
        with_gpu(
            "srgb_targets_are_encoded_once",
            srgb_targets_are_encoded_once,
        ),
        with_gpu(
            "materials_change_without_upload",
            materials_change_without_upload,
        ),
        with_gpu("passes_are_timed", passes_are_timed),
        with_gpu(
            "loading::uploads_tell_and_stop",
            loading::uploads_tell_and_stop,
        ),
        with_gpu("loading::scenes_are_replaced", loading::scenes_are_replaced),
        with_gpu(
            "loading::others_draw_meanwhile",
            loading::others_draw_meanwhile,
        ),
        with_gpu(
            "loading::a_thousand_instances_cost_their_pixels",
            loading::a_thousand_instances_cost_their_pixels,
        ),
        with_gpu(
            "textures::fifteen_maps_of_2048_are_drawn",
            textures::fifteen_maps_of_2048_are_drawn,
        ),
        with_gpu(
            "textures::second_coordinates_are_drawn",
            textures::second_coordinates_are_drawn,
        ),
        with_gpu(
            "textures::distant_textures_are_averaged",
            textures::distant_textures_are_averaged,
        ),
        with_gpu(
            "textures::images_take_the_place_of_textures",
            textures::images_take_the_place_of_textures,
        ),
        with_gpu(
            "background::backgrounds_match_twin",
            background::backgrounds_match_twin,
        ),
        with_gpu(
            "background::backgrounds_need_no_scene",
            background::backgrounds_need_no_scene,
        ),
        with_gpu("catcher::catchers_match_twin", catcher::catchers_match_twin),
        with_gpu(
            "catcher::catchers_are_switched",
            catcher::catchers_are_switched,
        ),
        with_gpu("engine::matrices_match_twin", engine::matrices_match_twin),
        with_gpu("engine::cameras_agree", engine::cameras_agree),
        with_gpu(
            "engine::antialiasing_matches_twin",
            engine::antialiasing_matches_twin,
        ),
        with_gpu(
            "engine::antialiasing_is_closer_to_the_truth",
            engine::antialiasing_is_closer_to_the_truth,
        ),
        with_gpu(
            "engine::edges_of_shadows_have_no_stairs",
            engine::edges_of_shadows_have_no_stairs,
        ),
        with_gpu(
            "engine::antialiased_edges_blend",
            engine::antialiased_edges_blend,
        ),
        with_gpu("engine::motion_matches_twin", engine::motion_matches_twin),
        with_gpu("engine::instances_match_twin", engine::instances_match_twin),
        with_gpu("engine::batches_match_twin", engine::batches_match_twin),
        with_gpu(
            "shadow_map::shadow_maps_match_twin",
            shadow_map::shadow_maps_match_twin,
        ),
        with_gpu(
            "engine::turning_the_world_changes_nothing",
            engine::turning_the_world_changes_nothing,
        ),
        with_gpu(
            "engine::scenes_stand_among_the_apps_objects",
            engine::scenes_stand_among_the_apps_objects,
        ),
        with_gpu(
            "engine::float_targets_hold_linear_radiance",
            engine::float_targets_hold_linear_radiance,
        ),
        with_gpu("engine::views_are_used_again", engine::views_are_used_again),
        with_gpu(
            "engine::wrong_uses_are_errors",
            engine::wrong_uses_are_errors,
        ),
        with_gpu("engine::parts_make_a_frame", engine::parts_make_a_frame),
        with_gpu(
            "examples_make_their_pictures",
            examples::examples_make_their_pictures,
        ),
        with_gpu(
            "engine::any_number_of_rows_is_dispatched",
            engine::any_number_of_rows_is_dispatched,
        ),
        with_gpu(
            "engine::times_are_known_without_waiting",
            engine::times_are_known_without_waiting,
        ),
        with_gpu("errors_name_what_is_wrong", errors_name_what_is_wrong),
        with_gpu("limits_are_checked", limits_are_checked),
        with_gpu("large_scenes_are_drawn", large_scenes_are_drawn),
        with_gpu("sizes_may_change", sizes_may_change),
        with_gpu("lost_devices_are_errors", lost_devices_are_errors),
    ];
    libtest_mimic::run(&libtest_mimic::Arguments::from_args(), trials).exit_code()
}

/// A warm sun, a blue sky and a dim ground.
fn lights() -> Vec<SphericalGaussian> {
    let lobe = |axis: Vec3, sharpness, amplitude: [f32; 3]| SphericalGaussian {
        axis: axis.normalize(),
        sharpness,
        amplitude: amplitude.into(),
    };
    vec![
        lobe(Vec3::new(1.0, 1.2, 0.3), 120.0, [40.0, 30.0, 20.0]),
        lobe(Vec3::new(-0.8, 0.9, 0.6), 12.0, [0.5, 1.5, 3.0]),
        lobe(Vec3::Y, 1.5, [0.2, 0.25, 0.3]),
    ]
}

fn frame(lights: &[SphericalGaussian], method: Method) -> Frame<'_> {
    Frame {
        camera: scenes::camera().into(),
        lights,
        rotation: Quat::from_rotation_y(0.4),
        reflections: None,
        sources: None,
        local_lights: &[],
        method,
        antialias: false,
        exposure: 0.8,
        shadow_map: None,
        background: Background::Transparent,
    }
}

const POLAR: Method = Method::Polar(PolarOptions { spokes: 8 });

fn render(gpu: &mut Gpu, frame: &Frame, width: u32, height: u32) -> Result<Picture, Failed> {
    let scene = gpu.upload(&scenes::sphere_over_plane())?;
    Ok(gpu.render(&scene, frame, width, height)?)
}

fn different_pixels(gpu: &mut Gpu, camera: Camera) -> Result<f32, Failed> {
    let (width, height) = (640, 480);
    let scene = scenes::sphere_over_plane();
    let uploaded = gpu.upload(&scene)?;
    let frame = Frame {
        camera: camera.into(),
        ..frame(&[], Method::Ambient)
    };
    gpu.render(&uploaded, &frame, width, height)?;
    let texture = gpu
        .renderer
        .visibility_buffer()
        .expect("a frame was drawn")
        .clone();
    let found: Vec<u32> = gpu
        .read_texture(&texture)?
        .chunks_exact(4)
        .map(|bytes| u32::from_le_bytes(bytes.try_into().expect("four bytes")))
        .collect();
    let view = View::new(&camera, width, height, scenes::NEAR);
    let expected = twin::visibility_buffer(&scene, &view, width, height);
    assert!(
        expected.iter().filter(|&&id| id > 0).count() > 10_000,
        "a nearly empty picture"
    );
    let different = found.iter().zip(&expected).filter(|(a, b)| a != b).count();
    println!("{different} of {} pixels differ", expected.len());
    Ok(different as f32 / expected.len() as f32)
}

fn visibility_buffer_matches_twin(gpu: &mut Gpu) -> Outcome {
    assert!(different_pixels(gpu, scenes::camera())? <= DIFFERENT_PIXELS);
    Ok(())
}

/// The eye just above the plane, which reaches from before the image plane to behind it.
fn grazing_camera() -> Camera {
    Camera {
        position: [0.3, 0.02, 0.7],
        target: [0.0, 0.1, 0.0],
        up: [0.2, 1.0, 0.0],
        field_of_view: FieldOfView::Y(1.4),
    }
}

fn near_clipping_matches_twin(gpu: &mut Gpu) -> Outcome {
    assert!(different_pixels(gpu, grazing_camera())? <= DIFFERENT_PIXELS);
    Ok(())
}

/// Root mean square difference over pixels covered in both, over the mean of `b`.
fn relative_rmse(a: &Image, b: &Image) -> f32 {
    let (mut square, mut sum) = (0.0f64, 0.0f64);
    for (a, b) in a.pixels.iter().zip(&b.pixels) {
        assert!(a.iter().all(|value| value.is_finite()), "{a:?}");
        if a[3] == 1.0 && b[3] == 1.0 {
            for channel in 0..3 {
                square += f64::from(a[channel] - b[channel]).powi(2);
                sum += f64::from(b[channel]);
            }
        }
    }
    let count = 3.0 * b.pixels.iter().filter(|pixel| pixel[3] == 1.0).count() as f64;
    ((square / count).sqrt() / (sum / count)) as f32
}

/// The rasteriser against rays through the pixel centres, triangle by triangle.
fn twin_visibility_matches_rays() {
    let (width, height) = (96, 72);
    let scene = scenes::sphere_over_plane();
    let mut different = 0;
    for camera in [scenes::camera(), grazing_camera()] {
        let view = View::new(&camera, width, height, scenes::NEAR);
        let found = twin::visibility_buffer(&scene, &view, width, height);
        for (index, &found) in found.iter().enumerate() {
            let direction = view.pixel_direction(index as u32 % width, index as u32 / width);
            let mut nearest = (f32::INFINITY, 0);
            for (triangle, id) in scene.triangles.iter().zip(1..) {
                let [a, b, c] = triangle
                    .vertices
                    .map(|vertex| Vec3::from(scene.vertices[vertex as usize].position) - view.eye);
                let weights = [
                    direction.dot(b.cross(c)),
                    direction.dot(c.cross(a)),
                    direction.dot(a.cross(b)),
                ];
                // Counter-clockwise triangles in front have negative volumes with the eye.
                let distance = a.dot(b.cross(c)) / weights.iter().sum::<f32>();
                let hit = weights.iter().all(|&weight| weight <= 0.0);
                if hit && distance > 0.0 && distance < nearest.0 {
                    nearest = (distance, id);
                }
            }
            different += usize::from(found != nearest.1);
        }
    }
    let pixels = 2 * width * height;
    println!("{different} of {pixels} pixels differ from rays");
    assert!(different as f32 <= SNAPPED_PIXELS * pixels as f32);
}

/// What a prepared scene keeps from frame to frame is in no picture: whatever was drawn before, other
/// cameras, lights and materials, and frames that were given up.
fn prepared_scenes_draw_the_same() -> Outcome {
    let scene = scenes::sphere_over_plane();
    let prepared = twin::Prepared::new(&scene);
    let lights = lights();
    let mut edited = scene.clone();
    edited.materials[0].emission = [0.5, 0.25, 0.125];
    let plain = frame(&lights, POLAR);
    let turned = Frame {
        rotation: Quat::from_rotation_y(0.7),
        ..plain.clone()
    };
    let ambient = frame(&lights, Method::Ambient);
    let asked = std::sync::atomic::AtomicU32::new(0);
    let soon = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) < 200;
    for (scene, frame, size) in [
        (&scene, &plain, [20, 15]),
        (&scene, &plain, [80, 60]),
        (&edited, &turned, [40, 30]),
        (&edited, &ambient, [40, 30]),
        (&scene, &plain, [60, 80]),
        (&scene, &turned, [80, 60]),
    ] {
        let [width, height] = size;
        // Given up half-way.
        twin::render_prepared(scene, &prepared, frame, width, height, &soon)?;
        let found = twin::render_prepared(scene, &prepared, frame, width, height, &|| true)?;
        assert!(
            found == twin::render(scene, frame, width, height)?,
            "{size:?}"
        );
        asked.store(0, std::sync::atomic::Ordering::Relaxed);
    }
    Ok(())
}

fn twin_ignores_thread_count() -> Outcome {
    let scene = scenes::sphere_over_plane();
    let lights = lights();
    let mut images = Vec::new();
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()?;
        images.push(pool.install(|| twin::render(&scene, &frame(&lights, POLAR), 80, 60))?);
    }
    assert!(images[0] == images[1]);
    assert!(images[0].pixels.iter().any(|pixel| pixel[3] == 1.0));
    assert!(images[0].pixels.contains(&[0.0; 4]), "no background");
    Ok(())
}

fn frame_matches_twin(gpu: &mut Gpu) -> Outcome {
    let (width, height) = (240, 180);
    let lights = lights();
    for method in [Method::Ambient, POLAR] {
        let frame = frame(&lights, method);
        // The first frame at a size makes its images.
        render(gpu, &frame, width, height)?;
        let start = std::time::Instant::now();
        let found = render(gpu, &frame, width, height)?.linear;
        let gpu_time = start.elapsed();
        let start = std::time::Instant::now();
        let expected = twin::render(&scenes::sphere_over_plane(), &frame, width, height)?;
        let twin_time = start.elapsed();
        let error = relative_rmse(&found, &expected);
        println!("{method:?}: relative RMSE {error:e}, GPU {gpu_time:?}, twin {twin_time:?}");
        if let Some(folder) = std::env::var_os("RELIGHT_TEST_PICTURES") {
            let folder = std::path::PathBuf::from(folder);
            let name = if method == POLAR { "polar" } else { "ambient" };
            for (who, image) in [("gpu", &found), ("twin", &expected)] {
                let path = folder.join(format!("{name}_{who}.png"));
                let display = twin::tonemap(image, frame.exposure);
                image::save_buffer(path, &display, width, height, image::ColorType::Rgba8)?;
            }
        }
        assert!(
            error <= FRAME_RELATIVE_RMSE,
            "{method:?}: relative RMSE {error}"
        );
    }
    Ok(())
}

/// Three quarters of a tile's lobes wait to be interpolated, and then, as no two pixels agree, to be integrated: where
/// that is so for two thirds of them, both are more than the queue holds.
fn tiles_whose_pixels_all_disagree_match_twin(gpu: &mut Gpu) -> Outcome {
    let scene = scenes::disagreeing_floor();
    let lights: Vec<SphericalGaussian> = (0..12)
        .map(|index| {
            let azimuth = index as f32;
            SphericalGaussian {
                axis: Vec3::new(azimuth.sin(), 0.8, azimuth.cos()).normalize(),
                sharpness: 20.0,
                amplitude: Vec3::ONE,
            }
        })
        .collect();
    let frame = Frame {
        camera: Camera {
            position: [0.0, 5.0, 0.0],
            target: [0.0; 3],
            up: [0.0, 0.0, -1.0],
            field_of_view: FieldOfView::Y(0.7),
        }
        .into(),
        ..frame(&lights, POLAR)
    };
    let [width, height] = [64; 2];
    let work = twin::work(&scene, &frame, width, height)?;
    let asked = work.integrals as f32 / (work.pixels * lights.len() as u64) as f32;
    assert_eq!(work.pixels, u64::from(width * height));
    assert!(asked > 0.7, "only {asked} of all lobes are integrated");
    let uploaded = gpu.upload(&scene)?;
    let found = gpu.render(&uploaded, &frame, width, height)?.linear;
    let expected = twin::render(&scene, &frame, width, height)?;
    let error = relative_rmse(&found, &expected);
    println!("relative RMSE {error:e}, {asked} of all lobes integrated");
    let most = looseness(gpu) * FRAME_RELATIVE_RMSE;
    assert!(error <= most, "relative RMSE {error}");
    Ok(())
}

/// What vertices see of a light serves while it stands still, also those that come into sight later,
/// and is found anew when it turns, or turns back.
fn light_at_vertices_is_kept_and_renewed(gpu: &mut Gpu) -> Outcome {
    let size = [96, 72];
    let lights = lights();
    let scene = scenes::sphere_over_plane();
    let uploaded = gpu.upload(&scene)?;
    let close = Camera {
        field_of_view: FieldOfView::Y(0.2),
        ..scenes::camera()
    };
    let frames = [
        (close, 0.4),
        (scenes::camera(), 0.4),
        (scenes::camera(), 1.3),
        (close, 1.3),
        (close, 0.4),
    ];
    for (index, (camera, turn)) in frames.into_iter().enumerate() {
        let frame = Frame {
            camera: camera.into(),
            rotation: Quat::from_rotation_y(turn),
            ..frame(&lights, POLAR)
        };
        let found = gpu.render(&uploaded, &frame, size[0], size[1])?.linear;
        let expected = twin::render(&scene, &frame, size[0], size[1])?;
        let error = relative_rmse(&found, &expected);
        println!("frame {index}: relative RMSE {error:e}");
        assert!(error <= FRAME_RELATIVE_RMSE, "frame {index}: {error}");
    }
    // Another scene of as many vertices has other fractions.
    let mut other = scene;
    for coefficient in &mut other.coefficients {
        *coefficient = -*coefficient;
    }
    let other_uploaded = gpu.upload(&other)?;
    let mut seen = Vec::new();
    for uploaded in [&uploaded, &other_uploaded] {
        let frame = frame(&lights, POLAR);
        seen.push(gpu.render(uploaded, &frame, size[0], size[1])?.linear);
    }
    let expected = twin::render(&other, &frame(&lights, POLAR), size[0], size[1])?;
    let error = relative_rmse(&seen[1], &expected);
    assert!(error <= FRAME_RELATIVE_RMSE, "another scene: {error}");
    assert!(relative_rmse(&seen[0], &expected) > 0.05, "they differ");
    Ok(())
}

/// A prefiltered image of stripes, five levels.
fn stripes() -> Prefiltered {
    let texels = (1..=5u32).rev().flat_map(|level| {
        let n = 1u32 << level;
        (0..n * n).map(move |index| {
            let bright = [4.0, 0.1][(index % n * 8 / n % 2) as usize];
            encode(Vec3::new(
                bright,
                0.5 * bright,
                (index / n) as f32 / n as f32,
            ))
        })
    });
    let texels = texels.collect();
    Prefiltered::new(&relight_format::Prefiltered { texels }, &[]).expect("whole levels")
}

/// A small sun and a window beside it.
pub fn sources() -> Sources {
    let grid = |theta, phi, row_step, column_step, rows, columns| relight_format::Source {
        theta,
        phi,
        row_step,
        column_step,
        rows,
        columns,
    };
    let environment = Environment {
        sources: vec![
            grid(0.9, 1.9, 0.01, 0.01, 1, 1),
            grid(1.0, 4.0, 0.05, 0.1, 8, 6),
        ],
        source_texels: (0..49)
            .map(|index| match index {
                0 => [9e3, 8e3, 7e3],
                index => [3.0, 4.0 + 0.1 * index as f32, 6.0],
            })
            .collect(),
        ..Environment::default()
    };
    Sources::new(&environment).expect("two sources")
}

/// Pixels, as a fraction, where rounding may send a ray to the other side of an edge, or a
/// pixel's first rays to another conclusion.
const OTHER_RAYS: f32 = 2e-3;

fn sources_match_twins(gpu: &mut Gpu) -> Outcome {
    let (width, height) = (96, 72);
    let (lights, sources) = (lights(), sources());
    let mut simple = scenes::sphere_over_plane();
    simple.visibility.ray_offset = 1e-4;
    let mut layered = simple.clone();
    layered.materials[1] = scenes::coated_material();
    let uploaded = [gpu.upload(&simple)?, gpu.upload(&layered)?];
    // Cells without thresholds: close to one, one of the two may divide a cell and the other not.
    let even = CellsOptions {
        uniform: Some([2, 8]),
        ..CellsOptions::default()
    };
    let cells = Method::Cells(even);
    for (layers, method, antialias) in [
        (1, POLAR, false),
        (1, POLAR, true),
        (1, cells, false),
        (2, POLAR, false),
        (2, cells, false),
    ] {
        let scene = [&simple, &layered][layers - 1];
        let uploaded = &uploaded[layers - 1];
        let without = Frame {
            antialias,
            ..frame(&lights, method)
        };
        let with = Frame {
            sources: Some(&sources),
            ..without.clone()
        };
        let found = gpu.render(uploaded, &with, width, height)?.linear;
        let expected = twin::render(scene, &with, width, height)?;
        // Sources come and go: the picture's images are made anew, or stay.
        let dark = gpu.render(uploaded, &without, width, height)?.linear;
        assert!(relative_rmse(&dark, &twin::render(scene, &without, width, height)?) < 1e-2);
        let mut different = 0;
        let mut added = Vec::new();
        for ((found, expected), dark) in found.pixels.iter().zip(&expected.pixels).zip(&dark.pixels)
        {
            let far = |a: &[f32; 4], b: &[f32; 4], most: f32| {
                (0..3).any(|channel| (a[channel] - b[channel]).abs() > most * (1e-3 + b[channel]))
            };
            different += usize::from(far(found, expected, 5.0 * CELLS_RELATIVE_RMSE));
            if found[3] == 1.0 {
                added.push(found[1] - dark[1]);
            }
        }
        added.sort_by(f32::total_cmp);
        let half = 0.5 * added[added.len() / 2];
        let shadowed = added.partition_point(|&added| added < half);
        println!(
            "{layers} layers, {method:?}, antialias {antialias}: {different} pixels differ, {shadowed} get little of their light"
        );
        let most = looseness(gpu) * OTHER_RAYS * (width * height) as f32;
        assert!(different as f32 <= most);
        assert!(shadowed > 200, "no shadow");
        let again = gpu.render(uploaded, &with, width, height)?.linear;
        assert!(again == found);
    }
    Ok(())
}

fn local_lights_and_reflections_match_twins(gpu: &mut Gpu) -> Outcome {
    let (width, height) = (160, 120);
    let lights = lights();
    // As many as are found at a time: light from everywhere, which follows them, is then found alone.
    let doubled = lights.repeat(2);
    let image = stripes();
    let lamp = LocalLight {
        position: Vec3::new(0.9, 1.4, 0.6),
        radius: 0.2,
        radiance: Vec3::new(30.0, 20.0, 10.0),
        spot: None,
    };
    let spot = LocalLight {
        position: Vec3::new(-1.2, 2.0, 0.4),
        radiance: Vec3::new(20.0, 60.0, 90.0),
        spot: Some(Spot {
            direction: Vec3::new(0.5, -0.8, 0.0).normalize(),
            inner_angle: 0.3,
            outer_angle: 0.6,
        }),
        ..lamp
    };
    let both = [lamp, spot];
    let plain = frame(&lights, POLAR);
    let drawn = render(gpu, &plain, width, height)?.linear;
    for frame in [
        Frame {
            local_lights: &both,
            ..plain.clone()
        },
        Frame {
            reflections: Some(&image),
            ..plain.clone()
        },
        Frame {
            local_lights: &both[..1],
            reflections: Some(&image),
            rotation: Quat::from_rotation_x(1.0),
            method: Method::Ambient,
            ..plain.clone()
        },
        Frame {
            lights: &doubled,
            reflections: Some(&image),
            ..plain.clone()
        },
    ] {
        let found = render(gpu, &frame, width, height)?.linear;
        let expected = twin::render(&scenes::sphere_over_plane(), &frame, width, height)?;
        let error = relative_rmse(&found, &expected);
        let change = relative_rmse(&found, &drawn);
        println!("relative RMSE {error:e}, {change} without");
        assert!(error <= FRAME_RELATIVE_RMSE, "relative RMSE {error}");
        assert!(change > 0.02, "it made no difference: {change}");
    }
    let many = vec![lamp; MAX_LOCAL_LIGHTS as usize + 1];
    let frame = Frame {
        local_lights: &many,
        ..plain
    };
    assert!(render(gpu, &frame, width, height).is_err());
    assert!(matches!(
        twin::render(&scenes::sphere_over_plane(), &frame, width, height),
        Err(Error::Frame(limit)) if limit.needed == u64::from(MAX_LOCAL_LIGHTS) + 1
    ));
    Ok(())
}

fn cells_match_twin(gpu: &mut Gpu) -> Outcome {
    let (width, height) = (64, 48);
    let mut lights = lights();
    // One that has cells of its own.
    lights[0].sharpness = 600.0;
    let image = stripes();
    let coarse = CellsOptions {
        boundary_error: 0.1,
        lobe_error: 0.1,
        uniform: None,
    };
    let even = CellsOptions {
        uniform: Some([2, 8]),
        ..coarse
    };
    let cells = |options| frame(&lights, Method::Cells(options));
    let mut drawn = Vec::new();
    for frame in [
        cells(coarse),
        cells(even),
        Frame {
            reflections: Some(&image),
            ..cells(even)
        },
    ] {
        let found = render(gpu, &frame, width, height)?.linear;
        let expected = twin::render(&scenes::sphere_over_plane(), &frame, width, height)?;
        let error = relative_rmse(&found, &expected);
        println!("{:?}: relative RMSE {error:e}", frame.method);
        assert!(error <= CELLS_RELATIVE_RMSE, "relative RMSE {error}");
        drawn.push(found);
    }
    assert!(relative_rmse(&drawn[0], &drawn[1]) > 1e-3);
    let polar = twin::render(
        &scenes::sphere_over_plane(),
        &frame(&lights, POLAR),
        width,
        height,
    )?;
    let error = relative_rmse(&drawn[0], &polar);
    assert!(error < 0.1, "cells are {error} from polar");
    Ok(())
}

fn tonemap_matches_twin(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    for exposure in [0.1, 1.0, 20.0] {
        let frame = Frame {
            exposure,
            ..frame(&lights, Method::Ambient)
        };
        let picture = render(gpu, &frame, 200, 150)?;
        let expected = twin::tonemap(&picture.linear, exposure);
        for (index, (a, b)) in picture.display.iter().zip(&expected).enumerate() {
            assert!(
                a.abs_diff(*b) <= DISPLAY_CODES,
                "byte {index}: GPU {a}, twin {b}"
            );
        }
        assert!(
            expected.chunks(4).any(|pixel| pixel[3] == 0),
            "no background"
        );
    }
    Ok(())
}

fn bands_do_not_show(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let frame = frame(&lights, Method::Ambient);
    let whole = render(gpu, &frame, 100, 101)?;
    let options = Options {
        rows_per_dispatch: Some(33),
        ..Options::default()
    };
    let bands = with_options(gpu, options, |gpu| render(gpu, &frame, 100, 101))?;
    assert!(whole == bands);
    parts_make_the_whole(gpu, &frame, &whole)
}

/// A frame that is submitted in parts is the one submitted whole.
fn parts_make_the_whole(gpu: &mut Gpu, frame: &Frame, whole: &Picture) -> Outcome {
    let size = [whole.linear.width, whole.linear.height];
    let scene = gpu.upload(&scenes::sphere_over_plane())?;
    let mut view = gpu.renderer.view(size)?;
    for rows in [0..8, 8..40, 40..90, 90..101] {
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let instances = [Instance::from(&scene)];
        (gpu.renderer).prepare_rows(&mut encoder, &mut view, &instances, frame, rows)?;
        gpu.queue.submit([encoder.finish()]);
    }
    let radiance = view.radiance().expect("a frame was recorded");
    let bytes = gpu.read_texture(radiance)?;
    let pixels: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&bytes);
    assert!(pixels == whole.linear.pixels);
    Ok(())
}

/// Runs with another renderer in place of the shared one.
fn with_options<T>(
    gpu: &mut Gpu,
    options: Options,
    run: impl FnOnce(&mut Gpu) -> Result<T, Failed>,
) -> Result<T, Failed> {
    let renderer = gpu.renderer.with_options(options)?;
    let shared = std::mem::replace(&mut gpu.renderer, renderer);
    let result = run(gpu);
    gpu.renderer = shared;
    result
}

fn one_encoder_holds_several_frames(gpu: &mut Gpu) -> Outcome {
    let size = [64, 48];
    let lights = lights();
    let scene = gpu.upload(&scenes::sphere_over_plane())?;
    let first = frame(&lights, Method::Ambient);
    let second = Frame {
        rotation: Quat::IDENTITY,
        exposure: 2.0,
        ..first.clone()
    };
    let expected = [&first, &second].map(|frame| gpu.render(&scene, frame, size[0], size[1]));
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let mut targets = Vec::new();
    for frame in [&first, &second] {
        let target = target(gpu, size, wgpu::TextureFormat::Rgba8Unorm);
        let view = target.create_view(&wgpu::TextureViewDescriptor::default());
        gpu.renderer
            .render(&mut encoder, &scene, frame, &view, size)?;
        targets.push(target);
    }
    gpu.queue.submit([encoder.finish()]);
    for (target, expected) in targets.iter().zip(expected) {
        assert!(gpu.read_texture(target)? == expected?.display);
    }
    Ok(())
}

fn target(gpu: &Gpu, size: [u32; 2], format: wgpu::TextureFormat) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d {
            width: size[0],
            height: size[1],
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}

fn srgb_targets_are_encoded_once(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let frame = frame(&lights, Method::Ambient);
    let plain = render(gpu, &frame, 64, 48)?.display;
    let options = Options {
        target_format: wgpu::TextureFormat::Rgba8UnormSrgb,
        ..Options::default()
    };
    let encoded = with_options(gpu, options, |gpu| render(gpu, &frame, 64, 48))?.display;
    for (a, b) in plain.iter().zip(&encoded) {
        assert!(
            a.abs_diff(*b) <= DISPLAY_CODES,
            "{a} without, {b} with an sRGB target"
        );
    }
    Ok(())
}

fn materials_change_without_upload(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let frame = frame(&lights, Method::Ambient);
    let mut scene = scenes::sphere_over_plane();
    let uploaded = gpu.upload(&scene)?;
    let before = gpu.render(&uploaded, &frame, 64, 48)?;
    scene.materials[1].surface = Surface::MetallicRoughness {
        base_color: [0.1, 0.8, 0.2],
        metallic: 1.0,
        roughness: 0.3,
        anisotropy_strength: 0.0,
        anisotropy_rotation: 0.0,
    };
    uploaded.set_material(1, &scene.materials[1])?;
    let after = gpu.render(&uploaded, &frame, 64, 48)?;
    assert!(before != after);
    let fresh = gpu.upload(&scene)?;
    assert!(after == gpu.render(&fresh, &frame, 64, 48)?);
    Ok(())
}

/// Whatever assets may hold, however little sense it makes: nothing is read beyond a buffer, no
/// kernel hangs, and the device draws the next picture as before.
fn any_valid_assets_are_drawn(gpu: &mut Gpu) -> Outcome {
    const ASSETS: u64 = 16;
    let draw = |gpu: &mut Gpu, scene: &Scene, environment: &Environment| {
        let light = EnvironmentLight::new(environment);
        let mut frame = Frame::under(scenes::camera(), &light);
        if let Some(camera) = scene.camera {
            frame.camera = camera.into();
        }
        let uploaded = gpu.upload(scene)?;
        for method in [Method::Polar(PolarOptions::STANDARD), Method::Ambient] {
            frame.method = method;
            match gpu.render(&uploaded, &frame, 24, 16) {
                // Cameras that see nothing.
                Ok(_) | Err(Error::Camera { .. }) => {}
                Err(error) => return Err(Failed::from(error)),
            }
        }
        Ok(())
    };
    let known = scenes::sphere_over_plane();
    let lit = frame(&[], Method::Ambient);
    let uploaded = gpu.upload(&known)?;
    let before = gpu.render(&uploaded, &lit, 24, 16)?;
    for seed in 0..ASSETS {
        let mut random = generate::Random::new(seed);
        let mut scene = generate::scene(&mut random);
        let environment = generate::environment(&mut random);
        // Extremes of what is allowed.
        for vertex in &mut scene.vertices {
            for x in &mut vertex.position {
                *x *= [1.0, 1e-30, 1e30, 0.0][random.below(4)];
            }
        }
        for value in &mut scene.coefficients {
            if random.below(4) == 0 {
                *value = [i16::MAX, -i16::MAX][random.below(2)];
            }
        }
        scene.validate()?;
        draw(gpu, &scene, &environment).map_err(|error| {
            Failed::from(format!("seed {seed}: {}", error.message().unwrap_or("?")))
        })?;
    }
    assert!(
        gpu.render(&uploaded, &lit, 24, 16)? == before,
        "another picture afterwards"
    );
    Ok(())
}

fn empty_scenes_are_background(gpu: &mut Gpu) -> Outcome {
    let scene = scenes::empty();
    let uploaded = gpu.upload(&scene)?;
    let frame = frame(&[], POLAR);
    let picture = gpu.render(&uploaded, &frame, 5, 3)?;
    assert!(picture.linear == twin::render(&scene, &frame, 5, 3)?);
    assert!(picture.display == [0; 5 * 3 * 4]);
    Ok(())
}

fn passes_are_timed(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let mut shade = Vec::new();
    for size in [40, 160] {
        let start = std::time::Instant::now();
        render(gpu, &frame(&lights, POLAR), size, size)?;
        let elapsed = start.elapsed();
        match gpu.renderer.pass_times() {
            Some(times) => {
                println!("{times:?} of {elapsed:?}");
                assert!(times.total() <= elapsed, "{times:?} of {elapsed:?}");
                shade.push(times.shade);
            }
            None => println!("the device has no timestamps"),
        }
    }
    // Sixteen times as many pixels.
    assert!(shade.windows(2).all(|pair| pair[1] > pair[0]), "{shade:?}");
    Ok(())
}

fn errors_name_what_is_wrong(gpu: &mut Gpu) -> Outcome {
    let mut scene = scenes::sphere_over_plane();
    let uploaded = gpu.upload(&scene)?;
    let mut material = scene.materials[0].clone();
    let error = uploaded
        .set_material(2, &material)
        .expect_err("two materials");
    assert!(matches!(
        error,
        Error::NoSuchMaterial { index: 2, count: 2 }
    ));
    material
        .base_color_texture
        .as_mut()
        .expect("a texture")
        .texture = 5;
    let error = uploaded
        .set_material(0, &material)
        .expect_err("two textures");
    assert!(error.to_string().contains("an existing texture"), "{error}");
    scene.materials[0] = material;
    assert!(matches!(gpu.upload(&scene), Err(Error::Asset(_))));
    let mut scene = scenes::sphere_over_plane();
    scene.triangles[7].vertices[1] = u32::MAX;
    assert!(matches!(gpu.upload(&scene), Err(Error::Asset(_))));
    let frame = frame(&[], Method::Ambient);
    let error = gpu.render(&uploaded, &frame, 0, 5).expect_err("no pixels");
    assert!(matches!(
        error,
        Error::EmptyImage {
            width: 0,
            height: 5
        }
    ));
    let error = gpu.render(&uploaded, &frame, 9000, 1);
    assert!(matches!(error, Err(Error::Frame(limit)) if limit.needed == 9000));
    Ok(())
}

fn limits_are_checked(_: &mut Gpu) -> Outcome {
    let few = wgpu::Limits {
        max_storage_buffer_binding_size: 30_000,
        ..wgpu::Limits::default()
    };
    let gpu = Gpu::new(&few)?;
    match gpu.upload(&scenes::sphere_over_plane()) {
        Err(Error::Scene(limit)) => {
            assert_eq!(limit.limit, "max_storage_buffer_binding_size");
            assert_eq!(limit.allowed, 30_000);
        }
        other => return Err(format!("uploaded in spite of limits: {other:?}").into()),
    }
    let few = wgpu::Limits {
        max_storage_buffers_per_shader_stage: 4,
        ..wgpu::Limits::default()
    };
    match Gpu::new(&few) {
        Err(Error::Device(limit)) => {
            assert_eq!(limit.limit, "max_storage_buffers_per_shader_stage");
        }
        other => return Err(format!("a renderer in spite of limits: {other:?}").into()),
    }
    let small = wgpu::Limits {
        max_uniform_buffer_binding_size: 16 << 10,
        ..wgpu::Limits::default()
    };
    match Gpu::new(&small) {
        Err(Error::Device(limit)) => {
            assert_eq!(limit.limit, "max_uniform_buffer_binding_size");
        }
        other => return Err(format!("a renderer in spite of limits: {other:?}").into()),
    }
    let many = wgpu::Limits {
        max_texture_dimension_2d: 1 << 30,
        ..wgpu::Limits::default()
    };
    assert!(matches!(Gpu::new(&many), Err(Error::NoAdapter { found }) if !found.is_empty()));
    Ok(())
}

/// A million triangles, 64 materials and 128 lights at WebGPU's default limits.
fn large_scenes_are_drawn(gpu: &mut Gpu) -> Outcome {
    let mut scene = scenes::sphere_over_plane();
    scene.materials = (0..64)
        .map(|index| Material {
            name: format!("material {index}"),
            ..scene.materials[index % 2].clone()
        })
        .collect();
    for (material, index) in scene.materials.iter_mut().zip(0u8..) {
        if let Surface::DiffuseSpecular { diffuse, .. } = &mut material.surface {
            *diffuse = [f32::from(index) / 64.0, 0.5, 1.0 - f32::from(index) / 64.0];
        }
    }
    let own = scene.triangles.len();
    for (index, triangle) in scene.triangles.iter_mut().enumerate() {
        triangle.material = (index % 64) as u16;
    }
    // Copies lie where their originals do, so that it does not matter which is drawn.
    scene.triangles = (0..300_000)
        .map(|index| scene.triangles[index % own])
        .collect();
    let lights: Vec<SphericalGaussian> = (0..128)
        .map(|index| {
            let height = 1.0 - (index as f32 + 0.5) / 80.0;
            let (sine, cosine) = (2.4 * index as f32).sin_cos();
            let radius = (1.0 - height * height).max(0.0).sqrt();
            SphericalGaussian {
                axis: Vec3::new(radius * cosine, height, radius * sine).normalize(),
                sharpness: 2.0 + index as f32,
                amplitude: Vec3::splat(0.05),
            }
        })
        .collect();
    let frame = frame(&lights, Method::Polar(PolarOptions::DRAFT));
    let uploaded = gpu.upload(&scene)?;
    let drawn = gpu.render(&uploaded, &frame, 64, 48)?.linear;
    let expected = twin::render(&scene, &frame, 64, 48)?;
    let error = relative_rmse(&drawn, &expected);
    println!("relative RMSE {error:e}");
    assert!(error < FRAME_RELATIVE_RMSE, "{error}");
    Ok(())
}

/// As windows do.
fn sizes_may_change(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let frame = frame(&lights, Method::Ambient);
    let first = render(gpu, &frame, 40, 30)?;
    let other = render(gpu, &frame, 70, 20)?;
    assert_eq!((other.linear.width, other.linear.height), (70, 20));
    let again = render(gpu, &frame, 40, 30)?;
    assert_eq!(first.linear.pixels, again.linear.pixels);
    Ok(())
}

/// Whatever is asked of a device that is gone is an error; a new one goes on where it ended.
fn lost_devices_are_errors(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let frame = frame(&lights, Method::Ambient);
    let scene = scenes::sphere_over_plane();
    let mut lost = Gpu::new(&wgpu::Limits::default())?;
    let uploaded = lost.upload(&scene)?;
    let before = lost.render(&uploaded, &frame, 40, 30)?;
    lost.device.destroy();
    for _ in 0..2 {
        match lost.render(&uploaded, &frame, 40, 30) {
            Err(Error::DeviceFailed(reason)) => println!("{reason}"),
            other => return Err(format!("drawn on a lost device: {}", other.is_ok()).into()),
        }
    }
    assert!(matches!(lost.upload(&scene), Err(Error::DeviceFailed(_))));
    assert_eq!(
        before.linear.pixels,
        render(gpu, &frame, 40, 30)?.linear.pixels
    );
    Ok(())
}
