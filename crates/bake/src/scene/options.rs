//! What a bake trades, and whether that goes together.

use relight_format::{CHANNELS_PER_TILE, MAX_TILES_PER_CLUSTER, Representation};
use serde::Serialize;

use super::error::Error;
use crate::error::Objection;
use crate::transfer;
use crate::visibility::places::EXPOSURE_RESOLUTION;

/// Whether this build can represent a scene by one basis, to compare with the paper.
pub const PAPER: bool = cfg!(feature = "paper");

/// Of [`Options::sample_resolution`].
const MOST_SAMPLES: u32 = 256;
/// A scene is small that has fewer vertices once it is divided.
pub(super) const ROOM_VERTICES: usize = 65_536;

/// What to trade. Every field has its default in [`Options::standard`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Options {
    /// Rays per vertex are this number squared; a multiple of `basis_resolution`.
    pub sample_resolution: u32,
    /// Texels per side of a stored basis image.
    pub basis_resolution: u32,
    /// SSDFs are clamped to ± this angle, radians.
    pub distance_clamp: f32,
    /// Clustered or global principal components; the latter with the feature `paper`.
    pub representation: Representation,
    /// Clustered: tiles of four images per cluster, at most. The GPU's cost of a sample is
    /// proportional to the tiles.
    pub max_tiles: u32,
    /// Clustered: at what rate clusters buy accuracy with bytes, as the error, radians, that
    /// one of ordinary detail ends near. Finer detail ends above it, the rest below.
    pub aim: f32,
    /// Clustered: in place of `aim`, the error that the scene's surface shall have, radians
    /// ([`relight_format::VisibilityErrors::surface`]).
    pub max_error: Option<f32>,
    /// Clustered: in place of `aim`, the bytes that the asset may have.
    pub max_bytes: Option<u64>,
    /// Global: components besides the mean.
    pub global_rank: u32,
    /// Longest edge after refinement, as a fraction of the diagonal of the scene without
    /// its ground, or of what is small beside that (`crate::mesh::size`). A scene file may set its own in metres. Vertices that lie closer together
    /// also see more alike, and share more of what is stored: half of the length costs twice
    /// the bytes.
    pub max_edge: f32,
    /// Where the mesh has fewer vertices then, its longest edges are divided further, until it has about so
    /// many, or until no edge is longer than a quarter of `max_edge`: in a small scene that takes little time.
    pub least_vertices: usize,
    /// Where the mesh is finer than this, as a fraction of the same diagonal, visibility and bounced light
    /// are found at places so far apart, and interpolated at those between
    /// (`crate::visibility::sparse`); at fewer still where that would take too long (`crate::visibility::clutter`). 0: they are found
    /// everywhere.
    pub sample_spacing: f32,
    /// Rays per side of an octahedral map of all directions that tell whether a place sees anything, or lies behind
    /// what touches it (`crate::visibility::places`); 1 to 64.
    pub exposure_resolution: u32,
    /// Whether a scene of rooms, while it is small, is sampled more finely than the rest tells: light gets there from
    /// few of the directions that are sampled.
    pub finer_rooms: bool,
    /// Triangles in which interpolation is checked once a scene is baked, about; at least 1.
    pub probes: usize,
    /// Edges are cut further where interpolated visibility is off by more than this, radians
    /// (`crate::mesh::refine::Bound::error`, at a length of 0.02 of the diagonal); infinite
    /// for nowhere. A scene file may set its own.
    pub refine_error: f32,
    /// Refinement stops here.
    pub max_vertices: usize,
    /// How light that bounces is gathered.
    pub transfer: transfer::Options,
}

impl Options {
    /// For looking at a scene soon: coarse samples, far apart, a coarse budget.
    pub fn draft() -> Self {
        Self {
            sample_resolution: 32,
            basis_resolution: 32,
            max_tiles: 2,
            aim: 0.02,
            max_edge: 0.08,
            least_vertices: 32_768,
            sample_spacing: 0.008,
            exposure_resolution: 4,
            finer_rooms: true,
            probes: 512,
            refine_error: f32::INFINITY,
            transfer: transfer::Options::draft(),
            ..Self::standard()
        }
    }

