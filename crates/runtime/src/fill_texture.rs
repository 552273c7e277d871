//! Images of the app's in place of a scene's textures.

use bytemuck::Zeroable as _;
use relight_format::TextureEncoding;
use relight_shading::gpu::TextureFill;
use relight_shading::textures::level_count;
use relight_shading::wgsl::FILL_TEXTURE;

use crate::layouts::{compute_pipeline, layout_entry, part_entry, texture_entry};
use crate::tiles::{OFFSET_ALIGNMENT, WORKGROUP};
use crate::transfer::filled_buffer;
use crate::{Error, GpuScene, Renderer};

/// The pipeline, which is made when it is first needed.
#[derive(Debug)]
pub(crate) struct FillPass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::ComputePipeline,
    sampler: wgpu::Sampler,
}

impl FillPass {
    pub(crate) fn new(device: &wgpu::Device) -> Self {
        let compute = wgpu::ShaderStages::COMPUTE;
        let uniform = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: true,
            min_binding_size: None,
        };
        let image = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let texels = wgpu::BindingType::StorageTexture {
            access: wgpu::StorageTextureAccess::WriteOnly,
            format: wgpu::TextureFormat::R32Uint,
            view_dimension: wgpu::TextureViewDimension::D2Array,
        };
        let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("relight texture"),
            entries: &[
                layout_entry(0, compute, uniform),
                layout_entry(1, compute, image),
                layout_entry(2, compute, sampler),
                layout_entry(3, compute, texels),
            ],
        });
        let pipeline = compute_pipeline(device, &[&layout], &FILL_TEXTURE);
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("relight texture"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        Self {
            layout,
            pipeline,
            sampler,
        }
    }
}

impl Renderer {
    /// Records that a scene's texture `index`, in the order of its asset, shows what `image` shows: a compressed texture
    /// of the app's (BC, ASTC, ETC2), a picture that it draws, a frame of a film. Frames prepared after it, of
    /// whatever view, have it; [`Renderer::upload`] brings back the asset's.
    ///
    /// The image is sampled by the GPU, which decodes it, sRGB too, into the size and encoding that the texture has
    /// in the asset: 8 bits a channel, and all its levels. They are made from the image's own levels; where there
    /// are too few, from up to 16 × 16 points for a texel. It costs a dispatch per level, and nothing afterwards.
    ///
    /// Bounced light was baked with the asset's colours, and masks of opacity were cut into its mesh: both stay.
    ///
    /// # Errors
    /// No such texture, a table of a measured material, or an image that cannot be sampled: expected are two
    /// dimensions, one sample, a format of filterable floats, and `TEXTURE_BINDING`.
    pub fn set_texture(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &GpuScene,
        index: usize,
        image: &wgpu::TextureView,
    ) -> Result<(), Error> {
        if scene.owner != *self.owner() {
            return Err(Error::Foreign { what: "scene" });
        }
        let Some(texture) = scene.textures.get(index) else {
            return Err(Error::NoSuchTexture {
                index,
                count: scene.textures.len(),
            });
        };
        if texture.shape.encoding == TextureEncoding::Rgbe {
            return Err(Error::NoImage { index });
        }
        self.check_image(image.texture())?;
        let fills: Vec<TextureFill> = (0..level_count(texture.shape))
            .map(|level| {
                let (corner, size) = texture.level(level);
                TextureFill {
                    corner,
                    srgb: u32::from(texture.shape.encoding == TextureEncoding::Srgb),
                    size,
                    ..TextureFill::zeroed()
                }
            })
            .collect();
        let mut uniforms = Vec::with_capacity(fills.len() * OFFSET_ALIGNMENT);
        for fill in &fills {
            uniforms.extend_from_slice(bytemuck::bytes_of(fill));
            uniforms.resize(uniforms.len().next_multiple_of(OFFSET_ALIGNMENT), 0);
        }
        let device = self.device();
        let usage = wgpu::BufferUsages::UNIFORM;
        let uniforms = filled_buffer(device, "relight texture", &uniforms, 0, usage)?;
        let pass = self.fill_pass();
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight texture"),
            layout: &pass.layout,
            entries: &[
                part_entry(0, &uniforms, size_of::<TextureFill>() as u64),
                texture_entry(1, image),
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: wgpu::BindingResource::Sampler(&pass.sampler),
                },
                texture_entry(3, &scene.texels),
            ],
        });
        let mut compute = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("relight texture"),
            timestamp_writes: None,
        });
        compute.set_pipeline(&pass.pipeline);
        for (place, fill) in (0u32..).step_by(OFFSET_ALIGNMENT).zip(&fills) {
            compute.set_bind_group(0, &group, &[place]);
            let [x, y] = fill.size.map(|side| side.div_ceil(WORKGROUP));
            compute.dispatch_workgroups(x, y, 1);
        }
        Ok(())
    }

    /// Whether an image can be sampled.
    fn check_image(&self, image: &wgpu::Texture) -> Result<(), Error> {
        let features = self.device().features();
        let sampled = image.format().sample_type(None, Some(features));
        let floats = wgpu::TextureSampleType::Float { filterable: true };
        let bound = wgpu::TextureUsages::TEXTURE_BINDING;
        if sampled == Some(floats)
            && image.dimension() == wgpu::TextureDimension::D2
            && image.sample_count() == 1
            && image.usage().contains(bound)
        {
            return Ok(());
        }
        Err(Error::Image {
            found: format!(
                "{:?}, {:?}, {} samples, {:?}",
                image.format(),
                image.dimension(),
                image.sample_count(),
                image.usage(),
            ),
        })
    }
}
