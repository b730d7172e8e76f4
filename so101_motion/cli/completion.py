"""``so101 completion``: print the shell script that completes verbs and options."""

from __future__ import annotations

import sys

import click
from click.shell_completion import BashComplete, FishComplete, ShellComplete, ZshComplete

from so101_motion.cli.options import argument, verb

_BASH = r"""%(complete_func)s() {
    local IFS=$'\n' response kind word
    response=$(
        env COMP_WORDS="${COMP_WORDS[*]}" COMP_CWORD=$COMP_CWORD %(complete_var)s=bash_complete $1
    )
    while IFS=, read -r kind word; do
        case $kind in
            dir) COMPREPLY=(); compopt -o dirnames ;;
            file) COMPREPLY=(); compopt -o default ;;
            plain)
                [[ ${COMP_WORDS[COMP_CWORD]} == [\"\']* ]] || printf -v word %%q "$word"
                COMPREPLY+=("$word") ;;
        esac
    done <<< "$response"
}
complete -o nosort -F %(complete_func)s %(prog_name)s
"""


class _Bash(BashComplete):
    """Bash completion that quotes names with blanks."""

    source_template = _BASH


_COMPLETERS: dict[str, type[ShellComplete]] = {
    "bash": _Bash,
    "zsh": ZshComplete,
    "fish": FishComplete,
}

_HOW = {
    "bash": "echo 'eval \"$(so101 completion bash)\"' >> ~/.bashrc",
    "zsh": "echo 'eval \"$(so101 completion zsh)\"' >> ~/.zshrc",
    "fish": "so101 completion fish > ~/.config/fish/completions/so101.fish",
}


@verb()
def completion(shell: str = argument(click.Choice(tuple(_COMPLETERS)))) -> None:
    """Print the script that makes SHELL complete so101's verbs and options.

    It completes the ports that are plugged in, poses and programs as well.

    \b
    echo 'eval "$(so101 completion bash)"' >> ~/.bashrc
    echo 'eval "$(so101 completion zsh)"' >> ~/.zshrc
    so101 completion fish > ~/.config/fish/completions/so101.fish
    """  # noqa: D301
    command = click.get_current_context().find_root().command
    click.echo(_COMPLETERS[shell](command, {}, "so101", "_SO101_COMPLETE").source())
    if sys.stdout.isatty():
        click.echo(f"to load it in every shell: {_HOW[shell]}", err=True)
