//! Header, section table, compression and checksums: everything that does not depend on
//! what an asset means.

use std::io::Read as _;

use bytemuck::Pod;
use serde::{Serialize, de::DeserializeOwned};

use crate::compression::{self, Decoder};
use crate::{Error, Issue};

/// First eight bytes of every asset. The line feed catches text-mode transfers.
pub const MAGIC: [u8; 8] = *b"RELIGHT\n";
/// Format version this crate writes.
pub const VERSION: u32 = 5;
/// The first version that it reads.
const FIRST_VERSION: u32 = 4;

const HEADER_LENGTH: usize = 24;
const ENTRY_LENGTH: usize = 32;
/// More sections than any version defines; bounds the table before it is read.
const MAX_SECTIONS: u32 = 64;
/// Most bytes of metadata, whatever [`Limits`] say.
const MAX_METADATA_BYTES: usize = 16 << 20;
/// Bytes decompressed at a time: what a lying raw length can make a reader allocate.
const DECODE_BLOCK_BYTES: usize = 1 << 20;

/// What an asset holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kind {
    /// Geometry, materials and visibility.
    Scene = 1,
    /// Spherical Gaussian lighting.
    Environment = 2,
    /// One material and its textures.
    Material = 3,
}

impl Kind {
    fn from_u32(value: u32) -> Option<Self> {
        [Self::Scene, Self::Environment, Self::Material]
            .into_iter()
            .find(|kind| *kind as u32 == value)
    }
}

/// What a section holds. Values are part of the format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum SectionKind {
    /// Metadata, as JSON.
    Metadata = 1,
    /// [`crate::Vertex`] array, as differences from what neighbours predict.
    Vertices = 2,
    /// [`crate::Triangle`] array, as distances between corners.
    Triangles = 3,
    /// [`crate::Cluster`] array.
    Clusters = 4,
    /// 16-bit SSDF coefficients, as differences from what neighbours predict.
    Coefficients = 5,
    /// 8-bit basis tiles, as differences from what neighbours predict.
    Basis = 6,
    /// Texels of all textures, as differences from what neighbours predict.
    Texels = 7,
    /// [`crate::Lobe`] array.
    Lobes = 8,
    /// Texels of a [`crate::Prefiltered`].
    Prefiltered = 9,
    /// [`crate::Source`] array.
    Sources = 10,
    /// Texels of all sources, concatenated.
    SourceTexels = 11,
    /// A [`crate::Transfer`]; optional.
    Transfer = 12,
    /// Second texture coordinates of vertices, as differences from what neighbours predict;
    /// optional.
    SecondUvs = 13,
}

impl SectionKind {
    fn from_u32(value: u32) -> Option<Self> {
        [
            Self::Metadata,
            Self::Vertices,
            Self::Triangles,
            Self::Clusters,
            Self::Coefficients,
            Self::Basis,
            Self::Texels,
            Self::Lobes,
            Self::Prefiltered,
            Self::Sources,
            Self::SourceTexels,
            Self::Transfer,
            Self::SecondUvs,
        ]
        .into_iter()
        .find(|kind| *kind as u32 == value)
    }
}

/// How much memory a reader may allocate for one asset.
///
/// Arrays are decompressed in place, so the sum of raw lengths bounds them; those that hold
/// differences, and textures, are held twice while they are decoded. Decoded metadata takes
/// a few times its raw length, and decompression up to 8 MiB of window.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Sum of the raw lengths of all sections, bytes. Default 4 GiB.
    pub max_bytes: u64,
    /// Raw length of the metadata section, bytes. Default 16 MiB, which is also the most
    /// that the format allows.
    pub max_metadata_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_bytes: 4 << 30,
            max_metadata_bytes: MAX_METADATA_BYTES as u64,
        }
    }
}

/// One row of the section table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SectionInfo {
    /// What it holds.
    pub kind: SectionKind,
    /// Byte offset of the stored bytes in the file.
    pub offset: u64,
    /// Compressed length, bytes.
    pub stored_length: u64,
    /// Length after decompression, bytes.
    pub raw_length: u64,
    /// CRC-32 of the stored bytes.
    pub checksum: u32,
}

