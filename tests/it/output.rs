// SPDX-License-Identifier: MIT

//! What the program prints, and the files that it writes and reads, on a host that fails or is hostile.

use std::fs::{self, File, Permissions};
use std::io::Write;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::process::Stdio;
#[cfg(feature = "screen")]
use std::time::{Duration, Instant};

use nix::mount::{MntFlags, MsFlags, mount, umount2};
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;

use crate::drawn::one_in;
use crate::room::{CHIP, Folder, STATION, can_mount, command, command_of, gaugefs, run};

/// Each command, with arguments that make it print something, or `None` where it prints nothing, or only with hardware.
fn printing<'a>(
    name: &str,
    [gauge, file, config, station, keys, new_keys, log]: [&'a str; 7],
) -> Option<Vec<&'a str>> {
    Some(match name {
        // They print nothing to standard output.
        "umount" | "wait" | "events" | "attach" | "sim-inside" | "sim-end" | "detach" | "check-keys" => {
            return None;
        }
        // It serves on when it has printed its line; `bus.rs` has its test.
        "sim" => return None,
        // A gauge with RAM has something to tell, which is printed as what is to settle; `forgetful.rs` has its test.
        "learned" => return None,
        // They need a bus.
        "probe" | "rescue" => return None,
        // Its steps are printed as those of a calibration are.
        "bringup" | "calibrate board-offset" | "calibrate cc-offset" => return None,
        "calibrate voltage" | "calibrate current" | "calibrate temperature" => return None,
        "mount" => vec!["--check", "--config", config],
        "list" | "doctor" | "man" | "chips" | "help" => vec![],
        "program" => vec!["--check", "--image", file, "--station", station],
        "report" => vec!["--force", "-o", log, gauge],
        "export" | "names" | "metrics" | "settle" => vec![gauge],
        "get" => vec![gauge, "80/53"],
        "set" => vec!["--dry-run", gauge, "80/53=3105"],
        "import" => vec!["--dry-run", "--set", "80/53=3105", gauge, file],
        "diff" => vec!["--exclude", "learned", config, file],
        "check" | "lint" => vec![file],
        // An empty one.
        "records" => vec!["-"],
        "calibrate leave" => vec![],
        "auth" => vec!["--key-file", keys, gauge],
        "keys change" => vec!["--key-file", keys, "--new-key-file", new_keys, gauge, "unseal"],
        "completions" => vec!["bash"],
        "top" => vec!["--json", "--count", "1", gauge],
        "learn" => vec!["--once", gauge],
        "log" => vec!["--count", "1", gauge],
        "plot" => vec![log],
        "watch" => vec![gauge, "capacity<101"],
        _ => panic!("`gaugefs {name}` is new: add how it is made to print"),
    })
}

/// Both programs, and the definitions of their command lines.
fn programs() -> [(&'static str, clap::Command); 2] {
    [(env!("CARGO_BIN_EXE_gaugefs"), gaugefs::cli::definition()), (STATION, gaugefs::station::definition())]
}

/// Whether a program only says which other one, or which other build, has that command.
fn is_elsewhere(program: &str, name: &str) -> bool {
    let is_rescue = name == "rescue" && cfg!(not(feature = "rescue"));
    program != STATION && ["program", "records"].contains(&name) || is_rescue
}

/// The program that has a command.
fn program_with(name: &str) -> &'static str {
    if ["program", "records"].contains(&name) { STATION } else { env!("CARGO_BIN_EXE_gaugefs") }
}

/// The names of all commands that can be run, such as `keys change`.
fn commands(of: &clap::Command, head: &[&str]) -> Vec<String> {
    // What `help` lists are the other commands.
    let is_one = |command: &&clap::Command| {
        of.get_name() != "help" && (command.get_name() != "help" || head.is_empty())
    };
    let below = of.get_subcommands().filter(is_one);
    let below: Vec<_> =
        below.flat_map(|command| commands(command, &[head, &[command.get_name()]].concat())).collect();
    if below.is_empty() { vec![head.join(" ")] } else { below }
}

