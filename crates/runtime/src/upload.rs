//! Asset to GPU buffers and atlas.

use std::sync::atomic::{AtomicU32, Ordering};

use bytemuck::Pod;
use glam::Vec3;
use relight_format::{Material, Scene, TextureShape};
use relight_shading::catcher;
use relight_shading::gpu::{self, AtlasLayout, LimitError};
use relight_shading::occluders::Occluders;
use relight_shading::pack::{self, PackedScene, pack_scene};
use relight_shading::textures::PackedTexture;
use relight_shading::transfer::{self, DistantLight, PackedTransfer};
use wgpu::util::{DeviceExt as _, TextureDataOrder};

use crate::frame::{LocalFrame, bounds, near_plane};
use crate::layouts::{VERTEX_BINDINGS, buffer_entry, texture_entry};
use crate::loading::{Loading, check_storage};
use crate::lobes::SCENE_BINDINGS;
use crate::owner::Owner;
use crate::vertex_lights::VertexLights;
use crate::{Error, Renderer, UploadProgress, occluders};

/// A scene on the GPU, for any number of views and threads. Dropping it
/// frees its memory.
#[derive(Debug)]
pub struct GpuScene {
    pub(crate) bind_group: wgpu::BindGroup,
    /// What sources need, or what it exceeds.
    pub(crate) sources: Result<wgpu::BindGroup, LimitError>,
    /// Group 1 of kernels of vertices.
    pub(crate) vertex_group: wgpu::BindGroup,
    /// Groups 1 of kernels that shade by lobes.
    pub(crate) lobe_groups: [wgpu::BindGroup; 2],
    /// How many a material has.
    reflections: Vec<AtomicU32>,
    pub(crate) vertex_count: usize,
    /// Whether vertices have second texture coordinates.
    pub(crate) second_uvs: bool,
    pub(crate) ray_offset: f32,
    pub(crate) triangle_count: u32,
    pub(crate) atlas: AtlasLayout,
    pub(crate) distance_clamp: f32,
    pub(crate) near: f32,
    /// Lowest and highest corner; infinite if empty.
    pub(crate) bounds: [Vec3; 2],
    pub(crate) owner: Owner,
    /// Without what hides light, where materials catch shadows.
    pub(crate) open: Option<Box<GpuScene>>,
    bytes: u64,
    queue: wgpu::Queue,
    materials: wgpu::Buffer,
    pub(crate) textures: Vec<PackedTexture>,
    pub(crate) texels: wgpu::TextureView,
    bounced: Option<PackedTransfer>,
    /// Where light does not bounce.
    no_products: wgpu::TextureView,
}

impl Renderer {
    /// Copies a scene to the GPU, on any thread. The error names the limit that it exceeds, or what
    /// is out of its range in a scene that was not read from an asset.
    ///
    /// The bytes are handed over at the next submission, which waits for them: while others draw,
    /// [`Self::upload_while`] is for scenes of more than a few megabytes. To replace an asset, assign the new
    /// scene to the old one, whatever its size: views find out, and frames that are not done keep what they
    /// were recorded with.
    pub fn upload(&self, scene: &Scene) -> Result<GpuScene, Error> {
        let loading = Loading::at_once(self.device(), self.queue());
        self.load(loading, scene)
    }

    /// The same beside a thread that draws: hands over a megabyte of textures or one buffer at a time,
    /// and stops with [`Error::Cancelled`] once `wanted`, which is asked after each, says so. Some megabytes go along
    /// with each frame that is prepared and submitted meanwhile; while there is none it submits by itself. It
    /// belongs on a thread of its own, where it takes as long as packing the scene and copying it, or as a frame
    /// for every 4 MB.
    pub fn upload_while(
        &self,
        scene: &Scene,
        wanted: &mut dyn FnMut(UploadProgress) -> bool,
    ) -> Result<GpuScene, Error> {
        let at_most = self.upload_bytes(scene)?;
        let loading =
            Loading::by_pieces(self.device(), self.queue(), self.frames(), at_most, wanted);
        self.load(loading, scene)
    }

    fn load(&self, loading: Loading, scene: &Scene) -> Result<GpuScene, Error> {
        GpuScene::new(
            loading,
            self.queue(),
            self.scene_layouts(),
            self.owner(),
            scene,
        )
    }

