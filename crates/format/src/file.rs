//! Assets to files, whole or not at all.

use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Write as _};
use std::path::Path;

use crate::Error;

/// Writes a file whole or not at all: to `PATH.partial` beside it first, which is then renamed.
///
/// What a killed process left under that name is replaced; two processes that write the same
/// file at a time do not mix, the second is refused (where the file system has locks). Only the
/// name is given to the new file: links are replaced, not followed.
///
/// # Errors
///
/// The system refused, or another process is writing the file; what was there before stays.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let io = |source| Error::Io {
        path: path.display().to_string(),
        source,
    };
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let partial = std::path::PathBuf::from(partial);
    let mut file = create_partial(&partial).map_err(io)?;
    let result = file
        .write_all(bytes)
        .and_then(|()| file.sync_all())
        .and_then(|()| std::fs::rename(&partial, path));
    if result.is_err() {
        // The error that stopped the write is the one to report.
        let _ = std::fs::remove_file(&partial);
    }
    result.map_err(io)
}

/// A new, empty file that this process has locked.
fn create_partial(partial: &Path) -> std::io::Result<File> {
    /// Others may remove and create the file at the same time.
    const TRIES: usize = 16;
    let busy = || {
        let text = "another process is writing this file";
        std::io::Error::new(ErrorKind::ResourceBusy, text)
    };
    for _ in 0..TRIES {
        match File::create_new(partial) {
            Ok(file) => match file.try_lock() {
                // Whoever found it before it was locked has removed it.
                Ok(()) if !is_at(&file, partial) => {}
                // Some network file systems have no locks.
                Ok(()) | Err(TryLockError::Error(_)) => return Ok(file),
                Err(TryLockError::WouldBlock) => return Err(busy()),
            },
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                // A leftover, unless somebody has locked it. Anything but a regular file, as a
                // link that someone laid there, is not opened.
                let regular = std::fs::symlink_metadata(partial).is_ok_and(|found| found.is_file());
                let found = regular.then(|| File::open(partial).ok()).flatten();
                let lock = found.as_ref().map(File::try_lock);
                if matches!(lock, Some(Err(TryLockError::WouldBlock))) {
                    return Err(busy());
                }
                match std::fs::remove_file(partial) {
                    Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
                    _ => {}
                }
            }
            Err(error) => return Err(error),
        }
    }
    Err(busy())
}

/// Whether an open file is the one that a path leads to.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    let identity = |metadata: &std::fs::Metadata| (metadata.dev(), metadata.ino());
    let (file, path) = (file.metadata(), std::fs::symlink_metadata(path));
    matches!((file, path), (Ok(file), Ok(path)) if identity(&file) == identity(&path))
}

/// Elsewhere an open file is not removed.
#[cfg(not(unix))]
fn is_at(_file: &File, _path: &Path) -> bool {
    true
}
