//! What all importers share: parts of a mesh are cleaned, completed and appended.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;

use glam::{DVec3, Vec2, Vec3};
use relight_format::{Material, Texture, TextureSlot, math};

use super::colors::{self, Palette};
use super::cutout::{self, Bound, Cutout, TooMuch};
use super::{Error, Options};
use crate::mesh::{self, MAX_COORDINATE, Mesh, Triangle, Vertex, orient, tangent};
use crate::visibility::places::{self, Divided};

/// Triangles of one material, in world space.
pub(super) struct Part {
    pub vertices: Vec<GivenVertex>,
    pub triangles: Vec<[u32; 3]>,
    /// Index into the materials given to [`Builder::finish`].
    pub material: usize,
    pub tangents: Tangents,
    pub(crate) double_sided: bool,
    /// What the material's alpha cuts away.
    pub cutout: Option<Cutout>,
    /// Whether colours of vertices can be shown: by a texture, in place of the material's.
    pub(crate) takes_colors: bool,
}

/// A part that waits for the size of the mesh and for its textures.
struct Uncut {
    vertices: Vec<Vertex>,
    triangles: Vec<[u32; 3]>,
    material: usize,
    double_sided: bool,
    cutout: Cutout,
}

/// A vertex as far as a file describes it.
#[derive(Clone, Copy, Debug)]
pub(super) struct GivenVertex {
    pub position: Vec3,
    pub normal: Option<Vec3>,
    /// Tangent, and the sign of the bitangent.
    pub tangent: Option<(Vec3, f32)>,
    /// Zero where there are none.
    pub uv: Vec2,
    /// Of the material's second set; zero where there is none.
    pub second_uv: Vec2,
    /// Linear; multiplies the material's.
    pub color: Option<[f32; 3]>,
}

/// Added to the material of a part whose vertices have colours.
const PAINTED: usize = 1 << (usize::BITS - 1);
/// Triangles that a part may leave if less is wanted of it.
const LEAST_CUT: usize = 1024;

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
    pub options: &'a Options,
    max_vertices: usize,
    uncut: Vec<Uncut>,
    /// How many were pushed.
    parts: usize,
    palette: Palette,
    vertices: Vec<Vertex>,
    triangles: Vec<([u32; 3], usize)>,
    warnings: Vec<String>,
    degenerate: usize,
    invented_normals: usize,
    invented_uvs: usize,
    second_sheets: usize,
    repeated: usize,
    back_to_back: usize,
}

impl<'a> Builder<'a> {
    pub(super) fn new(file: &'a Path, options: &'a Options, max_vertices: usize) -> Self {
        Self {
            file,
            options,
            max_vertices,
            uncut: Vec::new(),
            parts: 0,
            palette: Palette::default(),
            vertices: Vec::new(),
            triangles: Vec::new(),
            warnings: Vec::new(),
            degenerate: 0,
            invented_normals: 0,
            invented_uvs: 0,
            second_sheets: 0,
            repeated: 0,
            back_to_back: 0,
        }
    }

    /// Adds a warning unless the same was given before.
    pub(super) fn warn(&mut self, warning: String) {
        if !self.warnings.contains(&warning) {
            self.warnings.push(warning);
        }
    }

