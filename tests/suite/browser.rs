//! What only a browser can say: whether its compiler takes the shaders, and what it draws.

use std::io::ErrorKind;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use libtest_mimic::Trial;
use relight_runtime::{EnvironmentLight, Frame, twin};
use relight_shading::wgsl::{Entry, source};

use relight_xtask::server;

use crate::support::{Outcome, with_browser, with_page};

/// How long a page may take: the machine may be busy.
const PATIENCE: Duration = Duration::from_mins(4);

pub fn trials() -> Vec<Trial> {
    vec![
        with_browser("browser::its_compiler_takes_every_shader", shaders),
        with_page("browser::the_page_draws_what_the_twin_draws", picture),
        with_page("browser::the_page_answers_hands_and_bad_files", hands),
    ]
}

/// Of a picture by SwiftShader from the twin's, over the brightest value: they round differently.
const MOST_APART: f32 = 1e-4;
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
    for entry in Entry::ALL {
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
    for entry in Entry::ALL {
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
  const { default: init, Stage } = await import("./relight.js");
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

/// The page's module draws what the twin draws.
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
    let brightest = (expected.pixels.iter().flatten()).fold(0f32, |most, value| most.max(*value));
    let apart = |(found, expected): (&[f32; 4], &[f32; 4])| {
        (found.iter().zip(expected)).fold(0f32, |most, (a, b)| most.max((a - b).abs())) / brightest
    };
    let mut differences: Vec<f32> = pixels.iter().zip(&expected.pixels).map(apart).collect();
    differences.sort_by(f32::total_cmp);
    let covered = expected
        .pixels
        .iter()
        .filter(|pixel| pixel[3] > 0.5)
        .count();
    assert!(covered > 2000, "{covered} pixels of something");
    // On edges another triangle may be seen.
    let edges = (differences.len() as f64 * MOST_ON_EDGES) as usize;
    let most = differences[differences.len() - 1 - edges];
    assert!(
        most < MOST_APART,
        "{most}; {:?}",
        &differences[differences.len() - 80..]
    );
    Ok(())
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
<iframe src="embed.html?scene=scene.relight&environment=light.relight&scale=0.2"
  style="width:400px;height:300px;border:0"></iframe>
<script type="module">
const told = (body) => fetch("told", { method: "POST", body });
const frame = document.querySelector("iframe");
const inside = () => frame.contentDocument;
const notice = () => inside()?.getElementById("notice")?.textContent ?? "";
const until = async (what, holds) => {
  const start = performance.now();
  while (!holds()) {
    if (performance.now() - start > 100000) throw new Error(`${what}: "${notice()}"`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
};
const answers = () => frame.contentWindow.relight?.answers ?? [];
const width = () => inside().querySelector("canvas").width;
try {
  await until("the best picture", () => answers().length > 0 && width() >= 80);
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
