//! The payload of a record: the clusters of a chunk as bytes.

use bytemuck::{AnyBitPattern, NoUninit};
use relight_format::{self as format, CHANNELS_PER_TILE, MAX_TILES_PER_CLUSTER};

use crate::compress::Compressed;
use crate::scene::Cluster;
use crate::transfer::compress::{ClusterTransfer, Group};

/// Clusters to bytes: u32 number of clusters, then each: u32 vertices, second texture coordinates,
/// triangles and tiles, f32 coefficient scale, u64 basis bytes, f64 squared error, the sums of errors, then
/// the arrays; of bounced light u64 weights, u64 scales (0 where no group begins) and u64 basis
/// bytes, the weights, and where a group begins u32 rank, u32 outputs, f64 squared error, f64
/// squared light, scales and basis.
pub fn encode(clusters: &[Cluster]) -> Vec<u8> {
    const { assert!(cfg!(target_endian = "little"), "arrays are little-endian") };
    let mut bytes = (clusters.len() as u32).to_le_bytes().to_vec();
    for cluster in clusters {
        let compressed = &cluster.compressed;
        bytes.extend((cluster.vertices.len() as u32).to_le_bytes());
        bytes.extend((cluster.second_uvs.len() as u32).to_le_bytes());
        bytes.extend((cluster.triangles.len() as u32).to_le_bytes());
        bytes.extend(compressed.tiles.to_le_bytes());
        bytes.extend(compressed.coefficient_scale.to_le_bytes());
        bytes.extend((compressed.basis.len() as u64).to_le_bytes());
        bytes.extend(compressed.squared_error.to_le_bytes());
        bytes.extend(bytemuck::bytes_of(&cluster.errors));
        bytes.extend(array_bytes(&cluster.vertices));
        bytes.extend(array_bytes(&cluster.second_uvs));
        bytes.extend(array_bytes(&cluster.triangles));
        bytes.extend(array_bytes(&compressed.coefficients));
        bytes.extend(array_bytes(&compressed.basis));
        let ClusterTransfer { group, weights } = &cluster.transfer;
        let lengths = group
            .as_ref()
            .map_or([0; 2], |group| [group.scales.len(), group.basis.len()]);
        for length in [weights.len(), lengths[0], lengths[1]] {
            bytes.extend((length as u64).to_le_bytes());
        }
        bytes.extend(array_bytes(weights));
        if let Some(group) = group {
            bytes.extend(group.rank.to_le_bytes());
            bytes.extend(group.outputs.to_le_bytes());
            bytes.extend(group.squared_error.to_le_bytes());
            bytes.extend(group.squared.to_le_bytes());
            bytes.extend(array_bytes(&group.scales));
            bytes.extend(array_bytes(&group.basis));
        }
    }
    bytes
}

fn array_bytes<T: NoUninit>(values: &[T]) -> &[u8] {
    bytemuck::cast_slice(values)
}

/// The inverse of [`encode`]; `None` if the bytes are anything else. What the clusters hold
/// is checked when the asset is written.
pub(super) fn decode(mut bytes: &[u8]) -> Option<Vec<Cluster>> {
    let bytes = &mut bytes;
    let count: u32 = take(bytes)?;
    let mut clusters = Vec::new();
    for _ in 0..count {
        let [vertices, second_uvs, triangles, tiles]: [u32; 4] = take(bytes)?;
        let coefficient_scale: f32 = take(bytes)?;
        let basis: u64 = take(bytes)?;
        let squared_error: f64 = take(bytes)?;
        let errors = take(bytes)?;
        if !(1..=MAX_TILES_PER_CLUSTER).contains(&tiles) {
            return None;
        }
        let channels = u64::from(tiles) * CHANNELS_PER_TILE as u64;
        let mut cluster = Cluster {
            vertices: take_array(bytes, u64::from(vertices))?,
            second_uvs: take_array(bytes, u64::from(second_uvs))?,
            triangles: take_array(bytes, u64::from(triangles))?,
            compressed: Compressed {
                tiles,
                coefficient_scale,
                coefficients: take_array(bytes, u64::from(vertices) * channels)?,
                basis: take_array(bytes, basis)?,
                squared_error,
            },
            errors,
            transfer: ClusterTransfer::default(),
        };
        let [weights, scales, basis]: [u64; 3] = take(bytes)?;
        cluster.transfer.weights = take_array(bytes, weights)?;
        if scales > 0 {
            let [rank, outputs]: [u32; 2] = take(bytes)?;
            let [squared_error, squared]: [f64; 2] = take(bytes)?;
            cluster.transfer.group = Some(Group {
                rank,
                outputs,
                squared_error,
                squared,
                scales: take_array(bytes, scales)?,
                basis: take_array(bytes, basis)?,
            });
        }
        let inside =
            |triangle: &format::Triangle| triangle.vertices.iter().all(|vertex| *vertex < vertices);
        if !cluster.triangles.iter().all(inside) {
            return None;
        }
        clusters.push(cluster);
    }
    bytes.is_empty().then_some(clusters)
}

pub(super) fn take<T: AnyBitPattern>(bytes: &mut &[u8]) -> Option<T> {
    let (head, tail) = bytes.split_at_checked(size_of::<T>())?;
    *bytes = tail;
    Some(bytemuck::pod_read_unaligned(head))
}

/// Allocates only what `bytes` hold.
fn take_array<T: AnyBitPattern + NoUninit>(bytes: &mut &[u8], count: u64) -> Option<Vec<T>> {
    let length = usize::try_from(count).ok()?.checked_mul(size_of::<T>())?;
    let (head, tail) = bytes.split_at_checked(length)?;
    *bytes = tail;
    Some(bytemuck::pod_collect_to_vec(head))
}
