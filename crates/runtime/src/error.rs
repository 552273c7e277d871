//! What can go wrong between an app, its device and a scene.

use relight_shading::gpu::LimitError;

/// Why something could not be created, uploaded or drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The device was requested with lower limits than the renderer needs.
    #[error("device cannot run the renderer: {0}")]
    Device(LimitError),
    /// The scene needs more than the device was requested with.
    #[error("scene exceeds the device: {0}")]
    Scene(LimitError),
    /// The frame needs more than the device was requested with.
    #[error("frame exceeds the device: {0}")]
    Frame(LimitError),
    /// The image has no pixels.
    #[error("image size: expected at least 1x1, found {width}x{height}")]
    EmptyImage {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A material index beyond the scene's materials.
    #[error("material: expected an index below {count}, found {index}")]
    NoSuchMaterial {
        /// The index asked for.
        index: usize,
        /// Materials of the scene.
        count: usize,
    },
    /// A material that refers to a texture beyond the scene's textures.
    #[error("material {name:?}: expected a texture index below {count}, found {index}")]
    NoSuchTexture {
        /// Name of the material.
        name: String,
        /// The index asked for.
        index: u32,
        /// Textures of the scene.
        count: usize,
    },
    /// No adapter offers the limits asked for.
    #[error("no graphics adapter with the limits asked for among {found:?}")]
    NoAdapter {
        /// Names of the adapters that exist.
        found: Vec<String>,
    },
    /// The adapter did not give a device.
    #[error("no graphics device: {0}")]
    NoDevice(#[from] wgpu::RequestDeviceError),
    /// The device stopped, or ran out of memory, while an image was drawn or read back.
    #[error("the graphics device failed: {0}")]
    DeviceFailed(String),
}
