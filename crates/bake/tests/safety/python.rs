//! `tools/python`, which was written from FORMAT.md alone, reads what we read.

use std::path::Path;
use std::process::{Command, Stdio};

use libtest_mimic::{Completion, Failed, Trial};
use relight_format::{self as format, Kind, Limits};
use serde_json::{Value, json};

use crate::meshes::sphere_over_ground;
use crate::{Folder, bake_environment, bake_scene, expect_success, grey_hdr};

pub fn trials() -> Vec<Trial> {
    vec![Trial::ignorable_test("python::reads_what_we_read", reads)]
}

fn crc(bytes: &[u8]) -> Value {
    json!([crc32fast::hash(bytes)])
}

/// Checksums of arrays as we read them.
fn expected(path: &Path) -> Result<Value, Failed> {
    let bytes = std::fs::read(path)?;
    let limits = Limits::default();
    let textures = |textures: &[format::Texture]| -> Value {
        let texels = textures
            .iter()
            .map(|texture| crc32fast::hash(&texture.texels));
        texels.collect::<Vec<u32>>().into()
    };
    Ok(match format::inspect(&bytes, &limits)?.0 {
        Kind::Scene => {
            let scene = format::read_scene(&bytes, &limits)?;
            let mut arrays = json!({
                "vertices": crc(bytemuck::cast_slice(&scene.vertices)),
                "triangles": crc(bytemuck::cast_slice(&scene.triangles)),
                "clusters": crc(bytemuck::cast_slice(&scene.clusters)),
                "coefficients": crc(bytemuck::cast_slice(&scene.coefficients)),
                "basis": crc(bytemuck::cast_slice(&scene.basis)),
                "textures": textures(&scene.textures),
            });
            if !scene.second_uvs.is_empty() {
                arrays["second_uvs"] = crc(bytemuck::cast_slice(&scene.second_uvs));
            }
            if let Some(transfer) = &scene.transfer {
                arrays["transfer_scales"] = crc(bytemuck::cast_slice(&transfer.scales));
                arrays["transfer_basis"] = crc(bytemuck::cast_slice(&transfer.basis));
                let mut weights: &[u8] = bytemuck::cast_slice(&transfer.weights);
                let ends = transfer
                    .groups
                    .iter()
                    .skip(1)
                    .map(|group| group.first_cluster);
                let ends = ends.chain([scene.clusters.len() as u32]);
                let mut groups = Vec::new();
                for (group, end) in transfer.groups.iter().zip(ends) {
                    let clusters = &scene.clusters[group.first_cluster as usize..end as usize];
                    let vertices: u32 = clusters.iter().map(|cluster| cluster.vertex_count).sum();
                    let (own, rest) = weights.split_at((group.rank * vertices) as usize);
                    groups.push(crc32fast::hash(own));
                    weights = rest;
                }
                arrays["transfer_weights"] = groups.into();
            }
            arrays
        }
        Kind::Environment => {
            let read = format::read_environment(&bytes, &limits)?;
            json!({
                "lobes": crc(bytemuck::cast_slice(&read.lobes)),
                "sources": crc(bytemuck::cast_slice(&read.sources)),
                "source_texels": crc(bytemuck::cast_slice(&read.source_texels)),
            })
        }
        Kind::Material => {
            json!({ "textures": textures(&format::read_material(&bytes, &limits)?.textures) })
        }
    })
}

fn reads() -> Result<Completion, Failed> {
    let module = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/python");
    let run = |name: &str| {
        let mut python = Command::new(name);
        python
            .env("PYTHONPATH", &module)
            .env("PYTHONDONTWRITEBYTECODE", "1");
        python
    };
    // The packages of a system are for its own interpreter, and another may come first.
    let found = ["python3", "/usr/bin/python3"].into_iter().find(|name| {
        let imports = run(name)
            .args(["-c", "import numpy, zstandard"])
            .stderr(Stdio::null())
            .status();
        imports.is_ok_and(|status| status.success())
    });
    let Some(name) = found else {
        let what = "no python3 with numpy and zstandard (Debian: python3-numpy, python3-zstandard)";
        return Ok(Completion::ignored_with(what));
    };
    let python = || run(name);
    let lines = std::fs::read_to_string(module.join("relight_reader.py"))?
        .lines()
        .count();
    assert!(lines <= 300, "{lines} lines");
    let folder = Folder::new()?;
    folder.write("b.obj", sphere_over_ground(20))?;
    let baked = [folder.at("scene.relight"), folder.at("sky.relight")];
    expect_success(&mut bake_scene(&folder.at("b.obj"), &baked[0]));
    let sky = folder.write("sky.hdr", grey_hdr(32, 16))?;
    expect_success(&mut bake_environment(&sky, &baked[1], 2));
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../format/tests/golden");
    let mut files = baked.to_vec();
    for version in std::fs::read_dir(golden)? {
        for file in std::fs::read_dir(version?.path())? {
            files.push(file?.path());
        }
    }
    assert!(files.len() >= 5);
    for file in &files {
        let output = expect_success(python().arg(module.join("check.py")).arg(file));
        let found: Value = serde_json::from_slice(&output.stdout)?;
        let expected = expected(file)?;
        for (name, checksums) in expected.as_object().expect("an object") {
            let found = &found["arrays"][name];
            assert_eq!(found, checksums, "{name} of {}", file.display());
        }
    }
    // What is damaged is refused, wherever.
    let bytes = std::fs::read(&baked[0])?;
    let damaged = folder.at("damaged.relight");
    for cut in [0, 10, 100, bytes.len() - 1] {
        std::fs::write(&damaged, &bytes[..cut])?;
        let output = python()
            .arg(module.join("check.py"))
            .arg(&damaged)
            .output()?;
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(errors.contains("relight_reader.Invalid"), "{errors}");
    }
    Ok(Completion::Completed)
}
