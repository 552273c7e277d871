//! Why an input cannot be read: one error that names the file, the place, what was expected and
//! what was found. And how errors are told.

#[cfg(not(target_family = "wasm"))]
use std::path::Path;
use std::path::PathBuf;

/// An error and its causes as one sentence. Many messages end in that of their cause, which is not
/// said again.
pub fn sentence<'a>(
    chain: impl IntoIterator<Item = &'a (dyn std::error::Error + 'static)>,
) -> String {
    let mut sentence = String::new();
    for cause in chain {
        let cause = cause.to_string();
        if !sentence.ends_with(&cause) {
            if !sentence.is_empty() {
                sentence += ": ";
            }
            sentence += &cause;
        }
    }
    sentence
}

/// Why a scene file, mesh, material library or texture could not be read.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system refused.
    #[error("{}: cannot read: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The reason.
        source: std::io::Error,
    },
    /// The text does not parse.
    #[error("{}: {message}", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// The parser's message, with line and column.
        message: String,
    },
    /// A value is wrong.
    #[error("{}: {place}: expected {expected}, found {found}", file.display())]
    Invalid {
        /// The file.
        file: PathBuf,
        /// The line, key or element.
        place: String,
        /// What would have been right.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The file requires a glTF extension that is not supported.
    #[error(
        "{}: requires the glTF extension {extension}, which is not supported{hint}", file.display()
    )]
    UnsupportedExtension {
        /// The file.
        file: PathBuf,
        /// Its registered name.
        extension: String,
        /// What to do about it, or nothing.
        hint: &'static str,
    },
}

#[cfg(not(target_family = "wasm"))]
impl Error {
    pub(crate) fn read(file: &Path, source: std::io::Error) -> Self {
        Self::Read {
            file: file.into(),
            source,
        }
    }

    pub(crate) fn invalid(
        file: &Path,
        place: impl std::fmt::Display,
        expected: impl std::fmt::Display,
        found: impl std::fmt::Display,
    ) -> Self {
        Self::Invalid {
            file: file.into(),
            place: place.to_string(),
            expected: expected.to_string(),
            found: found.to_string(),
        }
    }
}