    /// Cleans, completes and appends a part. Its indices must be in range and its numbers
    /// finite, but for texture coordinates.
    pub(super) fn push(&mut self, mut part: Part) -> Result<(), Error> {
        self.parts += 1;
        let positions = part.vertices.iter().map(|vertex| vertex.position);
        if let Some(position) = mesh::distant_position(positions) {
            return Err(Error::invalid(
                self.file,
                "mesh, in world space",
                format_args!("coordinates within {MAX_COORDINATE} m of the origin"),
                format_args!("{:?}", position.to_array()),
            ));
        }
        let finite = |x: f32| if x.is_finite() { x } else { 0.0 };
        for vertex in &mut part.vertices {
            self.invented_uvs += usize::from(!(vertex.uv + vertex.second_uv).is_finite());
            vertex.uv = vertex.uv.map(finite);
            vertex.second_uv = vertex.second_uv.map(finite);
        }
        let before = part.triangles.len();
        let corners = |vertices: &[GivenVertex], triangle: [u32; 3]| {
            triangle.map(|index| vertices[index as usize].position)
        };
        part.triangles
            .retain(|triangle| face_normal(corners(&part.vertices, *triangle)).is_some());
        self.degenerate += before - part.triangles.len();
        self.merge_coincident(&mut part);
        drop_unused(&mut part.vertices, &mut part.triangles);
        let normals = self.normals(&part);
        let complete = |(given, normal): (&GivenVertex, Vec3)| {
            let (tangent, bitangent_sign) = (given.tangent)
                .and_then(|(tangent, sign)| {
                    let sign = if sign < 0.0 { -1.0 } else { 1.0 };
                    Some((tangent::orthogonal(normal, tangent)?, sign))
                })
                .unwrap_or_else(|| (tangent::around_axis(normal), 1.0));
            Vertex {
                position: given.position,
                normal,
                tangent,
                bitangent_sign,
                uv: given.uv,
                second_uv: given.second_uv,
            }
        };
        let mut vertices: Vec<Vertex> = (part.vertices.iter().zip(normals)).map(complete).collect();
        let mut triangles = part.triangles;
        match part.tangents {
            Tangents::Given | Tangents::AroundAxis => {}
            Tangents::MikkTSpace => tangent::set_mikktspace(&mut vertices, &mut triangles),
            Tangents::FromUv => tangent::set_from_uv(&mut vertices, &triangles),
        }
        let painted = self.paint(
            &part.vertices,
            part.takes_colors,
            &mut vertices,
            &mut triangles,
        );
        if painted {
            part.material |= PAINTED;
        }
        if let Some(cutout) = part.cutout {
            self.uncut.push(Uncut {
                vertices,
                triangles,
                material: part.material,
                double_sided: part.double_sided,
                cutout,
            });
            return Ok(());
        }
        self.append_sides(vertices, triangles, part.material, part.double_sided)
    }

    /// Gives vertices with colours places in the texture of them, if there are any but white.
    fn paint(
        &mut self,
        given: &[GivenVertex],
        takes_colors: bool,
        vertices: &mut Vec<Vertex>,
        triangles: &mut [[u32; 3]],
    ) -> bool {
        let color = |vertex: &GivenVertex| colors::texel(vertex.color.unwrap_or([1.0; 3]));
        let colors: Vec<[u8; 3]> = given.iter().map(color).collect();
        if colors.iter().all(|color| *color == [u8::MAX; 3]) {
            return false;
        }
        let painted = takes_colors
            && vertices.len() == given.len()
            && self.palette.paint(vertices, triangles, &colors).is_some();
        if !painted {
            self.warn(
                "vertex colours of materials with textures or anisotropy, and more than 4 million \
                 of them, are left out"
                    .into(),
            );
        }
        painted
    }

    /// Appends the front, and the back of what has two sides.
    fn append_sides(
        &mut self,
        mut vertices: Vec<Vertex>,
        mut triangles: Vec<[u32; 3]>,
        material: usize,
        double_sided: bool,
    ) -> Result<(), Error> {
        self.append(&vertices, &triangles, material)?;
        if double_sided {
            self.second_sheets += triangles.len();
            reverse(&mut vertices, &mut triangles);
            self.append(&vertices, &triangles, material)?;
        }
        Ok(())
    }

