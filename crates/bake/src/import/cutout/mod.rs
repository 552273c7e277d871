//! Alpha masks -> geometry: triangles are cut along the line where a texture's alpha crosses the
//! threshold, and what is transparent is dropped.
//!
//! So everything after the import is right without knowing of alpha: visibility, light inside the
//! scene, bounces, pictures, truth. Two triangles that share an edge and its texture coordinates
//! cut it at the same points, bit by bit, so that no crack opens.

mod contour;

use std::cmp::Ordering;
use std::collections::HashMap;

use glam::{DVec2, DVec3, Vec3};
use relight_format::{Texture, TextureSlot, math};
use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, Triangulation as _};

pub(super) use self::contour::Wrap;
use self::contour::{Contours, Mask};
use super::build::face_normal;
use crate::mesh::{Vertex, tangent};

/// Most a cut may be off, texels. A finer one does not change pictures, a coarser one does.
const TOLERANCE: f64 = 0.25;
/// What a cut may always be off by, diagonals of the mesh: a tenth of a pixel of a picture that
/// shows all of it.
const RELATIVE_TOLERANCE: f64 = 5e-5;
/// Largest tolerance, in sides of the texture.
const COARSEST: f64 = 1.0 / 32.0;
/// Part of what outlines enclose that may be lost for fewer triangles: needles and small leaves get thinner, and are left out, where they
/// are not much wider than the tolerance.
const MOST_LOST: f64 = 0.02;
/// Most squares of contours looked at for all triangles of a material, which bounds the time.
const MAX_WORK: f64 = (1u64 << 24) as f64;
/// Most pieces of contours in one triangle.
const MAX_NEAR: usize = 1 << 18;
/// Texture coordinates beyond this many texels are no coordinates.
const MAX_COORDINATE: f64 = 1e9;
/// Steps along an edge.
const STEPS: f64 = (1u64 << 32) as f64;

/// Which channel of a texture is its alpha.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channel {
    Red,
    Alpha,
}

/// What a material cuts away.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Cutout {
    /// Index into the textures given to [`super::build::Builder::finish`], with its transform.
    pub slot: TextureSlot,
    pub channel: Channel,
    pub wrap: [Wrap; 2],
    /// Multiplies what the texture holds.
    pub factor: f32,
    /// Smaller alpha is cut away.
    pub(crate) cutoff: f32,
}

/// Why triangles cannot be cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum TooMuch {
    /// Texture coordinates are beyond all measure.
    Coordinates,
    /// The texture repeats so often that the line is this long, in squares.
    Contours,
    /// More than so many triangles would come of it.
    Triangles(usize),
}

/// What became of some triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Outcome {
    pub triangles: Vec<[u32; 3]>,
    /// Triangles that were divided, and that were dropped.
    pub divided: usize,
    pub dropped: usize,
    /// Triangles without area in the texture.
    pub flat: usize,
    /// How far the cut is off, texels.
    pub tolerance: f64,
    /// Whether that is more than it had to be, for fewer triangles.
    pub coarser: bool,
}

/// How many triangles may come of some.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bound {
    /// So many if outlines can be as coarse as that takes and still enclose nearly as much.
    pub wanted: usize,
    /// In any case.
    pub most: usize,
}

