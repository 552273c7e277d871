//! Division where visibility, interpolated between vertices, is wrong.
//!
//! The SSDF in the middle of an edge is compared with the mean of those at its ends, which
//! is what would be shaded there. What differs most is cut first.

use std::cmp::Reverse;
use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec3;
use rayon::prelude::*;

use super::{Key, cut, divide, key, sides};
use crate::compress::{Normal, Weighting};
use crate::mesh::Mesh;
use crate::mesh::size::SizeFunction;
use crate::monitor::{Interrupted, Monitor};
use crate::ssdf;
use crate::visibility::contour::ContourMesh;
use crate::visibility::places::{EXPOSURE_RESOLUTION, Places};

/// Texels per side of the visibility that is compared: half of a bake's.
const SAMPLE_RESOLUTION: u32 = 64;
const RESOLUTION: u32 = 32;
/// Distances are clamped to and kept in 127ths of this angle, radians.
const CLAMP: f32 = 0.5;
/// Rounds of halving, whatever the bounds say.
const MAX_ROUNDS: usize = 12;

/// What is wrong, and how far to go.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bound<'a> {
    /// Edges are cut whose middle is more wrong than this: the angle by which a wall's edge
    /// would have to be off for the same effect, radians. That holds at the length `edge`.
    /// What is wrong shows on an area that shrinks with the square of the length, and so do
    /// squared errors count: an edge of half the length may be twice as wrong.
    pub error: f32,
    /// Part of the size of what an edge belongs to or stands beside.
    pub edge: f32,
    /// Edges up to this part of that size are left alone.
    pub min_edge: f32,
    /// Those sizes.
    pub sizes: &'a SizeFunction,
    /// Cuts stop before the mesh has more vertices.
    pub max_vertices: usize,
    /// Distance of visibility samples from the surface, metres.
    pub ray_offset: f32,
}

impl Bound<'_> {
    /// Length of an edge as a part of the size there.
    fn length(&self, a: Vec3, b: Vec3) -> f32 {
        self.sizes.length(a, b, self.min_edge)
    }
}

/// A clamped SSDF, coarsely.
type Coarse = Box<[i8]>;

/// An edge and what cutting it would mean.
struct Edge {
    vertices: [u32; 2],
    /// Sum of the normals of its triangles, weighted by area.
    normal: Vec3,
}

/// An edge that is to be cut.
struct Wrong {
    /// In terms of [`Bound::error`]; above zero.
    error: f32,
    vertices: [u32; 2],
    /// The SSDF in its middle.
    middle: Coarse,
}

/// Where visibility is sampled.
#[derive(Clone, Copy)]
struct Point {
    origin: Vec3,
    normal: Vec3,
}

struct Comparison<'a> {
    contours: &'a ContourMesh,
    sampler: ssdf::Sampler,
    weighting: Weighting,
}

