//! What a pixel sees: position, shading frame and reflectance parameters at a point of a
//! triangle.
//!
//! Textures are repeated, texel centres at (i + ½)/N, v down, sRGB decoded per texel before filtering: see
//! [`crate::textures`].

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles as _};
pub use relight_format::MAX_REFLECTIONS;
use relight_format::math;
use relight_format::{RATIO_NODES, RATIO_SHAPE, Scene, Surface, Texture, TextureSlot, Vertex};

mod layers;
mod reflection;

pub use layers::{Join, LayerParameters, fitted_reflection, has_diffuse, visit_layers};
pub(crate) use reflection::schlick;
pub use reflection::{Appearance, Model, Reflection, metallic_roughness_alpha};

use crate::textures::{self, Filter, Place, RGBE_BIAS, decode_rgbe};

/// Smallest roughness that is shaded, on the scale of GGX alpha. Its lobe falls to a third
/// within 0.04 rad, little more than a texel of a 128 × 128 visibility bitmap.
pub const MIN_ALPHA: f32 = 0.02;
/// Blinn-Phong exponent whose lobe is as narrow as [`MIN_ALPHA`]: `2 / alpha²`.
pub const MAX_EXPONENT: f32 = 2.0 / (MIN_ALPHA * MIN_ALPHA);
/// Reflectance of a dielectric at normal incidence in glTF 2.0 (index of refraction 1.5).
pub const DIELECTRIC_F0: f32 = 0.04;
/// Least product of sines by which the azimuth of a ratio is divided.
const LEAST_RATIO_SINE: f32 = 1e-6;
/// Least cosine between the shading normal and the direction to an eye that sees the front of a
/// triangle: normals that are farther from it are bent towards it, in the plane of both.
pub const LEAST_VIEW_COSINE: f32 = 0.05;
/// Squared length below which a direction carries no information.
const DEGENERATE_LENGTH_SQUARED: f32 = 1e-12;

/// A point of a surface and how it reflects towards the eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint<'a> {
    /// World space, metres.
    pub position: Vec3,
    /// Unit normal of the triangle, counter-clockwise side.
    pub geometric_normal: Vec3,
    /// Unit shading normal, normal map applied.
    pub normal: Vec3,
    /// Cosine between the normal and the one that the vertices interpolate to.
    pub vertex_cosine: f32,
    /// Unit, orthogonal to `normal`; the direction of `alpha.x`.
    pub tangent: Vec3,
    /// `cross(normal, tangent)`; the direction of `alpha.y`.
    pub bitangent: Vec3,
    /// Unit vector to the eye.
    pub view: Vec3,
    /// Reflectance.
    pub appearance: Appearance<'a>,
}

impl SurfacePoint<'_> {
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
) -> SurfacePoint<'_> {
    surface_seen(scene, triangle, barycentrics, eye.extend(1.0), None)
}

