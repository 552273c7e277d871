//! What repository tasks share with the tests.

pub mod server;