#[test]
fn regression_what_cannot_be_printed_is_a_failure_of_every_command() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, file, config, station, keys, new_keys, log] =
        ["m", "pack.toml", "mount.toml", "station.toml", "keys", "new-keys", "log.csv"]
            .map(|name| folder.file(name));
    let gauge = format!("{at}/BAT0");
    for (path, text) in [
        (&keys, "unseal = 0414 3672\nauthentication = 0123456789abcdeffedcba9876543210\n"),
        (&new_keys, "unseal = 6fa1 92d4\n"),
        (
            &station,
            "[station]\nexclude = [\"calibration\", \"keys\"]\n[[gauge]]\nname = \"BENCH\"\nsim = \"bq34z100-g1\"\n",
        ),
        (
            &config,
            &format!("[mount]\nmountpoint = '{}'\n[[gauge]]\nsim = \"bq34z100-g1\"\n", folder.file("n")),
        ),
    ] {
        fs::write(path, text).expect("a file");
        fs::set_permissions(path, Permissions::from_mode(0o600)).expect("its mode");
    }
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
    gaugefs(&["export", &gauge, "-o", &file]).done();
    let other = folder.file("other.toml");
    let text = fs::read_to_string(&file).expect("the export").replace("= 3000", "= 3001");
    fs::write(&other, text).expect("a file");
    gaugefs(&["log", "--count", "2", &gauge, "-o", &log]).done();
    let report = folder.file("report.txt");

    let full = |arguments: &[&str]| {
        let mut command = command_of(arguments[0], &arguments[1..]);
        command.stdout(File::options().write(true).open("/dev/full").expect("/dev/full"));
        run(command)
    };
    let closed = |arguments: &[&str]| {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let mut command = command_of(arguments[0], &arguments[1..]);
        command.stdout(Stdio::from(writer));
        run(command)
    };
    let mut lines: Vec<Vec<String>> = Vec::new();
    let all = programs().into_iter().flat_map(|(program, definition)| {
        let names = [vec!["--help".to_string(), "--version".into()], commands(&definition, &[])].concat();
        names.into_iter().map(move |name| (program, name))
    });
    for (program, name) in all {
        let words = || [program].into_iter().chain(name.split(' ')).map(str::to_string);
        if name.starts_with("--") {
            lines.push(words().collect());
            continue;
        }
        if is_elsewhere(program, &name) {
            continue;
        }
        if name != "help" {
            lines.push(words().chain(["--help".into()]).collect());
        }
        let files = [&*gauge, &*file, &*config, &*station, &*keys, &*new_keys, &*log];
        let Some(arguments) = printing(&name, files) else { continue };
        let mut line: Vec<String> = words().collect();
        if name == "calibrate leave" {
            line.insert(2, gauge.clone());
        }
        line.extend(arguments.into_iter().map(|word| match (&*name, word == config, word == log) {
            ("diff", true, _) => other.clone(),
            ("report", _, true) => report.clone(),
            _ => word.to_string(),
        }));
        lines.push(line);
    }
    for line in &lines {
        let line: Vec<&str> = line.iter().map(String::as_str).collect();
        let ran = full(&line);
        let is_comparison = ["auth", "diff"].contains(&line[1]) || line.contains(&"--dry-run");
        let expected = if is_comparison && !line.contains(&"--help") { 2 } else { 1 };
        assert_eq!(ran.code, Some(expected), "{line:?}: {}", ran.err);
        let says = "cannot write standard output: No space left on device\n";
        assert!(ran.err.ends_with(says), "{line:?}: {}", ran.err);
        // A reader that has seen enough is no failure.
        if ["chips", "lint", "log", "man", "top"].contains(&line[1]) {
            let ran = closed(&line);
            assert!(!ran.err.contains("standard output"), "{line:?}: {}", ran.err);
            assert!(!ran.err.contains("panicked"), "{line:?}: {}", ran.err);
        }
    }
    gaugefs(&["umount", &at]).done();
}

/// A file system of that many bytes; it needs root.
struct Tiny(String);

impl Tiny {
    fn new(folder: &Folder) -> Option<Self> {
        let path = folder.file("tiny");
        fs::create_dir(&path).expect("a folder");
        let none = MsFlags::empty();
        match mount(Some("none"), path.as_str(), Some("tmpfs"), none, Some("size=16k")) {
            Ok(()) => Some(Self(path)),
            Err(_) => {
                eprintln!("SKIPPED: only root can mount a file system that is full");
                None
            }
        }
    }

    fn file(&self, name: &str) -> String {
        format!("{}/{name}", self.0)
    }

    /// Leaves no room.
    fn fill(&self) {
        let mut file = File::create(self.file("rest")).expect("a file");
        while file.write_all(&[0; 512]).is_ok() {}
    }
}

impl Drop for Tiny {
    fn drop(&mut self) {
        let _ = umount2(self.0.as_str(), MntFlags::MNT_DETACH);
    }
}

