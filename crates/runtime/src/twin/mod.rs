//! The stages of a frame on the CPU. Same bytes on any number of threads.
//!
//! Longer than other files: the steps of a frame share what `Stage` holds, in the order of the kernels that
//! they are twins of, and are compared with these side by side.

mod vertex_fractions;
mod visibility_buffer;

use std::cell::Cell;
use std::sync::{Mutex, OnceLock};

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use relight_format::{Scene, Triangle};
use relight_shading::catcher;
use relight_shading::motion;
use relight_shading::occluders::Occluders;
use relight_shading::pixel_visibility::{PIXELS, SIDE};
use relight_shading::prefiltered::Prefiltered;
use relight_shading::shade::{Lighting, Method, Reflections};
use relight_shading::shadow_map::DepthImage;
use relight_shading::sources::{Lit, Pixel};
use relight_shading::ssdf::{Basis, SignedDistance, Ssdf};
use relight_shading::surface::{SurfacePoint, emission, has_diffuse, surface_seen};
use relight_shading::surfaces::{self, Item, Sample, Surfaces};
use relight_shading::textures::{Filter, Mipmaps};
use relight_shading::tile::{self, Counts};
use relight_shading::tonemap;
use relight_shading::transfer::{Bounced, PackedTransfer};
use relight_shading::vertex_visibility::{self, Corners};

use vertex_fractions::VertexFractions;
pub use visibility_buffer::visibility_buffer;

use crate::frame::{LocalFrame, bounds, near_plane};
use crate::resources::first_ids;
use crate::shadow_map::ShadowMap;
use crate::{Before, Error, Frame, Image, Placement, occluders};

/// A scene in a place.
#[derive(Clone, Copy, Debug)]
pub struct Placed<'a> {
    /// One that [`relight_format::read_scene`] returned or [`relight_format::write_scene`] accepts.
    pub scene: &'a Scene,
    /// Where it stands.
    pub placement: Placement,
}

impl<'a> From<&'a Scene> for Placed<'a> {
    fn from(scene: &'a Scene) -> Self {
        Self {
            scene,
            placement: Placement::IDENTITY,
        }
    }
}

/// What pictures of a scene need that depends on neither camera, light nor materials: worth keeping
/// for as long as its geometry and visibility stay.
pub struct Prepared {
    basis: Basis,
    mipmaps: Mipmaps,
    transfer: Option<PackedTransfer>,
    /// For the first frame with sources.
    occluders: OnceLock<Occluders>,
    /// Of the last frames, for the next one with the same lights.
    fractions: Mutex<Vec<VertexFractions>>,
}

impl Prepared {
    /// Of a scene as [`render`] takes it.
    pub fn new(scene: &Scene) -> Self {
        Self {
            basis: Basis::new(scene),
            mipmaps: Mipmaps::new(scene),
            transfer: PackedTransfer::new(scene),
            occluders: OnceLock::new(),
            fractions: Mutex::new(Vec::new()),
        }
    }

    /// SSDFs as they are evaluated.
    pub fn basis(&self) -> &Basis {
        &self.basis
    }
}

impl std::fmt::Debug for Prepared {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Prepared").finish_non_exhaustive()
    }
}

/// The linear radiance of one frame, not exposed. The scene is one that
/// [`relight_format::read_scene`] returned or [`relight_format::write_scene`] accepts.
pub fn render(scene: &Scene, frame: &Frame, width: u32, height: u32) -> Result<Image, Error> {
    render_instances(&[scene.into()], frame, width, height)
}

/// The same picture of a scene that was prepared before, for as long as it is `wanted`, which is
/// asked at every pixel: once it is not, the rest stays black. Materials of `scene` may be others
/// than those it was prepared with.
pub fn render_prepared(
    scene: &Scene,
    prepared: &Prepared,
    frame: &Frame,
    width: u32,
    height: u32,
    wanted: &(dyn Fn() -> bool + Sync),
) -> Result<Image, Error> {
    render_while(&[scene.into()], &[prepared], frame, [width, height], wanted)
}

/// The same of several instances, which occlude one another, but neither shadow nor light one
/// another.
pub fn render_instances(
    instances: &[Placed],
    frame: &Frame,
    width: u32,
    height: u32,
) -> Result<Image, Error> {
    let prepared: Vec<Prepared> = (instances.iter())
        .map(|placed| Prepared::new(placed.scene))
        .collect();
    let prepared: Vec<&Prepared> = prepared.iter().collect();
    render_while(instances, &prepared, frame, [width, height], &|| true)
}

