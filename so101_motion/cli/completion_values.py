"""Complete ports, poses, programs and files in the shell.

The shell waits for this at every press of Tab, so nothing here imports more than the verbs do
anyway, or opens a port. A file or folder that cannot be read is left out without an error.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable

import click
from click.shell_completion import CompletionItem

from so101_motion.common.errors import So101Error


def completed_ports(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete serial ports by each of their names; files if none fits."""
    from so101_motion.drivers.port.port_list import find_ports

    found = find_ports()
    names = {
        name: port.description for port in found for name in (port.name, port.device, *port.aliases)
    }
    fitting = [
        CompletionItem(name, help=words)
        for name, words in names.items()
        if name.startswith(incomplete)
    ]
    return fitting or _files(incomplete)


def completed_poses(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete named poses: built in, and the user's own."""
    from so101_motion.common.named_poses import POSES
    from so101_motion.files.saved_poses import SavedPoses

    names = [pose.name for pose in POSES]
    with contextlib.suppress(So101Error):
        names += [pose.name for pose in SavedPoses().own()]
    return _fitting(names, incomplete)


def completed_programs(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete the user's programs; files if none fits."""
    from so101_motion.files import user_storage

    try:
        files = (user_storage.folder() / "programs").glob("*.json")
        names = sorted(file.stem for file in files)
    except (So101Error, OSError):
        names = []
    return _fitting(names, incomplete) or _files(incomplete)


def completed_files(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete any file."""
    return _files(incomplete)


def _fitting(names: Iterable[str], incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _files(incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(incomplete, type="file")]
