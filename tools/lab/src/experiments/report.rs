//! What an experiment found: text, tables and figures, as files and as one HTML page.

use std::path::Path;

use anyhow::Context as _;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde::{Deserialize, Serialize};

/// What one experiment found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// Name on the command line, and of its folder.
    pub name: String,
    /// Heading.
    pub title: String,
    /// The command that made it.
    pub command: String,
    /// Where it ran and with what.
    pub provenance: Vec<(String, String)>,
    /// How long it took. What it shares with experiments before it took its time there.
    #[serde(default)]
    pub seconds: f64,
    /// Paragraphs: what is shown, and how it was measured.
    pub text: Vec<String>,
    /// Tables, each also a CSV file.
    pub tables: Vec<Table>,
    /// Pictures and plots.
    pub figures: Vec<Figure>,
}

/// Rows of cells under named columns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// Name of its CSV file, without the extension.
    pub name: String,
    /// What it says.
    pub caption: String,
    /// Heads, with units.
    pub columns: Vec<String>,
    /// As many cells as columns each.
    pub rows: Vec<Vec<Cell>>,
}

/// One entry of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Cell {
    /// A measured number; NaN and infinity are not shown.
    Number(f64),
    /// A name.
    Text(String),
    /// Nothing to say.
    Nothing(()),
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        if number.is_finite() {
            Self::Number(number)
        } else {
            Self::Nothing(())
        }
    }
}

impl From<usize> for Cell {
    fn from(number: usize) -> Self {
        Self::Number(number as f64)
    }
}

