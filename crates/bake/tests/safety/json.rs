//! Everything that `--json` prints is what `bake.schema.json` says, and nothing more.

use std::collections::BTreeSet;

use libtest_mimic::{Failed, Trial};
use serde_json::Value;

use crate::{
    BAD_INPUT, Folder, INPUT_OUTPUT, Outcome, USAGE, bake_environment, bake_material, bake_scene,
    expect, expect_success, grey_hdr, program,
};

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::test("json::results", results),
        Trial::test("json::errors", errors),
        Trial::test("json::progress", progress),
        Trial::test("json::checker", checker),
    ]
}

/// The keywords of JSON Schema (2020-12) that the file uses; any other fails the check, as it
/// would pass unseen.
struct Schema(Value);

impl Schema {
    fn load() -> Self {
        let text = include_str!("../../bake.schema.json");
        Self(serde_json::from_str(text).expect("the schema is JSON"))
    }

    /// The names of the fields that are described, or why the value is wrong.
    fn check(&self, schema: &Value, value: &Value) -> Result<BTreeSet<String>, String> {
        let mut described = BTreeSet::new();
        let Value::Object(keywords) = schema else {
            return if *schema == Value::Bool(true) {
                Ok(described)
            } else {
                Err(format!("{value} where nothing may be"))
            };
        };
        let wrong = |what: &str| Err(format!("{value}: {what}"));
        for (keyword, rule) in keywords {
            let list = || rule.as_array().into_iter().flatten();
            let number = rule.as_f64().unwrap_or(0.0);
            match keyword.as_str() {
                "type" => {
                    let is = |kind: &Value| match kind.as_str() {
                        Some("object") => value.is_object(),
                        Some("array") => value.is_array(),
                        Some("string") => value.is_string(),
                        Some("number") => value.is_number(),
                        Some("integer") => value.is_i64() || value.is_u64(),
                        Some("null") => value.is_null(),
                        _ => false,
                    };
                    if !(is(rule) || list().any(is)) {
                        return wrong(&format!("not of type {rule}"));
                    }
                }
                "const" if value != rule => return wrong(&format!("not {rule}")),
                "enum" if !list().any(|one| one == value) => {
                    return wrong(&format!("not one of {rule}"));
                }
                "minimum" if value.as_f64().is_some_and(|value| value < number) => {
                    return wrong(&format!("less than {rule}"));
                }
                "maximum" if value.as_f64().is_some_and(|value| value > number) => {
                    return wrong(&format!("more than {rule}"));
                }
                "const" | "enum" | "minimum" | "maximum" | "$schema" | "$id" | "title"
                | "description" | "$defs" => {}
                "minItems" | "maxItems" => {
                    let count = value.as_array().map_or(number, |list| list.len() as f64);
                    if (keyword == "minItems" && count < number)
                        || (keyword == "maxItems" && count > number)
                    {
                        return wrong("not so many");
                    }
                }
                "items" => {
                    for item in value.as_array().into_iter().flatten() {
                        self.check(rule, item)?;
                    }
                }
                "required" => {
                    if let Some(name) =
                        list().find(|name| value.get(name.as_str().unwrap_or("")).is_none())
                    {
                        return wrong(&format!("no {name}"));
                    }
                }
                "properties" => {
                    for (name, rule) in rule.as_object().expect("an object") {
                        if let Some(value) = value.get(name) {
                            self.check(rule, value)
                                .map_err(|why| format!("{name}: {why}"))?;
                            described.insert(name.clone());
                        }
                    }
                }
                "additionalProperties" => {
                    let known = keywords.get("properties").and_then(Value::as_object);
                    for (name, value) in value.as_object().into_iter().flatten() {
                        if known.is_none_or(|known| !known.contains_key(name)) {
                            self.check(rule, value)
                                .map_err(|why| format!("{name}: {why}"))?;
                        }
                    }
                }
                "$ref" => {
                    let pointer = rule.as_str().and_then(|path| path.strip_prefix('#'));
                    let schema = pointer.and_then(|pointer| self.0.pointer(pointer));
                    described.extend(self.check(schema.expect("a definition"), value)?);
                }
                "allOf" => {
                    for schema in list() {
                        described.extend(self.check(schema, value)?);
                    }
                }
                "oneOf" => {
                    let tried: Vec<_> = list().map(|schema| self.check(schema, value)).collect();
                    let mut fit = tried.iter().flatten();
                    match (fit.next(), fit.next()) {
                        (Some(names), None) => described.extend(names.clone()),
                        (Some(_), Some(_)) => return wrong("fits twice"),
                        (None, _) => return wrong(&format!("fits nothing: {tried:#?}")),
                    }
                }
                other => panic!("this check does not know the keyword {other}"),
            }
        }
        Ok(described)
    }

    /// Checks a line that was printed, every field of which must be described.
    fn accept(&self, line: &str) -> Result<Value, Failed> {
        let value: Value = serde_json::from_str(line)?;
        let described = self.check(&self.0, &value)?;
        for name in value.as_object().expect("an object").keys() {
            if !described.contains(name) {
                return Err(format!("{name} is in no schema: {line}").into());
            }
        }
        Ok(value)
    }
}

fn line(output: &std::process::Output) -> Result<String, Failed> {
    let text = String::from_utf8(output.stdout.clone())?;
    assert_eq!(text.lines().count(), 1, "{text}");
    Ok(text)
}

