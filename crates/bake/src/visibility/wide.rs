//! A tree of boxes for rays: each inner node has up to eight children, whose boxes are tested side by side (Wald, Benthin
//! and Boulos 2008, "Getting Rid of Packets"). Made of a binary tree.

use glam::{Vec3, Vec3A};
use obvhs::bvh2::Bvh2;
use pulp::{Simd, WithSimd};

use crate::simd;

/// Children of a node, at most.
const WIDTH: usize = 8;
/// Set in a child that is a leaf. Below it lie three bits of its primitives, less one, then the number of the first.
const LEAF: u32 = 1 << 31;
const COUNT_SHIFT: u32 = 28;
/// Primitives of a leaf, and of a tree, at most.
const LEAF_PRIMITIVES: u32 = 8;
const MOST_PRIMITIVES: u32 = 1 << COUNT_SHIFT;
/// Nodes that wait to be looked into, as many as lie on the stack.
const WAITING: usize = 64;

/// A node's boxes, and what is in them.
#[repr(C, align(64))]
struct Node {
    /// Least and largest coordinates along each axis, side by side. Those of no child are infinite, the least above the largest.
    bounds: [[[f32; WIDTH]; 2]; 3],
    children: [u32; WIDTH],
}

/// Looks at primitives. Not a closure, which would be compiled for any processor.
pub(super) trait Visitor {
    /// Looks at the one with this number, where only what is no farther away than `limit` counts. Returns the new limit;
    /// negative to end. `#[inline(always)]`.
    fn visit(&mut self, ray: &Ray, primitive: u32, limit: f32) -> f32;
}

/// The tree.
#[derive(Default)]
pub(super) struct Wide {
    nodes: Vec<Node>,
}

/// A ray as boxes are tested with it.
#[derive(Clone, Copy)]
pub(super) struct Ray {
    pub(super) origin: Vec3A,
    pub(super) direction: Vec3A,
    inverse: Vec3A,
}

impl Ray {
    /// Origin and direction must be finite.
    pub(super) fn new(origin: Vec3, direction: Vec3) -> Self {
        // Finite, so that no product is undefined.
        let inverse = |x: f32| (1.0 / x).abs().min(f32::MAX).copysign(x);
        let [x, y, z] = direction.to_array().map(inverse);
        Self {
            origin: origin.into(),
            direction: direction.into(),
            inverse: Vec3A::new(x, y, z),
        }
    }
}

impl Wide {
    /// A tree, and in which order its leaves name the primitives.
    ///
    /// # Panics
    ///
    /// If there are more than 2²⁸ primitives.
    pub(super) fn new(binary: &Bvh2) -> (Self, Vec<u32>) {
        assert!(
            binary.primitive_indices.len() <= MOST_PRIMITIVES as usize,
            "more triangles than a tree has numbers for"
        );
        let mut tree = Self::default();
        let mut order = Vec::with_capacity(binary.primitive_indices.len());
        if binary.nodes.is_empty() {
            return (tree, order);
        }
        // Inner nodes to be made, and which child of what they are.
        let mut waiting = vec![(0, None)];
        while let Some((node, parent)) = waiting.pop() {
            let made = tree.nodes.len();
            if let Some((parent, lane)) = parent {
                let parent: &mut Node = &mut tree.nodes[parent];
                parent.children[lane] = made as u32;
            }
            let mut wide = Node {
                bounds: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3],
                children: [0; WIDTH],
            };
            for (lane, child) in opened(binary, node).into_iter().enumerate() {
                let child_node = &binary.nodes[child];
                let bounds = child_node.aabb();
                for axis in 0..3 {
                    wide.bounds[axis][0][lane] = bounds.min[axis];
                    wide.bounds[axis][1][lane] = bounds.max[axis];
                }
                if !child_node.is_leaf() {
                    waiting.push((child, Some((made, lane))));
                    continue;
                }
                let (first, count) = (child_node.first_index as usize, child_node.prim_count);
                assert!(count <= LEAF_PRIMITIVES, "a leaf of {count} triangles");
                wide.children[lane] = LEAF | (count - 1) << COUNT_SHIFT | order.len() as u32;
                order.extend(&binary.primitive_indices[first..first + count as usize]);
            }
            tree.nodes.push(wide);
        }
        (tree, order)
    }

    /// The least and the largest coordinates of all.
    #[cfg(test)]
    pub(super) fn bounds(&self) -> [Vec3; 2] {
        let bounds = &self.nodes[0].bounds;
        let of = |side: usize, least: fn(f32, f32) -> f32| {
            let along = |axis: usize| bounds[axis][side].into_iter().reduce(least);
            Vec3::from([0, 1, 2].map(|axis| along(axis).expect("eight children")))
        };
        [of(0, f32::min), of(1, f32::max)]
    }

    /// Visits the primitives in boxes that a ray meets no farther away than `limit`, in lengths of its direction, nearer
    /// boxes first, and returns the visitor.
    pub(super) fn walk<V: Visitor>(&self, ray: &Ray, limit: f32, visitor: V) -> V {
        if self.nodes.is_empty() {
            return visitor;
        }
        simd::arch().dispatch(Walk {
            nodes: &self.nodes,
            ray: *ray,
            limit,
            visitor,
        })
    }
}

