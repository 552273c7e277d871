//! What blocks rays: the scene's triangles in a bounding volume hierarchy that is walked without
//! a stack.
//!
//! Nodes lie in depth-first order: behind a node come those within it, and where its box is missed
//! the walk goes on behind those (Smits 1998, "Efficiency Issues for Ray Tracing").

use glam::Vec3;

use crate::gpu;

/// Smallest component of a direction that is divided by.
const LEAST_COMPONENT: f32 = 1e-20;

/// Of a triangle's determinant with a unit direction, over its longer edge and its distance: less
/// leaves barycentric coordinates uncertain by a twentieth.
const UNCERTAIN: f32 = 5e-6;

/// Least length that is divided by.
const LEAST_LENGTH: f32 = 1e-20;

/// Least sine of a cone's half angle that a radius is divided by.
const LEAST_SINE: f32 = 1e-4;

/// Triangles that block, from both sides.
#[derive(Clone, Debug, Default)]
pub struct Occluders {
    nodes: Vec<gpu::OccluderNode>,
    triangles: Vec<gpu::OccluderTriangle>,
}

/// A node of any binary hierarchy.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// Lowest corner of a box around everything within.
    pub low: Vec3,
    /// Its highest corner.
    pub high: Vec3,
    /// Inner nodes: the first of two children, the second one following. Leaves: the first of
    /// `count` triangles.
    pub first: u32,
    /// 0: inner node.
    pub count: u32,
}

/// By how much a triangle's bounds are made larger along each axis, so that rounding in the box test loses no hit: it is
/// off by up to three units in the last place of the distance to the ray's origin, which lies within a few extents of the
/// scene. Along each axis for itself: boxes of ground that is kilometres wide would reach above the origins of rays that
/// start there, and go along all of it.
pub fn padding(triangles: &[[Vec3; 3]]) -> Vec3 {
    let extent =
        (triangles.iter().flatten()).fold(Vec3::ZERO, |extent, corner| extent.max(corner.abs()));
    extent * 16.0 * f32::EPSILON
}

impl Occluders {
    /// Lays out a hierarchy: `nodes` with the root first, and triangles in the order in which its
    /// leaves name them.
    pub fn new(nodes: &[Node], triangles: &[[Vec3; 3]]) -> Self {
        /// What is left to do, the next thing last.
        enum Task {
            Visit(u32),
            /// All within the node laid out at this place has been.
            End(usize),
        }
        let mut laid_out = Self {
            nodes: Vec::with_capacity(nodes.len()),
            triangles: Vec::with_capacity(triangles.len()),
        };
        let mut tasks = Vec::new();
        if !nodes.is_empty() {
            tasks.push(Task::Visit(0));
        }
        while let Some(task) = tasks.pop() {
            match task {
                Task::End(place) => laid_out.nodes[place].next = laid_out.nodes.len() as u32,
                Task::Visit(index) => {
                    let node = nodes[index as usize];
                    let place = laid_out.nodes.len();
                    laid_out.nodes.push(gpu::OccluderNode {
                        low: node.low.into(),
                        next: place as u32 + 1,
                        high: node.high.into(),
                        triangles: 0,
                    });
                    if node.count == 0 {
                        let area = |child: u32| {
                            let node = &nodes[child as usize];
                            let side = node.high - node.low;
                            side.dot(Vec3::new(side.y, side.z, side.x))
                        };
                        // The larger one first: it more likely ends the walk.
                        let (a, b) = (node.first, node.first + 1);
                        let (next, last) = if area(a) >= area(b) { (a, b) } else { (b, a) };
                        tasks.extend([Task::End(place), Task::Visit(last), Task::Visit(next)]);
                    } else {
                        laid_out.leaf(&triangles[node.first as usize..][..node.count as usize]);
                    }
                }
            }
        }
        laid_out
    }

    /// Makes the node laid out last a leaf, and further leaves in the same box where it has more
    /// triangles than one can name.
    fn leaf(&mut self, triangles: &[[Vec3; 3]]) {
        const MOST: usize = gpu::OccluderNode::MAX_TRIANGLES as usize;
        let mut node = self.nodes.pop().expect("the caller's");
        for triangles in triangles.chunks(MOST) {
            let first = self.triangles.len() as u32;
            node.triangles = (first << gpu::OccluderNode::COUNT_BITS) | triangles.len() as u32;
            node.next = self.nodes.len() as u32 + 1;
            self.nodes.push(node);
            self.triangles
                .extend(triangles.iter().map(|[a, b, c]| gpu::OccluderTriangle {
                    corner: (*a).into(),
                    reserved: 0.0,
                    edges: [(*b - *a).extend(0.0).into(), (*c - *a).extend(0.0).into()],
                }));
        }
    }