/// Cuts triangles; vertices are appended. `diagonal` is the whole mesh's, metres.
pub(super) fn cut(
    vertices: &mut Vec<Vertex>,
    triangles: &[[u32; 3]],
    cutout: &Cutout,
    texture: &Texture,
    diagonal: f32,
    Bound { wanted, most }: Bound,
) -> Result<Outcome, TooMuch> {
    let mask = mask(cutout, texture);
    let whole = Outcome {
        triangles: triangles.to_vec(),
        ..Outcome::default()
    };
    match mask.uniform() {
        Some(true) => return Ok(whole),
        Some(false) => {
            let dropped = triangles.len();
            return Ok(Outcome {
                dropped,
                ..Outcome::default()
            });
        }
        None => {}
    }
    let size = DVec2::new(f64::from(texture.width), f64::from(texture.height));
    let place = |vertex: &Vertex| {
        let rows = (cutout.slot.transform).map(|row| row.map(f64::from));
        let uv = if cutout.slot.second_uv {
            vertex.second_uv
        } else {
            vertex.uv
        };
        let uv = uv.as_dvec2();
        DVec2::from(rows.map(|[a, b, c]| a * uv.x + b * uv.y + c)) * size
    };
    let coordinates: Vec<DVec2> = vertices.iter().map(place).collect();
    let within = |point: &DVec2| point.abs().max_element() <= MAX_COORDINATE;
    if !coordinates.iter().all(within) {
        return Err(TooMuch::Coordinates);
    }
    // Metres per texel where the texture is largest.
    let scale = triangles.iter().map(|triangle| {
        let [a, b, c] = triangle.map(|index| vertices[index as usize].position.as_dvec3());
        let [p, q, r] = triangle.map(|index| coordinates[index as usize]);
        let texels = (q - p).perp_dot(r - p).abs();
        ((b - a).cross(c - a).length() / texels.max(1e-6)).sqrt()
    });
    let scale = scale.fold(f64::MIN_POSITIVE, f64::max);
    let coarsest = (size.min_element() * COARSEST).max(TOLERANCE);
    let unseen = RELATIVE_TOLERANCE * f64::from(diagonal) / scale;
    let finest = unseen.clamp(TOLERANCE, coarsest);
    let mut tolerance = finest;
    let before = vertices.len();
    let lines = mask.lines().ok_or(TooMuch::Contours)?;
    let mut contours = mask.contours(&lines, tolerance);
    let mut bound = wanted.min(most);
    loop {
        let mut knife = Knife {
            mask: &mask,
            contours: &contours,
            coordinates: coordinates.clone(),
            vertices,
            on_edges: HashMap::new(),
            outcome: Outcome {
                tolerance,
                coarser: tolerance > finest,
                ..Outcome::default()
            },
            work: 0.0,
        };
        let result = triangles.iter().try_for_each(|&t| knife.cut(t, bound));
        match result {
            Ok(()) => return Ok(knife.outcome),
            Err(TooMuch::Triangles(_)) if tolerance < coarsest || bound < most => {}
            Err(error) => return Err(error),
        }
        vertices.truncate(before);
        let coarser = (tolerance * 2.0).min(coarsest);
        let coarse = mask.contours(&lines, coarser);
        if bound < most && (tolerance == coarsest || coarse.lost > MOST_LOST * coarse.enclosed) {
            bound = most;
        } else {
            (tolerance, contours) = (coarser, coarse);
        }
    }
}

fn mask(cutout: &Cutout, texture: &Texture) -> Mask {
    // In steps of a texel's byte, and between two of them, where no texel lies.
    let threshold = cutout.cutoff / cutout.factor.max(f32::MIN_POSITIVE) * 255.0 - 0.01;
    let threshold = threshold.min(1e6);
    Mask::new([texture.width, texture.height], cutout.wrap, |x, y| {
        let texel = 4 * (y as usize * texture.width as usize + x as usize);
        let channel = match cutout.channel {
            Channel::Red => 0,
            Channel::Alpha => 3,
        };
        f32::from(texture.texels[texel + channel]) - threshold
    })
}

/// A point of a triangle while it is cut: its weights of the triangle's corners times [`STEPS`]
/// are whole numbers, and add up to that.
#[derive(Clone, Copy)]
struct Point {
    at: Point2<f64>,
    index: u32,
}

impl HasPosition for Point {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.at
    }
}

struct Knife<'a> {
    mask: &'a Mask,
    contours: &'a Contours<'a>,
    /// Texels, of every vertex.
    coordinates: Vec<DVec2>,
    vertices: &'a mut Vec<Vertex>,
    /// Vertices on edges, by the edge's ends and the weight of the second.
    on_edges: HashMap<([u32; 2], u64), u32>,
    outcome: Outcome,
    work: f64,
}