fn render_while(
    instances: &[Placed],
    prepared: &[&Prepared],
    frame: &Frame,
    size: [u32; 2],
    wanted: &(dyn Fn() -> bool + Sync),
) -> Result<Image, Error> {
    let [width, height] = size;
    let open: Vec<_> = (instances.iter())
        .map(|placed| Open::new(placed.scene))
        .collect();
    let stage = Stage::new(instances, prepared, &open, frame, size, wanted)?;
    let bounced: Vec<_> = (stage.instances.iter())
        .map(|instance| BouncedLight::new(instance.prepared, &instance.local))
        .collect();
    let shade_tile = |pixels: &[Option<Ready>]| {
        if !wanted() {
            return vec![[0.0; 4]; pixels.len()];
        }
        let direct = tile::shade(&shaded(pixels), &frame.method, &mut Counts::default());
        let opened: Vec<_> = (pixels.iter())
            .map(|ready| stage.opened(ready.as_ref()?))
            .collect();
        let without = if opened.iter().any(Option::is_some) {
            tile::shade(&shaded(&opened), &frame.method, &mut Counts::default())
        } else {
            Vec::new()
        };
        let finish = |(index, ready): (usize, &Option<Ready>)| {
            let Some(Ready { seen, field, .. }) = ready else {
                return [0.0; 4];
            };
            let instance = &stage.instances[seen.instance];
            let (scene, filter) = (instance.scene, instance.filter());
            let emitted = emission(scene, seen.triangle, seen.barycentrics, Some(filter));
            let bounced = bounced[seen.instance].as_ref().map_or(Vec3::ZERO, |light| {
                light.at(scene, seen).reflected(&seen.point, field)
            });
            let shaded = direct[index] + bounced + emitted;
            if opened[index].is_some() {
                catcher::catch(shaded, without[index] + emitted).to_array()
            } else {
                shaded.extend(1.0).to_array()
            }
        };
        pixels.iter().enumerate().map(finish).collect()
    };
    let shaded = stage.map_tiles(shade_tile);
    let pixels = match &stage.surfaces {
        Some(surfaces) => surfaces.resolve(&shaded),
        None => shaded,
    };
    stage.keep_fractions();
    Ok(Image {
        width,
        height,
        pixels,
    })
}

/// A scene without what hides light, where some of its materials catch shadows.
struct Open {
    scene: Scene,
    prepared: Prepared,
}

impl Open {
    fn new(scene: &Scene) -> Option<Self> {
        if !catcher::catches(&scene.materials) {
            return None;
        }
        let scene = catcher::open_scene(scene);
        let prepared = Prepared {
            occluders: occluders::none().into(),
            ..Prepared::new(&scene)
        };
        Some(Self { scene, prepared })
    }
}

/// Light of one frame that other surfaces reflect.
struct BouncedLight<'a> {
    packed: &'a PackedTransfer,
    products: Vec<[f32; 4]>,
}

impl<'a> BouncedLight<'a> {
    /// `None` where the asset has none.
    fn new(prepared: &'a Prepared, frame: &LocalFrame) -> Option<Self> {
        let packed = prepared.transfer.as_ref()?;
        let light = packed.light(&frame.bouncing_lights(), &frame.local_lights);
        let products = packed.products(&light);
        Some(Self { packed, products })
    }

    fn at(&self, scene: &Scene, seen: &Seen) -> Bounced {
        let triangle = &scene.triangles[seen.triangle];
        let cluster = usize::from(triangle.cluster);
        let weights = seen.barycentrics;
        (self.packed).interpolate(&self.products, cluster, triangle.vertices, weights)
    }
}

/// What is under a pixel.
#[derive(Clone, Copy)]
struct Seen<'a> {
    instance: usize,
    point: SurfacePoint<'a>,
    triangle: usize,
    barycentrics: Vec3,
    /// [`has_diffuse`] of its material.
    has_diffuse: bool,
    material: u32,
}

/// A pixel ready to be shaded.
struct Ready<'a> {
    seen: Seen<'a>,
    lighting: Lighting<'a>,
    field: Ssdf<'a>,
}

