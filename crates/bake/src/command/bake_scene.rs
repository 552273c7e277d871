//! `bake scene` and `bake merge`: chunks through a parts file into an asset.
//!
//! Every finished chunk goes to `OUT.parts` at once and is read from there when the asset is
//! put together, so memory does not hold the scene twice and a killed bake loses only what
//! was at hand.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use anyhow::bail;
use rayon::prelude::*;
use relight_bake::clock::ProcessorClock;
use relight_bake::error::Error;
use relight_bake::files::{self, Files};
use relight_bake::monitor::Monitor;
use relight_bake::scene::description::Refinement;
use relight_bake::scene::fingerprint::Fingerprint;
use relight_bake::scene::parts::{self, Identity, Parts};
use relight_bake::scene::{self, load, seam};
use relight_format as format;
use serde_json::json;

use crate::command::arguments::{SceneArguments, Shard, Usage};
use crate::command::lossy;
use crate::command::show::{self, Summary, is_interruption};

/// Bakes a scene, or a shard of it.
#[allow(
    clippy::too_many_lines,
    reason = "the order of a bake, with what goes wrong between its steps"
)]
pub fn bake(arguments: &SceneArguments, monitor: Monitor) -> anyhow::Result<Summary> {
    let options = arguments.options()?;
    let mut path = arguments.output.clone().into_os_string();
    path.push(".parts");
    let path = PathBuf::from(path);
    files::check_output(&arguments.output)?;
    files::check_output(&path)?;
    let (start, clock) = (Instant::now(), ProcessorClock::start());
    monitor.step("read", 0.0)?;
    let files = Files::new(&arguments.input, &arguments.access())?;
    let asked = arguments.import_options();
    let input = load::read(&files, &arguments.input, &asked)?;
    files::check_output_beside(&arguments.output, &files)?;
    files::check_output_beside(&path, &files)?;
    if input.has_tables() {
        monitor.step("fit measured materials", 0.0)?;
    }
    let input = input.fit()?;
    warn_of_overruled(arguments, input.refinement.as_ref());
    let read = clock.elapsed();
    let of_input = |error| blame(error, &arguments.input);
    let bake = scene::Bake::new(input, &options, monitor);
    let mut bake = bake.map_err(|error| of_input(error.into()))?;
    if arguments.verify_visibility {
        bake.verify_visibility();
    }
    let shard = arguments.shard.unwrap_or(Shard {
        number: 1,
        count: 1,
    });
    let identity = Identity {
        fingerprint: bake.fingerprint(),
        shard: shard.number,
        shards: shard.count,
        chunks: bake.chunk_count() as u32,
    };
    let described = bake.description();
    let parts = if arguments.resume {
        Parts::resume(&path, identity, described)?
    } else {
        Parts::create(&path, identity, described)?
    };
    if parts.replaced() {
        show::warn(format!(
            "{} of an interrupted bake is replaced; --resume would have continued it",
            path.display()
        ));
    }
    let resumed = parts.finished();
    let missing = parts.missing();
    let parts = Mutex::new(parts);
    let result: anyhow::Result<()> = bake.run(&missing, |chunk, clusters| {
        let payload = parts::encode(&clusters);
        let mut parts = parts.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(parts.append(chunk, &payload)?)
    });
    let mut parts = parts.into_inner().unwrap_or_else(PoisonError::into_inner);
    result
        .map_err(|error| keep_or_remove(&parts, error))
        .map_err(of_input)?;
    let (head, texels, mut statistics) = bake.finish();
    statistics.stages.insert(0, ("read", read));
    for warning in &head.report.warnings {
        show::warn(warning.as_str());
    }
    let sample_resolution = head.visibility.sample_resolution;
    let chunks = parts.finished();
    let clock = ProcessorClock::start();
    monitor.step("write", 0.0)?;
    let mut summary = if arguments.shard.is_some() {
        parts.finish(&head, texels)?;
        files::check_output_beside(&arguments.output, &files)?;
        std::fs::rename(&path, &arguments.output).map_err(|source| {
            let expected = "a file that can be written";
            Error::refused(&arguments.output, "output", expected, source)
        })?;
        Summary {
            text: format!(
                "{}: shard {} of {}, {chunks} of {} chunks",
                arguments.output.display(),
                shard.number,
                shard.count,
                identity.chunks,
            ),
            json: json!({ "output": lossy(&arguments.output), "shard": shard.number, "shards": shard.count }),
        }
    } else {
        let assembled = (0..chunks).map(|chunk| Ok(parts.chunk(chunk)?));
        let scene = assemble(head, assembled).map_err(of_input)?;
        files::check_output_beside(&arguments.output, &files)?;
        let summary = write(&arguments.output, scene, Some(texels))?;
        if let (Some(most), Some(bytes)) = (options.max_bytes, summary.json["bytes"].as_u64())
            && bytes > most
        {
            show::warn(format!(
                "{bytes} bytes, more than the {most} that --max-bytes allows"
            ));
        }
        // While it is locked: another bake of this output may be waiting for it.
        std::fs::remove_file(&path).map_err(|source| {
            Error::refused(&path, "parts file", "one that can be removed", source)
        })?;
        drop(parts);
        summary
    };
    statistics.stages.push(("write", clock.elapsed()));
    let wall = start.elapsed().as_secs_f64();
    summary.text += &format!(
        "\n{} rays, {wall:.1} s; processor time per stage:",
        statistics.rays
    );
    for (stage, time) in &statistics.stages {
        summary.text += &format!(" {stage} {:.1} s", time.as_secs_f64());
    }
    if arguments.verify_visibility {
        summary.text += &format!(
            "\nvisibility equals one ray per texel: {} points of {} texels compared, {} differ",
            statistics.verified_points,
            sample_resolution.pow(2),
            statistics.differing_texels,
        );
        summary.json["verified_points"] = json!(statistics.verified_points);
        summary.json["differing_texels"] = json!(statistics.differing_texels);
    }
    summary.text.push('\n');
    let stages = (statistics.stages.iter())
        .map(|(stage, time)| ((*stage).to_owned(), json!(time.as_secs_f64())));
    summary.json["chunks"] = json!(chunks);
    summary.json["resumed_chunks"] = json!(resumed);
    summary.json["rays"] = json!(statistics.rays);
    summary.json["sampled_vertices"] = json!(statistics.sampled_vertices);
    summary.json["probes"] = json!(statistics.probes);
    summary.json["seconds"] = json!(wall);
    summary.json["processor_seconds"] = stages.collect::<serde_json::Map<_, _>>().into();
    summary.json["peak_resident_bytes"] = json!(peak_resident_bytes());
    Ok(summary)
}

