//! Where what pixels show was in the frame before.

use bytemuck::Zeroable as _;
use relight_shading::camera::Viewpoint;
use relight_shading::gpu;
use relight_shading::wgsl::MOTION;

use crate::images::clear;
use crate::layouts::{
    UNIFORM_PARTS, compute_pipeline, image_entries, layout_entry, part_entry, texture_entry,
};
use crate::tiles::Tiling;
use crate::transfer::Slot;
use crate::{Error, Instance, Placement, Renderer, View};

/// Bytes of what kernels are bound to: a multiple of all alignments of dynamic offsets.
const BATCH_BYTES: usize = gpu::MAX_BATCH as usize * size_of::<gpu::Motion>();
const _: () = assert!(BATCH_BYTES.is_multiple_of(256));

/// Format of motion.
const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Float;

/// The frame before, as far as it tells where things were.
#[derive(Clone, Copy, Debug)]
pub struct Before<'a> {
    /// Its camera. What the jitter of both cameras differs by is part of the motion: a camera with the frame's own
    /// jitter leaves it out.
    pub camera: Viewpoint,
    /// Where the instances stood, in the order in which they were prepared.
    pub placements: &'a [Placement],
}

/// The pipeline, which is made when it is first needed.
#[derive(Debug)]
pub(crate) struct MotionPass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::ComputePipeline,
}

impl MotionPass {
    pub(crate) fn new(device: &wgpu::Device, [frame, scene]: [&wgpu::BindGroupLayout; 2]) -> Self {
        let [seen, ..] = image_entries();
        let compute = wgpu::ShaderStages::COMPUTE;
        let found = wgpu::BindingType::StorageTexture {
            access: wgpu::StorageTextureAccess::WriteOnly,
            format: FORMAT,
            view_dimension: wgpu::TextureViewDimension::D2,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("relight motion"),
            entries: &[
                seen,
                layout_entry(1, compute, found),
                layout_entry(2, compute, UNIFORM_PARTS),
            ],
        });
        let pipeline = compute_pipeline(device, &[frame, scene, &layout], &MOTION);
        Self { layout, pipeline }
    }
}

/// Of one view, kept from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct Motion {
    uniforms: Slot,
    images: Option<MotionImages>,
}

#[derive(Debug)]
struct MotionImages {
    /// What it was made for.
    seen: wgpu::TextureView,
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    group: Option<wgpu::BindGroup>,
}

impl Motion {
    pub(crate) fn texture(&self) -> Option<&wgpu::Texture> {
        self.images.as_ref().map(|images| &images.texture)
    }
}

impl Renderer {
    /// Records where everything was in the frame before that `view`, prepared with these instances, shows:
    /// into [`View::motion`], for an app's own temporal antialiasing or blur. It takes a dispatch of an instance's
    /// pixels and eight bytes a pixel.
    ///
    /// # Errors
    /// A view that was not prepared, or other numbers of instances or placements than it was prepared with.
    pub fn motion(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        view: &mut View,
        instances: &[Instance],
        before: &Before,
    ) -> Result<(), Error> {
        self.check_view(view)?;
        let size = view.size();
        let Some(images) = &view.images else {
            return Err(Error::NotPrepared);
        };
        let seen = images.seen_view.clone();
        let tiling = Tiling {
            size,
            antialias: images.antialias(),
            at_once: images.slots.tiles(),
        };
        for found in [instances.len(), before.placements.len()] {
            let expected = view.batches.iter().map(Vec::len).sum();
            if found != expected {
                return Err(Error::InstanceCount { expected, found });
            }
        }
        let mut uniforms = vec![gpu::Motion::zeroed(); instances.len()];
        for ((instance, placement), uniform) in
            (instances.iter().zip(before.placements)).zip(&mut uniforms)
        {
            if instance.scene.owner != *self.owner() {
                return Err(Error::Foreign { what: "scene" });
            }
            placement.check()?;
            // The distance of a pinhole's near plane has no part in places.
            let matrix = before.camera.matrix(size[0], size[1], 1.0) * placement.matrix();
            uniform.before = matrix.to_cols_array_2d();
            uniform.size = size.map(|side| side as f32);
        }
        let mut bytes = Vec::with_capacity(view.batches.len() * BATCH_BYTES);
        for batch in &view.batches {
            for &index in batch {
                bytes.extend_from_slice(bytemuck::bytes_of(&uniforms[index as usize]));
            }
            bytes.resize(bytes.len().next_multiple_of(BATCH_BYTES), 0);
        }
        let usage = wgpu::BufferUsages::UNIFORM;
        let motion = &mut view.motion;
        let new =
            motion
                .uniforms
                .fill(self, "relight motion", &bytes, BATCH_BYTES as u64, usage)?;
        if motion
            .images
            .as_ref()
            .is_none_or(|images| images.seen != seen)
        {
            motion.images = Some(self.motion_images(size, seen));
        }
        let images = motion.images.as_mut().expect("just made");
        if new {
            images.group = None;
        }
        let pass = self.motion_pass();
        let group = images.group.get_or_insert_with(|| {
            self.device().create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("relight motion"),
                layout: &pass.layout,
                entries: &[
                    texture_entry(0, &images.seen),
                    texture_entry(1, &images.view),
                    part_entry(2, motion.uniforms.buffer(), BATCH_BYTES as u64),
                ],
            })
        });
        clear(encoder, &images.view);
        let mut compute = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("relight motion"),
            timestamp_writes: None,
        });
        compute.set_pipeline(&pass.pipeline);
        let places = (0u32..).step_by(BATCH_BYTES);
        for ((batch, resources), place) in view.batches.iter().zip(&mut view.resources).zip(places)
        {
            let Some(&first) = batch.first() else {
                continue;
            };
            // Parts of a frame list their own.
            resources.list_all(self, tiling)?;
            compute.set_bind_group(1, &instances[first as usize].scene.bind_group, &[]);
            compute.set_bind_group(2, &*group, &[place]);
            for dispatch in resources.dispatches() {
                compute.set_bind_group(0, resources.frame_group(), &[dispatch.offset]);
                compute.dispatch_workgroups(dispatch.workgroups, 1, 1);
            }
        }
        Ok(())
    }

    fn motion_images(&self, [width, height]: [u32; 2], seen: wgpu::TextureView) -> MotionImages {
        let texture = self.device().create_texture(&wgpu::TextureDescriptor {
            label: Some("relight motion"),
            size: wgpu::Extent3d {
                width,
                height,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: FORMAT,
            usage: wgpu::TextureUsages::STORAGE_BINDING
                | wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_SRC
                | wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        MotionImages {
            view: texture.create_view(&wgpu::TextureViewDescriptor::default()),
            texture,
            seen,
            group: None,
        }
    }
}