/// Those of a tile as they are shaded.
fn shaded<'a>(pixels: &'a [Option<Ready<'a>>]) -> Vec<Option<tile::Pixel<'a, Ssdf<'a>>>> {
    let pixel = |ready: &'a Option<Ready<'a>>| Some(pixel(ready.as_ref()?, &ready.as_ref()?.field));
    pixels.iter().map(pixel).collect()
}

fn pixel<'a, F>(ready: &'a Ready<'a>, field: &'a F) -> tile::Pixel<'a, F> {
    tile::Pixel {
        point: &ready.seen.point,
        lighting: ready.lighting,
        field,
        surface: [ready.seen.instance as u32, ready.seen.material],
        has_diffuse: ready.seen.has_diffuse,
    }
}

/// What shading a frame takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Pixels that the scene covers.
    pub pixels: u64,
    /// Lobes integrated over what is visible of them; with `cells` groups of lobes.
    pub integrals: u64,
    /// Directions in which an SSDF was evaluated.
    pub samples: u64,
    /// Texels of four basis images that were interpolated for it.
    pub fetches: u64,
    /// Rays cast towards sources.
    pub rays: u64,
    /// Directions in which SSDFs of vertices were evaluated, for lights that every vertex in sight is
    /// new to. While light stands still, only those that come into sight take any.
    pub vertex_samples: u64,
    /// Texels of four basis images that were interpolated for those.
    pub vertex_fetches: u64,
}

/// Counts what [`render`] does.
pub fn work(scene: &Scene, frame: &Frame, width: u32, height: u32) -> Result<Work, Error> {
    let prepared = Prepared::new(scene);
    let size = [width, height];
    let stage = Stage::new(&[scene.into()], &[&prepared], &[], frame, size, &|| true)?;
    let counts = stage.map_tiles(|pixels| {
        let fields: Vec<Option<Counted>> = (pixels.iter())
            .map(|ready| Counted::new(ready.as_ref()))
            .collect();
        let mut of_tile = Counts::default();
        tile::shade(&counted(pixels, &fields), &frame.method, &mut of_tile);
        let count = |field: &Option<Counted>| {
            let Some(field) = field else {
                return [0; 5];
            };
            let samples = field.samples.get();
            let fetches = samples * field.field.tiles() as u64;
            // Not a pixel's: with the first one.
            let Counts { integrals, rays } = std::mem::take(&mut of_tile);
            [1, integrals, samples, fetches, rays]
        };
        fields.iter().map(count).collect()
    });
    let fractions = stage.instances.iter().map(|staged| &staged.fractions);
    let [vertex_samples, vertex_fetches] = (fractions.flatten())
        .fold([0; 2], |[samples, fetches], found| {
            [samples + found.work[0], fetches + found.work[1]]
        });
    let sum = |index: usize| counts.iter().map(|counts| counts[index]).sum();
    Ok(Work {
        pixels: sum(0),
        integrals: sum(1),
        samples: sum(2),
        fetches: sum(3),
        rays: sum(4),
        vertex_samples,
        vertex_fetches,
    })
}

struct Counted<'a> {
    field: &'a Ssdf<'a>,
    samples: Cell<u64>,
}

impl<'a> Counted<'a> {
    fn new(ready: Option<&'a Ready>) -> Option<Self> {
        let field = &ready?.field;
        let samples = Cell::new(0);
        Some(Self { field, samples })
    }
}

/// [`shaded`], with other fields.
fn counted<'a>(
    pixels: &'a [Option<Ready<'a>>],
    fields: &'a [Option<Counted<'a>>],
) -> Vec<Option<tile::Pixel<'a, Counted<'a>>>> {
    (pixels.iter().zip(fields))
        .map(|(ready, field)| Some(pixel(ready.as_ref()?, field.as_ref()?)))
        .collect()
}

impl SignedDistance for Counted<'_> {
    fn distance(&self, direction: Vec3) -> f32 {
        self.samples.set(self.samples.get() + 1);
        self.field.distance(direction)
    }

    fn limit(&self) -> f32 {
        self.field.limit()
    }
}

