//! What a pixel sees: position, shading frame and reflectance parameters at a point of a
//! triangle.
//!
//! Textures are sampled here and in `wgsl/surface.wgsl` by the same arithmetic: bilinear,
//! repeated, texel centres at (i + ½)/N, v down, sRGB decoded per texel before filtering.

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles as _};
use relight_format::{Scene, Specular, Surface, Texture, TextureEncoding, TextureSlot, Vertex};

/// Smallest roughness that is shaded, on the scale of GGX alpha. Its lobe falls to a third
/// within 0.04 rad, little more than a texel of a 128 × 128 visibility bitmap.
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

    let color_factor = sample(&material.base_color_texture).map_or(Vec3::ONE, Vec4::xyz);
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

#[cfg(test)]
mod tests {
    use super::*;
    use relight_format::{
        BakeReport, Cluster, Material, Representation, Triangle, VisibilityParameters,
    };

    /// A few roundings of numbers of order 1.
    const ROUNDING: f32 = 1e-5;

    fn material(surface: Surface) -> Material {
        Material {
            name: "test".into(),
            surface,
            base_color_texture: None,
            metallic_roughness_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            anisotropy_texture: None,
        }
    }

    fn metallic_roughness() -> Surface {
        Surface::MetallicRoughness {
            base_color: [0.8, 0.6, 0.4],
            metallic: 0.0,
            roughness: 0.5,
            anisotropy_strength: 0.0,
            anisotropy_rotation: 0.0,
        }
    }

    /// One right triangle in the plane z = 0, its texture coordinates running with x and
    /// down with y, its tangent along x.
    fn scene(material: Material, textures: Vec<Texture>) -> Scene {
        let vertex = |x: f32, y: f32| Vertex {
            position: [x, y, 0.0],
            normal: [0.0, 0.0, 1.0],
            tangent: [1.0, 0.0, 0.0, 1.0],
            uv: [x, 1.0 - y],
        };
        Scene {
            name: String::new(),
            visibility: VisibilityParameters {
                representation: Representation::ClusteredPca,
                sample_resolution: 128,
                basis_resolution: 4,
                distance_clamp: 0.5,
                ray_offset: 0.0,
            },
            camera: None,
            materials: vec![material],
            textures,
            report: BakeReport::default(),
            vertices: vec![vertex(0.0, 0.0), vertex(1.0, 0.0), vertex(0.0, 1.0)],
            triangles: vec![Triangle {
                vertices: [0, 1, 2],
                material: 0,
                cluster: 0,
            }],
            clusters: vec![Cluster {
                first_vertex: 0,
                vertex_count: 3,
                first_coefficient: 0,
                first_tile: 0,
                tiles: 1,
                coefficient_scale: 1.0,
            }],
            coefficients: vec![0; 12],
            basis: vec![0; 64],
        }
    }

    const EYE: Vec3 = Vec3::new(0.2, 0.3, 4.0);

    fn at(scene: &Scene, x: f32, y: f32) -> SurfacePoint {
        surface_point(scene, 0, Vec3::new(1.0 - x - y, x, y), EYE)
    }

    fn texture(width: u32, encoding: TextureEncoding, texels: &[[u8; 4]]) -> Texture {
        let height = texels.len() as u32 / width;
        Texture {
            width,
            height,
            encoding,
            texels: texels.concat(),
        }
    }

    fn slot(transform: [[f32; 3]; 2]) -> TextureSlot {
        TextureSlot {
            texture: 0,
            transform,
        }
    }