    /// The nodes, as the GPU has them.
    pub fn nodes(&self) -> &[gpu::OccluderNode] {
        &self.nodes
    }

    /// The triangles, as the GPU has them.
    pub fn triangles(&self) -> &[gpu::OccluderTriangle] {
        &self.triangles
    }

    /// Whether anything lies on the ray more than `nearest` lengths of `direction` in front of its origin; all that does
    /// is known to be in the node `from` and those behind it.
    pub fn block(&self, from: u32, origin: Vec3, direction: Vec3, nearest: f32) -> bool {
        let safe = |x: f32| {
            if x.abs() < LEAST_COMPONENT {
                LEAST_COMPONENT
            } else {
                x
            }
        };
        let inverse = Vec3::from(direction.to_array().map(|x| 1.0 / safe(x)));
        let mut place = from;
        while let Some(node) = self.nodes.get(place as usize) {
            let a = (Vec3::from(node.low) - origin) * inverse;
            let b = (Vec3::from(node.high) - origin) * inverse;
            let enter = a.min(b).max_element().max(0.0);
            if enter > a.max(b).min_element() {
                place = node.next;
                continue;
            }
            let count = node.triangles & gpu::OccluderNode::MAX_TRIANGLES;
            let first = node.triangles >> gpu::OccluderNode::COUNT_BITS;
            for triangle in &self.triangles[first as usize..][..count as usize] {
                if triangle.meets(origin, direction, nearest) {
                    return true;
                }
            }
            place += 1;
        }
        false
    }

    /// The first node that has anything which may lie within a cone with its tip at `origin`, around the unit vector
    /// `axis`; `cosine` is that of its half angle. A cone with a `radius` has its tip cut off where it is so
    /// wide, which is at `origin`. What lies below the plane through `origin` whose unit normal is `face` does not
    /// count. Now and then also where something only comes
    /// close, and always in a cone that is no cone: half of all directions or more. As with [`Self::block`], all that
    /// there is lies in `from` or behind it; so it does, for rays within the cone, in the node that is found.
    pub fn meet_cone(
        &self,
        from: u32,
        origin: Vec3,
        radius: f32,
        face: Vec3,
        axis: Vec3,
        cosine: f32,
    ) -> Option<u32> {
        if cosine <= 0.0 {
            return Some(from);
        }
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        // From the tip that is cut off.
        let cut = radius * cosine / sine.max(LEAST_SINE);
        let mut place = from;
        while let Some(node) = self.nodes.get(place as usize) {
            let (low, high) = (Vec3::from(node.low), Vec3::from(node.high));
            let (middle, half) = (0.5 * (low + high) - origin, 0.5 * (high - low));
            let along = axis.dot(middle);
            let aside = middle - along * axis;
            // Away from the side of the cone that is nearest to the middle.
            let away = aside * (cosine / aside.length().max(LEAST_LENGTH)) - axis * sine;
            let outside = away.dot(middle) - radius * cosine - away.abs().dot(half);
            let highest = face.dot(middle) + face.abs().dot(half);
            if outside > 0.0 || along < -axis.abs().dot(half) || highest <= 0.0 {
                place = node.next;
                continue;
            }
            let count = node.triangles & gpu::OccluderNode::MAX_TRIANGLES;
            let first = node.triangles >> gpu::OccluderNode::COUNT_BITS;
            for triangle in &self.triangles[first as usize..][..count as usize] {
                if triangle.meets_cone(origin, cut, face, axis, cosine) {
                    return Some(place);
                }
            }
            place += 1;
        }
        None
    }
}

impl gpu::OccluderTriangle {
    /// A cone meets a triangle that its axis hits, or an edge of which enters it; its first part, of length
    /// `cut`, is not there, nor what is below a plane.
    fn meets_cone(&self, origin: Vec3, cut: f32, face: Vec3, axis: Vec3, cosine: f32) -> bool {
        let [ab, ac] = self.edges.map(|[x, y, z, _]| Vec3::new(x, y, z));
        let a = Vec3::from(self.corner) - origin;
        let from_a = face.dot(ab).max(face.dot(ac)).max(0.0);
        if face.dot(a) + from_a <= 0.0 {
            return false;
        }
        let edge = |start, edge| {
            in_front(start, edge, axis).is_some_and(|(start, edge)| {
                cone_holds_part(start + cut * axis, edge, axis, cosine)
            })
        };
        edge(a, ab) || edge(a, ac) || edge(a + ab, ac - ab) || self.meets(origin, axis, 0.0)
    }

