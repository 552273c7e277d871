//! What goes to the terminal: progress, warnings, results and errors, as text or JSON.
//!
//! Nobody may be listening. A closed pipe is no failure, a full disk under standard output is;
//! neither may panic, and nothing that is said on standard error can fail.

use std::error::Error;
use std::io::{ErrorKind, IsTerminal as _, Write as _};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use relight_bake::environment;
use relight_bake::error::{self, Objection};
use relight_bake::files::OutputError;
use relight_bake::monitor::{Interrupted, Progress};
use relight_bake::scene;
use relight_format as format;
use serde_json::{Map, Value, json};

use super::arguments::Usage;
use super::lossy;

/// Version of what `--json` prints: fields may be added, but not change or go, while it stays.
const SCHEMA: u32 = 1;

/// What a command says at its end.
pub struct Summary {
    pub text: String,
    pub json: Value,
}

/// Warnings so far: they are also part of the final object.
static WARNINGS: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Says what the user should know, and goes on.
pub fn warn(text: impl Into<String>) {
    let text = text.into();
    say(&format!("warning: {text}"));
    let mut warnings = WARNINGS.lock().unwrap_or_else(PoisonError::into_inner);
    warnings.push(text);
}

/// A line on standard error.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Prints to standard output; a reader that has gone away is no error.
pub fn print(text: &str) -> std::io::Result<()> {
    let mut output = std::io::stdout().lock();
    let result = (output.write_all(text.as_bytes())).and_then(|()| output.flush());
    result.or_else(|error| match error.kind() {
        ErrorKind::BrokenPipe => Ok(()),
        _ => Err(error),
    })
}

/// How much is printed as JSON.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Output {
    Text,
    Json,
    /// One object per line, progress among them.
    JsonLines,
}

/// A bar on a terminal, a line every few seconds elsewhere, nothing with `--json`.
pub struct Show {
    output: Output,
    command: &'static str,
    start: Instant,
    bar: Option<ProgressBar>,
    plain: Option<Mutex<Plain>>,
}

struct Plain {
    stage: &'static str,
    start: Instant,
    last: Instant,
}

/// Stages report what is proportional to the work, so the rest takes as long per part as
/// what is done.
fn time_left(elapsed: Duration, fraction: f32) -> Option<Duration> {
    let seconds = elapsed.as_secs_f64() * (1.0 / f64::from(fraction) - 1.0);
    Duration::try_from_secs_f64(seconds.round()).ok()
}

impl Show {
    const PLAIN_INTERVAL: Duration = Duration::from_secs(5);
    /// Time between two objects of one stage.
    const LINES_INTERVAL: Duration = Duration::from_millis(500);

    /// For a command of this name.
    pub fn new(output: Output, command: &'static str) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let style = ProgressStyle::with_template(
            "{msg:<28} {bar:40} {percent:>3} %  elapsed {elapsed}  left {left}",
        )
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .with_key(
            "left",
            |state: &ProgressState, out: &mut dyn std::fmt::Write| {
                if let Some(left) = time_left(state.elapsed(), state.fraction()) {
                    let _ = write!(out, "{}", HumanDuration(left));
                }
            },
        );
        let now = Instant::now();
        let plain = Plain {
            stage: "",
            start: now,
            last: now,
        };
        let text = output == Output::Text;
        let shown = !terminal && text || output == Output::JsonLines;
        Self {
            output,
            command,
            start: now,
            bar: (terminal && text).then(|| ProgressBar::new(1000).with_style(style)),
            plain: shown.then(|| Mutex::new(plain)),
        }
    }

    /// Shows how far the work is.
    pub fn progress(&self, progress: Progress) {
        let Progress { stage, fraction } = progress;
        if let Some(bar) = &self.bar {
            if bar.message() != stage {
                bar.set_message(stage);
                bar.reset_elapsed();
            }
            bar.set_position((fraction * 1000.0) as u64);
        }
        let Some(plain) = &self.plain else { return };
        let mut plain = plain.lock().unwrap_or_else(PoisonError::into_inner);
        let new = plain.stage != stage;
        if new {
            (plain.stage, plain.start) = (stage, Instant::now());
        }
        if self.output == Output::JsonLines {
            if new || plain.last.elapsed() >= Self::LINES_INTERVAL {
                plain.last = Instant::now();
                let fields = json!({
                    "type": "progress",
                    "stage": stage,
                    "fraction": fraction.clamp(0.0, 1.0),
                    "seconds": self.start.elapsed().as_secs_f64(),
                });
                // The final object says whether standard output works.
                let _ = print(&self.line(fields));
            }
        } else if plain.last.elapsed() >= Self::PLAIN_INTERVAL {
            plain.last = Instant::now();
            let left = time_left(plain.start.elapsed(), fraction)
                .map(|left| format!(", {} left", HumanDuration(left)));
            let left = left.unwrap_or_default();
            say(&format!("{stage}: {:.0} %{left}", fraction * 100.0));
        }
    }

    /// An object with what all of them have.
    fn line(&self, fields: Value) -> String {
        let mut object = Map::new();
        object.insert("schema_version".into(), json!(SCHEMA));
        object.insert("command".into(), json!(self.command));
        if let Value::Object(fields) = fields {
            object.extend(fields);
        }
        format!("{}\n", Value::Object(object))
    }

    /// Prints what came of it. Gives the exit code.
    pub fn finish(&self, result: &anyhow::Result<Summary>) -> u8 {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        let warnings =
            std::mem::take(&mut *WARNINGS.lock().unwrap_or_else(PoisonError::into_inner));
        let code = result.as_ref().err().map_or(0, exit_code);
        let printed = match result {
            Ok(summary) if self.output == Output::Text => print(&summary.text),
            Ok(summary) => {
                let mut fields = json!({ "type": "result", "warnings": warnings });
                if let (Value::Object(fields), Value::Object(more)) = (&mut fields, &summary.json) {
                    fields.extend(more.clone());
                }
                print(&self.line(fields))
            }
            Err(error) => {
                say(&format!("error: {}", error::sentence(error.chain())));
                if self.output == Output::Text {
                    Ok(())
                } else {
                    let error = error_object(error);
                    let fields = json!({ "type": "error", "warnings": warnings, "error": error });
                    print(&self.line(fields))
                }
            }
        };
        if let Err(error) = printed
            && code == 0
        {
            say(&format!("error: standard output: {error}"));
            return 3;
        }
        code
    }
}

