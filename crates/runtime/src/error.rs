//! What can go wrong between an app, its device and a scene.

use relight_shading::gpu::LimitError;

use crate::Placement;

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
    /// A format that the renderer was asked to draw into and cannot.
    #[error("target format: expected {expected}, found {format:?}")]
    Format {
        /// The format asked for.
        format: wgpu::TextureFormat,
        /// What is expected of it.
        expected: &'static str,
    },
    /// A sample count that targets cannot have.
    #[error("samples of a target: expected 1 or 4, found {found}")]
    SampleCount {
        /// The count asked for.
        found: u32,
    },
    /// A target that is not as [`Options`](crate::Options) and the call say.
    #[error("target: expected {expected}, found {found}")]
    Target {
        /// What was expected.
        expected: String,
        /// What the target is.
        found: String,
    },
    /// Something that another renderer made, perhaps on another device.
    #[error(
        "{what}: expected one made by this renderer or one that shares its pipelines, found another's"
    )]
    Foreign {
        /// What it is.
        what: &'static str,
    },
    /// A view that is drawn before [`Renderer::prepare`](crate::Renderer::prepare) has filled it.
    #[error("view: expected a call of prepare before composite, found none")]
    NotPrepared,
    /// Other numbers of instances, or of their placements, than a view was prepared with.
    #[error("instances: expected the {expected} that the view was prepared with, found {found}")]
    InstanceCount {
        /// The view's.
        expected: usize,
        /// What was given.
        found: usize,
    },
    /// Matrices through which pixels have no rays.
    #[error("camera: expected matrices that are finite and regular, found {matrix}")]
    Camera {
        /// World to clip space.
        matrix: glam::Mat4,
    },
    /// A rotation that is not of unit length.
    #[error("rotation: expected a quaternion of length 1, found length {length}")]
    Rotation {
        /// Its length.
        length: f32,
    },
    /// Something that this crate was built without.
    #[error("{what}: expected a build with the feature `{feature}`, found one without")]
    Feature {
        /// What asks for it.
        what: &'static str,
        /// The feature.
        feature: &'static str,
    },
    /// A scene placed where it cannot be drawn.
    #[error("placement: expected a scale above 0 and a finite translation, found {0:?}")]
    Placement(Placement),
    /// A material index beyond the scene's materials.
    #[error("material: expected an index below {count}, found {index}")]
    NoSuchMaterial {
        /// The index asked for.
        index: usize,
        /// Materials of the scene.
        count: usize,
    },
    /// A texture index beyond the scene's textures.
    #[error("texture: expected an index below {count}, found {index}")]
    NoSuchTexture {
        /// The index asked for.
        index: usize,
        /// Textures of the scene.
        count: usize,
    },
    /// A texture that a measured material is made of, and that no image can stand for.
    #[error(
        "texture {index}: expected one of a material's images, found a table of a measured reflection"
    )]
    NoImage {
        /// Its index.
        index: usize,
    },
    /// An image that is to be a texture and cannot be sampled.
    #[error(
        "image of a texture: expected two dimensions, one sample, a format of filterable floats and TEXTURE_BINDING, found {found}"
    )]
    Image {
        /// What the image is.
        found: String,
    },
    /// A shadow map that cannot be looked up.
    #[error("shadow map: expected {expected}, found {found}")]
    ShadowMap {
        /// What was expected.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// A material that is to catch shadows in a scene that was uploaded without any.
    #[error(
        "material {index}: expected a scene uploaded with a material that catches shadows, found none"
    )]
    NoCatcher {
        /// Its index.
        index: usize,
    },
    /// A scene or material that no asset could hold: a number or an index out of its range.
    #[error("asset: {0}")]
    Asset(#[from] relight_format::Error),
    /// An upload that was no longer wanted.
    #[error("upload: stopped, as it was asked to")]
    Cancelled,
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
