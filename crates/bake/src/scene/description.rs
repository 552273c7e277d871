//! `scene.toml`: what to bake, as written by hand. `SCENE.md` beside this crate shows a
//! complete example.
//!
//! This module knows the file's syntax and the ranges of its values; it reads no mesh.
//! Unknown keys are errors, because a misspelt optional key would otherwise silently keep
//! its default.

mod check;
mod reflection;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use relight_format as format;
use relight_shading::gpu::MAX_LOCAL_LIGHTS;
use relight_shading::local_light::{LocalLight, Spot};
use serde::{Deserialize, Serialize};

pub use crate::error::Error;
use crate::error::of_parser;
use crate::mesh::ground;

use check::Checker;
pub use reflection::Reflecting;

use crate::files::{Access, Files};

/// A whole scene file. Paths are relative to the folder that holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// The mesh: `.gltf`, `.glb` or `.obj`.
    pub mesh: PathBuf,
    /// A lat-long HDR image, `.hdr` or `.exr`. Baking does not read it; tools use it as the
    /// scene's default light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub environment: Option<PathBuf>,
    /// OBJ files without normals and smoothing groups: faces that bend by more, degrees from 0 to
    /// 180, meet at a hard edge. Default: [`crate::import::DEFAULT_CREASE_DEGREES`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crease_degrees: Option<f32>,
    /// Where the mesh is placed in the world.
    #[serde(default)]
    pub transform: Transform,
    /// Replacements for the mesh's materials, textures included, by material name.
    /// `default` replaces every material that no other entry names.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub materials: BTreeMap<String, MaterialOverride>,
    /// Radiance that materials emit, by their name in the mesh, or `ground`; the same in all
    /// directions, in place of what the mesh says.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub emission: BTreeMap<String, Color>,
    /// Materials, by their name in the mesh, or `ground`, that catch shadows: pictures have only their
    /// shadow and what other surfaces add to their light, to be laid over photographs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shadow_catchers: Vec<String>,
    /// Alpha, from 0 to 1, below which materials of the mesh are cut away, by their name in the
    /// mesh, in place of what the mesh says; 0 keeps all of them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub cutout: BTreeMap<String, f32>,
    /// A horizontal plane under the mesh that receives its shadow.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ground: Option<Ground>,
    /// The view that tools start from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Camera>,
    /// Lights inside the scene. Baking does not read them: they may move from frame to frame.
    /// Tools use them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lights: Vec<Light>,
    /// How finely the mesh is divided before visibility is sampled at its vertices.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refinement: Option<Refinement>,
}

/// Scale, then rotation, then translation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Transform {
    /// Uniform scale, greater than 0. Default 1.
    pub scale: f32,
    /// Rotation axis, not zero. Default +Y.
    pub(crate) rotation_axis: [f32; 3],
    /// Rotation about the axis, degrees counter-clockwise seen from its tip. Default 0.
    pub(crate) rotation_degrees: f32,
    /// Translation, metres. Default zero.
    pub translation: [f32; 3],
}

impl Default for Transform {
    fn default() -> Self {
        Self {
            scale: 1.0,
            rotation_axis: [0.0, 1.0, 0.0],
            rotation_degrees: 0.0,
            translation: [0.0; 3],
        }
    }
}

/// Linear Rec.709 colour: three numbers, or one for grey.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a number or an array of three numbers")]
pub enum Color {
    /// All three channels alike.
    Grey(f32),
    /// Red, green, blue.
    Rgb([f32; 3]),
}

impl Color {
    /// The three channels.
    pub(crate) fn rgb(self) -> [f32; 3] {
        match self {
            Self::Grey(value) => [value; 3],
            Self::Rgb(rgb) => rgb,
        }
    }
}

fn black() -> Color {
    Color::Grey(0.0)
}

fn one() -> f32 {
    1.0
}

