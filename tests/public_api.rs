//! What users of a crate can name, as text: `public-api.txt` changes where the API does, and only on
//! purpose. `RELIGHT_UPDATE_API=1` writes it anew. Shared by the tests of the crates that have one.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// How types begin that cannot be named from outside.
const HIDDEN: [&str; 5] = [
    "struct ",
    "pub(crate) struct ",
    "pub(super) struct ",
    "pub(crate) enum ",
    "pub(super) enum ",
];

/// Declarations of a source file that are `pub` in full, one a line, without bodies. Modules of tests
/// are at the end of files.
fn declarations(source: &str) -> Vec<String> {
    let source = source.split("#[cfg(test)]\nmod tests").next().unwrap_or("");
    let mut found = Vec::new();
    let mut context = String::new();
    let mut lines = source.lines();
    let (mut in_enum, mut hidden) = (false, false);
    while let Some(line) = lines.next() {
        let text = line.trim();
        if line.starts_with('}') {
            context.clear();
            (in_enum, hidden) = (false, false);
        }
        // Fields of types that cannot be named are often `pub`.
        hidden |= HIDDEN.iter().any(|start| line.starts_with(start)) && line.ends_with('{');
        if hidden {
            continue;
        }
        if line.starts_with("impl") {
            text.trim_end_matches('{').trim().clone_into(&mut context);
        }
        let variant = in_enum
            && line.starts_with("    ")
            && !line.starts_with("     ")
            && text.starts_with(char::is_alphabetic);
        let field = in_enum
            && line.starts_with("        ")
            && text.ends_with(',')
            && text.contains(": ")
            && text.starts_with(char::is_alphabetic);
        if !(text.starts_with("pub ") || variant || field) {
            continue;
        }
        let mut whole = text.to_owned();
        while text.starts_with("pub use") && !whole.ends_with(';') {
            let Some(next) = lines.next() else { break };
            whole.push(' ');
            whole.push_str(next.trim());
        }
        // Up to the body or the end.
        while text.starts_with("pub ") && !whole.ends_with(['{', ';', ',']) && !whole.ends_with('}')
        {
            let Some(next) = lines.next() else { break };
            whole.push(' ');
            whole.push_str(next.trim());
        }
        while text.starts_with("pub fn") && whole.ends_with(',') {
            let Some(next) = lines.next() else { break };
            whole.push(' ');
            whole.push_str(next.trim());
        }
        if whole.starts_with("pub enum") || whole.starts_with("pub struct") {
            whole.trim_end_matches(['{', ';']).trim()[4..].clone_into(&mut context);
            in_enum = whole.starts_with("pub enum");
            found.push(whole.trim_end_matches('{').trim().to_owned());
            continue;
        }
        let whole = whole.trim_end_matches('{').trim();
        found.push(if context.is_empty() {
            whole.to_owned()
        } else {
            format!("{context}: {whole}")
        });
    }
    found
}

/// The sources below a folder, in the order of their names.
fn sources(folder: &Path, files: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(folder).expect("sources");
    let mut paths: Vec<_> = entries
        .map(|entry| entry.expect("an entry").path())
        .collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            sources(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

/// Compares the declarations of a crate in the folder `here` with its `public-api.txt`. What lies
/// below the folders `without` is not of its library.
pub fn check(here: &Path, without: &[&str]) {
    let mut text = String::from("# Written by RELIGHT_UPDATE_API=1 cargo test --test public_api\n");
    let mut files = Vec::new();
    sources(&here.join("src"), &mut files);
    for path in files {
        let source = std::fs::read_to_string(&path).expect("a source file");
        let name = path.strip_prefix(here).expect("a file of this crate");
        if without.iter().any(|folder| name.starts_with(folder)) {
            continue;
        }
        let declared = declarations(&source);
        if !declared.is_empty() {
            writeln!(text, "\n## {}\n", name.display()).expect("a String accepts every write");
            for line in declared {
                writeln!(text, "{line}").expect("a String accepts every write");
            }
        }
    }
    let stored = here.join("public-api.txt");
    if std::env::var_os("RELIGHT_UPDATE_API").is_some_and(|value| value == "1") {
        std::fs::write(&stored, &text).expect("a file that can be written");
    }
    let expected = std::fs::read_to_string(&stored).expect("public-api.txt");
    let first = text.lines().zip(expected.lines()).find(|(a, b)| a != b);
    assert!(
        text == expected,
        "the public API differs from public-api.txt; RELIGHT_UPDATE_API=1 writes it anew: {first:?}"
    );
}

#[test]
fn declarations_are_found() {
    let source = "pub struct Point {\n    /// x\n    pub x: f32,\n    y: f32,\n}\nimpl Point {\n    \
        pub fn new(\n        x: f32,\n    ) -> Self {\n        pub_not(x)\n    }\n    pub(crate) fn no() {}\n}\n\
        pub(crate) struct Inner {\n    pub x: f32,\n}\n\
        pub enum Way {\n    /// a\n    There,\n    Back {\n        steps: u32,\n    },\n}\npub use a::{B, C};\n";
    assert_eq!(
        declarations(source),
        [
            "pub struct Point",
            "struct Point: pub x: f32,",
            "impl Point: pub fn new( x: f32, ) -> Self",
            "pub enum Way",
            "enum Way: There,",
            "enum Way: Back",
            "enum Way: steps: u32,",
            "pub use a::{B, C};",
        ]
    );
}
