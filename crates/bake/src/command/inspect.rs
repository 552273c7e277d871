//! `bake inspect` and `bake validate`: what is in an asset.

use std::path::Path;

use relight_bake::error::Error;
use relight_format as format;
use serde_json::{Value, json};

use super::show::Summary;
use super::{bake_scene, lossy, read};

enum Asset {
    Scene(Box<format::Scene>),
    Environment(format::Environment),
    Material(Box<format::MaterialAsset>),
}

/// An asset, the version of the format that it is in, and its sections.
fn decode(path: &Path) -> anyhow::Result<(Asset, u32, Vec<format::SectionInfo>)> {
    let bytes = read(path)?;
    let limits = format::Limits::default();
    let asset = || -> Result<_, format::Error> {
        let (kind, version, sections) = format::inspect(&bytes, &limits)?;
        let asset = match kind {
            format::Kind::Scene => Asset::Scene(Box::new(format::read_scene(&bytes, &limits)?)),
            format::Kind::Environment => {
                Asset::Environment(format::read_environment(&bytes, &limits)?)
            }
            format::Kind::Material => {
                Asset::Material(Box::new(format::read_material(&bytes, &limits)?))
            }
        };
        Ok((asset, version, sections))
    };
    asset().map_err(|error| Error::asset(path, error).into())
}

pub(super) fn validate(path: &Path) -> anyhow::Result<Summary> {
    decode(path)?;
    Ok(Summary {
        text: format!("{}: valid\n", path.display()),
        json: json!({ "file": lossy(path), "valid": true }),
    })
}

#[allow(
    clippy::too_many_lines,
    reason = "what there is to say of each kind of asset"
)]
pub(super) fn inspect(path: &Path) -> anyhow::Result<Summary> {
    let (asset, version, sections) = decode(path)?;
    let mut text = format!("{}: ", path.display());
    let mut object = match &asset {
        Asset::Scene(scene) => {
            let parameters = &scene.visibility;
            text += &format!(
                "scene {:?}, format version {}\n\
                 {} vertices, {} triangles, {} materials, {} textures\n\
                 {:?}: {} clusters, {} tiles of 4 images at {r}x{r}, sampled at {s}x{s}\n\
                 {}\n",
                scene.name,
                version,
                scene.vertices.len(),
                scene.triangles.len(),
                scene.materials.len(),
                scene.textures.len(),
                parameters.representation,
                scene.clusters.len(),
                scene
                    .clusters
                    .iter()
                    .map(|cluster| cluster.tiles)
                    .sum::<u32>(),
                bake_scene::describe(&scene.report.errors)
                    + &bake_scene::describe_bounces(scene.transfer.as_ref()),
                r = parameters.basis_resolution,
                s = parameters.sample_resolution,
            );
            json!({
                "kind": "scene",
                "name": scene.name,
                "vertices": scene.vertices.len(),
                "triangles": scene.triangles.len(),
                "clusters": scene.clusters.len(),
                "tiles": scene.clusters.iter().map(|cluster| cluster.tiles).sum::<u32>(),
                "visibility": parameters,
                "camera": scene.camera,
                "materials": scene.materials,
                "textures": scene.textures.iter().map(|t| json!([t.width, t.height])).collect::<Vec<_>>(),
                "report": scene.report,
            })
        }
        Asset::Environment(environment) => {
            text += &format!(
                "environment, format version {}\n{} sources, {} lobes fitted to {} ({}x{}), relative L2 {:.4}, energy error {:?}\n",
                version,
                environment.sources.len(),
                environment.lobes.len(),
                environment.report.source,
                environment.report.source_size[0],
                environment.report.source_size[1],
                environment.report.relative_l2,
                environment.report.energy_error,
            );
            let lobes: Vec<Value> = (environment.lobes.iter())
                .map(
                    |l| json!({"axis": l.axis, "sharpness": l.sharpness, "amplitude": l.amplitude}),
                )
                .collect();
            let sources: Vec<Value> = (environment.sources.iter())
                .map(|source| {
                    let [height, width] = source.extent();
                    json!({"direction": source.direction(), "width": width, "height": height})
                })
                .collect();
            json!({
                "kind": "environment",
                "report": environment.report,
                "sources": sources,
                "lobes": lobes,
            })
        }
        Asset::Material(asset) => json!({
            "kind": "material",
            "report": asset.report,
            "material": asset.material,
            "textures": asset.textures.iter().map(|t| json!([t.width, t.height])).collect::<Vec<_>>(),
        }),
    };
    if let Asset::Material(asset) = &asset {
        text += &format!(
            "material, format version {}\n{:#?}\n{} textures; relative L2 {:.4}, as shaded {:.4}, albedo error {:.4}\n",
            version,
            asset.material,
            asset.textures.len(),
            asset.report.relative_l2,
            asset.report.shaded_relative_l2,
            asset.report.albedo_error,
        );
    }
    let mut rows = Vec::new();
    for section in &sections {
        text += &format!(
            "{:>12?}  {:>12} bytes stored  {:>12} raw  crc {:08x}\n",
            section.kind, section.stored_length, section.raw_length, section.checksum,
        );
        rows.push(json!({
            "section": format!("{:?}", section.kind),
            "stored_length": section.stored_length,
            "raw_length": section.raw_length,
        }));
    }
    object["file"] = json!(lossy(path));
    object["version"] = json!(version);
    object["sections"] = json!(rows);
    Ok(Summary { text, json: object })
}
