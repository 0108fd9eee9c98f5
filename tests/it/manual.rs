// SPDX-License-Identifier: MIT

//! The manual pages and the completions, checked by the programs that read them.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::room::{Folder, STATION, command, command_of, gaugefs, gaugefs_station};

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs")
}

/// gaugefs(1), as a package installs it.
fn page() -> String {
    printed("gaugefs")
}

fn printed(page: &str) -> String {
    dated(command(&["man", page]))
}

/// What a command prints that dates its page.
fn dated(mut command: Command) -> String {
    let output = command.env("SOURCE_DATE_EPOCH", "1700000000").output().expect("gaugefs runs");
    assert!(output.status.success());
    String::from_utf8(output.stdout).expect("a page in UTF-8")
}

/// The text without the markup of roff for dashes and fonts.
fn plain(page: &str) -> String {
    page.replace("\\-", "-").replace("\\fB", "").replace("\\fI", "").replace("\\fR", "")
}

/// What a program prints about a file; `None`, with a message, if it is not installed.
fn said(program: &str, arguments: &[&str], file: &str) -> Option<String> {
    let mut command = Command::new(program);
    command.args(arguments).arg(file).envs([("LC_ALL", "C.UTF-8"), ("MANWIDTH", "80")]);
    match command.stdin(Stdio::null()).output() {
        Ok(output) => {
            let (out, err) =
                (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
            Some(format!("{out}{err}"))
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            eprintln!("SKIPPED in part: {program} is missing, so it did not check {file}");
            None
        }
        Err(error) => panic!("{program}: {error}"),
    }
}

/// A temporary file, removed after the test.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str, text: &str) -> Self {
        let path = crate::room::folder().join(name);
        fs::write(&path, text).expect("a temporary file");
        Self(path)
    }

    fn path(&self) -> &str {
        self.0.to_str().expect("a path in UTF-8")
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = self.0.parent().map(fs::remove_dir_all);
    }
}

