//! Visibility from contours, and signed distances with it, against one ray per texel and
//! against Embree, on the same vertices, directions and threads, in one run.
//!
//! `cargo bench -p relight-bake --bench visibility -- [MESH...] [--vertices N]
//! [--threads N] [--rounds N] [--robust] [--json]`
//!
//! MESH may be `city`, which is made: 500 boxes that pass through one another, among 10,000 loose triangles.
//!
//! The contenders take turns and the fastest round of each counts, so that whatever else
//! the machine does falls on all of them alike. Embree takes part if its program is built
//! (`tools/peers/README.md`); `--robust` makes it watertight, as the others are. Prints a table of Markdown.

mod common;

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Instant;

use common::Subject;
use glam::Vec3;
use rayon::prelude::*;
use relight_bake::internals::DistanceTransform;
use relight_bake::internals::visibility::ContourMesh;
use relight_bake::internals::visibility::{self, Bitmap, Directions, RUNS};
use serde_json::{Value, json};

const RESOLUTION: u32 = 128;
const BASIS_RESOLUTION: u32 = 64;

fn main() {
    let vertices = common::number("--vertices", 256);
    let rounds = common::number("--rounds", 3);
    let threads = common::number("--threads", 2);
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .expect("threads");
    let mut rows = Vec::new();
    for path in common::paths() {
        let row = measure(&common::subject(&path, vertices), rounds, threads);
        if common::flag("--json") {
            rows.push(row);
            continue;
        }
        if rows.is_empty() {
            let unit = if threads == 1 { "thread" } else { "threads" };
            println!(
                "Microseconds for a vertex, {threads} {unit}, best of {rounds} rounds in turn:\n"
            );
            println!("| {} |", COLUMNS.map(|(head, _)| head).join(" | "));
            println!("| --- |{}", " ---: |".repeat(COLUMNS.len() - 1));
        }
        println!(
            "| {} |",
            COLUMNS.map(|(_, key)| cell(&row[key])).join(" | ")
        );
        rows.push(row);
    }
    if common::flag("--json") {
        println!("{}", Value::from(rows));
    }
}

/// Heads of the table, and what of a row is below them.
const COLUMNS: [(&str, &str); 10] = [
    ("mesh", "mesh"),
    ("triangles", "triangles"),
    ("visibility", "contours_us"),
    ("and distances", "all_us"),
    ("a ray per texel", "rays_us"),
    ("Embree", "embree_us"),
    ("Embree over visibility", "embree_over_contours"),
    ("Embree over both", "embree_over_all"),
    ("texels that differ from rays", "differing_texels"),
    ("of Embree's", "embree_differing_texels"),
];

/// Two digits behind the point of what is no count; nothing where there is no Embree.
fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        number if number.is_u64() => number.to_string(),
        number => format!("{:.2}", figure(number)),
    }
}