    /// Cuts away what materials mask, and appends what is left.
    fn cut(&mut self, materials: &[Material], textures: &[Texture]) -> Result<(), Error> {
        let uncut = std::mem::take(&mut self.uncut);
        if uncut.is_empty() {
            return Ok(());
        }
        let masked = uncut.iter().flat_map(|part| &part.vertices);
        let whole = Mesh {
            vertices: masked.chain(&self.vertices).copied().collect(),
            ..Mesh::default()
        };
        let diagonal = whole.diagonal();
        let masked: usize = uncut.iter().map(|part| part.triangles.len()).sum();
        // By material: triangles before and after, divided and without area in the texture, and
        // the largest tolerance, texels, and what of it is for fewer triangles and can be helped.
        let mut counted: BTreeMap<usize, ([usize; 4], f64, &str)> = BTreeMap::new();
        for mut part in uncut {
            let name = &materials[part.material].name;
            let texture = &textures[part.cutout.slot.texture as usize];
            let left = (self.max_vertices).saturating_sub(self.triangles.len());
            // What is wanted of all, by how many triangles each part has of them.
            let wanted = (self.options.cut_triangles).map_or(left, |all| {
                let part = part.triangles.len() as f64 / masked as f64;
                ((all as f64 * part) as usize).max(LEAST_CUT)
            });
            let sides = if part.double_sided { 2 } else { 1 };
            let bound = Bound {
                wanted: wanted / sides,
                most: left / sides,
            };
            let (vertices, before) = (&mut part.vertices, &part.triangles);
            let cut = cutout::cut(vertices, before, &part.cutout, texture, diagonal, bound);
            let cut = cut.map_err(|error| {
                let (expected, found) = match error {
                    TooMuch::Coordinates => (
                        "finite texture coordinates".to_owned(),
                        "larger ones".to_owned(),
                    ),
                    TooMuch::Contours => (
                        "an outline that can be cut".into(),
                        "one that is too long, or that repeats too often".into(),
                    ),
                    TooMuch::Triangles(most) => (
                        format!("at most {most} triangles more (--limit-vertices)"),
                        "more where its alpha cuts them".into(),
                    ),
                };
                let place = format!(
                    "material {name:?}, which a scene file's [cutout] makes opaque: {name:?} = 0"
                );
                Error::invalid(self.file, place, expected, found)
            })?;
            let ([before, after, divided, flat], tolerance, finer) =
                counted.entry(part.material).or_default();
            *before += part.triangles.len();
            *after += cut.triangles.len();
            *divided += cut.divided;
            *flat += cut.flat;
            *tolerance = tolerance.max(cut.tolerance);
            if cut.coarser {
                *finer = if wanted < left {
                    ", for fewer triangles; --preset high keeps them as fine as it can"
                } else {
                    ", for fewer triangles; a larger --limit-vertices keeps them finer"
                };
            }
            part.triangles = cut.triangles;
            drop_unused(&mut part.vertices, &mut part.triangles);
            self.append_sides(
                part.vertices,
                part.triangles,
                part.material,
                part.double_sided,
            )?;
        }
        for (material, ([before, after, divided, flat], tolerance, finer)) in counted {
            let name = &materials[material].name;
            self.warn(format!(
                "material {name:?}: its alpha cuts {divided} of {before} triangles, which leaves \
                 {after}; outlines are off by up to {tolerance:.2} texels{finer}"
            ));
            if flat > 0 {
                self.warn(format!(
                    "material {name:?}: {flat} triangles have no area in the texture and are kept \
                     or cut away as a whole"
                ));
            }
        }
        Ok(())
    }

    /// Drops triangles that lie where one of an earlier part does and face the same way: which of
    /// them is seen would be chance. Gives their number.
    fn drop_hidden(&mut self) -> usize {
        let mut seen = HashSet::with_capacity(self.triangles.len());
        let before = self.triangles.len();
        let vertices = &self.vertices;
        self.triangles.retain(|(triangle, _)| {
            let corners = triangle.map(|vertex| vertices[vertex as usize].position);
            seen.insert(winding(corners))
        });
        let hidden = before - self.triangles.len();
        if hidden > 0 {
            let mut triangles: Vec<_> = self.triangles.iter().map(|(t, _)| *t).collect();
            drop_unused(&mut self.vertices, &mut triangles);
            for ((triangle, _), moved) in self.triangles.iter_mut().zip(triangles) {
                *triangle = moved;
            }
        }
        hidden
    }