fn results() -> Outcome {
    let schema = Schema::load();
    let folder = Folder::new()?;
    let (mesh, asset, part) = (
        folder.at("a.obj"),
        folder.at("a.relight"),
        folder.at("1.part"),
    );
    let sky = folder.write("sky.hdr", grey_hdr(16, 8))?;
    let paint = folder.write("paint.toml", "model = 'diffuse'\ndiffuse = 0.5\n")?;
    let mut merge = program();
    merge.arg("merge").arg(&part).arg("-o").arg(&asset);
    let commands = [
        bake_environment(&sky, &asset, 2),
        bake_material(&paint, &asset),
        bake_scene(&mesh, &asset),
        {
            let mut verified = bake_scene(&mesh, &asset);
            verified.arg("--verify-visibility");
            verified
        },
        {
            let mut shard = bake_scene(&mesh, &part);
            shard.args(["--shard", "1/1"]);
            shard
        },
        merge,
    ];
    for mut command in commands {
        let output = expect_success(command.arg("--json"));
        let result = schema.accept(&line(&output)?)?;
        assert_eq!(result["type"], "result");
        if !asset.exists() {
            continue;
        }
        // What each asset holds is told by its kind; those fields are not part of the schema.
        let inspected = expect_success(program().arg("inspect").arg(&asset).arg("--json"));
        let inspected: Value = serde_json::from_str(&line(&inspected)?)?;
        schema.check(&schema.0, &inspected)?;
        let validated = expect_success(program().arg("validate").arg(&asset).arg("--json"));
        schema.accept(&line(&validated)?)?;
    }
    Ok(())
}

fn errors() -> Outcome {
    let schema = Schema::load();
    let folder = Folder::new()?;
    let asset = folder.at("a.relight");
    let broken = folder.write("broken.obj", "v 0 0 0\nf 1 2 9\n")?;
    let damaged = folder.write("damaged.relight", "no asset at all, but long enough")?;
    let check = |code: i32, command: &mut std::process::Command| -> Result<Value, Failed> {
        let output = expect(code, command.arg("--json"));
        let mut error = schema.accept(&line(&output)?)?;
        assert_eq!(error["type"], "error");
        let errors = String::from_utf8(output.stderr)?;
        let error = error["error"].take();
        assert_eq!(error["exit_code"], code);
        let message = error["message"]
            .as_str()
            .expect("text")
            .trim_start_matches("error: ");
        assert!(
            errors.contains(message),
            "{errors} does not contain {message}"
        );
        Ok(error)
    };
    let error = check(BAD_INPUT, &mut bake_scene(&broken, &asset))?;
    assert_eq!(
        (&error["kind"], &error["place"]),
        (&"invalid_input".into(), &"line 2".into())
    );
    assert!(
        error["file"]
            .as_str()
            .is_some_and(|file| file.ends_with("broken.obj")),
        "{error}"
    );
    let missing = folder.at("missing.obj");
    let error = check(INPUT_OUTPUT, &mut bake_scene(&missing, &asset))?;
    assert_eq!(error["kind"], "input_output");
    assert!(
        error["file"]
            .as_str()
            .is_some_and(|file| file.ends_with("missing.obj")),
        "{error}"
    );
    let error = check(BAD_INPUT, program().arg("validate").arg(&damaged))?;
    assert_eq!(error["issue"], "BadMagic");
    let error = check(USAGE, bake_scene(&broken, &asset).args(["--rank", "2"]))?;
    assert_eq!(
        (&error["kind"], &error["place"]),
        (&"usage".into(), &"--rank".into())
    );
    check(USAGE, bake_scene(&broken, &asset).arg("--no-such-option"))?;
    check(USAGE, &mut program())?;
    Ok(())
}

fn progress() -> Outcome {
    let schema = Schema::load();
    let folder = Folder::new()?;
    let mut bake = bake_scene(&folder.at("a.obj"), &folder.at("a.relight"));
    let output = expect_success(bake.arg("--json-progress"));
    let text = String::from_utf8(output.stdout)?;
    let objects: Result<Vec<Value>, Failed> =
        text.lines().map(|line| schema.accept(line)).collect();
    let objects = objects?;
    let (last, before) = objects.split_last().ok_or("nothing was printed")?;
    assert_eq!(last["type"], "result");
    assert!(before.len() >= 3, "{text}");
    assert!(
        before.iter().all(|object| object["type"] == "progress"),
        "{text}"
    );
    Ok(())
}

/// The check itself must refuse what is wrong.
fn checker() -> Outcome {
    let schema = Schema::load();
    let good = r#"{"schema_version":1,"command":"validate","type":"result","warnings":[],"file":"a","valid":true}"#;
    schema.accept(good)?;
    for (from, to) in [
        (r#""schema_version":1"#, r#""schema_version":2"#),
        (r#""warnings":[]"#, r#""warnings":[1]"#),
        (r#""file":"a","#, ""),
        (r#""valid":true"#, r#""valid":false"#),
        (r#""valid":true"#, r#""valid":true,"novel":1"#),
        (r#""validate""#, r#""boil""#),
        (r#""result""#, r#""error""#),
    ] {
        let line = good.replace(from, to);
        assert_ne!(line, good);
        assert!(schema.accept(&line).is_err(), "{line}");
    }
    Ok(())
}
