//! What blocks rays: the scene's triangles in a bounding volume hierarchy that is walked without
//! a stack.
//!
//! Nodes lie in depth-first order: behind a node come those within it, and where its box is missed
//! the walk goes on behind those (Smits 1998, "Efficiency Issues for Ray Tracing"). Corners of
//! boxes lie on a grid, farther out by up to a cell and a quarter: half the memory, and a single load for GPUs.

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

/// How far inside of its box on the grid a box lies, cells: more than rounding moves either.
const MARGIN: f64 = 0.25;

/// Triangles that block, from both sides.
#[derive(Clone, Debug, Default)]
pub struct Occluders {
    grid: Grid,
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

/// Where corners of boxes lie.
#[derive(Clone, Copy, Debug, Default)]
struct Grid {
    /// World space.
    low: Vec3,
    /// Side of a cell.
    cell: f32,
}

impl Grid {
    /// Around a box, with a cell to spare below it.
    fn around(low: Vec3, high: Vec3) -> Self {
        let cells = gpu::OccluderNode::CELLS as f32 - 2.0;
        let spare = (high - low).max_element() / cells;
        let below = |x: f32| (x - spare).min(x.next_down());
        let low = Vec3::new(below(low.x), below(low.y), below(low.z));
        // Rounding must leave the last corner inside.
        let cell = (high - low).max_element() / (cells + 1.0) * (1.0 + 4.0 * f32::EPSILON);
        let cell = cell.max(f32::MIN_POSITIVE);
        Self { low, cell }
    }

    /// The box of the grid that holds another one.
    fn bounds(&self, low: Vec3, high: Vec3) -> [u32; 3] {
        let most = f64::from(gpu::OccluderNode::CELLS);
        [0, 1, 2].map(|axis| {
            let cells = |x: f32| (f64::from(x) - f64::from(self.low[axis])) / f64::from(self.cell);
            let lowest = (cells(low[axis]) - MARGIN).floor().clamp(0.0, most);
            let highest = (cells(high[axis]) + MARGIN).ceil().clamp(0.0, most);
            lowest as u32 | (highest as u32) << 16
        })
    }

    /// As nodes have it.
    fn packed(&self) -> gpu::OccluderNode {
        gpu::OccluderNode {
            bounds: self.low.to_array().map(f32::to_bits),
            link: self.cell.to_bits(),
        }
    }
}

impl Occluders {
    /// The node that all others lie within.
    pub const ROOT: u32 = 1;

    /// Lays out a hierarchy: `nodes` with the root first, and triangles in the order in which its
    /// leaves name them.
    pub fn new(nodes: &[Node], triangles: &[[Vec3; 3]]) -> Self {
        /// What is left to do, the next thing last.
        enum Task {
            Visit(u32),
            /// All within the node laid out at this place has been.
            End(usize),
        }
        let Some(root) = nodes.first() else {
            return Self::default();
        };
        let grid = Grid::around(root.low, root.high);
        let mut laid_out = Self {
            grid,
            nodes: Vec::with_capacity(nodes.len() + 1),
            triangles: Vec::with_capacity(triangles.len()),
        };
        laid_out.nodes.push(grid.packed());
        let mut tasks = vec![Task::Visit(0)];
        while let Some(task) = tasks.pop() {
            match task {
                Task::End(place) => laid_out.nodes[place].link = laid_out.nodes.len() as u32,
                Task::Visit(index) => {
                    let node = nodes[index as usize];
                    let bounds = grid.bounds(node.low, node.high);
                    if node.count > 0 {
                        laid_out.leaf(
                            bounds,
                            &triangles[node.first as usize..][..node.count as usize],
                        );
                        continue;
                    }
                    let place = laid_out.nodes.len();
                    laid_out.nodes.push(gpu::OccluderNode { bounds, link: 0 });
                    let area = |child: u32| {
                        let node = &nodes[child as usize];
                        let side = node.high - node.low;
                        side.dot(Vec3::new(side.y, side.z, side.x))
                    };
                    // The larger one first: it more likely ends the walk.
                    let (a, b) = (node.first, node.first + 1);
                    let (next, last) = if area(a) >= area(b) { (a, b) } else { (b, a) };
                    tasks.extend([Task::End(place), Task::Visit(last), Task::Visit(next)]);
                }
            }
        }
        laid_out
    }