/// The commands that write a file, with all but its name.
fn writers<'a>(gauge: &'a str, at: &'a str, history: &'a str) -> [(&'static str, Vec<&'a str>); 4] {
    [
        ("export", vec!["export", gauge, "-o"]),
        ("plot", vec!["plot", history, "-o"]),
        ("metrics", vec!["metrics", at, "-o"]),
        ("report", vec!["report", gauge, "--force", "-o"]),
    ]
}

#[test]
fn regression_an_output_replaces_a_file_as_a_whole_and_nothing_else() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, history] = ["m", "history.csv"].map(|name| folder.file(name));
    let gauge = format!("{at}/BAT0");
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
    gaugefs(&["log", "--count", "2", &gauge, "-o", &history]).done();
    let tiny = Tiny::new(&folder);
    let link = folder.file("link.svg");
    std::os::unix::fs::symlink(&history, &link).expect("a link");
    let before = fs::read(&history).expect("the history");
    for (name, words) in writers(&gauge, &at, &history) {
        let to = |file: &str| gaugefs(&[&words[..], &[file]].concat());
        let file = folder.file(&format!("{name}.svg"));
        fs::write(&file, "old").expect("a file");
        fs::set_permissions(&file, Permissions::from_mode(0o640)).expect("its mode");
        assert_eq!(to(&file).code, Some(0));
        assert_ne!(fs::read(&file).expect("the file"), b"old", "{name}");
        assert_eq!(fs::metadata(&file).expect("the file").permissions().mode() & 0o777, 0o640, "{name}");

        let refused = |file: &str, why: &str| {
            let ran = to(file);
            assert_eq!(ran.code, Some(1), "{name} {file}: {}", ran.err);
            assert!(ran.err.contains(why), "{name} {file}: {}", ran.err);
        };
        refused(&link, "symbolic link");
        assert!(fs::symlink_metadata(&link).expect("the link").is_symlink(), "{name}");
        assert_eq!(fs::read(&history).expect("the history"), before, "{name}");
        // An export to a folder is a file in it.
        if name != "export" {
            refused(&folder.file(""), "directory");
        }
        refused("/dev/full", "No space left");
        if name != "plot" {
            assert_eq!(to("/dev/null").code, Some(0), "{name}");
            assert!(!to("/dev/stdout").out.is_empty(), "{name}");
        }
        assert!(fs::metadata("/dev/null").expect("it").file_type().is_char_device(), "{name}");
        if let Some(tiny) = &tiny {
            let full = tiny.file(&format!("{name}.svg"));
            fs::write(&full, "old").expect("a file");
            tiny.fill();
            refused(&full, "No space left");
            assert_eq!(fs::read(&full).expect("the file"), b"old", "{name}");
            fs::remove_file(tiny.file("rest")).expect("it was made here");
        }
    }
    let left = tiny.iter().map(|tiny| fs::read_dir(&tiny.0).expect("a folder").count()).sum::<usize>();
    assert_eq!(left, if tiny.is_some() { 4 } else { 0 }, "a temporary file was left");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn regression_inputs_have_a_limit_and_are_regular_files() {
    let folder = Folder::new();
    let [fifo, large, text, at] = ["fifo", "large", "text", "m"].map(|name| folder.file(name));
    mkfifo(fifo.as_str(), Mode::from_bits_truncate(0o600)).expect("a FIFO");
    File::create(&large).and_then(|file| file.set_len(3 << 30)).expect("a sparse file");
    fs::write(&text, "[[gauge]]\nsim = \"bq27441-g1\"\nrestore = \"/dev/zero\"\n").expect("a file");
    for (path, why) in
        [(&*fifo, "not a regular file"), ("/dev/zero", "not a regular file"), (&*large, "longer than")]
    {
        let station = ["program", "--check", "--image", path, "--station", path];
        for words in [
            &["lint", path][..],
            &["diff", path, "tests/it/images/pack.toml"],
            &["import", &at, path],
            &["plot", path],
            &["rescue", "--bus", "/dev/i2c-99", path, "--chip", CHIP, "--yes"],
            &["mount", "--config", path, &at],
            &["mount", "--config", path, "--check", &at],
            &["mount", "--replay", path, &at],
            &["mount", "--sim", "bq27441-g1", "--restore", path, &at],
            &["mount", "--sim", CHIP, "--sim-state", path, &at],
            &["mount", "--sim", CHIP, "--key-file", path, &at],
            &station,
        ] {
            let ran = run(command_of(program_with(words[0]), words));
            assert!([Some(1), Some(2)].contains(&ran.code), "{words:?}: {}", ran.err);
            let is_key = words.contains(&"--key-file");
            assert!(ran.err.contains(why) || is_key, "{words:?}: {}", ran.err);
        }
    }
    // Standard input is no file, and has a limit all the same.
    let mut lint = command(&["lint", "-"]);
    lint.stdin(File::open("/dev/zero").expect("/dev/zero"));
    run(lint).failed(&["standard input", "longer than 16 MiB"]);
    // A shell's <(command) is a pipe that is inherited.
    let mut shell = std::process::Command::new("bash");
    let script = "\"$0\" lint <(cat tests/it/images/pack.toml)";
    shell.args(["-c", script, env!("CARGO_BIN_EXE_gaugefs")]).current_dir(env!("CARGO_MANIFEST_DIR"));
    assert_eq!(run(shell).code, Some(0));
}