/// The children of a node of a binary tree, the largest of which are opened as long as there is room for theirs.
fn opened(binary: &Bvh2, node: usize) -> Vec<usize> {
    let mut children = vec![node];
    while children.len() < WIDTH {
        let inner = (0..children.len()).filter(|&i| !binary.nodes[children[i]].is_leaf());
        let area = |i: usize| binary.nodes[children[i]].aabb().half_area();
        let Some(largest) = inner.max_by(|&a, &b| area(a).total_cmp(&area(b)).then(b.cmp(&a)))
        else {
            break;
        };
        let first = binary.nodes[children[largest]].first_index as usize;
        children[largest] = first;
        children.insert(largest + 1, first + 1);
    }
    children
}

/// A walk through a tree.
struct Walk<'a, V> {
    nodes: &'a [Node],
    ray: Ray,
    limit: f32,
    visitor: V,
}

impl<V: Visitor> WithSimd for Walk<'_, V> {
    type Output = V;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> V {
        let mut stack = Stack::new();
        let (mut child, mut limit) = (0, self.limit);
        loop {
            if child & LEAF == 0 {
                let node = &self.nodes[child as usize];
                let (met, nears) = node.met(&self.ray, limit);
                if met != 0 {
                    child = stack.push_others(&node.children, met, &nears);
                    continue;
                }
            } else {
                let first = child & (MOST_PRIMITIVES - 1);
                for primitive in first..=first + (child >> COUNT_SHIFT & 7) {
                    limit = self.visitor.visit(&self.ray, primitive, limit);
                    if limit < 0.0 {
                        return self.visitor;
                    }
                }
            }
            child = loop {
                let Some(waiting) = stack.pop() else {
                    return self.visitor;
                };
                if f32::from_bits((waiting >> 32) as u32) <= limit {
                    break waiting as u32;
                }
            };
        }
    }
}

impl Node {
    /// Whether a ray meets each child no farther away than `limit`, a byte that is 0 or 1 for each, and where.
    #[inline(always)]
    fn met(&self, ray: &Ray, limit: f32) -> (u64, [f32; WIDTH]) {
        let mut nears = [0.0; WIDTH];
        let mut fars = [limit; WIDTH];
        let axes = (self.bounds.iter())
            .zip(ray.origin.to_array())
            .zip(ray.inverse.to_array());
        for ((bounds, origin), inverse) in axes {
            let backwards = usize::from(inverse < 0.0);
            let (low, high) = (&bounds[backwards], &bounds[1 - backwards]);
            for lane in 0..WIDTH {
                let near = (low[lane] - origin) * inverse;
                let far = (high[lane] - origin) * inverse;
                nears[lane] = if near > nears[lane] {
                    near
                } else {
                    nears[lane]
                };
                fars[lane] = if far < fars[lane] { far } else { fars[lane] };
            }
        }
        let mut met = [0; WIDTH];
        for lane in 0..WIDTH {
            met[lane] = u8::from(nears[lane] <= fars[lane]);
        }
        // Else the compiler takes the lanes apart to put the bytes together.
        (u64::from_le_bytes(*std::hint::black_box(&met)), nears)
    }
}

