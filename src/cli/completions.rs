// SPDX-License-Identifier: MIT

//! `gaugefs completions`.

use std::process::ExitCode;

use clap::Args;
use clap_complete::Shell;

use super::Cli;
use crate::command::{completions, whole};
use crate::error::Result;
use crate::output::print_file;

const COMPLETIONS: &str = "\
The Debian package installs the completions for bash, zsh and fish. Besides commands and options they
offer mounted gauges, their parameters, buses, scenarios and columns. zsh looks into ~/.zfunc if
~/.zshrc has fpath+=(~/.zfunc) before compinit.

Examples:
  mkdir -p ~/.local/share/bash-completion/completions
  gaugefs completions bash > ~/.local/share/bash-completion/completions/gaugefs

  mkdir -p ~/.config/fish/completions
  gaugefs completions fish > ~/.config/fish/completions/gaugefs.fish

  mkdir -p ~/.zfunc
  gaugefs completions zsh > ~/.zfunc/_gaugefs";

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
    with_names(shell, &completions::script(shell, &whole::<Cli>()))
}

/// The script, with calls of `gaugefs names`, which answers within seconds whatever the mounts do.
fn with_names(shell: Shell, script: &str) -> String {
    let gauges = commands_with(|argument| argument.is_positional() && of_gauge(argument));
    match shell {
        Shell::Bash => format!("{script}{}", BASH.replace("@GAUGES@", &gauges)),
        Shell::Zsh => {
            let lines: String = script.lines().map(|line| zsh_line(line) + "\n").collect();
            lines.replacen("#compdef gaugefs\n", ZSH, 1)
        }
        Shell::Fish => {
            let options = OPTIONS.iter().map(|(name, of)| {
                let commands = commands_with(|argument| argument.get_long() == Some(name));
                format!(
                    "complete -c gaugefs -n \"__fish_seen_subcommand_from {commands}\" -l {name} -r -a \"(__gaugefs_{of})\"\n"
                )
            });
            format!("{script}{}{}", FISH.replace("@GAUGES@", &gauges), options.collect::<String>())
        }
        _ => script.to_string(),
    }
}

/// Options whose values have names, and the kind of names.
const OPTIONS: [(&str, &str); 3] = [("bus", "buses"), ("scenario", "scenarios"), ("columns", "columns")];

/// Whether an argument is a mounted gauge.
fn of_gauge(argument: &clap::Arg) -> bool {
    let names = argument.get_value_names().unwrap_or_default().iter().map(|name| name.as_str());
    argument.get_id() == "gauge" || names.into_iter().any(|name| name == "GAUGE")
}

/// Names of the commands that have such an argument, or whose subcommands do.
fn commands_with(wanted: impl Fn(&clap::Arg) -> bool + Copy) -> String {
    fn has(command: &clap::Command, wanted: impl Fn(&clap::Arg) -> bool + Copy) -> bool {
        command.get_arguments().any(wanted) || command.get_subcommands().any(|below| has(below, wanted))
    }
    let all = whole::<Cli>();
    let commands = all.get_subcommands().filter(|command| !command.is_hide_set() && has(command, wanted));
    commands.map(|command| command.get_name().to_string()).collect::<Vec<_>>().join(" ")
}

/// A line of the script for zsh. The text after the last colon is what it offers.
fn zsh_line(line: &str) -> String {
    let start = line.trim_start();
    let of_option = |(name, _): &&(&str, &str)| start.starts_with(&format!("'--{name}=["));
    let of = match OPTIONS.iter().find(of_option) {
        Some((_, of)) => of,
        None if line.contains(":_hosts'") => "names",
        None if start.starts_with('\'') && line.contains(":gauge -- ") => "gauges",
        None => return line.into(),
    };
    match line.rsplit_once(":_") {
        Some((before, after)) => {
            let (_, end) = after.split_at(after.find('\'').unwrap_or(after.len()));
            format!("{before}:_gaugefs_{of}{end}")
        }
        None => line.into(),
    }
}

const BASH: &str = r#"
_gaugefs_names() {
    local word="${COMP_WORDS[COMP_CWORD]}" kind= gauge= named= at end= first=
    for ((at = 2; at < COMP_CWORD; at++)); do
        [[ ${COMP_WORDS[at]} == = ]] && named=yes
        [[ -z $gauge && ${COMP_WORDS[at]} != -* ]] && gauge=${COMP_WORDS[at]}
    done
    case ${COMP_WORDS[1]} in set) end='=' ;; get) ;; *) gauge= ;; esac
    if [[ -n $gauge && $word != [-/.]* ]]; then
        [[ -n $named || $word == *=* ]] && return
        mapfile -t COMPREPLY < <(compgen -S "$end" -W "$(gaugefs names -- "$gauge" 2>/dev/null)" -- "$word")
        [[ -n $end ]] && compopt -o nospace 2>/dev/null
        return
    fi
    case ${COMP_WORDS[COMP_CWORD-1]} in
        --bus) kind=buses ;;
        --scenario) kind=scenarios ;;
        --columns)
            kind=columns
            [[ $word == *,* ]] && first=${word%,*},
            ;;
        *) [[ $COMP_CWORD -gt 1 && $word != -* && " @GAUGES@ " == *" ${COMP_WORDS[1]} "* ]] && kind=gauges ;;
    esac
    COMPREPLY=()
    if [[ -n $kind ]]; then
        mapfile -t COMPREPLY < <(
            IFS=$'\n'
            compgen -P "$first" -W "$(gaugefs names --of "$kind" 2>/dev/null)" -- "${word#"$first"}"
        )
    fi
    [[ ${#COMPREPLY[@]} -gt 0 ]] || _gaugefs "$@"
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
    _gaugefs_gauges
}

_gaugefs_gauges() {
    compadd -- ${(f)"$(gaugefs names --of gauges 2>/dev/null)"}
    _files -/
}

_gaugefs_buses() {
    compadd -- ${(f)"$(gaugefs names --of buses 2>/dev/null)"}
    _files
}

_gaugefs_scenarios() {
    compadd -- ${(f)"$(gaugefs names --of scenarios 2>/dev/null)"}
    _files
}

_gaugefs_columns() {
    _sequence compadd - ${(f)"$(gaugefs names --of columns 2>/dev/null)"}
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
function __gaugefs_buses
    gaugefs names --of buses 2>/dev/null
end
function __gaugefs_scenarios
    gaugefs names --of scenarios 2>/dev/null
end
function __gaugefs_columns
    set -l first (string match -r '.*,' -- (commandline -ct))
    for name in (gaugefs names --of columns 2>/dev/null)
        echo "$first$name"
    end
end
complete -c gaugefs -n "__fish_seen_subcommand_from get set" -a "(__gaugefs_names)"
complete -c gaugefs -n "__fish_seen_subcommand_from @GAUGES@" -a "(gaugefs names --of gauges 2>/dev/null)"
"#;

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn what_other_programs_call_is_not_completed() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let script = script(shell);
            for command in whole::<Cli>().get_subcommands() {
                // Names of other commands and options may contain such a word.
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
            let all = whole::<Cli>();
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
