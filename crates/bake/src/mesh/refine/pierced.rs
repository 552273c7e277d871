//! Division where edges pass through other triangles.
//!
//! Where a wall stands on a floor, or a board passes through it, what a triangle sees jumps: on one side of the line it is in
//! a room, on the other within something solid. Vertices on that line keep the dark of the one out of the other.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

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
/// An edge that passes through many things is cut so often.
const ROUNDS: usize = 3;

/// Cuts edges where they pass through other triangles. As with [`super::refine`], triangles that meet at an edge cut it
/// alike. `caster` has the same surface, however it is divided; the mesh gets no more than `max_vertices`.
pub(crate) fn cut_where_pierced(
    mut mesh: Mesh,
    caster: &RayCaster,
    (sizes, ray_offset): (&SizeFunction, f32),
    max_vertices: usize,
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
        let mut found: Vec<(Key, usize, Vec3)> = (alike.into_par_iter())
            .filter_map(|edges| {
                let at = pierced(edges[0].0, caster, ray_offset)?;
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

/// Where an edge passes through a triangle, nearest to its middle.
fn pierced(edge: Key, caster: &RayCaster, ray_offset: f32) -> Option<Vec3> {
    let [a, b] = ends(edge);
    let length = a.distance(b);
    let direction = (b - a) / length;
    let nearest = (NEAREST * length).max(OFFSETS * ray_offset);
    let crossings = caster.crossings(a, direction, length).into_iter();
    let aside = |distance: &f32| (distance - 0.5 * length).abs();
    let distance = crossings
        .filter(|crossing| crossing.normal.dot(direction).abs() > STEEPEST)
        .map(|crossing| crossing.distance)
        .filter(|distance| *distance > nearest && *distance < length - nearest)
        .min_by(|one, other| {
            aside(one)
                .total_cmp(&aside(other))
                .then(one.total_cmp(other))
        })?;
    Some(a + distance * direction)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{assert_closed, assert_same_surface, soup};
    use super::*;

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
        cut_where_pierced(soup(), &caster, (&sizes, 1e-4), max_vertices)
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
        let alone = cut_where_pierced(soup(), &caster, (&sizes, 1e-4), usize::MAX);
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
}