/// As `--help` lists them.
fn exit_code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if is_interruption(cause) {
            return 130;
        }
        match cause.downcast_ref() {
            Some(OutputError::Input(_)) => return 2,
            Some(OutputError::Unwritable(_)) => return 3,
            None => {}
        }
        if cause.is::<Usage>() {
            return 2;
        }
        if cause.is::<std::io::Error>() {
            return 3;
        }
    }
    1
}

/// Whether somebody asked to stop. Transparent errors hide what they pass on.
pub fn is_interruption(cause: &(dyn Error + 'static)) -> bool {
    cause.is::<Interrupted>()
        || matches!(cause.downcast_ref(), Some(scene::Error::Interrupted(_)))
        || matches!(
            cause.downcast_ref(),
            Some(environment::Error::Interrupted(_))
        )
}

/// An error as programs want it: what is known apart from the sentence.
fn error_object(error: &anyhow::Error) -> Value {
    let code = exit_code(error);
    let kind = match code {
        2 => "usage",
        3 => "input_output",
        130 => "interrupted",
        _ => "invalid_input",
    };
    let mut object = json!({
        "kind": kind,
        "exit_code": code,
        "message": error::sentence(error.chain()),
    });
    let details = error.chain().find_map(details);
    if let (Value::Object(object), Some(details)) = (&mut object, details) {
        let names = ["file", "place", "expected", "found", "issue"];
        for (name, value) in names.into_iter().zip(details) {
            object.extend(value.map(|value| (name.to_owned(), json!(value))));
        }
    }
    object
}

/// File, place, expected, found and the format's issue.
fn details(cause: &(dyn Error + 'static)) -> Option<[Option<String>; 5]> {
    let of = |file: Option<String>, objection: &Objection| {
        let Objection {
            place,
            expected,
            found,
        } = objection.clone();
        Some([file, Some(place), Some(expected), Some(found), None])
    };
    let of_file = |error: &error::Error| {
        let mut details = of(Some(lossy(&error.file)), &error.objection)?;
        details[4] = error.issue.map(|issue| format!("{issue:?}"));
        Some(details)
    };
    if let Some(error) = cause.downcast_ref() {
        return of_file(error);
    }
    if let Some(OutputError::Unwritable(error) | OutputError::Input(error)) = cause.downcast_ref() {
        return of_file(error);
    }
    if let Some(objection) = cause.downcast_ref() {
        return of(None, objection);
    }
    if let Some(Usage(objection)) = cause.downcast_ref() {
        return of(None, objection);
    }
    if let Some(scene::Error::Options(objection)) = cause.downcast_ref() {
        return of(None, objection);
    }
    if let Some(environment::Error::Options(objection)) = cause.downcast_ref() {
        return of(None, objection);
    }
    match cause.downcast_ref::<format::Error>()? {
        format::Error::Io { path, .. } => Some([Some(path.clone()), None, None, None, None]),
        format::Error::Invalid {
            issue,
            place,
            expected,
            found,
        } => {
            let issue = format!("{issue:?}");
            Some([
                None,
                Some(place.clone()),
                Some(expected.clone()),
                Some(found.clone()),
                Some(issue),
            ])
        }
    }
}

/// What a command line that does not parse comes to as JSON.
pub fn usage_object(message: &str) -> String {
    let object = json!({
        "schema_version": SCHEMA,
        "command": null,
        "type": "error",
        "warnings": [],
        "error": { "kind": "usage", "exit_code": 2, "message": message.trim_end() },
    });
    format!("{object}\n")
}