/// A material, chosen by `model`. The models are those of [`format::Specular`] and
/// [`format::Surface`]; reflectances and albedos are in [0, 1].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(
    remote = "Self",
    tag = "model",
    rename_all = "kebab-case",
    deny_unknown_fields
)]
pub enum MaterialOverride {
    /// Lambertian.
    Diffuse {
        /// Albedo.
        diffuse: Color,
    },
    /// One of [`format::REFLECTION_MODELS`] over a Lambertian base, which is black by default. Keys are
    /// `diffuse` and those that the model's entry names; of a model that may be anisotropic also with
    /// `_x` and `_y`.
    #[serde(skip)]
    Reflecting(Reflecting),
    /// glTF 2.0 metallic-roughness.
    MetallicRoughness {
        /// Base colour.
        base_color: Color,
        /// 0 dielectric, 1 metal. Default 1, as in glTF.
        #[serde(default = "one")]
        metallic: f32,
        /// Perceptual roughness, the square root of GGX alpha, in [0, 1]. Default 1.
        #[serde(default = "one")]
        roughness: f32,
        /// `KHR_materials_anisotropy` strength, in [0, 1]. Default 0.
        #[serde(default)]
        anisotropy_strength: f32,
        /// Direction of anisotropy, degrees counter-clockwise from the tangent. Default 0.
        #[serde(default)]
        anisotropy_rotation_degrees: f32,
    },
    /// A measured BRDF: an RGL `.bsdf` file (Dupuy & Jakob 2018) or a MERL `.binary` file
    /// (Matusik et al. 2003), fitted when it is read, or what `bake material` made of one.
    Measured {
        /// The file.
        file: PathBuf,
        /// The table behind a baked `file`, for tools that want the truth.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        original: Option<PathBuf>,
    },
    /// Layers from the bottom up, spatially varying by texture.
    Layers {
        /// One to four of them.
        layers: Vec<LayerFile>,
        /// Tangent-space normals, +Y up.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        normal_texture: Option<PathBuf>,
        /// Scale of the normals' x and y. Default 1.
        #[serde(default = "one")]
        normal_scale: f32,
        /// RG is the direction of the tangent in [-1, 1].
        #[serde(default, skip_serializing_if = "Option::is_none")]
        anisotropy_texture: Option<PathBuf>,
    },
}

/// One layer. Textures are PNG, JPEG or WebP files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LayerFile {
    /// A material other than `layers` and `metallic-roughness`, and without textures.
    pub material: Box<MaterialOverride>,
    /// Coverage in [0, 1]. Default 1.
    #[serde(default = "one")]
    pub weight: f32,
    /// How it covers what is below. Default `over`.
    #[serde(default)]
    pub blend: BlendName,
    /// sRGB; multiplies the diffuse albedo.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diffuse_texture: Option<PathBuf>,
    /// sRGB; multiplies the specular colour.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specular_texture: Option<PathBuf>,
    /// R and G multiply the roughness along tangent and bitangent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub roughness_texture: Option<PathBuf>,
    /// 1 - R and 1 - G multiply the roughness. Give this or `roughness_texture`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub glossiness_texture: Option<PathBuf>,
    /// R multiplies `weight`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weight_texture: Option<PathBuf>,
}

/// How a layer covers what is below: [`format::Blend`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlendName {
    /// A stain.
    #[default]
    Over,
    /// A transparent coat.
    Coat,
}

/// A flat square grid facing +Y.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ground {
    /// Length of its sides, metres. Default: three times the mesh's longest extent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<f32>,
    /// Its y coordinate. Default: the mesh's lowest point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<f32>,
    /// x and z of its centre. Default: under the centre of the mesh's bounding box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub center: Option<[f32; 2]>,
    /// Largest distance of neighbouring vertices, metres. Default: 1/80 of `size`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spacing: Option<f32>,
    /// Its material, named `ground`. Default: diffuse with albedo 0.5.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub material: Option<MaterialOverride>,
}

impl Ground {
    /// Where it lies.
    pub fn extent(&self) -> ground::Extent {
        ground::Extent {
            size: self.size,
            height: self.height,
            center: self.center,
            spacing: self.spacing,
        }
    }
}

/// A pinhole camera. Give exactly one field of view.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Centre of projection (also spelt `origin`).
    #[serde(alias = "origin")]
    pub position: [f32; 3],
    /// A point on the optical axis.
    pub target: [f32; 3],
    /// Approximate up direction. Default +Y.
    #[serde(default = "up")]
    pub up: [f32; 3],
    /// Full horizontal angle, degrees in (0, 180).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov_x_degrees: Option<f32>,
    /// Full vertical angle, degrees in (0, 180).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov_y_degrees: Option<f32>,
}

fn up() -> [f32; 3] {
    [0.0, 1.0, 0.0]
}

/// A sphere that emits. With `direction` and both angles it is a spot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// Centre.
    pub position: [f32; 3],
    /// Radius, metres, greater than 0.
    pub radius: f32,
    /// Radiance of the surface, at least 0.
    pub radiance: Color,
    /// Where a spot shines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f32; 3]>,
    /// Angle from the direction up to which a spot is whole, degrees, at least 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inner_degrees: Option<f32>,
    /// Angle beyond which a spot is dark, degrees above the inner one and at most 90.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outer_degrees: Option<f32>,
}

