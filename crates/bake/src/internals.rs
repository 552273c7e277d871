//! Parts of stages, for those who measure them one by one: the benches, the experiments of `lab`, tests
//! that cross crates. Nothing that bakes needs them, and they change whenever the bake does.

pub use crate::ssdf::DistanceTransform;

/// Compression of a cluster's SSDFs.
pub mod compress {
    pub use crate::compress::{
        Encoded, Fit, Fits, Normal, Samples, Weighting, alternate, analyse, encode, images,
    };
}

/// What is done to meshes.
pub mod mesh {
    pub use crate::mesh::refine::refine;
    pub use crate::mesh::tangent::set_mikktspace;
}

/// Plots of reports.
pub mod plot {
    pub use crate::report::plot::{Curve, svg};
}

/// Light that bounces.
pub mod transfer {
    pub use crate::transfer::surfaces::bare_scene;
}

/// Visibility from a point.
pub mod visibility {
    pub use crate::visibility::contour::{ContourMesh, RUNS};
    pub use crate::visibility::places::{EXPOSURE_RESOLUTION, Places};
    pub use crate::visibility::ray::{RayCaster, ray_offset};
    pub use crate::visibility::{Bitmap, Crossings, Directions, arrange, sample};
}
