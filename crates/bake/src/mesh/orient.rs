//! Closed pieces of a mesh that are inside out.
//!
//! The front of a triangle is the side from which its corners run counter-clockwise; its back is
//! never lit. A closed piece whose fronts all look inwards is a room, or was exported inside out.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::hash::Hash;

use glam::{DVec3, I64Vec3, Vec3};
use rayon::prelude::*;
use relight_format::math;

use super::refine::sides;
use super::{Mesh, Triangle, Vertex};

/// Volume of an inside-out piece, in cubes of its diagonal, below which its sign may be rounding.
const LEAST_VOLUME: f64 = 1e-9;
/// Vertices on open edges that are so close together, in diagonals of what they belong to, are one: programs compute the
/// two sides of a seam each by itself.
const SAME_PLACE: f64 = 1e-6;
/// The part of a piece's triangles that must wind against their own normals for the winding to be
/// what is wrong.
const SURELY: f64 = 0.9;
/// Part of all directions in which the middle of an open piece must see its fronts for it to be taken for a closed one with
/// a gap, such as a column without its ends.
const SURROUNDED: f64 = 0.6;
/// Fewest closed pieces inside out that tell that all of a file is.
const LEAST_PIECES: usize = 4;
/// Most pairs of pieces that are looked at, one of which may lie in the other.
const MAX_WORK: usize = 1 << 30;

/// A set of triangles that share edges.
#[derive(Clone, Copy)]
struct Piece {
    origin: Vec3,
    low: Vec3,
    high: Vec3,
    /// Six times what it encloses, m³.
    volume: f64,
    /// Whether every edge joins two triangles that wind alike.
    closed: bool,
    triangles: usize,
    /// Those that wind against the normals of all their vertices.
    against: usize,
    /// Of an open piece the part of all directions in which its middle sees backs, less that in which it sees fronts
    /// (generalised winding number, Jacobson et al. 2013): of a closed one that faces inwards −1.
    winding: f64,
}

impl Piece {
    fn is_inside_out(&self) -> bool {
        self.closed && self.volume < -LEAST_VOLUME * self.cube()
    }

    /// Whether it is open and faces inwards nearly all about its middle.
    fn opens_inwards(&self) -> bool {
        !self.closed && self.winding < -SURROUNDED
    }

    /// Of its diagonal, m³.
    fn cube(&self) -> f64 {
        f64::from(self.low.distance(self.high)).powi(3)
    }

    /// Whether its normals show that its triangles wind the wrong way.
    fn winds_against_normals(&self) -> bool {
        self.against as f64 >= SURELY * self.triangles as f64
            && (self.is_inside_out() || !self.closed)
    }

    /// Whether a point lies within its box, and not on it.
    fn surrounds(&self, point: Vec3) -> bool {
        point.cmpgt(self.low).all() && point.cmplt(self.high).all()
    }
}

