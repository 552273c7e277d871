//! The hierarchy over a scene's triangles that rays are cast in.

use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::{Boundable, BvhBuildParams};
use relight_format::Scene;
use relight_shading::occluders::{Node, Occluders};

/// A triangle's bounds, padded so that rounding in the box test loses no hit.
struct Padded {
    corners: [Vec3A; 3],
    padding: f32,
}

impl Boundable for Padded {
    fn aabb(&self) -> Aabb {
        let bounds = Aabb::from_points(&self.corners);
        Aabb::new(bounds.min - self.padding, bounds.max + self.padding)
    }
}

/// Builds it; the same on any number of threads.
pub(crate) fn build(scene: &Scene) -> Occluders {
    let corners = |vertices: [u32; 3]| {
        vertices.map(|vertex| Vec3::from(scene.vertices[vertex as usize].position))
    };
    let triangles: Vec<[Vec3; 3]> = (scene.triangles.iter())
        .map(|triangle| corners(triangle.vertices))
        .collect();
    if triangles.is_empty() {
        return Occluders::default();
    }
    let extent = triangles.iter().flatten().fold(0f32, |extent, corner| {
        extent.max(corner.abs().max_element())
    });
    let padded: Vec<Padded> = triangles
        .iter()
        .map(|corners| Padded {
            corners: corners.map(Vec3A::from),
            padding: extent * 16.0 * f32::EPSILON,
        })
        .collect();
    let mut parameters = BvhBuildParams::medium_build();
    // So that every triangle is in one leaf.
    parameters.pre_split = false;
    let tree = build_bvh2(&padded, parameters, &mut std::time::Duration::default());
    let nodes: Vec<Node> = (tree.nodes.iter())
        .map(|node| Node {
            low: node.aabb().min.into(),
            high: node.aabb().max.into(),
            first: node.first_index,
            count: node.prim_count,
        })
        .collect();
    let ordered: Vec<[Vec3; 3]> = (tree.primitive_indices.iter())
        .map(|&index| triangles[index as usize])
        .collect();
    Occluders::new(&nodes, &ordered)
}