/// Reads the header and section table only: the asset's kind, version and sections.
#[allow(
    clippy::too_many_lines,
    reason = "checks of the header in the order of its bytes, as FORMAT.md has them"
)]
pub fn inspect(bytes: &[u8], limits: &Limits) -> Result<(Kind, u32, Vec<SectionInfo>), Error> {
    let take = |offset: usize, length: usize| {
        bytes.get(offset..offset + length).ok_or_else(|| {
            Error::invalid(
                Issue::Truncated,
                "header",
                format_args!("at least {} bytes", offset + length),
                format_args!("{} bytes", bytes.len()),
            )
        })
    };
    let u32_at = |offset: usize| -> Result<u32, Error> {
        Ok(u32::from_le_bytes(
            take(offset, 4)?.try_into().expect("four bytes"),
        ))
    };
    let u64_at = |offset: usize| -> Result<u64, Error> {
        Ok(u64::from_le_bytes(
            take(offset, 8)?.try_into().expect("eight bytes"),
        ))
    };
    let magic = take(0, 8)?;
    if magic != MAGIC {
        return Err(Error::invalid(
            Issue::BadMagic,
            "header",
            format_args!("\"{}\"", MAGIC.escape_ascii()),
            format_args!("\"{}\"", magic.escape_ascii()),
        ));
    }
    let version = u32_at(8)?;
    if !(FIRST_VERSION..=VERSION).contains(&version) {
        return Err(Error::invalid(
            Issue::UnknownVersion,
            "header",
            format_args!("version {FIRST_VERSION} to {VERSION}"),
            format_args!("version {version}"),
        ));
    }
    let kind_value = u32_at(12)?;
    let kind = Kind::from_u32(kind_value).ok_or_else(|| {
        Error::invalid(
            Issue::WrongKind,
            "header",
            "kind 1 (scene), 2 (environment) or 3 (material)",
            kind_value,
        )
    })?;
    let count = u32_at(16)?;
    if count > MAX_SECTIONS {
        return Err(Error::invalid(
            Issue::BadSectionTable,
            "header",
            format_args!("at most {MAX_SECTIONS} sections"),
            count,
        ));
    }
    let reserved = u32_at(20)?;
    if reserved != 0 {
        return Err(Error::invalid(
            Issue::ReservedNotZero,
            "header",
            0,
            reserved,
        ));
    }
    let mut sections: Vec<SectionInfo> = Vec::with_capacity(count as usize);
    let mut end = (HEADER_LENGTH + count as usize * ENTRY_LENGTH) as u64;
    let mut total = 0u64;
    for index in 0..count as usize {
        let entry = HEADER_LENGTH + index * ENTRY_LENGTH;
        let place = format!("section table entry {index}");
        let kind_value = u32_at(entry)?;
        let kind = SectionKind::from_u32(kind_value).ok_or_else(|| {
            Error::invalid(
                Issue::BadSectionTable,
                &place,
                "a known section kind",
                kind_value,
            )
        })?;
        let info = SectionInfo {
            kind,
            checksum: u32_at(entry + 4)?,
            offset: u64_at(entry + 8)?,
            stored_length: u64_at(entry + 16)?,
            raw_length: u64_at(entry + 24)?,
        };
        // Strictly ascending kinds make sections unique and the table canonical.
        if sections
            .last()
            .is_some_and(|last| last.kind as u32 >= kind as u32)
        {
            return Err(Error::invalid(
                Issue::BadSectionTable,
                &place,
                "section kinds in ascending order",
                format_args!("{kind:?}"),
            ));
        }
        if info.offset != end {
            return Err(Error::invalid(
                Issue::BadSectionTable,
                &place,
                format_args!("offset {end}"),
                format_args!("offset {}", info.offset),
            ));
        }
        end = end.checked_add(info.stored_length).ok_or_else(|| {
            Error::invalid(
                Issue::BadSectionTable,
                &place,
                "a length inside the file",
                info.stored_length,
            )
        })?;
        total = total.saturating_add(info.raw_length);
        if total > limits.max_bytes {
            return Err(Error::invalid(
                Issue::OverBudget,
                &place,
                format_args!("at most {} bytes in all", limits.max_bytes),
                format_args!("{total} bytes"),
            ));
        }
        sections.push(info);
    }
    match end.cmp(&(bytes.len() as u64)) {
        std::cmp::Ordering::Equal => Ok((kind, version, sections)),
        ordering => Err(Error::invalid(
            if ordering.is_gt() {
                Issue::Truncated
            } else {
                Issue::TrailingBytes
            },
            "file",
            format_args!("{end} bytes"),
            format_args!("{} bytes", bytes.len()),
        )),
    }
}

