//! Looks at scenes, turns their light and edits their materials.
//!
//! The application is data in, data out: [`state`] holds what is chosen, [`engine`] turns it into
//! linear pictures, [`compose`] pictures into pixels of the screen, [`jobs`] files into scenes,
//! environments and materials, [`save`] all of it into files. [`app`] and [`panels`] draw and
//! change the state; nothing else knows of windows.

pub mod app;
pub mod command;
pub mod compose;
pub mod engine;
pub mod inspect;
pub mod jobs;
pub mod orbit;
pub mod panels;
pub mod pick;
pub mod save;
pub mod settings;
pub mod state;
pub mod turntable;
pub mod viewport;
pub mod watch;
pub mod worker;