    /// Möller & Trumbore 1997.
    fn meets(&self, origin: Vec3, direction: Vec3, nearest: f32) -> bool {
        let [ab, ac] = self.edges.map(|[x, y, z, _]| Vec3::new(x, y, z));
        let from_a = origin - Vec3::from(self.corner);
        let p = direction.cross(ac);
        let q = from_a.cross(ab);
        let determinant = ab.dot(p);
        // Of slivers, and of triangles seen edge-on from afar, rounding alone would decide.
        let uncertain = UNCERTAIN * UNCERTAIN * from_a.length_squared();
        if determinant * determinant <= uncertain * ab.length_squared().max(ac.length_squared()) {
            return false;
        }
        let v = from_a.dot(p) / determinant;
        let w = direction.dot(q) / determinant;
        let t = ac.dot(q) / determinant;
        v >= 0.0 && w >= 0.0 && v + w <= 1.0 && t > nearest
    }
}

/// The part of an edge that is in front of the origin along `axis`.
fn in_front(start: Vec3, edge: Vec3, axis: Vec3) -> Option<(Vec3, Vec3)> {
    let (first, last) = (axis.dot(start), axis.dot(start + edge));
    if first < 0.0 && last < 0.0 {
        None
    } else if first < 0.0 {
        let behind = first / (first - last);
        Some((start + behind * edge, (1.0 - behind) * edge))
    } else if last < 0.0 {
        Some((start, edge * (first / (first - last))))
    } else {
        Some((start, edge))
    }
}

