//! Materials of scene files, with the tables, baked materials and textures that they name, to those of
//! the format.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt::Display;
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

    fn invalid(&self, key: &str, expected: impl Display, found: impl Display) -> Error {
        Error::invalid(self.path, self.at(key), expected, found)
    }

    fn below(&self, key: &str) -> Self {
        Self {
            place: self.at(key),
            ..*self
        }
    }
}

/// Replaces the materials of a mesh that a scene file has others for. `measured` gets the tables behind
/// them.
pub(super) fn override_materials(
    files: &Files,
    path: &Path,
    file: &SceneFile,
    mesh: &mut Mesh,
    measured: &mut Vec<(usize, PathBuf)>,
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
    // Made once, however many materials each replaces: fits take seconds.
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
                entry.insert(make(&keys, replacement, &mut mesh.textures)?)
            }
        };
        measured.extend(made.table.clone().map(|table| (index, table)));
        let name = std::mem::take(&mut material.name);
        *material = format::Material {
            name,
            ..made.material.clone()
        };
    }
    mesh.drop_unused_textures();
    Ok(())
}

/// A replacement, read and fitted.
pub(super) struct Made {
    pub(super) material: format::Material,
    /// The measured table behind it, relative to the working directory.
    pub(super) table: Option<PathBuf>,
}

/// Makes the material that a replacement describes; its textures are appended.
pub(super) fn make(
    keys: &Keys,
    replacement: &MaterialOverride,
    textures: &mut Vec<format::Texture>,
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
                    material: import::plain_material("", surface(keys, replacement, textures)?),
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
            )?,
            table: None,
        }),
        _ => Ok(Made {
            material: import::plain_material("", surface(keys, replacement, textures)?),
            table: None,
        }),
    }
}

/// Reads a file of one material, written as in a scene file, with its textures.
pub fn load_material(
    files: &Files,
    path: &Path,
) -> Result<(format::Material, Vec<format::Texture>), Error> {
    let replacement = description::parse_material(path, &files.read_named(path)?)?;
    let place = "material".to_owned();
    let keys = Keys { files, path, place };
    let mut textures = Vec::new();
    let made = make(&keys, &replacement, &mut textures)?;
    Ok((made.material, textures))
}

fn layered_material(
    layers: &[LayerFile],
    [normal_texture, anisotropy_texture]: [&Option<PathBuf>; 2],
    normal_scale: f32,
    keys: &Keys,
    textures: &mut Vec<format::Texture>,
) -> Result<format::Material, Error> {
    use Texels::{Linear, LinearInverted, Srgb};
    let layers = layers
        .iter()
        .enumerate()
        .map(|(index, layer)| -> Result<format::Layer, Error> {
            let keys = keys.below(&format!("layers[{index}]"));
            let format::Surface::DiffuseSpecular { diffuse, specular } =
                surface(&keys.below("material"), &layer.material, textures)?
            else {
                unreachable!("checked when the file was read")
            };
            let reflections = specular.reflections();
            if layer.blend == BlendName::Coat && reflections != 1 {
                let expected = "one reflection of a coat";
                return Err(keys.invalid("material", expected, reflections));
            }
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
    let reflections: usize = layers
        .iter()
        .map(|layer| layer.specular.reflections())
        .sum();
    if reflections > format::MAX_REFLECTIONS {
        return Err(keys.invalid(
            "layers",
            format_args!(
                "at most {} reflections, those of fitted lobes among them",
                format::MAX_REFLECTIONS
            ),
            reflections,
        ));
    }
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
        M::Measured { ref file, .. } => measured_surface(keys, file, textures)?,
        _ => unreachable!("layers do not nest"),
    })
}

/// The lobes of a baked material, or those that are fitted to a table; their textures are appended.
fn measured_surface(
    keys: &Keys,
    file: &Path,
    textures: &mut Vec<format::Texture>,
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
    let table = parse_table(&path, &bytes)?;
    let fitted = fit::corrected(&table, fit::Stop::default());
    textures.push(fitted.ratio);
    let slot = format::TextureSlot::whole(textures.len() as u32 - 1);
    Ok(fitted
        .fit
        .surface(file.to_string_lossy().into_owned(), Some(slot)))
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
