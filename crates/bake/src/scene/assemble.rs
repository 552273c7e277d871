//! Finished clusters -> the asset.

use relight_format as format;

use super::error::Error;
use super::surface::ErrorSums;
use crate::compress::Compressed;
use crate::error::Objection;
use crate::transfer::compress::ClusterTransfer;

/// Errors on the surface above this, radians, are warned of: pictures of such bakes are off by
/// several percent.
const LARGE_ERROR: f32 = 0.025;

/// A finished cluster; needs nothing else of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Cluster {
    /// As stored.
    pub vertices: Vec<format::Vertex>,
    /// Their second texture coordinates, where the scene has them.
    pub second_uvs: Vec<[f32; 2]>,
    /// Indices into `vertices`; `cluster` is 0.
    pub triangles: Vec<format::Triangle>,
    /// Visibility of the vertices.
    pub compressed: Compressed,
    /// How far it is off.
    pub errors: ErrorSums,
    /// Bounced light of the vertices, where there is any.
    pub transfer: ClusterTransfer,
}

/// Lays out the clusters of all chunks, in the chunks' order, behind what
/// [`super::Bake::finish`] gave.
///
/// # Errors
///
/// The first that `chunks` yields, or more clusters than the format can number.
pub fn assemble<E: From<Error>>(
    head: format::Scene,
    chunks: impl IntoIterator<Item = Result<Vec<Cluster>, E>>,
) -> Result<format::Scene, E> {
    let mut scene = head;
    let mut errors = ErrorSums::default();
    let (mut error, mut whole) = (0.0, 0.0);
    for chunk in chunks {
        for cluster in chunk? {
            errors.add(&cluster.errors);
            if let Some(group) = &cluster.transfer.group {
                error += group.squared_error;
                whole += group.squared;
            }
            append(&mut scene, cluster)?;
        }
    }
    scene.report.errors = errors.errors();
    let off = scene.report.errors.surface;
    if off > LARGE_ERROR {
        scene.report.warnings.push(format!(
            "visibility on the surface is off by {off:.3} rad, root mean square, where {LARGE_ERROR} \
             is usual at most: shadows will look wrong in places; compare with `lab truth`, and \
             try --preset high, or --refine-error 0.02"
        ));
    }
    if let Some(transfer) = &mut scene.transfer {
        transfer.error = (error / f64::max(whole, f64::MIN_POSITIVE)).sqrt() as f32;
    }
    Ok(scene)
}

/// Lays out a cluster behind the others.
fn append(scene: &mut format::Scene, cluster: Cluster) -> Result<(), Error> {
    let too_many = |place: &str, most: u64, what: &str| {
        let expected = format!("at most {most} {what}");
        let found = "more; allow a larger error or fewer vertices";
        Error::Options(Objection::new(place, expected, found))
    };
    let number = u16::try_from(scene.clusters.len())
        .ok()
        .filter(|number| *number < u16::MAX)
        .ok_or_else(|| too_many("max_error", u16::MAX.into(), "clusters"))?;
    let index = |count: usize| {
        let what = "vertices and coefficients";
        u32::try_from(count).map_err(|_| too_many("max_vertices", u32::MAX.into(), what))
    };
    let first_vertex = index(scene.vertices.len())?;
    // That indices within the cluster do not overflow either.
    index(scene.vertices.len() + cluster.vertices.len())?;
    let compressed = cluster.compressed;
    let last = scene.clusters.last();
    scene.clusters.push(format::Cluster {
        first_vertex,
        vertex_count: cluster.vertices.len() as u32,
        first_coefficient: index(scene.coefficients.len())?,
        first_tile: last.map_or(0, |last| last.first_tile + last.tiles),
        tiles: compressed.tiles,
        coefficient_scale: compressed.coefficient_scale,
    });
    if let Some(transfer) = &mut scene.transfer {
        if let Some(group) = cluster.transfer.group {
            transfer.groups.push(format::TransferGroup {
                first_cluster: u32::from(number),
                rank: group.rank,
                outputs: group.outputs,
                reserved: 0,
            });
            transfer.scales.extend(group.scales);
            transfer.basis.extend(group.basis);
        }
        transfer.weights.extend(cluster.transfer.weights);
    }
    scene.coefficients.extend(compressed.coefficients);
    scene.basis.extend(compressed.basis);
    scene.vertices.extend(cluster.vertices);
    scene.second_uvs.extend(cluster.second_uvs);
    let triangles = cluster.triangles.iter().map(|triangle| format::Triangle {
        vertices: triangle.vertices.map(|vertex| first_vertex + vertex),
        cluster: number,
        ..*triangle
    });
    scene.triangles.extend(triangles);
    Ok(())
}
