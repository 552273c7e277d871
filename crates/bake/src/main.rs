//! The `bake` command: meshes and HDR environments into `.relight` assets.

mod command;

fn main() -> std::process::ExitCode {
    command::run()
}