/// Turns pieces about that would be black: closed ones whose fronts look inwards, if nothing lies in
/// them that could be seen there, and those that wind against their own normals. Returns warnings.
pub(crate) fn mend(mesh: &mut Mesh) -> Vec<String> {
    let (of, pieces) = pieces(mesh);
    let mut turn: Vec<bool> = pieces.iter().map(Piece::winds_against_normals).collect();
    let against = turn.iter().filter(|turn| **turn).count();
    let mut inside_out: Vec<usize> = (0..pieces.len())
        .filter(|&piece| pieces[piece].is_inside_out() && !turn[piece])
        .collect();
    let mut opening: Vec<usize> = (0..pieces.len())
        .filter(|&piece| pieces[piece].opens_inwards() && !turn[piece])
        .collect();
    if (inside_out.len() + opening.len()).saturating_mul(pieces.len()) > MAX_WORK {
        inside_out.clear();
        opening.clear();
    }
    if against == 0 && inside_out.is_empty() && opening.is_empty() {
        return Vec::new();
    }
    let hollow = |piece: &usize| {
        let outer = &pieces[*piece];
        let holds = |outer: &Piece, inner: &Piece| {
            outer.surrounds(inner.low) && outer.surrounds(inner.high)
        };
        // What lies in another closed piece may be its inner side.
        let rules_out = |other: &Piece| {
            holds(outer, other) || other.closed && other.volume > 0.0 && holds(other, outer)
        };
        !pieces.iter().any(rules_out)
    };
    opening.retain(hollow);
    let (turned, left): (Vec<usize>, Vec<usize>) = inside_out.into_iter().partition(hollow);
    for piece in &turned {
        turn[*piece] = true;
    }
    // Where all closed pieces are inside out, and most pieces are closed, the file is: those with a
    // gap or an edge too many are as well.
    let outwards = |piece: &Piece| piece.closed && !piece.is_inside_out();
    let all = turned.len() >= LEAST_PIECES
        && 4 * turned.len() >= 3 * pieces.len()
        && left.is_empty()
        && !pieces.iter().any(outwards);
    if all {
        turn.fill(true);
        opening.clear();
    }
    // Normals that disagree with their triangles are right already.
    let mut votes = vec![0i32; mesh.vertices.len()];
    for (triangle, piece) in mesh.triangles.iter().zip(&of) {
        if turn[*piece] {
            let [a, b, c] = mesh.corners(triangle).map(Vec3::as_dvec3);
            let face = (b - a).cross(c - a);
            for vertex in triangle.vertices {
                let normal = mesh.vertices[vertex as usize].normal.as_dvec3();
                votes[vertex as usize] += if face.dot(normal) > 0.0 { 1 } else { -1 };
            }
        }
    }
    for (triangle, piece) in mesh.triangles.iter_mut().zip(&of) {
        if turn[*piece] {
            triangle.vertices.swap(1, 2);
        }
    }
    for (vertex, votes) in mesh.vertices.iter_mut().zip(votes) {
        if votes > 0 {
            vertex.normal = -vertex.normal;
            vertex.bitangent_sign = -vertex.bitangent_sign;
        }
    }
    let mut warnings = Vec::new();
    if against > 0 {
        warnings.push(format!(
            "pieces that wind against their own normals are turned about: {against}"
        ));
    }
    if !turned.is_empty() {
        warnings.push(format!(
            "pieces that are inside out, with nothing in them, are turned about: {}",
            if all { pieces.len() } else { turned.len() }
        ));
    }
    if !left.is_empty() {
        warnings.push(format!(
            "closed pieces that face inwards, and that hold something or lie in something: {}; rooms, or \
             inside out, and black from outside",
            left.len()
        ));
    }
    if !opening.is_empty() {
        warnings.push(format!(
            "open pieces that face inwards nearly all around, with nothing in them: {}; rooms, or inside out, and \
             black from outside",
            opening.len()
        ));
    }
    warnings
}

/// Whether a triangle's corners run clockwise as all of its normals see them.
pub(crate) fn winds_against_normals(mesh: &Mesh, triangle: &Triangle) -> bool {
    let [a, b, c] = mesh.corners(triangle).map(Vec3::as_dvec3);
    let face = (b - a).cross(c - a);
    let away = |vertex: u32| face.dot(mesh.vertices[vertex as usize].normal.as_dvec3()) < 0.0;
    triangle.vertices.into_iter().all(away)
}

/// A number for every key, the same for the same.
fn numbered<K: Eq + Hash>(keys: impl ExactSizeIterator<Item = K>) -> Vec<u32> {
    let mut numbers = HashMap::with_capacity(keys.len());
    keys.map(|key| {
        let next = numbers.len() as u32;
        *numbers.entry(key).or_insert(next)
    })
    .collect()
}

/// Where a vertex is: by its number, or by the size of cells and which of them it lies in.
#[derive(PartialEq, Eq, Hash)]
enum Key {
    Exact(u32),
    Near(u64, I64Vec3),
}

