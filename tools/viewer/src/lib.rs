//! Looks at scenes, turns their light and edits their materials.
//!
//! The application is data in, data out: [`state`] holds what is chosen, [`engine`] turns it into
//! linear pictures, [`compose`] pictures into pixels of the screen, [`jobs`] files into scenes,
//! environments and materials, [`save`] all of it into files. [`app`] holds it all and brings
//! it together, [`panels`] and [`viewport`] show and change it, [`window`] is one frame of them;
//! nothing else knows of windows.
//!
//! Compiled to WebAssembly it is the same application on a page, without what takes files and
//! threads: `page` is how the page talks to it, `browser` how it talks to the page, `worker` what the page's workers run.

pub mod app;
#[cfg(target_family = "wasm")]
pub mod browser;
pub mod camera_file;
#[cfg(not(target_family = "wasm"))]
pub mod command;
pub mod compose;
pub mod composer;
pub mod dialog;
pub mod engine;
pub mod inspect;
pub mod jobs;
pub mod pace;
#[cfg(target_family = "wasm")]
pub mod page;
pub mod panels;
pub mod save;
#[cfg(not(target_family = "wasm"))]
pub mod scene_file;
pub mod settings;
pub mod state;
#[cfg(not(target_family = "wasm"))]
pub mod turntable;
pub mod viewport;
#[cfg(not(target_family = "wasm"))]
pub mod watch;
pub mod window;
#[cfg(target_family = "wasm")]
pub mod worker;

pub use relight_embed::{orbit, pick};