    const IDENTITY: [[f32; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    fn assert_frame(point: &SurfacePoint) {
        assert!(
            point.normal.is_normalized() && point.tangent.is_normalized(),
            "{point:?}"
        );
        assert!(
            point.normal.dot(point.tangent).abs() < ROUNDING,
            "{point:?}"
        );
        assert!(point.bitangent.distance(point.normal.cross(point.tangent)) < ROUNDING);
    }

    #[test]
    fn metallic_roughness_becomes_diffuse_and_ggx() {
        let mut material = material(metallic_roughness());
        if let Surface::MetallicRoughness { metallic, .. } = &mut material.surface {
            *metallic = 0.25;
        }
        let point = at(&scene(material, vec![]), 0.25, 0.5);
        assert!(point.position.distance(Vec3::new(0.25, 0.5, 0.0)) < ROUNDING);
        assert!(point.view.distance((EYE - point.position).normalize()) < ROUNDING);
        assert_frame(&point);
        let appearance = point.appearance;
        assert!(appearance.diffuse.distance(Vec3::new(0.6, 0.45, 0.3)) < ROUNDING);
        assert!(appearance.specular.distance(Vec3::new(0.23, 0.18, 0.13)) < ROUNDING);
        assert_eq!(
            (appearance.model, appearance.alpha),
            (Model::Ggx, Vec2::splat(0.25))
        );
    }

    #[test]
    fn roughness_is_clamped_to_what_is_shaded() {
        let specular = |specular| Surface::Layered {
            diffuse: [0.0; 3],
            specular,
        };
        let mirror = specular(Specular::Ggx {
            f0: [1.0; 3],
            alpha: [1e-4, 0.5],
        });
        let shiny = specular(Specular::BlinnPhong {
            specular: [1.0; 3],
            exponent: 1e9,
        });
        let alpha = |surface| {
            at(&scene(material(surface), vec![]), 0.1, 0.1)
                .appearance
                .alpha
        };
        assert_eq!(alpha(mirror), Vec2::new(MIN_ALPHA, 0.5));
        assert_eq!(alpha(shiny), Vec2::splat(MAX_EXPONENT));
    }

    #[test]
    fn textures_are_bilinear_and_repeat() {
        let mut material = material(Surface::Layered {
            diffuse: [1.0; 3],
            specular: Specular::None,
        });
        let black_white = [[0, 0, 0, 255], [255, 255, 255, 255]];
        let red = |material: &Material, u: f32| {
            let texture = texture(2, TextureEncoding::Linear, &black_white);
            at(&scene(material.clone(), vec![texture]), u, 0.0)
                .appearance
                .diffuse
                .x
        };
        material.base_color_texture = Some(slot(IDENTITY));
        // Texel centres at ¼ and ¾; between them a ramp, and another across the border.
        for (u, expected) in [
            (0.25, 0.0),
            (0.375, 0.25),
            (0.75, 1.0),
            (0.875, 0.75),
            (0.0, 0.5),
        ] {
            assert!((red(&material, u) - expected).abs() < ROUNDING, "u = {u}");
        }
        // u' = 2 u − 3.1 goes through negative coordinates.
        material.base_color_texture = Some(slot([[2.0, 0.0, -3.1], [0.0, 1.0, 0.0]]));
        assert!((red(&material, 0.3) - 0.5).abs() < ROUNDING);
        assert!(red(&material, 0.175).abs() < ROUNDING);
    }

    #[test]
    fn rows_go_down_and_srgb_is_decoded_before_filtering() {
        let mut material = material(Surface::Layered {
            diffuse: [1.0; 3],
            specular: Specular::None,
        });
        material.base_color_texture = Some(slot(IDENTITY));
        let texels = [[188, 0, 0, 255], [0, 0, 0, 255]];
        let scene = scene(material, vec![texture(1, TextureEncoding::Srgb, &texels)]);
        // sRGB 188 is 0.5029 of full intensity; y = ¾ is v = ¼, the first row.
        let red = |y: f32| at(&scene, 0.0, y).appearance.diffuse.x;
        assert!((red(0.75) - 0.5029).abs() < 1e-4, "{}", red(0.75));
        assert!((red(0.5) - 0.5 * 0.5029).abs() < 1e-4, "{}", red(0.5));
        assert!(red(0.25).abs() < ROUNDING);
    }

    #[test]
    fn normal_maps_tilt_towards_the_tangent_frame() {
        let mut material = material(metallic_roughness());
        material.normal_texture = Some(slot(IDENTITY));
        material.normal_scale = 0.5;
        // (0.6, 0.8 ...) to within a byte; x and y halved by the scale.
        let mapped = texture(1, TextureEncoding::Linear, &[[204, 179, 255, 255]]);
        let mut scene = scene(material, vec![mapped]);
        let expected = |sign: f32| {
            let (x, y) = (204.0 / 127.5 - 1.0, 179.0 / 127.5 - 1.0);
            Vec3::new(0.5 * x, 0.5 * y * sign, 1.0).normalize()
        };
        let point = at(&scene, 0.2, 0.2);
        assert!(
            point.normal.distance(expected(1.0)) < ROUNDING,
            "{}",
            point.normal
        );
        assert_frame(&point);
        for vertex in &mut scene.vertices {
            vertex.tangent[3] = -1.0;
        }
        assert!(at(&scene, 0.2, 0.2).normal.distance(expected(-1.0)) < ROUNDING);
    }

    #[test]
    fn anisotropy_turns_the_tangent_and_widens_along_it() {
        let mut material = material(Surface::MetallicRoughness {
            base_color: [1.0; 3],
            metallic: 1.0,
            roughness: 0.5,
            anisotropy_strength: 0.8,
            anisotropy_rotation: 0.5,
        });
        let point = at(&scene(material.clone(), vec![]), 0.2, 0.2);
        assert!(
            point
                .tangent
                .distance(Vec3::new(0.5f32.cos(), 0.5f32.sin(), 0.0))
                < ROUNDING
        );
        assert!(
            point
                .appearance
                .alpha
                .distance(Vec2::new(0.25 + 0.75 * 0.64, 0.25))
                < ROUNDING
        );
        // Direction (0, 1), half strength: a quarter turn more.
        material.anisotropy_texture = Some(slot(IDENTITY));
        let direction = |texel| {
            let texture = texture(1, TextureEncoding::Linear, &[texel]);
            at(&scene(material.clone(), vec![texture]), 0.2, 0.2)
        };
        let point = direction([128, 255, 255, 255]);
        let expected = Vec3::new(-(0.5f32.sin()), 0.5f32.cos(), 0.0);
        // A byte cannot hold a direction component of exactly 0.
        assert!(point.tangent.distance(expected) < 5e-3, "{}", point.tangent);
        let isotropic = direction([128, 255, 0, 255]).appearance.alpha;
        assert_eq!(isotropic, Vec2::splat(0.25));
    }

    #[test]
    fn degenerate_vertices_still_have_a_frame() {
        let mut scene = scene(material(metallic_roughness()), vec![]);
        for (normal, tangent) in [
            ([0.0; 3], [0.0; 4]),
            ([0.0, 0.0, -1.0], [0.0, 0.0, 1.0, 1.0]),
            ([0.0, 1e-3, 0.0], [0.0, -5.0, 1e-9, -1.0]),
            ([0.6, 0.0, 0.8], [0.6, 0.0, 0.8, 1.0]),
        ] {
            for vertex in &mut scene.vertices {
                (vertex.normal, vertex.tangent) = (normal, tangent);
            }
            assert_frame(&at(&scene, 0.3, 0.3));
        }
        // A triangle of no area, seen from its own corner.
        for vertex in &mut scene.vertices {
            vertex.position = EYE.into();
            vertex.normal = [0.0; 3];
        }
        let point = at(&scene, 0.3, 0.3);
        assert_frame(&point);
        assert!(point.view.is_normalized() && point.geometric_normal.is_normalized());
    }
}
