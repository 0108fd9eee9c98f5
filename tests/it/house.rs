// SPDX-License-Identifier: MIT

//! The structure of the code, read from its `use` lines and paths: within each folder of modules none uses one that uses
//! it, and no test file uses another one. No crate depends on one above it.
//!
//! A module counts with everything below it, and may use its parent: what is below is a part of it. Tests within a file
//! are left out.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

mod ceilings;

/// The path of a module in its crate.
type Module = Vec<String>;

/// The modules of a crate and their text without comments and tests.
fn modules(folder: &Path) -> BTreeMap<Module, String> {
    sources(folder).into_iter().map(|(module, text)| (module, plain(&text))).collect()
}

/// The modules of a crate and their text, with the program that is named as the package.
fn sources(folder: &Path) -> BTreeMap<Module, String> {
    let mut found = BTreeMap::new();
    let mut folders = vec![(folder.to_path_buf(), Module::new())];
    while let Some((folder, parent)) = folders.pop() {
        for entry in
            fs::read_dir(folder).expect("a folder of the checkout").map(|entry| entry.expect("an entry"))
        {
            let path = entry.path();
            let stem = path.file_stem().and_then(|stem| stem.to_str()).expect("a name").to_string();
            let module = match &*stem {
                "lib" | "main" => parent.clone(),
                _ => [&parent[..], &[stem]].concat(),
            };
            if path.is_dir() {
                // Programs of their own, which `programs_only_call_the_library` looks at.
                if parent.is_empty() && module == ["bin"] {
                    continue;
                }
                folders.push((path, module));
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(path).expect("a file of the checkout");
                // A crate's library and its program are one.
                found.entry(module).or_insert_with(String::new).push_str(&text);
            }
        }
    }
    found
}

/// A text without the items that only a test has, as `rustfmt` leaves them: each ends where its indentation does.
fn without_tests(text: &str) -> String {
    let (mut found, mut lines) = (String::new(), text.lines().peekable());
    while let Some(line) = lines.next() {
        let indent = &line[..line.len() - line.trim_start().len()];
        if !(line[indent.len()..].starts_with("#[cfg(")
            && line.contains("test")
            && !line.contains("not(test"))
        {
            found += line;
            found += "\n";
            continue;
        }
        while lines.next_if(|line| line[indent.len()..].starts_with("#[")).is_some() {}
        let Some(item) = lines.next() else { break };
        if !item.ends_with([';', ',']) && !item.ends_with("{}") {
            let end = [format!("{indent}}}"), format!("{indent}}},"), format!("{indent}}};")];
            lines.find(|line| end.iter().any(|end| line == end));
        }
    }
    found
}

fn plain(text: &str) -> String {
    let product = without_tests(text);
    let lines = product.lines().map(|line| line.split("//").next().unwrap_or_default());
    lines.collect::<Vec<_>>().join("\n")
}

/// The paths that a text uses, each a list of names.
fn paths(text: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    let mut rest = String::new();
    let mut left = text;
    while let Some(at) = left.find("use ") {
        let is_word = left[..at].chars().next_back().is_none_or(|before| before.is_whitespace());
        let (head, tail) = left.split_at(at + "use ".len());
        rest += head;
        left = tail;
        if let Some(end) = tail.find(';').filter(|_| is_word) {
            expand(&[], &tail[..end], &mut found);
            left = &tail[end..];
        }
    }
    rest += left;
    for start in ["crate::", "super::"] {
        for (at, _) in rest.match_indices(start) {
            let is_name = |letter: char| letter.is_alphanumeric() || letter == '_' || letter == ':';
            if rest[..at].chars().next_back().is_some_and(is_name) {
                continue;
            }
            let path: String = rest[at..].chars().take_while(|&letter| is_name(letter)).collect();
            expand(&[], path.trim_end_matches(':'), &mut found);
        }
    }
    found
}