/// Names of files are anybody's.
#[test]
fn regression_no_control_character_reaches_a_terminal_or_a_table() {
    let folder = Folder::new();
    for name in ["\x1b]0;x\x07", "a\rb", "a\nb", "\u{9b}2J", "a\u{202e}b", "a\u{85}b"] {
        let file = folder.file(&format!("{name}.toml"));
        for text in [
            "",
            "[gauge]\nchip = \"bq34z100-g1\"\n[it-cfg]\ncell-terminate-voltage = \"\u{1b}[2J\u{202e}\"\n",
        ] {
            fs::write(&file, text).expect("a file");
            for words in [
                &["lint", &*file][..],
                &["lint", "--json", &file],
                &["diff", &file, "tests/it/images/pack.toml"],
                &["diff", "--json", &file, &file],
                &["mount", "--config", &file, "--check", &folder.file("m")],
                &["plot", &file],
                &["get", &file],
                &["umount", &file],
                &["chips", &file],
                &[&file],
            ] {
                let ran = gaugefs(words);
                for shown in [&ran.out, &ran.err] {
                    let hostile =
                        |letter: &char| !"\n\t".contains(*letter) && !ti_gauge::text::is_plain(*letter);
                    assert_eq!(shown.chars().find(hostile), None, "{words:?}: {shown:?}");
                }
                assert_ne!(ran.code, Some(0), "{words:?}");
            }
        }
    }
}

/// What may be where a file or a folder is expected.
const THINGS: [&str; 11] =
    ["new", "empty", "text", "folder", "link", "dangling", "fifo", "socket", "device", "below", "full"];

/// Makes a thing, and returns its path.
fn thing(folder: &str, kind: &str, full: Option<&Tiny>) -> Option<String> {
    let path = format!("{folder}/{kind}");
    let file = |text: &str| fs::write(&path, text).expect("a file");
    match kind {
        "new" => {}
        "empty" => file(""),
        "text" => file("some text\n"),
        "folder" => fs::create_dir(&path).expect("a folder"),
        "link" => {
            fs::write(format!("{path}.target"), "some text\n").expect("a file");
            std::os::unix::fs::symlink(format!("{path}.target"), &path).expect("a link");
        }
        "dangling" => std::os::unix::fs::symlink("nowhere/at/all", &path).expect("a link"),
        "fifo" => mkfifo(path.as_str(), Mode::from_bits_truncate(0o600)).expect("a FIFO"),
        "socket" => drop(std::os::unix::net::UnixListener::bind(&path).expect("a socket")),
        "device" => return Some("/dev/null".into()),
        "below" => return Some(format!("{path}/is/missing")),
        "full" => return full.map(|full| full.file(folder.rsplit('/').next().expect("a name"))),
        _ => unreachable!("{kind}"),
    }
    Some(path)
}

