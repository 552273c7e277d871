//! Modules of a crate use one another in one direction, and WGSL has no function that nothing calls and no name that
//! two files define but for those of interfaces.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use libtest_mimic::Trial;
use relight_shading::wgsl::{INTERFACES, Interface};

use crate::support::Outcome;

/// What each module at a crate's top level uses of the others.
type Uses = BTreeMap<String, BTreeSet<String>>;

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::test("modules::no_cycles_inside_crates", no_cycles),
        Trial::test("modules::a_cycle_is_found", a_cycle_is_found),
        Trial::test("modules::wgsl_functions_are_used", wgsl_functions_are_used),
        Trial::test("modules::wgsl_names_are_distinct", wgsl_names_are_distinct),
    ]
}

fn no_cycles() -> Outcome {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let (mut checked, mut wrong) = (0, String::new());
    for group in ["crates", "tools"] {
        for entry in fs::read_dir(root.join(group))? {
            let name = format!("{group}/{}", entry?.file_name().display());
            let source = root.join(&name).join("src");
            if !source.is_dir() {
                continue;
            }
            checked += 1;
            let uses = uses(&files(&source)?);
            if let Some(cycle) = cycle(&uses) {
                wrong += &format!("{name}: {}\n", cycle.join(" -> "));
            }
        }
    }
    assert!(checked > 1, "only {checked} crates");
    assert!(wrong.is_empty(), "\n{wrong}");
    Ok(())
}

/// Every source file's module at the top level of its crate, and its text.
fn files(source: &Path) -> Result<Vec<(String, String)>, std::io::Error> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = vec![source.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let inside = path.strip_prefix(source).unwrap_or(&path);
                let top = inside
                    .iter()
                    .next()
                    .map(Path::new)
                    .and_then(Path::file_stem);
                let module = top.unwrap_or_default().to_string_lossy().into_owned();
                found.push((module, fs::read_to_string(&path)?));
            }
        }
    }
    Ok(found)
}

/// What modules name after `crate::`, but in comments and in the tests at a file's end. The
/// crate's root may use any and is used by any.
fn uses(files: &[(String, String)]) -> Uses {
    let inner = |module: &String| !matches!(module.as_str(), "lib" | "main");
    let modules: BTreeSet<&String> = files
        .iter()
        .map(|(module, _)| module)
        .filter(|m| inner(m))
        .collect();
    let mut uses = Uses::new();
    for (module, text) in files.iter().filter(|(module, _)| inner(module)) {
        let product = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
        let code: Vec<&str> = product
            .lines()
            .map(|line| line.split("//").next().unwrap_or_default())
            .collect();
        let used = uses.entry(module.clone()).or_default();
        for rest in code.join("\n").split("crate::").skip(1) {
            let names = named(rest)
                .into_iter()
                .filter(|name| modules.contains(name));
            used.extend(names.filter(|name| name != module));
        }
    }
    uses
}

/// First names of the paths that follow `crate::`: one, or those of a group in braces.
fn named(rest: &str) -> Vec<String> {
    let name = |text: &str| -> String {
        let letters = text.trim_start().chars();
        letters
            .take_while(|&c| c.is_alphanumeric() || c == '_')
            .collect()
    };
    let Some(group) = rest.strip_prefix('{') else {
        return vec![name(rest)];
    };
    let (mut depth, mut start, mut names) = (0, 0, Vec::new());
    for (at, letter) in group.char_indices() {
        match letter {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                names.push(name(&group[start..at]));
                start = at + 1;
                if letter == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    names
}

/// A way from a module back to itself, the shortest one.
fn cycle(uses: &Uses) -> Option<Vec<&str>> {
    let ways = uses.keys().filter_map(|start| way_back(uses, start));
    ways.min_by_key(Vec::len)
}

fn way_back<'a>(uses: &'a Uses, start: &'a str) -> Option<Vec<&'a str>> {
    let mut seen = BTreeSet::new();
    let mut ways = std::collections::VecDeque::from([vec![start]]);
    while let Some(way) = ways.pop_front() {
        let last = *way.last()?;
        for next in uses.get(last).into_iter().flatten() {
            let longer = [&way[..], &[next.as_str()]].concat();
            if next == start {
                return Some(longer);
            }
            if seen.insert(next.as_str()) {
                ways.push_back(longer);
            }
        }
    }
    None
}

/// The check itself: one use closes a cycle, in a group, over a folder; none in comments, tests, the root.
fn a_cycle_is_found() -> Outcome {
    let with = |last: &str| {
        let text = [
            ("lib", "pub use crate::a::A;"),
            ("a", "use crate::{Error, b::{self, B}, d};\n// crate::c\n"),
            (
                "b",
                "use crate::c::C;\n#[cfg(test)]\nmod tests { use crate::a; }",
            ),
            ("c", last),
            ("d", ""),
        ];
        uses(&text.map(|(module, text)| (module.to_owned(), text.to_owned())))
    };
    let open = with("use crate::d::D; use crate::c;");
    assert_eq!(cycle(&open), None);
    let closed = with("fn f() { crate::a::g() }");
    assert_eq!(cycle(&closed), Some(vec!["a", "b", "c", "a"]));
    Ok(())
}

fn wgsl_functions_are_used() -> Outcome {
    let code: String = shaders()?.into_iter().map(|(_, code)| code).collect();
    let unused = unused(&code);
    assert!(unused.is_empty(), "no shader calls {unused:?}");
    // The check itself: entries need no caller, a function's own name is no call.
    let of = "@compute @workgroup_size(8)\nfn main() { a(); }\nfn a() {}\nfn ab() {}\n";
    assert_eq!(self::unused(of), ["ab"]);
    Ok(())
}

/// Name and code of every WGSL file, without comments.
fn shaders() -> Result<Vec<(String, String)>, std::io::Error> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/shading/src/wgsl");
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let mut code = String::new();
        for line in fs::read_to_string(&path)?.lines() {
            code += line.split("//").next().unwrap_or_default();
            code.push('\n');
        }
        let name = path.file_name().unwrap_or_default();
        files.push((name.to_string_lossy().into_owned(), code));
    }
    files.sort();
    Ok(files)
}