/// Children that wait: how far away, as bits, which are in order as it is not negative, and below that the child.
struct Stack {
    /// Those on top, and how many.
    top: [u64; WAITING],
    count: usize,
    below: Vec<u64>,
}

impl Stack {
    #[inline(always)]
    fn new() -> Self {
        Self {
            top: [0; WAITING],
            count: 0,
            below: Vec::new(),
        }
    }

    /// Pushes the children whose bytes are set, of which there are some, farthest first, but returns the nearest.
    #[inline(always)]
    fn push_others(&mut self, children: &[u32; WIDTH], mut met: u64, nears: &[f32; WIDTH]) -> u32 {
        let mut next = || {
            let lane = met.trailing_zeros() as usize / 8 % WIDTH;
            met &= met.wrapping_sub(1);
            let child = u64::from(nears[lane].to_bits()) << 32 | u64::from(children[lane]);
            (child, met != 0)
        };
        let (mut nearest, mut more) = next();
        if more && self.count + WIDTH > WAITING {
            self.below.extend(&self.top[..self.count]);
            self.count = 0;
        }
        let begun = self.count;
        while more {
            let child;
            (child, more) = next();
            let farther = nearest.max(child);
            nearest = nearest.min(child);
            let mut place = self.count % WAITING;
            while place > begun && self.top[place - 1] < farther {
                self.top[place] = self.top[place - 1];
                place -= 1;
            }
            self.top[place] = farther;
            self.count += 1;
        }
        nearest as u32
    }

    #[inline(always)]
    fn pop(&mut self) -> Option<u64> {
        if self.count == 0 {
            return self.below.pop();
        }
        self.count -= 1;
        self.top.get(self.count).copied()
    }
}

#[cfg(test)]
mod tests {
    use obvhs::BvhBuildParams;
    use obvhs::aabb::Aabb;
    use obvhs::bvh2::builder::build_bvh2;
    use obvhs::bvh2::node::Bvh2Node;

    use super::*;
    use crate::visibility::tests::random;

    /// Counts visits, and ends after so many.
    struct Visits {
        visited: Vec<u32>,
        most: usize,
    }

    impl Visitor for Visits {
        #[inline(always)]
        fn visit(&mut self, _: &Ray, primitive: u32, limit: f32) -> f32 {
            self.visited.push(primitive);
            if self.visited.len() < self.most {
                limit
            } else {
                -1.0
            }
        }
    }

    /// Numbers in `-1..1` that are as good as random.
    fn numbers() -> impl FnMut() -> f32 {
        let mut state = 1;
        move || 2.0 * random(&mut state) - 1.0
    }

    fn visits(tree: &Wide, ray: &Ray, limit: f32, most: usize) -> Vec<u32> {
        let visited = Vec::new();
        tree.walk(ray, limit, Visits { visited, most }).visited
    }

    /// Boxes at places as good as random, of all sizes, their tree, and its order.
    fn scattered(scale: f32) -> (Vec<Aabb>, Wide, Vec<u32>) {
        let mut number = numbers();
        let mut point = || Vec3A::new(number(), number(), number());
        let boxes: Vec<Aabb> = (0..700)
            .map(|i| {
                let centre = point();
                let half = point().abs() * if i % 20 == 0 { 0.5 } else { 0.02 };
                Aabb::new((centre - half) * scale, (centre + half) * scale)
            })
            .collect();
        let params = BvhBuildParams::medium_build();
        let binary = build_bvh2(&boxes, params, &mut std::time::Duration::default());
        let (tree, order) = Wide::new(&binary);
        (boxes, tree, order)
    }

