//! What all importers share: parts of a mesh are cleaned, completed and appended.

use std::path::Path;

use glam::{DVec3, Vec3};
use relight_format::{Material, Texture, Vertex};

use super::{Error, ImportedTriangle, MAX_COORDINATE, MAX_VERTICES, Mesh};
use crate::mesh::tangent;

/// Triangles of one material, in world space.
pub(super) struct Part {
    /// A zero normal or tangent stands for none.
    pub vertices: Vec<Vertex>,
    pub triangles: Vec<[u32; 3]>,
    /// Index into the materials given to [`Builder::finish`].
    pub material: usize,
    pub tangents: Tangents,
    pub double_sided: bool,
}

/// Where a part's tangents come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tangents {
    /// The file has them.
    Given,
    /// There are texture coordinates, and a texture depends on the frame.
    MikkTSpace,
    /// There are texture coordinates.
    FromUv,
    /// There is nothing to go by.
    AroundAxis,
}

/// Collects parts. The counters become warnings.
pub(super) struct Builder<'a> {
    file: &'a Path,
    vertices: Vec<Vertex>,
    triangles: Vec<([u32; 3], usize)>,
    warnings: Vec<String>,
    degenerate: usize,
    invented_normals: usize,
    turned_away: usize,
    second_sheets: usize,
}

impl<'a> Builder<'a> {
    pub fn new(file: &'a Path) -> Self {
        Self {
            file,
            vertices: Vec::new(),
            triangles: Vec::new(),
            warnings: Vec::new(),
            degenerate: 0,
            invented_normals: 0,
            turned_away: 0,
            second_sheets: 0,
        }
    }

    /// Adds a warning unless the same was given before.
    pub fn warn(&mut self, warning: String) {
        if !self.warnings.contains(&warning) {
            self.warnings.push(warning);
        }
    }

    /// Cleans, completes and appends a part. Its indices must be in range and its numbers
    /// finite.
    pub fn push(&mut self, mut part: Part) -> Result<(), Error> {
        if let Some(position) = Mesh::distant_position(&part.vertices) {
            return Err(Error::invalid(
                self.file,
                "mesh, in world space",
                format_args!("coordinates within {MAX_COORDINATE} m of the origin"),
                format_args!("{position:?}"),
            ));
        }
        let before = part.triangles.len();
        let vertices = &part.vertices;
        part.triangles
            .retain(|triangle| face_normal(vertices, *triangle).is_some());
        self.degenerate += before - part.triangles.len();
        drop_unused(&mut part.vertices, &mut part.triangles);
        self.complete_normals(&mut part);
        match part.tangents {
            Tangents::Given => {
                for vertex in &mut part.vertices {
                    let [x, y, z, w] = vertex.tangent;
                    let normal = vertex.normal.into();
                    vertex.tangent = match tangent::orthogonal(normal, Vec3::new(x, y, z)) {
                        Some(tangent) => tangent.extend(if w < 0.0 { -1.0 } else { 1.0 }),
                        None => tangent::around_axis(normal).extend(1.0),
                    }
                    .into();
                }
            }
            Tangents::MikkTSpace => {
                tangent::set_mikktspace(&mut part.vertices, &mut part.triangles);
            }
            Tangents::FromUv => tangent::set_from_uv(&mut part.vertices, &part.triangles),
            Tangents::AroundAxis => tangent::set_around_axis(&mut part.vertices),
        }
        self.append(&part)?;
        if part.double_sided {
            self.second_sheets += part.triangles.len();
            self.append(&reversed(part))?;
        }
        Ok(())
    }

    fn complete_normals(&mut self, part: &mut Part) {
        let mut sums: Option<Vec<DVec3>> = None;
        for index in 0..part.vertices.len() {
            let given = Vec3::from(part.vertices[index].normal);
            let normal = given.try_normalize().unwrap_or_else(|| {
                self.invented_normals += 1;
                let sums = sums.get_or_insert_with(|| {
                    let indices = part.triangles.iter().map(|t| t.map(|i| i as usize));
                    smooth_normals(part.vertices.len(), &part.vertices, indices)
                });
                // Faces that cancel leave any direction as good as another.
                sums[index].as_vec3().try_normalize().unwrap_or(Vec3::Y)
            });
            part.vertices[index].normal = normal.into();
        }
        for triangle in &part.triangles {
            let face = face_normal(&part.vertices, *triangle).unwrap_or_default();
            let away = |index: &u32| {
                face.dot(Vec3::from(part.vertices[*index as usize].normal).as_dvec3()) < 0.0
            };
            self.turned_away += usize::from(triangle.iter().all(away));
        }
    }

