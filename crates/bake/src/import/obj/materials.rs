//! Materials of OBJ files: what their libraries say of those in use, and their textures.

use std::collections::BTreeMap;
use std::path::Path;

use relight_format::{Material, Specular, Surface, Texture, TextureEncoding, TextureSlot};

use super::super::build::Builder;
use super::super::cutout::{Channel, Cutout, Wrap};
use super::super::mtl::{self, Map, MtlMaterial};
use super::super::{Error, image, plain_material};
use super::{DEFAULT_MATERIAL, Described, Obj};
use crate::files::Files;

/// Reads the material libraries and the textures of the materials in use.
pub(super) fn load_materials(
    files: &Files,
    file: &Path,
    obj: &Obj,
    builder: &mut Builder,
) -> Result<(Vec<Described>, Vec<Texture>), Error> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let mut library = BTreeMap::new();
    for names in &obj.libraries {
        // One name with spaces, or several names.
        let whole = folder.join(names.replace('\\', "/"));
        let paths = if files.exists(&whole) {
            vec![whole]
        } else {
            names
                .split_whitespace()
                .map(|name| folder.join(name.replace('\\', "/")))
                .collect()
        };
        let mut missing = Vec::new();
        for path in paths {
            match files.read(&path) {
                Ok(bytes) => {
                    library.extend(mtl::parse(&path, &String::from_utf8_lossy(&bytes))?);
                }
                Err(error) => missing.push(error.to_string()),
            }
        }
        if !missing.is_empty() {
            builder.warn(format!(
                "material libraries cannot be read: {}",
                missing.join("; ")
            ));
        }
    }
    let undefined = |name: &&String| !library.contains_key(*name) && *name != DEFAULT_MATERIAL;
    let undefined: Vec<_> = obj.materials.iter().filter(undefined).cloned().collect();
    if !undefined.is_empty() {
        const NAMED: usize = 8;
        let mut names = undefined[..undefined.len().min(NAMED)].join(", ");
        if undefined.len() > NAMED {
            names += &format!(" and {} more", undefined.len() - NAMED);
        }
        builder.warn(format!(
            "materials are not defined and become grey: {names}"
        ));
    }
    let mut textures = Textures {
        files,
        folder,
        images: BTreeMap::new(),
        list: Vec::new(),
        texels: 0,
    };
    let mut materials = Vec::new();
    for name in &obj.materials {
        let mut described = library.get(name).cloned().unwrap_or_default();
        if !obj.colors.is_empty() {
            described.diffuse = described.diffuse.or(Some([1.0; 3]));
        }
        let material = convert(name, &described, &mut textures, builder)?;
        let cutout = cutout(name, &described, &mut textures, builder)?;
        materials.push((material, cutout));
    }
    Ok((materials, textures.list))
}

fn convert(
    name: &str,
    mtl: &MtlMaterial,
    textures: &mut Textures,
    builder: &mut Builder,
) -> Result<Material, Error> {
    let mut clamped = |color: [f32; 3]| {
        let inside = color.map(|x| x.clamp(0.0, 1.0));
        if inside != color {
            builder.warn(format!(
                "material {name:?}: colours outside [0, 1] are clamped"
            ));
        }
        inside
    };
    // Mitsuba's default, for materials that say nothing.
    let mut diffuse = clamped(mtl.diffuse.unwrap_or([0.5; 3]));
    let specular = clamped(mtl.specular.unwrap_or([0.0; 3]));
    if mtl.diffuse_map.is_some() && (mtl.diffuse.is_none() || diffuse == [0.0; 3]) {
        // Exporters write a black Kd beside a map as often as a white one.
        diffuse = [1.0; 3];
    }
    // Illumination models 0 and 1 have no highlight.
    let shines = specular != [0.0; 3] && mtl.illumination.is_none_or(|model| model >= 2);
    let surface = if mtl.roughness.is_some() || mtl.metallic.is_some() {
        Surface::MetallicRoughness {
            base_color: diffuse,
            metallic: mtl.metallic.unwrap_or(0.0).clamp(0.0, 1.0),
            roughness: mtl.roughness.unwrap_or(1.0).clamp(0.0, 1.0),
            anisotropy_strength: 0.0,
            anisotropy_rotation: 0.0,
        }
    } else {
        let specular = if shines {
            Specular::BlinnPhong {
                specular,
                exponent: mtl.exponent.unwrap_or(1.0).max(1.0),
            }
        } else {
            Specular::None
        };
        Surface::DiffuseSpecular { diffuse, specular }
    };
    if !mtl.ignored_maps.is_empty() {
        let maps = mtl.ignored_maps.join(", ");
        builder.warn(format!("material {name:?}: {maps} left out"));
    }
    let mut material = plain_material(name, surface);
    let emission = mtl.emission.unwrap_or(if mtl.emission_map.is_some() {
        [1.0; 3]
    } else {
        [0.0; 3]
    });
    material.emission = emission.map(|x| x.max(0.0));
    if material.emission != emission {
        builder.warn(format!("material {name:?}: negative emission is left out"));
    }
    if let Some(map) = (mtl.emission_map.as_ref()).filter(|_| material.emission != [0.0; 3]) {
        material.emission_texture = textures.slot(map, TextureEncoding::Srgb, builder)?;
    }
    if let Some(map) = &mtl.diffuse_map {
        material.base_color_texture = textures.slot(map, TextureEncoding::Srgb, builder)?;
    }
    if let Some(map) = mtl.normal_map.as_ref().or(mtl.bump_map.as_ref()) {
        let slot = textures.slot(map, TextureEncoding::Linear, builder)?;
        let is_normal_map = |slot: &TextureSlot| {
            mtl.normal_map.is_some() || looks_like_normals(&textures.list[slot.texture as usize])
        };
        if slot.as_ref().is_some_and(|slot| !is_normal_map(slot)) {
            builder.warn(format!("material {name:?}: a height map is left out"));
        }
        material.normal_texture = slot.filter(is_normal_map);
    }
    Ok(material)
}

