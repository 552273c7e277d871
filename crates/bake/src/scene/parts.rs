//! Finished chunks of a scene bake in a file: the checkpoint of a bake that runs, the result
//! of a shard, what `merge` joins.
//!
//! An append-only log, little-endian:
//!
//! | bytes | header |
//! |---|---|
//! | 8 | magic, `RLPARTS\n` |
//! | 4, 4 | u32: version 5, 0 |
//! | 16 | u128: [fingerprint](crate::scene::Bake::fingerprint) |
//! | 4, 4, 4 | u32: shard (from 1), shards, chunks of the whole scene |
//! | 4 | CRC-32 of the header so far |
//!
//! Records follow, first one that tells what the fingerprint is of (`DESCRIPTION`, text),
//! then chunks in the order in which they were finished: u32 chunk, u32 CRC-32 of
//! chunk, length and payload, u64 length of the payload, the payload. A chunk's payload is its clusters
//! (`encode`). The last record of a finished shard has the chunk number `u32::MAX`; its
//! payload is a `.relight` scene without clusters: names, materials, textures.
//!
//! A process can be killed at any moment: the first record that is not whole ends what
//! counts, and is cut off before new ones are appended.

use std::collections::HashMap;
use std::fmt::Display;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufReader, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use relight_format::{self as format};

use crate::error::{Error, first_bytes};
use crate::files;
use crate::scene::Cluster;

mod payload;

pub use payload::encode;
use payload::{decode, take};

const MAGIC: [u8; 8] = *b"RLPARTS\n";
const VERSION: u32 = 5;
const HEADER_BYTES: usize = 48;
const RECORD_BYTES: usize = 16;
/// Chunk number of the record that ends a finished shard.
const HEAD: u32 = u32::MAX;
/// Chunk number of the record that tells what the fingerprint is of.
const DESCRIPTION: u32 = u32::MAX - 1;
/// Most bytes of it that are read.
const MAX_DESCRIPTION: u64 = 1 << 16;

/// What a parts file is a part of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Of the scene and the options.
    pub fingerprint: u128,
    /// Which shard, from 1.
    pub shard: u32,
    /// Number of shards.
    pub shards: u32,
    /// Number of chunks of the whole scene.
    pub chunks: u32,
}

impl Identity {
    /// The chunks that belong to this shard: every n-th, as neighbours cost alike.
    pub fn chunks(&self) -> impl ExactSizeIterator<Item = usize> + use<> {
        (self.shard as usize - 1..self.chunks as usize).step_by(self.shards as usize)
    }
}

/// An open parts file.
#[derive(Debug)]
pub struct Parts {
    path: PathBuf,
    file: File,
    identity: Identity,
    /// Offset and length of the payload of every finished chunk.
    records: HashMap<usize, (u64, u64)>,
    head: Option<(u64, u64)>,
    /// Lines of names and values; empty if none is whole.
    description: String,
    /// Whether another bake's chunks were there.
    replaced: bool,
    /// Where the next record goes.
    end: u64,
}

impl Parts {
    /// Starts an empty file in place of what another bake left.
    ///
    /// # Errors
    ///
    /// What is there is no parts file, or in use.
    pub fn create(path: &Path, identity: Identity, description: &str) -> Result<Self, Error> {
        Self::start(lock(path)?, path, identity, description)
    }

    fn start(
        mut file: File,
        path: &Path,
        identity: Identity,
        description: &str,
    ) -> Result<Self, Error> {
        let mut start = Vec::new();
        (&mut file)
            .take(MAGIC.len() as u64)
            .read_to_end(&mut start)
            .map_err(io(path))?;
        if !MAGIC.starts_with(&start) {
            return Err(Error::invalid(
                path,
                "file",
                "a parts file or nothing",
                "another file, which is not replaced",
            ));
        }
        let mut header = Vec::with_capacity(HEADER_BYTES);
        header.extend(MAGIC);
        header.extend(VERSION.to_le_bytes());
        header.extend([0; 4]);
        header.extend(identity.fingerprint.to_le_bytes());
        header.extend(identity.shard.to_le_bytes());
        header.extend(identity.shards.to_le_bytes());
        header.extend(identity.chunks.to_le_bytes());
        header.extend(crc32fast::hash(&header).to_le_bytes());
        (file.set_len(0))
            .and_then(|()| file.seek(SeekFrom::Start(0)))
            .and_then(|_| file.write_all(&header))
            .inspect_err(|_| drop(std::fs::remove_file(path)))
            .map_err(io(path))?;
        let mut parts = Self {
            path: path.to_owned(),
            file,
            identity,
            records: HashMap::new(),
            head: None,
            description: description.to_owned(),
            replaced: start == MAGIC,
            end: HEADER_BYTES as u64,
        };
        let described = parts.append_record(DESCRIPTION, description.as_bytes());
        // Nothing to continue from is not left behind.
        described.inspect_err(|_| drop(std::fs::remove_file(path)))?;
        Ok(parts)
    }

