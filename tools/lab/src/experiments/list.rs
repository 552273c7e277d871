//! The experiments, in the order of the report.

use super::report::Section;
use super::{
    Laboratory, adaptive, bounce, boundary, brdf, compression, contours, defaults, edits,
    end_to_end, environments, interpolation, meshes, occluders, penumbra, scale, scenes, speed,
};

/// An experiment.
pub struct Experiment {
    /// Name on the command line.
    pub name: &'static str,
    /// Heading.
    pub title: &'static str,
    /// Adds what it finds.
    pub(super) run: fn(&mut Laboratory, &mut Section) -> anyhow::Result<()>,
}

/// All of them, in the order of the report.
pub const ALL: [Experiment; 17] = [
    Experiment {
        name: "defaults",
        title: "Assets as `bake` makes them by default",
        run: defaults::run,
    },
    Experiment {
        name: "environments",
        title: "Environments as lobes",
        run: environments::run,
    },
    Experiment {
        name: "compression",
        title: "File size against error",
        run: compression::run,
    },
    Experiment {
        name: "boundary",
        title: "Errors of boundaries and of lobes (Fig. 6)",
        run: boundary::run,
    },
    Experiment {
        name: "adaptive",
        title: "Adaptive against uniform cells (Fig. 7)",
        run: adaptive::run,
    },
    Experiment {
        name: "penumbra",
        title: "The colour of a penumbra (Fig. 8)",
        run: penumbra::run,
    },
    Experiment {
        name: "occluders",
        title: "Concave and convex occluders (Fig. 9)",
        run: occluders::run,
    },
    Experiment {
        name: "edits",
        title: "Materials, bumps and local lights that change (Figs. 10 and 11)",
        run: edits::run,
    },
    Experiment {
        name: "interpolation",
        title: "What interpolation between vertices misses (Figs. 12 and 13)",
        run: interpolation::run,
    },
    Experiment {
        name: "scenes",
        title: "Five scenes (Table 1)",
        run: scenes::run,
    },
    Experiment {
        name: "speed",
        title: "Quality against speed",
        run: speed::run,
    },
    Experiment {
        name: "scale",
        title: "Work against lobes, pixels and triangles",
        run: scale::run,
    },
    Experiment {
        name: "end-to-end",
        title: "From image and reflection model to pixel",
        run: end_to_end::run,
    },
    Experiment {
        name: "contours",
        title: "Contours between texels",
        run: contours::run,
    },
    Experiment {
        name: "brdf",
        title: "Reflection models as spherical Gaussians",
        run: brdf::run,
    },
    Experiment {
        name: "bounce",
        title: "Light that bounces, and follows the light",
        run: bounce::run,
    },
    Experiment {
        name: "meshes",
        title: "Meshes as people bring them",
        run: meshes::run,
    },
];
