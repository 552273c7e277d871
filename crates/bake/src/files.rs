//! Which files a bake reads, and where it may write.
//!
//! Scenes and meshes come from anywhere and name other files. What they name is read only if
//! it is a regular file below one folder, the root: that of the file on the command line, or
//! a wider one that the command line names. Paths are resolved component by component below
//! the root (`cap-std`: `openat2` with `RESOLVE_BENEATH` where the system has it), so neither
//! `..`, nor an absolute path, nor a link leads outwards, whenever it was laid. Links that
//! stay inside are followed. Nothing is opened that would wait for a writer, and nothing is
//! allocated before the file's size is known to be within the budget.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{File, Metadata};
use std::io::{ErrorKind, Read as _};
use std::path::{Path, PathBuf};

use cap_std::ambient_authority;
use cap_std::fs::{Dir, OpenOptions};

use crate::error::Error;

/// Most vertices, and most triangles, that an imported mesh may have; [`Access::max_vertices`]
/// is less unless it is raised.
pub const MAX_VERTICES: usize = 1 << 25;

/// What may be read, and how much of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Access {
    /// Folder that holds everything that is read; that of the input file if `None`.
    pub root: Option<PathBuf>,
    /// Most bytes of all files together.
    pub max_bytes: u64,
    /// Most texels of all textures together; a texel takes 4 bytes, while it is decoded 8.
    pub max_texels: u64,
    /// Most vertices, and most triangles, of the mesh as the file has it. At most
    /// [`MAX_VERTICES`] counts.
    pub max_vertices: usize,
}

impl Default for Access {
    /// The input's own folder, 2 GiB, textures of 512 MiB, and 8 million vertices.
    fn default() -> Self {
        Self {
            root: None,
            max_bytes: 2 << 30,
            max_texels: 1 << 27,
            max_vertices: 1 << 23,
        }
    }
}

impl Access {
    /// Anything that the process may read, for tools whose scenes are their own.
    pub fn anywhere() -> Self {
        Self {
            root: Some("/".into()),
            ..Self::default()
        }
    }
}

/// Tells a file apart from all others, by whatever name it is opened.
#[cfg(unix)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    device: u64,
    number: u64,
}

#[cfg(unix)]
impl Identity {
    fn of(_path: &Path, metadata: &Metadata) -> Self {
        use std::os::unix::fs::MetadataExt as _;
        Self {
            device: metadata.dev(),
            number: metadata.ino(),
        }
    }
}

/// Tells a file apart from all others, links to it aside.
#[cfg(not(unix))]
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity(PathBuf);

#[cfg(not(unix))]
impl Identity {
    fn of(path: &Path, _metadata: &Metadata) -> Self {
        Self(path.canonicalize().unwrap_or_else(|_| path.to_owned()))
    }
}

/// The files of one bake.
#[derive(Debug)]
pub struct Files {
    access: Access,
    /// The input's folder, as it was given and as it is.
    given: PathBuf,
    folder: PathBuf,
    /// The root and where it is; `None` if files are in memory.
    root: Option<(Dir, PathBuf)>,
    memory: BTreeMap<PathBuf, Vec<u8>>,
    /// What was read so far.
    read: RefCell<Read>,
}

#[derive(Debug, Default)]
struct Read {
    bytes: u64,
    files: Vec<(PathBuf, Identity)>,
}

impl Files {
    /// For the bake of `input`, a file that the command line names. It is not opened yet.
    pub fn new(input: &Path, access: &Access) -> Result<Self, Error> {
        let given = input.parent().unwrap_or(Path::new(""));
        let here = if given.as_os_str().is_empty() {
            Path::new(".")
        } else {
            given
        };
        let failed = |source| Error::read(input, source);
        let folder = here.canonicalize().map_err(failed)?;
        let root = match &access.root {
            Some(root) => root
                .canonicalize()
                .map_err(|source| no_root(root, source))?,
            None => folder.clone(),
        };
        let opened = Dir::open_ambient_dir(&root, ambient_authority()).map_err(|source| {
            match &access.root {
                Some(root) => no_root(root, source),
                None => Error::read(&root, source),
            }
        })?;
        Ok(Self {
            access: access.clone(),
            given: given.to_owned(),
            folder,
            root: Some((opened, root)),
            memory: BTreeMap::new(),
            read: RefCell::default(),
        })
    }

    /// Files in memory, by their paths; there are no others.
    pub fn in_memory(files: BTreeMap<PathBuf, Vec<u8>>, access: &Access) -> Self {
        Self {
            access: access.clone(),
            given: PathBuf::new(),
            folder: PathBuf::new(),
            root: None,
            memory: files,
            read: RefCell::default(),
        }
    }

