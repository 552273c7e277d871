//! What trials share: the data folder, the binaries, skipping.

use std::ffi::OsStr;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use libtest_mimic::{Completion, Failed, Trial};

pub use crate::command::describe;

/// What a trial returns; failed assertions count as well.
pub type Outcome = Result<(), Failed>;

/// A trial on real data; skipped where there is none.
pub fn with_data(
    name: impl Into<String>,
    run: impl FnOnce(&Path) -> Outcome + Send + 'static,
) -> Trial {
    Trial::ignorable_test(name, move || match data_folder() {
        Some(folder) => run(&folder).map(|()| Completion::Completed),
        None => Ok(no_data()),
    })
}

/// A trial that draws with a GPU. Where there is none it fails, unless `RELIGHT_NO_GPU=1`
/// skips it: a driver that went missing must not pass unnoticed.
pub fn with_gpu(name: impl Into<String>, run: impl FnOnce() -> Outcome + Send + 'static) -> Trial {
    Trial::ignorable_test(name, move || {
        if no_gpu() {
            Ok(skipped_gpu())
        } else {
            run().map(|()| Completion::Completed)
        }
    })
}

/// Both.
pub fn with_data_and_gpu(
    name: impl Into<String>,
    run: impl FnOnce(&Path) -> Outcome + Send + 'static,
) -> Trial {
    Trial::ignorable_test(name, move || {
        if no_gpu() {
            return Ok(skipped_gpu());
        }
        match data_folder() {
            Some(folder) => run(&folder).map(|()| Completion::Completed),
            None => Ok(no_data()),
        }
    })
}

/// A trial that opens a page in Chromium, whose name it gets. Where there is none it fails,
/// unless `RELIGHT_NO_BROWSER=1` skips it.
pub fn with_browser(
    name: impl Into<String>,
    run: impl FnOnce(&str) -> Outcome + Send + 'static,
) -> Trial {
    Trial::ignorable_test(name, move || {
        if std::env::var_os("RELIGHT_NO_BROWSER").is_some_and(|value| value == "1") {
            return Ok(Completion::ignored_with("RELIGHT_NO_BROWSER=1"));
        }
        let names = ["chromium", "chromium-browser", "google-chrome"];
        let found = names.into_iter().find(|name| {
            let version = Command::new(name).arg("--version").output();
            version.is_ok_and(|output| output.status.success())
        });
        let browser = found.ok_or("no Chromium, and no RELIGHT_NO_BROWSER=1")?;
        run(browser).map(|()| Completion::Completed)
    })
}

/// The same of what `cargo xtask web` builds; skipped where that was not done.
pub fn with_page(
    name: impl Into<String>,
    run: impl FnOnce(&str) -> Outcome + Send + 'static,
) -> Trial {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../out/web/relight_viewer_bg.wasm");
    if page.exists() {
        return with_browser(name, run);
    }
    Trial::ignorable_test(name, || {
        Ok(Completion::ignored_with(
            "no out/web: cargo xtask web makes it",
        ))
    })
}

/// A trial that opens a window, on a screen of its own that Xvfb makes, whose name it gets. Where
/// there is no Xvfb it fails, unless `RELIGHT_NO_DISPLAY=1` skips it.
pub fn with_display(
    name: impl Into<String>,
    run: impl FnOnce(&str) -> Outcome + Send + 'static,
) -> Trial {
    Trial::ignorable_test(name, move || {
        if std::env::var_os("RELIGHT_NO_DISPLAY").is_some_and(|value| value == "1") {
            return Ok(Completion::ignored_with("RELIGHT_NO_DISPLAY=1"));
        }
        // It chooses a free number itself and writes it down once it can be used.
        let mut xvfb = Command::new("Xvfb")
            .args([
                "-displayfd",
                "1",
                "-screen",
                "0",
                "1280x800x24",
                "-nolisten",
                "tcp",
            ])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|error| format!("Xvfb: {error}, and no RELIGHT_NO_DISPLAY=1"))?;
        let mut number = String::new();
        let stdout = xvfb.stdout.take();
        let read = stdout.map(|stdout| BufReader::new(stdout).read_line(&mut number));
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| match read {
            Some(Ok(length)) if length > 1 => run(&format!(":{}", number.trim())),
            _ => Err("Xvfb did not start".into()),
        }));
        // It is ours and has to go, whatever happened.
        let _ = xvfb.kill();
        let _ = xvfb.wait();
        match result {
            Ok(outcome) => outcome.map(|()| Completion::Completed),
            Err(payload) => std::panic::resume_unwind(payload),
        }
    })
}

fn no_data() -> Completion {
    Completion::ignored_with("no RELIGHT_DATA and no ../shared/data")
}

fn no_gpu() -> bool {
    std::env::var_os("RELIGHT_NO_GPU").is_some_and(|value| value == "1")
}

fn skipped_gpu() -> Completion {
    Completion::ignored_with("RELIGHT_NO_GPU=1")
}

/// `RELIGHT_DATA`, which must then be right, or `../shared/data` if that is there.
fn data_folder() -> Option<PathBuf> {
    if let Some(folder) = std::env::var_os("RELIGHT_DATA") {
        let folder = PathBuf::from(folder);
        assert!(
            folder.is_dir(),
            "RELIGHT_DATA is {}, which is no folder",
            folder.display()
        );
        return Some(folder);
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    folder.canonicalize().ok().filter(|folder| folder.is_dir())
}

/// A command that runs the workspace's binary `name`, built from the sources as they are.
pub fn binary(name: &str) -> Command {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        // target/PROFILE/deps/suite-HASH: the binaries lie in target/PROFILE.
        let suite = std::env::current_exe().expect("the suite knows where it is");
        let folder = suite
            .ancestors()
            .nth(2)
            .expect("two folders above")
            .to_owned();
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        // With xtask, crates would have other features than the suite was compiled with.
        let arguments = "build --quiet --workspace --exclude relight-xtask --bins";
        cargo.args(arguments.split(' '));
        if folder.file_name() == Some(OsStr::new("release")) {
            cargo.arg("--release");
        }
        let built = cargo.current_dir(env!("CARGO_MANIFEST_DIR")).status();
        assert!(
            built.is_ok_and(|status| status.success()),
            "the binaries do not build"
        );
        folder
    });
    Command::new(folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX)))
}