/// What `shade` makes of the surface under every pixel's centre, its light and its visibility, row by
/// row; the default where there is none.
pub fn map_pixels<T: Default + Send>(
    scene: &Scene,
    frame: &Frame,
    size: [u32; 2],
    shade: impl Fn(&SurfacePoint, &Lighting, &Ssdf) -> T + Sync,
) -> Result<Vec<T>, Error> {
    let frame = Frame {
        antialias: false,
        ..frame.clone()
    };
    let prepared = Prepared::new(scene);
    let stage = Stage::new(&[scene.into()], &[&prepared], &[], &frame, size, &|| true)?;
    Ok(stage.map(|seen, lighting, field| shade(&seen.point, lighting, field)))
}

/// Where what is seen at every pixel's centre was in the frame before, row by row, as
/// [`crate::View::motion`] has it; zero where nothing is seen. Instances stood at `before`'s placements.
pub fn motion(
    instances: &[Placed],
    frame: &Frame,
    before: &Before,
    size: [u32; 2],
) -> Result<Vec<[f32; 2]>, Error> {
    if before.placements.len() != instances.len() {
        return Err(Error::InstanceCount {
            expected: instances.len(),
            found: before.placements.len(),
        });
    }
    let frame = Frame {
        antialias: false,
        method: Method::Ambient,
        ..frame.clone()
    };
    let prepared: Vec<Prepared> = (instances.iter())
        .map(|placed| Prepared::new(placed.scene))
        .collect();
    let prepared: Vec<&Prepared> = prepared.iter().collect();
    let stage = Stage::new(instances, &prepared, &[], &frame, size, &|| true)?;
    let camera = before.camera.matrix(size[0], size[1], 1.0);
    let mut matrices = Vec::with_capacity(instances.len());
    for placement in before.placements {
        placement.check()?;
        matrices.push(camera * placement.matrix());
    }
    let picture = Vec2::new(size[0] as f32, size[1] as f32);
    let found = |item: &Item| {
        if item.id == 0 {
            return [0.0; 2];
        }
        let (instance, triangle) = find(&stage.instances, item.id);
        let Staged { scene, local, .. } = &stage.instances[instance];
        let [a, b, c] = corners(scene, triangle);
        let weights = local.view.ray(item.at).barycentrics([a, b, c]);
        let position = a * weights.x + b * weights.y + c * weights.z;
        motion::motion(&matrices[instance], position, item.at / picture).to_array()
    };
    Ok(stage.items.par_iter().map(found).collect())
}

/// A frame ready to be shaded.
struct Stage<'a> {
    /// Columns and rows of the picture.
    size: [u32; 2],
    instances: Vec<Staged<'a>>,
    /// What is shaded.
    items: Vec<Item>,
    /// With antialiasing.
    surfaces: Option<Surfaces>,
    reflections: Option<&'a Prefiltered>,
    /// Of the app's own shadow map.
    depths: Option<DepthImage<'a>>,
}

/// One of its instances.
struct Staged<'a> {
    scene: &'a Scene,
    first_id: u32,
    local: LocalFrame,
    prepared: &'a Prepared,
    /// With `polar`, what vertices see of distant lights.
    fractions: Option<VertexFractions>,
    /// The same without what hides light, where something catches shadows.
    open: Option<Box<Staged<'a>>>,
}

impl Staged<'_> {
    /// What textures are seen through.
    fn filter(&self) -> Filter<'_> {
        Filter {
            view: &self.local.view,
            mipmaps: &self.prepared.mipmaps,
        }
    }

    /// Whether a triangle's corners are asked.
    fn pays(&self, triangle: &Triangle) -> bool {
        let corners =
            (triangle.vertices).map(|vertex| self.scene.vertices[vertex as usize].position);
        vertex_visibility::pays(&self.local.view, corners.map(Vec3::from))
    }

    /// What the vertices of a triangle see.
    fn corners(&self, triangle: usize, barycentrics: Vec3) -> Option<Corners<'_>> {
        let fractions = self.fractions.as_ref()?;
        let triangle = &self.scene.triangles[triangle];
        self.pays(triangle).then(|| Corners {
            fractions: triangle.vertices.map(|vertex| fractions.of(vertex)),
            barycentrics,
        })
    }

    /// Finds what the vertices of visible triangles see.
    fn look(&mut self, visible: &[u32], method: Method, wanted: &(dyn Fn() -> bool + Sync)) {
        let Method::Polar(options) = method else {
            return;
        };
        self.fractions = VertexFractions::new(self, visible, options, wanted);
        if let Some(open) = &mut self.open {
            let caught = |id: &u32| {
                let number = id.checked_sub(open.first_id)?;
                let triangle = self.scene.triangles.get(number as usize)?;
                let material = &self.scene.materials[usize::from(triangle.material)];
                material.shadow_catcher.then_some(*id)
            };
            let caught: Vec<u32> = visible.iter().filter_map(caught).collect();
            open.fractions = VertexFractions::new(open, &caught, options, wanted);
        }
    }
}

