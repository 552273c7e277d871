//! Distant lighting as a sum of spherical Gaussians.

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

/// A decoded environment asset.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Environment {
    /// How it was made.
    pub report: EnvironmentReport,
    /// The lobes, brightest energy first.
    pub lobes: Vec<Lobe>,
    /// The image for sharp reflections; may be empty.
    pub prefiltered: Prefiltered,
}

/// Decodes and validates an environment.
pub fn read_environment(bytes: &[u8], limits: &Limits) -> Result<Environment, Error> {
    let mut reader = Reader::new(bytes, Kind::Environment, limits)?;
    let report: EnvironmentReport = reader.metadata()?;
    let lobes: Vec<Lobe> = reader.pod(SectionKind::Lobes)?;
    let texels = reader.pod(SectionKind::Prefiltered)?;
    reader.finish()?;
    let environment = Environment {
        report,
        lobes,
        prefiltered: Prefiltered { texels },
    };
    validate(&environment)?;
    Ok(environment)
}

/// Encodes an environment; the same value gives the same bytes.
pub fn write_environment(environment: &Environment) -> Result<Vec<u8>, Error> {
    validate(environment)?;
    let mut writer = Writer::new(Kind::Environment);
    writer.metadata(&environment.report)?;
    writer.section(SectionKind::Lobes, &environment.lobes)?;
    writer.section(SectionKind::Prefiltered, &environment.prefiltered.texels)?;
    Ok(writer.finish())
}

fn validate(environment: &Environment) -> Result<(), Error> {
    let Environment {
        report,
        lobes,
        prefiltered,
    } = environment;
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
    Ok(())
}
