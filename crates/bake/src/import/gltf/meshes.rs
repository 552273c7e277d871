//! Nodes and primitives -> parts of a mesh in world space.

use glam::{DMat3, DMat4, DQuat, DVec3, Vec2, Vec3};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index, scene};
use serde::Deserialize;

use super::super::Error;
use super::super::build::{Builder, GivenVertex, Part, Tangents, face_normal};
use super::Document;
use super::materials::{Converted, Materials};

pub(super) const INSTANCING: &str = "EXT_mesh_gpu_instancing";

/// Accessors of `EXT_mesh_gpu_instancing`.
#[derive(Default, Deserialize)]
#[serde(default, rename_all = "UPPERCASE")]
struct InstanceAttributes {
    translation: Option<Index<Accessor>>,
    rotation: Option<Index<Accessor>>,
    scale: Option<Index<Accessor>>,
}

/// `EXT_mesh_gpu_instancing`.
#[derive(Deserialize)]
struct Instancing {
    attributes: InstanceAttributes,
}

/// Most nodes of a scene, those that several parents share counted once per parent.
const MAX_NODES: usize = 1 << 20;

impl Document<'_> {
    /// The nodes of the scene in depth-first order, with their transforms to world space. The
    /// specification wants trees; files with shared nodes exist and mean copies.
    pub(super) fn nodes(&self) -> Result<Vec<(usize, DMat4)>, Error> {
        let roots = match self.root.scene {
            Some(index) => self.get(index, "scene")?.nodes.clone(),
            None => match self.root.scenes.first() {
                Some(scene) => scene.nodes.clone(),
                None => self.parentless_nodes(),
            },
        };
        let mut found = Vec::new();
        let mut stack: Vec<_> = roots
            .into_iter()
            .rev()
            .map(|root| (root, DMat4::IDENTITY, 1))
            .collect();
        while let Some((index, parent, depth)) = stack.pop() {
            let place = format!("nodes[{}]", index.value());
            let node = self.get(index, &place)?;
            if depth > self.root.nodes.len() || found.len() == MAX_NODES {
                let expected = format!("no cycle and at most {MAX_NODES} nodes");
                return Err(self.invalid(place, expected, format_args!("depth {depth}")));
            }
            let matrix = parent * local_transform(node);
            if !matrix.is_finite() {
                return Err(self.invalid(place, "a finite transform", format_args!("{matrix}")));
            }
            found.push((index.value(), matrix));
            let children = node.children.iter().flatten().rev();
            stack.extend(children.map(|child| (*child, matrix, depth + 1)));
        }
        Ok(found)
    }

    fn parentless_nodes(&self) -> Vec<Index<scene::Node>> {
        let mut is_child = vec![false; self.root.nodes.len()];
        for child in self
            .root
            .nodes
            .iter()
            .flat_map(|node| node.children.iter().flatten())
        {
            if let Some(is_child) = is_child.get_mut(child.value()) {
                *is_child = true;
            }
        }
        let indices = is_child
            .iter()
            .enumerate()
            .filter(|(_, is_child)| !**is_child);
        indices.map(|(index, _)| Index::new(index as u32)).collect()
    }

    pub(super) fn push_node(
        &self,
        node_index: usize,
        matrix: DMat4,
        materials: &mut Materials,
        builder: &mut Builder,
    ) -> Result<(), Error> {
        let node = &self.root.nodes[node_index];
        let Some(mesh_index) = node.mesh else {
            return Ok(());
        };
        let mesh = self.get(mesh_index, &format!("nodes[{node_index}].mesh"))?;
        if node.skin.is_some() {
            builder.warn(format!(
                "nodes[{node_index}] is skinned; it is baked in its bind pose, placed by the node"
            ));
        }
        let weights = node.weights.as_ref().or(mesh.weights.as_ref());
        if weights.is_some_and(|weights| weights.iter().any(|weight| *weight != 0.0)) {
            builder.warn(format!(
                "nodes[{node_index}] is morphed; its base shape is baked"
            ));
        }
        for matrix in self.instances(node_index, matrix)? {
            for (index, primitive) in mesh.primitives.iter().enumerate() {
                let place = format!("meshes[{}].primitives[{index}]", mesh_index.value());
                if let Some(part) = self.part(primitive, &place, matrix, materials, builder)? {
                    builder.push(part)?;
                }
            }
        }
        Ok(())
    }

    /// Transforms to world space of every copy of a node's mesh.
    fn instances(&self, node_index: usize, matrix: DMat4) -> Result<Vec<DMat4>, Error> {
        let node = &self.root.nodes[node_index];
        let others = node.extensions.as_ref().map(|e| &e.others);
        let Some(value) = others.and_then(|others| others.get(INSTANCING)) else {
            return Ok(vec![matrix]);
        };
        let place = format!("nodes[{node_index}].{INSTANCING}");
        let Instancing { attributes } = Instancing::deserialize(value)
            .map_err(|error| self.invalid(&place, "an object as the extension specifies", error))?;
        let key = |name: &str| format!("{place}.attributes.{name}");
        let vectors = |index: Option<Index<Accessor>>, name: &str| {
            index
                .map(|index| self.floats::<3>(index, &key(name)))
                .transpose()
        };
        let translations = vectors(attributes.translation, "TRANSLATION")?;
        let scales = vectors(attributes.scale, "SCALE")?;
        let rotations = attributes
            .rotation
            .map(|index| self.floats::<4>(index, &key("ROTATION")))
            .transpose()?;
        let counts = [
            translations.as_ref().map(Vec::len),
            rotations.as_ref().map(Vec::len),
            scales.as_ref().map(Vec::len),
        ];
        let mut given = counts.into_iter().flatten();
        let count = given.next().unwrap_or(1);
        if let Some(other) = given.find(|other| *other != count) {
            let expected = format!("{count} elements in every attribute");
            return Err(self.invalid(&place, expected, other));
        }
        // Each is read anew, so that ones that come to nothing take time as well.
        let corners = node.mesh.map_or(0, |mesh| {
            let primitives = self.root.get(mesh).map(|mesh| &mesh.primitives);
            let accessors = primitives.into_iter().flatten().filter_map(|primitive| {
                let positions = &Checked::Valid(Semantic::Positions);
                let read = primitive
                    .indices
                    .or(primitive.attributes.get(positions).copied())?;
                Some(self.root.get(read)?.count.0)
            });
            accessors.fold(0u64, u64::saturating_add)
        });
        let all = corners.saturating_mul(count as u64);
        let most = 3 * self.files.max_vertices() as u64;
        if count > MAX_NODES || all > most {
            let expected = format!("at most {MAX_NODES} copies of {most} corners in all");
            let found = format!("{count} copies of {corners} corners");
            return Err(self.invalid(&place, expected, found));
        }
        (0..count)
            .map(|index| {
                let local = transform(
                    translations.as_ref().map(|all| all[index]),
                    rotations.as_ref().map(|all| all[index]),
                    scales.as_ref().map(|all| all[index]),
                );
                let matrix = matrix * local;
                if matrix.is_finite() {
                    Ok(matrix)
                } else {
                    Err(self.invalid(&place, "finite transforms", format_args!("{matrix}")))
                }
            })
            .collect()
    }

    /// One primitive in world space; `None` if it has no triangles.
    #[allow(
        clippy::too_many_lines,
        reason = "one primitive, attribute by attribute, in the order of the specification"
    )]
    fn part(
        &self,
        primitive: &Primitive,
        place: &str,
        matrix: DMat4,
        materials: &mut Materials,
        builder: &mut Builder,
    ) -> Result<Option<Part>, Error> {
        let Checked::Valid(mode) = primitive.mode else {
            return Err(self.invalid(format_args!("{place}.mode"), "a mode in 0..=6", "another"));
        };
        if !matches!(
            mode,
            Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
        ) {
            builder.warn(format!(
                "{place} has no triangles but {mode:?} and is left out"
            ));
            return Ok(None);
        }
        let material = materials.convert(primitive.material, builder)?;
        let Converted {
            uv_sets,
            double_sided,
            needs_tangents,
            ..
        } = materials.list[material];

        let attribute =
            |semantic: Semantic| primitive.attributes.get(&Checked::Valid(semantic)).copied();
        let key = |name: &str| format!("{place}.attributes.{name}");
        let Some(positions) = attribute(Semantic::Positions) else {
            return Err(self.invalid(key("POSITION"), "an accessor", "none"));
        };
        self.check_bounds(positions, &key("POSITION"))?;
        let positions = self.floats::<3>(positions, &key("POSITION"))?;
        let count = positions.len();
        let optional = |data: &[usize], name: &str| match data {
            [] => Ok(()),
            [length] if *length == count => Ok(()),
            [length, ..] => Err(self.invalid(
                key(name),
                format_args!("{count} elements, as many as POSITION has"),
                length,
            )),
        };
        let normals = attribute(Semantic::Normals)
            .map(|index| self.any_floats::<3>(index, &key("NORMAL")))
            .transpose()?;
        optional(normals.as_ref().map(Vec::len).as_slice(), "NORMAL")?;
        // Without normals the specification tells readers to ignore tangents.
        let tangents = attribute(Semantic::Tangents)
            .filter(|_| normals.is_some())
            .map(|index| self.floats::<4>(index, &key("TANGENT")))
            .transpose()?;
        optional(tangents.as_ref().map(Vec::len).as_slice(), "TANGENT")?;
        let mut missing = None;
        let mut uvs_of = |uv_set: Option<u32>| {
            let Some(uv_set) = uv_set else {
                return Ok(None);
            };
            let uv_name = format!("TEXCOORD_{uv_set}");
            let uvs = attribute(Semantic::TexCoords(uv_set))
                .map(|index| self.any_floats::<2>(index, &key(&uv_name)))
                .transpose()?;
            optional(uvs.as_ref().map(Vec::len).as_slice(), &uv_name)?;
            if uvs.is_none() {
                missing.get_or_insert(uv_name);
            }
            Ok(uvs)
        };
        let uvs = uvs_of(Some(uv_sets.0))?;
        let second_uvs = uvs_of(uv_sets.1)?;
        let colors = attribute(Semantic::Colors(0))
            .map(|index| self.colors(index, &key("COLOR_0")))
            .transpose()?;
        optional(colors.as_ref().map(Vec::len).as_slice(), "COLOR_0")?;
        if let Some(uv_name) = missing
            && materials.list[material].has_textures()
        {
            builder.warn(format!("{place} is textured but has no {uv_name}"));
        }

        let linear = DMat3::from_mat4(matrix);
        // The cofactor matrix maps normals; unlike the inverse transpose it exists for every
        // matrix. It points them inwards under a reflection, so its sign is restored.
        let mirrored = linear.determinant() < 0.0;
        let sign = if mirrored { -1.0 } else { 1.0 };
        let (x, y, z) = (linear.x_axis, linear.y_axis, linear.z_axis);
        let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign;
        let direction = |matrix: DMat3, vector: [f32; 3]| {
            (matrix * Vec3::from(vector).as_dvec3())
                .try_normalize()
                .map(DVec3::as_vec3)
        };
        let mut vertices = Vec::with_capacity(count);
        for (index, position) in positions.into_iter().enumerate() {
            let position = matrix
                .transform_point3(Vec3::from(position).as_dvec3())
                .as_vec3();
            if !position.is_finite() {
                let found = format!("{position} at vertex {index}, in world space");
                return Err(self.invalid(key("POSITION"), "finite coordinates", found));
            }
            let tangent = tangents.as_ref().and_then(|tangents| {
                let [x, y, z, w] = tangents[index];
                Some((direction(linear, [x, y, z])?, w * sign as f32))
            });
            let normal =
                (normals.as_ref()).and_then(|normals| direction(cofactors, normals[index]));
            let uv = |uvs: &Option<Vec<[f32; 2]>>| {
                uvs.as_ref().map_or(Vec2::ZERO, |uvs| uvs[index].into())
            };
            vertices.push(GivenVertex {
                position,
                normal,
                tangent,
                uv: uv(&uvs),
                second_uv: uv(&second_uvs),
                color: colors.as_ref().map(|colors| colors[index]),
            });
        }

        let indices = match primitive.indices {
            Some(accessor) => self.indices(accessor, &format!("{place}.indices"), count)?,
            None => (0..count as u32).collect(),
        };
        let mut triangles = assemble(mode, &indices);
        if mirrored {
            for triangle in &mut triangles {
                triangle.swap(1, 2);
            }
        }
        if normals.is_none() {
            (vertices, triangles) = flat_shaded(&vertices, &triangles);
        }
        let tangents = match (tangents.is_some(), uvs.is_some(), needs_tangents) {
            (true, ..) => Tangents::Given,
            (false, true, true) => Tangents::MikkTSpace,
            (false, true, false) => Tangents::FromUv,
            (false, false, _) => Tangents::AroundAxis,
        };
        Ok(Some(Part {
            vertices,
            triangles,
            material,
            tangents,
            double_sided,
            cutout: materials.list[material].cutout.clone(),
            takes_colors: !needs_tangents && !materials.list[material].has_textures(),
        }))
    }
}