/// The paths of a tree such as `super::{a, b::{self, c}}`.
fn expand(prefix: &[String], tree: &str, found: &mut Vec<Vec<String>>) {
    let tree = tree.trim();
    let names = |text: &str| {
        text.split("::").map(|name| name.trim().to_string()).filter(|name| !name.is_empty()).collect()
    };
    let Some((head, inner)) = tree.split_once('{') else {
        let path: Vec<String> = names(tree.split(" as ").next().unwrap_or_default());
        return found.push([prefix, &path[..]].concat());
    };
    let head: Vec<String> = names(head);
    let prefix = [prefix, &head[..]].concat();
    let (mut depth, mut part) = (0, String::new());
    for letter in inner.strip_suffix('}').unwrap_or(inner).chars().chain([',']) {
        match letter {
            ',' if depth == 0 => {
                if !part.trim().is_empty() {
                    expand(&prefix, &part, found);
                }
                part.clear();
                continue;
            }
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        part.push(letter);
    }
}

/// For each folder of modules, which of them uses which.
fn uses(modules: &BTreeMap<Module, String>) -> BTreeMap<Module, BTreeMap<String, BTreeSet<String>>> {
    let mut all: BTreeMap<Module, BTreeMap<String, BTreeSet<String>>> = BTreeMap::new();
    for (module, text) in modules {
        if module.last().is_some_and(|name| name == "tests" || name == "rig") {
            continue;
        }
        for path in paths(text) {
            let above = path.iter().take_while(|name| *name == "super").count();
            let (mut target, names): (Module, _) = match path.first().map(String::as_str) {
                Some("crate") => (Module::new(), &path[1..]),
                Some("super") => (module[..module.len().saturating_sub(above)].to_vec(), &path[above..]),
                Some(_) => (module.clone(), &path[..]),
                None => continue,
            };
            for name in names {
                target.push(name.clone());
                if !modules.contains_key(&target) {
                    target.pop();
                    break;
                }
            }
            let shared = module.iter().zip(&target).take_while(|(one, other)| one == other).count();
            if let (Some(user), Some(used)) = (module.get(shared), target.get(shared)) {
                let folder = all.entry(module[..shared].to_vec()).or_default();
                folder.entry(user.clone()).or_default().insert(used.clone());
            }
        }
    }
    all
}

/// What a module uses, directly or by others.
fn reached(uses: &BTreeMap<String, BTreeSet<String>>, from: &str) -> BTreeSet<String> {
    let (mut seen, mut left) = (BTreeSet::new(), vec![from.to_string()]);
    while let Some(module) = left.pop() {
        for used in uses.get(&module).into_iter().flatten() {
            if seen.insert(used.clone()) {
                left.push(used.clone());
            }
        }
    }
    seen
}

/// The modules of a crate that use themselves by others.
fn circles(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for (parent, uses) in uses(&modules(folder)) {
        for module in uses.keys().filter(|module| reached(&uses, module).contains(*module)) {
            let with =
                reached(&uses, module).into_iter().filter(|other| reached(&uses, other).contains(module));
            found.push(format!(
                "{}: {}::{module} is in a circle of {:?}",
                folder.display(),
                parent.join("::"),
                with.collect::<Vec<_>>()
            ));
        }
    }
    found
}

/// The folders of the checkout with the source of a crate.
fn crates() -> Vec<std::path::PathBuf> {
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    let libraries =
        fs::read_dir(top.join("crates")).expect("crates").map(|entry| entry.expect("a crate").path());
    libraries.chain([top.to_path_buf()]).collect()
}

#[test]
fn no_module_uses_one_that_uses_it() {
    let found: Vec<String> = crates().iter().flat_map(|folder| circles(&folder.join("src"))).collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Modules of `ti-gauge` that know which byte of a number comes first: the codec, the formats of files, what is sent and
/// read as the wire has it, and what reads raw transfers.
const ORDERED: &[&str] =
    &["codec", "image", "gauge", "rom", "dataflash::schemes", "dataflash::anonymous", "chip::question"];

#[test]
fn the_order_of_bytes_is_known_to_few() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/ti-gauge/src");
    let is_known = |module: &str| {
        ORDERED.iter().any(|known| module == *known || module.starts_with(&format!("{known}::")))
    };
    let mut knowing = BTreeSet::new();
    for (module, text) in modules(&folder) {
        let module = module.join("::");
        if text.contains("be_bytes") || text.contains("le_bytes") {
            knowing.insert(module);
        }
    }
    assert!(knowing.iter().any(|module| module == "codec"), "{knowing:?}");
    let others: Vec<_> = knowing.iter().filter(|module| !is_known(module)).collect();
    assert!(others.is_empty(), "these have an order of bytes of their own: {others:?}");
}

/// What only the program may know: FUSE, and but for the crate with commands of its own, a command line.
#[test]
fn no_crate_depends_on_what_lies_above_it() {
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    for folder in crates().iter().filter(|folder| *folder != top) {
        let text = fs::read_to_string(folder.join("Cargo.toml")).expect("a manifest");
        let table: toml::Table = text.parse().expect("TOML");
        let name = folder.file_name().and_then(|name| name.to_str()).expect("a name");
        let above: &[&str] = match name {
            "gaugefs-screen" => &["fuser", "gaugefs", "gauge-owner", "gauge-station"],
            "gauge-station" => &["fuser", "clap", "gaugefs", "gaugefs-screen"],
            "gauge-owner" => &["fuser", "clap", "gaugefs", "gaugefs-screen", "gauge-station"],
            _ => &["fuser", "clap", "gaugefs", "gaugefs-screen", "gauge-station", "gauge-owner"],
        };
        let uses = table["dependencies"].as_table().expect("dependencies");
        let found: Vec<_> = above.iter().filter(|above| uses.contains_key(**above)).collect();
        assert!(found.is_empty(), "{name} depends on {found:?}");
    }
}

/// The station is a program of its own: what it is made of is used by no other module, so that it is in no other program.
#[test]
fn only_the_station_is_made_of_the_station() {
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    let modules = modules(&top.join("src"));
    let of_station = |module: &Module| module.first().is_some_and(|first| first == "station");
    let users: Vec<_> =
        modules.iter().filter(|(_, text)| text.contains("gauge_station")).map(|(module, _)| module).collect();
    assert!(users.len() > 2 && users.iter().all(|module| of_station(module)), "{users:?}");
    let uses = uses(&modules);
    let users: Vec<_> = uses[&Module::new()].iter().filter(|(_, used)| used.contains("station")).collect();
    assert!(users.is_empty(), "{users:?}");
}

#[test]
fn programs_only_call_the_library() {
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    let others =
        fs::read_dir(top.join("src/bin")).expect("other programs").map(|entry| entry.expect("one").path());
    for path in others.chain([top.join("src/main.rs")]) {
        let text = fs::read_to_string(&path).expect("a program");
        let calls: Vec<_> = text.matches("gaugefs::").collect();
        assert!(calls.len() == 1 && text.lines().count() < 12, "{}", path.display());
    }
}

#[test]
fn no_test_file_uses_another_one() {
    const SHARED: [&str; 5] = ["room", "rig", "bench", "firmware", "drawn"];
    for folder in crates().iter().map(|folder| folder.join("tests/it")).filter(|folder| folder.is_dir()) {
        for (user, used) in uses(&modules(&folder)).get(&Module::new()).into_iter().flatten() {
            let others: Vec<_> = used.iter().filter(|used| !SHARED.contains(&used.as_str())).collect();
            assert!(others.is_empty(), "{}: {user} uses {others:?}", folder.display());
        }
    }
}

#[test]
fn a_circle_is_found() {
    let text = |text: &str| plain(text);
    let modules = BTreeMap::from([
        (vec!["a".to_string()], text("use super::{b::{self, Thing}, c};\n")),
        (vec!["b".to_string()], text("// crate::a is a comment\nfn x() { crate::c::deep::y() }\n")),
        (vec!["c".to_string()], String::new()),
        (vec!["c".to_string(), "deep".to_string()], text("use crate::a::Z;\n#[cfg(test)]\nmod tests {}")),
    ]);
    let uses = uses(&modules);
    let top = &uses[&Module::new()];
    let found = |module: &str| reached(top, module).contains(module);
    assert!(found("a") && found("b") && found("c"), "{top:?}");
    let modules: BTreeMap<_, _> = modules.into_iter().filter(|(module, _)| module.len() == 1).collect();
    let uses = self::uses(&modules);
    assert!(!reached(&uses[&Module::new()], "a").contains("a"), "{uses:?}");
}

/// A file that no module declares is not compiled: whoever repairs it repairs nothing.
#[test]
fn every_source_file_is_a_module() {
    let mut found = Vec::new();
    for folder in crates().iter().flat_map(|folder| [folder.join("src"), folder.join("tests/it")]) {
        if !folder.is_dir() {
            continue;
        }
        let sources = sources(&folder);
        for (name, parent) in sources.keys().filter_map(|module| module.split_last()) {
            let line = format!("mod {name};");
            let declares = |text: &String| text.lines().any(|declared| declared.ends_with(&line));
            if !sources.get(parent).is_some_and(declares) {
                found.push(folder.join(parent.join("/")).join(name));
            }
        }
    }
    assert!(found.is_empty(), "no module declares {found:?}");
}

/// The places in a text where the words of a message are compared with words of the program: the name of what is compared.
fn compared(text: &str) -> Vec<&str> {
    const MESSAGES: [&str; 11] = [
        "cause",
        "error",
        "failure",
        "last_error",
        "message",
        "reason",
        "refused",
        "said",
        "told",
        "warning",
        "why",
    ];
    const COMPARISONS: [&str; 7] = [
        ".contains(\"",
        ".starts_with(\"",
        ".ends_with(\"",
        ".find(\"",
        ".strip_prefix(\"",
        " == \"",
        " != \"",
    ];
    let places = COMPARISONS.iter().flat_map(|comparison| text.match_indices(comparison));
    let named = places.filter_map(|(at, _)| {
        let mut before = text[..at].trim_end();
        // Whatever is called on it, such as `to_string()`, is still the message.
        while let Some(call) = before.strip_suffix("()") {
            before = call.rsplit_once('.')?.0.trim_end();
        }
        let start = before.rfind(|letter: char| !letter.is_alphanumeric() && letter != '_');
        Some(&before[start.map_or(0, |start| start + 1)..])
    });
    named.filter(|name| MESSAGES.contains(name)).collect()
}

/// An error has a cause and facts. Whoever compared its words instead would decide otherwise when they are improved.
#[test]
fn nothing_is_decided_by_the_words_of_a_message() {
    // fusermount3 says in words only why it has not unmounted.
    const OF_OTHERS: [(&str, &str); 1] = [("daemon/mountpoint", "said")];
    let mut found = Vec::new();
    for folder in crates() {
        for (module, text) in modules(&folder.join("src")) {
            let name = module.join("/");
            if module.iter().any(|name| name == "tests" || name == "rig") {
                continue;
            }
            let compared = compared(&text).into_iter().filter(|one| !OF_OTHERS.contains(&(&name, one)));
            found.extend(
                compared.map(|one| format!("{}: {name} compares the words of {one}", folder.display())),
            );
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn a_comparison_of_words_is_found() {
    for (text, name) in [
        ("if error.to_string().contains(\"seal\") {", "error"),
        ("published.last_error.starts_with(\"x\")", "last_error"),
        ("told.trim() != \"nothing to settle\"", "told"),
        ("said\n    .to_lowercase()\n    .contains(\"busy\")", "said"),
    ] {
        assert_eq!(compared(text), [name], "{text}");
    }
    for text in
        ["name.contains(\"x\")", "error.cause() == Cause::Gone", "seal.trim() == \"sealed\"", "why(\"x\")"]
    {
        assert_eq!(compared(text), [""; 0], "{text}");
    }
}

/// The types of a text that are errors, by `impl` or `derive`.
fn errors(text: &str) -> BTreeSet<String> {
    let is_name = |letter: char| letter.is_alphanumeric() || letter == '_';
    let first = |text: &str| text.chars().take_while(|&letter| is_name(letter)).collect::<String>();
    let by_impl = text.match_indices("Error for ").filter_map(|(at, found)| {
        let head = text[..at].rsplit("impl").next()?;
        // The trait of that name, with or without a path, not `From<Error>` or `MyError`.
        let is_trait = head.ends_with(' ') || head.ends_with("::");
        (is_trait && !head.contains(['{', ';'])).then(|| first(&text[at + found.len()..]))
    });
    let by_derive = text.split("#[derive(").skip(1).filter_map(|rest| {
        let (traits, rest) = rest.split_once(")]")?;
        let is_error = traits.split(',').any(|name| name.trim().rsplit("::").next() == Some("Error"));
        let (_, item) = rest
            .split_once("struct ")
            .into_iter()
            .chain(rest.split_once("enum "))
            .min_by_key(|(before, _)| before.len())?;
        is_error.then(|| first(item))
    });
    by_impl.chain(by_derive).collect()
}

/// A failure is passed on as it is: a type around another one would repeat its methods. What a crate has to add is a
/// reason with facts, or a field.
#[test]
fn few_types_are_errors() {
    let mut found = BTreeSet::new();
    for folder in crates() {
        let name = folder.file_name().and_then(|name| name.to_str()).expect("a name").to_string();
        for text in modules(&folder.join("src")).values() {
            found.extend(errors(text).into_iter().map(|error| format!("{name}: {error}")));
        }
    }
    let known = ["gauge-bus: BusError", "gauge-bus: Error", "gaugefs-client: Error", "ti-gauge: Error"];
    assert_eq!(found, known.map(String::from).into());
}

#[test]
fn an_error_type_is_found() {
    for text in [
        "impl std::error::Error for Own {}",
        "impl<T: Debug> Error for Own<T> {",
        "#[derive(Debug, thiserror::Error)]\n#[error(\"x\")]\npub enum Own {",
        "#[derive(Error)] struct Own(u8); enum Other {}",
    ] {
        assert_eq!(errors(text), BTreeSet::from(["Own".to_string()]), "{text}");
    }
    for text in
        ["impl From<Error> for Own {", "impl fmt::Display for Error {", "#[derive(Debug)] struct Error;"]
    {
        assert_eq!(errors(text), BTreeSet::new(), "{text}");
    }
}

/// The functions of a text that are named as questions and answer nothing.
fn questions_without_answer(text: &str) -> Vec<&str> {
    const QUESTIONS: [&str; 9] = ["are_", "can_", "did_", "had_", "has_", "is_", "may_", "needs_", "was_"];
    let functions = text.split("fn ").skip(1).filter_map(|function| {
        let end = function.find(|letter: char| !letter.is_alphanumeric() && letter != '_')?;
        let (name, rest) = function.split_at(end);
        // An arrow within parentheses is that of an argument, and a semicolon within brackets that of an array.
        let (mut depth, mut head) = (0, String::new());
        for letter in rest.chars() {
            match letter {
                '{' => break,
                ';' if depth == 0 => break,
                '(' | '[' => depth += 1,
                ')' | ']' => depth -= 1,
                _ if depth == 0 => head.push(letter),
                _ => {}
            }
        }
        let answers = head.contains("-> ") && !head.contains("-> Result<>");
        let is_question = QUESTIONS.iter().any(|question| name.starts_with(question));
        (is_question && !answers).then_some(name)
    });
    functions.collect()
}

/// A call has to show that it changes something: what only changes is named by a verb.
#[test]
fn what_is_named_as_a_question_has_an_answer() {
    let mut found = Vec::new();
    for folder in crates() {
        for (module, text) in modules(&folder.join("src")) {
            if !module.iter().any(|name| name == "tests" || name == "rig") {
                let place = folder.join("src").join(module.join("/"));
                found.extend(
                    questions_without_answer(&text).iter().map(|name| format!("{}: {name}", place.display())),
                );
            }
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn a_question_without_answer_is_found() {
    for text in [
        "pub fn is_gone(&mut self) {",
        "fn is_gone<T>(\n    list: impl Fn(u8) -> bool,\n) where T: Copy {",
        "pub(super) const fn is_gone(&self);",
        "fn is_gone(&self) -> Result<()> {",
    ] {
        assert_eq!(questions_without_answer(text), ["is_gone"], "{text}");
    }
    for text in
        ["fn is_gone(&self) -> bool {", "fn goes(&mut self) {", "fn has(\n    at: u8,\n) -> Option<()> {"]
    {
        assert_eq!(questions_without_answer(text), [""; 0], "{text}");
    }
}

/// What is known of a gauge, or owed to it, is set by its room alone: few files have methods that reach all rooms of the engine,
/// or of an owner, and no field of a room is public.
#[test]
fn the_state_of_a_gauge_is_in_rooms() {
    const WHOLE: [(&str, &str, usize, &[&str]); 2] = [
        ("ti-gauge", "DataFlash", 3, &["Knowledge", "Debts", "Records", "Rules"]),
        (
            "gauge-owner",
            "Owner",
            4,
            &[
                "Access", "Backups", "Debt", "Identity", "Learning", "Memory", "Profile", "Readings",
                "Schedule", "Turn",
            ],
        ),
    ];
    for (name, whole, most, rooms) in WHOLE {
        let crate_ = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates").join(name);
        let modules = modules(&crate_.join("src"));
        let with = |line: &str| -> Vec<String> {
            let has = |text: &str| text.lines().any(|other| other == line);
            modules.iter().filter(|(_, text)| has(text)).map(|(name, _)| name.join("/")).collect()
        };
        let reach_all = with(&format!("impl {whole} {{"));
        assert!((1..=most).contains(&reach_all.len()), "{whole}: {reach_all:?}");
        for room in rooms.iter().chain([&whole]) {
            let start = format!("struct {room} {{\n");
            let fields: Vec<&str> =
                modules.values().filter_map(|text| text.split(&*start).nth(1)?.split("\n}").next()).collect();
            assert!(fields.len() == 1 && fields[0].contains(": "), "{room}: {fields:?}");
            let is_public = fields[0].lines().any(|field| field.trim_start().starts_with("pub"));
            assert!(!is_public, "{room} has a field that others reach: {}", fields[0]);
            assert!(*room == whole || with(&format!("impl {room} {{")).len() <= 3, "{room} is no room");
        }
    }
}

/// A function with the whole owner as an argument is a method in disguise: only the calls of operations have it.
#[test]
fn an_owner_is_passed_to_operations_only() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/gauge-owner/src");
    let modules = modules(&folder);
    let users: Vec<_> = modules
        .iter()
        .filter(|(module, text)| {
            let is_test = module.iter().any(|name| name == "tests" || name == "rig");
            !is_test && text.contains("&mut Owner")
        })
        .map(|(module, _)| module.join("/"))
        .collect();
    assert_eq!(users, ["owner/operation"]);
}

/// Every file below a folder, but for what a build makes and what git keeps.
fn files(folder: &Path, found: &mut Vec<std::path::PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of the checkout") {
        let path = entry.expect("an entry").path();
        if path.is_symlink() || path.ends_with("target") || path.ends_with(".git") {
            continue;
        } else if path.is_dir() {
            files(&path, found);
        } else {
            found.push(path);
        }
    }
}

/// The blocks of doc comments in a text, each on one line.
fn doc_comments(text: &str) -> Vec<String> {
    let mut found = vec![String::new()];
    for line in text.lines().map(str::trim_start) {
        match line.strip_prefix("///").or_else(|| line.strip_prefix("//!")) {
            Some(comment) => found.last_mut().expect("it begins with one").push_str(comment),
            None => found.push(String::new()),
        }
    }
    found.retain(|comment| !comment.is_empty());
    found
}

/// The words of a comment that an engineer reads twice.
fn hard_words(comment: &str) -> Option<&'static str> {
    const HARD: [&str; 4] = ["of which", "whoever", "is none", "likewise"];
    let comment = comment.to_lowercase();
    HARD.into_iter().find(|hard| {
        let is_end = |letter: Option<char>| letter.is_none_or(|letter| !letter.is_alphanumeric());
        comment.match_indices(hard).any(|(at, _)| {
            is_end(comment[..at].chars().next_back()) && is_end(comment[at + hard.len()..].chars().next())
        })
    })
}

#[test]
fn doc_comments_are_understood_at_the_first_reading() {
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut paths, mut found) = (Vec::new(), Vec::new());
    crates().iter().for_each(|folder| files(&folder.join("src"), &mut paths));
    for path in paths {
        let name = path.strip_prefix(top).expect("below the checkout").to_string_lossy().into_owned();
        if name.contains("/tests") {
            continue;
        }
        let text = fs::read_to_string(&path).expect("a file of the checkout");
        let comments = doc_comments(&without_tests(&text));
        found.extend(
            comments
                .iter()
                .filter_map(|comment| Some(format!("{name}: {}: {comment}", hard_words(comment)?))),
        );
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn a_hard_word_is_found() {
    let text =
        "/// Two bytes, of\n/// which one is 0.\nlet likewise = 1; // whoever\n//! This is nonetheless fine.";
    let comments = doc_comments(text);
    assert_eq!(comments.len(), 2, "{comments:?}");
    assert_eq!(comments.iter().map(|one| hard_words(one)).collect::<Vec<_>>(), [Some("of which"), None]);
}

/// A module of tests that is longer hides the code before it, and has a file of its own.
#[test]
fn test_modules_within_a_file_are_short() {
    const LONGEST: usize = 300;
    let (mut paths, mut found) = (Vec::new(), Vec::new());
    crates().iter().for_each(|folder| files(&folder.join("src"), &mut paths));
    for path in paths {
        let text = fs::read_to_string(&path).expect("a file of the checkout");
        let tests =
            text.split_once("\n#[cfg(test)]\nmod tests {\n").map_or(0, |(_, tests)| tests.lines().count());
        if tests > LONGEST {
            found.push(format!("{}: {tests} lines of tests", path.display()));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Whether a file is a program or a part of one, by its name and its first lines. What data there is, `REUSE.toml` covers.
fn is_source(path: &Path, text: &[u8]) -> bool {
    const SOURCE: [&str; 7] = ["asl", "awk", "conf", "rs", "rules", "service", "sh"];
    let extension = path.extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|extension| SOURCE.contains(&extension)) || text.starts_with(b"#!")
}

#[test]
fn every_source_file_says_its_license() {
    // In two parts, so that REUSE does not take it for this file's.
    let tag = ["SPDX", "License", "Identifier: MIT"].join("-");
    let lines = ["//", "#"].map(|mark| format!("{mark} {tag}"));
    let mut all = Vec::new();
    files(Path::new(env!("CARGO_MANIFEST_DIR")), &mut all);
    let (mut sources, mut without) = (0, Vec::new());
    for path in all {
        let text = fs::read(&path).expect("a file of the checkout");
        if !is_source(&path, &text) {
            continue;
        }
        sources += 1;
        let head = String::from_utf8_lossy(&text[..text.len().min(200)]).into_owned();
        if !head.lines().take(2).any(|line| lines.iter().any(|one| one == line)) {
            without.push(path);
        }
    }
    assert!(sources > 400, "{sources}");
    assert!(without.is_empty(), "these need a line such as {:?}: {without:?}", lines[0]);
}

/// What a reader of crates.io and of docs.rs looks for.
#[test]
fn every_crate_is_ready_to_be_published() {
    let mut texts = BTreeMap::new();
    for folder in crates() {
        let read = |name: &str| fs::read_to_string(folder.join(name)).expect(name);
        let manifest: toml::Table = read("Cargo.toml").parse().expect("TOML");
        let package = manifest["package"].as_table().expect("a package");
        let name = package["name"].as_str().expect("a name");
        for key in ["description", "license", "repository", "rust-version"] {
            assert!(package.contains_key(key), "{name} has no {key}");
        }
        let count = |key: &str| package[key].as_array().map_or(0, Vec::len);
        assert!((1..=5).contains(&count("keywords")) && (1..=5).contains(&count("categories")), "{name}");
        let targets = package["metadata"]["docs"]["rs"]["targets"].as_array();
        assert_eq!(targets.map(Vec::len), Some(1), "{name} says nothing to docs.rs");
        assert!(read("LICENSE").contains("Permission is hereby granted"), "{name}");
        let readme = read("README.md");
        assert!(readme.starts_with(&format!("# {name}\n")), "{name}");
        let library = read("src/lib.rs");
        let front: String = library.lines().filter(|line| line.starts_with("//!")).collect();
        assert!(front.contains("```"), "{name} has no example on its front page");
        for feature in manifest.get("features").and_then(toml::Value::as_table).into_iter().flatten() {
            let named = feature.0 == "default" || front.contains(&format!("`{}`", feature.0));
            assert!(named, "{name} does not say what its feature {} is", feature.0);
        }
        // What is published together refers to each other by version; what only tests need may be anything.
        for (other, value) in manifest["dependencies"].as_table().expect("dependencies") {
            let path = value.get("path").is_some();
            assert!(!path || value.get("version").is_some(), "{name} needs a version of {other}");
        }
        texts.insert(name.to_string(), readme);
    }
    assert_eq!(texts.len(), fs::read_dir("crates").expect("the crates").count() + 1);
}

/// The code of a text: without comments, without what is in strings, and without tests.
fn code(text: &str) -> String {
    let product = without_tests(text);
    let (mut found, mut letters) = (String::new(), product.chars().peekable());
    while let Some(letter) = letters.next() {
        match letter {
            '/' if letters.peek() == Some(&'/') => {
                letters.by_ref().find(|&letter| letter == '\n');
                found.push('\n');
            }
            '"' => {
                while let Some(letter) = letters.next().filter(|&letter| letter != '"') {
                    if letter == '\\' {
                        letters.next();
                    }
                }
                found.push_str("\"\"");
            }
            // A quotation mark as a letter, not the beginning of a string.
            '\'' if letters.peek() == Some(&'"') => {
                letters.next();
            }
            _ => found.push(letter),
        }
    }
    found
}

/// Whether code names a field: a call of that name is not one.
fn names_field(code: &str, before: &[&str], field: &str) -> bool {
    let is_word = |letter: char| letter.is_alphanumeric() || letter == '_';
    code.match_indices(field).any(|(at, _)| {
        let (head, tail) = (&code[..at], &code[at + field.len()..]);
        let is_whole = !head.ends_with(is_word) && !tail.starts_with(is_word);
        is_whole
            && !tail.starts_with('(')
            && !tail.starts_with("::")
            && (before.is_empty() || before.iter().any(|before| head.ends_with(before)))
    })
}

/// The product's files but for the simulator's, which knows no options, by their paths in the checkout, and their code.
fn product() -> BTreeMap<String, String> {
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = Vec::new();
    let folders = crates().into_iter().filter(|folder| !folder.ends_with("gauge-sim"));
    folders.for_each(|folder| files(&folder.join("src"), &mut all));
    let named = all.into_iter().filter_map(|path| {
        let name = path.strip_prefix(top).ok()?.to_str()?.to_string();
        let is_test = name.contains("/tests/") || name.contains("/rig/") || name.ends_with("/tests.rs");
        (name.ends_with(".rs") && !is_test && !name.ends_with("/rig.rs") && !name.ends_with("/wire.rs"))
            .then(|| (name, code(&fs::read_to_string(&path).expect("a file of the checkout"))))
    });
    named.collect()
}

/// Options of gauges are passed on as one value. An option is declared where the crates of its use can see it, has a row
/// in the program, whose command line they cannot, and stands in the file that uses it.
#[test]
fn an_option_of_a_gauge_stands_in_its_row_and_at_its_use() {
    const DECLARED: &str = "crates/gauge-owner/src/options.rs";
    const ROWS: &str = "src/config/options.rs";
    /// Other things of the same name, and what has to be known of an option before there is a gauge.
    const OTHERS: &[(&str, &[(&str, &str)])] = &[
        ("what is shown of it", &[("ask_the_pack", "crates/gauge-owner/src/owner/handle.rs")]),
        (
            "of a command",
            &[
                ("allow_unproven", "src/cli/import.rs"),
                ("byte_writes", "src/cli/probe.rs"),
                ("byte_writes", "src/cli/unmounted.rs"),
                ("key_file", "src/cli/auth.rs"),
                ("key_file", "src/cli/doctor/config.rs"),
                ("key_file", "src/cli/keys.rs"),
                ("key_file", "src/cli/unmounted.rs"),
                ("no_default_keys", "src/cli/unmounted.rs"),
                ("replay", "src/cli/check.rs"),
                ("scenario_seed", "src/cli/sim.rs"),
            ],
        ),
        (
            "of a bus that the device tree names",
            &[
                ("address", "src/config/node.rs"),
                ("bus", "src/config/node.rs"),
                ("chip", "src/config/node.rs"),
            ],
        ),
        ("for the gauges of a file that name none", &[("bus", "src/cli/mount.rs")]),
        ("for what its rules name", &[("choose", "src/config/choice.rs")]),
        ("of a file, where no two gauges have the same", &[("name", "src/config/file.rs")]),
        (
            "of something else",
            &[
                ("chip", "crates/gauge-owner/src/owner/handle.rs"),
                ("name", "crates/gauge-owner/src/source.rs"),
                ("name", "crates/gauge-station/src/setup.rs"),
                ("name", "src/daemon/node.rs"),
            ],
        ),
        (
            "of what it becomes below the owner",
            &[
                ("allow_learning", "crates/ti-gauge/"),
                ("key_file", "crates/gauge-owner/src/owner.rs"),
                ("key_file", "crates/ti-gauge/"),
                ("writes_per_hour", "crates/ti-gauge/"),
            ],
        ),
        (
            "of what it becomes in an attribute, with the gauge's own scale",
            &[
                ("absolute_current", "src/fs/attribute.rs"),
                ("current_scale", "crates/gauge-owner/src/owner/operation.rs"),
                ("current_scale", "crates/gauge-owner/src/owner/words.rs"),
                ("current_scale", "src/fs/supply.rs"),
                ("voltage_scale", "crates/gauge-owner/src/owner/operation.rs"),
                ("voltage_scale", "crates/gauge-owner/src/owner/words.rs"),
                ("voltage_scale", "src/fs/supply.rs"),
            ],
        ),
    ];
    let product = product();
    let fields =
        product[DECLARED].lines().filter_map(|line| line.strip_prefix("    pub ")?.split(": ").next());
    let fields: Vec<&str> = fields.collect();
    assert!(fields.len() >= 30, "{fields:?}");
    let (mut found, mut seen) = (Vec::new(), BTreeSet::<&(&str, &str)>::new());
    for field in fields {
        assert!(names_field(&product[ROWS], &["to."], field), "{field} has no row");
        let mut stands = Vec::new();
        for (file, code) in product.iter().filter(|(file, _)| *file != DECLARED && *file != ROWS) {
            // A name of one word is one of many other things.
            let names = match field.contains('_') {
                true => names_field(code, &["."], field) || code.contains(&format!(" {field}: ")),
                false => {
                    let before = ["options.", "gauge.", "self."];
                    let before = if code.contains("impl GaugeOptions {") { &before } else { &before[..2] };
                    code.contains("GaugeOptions") && names_field(code, before, field)
                }
            };
            let mut listed = OTHERS.iter().flat_map(|(_, others)| *others);
            let other = listed.find(|(name, place)| *name == field && file.starts_with(place));
            match names {
                true if other.is_some() => seen.extend(other),
                true => stands.push(file),
                false => {}
            }
        }
        if stands.len() > 1 {
            found.push(format!("{field} stands in {stands:?}"));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
    let listed = OTHERS.iter().flat_map(|(_, others)| *others);
    let gone: Vec<_> = listed.filter(|other| !seen.contains(*other)).collect();
    assert!(gone.is_empty(), "not there any more: {gone:?}");
}

#[test]
fn a_field_is_found_in_code() {
    let text = "let x = \"key_file\"; // key_file\nlet c = '\"'; to.key_file = y;\n#[cfg(test)]\nmod tests { secret }";
    let code = code(text);
    assert!(names_field(&code, &["to."], "key_file") && !names_field(&code, &["options."], "key_file"));
    for absent in ["file", "secret", "key"] {
        assert!(!names_field(&code, &[], absent), "{absent}: {code}");
    }
    assert!(!names_field("options.key_file()", &[], "key_file"));
}

/// The numbers in a line of code, as they are written, with their values.
fn numbers(line: &str) -> Vec<(&str, u64)> {
    let is_word = |letter: char| letter.is_alphanumeric() || letter == '_';
    let words =
        line.split("..").flat_map(|part| part.split(|letter: char| !is_word(letter) && letter != '.'));
    // Fractions are left out.
    let whole = |word| {
        let (head, rest): (&str, &str) = str::split_once(word, '.').unwrap_or((word, ""));
        (!rest.starts_with(|digit: char| digit.is_ascii_digit())).then_some(head)
    };
    let value = |word: &str| {
        let plain = word.replace('_', "");
        let (digits, radix) = match plain.get(..2) {
            Some("0x") => (&plain[2..], 16),
            Some("0b") => (&plain[2..], 2),
            Some("0o") => (&plain[2..], 8),
            _ => (&plain[..], 10),
        };
        let is_type = |rest: &str| rest.is_empty() || rest.starts_with(['u', 'i']);
        let end = digits.find(|digit: char| !digit.is_digit(radix)).unwrap_or(digits.len());
        let number = u64::from_str_radix(&digits[..end], radix).ok();
        number.filter(|_| is_type(&digits[end..]))
    };
    words.filter_map(whole).filter_map(|word| Some((word, value(word)?))).collect()
}

/// What is on the wire is behind one wall: the registers of selection and window are named where a dialect, a scheme of
/// access or the reader of FlashStreams is, and in tables. A further family is then no change to anything else.
#[test]
fn registers_of_block_access_stand_behind_the_dialect() {
    const REGISTERS: std::ops::RangeInclusive<u64> = 0x3e..=0x61;
    const BEHIND: [&str; 4] = [
        "ti-gauge chip/",
        "ti-gauge gauge/dialect/map",
        "ti-gauge dataflash/schemes/",
        "ti-gauge image/flashstream",
    ];
    /// Other numbers of that size: where they stand, and how often.
    const OTHERS: [(&str, &str, usize); 28] = [
        // The address of all gauges.
        ("gauge-bus ", "0x55", 1),
        // Subclasses.
        ("ti-gauge dataflash/anonymous", "64", 1),
        ("ti-gauge dataflash/anonymous", "68", 1),
        // Subcommands and their bits.
        ("ti-gauge chip", "0x0041", 1),
        ("ti-gauge learning", "0x0040", 1),
        // Times.
        ("gauge-bus linux/target", "66", 1),
        ("gauge-owner owner/crew/races", "90", 2),
        ("ti-gauge dataflash/io", "80", 1),
        ("ti-gauge dataflash/session", "80", 1),
        ("ti-gauge gauge/seal", "80", 1),
        ("ti-gauge gauge/wire", "66", 1),
        // Lengths of texts, histories, stacks, integers and rows of ROM.
        ("gauge-bus bounded", "64", 1),
        ("gauge-owner evidence", "64", 1),
        ("ti-gauge check/history", "64", 1),
        ("ti-gauge journal/machine", "64", 1),
        ("ti-gauge keys", "64", 1),
        ("ti-gauge registers", "64", 1),
        ("ti-gauge text", "64", 1),
        ("ti-gauge rom", "96", 1),
        // Bytes of a firmware's marks.
        ("ti-gauge rom", "0x3f", 1),
        ("ti-gauge rom", "0x54", 2),
        // A host's register, and the addresses that it protects.
        ("gauge-bus linux/spd", "0x40", 1),
        ("gauge-bus linux/spd", "0x50", 1),
        ("gauge-bus linux/spd", "0x57", 1),
        // The kernel's number of its I2C devices, and permissions of files.
        ("gauge-bus linux", "89", 1),
        ("gauge-owner key_file", "0o077", 1),
        // Transfers.
        ("gauge-owner owner/wire/costs", "94", 2),
        ("gauge-owner lock", "0o077", 1),
    ];
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found: BTreeMap<(String, String), usize> = BTreeMap::new();
    for name in ["ti-gauge", "gauge-bus", "gauge-owner"] {
        for (module, text) in modules(&top.join("crates").join(name).join("src")) {
            let place = format!("{name} {}", module.join("/"));
            let is_test = module.last().is_some_and(|name| name == "tests" || name == "rig");
            if is_test || BEHIND.iter().any(|behind| place.starts_with(behind)) {
                continue;
            }
            for line in code(&text).lines() {
                for (number, _) in numbers(line).into_iter().filter(|(_, value)| REGISTERS.contains(value)) {
                    *found.entry((place.clone(), number.to_string())).or_default() += 1;
                }
            }
        }
    }
    let others = OTHERS.map(|(place, number, count)| ((place.to_string(), number.to_string()), count));
    let others = BTreeMap::from(others);
    let outside: Vec<_> = found.iter().filter(|(key, count)| others.get(key) != Some(count)).collect();
    assert!(outside.is_empty(), "a register of block access, or another number of that size? {outside:?}");
    let gone: Vec<_> = others.keys().filter(|key| !found.contains_key(key)).collect();
    assert!(gone.is_empty(), "no longer there: {gone:?}");
}

#[test]
fn a_number_is_found_in_any_notation() {
    let values = |line: &str| numbers(line).into_iter().map(|(_, value)| value).collect::<Vec<_>>();
    assert_eq!(values("const A: u8 = 0x3e; [0x3E, 62, 0b11_1110, 0o76u8, 62u8, 0x3E_u16]"), [62; 7]);
    assert_eq!(
        values("x62 + 0x3eff - 62.5 + 62f(0x40..0x60).0 + 0x3e.max(1)"),
        [0x3eff, 0x40, 0x60, 0x3e, 1]
    );
}