/// A number for every vertex, the same for the same position and, where edges are open, for nearly the same.
fn weld(mesh: &Mesh) -> Vec<u32> {
    // Adding zero turns −0 into +0.
    let exact = |vertex: &Vertex| (vertex.position + Vec3::ZERO).to_array().map(f32::to_bits);
    let welded = numbered(mesh.vertices.iter().map(exact));
    let mut open = vec![false; welded.len()];
    for (ends, counts) in edges(mesh, &welded) {
        if counts != CLOSED {
            for end in ends {
                open[end as usize] = true;
            }
        }
    }
    if !open.contains(&true) {
        return welded;
    }
    let roots = roots(mesh, &welded);
    let mut boxes = vec![[Vec3::INFINITY, Vec3::NEG_INFINITY]; welded.len()];
    for (vertex, root) in mesh.vertices.iter().zip(&roots) {
        let [low, high] = &mut boxes[*root as usize];
        (*low, *high) = (low.min(vertex.position), high.max(vertex.position));
    }
    // A power of two, so that pieces of about the same size meet.
    let cell = |root: u32| {
        let [low, high] = boxes[root as usize];
        let size = (SAME_PLACE * f64::from(low.distance(high))).max(f64::MIN_POSITIVE);
        f64::from_bits(size.to_bits() >> 52 << 52)
    };
    let vertices = mesh.vertices.iter().zip(&welded).zip(roots);
    numbered(vertices.map(|((vertex, &number), root)| {
        if !open[number as usize] {
            return Key::Exact(number);
        }
        let cell = cell(root);
        let place = (vertex.position.as_dvec3() / cell).round();
        Key::Near(cell.to_bits(), place.as_i64vec3())
    }))
}

/// Of every vertex the least number of those that triangles connect it with.
fn roots(mesh: &Mesh, welded: &[u32]) -> Vec<u32> {
    let mut parents: Vec<u32> = (0..welded.len() as u32).collect();
    let find = |mut at: u32, parents: &mut Vec<u32>| {
        while parents[at as usize] != at {
            parents[at as usize] = parents[parents[at as usize] as usize];
            at = parents[at as usize];
        }
        at
    };
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.vertices.map(|vertex| welded[vertex as usize]);
        for other in [b, c] {
            let [a, b] = [a, other].map(|end| find(end, &mut parents));
            parents[a.max(b) as usize] = a.min(b);
        }
    }
    (welded.iter())
        .map(|number| find(*number, &mut parents))
        .collect()
}

/// Of an edge that joins two triangles that wind alike.
const CLOSED: [i32; 2] = [2, 0];

/// How many triangles run along every edge, and how many more one way than the other; in the order of their ends. Those
/// of which a side has no length are left out.
fn edges(mesh: &Mesh, welded: &[u32]) -> Vec<([u32; 2], [i32; 2])> {
    let sides_of = |triangle: &Triangle| {
        let sides = sides(triangle.vertices.map(|vertex| welded[vertex as usize]));
        let has_area = sides.iter().all(|[from, to]| from != to);
        (sides.into_iter().filter(move |_| has_area))
            .map(|[from, to]| ([from.min(to), from.max(to)], from < to))
    };
    let mut all = Vec::with_capacity(3 * mesh.triangles.len());
    all.extend(mesh.triangles.iter().flat_map(sides_of));
    all.par_sort_unstable();
    let edge = |sides: &[([u32; 2], bool)]| {
        let forwards = sides.iter().filter(|(_, forwards)| *forwards).count() as i32;
        let count = sides.len() as i32;
        (sides[0].0, [count, 2 * forwards - count])
    };
    all.chunk_by(|a, b| a.0 == b.0).map(edge).collect()
}

