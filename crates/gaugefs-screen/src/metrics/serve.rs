// SPDX-License-Identifier: MIT

//! A page over HTTP at `/metrics`, and one at `/` that leads there.
//!
//! It answers GET and HEAD and closes the connection: Prometheus needs no more. A client's requests are limited in time
//! and size, and so is the number of clients.

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{self, ExitCode};
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use nix::sys::signal::SigSet;

use super::{MOST, Prometheus, Reader};
use gauge_bus::clock::{Clock, RealClock};
use gaugefs_host::error::{Error, Result};
use gaugefs_host::output::say;
use gaugefs_host::signals;

/// A client's time limit for a request, and for taking the answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest request with its headers.
const LONGEST: usize = 8192;
/// Pause after a failed connection.
const PAUSE: Duration = Duration::from_millis(100);

#[derive(Clone, Debug)]
pub(super) enum Address {
    Tcp(String),
    Unix(PathBuf),
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.strip_prefix("unix:") {
            Some("") => Err("expected a path after unix:".into()),
            Some(path) => Ok(Self::Unix(path.into())),
            None if text.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok()) => {
                Ok(Self::Tcp(text.into()))
            }
            None => {
                Err("expected HOST:PORT, such as 127.0.0.1:9947, :PORT for all interfaces, or unix:PATH"
                    .into())
            }
        }
    }
}

/// A connection whose calls have a time limit.
trait Connection: Read + Write {
    fn limit(&self, time: Duration) -> io::Result<()>;
}

impl Connection for TcpStream {
    fn limit(&self, time: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(time)).and_then(|()| self.set_write_timeout(Some(time)))
    }
}

impl Connection for UnixStream {
    fn limit(&self, time: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(time)).and_then(|()| self.set_write_timeout(Some(time)))
    }
}

/// The page at `/`.
const LANDING: &str =
    "<!DOCTYPE html>\n<title>gaugefs</title>\n<h1>gaugefs</h1>\n<p><a href=\"/metrics\">Metrics</a>\n";

/// Answers until the process ends.
pub(super) fn run(address: &Address, reader: &Arc<Reader>) -> Result<ExitCode> {
    let refused = |name: &str, error| Error::io(name, "cannot listen there", &error);
    match address {
        Address::Tcp(address) => {
            let listener = listen(address).map_err(|error| refused(address, error))?;
            // Port 0 is any that is free.
            let here = listener.local_addr();
            let is_open = here.as_ref().is_ok_and(|here| here.ip().is_unspecified());
            let here = here.map_or_else(|_| address.clone(), |here| here.to_string());
            let open = "; all interfaces of this machine, without a password; 127.0.0.1:PORT is for this machine alone";
            say(format_args!("http://{here}/metrics{}", if is_open { open } else { "" }));
            accept(|| listener.accept().map(|(client, _)| client), reader)
        }
        Address::Unix(path) => {
            let name = path.display().to_string();
            // Before another thread exists that could get the signal.
            let ends = signals::block()?;
            let listener = bind(path).map_err(|error| refused(&name, error))?;
            let own = fs::symlink_metadata(path).map_err(|error| refused(&name, error))?;
            remove_at_end(ends, path.clone(), own)?;
            accept(|| listener.accept().map(|(client, _)| client), reader)
        }
    }
}

/// Without a host, on all interfaces: over IPv6, which includes IPv4, unless this machine lacks it.
fn listen(address: &str) -> io::Result<TcpListener> {
    match address.strip_prefix(':') {
        None => TcpListener::bind(address),
        Some(port) => {
            let bind = |host| TcpListener::bind(format!("{host}:{port}"));
            bind("[::]").or_else(|error| match error.kind() {
                ErrorKind::AddrInUse | ErrorKind::PermissionDenied => Err(error),
                _ => bind("0.0.0.0"),
            })
        }
    }
}

