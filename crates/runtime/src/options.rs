//! How a renderer is set up.

use crate::Error;

/// What a renderer draws into, given once: the formats and the sample count of the render passes
/// that [`Renderer::composite`](crate::Renderer::composite) is called in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// Format of the colour target. [`Output`] says what is written. Default `Rgba8Unorm`.
    pub target_format: wgpu::TextureFormat,
    /// Depth of the passes that `composite` is called in, as for a pipeline of the app's own: its
    /// format, how it compares, whether it is written. `None`, the default: they have no depth.
    ///
    /// Depth is that of the frame's matrices, so give those that the app draws everything else
    /// with: [`Viewpoint::Matrices`](crate::Viewpoint::Matrices).
    pub depth_stencil: Option<wgpu::DepthStencilState>,
    /// Samples of the passes that `composite` is called in: 1, the default, or 4.
    pub multisample: wgpu::MultisampleState,
    /// How `composite` blends over what is there. The default is for colours multiplied by their
    /// coverage, which is what is written. `None` replaces what is there, for formats that
    /// cannot be blended.
    pub blend: Option<wgpu::BlendState>,
    /// What is written. Default [`Output::Automatic`].
    pub output: Output,
    /// A dispatch shades as many pixels as so many rows of the picture have, rounded up to tiles of 8 × 8, and at most
    /// 524,288. Short dispatches keep slow devices responsive and clear of watchdogs; long ones fill fast devices, which
    /// wait for each to end before they begin the next. A view takes 512 bytes for every pixel of a dispatch, and 60 more
    /// for each of the environment's sources. `None`, the default: all rows on graphics cards; on other devices 128,
    /// and at most 131,072 pixels.
    pub rows_per_dispatch: Option<u32>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            target_format: wgpu::TextureFormat::Rgba8Unorm,
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            blend: Some(wgpu::BlendState::PREMULTIPLIED_ALPHA_BLENDING),
            output: Output::Automatic,
            rows_per_dispatch: None,
        }
    }
}

/// What is written into targets, always multiplied by coverage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Output {
    /// [`Self::Linear`] into formats of floating-point numbers, else [`Self::Display`].
    #[default]
    Automatic,
    /// Linear Rec.709 radiance times the frame's exposure, for the app's own tone mapping.
    Linear,
    /// Tone-mapped by the Khronos PBR Neutral curve and sRGB-encoded: by the target if its format
    /// does that, else before it is written.
    Display,
}

/// What the shader does to radiance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Linear = 0,
    ToneMapped = 1,
    ToneMappedSrgb = 2,
}

impl Output {
    pub(crate) fn encoding(self, format: wgpu::TextureFormat) -> Encoding {
        use wgpu::TextureFormat as F;
        let float = matches!(
            format,
            F::R16Float
                | F::Rg16Float
                | F::Rgba16Float
                | F::R32Float
                | F::Rg32Float
                | F::Rgba32Float
                | F::Rg11b10Ufloat
        );
        match self {
            Self::Linear => Encoding::Linear,
            Self::Automatic if float => Encoding::Linear,
            _ if format.is_srgb() => Encoding::ToneMapped,
            _ => Encoding::ToneMappedSrgb,
        }
    }
}

/// Rows of a dispatch, and tiles of 8 × 8 pixels at most, on devices that are no graphics cards.
const SHORT_DISPATCH: [u32; 2] = [128, 2048];

impl Options {
    /// Rows of a dispatch of a device, and tiles that it is to have at most.
    pub(crate) fn dispatch(&self, device: &wgpu::Device) -> [u32; 2] {
        let card = device.adapter_info().device_type == wgpu::DeviceType::DiscreteGpu;
        match self.rows_per_dispatch {
            None if !card => SHORT_DISPATCH,
            rows => [rows.unwrap_or(u32::MAX), u32::MAX],
        }
    }

    /// Refuses what no device with these features can draw into.
    pub(crate) fn check(&self, features: wgpu::Features) -> Result<(), Error> {
        let wrong = |format, expected| Err(Error::Format { format, expected });
        let color = self.target_format;
        let known = color.guaranteed_format_features(features);
        // The adapter may know more than is guaranteed.
        let more = features.contains(wgpu::Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES);
        let float = wgpu::TextureSampleType::Float { filterable: true };
        let unfilterable = wgpu::TextureSampleType::Float { filterable: false };
        let sampled = color.sample_type(Some(wgpu::TextureAspect::All), Some(features));
        if color.has_depth_aspect()
            || color.has_stencil_aspect()
            || !(sampled == Some(float) || sampled == Some(unfilterable))
        {
            return wrong(color, "a colour format that is not of integers");
        }
        if !more && !(known.allowed_usages).contains(wgpu::TextureUsages::RENDER_ATTACHMENT) {
            return wrong(color, "a colour format that can be drawn into");
        }
        let blendable = wgpu::TextureFormatFeatureFlags::BLENDABLE;
        if !more && self.blend.is_some() && !known.flags.contains(blendable) {
            return wrong(color, "a format that can be blended, or `blend: None`");
        }
        let count = self.multisample.count;
        if count != 1 && count != 4 {
            return Err(Error::SampleCount { found: count });
        }
        if !more && !known.flags.sample_count_supported(count) {
            return wrong(color, "a format of 4 samples, or 1 sample");
        }
        match &self.depth_stencil {
            Some(depth) if !depth.format.has_depth_aspect() => {
                wrong(depth.format, "a format with depth")
            }
            _ => Ok(()),
        }
    }
}