/// Names what an error is about: an option, as the command line has it, or else the input.
fn blame(error: anyhow::Error, input: &Path) -> anyhow::Error {
    match error.downcast_ref() {
        Some(scene::Error::Options(objection)) => {
            let mut objection = objection.clone();
            objection.place = format!("--{}", objection.place.replace('_', "-"));
            Usage(objection).into()
        }
        _ => error.context(input.display().to_string()),
    }
}

/// Bounds of the scene file win over those of the command line, which should not go unnoticed.
fn warn_of_overruled(arguments: &SceneArguments, file: Option<&Refinement>) {
    let Some(file) = file else { return };
    let both = [
        (
            "--max-edge",
            arguments.max_edge.is_some() && file.max_edge.is_some(),
        ),
        (
            "--refine-error",
            arguments.refine_error.is_some() && file.error.is_some(),
        ),
        (
            "--max-vertices",
            arguments.max_vertices.is_some() && file.max_vertices.is_some(),
        ),
    ];
    for (option, _) in both.into_iter().filter(|(_, both)| *both) {
        show::warn(format!(
            "{option} has no effect: the scene file has its own bound"
        ));
    }
}

/// What can be continued is kept, anything else removed.
fn keep_or_remove(parts: &Parts, error: anyhow::Error) -> anyhow::Error {
    let stopped = error
        .chain()
        .any(|cause| is_interruption(cause) || cause.is::<std::io::Error>());
    if stopped && parts.finished() > 0 {
        return error.context(format!(
            "{} keeps {} of {} chunks, --resume continues",
            parts.path().display(),
            parts.finished(),
            parts.identity().chunks().len(),
        ));
    }
    // The error at hand is the one to report.
    let _ = std::fs::remove_file(parts.path());
    error
}

/// Joins shards.
pub fn merge(paths: &[PathBuf], output: &Path, monitor: Monitor) -> anyhow::Result<Summary> {
    files::check_output_among(output, paths)?;
    monitor.step("read", 0.0)?;
    let mut shards = parts::open_all(paths)?;
    let [first, ..] = &mut shards[..] else {
        bail!("no shards")
    };
    let (head, chunks) = (first.head()?, first.identity().chunks as usize);
    let count = shards.len();
    let assembled = (0..chunks).map(|chunk| {
        monitor.step("merge", chunk as f32 / chunks as f32)?;
        Ok(shards[chunk % count].chunk(chunk)?)
    });
    let scene = assemble(head, assembled)?;
    monitor.step("write", 0.0)?;
    files::check_output_among(output, paths)?;
    let mut summary = write(output, scene, None)?;
    summary.text.push('\n');
    summary.json["peak_resident_bytes"] = json!(peak_resident_bytes());
    Ok(summary)
}

/// A scene of all its parts. Warns of what only all of them tell: errors that are too large.
fn assemble(
    head: format::Scene,
    parts: impl Iterator<Item = anyhow::Result<Vec<scene::Cluster>>>,
) -> anyhow::Result<format::Scene> {
    let told = head.report.warnings.len();
    let scene = scene::assemble::<anyhow::Error>(head, parts)?;
    for warning in &scene.report.warnings[told..] {
        show::warn(warning.as_str());
    }
    Ok(scene)
}

