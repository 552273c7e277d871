//! One material with its textures, to be named by scene files.

use serde::{Deserialize, Serialize};

use crate::container::{Kind, Limits, Reader, SectionKind, Writer};
use crate::material::TextureShape;
use crate::scene::validate_textures;
use crate::texels;
use crate::{Error, Issue, Material, Texture};

/// How well the lobes fit what they came from. Zero where nothing was fitted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialReport {
    /// Source file name, without folders.
    pub source: String,
    /// Relative L2 error of the fitted model, cosine included.
    pub relative_l2: f32,
    /// The same with the ratio that the lobes are multiplied by; that is what is shaded.
    pub corrected_relative_l2: f32,
    /// The same of the spherical Gaussians that the runtime makes of the lobes, without the ratio.
    pub shaded_relative_l2: f32,
    /// Largest error of the albedo over view directions, as a fraction of it.
    pub albedo_error: f32,
}

/// A decoded material asset.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialAsset {
    /// How it was made.
    pub report: MaterialReport,
    /// The material.
    pub material: Material,
    /// The textures that it refers to.
    pub textures: Vec<Texture>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Metadata {
    report: MaterialReport,
    material: Material,
    textures: Vec<TextureShape>,
}

/// Decodes and validates a material.
pub fn read_material(bytes: &[u8], limits: &Limits) -> Result<MaterialAsset, Error> {
    let mut reader = Reader::new(bytes, Kind::Material, limits)?;
    let metadata: Metadata = reader.metadata()?;
    let version = reader.version();
    let stored: Vec<u8> = reader.pod(SectionKind::Texels)?;
    reader.finish()?;
    let asset = MaterialAsset {
        report: metadata.report,
        material: metadata.material,
        textures: texels::decode(&metadata.textures, &stored, version)?,
    };
    asset.validate()?;
    Ok(asset)
}

/// Encodes a material; the same value gives the same bytes.
pub fn write_material(asset: &MaterialAsset) -> Result<Vec<u8>, Error> {
    asset.validate()?;
    let mut writer = Writer::new(Kind::Material);
    writer.metadata(&Metadata {
        report: asset.report.clone(),
        material: asset.material.clone(),
        textures: asset.textures.iter().map(Texture::shape).collect(),
    })?;
    writer.section(SectionKind::Texels, &texels::encode(&asset.textures))?;
    Ok(writer.finish())
}

impl MaterialAsset {
    /// Checks that every number, length and index is in its range, as it is where an asset is read.
    pub fn validate(&self) -> Result<(), Error> {
        let shapes: Vec<_> = self.textures.iter().map(Texture::shape).collect();
        self.material.validate(&shapes, false)?;
        validate_textures(&self.textures)?;
        let report = &self.report;
        let errors = [
            report.relative_l2,
            report.corrected_relative_l2,
            report.shaded_relative_l2,
            report.albedo_error,
        ];
        if errors
            .iter()
            .all(|error| error.is_finite() && *error >= 0.0)
        {
            Ok(())
        } else {
            Err(Error::section(
                Issue::ValueOutOfRange,
                SectionKind::Metadata,
                "finite errors >= 0",
                format_args!("{report:?}"),
            ))
        }
    }
}
