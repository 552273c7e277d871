//! The hierarchy over a scene's triangles that rays are cast in.

use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::leaf_collapser::collapse;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::PlocBuilder;
use obvhs::{Boundable, BvhBuildParams};
use relight_format::Scene;
use relight_shading::occluders::{Node, Occluders, padding};

/// What a node costs a walk, over what a triangle does.
const NODE_COST: f32 = 1.0;

/// A triangle's bounds with [`padding`].
struct Padded {
    corners: [Vec3A; 3],
    padding: Vec3A,
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
    of_triangles(&triangles)
}

fn of_triangles(triangles: &[[Vec3; 3]]) -> Occluders {
    if triangles.is_empty() {
        return Occluders::default();
    }
    let padding = Vec3A::from(padding(triangles));
    let padded: Vec<Padded> = triangles
        .iter()
        .map(|corners| Padded {
            corners: corners.map(Vec3A::from),
            padding,
        })
        .collect();
    let tree = tree(&padded);
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

/// What no ray meets: a point farther away than scenes reach.
pub(crate) fn none() -> Occluders {
    of_triangles(&[[Vec3::splat(1e18); 3]])
}

/// As `obvhs::bvh2::builder::build_bvh2` does it, which asks for the time, and so panics in
/// WebAssembly. Every triangle is in one leaf.
fn tree(padded: &[Padded]) -> Bvh2 {
    let parameters = BvhBuildParams::medium_build();
    let mut tree = PlocBuilder::with_capacity(padded.len()).build(
        parameters.ploc_search_distance,
        padded,
        (0..padded.len() as u32).collect(),
        parameters.sort_precision,
        parameters.search_depth_threshold,
    );
    let mut optimizer = ReinsertionOptimizer::default();
    let ratio = parameters.reinsertion_batch_ratio;
    optimizer.run(&mut tree, ratio, None);
    collapse(
        &mut tree,
        parameters.max_prims_per_leaf.clamp(1, 255),
        NODE_COST,
    );
    let ratio = ratio * parameters.post_collapse_reinsertion_batch_ratio_multiplier;
    optimizer.run(&mut tree, ratio, None);
    tree
}