/// The same, seen from an eye in homogeneous coordinates: where w is 0, the unit direction towards
/// a viewer at infinity. Textures are filtered as a pixel there sees them, or looked up at the point.
///
/// # Panics
/// If `triangle` is not a triangle of `scene`.
#[allow(
    clippy::too_many_lines,
    reason = "stays beside its twin, surface.wgsl, line by line"
)]
pub fn surface_seen<'a>(
    scene: &'a Scene,
    triangle: usize,
    barycentrics: Vec3,
    eye: Vec4,
    filter: Option<Filter>,
) -> SurfacePoint<'a> {
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
    let [pa, pb, pc] = [a, b, c].map(|vertex| Vec3::from(vertex.position));
    let geometric_normal = unit_or((pb - pa).cross(pc - pa), Vec3::Y);
    let at = (barycentrics, position);
    let place = |second| Place::new(scene, triangle.vertices, at, filter, second);
    let first = place(false);
    let sample = |slot: &TextureSlot| {
        let place = if slot.second_uv { place(true) } else { first };
        textures::sample(scene, slot, place)
    };

    let smooth_normal = unit_or(vertex_normal, geometric_normal);
    let mut normal = smooth_normal;
    let mut tangent = orthogonal_unit(vertex_tangent.xyz(), normal);
    let handedness = if vertex_tangent.w < 0.0 { -1.0 } else { 1.0 };
    if let Some(texel) = material.normal_texture.as_ref().map(sample) {
        let mapped = texel.xyz() * 2.0 - 1.0;
        let bitangent = normal.cross(tangent) * handedness;
        let scaled = tangent * (mapped.x * material.normal_scale)
            + bitangent * (mapped.y * material.normal_scale)
            + normal * mapped.z;
        normal = unit_or(scaled, normal);
        tangent = orthogonal_unit(tangent, normal);
    }

    let view = unit_or(eye.xyz() - position * eye.w, normal);
    if geometric_normal.dot(view) > 0.0 && normal.dot(view) < LEAST_VIEW_COSINE {
        // Interpolated or mapped, the normal turned away from an eye that sees the surface:
        // it is bent back as far as models reflect at all.
        let aside = unit_or(normal - normal.dot(view) * view, tangent);
        let sine = (1.0 - LEAST_VIEW_COSINE * LEAST_VIEW_COSINE).sqrt();
        normal = unit_or(LEAST_VIEW_COSINE * view + sine * aside, view);
        tangent = orthogonal_unit(tangent, normal);
    }
    // Direction of anisotropy relative to the tangent, and its strength.
    let anisotropy = material.anisotropy_texture.as_ref().map(|slot| {
        let texel = sample(slot);
        let direction = texel.xy() * 2.0 - 1.0;
        let degenerate = direction.length_squared() < DEGENERATE_LENGTH_SQUARED;
        (if degenerate { Vec2::X } else { direction }, texel.z)
    });
    let turn = |tangent: Vec3, direction: Vec2| {
        let bitangent = normal.cross(tangent) * handedness;
        unit_or(tangent * direction.x + bitangent * direction.y, tangent)
    };
    let appearance = if let Surface::MetallicRoughness {
        base_color,
        metallic,
        roughness,
        anisotropy_strength,
        anisotropy_rotation,
    } = &material.surface
    {
        let color = material.base_color_texture.as_ref().map(sample);
        let base_color = Vec3::from(*base_color) * color.map_or(Vec3::ONE, Vec4::xyz);
        let factors = material.metallic_roughness_texture.as_ref().map(sample);
        let factors = factors.unwrap_or(Vec4::ONE);
        let metallic = metallic * factors.z;
        let roughness = roughness * factors.y;
        let (direction, factor) = anisotropy.unwrap_or((Vec2::X, 1.0));
        let strength = anisotropy_strength * factor;
        if strength > 0.0 {
            let (sin, cos) = math::sin_cos(*anisotropy_rotation);
            let rotated = Vec2::new(cos, sin).rotate(direction);
            tangent = turn(tangent, rotated);
        }
        let reflection = Reflection::new(
            Model::Ggx,
            Vec3::splat(DIELECTRIC_F0).lerp(base_color, metallic),
            metallic_roughness_alpha(roughness, strength),
        );
        Appearance::new(base_color * (1.0 - metallic), &[reflection.clamped()])
    } else {
        if let (Some((direction, _)), Surface::Layers { .. }) = (anisotropy, &material.surface) {
            tangent = turn(tangent, direction);
        }
        let mut appearance = Appearance::new(Vec3::ZERO, &[]);
        let mut count = 0;
        visit_layers(material, |layer| {
            let factor = |slot: Option<&TextureSlot>| slot.map_or(Vec4::ONE, sample);
            let weight = layer.weight * factor(layer.weight_texture).x;
            let diffuse = layer.diffuse * factor(layer.diffuse_texture).xyz();
            let mut reflection = layer.reflection;
            reflection.ratio = layer.ratio.and_then(|slot| {
                let texture = &scene.textures[slot.texture as usize];
                (texture.shape() == RATIO_SHAPE).then_some(texture)
            });
            reflection.specular *= factor(layer.specular_texture).xyz();
            let roughness = factor(layer.roughness_texture).xy();
            let model = reflection.model;
            if model.has_exponent() {
                reflection.alpha /= (roughness.x * roughness.x).max(1e-12);
            } else if model.entry().is_some_and(|entry| !entry.anisotropic) {
                reflection.alpha *= roughness.x;
            } else {
                reflection.alpha *= roughness;
            }
            let below = match layer.join {
                Join::Add => Vec3::ONE,
                Join::Over => Vec3::splat(1.0 - weight),
                // Colours above 1 pass nothing.
                Join::Coat => (1.0 - weight * reflection.color(normal.dot(view))).max(Vec3::ZERO),
            };
            appearance.diffuse = appearance.diffuse * below + diffuse * weight;
            for lower in &mut appearance.reflections[..count] {
                lower.scale(below);
            }
            reflection.scale(Vec3::splat(weight));
            appearance.reflections[count] = reflection.clamped();
            count += 1;
        });
        appearance
    };
    let anisotropic = (appearance.reflections()).any(|r| r.alpha.x != r.alpha.y);
    if anisotropic && matches!(material.surface, Surface::DiffuseSpecular { .. }) {
        // glTF says that the frame is interpolated from the vertices; that of other materials is
        // the triangle's own: x along ∂position/∂u, by Cramer's rule and up to its length. Zero
        // without texture coordinates.
        let step = |to: &Vertex| Vec2::from(to.uv) - Vec2::from(a.uv);
        let (to_b, to_c) = (step(b), step(c));
        let along = ((pb - pa) * to_c.y - (pc - pa) * to_b.y) * to_b.perp_dot(to_c).signum();
        let along = along.reject_from_normalized(normal).normalize_or_zero();
        if along != Vec3::ZERO {
            tangent = along;
        }
    }
    SurfacePoint {
        position,
        geometric_normal,
        normal,
        vertex_cosine: smooth_normal.dot(normal),
        tangent,
        bitangent: normal.cross(tangent),
        view,
        appearance,
    }
}

