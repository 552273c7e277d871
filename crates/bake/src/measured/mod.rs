//! Measured BRDFs: the tables as files hold them, the lobes that are fitted to them, and the ratio
//! between the two.

pub mod fit;
mod merl;
pub mod ratio;
#[cfg(not(target_family = "wasm"))]
pub mod report;
mod rgl;

#[cfg(not(target_family = "wasm"))]
use std::path::Path;

use glam::{Vec2, Vec3};

#[cfg(not(target_family = "wasm"))]
use crate::error::Error;
use crate::error::Objection;
#[cfg(not(target_family = "wasm"))]
use crate::files::{Access, Files};

pub use merl::Merl;
pub use rgl::Rgl;

/// An isotropic RGB table of either database.
pub enum Table {
    /// RGL material database, `.bsdf`.
    Rgl(Box<Rgl>),
    /// MERL BRDF database, `.binary`.
    Merl(Box<Merl>),
}

impl Table {
    /// Loads a file of either kind; its first bytes tell which.
    #[cfg(not(target_family = "wasm"))]
    pub fn load(path: &Path) -> Result<Self, Error> {
        let bytes = Files::new(path, &Access::default())?.read_named(path)?;
        Self::parse(&bytes).map_err(|objection| objection.in_file(path))
    }

    /// Decodes the bytes of a file, which are not trusted.
    pub fn parse(bytes: &[u8]) -> Result<Self, Objection> {
        let table = if bytes.starts_with(rgl::MAGIC) {
            Self::Rgl(Box::new(Rgl::parse(bytes)?))
        } else {
            Self::Merl(Box::new(Merl::parse(bytes)?))
        };
        let black = match &table {
            Self::Rgl(table) => table.is_black(),
            Self::Merl(table) => table.is_black(),
        };
        if black {
            let found = "none: the table is black, or holds no valid measurement";
            return Err(Objection::new("values", "some that are above 0", found));
        }
        Ok(table)
    }

    /// BRDF in 1/sr (linear Rec.709, cosine not included) for unit vectors towards the
    /// light and the eye, z along the normal; zero where either is below the surface.
    /// Measurements may be slightly negative.
    pub fn evaluate(&self, light: Vec3, view: Vec3) -> Vec3 {
        match self {
            Self::Rgl(table) => table.evaluate(light, view),
            Self::Merl(table) => table.evaluate(light, view),
        }
    }

    /// A direction towards the light, distributed as [`Self::pdf`], from three uniform
    /// numbers in [0, 1); `None` where the draw falls below the surface.
    pub fn sample(&self, view: Vec3, uniform: [f32; 3]) -> Option<Vec3> {
        match self {
            Self::Rgl(table) => table.sample(view, Vec2::new(uniform[1], uniform[2])),
            Self::Merl(_) => merl::sample(view, uniform),
        }
    }

    /// Density of [`Self::sample`] in 1/sr.
    pub fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        match self {
            Self::Rgl(table) => table.pdf(light, view),
            Self::Merl(_) => merl::pdf(light, view),
        }
    }
}

/// Bits of `index` mirrored about the binary point (van der Corput 1935).
fn radical_inverse(index: u32) -> f32 {
    index.reverse_bits() as f32 / 2f32.powi(32)
}