/// One list of checks for `--check` and for the mount: each configuration has the same verdict from both.
#[test]
fn regression_a_check_refuses_what_the_mount_refuses() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let full = Tiny::new(&folder);
    full.iter().for_each(Tiny::fill);
    let sim = "[[gauge]]\nsim = \"bq27441-g1\"\n";
    let options = ["log", "state-dir", "sim-state", "trace", "profile", "key-file", "replay", "mountpoint"];
    let mut cases: Vec<(String, String, String)> = Vec::new();
    let mut case = |name: String, text: &dyn Fn(&str) -> String| {
        let at = folder.file(&name);
        fs::create_dir(&at).expect("a folder");
        cases.push((name, format!("{at}/mounted"), text(&at)));
    };
    for option in options {
        for kind in THINGS {
            // A file system without room is no place for what is only read.
            if kind == "full"
                && (full.is_none() || ["profile", "key-file", "replay", "mountpoint"].contains(&option))
            {
                continue;
            }
            case(format!("{option}-{kind}"), &|at| {
                let path = thing(at, kind, full.as_ref()).expect("it can be made");
                match option {
                    "log" | "state-dir" => format!("[mount]\n{option} = '{path}'\n{sim}"),
                    "replay" => format!("[[gauge]]\nreplay = '{path}'\n"),
                    "mountpoint" => format!("[mount]\nmountpoint = '{path}'\n{sim}"),
                    _ => format!("{sim}{option} = '{path}'\n"),
                }
            });
        }
    }
    let used = folder.file("used.state");
    gaugefs(&["mount", "--sim", "bq27441-g1", "--sim-state", &used, &folder.file("m")]).done();
    case("used".into(), &|_| format!("{sim}sim-state = '{used}'\n"));
    case("name".into(), &|_| format!("[mount]\nac = 'BAT0'\n{sim}"));
    case("log-trace".into(), &|at| format!("[mount]\nlog = '{at}/x'\n{sim}trace = '{at}/x'\n"));
    case("group".into(), &|_| format!("[mount]\ngroup = 'root'\nprivate = true\n{sim}"));
    for place in
        ["/proc/none", "/proc/none/none", "/sys/none", "/sys/class/none", "/proc/version/x", "/dev/pts/none"]
    {
        case(format!("place{}", place.replace('/', "-")), &|_| {
            format!("[mount]\nmountpoint = '{place}'\n{sim}")
        });
    }
    let cases: Vec<_> = one_in(3, cases).collect();
    let differ = std::sync::Mutex::new(Vec::new());
    let verdict = |(name, at, text): &(String, String, String)| {
        let file = folder.file(&format!("{name}.toml"));
        let text = if text.contains("mountpoint") { text.clone() } else { text.replacen("[mount]\n", "", 1) };
        let text =
            if text.contains("mountpoint") { text } else { format!("[mount]\nmountpoint = '{at}'\n{text}") };
        fs::write(&file, &text).expect("a file");
        let check = gaugefs(&["mount", "--config", &file, "--check"]);
        let mounted = gaugefs(&["mount", "--config", &file]);
        if mounted.code == Some(0) {
            let place =
                text.lines().find_map(|line| line.strip_prefix("mountpoint = '")).expect("a mount point");
            gaugefs(&["umount", place.trim_end_matches('\'')]).done();
        }
        if check.code != mounted.code {
            let line = format!(
                "{name}: check {:?} {}, mount {:?} {}",
                check.code, check.err, mounted.code, mounted.err
            );
            differ.lock().expect("no panic").push(line);
        }
    };
    std::thread::scope(|scope| {
        for part in cases.chunks(cases.len().div_ceil(4)) {
            scope.spawn(|| part.iter().for_each(verdict));
        }
    });
    let differ = differ.into_inner().expect("no panic");
    assert!(differ.is_empty(), "{} of {}:\n{}", differ.len(), cases.len(), differ.join("\n"));
    gaugefs(&["umount", &folder.file("m")]).done();
}

/// A bind mount keeps what is mounted elsewhere, as a mount namespace of another process does. A test cannot make one of
/// those: it would have the mounts of all other tests, too.
#[test]
fn regression_an_unmount_says_what_keeps_the_daemon() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, other] = ["m", "n"].map(|name| folder.file(name));
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    fs::create_dir(&other).expect("a folder");
    if mount(Some(&*at), &*other, None::<&str>, MsFlags::MS_BIND, None::<&str>).is_err() {
        eprintln!("SKIPPED: only root can mount a folder at a second place");
        return;
    }
    let ran = gaugefs(&["umount", &at]);
    assert_eq!(ran.code, Some(3), "{}", ran.err);
    for words in ["its daemon keeps running", &format!("it is mounted at {other}, too")] {
        assert!(ran.err.contains(words), "{words}: {}", ran.err);
    }
    gaugefs(&["umount", &other]).done();
}

#[cfg(feature = "screen")]
mod screen {
    use std::fs::OpenOptions;
    use std::io::Read;
    use std::os::unix::fs::OpenOptionsExt;
    use std::process::Child;

