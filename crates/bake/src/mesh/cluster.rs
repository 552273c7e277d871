//! Triangles into spatially coherent groups of bounded size.

use glam::Vec3;

/// How far a quarter turn of the normal counts, in extents of the scene, if at all.
const NORMAL_WEIGHT: f32 = 0.25;
/// Most vertices that groups of similar normals may store, in those of groups by place alone.
const SCATTERED: f32 = 1.03;

/// Splits the triangles into compact groups whose vertices number at most `max_vertices` (or
/// that hold one triangle), by recursive median cuts along the axis of largest spread.
/// Groups come in spatial order; triangles within a group keep their order.
///
/// Vertices of similar normals see more alike. But on bumpy surfaces groups of similar normals
/// are scattered: each has neighbours of another everywhere, whose vertices both store. There
/// place alone counts.
pub(crate) fn partition(
    positions: &[Vec3],
    triangles: &[[u32; 3]],
    max_vertices: usize,
) -> Vec<Vec<u32>> {
    let with = |normal_weight: f32| {
        let features = features(positions, triangles, normal_weight);
        let all = (0..triangles.len() as u32).collect();
        let groups = split(all, &features, triangles, max_vertices);
        let vertices = groups
            .iter()
            .map(|group| vertices_of(group, triangles).len());
        (vertices.sum::<usize>() as f32, groups)
    };
    let (compact, alike) = rayon::join(|| with(0.0), || with(NORMAL_WEIGHT));
    if alike.0 <= SCATTERED * compact.0 {
        alike.1
    } else {
        compact.1
    }
}

/// A triangle's place in extents of the scene, and its weighted normal.
type Feature = [f32; 6];

fn features(positions: &[Vec3], triangles: &[[u32; 3]], normal_weight: f32) -> Vec<Feature> {
    let (low, high) = positions.iter().fold(
        (Vec3::INFINITY, Vec3::NEG_INFINITY),
        |(low, high), position| (low.min(*position), high.max(*position)),
    );
    let scale = 1.0 / (high - low).max_element().max(f32::MIN_POSITIVE);
    (triangles.iter())
        .map(|triangle| {
            let corners = triangle.map(|vertex| positions[vertex as usize]);
            let [a, b, c] = corners;
            let place = centre(corners) * scale;
            let normal = (b - a).cross(c - a).normalize_or_zero() * normal_weight;
            [place.x, place.y, place.z, normal.x, normal.y, normal.z]
        })
        .collect()
}

/// Of a triangle's corners.
fn centre([a, b, c]: [Vec3; 3]) -> Vec3 {
    (a + b + c) / 3.0
}

fn split(
    mut group: Vec<u32>,
    features: &[Feature],
    triangles: &[[u32; 3]],
    max_vertices: usize,
) -> Vec<Vec<u32>> {
    if group.is_empty() {
        return Vec::new();
    }
    if group.len() < 2 || has_at_most(max_vertices, &group, triangles) {
        group.sort_unstable();
        return vec![group];
    }
    let axis = widest_axis(&group, features);
    // Ties are broken by index: the cut does not depend on the sort's implementation.
    let mut keys: Vec<u64> = (group.iter())
        .map(|&triangle| {
            let place = ordered(features[triangle as usize][axis]);
            u64::from(place) << 32 | u64::from(triangle)
        })
        .collect();
    keys.sort_unstable();
    for (triangle, key) in group.iter_mut().zip(keys) {
        *triangle = key as u32;
    }
    let upper = group.split_off(group.len() / 2);
    let part = |group| split(group, features, triangles, max_vertices);
    let (mut groups, others) = rayon::join(|| part(group), || part(upper));
    groups.extend(others);
    groups
}

/// A number of the place of another in the order of [`f32::total_cmp`].
fn ordered(number: f32) -> u32 {
    let bits = number.to_bits();
    if number.is_sign_negative() {
        !bits
    } else {
        bits | 1 << 31
    }
}

/// Whether some triangles use no more vertices than that.
fn has_at_most(most: usize, group: &[u32], triangles: &[[u32; 3]]) -> bool {
    let few = |group: &[u32]| vertices_of(group, triangles).len() <= most;
    // Of many triangles the first ones tell.
    let first = &group[..group.len().min(4 * most)];
    few(first) && (first.len() == group.len() || few(group))
}

fn widest_axis(group: &[u32], features: &[Feature]) -> usize {
    let spread = [0, 1, 2, 3, 4, 5].map(|axis| {
        let values = group
            .iter()
            .map(|&triangle| features[triangle as usize][axis]);
        let mean = values.clone().sum::<f32>() / group.len() as f32;
        values.map(|value| (value - mean).powi(2)).sum::<f32>()
    });
    (0..6)
        .max_by(|&a, &b| spread[a].total_cmp(&spread[b]))
        .unwrap_or(0)
}

/// The vertices that the triangles use, ascending.
pub(crate) fn vertices_of(group: &[u32], triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut vertices: Vec<u32> = group
        .iter()
        .flat_map(|&triangle| triangles[triangle as usize])
        .collect();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Squares of two triangles each on n² cells, so high at every vertex.
    pub(crate) fn grid(n: u32, height: impl Fn(u32, u32) -> f32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let positions = (0..(n + 1) * (n + 1))
            .map(|i| {
                let (x, z) = (i % (n + 1), i / (n + 1));
                Vec3::new(x as f32, height(x, z), z as f32)
            })
            .collect();
        let triangles = (0..n * n)
            .flat_map(|i| {
                let a = i / n * (n + 1) + i % n;
                [[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]
            })
            .collect();
        (positions, triangles)
    }

    #[test]
    fn numbers_keep_their_order() {
        let numbers = [
            f32::NEG_INFINITY,
            -2.0,
            -f32::MIN_POSITIVE,
            -0.0,
            0.0,
            1e-30,
            3.0,
            f32::INFINITY,
        ];
        assert!(numbers.is_sorted_by(|a, b| ordered(*a) < ordered(*b)));
    }

    #[test]
    fn groups_cover_every_triangle_once_within_the_bound() {
        let (positions, triangles) = grid(40, |_, _| 0.0);
        let groups = partition(&positions, &triangles, 100);
        let mut seen: Vec<u32> = groups.iter().flatten().copied().collect();
        seen.sort_unstable();
        assert!(seen.iter().copied().eq(0..triangles.len() as u32));
        for group in &groups {
            assert!(vertices_of(group, &triangles).len() <= 100);
        }
        let total: usize = groups
            .iter()
            .map(|g| vertices_of(g, &triangles).len())
            .sum();
        assert!(
            total < positions.len() * 3 / 2,
            "compact groups share few vertices: {total}"
        );
    }

    /// A surface whose normals turn by a right angle from one triangle to the next.
    #[test]
    fn bumps_do_not_scatter_groups() {
        let (positions, triangles) = grid(60, |x, z| ((x + z) % 2) as f32);
        let groups = partition(&positions, &triangles, 200);
        let total: usize = (groups.iter())
            .map(|group| vertices_of(group, &triangles).len())
            .sum();
        // Squares of 200 vertices have about 28 on half of their border.
        assert!(total < positions.len() * 13 / 10, "{total}");
    }

    #[test]
    fn equal_features_still_split() {
        let positions = vec![Vec3::ZERO; 30];
        let triangles: Vec<[u32; 3]> = (0..10).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        assert!(
            partition(&positions, &triangles, 3)
                .iter()
                .all(|group| group.len() == 1)
        );
    }
}
