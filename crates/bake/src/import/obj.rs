//! Wavefront OBJ.
//!
//! Our own parser; ARCHITECTURE.md says why it is not `tobj`.

use relight_format::math;
use std::collections::HashMap;
use std::path::Path;

use glam::{DVec2, DVec3, Vec2, Vec3};
use relight_format::Material;

use crate::visibility::places;

mod materials;

use materials::load_materials;

use super::build::{Builder, GivenVertex, Part, Tangents, angle_weighted_normals};
use crate::files::Files;

use super::colors;
use super::cutout::Cutout;
use super::{DEFAULT_CREASE_DEGREES, Error, Options};
use crate::mesh::Mesh;

/// Most corners of a face that is not convex, which bounds the time to triangulate it.
const MAX_CONCAVE_CORNERS: usize = 1024;

/// Name of the material of faces before any `usemtl`.
const DEFAULT_MATERIAL: &str = "default";

/// Imports the bytes of an OBJ file and what it refers to.
pub(super) fn import(
    files: &Files,
    file: &Path,
    options: &Options,
    bytes: &[u8],
) -> Result<Mesh, Error> {
    let text = String::from_utf8_lossy(bytes);
    let mut builder = Builder::new(file, options, files.max_vertices());
    let obj = parse(file, &text)?;
    let (triangles, skipped) = obj.triangulate(file, &mut builder)?;
    let counted = [
        (obj.curves, "points, lines and curves are left out"),
        (skipped, "faces of fewer than three corners are left out"),
        (
            obj.lost_normals,
            "normals are zero or no numbers: faces replace them",
        ),
    ];
    for (count, what) in counted {
        if count > 0 {
            builder.warn(format!("{count} {what}"));
        }
    }
    let (materials, textures) = load_materials(files, file, &obj, &mut builder)?;
    let crease = options.crease_degrees.unwrap_or(DEFAULT_CREASE_DEGREES);
    let normals = corner_normals(&obj, &triangles, crease);
    for (index, material) in materials.iter().enumerate() {
        push_part(&mut builder, &obj, &triangles, &normals, index, material)?;
    }
    let materials: Vec<_> = materials
        .into_iter()
        .map(|(material, _)| material)
        .collect();
    builder.finish(&materials, &textures)
}

/// A corner of a face: indices into the arrays of [`Obj`].
#[derive(Clone, Copy, Debug)]
struct Corner {
    position: u32,
    uv: Option<u32>,
    normal: Option<u32>,
}

#[derive(Debug)]
struct Face {
    /// First and one past the last corner.
    corners: [usize; 2],
    /// Index into [`Obj::materials`].
    material: usize,
    /// Smoothing group, 0 of which is flat; none in a file without groups.
    smoothing: Option<u32>,
    line: usize,
}

#[derive(Debug, Default)]
struct Obj {
    positions: Vec<Vec3>,
    /// sRGB-encoded, of positions; none where the file has none, shorter where the last have none.
    colors: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<Vec3>,
    corners: Vec<Corner>,
    faces: Vec<Face>,
    /// Names in order of first use.
    materials: Vec<String>,
    /// Rest of each `mtllib` line.
    libraries: Vec<String>,
    curves: usize,
    /// Normals that are zero or no numbers: as if the file had none there.
    lost_normals: usize,
}

/// A material, and what its opacity cuts away.
type Described = (Material, Option<Cutout>);

/// A triangle of corners, with the face it came from.
struct Triangle {
    corners: [u32; 3],
    face: u32,
}

