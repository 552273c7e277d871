//! Numerical methods that the fits of environments and of measured BRDFs share.

pub(crate) mod amplitude;
mod minimise;

pub(crate) use minimise::minimise;