    /// What a scene will take of the GPU's memory, at most: [`GpuScene::bytes`] says it after. Nothing is copied
    /// or made.
    pub fn upload_bytes(&self, scene: &Scene) -> Result<u64, Error> {
        // Kernels index with what it holds; whoever made it need not have read it.
        scene.validate()?;
        // A binary tree has fewer nodes than twice its leaves.
        let node = size_of::<gpu::OccluderNode>() as u64;
        let triangle = size_of::<gpu::OccluderTriangle>() as u64;
        let rays = (scene.triangles.len().max(1) as u64) * (2 * node + triangle);
        let mut bytes = scene_bytes(scene, true)? + rays;
        if catcher::catches(&scene.materials) {
            bytes += scene_bytes(&catcher::open_scene(scene), false)? + 2 * node + triangle;
        }
        Ok(bytes)
    }
}

/// What buffers and textures of a valid scene take, but for what rays meet.
fn scene_bytes(scene: &Scene, textures: bool) -> Result<u64, Error> {
    let words = PackedTransfer::new(scene).map_or(1, |packed| packed.words().len());
    let words = 4 * word_count(words) as u64;
    Ok(words + pack::packed_bytes(scene, textures).map_err(Error::Scene)?)
}

/// What groups of a scene have of some bounced light.
#[derive(Debug)]
pub(crate) struct ProductsOfLight {
    scene: wgpu::BindGroup,
    /// By instance.
    lights: Vec<DistantLight>,
    view: wgpu::TextureView,
}

impl GpuScene {
    /// Uploads a scene; one that no asset could hold is refused.
    fn new(
        mut loading: Loading,
        queue: &wgpu::Queue,
        layouts: [&wgpu::BindGroupLayout; 5],
        owner: &Owner,
        scene: &Scene,
    ) -> Result<Self, Error> {
        // Kernels index with what it holds; whoever made it need not have read it.
        scene.validate()?;
        let mut uploaded = Self::visible(&mut loading, queue, layouts, owner, scene, None)?;
        if catcher::catches(&scene.materials) {
            let open = catcher::open_scene(scene);
            let texels = Some(&uploaded.texels);
            let open = Self::visible(&mut loading, queue, layouts, owner, &open, texels)?;
            uploaded.open = Some(Box::new(open));
        }
        uploaded.bytes = loading.bytes();
        Ok(uploaded)
    }

