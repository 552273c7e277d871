//! Distant lighting as a sum of spherical Gaussians, beside sources with an outline of their own.

use crate::math;
use std::f32::consts::{PI, TAU};

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

use crate::container::{Kind, Limits, Reader, SectionKind, Writer};
use crate::{Error, Issue};

/// A spherical Gaussian G(ω) = amplitude · exp(sharpness (axis·ω − 1)).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Lobe {
    /// Unit vector, world space.
    pub axis: [f32; 3],
    /// Sharpness λ, greater than 0.
    pub sharpness: f32,
    /// Linear Rec.709 radiance at the axis, each at least 0.
    pub amplitude: [f32; 3],
    /// Zero.
    pub reserved: f32,
}

/// Largest deviation of an axis's squared length from 1: far above f32 rounding, far below
/// what would dim a lobe.
const AXIS_TOLERANCE: f32 = 1e-3;

/// How well the lobes fit the image they came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentReport {
    /// Source file name, without folders.
    pub source: String,
    /// Width and height of the source image.
    pub source_size: [u32; 2],
    /// NaN, infinite or negative pixels that were repaired.
    pub repaired_pixels: u64,
    /// Solid-angle-weighted ‖fit − image‖₂ / ‖image‖₂ over all channels.
    pub relative_l2: f32,
    /// Per channel (energy of fit − energy of image) / energy of image.
    pub energy_error: [f32; 3],
}

/// Most levels of a [`Prefiltered`]: 1024² texels in the sharpest.
pub const MAX_PREFILTERED_LEVELS: u32 = 10;

/// The image as seen through lobes of decreasing sharpness.
///
/// Level i of L is an octahedral map of N × N texels, N = 2^(L − i), row 0 first, with texel
/// centres at (j + ½)/N. A texel is the mean radiance under the lobe of sharpness
/// [`Self::SHARPNESS`] · N² about its direction, as 32 bits: 9 of red lowest, 9 of green, 9 of
/// blue, and 5 of an exponent e; a channel is its 9 bits · 2^(e − 24).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Prefiltered {
    /// All levels, sharpest first; none where there is no image.
    pub texels: Vec<u32>,
}

impl Prefiltered {
    /// Sharpness of a level's lobes in its texels per row, squared: lobes about as wide (1/√λ) as
    /// 1.3 texels.
    pub const SHARPNESS: f32 = 0.05;

    /// Number of levels, 0 to [`MAX_PREFILTERED_LEVELS`]; `None` where `texels` is not a
    /// number of whole levels.
    pub fn levels(&self) -> Option<u32> {
        (0..=MAX_PREFILTERED_LEVELS).find(|&levels| Self::texel_count(levels) == self.texels.len())
    }

    /// Texels of the given number of levels.
    pub fn texel_count(levels: u32) -> usize {
        (1..=levels).map(|level| 1 << (2 * level)).sum()
    }
}

/// Most sources of an environment.
pub const MAX_SOURCES: usize = 8;

/// Most texels of one source.
pub const MAX_SOURCE_TEXELS: usize = 1 << 14;

/// A compact bright part of the image, such as a sun, a lamp or a window: what of it exceeds its
/// surroundings, texel by texel.
///
/// Texels lie on a grid of angles: that of row i and column j of a source is centred on
/// θ = `theta` + i · `row_step` from +Y and φ = `phi` + j · `column_step` about it, the direction
/// (sinθ sinφ, cosθ, −sinθ cosφ). Radiance is bilinear between their centres and falls to 0
/// one step beyond the outermost: a texel is a tent. It is radiance × `column_step` · 2 sinθ
/// sin(`row_step`/2) of light.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Source {
    /// Of the first row's centres, radians, 0 to π.
    pub theta: f32,
    /// Of the first column's centres, radians, −2π to 2π.
    pub phi: f32,
    /// Between rows, radians, greater than 0 and at most π; no row lies beyond π.
    pub row_step: f32,
    /// Between columns, radians, greater than 0; all columns together at most 2π, but for
    /// rounding.
    pub column_step: f32,
    /// Number of rows, at least 1.
    pub rows: u32,
    /// Number of columns, at least 1.
    pub columns: u32,
}

impl Source {
    /// Number of texels, rows × columns.
    pub fn texels(&self) -> usize {
        self.rows as usize * self.columns as usize
    }

    /// Direction of the middle of the grid; unit.
    pub fn direction(&self) -> [f32; 3] {
        let theta = self.theta + 0.5 * (self.rows as f32 - 1.0) * self.row_step;
        let phi = self.phi + 0.5 * (self.columns as f32 - 1.0) * self.column_step;
        let ((sin_theta, cos_theta), (sin_phi, cos_phi)) =
            (math::sin_cos(theta), math::sin_cos(phi));
        [sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi]
    }

    /// Angles that the grid spans along a column and along its middle row, radians.
    pub fn extent(&self) -> [f32; 2] {
        let height = self.rows as f32 * self.row_step;
        let middle = self.theta + 0.5 * (height - self.row_step);
        [
            height,
            self.columns as f32 * self.column_step * math::sin(middle),
        ]
    }
}

/// Rounding of the last row or column of a source, in steps.
const SOURCE_TOLERANCE: f32 = 0.01;