    /// The bounds.
    pub(crate) fn access(&self) -> &Access {
        &self.access
    }

    /// Most vertices and triangles of a mesh.
    pub(crate) fn max_vertices(&self) -> usize {
        self.access.max_vertices.min(MAX_VERTICES)
    }

    /// Whether this is one of the files that were read; gives its path as it was read.
    pub(crate) fn find(&self, identity: &Identity) -> Option<PathBuf> {
        let read = self.read.borrow();
        let found = read.files.iter().find(|(_, known)| known == identity);
        found.map(|(path, _)| path.clone())
    }

    /// Reads a file that the command line names, wherever it is.
    pub fn read_named(&self, path: &Path) -> Result<Vec<u8>, Error> {
        if self.root.is_none() {
            return self.remembered(path);
        }
        self.contents(path, self.remember(path, open_named(path)?)?)
    }

    /// Reads a file that an input names: `path` is the input's folder, as given to
    /// [`Files::new`], joined with the reference.
    ///
    /// # Errors
    ///
    /// There is none or the system refuses; it is outside the root, is no regular file, or is one
    /// too many for the budget.
    pub fn read(&self, path: &Path) -> Result<Vec<u8>, Error> {
        if self.root.is_none() {
            return self.remembered(path);
        }
        self.contents(path, self.open(path)?)
    }

    fn remembered(&self, path: &Path) -> Result<Vec<u8>, Error> {
        let found = self.memory.get(path).cloned();
        found.ok_or_else(|| Error::read(path, ErrorKind::NotFound.into()))
    }

    /// Whether [`Files::read`] would find a file.
    pub(crate) fn exists(&self, path: &Path) -> bool {
        self.memory.contains_key(path) || self.open(path).is_ok()
    }

    /// Opens a file that an input names, as [`Files::read`] does.
    pub(crate) fn open(&self, path: &Path) -> Result<File, Error> {
        let Some((root, root_path)) = &self.root else {
            return Err(Error::read(path, ErrorKind::NotFound.into()));
        };
        let reference = path.strip_prefix(&self.given).unwrap_or(path);
        let whole = self.folder.join(reference);
        let Ok(inside) = whole.strip_prefix(root_path) else {
            return Err(self.outside(path));
        };
        // Below the root `cap-std` tells what leads outwards by an error that no system call
        // gave.
        let failed = |source: std::io::Error| {
            if source.kind() == ErrorKind::PermissionDenied && source.raw_os_error().is_none() {
                self.outside(path)
            } else {
                Error::read(path, source)
            }
        };
        // Opening some devices has effects: they are not even opened.
        let metadata = root.metadata(inside).map_err(failed)?;
        if !metadata.is_file() {
            return Err(irregular(path));
        }
        let mut options = OpenOptions::new();
        options.read(true);
        #[cfg(unix)]
        {
            use cap_std::fs::OpenOptionsExt as _;
            options.custom_flags(NEVER_WAIT);
        }
        let file = root.open_with(inside, &options).map_err(failed)?.into_std();
        self.remember(path, regular(path, file)?)
    }

    fn remember(&self, path: &Path, file: File) -> Result<File, Error> {
        let metadata = file
            .metadata()
            .map_err(|source| Error::read(path, source))?;
        let identity = Identity::of(path, &metadata);
        self.read
            .borrow_mut()
            .files
            .push((path.to_owned(), identity));
        Ok(file)
    }

    fn contents(&self, path: &Path, mut file: File) -> Result<Vec<u8>, Error> {
        let failed = |source| Error::read(path, source);
        let before = file.metadata().map_err(failed)?;
        let mut read = self.read.borrow_mut();
        let left = self.access.max_bytes.saturating_sub(read.bytes);
        let too_many = |length: u64| {
            Error::invalid(
                path,
                "file",
                format_args!(
                    "at most {} bytes of input in all (--limit-bytes)",
                    self.access.max_bytes
                ),
                format_args!("{length} bytes after {} of other files", read.bytes),
            )
        };
        if before.len() > left {
            return Err(too_many(before.len()));
        }
        let mut bytes = Vec::with_capacity(usize::try_from(before.len()).unwrap_or(0));
        // It may grow while it is read; it must not grow for ever.
        (&mut file)
            .take(left.saturating_add(1))
            .read_to_end(&mut bytes)
            .map_err(failed)?;
        if bytes.len() as u64 > left {
            return Err(too_many(bytes.len() as u64));
        }
        let after = file.metadata().map_err(failed)?;
        let stayed = bytes.len() as u64 == before.len()
            && after.len() == before.len()
            && after.modified().ok() == before.modified().ok();
        if !stayed {
            let found = "one that changed while it was read";
            return Err(Error::invalid(path, "file", "a file at rest", found));
        }
        read.bytes += bytes.len() as u64;
        Ok(bytes)
    }

