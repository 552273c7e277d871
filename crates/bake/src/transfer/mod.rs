//! Light that bounces: how much of distant light arrives at every vertex after reflections off
//! the scene, and of what surfaces emit.
//!
//! Light reflected many times is smooth, so its bounces are followed between a few thousand
//! points that lie evenly on the surface ([`points`], [`radiosity`]), which depend on the scene and
//! the options alone: every shard has the same. Vertices then gather once more, by rays of their
//! own ([`gather`]), chunk by chunk, take what their neighbours' rays tell as well ([`smooth`]), and chunks are compressed
//! ([`compress`]). What emits, and what sends
//! much of that on, is drawn from besides ([`emitters`]): rays at random seldom meet it.
//!
//! Surfaces send on light evenly in all directions, as much as their albedo is, mirrors' among
//! it; as in D3DX's `ComputeBounce` each bounce is one pass over all points.

pub(crate) mod compress;
pub(crate) mod emitters;
pub(crate) mod gather;
mod lamps;
pub(crate) mod points;
pub(crate) mod radiosity;
pub(crate) mod reflections;
pub(crate) mod smooth;
pub(crate) mod surfaces;

/// How to gather bounced light. Every field has its default in [`Options::standard`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Options {
    /// Bounces to follow; `None` for as many as it takes until those left out add less than 0.5 %.
    /// Default: 0, direct light alone. `bake scene` asks for `None`.
    pub bounces: Option<u32>,
    /// Order of the spherical harmonics that distant light is given in.
    pub order: u32,
    /// Points between which light bounces.
    pub points: usize,
    /// Rays per point.
    pub(crate) point_rays: u32,
    /// Rays per vertex.
    pub(crate) vertex_rays: u32,
}

impl Options {
    /// Half the rays and points.
    pub fn draft() -> Self {
        Self {
            points: 2048,
            point_rays: 128,
            vertex_rays: 32,
            ..Self::standard()
        }
    }

    /// The default.
    pub fn standard() -> Self {
        Self {
            bounces: Some(0),
            order: 6,
            points: 4096,
            point_rays: 256,
            vertex_rays: 64,
        }
    }

    /// Twice the rays and points.
    pub fn high() -> Self {
        Self {
            points: 8192,
            vertex_rays: 128,
            ..Self::standard()
        }
    }
}