impl Knife<'_> {
    fn cut(&mut self, triangle: [u32; 3], most: usize) -> Result<(), TooMuch> {
        let q = triangle.map(|index| self.coordinates[index as usize]);
        let (low, high) = (q[0].min(q[1]).min(q[2]), q[0].max(q[1]).max(q[2]));
        self.work += self.contours.count(low, high);
        if self.work > MAX_WORK {
            return Err(TooMuch::Contours);
        }
        let area = (q[1] - q[0]).perp_dot(q[2] - q[0]);
        let near = if area.abs() < f64::EPSILON {
            self.outcome.flat += 1;
            Vec::new()
        } else {
            let near = self.contours.near(low, high, MAX_NEAR);
            near.ok_or(TooMuch::Triangles(most))?
        };
        self.work += near.len() as f64;
        let crossed = self.divide(triangle, q, area, &near);
        if crossed.is_empty() {
            if self.keeps(q) {
                self.outcome.triangles.push(triangle);
            } else {
                self.outcome.dropped += 1;
            }
        } else {
            self.outcome.divided += 1;
            for piece in crossed {
                let corners = piece.map(|index| self.vertices[index as usize].position);
                let kept = self.keeps(piece.map(|index| self.coordinates[index as usize]));
                if kept && face_normal(corners).is_some() {
                    self.outcome.triangles.push(piece);
                }
            }
        }
        if self.outcome.triangles.len() > most {
            return Err(TooMuch::Triangles(most));
        }
        Ok(())
    }

    /// Whether most of a triangle that no contour crosses is kept.
    fn keeps(&self, q: [DVec2; 3]) -> bool {
        const WEIGHTS: [([f64; 3], u32); 4] = [
            ([1.0 / 3.0; 3], 2),
            ([0.6, 0.2, 0.2], 1),
            ([0.2, 0.6, 0.2], 1),
            ([0.2, 0.2, 0.6], 1),
        ];
        let votes: u32 = (WEIGHTS.iter())
            .filter(|([a, b, c], _)| self.mask.at(q[0] * *a + q[1] * *b + q[2] * *c) >= 0.0)
            .map(|(_, votes)| votes)
            .sum();
        votes >= 3
    }

    /// Triangles that the contours divide one into; none if they do not cross it.
    fn divide(
        &mut self,
        triangle: [u32; 3],
        q: [DVec2; 3],
        area: f64,
        near: &[(u32, [i32; 2])],
    ) -> Vec<[u32; 3]> {
        let edges = [0, 1, 2].map(|k| self.edge(triangle, q, k));
        let mut sheet = Sheet::new(self.shape(triangle));
        for &(piece, tile) in near {
            let piece = self.contours.pieces[piece as usize];
            let tiles = [tile, [tile[0] + piece.step[0], tile[1] + piece.step[1]]];
            // Crossings with edges, and ends inside, along the piece.
            let mut stops: Vec<(f64, [u64; 3])> = Vec::new();
            let mut inside = [true; 2];
            for edge in &edges {
                let ends = [0, 1].map(|end| {
                    let moved = [0, 1].map(|axis| tiles[end][axis] - edge.tile[axis]);
                    self.contours.point(piece.ends[end], moved)
                });
                let side = ends.map(|end| (edge.to - edge.from).perp_dot(end - edge.from) >= 0.0);
                for end in 0..2 {
                    inside[end] &= side[end] == edge.left;
                }
                if side[0] == side[1] {
                    continue;
                }
                let along = ends[1] - ends[0];
                let [a, b] = [edge.from, edge.to].map(|corner| along.perp_dot(corner - ends[0]));
                if (a >= 0.0) == (b >= 0.0) {
                    continue;
                }
                let weight = (a / (a - b) * STEPS).round().clamp(0.0, STEPS) as u64;
                let mut weights = [0; 3];
                weights[edge.corners[1]] = weight;
                weights[edge.corners[0]] = STEPS as u64 - weight;
                let at = edge.from + (edge.to - edge.from) * (weight as f64 / STEPS);
                stops.push(((at - ends[0]).dot(along), weights));
            }
            for end in 0..2 {
                if inside[end] {
                    let point = self.contours.point(piece.ends[end], tiles[end]);
                    let other = self.contours.point(piece.ends[1 - end], tiles[1 - end]);
                    let along = if end == 0 {
                        other - point
                    } else {
                        point - other
                    };
                    let s = if end == 0 {
                        -1.0
                    } else {
                        along.length_squared() + 1.0
                    };
                    stops.push((s, weights_inside(q, area, point)));
                }
            }
            stops.sort_by(|a, b| a.0.total_cmp(&b.0));
            sheet.constrain(stops.iter().map(|(_, weights)| *weights));
        }
        if sheet.points.len() == 3 {
            return Vec::new();
        }
        let indices: Vec<u32> = (sheet.points.iter())
            .map(|weights| self.vertex(triangle, q, *weights))
            .collect();
        let faces = sheet.triangulation.inner_faces();
        faces
            .map(|face| face.vertices().map(|v| indices[v.data().index as usize]))
            .collect()
    }

    /// The edge from corner `k` on, its ends in an order that all triangles agree on.
    fn edge(&self, triangle: [u32; 3], q: [DVec2; 3], k: usize) -> Edge {
        let (a, b) = (k, (k + 1) % 3);
        let order = self.order(triangle[a], triangle[b]);
        let corners = if order == Ordering::Greater {
            [b, a]
        } else {
            [a, b]
        };
        let [from, to] = corners.map(|corner| q[corner]);
        let tile = self.contours.tile(from);
        let back = tile.map(|index| -index);
        let left = (to - from).perp_dot(q[(k + 2) % 3] - from) > 0.0;
        Edge {
            corners,
            tile,
            from: self.contours.moved(from, back),
            to: self.contours.moved(to, back),
            left,
        }
    }

    /// By position, then by texture coordinates.
    fn order(&self, a: u32, b: u32) -> Ordering {
        let key = |index: u32| {
            let Vertex {
                position: p,
                uv: a,
                second_uv: b,
                ..
            } = self.vertices[index as usize];
            [p.x, p.y, p.z, a.x, a.y, b.x, b.y]
        };
        let pairs = key(a).into_iter().zip(key(b));
        pairs
            .map(|(a, b)| (a + 0.0).total_cmp(&(b + 0.0)))
            .find(|order| order.is_ne())
            .unwrap_or(Ordering::Equal)
    }

    /// The corner to measure the others from, where the angle is nearest to a right one, and how
    /// many times as long as the third's the second's side is, a power of two.
    fn shape(&self, triangle: [u32; 3]) -> (usize, f64) {
        let position = |k: usize| self.vertices[triangle[k % 3] as usize].position.as_dvec3();
        let sides = |k: usize| [position(k + 1) - position(k), position(k + 2) - position(k)];
        let slant = |k: usize| {
            let [a, b] = sides(k).map(DVec3::normalize_or_zero);
            a.dot(b).abs()
        };
        let first = (0..3)
            .min_by(|&a, &b| slant(a).total_cmp(&slant(b)))
            .unwrap_or(0);
        let [a, b] = sides(first).map(|side| side.length().max(f64::MIN_POSITIVE));
        let exponent = math::log2(a / b).round().clamp(-30.0, 30.0);
        (first, math::exp2(exponent))
    }

    /// The vertex with these weights of the corners.
    fn vertex(&mut self, triangle: [u32; 3], q: [DVec2; 3], weights: [u64; 3]) -> u32 {
        let zeros = weights.iter().filter(|weight| **weight == 0).count();
        if zeros == 2 {
            let corner = weights.iter().position(|weight| *weight > 0).unwrap_or(0);
            return triangle[corner];
        }
        let w = weights.map(|weight| weight as f64 / STEPS);
        let place = q[0] * w[0] + q[1] * w[1] + q[2] * w[2];
        if zeros == 0 {
            let w = w.map(|weight| weight as f32);
            let [a, b, c] = triangle.map(|index| self.vertices[index as usize]);
            let vertex = Vertex {
                position: a.position * w[0] + b.position * w[1] + c.position * w[2],
                uv: a.uv * w[0] + b.uv * w[1] + c.uv * w[2],
                second_uv: a.second_uv * w[0] + b.second_uv * w[1] + c.second_uv * w[2],
                ..framed(
                    a,
                    a.normal * w[0] + b.normal * w[1] + c.normal * w[2],
                    a.tangent * w[0] + b.tangent * w[1] + c.tangent * w[2],
                )
            };
            return self.push(vertex, place);
        }
        let third = weights.iter().position(|weight| *weight == 0).unwrap_or(0);
        let mut ends = [(third + 1) % 3, (third + 2) % 3];
        if self.order(triangle[ends[0]], triangle[ends[1]]) == Ordering::Greater {
            ends.swap(0, 1);
        }
        let key = (ends.map(|end| triangle[end]), weights[ends[1]]);
        if let Some(&known) = self.on_edges.get(&key) {
            return known;
        }
        let [a, b] = key.0.map(|index| self.vertices[index as usize]);
        let t = w[ends[1]] as f32;
        let between = |a: Vec3, b: Vec3| a + (b - a) * t;
        let vertex = Vertex {
            position: between(a.position, b.position),
            uv: a.uv + (b.uv - a.uv) * t,
            second_uv: a.second_uv + (b.second_uv - a.second_uv) * t,
            ..framed(
                a,
                between(a.normal, b.normal),
                between(a.tangent, b.tangent),
            )
        };
        let index = self.push(vertex, place);
        self.on_edges.insert(key, index);
        index
    }

    fn push(&mut self, vertex: Vertex, place: DVec2) -> u32 {
        self.vertices.push(vertex);
        self.coordinates.push(place);
        self.vertices.len() as u32 - 1
    }
}

