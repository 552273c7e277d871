//! What only a browser can say: whether its compiler takes the shaders, and what it draws.

use std::io::ErrorKind;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use glam::Vec3;
use libtest_mimic::Trial;
use relight_format::{Limits, read_environment, read_scene};
use relight_lab::demo;
use relight_runtime::{EnvironmentLight, Frame, Image, LocalLight, Method, twin};
use relight_shading::wgsl::{Entry, source};

use relight_viewer::state::Document;
use relight_xtask::server;

use crate::support::{Outcome, with_browser, with_page};

/// How long a page may take: the machine may be busy.
const PATIENCE: Duration = Duration::from_mins(8);

pub fn trials() -> Vec<Trial> {
    vec![
        with_browser("browser::its_compiler_takes_every_shader", shaders),
        with_page("browser::the_page_draws_what_the_twin_draws", picture),
        with_page("browser::the_page_answers_hands_and_bad_files", hands),
        with_page("browser::the_application_is_the_programs", application),
        with_page("browser::modules_are_small", sizes),
        with_page("browser::without_webgpu_there_are_words", words),
    ]
}

/// Of a picture by SwiftShader from the twin's, over the brightest value. Its samplers round weights to 8 bits, of
/// images of 32 texels per side as drafts have them; pixels that take what they see from others may then do so a little
/// less, more where they are few.
const MOST_APART: f32 = 3e-4;
const MOST_APART_OF_FEW: f32 = 2e-3;
/// Part of the pixels that may see another triangle, or just not the same light.
const MOST_ON_EDGES: f64 = 0.01;

/// Makes every module and tells what the compiler says of it. The sources lie in elements that are
/// no scripts, so that nothing in them is read as a page or as JavaScript.
const PAGE: &str = r#"<!doctype html><meta charset="utf-8"><body>
<script>
let lines = "";
const told = (name, text) => { lines += `${name}: ${text}\n`; };
(async () => {
  const adapter = await navigator.gpu?.requestAdapter();
  if (!adapter) { told("adapter", "none"); return; }
  const device = await adapter.requestDevice();
  const all = [...document.querySelectorAll("script[type=wgsl]")];
  for (const { id, textContent } of all) {
    device.pushErrorScope("validation");
    const module = device.createShaderModule({ code: textContent });
    const { messages } = await module.getCompilationInfo();
    const errors = messages.filter(({ type }) => type === "error");
    await device.popErrorScope();
    const words = errors.map(({ lineNum, message }) => `line ${lineNum}: ${message}`);
    told(id, words.length ? words.join("; ") : "accepted");
  }
})().catch(error => told("failed", error))
  .finally(() => fetch("told", { method: "POST", body: lines }));
</script>
"#;

fn shaders(browser: &str) -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut page = String::new();
    for &entry in Entry::ALL {
        page += &format!(
            "<script type=wgsl id={entry:?}>{}</script>\n",
            source(entry)
        );
    }
    // One that must be refused: a browser that takes everything says nothing.
    page += "<script type=wgsl id=Broken>fn f(a: u32) -> u32 { return a >> 9u & 511u; }</script>\n";
    page += PAGE;
    std::fs::write(folder.path().join("index.html"), page)?;
    let told = visit(browser, &[folder.path()])?;
    let told = String::from_utf8_lossy(&told);
    for &entry in Entry::ALL {
        assert!(
            told.contains(&format!("{entry:?}: accepted")),
            "{entry:?}: {told}"
        );
    }
    assert!(told.contains("Broken: line"), "{told}");
    Ok(())
}

/// Opens a folder's `index.html` in the browser, which draws by SwiftShader, and returns what it
/// posts. The first folder is also for what the browser keeps.
fn visit(browser: &str, folders: &[&Path]) -> Result<Vec<u8>, libtest_mimic::Failed> {
    visit_at(browser, folders, 1.0)
}

