//! The renderer that apps load, and the same stages on the CPU.
//!
//! An app brings its own `wgpu` device, queue, command encoder and target:
//!
//! ```no_run
//! # fn draw(
//! #     device: &wgpu::Device, queue: &wgpu::Queue, target: &wgpu::TextureView,
//! #     scene: &relight_format::Scene, environment: &relight_format::Environment,
//! # ) -> Result<(), relight_runtime::Error> {
//! use relight_runtime::{EnvironmentLight, Frame, Options, Renderer, wgpu};
//!
//! let mut renderer = Renderer::new(device, queue, Options::default())?;
//! let uploaded = renderer.upload(scene)?;
//! let light = EnvironmentLight::new(environment);
//! let camera = scene.camera.expect("this scene brings a camera");
//! let frame = Frame {
//!     rotation: glam::Quat::from_rotation_y(0.5),
//!     ..Frame::under(camera, &light)
//! };
//! let mut encoder = device.create_command_encoder(&Default::default());
//! renderer.render(&mut encoder, &uploaded, &frame, target, [1280, 720])?;
//! queue.submit([encoder.finish()]);
//! # Ok(())
//! # }
//! ```
//!
//! A device that is lost makes calls fail with [`Error::DeviceFailed`]; a renderer and an upload
//! on a new one go on from there. Targets may have another size in every call.
//!
//! Without a GPU, `twin::render` draws the same frame (feature `twin`). `offscreen` serves tools
//! and tests that have no device of their own (feature `offscreen`). Both features are on by
//! default; an app needs neither.

mod composite;
mod error;
mod frame;
#[cfg(any(feature = "offscreen", feature = "twin"))]
mod image;
mod occluders;
#[cfg(feature = "offscreen")]
pub mod offscreen;
mod options;
mod pass_times;
mod placement;
mod renderer;
mod resources;
mod transfer;
#[cfg(feature = "twin")]
pub mod twin;
mod upload;
mod vertex_lights;
mod view;

pub use error::Error;
pub use frame::{EnvironmentLight, Frame};
#[cfg(any(feature = "offscreen", feature = "twin"))]
pub use image::Image;
pub use options::{Options, Output};
pub use pass_times::PassTimes;
pub use placement::{Instance, Placement};
pub use relight_shading::camera::Viewpoint;
pub use relight_shading::cells::CellsOptions;
pub use relight_shading::gpu::{LimitError, MAX_LOCAL_LIGHTS};
pub use relight_shading::local_light::{LocalLight, Spot};
pub use relight_shading::polar::PolarOptions;
pub use relight_shading::prefiltered::Prefiltered;
pub use relight_shading::shade::Method;
pub use relight_shading::sources::Sources;
pub use relight_shading::spherical_gaussian::SphericalGaussian;
pub use renderer::Renderer;
pub use upload::GpuScene;
pub use view::View;
pub use wgpu;