    #[test]
    fn all_that_rays_meet_is_visited_once() {
        for scale in [1e-6, 1.0, 1e6] {
            let (boxes, tree, order) = scattered(scale);
            let mut number = numbers();
            for i in 0..500 {
                let origin = Vec3::new(number(), number(), number()) * scale;
                let mut direction = Vec3::new(number(), number(), number());
                if i % 3 == 0 {
                    // Along a plane, or an axis.
                    direction[i % 2] = 0.0;
                    direction[2] *= f32::from(u8::from(i % 4 == 0));
                }
                let direction = direction * scale;
                if direction == Vec3::ZERO {
                    continue;
                }
                let limit = [0.4, f32::INFINITY][i % 2];
                let ray = Ray::new(origin, direction);
                let visited = visits(&tree, &ray, limit, usize::MAX);
                // In double precision.
                let met = |bounds: &Aabb, spare: f64| {
                    let (mut near, mut far) = (0f64, f64::from(limit));
                    for axis in 0..3 {
                        let [o, d] = [origin[axis], direction[axis]].map(f64::from);
                        let [low, high] = [bounds.min[axis], bounds.max[axis]].map(f64::from);
                        let slack = spare * f64::from(scale);
                        let [low, high] = [low - o + slack, high - o - slack];
                        if d == 0.0 {
                            far = if low <= 0.0 && high >= 0.0 { far } else { -1.0 };
                            continue;
                        }
                        near = near.max((low / d).min(high / d));
                        far = far.min((low / d).max(high / d));
                    }
                    near <= far
                };
                for (place, number) in order.iter().enumerate() {
                    if met(&boxes[*number as usize], 1e-6) {
                        assert!(visited.contains(&(place as u32)), "ray {i} at {scale}");
                    }
                }
                // Leaves of a few boxes each bring some that are not met.
                let all = boxes.iter().filter(|bounds| met(bounds, 0.0)).count();
                assert!(visited.len() <= 8 * all + 16, "{} of {all}", visited.len());
                let mut once = visited.clone();
                once.sort_unstable();
                once.dedup();
                assert_eq!(once.len(), visited.len());
                if let Some(&first) = visited.first() {
                    assert_eq!(visits(&tree, &ray, limit, 1), [first]);
                }
            }
        }
    }

    #[test]
    fn trees_may_be_deeper_than_the_stack() {
        // At each level a box that the ray meets, and the rest, nearer than that.
        let depth = 2000;
        let bounds = |i: usize| Aabb::new(Vec3A::ZERO, Vec3A::splat(1.0 - i as f32 / 4000.0));
        let leaf = |i: usize| Bvh2Node::new(bounds(i), 1, i as u32);
        let mut nodes = vec![Bvh2Node::new(bounds(0), 0, 1)];
        for i in 0..depth {
            nodes.push(leaf(i));
            let last = i + 1 == depth;
            nodes.push(if last {
                leaf(depth)
            } else {
                Bvh2Node::new(bounds(i), 0, nodes.len() as u32 + 1)
            });
        }
        let binary = Bvh2 {
            nodes,
            primitive_indices: (0..=depth as u32).collect(),
            ..Bvh2::default()
        };
        let (tree, order) = Wide::new(&binary);
        assert_eq!(order.len(), depth + 1);
        let ray = Ray::new(Vec3::splat(-1.0), Vec3::ONE);
        let mut visited = visits(&tree, &ray, f32::INFINITY, usize::MAX);
        visited.sort_unstable();
        assert!(visited.into_iter().eq(0..=depth as u32));
    }

    #[test]
    fn a_tree_of_nothing_is_walked() {
        let (tree, order) = Wide::new(&Bvh2::default());
        assert!(order.is_empty());
        let ray = Ray::new(Vec3::ZERO, Vec3::X);
        assert!(visits(&tree, &ray, f32::INFINITY, usize::MAX).is_empty());
    }
}
