// SPDX-License-Identifier: MIT

//! `gaugefs keys change`: key files with sections, input on the terminal, and the places where keys must not
//! appear.

use std::collections::BTreeSet;
use std::fs::{self, Permissions};
use std::io::{Read, Write};
use std::os::unix::fs::{FileExt, MetadataExt, PermissionsExt};
use std::path::Path;
use std::process::{Command, Stdio};

use nix::errno::Errno;

use crate::room::{Folder, Ran, can_mount, command, gaugefs, read, within};

const CHIP: &str = "bq34z100-g1";
const SEALS: [&str; 2] = ["8d3e b7c5", "6fa1 92d4"];
const AUTHENTICATION: [&str; 2] = ["0123456789abcdeffedcba9876543210", "9d17c2e85ba3f6047e91d80c3b6fa25e"];

fn write_keys(path: &str, text: &str) {
    fs::write(path, text).expect("a key file");
    fs::set_permissions(path, Permissions::from_mode(0o600)).expect("its mode");
}

/// Whether data flash can be read, which on a sealed gauge needs the unseal key.
fn opens(at: &str, gauge: &str) -> bool {
    match fs::read_to_string(Path::new(at).join(gauge).join("df/80/53")) {
        Ok(_) => true,
        Err(error) => {
            assert_eq!(error.raw_os_error(), Some(Errno::EPERM as i32), "{error}");
            false
        }
    }
}

#[test]
fn a_key_is_changed_through_the_mount_and_survives_a_remount() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, state, old, new] = ["m", "state", "old", "new"].map(|name| folder.file(name));
    // One file for many gauges; lines above the sections apply to gauges without a section.
    write_keys(&old, "unseal = 1111 2222\n[PACK]\nunseal = 8d3e b7c5\n[BAT9]\nunseal = 3333 4444\n");
    write_keys(&new, "[PACK]\nunseal = 6fa1 92d4\n");
    let mount = |keys: &str| {
        let mount = ["mount", "--sim", CHIP, "--sim-state", &state, "--sim-key", SEALS[0], "--name", "PACK"];
        gaugefs(&[&mount[..], &["--key-file", keys, &at]].concat()).done();
    };
    mount(&old);
    let gauge = format!("{at}/PACK");
    assert_eq!(fs::metadata(format!("{gauge}/gauge/keys")).expect("a file").mode() & 0o777, 0o200);
    let told =
        gaugefs(&["keys", "change", &gauge, "unseal", "--key-file", &old, "--new-key-file", &new]).done();
    assert!(told.contains("unseal key is changed") && told.contains("`unseal = ...`"), "{told}");
    assert_eq!(read(&gauge, "gauge/seal"), "sealed");
    assert!(opens(&at, "PACK"), "the mount took the new key into use");
    gaugefs(&["umount", &at]).done();
    mount(&old);
    assert!(!opens(&at, "PACK"), "the old key is gone");
    gaugefs(&["umount", &at]).done();
    mount(&new);
    assert!(opens(&at, "PACK"));
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_refused_key_change_reports_the_reason() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, old, new] = ["m", "old", "new"].map(|name| folder.file(name));
    write_keys(&old, "unseal = 0414 3672\nfull_access = ffff ffff\n");
    write_keys(&new, "unseal = 6fa1 92d4\n");
    let change = |key: &str| {
        gaugefs(&["keys", "change", &format!("{at}/BAT0"), key, "--key-file", &old, "--new-key-file", &new])
    };
    change("unseal").failed(&["not a mounted gauge: it does not exist"]);
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    fs::set_permissions(&new, Permissions::from_mode(0o604)).expect("its mode");
    change("unseal").failed(&["others may read", "mode 604"]);
    fs::set_permissions(&new, Permissions::from_mode(0o600)).expect("its mode");
    change("full-access").failed(&[&new, "no line `full_access = ...` for BAT0"]);
    change("authentication").failed(&[&old, "no line `authentication = ...` for BAT0"]);
    write_keys(&new, "[BAT0]\nunseal = 6fa1 6fa1\n");
    change("unseal").failed(&["unseal key", "one word twice"]);
    write_keys(&new, "[BAT0]\nunseal = 6fa1 92d4 92d4\n");
    change("unseal").failed(&["line 2", "two words"]);
    let file = format!("{at}/BAT0/gauge/keys");
    // An unsealed gauge shows at once that the key is wrong; a sealed one needs silence before each attempt.
    fs::write(format!("{at}/BAT0/gauge/seal"), "full-access").expect("a state");
    for (text, errno) in [
        ("unseal 0414 3672", Errno::EINVAL),
        ("unseal 0414 3672 0414 3672", Errno::EINVAL),
        ("unseal 0414 3672 0000 0000", Errno::ERANGE),
        ("full-access 1234 5678 6fa1 92d4", Errno::EPERM),
    ] {
        let error = fs::write(&file, text).expect_err("refused");
        assert_eq!(error.raw_os_error(), Some(errno as i32), "{text}");
    }
    assert!(opens(&at, "BAT0"), "the key is the old one");
    gaugefs(&["umount", &at]).done();

    gaugefs(&["mount", "--sim", CHIP, "--read-only", &at]).done();
    let error = fs::write(&file, "unseal 0414 3672 6fa1 92d4").expect_err("refused");
    assert_eq!(error.raw_os_error(), Some(Errno::EROFS as i32));
    gaugefs(&["umount", &at]).done();

    gaugefs(&["mount", "--sim", "bq27441-g1", &at]).done();
    write_keys(&old, "unseal = 8000 8000\n");
    write_keys(&new, "unseal = 6fa1 92d4\n");
    change("unseal").failed(&["unseal key", "cannot be changed here", "ROM"]);
    gaugefs(&["umount", &at]).done();
}

