//! What a pixel sees: position, shading frame and reflectance parameters at a point of a
//! triangle.
//!
//! Textures are sampled here and in `wgsl/surface.wgsl` by the same arithmetic: bilinear,
//! repeated, texel centres at (i + ½)/N, v down, sRGB decoded per texel before filtering.

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles as _};
use relight_format::{Scene, Specular, Surface, Texture, TextureEncoding, TextureSlot, Vertex};

/// Smallest roughness that is shaded, on the scale of GGX alpha. Lobes narrower than this
/// (0.02 rad) are narrower than any light the environment fit produces, apart from suns.
pub const MIN_ALPHA: f32 = 0.02;
/// Blinn-Phong exponent whose lobe is as narrow as [`MIN_ALPHA`]: `2 / alpha²`.
pub const MAX_EXPONENT: f32 = 2.0 / (MIN_ALPHA * MIN_ALPHA);
/// Reflectance of a dielectric at normal incidence in glTF 2.0 (index of refraction 1.5).
pub const DIELECTRIC_F0: f32 = 0.04;
/// Squared length below which a direction carries no information.
const DEGENERATE_LENGTH_SQUARED: f32 = 1e-12;

/// Specular reflection model. The values are those of `Material::model` on the GPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Model {
    /// Diffuse only.
    None = 0,
    /// Normalised Blinn-Phong.
    BlinnPhong = 1,
    /// Ward with the Duer normalisation.
    Ward = 2,
    /// Beckmann distribution, Smith masking, Schlick's Fresnel.
    CookTorrance = 3,
    /// GGX distribution, Smith masking, Schlick's Fresnel.
    Ggx = 4,
}

/// Reflectance at one point, textures applied and parameters clamped to what is shaded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Appearance {
    /// Lambertian albedo, linear Rec.709.
    pub diffuse: Vec3,
    /// Cook-Torrance and GGX: reflectance at normal incidence. Blinn-Phong and Ward:
    /// specular albedo. Linear Rec.709.
    pub specular: Vec3,
    /// Specular model.
    pub model: Model,
    /// Roughness along tangent and bitangent, [`MIN_ALPHA`] to 1. Blinn-Phong: the
    /// exponent, 1 to [`MAX_EXPONENT`], in both.
    pub alpha: Vec2,
}

/// A point of a surface and how it reflects towards the eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// World space, metres.
    pub position: Vec3,
    /// Unit normal of the triangle, counter-clockwise side.
    pub geometric_normal: Vec3,
    /// Unit shading normal, normal map applied.
    pub normal: Vec3,
    /// Unit, orthogonal to `normal`; the direction of `alpha.x`.
    pub tangent: Vec3,
    /// `cross(normal, tangent)`; the direction of `alpha.y`.
    pub bitangent: Vec3,
    /// Unit vector to the eye.
    pub view: Vec3,
    /// Reflectance.
    pub appearance: Appearance,
}

impl SurfacePoint {
    /// World direction -> (tangent, bitangent, normal) coordinates.
    pub fn to_local(&self, direction: Vec3) -> Vec3 {
        Vec3::new(
            direction.dot(self.tangent),
            direction.dot(self.bitangent),
            direction.dot(self.normal),
        )
    }

    /// (tangent, bitangent, normal) coordinates -> world direction.
    pub fn to_world(&self, local: Vec3) -> Vec3 {
        self.tangent * local.x + self.bitangent * local.y + self.normal * local.z
    }
}