/// The piece of every triangle, and the pieces.
fn pieces(mesh: &Mesh) -> (Vec<usize>, Vec<Piece>) {
    let welded = weld(mesh);
    let edges = edges(mesh, &welded);
    let roots = roots(mesh, &welded);
    let mut of_number = vec![0; welded.len()];
    let mut names = vec![None; welded.len()];
    let mut pieces: Vec<Piece> = Vec::new();
    let mut of = Vec::with_capacity(mesh.triangles.len());
    for triangle in &mesh.triangles {
        let corners = mesh.corners(triangle);
        let first = triangle.vertices[0] as usize;
        let piece = *names[roots[first] as usize].get_or_insert_with(|| {
            pieces.push(Piece {
                origin: corners[0],
                low: corners[0],
                high: corners[0],
                volume: 0.0,
                closed: false,
                triangles: 0,
                against: 0,
                winding: 0.0,
            });
            pieces.len() - 1
        });
        of.push(piece);
        for vertex in triangle.vertices {
            of_number[welded[vertex as usize] as usize] = piece;
        }
        let piece = &mut pieces[piece];
        // From a corner of its own, so that far-off pieces keep their digits.
        let [a, b, c]: [DVec3; 3] = corners.map(|corner| (corner - piece.origin).as_dvec3());
        for corner in corners {
            piece.low = piece.low.min(corner);
            piece.high = piece.high.max(corner);
        }
        piece.volume += a.dot(b.cross(c));
        piece.triangles += 1;
        piece.against += usize::from(winds_against_normals(mesh, triangle));
    }
    // What is so thin that no edge is left is not closed.
    for closed in [true, false] {
        for ([a, _], counts) in &edges {
            if (*counts == CLOSED) == closed {
                pieces[of_number[*a as usize]].closed = closed;
            }
        }
    }
    for (triangle, piece) in mesh.triangles.iter().zip(&of) {
        let piece = &mut pieces[*piece];
        if !piece.closed {
            let middle = piece.low.as_dvec3() * 0.5 + piece.high.as_dvec3() * 0.5;
            let corners = mesh.corners(triangle);
            piece.winding += part_of_sphere(corners.map(|corner| corner.as_dvec3() - middle));
        }
    }
    (of, pieces)
}

