//! Division where edges pass through other triangles.
//!
//! Where a wall stands on a floor, or a board passes through it, what a triangle sees jumps: on one side of the line it is in
//! a room, on the other within something solid. Vertices on that line keep the dark of the one out of the other.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;
use relight_shading::octahedral;

use super::{Key, divide, key, sides};
use crate::mesh::Mesh;
use crate::mesh::size::SizeFunction;
use crate::visibility::ray::RayCaster;

/// Edges shorter than this part of the size of things are left whole: what is wrong at them is small.
const SHORTEST: f32 = 0.01;
/// An edge is not cut nearer to an end than this part of it, nor than so many offsets of rays: what an end touches is no more
/// than rounding.
const NEAREST: f32 = 0.05;
const OFFSETS: f32 = 20.0;
/// Sine of the least angle between an edge and what it passes through: along a surface the place is not known.
const STEEPEST: f32 = 0.02;
/// One vertex is added for so many at most, or this number.
const SHARE: usize = 4;
const FEW: usize = 1024;
/// Rays per side of an octahedral map, folded to a hemisphere, that tell what lies to either side of a cut. So many of them that
/// meet backs of triangles begin within something solid.
const RAYS: u32 = 8;
const SOLID: usize = 48;
/// Of those of the darker side no more than this part meets nothing of what does on the brighter one; nothing is told by fewer than so many.
const DARKER: usize = 2;
const FEW_OPEN: usize = 8;
/// An edge that passes through many things is cut so often.
const ROUNDS: usize = 3;

/// Where to cut edges that pass through other triangles.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Cuts {
    /// Everywhere.
    All,
    /// Where people may see both ends of an edge and much less light arrives at one of them, as where a table's legs
    /// pass through the floor of a room that has two sides. Elsewhere one end is within something solid, and corners there
    /// are sampled where the triangle comes out.
    BetweenRooms,
}

/// Cuts edges where they pass through other triangles. As with [`super::refine`], triangles that meet at an edge cut it
/// alike. `caster` has the same surface, however it is divided; the mesh gets no more than `max_vertices`.
pub(crate) fn cut_where_pierced(
    mut mesh: Mesh,
    caster: &RayCaster,
    (sizes, ray_offset): (&SizeFunction, f32),
    max_vertices: usize,
    cuts: Cuts,
) -> Mesh {
    let most = max_vertices.min(mesh.vertices.len() + (mesh.vertices.len() / SHARE).max(FEW));
    let mut known = 0;
    for _ in 0..ROUNDS {
        let position = |index: u32| mesh.vertices[index as usize].position;
        let long = |[a, b]: &[u32; 2]| {
            // Others were looked at in an earlier round.
            (*a.max(b) as usize >= known)
                && sizes.length(position(*a), position(*b), SHORTEST) > SHORTEST
        };
        // An edge of triangles that share no vertices there is many, which are cut alike.
        let mut edges: Vec<(Key, [u32; 2])> = (mesh.triangles.par_iter())
            .flat_map_iter(|triangle| sides(triangle.vertices).into_iter().filter(long))
            .map(|[a, b]| (key(position(a), position(b)), [a.min(b), a.max(b)]))
            .collect();
        edges.par_sort_unstable();
        edges.dedup();
        let alike: Vec<&[(Key, [u32; 2])]> = edges.chunk_by(|a, b| a.0 == b.0).collect();
        let normal = |[a, b]: [u32; 2]| {
            let [a, b] = [a, b].map(|index| mesh.vertices[index as usize].normal);
            (a + b).normalize_or_zero()
        };
        let mut found: Vec<(Key, usize, Vec3)> = (alike.into_par_iter())
            .filter_map(|edges| {
                let is_cut = |at: Vec3, normal: Vec3| {
                    cuts == Cuts::All
                        || parts_rooms(ends(edges[0].0), at, normal, caster, ray_offset)
                };
                let at = edges.iter().find_map(|(edge, vertices)| {
                    let normal = normal(*vertices);
                    pierced(*edge, normal, caster, ray_offset).filter(|at| is_cut(*at, normal))
                })?;
                Some((edges[0].0, edges.len(), at))
            })
            .collect();
        let mut room = most.saturating_sub(mesh.vertices.len());
        if found.iter().map(|(_, count, _)| count).sum::<usize>() > room {
            let length = |edge: Key| ends(edge)[0].distance_squared(ends(edge)[1]);
            found.sort_by(|a, b| length(b.0).total_cmp(&length(a.0)).then(a.0.cmp(&b.0)));
            found.retain(|(_, count, _)| {
                let fits = *count <= room;
                room = if fits { room - count } else { 0 };
                fits
            });
        }
        if found.is_empty() {
            break;
        }
        known = mesh.vertices.len();
        let cuts: HashMap<Key, Vec3> = found.into_iter().map(|(edge, _, at)| (edge, at)).collect();
        divide(&mut mesh, |a, b| cuts.get(&key(a, b)).copied());
    }
    mesh
}

