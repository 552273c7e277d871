//! What rays meet: reflectance and emission of the scene as it was imported.

use glam::Vec3;
use rayon::prelude::*;
use relight_format as format;
use relight_shading::surface::{Join, emission, surface_point, visit_layers};
use relight_shading::transfer::albedo;

use super::emitters::{Emitter, Emitters};
use crate::mesh::Mesh;
use crate::mesh::size::SizeFunction;

/// The imported mesh with its materials and textures.
pub(crate) struct Surfaces {
    scene: format::Scene,
    /// By material: albedo, where it is the same everywhere and from all sides.
    plain: Vec<Option<Vec3>>,
    /// By triangle: the same of those that are so small that its mean will do; empty where no albedo needs that.
    small: Vec<Option<Vec3>>,
    emitters: Emitters,
}

/// A point of a surface that a ray meets, from the side that it comes from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Met {
    /// Of the mesh.
    pub triangle: usize,
    /// Of the triangle.
    pub barycentrics: Vec3,
    /// World space, metres.
    pub position: Vec3,
    /// Geometric normal, towards where the ray comes from.
    pub normal: Vec3,
    /// Part of diffuse light that is sent on.
    pub albedo: Vec3,
    /// Radiance of its own.
    pub emission: Vec3,
    /// Whether the ray comes from behind the triangle.
    pub behind: bool,
}

/// A place on a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// Of the mesh.
    pub triangle: usize,
    /// Of the triangle.
    pub barycentrics: Vec3,
    /// World space, metres.
    pub position: Vec3,
}

/// A part of a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece {
    /// Of the mesh.
    triangle: usize,
    /// Barycentrics of its corners.
    corners: [Vec3; 3],
    /// What it counts where places are spread.
    pub(crate) weight: f64,
}

/// Longest side of a piece of a wide triangle, in sizes of what is there.
const PIECE: f32 = 0.25;
/// As often is a triangle halved at most: its sides to a 65,536th.
const MOST_HALVINGS: u32 = 32;

impl Surfaces {
    /// Copies what shading reads.
    pub(crate) fn new(mesh: &Mesh) -> Self {
        let scene = bare_scene(mesh);
        let mut surfaces = Self {
            plain: vec![None; scene.materials.len()],
            scene,
            small: Vec::new(),
            emitters: Emitters::default(),
        };
        let mut known = vec![false; surfaces.plain.len()];
        for index in 0..surfaces.triangle_count() {
            let material = usize::from(surfaces.scene.triangles[index].material);
            if !known[material] && is_plain(&surfaces.scene.materials[material]) {
                let [corner, ..] = surfaces.corners(index);
                let eye = corner + surfaces.geometric_normal(index);
                let point = surface_point(&surfaces.scene, index, Vec3::splat(1.0 / 3.0), eye);
                surfaces.plain[material] = Some(albedo(&point));
            }
            known[material] = true;
        }
        let emitter = |triangle| Emitter {
            triangle: triangle as u32,
            corners: surfaces.corners(triangle),
            radiance: surfaces.radiance(triangle),
        };
        let count = surfaces.triangle_count();
        let emitting = (0..count).filter(|triangle| surfaces.radiance(*triangle) > 0.0);
        surfaces.emitters = Emitters::new(emitting.map(emitter).collect(), count);
        surfaces
    }

    /// Sum over channels of what a triangle's material emits, textures aside.
    pub(crate) fn radiance(&self, triangle: usize) -> f32 {
        let material = usize::from(self.scene.triangles[triangle].material);
        Vec3::from(self.scene.materials[material].emission).element_sum()
    }

    /// What a point of a triangle's front emits.
    pub(crate) fn emission(&self, triangle: usize, barycentrics: Vec3) -> Vec3 {
        emission(&self.scene, triangle, barycentrics, None)
    }

    /// What emits.
    pub(crate) fn emitters(&self) -> &Emitters {
        &self.emitters
    }

    /// Whether any surface emits light.
    pub(crate) fn emit(&self) -> bool {
        !self.emitters.is_empty()
    }

    /// Triangles.
    pub(crate) fn triangle_count(&self) -> usize {
        self.scene.triangles.len()
    }

    /// What shading reads.
    pub(crate) fn scene(&self) -> &format::Scene {
        &self.scene
    }