fn parse(file: &Path, text: &str) -> Result<Obj, Error> {
    let mut obj = Obj::default();
    let mut material_indices = HashMap::new();
    let mut material = None;
    let mut smoothing = None;
    let mut lines = text.lines().enumerate();
    while let Some((number, first)) = lines.next() {
        let mut line = std::borrow::Cow::Borrowed(first.trim());
        while line.ends_with('\\') {
            let joined = line.trim_end_matches('\\');
            let next = lines.next().map_or("", |(_, next)| next.trim());
            line = format!("{joined} {next}").into();
        }
        let number = number + 1;
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((&line, ""));
        let rest = rest.trim();
        let wrong = |expected: &str| {
            Error::invalid(
                file,
                format_args!("line {number}"),
                expected,
                format_args!("{line:?}"),
            )
        };
        match key {
            // A fourth number alone is a weight of rational curves, three more are a colour.
            "v" => {
                let position = numbers(rest).ok_or_else(|| wrong("v and three finite numbers"))?;
                obj.positions.push(position.into());
                if let Some([_, _, _, r, g, b]) = numbers::<6>(rest) {
                    obj.colors.resize(obj.positions.len() - 1, [1.0; 3]);
                    obj.colors.push([r, g, b]);
                }
            }
            "vt" => {
                // v may be left out, and is 0 then.
                let padded = format!("{rest} 0");
                let [u, v] = any_numbers(&padded).ok_or_else(|| wrong("vt and numbers"))?;
                obj.uvs.push([u, 1.0 - v]);
            }
            "vn" => {
                let normal = any_numbers(rest).ok_or_else(|| wrong("vn and three numbers"))?;
                let normal = Vec3::from(normal);
                obj.lost_normals += usize::from(normal.try_normalize().is_none());
                obj.normals.push(normal);
            }
            "f" | "fo" => {
                let start = obj.corners.len();
                for word in rest.split_whitespace() {
                    let counts = [obj.positions.len(), obj.uvs.len(), obj.normals.len()];
                    let corner = corner(word, counts).ok_or_else(|| {
                        wrong("f and corners v, v/vt, v//vn or v/vt/vn of existing indices")
                    })?;
                    obj.corners.push(corner);
                }
                let material = *material.get_or_insert_with(|| {
                    material_index(&mut obj.materials, &mut material_indices, DEFAULT_MATERIAL)
                });
                obj.faces.push(Face {
                    corners: [start, obj.corners.len()],
                    material,
                    smoothing,
                    line: number,
                });
            }
            "usemtl" => {
                material = Some(material_index(
                    &mut obj.materials,
                    &mut material_indices,
                    rest,
                ));
            }
            "mtllib" => obj.libraries.push(rest.to_owned()),
            "s" => {
                // Faces before the first statement are in no group once there is one.
                if smoothing.is_none() {
                    for face in &mut obj.faces {
                        face.smoothing = Some(0);
                    }
                }
                smoothing = Some(rest.parse().unwrap_or(0));
            }
            "p" | "l" | "curv" | "curv2" | "surf" => obj.curves += 1,
            _ => {}
        }
    }
    Ok(obj)
}

/// The first N words as finite numbers.
fn numbers<const N: usize>(text: &str) -> Option<[f32; N]> {
    any_numbers(text).filter(|values: &[f32; N]| values.iter().all(|value| value.is_finite()))
}

/// The first N words as numbers, or as what programs write for what is none: `nan`, `-nan(ind)`, `1.#QNAN`, `inf`.
fn any_numbers<const N: usize>(text: &str) -> Option<[f32; N]> {
    let mut words = text.split_whitespace();
    let mut values = [0.0; N];
    for value in &mut values {
        let word = words.next()?;
        let is_none = || word.contains(".#") || word.to_ascii_lowercase().contains("nan(");
        *value = (word.parse().ok()).or_else(|| is_none().then_some(f32::NAN))?;
    }
    Some(values)
}

fn material_index(
    names: &mut Vec<String>,
    indices: &mut HashMap<String, usize>,
    name: &str,
) -> usize {
    *indices.entry(name.to_owned()).or_insert_with(|| {
        names.push(name.to_owned());
        names.len() - 1
    })
}

/// Parses `v`, `v/vt`, `v//vn` or `v/vt/vn`. Positive indices may refer forward, so they are
/// checked against the whole file later.
fn corner(word: &str, counts: [usize; 3]) -> Option<Corner> {
    let mut fields = word.split('/');
    let mut indices = [None; 3];
    for (index, count) in indices.iter_mut().zip(counts) {
        *index = match fields.next() {
            None | Some("") => None,
            Some(field) => match field.parse::<i64>().ok()? {
                0 => return None,
                // A relative index into nothing must stay out of range.
                value @ ..0 => {
                    let back = usize::try_from(value.unsigned_abs()).ok()?;
                    Some(if count == 0 {
                        u32::MAX
                    } else {
                        count.checked_sub(back)? as u32
                    })
                }
                value => Some(u32::try_from(value - 1).ok()?),
            },
        };
    }
    let [position, uv, normal] = indices;
    (fields.next().is_none()).then_some(Corner {
        position: position?,
        uv,
        normal,
    })
}