fn ends(edge: Key) -> [Vec3; 2] {
    edge.map(|end| Vec3::from(end.map(f32::from_bits)))
}

/// Where an edge passes through a triangle, or meets one that stands on the surface, which `normal` tells; nearest to
/// its middle.
fn pierced(edge: Key, normal: Vec3, caster: &RayCaster, ray_offset: f32) -> Option<Vec3> {
    let [a, b] = ends(edge);
    let length = a.distance(b);
    let direction = (b - a) / length;
    let nearest = (NEAREST * length).max(OFFSETS * ray_offset);
    let start = a + ray_offset * normal;
    let crossings = caster.crossings(start, direction, length).into_iter();
    let aside = |distance: &f32| (distance - 0.5 * length).abs();
    let distance = crossings
        .filter(|crossing| crossing.normal.dot(direction).abs() > STEEPEST)
        // On the edge itself.
        .map(|crossing| {
            let aside = crossing.normal.dot(start - a);
            crossing.distance + aside / crossing.normal.dot(direction)
        })
        .filter(|distance| *distance > nearest && *distance < length - nearest)
        .min_by(|one, other| {
            aside(one)
                .total_cmp(&aside(other))
                .then(one.total_cmp(other))
        })?;
    Some(a + distance * direction)
}

/// Whether much more of the distance is seen from one side of what an edge passes through at a point than from the other,
/// and neither lies within something solid. `normal` is that of the surface that the edge belongs to.
fn parts_rooms(
    [a, b]: [Vec3; 2],
    at: Vec3,
    normal: Vec3,
    caster: &RayCaster,
    ray_offset: f32,
) -> bool {
    let along = 0.5 * OFFSETS * ray_offset * (b - a).normalize_or_zero();
    let open = [-along, along].map(|aside| {
        let origin = at + aside + ray_offset * normal;
        let rays = (0..RAYS * RAYS).map(|i| {
            let ray = octahedral::texel_direction(i % RAYS, i / RAYS, RAYS);
            caster.closest_side(origin, ray * ray.dot(normal).signum())
        });
        let rays: Vec<Option<(f32, bool)>> = rays.collect();
        let is_back = |met: &&Option<(f32, bool)>| met.is_some_and(|(_, front)| !front);
        let is_solid = rays.iter().filter(is_back).count() >= SOLID;
        (!is_solid).then(|| rays.iter().filter(|met| met.is_none()).count())
    });
    let [Some(one), Some(other)] = open else {
        return false;
    };
    let bright = one.max(other);
    bright > 0 && (bright < FEW_OPEN || DARKER * one.min(other) <= bright)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{assert_closed, assert_same_surface, soup};
    use super::*;
    use crate::transfer::radiosity;

    /// A large square in the plane x = .3.
    fn board() -> [[Vec3; 3]; 2] {
        let at = |y, z| Vec3::new(0.3, y, z);
        let [a, b, c, d] = [at(-9.0, -9.0), at(9.0, -9.0), at(9.0, 9.0), at(-9.0, 9.0)];
        [[a, b, c], [a, c, d]]
    }

    fn cut(max_vertices: usize) -> Mesh {
        let sizes = SizeFunction::even(1.0);
        let both = [soup().soup(), board().to_vec()].concat();
        let caster = RayCaster::new(&both);
        cut_where_pierced(soup(), &caster, (&sizes, 1e-4), max_vertices, Cuts::All)
    }

    #[test]
    fn vertices_lie_where_a_board_passes_through() {
        let mesh = cut(usize::MAX);
        assert_same_surface(&mesh);
        assert_closed(&mesh);
        // Four edges end at the corner beyond the board, each of two faces that share no vertex.
        let added = &mesh.vertices[soup().vertices.len()..];
        assert_eq!(added.len(), 8);
        for vertex in added {
            assert!(
                (vertex.position.x - 0.3).abs() < 1e-6,
                "{}",
                vertex.position
            );
        }
        for [a, b] in mesh
            .triangles
            .iter()
            .flat_map(|triangle| sides(triangle.vertices))
        {
            let [a, b] = [a, b].map(|vertex| mesh.vertices[vertex as usize].position.x - 0.3);
            assert!(a * b > -1e-6, "an edge passes through the board: {a} {b}");
        }
    }

    #[test]
    fn what_is_not_pierced_or_has_no_room_stays_whole() {
        let sizes = SizeFunction::even(1.0);
        let caster = RayCaster::new(&soup().soup());
        let alone = cut_where_pierced(soup(), &caster, (&sizes, 1e-4), usize::MAX, Cuts::All);
        assert_eq!(alone, soup());
        assert_eq!(cut(24), soup());
        // Neighbours agree with as little room as there may be.
        for bound in 25..32 {
            let mesh = cut(bound);
            assert!(
                mesh.vertices.len() <= bound,
                "{} of {bound}",
                mesh.vertices.len()
            );
            assert_closed(&mesh);
        }
    }

    /// A post that passes through y = 0, cut with what else there is.
    fn post(others: &[[Vec3; 3]]) -> Mesh {
        let of = |squares: &[[Vec3; 3]]| radiosity::tests::squares(squares, 0.5, 0.0);
        let post = of(&[[Vec3::new(1.5, -0.5, 2.0), Vec3::X, Vec3::Y]]);
        let all = [post.soup(), of(others).soup()].concat();
        let sizes = SizeFunction::even(4.0);
        let scale = (&sizes, 1e-4);
        cut_where_pierced(
            post,
            &RayCaster::new(&all),
            scale,
            usize::MAX,
            Cuts::BetweenRooms,
        )
    }

    /// A box of 4 m that stands on y = 0, its front within.
    fn room() -> [[Vec3; 3]; 6] {
        let (o, x, y, z) = (Vec3::ZERO, 4.0 * Vec3::X, 4.0 * Vec3::Y, 4.0 * Vec3::Z);
        [
            [o, z, x],
            [o, x, y],
            [o, y, z],
            [o + y, x, z],
            [o + z, y, x],
            [o + x, z, y],
        ]
    }

    #[test]
    fn what_passes_through_the_floor_of_a_room_is_cut_there() {
        let outside = room().map(|[corner, u, v]| [corner, v, u]);
        for walls in [room().to_vec(), [room(), outside].concat()] {
            let mesh = post(&walls);
            let line = mesh.vertices.iter().map(|vertex| vertex.position.y);
            assert_eq!(line.filter(|y| y.abs() < 1e-6).count(), 3);
        }
    }

    #[test]
    fn what_passes_into_a_solid_or_through_a_sheet_in_the_open_stays_whole() {
        let solid = room().map(|[corner, u, v]| [corner, v, u]);
        assert_eq!(post(&solid).vertices.len(), 4);
        let [floor, ..] = room();
        assert_eq!(post(&[floor]).vertices.len(), 4);
        assert_eq!(post(&[]).vertices.len(), 4);
    }
}