    /// Drops triangles that repeat another. Where two lie back to back on the same vertices,
    /// gives each its own: the mean of their normals is neither's.
    fn merge_coincident(&mut self, part: &mut Part) {
        let positions: Vec<Vec3> = part.vertices.iter().map(|vertex| vertex.position).collect();
        let key = |triangle: &[u32; 3]| winding(triangle.map(|vertex| positions[vertex as usize]));
        let mut seen = HashSet::with_capacity(part.triangles.len());
        let before = part.triangles.len();
        part.triangles.retain(|triangle| seen.insert(key(triangle)));
        self.repeated += before - part.triangles.len();
        let back = |triangle: &[u32; 3]| {
            let [a, b, c] = key(triangle);
            seen.contains(&[a, c, b])
        };
        let doubled: Vec<bool> = part.triangles.iter().map(back).collect();
        let count = doubled.iter().filter(|doubled| **doubled).count();
        if count == 0 {
            return;
        }
        self.back_to_back += count / 2;
        let sides = places::sides(&positions, &part.triangles);
        let divided = Divided::new(&part.triangles, part.vertices.len(), &sides);
        part.triangles = divided.triangles;
        for vertex in divided.copied {
            part.vertices.push(part.vertices[vertex as usize]);
        }
        // Normals of one side are wrong on the other.
        let mut votes = vec![0i32; part.vertices.len()];
        for (triangle, doubled) in part.triangles.iter().zip(doubled) {
            let corners = triangle.map(|vertex| part.vertices[vertex as usize].position);
            let face = face_normal(corners).unwrap_or_default();
            for vertex in triangle {
                let normal = part.vertices[*vertex as usize].normal.unwrap_or_default();
                let away = face.dot(normal.as_dvec3()) < 0.0;
                votes[*vertex as usize] += if doubled && away { 1 } else { -1 };
            }
        }
        for (vertex, votes) in part.vertices.iter_mut().zip(votes) {
            if votes > 0 {
                vertex.normal = vertex.normal.map(|normal| -normal);
            }
        }
    }

    /// Unit normals: the part's own, else those of faces.
    fn normals(&mut self, part: &Part) -> Vec<Vec3> {
        let mut sums: Option<Vec<DVec3>> = None;
        let mut normals = Vec::with_capacity(part.vertices.len());
        for (index, given) in part.vertices.iter().enumerate() {
            let given = given.normal.and_then(Vec3::try_normalize);
            normals.push(given.unwrap_or_else(|| {
                self.invented_normals += 1;
                let sums = sums.get_or_insert_with(|| smooth_normals(part));
                // Faces that cancel leave any direction as good as another.
                sums[index].as_vec3().try_normalize().unwrap_or(Vec3::Y)
            }));
        }
        normals
    }

    fn append(
        &mut self,
        new_vertices: &[Vertex],
        new_triangles: &[[u32; 3]],
        material: usize,
    ) -> Result<(), Error> {
        let base = self.vertices.len();
        let vertices = base + new_vertices.len();
        let triangles = self.triangles.len() + new_triangles.len();
        let most = self.max_vertices;
        if vertices.max(triangles) > most {
            return Err(Error::invalid(
                self.file,
                "mesh",
                format_args!("at most {most} vertices and triangles (--limit-vertices)"),
                format_args!("{vertices} vertices and {triangles} triangles or more"),
            ));
        }
        self.vertices.extend_from_slice(new_vertices);
        self.triangles.extend(
            new_triangles
                .iter()
                .map(|triangle| (triangle.map(|index| index + base as u32), material)),
        );
        Ok(())
    }

