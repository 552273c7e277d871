//! Assets that come and go while others are drawn.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use glam::{Quat, Vec3};
use relight_format::{Camera, FieldOfView};
use relight_runtime::offscreen::Gpu;
use relight_runtime::{Error, Frame, GpuScene, Instance, Method, Placement, View, wgpu};

use crate::textures::textured;
use crate::{Outcome, POLAR, frame, lights, scenes};

const SIZE: [u32; 2] = [96, 72];
/// Told before and found after: the hierarchy for rays is told with as many nodes as there can be.
const TOLD_TOO_MUCH: f64 = 1.25;
/// Of the time that one instance takes to draw and shade as many pixels as a thousand, on software Vulkan, which
/// runs every dispatch by itself, on a busy machine: 1.6 to 1.8 are measured.
const SLOWER: f64 = 6.0;

pub fn uploads_tell_and_stop(gpu: &mut Gpu) -> Outcome {
    let mut catching = scenes::sphere_over_plane();
    catching.materials[0].shadow_catcher = true;
    for scene in [scenes::empty(), scenes::noise(3), catching, textured(256)] {
        let told = gpu.renderer.upload_bytes(&scene)?;
        let mut steps = Vec::new();
        let whole = gpu.renderer.upload_while(&scene, &mut |progress| {
            steps.push(progress);
            true
        })?;
        assert!(steps.is_sorted_by_key(|step| step.bytes));
        let last = steps.last().expect("asked at least once");
        assert_eq!((last.bytes, last.at_most), (whole.bytes(), told));
        assert_eq!(whole.bytes(), gpu.upload(&scene)?.bytes());
        println!(
            "{} bytes, at most {told}, in {} steps",
            whole.bytes(),
            steps.len()
        );
        assert!(whole.bytes() <= told);
        if !scene.triangles.is_empty() {
            assert!(told as f64 <= TOLD_TOO_MUCH * whole.bytes() as f64);
        }
        let lights = lights();
        let frame = frame(&lights, POLAR);
        let expected = gpu.upload(&scene)?;
        let [found, expected] =
            [&whole, &expected].map(|scene| gpu.render(scene, &frame, SIZE[0], SIZE[1]));
        assert!(found? == expected?);
        for stop in [0, 1, steps.len() / 2, steps.len() - 1] {
            let mut asked = 0;
            let stopped = gpu.renderer.upload_while(&scene, &mut |_| {
                asked += 1;
                asked <= stop
            });
            assert!(matches!(stopped, Err(Error::Cancelled)), "{stop}");
            assert_eq!(asked, stop + 1, "asked again after it was stopped");
        }
    }
    Ok(())
}

/// Prepares and submits; radiance is read back.
fn draw(
    gpu: &Gpu,
    view: &mut View,
    instances: &[Instance],
    frame: &Frame,
) -> Result<Vec<u8>, Error> {
    submit(gpu, view, instances, frame)?;
    relight_runtime::offscreen::read_texture(
        &gpu.device,
        &gpu.queue,
        view.radiance().expect("prepared"),
    )
}

fn submit(gpu: &Gpu, view: &mut View, instances: &[Instance], frame: &Frame) -> Result<(), Error> {
    let encoder = prepare(gpu, view, instances, frame)?;
    gpu.queue.submit([encoder.finish()]);
    Ok(())
}

fn prepare(
    gpu: &Gpu,
    view: &mut View,
    instances: &[Instance],
    frame: &Frame,
) -> Result<wgpu::CommandEncoder, Error> {
    let descriptor = wgpu::CommandEncoderDescriptor::default();
    let mut encoder = gpu.device.create_command_encoder(&descriptor);
    gpu.renderer.prepare(&mut encoder, view, instances, frame)?;
    Ok(encoder)
}

/// A view draws what is in the scene's place now: smaller, larger, with other textures, and back.
pub fn scenes_are_replaced(gpu: &mut Gpu) -> Outcome {
    let lights = lights();
    let frame = frame(&lights, POLAR);
    let assets = [scenes::sphere_over_plane(), scenes::noise(5), textured(64)];
    let mut fresh = Vec::new();
    for asset in &assets {
        let scene = gpu.upload(asset)?;
        let mut view = gpu.renderer.view(SIZE)?;
        fresh.push(draw(gpu, &mut view, &[(&scene).into()], &frame)?);
    }
    assert!(fresh[0] != fresh[1] && fresh[1] != fresh[2]);
    let mut scene: GpuScene = gpu.upload(&assets[0])?;
    let mut view = gpu.renderer.view(SIZE)?;
    for index in [0, 1, 2, 0, 2, 1] {
        scene = gpu.renderer.upload_while(&assets[index], &mut |_| true)?;
        let twice = [Instance::from(&scene), Instance::from(&scene)];
        assert!(
            draw(gpu, &mut view, &twice[..1], &frame)? == fresh[index],
            "{index}"
        );
        assert!(
            draw(gpu, &mut view, &twice, &frame)? == fresh[index],
            "{index}, twice"
        );
    }
    drop(scene);
    Ok(())
}