    /// Opens the file for more records, or starts it if there is none or one that was cut
    /// short before its first record.
    ///
    /// # Errors
    ///
    /// The file belongs to another scene, other options or another shard, or is in use.
    pub fn resume(path: &Path, identity: Identity, description: &str) -> Result<Self, Error> {
        let file = lock(path)?;
        let length = file.metadata().map_err(io(path))?.len();
        if length < HEADER_BYTES as u64 {
            return Self::start(file, path, identity, description).map(|parts| Self {
                replaced: false,
                ..parts
            });
        }
        let mut parts = Self::scan(path, file)?;
        if parts.identity != identity {
            let (expected, found) = parts.differences(&identity, description);
            return Err(parts.invalid("--resume", expected, found));
        }
        if parts.description.is_empty() {
            // The record that comes first is not whole: nothing after it is either.
            (parts.file.seek(SeekFrom::Start(0))).map_err(io(path))?;
            return Self::start(parts.file, path, identity, description).map(|parts| Self {
                replaced: false,
                ..parts
            });
        }
        // A head that is there was followed by the end of a bake whose rename failed.
        if let Some((start, _)) = parts.head.take() {
            parts.end = start - RECORD_BYTES as u64;
        }
        (parts.file.set_len(parts.end)).map_err(io(path))?;
        Ok(parts)
    }

    /// What is asked for and what is there, as far as they differ.
    fn differences(&self, identity: &Identity, description: &str) -> (String, String) {
        let Identity {
            fingerprint: _,
            shard,
            shards,
            chunks,
        } = identity;
        let there = &self.identity;
        if (there.shard, there.shards) != (*shard, *shards) {
            return (
                format!("shard {shard} of {shards}"),
                format!("shard {} of {}", there.shard, there.shards),
            );
        }
        let value = |text: &str, name: &str| {
            let mut lines = text.lines().filter_map(|line| line.split_once(": "));
            lines
                .find(|(known, _)| *known == name)
                .map(|(_, value)| value.to_owned())
        };
        let mut expected = Vec::new();
        let mut found = Vec::new();
        for (name, now) in description.lines().filter_map(|line| line.split_once(": ")) {
            let before = value(&self.description, name);
            if before.as_deref() != Some(now) {
                let before = before.unwrap_or_else(|| "nothing".into());
                expected.push(format!("{name} {now}"));
                found.push(format!("{name} {before}"));
            }
        }
        if expected.is_empty() {
            return (
                format!("{chunks} chunks of the same scene"),
                format!("{} chunks of another", there.chunks),
            );
        }
        (
            format!("a bake of {}", expected.join(", ")),
            format!("one of {}", found.join(", ")),
        )
    }

    /// Opens a finished shard.
    ///
    /// # Errors
    ///
    /// A chunk or the head is missing, or damaged.
    pub(crate) fn open(path: &Path) -> Result<Self, Error> {
        let file = files::open_named(path)?;
        let parts = Self::scan(path, file)?;
        let length = (parts.file.metadata()).map_err(io(path))?.len();
        let (whole, there) = (parts.identity.chunks().len(), parts.finished());
        if there < whole || parts.head.is_none() || length != parts.end {
            return Err(parts.invalid(
                &format!("byte {}", parts.end),
                format!("a finished shard of {whole} chunks"),
                format!("{there} chunks and no intact end"),
            ));
        }
        Ok(parts)
    }