/// Radiance that the surface emits at `barycentrics` of triangle `triangle`; textures as in
/// [`surface_seen`].
///
/// # Panics
/// If `triangle` is not a triangle of `scene`.
pub fn emission(
    scene: &Scene,
    triangle: usize,
    barycentrics: Vec3,
    filter: Option<Filter>,
) -> Vec3 {
    let triangle = &scene.triangles[triangle];
    let material = &scene.materials[triangle.material as usize];
    let emission = Vec3::from(material.emission);
    let Some(slot) = &material.emission_texture else {
        return emission;
    };
    let corners = triangle
        .vertices
        .map(|vertex| &scene.vertices[vertex as usize]);
    let weights = barycentrics.to_array();
    let position = (corners.iter().zip(weights)).fold(Vec3::ZERO, |position, (corner, weight)| {
        position + Vec3::from(corner.position) * weight
    });
    let at = (barycentrics, position);
    let place = Place::new(scene, triangle.vertices, at, filter, slot.second_uv);
    emission * textures::sample(scene, slot, place).xyz()
}

/// Where a ratio is looked up for two unit vectors above the surface, each from 0 to 1; they are
/// explained at [`relight_format::RATIO_NODES`].
pub fn ratio_coordinates(wi: Vec3, wo: Vec3) -> Vec3 {
    let half = (wi + wo).normalize();
    let cosine = half.dot(wi).clamp(0.0, 1.0);
    let half_sine = Vec2::new(half.x, half.y).length().min(1.0);
    let sines = half_sine * (1.0 - cosine * cosine).sqrt();
    let azimuth = (wi.z - half.z * cosine) / sines.max(LEAST_RATIO_SINE);
    Vec3::new(half_sine.sqrt(), cosine, (azimuth * azimuth).min(1.0))
}