impl<'a> Stage<'a> {
    fn new(
        instances: &[Placed<'a>],
        prepared: &[&'a Prepared],
        open: &'a [Option<Open>],
        frame: &Frame<'a>,
        [width, height]: [u32; 2],
        wanted: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, Error> {
        if width == 0 || height == 0 {
            return Err(Error::EmptyImage { width, height });
        }
        let near = (instances.iter())
            .map(|placed| near_plane(bounds(placed.scene)) * placed.placement.scale)
            .fold(f32::INFINITY, f32::min);
        let ids = first_ids(
            instances
                .iter()
                .map(|placed| placed.scene.triangles.len() as u32),
        )?;
        let pattern = visibility_buffer::pattern();
        let samples = if frame.antialias {
            &pattern[..]
        } else {
            &visibility_buffer::CENTRE
        };
        let mut visible = visibility_buffer::Nearest::new([width, height], samples);
        let mut opened = open.iter();
        let stage = |((placed, first_id), &prepared): ((&Placed<'a>, u32), &&'a Prepared)| {
            let scene = placed.scene;
            let local = frame.seen_from(&placed.placement, [width, height], near)?;
            visible.draw(scene, &local.view, first_id);
            let open = opened.next().and_then(Option::as_ref).map(|open| {
                Box::new(Staged {
                    scene: &open.scene,
                    first_id,
                    local: LocalFrame {
                        shadow_map: None,
                        ..local.clone()
                    },
                    prepared: &open.prepared,
                    fractions: None,
                    open: None,
                })
            });
            Ok(Staged {
                scene,
                first_id,
                local,
                prepared,
                fractions: None,
                open,
            })
        };
        let mut instances = (instances.iter().zip(ids).zip(prepared))
            .map(stage)
            .collect::<Result<Vec<_>, Error>>()?;
        for staged in &mut instances {
            staged.look(&visible.ids, frame.method, wanted);
        }
        let world = frame.seen_from(&Placement::IDENTITY, [width, height], near.min(f32::MAX))?;
        let surfaces = frame.antialias.then(|| {
            let sample = |(&id, &depth): (&u32, &f32)| Sample {
                id,
                key: key(&instances, id),
                depth,
            };
            let samples: Vec<Sample> = visible
                .ids
                .par_iter()
                .zip(&visible.depths)
                .map(sample)
                .collect();
            let (pixels, _) = samples.as_chunks();
            Surfaces::new(&world.view, width, pixels)
        });
        let centres = |(index, &id): (u32, &u32)| Item {
            id,
            at: Vec2::new((index % width) as f32, (index / width) as f32) + 0.5,
        };
        Ok(Self {
            size: [width, height],
            instances,
            items: match &surfaces {
                Some(surfaces) => surfaces.items.clone(),
                None => (0..).zip(&visible.ids).map(centres).collect(),
            },
            surfaces,
            reflections: frame.reflections,
            depths: (frame.shadow_map.as_ref())
                .map(ShadowMap::image)
                .transpose()?,
        })
    }

    /// What `shade` makes of every item; the default where that is nothing.
    fn map<T: Default + Send>(
        &self,
        shade: impl Fn(&Seen, &Lighting, &Ssdf) -> T + Sync,
    ) -> Vec<T> {
        self.map_tiles(|pixels| {
            let shade = |ready: &Option<Ready>| {
                (ready.as_ref()).map_or_else(T::default, |ready| {
                    shade(&ready.seen, &ready.lighting, &ready.field)
                })
            };
            pixels.iter().map(shade).collect()
        })
    }

    /// What `shade` makes of tile after tile of items; with antialiasing, of every further surface of a pixel by
    /// itself.
    fn map_tiles<T: Default + Send>(
        &self,
        shade: impl Fn(&[Option<Ready>]) -> Vec<T> + Sync,
    ) -> Vec<T> {
        let lightings: Vec<_> = self
            .instances
            .iter()
            .map(|staged| self.lighting(staged))
            .collect();
        let [width, height] = self.size;
        let tiles_per_row = width.div_ceil(SIDE);
        let tiles = tiles_per_row * height.div_ceil(SIDE);
        let pixels = width * height;
        // Items of a tile, none where the picture ends.
        let items = |tile: u32| {
            let [left, top] = [tile % tiles_per_row * SIDE, tile / tiles_per_row * SIDE];
            (0..PIXELS as u32).map(move |index| {
                let [x, y] = [left + index % SIDE, top + index / SIDE];
                (x < width && y < height).then_some((y * width + x) as usize)
            })
        };
        let shade_tile = |tile: u32| {
            if tile >= tiles {
                let item = &self.items[(pixels + tile - tiles) as usize];
                return shade(&[self.ready(item, &lightings)]);
            }
            let ready: Vec<Option<Ready>> = items(tile)
                .map(|index| self.ready(&self.items[index?], &lightings))
                .collect();
            if ready.iter().all(Option::is_none) {
                return ready.iter().map(|_| T::default()).collect();
            }
            shade(&ready)
        };
        let shaded: Vec<Vec<T>> = (0..tiles + (self.items.len() as u32 - pixels))
            .into_par_iter()
            // Short runs of tiles: some cost a hundred times what others do.
            .with_max_len(4)
            .map(shade_tile)
            .collect();
        let mut all: Vec<T> = self.items.iter().map(|_| T::default()).collect();
        let mut shaded = shaded.into_iter();
        for (tile, shaded) in (0..tiles).zip(&mut shaded) {
            for (index, shaded) in items(tile).zip(shaded) {
                if let Some(index) = index {
                    all[index] = shaded;
                }
            }
        }
        for (item, shaded) in all[pixels as usize..].iter_mut().zip(shaded.flatten()) {
            *item = shaded;
        }
        all
    }

    /// What an item shows, if anything.
    fn ready<'b>(&'b self, item: &Item, lightings: &[Lighting<'b>]) -> Option<Ready<'b>> {
        if item.id == 0 {
            return None;
        }
        let (instance, triangle) = find(&self.instances, item.id);
        let staged = &self.instances[instance];
        let Staged { scene, local, .. } = staged;
        let weights = local
            .view
            .ray(item.at)
            .barycentrics(corners(scene, triangle));
        let eye = local.view.homogeneous_eye();
        let material = scene.triangles[triangle].material;
        let mut lighting = Lighting {
            corners: staged.corners(triangle, weights),
            ..lightings[instance]
        };
        if let (Some(lit), Some(_)) = (&mut lighting.sources, &self.surfaces) {
            lit.pixel = Some(Pixel::around(&local.view, item.at));
        }
        Some(Ready {
            seen: Seen {
                instance,
                point: surface_seen(scene, triangle, weights, eye, Some(staged.filter())),
                triangle,
                barycentrics: weights,
                has_diffuse: has_diffuse(&scene.materials[usize::from(material)]),
                material: u32::from(material),
            },
            field: Ssdf::interpolate(scene, &staged.prepared.basis, triangle, weights),
            lighting,
        })
    }

    /// The same without what hides light, if it is of what catches shadows.
    fn opened<'b>(&'b self, ready: &Ready<'b>) -> Option<Ready<'b>> {
        let Seen {
            instance,
            triangle,
            barycentrics,
            material,
            ..
        } = ready.seen;
        let staged = &self.instances[instance];
        let open = staged.open.as_ref()?;
        if !staged.scene.materials[material as usize].shadow_catcher {
            return None;
        }
        let (field, lighting) = self.light_of(open, triangle, barycentrics);
        Some(Ready {
            seen: ready.seen,
            field,
            lighting,
        })
    }

    /// Visibility and light at a point of an instance's triangle.
    fn light_of<'b>(
        &'b self,
        staged: &'b Staged,
        triangle: usize,
        weights: Vec3,
    ) -> (Ssdf<'b>, Lighting<'b>) {
        let basis = &staged.prepared.basis;
        let lighting = Lighting {
            corners: staged.corners(triangle, weights),
            ..self.lighting(staged)
        };
        let field = Ssdf::interpolate(staged.scene, basis, triangle, weights);
        (field, lighting)
    }

    /// For the next frame.
    fn keep_fractions(self) {
        for Staged {
            prepared,
            fractions,
            ..
        } in self.instances
        {
            if let Some(fractions) = fractions {
                fractions.keep(prepared);
            }
        }
    }

    fn lighting<'b>(&'b self, staged: &'b Staged) -> Lighting<'b> {
        let local = &staged.local;
        Lighting {
            sources: local.sources.as_ref().map(|sources| Lit {
                sources,
                occluders: (staged.prepared.occluders)
                    .get_or_init(|| occluders::build(staged.scene)),
                ray_offset: staged.scene.visibility.ray_offset,
                pixel: None,
                shadow_map: local.shadow_map.zip(self.depths),
            }),
            lights: &local.lights,
            local: &local.local_lights,
            reflections: self.reflections.map(|image| Reflections {
                image,
                rotation: local.reflection_rotation,
            }),
            corners: None,
        }
    }
}

/// Instance and triangle of an id that is not 0.
fn find(instances: &[Staged], id: u32) -> (usize, usize) {
    // The last one that begins there: those without triangles begin there too.
    let instance = instances.partition_point(|staged| staged.first_id <= id) - 1;
    (instance, (id - instances[instance].first_id) as usize)
}

fn corners(scene: &Scene, triangle: usize) -> [Vec3; 3] {
    let corner = |vertex: u32| scene.vertices[vertex as usize].position.into();
    scene.triangles[triangle].vertices.map(corner)
}

/// What tells the surface of a triangle from others.
fn key(instances: &[Staged], id: u32) -> u32 {
    if id == 0 {
        return 0;
    }
    let (instance, triangle) = find(instances, id);
    let Staged { scene, local, .. } = &instances[instance];
    let [a, b, c] = corners(scene, triangle);
    let normal = (local.to_world * (b - a).cross(c - a)).normalize();
    let material = u32::from(scene.triangles[triangle].material);
    surfaces::key(normal, surfaces::tag(material, instance as u32))
}

/// Linear radiance of a frame's background, not exposed, as a picture: alpha is 1, or 0 where there is
/// none.
pub fn background(frame: &Frame, [width, height]: [u32; 2]) -> Result<Image, Error> {
    if width == 0 || height == 0 {
        return Err(Error::EmptyImage { width, height });
    }
    let world = frame.seen_from(&Placement::IDENTITY, [width, height], 1.0)?;
    let to_image = frame.to_image();
    let pixel = |index: u32| {
        let direction = (world.view).pixel_direction(index % width, index / width);
        let radiance = (frame.background).radiance(direction.normalize(), &to_image);
        radiance.map_or([0.0; 4], |radiance| radiance.extend(1.0).to_array())
    };
    Ok(Image {
        width,
        height,
        pixels: (0..width * height).into_par_iter().map(pixel).collect(),
    })
}

/// Tone-mapped sRGB RGBA8 of a linear image over the frame's background, as
/// [`Renderer::render`](crate::Renderer::render) has it in a target that does not encode: multiplied by
/// coverage, and pixels that are covered in part are mixed as they are encoded.
pub fn display(image: &Image, frame: &Frame) -> Result<Vec<u8>, Error> {
    let behind = background(frame, [image.width, image.height])?;
    let stored = |[r, g, b, coverage]: [f32; 4]| {
        let radiance = Vec3::new(r, g, b) / if coverage > 0.0 { coverage } else { 1.0 };
        let color = tonemap::encoded(radiance * frame.exposure);
        (coverage * color).extend(coverage)
    };
    let pixel = |(&above, &below): (&[f32; 4], &[f32; 4])| {
        let above = stored(above);
        let mixed = above + (1.0 - above.w) * stored(below);
        mixed.to_array().map(|value| (value * 255.0).round() as u8)
    };
    Ok((image.pixels.iter().zip(&behind.pixels))
        .flat_map(pixel)
        .collect())
}

/// Tone-mapped sRGB RGBA8 of a linear image, row 0 first; colours are not multiplied by coverage.
pub fn tonemap(image: &Image, exposure: f32) -> Vec<u8> {
    image
        .pixels
        .iter()
        .flat_map(|&pixel| tonemap::pixel(pixel, exposure))
        .collect()
}