/// Hands out sections in order and checks that all were used.
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    limits: &'a Limits,
    version: u32,
    sections: std::vec::IntoIter<SectionInfo>,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(bytes: &'a [u8], expected: Kind, limits: &'a Limits) -> Result<Self, Error> {
        let (kind, version, sections) = inspect(bytes, limits)?;
        if kind != expected {
            return Err(Error::invalid(
                Issue::WrongKind,
                "header",
                format_args!("{expected:?}"),
                format_args!("{kind:?}"),
            ));
        }
        Ok(Self {
            bytes,
            limits,
            version,
            sections: sections.into_iter(),
        })
    }

    /// Of the format, that the file is in.
    pub(crate) fn version(&self) -> u32 {
        self.version
    }

    /// The next section, which must be of `kind`, as an array of little-endian elements.
    pub(crate) fn pod<T: Pod>(&mut self, kind: SectionKind) -> Result<Vec<T>, Error> {
        let info = self.next(kind)?;
        let stored = &self.bytes[info.offset as usize..][..info.stored_length as usize];
        let checksum = crc32fast::hash(stored);
        if checksum != info.checksum {
            return Err(Error::section(
                Issue::BadChecksum,
                kind,
                format_args!("{:08x}", info.checksum),
                format_args!("{checksum:08x}"),
            ));
        }
        let size = size_of::<T>();
        if !info.raw_length.is_multiple_of(size as u64) {
            return Err(Error::section(
                Issue::BadLength,
                kind,
                format_args!("a multiple of {size} bytes"),
                info.raw_length,
            ));
        }
        let over_budget = || {
            Error::section(
                Issue::OverBudget,
                kind,
                "memory for it",
                format_args!("{} bytes", info.raw_length),
            )
        };
        let length = usize::try_from(info.raw_length).map_err(|_| over_budget())? / size;
        let bad = |found: &dyn std::fmt::Display| {
            Error::section(
                Issue::BadCompression,
                kind,
                format_args!("{} bytes in one zstd frame", info.raw_length),
                found,
            )
        };
        let mut decoder = Decoder::new(stored).map_err(|error| bad(&error))?;
        // Grows as bytes arrive, by doubling up to the exact length: neither a lying raw
        // length nor a second copy of the section costs memory.
        let mut values: Vec<T> = Vec::new();
        while values.len() < length {
            let start = values.len();
            let block = (DECODE_BLOCK_BYTES / size).max(1);
            if start == values.capacity() {
                values
                    .try_reserve_exact(start.max(block).min(length - start))
                    .map_err(|_| over_budget())?;
            }
            values.resize(
                values.capacity().min(length).min(start + block),
                T::zeroed(),
            );
            decoder
                .read_exact(bytemuck::cast_slice_mut(&mut values[start..]))
                .map_err(|error| bad(&error))?;
        }
        let excess = decoder.read(&mut [0]).map_err(|error| bad(&error))?;
        if excess > 0 {
            return Err(bad(&"more bytes"));
        }
        match decoder.unused() {
            0 => Ok(values),
            unused => Err(bad(&format_args!("{unused} bytes after it"))),
        }
    }

    /// The metadata section.
    pub(crate) fn metadata<T: DeserializeOwned>(&mut self) -> Result<T, Error> {
        let limit = self
            .limits
            .max_metadata_bytes
            .min(MAX_METADATA_BYTES as u64);
        let length = self
            .sections
            .as_slice()
            .first()
            .map_or(0, |info| info.raw_length);
        if length > limit {
            return Err(Error::section(
                Issue::OverBudget,
                SectionKind::Metadata,
                format_args!("at most {limit} bytes"),
                length,
            ));
        }
        let raw: Vec<u8> = self.pod(SectionKind::Metadata)?;
        serde_json::from_slice(&raw).map_err(|error| {
            Error::section(
                Issue::BadMetadata,
                SectionKind::Metadata,
                "JSON metadata of this kind of asset",
                error,
            )
        })
    }

    /// Whether the next section is of `kind`.
    pub(crate) fn has(&self, kind: SectionKind) -> bool {
        let next = self.sections.as_slice().first();
        next.is_some_and(|info| info.kind == kind)
    }

    fn next(&mut self, kind: SectionKind) -> Result<SectionInfo, Error> {
        let found = match self.sections.next() {
            Some(info) if info.kind == kind => return Ok(info),
            Some(info) => format!("section {:?}", info.kind),
            None => "no more sections".to_owned(),
        };
        Err(Error::section(
            Issue::MissingSection,
            kind,
            "it next",
            found,
        ))
    }

    /// Fails if a section was not asked for.
    pub(crate) fn finish(mut self) -> Result<(), Error> {
        match self.sections.next() {
            None => Ok(()),
            Some(info) => Err(Error::section(
                Issue::BadSectionTable,
                info.kind,
                "no such section in this kind of asset",
                "one",
            )),
        }
    }
}