/// Trilinear; of two unit vectors above the surface.
pub fn sample_ratio(texture: &Texture, wi: Vec3, wo: Vec3) -> Vec3 {
    let nodes = RATIO_NODES.map(|nodes| nodes as usize);
    let position = ratio_coordinates(wi, wo) * Vec3::from(nodes.map(|nodes| (nodes - 1) as f32));
    let low: [usize; 3] =
        std::array::from_fn(|axis| (position[axis] as usize).min(nodes[axis] - 2));
    let f = position - Vec3::from(low.map(|low| low as f32));
    let at = |x: usize, y: usize, z: usize| {
        let index = ((low[2] + z) * nodes[1] + low[1] + y) * nodes[0] + low[0] + x;
        decode_rgbe(std::array::from_fn(|channel| {
            texture.texels[4 * index + channel]
        }))
    };
    let row = |y, z| at(0, y, z).lerp(at(1, y, z), f.x);
    let plane = |z| row(0, z).lerp(row(1, z), f.y);
    plane(0).lerp(plane(1), f.z)
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
         const MAX_REFLECTIONS: u32 = {MAX_REFLECTIONS}u;\n\
         const SURFACE_LEAST_VIEW_COSINE: f32 = {LEAST_VIEW_COSINE:?};\n\
         const SURFACE_DEGENERATE_LENGTH_SQUARED: f32 = {DEGENERATE_LENGTH_SQUARED:?};\n\
         const SURFACE_RATIO_NODES: vec3<u32> = vec3({}u, {}u, {}u);\n\
         const SURFACE_RGBE_BIAS: i32 = {RGBE_BIAS};\n\
         const SURFACE_LEAST_RATIO_SINE: f32 = {LEAST_RATIO_SINE:?};\n",
        RATIO_NODES[0], RATIO_NODES[1], RATIO_NODES[2],
    )
}

/// A surface point at the origin whose frame is that of the coordinate axes, seen from the
/// unit vector `view`.
pub fn local_point(appearance: Appearance, view: Vec3) -> SurfacePoint {
    SurfacePoint {
        position: Vec3::ZERO,
        geometric_normal: Vec3::Z,
        normal: Vec3::Z,
        vertex_cosine: 1.0,
        tangent: Vec3::X,
        bitangent: Vec3::Y,
        view,
        appearance,
    }
}

#[cfg(test)]
mod tests {
    use relight_format::{Blend, FittedLobe, Layer, Material, REFLECTION_MODELS, Specular};

    #[test]
    fn models_are_in_the_order_of_the_formats_entries() {
        assert_eq!(Model::ALL.len(), REFLECTION_MODELS.len());
        for (model, entry) in Model::ALL.into_iter().zip(REFLECTION_MODELS) {
            let name = format!("{model:?}").to_ascii_lowercase();
            assert_eq!(name, entry.key.replace('-', ""));
            assert_eq!(Model::of(entry), model);
        }
        assert!(Model::None.entry().is_none());
    }

    use super::*;
    use relight_format::{
        BakeReport, Cluster, Representation, TextureEncoding, Triangle, VisibilityParameters,
    };

    /// A few roundings of numbers of order 1.
    const ROUNDING: f32 = 1e-5;