impl From<Option<f64>> for Cell {
    fn from(number: Option<f64>) -> Self {
        number.map_or(Self::Nothing(()), Self::from)
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl Cell {
    /// Some number less than this.
    pub fn below(number: f64) -> Self {
        Self::Text(format!("< {}", Self::Number(number).shown()))
    }

    /// For people: three significant digits of what is below a thousand.
    fn shown(&self) -> String {
        match self {
            Self::Nothing(()) => String::new(),
            Self::Text(text) => text.clone(),
            Self::Number(number) => {
                let digits = match number.abs() {
                    size if size >= 100.0 || number.fract() == 0.0 => 0,
                    size if size >= 10.0 => 1,
                    size if size >= 1.0 => 2,
                    size if size >= 0.1 => 3,
                    _ => 4,
                };
                format!("{number:.digits$}")
            }
        }
    }

    /// For programs: every digit.
    fn written(&self) -> String {
        match self {
            Self::Text(text) if text.contains([',', '"', '\n']) => {
                format!("\"{}\"", text.replace('"', "\"\""))
            }
            Self::Number(number) => number.to_string(),
            other => other.shown(),
        }
    }
}

impl Table {
    /// An empty table.
    pub fn new(name: &str, caption: &str, columns: &[&str]) -> Self {
        Self {
            name: name.to_owned(),
            caption: caption.to_owned(),
            columns: columns.iter().map(|&column| column.to_owned()).collect(),
            rows: Vec::new(),
        }
    }

    /// Adds a row.
    ///
    /// # Panics
    /// If the number of cells is not that of the columns.
    pub fn row<const N: usize>(&mut self, cells: [Cell; N]) {
        assert_eq!(N, self.columns.len(), "cells of {}", self.name);
        self.rows.push(cells.into());
    }

    /// Some of its columns, in their own order; all if none are named.
    #[must_use]
    pub fn with(&self, columns: &[&str]) -> Self {
        let kept =
            |index: &usize| columns.is_empty() || columns.contains(&self.columns[*index].as_str());
        let indices: Vec<usize> = (0..self.columns.len()).filter(kept).collect();
        let rows = self.rows.iter();
        Self {
            columns: indices.iter().map(|&i| self.columns[i].clone()).collect(),
            rows: rows
                .map(|row| indices.iter().map(|&i| row[i].clone()).collect())
                .collect(),
            ..self.clone()
        }
    }

    /// Comma-separated values with a header.
    pub fn csv(&self) -> String {
        let heads = self.columns.iter().map(|head| Cell::Text(head.clone()));
        let mut lines: Vec<String> = vec![
            heads
                .map(|head| head.written())
                .collect::<Vec<_>>()
                .join(","),
        ];
        for row in &self.rows {
            lines.push(row.iter().map(Cell::written).collect::<Vec<_>>().join(","));
        }
        lines.join("\n") + "\n"
    }

    /// A table of GitHub's Markdown.
    pub fn markdown(&self) -> String {
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let numbers =
            |column: usize| (self.rows.iter()).all(|row| !matches!(row[column], Cell::Text(_)));
        let rule = (0..self.columns.len()).map(|column| {
            let rule = if numbers(column) { "---:" } else { "---" };
            rule.to_owned()
        });
        let mut text = line(self.columns.clone()) + &line(rule.collect());
        for row in &self.rows {
            text += &line(row.iter().map(Cell::shown).collect());
        }
        text
    }

    fn html(&self) -> Markup {
        html! {
            table {
                caption { (self.caption) " (" code { (self.name) ".csv" } ")" }
                thead { tr { @for column in &self.columns { th { (column) } } } }
                tbody {
                    @for row in &self.rows {
                        tr {
                            @for cell in row {
                                @if matches!(cell, Cell::Number(_)) {
                                    td.number { (cell.shown()) }
                                } @else {
                                    td { (cell.shown()) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// A picture (.png) or plot (.svg).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// File in the section's folder.
    pub file: String,
    /// What it shows, from left to right.
    pub caption: String,
}

impl Figure {
    fn html(&self, folder: &Path) -> anyhow::Result<Markup> {
        let path = folder.join(&self.file);
        let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
        let image = if path.extension().is_some_and(|kind| kind == "svg") {
            PreEscaped(String::from_utf8(bytes).with_context(|| path.display().to_string())?)
        } else {
            let source = format!("data:image/png;base64,{}", STANDARD.encode(bytes));
            html! { img src=(source) alt=(self.caption); }
        };
        Ok(html! { figure { (image) figcaption { (self.caption) } } })
    }
}

const STYLE: &str = "\
body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}\
h2{margin-top:2.5em;border-bottom:1px solid #ccc}\
table{display:block;overflow-x:auto;border-collapse:collapse;margin:1em 0;font-size:13px}\
caption{text-align:left;padding:.3em 0;color:#555}\
th,td{padding:.2em .7em;border-bottom:1px solid #e4e4e4;text-align:left}\
td.number{text-align:right;font-variant-numeric:tabular-nums}\
figure{margin:1em 0}figcaption{color:#555;font-size:13px}\
img,svg{max-width:100%;height:auto}\
pre,.provenance{background:#f5f5f5;padding:.6em;font-size:12px;overflow-x:auto}";

/// One page that needs no other file and no script. The sections' figures are read from folders
/// of their names in `folder`.
pub fn page(folder: &Path, sections: &[Section]) -> anyhow::Result<String> {
    let mut bodies = Vec::new();
    for section in sections {
        let figures = (section.figures.iter())
            .map(|figure| figure.html(&folder.join(&section.name)))
            .collect::<anyhow::Result<Vec<_>>>()?;
        bodies.push(html! {
            section id=(section.name) {
                h2 { (section.title) }
                @for paragraph in &section.text { p { (paragraph) } }
                @for table in &section.tables { (table.html()) }
                @for figure in &figures { (figure) }
                pre { (section.command) }
                p.provenance {
                    @for (key, value) in &section.provenance { (key) ": " (value) ". " }
                    "seconds: " (format!("{:.0}", section.seconds)) "."
                }
            }
        });
    }
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                title { "Relight: experiments" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { "Relight: experiments" }
                p {
                    "Errors are relative root mean square errors over the pixels that the scene \
                     covers, noise of the truth removed, unless a table says otherwise."
                }
                ul {
                    @for section in sections {
                        li { a href=(format!("#{}", section.name)) { (section.title) } }
                    }
                }
                @for body in &bodies { (body) }
            }
        }
    };
    Ok(page.into_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut table = Table::new("t", "of <things>", &["name, kind", "value"]);
        table.row(["a \"b\", c".into(), 0.012_345.into()]);
        table.row(["<b>".into(), f64::NAN.into()]);
        table
    }

    #[test]
    fn tables_are_escaped_for_every_reader() {
        let table = table();
        assert_eq!(
            table.csv(),
            "\"name, kind\",value\n\"a \"\"b\"\", c\",0.012345\n<b>,\n"
        );
        let markdown = table.markdown();
        assert_eq!(markdown.lines().nth(1), Some("| --- | ---: |"));
        assert_eq!(markdown.lines().nth(2), Some("| a \"b\", c | 0.0123 |"));
        let html = table.html().into_string();
        assert!(
            html.contains("&lt;b&gt;") && html.contains("of &lt;things&gt;"),
            "{html}"
        );
    }

    #[test]
    fn sections_survive_their_file() {
        let section = Section {
            name: "x".into(),
            tables: vec![table()],
            figures: vec![Figure {
                file: "a.png".into(),
                caption: "c".into(),
            }],
            ..Section::default()
        };
        let text = serde_json::to_string(&section).unwrap();
        assert_eq!(serde_json::from_str::<Section>(&text).unwrap(), section);
    }

    #[test]
    fn a_missing_figure_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let section = Section {
            name: "x".into(),
            figures: vec![Figure {
                file: "absent.png".into(),
                caption: String::new(),
            }],
            ..Section::default()
        };
        let error = page(folder.path(), &[section]).unwrap_err();
        assert!(format!("{error:#}").contains("absent.png"), "{error:#}");
    }
}