/// Runs gaugefs on a terminal of its own, and types each answer when its question appears.
fn typed(arguments: &[&str], answers: &[(&str, &str)]) -> Ran {
    let quoted: Vec<_> = arguments.iter().map(|argument| format!("'{argument}'")).collect();
    let line = format!("'{}' {}", env!("CARGO_BIN_EXE_gaugefs"), quoted.join(" "));
    let mut script = Command::new("script")
        .args(["-q", "-e", "-c", &line, "/dev/null"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("script runs");
    let (mut keyboard, mut screen) =
        (script.stdin.take().expect("a pipe"), script.stdout.take().expect("a pipe"));
    let mut out = String::new();
    let mut seen = 0;
    let mut byte = [0];
    for (question, answer) in answers {
        while !out[seen..].contains(question) {
            assert_eq!(screen.read(&mut byte).expect("a screen"), 1, "no question `{question}`: {out}");
            out.push(char::from(byte[0]));
        }
        seen = out.len();
        keyboard.write_all(answer.as_bytes()).expect("typed");
    }
    screen.read_to_string(&mut out).expect("a screen");
    drop(keyboard);
    Ran { code: script.wait().expect("it ends").code(), out, err: String::new(), gauges: Vec::new() }
}

#[test]
fn typed_keys_are_not_echoed() {
    if !can_mount() {
        return;
    }
    if Command::new("script").arg("--version").output().is_err() {
        eprintln!("SKIPPED: there is no script(1); nothing was typed at a terminal");
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let gauge = format!("{at}/BAT0");
    let ask = |answers: &[(&str, &str)]| typed(&["keys", "change", &gauge, "unseal"], answers);
    let (old, new, again) = ("old unseal key: ", "new unseal key: ", "repeat the new unseal key: ");
    let ran = ask(&[(old, "0414 3672\n"), (new, "6fa1 92d4\n"), (again, "6fa1 92d5\n")]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    assert!(ran.out.contains("two different keys were typed"), "{}", ran.out);
    // Ctrl-C, without Enter.
    let ran = ask(&[(old, "0414 3672\n"), (new, "6fa1\x03")]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    assert!(ran.out.contains("no key was typed; nothing was changed"), "{}", ran.out);
    assert!(opens(&at, "BAT0"));
    let ran = ask(&[(old, "0414 3672\n"), (new, "6fa1 92d4\n"), (again, "6FA192D4\n")]);
    assert!(ran.out.contains("expected two words"), "{}", ran.out);
    let ran = ask(&[(old, "0414 3672\n"), (new, "6fa1 92d4\n"), (again, "6FA1 92D4\n")]);
    assert_eq!(ran.code, Some(0), "{}", ran.out);
    for word in ["0414", "3672", "6fa1", "6FA1"] {
        assert!(!ran.out.replace("0414 3672", "").contains(word), "{}", ran.out);
        assert!(!ran.out.contains("0414 3672"), "{}", ran.out);
    }
    assert!(opens(&at, "BAT0"));
    gaugefs(&["umount", &at]).done();
    // Without a terminal there are no questions.
    let alone = Command::new("setsid")
        .args(["-w", env!("CARGO_BIN_EXE_gaugefs"), "keys", "change", &gauge, "unseal"])
        .output()
        .expect("setsid runs");
    assert_eq!(alone.status.code(), Some(1));
}

/// The forms in which a key might leak: words and bytes, hexadecimal and decimal, in the order in which it is
/// typed, sent, and stored in data flash.
fn spellings(key: &str) -> BTreeSet<String> {
    let bytes: Vec<u8> = hexadecimal(key);
    let mut spellings = BTreeSet::new();
    let mut orders = vec![bytes.clone(), bytes.iter().rev().copied().collect()];
    orders.push(bytes.chunks(2).flat_map(|word| [word[1], word[0]]).collect());
    orders.push(bytes.chunks(2).rev().flatten().copied().collect());
    for order in orders {
        let join = |show: &dyn Fn(&u8) -> String, between: &str| {
            order.iter().map(show).collect::<Vec<_>>().join(between)
        };
        for between in ["", " ", ", ", ":", "-"] {
            spellings.insert(join(&|byte| format!("{byte:02x}"), between));
            spellings.insert(join(&|byte| format!("0x{byte:02x}"), between));
        }
        spellings.extend([" ", ", ", "\n"].map(|between| join(&|byte| byte.to_string(), between)));
        let words: Vec<u16> = order.chunks(2).map(|word| u16::from_be_bytes([word[0], word[1]])).collect();
        for between in [" ", ", ", "\t"] {
            let join =
                |show: &dyn Fn(&u16) -> String| words.iter().map(show).collect::<Vec<_>>().join(between);
            spellings.insert(join(&|word| word.to_string()));
            spellings.insert(join(&|word| format!("{word:04x}")));
            spellings.insert(join(&|word| format!("0x{word:04x}")));
        }
        // As in a FlashStream or a trace, one word per line.
        spellings.extend(words.iter().map(|word| format!("aa 00 {:02x} {:02x}", word & 0xff, word >> 8)));
        for double in order.chunks(4) {
            let number = double.iter().fold(0u32, |sum, byte| sum << 8 | u32::from(*byte));
            spellings.extend([number.to_string(), (number as i32).to_string()]);
        }
    }
    spellings
}

fn hexadecimal(key: &str) -> Vec<u8> {
    let digits: String = key.split(' ').collect();
    (0..digits.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&digits[at..at + 2], 16).expect("digits"))
        .collect()
}

/// Keys in every form in which they are searched for, made once: hundreds of files are searched.
struct Sought {
    /// A key, a spelling of it, and that without spaces unless it is short and would be found by chance.
    spelled: Vec<(String, String, Option<String>)>,
    raw: Vec<(String, Vec<u8>)>,
}

impl Sought {
    fn new(keys: &[&str]) -> Self {
        let (mut spelled, mut raw) = (Vec::new(), Vec::new());
        for key in keys {
            for spelling in spellings(key) {
                let tight: String = spelling.split_whitespace().collect();
                spelled.push((key.to_string(), spelling, Some(tight).filter(|tight| tight.len() >= 12)));
            }
            let bytes = hexadecimal(key);
            let turned: Vec<u8> = bytes.iter().rev().copied().collect();
            let swapped: Vec<u8> = bytes.chunks(2).flat_map(|word| [word[1], word[0]]).collect();
            raw.extend([bytes, turned, swapped].map(|bytes| (key.to_string(), bytes)));
        }
        Self { spelled, raw }
    }

    /// The key that occurs in `content`, as text or as bytes.
    fn found(&self, content: &[u8]) -> Option<String> {
        let text = String::from_utf8_lossy(content).to_lowercase();
        let tight: String = text.split_whitespace().collect();
        let spelled = self.spelled.iter().find(|(_, spelling, squeezed)| {
            text.contains(spelling) || squeezed.as_ref().is_some_and(|squeezed| tight.contains(squeezed))
        });
        let spelled = spelled.map(|(key, spelling, _)| format!("{key} as `{spelling}`"));
        spelled.or_else(|| {
            let mut raw = self.raw.iter();
            let found = raw.find(|(_, bytes)| content.windows(bytes.len()).any(|window| window == bytes));
            found.map(|(key, _)| format!("{key} as bytes"))
        })
    }
}

#[test]
fn the_search_finds_keys_in_every_notation() {
    let sought = Sought::new(&[SEALS[0], AUTHENTICATION[0]]);
    let shows = |content: &[u8]| sought.found(content);
    for text in [
        "a 8d3e b7c5",
        "8D3EB7C5",
        "b7 c5 8d 3e",
        "3e 8d c5 b7",
        "0xb7c5, 0x8d3e",
        "36158 47045",
        "W: AA 00 3E 8D",
        "2369697733",
        "0123456789ABCDEF FEDCBA9876543210",
        "10 32 54 76 98 ba dc fe ef cd ab 89 67 45 23 01",
    ] {
        assert!(shows(text.as_bytes()).is_some(), "{text}");
    }
    assert!(shows(b"\x00\xb7\xc5\x8d\x3e").is_some() || shows(b"\x00\x8d\x3e\xb7\xc5").is_some());
    assert_eq!(shows(b"8d3e and, elsewhere, b7c5"), None);
}

/// Reads every readable file below a folder, without following links.
fn read_all(folder: &Path, each: &mut dyn FnMut(&Path, &[u8])) {
    for entry in fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry")) {
        let (path, kind) = (entry.path(), entry.file_type().expect("its type"));
        if kind.is_dir() {
            read_all(&path, each);
        } else if kind.is_file()
            && let Ok(content) = fs::read(&path)
        {
            each(&path, &content);
        }
    }
}

/// The process that serves a mount point.
fn daemon(at: &str) -> Option<u32> {
    let mut found = None;
    for entry in fs::read_dir("/proc").expect("/proc").flatten() {
        let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        let words: Vec<_> = line.split(|byte| *byte == 0).collect();
        if words.contains(&b"mount".as_slice()) && words.contains(&at.as_bytes()) {
            found = Some(pid);
        }
    }
    found
}

/// The writable memory of a process, which contains its buffers.
fn writable_memory(process: u32) -> std::io::Result<Vec<u8>> {
    let memory = fs::File::open(format!("/proc/{process}/mem"))?;
    let mut all = Vec::new();
    for line in
        fs::read_to_string(format!("/proc/{process}/maps"))?.lines().filter(|line| line.contains(" rw"))
    {
        let (from, to) = line.split(' ').next().and_then(|range| range.split_once('-')).expect("a range");
        let at = |text| u64::from_str_radix(text, 16).expect("an address");
        let mut piece = vec![0; (at(to) - at(from)) as usize];
        // Some mappings cannot be read.
        if memory.read_exact_at(&mut piece, at(from)).is_ok() {
            all.extend(piece);
        }
    }
    Ok(all)
}

/// Where keys are in memory, as bytes in each order or as text: the key, its form and the place.
fn places<'a>(memory: &[u8], keys: &[&'a str]) -> Vec<(&'a str, &'static str, usize)> {
    let forms = keys.iter().flat_map(|&key| {
        let raw = hexadecimal(key);
        let words: Vec<u8> = raw.chunks(2).flat_map(|word| [word[1], word[0]]).collect();
        let reversed: Vec<u8> = raw.iter().rev().copied().collect();
        let stored: Vec<u8> = raw.chunks(2).rev().flatten().copied().collect();
        let tight: String = key.split(' ').collect();
        [
            (key, "bytes", raw),
            (key, "words", words),
            (key, "reversed", reversed),
            (key, "as stored", stored),
            (key, "text", tight.into_bytes()),
            (key, "text with spaces", key.into()),
        ]
    });
    // Most of the memory is skipped by its first byte, because the search is slow without optimization.
    let mut by_first: Vec<Vec<_>> = vec![Vec::new(); 256];
    for (key, form, bytes) in forms {
        by_first[usize::from(bytes[0])].push((key, form, bytes));
    }
    let mut found = Vec::new();
    for (at, first) in memory.iter().enumerate() {
        let forms = by_first[usize::from(*first)].iter();
        let form = forms.into_iter().find(|(_, _, bytes)| memory[at..].starts_with(bytes));
        found.extend(form.map(|(key, form, _)| (*key, *form, at)));
    }
    found
}

/// A key is in one allocation of the daemon, from which it is wiped. A key of another gauge is nowhere.
#[test]
fn keys_that_are_not_used_are_in_memory_once() {
    if !can_mount() {
        return;
    }
    let (folder, secret) = (Folder::new(), Folder::new());
    let [at, keys] = [folder.file("m"), secret.file("keys")];
    let own = ["8d3e b7c5", "47b2 d90e", "9d17c2e85ba3f6047e91d80c3b6fa25e"];
    let others = ["6fa1 92d4", "51e8 7ac3", "44d1f08a6c2e97b35a0e7fd1c8b26493"];
    let section = |[unseal, full, authentication]: [&str; 3]| {
        format!("unseal = {unseal}\nfull_access = {full}\nauthentication = {authentication}\n")
    };
    write_keys(&keys, &format!("{}[BAT0]\n{}[BAT9]\n{}", section(others), section(own), section(others)));
    gaugefs(&["mount", "--sim", CHIP, "--key-file", &keys, &at]).done();
    let process = daemon(&at).expect("the daemon runs");
    let memory = writable_memory(process);
    gaugefs(&["umount", &at]).done();
    let memory = match memory {
        Ok(memory) => memory,
        Err(error) => return eprintln!("SKIPPED: the daemon's memory cannot be looked at: {error}"),
    };
    let found = places(&memory, &[own, others].concat());
    for key in own {
        let places: Vec<_> = found.iter().filter(|(other, ..)| *other == key).collect();
        assert!(matches!(places[..], [(_, "bytes", _)]), "{key} in {} bytes: {places:?}", memory.len());
    }
    let foreign: Vec<_> = found.iter().filter(|(key, ..)| others.contains(key)).collect();
    assert!(foreign.is_empty(), "no keys of this gauge: {foreign:?}");
}

/// Uses and changes every key, with success and without. Afterwards the keys are in their files and nowhere
/// else.
#[test]
fn keys_appear_nowhere() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let secret = Folder::new();
    let [at, log, trace] = ["m", "log", "trace"].map(|name| folder.file(name));
    let [old, new, wrong] = ["old", "new", "wrong"].map(|name| secret.file(name));
    // Full access has its default at first, which cannot be searched for: erased flash reads the same.
    let full = "47b2 d90e";
    let file = |path: &str, unseal: &str, full: &str, authentication: &str| {
        write_keys(
            path,
            &format!("[BAT0]\nunseal = {unseal}\nfull_access = {full}\nauthentication = {authentication}\n"),
        );
    };
    let stranger = ["51e8 7ac3", "e3c4 19b6", "44d1f08a6c2e97b35a0e7fd1c8b26493"];
    file(&old, SEALS[0], "ffff ffff", AUTHENTICATION[0]);
    file(&new, SEALS[1], full, AUTHENTICATION[1]);
    file(&wrong, stranger[0], stranger[1], stranger[2]);
    let daemon_of = {
        // The key of a new simulated gauge is on a command line; this one is changed before the search.
        let mount =
            ["mount", "--sim", CHIP, "--key-file", &old, "--log", &log, "--trace", &trace, "--sim-state"];
        let state = secret.file("state");
        gaugefs(&["mount", "--sim", CHIP, "--sim-state", &state, "--sim-key", SEALS[0], &at]).done();
        gaugefs(&["umount", &at]).done();
        gaugefs(&[&mount[..], &[&state, &at]].concat()).done();
        daemon(&at).expect("the daemon runs")
    };
    let gauge = format!("{at}/BAT0");
    let mut said = Vec::new();
    let mut change = |key: &str, from: &str, to: &str, code: i32| {
        let ran = command(&["keys", "change", &gauge, key, "--key-file", from, "--new-key-file", to])
            .output()
            .expect("gaugefs runs");
        said.extend([ran.stdout, ran.stderr].concat());
        said.extend(fs::read(format!("{gauge}/gauge/last_error")).expect("it"));
        assert_eq!(ran.status.code(), Some(code), "{}", String::from_utf8_lossy(&said));
    };
    let keys = [
        SEALS[0],
        SEALS[1],
        full,
        AUTHENTICATION[0],
        AUTHENTICATION[1],
        stranger[0],
        stranger[1],
        stranger[2],
    ];
    let sought = Sought::new(&keys);
    let go_to = |state: &str| fs::write(format!("{gauge}/gauge/seal"), state).expect("a state");
    for key in ["unseal", "full-access", "authentication"] {
        // An unsealed gauge shows at once that the key is wrong; a sealed one needs silence before each attempt.
        go_to("full-access");
        change(key, &wrong, &new, 1);
        go_to("sealed");
        change(key, &old, &new, 0);
    }
    change("unseal", &new, &wrong, 0);
    change("unseal", &wrong, &new, 0);
    go_to("full-access");
    // Repeating the change succeeds, because the gauge already has the new key.
    change("unseal", &old, &new, 0);
    // After the command has ended, the daemon's memory contains nothing of what it wrote.
    match writable_memory(daemon_of) {
        Err(error) => eprintln!("SKIPPED: the daemon's memory cannot be looked at: {error}"),
        Ok(memory) => {
            // The simulated gauge's own flash is there too, as text without spaces.
            // The standard library's search is fast without optimization, too.
            let text = String::from_utf8_lossy(&memory);
            for key in keys.map(|key| format!(" {key}")) {
                assert!(!text.contains(&key), "{key} is left in memory");
            }
        }
    }
    for text in
        [&format!("unseal {} {}", SEALS[1], SEALS[1]), AUTHENTICATION[1], SEALS[1], "unseal 6fa1 92d4 1 2"]
    {
        fs::write(format!("{gauge}/gauge/keys"), text).expect_err("refused");
        said.extend(fs::read(format!("{gauge}/gauge/last_error")).expect("it"));
    }
    gaugefs(&["auth", &gauge, "--key-file", &new]).done();
    assert_eq!(sought.found(&said), None, "{}", String::from_utf8_lossy(&said));
    for format in ["toml", "gg.csv", "flashstream"] {
        gaugefs(&["export", &gauge, "--format", format, "-o", &folder.file(format)]).done();
    }
    let mut files = 0;
    read_all(Path::new(&gauge), &mut |path, content| {
        files += 1;
        assert_eq!(sought.found(content), None, "{}", path.display());
    });
    assert!(files > 300, "{files}");
    for file in ["cmdline", "environ", "comm"] {
        let content = fs::read(format!("/proc/{daemon_of}/{file}")).expect("of our own process");
        assert_eq!(sought.found(&content), None, "{file}");
    }
    gaugefs(&["umount", &at]).done();
    within("the end is logged", || fs::read_to_string(&log).expect("the log").contains("unmounted"));
    let mut left = 0;
    read_all(&folder.0, &mut |path, content| {
        left += 1;
        assert_eq!(sought.found(content), None, "{}", path.display());
    });
    assert_eq!(left, 5, "log, trace and three exports");
    let trace = fs::read_to_string(&trace).expect("the trace");
    assert!(trace.matches("; hidden").count() > 50, "{trace}");
    assert!(trace.contains("W: AA 40 "), "challenges are no secret");
    assert!(fs::read_to_string(&log).expect("the log").contains("unseal key: changed and tried"));
}

