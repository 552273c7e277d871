//! `scene.toml`: what to bake, as written by hand. `SCENE.md` beside this crate shows a
//! complete example.
//!
//! This module knows the file's syntax and the ranges of its values; it reads no mesh.
//! Unknown keys are errors, because a misspelt optional key would otherwise silently keep
//! its default.

mod reflection;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use relight_format as format;
use relight_shading::gpu::MAX_LOCAL_LIGHTS;
use relight_shading::local_light::{LocalLight, Spot};
use serde::{Deserialize, Serialize};

pub use crate::error::Error;
use crate::mesh::ground;

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
    pub rotation_axis: [f32; 3],
    /// Rotation about the axis, degrees counter-clockwise seen from its tip. Default 0.
    pub rotation_degrees: f32,
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
    pub fn rgb(self) -> [f32; 3] {
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
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub enum MaterialOverride {
    /// Lambertian.
    Diffuse {
        /// Albedo.
        diffuse: Color,
    },
    /// Normalised Blinn-Phong over a Lambertian base.
    BlinnPhong {
        /// Albedo of the base. Default black.
        #[serde(default = "black")]
        diffuse: Color,
        /// Specular albedo.
        specular: Color,
        /// Exponent, at least 1.
        exponent: f32,
    },
    /// Ward over a Lambertian base. Give `alpha`, or `alpha_x` and `alpha_y`.
    Ward {
        /// Albedo of the base. Default black.
        #[serde(default = "black")]
        diffuse: Color,
        /// Specular albedo.
        specular: Color,
        /// Isotropic roughness, in (0, 1].
        alpha: Option<f32>,
        /// Roughness along the tangent, in (0, 1].
        alpha_x: Option<f32>,
        /// Roughness along the bitangent, in (0, 1].
        alpha_y: Option<f32>,
    },
    /// Cook-Torrance with a Beckmann distribution over a Lambertian base.
    CookTorrance {
        /// Albedo of the base. Default black.
        #[serde(default = "black")]
        diffuse: Color,
        /// Reflectance at normal incidence.
        f0: Color,
        /// Beckmann roughness m, in (0, 1].
        roughness: f32,
    },
    /// GGX over a Lambertian base. Give `alpha`, or `alpha_x` and `alpha_y`.
    Ggx {
        /// Albedo of the base. Default black.
        #[serde(default = "black")]
        diffuse: Color,
        /// Reflectance at normal incidence; 1 is a perfect conductor.
        f0: Color,
        /// Isotropic roughness, in (0, 1].
        alpha: Option<f32>,
        /// Roughness along the tangent, in (0, 1].
        alpha_x: Option<f32>,
        /// Roughness along the bitangent, in (0, 1].
        alpha_y: Option<f32>,
    },
    /// Ashikhmin-Shirley's specular term over a Lambertian base. Give `exponent`, or
    /// `exponent_x` and `exponent_y`.
    AshikhminShirley {
        /// Albedo of the base. Default black.
        #[serde(default = "black")]
        diffuse: Color,
        /// Reflectance at normal incidence.
        f0: Color,
        /// Isotropic exponent, at least 2.
        exponent: Option<f32>,
        /// Exponent along the tangent, at least 2.
        exponent_x: Option<f32>,
        /// Exponent along the bitangent, at least 2.
        exponent_y: Option<f32>,
    },
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
    let scene: SceneFile = parse_toml(path, bytes)?;
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

fn parse_toml<T: serde::de::DeserializeOwned>(path: &Path, bytes: &[u8]) -> Result<T, Error> {
    let syntax = |message: String| Error::Syntax {
        file: path.into(),
        message,
    };
    let text = std::str::from_utf8(bytes).map_err(|error| syntax(error.to_string()))?;
    toml::from_str(text).map_err(|error| syntax(error.to_string()))
}

/// Parses and checks the bytes of a file of one material, written as under `[materials]`.
pub fn parse_material(path: &Path, bytes: &[u8]) -> Result<MaterialOverride, Error> {
    let material = parse_toml(path, bytes)?;
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

/// The two numbers that `alpha` or `alpha_x` and `alpha_y`, or exponents, stand for.
pub fn alpha_pair(
    alpha: Option<f32>,
    alpha_x: Option<f32>,
    alpha_y: Option<f32>,
) -> Option<[f32; 2]> {
    match (alpha, alpha_x, alpha_y) {
        (Some(alpha), None, None) => Some([alpha; 2]),
        (None, Some(x), Some(y)) => Some([x, y]),
        _ => None,
    }
}

/// Range checks whose errors name the file.
struct Checker<'a> {
    path: &'a Path,
}

impl Checker<'_> {
    fn require(
        &self,
        holds: bool,
        place: &str,
        expected: &str,
        found: impl std::fmt::Debug,
    ) -> Result<(), Error> {
        if holds {
            Ok(())
        } else {
            Err(Error::invalid(
                self.path,
                place,
                expected,
                format_args!("{found:?}"),
            ))
        }
    }

    fn positive(&self, place: &str, value: f32) -> Result<(), Error> {
        self.require(
            value > 0.0 && value.is_finite(),
            place,
            "a number above 0",
            value,
        )
    }

    fn finite(&self, place: &str, values: &[f32]) -> Result<(), Error> {
        self.require(
            values.iter().all(|x| x.is_finite()),
            place,
            "finite numbers",
            values,
        )
    }

    fn nonzero(&self, place: &str, vector: [f32; 3]) -> Result<(), Error> {
        let normalizable = glam::Vec3::from(vector).try_normalize().is_some();
        self.require(normalizable, place, "a vector other than zero", vector)
    }

    fn transform(&self, transform: &Transform) -> Result<(), Error> {
        self.positive("transform.scale", transform.scale)?;
        self.nonzero("transform.rotation_axis", transform.rotation_axis)?;
        self.finite("transform.rotation_degrees", &[transform.rotation_degrees])?;
        self.finite("transform.translation", &transform.translation)
    }

    fn ground(&self, ground: &Ground) -> Result<(), Error> {
        for (place, value) in [
            ("ground.size", ground.size),
            ("ground.spacing", ground.spacing),
        ] {
            value.map_or(Ok(()), |value| self.positive(place, value))?;
        }
        self.finite("ground.height", ground.height.as_slice())?;
        self.finite(
            "ground.center",
            ground.center.as_ref().map_or(&[], |center| center),
        )?;
        ground.material.as_ref().map_or(Ok(()), |material| {
            self.material("ground.material", material)
        })
    }

    fn camera(&self, camera: &Camera) -> Result<(), Error> {
        let angles = [camera.fov_x_degrees, camera.fov_y_degrees];
        self.require(
            angles.iter().flatten().count() == 1,
            "camera",
            "one of fov_x_degrees and fov_y_degrees",
            format_args!("{} of them", angles.iter().flatten().count()),
        )?;
        let in_range = angles
            .into_iter()
            .flatten()
            .all(|angle| angle > 0.0 && angle < 180.0);
        self.require(
            in_range,
            "camera",
            "a field of view above 0 and below 180",
            angles,
        )?;
        self.finite("camera.position", &camera.position)?;
        self.finite("camera.target", &camera.target)?;
        let [position, target, up] =
            [camera.position, camera.target, camera.up].map(glam::Vec3::from);
        self.nonzero(
            "camera.target minus camera.position",
            (target - position).into(),
        )?;
        self.nonzero("camera.up", up.into())?;
        self.nonzero(
            "camera.up across the viewing direction",
            (target - position).normalize().cross(up.normalize()).into(),
        )
    }

    fn layer(&self, place: &str, layer: &LayerFile) -> Result<(), Error> {
        use MaterialOverride as M;
        let plain = !matches!(
            *layer.material,
            M::Layers { .. } | M::MetallicRoughness { .. }
        );
        self.require(
            plain,
            &format!("{place}.material"),
            "a model other than layers and metallic-roughness",
            "one of them",
        )?;
        self.material(&format!("{place}.material"), &layer.material)?;
        self.require(
            layer.blend != BlendName::Coat || !matches!(*layer.material, M::Diffuse { .. }),
            &format!("{place}.blend"),
            "over, or a coat of a material that reflects",
            "a coat of a diffuse material",
        )?;
        self.require(
            (0.0..=1.0).contains(&layer.weight),
            &format!("{place}.weight"),
            "a number in [0, 1]",
            layer.weight,
        )?;
        self.require(
            layer.roughness_texture.is_none() || layer.glossiness_texture.is_none(),
            place,
            "one of roughness_texture and glossiness_texture",
            "both",
        )
    }

    fn light(&self, place: &str, light: &Light) -> Result<(), Error> {
        self.finite(&format!("{place}.position"), &light.position)?;
        self.positive(&format!("{place}.radius"), light.radius)?;
        let radiance = light.radiance.rgb();
        self.require(
            radiance.iter().all(|x| *x >= 0.0 && x.is_finite()),
            &format!("{place}.radiance"),
            "numbers of at least 0",
            radiance,
        )?;
        match (light.direction, light.inner_degrees, light.outer_degrees) {
            (None, None, None) => Ok(()),
            (Some(direction), Some(inner), Some(outer)) => {
                self.nonzero(&format!("{place}.direction"), direction)?;
                self.require(
                    0.0 <= inner && inner < outer && outer <= 90.0,
                    &format!("{place}.outer_degrees"),
                    "0 <= inner_degrees < outer_degrees <= 90",
                    (inner, outer),
                )
            }
            parts => self.require(
                false,
                place,
                "all of direction, inner_degrees and outer_degrees, or none",
                parts,
            ),
        }
    }

    #[allow(clippy::too_many_lines, reason = "one arm per reflection model")]
    fn material(&self, place: &str, material: &MaterialOverride) -> Result<(), Error> {
        use MaterialOverride as M;
        let at = |key: &str| format!("{place}.{key}");
        let unit = |key: &str, value: f32| {
            self.require(
                (0.0..=1.0).contains(&value),
                &at(key),
                "a number in [0, 1]",
                value,
            )
        };
        let color = |key: &str, value: Color| {
            let rgb = value.rgb();
            let valid = rgb.iter().all(|x| (0.0..=1.0).contains(x));
            self.require(valid, &at(key), "reflectances in [0, 1]", rgb)
        };
        let roughness = |key: &str, value: f32| {
            let valid = value > 0.0 && value <= 1.0;
            self.require(valid, &at(key), "a roughness in (0, 1]", value)
        };
        let alpha = |alpha, x, y| {
            let pair = alpha_pair(alpha, x, y);
            let found = (alpha, x, y);
            let expected = "alpha, or alpha_x and alpha_y";
            self.require(pair.is_some(), place, expected, found)?;
            pair.into_iter()
                .flatten()
                .try_for_each(|value| roughness("alpha", value))
        };
        match *material {
            M::Diffuse { diffuse } => color("diffuse", diffuse),
            M::BlinnPhong {
                diffuse,
                specular,
                exponent,
            } => {
                color("diffuse", diffuse)?;
                color("specular", specular)?;
                let valid = exponent >= 1.0 && exponent.is_finite();
                self.require(valid, &at("exponent"), "a number of at least 1", exponent)
            }
            M::Ward {
                diffuse,
                specular,
                alpha: a,
                alpha_x,
                alpha_y,
            } => {
                color("diffuse", diffuse)?;
                color("specular", specular)?;
                alpha(a, alpha_x, alpha_y)
            }
            M::CookTorrance {
                diffuse,
                f0,
                roughness: m,
            } => {
                color("diffuse", diffuse)?;
                color("f0", f0)?;
                roughness("roughness", m)
            }
            M::Ggx {
                diffuse,
                f0,
                alpha: a,
                alpha_x,
                alpha_y,
            } => {
                color("diffuse", diffuse)?;
                color("f0", f0)?;
                alpha(a, alpha_x, alpha_y)
            }
            M::AshikhminShirley {
                diffuse,
                f0,
                exponent,
                exponent_x,
                exponent_y,
            } => {
                color("diffuse", diffuse)?;
                color("f0", f0)?;
                let pair = alpha_pair(exponent, exponent_x, exponent_y);
                let found = (exponent, exponent_x, exponent_y);
                let expected = "exponent, or exponent_x and exponent_y";
                self.require(pair.is_some(), place, expected, found)?;
                pair.into_iter().flatten().try_for_each(|value| {
                    let valid = value >= 2.0 && value.is_finite();
                    self.require(valid, &at("exponent"), "a number of at least 2", value)
                })
            }
            M::MetallicRoughness {
                base_color,
                metallic,
                roughness: perceptual,
                anisotropy_strength,
                anisotropy_rotation_degrees,
            } => {
                color("base_color", base_color)?;
                unit("metallic", metallic)?;
                unit("roughness", perceptual)?;
                unit("anisotropy_strength", anisotropy_strength)?;
                let rotation = [anisotropy_rotation_degrees];
                self.finite(&at("anisotropy_rotation_degrees"), &rotation)
            }
            M::Measured { .. } => Ok(()),
            M::Layers {
                ref layers,
                normal_scale,
                ..
            } => {
                self.finite(&at("normal_scale"), &[normal_scale])?;
                let count = layers.len();
                let most = format::MAX_LAYERS;
                self.require(
                    (1..=most).contains(&count),
                    &at("layers"),
                    &format!("1 to {most} layers"),
                    count,
                )?;
                layers.iter().enumerate().try_for_each(|(index, layer)| {
                    self.layer(&format!("{place}.layers[{index}]"), layer)
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<SceneFile, Error> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, text).expect("a writable folder");
        load(&path)
    }

    #[test]
    fn the_documented_example_is_valid_and_shows_every_model() {
        let document = include_str!("../../SCENE.md");
        let (_, rest) = document.split_once("```toml\n").expect("an example");
        let (example, _) = rest.split_once("```").expect("its end");
        let scene = parse(example).expect("a valid example");
        let mut models = [false; 9];
        for material in scene.materials.values() {
            models[match material {
                MaterialOverride::Diffuse { .. } => 0,
                MaterialOverride::BlinnPhong { .. } => 1,
                MaterialOverride::Ward { .. } => 2,
                MaterialOverride::CookTorrance { .. } => 3,
                MaterialOverride::Ggx { .. } => 4,
                MaterialOverride::MetallicRoughness { .. } => 5,
                MaterialOverride::Measured { .. } => 6,
                MaterialOverride::AshikhminShirley { .. } => 7,
                MaterialOverride::Layers { .. } => 8,
            }] = true;
        }
        assert_eq!(models, [true; 9]);
        assert!(scene.environment.is_some() && scene.refinement.is_some());
        let camera = scene
            .camera
            .expect("a camera")
            .to_format()
            .expect("one field of view");
        assert_eq!(
            camera.field_of_view,
            format::FieldOfView::X(28f32.to_radians())
        );
    }

    #[test]
    fn a_mesh_is_enough() {
        let scene = parse("mesh = 'a.obj'").expect("a valid file");
        assert_eq!(scene.mesh, Path::new("a.obj"));
        assert_eq!(scene.transform, Transform::default());
        assert_eq!(
            (scene.ground, scene.camera, scene.refinement),
            (None, None, None)
        );
    }

    #[test]
    fn every_model_of_the_format_is_written_and_read_again() {
        for model in format::REFLECTION_MODELS {
            let roughness = [0.3, if model.anisotropic { 0.2 } else { 0.3 }];
            let specular = model.reflection(format::ModelParameters {
                color: [0.1, 0.2, 0.3],
                roughness: roughness.map(|alpha| model.roughness.from_alpha(alpha)),
            });
            let material = MaterialOverride::over_base([0.5; 3], &specular);
            let text = toml::to_string(&material).expect("a table");
            assert!(
                text.contains(&format!("model = \"{}\"", model.key)),
                "{text}"
            );
            for name in [model.color, model.roughness_name] {
                assert!(text.contains(&format!("\n{name}")), "{name}: {text}");
            }
            let scene = parse(&format!("mesh = 'a'\n[materials.m]\n{text}")).expect(&text);
            let found = scene.materials["m"].reflection().expect("a model");
            assert_eq!(found, (Color::Rgb([0.5; 3]), specular));
        }
    }

    #[test]
    #[allow(clippy::too_many_lines, reason = "a table of cases")]
    fn what_is_wrong_is_named() {
        let cases = [
            ("", "mesh"),
            ("mesh = 1", "mesh"),
            ("mesh = 'a'\nmehs = 'b'", "mehs"),
            ("mesh = 'a'\n[transform]\nsize = 1", "size"),
            ("mesh = 'a'\n[transform]\nscale = 0", "transform.scale"),
            ("mesh = 'a'\n[cutout]\nleaf = 1.5", "cutout.leaf"),
            ("mesh = 'a'\n[cutout]\nleaf = nan", "cutout.leaf"),
            ("mesh = 'a'\ncrease_degrees = -1", "crease_degrees"),
            (
                "mesh = 'a'\n[transform]\nrotation_axis = [0, 0, 0]",
                "rotation_axis",
            ),
            ("mesh = 'a'\n[ground]\nwidth = 1", "width"),
            (
                "mesh = 'a'\n[[lights]]\nposition = [0, 1, 0]\nradius = 0\nradiance = 1",
                "lights[0].radius",
            ),
            (
                "mesh = 'a'\n[[lights]]\nposition = [0, 1, 0]\nradius = 1\nradiance = -1",
                "lights[0].radiance",
            ),
            (
                "mesh = 'a'\n[[lights]]\nposition = [0, 1, 0]\nradius = 1\nradiance = 1\ninner_degrees = 5",
                "lights[0]",
            ),
            (
                "mesh = 'a'\n[[lights]]\nposition = [0, 1, 0]\nradius = 1\nradiance = 1\n\
                 direction = [0, -1, 0]\ninner_degrees = 5\nouter_degrees = 5",
                "lights[0].outer_degrees",
            ),
            ("mesh = 'a'\n[ground]\nspacing = -1", "ground.spacing"),
            (
                "mesh = 'a'\n[ground]\nmaterial = { model = 'diffuse', diffuse = 2 }",
                "ground.mat",
            ),
            (
                "mesh = 'a'\n[refinement]\nmax_edge = inf",
                "refinement.max_edge",
            ),
            ("mesh = 'a'\n[refinement]\nerror = 0", "refinement.error"),
            (
                "mesh = 'a'\n[camera]\nposition = [0, 0, 1]\ntarget = [0, 0, 0]",
                "fov_x_degrees",
            ),
            (
                "mesh = 'a'\n[camera]\nposition = [0, 1, 0]\ntarget = [0, 0, 0]\nfov_x_degrees = 9",
                "camera.up",
            ),
            (
                "mesh = 'a'\n[camera]\nposition = [0, 0, 1]\ntarget = [0, 0, 0]\nfov_x_degrees = 9\n\
                 fov_y_degrees = 9",
                "one of fov_x_degrees and fov_y_degrees",
            ),
            (
                "mesh = 'a'\n[camera]\nposition = [0, 0, 1]\ntarget = [0, 0, 0]\n\
                 fov_x_degrees = 180",
                "field of view",
            ),
            ("mesh = 'a'\n[materials.m]\nmodel = 'plastic'", "plastic"),
            ("mesh = 'a'\n[materials.m]\ndiffuse = 0.5", "model"),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'diffuse'\ndiffuse = 0.5\nf0 = 1",
                "f0",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'diffuse'\ndiffuse = [1, 2]",
                "three numbers",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'ggx'\nf0 = 1",
                "materials.m",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'ggx'\nf0 = 1\nalpha = 0.1\nalpha_x = 0.1",
                "alpha",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'ggx'\nf0 = 1\nalpha = 0",
                "roughness in (0, 1]",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'layers'\nlayers = []",
                "1 to 4 layers",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'layers'\n[[materials.m.layers]]\nweight = 2\n\
                 material = { model = 'diffuse', diffuse = 1 }",
                "layers[0].weight",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'layers'\n[[materials.m.layers]]\n\
                 material = { model = 'metallic-roughness', base_color = 1 }",
                "layers[0].material",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'layers'\n[[materials.m.layers]]\n\
                 material = { model = 'diffuse', diffuse = 1 }\nroughness_texture = 'a'\n\
                 glossiness_texture = 'b'",
                "glossiness_texture",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'ashikhmin-shirley'\nf0 = 1\nexponent = 1",
                "exponent",
            ),
            (
                "mesh = 'a'\n[materials.m]\nmodel = 'blinn-phong'\nspecular = 1\nexponent = 0.5",
                "materials.m.exponent",
            ),
        ];
        for (text, expected) in cases {
            let message = parse(text).expect_err(text).to_string();
            assert!(message.contains(expected), "{text}: {message}");
            assert!(message.contains("scene.toml"), "{message}");
        }
    }
}