    fn outside(&self, path: &Path) -> Error {
        let root = self.root.as_ref().map_or(Path::new(""), |(_, root)| root);
        let root = root.display();
        let expected = format!("a file in {root} (--root names a wider folder)");
        Error::invalid(path, "reference", expected, "one outside of it")
    }
}

fn no_root(root: &Path, source: std::io::Error) -> Error {
    Error::refused(root, "--root", "a folder that can be read", source)
}

/// So that no open waits: for the other end of a pipe, or for a device.
#[cfg(unix)]
const NEVER_WAIT: i32 = rustix::fs::OFlags::NONBLOCK.bits() as i32;

/// Opens a file that the command line names, if it is a regular one. Links are followed.
pub(crate) fn open_named(path: &Path) -> Result<File, Error> {
    let failed = |source| Error::read(path, source);
    if !std::fs::metadata(path).map_err(failed)?.is_file() {
        return Err(irregular(path));
    }
    let mut options = std::fs::OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        options.custom_flags(NEVER_WAIT);
    }
    regular(path, options.open(path).map_err(failed)?)
}

fn regular(path: &Path, file: File) -> Result<File, Error> {
    let metadata = file
        .metadata()
        .map_err(|source| Error::read(path, source))?;
    if metadata.is_file() {
        Ok(file)
    } else {
        Err(irregular(path))
    }
}

fn irregular(path: &Path) -> Error {
    let found = "a folder, pipe, socket or device";
    Error::invalid(path, "file", "a regular file", found)
}

/// Why nothing may be written to a path.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The system refuses, or there is something that must not be replaced.
    #[error(transparent)]
    Unwritable(Error),
    /// It is one of the inputs.
    #[error(transparent)]
    Input(Error),
}

impl OutputError {
    fn input(path: &Path, input: &Path) -> Self {
        let found = format!("the input {}", input.display());
        let expected = "another file than the inputs";
        Self::Input(Error::invalid(path, "output", expected, found))
    }
}

/// Checks that a file may be written or replaced: its folder exists, and what has its name
/// is a regular file or nothing. Gives the identity of the file that would be replaced.
pub fn check_output(path: &Path) -> Result<Option<Identity>, OutputError> {
    let failed = |source| {
        let expected = "a file that can be written";
        OutputError::Unwritable(Error::refused(path, "output", expected, source))
    };
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    if !std::fs::metadata(folder).map_err(failed)?.is_dir() {
        return Err(failed(ErrorKind::NotADirectory.into()));
    }
    if path.file_name().is_none() {
        return Err(failed(ErrorKind::IsADirectory.into()));
    }
    let metadata = match std::fs::symlink_metadata(path) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(failed(error)),
    };
    let kind = metadata.file_type();
    let found = if kind.is_file() {
        return Ok(Some(Identity::of(path, &metadata)));
    } else if kind.is_symlink() {
        "a symbolic link"
    } else if kind.is_dir() {
        "a folder"
    } else {
        "a pipe, socket or device"
    };
    let expected = "a regular file or nothing";
    let error = Error::invalid(path, "output", expected, found);
    Err(OutputError::Unwritable(error))
}

/// [`check_output`], and that the file is none of those that were read.
pub fn check_output_beside(path: &Path, inputs: &Files) -> Result<(), OutputError> {
    let Some(input) = check_output(path)?.and_then(|identity| inputs.find(&identity)) else {
        return Ok(());
    };
    Err(OutputError::input(path, &input))
}

/// [`check_output`], and that the file is none of `inputs`, which the command line names.
pub fn check_output_among(path: &Path, inputs: &[PathBuf]) -> Result<(), OutputError> {
    let Some(output) = check_output(path)? else {
        return Ok(());
    };
    let same = |input: &&PathBuf| {
        std::fs::metadata(input).is_ok_and(|metadata| Identity::of(input, &metadata) == output)
    };
    match inputs.iter().find(same) {
        None => Ok(()),
        Some(input) => Err(OutputError::input(path, input)),
    }
}

/// Whether an open file is the one that a path leads to.
pub(crate) fn is_at(file: &File, path: &Path) -> bool {
    let identity = |metadata: std::io::Result<Metadata>| Some(Identity::of(path, &metadata.ok()?));
    let there = identity(std::fs::symlink_metadata(path));
    there.is_some() && identity(file.metadata()) == there
}