    /// Places evenly over some pieces, one for every `step` of what they count.
    pub(crate) fn spread(&self, pieces: impl Iterator<Item = Piece>, step: f64) -> Vec<Place> {
        let mut places = Vec::new();
        // Systematic sampling: every `step`, from half of it on.
        let mut due = 0.5 * step;
        for piece in pieces {
            let mut number = 0;
            while due < piece.weight && step > 0.0 {
                let within = spread(number);
                let [a, b, c] = piece.corners;
                let barycentrics = a * within.x + b * within.y + c * within.z;
                places.push(Place {
                    triangle: piece.triangle,
                    barycentrics,
                    position: self.position(piece.triangle, barycentrics),
                });
                number += 1;
                due += step;
            }
            due -= piece.weight;
        }
        places
    }

    /// All of a triangle, which counts its area.
    pub(crate) fn whole(&self, triangle: usize) -> Piece {
        Piece {
            triangle,
            corners: [Vec3::X, Vec3::Y, Vec3::Z],
            weight: self.area(triangle),
        }
    }

    /// A triangle in pieces in each of which things are about equally large, and which count their area in that of
    /// what is there. One that is not wide beside what is small is one piece.
    pub(crate) fn pieces(&self, triangle: usize, sizes: &SizeFunction) -> Vec<Piece> {
        if sizes.is_even() {
            return vec![self.whole(triangle)];
        }
        let mut left = vec![(self.whole(triangle), 0)];
        let mut pieces = Vec::new();
        while let Some((piece, halvings)) = left.pop() {
            let corners = piece.corners.map(|at| self.position(triangle, at));
            let length = |k: usize| sizes.length(corners[k], corners[(k + 1) % 3], PIECE);
            let longest = (1..3).fold(0, |longest, k| {
                if length(k) > length(longest) {
                    k
                } else {
                    longest
                }
            });
            if length(longest) <= PIECE || halvings == MOST_HALVINGS {
                let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
                let part = f64::from(sizes.part(middle));
                let weight = piece.weight / (part * part);
                pieces.push(Piece { weight, ..piece });
                continue;
            }
            let [a, b, c] = [0, 1, 2].map(|k| piece.corners[(longest + k) % 3]);
            let middle = (a + b) * 0.5;
            for corners in [[a, middle, c], [middle, b, c]] {
                let weight = 0.5 * piece.weight;
                let half = Piece {
                    corners,
                    weight,
                    ..piece
                };
                left.push((half, halvings + 1));
            }
        }
        pieces
    }

    /// Area of a triangle, square metres.
    pub(crate) fn area(&self, triangle: usize) -> f64 {
        let [a, b, c] = self.corners(triangle);
        0.5 * f64::from((b - a).cross(c - a).length())
    }

    /// Triangles of a material.
    pub(crate) fn of_material(&self, material: usize) -> Vec<usize> {
        (0..self.triangle_count())
            .filter(|&triangle| usize::from(self.scene.triangles[triangle].material) == material)
            .collect()
    }

    /// Where a triangle has some barycentrics.
    fn position(&self, triangle: usize, barycentrics: Vec3) -> Vec3 {
        let [a, b, c] = self.corners(triangle);
        a * barycentrics.x + b * barycentrics.y + c * barycentrics.z
    }

