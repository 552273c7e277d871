//! Materials of scene files, with the tables, baked materials and textures that they name, to those of
//! the format.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};

use relight_format as format;

use crate::error::Error;
use crate::files::Files;
use crate::import;
use crate::measured::{Table, fit};
use crate::mesh::Mesh;
use crate::scene::description::{self, BlendName, LayerFile, MaterialOverride, SceneFile};

/// The keys of a scene file below which a material is written. What it names is relative to that file.
pub(super) struct Keys<'a> {
    pub(super) files: &'a Files,
    /// The scene file.
    pub(super) path: &'a Path,
    /// For messages.
    pub(super) place: String,
}

impl Keys<'_> {
    /// Relative to the working directory.
    fn resolve(&self, reference: &Path) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("")).join(reference)
    }

    fn at(&self, key: &str) -> String {
        format!("{}.{key}", self.place)
    }

    /// The path and the bytes of the file that a key names.
    fn read(&self, key: &str, reference: &Path) -> Result<(PathBuf, Vec<u8>), Error> {
        let path = self.resolve(reference);
        let bytes = self.files.read(&path);
        let bytes = bytes.map_err(|error| error.referred_to(self.path, self.at(key)))?;
        Ok((path, bytes))
    }

    fn below(&self, key: &str) -> Self {
        Self {
            place: self.at(key),
            ..*self
        }
    }
}

/// What is known of the materials of a scene file beside themselves.
#[derive(Default)]
pub(super) struct Replaced {
    /// Index into the mesh's materials, and path of the measured table behind it, relative to the working directory.
    pub(super) measured: Vec<(usize, PathBuf)>,
    /// Tables that have no lobes yet, by the paths that [`format::Specular::Lobes`] has of them.
    tables: Tables,
    /// Index of each that is made of layers, and the keys that it is written below.
    layered: Vec<(usize, String)>,
}

/// Measured tables by their paths as they are written.
pub(super) type Tables = BTreeMap<String, Table>;

impl Replaced {
    /// Keeps what was made for a material.
    pub(super) fn note(&mut self, index: usize, made: &Made, place: &str) {
        let table = made.table.clone();
        self.measured.extend(table.map(|table| (index, table)));
        if matches!(made.material.surface, format::Surface::Layers { .. }) {
            self.layered.push((index, place.to_owned()));
        }
    }

    /// [`make`] with these tables.
    pub(super) fn make(
        &mut self,
        keys: &Keys,
        replacement: &MaterialOverride,
        textures: &mut Vec<format::Texture>,
    ) -> Result<Made, Error> {
        make(keys, replacement, textures, &mut self.tables)
    }

    /// Whether [`Replaced::fit`] has anything to do.
    pub(super) fn has_tables(&self) -> bool {
        !self.tables.is_empty()
    }

    /// Gives measured materials their lobes, then checks that layers have no more than they may.
    pub(super) fn fit(&self, scene: &Path, mesh: &mut Mesh) -> Result<(), Error> {
        fit_tables(&self.tables, &mut mesh.materials, &mut mesh.textures);
        for (index, place) in &self.layered {
            check_layers(scene, place, &mesh.materials[*index])?;
        }
        Ok(())
    }
}

/// Fits every table and puts its lobes, its diffuse base and its texture where they are missing.
fn fit_tables(
    tables: &Tables,
    materials: &mut [format::Material],
    textures: &mut [format::Texture],
) {
    for (written, table) in tables {
        let fitted = fit::corrected(table, fit::Stop::default());
        for (diffuse, specular) in materials.iter_mut().flat_map(reflections_mut) {
            if let format::Specular::Lobes { path, lobes, ratio } = specular
                && lobes.is_empty()
                && path == written
            {
                *diffuse = fitted.fit.diffuse;
                lobes.clone_from(&fitted.fit.lobes);
                if let Some(slot) = ratio {
                    textures[slot.texture as usize] = fitted.ratio.clone();
                }
            }
        }
    }
}