/// What a material's opacity cuts away.
fn cutout(
    name: &str,
    mtl: &MtlMaterial,
    textures: &mut Textures,
    builder: &mut Builder,
) -> Result<Option<Cutout>, Error> {
    /// Opacity below which nothing is left, where the scene file has no other.
    const CUTOFF: f32 = 0.5;
    let factor = mtl.opacity.unwrap_or(1.0);
    let cutoff = builder.options.cutoffs.get(name).copied();
    if cutoff == Some(0.0) {
        return Ok(None);
    }
    // A scene file may ask for the alpha of the colours, which OBJ files do not use.
    let colors = mtl.diffuse_map.as_ref().filter(|_| cutoff.is_some());
    let Some(map) = mtl.opacity_map.as_ref().or(colors) else {
        if factor < 1.0 {
            builder.warn(format!(
                "material {name:?} is transparent (d {factor}) and is baked as opaque"
            ));
        }
        return Ok(None);
    };
    let Some(slot) = textures.slot(map, TextureEncoding::Linear, builder)? else {
        return Ok(None);
    };
    // Programs write the picture whose alpha is meant as often as one of greys.
    let texels = textures.list[slot.texture as usize]
        .texels
        .as_chunks::<4>()
        .0;
    let has_alpha = texels.iter().any(|texel| texel[3] < u8::MAX);
    let wrap = if map.clamp { Wrap::Clamp } else { Wrap::Repeat };
    Ok(Some(Cutout {
        slot,
        channel: if has_alpha || mtl.opacity_map.is_none() {
            Channel::Alpha
        } else {
            Channel::Red
        },
        wrap: [wrap; 2],
        factor: factor.clamp(0.0, 1.0),
        cutoff: cutoff.unwrap_or(CUTOFF),
    }))
}

/// Whether an image is mostly the blue of normals that point up, where a height map is grey.
fn looks_like_normals(texture: &Texture) -> bool {
    let mut sums = [0u64; 4];
    for texel in texture.texels.as_chunks::<4>().0 {
        for (sum, &value) in sums.iter_mut().zip(texel) {
            *sum += u64::from(value);
        }
    }
    let [red, green, blue, _] = sums;
    blue > red + red / 4 && blue > green + green / 4
}

/// Textures read so far.
struct Textures<'a> {
    files: &'a Files,
    folder: &'a Path,
    /// Index into `list`, or none if unreadable, by file and encoding.
    images: BTreeMap<(String, bool), Option<u32>>,
    list: Vec<Texture>,
    texels: u64,
}

impl Textures<'_> {
    /// The texture of a map. OBJ files travel without their textures so often that a missing
    /// one is a warning.
    fn slot(
        &mut self,
        map: &Map,
        encoding: TextureEncoding,
        builder: &mut Builder,
    ) -> Result<Option<TextureSlot>, Error> {
        let key = (map.file.clone(), encoding == TextureEncoding::Srgb);
        let index = if let Some(index) = self.images.get(&key) {
            *index
        } else {
            let path = self.folder.join(&map.file);
            let index = match self.files.read(&path) {
                Ok(bytes) => {
                    let image = image::decode(
                        &path,
                        "image",
                        &bytes,
                        encoding,
                        &mut self.texels,
                        self.files.access().max_texels,
                    )?;
                    self.list.push(image);
                    Some(self.list.len() as u32 - 1)
                }
                Err(error) => {
                    builder.warn(format!("a texture is left out: {error}"));
                    None
                }
            };
            self.images.insert(key, index);
            index
        };
        let ([su, sv], [ou, ov]) = (map.scale, map.offset);
        // OBJ's v points up: v' = 1 - ((1 - v) sv + ov).
        let transform = [[su, 0.0, ou], [0.0, sv, 1.0 - sv - ov]];
        Ok(index.map(|texture| TextureSlot {
            transform,
            ..TextureSlot::whole(texture)
        }))
    }
}
