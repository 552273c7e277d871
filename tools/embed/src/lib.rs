//! Shows a baked asset in a page: small, for other people's pages.
//!
//! Compiled to WebAssembly it is the renderer behind `web/embed.html`: `stage`. What viewers share
//! with it is here for every target: a camera for hands, what lies under a pointer, and a light for
//! scenes that come without one.

pub mod orbit;
pub mod pick;
#[cfg(target_family = "wasm")]
pub mod stage;

use relight_format::{Environment, Lobe};

/// A wide sky and a lamp, for scenes without an environment.
pub fn plain_sky() -> Environment {
    let lobe = |axis, sharpness, amplitude| Lobe {
        axis,
        sharpness,
        amplitude,
        ..bytemuck::Zeroable::zeroed()
    };
    Environment {
        lobes: vec![
            lobe([0.0, 1.0, 0.0], 2.0, [0.3, 0.35, 0.4]),
            lobe([0.6, 0.64, 0.48], 60.0, [9.0, 8.0, 6.0]),
        ],
        ..Environment::default()
    }
}
