"""``so101 completion``: what lets a shell complete verbs and options."""

from __future__ import annotations

import sys

import click
from click.shell_completion import BashComplete, FishComplete, ShellComplete, ZshComplete

_COMPLETERS: dict[str, type[ShellComplete]] = {
    "bash": BashComplete,
    "zsh": ZshComplete,
    "fish": FishComplete,
}

_HOW = {
    "bash": "echo 'eval \"$(so101 completion bash)\"' >> ~/.bashrc",
    "zsh": "echo 'eval \"$(so101 completion zsh)\"' >> ~/.zshrc",
    "fish": "so101 completion fish > ~/.config/fish/completions/so101.fish",
}


@click.command()
@click.argument("shell", type=click.Choice(tuple(_COMPLETERS)))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script that makes SHELL complete so101's verbs and options.

    \b
    echo 'eval "$(so101 completion bash)"' >> ~/.bashrc
    echo 'eval "$(so101 completion zsh)"' >> ~/.zshrc
    so101 completion fish > ~/.config/fish/completions/so101.fish
    """  # noqa: D301
    command = context.find_root().command
    click.echo(_COMPLETERS[shell](command, {}, "so101", "_SO101_COMPLETE").source())
    if sys.stdout.isatty():
        click.echo(f"to have it in every shell: {_HOW[shell]}", err=True)