/// Whether an edge from `start`, relative to the tip of a cone, enters it. With x along the
/// edge, axis · x − cosine |x| is concave, and its sign that of a quadratic where axis · x > 0.
fn cone_holds_part(start: Vec3, edge: Vec3, axis: Vec3, cosine: f32) -> bool {
    let holds = |x: Vec3| axis.dot(x) >= cosine * x.length();
    let square = axis.dot(edge).powi(2) - cosine * cosine * edge.length_squared();
    let linear = axis.dot(start) * axis.dot(edge) - cosine * cosine * start.dot(edge);
    let best = if square < 0.0 {
        (-linear / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    holds(start) || holds(start + edge) || holds(start + best * edge)
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!(
        "const OCCLUDERS_LEAST_COMPONENT: f32 = {LEAST_COMPONENT:e};\n\
         const OCCLUDERS_UNCERTAIN: f32 = {UNCERTAIN:e};\n\
         const OCCLUDERS_LEAST_LENGTH: f32 = {LEAST_LENGTH:e};\n\
         const OCCLUDERS_LEAST_SINE: f32 = {LEAST_SINE:e};\n\
         const OCCLUDERS_NONE: u32 = 0xffffffffu;\n\
         const OCCLUDERS_COUNT_BITS: u32 = {}u;\n\
         const OCCLUDERS_MAX_TRIANGLES: u32 = {}u;\n",
        gpu::OccluderNode::COUNT_BITS,
        gpu::OccluderNode::MAX_TRIANGLES,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight_format::math;

    /// Pseudorandom numbers in [0, 1).
    fn uniform(index: u32) -> f32 {
        let mut x = index.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
        x = (x ^ x >> 16).wrapping_mul(0x21f0_aaad);
        x = (x ^ x >> 15).wrapping_mul(0x735a_2d97);
        (x ^ x >> 15) as f32 / 4_294_967_296.0
    }

    fn vector(index: u32) -> Vec3 {
        Vec3::from([0, 1, 2].map(|i| 2.0 * uniform(3 * index + i) - 1.0))
    }

    /// Splits in the middle down to leaves of up to nine triangles, more than a node can name.
    fn split(nodes: &mut Vec<Node>, place: usize, triangles: &[[Vec3; 3]], first: u32) {
        let corners = triangles.iter().flatten();
        let (low, high) = corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &p| {
            (low.min(p), high.max(p))
        });
        let leaf = triangles.len() < 10;
        nodes[place] = Node {
            low,
            high,
            first: if leaf { first } else { nodes.len() as u32 },
            count: if leaf { triangles.len() as u32 } else { 0 },
        };
        if !leaf {
            let children = nodes.len();
            nodes.extend([nodes[place]; 2]);
            let (left, right) = triangles.split_at(triangles.len() / 2);
            split(nodes, children, left, first);
            split(nodes, children + 1, right, first + left.len() as u32);
        }
    }

    #[test]
    fn the_walk_finds_what_trying_all_finds() {
        let triangles: Vec<[Vec3; 3]> = (0..200)
            .map(|index| {
                let middle = vector(index);
                [1, 2, 3].map(|corner| middle + 0.1 * vector(1000 * corner + index))
            })
            .collect();
        let mut nodes = vec![
            Node {
                low: Vec3::ZERO,
                high: Vec3::ZERO,
                first: 0,
                count: 0
            };
            1
        ];
        split(&mut nodes, 0, &triangles, 0);
        let occluders = Occluders::new(&nodes, &triangles);
        assert_eq!(occluders.triangles().len(), 200);
        // A sliver whose corners lie on a line but for rounding blocks nothing from afar.
        let line = Vec3::new(0.37, 0.11, -0.23);
        let sliver = [Vec3::ZERO, line, 1.000_000_1 * (0.3 * line)];
        let one = Node {
            low: -Vec3::ONE,
            high: Vec3::ONE,
            first: 0,
            count: 1,
        };
        let sliver = Occluders::new(&[one], &[sliver]);
        let far = |ray: u32| 5.0 * vector(ray).normalize();
        assert!((0..2000).all(|ray| {
            let through = uniform(ray) * line;
            !sliver.block(0, far(ray), (through - far(ray)).normalize(), 0.0)
        }));
        let mut hits = 0;
        for ray in 0..2000 {
            let (origin, mut direction) = (1.2 * vector(5000 + ray), vector(9000 + ray));
            if ray % 3 == 0 {
                direction.y = 0.0;
            }
            let found = occluders.block(0, origin, direction, 0.0);
            let expected = (occluders.triangles().iter()).any(|t| t.meets(origin, direction, 0.0));
            assert_eq!(found, expected, "{origin} {direction}");
            hits += u32::from(found);
        }
        assert!((50..1800).contains(&hits), "{hits}");
        // A cone is empty only where no ray within it hits, and is often found to be.
        let mut empty = 0;
        for cone in 0..400 {
            let (origin, axis) = (
                1.2 * vector(20_000 + cone),
                vector(30_000 + cone).normalize(),
            );
            let cosine = 1.0 - 0.1 * uniform(cone).powi(4);
            let radius = if cone % 2 == 0 {
                0.0
            } else {
                0.05 * uniform(cone + 1)
            };
            // A plane through the places that rays start at, which some of those without a radius go below.
            let face = if radius > 0.0 {
                axis
            } else {
                vector(40_000 + cone).normalize()
            };
            let (x, y) = axis.any_orthonormal_pair();
            let found = occluders.meet_cone(0, origin, radius, face, axis, cosine);
            let hit = (0..200).any(|ray| {
                let cosine = 1.0 - (1.0 - cosine) * uniform(200 * cone + ray);
                let sine = (1.0 - cosine * cosine).sqrt();
                let (sin, cos) =
                    math::sin_cos(std::f32::consts::TAU * uniform(700_000 + 200 * cone + ray));
                let aside = radius * vector(900_000 + 200 * cone + ray).normalize();
                let start = origin + aside - axis * axis.dot(aside);
                // Parallel to the rim or less far out.
                let direction = axis * cosine + (x * cos + y * sin) * sine;
                let hits = |from| occluders.block(from, start, direction, 0.0);
                let hit = direction.dot(face) > 0.0 && hits(0);
                // Nothing is missed by a ray that begins where the cone met something.
                assert!(!hit || found.is_some_and(hits), "{start} {direction}");
                hit
            });
            let met = found.is_some();
            let cut = radius * cosine / (1.0 - cosine * cosine).sqrt().max(LEAST_SINE);
            let meets = |triangle: &gpu::OccluderTriangle| {
                triangle.meets_cone(origin, cut, face, axis, cosine)
            };
            let expected = occluders.triangles().iter().any(meets);
            assert!(met || !hit, "{origin} {radius} {axis} {cosine}");
            assert_eq!(met, expected, "{origin} {radius} {axis} {cosine}");
            empty += u32::from(!met);
        }
        assert!((50..350).contains(&empty), "{empty}");
        assert!(!Occluders::default().block(0, Vec3::ZERO, Vec3::Y, 0.0));
    }
}
