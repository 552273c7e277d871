//! Two cameras on one scene in one frame: a view for each, the second in a corner of the first, both
//! drawn in one pass.
//!
//!     cargo run --release -p relight-runtime --example picture_in_picture SCENE.relight ENV.relight OUT.png

use std::error::Error;
use std::path::Path;

use glam::{Vec3, camera::rh};
use relight_runtime::{EnvironmentLight, Frame, Instance, Options, Renderer, Viewpoint, wgpu};

mod support;

const SIZE: [u32; 2] = [400, 300];
/// Upper left corner and size of the second picture.
const CORNER: [u32; 2] = [280, 16];
const SMALL: [u32; 2] = [104, 104];

/// Draws and saves one picture.
pub fn run(scene: &Path, environment: &Path, picture: &Path) -> Result<(), Box<dyn Error>> {
    let (scene, environment) = support::read(scene, environment)?;
    let (device, queue) = support::device()?;
    let renderer = Renderer::new(&device, &queue, Options::default())?;
    let uploaded = renderer.upload(&scene)?;
    let instances = [Instance::from(&uploaded)];
    let light = EnvironmentLight::new(&environment);
    let mut large = renderer.view(SIZE)?;
    let mut small = renderer.view(SMALL)?;

    let aspect = SIZE[0] as f32 / SIZE[1] as f32;
    let perspective = Viewpoint::Matrices {
        view: rh::view::look_at_mat4(Vec3::new(1.2, 1.6, 3.2), 0.6 * Vec3::Y, Vec3::Y),
        projection: rh::proj::directx::perspective_infinite_reverse(0.8, aspect, 0.05),
    };
    // From above, as on a plan.
    let plan = Viewpoint::Matrices {
        view: rh::view::look_to_mat4(5.0 * Vec3::Y, -Vec3::Y, -Vec3::Z),
        projection: rh::proj::directx::orthographic(-2.0, 2.0, -2.0, 2.0, 0.1, 10.0),
    };
    let frame = |camera| Frame {
        antialias: true,
        ..Frame::under(camera, &light)
    };
    let target = support::attachment(&device, SIZE, renderer.options().target_format, 1);
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    renderer.prepare(&mut encoder, &mut large, &instances, &frame(perspective))?;
    renderer.prepare(&mut encoder, &mut small, &instances, &frame(plan))?;
    let drawn = support::whole(&target);
    let mut pass = support::pass(&mut encoder, &drawn, wgpu::Color::WHITE);
    renderer.composite(&large, &mut pass)?;
    let [x, y, width, height] =
        [CORNER[0], CORNER[1], SMALL[0], SMALL[1]].map(|pixels| pixels as f32);
    pass.set_viewport(x, y, width, height, 0.0, 1.0);
    renderer.composite(&small, &mut pass)?;
    drop(pass);
    queue.submit([encoder.finish()]);
    support::save(&device, &queue, &target, picture)
}

#[allow(dead_code, reason = "tests call `run`")]
fn main() -> Result<(), Box<dyn Error>> {
    let [scene, environment, picture] = support::paths()?;
    run(&scene, &environment, &picture)
}