/// Every Lambertian base of a material with the reflection over it.
fn reflections_mut(material: &mut format::Material) -> Vec<(&mut [f32; 3], &mut format::Specular)> {
    match &mut material.surface {
        format::Surface::MetallicRoughness { .. } => Vec::new(),
        format::Surface::DiffuseSpecular { diffuse, specular } => vec![(diffuse, specular)],
        format::Surface::Layers { layers } => (layers.iter_mut())
            .map(|layer| (&mut layer.diffuse, &mut layer.specular))
            .collect(),
    }
}

/// How many reflections layers may have, all lobes of measured ones counted.
fn check_layers(scene: &Path, place: &str, material: &format::Material) -> Result<(), Error> {
    let format::Surface::Layers { layers } = &material.surface else {
        return Ok(());
    };
    for (index, layer) in layers.iter().enumerate() {
        let reflections = layer.specular.reflections();
        if layer.blend == format::Blend::Coat && reflections != 1 {
            let place = format!("{place}.layers[{index}].material");
            let expected = "one reflection of a coat";
            return Err(Error::invalid(scene, place, expected, reflections));
        }
    }
    let reflections: usize = layers
        .iter()
        .map(|layer| layer.specular.reflections())
        .sum();
    if reflections > format::MAX_REFLECTIONS {
        return Err(Error::invalid(
            scene,
            format_args!("{place}.layers"),
            format_args!(
                "at most {} reflections, those of fitted lobes among them",
                format::MAX_REFLECTIONS
            ),
            reflections,
        ));
    }
    Ok(())
}

/// Replaces the materials of a mesh that a scene file has others for.
pub(super) fn override_materials(
    files: &Files,
    path: &Path,
    file: &SceneFile,
    mesh: &mut Mesh,
    replaced: &mut Replaced,
) -> Result<(), Error> {
    for name in file.materials.keys().filter(|name| *name != "default") {
        if mesh.materials.iter().all(|material| material.name != *name) {
            let names: Vec<_> = mesh
                .materials
                .iter()
                .map(|m| format!("{:?}", m.name))
                .collect();
            return Err(Error::invalid(
                path,
                format_args!("materials.{name}"),
                format_args!("default or a material of the mesh: {}", names.join(", ")),
                format_args!("{name:?}"),
            ));
        }
    }
    // Made once, however many materials each replaces: tables are large.
    let mut made = BTreeMap::new();
    for (index, material) in mesh.materials.iter_mut().enumerate() {
        let replacement = file
            .materials
            .get_key_value(&material.name)
            .or_else(|| file.materials.get_key_value("default"));
        let Some((key, replacement)) = replacement else {
            continue;
        };
        let made = match made.entry(key) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => {
                let place = format!("materials.{key}");
                let keys = Keys { files, path, place };
                entry.insert(replaced.make(&keys, replacement, &mut mesh.textures)?)
            }
        };
        replaced.note(index, made, &format!("materials.{key}"));
        let name = std::mem::take(&mut material.name);
        *material = format::Material {
            name,
            ..made.material.clone()
        };
    }
    mesh.drop_unused_textures();
    Ok(())
}

/// A replacement, read.
pub(super) struct Made {
    pub(super) material: format::Material,
    /// The measured table behind it, relative to the working directory.
    pub(super) table: Option<PathBuf>,
}

/// Makes the material that a replacement describes; its textures are appended, and the tables that lobes are
/// to be fitted to.
fn make(
    keys: &Keys,
    replacement: &MaterialOverride,
    textures: &mut Vec<format::Texture>,
    tables: &mut Tables,
) -> Result<Made, Error> {
    match replacement {
        MaterialOverride::Measured { file, original } => {
            let original = match original {
                Some(original) => {
                    let path = keys.resolve(original);
                    let opened = keys.files.open(&path);
                    opened.map_err(|error| error.referred_to(keys.path, keys.at("original")))?;
                    Some(path)
                }
                None => None,
            };
            if !is_baked(file) {
                return Ok(Made {
                    material: import::plain_material(
                        "",
                        surface(keys, replacement, textures, tables)?,
                    ),
                    table: Some(keys.resolve(file)),
                });
            }
            Ok(Made {
                material: appended(baked(keys, file)?, textures),
                table: original,
            })
        }
        MaterialOverride::Layers {
            layers,
            normal_texture,
            normal_scale,
            anisotropy_texture,
        } => Ok(Made {
            material: layered_material(
                layers,
                [normal_texture, anisotropy_texture],
                *normal_scale,
                keys,
                textures,
                tables,
            )?,
            table: None,
        }),
        _ => Ok(Made {
            material: import::plain_material("", surface(keys, replacement, textures, tables)?),
            table: None,
        }),
    }
}

