use relight_format::{Limits, read_environment, read_scene};
use relight_runtime::{EnvironmentLight, Frame, GpuScene, Renderer, View, Viewpoint};
use relight_runtime::{Error, glam::Mat4, wgpu};

pub struct Relit {
    scene: GpuScene,
    light: EnvironmentLight,
    view: View,
}

impl Relit {
    /// Once, of the bytes of both assets.
    pub fn new(
        renderer: &Renderer,
        size: [u32; 2],
        [scene, environment]: [&[u8]; 2],
    ) -> Result<Self, Box<dyn std::error::Error>> {
        let environment = read_environment(environment, &Limits::default())?;
        Ok(Self {
            scene: renderer.upload(&read_scene(scene, &Limits::default())?)?,
            light: EnvironmentLight::new(&environment),
            view: renderer.view(size)?,
        })
    }

    /// Every frame before the pass, with the matrices that everything else is drawn with.
    pub fn prepare(
        &mut self,
        renderer: &Renderer,
        encoder: &mut wgpu::CommandEncoder,
        [view, projection]: [Mat4; 2],
    ) -> Result<(), Error> {
        let mut frame = Frame::under(Viewpoint::Matrices { view, projection }, &self.light);
        frame.antialias = true;
        renderer.prepare(encoder, &mut self.view, &[(&self.scene).into()], &frame)
    }

    /// In the pass: opaque objects before, for smooth edges over them; transparent ones after.
    pub fn draw(&self, renderer: &Renderer, pass: &mut wgpu::RenderPass) -> Result<(), Error> {
        renderer.composite(&self.view, pass)
    }
}