    /// The mesh, with the materials and textures that it uses.
    pub(super) fn finish(
        mut self,
        materials: &[Material],
        textures: &[Texture],
    ) -> Result<Mesh, Error> {
        for name in self.options.cutoffs.keys() {
            if materials.iter().all(|material| material.name != *name) {
                let names: Vec<_> = materials.iter().map(|m| format!("{:?}", m.name)).collect();
                return Err(Error::invalid(
                    self.file,
                    format_args!("cutout.{name} of the scene file"),
                    format_args!("a material of the mesh: {}", names.join(", ")),
                    format_args!("{name:?}"),
                ));
            }
        }
        let masked = !self.uncut.is_empty();
        self.cut(materials, textures)?;
        if self.triangles.is_empty() {
            let found = match self.degenerate {
                _ if masked => "all cut away by the alpha of their materials".to_owned(),
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
        let hidden = if self.parts > 1 {
            self.drop_hidden()
        } else {
            0
        };
        let mut mesh = Mesh {
            vertices: std::mem::take(&mut self.vertices),
            ..Mesh::default()
        };
        // Places in the texture of colours are texels so far.
        let palette = self.palette.texture();
        let sides = Vec2::new(palette.width as f32, palette.height as f32);
        let mut divided = vec![false; mesh.vertices.len()];
        let mut used = HashMap::new();
        for (vertices, number) in std::mem::take(&mut self.triangles) {
            let painted = number & PAINTED != 0;
            for vertex in vertices.into_iter().filter(|_| painted) {
                if !std::mem::replace(&mut divided[vertex as usize], true) {
                    mesh.vertices[vertex as usize].uv /= sides;
                }
            }
            let material = *used.entry(number).or_insert_with(|| {
                let mut material = materials[number & !PAINTED].clone();
                if painted {
                    material.base_color_texture = Some(TextureSlot::whole(textures.len() as u32));
                }
                mesh.materials.push(material);
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
            mesh.triangles.push(Triangle { vertices, material });
        }
        mesh.textures = textures.to_vec();
        if !self.palette.is_empty() {
            mesh.textures.push(palette);
        }
        mesh.drop_unused_textures();
        self.warnings.extend(orient::mend(&mut mesh));
        let turned_away = (mesh.triangles.iter())
            .filter(|triangle| orient::winds_against_normals(&mesh, triangle))
            .count();
        self.warn_of_counts(hidden, turned_away);
        mesh.warnings = self.warnings;
        Ok(mesh)
    }

    /// Warns of what was dropped, divided or is odd.
    fn warn_of_counts(&mut self, hidden: usize, turned_away: usize) {
        let counted = [
            (self.degenerate, "triangles of zero area are dropped"),
            (self.repeated, "triangles repeat another and are dropped"),
            (
                hidden,
                "triangles lie exactly on one that came before, of another material or primitive, \
                 and are dropped",
            ),
            (
                self.back_to_back,
                "pairs of triangles lie back to back: each becomes the two sides of one sheet",
            ),
            (
                self.invented_normals,
                "vertices have a normal that is zero or no number, which their faces replace",
            ),
            (
                self.invented_uvs,
                "vertices have texture coordinates that are no numbers: those are 0",
            ),
            (
                turned_away,
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
    }
}

/// Positions of corners bit by bit, turned so that the least comes first: the same for triangles
/// that lie on each other and face the same way.
fn winding(corners: [Vec3; 3]) -> [[u32; 3]; 3] {
    // Adding zero turns −0 into +0.
    let mut corners = corners.map(|corner| (corner + Vec3::ZERO).to_array().map(f32::to_bits));
    let first = (0..3).min_by_key(|&k| corners[k]).unwrap_or(0);
    corners.rotate_left(first);
    corners
}

/// Unit normal of the side from which the corners run counter-clockwise, or `None` for a
/// triangle without area. The cross product of f32 differences is exact enough in f64 to
/// tell a needle from a line.
pub(super) fn face_normal(corners: [Vec3; 3]) -> Option<DVec3> {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    (b - a).cross(c - a).try_normalize()
}

/// Per vertex the sum of face normals, each weighted by its angle there (Thürmer & Wüthrich
/// 1998).
fn smooth_normals(part: &Part) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; part.vertices.len()];
    for triangle in &part.triangles {
        let corners = triangle.map(|index| part.vertices[index as usize].position.as_dvec3());
        for (index, weight) in triangle.iter().zip(angle_weighted_normals(corners)) {
            sums[*index as usize] += weight;
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
        normal * math::acos(left.dot(right).clamp(-1.0, 1.0))
    })
}

/// Turns a sheet to its back. Negating the whole frame negates a normal map's normal as well:
/// what is a bump on one side of a thin sheet is a dent on the other.
fn reverse(vertices: &mut [Vertex], triangles: &mut [[u32; 3]]) {
    for vertex in vertices {
        vertex.normal = -vertex.normal;
        vertex.tangent = -vertex.tangent;
        vertex.bitangent_sign = -vertex.bitangent_sign;
    }
    for triangle in triangles {
        triangle.swap(1, 2);
    }
}

fn drop_unused<T>(vertices: &mut Vec<T>, triangles: &mut [[u32; 3]]) {
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