fn figure(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn measure(subject: &Subject, rounds: usize, threads: usize) -> Value {
    let Subject {
        name,
        soup,
        origins,
        ..
    } = subject;
    let directions = Directions::new(RESOLUTION);
    let setup = Instant::now();
    let contours = ContourMesh::new(soup);
    let setup = setup.elapsed().as_secs_f64();
    let transform = DistanceTransform::new(&directions, BASIS_RESOLUTION);
    let mut embree =
        Embree::find().map(|program| Embree::start(&program, subject, &directions, threads));
    // Contours, rays, Embree, contours with crossings, and with crossings and distances.
    let mut best = [f64::INFINITY; 5];
    let mut exact: Vec<Bitmap> = Vec::new();
    let mut fast: Vec<(Bitmap, u32)> = Vec::new();
    for _ in 0..rounds {
        let mut lap = |contender: usize, work: &mut dyn FnMut()| {
            let start = Instant::now();
            work();
            best[contender] = best[contender].min(start.elapsed().as_secs_f64());
        };
        lap(0, &mut || {
            fast = (origins.par_chunks(RUNS[0]))
                .map_init(
                    || contours.scratch(&directions),
                    |scratch, group| {
                        contours.prepare(group, scratch);
                        let sample = |&origin| contours.sample(origin, &directions, scratch);
                        group.iter().map(sample).collect::<Vec<_>>()
                    },
                )
                .flatten()
                .collect();
        });
        lap(1, &mut || {
            exact = (origins.par_iter())
                .map(|&origin| visibility::sample(contours.caster(), origin, &directions))
                .collect();
        });
        let distances = |scratch: &mut _, group: &[Vec3], transform: Option<&DistanceTransform>| {
            contours.prepare(group, scratch);
            for &origin in group {
                let (bitmap, _) = contours.sample(origin, &directions, scratch);
                let crossings = contours.crossings(&bitmap, scratch);
                std::hint::black_box(
                    transform.map(|transform| transform.apply(&bitmap, crossings, 0.5)),
                );
            }
        };
        for (contender, transform) in [(3, None), (4, Some(&transform))] {
            lap(contender, &mut || {
                (origins.par_chunks(RUNS[0])).for_each_init(
                    || contours.scratch(&directions),
                    |scratch, group| distances(scratch, group, transform),
                );
            });
        }
        if let Some(embree) = &mut embree {
            best[2] = best[2].min(embree.round());
        }
    }
    let texels = RESOLUTION.pow(2) as usize;
    let differing: usize = (exact.iter().zip(&fast))
        .map(|(a, (b, _))| (0..texels).filter(|&i| a.get(i) != b.get(i)).count())
        .sum();
    let rays: u64 = fast.iter().map(|(_, rays)| u64::from(*rays)).sum();
    let per_vertex = |seconds: f64| seconds * 1e6 / origins.len() as f64;
    let mut row = json!({
        "mesh": name,
        "triangles": soup.len(),
        "vertices": origins.len(),
        "threads": threads,
        "contours_us": per_vertex(best[0]),
        "rays_us": per_vertex(best[1]),
        "rays_over_contours": best[1] / best[0],
        "rays_per_vertex": rays as f64 / origins.len() as f64,
        "differing_texels": differing,
        "all_us": per_vertex(best[4]),
        "crossings_us": per_vertex(best[3] - best[0]),
        "ssdf_us": per_vertex(best[4] - best[3]),
        "setup_ms": setup * 1e3,
    });
    if let Some(embree) = embree {
        let bitmaps = embree.finish();
        let differing: usize = (exact.iter().zip(bitmaps.chunks_exact(texels / 8)))
            .map(|(a, b)| {
                (0..texels)
                    .filter(|&i| a.get(i) != (b[i / 8] >> (i % 8) & 1 == 1))
                    .count()
            })
            .sum();
        row["embree_us"] = json!(per_vertex(best[2]));
        row["embree_over_contours"] = json!(best[2] / best[0]);
        row["embree_over_all"] = json!(best[2] / best[4]);
        row["embree_differing_texels"] = json!(differing);
        row["embree_robust"] = json!(common::flag("--robust"));
    }
    row
}

/// The program of `tools/peers/embree`, running.
struct Embree {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    folder: tempfile::TempDir,
}

impl Embree {
    /// `RELIGHT_EMBREE`, else where its build line puts it.
    fn find() -> Option<PathBuf> {
        if let Some(path) = std::env::var_os("RELIGHT_EMBREE") {
            return Some(path.into());
        }
        let built = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/peers/embree/occluded");
        built.is_file().then_some(built)
    }

    fn start(program: &Path, subject: &Subject, directions: &Directions, threads: usize) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let rays = folder.path().join("rays");
        let counts = [
            RESOLUTION,
            subject.soup.len() as u32,
            subject.origins.len() as u32,
            0,
        ];
        let mut bytes = b"RAYPEER1".to_vec();
        bytes.extend(counts.iter().flat_map(|count| count.to_le_bytes()));
        let vectors = (directions.as_slice().iter())
            .chain(subject.soup.iter().flatten())
            .chain(&subject.origins);
        bytes.extend(vectors.flat_map(Vec3::to_array).flat_map(f32::to_le_bytes));
        std::fs::write(&rays, bytes).expect("a writable folder");
        let mut command = Command::new(program);
        command
            .arg(&rays)
            .arg("--bitmaps")
            .arg(folder.path().join("bitmaps"));
        command.args(["--threads", &threads.to_string()]);
        if common::flag("--robust") {
            command.arg("--robust");
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().expect("the peer starts");
        let input = child.stdin.take().expect("piped");
        let output = BufReader::new(child.stdout.take().expect("piped"));
        Self {
            child,
            input,
            output,
            folder,
        }
    }

    /// Seconds of one round.
    fn round(&mut self) -> f64 {
        self.input.write_all(b"\n").expect("the peer listens");
        let mut line = String::new();
        self.output.read_line(&mut line).expect("the peer answers");
        let answer: Value = serde_json::from_str(&line).expect("the peer answers in JSON");
        figure(&answer["seconds"])
    }

    /// Ends the program and returns the bitmaps of its last round.
    fn finish(self) -> Vec<u8> {
        let Self {
            mut child,
            input,
            folder,
            ..
        } = self;
        drop(input);
        assert!(
            child.wait().is_ok_and(|status| status.success()),
            "the peer fails"
        );
        std::fs::read(folder.path().join("bitmaps")).expect("the peer writes bitmaps")
    }
}
