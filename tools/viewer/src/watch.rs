//! Notices that files changed, by asking the file system once a second.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

/// How often files are looked at.
pub const INTERVAL: Duration = Duration::from_secs(1);

/// Files and when they were changed last.
#[derive(Debug, Default)]
pub struct Watch {
    files: Vec<(PathBuf, Option<Stamp>)>,
    looked: Option<Instant>,
    /// A change is told once it is as old as the interval between two looks: who writes a file
    /// may not be done with it.
    pending: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stamp {
    modified: SystemTime,
    bytes: u64,
}

impl Watch {
    /// Looks at these files from now on.
    pub fn set(&mut self, files: &[PathBuf]) {
        self.files = (files.iter())
            .map(|file| (file.clone(), stamp(file)))
            .collect();
        self.pending = false;
    }

    /// Whether one of them changed and has since been left alone. Looks at most every
    /// [`INTERVAL`].
    pub fn changed(&mut self) -> bool {
        if self
            .looked
            .is_some_and(|looked| looked.elapsed() < INTERVAL)
        {
            return false;
        }
        self.looked = Some(Instant::now());
        self.look()
    }

    fn look(&mut self) -> bool {
        let mut moved = false;
        for (file, known) in &mut self.files {
            let found = stamp(file);
            // A file that is away for a moment is being written.
            if found.is_some() && found != *known {
                *known = found;
                moved = true;
            }
        }
        let settled = self.pending && !moved;
        self.pending = moved;
        settled
    }
}

fn stamp(file: &Path) -> Option<Stamp> {
    let data = std::fs::metadata(file).ok()?;
    Some(Stamp {
        modified: data.modified().ok()?,
        bytes: data.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_is_told_once_and_only_when_it_has_settled() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("scene.toml");
        std::fs::write(&file, "a").unwrap();
        let mut watch = Watch::default();
        watch.set(std::slice::from_ref(&file));
        assert!(!watch.look());
        std::fs::write(&file, "longer").unwrap();
        assert!(!watch.look(), "may still be written");
        std::fs::remove_file(&file).unwrap();
        std::fs::write(&file, "longer still").unwrap();
        assert!(!watch.look(), "still written");
        assert!(watch.look());
        assert!(!watch.look());
    }
}