/// The surface at `barycentrics` of triangle `triangle`, seen from `eye`.
///
/// # Panics
/// If `triangle` is not a triangle of `scene`.
pub fn surface_point(
    scene: &Scene,
    triangle: usize,
    barycentrics: Vec3,
    eye: Vec3,
) -> SurfacePoint {
    let triangle = &scene.triangles[triangle];
    let material = &scene.materials[triangle.material as usize];
    let [a, b, c] = triangle
        .vertices
        .map(|vertex| &scene.vertices[vertex as usize]);
    let interpolate = |attribute: fn(&Vertex) -> Vec4| {
        attribute(a) * barycentrics.x
            + attribute(b) * barycentrics.y
            + attribute(c) * barycentrics.z
    };
    let position = interpolate(|vertex| Vec3::from(vertex.position).extend(1.0)).xyz();
    let vertex_normal = interpolate(|vertex| Vec3::from(vertex.normal).extend(0.0)).xyz();
    let vertex_tangent = interpolate(|vertex| Vec4::from(vertex.tangent));
    let uv = interpolate(|vertex| Vec2::from(vertex.uv).extend(0.0).extend(0.0)).xy();
    let [pa, pb, pc] = [a, b, c].map(|vertex| Vec3::from(vertex.position));
    let geometric_normal = unit_or((pb - pa).cross(pc - pa), Vec3::Y);
    let sample = |slot: &Option<TextureSlot>| {
        slot.as_ref()
            .map(|slot| sample_slot(&scene.textures[slot.texture as usize], slot, uv))
    };

    let mut normal = unit_or(vertex_normal, geometric_normal);
    let mut tangent = orthogonal_unit(vertex_tangent.xyz(), normal);
    let handedness = if vertex_tangent.w < 0.0 { -1.0 } else { 1.0 };
    if let Some(texel) = sample(&material.normal_texture) {
        let mapped = texel.xyz() * 2.0 - 1.0;
        let bitangent = normal.cross(tangent) * handedness;
        let scaled = tangent * (mapped.x * material.normal_scale)
            + bitangent * (mapped.y * material.normal_scale)
            + normal * mapped.z;
        normal = unit_or(scaled, normal);
        tangent = orthogonal_unit(tangent, normal);
    }

    let color_factor = sample(&material.base_color_texture).map_or(Vec3::ONE, |texel| texel.xyz());
    let appearance = match &material.surface {
        Surface::MetallicRoughness {
            base_color,
            metallic,
            roughness,
            anisotropy_strength,
            anisotropy_rotation,
        } => {
            let base_color = Vec3::from(*base_color) * color_factor;
            let factors = sample(&material.metallic_roughness_texture).unwrap_or(Vec4::ONE);
            let metallic = metallic * factors.z;
            let roughness = roughness * factors.y;
            let alpha = roughness * roughness;
            let mut strength = *anisotropy_strength;
            let mut direction = Vec2::X;
            if let Some(texel) = sample(&material.anisotropy_texture) {
                strength *= texel.z;
                direction = texel.xy() * 2.0 - 1.0;
                if direction.length_squared() < DEGENERATE_LENGTH_SQUARED {
                    direction = Vec2::X;
                }
            }
            if strength > 0.0 {
                let (sin, cos) = anisotropy_rotation.sin_cos();
                let rotated = Vec2::new(
                    direction.x * cos - direction.y * sin,
                    direction.x * sin + direction.y * cos,
                );
                let bitangent = normal.cross(tangent) * handedness;
                tangent = unit_or(tangent * rotated.x + bitangent * rotated.y, tangent);
            }
            Appearance {
                diffuse: base_color * (1.0 - metallic),
                specular: Vec3::splat(DIELECTRIC_F0).lerp(base_color, metallic),
                model: Model::Ggx,
                alpha: Vec2::new(alpha + (1.0 - alpha) * strength * strength, alpha),
            }
        }
        Surface::Layered { diffuse, specular } => {
            let (specular, model, alpha) = match specular {
                Specular::None => ([0.0; 3], Model::None, [1.0; 2]),
                Specular::BlinnPhong { specular, exponent } => {
                    (*specular, Model::BlinnPhong, [*exponent; 2])
                }
                Specular::Ward { specular, alpha } => (*specular, Model::Ward, *alpha),
                Specular::CookTorrance { f0, roughness } => {
                    (*f0, Model::CookTorrance, [*roughness; 2])
                }
                Specular::Ggx { f0, alpha } => (*f0, Model::Ggx, *alpha),
                Specular::Measured { f0, alpha, .. } => (*f0, Model::Ggx, [*alpha; 2]),
            };
            Appearance {
                diffuse: Vec3::from(*diffuse) * color_factor,
                specular: specular.into(),
                model,
                alpha: alpha.into(),
            }
        }
    };
    let (low, high) = if appearance.model == Model::BlinnPhong {
        (1.0, MAX_EXPONENT)
    } else {
        (MIN_ALPHA, 1.0)
    };
    SurfacePoint {
        position,
        geometric_normal,
        normal,
        tangent,
        bitangent: normal.cross(tangent),
        view: unit_or(eye - position, normal),
        appearance: Appearance {
            alpha: appearance.alpha.clamp(Vec2::splat(low), Vec2::splat(high)),
            ..appearance
        },
    }
}