    /// Reads the header and finds the records that are whole.
    fn scan(path: &Path, file: File) -> Result<Self, Error> {
        let length = file.metadata().map_err(io(path))?.len();
        let mut reader = BufReader::with_capacity(1 << 20, file);
        let mut header = [0; HEADER_BYTES];
        let invalid =
            |expected: &str, found: String| Error::invalid(path, "header", expected, found);
        if length < HEADER_BYTES as u64 {
            let expected = "at least 48 bytes, as `bake scene --shard` writes them";
            return Err(invalid(expected, format!("{length} bytes")));
        }
        reader.read_exact(&mut header).map_err(io(path))?;
        let mut fields: &[u8] = &header;
        let magic: [u8; 8] = take(&mut fields).expect("inside the header");
        if magic != MAGIC {
            return Err(invalid("a parts file", first_bytes(&magic)));
        }
        let [version, reserved]: [u32; 2] = take(&mut fields).expect("inside the header");
        if (version, reserved) != (VERSION, 0) {
            let found = format!("version {version}, {reserved}");
            return Err(invalid(&format!("version {VERSION}, 0"), found));
        }
        let fingerprint: u128 = take(&mut fields).expect("inside the header");
        let [shard, shards, chunks, checksum]: [u32; 4] =
            take(&mut fields).expect("inside the header");
        let computed = crc32fast::hash(&header[..HEADER_BYTES - 4]);
        if checksum != computed {
            let found = format!("{checksum:08x}");
            return Err(invalid(&format!("checksum {computed:08x}"), found));
        }
        if shard < 1 || shard > shards {
            let found = format!("shard {shard} of {shards}");
            return Err(invalid("a shard from 1 to the number of shards", found));
        }
        let identity = Identity {
            fingerprint,
            shard,
            shards,
            chunks,
        };
        let mut records = HashMap::new();
        let mut head = None;
        let mut description = String::new();
        let mut end = HEADER_BYTES as u64;
        let mut payload = Vec::new();
        while head.is_none() && length - end >= RECORD_BYTES as u64 {
            let mut record = [0; RECORD_BYTES];
            reader.read_exact(&mut record).map_err(io(path))?;
            let mut fields: &[u8] = &record;
            let [chunk, checksum]: [u32; 2] = take(&mut fields).expect("inside the record");
            let bytes: u64 = take(&mut fields).expect("inside the record");
            let start = end + RECORD_BYTES as u64;
            if bytes > length - start {
                break;
            }
            payload.resize(bytes as usize, 0);
            reader.read_exact(&mut payload).map_err(io(path))?;
            let first = end == HEADER_BYTES as u64;
            let known = chunk < chunks && chunk % shards == shard - 1;
            let known = if first {
                chunk == DESCRIPTION && (1..=MAX_DESCRIPTION).contains(&bytes)
            } else {
                known || chunk == HEAD
            };
            if checksum != record_checksum(chunk, &payload) || !known {
                break;
            }
            if first {
                description = String::from_utf8_lossy(&payload).into_owned();
            } else if chunk == HEAD {
                head = Some((start, bytes));
            } else if records.insert(chunk as usize, (start, bytes)).is_some() {
                return Err(invalid("every chunk once", format!("chunk {chunk} twice")));
            }
            end = start + bytes;
        }
        Ok(Self {
            path: path.to_owned(),
            file: reader.into_inner(),
            identity,
            records,
            head,
            description,
            replaced: false,
            end,
        })
    }

    /// Whether [`Parts::create`] replaced what another bake left.
    pub fn replaced(&self) -> bool {
        self.replaced
    }