/// What the program prints after a power cut is followed to the letter. A gauge wants pauses of several seconds between
/// keys, so every run takes one key; GAUGEFS_KEYS=1 takes all of them.
#[test]
fn regression_the_way_back_from_a_power_cut_in_a_key_change_is_refused() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, flash, state, own, old, new] =
        ["m", "flash", "state", "own", "old", "new"].map(|name| folder.file(name));
    let gauge = format!("{at}/BAT0");
    // As a shell needs it.
    let quoted = if gauge.contains(' ') { format!("'{gauge}'") } else { gauge.clone() };
    let default = AUTHENTICATION[0];
    write_keys(&own, &format!("unseal = 0414 3672\nfull_access = ffff ffff\nauthentication = {default}\n"));
    let mount = || {
        let mount =
            ["mount", "--sim", CHIP, "--sim-state", &flash, "--state-dir", &state, "--key-file", &own];
        gaugefs(&[&mount[..], &[&at]].concat()).done();
    };
    let set = |knob: &str, text: &str| fs::write(format!("{gauge}/sim/{knob}"), text).expect("a knob");
    let keys = [
        ("unseal", "0414 3672", SEALS[0]),
        ("full-access", "ffff ffff", SEALS[1]),
        ("authentication", default, AUTHENTICATION[1]),
    ];
    let count = if std::env::var_os("GAUGEFS_KEYS").is_some() { keys.len() } else { 1 };
    for (number, (key, from, to)) in keys.into_iter().enumerate().take(count) {
        let line = key.replace('-', "_");
        write_keys(&old, &format!("{line} = {from}\n"));
        write_keys(&new, &format!("{line} = {to}\n"));
        mount();
        set("tear", "erased");
        set("fault", "torn-commit 2");
        let change = ["keys", "change", &gauge, key, "--key-file", &old, "--new-key-file", &new];
        let ran = gaugefs(&change);
        ran.failed(&[
            "the gauge does not answer",
            &format!("gaugefs keys change {quoted} {key} --key-file OLD"),
        ]);
        assert_eq!(read(&gauge, "gauge/owed"), "1");
        let process = daemon(&at).expect("the daemon runs");
        nix::sys::signal::kill(nix::unistd::Pid::from_raw(process as i32), nix::sys::signal::Signal::SIGKILL)
            .expect("it is killed");
        within("it has ended", || daemon(&at).is_none());
        mount();
        let shown = gaugefs(&["settle", &gauge]);
        assert_eq!(shown.code, Some(1), "{}{}", shown.out, shown.err);
        assert!(shown.out.contains("unseal key ffff ffff (erased)"), "{}", shown.out);
        assert!(fs::write(format!("{gauge}/df/80/53"), "3100").is_err(), "nothing else is written");
        assert_eq!(read(&gauge, "gauge/owed"), "1");
        let command = shown.out.split("gaugefs ").nth(1).and_then(|rest| rest.split(')').next());
        let command = command.unwrap_or_else(|| panic!("no command in {}", shown.out));
        let command = command.replace(&quoted, "HERE");
        let words = command.split(' ').map(|word| match word {
            "HERE" => gauge.as_str(),
            "OLD" if number != 1 => old.as_str(),
            "NEW" if number != 1 => new.as_str(),
            // This one is undone.
            "OLD" => new.as_str(),
            "NEW" => old.as_str(),
            word => word,
        });
        gaugefs(&words.collect::<Vec<_>>()).done();
        assert_eq!(read(&gauge, "gauge/owed"), "0");
        assert_eq!(gaugefs(&["settle", &gauge]).done(), "nothing to settle\n");
        if number != 1 {
            let back = ["keys", "change", &gauge, key, "--key-file", &new, "--new-key-file", &old];
            gaugefs(&back).done();
        }
        gaugefs(&["umount", &at]).done();
        // With the owner's keys.
        mount();
        fs::write(format!("{gauge}/gauge/seal"), "full-access").expect("his keys");
        fs::write(format!("{gauge}/gauge/seal"), "sealed").expect("a state");
        gaugefs(&["auth", &gauge, "--key-file", &own]).done();
        gaugefs(&["umount", &at]).done();
    }
}
