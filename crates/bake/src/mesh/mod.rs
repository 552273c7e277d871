//! The triangles between import and sampling: tangents, an optional ground, vertices where
//! shadows need them, and the clusters that visibility is compressed by.

pub mod cluster;
pub mod ground;
pub mod refine;
pub mod tangent;