/// A decoded environment asset.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Environment {
    /// How it was made.
    pub report: EnvironmentReport,
    /// The lobes, brightest energy first.
    pub lobes: Vec<Lobe>,
    /// The image without its sources, for sharp reflections; may be empty.
    pub prefiltered: Prefiltered,
    /// Suns, lamps and windows, at most [`MAX_SOURCES`], the one that matters most first. The
    /// lobes do not have their light.
    pub sources: Vec<Source>,
    /// Linear Rec.709 radiance of all sources' texels, source by source, row by row.
    pub source_texels: Vec<[f32; 3]>,
}

/// Decodes and validates an environment.
pub fn read_environment(bytes: &[u8], limits: &Limits) -> Result<Environment, Error> {
    let mut reader = Reader::new(bytes, Kind::Environment, limits)?;
    let report: EnvironmentReport = reader.metadata()?;
    let lobes: Vec<Lobe> = reader.pod(SectionKind::Lobes)?;
    let texels = reader.pod(SectionKind::Prefiltered)?;
    let sources = reader.pod(SectionKind::Sources)?;
    let source_texels = reader.pod(SectionKind::SourceTexels)?;
    reader.finish()?;
    let environment = Environment {
        report,
        lobes,
        prefiltered: Prefiltered { texels },
        sources,
        source_texels,
    };
    environment.validate()?;
    Ok(environment)
}

/// Encodes an environment; the same value gives the same bytes.
pub fn write_environment(environment: &Environment) -> Result<Vec<u8>, Error> {
    environment.validate()?;
    let mut writer = Writer::new(Kind::Environment);
    writer.metadata(&environment.report)?;
    writer.section(SectionKind::Lobes, &environment.lobes)?;
    writer.section(SectionKind::Prefiltered, &environment.prefiltered.texels)?;
    writer.section(SectionKind::Sources, &environment.sources)?;
    writer.section(SectionKind::SourceTexels, &environment.source_texels)?;
    Ok(writer.finish())
}

impl Environment {
    /// Checks that every number, length and index is in its range, as it is where an asset is read.
    pub fn validate(&self) -> Result<(), Error> {
        let Environment {
            report,
            lobes,
            prefiltered,
            sources,
            source_texels,
        } = self;
        if prefiltered.levels().is_none() {
            return Err(Error::section(
                Issue::BadLength,
                SectionKind::Prefiltered,
                format_args!("4 + 16 + ... texels of at most {MAX_PREFILTERED_LEVELS} levels"),
                format_args!("{} texels", prefiltered.texels.len()),
            ));
        }
        let fit = report.energy_error.iter().chain([&report.relative_l2]);
        if !fit.into_iter().all(|value| value.is_finite()) {
            return Err(Error::section(
                Issue::ValueOutOfRange,
                SectionKind::Metadata,
                "finite fit errors",
                format_args!("{report:?}"),
            ));
        }
        for (index, lobe) in lobes.iter().enumerate() {
            let length = lobe.axis.iter().map(|x| x * x).sum::<f32>();
            let valid = (length - 1.0).abs() < AXIS_TOLERANCE
                && lobe.sharpness > 0.0
                && lobe.sharpness.is_finite()
                && lobe.amplitude.iter().all(|a| a.is_finite() && *a >= 0.0)
                && lobe.reserved.to_bits() == 0;
            if !valid {
                return Err(Error::section(
                    Issue::ValueOutOfRange,
                    SectionKind::Lobes,
                    "unit axis, finite sharpness > 0, finite amplitude >= 0, reserved 0",
                    format_args!("lobe {index}: {lobe:?}"),
                ));
            }
        }
        validate_sources(sources, source_texels)
    }
}

fn validate_sources(sources: &[Source], texels: &[[f32; 3]]) -> Result<(), Error> {
    if sources.len() > MAX_SOURCES {
        return Err(Error::section(
            Issue::BadLength,
            SectionKind::Sources,
            format_args!("at most {MAX_SOURCES} sources"),
            sources.len(),
        ));
    }
    for (index, source) in sources.iter().enumerate() {
        let steps = |count: u32| count as f32 - SOURCE_TOLERANCE;
        let valid = (0.0..=PI).contains(&source.theta)
            && (-TAU..=TAU).contains(&source.phi)
            && source.row_step > 0.0
            && source.row_step <= PI
            && source.column_step > 0.0
            && source.column_step <= TAU
            && (1..=MAX_SOURCE_TEXELS as u64)
                .contains(&(u64::from(source.rows) * u64::from(source.columns)))
            && source.theta + (steps(source.rows) - 1.0) * source.row_step <= PI
            && steps(source.columns) * source.column_step <= TAU;
        if !valid {
            return Err(Error::section(
                Issue::ValueOutOfRange,
                SectionKind::Sources,
                "a grid of 1 to 16384 texels on the sphere",
                format_args!("source {index}: {source:?}"),
            ));
        }
    }
    let expected: usize = sources.iter().map(Source::texels).sum();
    if texels.len() != expected {
        return Err(Error::section(
            Issue::BadLength,
            SectionKind::SourceTexels,
            format_args!("{expected} texels"),
            texels.len(),
        ));
    }
    let valid = |texel: &[f32; 3]| texel.iter().all(|value| value.is_finite() && *value >= 0.0);
    if let Some(index) = texels.iter().position(|texel| !valid(texel)) {
        return Err(Error::section(
            Issue::ValueOutOfRange,
            SectionKind::SourceTexels,
            "finite radiance >= 0",
            format_args!("texel {index}: {:?}", texels[index]),
        ));
    }
    Ok(())
}
