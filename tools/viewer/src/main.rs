//! Looks at scenes in a window, or draws pictures without one.

#[cfg(not(target_family = "wasm"))]
fn main() -> std::process::ExitCode {
    relight_viewer::command::run()
}

/// Pages call the library.
#[cfg(target_family = "wasm")]
fn main() {}
