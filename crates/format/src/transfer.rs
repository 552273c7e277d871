//! Light that bounces: how much of distant light arrives at every vertex after reflections off
//! the scene, compressed per group of clusters.

use bytemuck::{AnyBitPattern, Pod, Zeroable};

use crate::container::SectionKind;
use crate::{Cluster, Error, Issue};

/// Largest order of the spherical harmonics that light is given in.
pub const MAX_TRANSFER_ORDER: u32 = 9;
/// Most components of a group besides its mean.
pub const MAX_TRANSFER_RANK: u32 = 24;
/// Outputs of a group that stores irradiance alone, and of one that stores what is reflected by
/// rough mirrors as well.
pub const TRANSFER_OUTPUTS: [u32; 2] = [3, 7];

/// What other surfaces reflect to vertices, as a linear function of distant light.
///
/// Light is `columns()` numbers per channel: its coefficients in real orthonormal spherical
/// harmonics up to `order` and, where `emitted`, a 1 for what surfaces themselves emit. A
/// vertex has `outputs` numbers per channel: the vector irradiance G (x, y, z; irradiance of
/// a surface with normal n is G·n) and, with 7 outputs, the radiance `r₀ + r·ω` from
/// directions ω in which the scene blocks the distance (r₀, then r).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transfer {
    /// Order of the harmonics, up to [`MAX_TRANSFER_ORDER`].
    pub order: u32,
    /// Whether the last column is what surfaces emit.
    pub emitted: bool,
    /// Bounces that were added up.
    pub bounces: u32,
    /// What the last of them added, as a part of what each place had before; root mean square.
    pub last_bounce: f32,
    /// Root mean square error of what is stored, relative to the bounced light.
    pub error: f32,
    /// Groups of clusters, in order and without gaps.
    pub groups: Vec<TransferGroup>,
    /// What 127 of `basis` stands for: per group, row (the mean, then components) and output.
    pub scales: Vec<f32>,
    /// Per group, row, output and channel (R, G, B) `columns()` numbers.
    pub basis: Vec<i8>,
    /// Per group, vertex and component the weight, 127 for 1.
    pub weights: Vec<i8>,
}

/// Successive clusters that share rows (16 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct TransferGroup {
    /// First cluster; the group ends where the next begins.
    pub first_cluster: u32,
    /// Components besides the mean, up to [`MAX_TRANSFER_RANK`].
    pub rank: u32,
    /// One of [`TRANSFER_OUTPUTS`].
    pub outputs: u32,
    /// Zero.
    pub reserved: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Header {
    order: u32,
    emitted: u32,
    bounces: u32,
    groups: u32,
    last_bounce: f32,
    error: f32,
}

impl Transfer {
    /// Numbers per channel that light is given in.
    pub fn columns(&self) -> usize {
        let side = self.order as usize + 1;
        side * side + usize::from(self.emitted)
    }

    /// Vertices of every group.
    pub fn vertices<'a>(&'a self, clusters: &'a [Cluster]) -> impl Iterator<Item = usize> + 'a {
        self.groups.iter().enumerate().map(|(index, group)| {
            let next = self.groups.get(index + 1);
            let end = next.map_or(clusters.len(), |next| next.first_cluster as usize);
            clusters
                .get(group.first_cluster as usize..end)
                .map_or(0, |clusters| {
                    clusters
                        .iter()
                        .map(|cluster| cluster.vertex_count as usize)
                        .sum()
                })
        })
    }

    /// Numbers of scales, of the basis and of weights that the groups call for; `None` where
    /// they are more than can be addressed.
    fn lengths(&self, clusters: &[Cluster]) -> Option<[usize; 3]> {
        let mut lengths = [0usize; 3];
        for (group, vertices) in self.groups.iter().zip(self.vertices(clusters)) {
            let rows = (group.rank as usize + 1).checked_mul(group.outputs as usize)?;
            let numbers = rows.checked_mul(3)?.checked_mul(self.columns())?;
            let weights = vertices.checked_mul(group.rank as usize)?;
            for (length, more) in lengths.iter_mut().zip([rows, numbers, weights]) {
                *length = length.checked_add(more)?;
            }
        }
        Some(lengths)
    }

    pub(crate) fn validate(&self, clusters: &[Cluster]) -> Result<(), Error> {
        let section = SectionKind::Transfer;
        let relative = [self.last_bounce, self.error];
        let numbers = self.order <= MAX_TRANSFER_ORDER
            && relative
                .iter()
                .all(|value| value.is_finite() && *value >= 0.0);
        if !numbers {
            return Err(Error::section(
                Issue::ValueOutOfRange,
                section,
                format_args!("an order up to {MAX_TRANSFER_ORDER} and finite errors >= 0"),
                format_args!("{}, {relative:?}", self.order),
            ));
        }
        let mut first = Some(0);
        for (index, group) in self.groups.iter().enumerate() {
            let begins = match first {
                Some(start) => group.first_cluster == start,
                None => group.first_cluster > self.groups[index - 1].first_cluster,
            };
            first = None;
            let valid = begins
                && (group.first_cluster as usize) < clusters.len()
                && group.rank <= MAX_TRANSFER_RANK
                && TRANSFER_OUTPUTS.contains(&group.outputs)
                && group.reserved == 0;
            if !valid {
                return Err(Error::section(
                    Issue::ValueOutOfRange,
                    section,
                    "ascending groups of clusters that begin with the first, 3 or 7 outputs",
                    format_args!("group {index}: {group:?}"),
                ));
            }
        }
        if self.groups.is_empty() && !clusters.is_empty() {
            let expected = "a group for every cluster";
            return Err(Error::section(Issue::BadLength, section, expected, "none"));
        }
        let found = [self.scales.len(), self.basis.len(), self.weights.len()];
        if self.lengths(clusters) != Some(found) {
            return Err(Error::section(
                Issue::BadLength,
                section,
                format_args!(
                    "scales, basis and weights as the groups say: {:?}",
                    self.lengths(clusters)
                ),
                format_args!("{found:?}"),
            ));
        }
        if let Some(scale) = self.scales.iter().find(|x| !(x.is_finite() && **x >= 0.0)) {
            let expected = "finite scales >= 0";
            return Err(Error::section(
                Issue::ValueOutOfRange,
                section,
                expected,
                scale,
            ));
        }
        // As of visibility's basis: −1 is the least that every decoder agrees on.
        let low = |values: &[i8]| values.contains(&i8::MIN);
        if low(&self.basis) || low(&self.weights) {
            return Err(Error::section(
                Issue::ValueOutOfRange,
                section,
                "signed normalised values of at least -1",
                "less",
            ));
        }
        Ok(())
    }

