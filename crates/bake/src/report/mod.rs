//! Pictures and plots for reports.

pub(crate) mod picture;
pub(crate) mod plot;
