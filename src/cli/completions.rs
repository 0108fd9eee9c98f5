// SPDX-License-Identifier: MIT

//! `gaugefs completions`.

use std::process::ExitCode;

use clap::{ArgGroup, Args, CommandFactory, Id};
use clap_complete::Shell;

use super::Cli;
use crate::error::Result;
use crate::output::print_file;

const COMPLETIONS: &str = "\
The Debian package installs the completions for bash, zsh and fish.

Example:
  gaugefs completions bash > ~/.local/share/bash-completion/completions/gaugefs";

/// Generate shell completions
#[derive(Args, Debug)]
#[command(after_help = COMPLETIONS)]
pub(super) struct Completions {
    /// Shell to generate them for
    shell: Shell,
}

impl Completions {
    pub(super) fn run(self) -> Result<ExitCode> {
        print_file(script(self.shell).as_bytes())?;
        Ok(ExitCode::SUCCESS)
    }
}

pub(super) fn script(shell: Shell) -> String {
    let mut script = Vec::new();
    let mut typed = typed(&Cli::command()).version(env!("CARGO_PKG_VERSION"));
    clap_complete::generate(shell, &mut typed, "gaugefs", &mut script);
    with_names(shell, &String::from_utf8_lossy(&script))
}

/// A command without what nobody types, because other programs call it.
fn typed(command: &clap::Command) -> clap::Command {
    let arguments: Vec<_> = command.get_arguments().filter(|argument| !argument.is_hide_set()).collect();
    let groups = command.get_groups().map(|group| {
        let is_there = |id: &&Id| arguments.iter().any(|argument| argument.get_id() == *id);
        let members: Vec<&Id> = group.get_args().filter(is_there).collect();
        ArgGroup::new(group.get_id().clone()).multiple(true).args(members)
    });
    let commands = command.get_subcommands().filter(|command| !command.is_hide_set());
    // clap keeps names that the program has; this one ends when the script is printed.
    let name: &str = command.get_name().to_string().leak();
    clap::Command::new(name)
        .about(command.get_about().cloned().unwrap_or_default())
        .groups(groups)
        .args(arguments.iter().copied())
        .subcommands(commands.map(typed))
}

/// The script, with the names of parameters after the gauge of `get` and `set`. `gaugefs names` knows them, and answers within
/// 5 s whatever the mount does.
fn with_names(shell: Shell, script: &str) -> String {
    match shell {
        Shell::Bash => format!("{script}{BASH}"),
        // The two commands alone have this hint.
        Shell::Zsh => script.replace(":_hosts", ":_gaugefs_names").replacen("#compdef gaugefs\n", ZSH, 1),
        Shell::Fish => format!("{script}{FISH}"),
        _ => script.to_string(),
    }
}

const BASH: &str = r#"
_gaugefs_names() {
    local word="${COMP_WORDS[COMP_CWORD]}" gauge at end=
    case ${COMP_WORDS[1]} in set) end='=' ;; get) ;; *) _gaugefs "$@"; return ;; esac
    for ((at = 2; at < COMP_CWORD; at++)); do
        [[ ${COMP_WORDS[at]} == = ]] && return
        [[ -z $gauge && ${COMP_WORDS[at]} != -* ]] && gauge=${COMP_WORDS[at]}
    done
    if [[ -z $gauge || $word == [-/.]* ]]; then
        _gaugefs "$@"
        return
    fi
    [[ $word == *=* ]] && return
    mapfile -t COMPREPLY < <(compgen -S "$end" -W "$(gaugefs names -- "$gauge" 2>/dev/null)" -- "$word")
    [[ -n $end ]] && compopt -o nospace 2>/dev/null
}
complete -F _gaugefs_names -o nosort -o bashdefault -o default gaugefs 2>/dev/null ||
    complete -F _gaugefs_names -o bashdefault -o default gaugefs
"#;

const ZSH: &str = r#"#compdef gaugefs

_gaugefs_names() {
    local gauge=${words[(r)[/.]*]}
    local -a names
    if [[ -n $gauge && $PREFIX != [/.]* ]]; then
        names=(${(f)"$(gaugefs names -- $gauge 2>/dev/null)"})
        if [[ $curcontext == *-command-set:* ]]; then
            compadd -S = -- $names
        else
            compadd -- $names
        fi
    fi
    _files -/
}
"#;

const FISH: &str = r#"
function __gaugefs_names
    set -l words (commandline -opc)
    set -l gauge (string match -r '^[/.].*' -- $words)[1]
    test -n "$gauge"; or return
    set -l end ''
    contains -- set $words; and set end =
    for name in (gaugefs names -- $gauge 2>/dev/null)
        echo $name$end
    end
end
complete -c gaugefs -n "__fish_seen_subcommand_from get set" -a "(__gaugefs_names)"
"#;

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn what_other_programs_call_is_not_completed() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let script = script(shell);
            for command in Cli::command().get_subcommands() {
                // In the names of other commands and options there may be such a word, too.
                let is_line = |wanted: String| script.lines().any(|line| line.trim() == wanted);
                let is_there = match shell {
                    Shell::Bash => script.contains(&format!("gaugefs,{})", command.get_name())),
                    Shell::Zsh => is_line(format!("({})", command.get_name())),
                    _ => script.contains(&format!("-a \"{}\"", command.get_name())),
                };
                assert_eq!(is_there, !command.is_hide_set(), "{shell}: {}", command.get_name());
            }
        }
    }

    #[test]
    fn regression_options_that_other_programs_pass_were_completed() {
        let names = |is_hidden: bool| -> BTreeSet<String> {
            let all = Cli::command();
            let of = |command: &clap::Command| command.get_arguments().cloned().collect::<Vec<_>>();
            let arguments = all.get_subcommands().filter(|command| !command.is_hide_set()).flat_map(of);
            arguments
                .filter(|argument| argument.is_hide_set() == is_hidden)
                .filter_map(|argument| argument.get_long().map(String::from))
                .collect()
        };
        let (hidden, shown) = (names(true), names(false));
        assert!(hidden.contains("service") && shown.contains("kernel-node"), "{hidden:?}");
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let script = script(shell);
            let is_there = |name: &String| match shell {
                Shell::Fish => script.contains(&format!(" -l {name} ")),
                _ => script.contains(&format!("--{name}")),
            };
            assert!(hidden.difference(&shown).all(|name| !is_there(name)), "{shell}: {hidden:?}");
            assert!(shown.iter().all(is_there), "{shell}");
        }
    }
}