fn wgsl_names_are_distinct() -> Outcome {
    let wrong = shared_names(&shaders()?, INTERFACES);
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
    // The check itself: a double, a part of an interface that is not there, one of one file.
    let files = [
        (
            "a",
            "fn f(x: u32) {}\nstruct S {\n@group(0) @binding(1) var t: texture_2d<f32>;\n",
        ),
        ("b", "fn f() {}\n@fragment fn g() {}\nconst T: u32 = 1u;\n"),
        ("c", "var<private> S: u32;\n    var t = 1;\n"),
    ];
    let files = files.map(|(name, code)| (name.to_owned(), code.to_owned()));
    let interface = |names, files| Interface {
        what: "",
        names,
        files,
    };
    let both = interface(&["f"], &["a", "b"]);
    assert_eq!(shared_names(&files, &[both]), ["S: defined by a, c"]);
    let absent = [both, interface(&["S", "T"], &["a", "c"])];
    assert_eq!(
        shared_names(&files, &absent),
        ["T: an interface of a, c, defined by b"]
    );
    Ok(())
}

/// What is wrong with names that several files define, or that interfaces say they do.
fn shared_names(files: &[(String, String)], interfaces: &[Interface]) -> Vec<String> {
    let mut defined: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (file, code) in files {
        for name in code.lines().filter_map(definition) {
            defined.entry(name).or_default().push(file);
        }
    }
    let mut wrong = Vec::new();
    for interface in interfaces {
        for name in interface.names {
            let by = defined.remove(name).unwrap_or_default();
            if by != interface.files {
                let said = interface.files.join(", ");
                wrong.push(format!(
                    "{name}: an interface of {said}, defined by {}",
                    by.join(", ")
                ));
            }
        }
    }
    let doubles = defined.iter().filter(|(_, by)| by.len() > 1);
    wrong.extend(doubles.map(|(name, by)| format!("{name}: defined by {}", by.join(", "))));
    wrong
}

/// The name that a line defines for its whole module.
fn definition(line: &str) -> Option<&str> {
    let mut words = line.split(' ').filter(|word| !word.is_empty());
    if line.starts_with(' ') {
        return None;
    }
    let kind = words.find(|word| !word.starts_with('@'))?;
    let kind = kind.split('<').next()?;
    if !["fn", "struct", "const", "override", "alias", "var"].contains(&kind) {
        return None;
    }
    let rest = words.find(|word| !word.ends_with('>') && !word.ends_with(','))?;
    rest.split(|c: char| !(c.is_alphanumeric() || c == '_'))
        .next()
}

/// Functions that are no entries and occur in `code` only where they are defined.
fn unused(code: &str) -> Vec<&str> {
    let letter = |c: char| c.is_alphanumeric() || c == '_';
    let words: Vec<&str> = code
        .split(|c| !letter(c))
        .filter(|word| !word.is_empty())
        .collect();
    let mut found = Vec::new();
    let mut before = "";
    for line in code.lines() {
        if let Some((name, _)) = line
            .strip_prefix("fn ")
            .and_then(|rest| rest.split_once('('))
        {
            let defined = words
                .windows(2)
                .filter(|pair| pair == &["fn", name])
                .count();
            let named = words.iter().filter(|word| **word == name).count();
            if named == defined && !before.starts_with('@') {
                found.push(name);
            }
        }
        before = line;
    }
    found
}