    /// The default.
    pub fn standard() -> Self {
        Self {
            sample_resolution: 128,
            basis_resolution: 64,
            distance_clamp: 0.5,
            representation: Representation::ClusteredPca,
            max_tiles: 4,
            aim: 0.005,
            max_error: None,
            max_bytes: None,
            global_rank: 24,
            max_edge: 0.02,
            least_vertices: 0,
            sample_spacing: 0.0,
            exposure_resolution: EXPOSURE_RESOLUTION,
            finer_rooms: false,
            probes: 2048,
            refine_error: f32::INFINITY,
            max_vertices: 1_000_000,
            transfer: transfer::Options::standard(),
        }
    }

    /// Small errors at several times the size, and vertices where shadows fall.
    pub fn high() -> Self {
        Self {
            aim: 0.0025,
            max_tiles: 6,
            max_edge: 0.06,
            refine_error: 0.01,
            transfer: transfer::Options::high(),
            ..Self::standard()
        }
    }

    /// In place of these for a small scene of rooms: by those of a draft errors there are half as large again, in all it
    /// takes twice the time.
    pub(super) fn for_rooms(&self) -> Self {
        let standard = Self::standard();
        Self {
            sample_resolution: if self.sample_resolution <= MOST_SAMPLES / 2 {
                2 * self.sample_resolution
            } else {
                self.sample_resolution
            },
            max_tiles: self.max_tiles.max(standard.max_tiles),
            aim: self.aim.min(standard.aim),
            least_vertices: self.least_vertices.max(ROOM_VERTICES),
            sample_spacing: 0.6 * self.sample_spacing,
            exposure_resolution: self.exposure_resolution.max(EXPOSURE_RESOLUTION),
            ..self.clone()
        }
    }

    /// That every option is in its range, and that none contradicts another.
    pub(super) fn check(&self) -> Result<(), Error> {
        let Options {
            sample_resolution: sample,
            basis_resolution: basis,
            ..
        } = *self;
        let wrong = |place: &str, expected: String, found: String| {
            Err(Error::Options(Objection::new(place, expected, found)))
        };
        if !(8..=512).contains(&basis)
            || !(basis..=MOST_SAMPLES).contains(&sample)
            || sample % basis != 0
        {
            return wrong(
                "sample_resolution",
                "a basis resolution in 8..=512 that divides a sample resolution up to 256".into(),
                format!("{basis} and {sample}"),
            );
        }
        if !(1..=MAX_TILES_PER_CLUSTER).contains(&self.max_tiles) {
            return wrong(
                "max_tiles",
                format!("1..={MAX_TILES_PER_CLUSTER}"),
                self.max_tiles.to_string(),
            );
        }
        let max_rank = MAX_TILES_PER_CLUSTER * CHANNELS_PER_TILE as u32 - 1;
        if self.global_rank > max_rank {
            return wrong(
                "global_rank",
                format!("0..={max_rank}"),
                self.global_rank.to_string(),
            );
        }
        if self.representation == Representation::GlobalPca && !PAPER {
            return wrong(
                "representation",
                "a build with the feature `paper` for one basis of the whole scene".into(),
                "one without".into(),
            );
        }
        if self.max_bytes.is_some() && self.representation == Representation::GlobalPca {
            return wrong(
                "max_bytes",
                "a rank: the global representation has no other choice".into(),
                "a number of bytes".into(),
            );
        }
        if !(0.0..1.0).contains(&self.sample_spacing) {
            return wrong(
                "sample_spacing",
                "a fraction of the diagonal below 1".into(),
                self.sample_spacing.to_string(),
            );
        }
        if !(1..=64).contains(&self.exposure_resolution) {
            return wrong(
                "exposure_resolution",
                "1..=64".into(),
                self.exposure_resolution.to_string(),
            );
        }
        if self.probes == 0 {
            return wrong("probes", "at least 1".into(), "0".into());
        }
        let positive = [
            self.distance_clamp,
            self.aim,
            self.max_error.unwrap_or(self.aim),
            self.max_edge,
            self.refine_error,
        ];
        if !positive.iter().all(|value| *value > 0.0) || self.distance_clamp > 3.0 {
            return wrong(
                "options",
                "a clamp in (0, 3], an error and an edge length above 0".into(),
                format!("{positive:?}"),
            );
        }
        Ok(())
    }
}