    fn append(&mut self, part: &Part) -> Result<(), Error> {
        let base = self.vertices.len();
        let vertices = base + part.vertices.len();
        let triangles = self.triangles.len() + part.triangles.len();
        if vertices.max(triangles) > MAX_VERTICES {
            return Err(Error::invalid(
                self.file,
                "mesh",
                format_args!("at most {MAX_VERTICES} vertices and triangles"),
                format_args!("{vertices} vertices and {triangles} triangles or more"),
            ));
        }
        self.vertices.extend_from_slice(&part.vertices);
        self.triangles.extend(
            part.triangles
                .iter()
                .map(|triangle| (triangle.map(|index| index + base as u32), part.material)),
        );
        Ok(())
    }

    /// The mesh, with the materials and textures that it uses.
    pub fn finish(mut self, materials: &[Material], textures: &[Texture]) -> Result<Mesh, Error> {
        if self.triangles.is_empty() {
            let found = match self.degenerate {
                0 => "no triangle".to_owned(),
                count => format!("{count} of zero area"),
            };
            return Err(Error::invalid(
                self.file,
                "mesh",
                "at least one triangle",
                found,
            ));
        }
        let mut mesh = Mesh {
            vertices: self.vertices,
            ..Mesh::default()
        };
        let mut used = vec![None; materials.len()];
        for (vertices, material) in self.triangles {
            let material = *used[material].get_or_insert_with(|| {
                mesh.materials.push(materials[material].clone());
                mesh.materials.len() - 1
            });
            let Ok(material) = u16::try_from(material) else {
                return Err(Error::invalid(
                    self.file,
                    "materials",
                    format_args!("at most {} of them", usize::from(u16::MAX) + 1),
                    "more",
                ));
            };
            mesh.triangles.push(ImportedTriangle { vertices, material });
        }
        mesh.textures = textures.to_vec();
        mesh.drop_unused_textures();
        let counted = [
            (self.degenerate, "triangles of zero area are dropped"),
            (
                self.invented_normals,
                "vertices have a zero normal, which their faces replace",
            ),
            (
                self.turned_away,
                "triangles wind against their own vertex normals and will look dark",
            ),
            (
                self.second_sheets,
                "triangles are double-sided: each becomes two, back to back, which bakes both \
                 sides",
            ),
        ];
        for (count, what) in counted {
            if count > 0 {
                self.warnings.push(format!("{count} {what}"));
            }
        }
        mesh.warnings = self.warnings;
        Ok(mesh)
    }
}

/// Unit normal of the side from which the vertices run counter-clockwise, or `None` for a
/// triangle without area. The cross product of f32 differences is exact enough in f64 to
/// tell a needle from a line.
pub(super) fn face_normal(vertices: &[Vertex], triangle: [u32; 3]) -> Option<DVec3> {
    let [a, b, c] = triangle.map(|index| Vec3::from(vertices[index as usize].position).as_dvec3());
    (b - a).cross(c - a).try_normalize()
}

/// Sums of face normals, each weighted by its angle at the vertex (Thürmer & Wüthrich 1998).
pub(super) fn smooth_normals(
    count: usize,
    vertices: &[Vertex],
    triangles: impl Iterator<Item = [usize; 3]>,
) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; count];
    for triangle in triangles {
        let corners = triangle.map(|index| Vec3::from(vertices[index].position).as_dvec3());
        let weights = angle_weighted_normals(corners);
        for (index, weight) in triangle.into_iter().zip(weights) {
            sums[index] += weight;
        }
    }
    sums
}

/// A triangle's unit normal times its angle at each corner; zero for a degenerate one.
pub(super) fn angle_weighted_normals(corners: [DVec3; 3]) -> [DVec3; 3] {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a).normalize_or_zero();
    [(a, b, c), (b, c, a), (c, a, b)].map(|(apex, left, right)| {
        let (left, right) = (
            (left - apex).normalize_or_zero(),
            (right - apex).normalize_or_zero(),
        );
        normal * left.dot(right).clamp(-1.0, 1.0).acos()
    })
}

/// The back of a part. Negating the whole frame negates a normal map's normal as well: what
/// is a bump on one side of a thin sheet is a dent on the other.
fn reversed(mut part: Part) -> Part {
    for vertex in &mut part.vertices {
        vertex.normal = vertex.normal.map(|x| -x);
        vertex.tangent = vertex.tangent.map(|x| -x);
    }
    for triangle in &mut part.triangles {
        triangle.swap(1, 2);
    }
    part
}

fn drop_unused(vertices: &mut Vec<Vertex>, triangles: &mut [[u32; 3]]) {
    let mut moved: Vec<Option<u32>> = vec![None; vertices.len()];
    for index in triangles.iter().flatten() {
        moved[*index as usize] = Some(0);
    }
    let mut count = 0;
    let mut kept = moved.iter_mut().map(|slot| {
        slot.as_mut().map(|index| {
            *index = count;
            count += 1;
        })
    });
    vertices.retain(|_| kept.next().flatten().is_some());
    for index in triangles.iter_mut().flatten() {
        *index = moved[*index as usize].unwrap_or_default();
    }
}
