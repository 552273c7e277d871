//! Principal components and coefficients of one chunk of a real mesh, on one thread.
//!
//! `cargo bench -p relight-bake --bench compress -- [MESH...] [--vertices N] [--rounds N]`

mod common;

use nalgebra::DMatrix;
use relight_bake::internals::DistanceTransform;
use relight_bake::internals::compress::{self, Fits, Samples, Weighting};
use relight_bake::internals::visibility::RayCaster;
use relight_bake::internals::visibility::{self, Crossings, Directions};

const RESOLUTION: u32 = 64;
/// Images of the largest default cluster.
const CHANNELS: usize = 16;
/// As a cluster is made, once planned.
const ROUNDS: usize = 1;
const MAX_ERROR: f32 = 0.005;

fn main() {
    let vertices = common::number("--vertices", 512);
    let rounds = common::number("--rounds", 3);
    for (index, path) in common::paths().iter().enumerate() {
        if index == 0 {
            println!("us per vertex, one thread, best of {rounds} rounds");
            println!(
                "{:<14}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>16}",
                "mesh", "vertices", "analyse", "select", "plan", "fit", "encode", "error, rad"
            );
        }
        // Groups from all over the mesh: harder to compress than one neighbourhood is.
        let subject = common::subject(path, vertices);
        let caster = RayCaster::new(&subject.soup);
        let directions = Directions::new(RESOLUTION);
        let transform = DistanceTransform::new(&directions, RESOLUTION);
        let columns: Vec<f32> = (subject.origins.iter())
            .flat_map(|&origin| {
                let bitmap = visibility::sample(&caster, origin, &directions);
                transform.apply(&bitmap, &Crossings::default(), 0.5)
            })
            .collect();
        let count = subject.origins.len();
        let ssdfs = DMatrix::from_vec(RESOLUTION.pow(2) as usize, count, columns);
        let samples = Samples::new(ssdfs, &subject.normals, &Weighting::new(RESOLUTION));
        let select = common::best(rounds, || {
            std::hint::black_box(samples.fitted());
        });
        let fitted = samples.fitted();
        let analyse = common::best(rounds, || {
            std::hint::black_box(compress::analyse(&fitted, CHANNELS - 1));
        });
        let basis = compress::analyse(&fitted, CHANNELS - 1);
        let one_round = || Fits::new(&fitted, &basis, CHANNELS).fit(CHANNELS);
        let plan = common::best(rounds, || {
            std::hint::black_box(one_round());
        });
        let start = one_round().coefficients;
        let images = || {
            let coefficients = compress::alternate(&fitted, start.clone(), ROUNDS);
            compress::images(&fitted, &coefficients).0
        };
        let fit = common::best(rounds, || {
            std::hint::black_box(images());
        });
        let images = images();
        let encode = common::best(rounds, || {
            std::hint::black_box(compress::encode(&fitted, &images, MAX_ERROR));
        });
        let per_vertex = |seconds: f64| seconds * 1e6 / count as f64;
        println!(
            "{:<14}{count:>10}{:>10.0}{:>10.0}{:>10.0}{:>10.0}{:>10.0}{:>16.4}",
            subject.name,
            per_vertex(analyse),
            per_vertex(select),
            per_vertex(plan),
            per_vertex(fit),
            per_vertex(encode),
            compress::encode(&fitted, &images, MAX_ERROR).error(),
        );
    }
}