/// Reads a file of one material, written as in a scene file, with its textures, and fits the tables that it names.
pub fn load_material(
    files: &Files,
    path: &Path,
) -> Result<(format::Material, Vec<format::Texture>), Error> {
    let replacement = description::parse_material(path, &files.read_named(path)?)?;
    let place = "material".to_owned();
    let keys = Keys { files, path, place };
    let (mut textures, mut tables) = (Vec::new(), Tables::new());
    let mut material = make(&keys, &replacement, &mut textures, &mut tables)?.material;
    fit_tables(&tables, std::slice::from_mut(&mut material), &mut textures);
    check_layers(path, &keys.place, &material)?;
    Ok((material, textures))
}

fn layered_material(
    layers: &[LayerFile],
    [normal_texture, anisotropy_texture]: [&Option<PathBuf>; 2],
    normal_scale: f32,
    keys: &Keys,
    textures: &mut Vec<format::Texture>,
    tables: &mut Tables,
) -> Result<format::Material, Error> {
    use Texels::{Linear, LinearInverted, Srgb};
    let layers = layers
        .iter()
        .enumerate()
        .map(|(index, layer)| -> Result<format::Layer, Error> {
            let keys = keys.below(&format!("layers[{index}]"));
            let format::Surface::DiffuseSpecular { diffuse, specular } =
                surface(&keys.below("material"), &layer.material, textures, tables)?
            else {
                unreachable!("checked when the file was read")
            };
            let mut slot = |key, file: &Option<PathBuf>, texels| {
                texture_slot(&keys, key, file.as_deref(), texels, textures)
            };
            let roughness = slot("roughness_texture", &layer.roughness_texture, Linear)?;
            Ok(format::Layer {
                diffuse,
                specular,
                weight: layer.weight,
                blend: match layer.blend {
                    BlendName::Over => format::Blend::Over,
                    BlendName::Coat => format::Blend::Coat,
                },
                diffuse_texture: slot("diffuse_texture", &layer.diffuse_texture, Srgb)?,
                specular_texture: slot("specular_texture", &layer.specular_texture, Srgb)?,
                roughness_texture: match roughness {
                    None => slot(
                        "glossiness_texture",
                        &layer.glossiness_texture,
                        LinearInverted,
                    )?,
                    some => some,
                },
                weight_texture: slot("weight_texture", &layer.weight_texture, Linear)?,
            })
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut slot =
        |key, file: &Option<PathBuf>| texture_slot(keys, key, file.as_deref(), Linear, textures);
    Ok(format::Material {
        normal_texture: slot("normal_texture", normal_texture)?,
        anisotropy_texture: slot("anisotropy_texture", anisotropy_texture)?,
        normal_scale,
        ..import::plain_material("", format::Surface::Layers { layers })
    })
}

/// The surface that a replacement without textures of its own describes; what measured ones come
/// with is appended to `textures`. Its values were checked when it was read.
fn surface(
    keys: &Keys,
    material: &MaterialOverride,
    textures: &mut Vec<format::Texture>,
    tables: &mut Tables,
) -> Result<format::Surface, Error> {
    use MaterialOverride as M;
    if let Some((diffuse, specular)) = material.reflection() {
        let diffuse = diffuse.rgb();
        return Ok(format::Surface::DiffuseSpecular { diffuse, specular });
    }
    Ok(match *material {
        M::MetallicRoughness {
            base_color,
            metallic,
            roughness,
            anisotropy_strength,
            anisotropy_rotation_degrees,
        } => format::Surface::MetallicRoughness {
            base_color: base_color.rgb(),
            metallic,
            roughness,
            anisotropy_strength,
            anisotropy_rotation: anisotropy_rotation_degrees.to_radians(),
        },
        M::Measured { ref file, .. } => measured_surface(keys, file, textures, tables)?,
        _ => unreachable!("layers do not nest"),
    })
}

/// The lobes of a baked material, or room for those that [`fit_tables`] finds; their textures are appended.
fn measured_surface(
    keys: &Keys,
    file: &Path,
    textures: &mut Vec<format::Texture>,
    tables: &mut Tables,
) -> Result<format::Surface, Error> {
    if is_baked(file) {
        let material = appended(baked(keys, file)?, textures);
        return match material.surface {
            surface @ format::Surface::DiffuseSpecular { .. } => Ok(surface),
            _ => Err(Error::invalid(
                &keys.resolve(file),
                "file",
                "lobes fitted to a table",
                "layers, which do not nest",
            )),
        };
    }
    let (path, bytes) = keys.read("file", file)?;
    let written = file.to_string_lossy().into_owned();
    tables.insert(written.clone(), parse_table(&path, &bytes)?);
    textures.push(format::Texture {
        width: 0,
        height: 0,
        encoding: format::TextureEncoding::Rgbe,
        texels: Vec::new(),
    });
    let slot = format::TextureSlot::whole(textures.len() as u32 - 1);
    Ok(format::Surface::DiffuseSpecular {
        diffuse: [0.0; 3],
        specular: format::Specular::Lobes {
            path: written,
            lobes: Vec::new(),
            ratio: Some(slot),
        },
    })
}

/// An asset's material; its textures are appended.
fn appended(asset: format::MaterialAsset, textures: &mut Vec<format::Texture>) -> format::Material {
    let mut material = asset.material;
    for slot in material.slots_mut() {
        slot.texture += textures.len() as u32;
    }
    textures.extend(asset.textures);
    material
}

/// Whether a material is baked, in place of a table that lobes are to be fitted to.
fn is_baked(file: &Path) -> bool {
    file.extension()
        .is_some_and(|extension| extension == "relight")
}

/// A baked material that a scene file names.
fn baked(keys: &Keys, file: &Path) -> Result<format::MaterialAsset, Error> {
    let (path, bytes) = keys.read("file", file)?;
    let read = format::read_material(&bytes, &format::Limits::default());
    read.map_err(|error| Error::asset(&path, error))
}

/// What the texels of a file stand for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Texels {
    Srgb,
    Linear,
    /// Glossiness, which is stored as roughness.
    LinearInverted,
}

/// The texture that a key names, appended to the others.
fn texture_slot(
    keys: &Keys,
    key: &str,
    file: Option<&Path>,
    texels: Texels,
    textures: &mut Vec<format::Texture>,
) -> Result<Option<format::TextureSlot>, Error> {
    let Some(file) = file else { return Ok(None) };
    let (path, bytes) = keys.read(key, file)?;
    let encoding = match texels {
        Texels::Srgb => format::TextureEncoding::Srgb,
        Texels::Linear | Texels::LinearInverted => format::TextureEncoding::Linear,
    };
    let mut texture = import::texture(keys.files, &path, &bytes, encoding, textures)?;
    if texels == Texels::LinearInverted {
        for texel in texture.texels.as_chunks_mut::<4>().0 {
            for channel in &mut texel[..3] {
                *channel = 255 - *channel;
            }
        }
    }
    textures.push(texture);
    Ok(Some(format::TextureSlot::whole(textures.len() as u32 - 1)))
}

/// Decodes a table; errors name the file.
pub fn parse_table(path: &Path, bytes: &[u8]) -> Result<Table, Error> {
    Table::parse(bytes).map_err(|objection| objection.in_file(path))
}