/// What a thread that draws waits for calls of ours, and for its queue's submission: alone, beside a thread that does
/// anything, and beside an upload of 100 MiB. Told, not bounded: software Vulkan draws with the same processors,
/// and submits only once it has executed what was submitted before.
pub fn others_draw_meanwhile(gpu: &mut Gpu) -> Outcome {
    let large = textured(1024);
    let lights = lights();
    let frame = frame(&lights, Method::Ambient);
    let scene = gpu.upload(&scenes::sphere_over_plane())?;
    let mut view = gpu.renderer.view([32, 24])?;
    let instances = [Instance::from(&scene)];
    let expected = draw(gpu, &mut view, &instances, &frame)?;
    let gpu = &*gpu;
    let done = AtomicBool::new(false);
    let mut draw_until = |done: &dyn Fn() -> bool| -> Result<Vec<[Duration; 2]>, Error> {
        let mut waits = Vec::new();
        while !done() {
            let start = Instant::now();
            let encoder = prepare(gpu, &mut view, &instances, &frame)?;
            let prepared = start.elapsed();
            gpu.queue.submit([encoder.finish()]);
            waits.push([prepared, start.elapsed().saturating_sub(prepared)]);
            gpu.device
                .poll(wgpu::PollType::wait_indefinitely())
                .map_err(|error| Error::DeviceFailed(error.to_string()))?;
        }
        Ok(waits)
    };
    let end = Instant::now() + Duration::from_millis(500);
    let alone = draw_until(&|| Instant::now() > end)?;
    // What a thread waits for that has to share its processor.
    let end = Instant::now() + Duration::from_millis(500);
    let busy = std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut random = scenes::Random(1);
            let mut memory = vec![0u8; 1 << 20];
            while Instant::now() < end {
                memory.fill(random.next() as u8);
            }
            std::hint::black_box(&memory);
        });
        draw_until(&|| Instant::now() > end)
    })?;
    let (beside, uploaded) = std::thread::scope(|scope| {
        let loader = scope.spawn(|| {
            let uploaded = gpu.renderer.upload_while(&large, &mut |_| true);
            done.store(true, Ordering::Relaxed);
            uploaded
        });
        let beside = draw_until(&|| done.load(Ordering::Relaxed));
        (beside, loader.join().expect("no panic"))
    });
    let beside = beside?;
    for (name, waits) in [
        ("alone", &alone),
        ("beside a busy thread", &busy),
        ("beside an upload", &beside),
    ] {
        for (call, what) in [(0, "prepare"), (1, "submit")] {
            let mut times: Vec<Duration> = waits.iter().map(|wait| wait[call]).collect();
            times.sort_unstable();
            println!(
                "{name}: {} frames, to {what} takes {:?} (median), {:?} (95 of 100), {:?} (most)",
                times.len(),
                times[times.len() / 2],
                times[times.len() * 95 / 100],
                times[times.len() - 1]
            );
        }
    }
    println!("{} bytes", uploaded?.bytes());
    assert!(beside.len() > 3, "no frames while it was uploaded");
    assert!(draw(gpu, &mut view, &instances, &frame)? == expected);
    Ok(())
}

/// 1,000 instances of 20 assets on a grid, and one that covers as many pixels. On a card other things than pixels tell the
/// time of so few: each asset has dispatches of its own, one after the other, and an H200 takes 11 to 16 ms for the
/// visibility buffer of the grid's 1.5 million triangles. There it is printed only.
pub fn a_thousand_instances_cost_their_pixels(gpu: &mut Gpu) -> Outcome {
    let assets = (0..20)
        .map(|_| gpu.upload(&scenes::sphere_over_plane()))
        .collect::<Result<Vec<_>, _>>()?;
    let lights = lights();
    let camera = Camera {
        position: [0.0, 100.0, 0.01],
        target: [0.0; 3],
        up: [0.0, 0.0, -1.0],
        field_of_view: FieldOfView::Y(0.5),
    };
    let frame = Frame {
        camera: camera.into(),
        ..frame(&lights, Method::Ambient)
    };
    let side = 50.0f32;
    let cell = side / 32.0;
    let many: Vec<Instance> = (0..1000usize)
        .map(|i| Instance {
            scene: &assets[i % 20],
            placement: Placement {
                rotation: Quat::from_rotation_y(0.0),
                scale: cell / 4.2,
                translation: cell * Vec3::new((i % 32) as f32 - 15.5, 0.0, (i / 32) as f32 - 15.5),
            },
        })
        .collect();
    let one = [Instance {
        scene: &assets[0],
        placement: Placement {
            scale: side / 4.2 * (1000.0f32 / 1024.0).sqrt(),
            ..Placement::IDENTITY
        },
    }];
    let mut results = Vec::new();
    for (name, instances) in [("one", &one[..]), ("a thousand", &many)] {
        let mut view = gpu.renderer.view([320, 320])?;
        let pixels = draw(gpu, &mut view, instances, &frame)?;
        let covered = (pixels.chunks_exact(16))
            .filter(|pixel| pixel[12..] == 1f32.to_le_bytes())
            .count();
        let start = Instant::now();
        submit(gpu, &mut view, instances, &frame)?;
        let encode = start.elapsed();
        gpu.device.poll(wgpu::PollType::wait_indefinitely())?;
        let whole = start.elapsed();
        println!("{name}: {covered} pixels, {encode:?} to encode and submit, {whole:?} in all");
        results.push((covered as f64, whole.as_secs_f64()));
    }
    let [one, many] = results[..] else {
        unreachable!("two were measured");
    };
    assert!((many.0 / one.0 - 1.0).abs() < 0.1, "{many:?} {one:?}");
    assert!(
        !gpu.is_software() || many.1 < SLOWER * one.1,
        "{many:?} {one:?}"
    );
    Ok(())
}
