//! Pictures all around: of the scene, or of its light.

use std::f32::consts::TAU;
use std::path::Path;

use anyhow::{Context as _, bail};
use glam::Quat;
use relight_format::Camera;

use crate::compose::{self, Look, Sky};
use crate::engine::{Artist, Device, Shot};
use crate::jobs::{Context, Loaded};
use crate::orbit::Orbit;
use crate::save;
use crate::state::Light;

/// Most frames of an animation: a minute of them.
pub const MAX_FRAMES: u32 = 1800;

/// What turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// The camera, about its target.
    Camera,
    /// The distant light.
    Light,
}

/// What to draw.
#[derive(Clone, Debug)]
pub struct Turntable {
    /// What turns.
    pub turn: Turn,
    /// Pictures of one whole turn.
    pub frames: u32,
    /// Pictures per second of the animated file.
    pub rate: u16,
    /// Of a picture, pixels.
    pub size: [u32; 2],
}

impl Default for Turntable {
    fn default() -> Self {
        Self {
            turn: Turn::Light,
            frames: 48,
            rate: 24,
            size: [640, 480],
        }
    }
}

/// One frame's shot: `shot`, turned.
pub fn turned(shot: &Shot, turn: Turn, part: f32) -> Shot {
    let mut shot = shot.clone();
    match turn {
        Turn::Camera => shot.camera = around(&shot.camera, part),
        Turn::Light => shot.rotation = Quat::from_rotation_y(TAU * part) * shot.rotation,
    }
    shot
}

/// A camera that went a part of the way around its target.
fn around(camera: &Camera, part: f32) -> Camera {
    let orbit = Orbit::new(camera);
    let yaw = orbit.yaw + TAU * part;
    Orbit { yaw, ..orbit }.camera()
}

/// Draws all frames into `folder` as `frame-0000.png` and so on, and as one animated file,
/// `turntable.png`.
pub fn draw(
    options: &Turntable,
    shot: &Shot,
    light: &Light,
    look: &Look,
    folder: &Path,
    device: Device,
    context: &Context,
) -> anyhow::Result<()> {
    if !(1..=MAX_FRAMES).contains(&options.frames) {
        bail!(
            "frames: expected 1 to {MAX_FRAMES}, found {}",
            options.frames
        );
    }
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let mut artist = Artist::open(device);
    let mut drawn = Vec::new();
    for index in 0..options.frames {
        let part = index as f32 / options.frames as f32;
        context.monitor.step("draw frames", part)?;
        let shot = turned(shot, options.turn, part);
        let pixels = still(&mut artist, &shot, light, look, options.size, 1)?;
        save::png(
            &folder.join(format!("frame-{index:04}.png")),
            options.size,
            &pixels,
        )?;
        drawn.push(pixels);
    }
    let frames: Vec<&[u8]> = drawn.iter().map(Vec::as_slice).collect();
    let animated = folder.join("turntable.png");
    let bytes = save::encode_png(options.size, &frames, options.rate)?;
    relight_format::write_file(&animated, &bytes)?;
    (context.deliver)(Loaded::Saved(format!(
        "{} frames and {}",
        options.frames,
        animated.display()
    )));
    Ok(())
}

/// One picture, composed; of the ray tracer the mean of `passes` passes.
pub fn still(
    artist: &mut Artist,
    shot: &Shot,
    light: &Light,
    look: &Look,
    size: [u32; 2],
    passes: u32,
) -> anyhow::Result<Vec<u8>> {
    let image = artist
        .finished(shot, size, passes)
        .map_err(anyhow::Error::msg)?;
    let sky = Sky {
        panorama: light.panorama.as_ref(),
        rotation: shot.rotation,
    };
    Ok(compose::compose(
        [Some(&image), None],
        look,
        &sky,
        &shot.camera,
        size,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight_format::FieldOfView;

    #[test]
    fn half_a_turn_is_the_other_side() {
        let camera = Camera {
            position: [1.0, 2.0, 3.0],
            target: [0.0, 2.0, 0.0],
            up: [0.0, 1.0, 0.0],
            field_of_view: FieldOfView::Y(0.5),
        };
        let other = around(&camera, 0.5);
        for (found, expected) in other.position.into_iter().zip([-1.0, 2.0, -3.0]) {
            assert!((found - expected).abs() < 1e-5, "{other:?}");
        }
    }
}
