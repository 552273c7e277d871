//! A second implementation of the container, written from FORMAT.md and sharing nothing
//! with the crate, that can also write what the specification forbids.

/// Bytes before the section table.
pub const HEADER_LENGTH: usize = 24;
/// Bytes of one row of it.
pub const ENTRY_LENGTH: usize = 32;

/// One section, with every field of its row free to lie.
#[derive(Clone, Debug)]
pub struct Section {
    pub kind: u32,
    pub stored: Vec<u8>,
    pub raw_length: u64,
    pub checksum: u32,
}

impl Section {
    /// An honest section.
    pub fn new(kind: u32, raw: &[u8]) -> Self {
        let stored = zstd::bulk::compress(raw, 1).expect("zstd accepts any bytes");
        Self::stored(kind, stored, raw.len() as u64)
    }

    /// A section of bytes that are already compressed.
    pub fn stored(kind: u32, stored: Vec<u8>, raw_length: u64) -> Self {
        let checksum = crc32fast::hash(&stored);
        Self {
            kind,
            stored,
            raw_length,
            checksum,
        }
    }

    /// The decompressed bytes.
    pub fn raw(&self) -> Vec<u8> {
        zstd::bulk::decompress(&self.stored, self.raw_length as usize).expect("an honest section")
    }
}

/// A whole file.
#[derive(Clone, Debug)]
pub struct File {
    pub version: u32,
    pub kind: u32,
    pub sections: Vec<Section>,
}

impl File {
    /// Takes a valid file apart.
    pub fn parse(bytes: &[u8]) -> Self {
        let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let u64_at = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        let sections = (0..u32_at(16) as usize)
            .map(|index| {
                let row = HEADER_LENGTH + index * ENTRY_LENGTH;
                let (start, length) = (u64_at(row + 8) as usize, u64_at(row + 16) as usize);
                Section {
                    kind: u32_at(row),
                    checksum: u32_at(row + 4),
                    stored: bytes[start..start + length].to_vec(),
                    raw_length: u64_at(row + 24),
                }
            })
            .collect();
        Self {
            version: u32_at(8),
            kind: u32_at(12),
            sections,
        }
    }

    /// The file's bytes, with offsets computed.
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = b"RELIGHT\n".to_vec();
        for word in [self.version, self.kind, self.sections.len() as u32, 0] {
            bytes.extend(word.to_le_bytes());
        }
        let mut offset = HEADER_LENGTH + self.sections.len() * ENTRY_LENGTH;
        for section in &self.sections {
            bytes.extend(section.kind.to_le_bytes());
            bytes.extend(section.checksum.to_le_bytes());
            bytes.extend((offset as u64).to_le_bytes());
            bytes.extend((section.stored.len() as u64).to_le_bytes());
            bytes.extend(section.raw_length.to_le_bytes());
            offset += section.stored.len();
        }
        for section in &self.sections {
            bytes.extend(&section.stored);
        }
        bytes
    }

    /// The same file with the raw bytes of section `index` changed and all of its row
    /// made to fit: only the meaning of the bytes can give the change away.
    pub fn with_raw(&self, index: usize, edit: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
        let mut file = self.clone();
        let section = &mut file.sections[index];
        let mut raw = section.raw();
        edit(&mut raw);
        *section = Section::new(section.kind, &raw);
        file.bytes()
    }
}