impl Obj {
    /// Checks indices and cuts faces into triangles; also counts faces that have no area to
    /// cut.
    fn triangulate(
        &self,
        file: &Path,
        builder: &mut Builder,
    ) -> Result<(Vec<Triangle>, usize), Error> {
        let mut triangles = Vec::new();
        let mut skipped = 0;
        let mut points = Vec::new();
        for (
            face,
            &Face {
                corners: [start, end],
                line,
                ..
            },
        ) in self.faces.iter().enumerate()
        {
            let corners = &self.corners[start..end];
            for corner in corners {
                let checks = [
                    ("vertices", Some(corner.position), self.positions.len()),
                    ("texture coordinates", corner.uv, self.uvs.len()),
                    ("normals", corner.normal, self.normals.len()),
                ];
                for (what, index, count) in checks {
                    let Some(index) = index.filter(|&index| index as usize >= count) else {
                        continue;
                    };
                    if count == 0 && what != "vertices" {
                        builder.warn(format!("faces refer to {what}, but the file has none"));
                        continue;
                    }
                    return Err(Error::invalid(
                        file,
                        format_args!("line {line}"),
                        format_args!("an index into the file's {count} {what}"),
                        match index {
                            u32::MAX => "a relative one".to_owned(),
                            _ => (u64::from(index) + 1).to_string(),
                        },
                    ));
                }
            }
            if corners.len() < 3 {
                skipped += 1;
                continue;
            }
            points.clear();
            points.extend(
                corners
                    .iter()
                    .map(|c| self.positions[c.position as usize].as_dvec3()),
            );
            let cut = triangulate(&points).ok_or_else(|| {
                Error::invalid(
                    file,
                    format_args!("line {line}"),
                    format_args!("at most {MAX_CONCAVE_CORNERS} corners of a concave face"),
                    points.len(),
                )
            })?;
            triangles.extend(cut.into_iter().map(|local| Triangle {
                corners: local.map(|index| (start + index) as u32),
                face: face as u32,
            }));
        }
        Ok((triangles, skipped))
    }
}

/// Cuts a polygon into triangles of local indices: a fan if it is convex, else by ear
/// clipping in the plane that it projects to with the largest area. `None` if it is concave
/// and too large.
fn triangulate(points: &[DVec3]) -> Option<Vec<[usize; 3]>> {
    let count = points.len();
    let fan = |corners: &[usize]| -> Vec<[usize; 3]> {
        corners[1..]
            .windows(2)
            .map(|pair| [corners[0], pair[0], pair[1]])
            .collect()
    };
    let mut left: Vec<usize> = (0..count).collect();
    if count == 3 {
        return Some(fan(&left));
    }
    // Newell's normal: twice the vector area.
    let area: DVec3 = (0..count)
        .map(|i| (points[i] - points[0]).cross(points[(i + 1) % count] - points[0]))
        .sum();
    let axis = (0..3)
        .max_by(|&i, &j| area[i].abs().total_cmp(&area[j].abs()))
        .unwrap_or(0);
    let (s, t) = ((axis + 1) % 3, (axis + 2) % 3);
    let flat: Vec<DVec2> = points
        .iter()
        .map(|p| {
            DVec2::new(
                p[s] - points[0][s],
                (p[t] - points[0][t]) * area[axis].signum(),
            )
        })
        .collect();
    let turn = |a: usize, b: usize, c: usize| (flat[b] - flat[a]).perp_dot(flat[c] - flat[b]);
    let convex = |left: &[usize], i: usize| {
        let n = left.len();
        turn(left[(i + n - 1) % n], left[i], left[(i + 1) % n]) > 0.0
    };
    if (0..count).all(|i| convex(&left, i)) {
        return Some(fan(&left));
    }
    if count > MAX_CONCAVE_CORNERS {
        return None;
    }
    let mut triangles = Vec::with_capacity(count - 2);
    while left.len() > 3 {
        let n = left.len();
        let ear = (0..n).find(|&i| {
            let [a, b, c] = [left[(i + n - 1) % n], left[i], left[(i + 1) % n]];
            turn(a, b, c) > 0.0
                && left.iter().all(|&p| {
                    let corner = [a, b, c].iter().any(|&q| flat[p] == flat[q]);
                    let inside =
                        turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0;
                    corner || !inside
                })
        });
        // A polygon that crosses itself may have no ear; it has no right answer either.
        let Some(ear) = ear else { break };
        triangles.push([left[(ear + n - 1) % n], left[ear], left[(ear + 1) % n]]);
        left.remove(ear);
    }
    triangles.extend(fan(&left));
    Some(triangles)
}