/// Cuts edges, most wrong first, until none is more wrong than the bound allows. As with
/// [`super::refine`], triangles that meet at an edge cut it alike. `contours` are of the same
/// surface, however it is divided.
pub(crate) fn refine(
    mut mesh: Mesh,
    contours: &ContourMesh,
    bound: Bound,
    monitor: Monitor,
) -> Result<Mesh, Interrupted> {
    let comparison = Comparison::new(contours);
    let mut ssdfs: HashMap<u32, Coarse> = HashMap::new();
    let mut known: HashSet<[u32; 2]> = HashSet::new();
    let mut wrong: Vec<Wrong> = Vec::new();
    for _ in 0..MAX_ROUNDS {
        let edges: Vec<Edge> = (edges(&mesh).into_iter())
            .filter(|edge| {
                let [a, b] = ends(&mesh, edge);
                let long = bound.length(a, b) > bound.min_edge;
                cut(a, b, long).is_some() && known.insert(edge.vertices)
            })
            .collect();
        sample_ends(&mesh, &edges, &mut ssdfs, &comparison, bound, monitor)?;
        let points: Vec<Point> = edges
            .iter()
            .map(|edge| middle(&mesh, edge, bound))
            .collect();
        let length = |edge: &Edge| {
            let [a, b] = ends(&mesh, edge);
            bound.length(a, b)
        };
        let found = comparison.sample(&points, monitor, |index, middle, normal| {
            let edge = &edges[index];
            let ends = edge.vertices.map(|vertex| &ssdfs[&vertex]);
            let error = comparison.error(&middle, ends, normal) * (length(edge) / bound.edge);
            (error > bound.error).then(|| Wrong {
                error,
                vertices: edge.vertices,
                middle: coarse(&middle),
            })
        })?;
        wrong.extend(found.into_iter().flatten());
        let at = |edge: &Wrong| {
            let [a, b] = edge.vertices.map(|vertex| position(&mesh, vertex));
            key(a, b)
        };
        wrong.sort_by_cached_key(|edge| (Reverse(edge.error.to_bits()), at(edge), edge.vertices));
        let room = bound.max_vertices.saturating_sub(mesh.vertices.len());
        if wrong.is_empty() || room == 0 {
            break;
        }
        // With less room than edges, what the worst of them leave may be worse than the rest.
        let count = if wrong.len() > room {
            room.div_ceil(2)
        } else {
            wrong.len()
        };
        let chosen: HashSet<Key> = wrong[..count].iter().map(at).collect();
        let middles = divide(&mut mesh, |a, b| {
            chosen.contains(&key(a, b)).then(|| cut(a, b, true))?
        });
        wrong.retain_mut(|edge| {
            let vertex = middles.get(&edge.vertices);
            if let Some(vertex) = vertex {
                ssdfs.insert(*vertex, std::mem::take(&mut edge.middle));
            }
            vertex.is_none()
        });
    }
    if !wrong.is_empty() {
        mesh.warnings.push(format!(
            "refinement stopped at {} of at most {} vertices; {} edges are left that are off by \
             more than {} rad, at {} of their things' size",
            mesh.vertices.len(),
            bound.max_vertices,
            wrong.len(),
            bound.error,
            bound.edge,
        ));
    }
    Ok(mesh)
}

fn position(mesh: &Mesh, vertex: u32) -> Vec3 {
    mesh.vertices[vertex as usize].position
}

fn ends(mesh: &Mesh, edge: &Edge) -> [Vec3; 2] {
    edge.vertices.map(|vertex| position(mesh, vertex))
}

/// Every edge once, in the order of its vertices.
fn edges(mesh: &Mesh) -> Vec<Edge> {
    let mut sides: Vec<([u32; 2], usize)> = (mesh.triangles.iter().enumerate())
        .flat_map(|(index, triangle)| {
            sides(triangle.vertices).map(|[a, b]| ([a.min(b), a.max(b)], index))
        })
        .collect();
    sides.par_sort_unstable();
    let normal = |triangle: usize| {
        let [a, b, c] = mesh.corners(&mesh.triangles[triangle]);
        (b - a).cross(c - a)
    };
    sides
        .chunk_by(|a, b| a.0 == b.0)
        .map(|sides| Edge {
            vertices: sides[0].0,
            normal: sides.iter().map(|&(_, triangle)| normal(triangle)).sum(),
        })
        .collect()
}

/// Where the vertex will be sampled that a cut makes.
fn middle(mesh: &Mesh, edge: &Edge, bound: Bound) -> Point {
    let [a, b] = edge.vertices.map(|vertex| &mesh.vertices[vertex as usize]);
    let position = (a.position + b.position) * 0.5;
    Point {
        origin: position + bound.ray_offset * edge.normal.normalize_or_zero(),
        normal: (a.normal + b.normal).normalize_or_zero(),
    }
}

