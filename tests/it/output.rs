//! What the program prints, and the files that it writes and reads, on a host that fails or is hostile.

use std::fs::{self, File, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::process::Stdio;

use crate::cli::{CHIP, Folder, can_mount, command, gaugefs, run};

/// Each command, with arguments that make it print something, or `None` where it prints nothing, or only with hardware.
fn printing<'a>(
    name: &str,
    [gauge, file, config, station, keys, new_keys, log]: [&'a str; 7],
) -> Option<Vec<&'a str>> {
    Some(match name {
        // They print nothing to standard output.
        "umount" | "wait" | "attach" | "detach" | "check-keys" => return None,
        // They need a bus.
        "probe" | "rescue" => return None,
        // Its steps are printed as those of a calibration are.
        "bringup" | "calibrate board-offset" | "calibrate cc-offset" => return None,
        "calibrate voltage" | "calibrate current" | "calibrate temperature" => return None,
        "mount" => vec!["--check", "--config", config],
        "list" | "doctor" | "man" | "chips" | "help" => vec![],
        "program" => vec!["--check", "--image", file, "--station", station],
        "report" => vec!["--force", "-o", log, gauge],
        "export" | "names" | "look" | "metrics" | "settle" => vec![gauge],
        "get" => vec![gauge, "80/53"],
        "set" => vec!["--dry-run", gauge, "80/53=3105"],
        "import" => vec!["--dry-run", "--set", "80/53=3105", gauge, file],
        "diff" => vec!["--exclude", "learned", config, file],
        "lint" => vec![file],
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

/// The names of all commands that can be run, such as `keys change`.
fn commands(of: &clap::Command, head: &[&str]) -> Vec<String> {
    let below = of.get_subcommands().filter(|command| command.get_name() != "help" || head.is_empty());
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
        let mut command = command(arguments);
        command.stdout(File::options().write(true).open("/dev/full").expect("/dev/full"));
        run(command)
    };
    let closed = |arguments: &[&str]| {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let mut command = command(arguments);
        command.stdout(Stdio::from(writer));
        run(command)
    };
    let definition = gaugefs::cli::definition();
    let mut lines: Vec<Vec<String>> = vec![vec!["--help".into()], vec!["--version".into()]];
    for name in commands(&definition, &[]) {
        let words = || name.split(' ').map(str::to_string);
        if name != "help" {
            lines.push(words().chain(["--help".into()]).collect());
        }
        let files = [&*gauge, &*file, &*config, &*station, &*keys, &*new_keys, &*log];
        let Some(arguments) = printing(&name, files) else { continue };
        let mut line: Vec<String> = words().collect();
        if name == "calibrate leave" {
            line.insert(1, gauge.clone());
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
        let is_comparison = ["auth", "diff"].contains(&line[0]) || line.contains(&"--dry-run");
        let expected = if is_comparison && !line.contains(&"--help") { 2 } else { 1 };
        assert_eq!(ran.code, Some(expected), "{line:?}: {}", ran.err);
        let says = "cannot write standard output: No space left on device\n";
        assert!(ran.err.ends_with(says), "{line:?}: {}", ran.err);
        // A reader that has seen enough is no failure.
        if ["chips", "lint", "log", "man", "top"].contains(&line[0]) {
            let ran = closed(&line);
            assert!(!ran.err.contains("standard output"), "{line:?}: {}", ran.err);
            assert!(!ran.err.contains("panicked"), "{line:?}: {}", ran.err);
        }
    }
    gaugefs(&["umount", &at]).done();
}