/// The normal of each corner of each triangle: the file's, else the angle-weighted mean over
/// the triangles around the position on its side of the surface, those of its smoothing group
/// or, where the file has no groups, those that bend by less than the crease angle; none where
/// faces cancel.
fn corner_normals(
    obj: &Obj,
    triangles: &[Triangle],
    crease_degrees: f32,
) -> Vec<[Option<Vec3>; 3]> {
    let given = |corner: u32| {
        let index = obj.corners[corner as usize].normal?;
        obj.normals.get(index as usize)?.try_normalize()
    };
    let incomplete = triangles
        .iter()
        .any(|t| t.corners.iter().any(|&c| given(c).is_none()));
    if !incomplete {
        let given = triangles.iter().map(|t| t.corners.map(given));
        return given.collect();
    }
    let indices: Vec<[u32; 3]> = (triangles.iter())
        .map(|t| {
            t.corners
                .map(|corner| obj.corners[corner as usize].position)
        })
        .collect();
    let sides = places::sides(&obj.positions, &indices);
    // Around every corner: smoothing group, unit normal of the face and that times its angle.
    let mut around: HashMap<u32, Vec<(Option<u32>, DVec3, DVec3)>> = HashMap::new();
    let group = |t: &Triangle| obj.faces[t.face as usize].smoothing;
    let normal = |triangle: [u32; 3]| {
        let [a, b, c] = triangle.map(|position| obj.positions[position as usize].as_dvec3());
        (b - a).cross(c - a).normalize_or_zero()
    };
    for ((t, positions), sides) in triangles.iter().zip(&indices).zip(&sides) {
        let points = positions.map(|position| obj.positions[position as usize].as_dvec3());
        let weighted = angle_weighted_normals(points);
        for (side, weighted) in sides.iter().zip(weighted) {
            let of_face = (group(t), normal(*positions), weighted);
            around.entry(*side).or_default().push(of_face);
        }
    }
    let crease = math::cos(f64::from(crease_degrees).to_radians());
    let smooth = |t: &Triangle, positions: [u32; 3], side: u32| {
        let (own_group, own) = (group(t), normal(positions));
        let others = around.get(&side)?.iter();
        let sum: DVec3 = others
            .filter(|(group, normal, _)| match own_group {
                Some(0) => false,
                None => group.is_none() && normal.dot(own) >= crease,
                some => *group == some,
            })
            .map(|(_, _, weighted)| *weighted)
            .sum();
        let flat = own_group == Some(0);
        Some(if flat { own } else { sum }.try_normalize()?.as_vec3())
    };
    (triangles.iter().zip(&indices).zip(&sides))
        .map(|((t, positions), sides)| {
            [0, 1, 2].map(|k| given(t.corners[k]).or_else(|| smooth(t, *positions, sides[k])))
        })
        .collect()
}

/// Appends the triangles of one material. Corners that agree in everything become one vertex.
fn push_part(
    builder: &mut Builder,
    obj: &Obj,
    triangles: &[Triangle],
    normals: &[[Option<Vec3>; 3]],
    material: usize,
    (description, cutout): &Described,
) -> Result<(), Error> {
    let mut vertices = Vec::new();
    // Some programs write bytes.
    let bytes = obj.colors.as_flattened().iter().any(|x| *x > 1.0);
    let largest = if bytes { 255.0 } else { 1.0 };
    let mut indices = HashMap::new();
    let mut has_uv = true;
    let mut part_triangles = Vec::new();
    for (triangle, normals) in triangles.iter().zip(normals) {
        if obj.faces[triangle.face as usize].material != material {
            continue;
        }
        let mut vertex = |corner: u32, normal: Option<Vec3>| {
            let Corner { position, uv, .. } = obj.corners[corner as usize];
            let uv = uv.filter(|&uv| (uv as usize) < obj.uvs.len());
            has_uv &= uv.is_some();
            let key = (position, uv, normal.map(|n| n.to_array().map(f32::to_bits)));
            *indices.entry(key).or_insert_with(|| {
                vertices.push(GivenVertex {
                    position: obj.positions[position as usize],
                    normal,
                    tangent: None,
                    uv: uv.map_or(Vec2::ZERO, |uv| obj.uvs[uv as usize].into()),
                    second_uv: Vec2::ZERO,
                    color: obj.colors.get(position as usize).map(|encoded| {
                        encoded.map(|x| colors::linear(x.clamp(0.0, largest) / largest))
                    }),
                });
                vertices.len() as u32 - 1
            })
        };
        let [a, b, c] = triangle.corners;
        part_triangles.push([
            vertex(a, normals[0]),
            vertex(b, normals[1]),
            vertex(c, normals[2]),
        ]);
    }
    let tangents = match (has_uv, description.normal_texture) {
        (true, Some(_)) => Tangents::MikkTSpace,
        (true, None) => Tangents::FromUv,
        (false, _) => Tangents::AroundAxis,
    };
    let part = Part {
        vertices,
        triangles: part_triangles,
        material,
        tangents,
        double_sided: false,
        cutout: cutout.clone(),
        takes_colors: description.base_color_texture.is_none()
            && description.normal_texture.is_none()
            && cutout.is_none(),
    };
    builder.push(part)
}
