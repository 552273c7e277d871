//! Tests live in `suite/`.
