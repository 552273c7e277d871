//! The tables of RESULTS.md: the columns that it has of every experiment.

use std::path::Path;

use anyhow::Context as _;
use relight_format as format;

use super::report::{Section, Table};

/// Tables that RESULTS.md has room for, and the columns of them.
const SHORT: [(&str, &[&str]); 15] = [
    ("defaults", &[]),
    ("environments", &[]),
    (
        "compression",
        &[
            "scene",
            "curve",
            "setting",
            "vertices",
            "bytes",
            "tiles per sample",
            "diffuse, %",
            "specular, %",
        ],
    ),
    ("boundary", &[]),
    (
        "adaptive",
        &["partition", "cells per pixel", "relative RMSE, %"],
    ),
    (
        "penumbra",
        &["angle, °", "method", "hue, ΔH*ab", "penumbra RMSE, %"],
    ),
    (
        "occluders",
        &["scene", "environment", "method", "relative RMSE, %"],
    ),
    (
        "scenes",
        &[
            "scene",
            "reflection",
            "vertices",
            "asset, MB",
            "method",
            "samples per pixel",
            "time over ambient",
            "relative RMSE, %",
        ],
    ),
    ("interpolation", &[]),
    ("readings", &[]),
    (
        "scale",
        &[
            "what varies",
            "is",
            "clusters",
            "pixels covered",
            "integrals per pixel",
            "samples per pixel",
            "fetches per pixel",
            "floor, fetches per pixel",
            "fetches per pixel for vertices",
            "nanoseconds per pixel",
            "relative RMSE, %",
        ],
    ),
    ("end-to-end", &[]),
    ("contours", &[]),
    ("bounce", &[]),
    (
        "meshes",
        &[
            "mesh",
            "triangles",
            "asset, MB",
            "relative RMSE, %",
            "warnings",
        ],
    ),
];

/// What the tables stand between in a Markdown file.
const MARKERS: [&str; 2] = ["<!-- experiments -->\n", "<!-- /experiments -->"];

/// What stands before and after the markers of a Markdown file.
///
/// # Errors
///
/// If the file cannot be read or lacks a marker.
pub fn around_results(file: &Path) -> anyhow::Result<(String, String)> {
    let name = || file.display().to_string();
    let text = std::fs::read_to_string(file).with_context(name)?;
    (text.split_once(MARKERS[0]))
        .and_then(|(before, rest)| {
            let (_, after) = rest.split_once(MARKERS[1])?;
            Some((before.to_owned(), after.to_owned()))
        })
        .with_context(|| format!("no {} followed by {}", MARKERS[0].trim(), MARKERS[1]))
        .with_context(name)
}

/// Replaces what stands between the markers of a Markdown file by the sections' tables.
///
/// # Errors
///
/// If the file cannot be read or written, or lacks a marker; it is then left as it was.
pub fn write_results(file: &Path, sections: &[Section]) -> anyhow::Result<()> {
    let (before, after) = around_results(file)?;
    let text = [
        &before[..],
        MARKERS[0],
        &markdown(sections),
        "\n",
        MARKERS[1],
        &after,
    ]
    .concat();
    Ok(format::write_file(file, text.as_bytes())?)
}

/// One entry of a section's provenance.
fn made_with<'a>(section: &'a Section, key: &str) -> &'a str {
    let entry = section.provenance.iter().find(|(name, _)| name == key);
    entry.map_or("unknown", |(_, value)| value)
}

/// What made all of it, then every section that has a table in [`SHORT`]: what it shows, and the table. A section that
/// something else made says so.
fn markdown(sections: &[Section]) -> String {
    let origin = |section: &Section| {
        let commit = made_with(section, "commit");
        format!("`{}`, commit {commit}", section.command)
    };
    let Some(last) = sections.last() else {
        return String::new();
    };
    let (common, made) = (origin(last), |key| made_with(last, key));
    let minutes = sections.iter().map(|section| section.seconds).sum::<f64>() / 60.0;
    let mut text = format!(
        "\nMade by {common}: Relight {}, {minutes:.0} minutes with {} threads of {}, seed {}.\n",
        made("Relight"),
        made("threads"),
        made("processor"),
        made("seed"),
    );
    for section in sections {
        let tables: Vec<Table> = (section.tables.iter())
            .filter_map(|table| {
                let (_, columns) = SHORT.iter().find(|(name, _)| *name == table.name)?;
                Some(table.with(columns))
            })
            .collect();
        if tables.is_empty() {
            continue;
        }
        text += &format!("\n### {}\n", section.title);
        let origin = origin(section);
        if origin != common {
            text += &format!("\nMade by {origin}.\n");
        }
        for paragraph in &section.text {
            text += &format!("\n{paragraph}\n");
        }
        for table in &tables {
            text += &format!("\n{}:\n\n{}", table.caption, table.markdown());
        }
    }
    text
}