/// RGBA of a texture slot at a vertex's texture coordinates.
fn sample_slot(texture: &Texture, slot: &TextureSlot, uv: Vec2) -> Vec4 {
    let [row_u, row_v] = slot.transform.map(Vec3::from);
    let uv = Vec2::new(row_u.dot(uv.extend(1.0)), row_v.dot(uv.extend(1.0)));
    let size = Vec2::new(texture.width as f32, texture.height as f32);
    // In texels from the first texel's centre, -½ to N - ½.
    let p = (uv - uv.floor()) * size - 0.5;
    let low = p.floor();
    let f = p - low;
    // Adding N makes the first operand of the remainder positive.
    let x0 = (low.x as i32 + texture.width as i32) as u32 % texture.width;
    let y0 = (low.y as i32 + texture.height as i32) as u32 % texture.height;
    let x1 = (x0 + 1) % texture.width;
    let y1 = (y0 + 1) % texture.height;
    let top = texel(texture, x0, y0).lerp(texel(texture, x1, y0), f.x);
    let bottom = texel(texture, x0, y1).lerp(texel(texture, x1, y1), f.x);
    top.lerp(bottom, f.y)
}

fn texel(texture: &Texture, x: u32, y: u32) -> Vec4 {
    let start = (y as usize * texture.width as usize + x as usize) * 4;
    let bytes: [u8; 4] = std::array::from_fn(|channel| texture.texels[start + channel]);
    let value = Vec4::from(bytes.map(f32::from)) / 255.0;
    match texture.encoding {
        TextureEncoding::Linear => value,
        TextureEncoding::Srgb => Vec3::new(
            decode_srgb(value.x),
            decode_srgb(value.y),
            decode_srgb(value.z),
        )
        .extend(value.w),
    }
}

/// IEC 61966-2-1.
fn decode_srgb(encoded: f32) -> f32 {
    if encoded <= 0.040_45 {
        encoded / 12.92
    } else {
        ((encoded + 0.055) / 1.055).powf(2.4)
    }
}

/// `vector` at unit length, or `fallback` where it is zero or not a number.
fn unit_or(vector: Vec3, fallback: Vec3) -> Vec3 {
    let squared = vector.length_squared();
    // Far below any geometric length but above the underflow of its square.
    if squared > 1e-36 {
        vector / squared.sqrt()
    } else {
        fallback
    }
}

/// The unit vector orthogonal to the unit vector `normal` that is nearest to `vector`, or
/// any such vector where `vector` is zero or parallel to `normal`.
fn orthogonal_unit(vector: Vec3, normal: Vec3) -> Vec3 {
    let projected = vector - normal * normal.dot(vector);
    let squared = projected.length_squared();
    if squared > DEGENERATE_LENGTH_SQUARED * vector.length_squared() && squared > 1e-36 {
        return projected / squared.sqrt();
    }
    // Duff et al. 2017.
    let sign = if normal.z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + normal.z);
    Vec3::new(
        1.0 + sign * normal.x * normal.x * a,
        sign * normal.x * normal.y * a,
        -sign * normal.x,
    )
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!(
        "const SURFACE_MIN_ALPHA: f32 = {MIN_ALPHA:?};\n\
         const SURFACE_MAX_EXPONENT: f32 = {MAX_EXPONENT:?};\n\
         const SURFACE_DIELECTRIC_F0: f32 = {DIELECTRIC_F0:?};\n\
         const SURFACE_DEGENERATE_LENGTH_SQUARED: f32 = {DEGENERATE_LENGTH_SQUARED:?};\n"
    )
}
