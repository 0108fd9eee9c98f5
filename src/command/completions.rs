// SPDX-License-Identifier: MIT

//! Scripts that complete the command line of a program in a shell.

use clap::{ArgGroup, Id};
use clap_complete::Shell;

/// The script of a program.
pub(crate) fn script(shell: Shell, program: &clap::Command) -> String {
    let mut script = Vec::new();
    let mut typed = typed(program).version(env!("CARGO_PKG_VERSION"));
    clap_complete::generate(shell, &mut typed, program.get_name(), &mut script);
    String::from_utf8_lossy(&script).into_owned()
}

/// A command without subcommands that only programs call.
fn typed(command: &clap::Command) -> clap::Command {
    let arguments: Vec<_> = command.get_arguments().filter(|argument| !argument.is_hide_set()).collect();
    let groups = command.get_groups().map(|group| {
        let is_there = |id: &&Id| arguments.iter().any(|argument| argument.get_id() == *id);
        let members: Vec<&Id> = group.get_args().filter(is_there).collect();
        ArgGroup::new(group.get_id().clone()).multiple(true).args(members)
    });
    let commands = command.get_subcommands().filter(|command| !command.is_hide_set());
    // clap keeps the program's names; this one ends after the script is printed.
    let name: &str = command.get_name().to_string().leak();
    clap::Command::new(name)
        .about(command.get_about().cloned().unwrap_or_default())
        .groups(groups)
        .args(arguments.iter().copied())
        .subcommands(commands.map(typed))
}
