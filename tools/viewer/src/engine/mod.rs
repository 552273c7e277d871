//! What is asked for to linear pictures, coarse ones first.
//!
//! A new request ends the one at hand, whatever it was doing; [`pace`](crate::pace) says in which
//! pictures it is answered. Programs draw in a thread, on a graphics device or the processor; pages
//! draw part by part on their device, between frames of the window.

#[cfg(target_family = "wasm")]
mod page;
#[cfg(not(target_family = "wasm"))]
mod thread;
mod uploaded;

use std::sync::Arc;
use std::time::Duration;

use glam::{Quat, Vec3};
use relight_format::{Camera, Material, Scene};
use relight_runtime::{
    Frame, Image, LocalLight, Method, PassTimes, Prefiltered, Sources, SphericalGaussian,
};
use relight_shading::spherical_gaussian::energy;

#[cfg(target_family = "wasm")]
pub use page::Engine;
#[cfg(not(target_family = "wasm"))]
pub use thread::{Artist, Drawn, Engine};

use crate::state::Integrator;

/// How long a group of rows on a graphics device may take.
const GROUP: Duration = Duration::from_millis(40);
/// Rows of the smallest group.
const BAND: u32 = 8;
/// Sharpness of the lobe that stands for a source in drafts, at most: what SSDFs can tell apart.
const SHARPEST_SOURCE: f32 = 1000.0;

/// Rows of a group of a picture so wide, where pixels take so many seconds.
fn rows_of_group(rate: Option<f64>, width: u32) -> u32 {
    let rows = GROUP.as_secs_f64() / (rate.unwrap_or(2e-5) * f64::from(width)).max(1e-12);
    (rows as u32).max(BAND).next_multiple_of(BAND)
}

/// Where pictures are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// A graphics card if there is one, else the processor: software Vulkan is slower than the
    /// twin is.
    #[default]
    Auto,
    /// A graphics device, if only in software.
    Gpu,
    /// The processor.
    Cpu,
}

/// Everything that a picture depends on.
#[derive(Clone, Debug)]
pub struct Shot {
    /// The scene as baked.
    pub scene: Arc<Scene>,
    /// In place of the scene's.
    pub materials: Arc<Vec<Material>>,
    /// From where.
    pub camera: Camera,
    /// Distant light.
    pub lights: Arc<[SphericalGaussian]>,
    /// Its image, to be reflected in place of it.
    pub reflections: Option<Prefiltered>,
    /// Suns, lamps and windows, apart from the lobes.
    pub sources: Option<Arc<Sources>>,
    /// Turns all of it.
    pub rotation: Quat,
    /// Lights inside the scene.
    pub local_lights: Vec<LocalLight>,
    /// How light is integrated.
    pub integrator: Integrator,
}

impl Shot {
    /// What the first picture shows where the best takes long: the same view and light, of few
    /// spokes, each source a lobe that is shadowed as the others are.
    #[must_use]
    pub fn draft(&self) -> Self {
        let mut lights = self.lights.to_vec();
        lights.extend((self.sources.iter()).flat_map(|sources| sources_as_lobes(sources)));
        Self {
            lights: lights.into(),
            sources: None,
            integrator: match self.integrator {
                Integrator::Ambient => Integrator::Ambient,
                _ => Integrator::PolarDraft,
            },
            ..self.clone()
        }
    }

    /// The same for the runtime. `method` stands for the ray tracer as well.
    pub fn frame(&self, method: Method) -> Frame<'_> {
        Frame {
            reflections: self.reflections.as_ref(),
            sources: self.sources.as_deref(),
            rotation: self.rotation,
            local_lights: &self.local_lights,
            method,
            ..Frame::new(self.camera, &self.lights)
        }
    }
}

/// One lobe for every source, of its light, direction and width.
fn sources_as_lobes(sources: &Sources) -> Vec<SphericalGaussian> {
    let lobe = |points: Vec<SphericalGaussian>| {
        let light: Vec3 = points.iter().map(SphericalGaussian::integral).sum();
        let mean: Vec3 = points.iter().map(|point| point.axis).sum::<Vec3>() / points.len() as f32;
        // Banerjee et al. 2005, equation 4.4, of directions on the sphere.
        let length = mean.length().min(1.0 - f32::EPSILON);
        let sharpness = length * (3.0 - length * length) / (1.0 - length * length);
        let sharpness = sharpness.min(SHARPEST_SOURCE);
        SphericalGaussian {
            axis: mean.normalize_or(Vec3::Y),
            sharpness,
            amplitude: light / energy(sharpness),
        }
    };
    let sources = sources.each_as_lobes();
    sources.map(|points| lobe(points.collect())).collect()
}

/// One or two pictures of one size.
#[derive(Clone, Debug)]
pub struct Request {
    /// What is to be seen.
    pub shots: Vec<Shot>,
    /// Size of the best pictures.
    pub size: [u32; 2],
    /// Whether coarse pictures come first; else only the best ones come.
    pub progressive: bool,
}

/// One picture of a request.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Counts requests.
    pub request: u64,
    /// Which shot of the request.
    pub pane: usize,
    /// Linear radiance times coverage, and coverage.
    pub image: Arc<Image>,
    /// The camera that it is seen by.
    pub camera: Camera,
    /// The turn of its light.
    pub rotation: Quat,
    /// Whether it shows what others will show, by cheaper means: [`Shot::draft`].
    pub draft: bool,
    /// Whether none better comes.
    pub complete: bool,
    /// Samples per pixel, where it is ray-traced.
    pub samples: u32,
    /// How long it took.
    pub time: Duration,
    /// How long the passes took, on a graphics device that tells.
    pub passes: Option<PassTimes>,
    /// How many scenes were prepared or uploaded until then: neither edits nor cameras take one.
    pub preparations: u32,
}

/// What comes from the engine.
#[derive(Clone, Debug)]
pub enum Event {
    /// A picture.
    Picture(Picture),
    /// Name of the device, once it is open.
    Device(String),
    /// What went wrong, for people.
    Failed(String),
}
