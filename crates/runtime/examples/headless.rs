//! A batch without window or device of its own: the light turns once around the scene, four pictures in
//! one strip. `offscreen` opens a device and waits for every picture.
//!
//!     cargo run --release -p relight-runtime --example headless SCENE.relight ENV.relight OUT.png

use std::error::Error;
use std::f32::consts::FRAC_PI_2;
use std::path::Path;

use glam::Quat;
use relight_runtime::offscreen::Gpu;
use relight_runtime::{EnvironmentLight, Frame, wgpu};

mod support;

const SIZE: [u32; 2] = [160, 120];

/// Draws and saves one picture.
pub fn run(scene: &Path, environment: &Path, picture: &Path) -> Result<(), Box<dyn Error>> {
    let (scene, environment) = support::read(scene, environment)?;
    let light = EnvironmentLight::new(&environment);
    let camera = scene.camera.ok_or("the scene has no camera")?;
    let mut gpu = Gpu::new(&wgpu::Limits::default())?;
    let uploaded = gpu.upload(&scene)?;
    let mut strip = Vec::new();
    for quarter in [0.0, 1.0, 2.0, 3.0] {
        let frame = Frame {
            rotation: Quat::from_rotation_y(quarter * FRAC_PI_2),
            antialias: true,
            ..Frame::under(camera, &light)
        };
        let drawn = gpu.render(&uploaded, &frame, SIZE[0], SIZE[1])?;
        // Also there: `drawn.linear`, the radiance.
        strip.extend(drawn.display);
    }
    let rows = 4 * SIZE[1];
    image::save_buffer(picture, &strip, SIZE[0], rows, image::ColorType::Rgba8)?;
    println!("{} on {}", picture.display(), gpu.name());
    Ok(())
}

#[allow(dead_code, reason = "tests call `run`")]
fn main() -> Result<(), Box<dyn Error>> {
    let [scene, environment, picture] = support::paths()?;
    run(&scene, &environment, &picture)
}