/// A vertex with a unit frame near these directions, else its own.
fn framed(vertex: Vertex, normal: Vec3, along: Vec3) -> Vertex {
    let normal = normal.try_normalize().unwrap_or(vertex.normal);
    let tangent = tangent::orthogonal(normal, along);
    Vertex {
        normal,
        tangent: tangent.unwrap_or_else(|| tangent::around_axis(normal)),
        ..vertex
    }
}

/// An edge of a triangle as it is in the texture, moved into the first tile.
struct Edge {
    /// Which corners of the triangle its ends are.
    corners: [usize; 2],
    from: DVec2,
    to: DVec2,
    /// Where it was.
    tile: [i32; 2],
    /// Whether the triangle lies on its left.
    left: bool,
}

/// Weights of a point inside a triangle, none of them zero.
fn weights_inside(q: [DVec2; 3], area: f64, point: DVec2) -> [u64; 3] {
    let weight = |k: usize| {
        let [a, b] = [q[(k + 1) % 3] - point, q[(k + 2) % 3] - point];
        let part = (a.perp_dot(b) / area * STEPS).round();
        part.clamp(1.0, STEPS - 2.0) as u64
    };
    let total = STEPS as u64;
    let first = weight(0);
    let second = weight(1).min(total - first - 1);
    [first, second, total - first - second]
}

