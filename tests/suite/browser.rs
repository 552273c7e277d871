//! What only a browser can say: whether its compiler takes the shaders.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use libtest_mimic::Trial;
use relight_shading::wgsl::{Entry, source};

use crate::support::{Outcome, with_browser};

/// How long a page may take: the machine may be busy.
const PATIENCE: Duration = Duration::from_mins(4);

pub fn trials() -> Vec<Trial> {
    vec![with_browser(
        "browser::its_compiler_takes_every_shader",
        shaders,
    )]
}

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
    let told = visit(browser, folder.path(), page.as_bytes())?;
    for entry in Entry::ALL {
        assert!(
            told.contains(&format!("{entry:?}: accepted")),
            "{entry:?}: {told}"
        );
    }
    assert!(told.contains("Broken: line"), "{told}");
    Ok(())
}

/// Opens a page in the browser, which draws by SwiftShader, and returns what it posts. The folder
/// is for what the browser keeps.
fn visit(browser: &str, folder: &Path, page: &[u8]) -> Result<String, libtest_mimic::Failed> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    listener.set_nonblocking(true)?;
    let mut process = Command::new(browser)
        .args([
            "--headless=new",
            "--no-sandbox",
            "--disable-dev-shm-usage",
            "--enable-unsafe-webgpu",
            "--use-webgpu-adapter=swiftshader",
        ])
        .arg(format!(
            "--user-data-dir={}",
            folder.join("profile").display()
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
            Ok((stream, _)) => told = answer(stream, page).unwrap_or_default(),
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
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

/// The page to whoever asks for it; what was posted, if anything was.
fn answer(stream: TcpStream, page: &[u8]) -> std::io::Result<Option<String>> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    let mut stream = BufReader::new(stream);
    let mut request = String::new();
    stream.read_line(&mut request)?;
    let mut length = 0;
    loop {
        let mut line = String::new();
        stream.read_line(&mut line)?;
        let line = line.trim().to_ascii_lowercase();
        if line.is_empty() {
            break;
        }
        if let Some(value) = line.strip_prefix("content-length:") {
            length = value.trim().parse().unwrap_or(0);
        }
    }
    let mut told = None;
    let mut body = page;
    if request.starts_with("POST") {
        let mut bytes = vec![0; length];
        stream.read_exact(&mut bytes)?;
        told = Some(String::from_utf8_lossy(&bytes).into_owned());
        body = b"";
    } else if !request.starts_with("GET / ") {
        body = b"";
    }
    let head = format!(
        "HTTP/1.1 200 OK\r\nContent-Type: text/html; charset=utf-8\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    let mut stream = stream.into_inner();
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)?;
    Ok(told)
}
