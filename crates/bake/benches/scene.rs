//! The whole scene bake on one mesh refined to rising numbers of vertices: time per vertex
//! and stage, how well the time left was told, and on one thread against several.
//!
//! `cargo bench -p relight-bake --bench scene -- [MESH...] [--vertices N,N,...]
//! [--threads N] [--sample-resolution N]`
//!
//! The default ladder ends at 30,000 vertices; `--vertices 10000,30000,100000,300000,1000000`
//! takes an hour or so.

mod common;

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use relight_bake::files::{Access, Files};
use relight_bake::monitor::{Monitor, Progress};
use relight_bake::scene::load;
use relight_bake::scene::{self, Bake, Options, Statistics};

/// The stage whose progress is checked; the others are short.
const STAGE: &str = "visibility and compression";

fn main() {
    let threads = common::number("--threads", 2);
    let ladder = common::option("--vertices").unwrap_or_else(|| "10000,30000".into());
    let ladder: Vec<usize> = (ladder.split(','))
        .map(|count| count.parse().expect("numbers"))
        .collect();
    for path in common::paths() {
        println!("{}", path.display());
        println!(
            "{:>9}{:>9}{:>10}{:>12}{:>9}{:>10}{:>11}{:>12}{:>14}{:>10}",
            "vertices",
            "threads",
            "seconds",
            "us/vertex",
            "setup",
            "visib.",
            "ssdf",
            "compress",
            "left, error",
            "speed-up"
        );
        for &vertices in &ladder {
            let one = (threads > 1 && vertices == ladder[0]).then(|| measure(&path, vertices, 1));
            measure(&path, vertices, threads).print(one.as_ref());
            if let Some(one) = one {
                one.print(None);
            }
        }
    }
}

struct Measured {
    vertices: usize,
    threads: usize,
    /// Of the whole bake without reading and writing, and of what comes before sampling.
    seconds: f64,
    setup: f64,
    /// Largest relative error of the predicted time of the stage, after its first tenth.
    prediction_error: f64,
    statistics: Statistics,
}

impl Measured {
    fn print(&self, one_thread: Option<&Self>) {
        let sampled = self.statistics.sampled_vertices as f64;
        let per_vertex = |seconds: f64| seconds * 1e6 / sampled;
        let stage = |name| {
            let time = self
                .statistics
                .stages
                .iter()
                .find(|(stage, _)| *stage == name);
            per_vertex(time.map_or(0.0, |(_, time)| time.as_secs_f64()))
        };
        println!(
            "{:>9}{:>9}{:>10.1}{:>12.0}{:>9.1}{:>10.0}{:>11.0}{:>12.0}{:>12.0} %{:>10}",
            self.vertices,
            self.threads,
            self.seconds,
            self.seconds * 1e6 / self.vertices as f64,
            self.setup,
            stage("visibility"),
            stage("ssdf"),
            stage("compress"),
            self.prediction_error * 100.0,
            one_thread.map_or_else(String::new, |one| format!(
                "{:.2}",
                one.seconds / self.seconds
            )),
        );
    }
}

fn measure(path: &Path, vertices: usize, threads: usize) -> Measured {
    let input = Files::new(path, &Access::anywhere())
        .and_then(|files| load::load_from(&files, path))
        .unwrap_or_else(|error| panic!("{error}"));
    let options = Options {
        // Short enough that the bound on vertices decides.
        max_edge: 1e-4,
        max_vertices: vertices,
        sample_resolution: common::number("--sample-resolution", 128) as u32,
        ..Options::standard()
    };
    let times: Mutex<Vec<(f32, Instant)>> = Mutex::default();
    let report = |progress: Progress| {
        let mut times = times.lock().expect("no panic elsewhere");
        let last = times.last().map_or(0.0, |(fraction, _)| *fraction);
        if progress.stage == STAGE && progress.fraction >= last + 0.01 {
            times.push((progress.fraction, Instant::now()));
        }
    };
    let monitor = Monitor {
        report: &report,
        stop: &AtomicBool::new(false),
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("threads");
    pool.install(|| {
        let start = Instant::now();
        let bake = Bake::new(input, &options, monitor).unwrap_or_else(|error| panic!("{error}"));
        let setup = start.elapsed().as_secs_f64();
        let vertices = bake.vertex_count();
        let all: Vec<usize> = (0..bake.chunk_count()).collect();
        let sampling = Instant::now();
        bake.run(&all, |_, clusters| {
            std::hint::black_box(clusters);
            Ok::<_, scene::Error>(())
        })
        .unwrap_or_else(|error| panic!("{error}"));
        let took = sampling.elapsed().as_secs_f64();
        let (_, _, statistics) = bake.finish();
        let times = times.lock().expect("no panic elsewhere");
        let errors = (times.iter())
            .filter(|(fraction, _)| (0.1..0.95).contains(fraction))
            .map(|(fraction, time)| {
                let elapsed = (*time - sampling).as_secs_f64();
                let left = elapsed / f64::from(*fraction) - elapsed;
                // Of the time that was left, as a fraction of the stage's: near the end
                // a second too many is no error anyone minds.
                (left - (took - elapsed)).abs() / took
            });
        Measured {
            vertices,
            threads,
            seconds: setup + took,
            setup,
            prediction_error: errors.fold(0.0, f64::max),
            statistics,
        }
    })
}
