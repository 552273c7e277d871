//! Looks at scenes in a window, or draws pictures without one.

use std::process::ExitCode;

fn main() -> ExitCode {
    relight_viewer::command::run()
}