    /// Adds a leaf, and further leaves in the same box where it has more triangles than one can name.
    fn leaf(&mut self, bounds: [u32; 3], triangles: &[[Vec3; 3]]) {
        const MOST: usize = gpu::OccluderNode::MAX_TRIANGLES as usize;
        for triangles in triangles.chunks(MOST) {
            let first = (self.triangles.len() as u32) << gpu::OccluderNode::COUNT_BITS;
            self.nodes.push(gpu::OccluderNode {
                bounds,
                link: gpu::OccluderNode::LEAF | first | triangles.len() as u32,
            });
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
        // Along the ray: a cell of every axis, and the grid's beginning.
        let across = self.grid.cell * inverse;
        let start = (self.grid.low - origin) * inverse;
        let mut place = from;
        while let Some(node) = self.nodes.get(place as usize) {
            let [low, high] = node.corners();
            let (a, b) = (low * across + start, high * across + start);
            let enter = a.min(b).max_element().max(0.0);
            if enter > a.max(b).min_element() {
                place = node.behind(place);
                continue;
            }
            for triangle in &self.triangles[node.triangles()] {
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
        let (start, half_cell) = (self.grid.low - origin, 0.5 * self.grid.cell);
        let mut place = from;
        while let Some(node) = self.nodes.get(place as usize) {
            let [low, high] = node.corners();
            let (middle, half) = (start + half_cell * (low + high), half_cell * (high - low));
            let along = axis.dot(middle);
            let aside = middle - along * axis;
            // Away from the side of the cone that is nearest to the middle.
            let away = aside * (cosine / aside.length().max(LEAST_LENGTH)) - axis * sine;
            let outside = away.dot(middle) - radius * cosine - away.abs().dot(half);
            let highest = face.dot(middle) + face.abs().dot(half);
            if outside > 0.0 || along < -axis.abs().dot(half) || highest <= 0.0 {
                place = node.behind(place);
                continue;
            }
            for triangle in &self.triangles[node.triangles()] {
                if triangle.meets_cone(origin, cut, face, axis, cosine) {
                    return Some(place);
                }
            }
            place += 1;
        }
        None
    }
}

impl gpu::OccluderNode {
    /// The lowest and the highest corner, cells of the grid.
    fn corners(&self) -> [Vec3; 2] {
        let corner =
            |shift: u32| Vec3::from(self.bounds.map(|word| (word >> shift & 0xffff) as f32));
        [corner(0), corner(16)]
    }

    /// The first node that does not lie within this one, whose place is given.
    fn behind(&self, place: u32) -> u32 {
        if self.link & Self::LEAF == 0 {
            self.link
        } else {
            place + 1
        }
    }

    /// Its triangles; none of an inner node.
    fn triangles(&self) -> std::ops::Range<usize> {
        if self.link & Self::LEAF == 0 {
            return 0..0;
        }
        let first = (self.link & !Self::LEAF) >> Self::COUNT_BITS;
        first as usize..(first + (self.link & Self::MAX_TRIANGLES)) as usize
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
         const OCCLUDERS_ROOT: u32 = {}u;\n\
         const OCCLUDERS_LEAF: u32 = {}u;\n\
         const OCCLUDERS_COUNT_BITS: u32 = {}u;\n\
         const OCCLUDERS_MAX_TRIANGLES: u32 = {}u;\n",
        Occluders::ROOT,
        gpu::OccluderNode::LEAF,
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
    fn boxes_on_the_grid_hold_those_they_are_of() {
        let scenes = [
            (0.0, 1.0),
            (1e6, 1.0),
            (-3e4, 1e-3),
            (0.0, 1e-6),
            (5.0, 1e6),
            (7.0, 0.0),
            (0.0, 0.0),
            (1e18, 0.0),
        ];
        for (middle, size) in scenes {
            // A flat one.
            let shape = Vec3::new(1.0, 0.3, 0.0);
            let corner = |index: u32| Vec3::splat(middle) + size * shape * vector(index);
            let boxes = (0..200).map(|index| (corner(2 * index), corner(2 * index + 1)));
            let boxes: Vec<_> = boxes.map(|(a, b)| (a.min(b), a.max(b))).collect();
            let low = boxes.iter().fold(Vec3::INFINITY, |low, of| low.min(of.0));
            let high = boxes
                .iter()
                .fold(Vec3::NEG_INFINITY, |high, of| high.max(of.1));
            let grid = Grid::around(low, high);
            for &(low, high) in &boxes {
                let bounds = grid.bounds(low, high);
                let [lowest, highest] = gpu::OccluderNode { bounds, link: 0 }.corners();
                for axis in 0..3 {
                    let side = f64::from(grid.cell);
                    let at = |cells: f32| f64::from(grid.low[axis]) + side * f64::from(cells);
                    let below = f64::from(low[axis]) - at(lowest[axis]);
                    let above = at(highest[axis]) - f64::from(high[axis]);
                    let most = (1.0 + MARGIN) * side * (1.0 + 1e-9);
                    assert!(
                        (0.0..=most).contains(&below),
                        "{middle} {size}: {below} {side}"
                    );
                    assert!(
                        (0.0..=most).contains(&above),
                        "{middle} {size}: {above} {side}"
                    );
                }
            }
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
            !sliver.block(
                Occluders::ROOT,
                far(ray),
                (through - far(ray)).normalize(),
                0.0,
            )
        }));
        let mut hits = 0;
        for ray in 0..2000 {
            let (origin, mut direction) = (1.2 * vector(5000 + ray), vector(9000 + ray));
            if ray % 3 == 0 {
                direction.y = 0.0;
            }
            let found = occluders.block(Occluders::ROOT, origin, direction, 0.0);
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
            let found = occluders.meet_cone(Occluders::ROOT, origin, radius, face, axis, cosine);
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
                let hit = direction.dot(face) > 0.0 && hits(Occluders::ROOT);
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
        assert!(!Occluders::default().block(Occluders::ROOT, Vec3::ZERO, Vec3::Y, 0.0));
    }
}
