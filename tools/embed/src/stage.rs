//! The renderer behind a web page: assets in as bytes, pictures out on a canvas by WebGPU.
//!
//! `web/page.js` is the other half: it takes input, fetches files and decides which part of which
//! picture is drawn next, so that the page answers while a picture takes seconds.

use glam::Quat;
use js_sys::{Float32Array, Promise};
use relight_format::{Camera, FieldOfView, Kind, Limits, Scene};
use relight_runtime::{
    EnvironmentLight, Frame, GpuScene, Instance, Method, Options, PolarOptions, Renderer, View,
    wgpu,
};
use wasm_bindgen::prelude::wasm_bindgen;
use wasm_bindgen::{JsCast as _, JsError, JsValue};
use wasm_bindgen_futures::{JsFuture, future_to_promise};
use web_sys::HtmlCanvasElement;

use crate::orbit::Orbit;
use crate::plain_sky;

/// Side of the view before the canvas has a size.
const SIDE: u32 = 16;

/// A canvas, a device, and what is shown.
#[wasm_bindgen]
pub struct Stage {
    canvas: HtmlCanvasElement,
    surface: wgpu::Surface<'static>,
    format: wgpu::TextureFormat,
    renderer: Renderer,
    view: View,
    scene: Option<Shown>,
    light: EnvironmentLight,
    orbit: Orbit,
    yaw: f32,
    pitch: f32,
    method: Method,
    /// Stops.
    exposure: f32,
    image_reflections: bool,
}

struct Shown {
    /// Kept for another upload, with or without light that bounces.
    scene: Scene,
    uploaded: GpuScene,
    low: glam::Vec3,
    high: glam::Vec3,
}

#[wasm_bindgen]
extern "C" {
    /// The browser's.
    #[wasm_bindgen(js_namespace = console, js_name = error)]
    fn console_error(text: &str);
}

fn failed(error: impl std::fmt::Display) -> JsError {
    JsError::new(&error.to_string())
}

