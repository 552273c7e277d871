//! The same input and options give the same bytes, on any number of threads.

use std::path::Path;

use libtest_mimic::Trial;

use crate::cli::{bake_environment, bake_scene, expect_success, write_hdr};
use crate::meshes::sphere_over_ground;
use crate::support::{Outcome, with_data};

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::test("determinism::made_scene", made_scene),
        Trial::test("determinism::fine_scene", fine_scene),
        Trial::test("determinism::made_environment", made_environment),
        with_data("determinism::textured_scene", |data| {
            scene(&data.join("meshes/awkward/gltf/sphere/sphere.gltf"))
        }),
        with_data("determinism::real_environment", |data| {
            environment(&data.join("env/probulator/ennis_256.hdr"))
        }),
    ]
}

/// Twice on one thread, and on two and three, which never divide the work alike.
const THREADS: [&str; 4] = ["1", "1", "2", "3"];

fn made_scene() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mesh = folder.path().join("sphere.obj");
    std::fs::write(&mesh, sphere_over_ground(16))?;
    scene(&mesh)
}

/// So fine that some vertices stand for others.
fn fine_scene() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mesh = folder.path().join("sphere.obj");
    std::fs::write(&mesh, sphere_over_ground(100))?;
    let output = bake_scene(&mesh, &folder.path().join("out.relight"))
        .arg("--json")
        .output()?;
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    let number = |name: &str| summary[name].as_u64().expect("a number");
    let (sampled, vertices) = (number("sampled_vertices"), number("vertices"));
    assert!(
        2 * sampled < vertices,
        "{sampled} of {vertices} are sampled"
    );
    scene(&mesh)
}

fn made_environment() -> Outcome {
    let folder = tempfile::tempdir()?;
    let image = folder.path().join("sky.hdr");
    write_hdr(&image)?;
    environment(&image)
}

fn scene(mesh: &Path) -> Outcome {
    same_bytes(|threads, asset| {
        expect_success(bake_scene(mesh, asset).args(["--threads", threads]));
    })
}

fn environment(image: &Path) -> Outcome {
    same_bytes(|threads, asset| {
        expect_success(bake_environment(image, asset, 4).args(["--threads", threads]));
    })
}

fn same_bytes(bake: impl Fn(&str, &Path)) -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut first: Option<Vec<u8>> = None;
    for (run, threads) in THREADS.into_iter().enumerate() {
        let asset = folder.path().join(format!("{run}.relight"));
        bake(threads, &asset);
        let bytes = std::fs::read(&asset)?;
        let first = first.get_or_insert_with(|| bytes.clone());
        assert!(
            *first == bytes,
            "other bytes on {threads} threads in run {run}"
        );
    }
    Ok(())
}