#[test]
fn the_pages_render_without_a_warning() {
    let station = dated(command_of(STATION, &["man"]));
    for place in ["@DATE@", "@VERSION@", "@SYNOPSIS@", "@COMMANDS@", "@WORDS@"] {
        assert!(!station.contains(place), "{place}");
    }
    let pages =
        [("gaugefs.1", page()), ("gaugefs-station.1", station), ("gaugefs.toml.5", printed("gaugefs.toml"))];
    for (name, text) in pages {
        let file = Scratch::new(name, &text);
        if let Some(lint) = said("mandoc", &["-T", "lint", "-W", "warning"], file.path()) {
            assert_eq!(lint, "", "{name}");
        }
        // Only the warnings of groff, without the page.
        let warnings = ["-c", r#"man --warnings=w -l "$0" 2>&1 >/dev/null"#];
        if said("man", &["--version"], "").is_some()
            && let Some(warnings) = said("sh", &warnings, file.path())
        {
            assert_eq!(warnings, "", "{name}");
        }
    }
}

#[test]
fn the_page_lists_every_command_with_its_options() {
    let page = plain(&page());
    assert!(page.contains(r#".TH GAUGEFS 1 "2023-11-14" "gaugefs "#), "{}", &page[..300]);
    for place in ["@DATE@", "@VERSION@", "@SYNOPSIS@", "@COMMANDS@", "@WORDS@"] {
        assert!(!page.contains(place), "{place}");
    }
    let help = gaugefs(&["--help"]).done();
    let (commands, _) = help.split_once("\nOptions:\n").expect("commands");
    let names = commands.lines().filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
    let commands = names.filter(|name| !name.is_empty());
    let mut seen = 0;
    for name in commands.filter(|name| *name != "help") {
        let start = page.find(&format!(".SS \"gaugefs {name}\"\n")).unwrap_or_else(|| panic!("no {name}"));
        let section = &page[start + 4..];
        let section = &section[..section.find("\n.S").expect("an end")];
        let help = gaugefs(&[name, "--help"]).done();
        for word in help.split(|byte: char| byte.is_whitespace() || "<|>,[=]".contains(byte)) {
            if word.starts_with("--") && word.len() > 3 && word != "--help" {
                let word = word.trim_end_matches(['.', ':', ';', ')']);
                assert!(section.contains(word), "gaugefs {name} {word}");
                seen += 1;
            }
        }
    }
    assert!(seen > 40, "{seen}");
    for section in ["WORDS", "FILES", "EXIT STATUS", "ERRORS", "EXAMPLES", "SEE ALSO"] {
        assert!(page.contains(&format!(".SH {section}\n")), "{section}");
    }
}

/// A configuration file has the options of the command line, except those that only make sense there.
#[test]
fn the_page_of_the_configuration_lists_every_option() {
    let page = plain(&printed("gaugefs.toml"));
    for place in ["@DATE@", "@VERSION@", "@MOUNT@", "@DEFAULTS@", "@GAUGE@", "@CHOOSE@", "@ALERT@"] {
        assert!(!page.contains(place), "{place}");
    }
    let terms = page.lines().zip(page.lines().skip(1)).filter(|(before, _)| *before == ".TP");
    let keys = terms.filter_map(|(_, term)| term.strip_suffix(')')?.split_once(" ("));
    let keys: BTreeSet<String> = keys.map(|(key, _)| key.to_string()).collect();
    let help = gaugefs(&["mount", "--help"]).done();
    // Explanations are indented further, and may begin a line with an option.
    let options = help.lines().filter_map(|line| line.strip_prefix("      --"));
    let name = |line: &str| line.split([' ', '[']).next().unwrap_or(line).to_string();
    let mut options: BTreeSet<String> = options.map(name).collect();
    for only_there in ["config", "check"] {
        options.remove(only_there);
    }
    options.insert("mountpoint".into());
    let help = gaugefs(&["watch", "--help"]).done();
    let of_alerts = help.lines().filter_map(|line| line.strip_prefix("      --")).map(name);
    options.extend(of_alerts.filter(|option| !["config", "test"].contains(&option.as_str())));
    options.extend(["when", "gauge", "choose"].map(String::from));
    let folder = Folder::new();
    let file = folder.file("rules.toml");
    fs::write(&file, "[[gauge]]\nsim = 'bq27427'\nchoose = [{ resistor = 1 }]\n").expect("a file");
    let refused = gaugefs(&["mount", "--config", &file, &folder.file("m")]).err;
    let (_, of_rules) = refused.trim_end().split_once("[[gauge.choose]] are ").expect("their names");
    options.extend(of_rules.split(", ").map(String::from));
    assert_eq!(keys, options);
}

#[test]
fn the_errors_of_the_page_are_those_of_semantics_md() {
    let page = page();
    let (_, errors) = page.split_once(".SH ERRORS").expect("ERRORS");
    let (errors, _) = errors.split_once(".SH").expect("an end");
    let page: BTreeSet<_> =
        errors.split(".TP\n.B ").skip(1).filter_map(|item| item.trim().split_once('\n')).collect();
    let semantics = fs::read_to_string(docs().join("SEMANTICS.md")).expect("SEMANTICS.md");
    let (_, table) = semantics.split_once("| errno | when |").expect("the table");
    let rows = table.lines().skip(2).take_while(|line| line.starts_with('|')).map(|line| {
        let mut cells = line.split('|').map(str::trim).skip(1);
        (cells.next().expect("an errno"), cells.next().expect("when"))
    });
    let mut count = 0;
    for (errno, when) in rows {
        let sentence = format!("{}{}.", when[..1].to_uppercase(), &when[1..]);
        assert!(page.contains(&(errno, sentence.as_str())), "{errno}: {sentence}");
        count += 1;
    }
    assert_eq!(page.len(), count, "{page:?}");
}

#[test]
fn bash_completes_commands_options_and_chips() {
    let script = Scratch::new("completions.bash", &gaugefs(&["completions", "bash"]).done());
    let complete = |words: &[&str]| {
        let last = words.len() - 1;
        let line = words.iter().map(|word| format!("'{word}'")).collect::<Vec<_>>().join(" ");
        let ask = format!(
            r#". "$0"; COMP_WORDS=({line}); COMP_CWORD={last}; _gaugefs gaugefs '{}' '{}'; echo "${{COMPREPLY[@]}}""#,
            words[last],
            words[last - 1]
        );
        said("bash", &["-c", &ask], script.path())
    };
    if let Some(commands) = complete(&["gaugefs", "umo"]) {
        assert_eq!(commands, "umount\n");
        assert_eq!(complete(&["gaugefs", "mount", "--fore"]).as_deref(), Some("--foreground\n"));
        assert_eq!(complete(&["gaugefs", "mount", "--sim", "bq351"]).as_deref(), Some("bq35100\n"));
    }
    for shell in ["zsh", "fish"] {
        for text in [gaugefs(&["completions", shell]), gaugefs_station(&["completions", shell])] {
            let script = Scratch::new(shell, &text.done());
            if let Some(complaints) = said(shell, &["-n"], script.path()) {
                assert_eq!(complaints, "", "{shell}");
            }
        }
    }
}
