//! The `.relight` container: bytes to typed sections and back.
//!
//! One container serves scenes, environments and materials. [`Scene`], [`Environment`] and
//! [`MaterialAsset`] are the decoded assets; [`read_scene`], [`write_scene`] and their like
//! convert them from and to bytes.
//!
//! Readers treat bytes as untrusted: every length is checked against the file and against
//! [`Limits`] before anything is allocated, every index against the array it indexes, and
//! every error names the section, what was expected and what was found.
#![doc = ""]
#![doc = include_str!("../FORMAT.md")]

mod compression;
mod container;
mod environment;
mod error;
mod file;
mod geometry;
mod material;
mod material_asset;
pub mod math;
mod prediction;
mod read;
mod scene;
mod texels;
mod transfer;

pub use container::{Kind, Limits, MAGIC, SectionInfo, SectionKind, VERSION, inspect};
pub use environment::{
    Environment, EnvironmentReport, Lobe, MAX_PREFILTERED_LEVELS, MAX_SOURCE_TEXELS, MAX_SOURCES,
    Prefiltered, Source, read_environment, write_environment,
};
pub use error::{Error, Issue};
pub use file::write_file;
pub use material::{
    Blend, Camera, FieldOfView, FittedLobe, Layer, MAX_FITTED_LOBES, MAX_LAYERS, MAX_REFLECTIONS,
    Material, ModelParameters, RATIO_NODES, RATIO_SHAPE, RATIO_SIZE, REFLECTION_MODELS,
    ReflectionModel, Roughness, Specular, Surface, Texture, TextureEncoding, TextureShape,
    TextureSlot, plain_material,
};
pub use material_asset::{MaterialAsset, MaterialReport, read_material, write_material};
pub use prediction::predict;
pub use read::read_scene;
pub use scene::{
    BakeReport, CHANNELS_PER_TILE, Cluster, MAX_TILES_PER_CLUSTER, Representation, Scene,
    StoredTexels, Triangle, Vertex, VisibilityErrors, VisibilityParameters, write_scene,
    write_scene_with,
};
pub use transfer::{
    MAX_TRANSFER_ORDER, MAX_TRANSFER_RANK, TRANSFER_OUTPUTS, Transfer, TransferGroup,
};