    fn material(surface: Surface) -> Material {
        relight_format::plain_material("test", surface)
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
            second_uvs: Vec::new(),
            transfer: None,
        }
    }

    const EYE: Vec3 = Vec3::new(0.2, 0.3, 4.0);

    fn at(scene: &Scene, x: f32, y: f32) -> SurfacePoint<'static> {
        // Points refer to their scene; here it lives as long as the test.
        let scene = Box::leak(Box::new(scene.clone()));
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
            transform,
            ..TextureSlot::whole(0)
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
        let reflection = point.appearance.reflections[0];
        assert!(point.appearance.diffuse.distance(Vec3::new(0.6, 0.45, 0.3)) < ROUNDING);
        assert!(reflection.specular.distance(Vec3::new(0.23, 0.18, 0.13)) < ROUNDING);
        assert_eq!(
            (reflection.model, reflection.alpha, reflection.grazing),
            (Model::Ggx, Vec2::splat(0.25), Vec3::ONE)
        );
        assert_eq!(point.appearance.reflections().count(), 1);
    }

    #[test]
    fn roughness_is_clamped_to_what_is_shaded() {
        let specular = |specular| Surface::DiffuseSpecular {
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
                .reflections[0]
                .alpha
        };
        assert_eq!(alpha(mirror), Vec2::new(MIN_ALPHA, 0.5));
        assert_eq!(alpha(shiny), Vec2::splat(MAX_EXPONENT));
    }

    #[test]
    fn textures_are_bilinear_and_repeat() {
        let mut material = material(Surface::DiffuseSpecular {
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
    fn slots_say_which_coordinates_they_are_looked_up_by() {
        let surface = Surface::MetallicRoughness {
            base_color: [1.0; 3],
            metallic: 0.0,
            roughness: 1.0,
            anisotropy_strength: 0.0,
            anisotropy_rotation: 0.0,
        };
        let slot = |second_uv| TextureSlot {
            second_uv,
            ..TextureSlot::whole(0)
        };
        let halves = [[0, 0, 0, 255], [255, 255, 255, 255]];
        let texture = texture(2, TextureEncoding::Linear, &halves);
        for second in [false, true] {
            let mut material = material(surface.clone());
            material.base_color_texture = Some(slot(second));
            material.emission = [2.0; 3];
            material.emission_texture = Some(slot(!second));
            let mut scene = scene(material, vec![texture.clone()]);
            // Seen in the middle of one texel, or of the other.
            for vertex in &mut scene.vertices {
                vertex.uv = [0.25, 0.5];
            }
            scene.second_uvs = vec![[0.75, 0.5]; 3];
            let found = at(&scene, 0.2, 0.3).appearance.diffuse;
            let emitted = emission(&scene, 0, Vec3::splat(1.0 / 3.0), None);
            let of = |bright: bool| Vec3::splat(if bright { 1.0 } else { 0.0 });
            assert!(found.distance(of(second)) < ROUNDING, "{second}: {found}");
            assert!(
                emitted.distance(2.0 * of(!second)) < ROUNDING,
                "{second}: {emitted}"
            );
        }
    }

    #[test]
    fn rows_go_down_and_srgb_is_decoded_before_filtering() {
        let mut material = material(Surface::DiffuseSpecular {
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
                .distance(Vec3::new(math::cos(0.5f32), math::sin(0.5f32), 0.0))
                < ROUNDING
        );
        assert!(
            point.appearance.reflections[0]
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
        let expected = Vec3::new(-(math::sin(0.5f32)), math::cos(0.5f32), 0.0);
        // A byte cannot hold a direction component of exactly 0.
        assert!(point.tangent.distance(expected) < 5e-3, "{}", point.tangent);
        let isotropic = direction([128, 255, 0, 255]).appearance.reflections[0].alpha;
        assert_eq!(isotropic, Vec2::splat(0.25));
    }

    fn layer(diffuse: f32, specular: Specular, weight: f32, blend: Blend) -> Layer {
        Layer {
            diffuse: [diffuse; 3],
            specular,
            weight,
            blend,
            diffuse_texture: None,
            specular_texture: None,
            roughness_texture: None,
            weight_texture: None,
        }
    }

    fn ggx(f0: f32, alpha: f32) -> Specular {
        Specular::Ggx {
            f0: [f0; 3],
            alpha: [alpha; 2],
        }
    }

    #[test]
    fn a_stain_mixes_where_its_texture_says() {
        let mut stain = layer(0.1, ggx(0.2, 0.1), 0.8, Blend::Over);
        stain.weight_texture = Some(slot(IDENTITY));
        let lobes = Specular::Lobes {
            path: String::new(),
            lobes: [0.3, 0.6]
                .map(|roughness| FittedLobe {
                    f0: [0.5; 3],
                    f90: [0.25; 3],
                    roughness,
                })
                .to_vec(),
            ratio: None,
        };
        let base = layer(0.5, lobes, 1.0, Blend::Over);
        let surface = Surface::Layers {
            layers: vec![base, stain],
        };
        let texels = [[0, 9, 9, 9], [255, 9, 9, 9]];
        let texture = texture(2, TextureEncoding::Linear, &texels);
        let scene = scene(material(surface), vec![texture]);
        for (u, weight) in [(0.25, 0.0), (0.5, 0.4), (0.75, 0.8)] {
            let appearance = at(&scene, u, 0.0).appearance;
            assert!((appearance.diffuse.x - (0.5 - 0.4 * weight)).abs() < ROUNDING);
            let expected = [
                (
                    Model::CookTorrance,
                    0.5 * (1.0 - weight),
                    0.25 * (1.0 - weight),
                    0.3,
                ),
                (
                    Model::CookTorrance,
                    0.5 * (1.0 - weight),
                    0.25 * (1.0 - weight),
                    0.6,
                ),
                (Model::Ggx, 0.2 * weight, weight, 0.1),
            ];
            let mut count = 0;
            for (found, (model, specular, grazing, alpha)) in appearance.reflections().zip(expected)
            {
                assert_eq!((found.model, found.alpha.x), (model, alpha));
                assert!((found.specular.y - specular).abs() < ROUNDING, "u = {u}");
                assert!((found.grazing.y - grazing).abs() < ROUNDING, "u = {u}");
                count += 1;
            }
            assert_eq!(count, 3);
        }
    }

    #[test]
    fn a_coat_dims_what_is_below_by_what_it_reflects() {
        let base = layer(0.5, ggx(0.9, 0.4), 1.0, Blend::Over);
        let coat = layer(0.0, ggx(0.04, 0.05), 0.5, Blend::Coat);
        let surface = Surface::Layers {
            layers: vec![base, coat],
        };
        let point = at(&scene(material(surface), vec![]), 0.2, 0.3);
        let cosine = point.normal.dot(point.view);
        let below = 1.0 - 0.5 * (0.04 + 0.96 * (1.0 - cosine).powi(5));
        let [lower, upper, ..] = point.appearance.reflections;
        for (found, expected) in [
            (point.appearance.diffuse.x, 0.5 * below),
            (lower.specular.x, 0.9 * below),
            (lower.grazing.x, below),
            (upper.specular.x, 0.02),
            (upper.grazing.x, 0.5),
        ] {
            assert!(
                (found - expected).abs() < ROUNDING,
                "{found}, not {expected}"
            );
        }
    }

    #[test]
    fn textures_vary_colour_and_roughness_of_a_layer() {
        let slots = [0, 1].map(TextureSlot::whole);
        let textures = [[51, 102, 255, 255], [128, 64, 0, 255]]
            .map(|texel| texture(1, TextureEncoding::Linear, &[texel]))
            .to_vec();
        let reflection = |specular| {
            let surface = Surface::Layers {
                layers: vec![Layer {
                    diffuse_texture: Some(slots[0]),
                    specular_texture: Some(slots[0]),
                    roughness_texture: Some(slots[1]),
                    ..layer(0.5, specular, 1.0, Blend::Over)
                }],
            };
            let appearance = at(&scene(material(surface), textures.clone()), 0.2, 0.2).appearance;
            assert!(appearance.diffuse.distance(Vec3::new(0.1, 0.2, 0.5)) < ROUNDING);
            let specular = appearance.reflections[0].specular;
            assert!(specular.distance(Vec3::new(0.08, 0.16, 0.4)) < ROUNDING);
            appearance.reflections[0].alpha
        };
        let (r, g) = (128.0 / 255.0, 64.0 / 255.0);
        let f0 = [0.4; 3];
        for (specular, expected) in [
            (ggx(0.4, 0.5), Vec2::new(0.5 * r, 0.5 * g)),
            (
                Specular::CookTorrance { f0, roughness: 0.5 },
                Vec2::splat(0.5 * r),
            ),
            (
                Specular::BlinnPhong {
                    specular: f0,
                    exponent: 10.0,
                },
                Vec2::splat(10.0 / (r * r)),
            ),
            (
                Specular::AshikhminShirley {
                    f0,
                    exponents: [8.0, 2.0],
                },
                Vec2::new(0.5 * r, g),
            ),
        ] {
            let found = reflection(specular);
            assert!(found.distance(expected) < 1e-3, "{found}, not {expected}");
        }
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
