//! Why a scene could not be baked.

use relight_format as format;

use crate::error::Objection;
use crate::monitor::Interrupted;

/// Why a scene could not be baked.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Asked to stop.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
    /// The scene does not fit into an asset.
    #[error(transparent)]
    Format(#[from] format::Error),
    /// The options contradict each other or the scene.
    #[error(transparent)]
    Options(Objection),
    /// Contours and rays disagree.
    #[error(
        "visibility: expected the texels that one ray each gives, found {texels} others at \
         {vertices} vertices"
    )]
    Visibility {
        /// Vertices compared.
        vertices: u64,
        /// Texels that differ.
        texels: u64,
    },
}