    /// Header, groups, scales, basis, then weights: per group component after component, each
    /// as differences from the vertex before.
    pub(crate) fn encode(&self, clusters: &[Cluster]) -> Vec<u8> {
        let header = Header {
            order: self.order,
            emitted: u32::from(self.emitted),
            bounces: self.bounces,
            groups: self.groups.len() as u32,
            last_bounce: self.last_bounce,
            error: self.error,
        };
        let mut bytes = bytemuck::bytes_of(&header).to_vec();
        bytes.extend_from_slice(bytemuck::cast_slice(&self.groups));
        bytes.extend_from_slice(bytemuck::cast_slice(&self.scales));
        bytes.extend_from_slice(bytemuck::cast_slice(&self.basis));
        let mut rest = &self.weights[..];
        for (group, vertices) in self.groups.iter().zip(self.vertices(clusters)) {
            let rank = group.rank as usize;
            let (weights, tail) = rest.split_at(vertices * rank);
            rest = tail;
            for component in 0..rank {
                let mut before = 0i8;
                for weight in weights.iter().skip(component).step_by(rank) {
                    bytes.push(weight.wrapping_sub(before).cast_unsigned());
                    before = *weight;
                }
            }
        }
        bytes
    }

    /// The inverse of [`Self::encode`]; checks lengths, the rest is left to
    /// [`Self::validate`].
    pub(crate) fn decode(mut bytes: &[u8], clusters: &[Cluster]) -> Result<Self, Error> {
        let total = bytes.len();
        let bad = |expected: &str| {
            let found = format_args!("{total} bytes");
            Error::section(Issue::BadLength, SectionKind::Transfer, expected, found)
        };
        let header: Header = take(&mut bytes, 1)
            .and_then(|mut headers| headers.pop())
            .ok_or_else(|| bad("24 bytes of header"))?;
        if header.emitted > 1 || header.order > MAX_TRANSFER_ORDER {
            return Err(Error::section(
                Issue::ValueOutOfRange,
                SectionKind::Transfer,
                format_args!("an order up to {MAX_TRANSFER_ORDER}, then 0 or 1"),
                format_args!("{}, {}", header.order, header.emitted),
            ));
        }
        let groups: Vec<TransferGroup> =
            take(&mut bytes, header.groups as usize).ok_or_else(|| bad("16 bytes per group"))?;
        let mut transfer = Self {
            order: header.order,
            emitted: header.emitted == 1,
            bounces: header.bounces,
            last_bounce: header.last_bounce,
            error: header.error,
            groups,
            ..Self::default()
        };
        let whole = "scales, basis and weights of the groups";
        let [scales, basis, weights] = transfer.lengths(clusters).ok_or_else(|| bad(whole))?;
        transfer.scales = take(&mut bytes, scales).ok_or_else(|| bad(whole))?;
        transfer.basis = take(&mut bytes, basis).ok_or_else(|| bad(whole))?;
        if bytes.len() != weights {
            return Err(bad(whole));
        }
        let vertices: Vec<usize> = transfer.vertices(clusters).collect();
        transfer.weights = vec![0; weights];
        let mut rest = &mut transfer.weights[..];
        for (group, vertices) in transfer.groups.iter().zip(vertices) {
            let rank = group.rank as usize;
            let (weights, tail) = rest.split_at_mut(vertices * rank);
            rest = tail;
            let (differences, more) = bytes.split_at(vertices * rank);
            bytes = more;
            for component in 0..rank {
                let mut before = 0i8;
                let differences = &differences[component * vertices..][..vertices];
                let weights = weights.iter_mut().skip(component).step_by(rank);
                for (weight, difference) in weights.zip(differences) {
                    before = before.wrapping_add(difference.cast_signed());
                    *weight = before;
                }
            }
        }
        Ok(transfer)
    }
}

/// Takes `count` elements off the front; allocates only what is there.
fn take<T: AnyBitPattern>(bytes: &mut &[u8], count: usize) -> Option<Vec<T>> {
    let (head, tail) = bytes.split_at_checked(count.checked_mul(size_of::<T>())?)?;
    *bytes = tail;
    Some(
        head.chunks_exact(size_of::<T>())
            .map(bytemuck::pod_read_unaligned)
            .collect(),
    )
}