    use nix::fcntl::OFlag;
    use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};

    use super::*;
    use crate::room::{Foreground, LONG, stop};

    fn ends(mut child: Child, what: &str) -> Option<i32> {
        let start = Instant::now();
        loop {
            if let Some(status) = child.try_wait().expect("a child") {
                return status.code();
            }
            if start.elapsed() > LONG {
                let _ = child.kill();
                let _ = child.wait();
                panic!("{what}: it does not end");
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Without SIGHUP: the terminal is not the one that controls it.
    #[test]
    fn regression_top_ends_when_its_terminal_is_gone() {
        if !can_mount() {
            return;
        }
        let folder = Folder::new();
        let at = folder.file("m");
        gaugefs(&["mount", "--sim", CHIP, &at]).done();
        let mut master =
            posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).expect("a terminal");
        grantpt(&master).and_then(|()| unlockpt(&master)).expect("it can be opened");
        let mut options = OpenOptions::new();
        options.read(true).write(true).custom_flags(OFlag::O_NOCTTY.bits());
        let slave = options.open(ptsname_r(&master).expect("its name")).expect("it opens");
        let stdio = || Stdio::from(slave.try_clone().expect("a descriptor"));
        let mut top = command(&["top", &at]);
        let top = top.stdin(stdio()).stdout(stdio()).stderr(Stdio::null()).spawn().expect("gaugefs runs");
        drop(slave);
        assert!(master.read(&mut [0; 256]).is_ok_and(|length| length > 0), "nothing is drawn");
        drop(master);
        ends(top, "top");
        gaugefs(&["umount", &at]).done();
    }

    #[test]
    fn regression_what_watches_a_stopped_daemon_ends() {
        if !can_mount() {
            return;
        }
        let folder = Folder::new();
        let at = folder.file("m");
        let gauge = format!("{at}/BAT0");
        // Killed also if the test fails: a mount whose daemon is stopped cannot be removed.
        let daemon = Foreground::new(&at, &[]);
        stop(daemon.0.id(), &at);
        let lines = [
            &["top", "--json", "--count", "1", &*at][..],
            &["top", "--json", "--count", "2", &gauge],
            &["learn", "--once", &gauge],
            &["log", "--count", "1", &at],
        ];
        let started = lines.map(|line| {
            let mut command = command(line);
            (line, command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("gaugefs runs"))
        });
        let codes = started.map(|(line, child)| (line, ends(child, line[0])));
        drop(daemon);
        for (line, code) in codes {
            assert_eq!(code, Some(1), "{line:?}");
        }
    }

    /// No event follows the first one, so nothing is written that would fail.
    #[test]
    fn regression_what_prints_until_it_is_stopped_ends_with_its_reader() {
        if !can_mount() {
            return;
        }
        let folder = Folder::new();
        let at = folder.file("m");
        gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", &at]).done();
        for line in [
            &["watch", &*at, "capacity<101"][..],
            &["learn", "--json", &at],
            &["log", &at],
            &["top", "--json", &at],
        ] {
            let (mut reader, writer) = std::io::pipe().expect("a pipe");
            let mut command = command(line);
            let child = command.stdout(writer).stderr(Stdio::null()).spawn().expect("gaugefs runs");
            drop(command);
            assert!(reader.read(&mut [0]).is_ok_and(|length| length == 1), "{line:?}");
            drop(reader);
            assert_eq!(ends(child, line[0]), Some(0), "{line:?}");
        }
        gaugefs(&["umount", &at]).done();
    }
}

/// What `-` is for each option and argument that names a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dash {
    /// Standard input.
    Input,
    /// Standard output.
    Output,
    /// Refused, with these words: something else has it, or it would have to be there later.
    Refused(&'static str),
}

/// Every such option and argument.
const DASHES: [(&str, &str, Dash); 35] = [
    ("mount", "config", Dash::Input),
    ("mount", "replay", Dash::Input),
    ("mount", "profile", Dash::Input),
    ("mount", "restore", Dash::Input),
    (
        "mount",
        "sim_state",
        Dash::Refused("--sim-state: the gauge's flash is read from it and written to it; name a file"),
    ),
    ("mount", "trace", Dash::Refused("--trace: a mount goes on when the command has returned")),
    ("mount", "log", Dash::Refused("--log: with --foreground the log goes to standard error")),
    ("mount", "key_file", Dash::Refused("standard input: keys are not read from it")),
    ("sim", "replay", Dash::Input),
    (
        "sim",
        "state",
        Dash::Refused("--state: the gauge's flash is read from it and written to it; name a file"),
    ),
    ("program", "image", Dash::Input),
    ("program", "station", Dash::Refused("standard input: it has the serial numbers that are scanned")),
    ("records", "file", Dash::Input),
    ("rescue", "file", Dash::Input),
    ("report", "output", Dash::Output),
    ("report", "key_file", Dash::Refused("standard input: keys are not read from it")),
    ("check", "key_file", Dash::Refused("standard input: keys are not read from it")),
    ("check", "replay", Dash::Input),
    ("export", "output", Dash::Output),
    ("import", "file", Dash::Input),
    ("diff", "a", Dash::Input),
    ("diff", "b", Dash::Input),
    ("lint", "file", Dash::Input),
    ("auth", "key_file", Dash::Refused("standard input: keys are not read from it")),
    ("keys change", "key_file", Dash::Refused("standard input: keys are not read from it")),
    ("keys change", "new_key_file", Dash::Refused("standard input: keys are not read from it")),
    ("log", "output", Dash::Output),
    ("plot", "file", Dash::Input),
    ("plot", "output", Dash::Output),
    ("metrics", "output", Dash::Output),
    ("top", "history", Dash::Refused("not a terminal")),
    ("watch", "config", Dash::Refused("standard input: programs are run from it")),
    // Of systemd's units.
    ("attach", "config", Dash::Input),
    ("check-keys", "file", Dash::Refused("standard input: keys are not read from it")),
    ("attach", "restore", Dash::Input),
];

#[test]
fn a_dash_is_standard_input_or_standard_output_of_every_command() {
    // No option is forgotten.
    let all = programs();
    let all = all.iter().flat_map(|(program, definition)| {
        let names = commands(definition, &[]).into_iter().filter(|name| !is_elsewhere(program, name));
        names.map(move |name| (definition, name))
    });
    for (definition, name) in all {
        let mut command = definition;
        for word in name.split(' ').filter(|word| *word != "help") {
            command = command.find_subcommand(word).expect("a command");
        }
        let is_file = |arg: &&clap::Arg| {
            let named =
                arg.get_value_names().is_some_and(|names| names.iter().any(|name| name.as_str() == "FILE"));
            named || (arg.is_positional() && ["file", "a", "b"].contains(&arg.get_id().as_str()))
        };
        for arg in command.get_arguments().filter(is_file) {
            let found = arg.get_id().as_str().replace('-', "_");
            let is_known = DASHES.iter().any(|(of, id, _)| (*of, *id) == (&*name, &*found));
            // Attaching takes the options of a mount.
            assert!(is_known || name == "attach", "`gaugefs {name}` {}: what is - there?", arg.get_id());
        }
    }
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, other, toml, keys, station, csv, config, trace, empty, profile] =
        ["m", "n", "pack.toml", "keys", "station.toml", "log.csv", "mount.toml", "trace", "empty", "profile"]
            .map(|name| folder.file(name));
    fs::write(&empty, "").expect("a file");
    fs::write(&profile, "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 1200\n").expect("a profile");
    let gauge = format!("{at}/BAT0");
    fs::write(&keys, "unseal = 0414 3672\nauthentication = 0123456789abcdeffedcba9876543210\n")
        .expect("keys");
    fs::set_permissions(&keys, Permissions::from_mode(0o600)).expect("its mode");
    let text = "[station]\nexclude = [\"calibration\", \"keys\"]\n[[gauge]]\nname = \"BENCH\"\nsim = \"bq34z100-g1\"\n";
    fs::write(&station, text).expect("a station");
    // A relative path begins at the folder of whoever runs the command.
    fs::write(&config, "[mount]\nmountpoint = \"dash\"\n[[gauge]]\nsim = \"bq34z100-g1\"\n")
        .expect("a configuration");
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", "--trace", &trace, &at]).done();
    gaugefs(&["export", &gauge, "-o", &toml]).done();
    gaugefs(&["log", "--count", "2", &gauge, "-o", &csv]).done();
    let piped = |arguments: &[&str], file: &str| {
        let mut shell = std::process::Command::new("bash");
        let script = "cat \"$1\" | \"$0\" \"${@:2}\"";
        shell.args(["-c", script, program_with(arguments[0]), file]).args(arguments);
        shell.current_dir(folder.file(""));
        run(shell)
    };
    for (command, id, dash) in DASHES {
        let arguments: Vec<&str> = match (command, id) {
            ("mount", "config") => vec!["mount", "--check", "--config", "-"],
            ("sim", "replay") => vec!["sim", "--replay", "-", "./bus", "--", "true"],
            ("sim", "state") => vec!["sim", CHIP, "--state", "-", "./bus", "--", "true"],
            ("mount", "replay") => vec!["mount", "--replay", "-", &other],
            ("mount", "profile") => vec!["mount", "--sim", "bq27441-g1", "--profile", "-", &other],
            ("mount", "restore") => vec!["mount", "--sim", "bq27441-g1", "--restore", "-", &other],
            ("mount", "key_file") => vec!["mount", "--sim", CHIP, "--key-file", "-", &other],
            ("mount", "log") => vec!["mount", "--sim", CHIP, "--log", "-", &other],
            ("mount", "trace") => vec!["mount", "--sim", CHIP, "--trace", "-", &other],
            ("mount", "sim_state") => vec!["mount", "--sim", CHIP, "--sim-state", "-", &other],
            ("program", "image") => vec!["program", "--check", "--image", "-", "--station", &station],
            ("program", "station") => vec!["program", "--image", &toml, "--station", "-"],
            ("records", _) => vec!["records", "-"],
            ("rescue", _) => vec!["rescue", "--yes", "--bus", "/dev/i2c-999", "--chip", CHIP, "-"],
            ("report", "output") => vec!["report", "-o", "-", &gauge],
            ("report", _) => vec!["report", "--sim", CHIP, "--key-file", "-", "-o", "-"],
            ("check", "key_file") => vec!["check", "--bus", "/dev/i2c-999", "--key-file", "-"],
            ("check", _) => vec!["check", "--replay", "-"],
            ("export" | "metrics", _) => {
                vec![command, if command == "export" { &gauge } else { &at }, "-o", "-"]
            }
            ("log", _) => vec!["log", "--count", "1", &gauge, "-o", "-"],
            ("import", _) => vec!["import", "--dry-run", &gauge, "-"],
            ("diff", "a") => vec!["diff", "-", &gauge],
            ("diff", _) => vec!["diff", &gauge, "-"],
            ("lint", _) => vec!["lint", "-"],
            ("auth", _) => vec!["auth", "--key-file", "-", &gauge],
            ("keys change", "key_file") => {
                vec!["keys", "change", "--key-file", "-", "--new-key-file", &keys, &gauge, "unseal"]
            }
            ("keys change", _) => {
                vec!["keys", "change", "--key-file", &keys, "--new-key-file", "-", &gauge, "unseal"]
            }
            ("top", _) => vec!["top", "--history", "-", &gauge],
            ("plot", "file") => vec!["plot", "-"],
            ("plot", _) => vec!["plot", &csv, "-o", "-"],
            ("watch", _) => vec!["watch", "--config", "-"],
            ("check-keys", _) => vec!["check-keys", "-"],
            ("attach", _) => continue,
            other => panic!("{other:?} is new"),
        };
        let file = match (command, id) {
            ("mount", "config") => &config,
            ("mount", "profile" | "restore") => &profile,
            ("check" | "mount" | "sim", "replay") => &trace,
            ("plot", _) => &csv,
            ("records", _) => &empty,
            _ => &toml,
        };
        let ran = piped(&arguments, file);
        let told = format!("{arguments:?}: {:?} {}", ran.code, ran.err);
        match dash {
            Dash::Refused(says) => assert!(ran.err.contains(says) && ran.out.is_empty(), "{told}"),
            // A TOML is no firmware; the bus would be next.
            Dash::Input if command == "rescue" => {
                assert!(ran.err.starts_with("gaugefs: standard input: "), "{told}")
            }
            // The recording may end before a gauge has told all.
            Dash::Input if command == "check" => {
                assert!(matches!(ran.code, Some(0 | 3)) && !ran.out.is_empty(), "{told}")
            }
            Dash::Input => assert!(ran.code == Some(0) && ran.err.is_empty(), "{told}"),
            Dash::Output => {
                assert!(ran.code == Some(0) && !ran.out.is_empty(), "{told}");
                // Nothing but the content.
                assert!(!ran.out.ends_with("\n-\n"), "{told}");
            }
        }
        let shown = ran.out.contains(&folder.file("dash"));
        assert!((command, id) != ("mount", "config") || shown, "{}", ran.out);
        if command == "mount" && dash == Dash::Input && id != "config" {
            gaugefs(&["umount", &other]).done();
        }
    }
    assert!(!std::path::Path::new(&folder.file("-")).exists());
    let asked = piped(&["rescue", "--bus", "/dev/i2c-999", "--chip", CHIP, "-"], &toml);
    assert!(asked.err.contains("so the question cannot be answered there; pass --yes"), "{}", asked.err);
    gaugefs(&["umount", &at]).done();
}