    /// Uploads a valid scene; without what hides light, where that of the same textures is given.
    #[allow(
        clippy::too_many_lines,
        reason = "one buffer or texture after the other, in the order of the bindings"
    )]
    fn visible(
        loading: &mut Loading,
        queue: &wgpu::Queue,
        [
            layout,
            source_layout,
            vertex_layout,
            material_layout,
            visibility_layout,
        ]: [&wgpu::BindGroupLayout; 5],
        owner: &Owner,
        scene: &Scene,
        open_of: Option<&wgpu::TextureView>,
    ) -> Result<Self, Error> {
        let device = loading.device();
        let packed = pack_scene(scene).map_err(Error::Scene)?;
        let atlas = packed.atlas;
        // One vertex shader invocation per triangle corner.
        let corners = 3 * packed.triangles.len() as u64;
        LimitError::check("32-bit vertex index", corners, u64::from(u32::MAX))
            .map_err(Error::Scene)?;
        loading.ask()?;
        let vertices = loading.storage("vertices", &packed.vertices)?;
        let triangles = loading.storage("triangles", &packed.triangles)?;
        let clusters = loading.storage("clusters", &packed.clusters)?;
        let coefficients = loading.storage("coefficients", &packed.coefficients)?;
        let materials = loading.storage("materials", &packed.materials)?;
        let texels = match open_of {
            Some(texels) => texels.clone(),
            None => texel_texture(loading, scene, &packed)?,
        };
        let words = packed
            .transfer
            .as_ref()
            .map_or(&[0][..], PackedTransfer::words);
        let words = word_texture(loading, words)?;
        let colors = wgpu::TextureFormat::Rgba32Float;
        let no_products =
            bounced_texture(device, queue, colors, &[[0.0; 4]], [0.0; 4]).map_err(Error::Scene)?;
        let format = wgpu::TextureFormat::Rgba8Snorm;
        let sampled = wgpu::TextureUsages::TEXTURE_BINDING;
        let size = [atlas.width, atlas.height, atlas.layers];
        let texture = loading.texture("relight basis atlas", format, sampled, size)?;
        let basis: &[u8] = bytemuck::cast_slice(&packed.basis);
        let layer = 4 * atlas.width as usize * atlas.height as usize;
        for (z, texels) in (0..).zip(basis.chunks(layer)) {
            loading.rows(&texture, [0, 0, z], atlas.width, texels)?;
        }
        let view = texture.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        });
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("relight basis"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let buffers = [&vertices, &triangles, &clusters, &coefficients, &materials];
        let mut entries: Vec<_> = buffers
            .iter()
            .zip(0..)
            .map(|(buffer, binding)| buffer_entry(binding, buffer))
            .collect();
        entries.push(texture_entry(5, &texels));
        entries.push(texture_entry(6, &view));
        entries.push(wgpu::BindGroupEntry {
            binding: 7,
            resource: wgpu::BindingResource::Sampler(&sampler),
        });
        entries.push(texture_entry(10, &words));
        let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight scene"),
            layout,
            entries: &entries,
        });
        let part = |label, layout, bindings: &[u32]| {
            let entries = entries.iter();
            let entries = entries.filter(|entry| bindings.contains(&entry.binding));
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(label),
                layout,
                entries: &entries.cloned().collect::<Vec<_>>(),
            })
        };
        let vertex_group = part("relight vertices", vertex_layout, &VERTEX_BINDINGS);
        let lobe_groups = [
            part("relight materials", material_layout, SCENE_BINDINGS[0]),
            part("relight visibility", visibility_layout, SCENE_BINDINGS[1]),
        ];
        let shared = [&vertices, &triangles];
        let occluders = if open_of.is_none() {
            occluders::build(scene)
        } else {
            occluders::none()
        };
        let sources = source_group(loading, source_layout, shared, &occluders)?;
        Ok(Self {
            bind_group,
            sources,
            vertex_group,
            lobe_groups,
            reflections: (packed.materials.iter())
                .map(|material| AtomicU32::new(material.reflections()))
                .collect(),
            vertex_count: scene.vertices.len(),
            second_uvs: !scene.second_uvs.is_empty(),
            ray_offset: scene.visibility.ray_offset,
            triangle_count: packed.triangles.len() as u32,
            atlas,
            distance_clamp: packed.distance_clamp,
            near: near_plane(bounds(scene)),
            bounds: bounds(scene),
            owner: owner.clone(),
            open: None,
            bytes: 0,
            queue: queue.clone(),
            materials,
            textures: packed.textures,
            texels,
            bounced: packed.transfer,
            no_products,
        })
    }

    /// What it takes of the GPU's memory, but for what the device adds to each resource.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Reflections of a material, at most.
    pub(crate) fn reflections(&self) -> u32 {
        let counts = self.reflections.iter();
        let most = counts.map(|count| count.load(Ordering::Relaxed)).max();
        most.unwrap_or(0)
    }

    /// Whether a material has textures.
    pub(crate) fn is_textured(&self) -> bool {
        !self.textures.is_empty()
    }

    /// Whether light bounces.
    pub(crate) fn is_bounced(&self) -> bool {
        self.bounced.is_some()
    }

    /// Texels that an instance has of the texture of [`Self::products`].
    pub(crate) fn product_count(&self) -> usize {
        self.bounced
            .as_ref()
            .map_or(0, PackedTransfer::product_count)
    }

    /// Most instances that are shaded together under so many lights.
    pub(crate) fn most_instances(&self, device: &wgpu::Device, lights: usize) -> usize {
        let texels =
            transfer::TEXTURE_WIDTH as usize * device.limits().max_texture_dimension_2d as usize;
        let products = texels / self.product_count().max(1);
        let fractions = VertexLights::most_instances(device, self.vertex_count, lights);
        products.min(fractions).clamp(1, gpu::MAX_BATCH as usize)
    }

    /// Texture of the colours that groups have under the light of instances, one after the other; the last one
    /// where scene and light are the same.
    pub(crate) fn products<'a>(
        &self,
        device: &wgpu::Device,
        last: &mut Option<ProductsOfLight>,
        instances: impl Iterator<Item = &'a LocalFrame>,
    ) -> Result<wgpu::TextureView, Error> {
        let Some(packed) = &self.bounced else {
            return Ok(self.no_products.clone());
        };
        let light =
            |local: &LocalFrame| packed.light(&local.bouncing_lights(), &local.local_lights);
        let lights: Vec<DistantLight> = instances.map(light).collect();
        if let Some(last) = last
            && last.scene == self.bind_group
            && last.lights == lights
        {
            return Ok(last.view.clone());
        }
        let texels: Vec<_> = (lights.iter())
            .flat_map(|light| packed.products(light))
            .collect();
        let format = wgpu::TextureFormat::Rgba32Float;
        let view = bounced_texture(device, &self.queue, format, &texels, [0.0; 4])
            .map_err(Error::Frame)?;
        *last = Some(ProductsOfLight {
            scene: self.bind_group.clone(),
            lights,
            view: view.clone(),
        });
        Ok(view)
    }

    /// Replaces material `index`, of the frame that is prepared next. Textures are those
    /// that the scene was uploaded with, and a material may begin to catch shadows only in a scene that
    /// was uploaded with one that does.
    pub fn set_material(&self, index: usize, material: &Material) -> Result<(), Error> {
        let Some(reflections) = self.reflections.get(index) else {
            return Err(Error::NoSuchMaterial {
                index,
                count: self.reflections.len(),
            });
        };
        let shapes: Vec<TextureShape> = self.textures.iter().map(|texture| texture.shape).collect();
        material.validate(&shapes, self.second_uvs)?;
        match &self.open {
            Some(open) => open.set_material(index, material)?,
            None if material.shadow_catcher => return Err(Error::NoCatcher { index }),
            None => {}
        }
        let packed = pack::pack_material(material, &self.textures);
        reflections.store(packed.reflections(), Ordering::Relaxed);
        let offset = (index * size_of::<gpu::Material>()) as u64;
        self.queue
            .write_buffer(&self.materials, offset, bytemuck::bytes_of(&packed));
        Ok(())
    }
}

