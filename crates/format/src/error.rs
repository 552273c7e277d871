//! What can be wrong with bytes, and where.

use crate::SectionKind;

/// Stable identifiers of everything a reader or validator can object to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Issue {
    /// The first eight bytes are not [`crate::MAGIC`].
    BadMagic,
    /// The version is not one this reader knows.
    UnknownVersion,
    /// The asset is of another kind (scene, environment) than asked for.
    WrongKind,
    /// A field that must be zero is not.
    ReservedNotZero,
    /// The file ends before the bytes that the header promises.
    Truncated,
    /// The file goes on after the last section.
    TrailingBytes,
    /// Sections are not contiguous, in order, or unique.
    BadSectionTable,
    /// A required section is absent.
    MissingSection,
    /// A section's checksum does not match its stored bytes.
    BadChecksum,
    /// A section does not decompress to its raw length.
    BadCompression,
    /// A section's raw length is not the one its element count demands.
    BadLength,
    /// The asset would need more memory than [`crate::Limits`] allows.
    OverBudget,
    /// The metadata section does not decode.
    BadMetadata,
    /// A number is not finite, or outside its documented range.
    ValueOutOfRange,
    /// An index points outside the array it indexes.
    IndexOutOfRange,
}

impl std::fmt::Display for Issue {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Self::BadMagic => "this is not a .relight file",
            Self::UnknownVersion => "it was written for another version of the format",
            Self::WrongKind => "it holds another kind of asset",
            Self::ReservedNotZero => "a field that must be zero is not",
            Self::Truncated => "the file ends too early",
            Self::TrailingBytes => "the file goes on after its end",
            Self::BadSectionTable => "the table of its sections is damaged",
            Self::MissingSection => "a section is missing",
            Self::BadChecksum => "the file is damaged",
            Self::BadCompression => "a section cannot be decompressed",
            Self::BadLength => "a section has the wrong length",
            Self::OverBudget => "it would take more memory than is allowed",
            Self::BadMetadata => "its metadata cannot be read",
            Self::ValueOutOfRange => "a number is out of its range",
            Self::IndexOutOfRange => "an index is out of its range",
        })
    }
}

/// One objection: what, where, what was expected and what was found.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The bytes are not a valid asset.
    #[error("{place}: expected {expected}, found {found} ({issue})")]
    Invalid {
        /// Stable identifier.
        issue: Issue,
        /// Section or header field.
        place: String,
        /// What a valid file has there.
        expected: String,
        /// What this file has there.
        found: String,
    },
    /// The file could not be written.
    #[error("{path}: output: expected a file that can be written, found {source}")]
    Io {
        /// The file.
        path: String,
        /// The system's reason.
        source: std::io::Error,
    },
}

impl Error {
    /// The stable identifier, or `None` for an input/output error.
    pub fn issue(&self) -> Option<Issue> {
        match self {
            Self::Invalid { issue, .. } => Some(*issue),
            Self::Io { .. } => None,
        }
    }

    #[expect(
        clippy::needless_pass_by_value,
        reason = "callers pass literals and format_args!"
    )]
    pub(crate) fn invalid(
        issue: Issue,
        place: impl ToString,
        expected: impl ToString,
        found: impl ToString,
    ) -> Self {
        Self::Invalid {
            issue,
            place: place.to_string(),
            expected: brief(&expected.to_string()),
            found: brief(&found.to_string()),
        }
    }

    pub(crate) fn section(
        issue: Issue,
        section: SectionKind,
        expected: impl ToString,
        found: impl ToString,
    ) -> Self {
        Self::invalid(issue, format_args!("section {section:?}"), expected, found)
    }
}

/// Most bytes of an untrusted value that a message repeats.
const MAX_QUOTED_BYTES: usize = 300;

fn brief(text: &str) -> String {
    if text.len() <= MAX_QUOTED_BYTES {
        return text.to_owned();
    }
    let end = (0..=MAX_QUOTED_BYTES)
        .rev()
        .find(|end| text.is_char_boundary(*end))
        .unwrap_or(0);
    format!("{}…", &text[..end])
}