    /// What this is a part of.
    pub fn identity(&self) -> Identity {
        self.identity
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Number of finished chunks.
    pub fn finished(&self) -> usize {
        self.records.len()
    }

    /// Chunks of this shard that are not finished.
    pub fn missing(&self) -> Vec<usize> {
        (self.identity.chunks())
            .filter(|chunk| !self.records.contains_key(chunk))
            .collect()
    }

    /// Appends a finished chunk, as [`encode`] gives it.
    pub fn append(&mut self, chunk: usize, payload: &[u8]) -> Result<(), Error> {
        let record = self.append_record(chunk as u32, payload)?;
        self.records.insert(chunk, record);
        Ok(())
    }

    /// Ends a finished shard. `head` is the scene without its clusters, with its texels.
    pub fn finish(
        &mut self,
        head: &format::Scene,
        texels: format::StoredTexels,
    ) -> Result<(), Error> {
        let bytes = format::write_scene_with(head, texels)
            .map_err(|error| self.invalid("scene", "one that can be written", error))?;
        self.head = Some(self.append_record(HEAD, &bytes)?);
        self.file.sync_all().map_err(io(&self.path))
    }

    fn append_record(&mut self, chunk: u32, payload: &[u8]) -> Result<(u64, u64), Error> {
        let mut bytes = Vec::with_capacity(RECORD_BYTES + payload.len());
        bytes.extend(chunk.to_le_bytes());
        bytes.extend(record_checksum(chunk, payload).to_le_bytes());
        bytes.extend((payload.len() as u64).to_le_bytes());
        bytes.extend(payload);
        (self.file.seek(SeekFrom::Start(self.end)))
            .and_then(|_| self.file.write_all(&bytes))
            .map_err(io(&self.path))?;
        let start = self.end + RECORD_BYTES as u64;
        self.end += bytes.len() as u64;
        Ok((start, payload.len() as u64))
    }

    /// The clusters of a finished chunk.
    pub fn chunk(&mut self, chunk: usize) -> Result<Vec<Cluster>, Error> {
        let payload = self.payload(chunk as u32, self.records.get(&chunk).copied())?;
        decode(&payload).ok_or_else(|| {
            let found = format!("{} bytes", payload.len());
            self.invalid(&format!("chunk {chunk}"), "clusters", found)
        })
    }

    /// The scene without its clusters, of a finished shard.
    pub fn head(&mut self) -> Result<format::Scene, Error> {
        let payload = self.payload(HEAD, self.head)?;
        let head = format::read_scene(&payload, &format::Limits::default())
            .map_err(|error| self.invalid("end", "a scene", error))?;
        if head.clusters.is_empty() {
            Ok(head)
        } else {
            Err(self.invalid("end", "a scene without clusters", head.clusters.len()))
        }
    }

    /// Reads a record again; the file may have changed since it was scanned.
    fn payload(&mut self, chunk: u32, record: Option<(u64, u64)>) -> Result<Vec<u8>, Error> {
        let place = format!("record of chunk {chunk}");
        let Some((start, bytes)) = record else {
            return Err(self.invalid(&place, "it", "none"));
        };
        let mut header = [0; RECORD_BYTES];
        let mut payload = vec![0; bytes as usize];
        (self.file.seek(SeekFrom::Start(start - RECORD_BYTES as u64)))
            .and_then(|_| self.file.read_exact(&mut header))
            .and_then(|()| self.file.read_exact(&mut payload))
            .map_err(io(&self.path))?;
        let checksum: u32 = take(&mut &header[4..]).expect("inside the record");
        let computed = record_checksum(chunk, &payload);
        if checksum == computed {
            Ok(payload)
        } else {
            let (expected, found) = (format!("{checksum:08x}"), format!("{computed:08x}"));
            Err(self.invalid(&place, expected, found))
        }
    }

    fn invalid(&self, place: &str, expected: impl Display, found: impl Display) -> Error {
        Error::invalid(&self.path, place, expected, found)
    }
}

/// All shards of one scene, in order.
///
/// # Errors
///
/// They are of different scenes or options, one is there twice, or some are missing.
pub fn open_all(paths: &[PathBuf]) -> Result<Vec<Parts>, Error> {
    let mut parts = Vec::new();
    for path in paths {
        parts.push(Parts::open(path)?);
    }
    parts.sort_by_key(|part| part.identity.shard);
    for pair in parts.windows(2) {
        let [first, second] = [&pair[0], &pair[1]];
        let same_scene = Identity {
            shard: first.identity.shard,
            ..second.identity
        };
        if same_scene != first.identity {
            let expected = format!(
                "{} as {} has",
                describe(&first.identity),
                first.path.display()
            );
            return Err(second.invalid("header", expected, describe(&second.identity)));
        }
        if first.identity.shard == second.identity.shard {
            let expected = format!("another shard than {}", first.path.display());
            return Err(second.invalid("header", expected, describe(&second.identity)));
        }
    }
    if let Some(first) = parts.first() {
        let shards = first.identity.shards;
        if parts.len() < shards as usize {
            let there = |shard: &u32| parts.iter().any(|part| part.identity.shard == *shard);
            let mut absent = (1..=shards).filter(|shard| !there(shard));
            let mut list: Vec<String> = absent.by_ref().take(8).map(|s| s.to_string()).collect();
            if absent.next().is_some() {
                list.push("…".into());
            }
            return Err(first.invalid(
                "header",
                format!("all {shards} shards"),
                format!("none of {}", list.join(", ")),
            ));
        }
    }
    Ok(parts)
}

fn describe(identity: &Identity) -> String {
    let Identity {
        fingerprint,
        shard,
        shards,
        chunks,
    } = identity;
    format!("shard {shard} of {shards}, {chunks} chunks of scene and options {fingerprint:032x}")
}

/// Opens or makes a file that no other process works on. Neither links nor anything but
/// regular files will do.
fn lock(path: &Path) -> Result<File, Error> {
    /// Another bake may remove the file between opening and locking.
    const TRIES: usize = 8;
    let refused = |expected: &str, found: &str| Error::invalid(path, "lock", expected, found);
    let running = || {
        refused(
            "no other bake of the same output",
            "one that is running; wait for it, or give another output",
        )
    };
    for _ in 0..TRIES {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        #[cfg(unix)]
        {
            use rustix::fs::OFlags;
            use std::os::unix::fs::OpenOptionsExt as _;
            options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32);
        }
        let file = options.open(path).map_err(io(path))?;
        if !file.metadata().map_err(io(path))?.is_file() {
            return Err(refused("a regular file or nothing", "something else"));
        }
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => return Err(running()),
            // Some network file systems have no locks; nothing but this check depends on them.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        if files::is_at(&file, path) {
            return Ok(file);
        }
    }
    Err(running())
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    |source| {
        Error::refused(
            path,
            "parts file",
            "one that can be read and written",
            source,
        )
    }
}

fn record_checksum(chunk: u32, payload: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&chunk.to_le_bytes());
    hasher.update(&(payload.len() as u64).to_le_bytes());
    hasher.update(payload);
    hasher.finalize()
}
