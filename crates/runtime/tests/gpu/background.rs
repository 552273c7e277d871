//! What is drawn behind scenes, by the GPU and by its twin.

use glam::{Quat, Vec3};
use relight_runtime::offscreen::Gpu;
use relight_runtime::{Background, Frame, Method, Options, Panorama, twin, wgpu};

use crate::engine::{matrices, projections};
use crate::{DISPLAY_CODES, Outcome, frame, lights, render, scenes, with_options};

const SIZE: [u32; 2] = [80, 60];
/// Of the brightest channel: a few roundings of rays and weights, magnified by the image's steps, which
/// fall by all of its range from one texel to the next here.
const TOLERANCE: f32 = 2e-5;

/// Rings and sectors, the brightest 40 times as bright as the darkest.
fn image() -> Panorama {
    let [width, height] = [64u32, 32];
    let pixel = |index: u32| {
        let (x, y) = ((index % width) as f32, (index / width) as f32);
        [0.2, 0.7, 1.9].map(|phase| (1.8 * ((0.4 * x + phase).sin() + (0.3 * y).cos())).exp())
    };
    let pixels: Vec<_> = (0..width * height).map(pixel).collect();
    Panorama::from_lat_long([width, height], &pixels).expect("an image")
}

/// Every kind of camera, with and without antialiasing: behind what is seen there is the image.
pub fn backgrounds_match_twin(gpu: &mut Gpu) -> Outcome {
    let (lights, image) = (lights(), image());
    let linear = Options {
        target_format: wgpu::TextureFormat::Rgba32Float,
        blend: None,
        ..Options::default()
    };
    let backgrounds = [
        Background::sharp(&image),
        Background::blurred(&image),
        Background::Color(Vec3::new(0.1, 0.5, 2.0)),
    ];
    let (mut worst, mut behind, mut mixed) = (0.0f32, 0, 0);
    for (index, (name, projection)) in projections().into_iter().enumerate() {
        let frame = Frame {
            camera: matrices(projection),
            antialias: index % 2 == 0,
            background: backgrounds[index / 2 % 3],
            rotation: Quat::from_rotation_x(0.5) * Quat::from_rotation_y(0.1 * index as f32),
            ..frame(&lights, Method::Ambient)
        };
        let (scene, found) = with_options(gpu, linear.clone(), |gpu| {
            let picture = render(gpu, &frame, SIZE[0], SIZE[1])?;
            let found: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&picture.display);
            Ok((picture.linear, found))
        })?;
        let expected = twin::background(&frame, SIZE)?;
        for (index, (scene, (found, expected))) in
            (scene.pixels.iter().zip(found.iter().zip(&expected.pixels))).enumerate()
        {
            behind += usize::from(scene[3] == 0.0);
            mixed += usize::from(scene[3] > 0.0 && scene[3] < 1.0);
            let most = expected[..3].iter().copied().fold(0.01, f32::max);
            for channel in 0..3 {
                let over = scene[channel] + (1.0 - scene[3]) * expected[channel];
                let error = (found[channel] - frame.exposure * over).abs() / most.max(over);
                worst = worst.max(error);
                assert!(
                    error <= TOLERANCE,
                    "{name}, pixel {index}: {found:?} over {expected:?}, {error}"
                );
            }
            assert!((found[3] - 1.0).abs() < 1e-6, "{found:?}");
        }
    }
    println!("{behind} pixels behind, {mixed} mixed, error {worst:e}");
    assert!(behind > 10_000 && mixed > 300);

    // As people see it; of a pinhole.
    for background in backgrounds {
        let frame = Frame {
            background,
            ..frame(&lights, Method::Ambient)
        };
        let found = render(gpu, &frame, SIZE[0], SIZE[1])?;
        let expected = twin::display(&found.linear, &frame)?;
        for (found, expected) in found.display.iter().zip(&expected) {
            assert!(found.abs_diff(*expected) <= DISPLAY_CODES);
        }
    }
    Ok(())
}

/// A view of nothing shows the background; images may change from frame to frame.
pub fn backgrounds_need_no_scene(gpu: &mut Gpu) -> Outcome {
    let (lights, first) = (lights(), image());
    let second = Panorama::from_lat_long([1, 1], &[[0.25; 3]]).expect("an image");
    let empty = gpu.upload(&scenes::empty())?;
    let mut found = Vec::new();
    for background in [
        Background::sharp(&first),
        Background::sharp(&second),
        Background::Color(Vec3::splat(0.25)),
        Background::Transparent,
    ] {
        let frame = Frame {
            background,
            ..frame(&lights, Method::Ambient)
        };
        found.push(gpu.render(&empty, &frame, 24, 16)?.display);
    }
    assert_ne!(found[0], found[1]);
    assert_eq!(found[1], found[2]);
    assert!(found[3].iter().all(|&value| value == 0));
    Ok(())
}
