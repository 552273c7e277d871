//! Pictures and plots for reports.

pub(crate) mod picture;
pub mod plot;