impl Light {
    /// The light as it is drawn.
    pub fn to_local_light(&self) -> LocalLight {
        let angles = self.inner_degrees.zip(self.outer_degrees);
        LocalLight {
            position: self.position.into(),
            radius: self.radius,
            radiance: self.radiance.rgb().into(),
            spot: self
                .direction
                .zip(angles)
                .map(|(direction, (inner, outer))| Spot {
                    direction: glam::Vec3::from(direction).normalize_or(glam::Vec3::NEG_Y),
                    inner_angle: inner.to_radians(),
                    outer_angle: outer.to_radians(),
                }),
        }
    }
}

/// Bounds on the division of the mesh, ground included.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Refinement {
    /// Longer edges are halved until none is left, metres. Default: the option's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_edge: Option<f32>,
    /// Edges are halved further where interpolated visibility is off by more than this,
    /// radians. Default: the option's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<f32>,
    /// Division stops before the mesh has more vertices than this. Default: the option's,
    /// 1,000,000.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_vertices: Option<usize>,
}

/// Reads and checks a scene file.
pub fn load(path: &Path) -> Result<SceneFile, Error> {
    let files = Files::new(path, &Access::default())?;
    parse(path, &files.read_named(path)?)
}

/// Parses and checks the bytes of a scene file; `path` is for messages.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<SceneFile, Error> {
    let scene: SceneFile = parse_toml(path, bytes, "a scene as in SCENE.md")?;
    let checked = Checker { path };
    checked.transform(&scene.transform)?;
    for (name, material) in &scene.materials {
        checked.material(&format!("materials.{name}"), material)?;
    }
    for (name, cutoff) in &scene.cutout {
        checked.require(
            (0.0..=1.0).contains(cutoff),
            &format!("cutout.{name}"),
            "a number in [0, 1]",
            cutoff,
        )?;
    }
    if let Some(crease) = scene.crease_degrees {
        checked.require(
            (0.0..=180.0).contains(&crease),
            "crease_degrees",
            "an angle in [0, 180]",
            crease,
        )?;
    }
    if let Some(ground) = &scene.ground {
        checked.ground(ground)?;
    }
    if let Some(camera) = &scene.camera {
        checked.camera(camera)?;
    }
    checked.require(
        scene.lights.len() <= MAX_LOCAL_LIGHTS as usize,
        "lights",
        &format!("at most {MAX_LOCAL_LIGHTS} lights"),
        scene.lights.len(),
    )?;
    for (index, light) in scene.lights.iter().enumerate() {
        checked.light(&format!("lights[{index}]"), light)?;
    }
    if let Some(refinement) = &scene.refinement {
        if let Some(max_edge) = refinement.max_edge {
            checked.positive("refinement.max_edge", max_edge)?;
        }
        if let Some(error) = refinement.error {
            checked.positive("refinement.error", error)?;
        }
    }
    Ok(scene)
}

/// Parses a TOML file as what `expected` says; errors name line and column.
pub fn parse_toml<T: serde::de::DeserializeOwned>(
    path: &Path,
    bytes: &[u8],
    expected: &str,
) -> Result<T, Error> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let place = format!("byte {}", error.valid_up_to());
        Error::invalid(path, place, "text in UTF-8", "other bytes")
    })?;
    toml::from_str(text).map_err(|error| {
        let start = error.span().map_or(0, |span| span.start);
        let before = &text[..text.floor_char_boundary(start)];
        let line = 1 + before.matches('\n').count();
        let column = 1 + before.chars().rev().take_while(|&c| c != '\n').count();
        of_parser([line, column], expected, error.message()).in_file(path)
    })
}

/// Parses and checks the bytes of a file of one material, written as under `[materials]`.
pub(crate) fn parse_material(path: &Path, bytes: &[u8]) -> Result<MaterialOverride, Error> {
    let material = parse_toml(path, bytes, "a material as in SCENE.md")?;
    Checker { path }.material("material", &material)?;
    Ok(material)
}

impl Camera {
    /// The camera as assets store it; `None` unless exactly one field of view is given.
    pub fn to_format(&self) -> Option<format::Camera> {
        let field_of_view = match (self.fov_x_degrees, self.fov_y_degrees) {
            (Some(x), None) => format::FieldOfView::X(x.to_radians()),
            (None, Some(y)) => format::FieldOfView::Y(y.to_radians()),
            _ => return None,
        };
        let Self {
            position,
            target,
            up,
            ..
        } = *self;
        Some(format::Camera {
            position,
            target,
            up,
            field_of_view,
        })
    }
}

#[cfg(test)]
mod tests;