/// A triangle that is being divided, in a plane where coordinates are exact: its first corner is
/// (0, 0), and the others lie on the axes.
struct Sheet {
    triangulation: ConstrainedDelaunayTriangulation<Point>,
    /// Weights of every point, the corners first.
    points: Vec<[u64; 3]>,
    known: HashMap<[u64; 3], spade::handles::FixedVertexHandle>,
    first: usize,
    stretch: f64,
}

impl Sheet {
    fn new((first, stretch): (usize, f64)) -> Self {
        let mut sheet = Self {
            triangulation: ConstrainedDelaunayTriangulation::new(),
            points: Vec::new(),
            known: HashMap::new(),
            first,
            stretch,
        };
        for corner in 0..3 {
            let mut weights = [0; 3];
            weights[corner] = STEPS as u64;
            sheet.insert(weights);
        }
        sheet
    }

    fn insert(&mut self, weights: [u64; 3]) -> Option<spade::handles::FixedVertexHandle> {
        if let Some(known) = self.known.get(&weights) {
            return Some(*known);
        }
        let along = |step: usize| weights[(self.first + step) % 3] as f64 / STEPS;
        let at = Point2::new(along(1) * self.stretch, along(2));
        let index = self.points.len() as u32;
        // Refuses only what is not finite.
        let handle = self.triangulation.insert(Point { at, index }).ok()?;
        self.points.push(weights);
        self.known.insert(weights, handle);
        Some(handle)
    }

    /// Joins points by edges, unless they cross others: the first come stay.
    fn constrain(&mut self, points: impl Iterator<Item = [u64; 3]>) {
        let mut before = None;
        for weights in points {
            let handle = self.insert(weights);
            if let (Some(a), Some(b)) = (before, handle)
                && a != b
            {
                self.triangulation.try_add_constraint(a, b);
            }
            before = handle;
        }
    }
}

#[cfg(test)]
mod tests;
