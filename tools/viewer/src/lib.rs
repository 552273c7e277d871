//! Looks at scenes, turns their light and edits their materials.
//!
//! The application is data in, data out: [`state`] holds what is chosen, [`engine`] turns it into
//! linear pictures, [`compose`] pictures into pixels of the screen, [`jobs`] files into scenes,
//! environments and materials, [`save`] all of it into files. [`app`] and [`panels`] draw and
//! change the state; nothing else knows of windows.
//!
//! Compiled to WebAssembly it is the renderer behind a page instead: `web`.

#[cfg(not(target_family = "wasm"))]
pub mod app;
#[cfg(not(target_family = "wasm"))]
pub mod command;
#[cfg(not(target_family = "wasm"))]
pub mod compose;
#[cfg(not(target_family = "wasm"))]
pub mod dialog;
#[cfg(not(target_family = "wasm"))]
pub mod engine;
#[cfg(not(target_family = "wasm"))]
pub mod inspect;
#[cfg(not(target_family = "wasm"))]
pub mod jobs;
pub mod orbit;
#[cfg(not(target_family = "wasm"))]
pub mod pace;
#[cfg(not(target_family = "wasm"))]
pub mod panels;
pub mod pick;
#[cfg(not(target_family = "wasm"))]
pub mod save;
#[cfg(not(target_family = "wasm"))]
pub mod settings;
#[cfg(not(target_family = "wasm"))]
pub mod state;
#[cfg(not(target_family = "wasm"))]
pub mod turntable;
#[cfg(not(target_family = "wasm"))]
pub mod viewport;
#[cfg(not(target_family = "wasm"))]
pub mod watch;
#[cfg(target_family = "wasm")]
pub mod web;
#[cfg(not(target_family = "wasm"))]
pub mod worker;