/// The part of all directions in which a triangle is seen from the origin, negative where that is its front
/// (Van Oosterom & Strackee 1983).
fn part_of_sphere([a, b, c]: [DVec3; 3]) -> f64 {
    let [x, y, z] = [a, b, c].map(DVec3::length);
    let below = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
    math::atan2(a.dot(b.cross(c)), below) / TAU
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::tangent;

    /// A box, its normals outwards or not, its triangles as its normals or not.
    fn add_box(mesh: &mut Mesh, low: f32, high: f32, [normals, winding]: [bool; 2]) {
        let corner = |bits: usize| {
            let at = [0, 1, 2].map(|axis| if bits >> axis & 1 == 0 { low } else { high });
            Vec3::from(at)
        };
        let middle = Vec3::splat((low + high) * 0.5);
        let base = mesh.vertices.len() as u32;
        for bits in 0..8 {
            let out = (corner(bits) - middle).normalize();
            let normal = if normals { out } else { -out };
            mesh.vertices.push(Vertex {
                position: corner(bits),
                normal,
                tangent: tangent::around_axis(normal),
                bitangent_sign: 1.0,
                uv: glam::Vec2::ZERO,
                second_uv: glam::Vec2::ZERO,
            });
        }
        let faces = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        for [a, b, c, d] in faces {
            for mut vertices in [[a, b, c], [a, c, d]] {
                if !winding {
                    vertices.swap(1, 2);
                }
                let vertices = vertices.map(|vertex| base + vertex);
                mesh.triangles.push(Triangle {
                    vertices,
                    material: 0,
                });
            }
        }
    }

    fn faces_outwards(mesh: &Mesh, triangles: std::ops::Range<usize>, middle: Vec3) -> [bool; 2] {
        let all = mesh.triangles[triangles].iter();
        let winds = all.clone().all(|triangle| {
            let [a, b, c] = mesh.corners(triangle);
            (b - a).cross(c - a).dot(a - middle) > 0.0
        });
        let points = all.flat_map(|triangle| triangle.vertices).all(|vertex| {
            let vertex = mesh.vertices[vertex as usize];
            vertex.normal.dot(vertex.position - middle) > 0.0
        });
        [winds, points]
    }

    /// Mends a mesh, and tells whether triangles were turned.
    fn turns_any(mesh: &mut Mesh) -> bool {
        let before = mesh.triangles.clone();
        mend(mesh);
        mesh.triangles != before
    }

    #[test]
    fn an_inside_out_box_is_turned_whatever_its_normals() {
        for (normals, winding, warns) in [(true, true, 0), (false, false, 1), (true, false, 1)] {
            let mut mesh = Mesh::default();
            add_box(&mut mesh, 1.0, 2.0, [normals, winding]);
            add_box(&mut mesh, 4.0, 5.0, [true, true]);
            assert_eq!(mend(&mut mesh).len(), warns, "{normals} {winding}");
            for (range, middle) in [(0..12, 1.5), (12..24, 4.5)] {
                let found = faces_outwards(&mesh, range, Vec3::splat(middle));
                assert_eq!(found, [true; 2], "{normals} {winding}");
            }
        }
    }

    #[test]
    fn corners_that_meet_but_for_rounding_close_a_piece() {
        for (off, closes) in [(1e-17, true), (1e-7, true), (1e-3, false)] {
            let mut mesh = Mesh::default();
            add_box(&mut mesh, 0.0, 1.0, [false, false]);
            // The last two faces get vertices of their own.
            let vertices = mesh.vertices.clone();
            let moved = |vertex: Vertex| Vertex {
                position: vertex.position - Vec3::splat(off),
                ..vertex
            };
            mesh.vertices.extend(vertices.into_iter().map(moved));
            for triangle in &mut mesh.triangles[8..] {
                triangle.vertices = triangle.vertices.map(|vertex| vertex + 8);
            }
            let turned = turns_any(&mut mesh);
            assert_eq!(turned, closes, "{off}");
        }
    }

    #[test]
    fn what_is_small_in_a_large_scene_is_told_as_any_other() {
        // Below a millionth of the diagonal: a closed box inside out, and one with a hole.
        for (hole, turns) in [(false, true), (true, false)] {
            let mut mesh = Mesh::default();
            add_box(&mut mesh, 0.0, 0.5, [false, false]);
            if hole {
                mesh.triangles.pop();
            }
            let small = mesh.triangles.len();
            add_box(&mut mesh, 4e6, 5e6, [true, true]);
            assert_eq!(turns_any(&mut mesh), turns, "{hole}");
            let found = faces_outwards(&mesh, 0..small, Vec3::splat(0.25));
            assert_eq!(found, [turns; 2], "{hole}");
        }
    }

    #[test]
    fn a_file_of_pieces_inside_out_is_turned_with_its_open_ones() {
        let mut mesh = Mesh::default();
        for at in 0..5 {
            let low = 2.0 * at as f32;
            add_box(&mut mesh, low, low + 1.0, [false, false]);
        }
        mesh.triangles.pop();
        assert_eq!(mend(&mut mesh).len(), 1);
        for at in 0..5 {
            let range = 12 * at..(12 * at + 12).min(59);
            let middle = Vec3::splat(2.0 * at as f32 + 0.5);
            assert_eq!(faces_outwards(&mesh, range, middle), [true; 2], "{at}");
        }
    }

    #[test]
    fn rooms_and_hollows_are_left() {
        // A room with something in it, and a hollow in something solid.
        for outer in [[false, false], [true, true]] {
            let mut mesh = Mesh::default();
            add_box(&mut mesh, 0.0, 10.0, outer);
            add_box(&mut mesh, 4.0, 5.0, [!outer[0]; 2]);
            let before = mesh.triangles.clone();
            let warnings = mend(&mut mesh);
            assert_eq!(mesh.triangles, before);
            assert_eq!(warnings.len(), 1);
        }
    }

    #[test]
    fn open_pieces_that_face_inwards_are_warned_of_unless_they_hold_something() {
        // A box without a face, or with only one, inside out or not, and with something in it.
        let cases = [
            (10, false, false, 1),
            (10, true, false, 0),
            (2, false, false, 0),
            (10, false, true, 0),
        ];
        for (triangles, outwards, holds, warns) in cases {
            let mut mesh = Mesh::default();
            add_box(&mut mesh, 0.0, 10.0, [outwards; 2]);
            mesh.triangles.truncate(triangles);
            if holds {
                add_box(&mut mesh, 4.0, 5.0, [true; 2]);
            }
            let before = mesh.triangles.clone();
            let warnings = mend(&mut mesh);
            assert_eq!(mesh.triangles, before);
            assert_eq!(warnings.len(), warns, "{triangles} {outwards} {holds}");
        }
    }
}
