"""Shell completion: the script that ``so101 completion`` prints, and the values that Tab offers.

The shell waits for this at every press of Tab, so nothing here imports more than the verbs do
anyway, or opens a port. A file or folder that cannot be read is left out without an error.
"""

from __future__ import annotations

import contextlib

import click
from click.shell_completion import (
    BashComplete,
    CompletionItem,
    FishComplete,
    ShellComplete,
    ZshComplete,
)

from so101_motion.cli.options import argument, verb
from so101_motion.common.errors import So101Error

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


def completed_files(context: object, parameter: object, incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(incomplete, type="file")]


def completed_ports(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete serial ports by each of their names; files if none fits."""
    from so101_motion.drivers.port.port_list import find_ports

    names = {
        name: port.description
        for port in find_ports()
        for name in (port.name, port.device, *port.aliases)
    }
    fitting = [CompletionItem(n, help=w) for n, w in names.items() if n.startswith(incomplete)]
    return fitting or completed_files(context, parameter, incomplete)


def completed_poses(context: object, parameter: object, incomplete: str) -> list[CompletionItem]:
    from so101_motion.common.named_poses import POSES
    from so101_motion.files.saved_poses import SavedPoses

    names = [pose.name for pose in POSES]
    with contextlib.suppress(So101Error):
        names += [pose.name for pose in SavedPoses().own()]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def completed_programs(context: object, parameter: object, incomplete: str) -> list[CompletionItem]:
    """Complete the user's programs; files if none fits."""
    from so101_motion.files import user_storage

    try:
        files = (user_storage.folder() / "programs").glob("*.json")
        names = sorted(file.stem for file in files)
    except (So101Error, OSError):
        names = []
    fitting = [CompletionItem(name) for name in names if name.startswith(incomplete)]
    return fitting or completed_files(context, parameter, incomplete)
