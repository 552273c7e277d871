//! The tables of RESULTS.md: the columns that it has of every experiment.

use std::path::Path;

use anyhow::Context as _;
use relight_format as format;

use super::report::Section;

/// Tables that RESULTS.md has room for, and the columns of them.
const SHORT: [(&str, &[&str]); 12] = [
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
        &["mesh", "triangles", "asset, MB", "relative RMSE, %"],
    ),
];

/// Replaces what stands between the markers of a Markdown file by the sections' tables.
///
/// # Errors
///
/// If the file cannot be read or written, or lacks a marker; it is then left as it was.
pub fn write_results(file: &Path, sections: &[Section]) -> anyhow::Result<()> {
    const MARKERS: [&str; 2] = ["<!-- experiments -->\n", "<!-- /experiments -->"];
    let name = || file.display().to_string();
    let text = std::fs::read_to_string(file).with_context(name)?;
    let parts = (text.split_once(MARKERS[0])).and_then(|(before, rest)| {
        let (_, after) = rest.split_once(MARKERS[1])?;
        Some((before, after))
    });
    let (before, after) = parts
        .with_context(|| format!("no {} followed by {}", MARKERS[0].trim(), MARKERS[1]))
        .with_context(name)?;
    let tables = markdown(&digest(sections));
    let text = [before, MARKERS[0], &tables, "\n", MARKERS[1], after].concat();
    Ok(format::write_file(file, text.as_bytes())?)
}

/// The tables that [`markdown`] shows, without anything else.
fn digest(sections: &[Section]) -> Vec<Section> {
    let short = |section: &Section| {
        let tables = section.tables.iter().filter_map(|table| {
            let (_, columns) = SHORT.iter().find(|(name, _)| *name == table.name)?;
            Some(table.with(columns))
        });
        Section {
            tables: tables.collect(),
            // Sizes are in the commands.
            provenance: (section.provenance.iter())
                .filter(|(key, _)| {
                    ["Relight", "commit", "processor", "threads", "seed"].contains(&key.as_str())
                })
                .cloned()
                .collect(),
            text: Vec::new(),
            figures: Vec::new(),
            ..section.clone()
        }
    };
    let digests = sections.iter().map(short);
    digests
        .filter(|section| !section.tables.is_empty())
        .collect()
}

/// A digest as Markdown.
fn markdown(digest: &[Section]) -> String {
    let mut text = String::new();
    for section in digest {
        text += &format!("\n**{}** (`{}`)\n", section.title, section.command);
        // Sections may be of different runs.
        let commit = section.provenance.iter().find(|(key, _)| key == "commit");
        if let Some((_, commit)) = commit {
            text += &format!("\nCommit {commit}.\n");
        }
        for table in &section.tables {
            text += &format!("\n{}:\n\n{}", table.caption, table.markdown());
        }
    }
    if let Some(section) = digest.first() {
        let made: Vec<String> = (section.provenance.iter())
            .filter(|(key, _)| key != "commit")
            .map(|(key, value)| format!("{key} {value}"))
            .collect();
        text += &format!("\nMade with {}.\n", made.join(", "));
    }
    text
}
