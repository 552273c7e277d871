//! Tests of the container and its sections: one binary.

mod container;
mod differences;
mod generate;
mod golden;
mod hostile;
mod invalid;
mod round_trip;