/// The same with so many pixels of the screen for one of the page.
fn visit_at(
    browser: &str,
    folders: &[&Path],
    scale: f32,
) -> Result<Vec<u8>, libtest_mimic::Failed> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    listener.set_nonblocking(true)?;
    let mut process = Command::new(browser)
        .args([
            "--headless=new",
            "--no-sandbox",
            "--disable-dev-shm-usage",
            "--enable-unsafe-webgpu",
            "--use-webgpu-adapter=swiftshader",
            // Or canvases have nowhere to go, and take the device with them.
            "--enable-features=Vulkan",
            "--use-vulkan=swiftshader",
            "--use-angle=swiftshader",
            "--disable-vulkan-surface",
            "--enable-unsafe-swiftshader",
        ])
        .arg(format!(
            "--user-data-dir={}",
            folders[0].join("profile").display()
        ))
        .arg(format!("--force-device-scale-factor={scale}"))
        .arg(format!("http://{}/", listener.local_addr()?))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()?;
    let start = Instant::now();
    let mut told = None;
    while told.is_none() && start.elapsed() < PATIENCE {
        match listener.accept() {
            // Browsers hang up on connections that they opened for nothing.
            Ok((stream, _)) => told = server::answer(stream, folders).unwrap_or_default(),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                std::thread::sleep(Duration::from_millis(20));
            }
            Err(error) => return Err(error.into()),
        }
    }
    // It is ours and has to go, whatever came.
    let _ = process.kill();
    let _ = process.wait();
    told.ok_or_else(|| "the page told nothing".into())
}

/// Shows a scene by the module that the page is made of, and posts the picture's radiance.
const PICTURE: &str = r#"<!doctype html><meta charset="utf-8"><canvas></canvas>
<script type="module">
const told = (body) => fetch("told", { method: "POST", body });
let errors = "";
console.error = (text) => { errors += `${text}\n`; };
try {
  const { default: init, Stage } = await import("./relight_embed.js");
  await init();
  const stage = await Stage.open(document.querySelector("canvas"));
  for (const name of ["light.relight", "scene.relight"]) {
    const response = await fetch(name);
    stage.load(new Uint8Array(await response.arrayBuffer()));
  }
  let refused = false;
  try { stage.load(new Uint8Array([1, 2, 3])); } catch { refused = true; }
  if (!refused) throw new Error("three bytes are no asset");
  stage.turn_light(0.5, 0);
  for (let row = 0; row < 72; row += 16) {
    stage.draw_rows(96, 72, row, 16);
    await stage.finished();
  }
  stage.present();
  await told(await stage.pixels());
} catch (error) {
  await told(`failed: ${error.message ?? error} ${errors}`);
}
</script>
"#;

/// The embedded page's module draws what the twin draws.
fn picture(browser: &str) -> Outcome {
    let built = built_page();
    let folder = folder_with(PICTURE)?;
    let (scene, environment) = crate::viewer::prepared_assets();
    let told = visit(browser, &[folder.path(), &built])?;
    let [width, height] = [96, 72];
    assert!(
        told.len() == 16 * width as usize * height as usize,
        "{}",
        String::from_utf8_lossy(&told[..told.len().min(1000)])
    );
    let pixels: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&told);
    let light = EnvironmentLight::new(&environment);
    let frame = Frame {
        rotation: glam::Quat::from_rotation_y(0.5),
        ..Frame::under(scene.camera.ok_or("a camera")?, &light)
    };
    let expected = twin::render(&scene, &frame, width, height)?;
    assert_same(&pixels, &expected, MOST_ON_EDGES, MOST_APART);
    Ok(())
}

/// That a browser's picture is the twin's, but for a part of the pixels.
fn assert_same(pixels: &[[f32; 4]], expected: &Image, on_edges: f64, most_apart: f32) {
    assert_eq!(pixels.len(), expected.pixels.len());
    let brightest = (expected.pixels.iter().flatten()).fold(0f32, |most, value| most.max(*value));
    let apart = |(found, expected): (&[f32; 4], &[f32; 4])| {
        (found.iter().zip(expected)).fold(0f32, |most, (a, b)| most.max((a - b).abs())) / brightest
    };
    let mut differences: Vec<f32> = pixels.iter().zip(&expected.pixels).map(apart).collect();
    differences.sort_by(f32::total_cmp);
    let covered = (expected.pixels.iter().filter(|pixel| pixel[3] > 0.5)).count();
    assert!(4 * covered > pixels.len(), "{covered} pixels of something");
    // On edges another triangle may be seen.
    let edges = (differences.len() as f64 * on_edges) as usize;
    let most = differences[differences.len() - 1 - edges];
    assert!(
        most < most_apart,
        "{most}; {:?}",
        &differences[differences.len().saturating_sub(80)..]
    );
}