fn local_transform(node: &scene::Node) -> DMat4 {
    if let Some(matrix) = node.matrix {
        return DMat4::from_cols_array(&matrix.map(f64::from));
    }
    let rotation = node.rotation.map(|rotation| rotation.0);
    transform(node.translation, rotation, node.scale)
}

fn transform(
    translation: Option<[f32; 3]>,
    rotation: Option<[f32; 4]>,
    scale: Option<[f32; 3]>,
) -> DMat4 {
    let vector = |given: Option<[f32; 3]>, default| {
        given.map_or(default, |given| DVec3::from(given.map(f64::from)))
    };
    let rotation = rotation.map_or(DQuat::IDENTITY, |rotation| {
        let rotation = DQuat::from_array(rotation.map(f64::from));
        // A file's quaternion is only as long as its rounding lets it be.
        if rotation.length_squared() > 0.0 {
            rotation.normalize()
        } else {
            DQuat::IDENTITY
        }
    });
    DMat4::from_scale_rotation_translation(
        vector(scale, DVec3::ONE),
        rotation,
        vector(translation, DVec3::ZERO),
    )
}

/// Triangles of a list, strip or fan; left-over indices are dropped.
fn assemble(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => indices
            .windows(3)
            .enumerate()
            .map(|(i, w)| {
                if i % 2 == 0 {
                    [w[0], w[1], w[2]]
                } else {
                    [w[1], w[0], w[2]]
                }
            })
            .collect(),
        Mode::TriangleFan => indices
            .get(1..)
            .unwrap_or_default()
            .windows(2)
            .map(|pair| [pair[0], pair[1], indices[0]])
            .collect(),
        _ => indices.as_chunks::<3>().0.to_vec(),
    }
}

/// Gives every triangle its own vertices, with its face's normal.
fn flat_shaded(
    vertices: &[GivenVertex],
    triangles: &[[u32; 3]],
) -> (Vec<GivenVertex>, Vec<[u32; 3]>) {
    let mut flat = Vec::with_capacity(triangles.len() * 3);
    for triangle in triangles {
        let corners = triangle.map(|index| vertices[index as usize]);
        let normal = face_normal(corners.map(|corner| corner.position));
        flat.extend(corners.map(|corner| GivenVertex {
            normal: normal.map(DVec3::as_vec3),
            ..corner
        }));
    }
    let triangles = (0..triangles.len() as u32)
        .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
        .collect();
    (flat, triangles)
}
