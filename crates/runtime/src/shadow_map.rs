//! An app's own shadow map, as a frame has it and as the GPU does.

use glam::Mat4;
use relight_shading::gpu;
use relight_shading::shadow_map::{DepthImage, Lookup};

use crate::layouts::{UNIFORM, buffer_entry, layout_entry, texture_entry};
use crate::transfer::Slot;
use crate::{Error, Placement, Renderer};

/// What of a source's light things hide that are not in any scene: depths as the app drew them from where the light
/// comes from, of characters that move, of foliage, of other instances.
///
/// What of the source is visible by rays is multiplied by what the map leaves, between the four texels around the
/// point that a pixel sees; nothing is hidden outside of the map. Edges are as soft as a texel is wide, whatever the size of the
/// source. The rest of the light, its bounces and what vertices see know nothing of the map, and shadow catchers show
/// its shadows as those of the scene.
///
/// The camera of a map that covers a sphere, of the environment's first source:
///
/// ```
/// use relight_runtime::glam::{Mat4, Vec3, camera::rh};
/// use relight_runtime::Frame;
///
/// fn light_camera(frame: &Frame, centre: Vec3, radius: f32) -> Option<Mat4> {
///     let toward = frame.rotated_sources()?.axis(0)?;
///     let up = toward.any_orthonormal_vector();
///     let look = rh::view::look_to_mat4(centre + radius * toward, -toward, up);
///     let [r, far] = [radius, 2.0 * radius];
///     Some(rh::proj::directx::orthographic(-r, r, -r, r, 0.0, far) * look)
/// }
/// ```
#[derive(Clone, Copy, Debug)]
pub struct ShadowMap<'a> {
    /// The depths.
    pub depths: Depths<'a>,
    /// World space to the map's clip space, as `wgpu` has it: y up, depth 0 to 1.
    pub matrix: Mat4,
    /// Which of [`Frame::sources`](crate::Frame::sources) it is of; 0 is the one whose shadows matter most. One that
    /// there is not hides nothing.
    pub source: usize,
    /// Whether depth falls with distance from the light, from 1 to 0.
    pub reversed: bool,
    /// What hides a point is nearer to the light by more than this, in units of depth. Above 0 where the map
    /// has surfaces of the scene as well.
    pub bias: f32,
}

/// Where the depths of a [`ShadowMap`] are.
#[derive(Clone, Copy, Debug)]
pub enum Depths<'a> {
    /// On the GPU, for renderers: the view of a depth texture of two dimensions, one sample and `TEXTURE_BINDING`.
    Texture(&'a wgpu::TextureView),
    /// On the CPU, for the twin.
    Image(DepthImage<'a>),
}

impl<'a> ShadowMap<'a> {
    /// How it is looked up from a scene that stands somewhere.
    pub(crate) fn lookup(&self, placement: &Placement) -> Result<Lookup, Error> {
        let refused = |found: String| Error::ShadowMap {
            expected: "a finite matrix and a finite bias",
            found,
        };
        if !self.matrix.is_finite() || !self.bias.is_finite() {
            return Err(refused(format!("{} and {}", self.matrix, self.bias)));
        }
        Ok(Lookup {
            matrix: self.matrix * placement.matrix(),
            source: self.source,
            sign: if self.reversed { -1.0 } else { 1.0 },
            bias: self.bias,
        })
    }

    /// The twin's depths.
    #[cfg(feature = "twin")]
    pub(crate) fn image(&self) -> Result<DepthImage<'a>, Error> {
        let refused = |found: String| Error::ShadowMap {
            expected: "depths on the CPU, at least one and as many as width times height",
            found,
        };
        match self.depths {
            Depths::Texture(_) => Err(refused("a texture".to_owned())),
            Depths::Image(image) => {
                let texels = u64::from(image.width) * u64::from(image.height);
                if texels > 0 && texels == image.depths.len() as u64 {
                    Ok(image)
                } else {
                    let (width, height) = (image.width, image.height);
                    let found = image.depths.len();
                    Err(refused(format!("{found} of {width}x{height}")))
                }
            }
        }
    }

    fn view(&self) -> Result<&'a wgpu::TextureView, Error> {
        let refused = |found: String| Error::ShadowMap {
            expected: "a depth texture of two dimensions, one sample and TEXTURE_BINDING",
            found,
        };
        let Depths::Texture(view) = self.depths else {
            return Err(refused("depths on the CPU".to_owned()));
        };
        let texture = view.texture();
        let usable = texture.format().has_depth_aspect()
            && texture.dimension() == wgpu::TextureDimension::D2
            && texture.sample_count() == 1
            && (texture.usage()).contains(wgpu::TextureUsages::TEXTURE_BINDING);
        if usable {
            Ok(view)
        } else {
            let (format, samples) = (texture.format(), texture.sample_count());
            let usage = texture.usage();
            Err(refused(format!("{format:?}, {samples} samples, {usage:?}")))
        }
    }
}

/// Group 3 of shadow_map.wgsl.
pub(crate) fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let depths = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Depth,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let compute = wgpu::ShaderStages::COMPUTE;
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight shadow map"),
        entries: &[
            layout_entry(0, compute, UNIFORM),
            layout_entry(1, compute, depths),
        ],
    })
}

/// What instances of one scene have of it, kept from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct BoundMap {
    uniform: Slot,
    bound: Option<(wgpu::TextureView, wgpu::BindGroup)>,
}

impl BoundMap {
    /// Fills it for instances in their order; with nothing, where the frame has none.
    pub(crate) fn fill(
        &mut self,
        renderer: &Renderer,
        layout: &wgpu::BindGroupLayout,
        map: Option<&ShadowMap>,
        lookups: impl Iterator<Item = Option<Lookup>>,
    ) -> Result<(), Error> {
        let Some(map) = map else {
            self.bound = None;
            return Ok(());
        };
        let view = map.view()?;
        let lookups: Vec<Lookup> = lookups.flatten().collect();
        let Some(first) = lookups.first() else {
            self.bound = None;
            return Ok(());
        };
        let head = gpu::ShadowMap {
            sign: first.sign,
            bias: first.bias,
            source: u32::try_from(first.source).unwrap_or(u32::MAX),
            reserved: 0,
        };
        let matrices: Vec<_> = (lookups.iter())
            .map(|lookup| lookup.matrix.to_cols_array_2d())
            .collect();
        let bytes = [bytemuck::bytes_of(&head), bytemuck::cast_slice(&matrices)].concat();
        let room = (size_of_val(&head) + gpu::MAX_BATCH as usize * size_of::<Mat4>()) as u64;
        let usage = wgpu::BufferUsages::UNIFORM;
        let new = (self.uniform).fill(renderer, "relight shadow map", &bytes, room, usage)?;
        if new || self.bound.as_ref().is_none_or(|(bound, _)| bound != view) {
            let descriptor = wgpu::BindGroupDescriptor {
                label: Some("relight shadow map"),
                layout,
                entries: &[
                    buffer_entry(0, self.uniform.buffer()),
                    texture_entry(1, view),
                ],
            };
            let group = renderer.device().create_bind_group(&descriptor);
            self.bound = Some((view.clone(), group));
        }
        Ok(())
    }

    /// Group 3, where there is a map.
    pub(crate) fn group(&self) -> Option<&wgpu::BindGroup> {
        self.bound.as_ref().map(|(_, group)| group)
    }
}
