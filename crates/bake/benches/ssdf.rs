//! From visibility bitmaps of real meshes to signed distances, on one thread: finding where
//! contours cross the links between texels, and the transform.
//!
//! `cargo bench -p relight-bake --bench ssdf -- [MESH...] [--vertices N] [--rounds N]`

mod common;

use relight_bake::internals::DistanceTransform;
use relight_bake::internals::visibility::ContourMesh;
use relight_bake::internals::visibility::{Directions, RUNS};

fn main() {
    let vertices = common::number("--vertices", 100);
    let rounds = common::number("--rounds", 3);
    for (index, path) in common::paths().iter().enumerate() {
        if index == 0 {
            println!("us per vertex, one thread, best of {rounds} rounds");
            println!(
                "{:<14}{:>12}{:>12}{:>12}{:>12}{:>12}",
                "mesh", "visibility", "crossings", "128 -> 128", "128 -> 64", "64 -> 64"
            );
        }
        let subject = common::subject(path, vertices);
        let contours = ContourMesh::new(&subject.soup);
        let mut cells = Vec::new();
        for (samples, resolutions) in [(128, &[128, 64][..]), (64, &[64])] {
            let directions = Directions::new(samples);
            let mut scratch = contours.scratch(&directions);
            let mut sample = || {
                for group in subject.origins.chunks(RUNS[0]) {
                    contours.prepare(group, &mut scratch);
                    for &origin in group {
                        contours.sample(origin, &directions, &mut scratch);
                    }
                }
            };
            let visibility = common::best(rounds, &mut sample);
            let mut scratch = contours.scratch(&directions);
            let mut apply = |transform: Option<&DistanceTransform>| {
                for group in subject.origins.chunks(RUNS[0]) {
                    contours.prepare(group, &mut scratch);
                    for &origin in group {
                        let (bitmap, _) = contours.sample(origin, &directions, &mut scratch);
                        let crossings = contours.crossings(&bitmap, &mut scratch);
                        if let Some(transform) = transform {
                            std::hint::black_box(transform.apply(&bitmap, crossings, 0.5));
                        }
                    }
                }
            };
            let crossings = common::best(rounds, || apply(None));
            if samples == 128 {
                cells.extend([visibility, crossings - visibility]);
            }
            for &resolution in resolutions {
                let transform = DistanceTransform::new(&directions, resolution);
                cells.push(common::best(rounds, || apply(Some(&transform))) - crossings);
            }
        }
        print!("{:<14}", subject.name);
        for seconds in cells {
            print!("{:>12.0}", seconds * 1e6 / subject.origins.len() as f64);
        }
        println!();
    }
}