    /// Corners of a triangle.
    pub(crate) fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.scene.triangles[triangle]
            .vertices
            .map(|vertex| self.scene.vertices[vertex as usize].position.into())
    }

    /// Shading normal of a triangle at some barycentrics.
    pub(crate) fn normal(&self, triangle: usize, barycentrics: Vec3) -> Vec3 {
        let [a, b, c] = self.scene.triangles[triangle]
            .vertices
            .map(|vertex| Vec3::from(self.scene.vertices[vertex as usize].normal));
        let normal = a * barycentrics.x + b * barycentrics.y + c * barycentrics.z;
        normal.normalize_or(self.geometric_normal(triangle))
    }

    /// Of a triangle's front.
    pub(crate) fn geometric_normal(&self, triangle: usize) -> Vec3 {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(c - a).normalize_or(Vec3::Y)
    }

    /// From here on some triangles have the same albedo everywhere, unless it depends on where they are seen from.
    pub(crate) fn average(&mut self, small: &[bool]) {
        let is_textured = |(material, plain): (&format::Material, &Option<Vec3>)| {
            plain.is_none() && !depends_on_view(material)
        };
        let materials = self.scene.materials.iter().zip(&self.plain);
        let textured: Vec<bool> = materials.map(is_textured).collect();
        if !textured.contains(&true) {
            return;
        }
        let mean = |(triangle, small): (usize, &bool)| {
            let material = usize::from(self.scene.triangles[triangle].material);
            (*small && textured[material]).then(|| {
                // Exact for what changes as squares of places do.
                let places = [[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]];
                let albedo = |place: [f32; 3]| {
                    let barycentrics = Vec3::from(place) / 6.0;
                    let position = self.position(triangle, barycentrics);
                    let eye = position + self.geometric_normal(triangle);
                    self.albedo(triangle, barycentrics, eye)
                };
                places.into_iter().map(albedo).sum::<Vec3>() / 3.0
            })
        };
        self.small = small.par_iter().enumerate().map(mean).collect();
    }

    /// Part of diffuse light that a point of a triangle sends on towards `eye`.
    pub(crate) fn albedo(&self, triangle: usize, barycentrics: Vec3, eye: Vec3) -> Vec3 {
        let material = usize::from(self.scene.triangles[triangle].material);
        let known = self.plain[material].or_else(|| *self.small.get(triangle)?);
        known.unwrap_or_else(|| albedo(&surface_point(&self.scene, triangle, barycentrics, eye)))
    }

    /// What a ray from `origin` meets at a point of a triangle.
    pub(crate) fn meet(&self, triangle: usize, barycentrics: Vec3, origin: Vec3) -> Met {
        let position = self.position(triangle, barycentrics);
        let normal = self.geometric_normal(triangle);
        let behind = normal.dot(origin - position) < 0.0;
        // What is emitted leaves the front alone, as it is drawn.
        let emission = if self.emit() && !behind {
            self.emission(triangle, barycentrics)
        } else {
            Vec3::ZERO
        };
        Met {
            triangle,
            barycentrics,
            position,
            normal: if behind { -normal } else { normal },
            albedo: self.albedo(triangle, barycentrics, origin),
            emission,
            behind,
        }
    }
}

/// Barycentrics of the points of one triangle, evenly spread (Roberts 2018, R2, folded).
fn spread(number: u32) -> Vec3 {
    let index = f64::from(number);
    let u = (0.5 + index * 0.754_877_666_246_693) % 1.0;
    let v = (0.5 + index * 0.569_840_290_998_053) % 1.0;
    let (u, v) = if u + v > 1.0 {
        (1.0 - u, 1.0 - v)
    } else {
        (u, v)
    };
    // Of a triangle's first point: its middle, not the middle of an edge.
    let (u, v) = if number == 0 {
        (1.0 / 3.0, 1.0 / 3.0)
    } else {
        (u, v)
    };
    Vec3::new((1.0 - u - v) as f32, u as f32, v as f32)
}

/// Whether the albedo of a material is the same everywhere and from all sides.
fn is_plain(material: &format::Material) -> bool {
    if let format::Surface::MetallicRoughness { .. } = material.surface {
        let textures = [
            &material.base_color_texture,
            &material.metallic_roughness_texture,
            &material.anisotropy_texture,
        ];
        return textures.into_iter().all(Option::is_none);
    }
    let mut plain = !depends_on_view(material);
    visit_layers(material, |layer| {
        let textures = [
            layer.diffuse_texture,
            layer.specular_texture,
            layer.roughness_texture,
            layer.weight_texture,
        ];
        plain &= textures.iter().all(Option::is_none);
    });
    plain
}

/// Whether the albedo of a material does: what a coat lets through.
fn depends_on_view(material: &format::Material) -> bool {
    let mut depends = false;
    visit_layers(material, |layer| depends |= layer.join == Join::Coat);
    depends
}

/// A mesh as the runtime would see it, without visibility.
pub fn bare_scene(mesh: &Mesh) -> format::Scene {
    format::Scene {
        name: String::new(),
        visibility: format::VisibilityParameters {
            representation: format::Representation::ClusteredPca,
            sample_resolution: 1,
            basis_resolution: 2,
            distance_clamp: std::f32::consts::PI,
            ray_offset: 0.0,
        },
        camera: None,
        materials: mesh.materials.clone(),
        textures: mesh.textures.clone(),
        report: format::BakeReport::default(),
        vertices: mesh.vertices.iter().map(|&vertex| vertex.into()).collect(),
        second_uvs: if mesh.has_second_uvs() {
            (mesh.vertices.iter())
                .map(|vertex| vertex.second_uv.into())
                .collect()
        } else {
            Vec::new()
        },
        triangles: (mesh.triangles.iter())
            .map(|triangle| format::Triangle {
                vertices: triangle.vertices,
                material: triangle.material,
                cluster: 0,
            })
            .collect(),
        clusters: Vec::new(),
        coefficients: Vec::new(),
        basis: Vec::new(),
        transfer: None,
    }
}
