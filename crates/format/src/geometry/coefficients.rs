//! Coefficients of visibility: predicted across the mesh, as are vertices.

use super::Places;
use super::numbers::{element, from_zigzag, planes, zigzag};
use crate::{CHANNELS_PER_TILE, Cluster, MAX_TILES_PER_CLUSTER, Triangle};

/// Coefficients of image after image of every cluster: what all are multiples of, then
/// differences, in multiples of it, of places.
pub(crate) fn encode_coefficients(
    coefficients: &[i16],
    triangles: &[Triangle],
    clusters: &[Cluster],
    places: &Places,
) -> Vec<u8> {
    let expected = places.expected(triangles);
    let mut steps = Vec::new();
    let mut differences = Vec::with_capacity(coefficients.len());
    for ((members, channels), cluster) in places.clusters(clusters).zip(clusters) {
        for channel in 0..channels {
            let value = |place: usize| {
                let row = places.vertices[place] - cluster.first_vertex;
                let row = cluster.first_coefficient as usize + row as usize * channels;
                i32::from(coefficients[row + channel])
            };
            let common = members
                .clone()
                .fold(0, |step, place| greatest_common_divisor(step, value(place)));
            // A lone −32768 has a step that 16 bits do not hold; such coefficients are not valid.
            let step = common.clamp(1, i32::from(i16::MAX));
            steps.push((step as u16).to_le_bytes());
            differences.extend(members.clone().map(|place| {
                let difference = value(place) - expected.of(place, &members, value);
                // Modulo 2¹⁶, like the coefficients themselves.
                let multiple = (difference / step) as i16;
                (zigzag(i32::from(multiple)) as u16).to_le_bytes()
            }));
        }
    }
    let mut bytes = planes(&steps);
    bytes.extend(planes(&differences));
    bytes
}

/// The inverse of [`encode_coefficients`]; none if clusters and their places are not of
/// this length.
pub(crate) fn decode_coefficients(
    bytes: &[u8],
    triangles: &[Triangle],
    clusters: &[Cluster],
    places: &Places,
) -> Option<Vec<i16>> {
    let images = |cluster: &Cluster| u64::from(cluster.tiles) * CHANNELS_PER_TILE as u64;
    let all_images: u64 = clusters.iter().map(images).sum();
    let counts = clusters.iter().zip(places.first.windows(2));
    let all = counts.clone().try_fold(0u64, |sum, (cluster, ends)| {
        sum.checked_add(u64::from(ends[1] - ends[0]).checked_mul(images(cluster))?)
    });
    let expected_length = all?.checked_add(all_images)?.checked_mul(2)?;
    // Of few places many vertices: more tiles than a cluster may have are refused here, before
    // they cost memory.
    let tiles = clusters
        .iter()
        .all(|cluster| cluster.tiles <= MAX_TILES_PER_CLUSTER);
    if expected_length != bytes.len() as u64 || !tiles {
        return None;
    }
    let expected = places.expected(triangles);
    let (steps, differences) = bytes.split_at(2 * all_images as usize);
    let all = counts.map(|(cluster, _)| images(cluster) * u64::from(cluster.vertex_count));
    let mut coefficients = Vec::with_capacity(usize::try_from(all.sum::<u64>()).ok()?);
    let (mut image, mut index) = (0, 0);
    let mut values = vec![0i16; places.vertices.len()];
    let mut vertices = places.numbers.iter();
    for ((members, channels), cluster) in places.clusters(clusters).zip(clusters) {
        let start = coefficients.len();
        coefficients.resize(start + cluster.vertex_count as usize * channels, 0);
        let vertices: Vec<u32> = (vertices.by_ref())
            .take(cluster.vertex_count as usize)
            .copied()
            .collect();
        for channel in 0..channels {
            let step = i32::from(u16::from_le_bytes(element(steps, image)));
            image += 1;
            for place in members.clone() {
                let value = |place: usize| i32::from(values[place]);
                let expected = expected.of(place, &members, value);
                let difference = u16::from_le_bytes(element(differences, index));
                index += 1;
                let difference = from_zigzag(u32::from(difference)).wrapping_mul(step);
                values[place] = expected.wrapping_add(difference) as i16;
            }
            let column = coefficients[start..]
                .iter_mut()
                .skip(channel)
                .step_by(channels);
            for (coefficient, &place) in column.zip(&vertices) {
                *coefficient = values[place as usize];
            }
        }
    }
    Some(coefficients)
}

fn greatest_common_divisor(a: i32, b: i32) -> i32 {
    if b == 0 {
        a.abs()
    } else {
        greatest_common_divisor(b, a % b)
    }
}
