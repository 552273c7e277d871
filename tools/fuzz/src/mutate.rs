//! Mutants that get past checksums: the parts that a checksum guards are taken apart, changed
//! and put together again.

use std::ops::Range;

/// What to put right after bytes have changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repair {
    /// Nothing.
    None,
    /// `.relight`: compressed sections, their lengths and checksums.
    Asset,
    /// Parts files: checksums of the header and the records.
    Parts,
    /// `.glb`: lengths of chunks.
    Glb,
}

const HEADER: usize = 24;
const ENTRY: usize = 32;
/// Most raw bytes of a section that is taken apart.
const MAX_RAW: usize = 1 << 20;

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let word = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(word.try_into().ok()?))
}

fn long(bytes: &[u8], at: usize) -> Option<u64> {
    let long = bytes.get(at..at.checked_add(8)?)?;
    Some(u64::from_le_bytes(long.try_into().ok()?))
}

/// A mutant of `bytes`, of at most `most` bytes: `change` alters what it is given in place
/// and within its capacity, as a fuzzer's own mutator does. `None` if the bytes are not of
/// the kind; then they can be changed as they are.
pub fn mutant(
    repair: Repair,
    bytes: &[u8],
    seed: u32,
    most: usize,
    change: &mut dyn FnMut(&mut Vec<u8>),
) -> Option<Vec<u8>> {
    let mutant = match repair {
        Repair::None => return None,
        Repair::Asset => asset(bytes, seed, change)?,
        Repair::Parts => parts(bytes, seed, change)?,
        Repair::Glb => glb(bytes, seed, change)?,
    };
    (mutant.len() <= most).then_some(mutant)
}

/// One section of an asset, decompressed, changed, compressed.
fn asset(bytes: &[u8], seed: u32, change: &mut dyn FnMut(&mut Vec<u8>)) -> Option<Vec<u8>> {
    let count = word(bytes, 16)? as usize;
    if !(1..=64).contains(&count) {
        return None;
    }
    let entries: Option<Vec<(u32, Vec<u8>, u64)>> = (0..count)
        .map(|index| {
            let at = HEADER + index * ENTRY;
            let start = usize::try_from(long(bytes, at + 8)?).ok()?;
            let length = usize::try_from(long(bytes, at + 16)?).ok()?;
            let stored = bytes.get(start..start.checked_add(length)?)?;
            Some((word(bytes, at)?, stored.to_vec(), long(bytes, at + 24)?))
        })
        .collect();
    let mut entries = entries?;
    let chosen = seed as usize % count;
    let (_, stored, raw_length) = &mut entries[chosen];
    let mut raw = zstd::bulk::decompress(stored, MAX_RAW).ok()?;
    change(&mut raw);
    // Half of the mutants keep the length that the table demands.
    if seed & 0x100 == 0 {
        raw.resize(usize::try_from(*raw_length).ok()?.min(MAX_RAW), 0);
    }
    *raw_length = raw.len() as u64;
    *stored = zstd::bulk::compress(&raw, 1).ok()?;
    let mut mutant = bytes.get(..HEADER)?.to_vec();
    let mut offset = (HEADER + count * ENTRY) as u64;
    for (kind, stored, raw_length) in &entries {
        mutant.extend(kind.to_le_bytes());
        mutant.extend(crc32fast::hash(stored).to_le_bytes());
        mutant.extend(offset.to_le_bytes());
        mutant.extend((stored.len() as u64).to_le_bytes());
        mutant.extend(raw_length.to_le_bytes());
        offset += stored.len() as u64;
    }
    for (_, stored, _) in &entries {
        mutant.extend(stored);
    }
    Some(mutant)
}

const PARTS_HEADER: usize = 48;
const RECORD: usize = 16;

/// The header or one record of a parts file.
fn parts(bytes: &[u8], seed: u32, change: &mut dyn FnMut(&mut Vec<u8>)) -> Option<Vec<u8>> {
    let mut records: Vec<Range<usize>> = Vec::new();
    let mut at = PARTS_HEADER;
    while let Some(length) = long(bytes, at + 8) {
        let start = at + RECORD;
        let end = start.checked_add(usize::try_from(length).ok()?)?;
        if end > bytes.len() {
            break;
        }
        records.push(at..end);
        at = end;
    }
    let mut header = bytes.get(..PARTS_HEADER)?.to_vec();
    let chosen = seed as usize % (records.len() + 1);
    if chosen == records.len() {
        let mut changed = header[8..PARTS_HEADER - 4].to_vec();
        change(&mut changed);
        changed.resize(PARTS_HEADER - 12, 0);
        header[8..PARTS_HEADER - 4].copy_from_slice(&changed);
    }
    let checksum = crc32fast::hash(&header[..PARTS_HEADER - 4]);
    header[PARTS_HEADER - 4..].copy_from_slice(&checksum.to_le_bytes());
    let mut mutant = header;
    for (index, record) in records.into_iter().enumerate() {
        let chunk = word(bytes, record.start)?;
        let mut payload = bytes[record.start + RECORD..record.end].to_vec();
        if index == chosen {
            // The last is an asset, with checksums of its own.
            payload = if let Some(payload) = asset(&payload, seed >> 8, change) {
                payload
            } else {
                change(&mut payload);
                payload
            };
        }
        let length = (payload.len() as u64).to_le_bytes();
        let guarded = [&chunk.to_le_bytes()[..], &length, &payload].concat();
        mutant.extend(chunk.to_le_bytes());
        mutant.extend(crc32fast::hash(&guarded).to_le_bytes());
        mutant.extend(length);
        mutant.extend(payload);
    }
    Some(mutant)
}

/// The JSON or the binary chunk.
fn glb(bytes: &[u8], seed: u32, change: &mut dyn FnMut(&mut Vec<u8>)) -> Option<Vec<u8>> {
    if !bytes.starts_with(b"glTF") {
        return None;
    }
    let length = word(bytes, 12)? as usize;
    let mut json = bytes.get(20..20usize.checked_add(length)?)?.to_vec();
    let mut blob = bytes.get(28 + length..).map(<[u8]>::to_vec);
    match &mut blob {
        Some(blob) if seed.is_multiple_of(4) => change(blob),
        _ => change(&mut json),
    }
    let mut mutant = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    mutant.extend((json.len() as u32).to_le_bytes());
    mutant.extend(b"JSON");
    mutant.extend(json);
    if let Some(blob) = blob {
        mutant.extend((blob.len() as u32).to_le_bytes());
        mutant.extend(b"BIN\0");
        mutant.extend(blob);
    }
    let whole = (mutant.len() as u32).to_le_bytes();
    mutant[8..12].copy_from_slice(&whole);
    Some(mutant)
}
