//! Files over HTTP, for browsers on this machine alone.

use std::io::{BufRead as _, BufReader, Error, ErrorKind, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Component, Path, PathBuf};
use std::time::Duration;

/// Most bytes that a page may post.
const MOST_POSTED: usize = 64 << 20;
/// Most bytes of a request's first line and headers.
const MOST_HEAD: u64 = 64 << 10;
/// How long a browser may take to say something.
const PATIENCE: Duration = Duration::from_secs(10);

/// Answers one request with the file of that name in the first of the folders that has it,
/// `index.html` where none is named. Returns what was posted, if anything was.
pub fn answer(stream: TcpStream, folders: &[&Path]) -> std::io::Result<Option<Vec<u8>>> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut reader = BufReader::new(stream);
    let mut head = (&mut reader).take(MOST_HEAD);
    let mut request = String::new();
    head.read_line(&mut request)?;
    let mut length = 0;
    loop {
        let mut line = String::new();
        head.read_line(&mut line)?;
        let line = line.trim().to_ascii_lowercase();
        if line.is_empty() {
            break;
        }
        if let Some(value) = line.strip_prefix("content-length:") {
            length = value.trim().parse().unwrap_or(0);
        }
    }
    let mut words = request.split_whitespace();
    let (method, address) = (words.next().unwrap_or(""), words.next().unwrap_or("/"));
    if method == "POST" {
        if length > MOST_POSTED {
            return Err(Error::new(ErrorKind::InvalidData, "too much was posted"));
        }
        let mut posted = vec![0; length];
        reader.read_exact(&mut posted)?;
        respond(reader.into_inner(), "200 OK", "text/plain", b"")?;
        return Ok(Some(posted));
    }
    let found = inside(address)
        .and_then(|file| (folders.iter()).find_map(|folder| read(&folder.join(&file))));
    let stream = reader.into_inner();
    match found {
        Some((kind, bytes)) => respond(stream, "200 OK", kind, &bytes)?,
        None => respond(stream, "404 Not Found", "text/plain", b"no such file")?,
    }
    Ok(None)
}

/// The file that an address names, below some folder; `None` of addresses that lead out of it.
fn inside(address: &str) -> Option<PathBuf> {
    let path = address.split(['?', '#']).next()?.trim_start_matches('/');
    let path = if path.is_empty() { "index.html" } else { path };
    let path = PathBuf::from(path);
    let is_plain = |part| matches!(part, Component::Normal(_));
    path.components().all(is_plain).then_some(path)
}

fn read(file: &Path) -> Option<(&'static str, Vec<u8>)> {
    let kind = match file.extension()?.to_str()? {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        // Or browsers refuse to compile while it arrives.
        "wasm" => "application/wasm",
        "png" => "image/png",
        _ => "application/octet-stream",
    };
    Some((kind, std::fs::read(file).ok()?))
}

fn respond(mut stream: TcpStream, status: &str, kind: &str, body: &[u8]) -> std::io::Result<()> {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\n\
         Cache-Control: no-store\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_stay_inside() {
        assert_eq!(inside("/"), Some("index.html".into()));
        assert_eq!(inside("/a/b.js?c=../d"), Some("a/b.js".into()));
        for address in ["/../secret", "/a/../../b", "//../x", "/.."] {
            assert_eq!(inside(address), None, "{address}");
        }
    }
}