#[wasm_bindgen]
impl Stage {
    /// Opens a device that draws on the canvas; rejected with the reason where there is none.
    pub async fn open(canvas: HtmlCanvasElement) -> Result<Stage, JsError> {
        // All that a page sees of a panic otherwise is that something unreachable was reached.
        std::panic::set_hook(Box::new(|panic| console_error(&panic.to_string())));
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let surface = instance
            .create_surface(wgpu::SurfaceTarget::Canvas(canvas.clone()))
            .map_err(failed)?;
        let adapter = instance
            .request_adapter(&wgpu::RequestAdapterOptions {
                power_preference: wgpu::PowerPreference::HighPerformance,
                compatible_surface: Some(&surface),
                ..Default::default()
            })
            .await
            .map_err(failed)?;
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                label: Some("relight page"),
                ..Default::default()
            })
            .await
            .map_err(failed)?;
        let formats = surface.get_capabilities(&adapter).formats;
        // The renderer encodes sRGB itself.
        let format = (formats.iter().copied())
            .find(|format| !format.is_srgb())
            .or_else(|| formats.first().copied())
            .ok_or_else(|| JsError::new("the canvas takes no pictures of this device"))?;
        let options = Options {
            target_format: format,
            ..Options::default()
        };
        let renderer = Renderer::new(&device, &queue, options).map_err(failed)?;
        let view = renderer.view([SIDE, SIDE]).map_err(failed)?;
        Ok(Stage {
            canvas,
            surface,
            format,
            renderer,
            view,
            scene: None,
            light: EnvironmentLight::new(&plain_sky()),
            orbit: Orbit::new(&Camera {
                position: [0.55, 0.4, 1.0],
                target: [0.0; 3],
                up: [0.0, 1.0, 0.0],
                field_of_view: FieldOfView::Y(40f32.to_radians()),
            }),
            yaw: 0.0,
            pitch: 0.0,
            method: Method::Polar(PolarOptions::STANDARD),
            exposure: 0.0,
            image_reflections: true,
        })
    }

    /// Takes a scene or environment asset and returns a line about it. What was shown stays where
    /// the bytes are not what they should be.
    pub fn load(&mut self, bytes: &[u8]) -> Result<String, JsError> {
        let limits = Limits::default();
        let (kind, ..) = relight_format::inspect(bytes, &limits).map_err(failed)?;
        match kind {
            Kind::Scene => {
                let scene = relight_format::read_scene(bytes, &limits).map_err(failed)?;
                let line = format!("{}: {} triangles", scene.name, scene.triangles.len());
                let uploaded = self.renderer.upload(&scene).map_err(failed)?;
                let (low, high) = crate::pick::bounds(&scene, None)
                    .ok_or_else(|| JsError::new("there is nothing in this scene"))?;
                self.orbit = match scene.camera {
                    Some(camera) => Orbit::new(&camera),
                    None => self.orbit.framing(low, high, self.aspect()),
                };
                self.scene = Some(Shown {
                    scene,
                    uploaded,
                    low,
                    high,
                });
                Ok(line)
            }
            Kind::Environment => {
                let environment =
                    relight_format::read_environment(bytes, &limits).map_err(failed)?;
                self.light = EnvironmentLight::new(&environment);
                let name = &environment.report.source;
                Ok(format!("{name}: {} lobes", environment.lobes.len()))
            }
            Kind::Material => Err(JsError::new(
                "a material: scenes and environments can be shown",
            )),
        }
    }

    /// Whether there is a scene to draw.
    pub fn is_ready(&self) -> bool {
        self.scene.is_some()
    }

    /// Whether the scene has light that bounces.
    pub fn bounces(&self) -> bool {
        (self.scene.as_ref()).is_some_and(|shown| shown.scene.transfer.is_some())
    }

    /// Shows light that bounces or leaves it out.
    pub fn set_bounce(&mut self, bounce: bool) -> Result<(), JsError> {
        if let Some(shown) = &mut self.scene {
            let transfer = shown.scene.transfer.take();
            let direct = (!bounce).then(|| self.renderer.upload(&shown.scene));
            shown.scene.transfer = transfer;
            let uploaded = direct.unwrap_or_else(|| self.renderer.upload(&shown.scene));
            shown.uploaded = uploaded.map_err(failed)?;
        }
        Ok(())
    }

    /// Turns the camera by a drag, in fractions of the picture's height.
    pub fn turn_camera(&mut self, x: f32, y: f32) {
        self.orbit = self.orbit.turned(x, y);
    }

    /// Moves the camera by a drag, in fractions of the picture's height.
    pub fn move_camera(&mut self, x: f32, y: f32) {
        self.orbit = self.orbit.panned(x, y, self.aspect());
    }

    /// Comes closer by a factor above 1.
    pub fn dolly(&mut self, factor: f32) {
        self.orbit = self.orbit.dollied(factor);
    }

    /// Shows all of the scene.
    pub fn frame(&mut self) {
        if let Some(shown) = &self.scene {
            self.orbit = self.orbit.framing(shown.low, shown.high, self.aspect());
        }
    }

    /// Turns the light by angles, radians: about +Y, then about +X.
    pub fn turn_light(&mut self, yaw: f32, pitch: f32) {
        self.yaw = (self.yaw + yaw).rem_euclid(std::f32::consts::TAU);
        self.pitch = (self.pitch + pitch).clamp(-1.5, 1.5);
    }

    /// Stops of exposure.
    pub fn set_exposure(&mut self, stops: f32) {
        self.exposure = stops.clamp(-20.0, 20.0);
    }

    /// Whether specular lobes reflect the environment's image.
    pub fn set_image_reflections(&mut self, image_reflections: bool) {
        self.image_reflections = image_reflections;
    }

    /// How light is integrated: `ambient`, `draft`, `polar` or `high`; whether there is such a
    /// method.
    pub fn set_method(&mut self, name: &str) -> bool {
        self.method = match name {
            "ambient" => Method::Ambient,
            "draft" => Method::Polar(PolarOptions::DRAFT),
            "polar" => Method::Polar(PolarOptions::STANDARD),
            "high" => Method::Polar(PolarOptions::HIGH),
            _ => return false,
        };
        true
    }

    /// Shades the bands that begin within some rows of a picture of this size. The part that begins
    /// with row 0 comes first; until the last one nothing but parts may be asked for.
    pub fn draw_rows(
        &mut self,
        width: u32,
        height: u32,
        first: u32,
        rows: u32,
    ) -> Result<(), JsError> {
        let Some(shown) = &self.scene else {
            return Ok(());
        };
        (self.view.resize(&self.renderer, [width, height])).map_err(failed)?;
        let light = &self.light;
        let frame = Frame {
            reflections: light.image().filter(|_| self.image_reflections),
            rotation: Quat::from_rotation_x(self.pitch) * Quat::from_rotation_y(self.yaw),
            method: self.method,
            exposure: self.exposure.exp2(),
            ..Frame::under(self.orbit.camera(), light)
        };
        let mut encoder = self.encoder();
        let instances = [Instance::from(&shown.uploaded)];
        let rows = first..first.saturating_add(rows);
        (self.renderer)
            .prepare_rows(&mut encoder, &mut self.view, &instances, &frame, rows)
            .map_err(failed)?;
        self.renderer.queue().submit([encoder.finish()]);
        Ok(())
    }

    /// Puts the picture on the canvas, which gets its size: the page stretches it.
    pub fn present(&mut self) -> Result<(), JsError> {
        use wgpu::CurrentSurfaceTexture::{Suboptimal, Success};
        let [width, height] = self.view.size();
        if [self.canvas.width(), self.canvas.height()] != [width, height] {
            self.canvas.set_width(width);
            self.canvas.set_height(height);
        }
        let configuration = self.configuration(width, height);
        (self.surface).configure(self.renderer.device(), &configuration);
        let current = self.surface.get_current_texture();
        let (Success(texture) | Suboptimal(texture)) = current else {
            // The next picture comes soon.
            return Ok(());
        };
        let target = texture
            .texture
            .create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = self.encoder();
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("relight page"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            self.renderer
                .composite(&self.view, &mut pass)
                .map_err(failed)?;
        }
        self.renderer.queue().submit([encoder.finish()]);
        self.renderer.queue().present(texture);
        Ok(())
    }

    /// Resolved once the device has done all it was asked for.
    pub fn finished(&self) -> Promise {
        Promise::new(&mut |resolve, _| {
            (self.renderer.queue()).on_submitted_work_done(move || {
                // The page may have gone on.
                let _ = resolve.call0(&JsValue::UNDEFINED);
            });
        })
    }

    /// Linear radiance times coverage, and coverage, of the last picture: a `Float32Array`, row 0
    /// first.
    pub fn pixels(&self) -> Result<Promise, JsError> {
        let radiance = (self.view.radiance()).ok_or_else(|| JsError::new("nothing is drawn"))?;
        let [width, height] = self.view.size();
        let row = 16 * width;
        let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = (self.renderer.device()).create_buffer(&wgpu::BufferDescriptor {
            label: Some("relight pixels"),
            size: u64::from(padded) * u64::from(height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = self.encoder();
        encoder.copy_texture_to_buffer(
            radiance.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(padded),
                    rows_per_image: None,
                },
            },
            radiance.size(),
        );
        self.renderer.queue().submit([encoder.finish()]);
        let mapped = Promise::new(&mut |resolve, reject| {
            buffer.map_async(wgpu::MapMode::Read, .., move |result| {
                let told = if result.is_ok() { resolve } else { reject };
                // The page may have gone on.
                let _ = told.call0(&JsValue::UNDEFINED);
            });
        });
        Ok(future_to_promise(async move {
            JsFuture::from(mapped).await?;
            let range = buffer
                .get_mapped_range(..)
                .map_err(|error| JsValue::from(failed(error)))?;
            let mut pixels: Vec<f32> = Vec::with_capacity(4 * width as usize * height as usize);
            for line in range.chunks_exact(padded as usize) {
                pixels.extend(bytemuck::pod_collect_to_vec::<u8, f32>(
                    &line[..row as usize],
                ));
            }
            Ok(Float32Array::from(&pixels[..]).unchecked_into())
        }))
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        (self.renderer.device()).create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    fn aspect(&self) -> f32 {
        self.canvas.client_width().max(1) as f32 / self.canvas.client_height().max(1) as f32
    }

    fn configuration(&self, width: u32, height: u32) -> wgpu::SurfaceConfiguration {
        wgpu::SurfaceConfiguration {
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            format: self.format,
            color_space: wgpu::SurfaceColorSpace::default(),
            width,
            height,
            present_mode: wgpu::PresentMode::Fifo,
            desired_maximum_frame_latency: 2,
            alpha_mode: wgpu::CompositeAlphaMode::PreMultiplied,
            view_formats: Vec::new(),
        }
    }
}