/// Samples those ends of edges that are not known yet.
fn sample_ends(
    mesh: &Mesh,
    edges: &[Edge],
    ssdfs: &mut HashMap<u32, Coarse>,
    comparison: &Comparison,
    bound: Bound,
    monitor: Monitor,
) -> Result<(), Interrupted> {
    let mut missing: Vec<u32> = (edges.iter().flat_map(|edge| edge.vertices))
        .filter(|vertex| !ssdfs.contains_key(vertex))
        .collect();
    missing.sort_unstable();
    missing.dedup();
    if missing.is_empty() {
        return Ok(());
    }
    let triangles = mesh.indices();
    let caster = comparison.contours.caster();
    let positions = mesh.positions();
    let places = Places::new(
        &positions,
        &triangles,
        caster,
        bound.ray_offset,
        EXPOSURE_RESOLUTION,
    );
    // Of a vertex on several sides any will do.
    let mut place_of = vec![0; mesh.vertices.len()];
    for (triangle, corners) in triangles.iter().zip(&places.corners) {
        for (vertex, place) in triangle.iter().zip(corners) {
            place_of[*vertex as usize] = *place;
        }
    }
    let points: Vec<Point> = (missing.iter())
        .map(|&vertex| Point {
            origin: places.origins[place_of[vertex as usize] as usize],
            normal: Vec3::ZERO,
        })
        .collect();
    let found = comparison.sample(&points, monitor, |_, ssdf, _| coarse(&ssdf))?;
    ssdfs.extend(missing.into_iter().zip(found));
    Ok(())
}

fn coarse(ssdf: &[f32]) -> Coarse {
    (ssdf.iter())
        .map(|distance| (distance * (127.0 / CLAMP)).round() as i8)
        .collect()
}

impl<'a> Comparison<'a> {
    fn new(contours: &'a ContourMesh) -> Self {
        Self {
            contours,
            sampler: ssdf::Sampler::new(SAMPLE_RESOLUTION, RESOLUTION, CLAMP),
            weighting: Weighting::new(RESOLUTION),
        }
    }

    /// Calls `use_ssdf` with the number, SSDF and normal of every point, and collects what it
    /// returns in the points' order.
    fn sample<T: Send>(
        &self,
        points: &[Point],
        monitor: Monitor,
        use_ssdf: impl Fn(usize, Vec<f32>, Vec3) -> T + Sync,
    ) -> Result<Vec<T>, Interrupted> {
        let mut found: Vec<Option<T>> = points.iter().map(|_| None).collect();
        let sampled = (points.iter().enumerate().zip(&mut found))
            .map(|((index, point), found)| (point.origin, (index, found)))
            .collect();
        let done = AtomicUsize::new(0);
        self.sampler
            .sample(self.contours, sampled, |(index, found), sampled| {
                let normal = points[*index].normal;
                **found = Some(use_ssdf(*index, sampled.distances, normal));
                let before = done.fetch_add(1, Ordering::Relaxed);
                monitor.step("refine", before as f32 / points.len() as f32)
            })?;
        Ok(found.into_iter().flatten().collect())
    }

    /// How wrong the mean of the ends is in the middle.
    fn error(&self, middle: &[f32], ends: [&Coarse; 2], normal: Vec3) -> f32 {
        let normal = Normal {
            direction: normal,
            tilt: 0.0,
        };
        let mean: Vec<f32> = (ends[0].iter())
            .zip(ends[1])
            .map(|(a, b)| (f32::from(*a) + f32::from(*b)) * (0.5 * CLAMP / 127.0))
            .collect();
        let squared = self.weighting.squared_displacement(&mean, middle, normal);
        squared.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use glam::Vec3Swizzles;

    use super::*;
    use crate::mesh::{Triangle, Vertex};
    use crate::monitor::SILENT;

    fn vertex(position: Vec3, normal: Vec3) -> Vertex {
        Vertex {
            position,
            normal,
            tangent: Vec3::X,
            bitangent_sign: 1.0,
            uv: position.xz(),
            second_uv: position.yx(),
        }
    }

    fn quad(mesh: &mut Mesh, corners: [Vec3; 4]) {
        let base = mesh.vertices.len() as u32;
        let normal = (corners[1] - corners[0])
            .cross(corners[2] - corners[0])
            .normalize();
        mesh.vertices
            .extend(corners.map(|corner| vertex(corner, normal)));
        for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
            mesh.triangles.push(Triangle {
                vertices: [base + a, base + b, base + c],
                material: 0,
            });
        }
    }

