//! Visibility from contours against one ray per texel, on the same vertices in one run.
//!
//! `cargo bench -p relight-bake --bench visibility -- MESH.obj...`: per mesh, time per
//! vertex of both on one thread, their ratio, rays cast, and texels that differ.

use std::time::Instant;

use glam::Vec3;
use relight_bake::contour::ContourMesh;
use relight_bake::import;
use relight_bake::ray::RayCaster;
use relight_bake::ssdf::Transform;
use relight_bake::visibility::{self, Directions};

fn main() {
    let paths = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with("--"));
    println!(
        "mesh, triangles, contours µs, rays µs, ratio, rays per vertex, differing texels, ssdf µs, setup ms"
    );
    for path in paths {
        let mesh = import::mesh(path.as_ref()).expect("a mesh");
        let positions: Vec<Vec3> = mesh.vertices.iter().map(|v| v.position.into()).collect();
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.vertices).collect();
        let soup: Vec<[Vec3; 3]> = triangles
            .iter()
            .map(|t| t.map(|v| positions[v as usize]))
            .collect();
        let (low, high) = positions
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| {
                (l.min(*p), h.max(*p))
            });
        let origins = visibility::origins(&positions, &triangles, 1e-4 * low.distance(high));
        let step = (origins.len() / 200).max(1);
        let origins: Vec<Vec3> = origins.into_iter().step_by(step).take(200).collect();
        let caster = RayCaster::new(&soup);
        let directions = Directions::new(128);
        let setup = Instant::now();
        let mesh = ContourMesh::new(&soup);
        let setup = setup.elapsed().as_secs_f64() * 1e3;
        let mut scratch = mesh.scratch(&directions);
        let per_vertex =
            |start: Instant| start.elapsed().as_secs_f64() * 1e6 / origins.len() as f64;
        let start = Instant::now();
        let exact: Vec<_> = origins
            .iter()
            .map(|&o| visibility::sample(&caster, o, &directions))
            .collect();
        let ray_time = per_vertex(start);
        let start = Instant::now();
        let fast: Vec<_> = origins
            .iter()
            .map(|&o| mesh.sample(&caster, o, &directions, &mut scratch))
            .collect();
        let contour_time = per_vertex(start);
        let rays: u32 = fast.iter().map(|(_, rays)| rays).sum();
        let differing: usize = (exact.iter().zip(&fast))
            .map(|(a, (b, _))| (0..128 * 128).filter(|&i| a.get(i) != b.get(i)).count())
            .sum();
        let transform = Transform::new(&directions, 64);
        let start = Instant::now();
        for bitmap in &exact {
            std::hint::black_box(transform.apply(bitmap, 0.5));
        }
        let ssdf_time = per_vertex(start);
        let name = std::path::Path::new(&path)
            .file_stem()
            .unwrap_or_default()
            .display();
        println!(
            "{name}, {}, {contour_time:.0}, {ray_time:.0}, {:.1}, {:.0}, {differing}, {ssdf_time:.0}, {setup:.0}",
            triangles.len(),
            ray_time / contour_time,
            f64::from(rays) / origins.len() as f64,
        );
    }
}