/// Writes an asset and checks what arrived. The scene is dropped before it is read back:
/// two of them may not fit.
fn write(
    path: &Path,
    scene: format::Scene,
    texels: Option<format::StoredTexels>,
) -> anyhow::Result<Summary> {
    let measured = || (seam::measure(&scene), fingerprint(&scene));
    let write = || match texels {
        Some(texels) => format::write_scene_with(&scene, texels),
        None => format::write_scene(&scene),
    };
    let (bytes, (seams, meant)) = rayon::join(write, measured);
    let bytes = bytes?;
    let tiles: u32 = scene.clusters.iter().map(|cluster| cluster.tiles).sum();
    let report = &scene.report;
    let summary = Summary {
        text: format!(
            "{}: {} vertices, {} triangles, {} clusters, {} bytes ({:.0} per vertex)\n\
             {}, jumps between clusters {:.4} (root mean squares, as of a wall's edge)",
            path.display(),
            scene.vertices.len(),
            scene.triangles.len(),
            scene.clusters.len(),
            bytes.len(),
            bytes.len() as f64 / scene.vertices.len().max(1) as f64,
            describe(&report.errors),
            seams.rms,
        ) + &describe_bounces(scene.transfer.as_ref()),
        json: json!({
            "output": lossy(path),
            "bytes": bytes.len(),
            "vertices": scene.vertices.len(),
            "triangles": scene.triangles.len(),
            "clusters": scene.clusters.len(),
            "tiles": tiles,
            "errors": report.errors,
            "seam_rms": seams.rms,
            "seam_largest": seams.largest,
            "warnings": report.warnings,
            "bounces": scene.transfer.as_ref().map(|transfer| json!({
                "count": transfer.bounces,
                "last": transfer.last_bounce,
                "stored_error": transfer.error,
                "groups": transfer.groups.len(),
            })),
        }),
    };
    drop(scene);
    crate::command::write_checked(path, &bytes, |bytes| {
        let read = format::read_scene(bytes, &format::Limits::default())?;
        Ok(fingerprint(&read) == meant)
    })?;
    Ok(summary)
}

/// One line.
pub fn describe(errors: &format::VisibilityErrors) -> String {
    format!(
        "visibility boundaries are off by {:.4} rad on the surface: {:.4} by interpolation between \
         vertices, {:.4} by compression at them; and by {:.4} for the resolution of distances",
        errors.surface, errors.interpolation, errors.compression, errors.resolution,
    )
}

/// A further line, where light bounces.
pub fn describe_bounces(transfer: Option<&format::Transfer>) -> String {
    transfer.map_or_else(String::new, |transfer| {
        format!(
            "\n{} bounces of light, the last adds {:.2} %; stored to {:.1} % of what bounces",
            transfer.bounces,
            100.0 * transfer.last_bounce,
            100.0 * transfer.error,
        )
    })
}

fn fingerprint(scene: &format::Scene) -> u128 {
    let format::Scene {
        name,
        visibility,
        camera,
        materials,
        textures,
        report,
        vertices,
        second_uvs,
        triangles,
        clusters,
        coefficients,
        basis,
        transfer,
    } = scene;
    let bounced = transfer.as_ref().map(|transfer| {
        let numbers = (transfer.order, transfer.emitted, transfer.bounces);
        (
            numbers,
            transfer.last_bounce,
            transfer.error,
            &transfer.groups,
        )
    });
    let shapes: Vec<_> = textures.iter().map(format::Texture::shape).collect();
    let small = (name, visibility, camera, materials, report, bounced, shapes);
    let small = format!("{small:?}");
    let mut all: Vec<&[u8]> = vec![
        small.as_bytes(),
        bytemuck::cast_slice(vertices),
        bytemuck::cast_slice(second_uvs),
        bytemuck::cast_slice(triangles),
        bytemuck::cast_slice(clusters),
        bytemuck::cast_slice(coefficients),
        bytemuck::cast_slice(basis),
    ];
    all.extend(textures.iter().map(|texture| &texture.texels[..]));
    if let Some(transfer) = transfer {
        all.extend([
            bytemuck::cast_slice(&transfer.scales),
            bytemuck::cast_slice(&transfer.basis),
            bytemuck::cast_slice(&transfer.weights),
        ]);
    }
    let of = |bytes: &[u8]| {
        let mut fingerprint = Fingerprint::default();
        fingerprint.add(bytes);
        fingerprint.value()
    };
    let each: Vec<u128> = all.into_par_iter().map(of).collect();
    of(bytemuck::cast_slice(&each))
}

/// The most memory this process ever held, where the system tells.
fn peak_resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kibibytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kibibytes * 1024)
}
