//! Why an input cannot be read or an option not be followed, in one shape: what it is about, where in
//! it, what was expected and what was found. And how errors are told.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use relight_format::{self as format, Issue};

/// An error and its causes as one sentence on one line. Many messages end in that of their cause, which
/// is not said again.
pub fn sentence<'a>(
    chain: impl IntoIterator<Item = &'a (dyn std::error::Error + 'static)>,
) -> String {
    let mut sentence = String::new();
    for cause in chain {
        let cause = on_one_line(&cause.to_string());
        if !sentence.ends_with(&cause) {
            if !sentence.is_empty() {
                sentence += ": ";
            }
            sentence += &cause;
        }
    }
    sentence
}

/// Text on one line and without control characters: names in files that are not trusted are in it.
fn on_one_line(text: &str) -> String {
    let mut line = String::new();
    for word in text.split_whitespace() {
        if !line.is_empty() {
            line.push(' ');
        }
        for character in word.chars() {
            if character.is_control() {
                line.extend(character.escape_default());
            } else {
                line.push(character);
            }
        }
    }
    line
}

/// What is wrong in some place, of a file or of the options.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: expected {expected}, found {found}")]
pub struct Objection {
    /// The line, key, element or option.
    pub place: String,
    /// What would have been right.
    pub expected: String,
    /// What is there.
    pub found: String,
}

impl Objection {
    /// An objection to what was found in a place.
    pub fn new(place: impl Display, expected: impl Display, found: impl Display) -> Self {
        Self {
            place: place.to_string(),
            expected: expected.to_string(),
            found: found.to_string(),
        }
    }

    /// The same of a file.
    pub fn in_file(self, file: &Path) -> Error {
        Error {
            file: file.to_owned(),
            objection: self,
            issue: None,
            source: None,
        }
    }
}

/// Why a file cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {objection}{}", file.display(), in_brackets(*issue))]
pub struct Error {
    /// The file.
    pub file: PathBuf,
    /// What is wrong with it.
    pub objection: Objection,
    /// Of an asset: which rule of the format it breaks.
    pub issue: Option<Issue>,
    /// The system's reason, where it refused.
    pub source: Option<std::io::Error>,
}

impl Error {
    /// The system refuses to read a file.
    #[cfg(not(target_family = "wasm"))]
    pub(crate) fn read(file: &Path, source: std::io::Error) -> Self {
        Self::refused(file, "file", "a readable file", source)
    }

    /// The system refuses.
    pub fn refused(
        file: &Path,
        place: impl Display,
        expected: impl Display,
        source: std::io::Error,
    ) -> Self {
        let refused = Self::invalid(file, place, expected, &source);
        Self {
            source: Some(source),
            ..refused
        }
    }

    /// Something in a file is wrong.
    pub fn invalid(
        file: &Path,
        place: impl Display,
        expected: impl Display,
        found: impl Display,
    ) -> Self {
        Objection::new(place, expected, found).in_file(file)
    }

    /// A file is not the asset that it should be.
    pub fn asset(file: &Path, error: format::Error) -> Self {
        match error {
            format::Error::Invalid {
                issue,
                place,
                expected,
                found,
            } => Self {
                issue: Some(issue),
                ..Self::invalid(file, place, expected, found)
            },
            format::Error::Io { path, source } => Self::refused(
                Path::new(&path),
                "output",
                "a file that can be written",
                source,
            ),
        }
    }

    /// The same of the file that refers to this one, in some place.
    #[cfg(not(target_family = "wasm"))]
    #[must_use]
    pub(crate) fn referred_to(self, by: &Path, place: impl Display) -> Self {
        let found = format!("{}: {}", self.file.display(), self.objection.found);
        Self {
            file: by.to_owned(),
            objection: Objection::new(place, self.objection.expected, found),
            ..self
        }
    }
}

fn in_brackets(issue: Option<Issue>) -> String {
    issue.map_or_else(String::new, |issue| format!(" ({issue})"))
}

/// Most bytes that are repeated of a file which begins otherwise than it should.
const FIRST_BYTES: usize = 12;

/// How a file begins, as text where it is.
pub(crate) fn first_bytes(bytes: &[u8]) -> String {
    match bytes {
        [] => "an empty file".into(),
        _ => format!(
            "\"{}\"",
            bytes[..bytes.len().min(FIRST_BYTES)].escape_ascii()
        ),
    }
}

/// What a parser of TOML or JSON objects to in a line and column; `whole` is what it should have
/// been, for where it says no more. `serde` says "FOUND, expected EXPECTED".
#[cfg(not(target_family = "wasm"))]
pub(crate) fn of_parser([line, column]: [usize; 2], whole: &str, message: &str) -> Objection {
    let place = format!("line {line}, column {column}");
    if let Some(key) = message.strip_prefix("missing field ") {
        return Objection::new(place, format_args!("{whole} with {key}"), "none");
    }
    let (found, expected) = (message.rsplit_once(", expected ")).unwrap_or((message, whole));
    let mut kinds = ["invalid type: ", "invalid value: "].into_iter();
    let found = kinds
        .find_map(|kind| found.strip_prefix(kind))
        .unwrap_or(found);
    Objection::new(place, expected, found)
}
