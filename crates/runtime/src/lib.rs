//! The renderer that apps load, and the same stages on the CPU.
//!
//! Scenes are baked into `.relight` assets, environments (HDR images) into others, by
//! `relight-bake`; `relight-format` reads both. This crate draws them with an app's own `wgpu`
//! device: light and camera may change in every frame.
//!
//! # In a pass of your own
//!
//! A [`Renderer`] holds pipelines, a [`GpuScene`] is an asset on the GPU, a [`View`] holds the images of
//! one camera. [`Renderer::prepare`] shades, outside of any pass; [`Renderer::composite`] draws the
//! pixels in a pass of the app's, with its depth, samples, viewport and blending. [`Renderer::new`] takes what the
//! app's own pipelines have of these, as [`Options`].
//!
//! ```no_run
#![doc = include_str!("../examples/support/in_your_pass.rs")]
//! ```
//!
//! The example `own_pass` is an app around these lines, with objects of its own before and behind.
//!
//! [`Frame::background`] is drawn behind it all: a colour, or a [`Panorama`] of the environment or of the
//! app's own image, sharp or blurred, which turns with the light.
//!
//! Float targets get linear radiance times [`Frame::exposure`], others display colours ([`Output`]).
//! What is written is multiplied by its coverage. An app that wants a picture and nothing else calls
//! [`Renderer::render`], which clears and fills a target.
//!
//! # Over photographs
//!
//! A material with `shadow_catcher` is not drawn itself: pictures have the shadow that it receives as coverage,
//! and what reflections and bounced light add to it as colour, multiplied by coverage as everything is. Over the
//! plate that it would be with nothing around it they make what it is; [`relight_shading::catcher`] says it in
//! numbers, which are those that the target stores: linear, or as they are displayed. Such a scene holds
//! its geometry twice and costs twice its shading. Ray-traced truth knows nothing of it.
//!
//! # Several of everything
//!
//! - Cameras: a view each, prepared in any order into one encoder.
//! - Scenes and places: [`Renderer::prepare`] takes [`Instance`]s, each with a [`Placement`]. They hide
//!   one another. **They neither shadow nor light one another**: visibility is baked per scene. What
//!   must throw a shadow on something is baked with it, or drawn by the app into a [`ShadowMap`] of a sun, a lamp or a
//!   window: [`Frame::shadow_map`], with what else moves and is in no scene.
//! - Threads: renderers, scenes and lights may be shared. [`Renderer::upload_while`], which can be stopped, and
//!   [`EnvironmentLight::new`] take time and belong on a thread of their own. An asset is replaced by
//!   assigning the new scene to the old one; [`Renderer::upload_bytes`] says before what it takes.
//! - Materials and textures: [`GpuScene::set_material`] at any time; [`Renderer::set_texture`] puts an image of the app's in
//!   place of a texture of the asset: compressed, drawn by the app, a film.
//! - Targets: [`Renderer::with_options`] shares pipelines and scenes with a renderer for other passes.
//!
//! # For an app's own temporal antialiasing
//!
//! After [`Renderer::prepare`], [`Renderer::motion`] takes the camera and the placements of the frame before and fills
//! [`View::motion`]; [`View::depth`] is beside it. Jitter is in the projection matrix.
//!
//! # What may go wrong
//!
//! Calls return an [`Error`] that says what was expected and what was found. A pass that is not as
//! [`Options`] say cannot be seen by `composite`; `wgpu` reports it as an incompatible pipeline. On a device that
//! is lost calls fail with [`Error::DeviceFailed`], or do nothing; a renderer and an upload on a new one go on.
//!
//! # Versions
//!
//! The major version of this crate follows that of `wgpu`, which is re-exported: [`wgpu`], as is [`glam`], whose vectors
//! and matrices cameras and placements are made of. `relight-shading` has
//! the same stages as WGSL (`wgsl::source`, `wgsl::KERNELS`) and packed buffers (`pack::pack_scene`, `textures`) without
//! any type of `wgpu`, for engines on another version or API.
//! `public-api.txt` in the repository lists what may be named.
//!
//! # Features
//!
//! `vulkan` (on by default), `metal`, `dx12` and `webgpu` are those of `wgpu`: an app whose own `wgpu` has its
//! backends needs none of them.
//!
//! Without a GPU, `twin::render` draws the same frame (feature `twin`). `offscreen` opens a device and
//! waits for pictures, for tools and tests. Both are on by default; an app needs neither.
//!
//! `paper`, off by default, adds [`Method::Cells`], the integrator of Wang et al. (2013), to compare with. Without it
//! a frame that asks for cells is an [`Error::Feature`].

#![cfg_attr(
    target_family = "wasm",
    allow(
        clippy::arc_with_non_send_sync,
        reason = "pages have one thread; elsewhere the same handles are shared between threads"
    )
)]

mod background;
mod composite;
mod error;
mod fill_texture;
mod frame;
mod image;
mod images;
mod layouts;
mod loading;
mod lobes;
mod motion;
mod occluders;
#[cfg(feature = "offscreen")]
pub mod offscreen;
mod options;
mod owner;
mod pass_times;
mod placement;
mod renderer;
mod resources;
mod shadow_map;
mod tiles;
mod transfer;
#[cfg(feature = "twin")]
pub mod twin;
mod upload;
mod vertex_lights;
mod view;

pub use background::Background;
pub use error::Error;
pub use frame::{EnvironmentLight, Frame};
pub use image::Image;
pub use loading::UploadProgress;
pub use motion::Before;
pub use options::{Options, Output};
pub use pass_times::PassTimes;
pub use placement::{Instance, Placement};
pub use relight_shading::background::Panorama;
pub use relight_shading::camera::Viewpoint;
pub use relight_shading::gpu::{LimitError, MAX_LOCAL_LIGHTS};
pub use relight_shading::local_light::{LocalLight, Spot};
pub use relight_shading::polar::PolarOptions;
pub use relight_shading::prefiltered::Prefiltered;
pub use relight_shading::shade::{CellsOptions, Method};
pub use relight_shading::shadow_map::DepthImage;
pub use relight_shading::sources::Sources;
pub use relight_shading::spherical_gaussian::SphericalGaussian;
pub use renderer::Renderer;
pub use shadow_map::{Depths, ShadowMap};
pub use upload::GpuScene;
pub use view::View;
pub use {glam, wgpu};