/// Collects sections; the counterpart of [`Reader`].
pub(crate) struct Writer {
    kind: Kind,
    sections: Vec<(SectionInfo, Vec<u8>)>,
}

impl Writer {
    pub(crate) fn new(kind: Kind) -> Self {
        Self {
            kind,
            sections: Vec::new(),
        }
    }

    pub(crate) fn section<T: Pod>(&mut self, kind: SectionKind, values: &[T]) -> Result<(), Error> {
        const {
            assert!(
                cfg!(target_endian = "little"),
                "POD sections are little-endian"
            );
        };
        let raw: &[u8] = bytemuck::cast_slice(values);
        let compress = match kind {
            SectionKind::Basis => compression::compress_noise,
            SectionKind::Texels | SectionKind::Coefficients | SectionKind::Transfer => {
                compression::compress_numbers
            }
            _ => compression::compress,
        };
        let stored = compress(raw).map_err(|error| {
            Error::section(
                Issue::BadCompression,
                kind,
                "zstd to accept the bytes",
                error,
            )
        })?;
        let info = SectionInfo {
            kind,
            offset: 0,
            stored_length: stored.len() as u64,
            raw_length: raw.len() as u64,
            checksum: crc32fast::hash(&stored),
        };
        self.sections.push((info, stored));
        Ok(())
    }

    pub(crate) fn metadata<T: Serialize>(&mut self, value: &T) -> Result<(), Error> {
        let raw = serde_json::to_vec(value).map_err(|error| {
            Error::section(
                Issue::BadMetadata,
                SectionKind::Metadata,
                "encodable metadata",
                error,
            )
        })?;
        if raw.len() > MAX_METADATA_BYTES {
            return Err(Error::section(
                Issue::OverBudget,
                SectionKind::Metadata,
                format_args!("at most {MAX_METADATA_BYTES} bytes"),
                raw.len(),
            ));
        }
        self.section(SectionKind::Metadata, &raw)
    }

    /// With another's sections after its own.
    pub(crate) fn followed_by(mut self, other: Self) -> Self {
        self.sections.extend(other.sections);
        self
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        let mut offset = (HEADER_LENGTH + self.sections.len() * ENTRY_LENGTH) as u64;
        let mut bytes = Vec::new();
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend((self.kind as u32).to_le_bytes());
        bytes.extend((self.sections.len() as u32).to_le_bytes());
        bytes.extend(0u32.to_le_bytes());
        for (info, _) in &self.sections {
            bytes.extend((info.kind as u32).to_le_bytes());
            bytes.extend(info.checksum.to_le_bytes());
            bytes.extend(offset.to_le_bytes());
            bytes.extend(info.stored_length.to_le_bytes());
            bytes.extend(info.raw_length.to_le_bytes());
            offset += info.stored_length;
        }
        for (_, stored) in self.sections {
            bytes.extend(stored);
        }
        bytes
    }
}