/// Ends the process after a signal, and removes its socket.
fn remove_at_end(ends: SigSet, path: PathBuf, own: fs::Metadata) -> Result<()> {
    let end = move || {
        // It cannot fail: the set is valid.
        let _ = ends.wait();
        // Another process may have one there by now.
        let is_own = |found: &fs::Metadata| (found.dev(), found.ino()) == (own.dev(), own.ino());
        if fs::symlink_metadata(&path).is_ok_and(|found| is_own(&found)) {
            let _ = fs::remove_file(&path);
        }
        process::exit(0);
    };
    let thread = std::thread::Builder::new().stack_size(256 * 1024).spawn(end);
    thread.map(drop).map_err(|error| Error::io("", "cannot start a thread", &error))
}

/// Replaces a socket without a listener.
fn bind(path: &Path) -> io::Result<UnixListener> {
    let bound = UnixListener::bind(path);
    let is_in_use = bound.as_ref().is_err_and(|error| error.kind() == ErrorKind::AddrInUse);
    let is_left = || {
        fs::symlink_metadata(path).is_ok_and(|status| status.file_type().is_socket())
            && UnixStream::connect(path).is_err_and(|error| error.kind() == ErrorKind::ConnectionRefused)
    };
    if is_in_use && is_left() {
        fs::remove_file(path)?;
        return UnixListener::bind(path);
    }
    bound
}

fn accept<C: Connection + Send + 'static>(
    next: impl Fn() -> io::Result<C>,
    reader: &Arc<Reader>,
) -> Result<ExitCode> {
    // Each client has a copy, and so has this loop.
    let clients = Arc::new(());
    loop {
        let mut client = match next() {
            Ok(client) if Arc::strong_count(&clients) <= MOST => client,
            Ok(_) => continue,
            Err(_) => {
                // A client that is gone already, or too many open files, which would fail again at once.
                RealClock::new().sleep(PAUSE);
                continue;
            }
        };
        let (reader, held) = (reader.clone(), clients.clone());
        let serve = move || {
            // A client that goes away gets no answer.
            let _ = answer(&mut client, &reader);
            drop(held);
        };
        if let Err(error) = std::thread::Builder::new().stack_size(256 * 1024).spawn(serve) {
            say(Error::io("", "cannot start a thread", &error));
        }
    }
}

fn answer(client: &mut impl Connection, reader: &Arc<Reader>) -> io::Result<()> {
    client.limit(PATIENCE)?;
    let Some(request) = request(client)? else {
        return respond(client, "400 Bad Request", "text/plain", "", "");
    };
    let mut words = request.lines().next().unwrap_or_default().split(' ');
    let (method, target) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let is_open = request.to_ascii_lowercase().contains("application/openmetrics-text");
    let (status, kind, body) = match (method, target.split('?').next().unwrap_or_default()) {
        ("GET" | "HEAD", "/metrics") if is_open => {
            let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
            ("200 OK", kind, reader.page(Prometheus::OpenMetrics))
        }
        ("GET" | "HEAD", "/metrics") => {
            ("200 OK", "text/plain; version=0.0.4; charset=utf-8", reader.page(Prometheus::Text))
        }
        ("GET" | "HEAD", "/") => ("200 OK", "text/html; charset=utf-8", LANDING.into()),
        ("GET" | "HEAD", _) => ("404 Not Found", "text/plain", "the metrics are at /metrics\n".into()),
        _ => ("405 Method Not Allowed\r\nAllow: GET, HEAD", "text/plain", String::new()),
    };
    respond(client, status, kind, &body, if method == "HEAD" { "" } else { &body })
}

/// The head of a request; `None` if it is too long, late or cut off.
fn request(client: &mut impl Connection) -> io::Result<Option<String>> {
    let (begun, mut head, mut bytes) = (Instant::now(), Vec::new(), [0; 1024]);
    while !head.windows(4).any(|end| end == b"\r\n\r\n") {
        let count = client.read(&mut bytes)?;
        head.extend_from_slice(&bytes[..count]);
        if count == 0 || head.len() > LONGEST || begun.elapsed() > PATIENCE {
            return Ok(None);
        }
    }
    Ok(Some(String::from_utf8_lossy(&head).into_owned()))
}

/// Answers with the head for the whole body, and the part of it that is sent.
fn respond(
    client: &mut impl Connection,
    status: &str,
    kind: &str,
    whole: &str,
    body: &str,
) -> io::Result<()> {
    let length = whole.len();
    write!(
        client,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    )?;
    client.flush()
}
