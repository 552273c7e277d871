//! Commands that are run and what they must do; shared with the tests of `bake` itself.

use std::path::Path;
use std::process::{Command, Output, Stdio};

/// Exit codes of `bake`, as README.md lists them.
pub const OK: i32 = 0;
pub const BAD_INPUT: i32 = 1;
pub const USAGE: i32 = 2;
pub const INPUT_OUTPUT: i32 = 3;
pub const INTERRUPTED: i32 = 130;

/// Runs a command that must succeed.
pub fn expect_success(command: &mut Command) -> Output {
    expect(OK, command)
}

/// Runs a command that must refuse `file`, and returns the line that says why.
pub fn expect_refusal(command: &mut Command, file: &Path) -> String {
    error_line(&expect(BAD_INPUT, command), file)
}

/// Runs a command that must exit with `code`.
pub fn expect(code: i32, command: &mut Command) -> Output {
    let output = command
        .stdin(Stdio::null())
        .output()
        .expect("the binary starts");
    assert_eq!(
        output.status.code(),
        Some(code),
        "{command:?}: {}",
        describe(&output)
    );
    output
}

/// The one line that says why, which must name `file`.
pub fn error_line(output: &Output, file: &Path) -> String {
    let errors = String::from_utf8(output.stderr.clone()).expect("messages are UTF-8");
    let lines: Vec<&str> = errors
        .lines()
        .filter(|line| line.starts_with("error"))
        .collect();
    let [line] = lines[..] else {
        panic!("not one error line: {}", describe(output))
    };
    assert_eq!(
        errors.lines().last(),
        Some(line),
        "more after the error: {}",
        describe(output)
    );
    let name = file.file_name().unwrap().to_str().unwrap();
    assert!(line.contains(name), "{line:?} does not name {name}");
    line.to_owned()
}

/// What a finished command did, for messages.
pub fn describe(output: &Output) -> String {
    format!(
        "{}\nstdout: {}\nstderr: {}",
        output.status,
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}
