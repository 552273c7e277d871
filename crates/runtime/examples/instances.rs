//! Many instances of one scene in one frame: turned, moved, scaled, each under the same light as the
//! world has it. They hide one another; they neither shadow nor light one another.
//!
//!     cargo run --release -p relight-runtime --example instances SCENE.relight ENV.relight OUT.png

use std::error::Error;
use std::path::Path;

use glam::{Quat, Vec3, camera::rh};
use relight_runtime::{
    EnvironmentLight, Frame, Instance, Options, Placement, Renderer, Viewpoint, wgpu,
};

mod support;

const SIZE: [u32; 2] = [400, 300];
/// Instances per row, and rows.
const COUNT: [u16; 2] = [6, 5];

/// Draws and saves one picture.
pub fn run(scene: &Path, environment: &Path, picture: &Path) -> Result<(), Box<dyn Error>> {
    let (scene, environment) = support::read(scene, environment)?;
    let (device, queue) = support::device()?;
    let renderer = Renderer::new(&device, &queue, Options::default())?;
    let uploaded = renderer.upload(&scene)?;
    let light = EnvironmentLight::new(&environment);
    let mut view = renderer.view(SIZE)?;

    // The scene is uploaded once, whatever the number of places that it stands in.
    let cells = (0..COUNT[1]).flat_map(|row| (0..COUNT[0]).map(move |column| [column, row]));
    let instances: Vec<Instance> = cells
        .zip(0u16..)
        .map(|(cell, index)| Instance {
            scene: &uploaded,
            placement: Placement {
                rotation: Quat::from_rotation_y(0.7 * f32::from(index)),
                translation: Vec3::new(
                    5.0 * (f32::from(cell[0]) - 2.5),
                    0.0,
                    -5.0 * f32::from(cell[1]),
                ),
                scale: 0.6 + 0.03 * f32::from(index % 9),
            },
        })
        .collect();

    let aspect = SIZE[0] as f32 / SIZE[1] as f32;
    let camera = Viewpoint::Matrices {
        view: rh::view::look_at_mat4(Vec3::new(0.0, 7.0, 9.0), Vec3::new(0.0, 0.0, -4.0), Vec3::Y),
        projection: rh::proj::directx::perspective_infinite_reverse(0.9, aspect, 0.1),
    };
    let frame = Frame {
        antialias: true,
        ..Frame::under(camera, &light)
    };
    let target = support::attachment(&device, SIZE, renderer.options().target_format, 1);
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    renderer.prepare(&mut encoder, &mut view, &instances, &frame)?;
    let drawn = support::whole(&target);
    let mut pass = support::pass(&mut encoder, &drawn, wgpu::Color::WHITE);
    renderer.composite(&view, &mut pass)?;
    drop(pass);
    queue.submit([encoder.finish()]);
    support::save(&device, &queue, &target, picture)
}

#[allow(dead_code, reason = "tests call `run`")]
fn main() -> Result<(), Box<dyn Error>> {
    let [scene, environment, picture] = support::paths()?;
    run(&scene, &environment, &picture)
}