/// Group 1 of the pass for points of sources: vertices, triangles, and what blocks rays.
fn source_group(
    loading: &mut Loading,
    layout: &wgpu::BindGroupLayout,
    shared: [&wgpu::Buffer; 2],
    occluders: &Occluders,
) -> Result<Result<wgpu::BindGroup, LimitError>, Error> {
    let device = loading.device();
    let largest = size_of_val(occluders.nodes()).max(size_of_val(occluders.triangles()));
    if let Err(error) = check_storage(device, largest as u64) {
        // A scene that is drawn without sources needs none of it.
        return Ok(Err(error));
    }
    let nodes = loading.storage("occluder nodes", occluders.nodes())?;
    let triangles = loading.storage("occluder triangles", occluders.triangles())?;
    let buffers = shared.into_iter().chain([&nodes, &triangles]);
    let entries: Vec<_> = buffers
        .zip([0, 1, 8, 9])
        .map(|(buffer, binding)| buffer_entry(binding, buffer))
        .collect();
    Ok(Ok(device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("relight occluders"),
        layout,
        entries: &entries,
    })))
}

/// All levels of all textures.
fn texel_texture(
    loading: &mut Loading,
    scene: &Scene,
    packed: &PackedScene,
) -> Result<wgpu::TextureView, Error> {
    let pages = packed.pages;
    let size = [pages.width, pages.height, pages.layers];
    let format = wgpu::TextureFormat::R32Uint;
    // For `Renderer::set_texture`.
    let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::STORAGE_BINDING;
    let texture = loading.texture("relight textures", format, usage, size)?;
    for (of_scene, place) in scene.textures.iter().zip(&packed.textures) {
        place.visit(of_scene, |corner, level| {
            loading.rows(&texture, corner, level.width, &level.texels)
        })?;
    }
    Ok(texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    }))
}

/// What bounced light is packed into.
fn word_texture(loading: &mut Loading, words: &[u32]) -> Result<wgpu::TextureView, Error> {
    let width = transfer::TEXTURE_WIDTH;
    let mut words = words.to_vec();
    words.resize(word_count(words.len()), 0);
    let size = [width, words.len() as u32 / width, 1];
    let format = wgpu::TextureFormat::R32Uint;
    let usage = wgpu::TextureUsages::TEXTURE_BINDING;
    let texture = loading.texture("relight bounced light", format, usage, size)?;
    loading.rows(&texture, [0; 3], width, bytemuck::cast_slice(&words))?;
    Ok(texture.create_view(&wgpu::TextureViewDescriptor::default()))
}

/// Words of whole rows that so many take.
fn word_count(words: usize) -> usize {
    words
        .max(1)
        .next_multiple_of(transfer::TEXTURE_WIDTH as usize)
}

/// A texture of texels in order, [`transfer::TEXTURE_WIDTH`] per row.
fn bounced_texture<T: Pod>(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    format: wgpu::TextureFormat,
    texels: &[T],
    padding: T,
) -> Result<wgpu::TextureView, LimitError> {
    let width = transfer::TEXTURE_WIDTH as usize;
    let rows = texels.len().div_ceil(width).max(1);
    let allowed = u64::from(device.limits().max_texture_dimension_2d);
    LimitError::check("max_texture_dimension_2d", rows as u64, allowed)?;
    let mut padded = texels.to_vec();
    padded.resize(rows * width, padding);
    let texture = device.create_texture_with_data(
        queue,
        &wgpu::TextureDescriptor {
            label: Some("relight bounced light"),
            size: wgpu::Extent3d {
                width: width as u32,
                height: rows as u32,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        TextureDataOrder::LayerMajor,
        bytemuck::cast_slice(&padded),
    );
    Ok(texture.create_view(&wgpu::TextureViewDescriptor::default()))
}