fn built_page() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../out/web")
}

/// A page, and a scene and its light beside it.
fn folder_with(page: &str) -> Result<tempfile::TempDir, libtest_mimic::Failed> {
    let folder = tempfile::tempdir()?;
    std::fs::write(folder.path().join("index.html"), page)?;
    let (scene, environment) = crate::viewer::prepared_assets();
    let files = [
        ("scene.relight", relight_format::write_scene(&scene)?),
        (
            "light.relight",
            relight_format::write_environment(&environment)?,
        ),
    ];
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes)?;
    }
    Ok(folder)
}

/// The embedded page itself, in a frame: waits for its picture, drags, drops a broken file and one
/// that is no asset, and tells what it answered.
const HANDS: &str = r#"<!doctype html><meta charset="utf-8">
<iframe src="embed.html?scene=scene.relight&environment=light.relight&scale=0.1"
  style="width:400px;height:300px;border:0"></iframe>
<script type="module">
const told = (body) => fetch("told", { method: "POST", body });
const frame = document.querySelector("iframe");
const inside = () => frame.contentDocument;
const notice = () => inside()?.getElementById("notice")?.textContent ?? "";
const until = async (what, holds) => {
  const start = performance.now();
  while (!holds()) {
    if (performance.now() - start > 200000) throw new Error(`${what}: "${notice()}"`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
};
const answers = () => frame.contentWindow.relight?.answers ?? [];
const width = () => inside().querySelector("canvas").width;
try {
  await until("the best picture", () => answers().length > 0 && width() >= 40);
  const before = answers().length;
  const canvas = inside().querySelector("canvas");
  // Synthetic pointers cannot be captured.
  canvas.setPointerCapture = () => {};
  const { PointerEvent, File, DataTransfer, DragEvent } = frame.contentWindow;
  const pointer = (type, clientX) => canvas.dispatchEvent(
    new PointerEvent(type, { pointerId: 1, clientX, clientY: 100, buttons: 1, bubbles: true }));
  pointer("pointerdown", 100);
  pointer("pointermove", 160);
  pointer("pointerup", 160);
  await until("an answer to a drag", () => answers().length > before);
  const drop = (name) => {
    const dataTransfer = new DataTransfer();
    dataTransfer.items.add(new File([new Uint8Array([82, 69, 76])], name));
    frame.contentWindow.dispatchEvent(new DragEvent("drop", { dataTransfer, bubbles: true }));
  };
  drop("broken.relight");
  await until("words about a broken file", () => notice().includes("broken.relight"));
  drop("picture.hdr");
  await until("words about an image", () => notice().includes("bake environment"));
  await told(`answers: ${answers().map(({ time }) => Math.round(time))}`);
} catch (error) {
  await told(`failed: ${error.message ?? error}`);
}
</script>
"#;

fn hands(browser: &str) -> Outcome {
    let folder = folder_with(HANDS)?;
    let told = visit(browser, &[folder.path(), &built_page()])?;
    let told = String::from_utf8_lossy(&told);
    assert!(told.starts_with("answers: "), "{told}");
    println!("{told} ms");
    Ok(())
}

/// Bytes of all modules of a page, as they are without compression, and what they may compress to.
const MOST_BYTES: [(&str, usize); 2] = [
    ("relight_viewer_bg.wasm", 3_000_000),
    ("relight_embed_bg.wasm", 600_000),
];

fn sizes(_browser: &str) -> Outcome {
    for (name, most) in MOST_BYTES {
        let file = built_page().join(name);
        let output = Command::new("gzip").arg("-9c").arg(&file).output()?;
        assert!(output.status.success(), "{output:?}");
        println!("{name}: {} bytes by gzip", output.stdout.len());
        assert!(
            output.stdout.len() <= most,
            "{name}: {}",
            output.stdout.len()
        );
    }
    Ok(())
}

/// The application in a frame of a browser without WebGPU: tells the words that it shows.
const NOTHING: &str = r#"<!doctype html><meta charset="utf-8">
<iframe src="app.html" width="400" height="300"></iframe>
<script>
const look = () => {
  const words = document.querySelector("iframe").contentDocument?.getElementById("notice")?.textContent ?? "";
  if (words.includes("WebGPU")) fetch("told", { method: "POST", body: words });
  else setTimeout(look, 50);
};
look();
</script>
"#;

fn words(browser: &str) -> Outcome {
    let folder = folder_with(NOTHING)?;
    let page = std::fs::read_to_string(built_page().join("index.html"))?;
    let hide = "<script>Object.defineProperty(Navigator.prototype, \"gpu\", { get: () => undefined });\
                </script>";
    std::fs::write(folder.path().join("app.html"), format!("{hide}{page}"))?;
    let told = visit(browser, &[folder.path(), &built_page()])?;
    let told = String::from_utf8_lossy(&told);
    assert!(told.contains("which this browser does not have"), "{told}");
    Ok(())
}

/// The application in a frame, driven as a person would: an image is dropped and fitted, a surface
/// clicked, its reflection made another one, the window split, the picture saved. Posts what it tells
/// of itself, the scene and the light as they are then, both pictures, the screen, what was saved and a
/// picture of the window, each after its length.
const APPLICATION: &str = r#"<!doctype html><meta charset="utf-8">
<body style="margin:0"><script>
localStorage.setItem("relight.viewer", JSON.stringify({ resolution: 0.12, lobes: 12, background: "Off" }));
</script>
<iframe src="app.html" width="760" height="640" style="border:0"></iframe>
<script type="module">
const told = (body) => fetch("told", { method: "POST", body });
const frame = document.querySelector("iframe");
const view = frame.contentWindow;
let page;
let errors = "";
const steps = [];
const sleep = (time) => new Promise((resolve) => setTimeout(resolve, time));
const state = () => JSON.parse(page?.state() ?? "{}");
const until = async (what, holds) => {
  const start = performance.now();
  while (!holds()) {
    if (performance.now() - start > 150000) {
      const notice = frame.contentDocument.getElementById("notice")?.textContent;
      throw new Error(`${what}: "${notice}" ${JSON.stringify(state())}`);
    }
    await sleep(50);
  }
  steps.push([what, Math.round(performance.now() - start)]);
};
const canvas = () => frame.contentDocument.querySelector("canvas");
const pointer = (type, x, y, buttons) => {
  const Kind = type.startsWith("pointer") ? view.PointerEvent : view.MouseEvent;
  canvas().dispatchEvent(new Kind(type, { clientX: x, clientY: y, button: 0, buttons, bubbles: true, cancelable: true }));
};
const press = async (x, y) => {
  pointer("mousemove", x, y, 0);
  await sleep(120);
  pointer("pointerdown", x, y, 1);
  await sleep(120);
  pointer("pointerup", x, y, 0);
  await sleep(250);
};
const press_widget = async (name) => {
  let found;
  page.find(name);
  await sleep(300);
  await until(`there is ${name}`, () => { found = page.find(name); return found; });
  const [left, top, right, bottom] = found;
  await press((left + right) / 2, (top + bottom) / 2);
};
try {
  view.addEventListener("error", (event) => { errors += `${event.message}\n`; });
  await until("the application starts", () => view.relight);
  page = view.relight;
  view.console.error = (...words) => { errors += `${words.join(" ")}\n`; };
  await until("the first picture", () => state().settled && state().scene);

  const bytes = await (await fetch("sky.exr")).arrayBuffer();
  const dataTransfer = new view.DataTransfer();
  dataTransfer.items.add(new view.File([bytes], "sky.exr"));
  canvas().dispatchEvent(new view.DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
  await until("the job begins", () => state().jobs?.length);
  // The page lives on while the worker fits.
  let frames = 0;
  const count = () => { frames += 1; view.requestAnimationFrame(count); };
  view.requestAnimationFrame(count);
  await until("the image is fitted", () => state().light === "sky.exr" && !state().jobs.length);
  const alive = frames;
  await until("its picture", () => state().settled);

  // Room for the material's section.
  for (const section of ["Scene", "Environment", "Method", "Picture"]) await press_widget(section);
  await press_widget("Lights in the scene");
  await press_widget("Add");
  await until("a light", () => state().lights?.length);
  const placed = state().lights[0].position;
  let handle;
  page.find("handle of light 1");
  await until("its handle", () => { handle = page.find("handle of light 1"); return handle; });
  const [x, y] = [(handle[0] + handle[2]) / 2, (handle[1] + handle[3]) / 2];
  pointer("mousemove", x, y, 0);
  await sleep(120);
  pointer("pointerdown", x, y, 1);
  for (const step of [10, 20, 30]) {
    await sleep(120);
    pointer("mousemove", x + step, y + step, 1);
  }
  await sleep(120);
  pointer("pointerup", x + 30, y + 30, 0);
  await until("the light has moved", () => {
    const moved = state().lights[0].position;
    return Math.hypot(...moved.map((value, axis) => value - placed[axis])) > 0.01;
  });
  await press_widget("Lights in the scene");
  await until("the picture under it", () => state().settled);
  let found;
  page.find("picture of the scene");
  await until("the picture", () => { found = page.find("picture of the scene"); return found; });
  const [left, top, right, bottom] = found;
  await press((left + right) / 2, (top + bottom) / 2);
  await until("a surface is selected", () => state().selected !== null);
  await press_widget("reflection");
  await press_widget("Ward");
  await until("its picture again", () => state().settled);
  await press_widget("Split");
  await until("both pictures", () => state().settled && state().layout === "Split" && state().pictures.length === 2);

  let saved;
  const offer = view.URL.createObjectURL;
  view.URL.createObjectURL = (blob) => { saved = blob; return offer(blob); };
  await press_widget("File");
  await press_widget("Save picture…");
  await until("the picture is saved", () => saved);
  const picture = saved;
  saved = undefined;
  await press_widget("File");
  await press_widget("Save camera…");
  await until("the camera is saved", () => saved);
  const camera = await saved.text();

  page.capture();
  await until("a picture of the window", () => page.captured());

  // Files that are wrong are messages.
  const wrong = new view.DataTransfer();
  wrong.items.add(new view.File([new Uint8Array([82, 69, 76])], "broken.relight"));
  wrong.items.add(new view.File([new Uint8Array([35, 63])], "broken.hdr"));
  canvas().dispatchEvent(new view.DragEvent("drop", { dataTransfer: wrong, bubbles: true, cancelable: true }));
  await until("words about broken files", () =>
    ["broken.relight", "broken.hdr"].every((name) => state().messages.some((text) => text.includes(name))));

  const text = (value) => new TextEncoder().encode(JSON.stringify(value));
  const [scene, light] = page.assets();
  const parts = [
    text({ ...state(), alive, steps, errors, camera }), scene, light,
    new Uint8Array(page.radiance(0).buffer), new Uint8Array(page.radiance(1).buffer),
    page.screen(), new Uint8Array(await picture.arrayBuffer()), page.captured(),
  ];
  const lengths = new Uint32Array(parts.map((part) => part.length));
  await told(new Blob([lengths, ...parts]));
} catch (error) {
  await told(`failed: ${error.message ?? error} ${errors} ${JSON.stringify(steps)}`);
}
</script>
"#;

/// The page's pictures are the twin's, of the scene that hands made of it.
fn application(browser: &str) -> Outcome {
    let folder = folder_with(APPLICATION)?;
    std::fs::copy(
        built_page().join("index.html"),
        folder.path().join("app.html"),
    )?;
    // What a page shows of itself.
    for (from, to) in [("scene", "demo"), ("light", "demo-environment")] {
        let [from, to] = [from, to].map(|name| folder.path().join(format!("{name}.relight")));
        std::fs::rename(from, to)?;
    }
    let sky = demo::sky(64, 32);
    let mut image = relight_lab::image_file::Image::new(64, 32);
    for (pixel, [r, g, b]) in image.pixels.iter_mut().zip(&sky.pixels) {
        *pixel = [*r, *g, *b, 1.0];
    }
    relight_lab::image_file::write_exr(&folder.path().join("sky.exr"), &image)?;
    // At a scale of 1 this takes twice as long for pictures of the same size: SwiftShader draws the window's own widgets.
    let told = visit_at(browser, &[folder.path(), &built_page()], 0.5)?;
    let words = String::from_utf8_lossy(&told[..told.len().min(2000)]);
    assert!(!words.starts_with("failed"), "{words}");
    let (head, mut rest) = told.split_at(32);
    let lengths: Vec<u32> = bytemuck::pod_collect_to_vec(head);
    let mut parts = Vec::new();
    for length in lengths {
        let (part, behind) = rest.split_at(length as usize);
        (rest, parts) = (behind, [parts, vec![part]].concat());
    }
    let [state, scene, light, left, right, screen, saved, window] = parts[..] else {
        return Err("eight parts".into());
    };
    let state: serde_json::Value = serde_json::from_slice(state)?;
    println!("{state}");
    assert_eq!(state["errors"], "", "{state}");
    assert!(
        state["alive"].as_u64() > Some(5),
        "frames while a worker fits: {state}"
    );
    let saved = image::load_from_memory(saved)?.into_rgba8();
    let shown = image::load_from_memory(window)?.into_rgba8();
    assert_eq!((shown.width(), shown.height()), (380, 320));
    let colors: std::collections::HashSet<_> = shown.pixels().map(|pixel| pixel.0).collect();
    assert!(colors.len() > 200, "{} colours", colors.len());
    assert!(saved.as_raw() == screen, "what is saved is what is shown");
    if let Some(folder) = std::env::var_os("RELIGHT_VIEWER_PICTURES") {
        std::fs::write(Path::new(&folder).join("page.png"), window)?;
    }

    let before = crate::viewer::prepared_assets().0;
    let scene = read_scene(scene, &Limits::default())?;
    let selected = state["selected"].as_u64().ok_or("a selected surface")? as usize;
    assert!(format!("{:?}", scene.materials[selected]).contains("Ward"));
    assert!(scene.materials[selected] != before.materials[selected]);
    let light = read_environment(light, &Limits::default())?;
    assert_eq!(light.report.source, "sky.exr");
    assert_eq!(light.report.source_size, [64, 32]);
    assert!(!light.lobes.is_empty() && light.lobes.len() <= 12);
    let light = EnvironmentLight::new(&light);
    let camera = Document::new(before, None, None, Vec::new()).camera();
    let size = &state["pictures"][0]["size"];
    let [width, height] = [0, 1].map(|side| size[side].as_u64().unwrap_or(0) as u32);
    let file = folder.path().join("camera.toml");
    std::fs::write(&file, state["camera"].as_str().ok_or("a camera")?)?;
    assert_eq!(
        relight_lab::camera::load(&file)?.target,
        camera.camera().target
    );
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::NAN) as f32;
    let vector = |value: &serde_json::Value| Vec3::from([0, 1, 2].map(|axis| number(&value[axis])));
    let local = &state["lights"][0];
    let local_lights = vec![LocalLight {
        position: vector(&local["position"]),
        radius: number(&local["radius"]),
        radiance: vector(&local["radiance"]),
        spot: None,
    }];
    let polar = Frame {
        local_lights: &local_lights,
        ..Frame::under(camera.camera(), &light)
    };
    let ambient = Frame {
        method: Method::Ambient,
        ..polar.clone()
    };
    for (found, frame) in [(left, polar), (right, ambient)] {
        let found: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(found);
        let expected = twin::render(&scene, &frame, width, height)?;
        // Of 900 pixels most are near edges, and rays to sources just meet something or just do not.
        assert_same(&found, &expected, 4.0 * MOST_ON_EDGES, MOST_APART_OF_FEW);
    }
    Ok(())
}