    /// A thin wall on one side of a wide floor of two triangles.
    fn wall() -> Mesh {
        let mut mesh = Mesh::default();
        let p = Vec3::new;
        quad(
            &mut mesh,
            [
                p(-4.0, 0.0, -4.0),
                p(-4.0, 0.0, 4.0),
                p(4.0, 0.0, 4.0),
                p(4.0, 0.0, -4.0),
            ],
        );
        quad(
            &mut mesh,
            [
                p(2.0, 0.01, 0.3),
                p(2.3, 0.01, 0.3),
                p(2.3, 1.0, 0.3),
                p(2.0, 1.0, 0.3),
            ],
        );
        mesh
    }

    /// Of a scene of one size, 10 metres.
    fn bound(error: f32) -> Bound<'static> {
        static SIZES: LazyLock<SizeFunction> = LazyLock::new(|| SizeFunction::even(10.0));
        Bound {
            error,
            edge: 0.1,
            min_edge: 0.02,
            sizes: &SIZES,
            max_vertices: 100_000,
            ray_offset: 1e-3,
        }
    }

    fn refined(bound: Bound) -> Mesh {
        let contours = ContourMesh::new(&wall().soup());
        refine(wall(), &contours, bound, SILENT).unwrap()
    }

    #[test]
    fn cuts_gather_where_shadows_change() {
        let mesh = refined(bound(0.03));
        let near = |vertex: &&Vertex| vertex.position.distance(Vec3::new(2.15, 0.0, 0.3)) < 1.2;
        let close = mesh.vertices.iter().filter(near).count();
        let floor = 64.0;
        let share = std::f32::consts::PI * 1.2f32.powi(2) / floor;
        let expected = share * mesh.vertices.len() as f32;
        assert!(mesh.vertices.len() > 100, "{}", mesh.vertices.len());
        assert!(close as f32 > 3.0 * expected, "{close}, {expected} if even");
    }

    #[test]
    fn the_most_wrong_edges_come_first_and_the_bound_holds() {
        let all = refined(bound(0.02)).vertices.len();
        let limited = Bound {
            max_vertices: all / 2,
            ..bound(0.02)
        };
        let mesh = refined(limited);
        assert!(mesh.vertices.len() <= all / 2);
        assert_eq!(mesh.warnings.len(), 1, "{:?}", mesh.warnings);
    }

    #[test]
    fn no_edge_gets_a_vertex_on_one_side_alone() {
        let mesh = refined(bound(0.05));
        let at = |vertex: u32| position(&mesh, vertex);
        let sides: Vec<[Vec3; 2]> = (mesh.triangles.iter())
            .flat_map(|triangle| sides(triangle.vertices.map(at)))
            .collect();
        let keys: HashSet<Key> = sides.iter().map(|&[a, b]| key(a, b)).collect();
        for [a, b] in sides {
            let middle = (a + b) * 0.5;
            assert!(
                !(keys.contains(&key(a, middle)) && keys.contains(&key(middle, b))),
                "{a} to {b} is whole on one side and cut on the other"
            );
        }
    }

    #[test]
    fn threads_do_not_matter() {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let mesh = pool.build().unwrap().install(|| refined(bound(0.05)));
            (mesh.vertices, mesh.triangles.len())
        };
        assert_eq!(on(1), on(3));
    }
}
