//! Materials and their textures.

use relight_format::math;
use std::borrow::Cow;
use std::collections::BTreeMap;

use gltf::json::texture::{Sampler, WrappingMode};
use gltf::json::validation::Checked;
use gltf::json::{Image, Index, material, texture};
use relight_format::{Material, Surface, Texture, TextureEncoding, TextureSlot};
use serde::Deserialize;

use super::super::build::Builder;
use super::super::cutout::{Channel, Cutout, Wrap};
use super::super::{Error, image, plain_material};
use super::{Document, resolve};

/// A material and what its primitives must know.
pub(super) struct Converted {
    pub(super) material: Material,
    /// n of the TEXCOORD_n that its textures use: that which tangents follow, and another.
    pub(super) uv_sets: (u32, Option<u32>),
    pub(super) double_sided: bool,
    pub(super) needs_tangents: bool,
    pub(super) cutout: Option<Cutout>,
}

impl Converted {
    pub(super) fn has_textures(&self) -> bool {
        let material = &self.material;
        material.base_color_texture.is_some()
            || material.metallic_roughness_texture.is_some()
            || material.normal_texture.is_some()
            || material.anisotropy_texture.is_some()
            || material.emission_texture.is_some()
    }
}

/// Materials and textures converted so far: only what a primitive uses.
pub(super) struct Materials<'a> {
    document: &'a Document<'a>,
    /// Index into `list` by index into the file's materials; `None` is the default material.
    converted: BTreeMap<Option<usize>, usize>,
    pub(super) list: Vec<Converted>,
    /// Index into `textures` by index into the file's images and encoding.
    images: BTreeMap<(usize, bool), u32>,
    pub(super) textures: Vec<Texture>,
    texels: u64,
}

/// A texture reference of whatever kind.
struct Reference {
    place: String,
    texture: Index<texture::Texture>,
    uv_set: u32,
    transform: TextureTransform,
    encoding: TextureEncoding,
}

/// `KHR_texture_transform`, which the JSON types know on some texture references only.
#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct TextureTransform {
    offset: [f32; 2],
    rotation: f32,
    scale: [f32; 2],
    tex_coord: Option<u32>,
}

impl Default for TextureTransform {
    fn default() -> Self {
        Self {
            offset: [0.0; 2],
            rotation: 0.0,
            scale: [1.0; 2],
            tex_coord: None,
        }
    }
}

impl TextureTransform {
    /// Rows of the map from (u, v, 1): scale, then rotation, counter-clockwise as seen on an
    /// image whose v points down, then translation.
    fn rows(&self) -> [[f32; 3]; 2] {
        let ([su, sv], [ou, ov]) = (self.scale, self.offset);
        let (sin, cos) = math::sin_cos(self.rotation);
        [[cos * su, sin * sv, ou], [-sin * su, cos * sv, ov]]
    }
}

/// `KHR_materials_anisotropy`.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Anisotropy {
    #[serde(rename = "anisotropyStrength")]
    strength: f32,
    #[serde(rename = "anisotropyRotation")]
    rotation: f32,
    #[serde(rename = "anisotropyTexture")]
    texture: Option<texture::Info>,
}

/// `KHR_materials_emissive_strength`.
#[derive(Deserialize)]
#[serde(default)]
struct EmissiveStrength {
    #[serde(rename = "emissiveStrength")]
    strength: f32,
}

impl Default for EmissiveStrength {
    fn default() -> Self {
        Self { strength: 1.0 }
    }
}

/// `EXT_texture_webp`.
#[derive(Deserialize)]
struct Source {
    source: Index<Image>,
}

pub(super) const EMISSIVE_STRENGTH: &str = "KHR_materials_emissive_strength";
pub(super) const WEBP: &str = "EXT_texture_webp";
pub(super) const BASISU: &str = "KHR_texture_basisu";

fn document_lacks(document: &Document, image: Index<Image>) -> bool {
    image.value() >= document.root.images.len()
}

impl<'a> Materials<'a> {
    pub(super) fn new(document: &'a Document<'a>) -> Self {
        Self {
            document,
            converted: BTreeMap::new(),
            list: Vec::new(),
            images: BTreeMap::new(),
            textures: Vec::new(),
            texels: 0,
        }
    }

