use std::error::Error;
use std::path::Path;

use relight_format::{Limits, read_environment, read_scene};
use relight_runtime::{EnvironmentLight, Frame, GpuScene, Options, Renderer, View, Viewpoint};
use relight_runtime::{glam::Mat4, wgpu};

pub struct Relit {
    pub renderer: Renderer,
    scene: GpuScene,
    light: EnvironmentLight,
    view: View,
}

impl Relit {
    /// Once. The options say what the app's passes look like, as for a pipeline of its own.
    pub fn new(
        (device, queue): (&wgpu::Device, &wgpu::Queue),
        size: [u32; 2],
        [scene, environment]: [&Path; 2],
    ) -> Result<Self, Box<dyn Error>> {
        let options = Options {
            target_format: wgpu::TextureFormat::Rgba8UnormSrgb,
            depth_stencil: Some(wgpu::DepthStencilState {
                format: wgpu::TextureFormat::Depth32Float,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Greater), // Less: not reversed
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState {
                count: 4,
                ..Default::default()
            },
            ..Options::default()
        };
        let renderer = Renderer::new(device, queue, options)?;
        let scene = read_scene(&std::fs::read(scene)?, &Limits::default())?;
        let environment = read_environment(&std::fs::read(environment)?, &Limits::default())?;
        Ok(Self {
            scene: renderer.upload(&scene)?,
            light: EnvironmentLight::new(&environment),
            view: renderer.view(size)?,
            renderer,
        })
    }

    /// Every frame before the pass, with the matrices that everything else is drawn with.
    pub fn prepare(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        [look, projection]: [Mat4; 2],
    ) -> Result<(), relight_runtime::Error> {
        let camera = Viewpoint::Matrices {
            view: look,
            projection,
        };
        let frame = Frame {
            antialias: true,
            ..Frame::under(camera, &self.light)
        };
        (self.renderer).prepare(encoder, &mut self.view, &[(&self.scene).into()], &frame)
    }

    /// In the pass: opaque objects before, for smooth edges over them; transparent ones after.
    pub fn draw(&self, pass: &mut wgpu::RenderPass) -> Result<(), relight_runtime::Error> {
        self.renderer.composite(&self.view, pass)
    }
}
