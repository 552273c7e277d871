//! Surfaces that catch shadows, by the GPU and by its twin.

use relight_format::Scene;
use relight_runtime::offscreen::{Gpu, Picture};
use relight_runtime::{Error, Frame, Image, Method, Options, twin, wgpu};
use relight_shading::catcher;

use crate::{FRAME_RELATIVE_RMSE, Outcome, POLAR, frame, lights, scenes, with_options};

const SIZE: [u32; 2] = [80, 60];
/// Most that the coverage of one pixel differs by between devices: a spoke that grazes a boundary counts for
/// one and not for the other.
const COVERAGE: f32 = 1e-2;
/// Of pictures laid over each other, as a part of their brightest radiance: roundings of a few sums.
const OVER: f32 = 1e-5;
/// The same in codes of eight bits: three of them are rounded.
const OVER_CODES: u8 = 2;

/// A sphere over a plane that is as it is, and one that catches shadows.
fn scenes_of_plane() -> [Scene; 2] {
    let scene = scenes::sphere_over_plane();
    let mut catching = scene.clone();
    catching.materials[0].shadow_catcher = true;
    [scene, catching]
}

fn draw(gpu: &mut Gpu, scene: &Scene, frame: &Frame) -> Result<Picture, Error> {
    let uploaded = gpu.upload(scene)?;
    gpu.render(&uploaded, frame, SIZE[0], SIZE[1])
}

/// One premultiplied picture over another.
fn over<'a>(above: &'a Image, below: &'a Image) -> impl Iterator<Item = [f32; 3]> + 'a {
    (above.pixels.iter().zip(&below.pixels))
        .map(|(a, b)| [0, 1, 2].map(|i| a[i] + (1.0 - a[3]) * b[i]))
}

/// What is caught, laid over the open picture, is the opaque one; on the GPU and on the processor.
pub fn catchers_match_twin(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let [opaque, catching] = scenes_of_plane();
    let plate = catcher::open_scene(&opaque);
    for (method, antialias) in [(POLAR, false), (POLAR, true), (Method::Ambient, false)] {
        let frame = Frame {
            antialias,
            ..frame(&lights, method)
        };
        let [opaque, caught, plate] =
            [&opaque, &catching, &plate].map(|scene| draw(gpu, scene, &frame));
        let (opaque, caught, plate) = (opaque?, caught?, plate?);
        let expected = twin::render(&catching, &frame, SIZE[0], SIZE[1])?;
        let most = (opaque.linear.pixels.iter().flatten()).fold(0f32, |a, b| a.max(*b));
        let (mut worst, mut squares, mut coverage) = (0f32, [0f64; 2], 0f32);
        let (mut shadowed, mut partly) = (0, 0);
        let rows = over(&caught.linear, &plate.linear).zip(&opaque.linear.pixels);
        for ((over, opaque), (found, expected)) in
            rows.zip(caught.linear.pixels.iter().zip(&expected.pixels))
        {
            coverage = coverage.max((found[3] - expected[3]).abs());
            for i in 0..3 {
                squares[0] += f64::from(found[i] - expected[i]).powi(2);
                squares[1] += f64::from(opaque[i]).powi(2);
            }
            shadowed += usize::from(found[3] > 0.5 && found[3] < 0.999);
            partly += usize::from(found[3] > 0.0 && found[3] < 0.5);
            if opaque[3] == 1.0 {
                let error = [0, 1, 2].map(|i| (over[i] - opaque[i]).abs() / most);
                worst = error.into_iter().fold(worst, f32::max);
            }
        }
        let error = (squares[0] / squares[1]).sqrt() as f32;
        println!(
            "{method:?}, antialias {antialias}: {shadowed} pixels in shadow, {partly} beside it, laid over \
             the open picture {worst:e} off, twin {error:e}, its coverage {coverage:e}"
        );
        assert!(shadowed > 50 && partly > 50);
        // A pixel with an edge has samples of the sphere, whose light the plate has less shadowed.
        let edges = if antialias { 1.0 } else { OVER };
        assert!(worst <= edges, "{worst}");
        assert!(error <= FRAME_RELATIVE_RMSE, "relative RMSE {error}");
        assert!(coverage <= COVERAGE, "{coverage}");
        if !antialias {
            let codes = caught.display.chunks(4).zip(plate.display.chunks(4));
            for ((above, below), opaque) in codes.zip(opaque.display.chunks(4)) {
                for i in 0..3 {
                    let kept = 255 - u32::from(above[3]);
                    let over = u32::from(above[i]) + (kept * u32::from(below[i]) + 127) / 255;
                    let off = (over as u8).abs_diff(opaque[i]);
                    assert!(
                        opaque[3] < 255 || off <= OVER_CODES,
                        "{above:?} {below:?} {opaque:?}"
                    );
                }
            }
        }
    }
    Ok(())
}

/// Shadows are caught into float targets, without blending, and switched without an upload.
pub fn catchers_are_switched(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let [opaque, catching] = scenes_of_plane();
    let frame = frame(&lights, Method::Ambient);
    let options = Options {
        target_format: wgpu::TextureFormat::Rgba32Float,
        blend: None,
        ..Options::default()
    };
    with_options(gpu, options, |gpu| {
        let picture = draw(gpu, &catching, &frame)?;
        let target: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&picture.display);
        for (target, linear) in target.iter().zip(&picture.linear.pixels) {
            let [r, g, b, coverage] = *linear;
            let expected = [r, g, b].map(|value| frame.exposure * value);
            for (found, expected) in target[..3].iter().zip(expected) {
                assert!((found - expected).abs() < 1e-4, "{target:?} {linear:?}");
            }
            assert!((target[3] - coverage).abs() < 1e-4, "{target:?} {linear:?}");
        }
        Ok(())
    })?;
    let uploaded = gpu.upload(&catching)?;
    uploaded.set_material(0, &opaque.materials[0])?;
    let switched = gpu.render(&uploaded, &frame, SIZE[0], SIZE[1])?;
    assert_eq!(switched.linear, draw(gpu, &opaque, &frame)?.linear);
    let never = gpu.upload(&opaque)?;
    let refused = never.set_material(0, &catching.materials[0]);
    assert!(matches!(refused, Err(Error::NoCatcher { index: 0 })));
    Ok(())
}