    /// Converts a material once; gives its index into `list`.
    #[allow(
        clippy::too_many_lines,
        reason = "one material, key by key, in the order of the specification"
    )]
    pub(super) fn convert(
        &mut self,
        index: Option<Index<material::Material>>,
        builder: &mut Builder,
    ) -> Result<usize, Error> {
        let key = index.map(|index| index.value());
        if let Some(done) = self.converted.get(&key) {
            return Ok(*done);
        }
        let default = material::Material::default();
        let (place, source) = match index {
            Some(index) => {
                let place = format!("materials[{index}]");
                (place.clone(), self.document.get(index, &place)?)
            }
            None => ("default material".into(), &default),
        };
        let unnamed = || key.map_or("default".into(), |index| format!("material {index}"));
        let name = source.name.clone().unwrap_or_else(unnamed);
        let anisotropy = match extension(source.extensions.as_ref().map(|e| &e.others), ANISOTROPY)
        {
            Some(value) => self.parse::<Anisotropy>(value, &format!("{place}.{ANISOTROPY}"))?,
            None => Anisotropy::default(),
        };
        let others = source.extensions.as_ref().map(|e| &e.others);
        let strength = match extension(others, EMISSIVE_STRENGTH) {
            Some(value) => {
                let place = format!("{place}.{EMISSIVE_STRENGTH}");
                self.parse::<EmissiveStrength>(value, &place)?.strength
            }
            None => 1.0,
        };
        let emission = source.emissive_factor.0.map(|factor| factor * strength);
        if !emission.iter().all(|x| x.is_finite() && *x >= 0.0) {
            let expected = "a finite emission of at least 0";
            let found = format!("{emission:?}");
            return Err(self.document.invalid(place, expected, found));
        }

        let metallic_roughness = &source.pbr_metallic_roughness;
        let rotation = anisotropy.rotation;
        let numbers = [
            source.normal_texture.as_ref().map_or(1.0, |t| t.scale),
            rotation,
        ];
        if !numbers.iter().all(|number| number.is_finite()) {
            let expected = "a finite normal scale and anisotropy rotation";
            return Err(self
                .document
                .invalid(place, expected, format_args!("{numbers:?}")));
        }
        let mut unit = |value: f32| {
            if !(0.0..=1.0).contains(&value) {
                builder.warn(format!(
                    "material {name:?}: factors outside [0, 1] are clamped"
                ));
            }
            value.clamp(0.0, 1.0)
        };
        let [red, green, blue, alpha] = metallic_roughness.base_color_factor.0;
        if !alpha.is_finite() {
            return Err(self.document.invalid(place, "a finite alpha", alpha));
        }
        let surface = Surface::MetallicRoughness {
            base_color: [red, green, blue].map(&mut unit),
            metallic: unit(metallic_roughness.metallic_factor.0),
            roughness: unit(metallic_roughness.roughness_factor.0),
            anisotropy_strength: unit(anisotropy.strength),
            anisotropy_rotation: rotation,
        };

        let info = |info: &Option<texture::Info>, what: &str, encoding| {
            let info = info.as_ref()?;
            let given = info
                .extensions
                .as_ref()
                .and_then(|e| e.texture_transform.as_ref());
            let transform = given.map_or_else(TextureTransform::default, |t| TextureTransform {
                offset: t.offset.0,
                rotation: t.rotation.0,
                scale: t.scale.0,
                tex_coord: t.tex_coord,
            });
            let place = format!("{place}.{what}");
            Some(Reference {
                place,
                texture: info.index,
                uv_set: info.tex_coord,
                transform,
                encoding,
            })
        };
        let base_color = &metallic_roughness.base_color_texture;
        let colored = base_color.as_ref().map(|info| info.index);
        let packed = &metallic_roughness.metallic_roughness_texture;
        let normal = match &source.normal_texture {
            Some(normal) => {
                let place = format!("{place}.normalTexture");
                let others = normal.extensions.as_ref().map(|e| &e.others);
                let transform = match extension(others, "KHR_texture_transform") {
                    Some(value) => self.parse(value, &place)?,
                    None => TextureTransform::default(),
                };
                let encoding = TextureEncoding::Linear;
                let (texture, uv_set) = (normal.index, normal.tex_coord);
                Some(Reference {
                    place,
                    texture,
                    uv_set,
                    transform,
                    encoding,
                })
            }
            None => None,
        };
        let references = [
            info(base_color, "baseColorTexture", TextureEncoding::Srgb),
            info(packed, "metallicRoughnessTexture", TextureEncoding::Linear),
            normal,
            info(
                &anisotropy.texture,
                "anisotropyTexture",
                TextureEncoding::Linear,
            ),
            info(
                &source.emissive_texture,
                "emissiveTexture",
                TextureEncoding::Srgb,
            )
            .filter(|_| emission != [0.0; 3]),
        ];
        let set = |reference: &Reference| reference.transform.tex_coord.unwrap_or(reference.uv_set);
        // Tangents are those of the normal map's coordinates, or else of the anisotropy's.
        let framed = [2, 3]
            .into_iter()
            .find_map(|index| references[index].as_ref());
        let sets = framed.into_iter().chain(references.iter().flatten());
        let sets: Vec<u32> = sets.map(set).collect();
        let first = sets.first().copied().unwrap_or(0);
        let second = sets.into_iter().find(|set| *set != first);
        let mut slots = [None; 5];
        for (slot, reference) in slots.iter_mut().zip(references) {
            let Some(reference) = reference else { continue };
            let own = set(&reference);
            if own == first || Some(own) == second {
                *slot = Some(TextureSlot {
                    second_uv: own != first,
                    ..self.slot(&reference, builder)?
                });
            } else {
                builder.warn(format!(
                    "{} uses a third set of texture coordinates, beside two that other textures of \
                     the material use, and is left out",
                    reference.place
                ));
            }
        }
        let [
            base_color_texture,
            metallic_roughness_texture,
            normal_texture,
            anisotropy_texture,
            emission_texture,
        ] = slots;
        let material = Material {
            base_color_texture,
            metallic_roughness_texture,
            normal_texture,
            anisotropy_texture,
            emission,
            emission_texture,
            normal_scale: numbers[0],
            ..plain_material(&name, surface)
        };
        let cutout = self.cutout(
            source,
            alpha,
            colored.zip(base_color_texture),
            &name,
            builder,
        )?;
        self.list.push(Converted {
            cutout,
            needs_tangents: normal_texture.is_some() || anisotropy.strength > 0.0,
            material,
            uv_sets: (first, second),
            double_sided: source.double_sided,
        });
        self.converted.insert(key, self.list.len() - 1);
        Ok(self.list.len() - 1)
    }

    /// What a material's alpha cuts away: its texture in the slot given with it, times `factor`.
    fn cutout(
        &self,
        source: &material::Material,
        factor: f32,
        colored: Option<(Index<texture::Texture>, TextureSlot)>,
        name: &str,
        builder: &mut Builder,
    ) -> Result<Option<Cutout>, Error> {
        use material::AlphaMode;
        let mode = match source.alpha_mode {
            Checked::Valid(mode) => mode,
            Checked::Invalid => AlphaMode::Opaque,
        };
        let own = source
            .alpha_cutoff
            .map_or(DEFAULT_CUTOFF, |cutoff| cutoff.0);
        let override_cutoff = builder.options.cutoffs.get(name).copied();
        let cutoff = match (override_cutoff, mode) {
            (Some(cutoff), _) => cutoff,
            (None, AlphaMode::Opaque) => return Ok(None),
            (None, AlphaMode::Mask) => own,
            (None, AlphaMode::Blend) => {
                let texels = colored.map(|(_, slot)| &self.textures[slot.texture as usize]);
                if texels.is_some_and(is_outline) {
                    builder.warn(format!(
                        "material {name:?} is transparent (alphaMode BLEND); its alpha is nearly \
                         0 or 1 everywhere, so it is cut away below {DEFAULT_CUTOFF}"
                    ));
                    DEFAULT_CUTOFF
                } else {
                    builder.warn(format!(
                        "material {name:?} is transparent (alphaMode BLEND) and is baked as \
                         opaque; [cutout] in a scene file cuts it where its alpha is low"
                    ));
                    return Ok(None);
                }
            }
        };
        if !cutoff.is_finite() {
            let found = cutoff.to_string();
            return Err(self.document.invalid(name, "a finite alphaCutoff", found));
        }
        if cutoff <= 0.0 {
            return Ok(None);
        }
        let Some((texture, slot)) = colored else {
            if factor < cutoff {
                builder.warn(format!(
                    "material {name:?} is wholly transparent: its alpha, {factor}, is below \
                     {cutoff}, but it has no texture to cut by; it is baked as opaque"
                ));
            }
            return Ok(None);
        };
        let texture = self.document.get(texture, name)?;
        let wrap = match texture.sampler {
            None => [Wrap::Repeat; 2],
            Some(index) => {
                let Sampler { wrap_s, wrap_t, .. } = self.document.get(index, name)?;
                [wrap_s, wrap_t].map(|mode| match mode {
                    Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
                    Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
                    _ => Wrap::Repeat,
                })
            }
        };
        Ok(Some(Cutout {
            slot,
            channel: Channel::Alpha,
            wrap,
            factor: factor.max(0.0),
            cutoff,
        }))
    }

    /// The image of a texture: a WebP one where there is a choice.
    fn image(&self, texture: &texture::Texture, place: &str) -> Result<Index<Image>, Error> {
        let others = texture.extensions.as_ref().map(|e| &e.others);
        if let Some(value) = extension(others, WEBP) {
            let place = format!("{place}.{WEBP}");
            return Ok(self.parse::<Source>(value, &place)?.source);
        }
        // Its index is then out of range.
        let none = document_lacks(self.document, texture.source);
        if none && extension(others, BASISU).is_some() {
            return Err(super::unsupported(self.document.file, place, BASISU));
        }
        Ok(texture.source)
    }

    fn parse<T: serde::de::DeserializeOwned>(
        &self,
        value: &serde_json::Value,
        place: &str,
    ) -> Result<T, Error> {
        T::deserialize(value).map_err(|error| {
            self.document
                .invalid(place, "an object as the extension specifies", error)
        })
    }

    fn slot(&mut self, reference: &Reference, builder: &mut Builder) -> Result<TextureSlot, Error> {
        let document = self.document;
        let place = &reference.place;
        let transform = reference.transform.rows();
        if !transform.iter().flatten().all(|value| value.is_finite()) {
            let found = format!("{transform:?}");
            return Err(document.invalid(place, "a finite texture transform", found));
        }
        let texture = document.get(reference.texture, place)?;
        if let Some(index) = texture.sampler {
            let Sampler { wrap_s, wrap_t, .. } = document.get(index, place)?;
            if [wrap_s, wrap_t]
                .into_iter()
                .any(|mode| *mode != Checked::Valid(WrappingMode::Repeat))
            {
                builder.warn(format!("{place} does not repeat in its sampler, but will"));
            }
        }
        let image = self.image(texture, place)?;
        let key = (image.value(), reference.encoding == TextureEncoding::Srgb);
        if let Some(&texture) = self.images.get(&key) {
            return Ok(TextureSlot {
                transform,
                ..TextureSlot::whole(texture)
            });
        }
        let source = document.get(image, place)?;
        let place = format!("images[{image}]");
        let bytes = match (&source.uri, source.buffer_view) {
            (Some(uri), _) => Cow::Owned(resolve(document.files, document.file, &place, uri)?),
            (None, Some(view)) => Cow::Borrowed(document.view(view, &place)?),
            (None, None) => {
                return Err(document.invalid(place, "a uri or a bufferView", "neither"));
            }
        };
        let (file, encoding) = (document.file, reference.encoding);
        self.textures.push(image::decode(
            file,
            &place,
            &bytes,
            encoding,
            &mut self.texels,
            document.files.access().max_texels,
        )?);
        let texture = self.textures.len() as u32 - 1;
        self.images.insert(key, texture);
        Ok(TextureSlot {
            transform,
            ..TextureSlot::whole(texture)
        })
    }
}

/// glTF's alphaCutoff where a material has none.
const DEFAULT_CUTOFF: f32 = 0.5;

/// Whether a texture's alpha draws an outline: nearly all of it is clear or opaque, and there is
/// some of both.
fn is_outline(texture: &Texture) -> bool {
    let alphas = texture
        .texels
        .as_chunks::<4>()
        .0
        .iter()
        .map(|texel| texel[3]);
    let (mut clear, mut opaque, mut all) = (0usize, 0usize, 0usize);
    for alpha in alphas {
        clear += usize::from(alpha < 26);
        opaque += usize::from(alpha > 229);
        all += 1;
    }
    10 * (clear + opaque) >= 9 * all && clear.min(opaque) * 100 >= all
}

const ANISOTROPY: &str = "KHR_materials_anisotropy";

fn extension<'a>(
    extensions: Option<&'a serde_json::Map<String, serde_json::Value>>,
    name: &str,
) -> Option<&'a serde_json::Value> {
    extensions?.get(name)
}
