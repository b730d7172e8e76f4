"""Parameter types of the command line: finite numbers, ports, files to read or to write.

An output file is checked before anything else happens, so that no motion is planned and no path
recorded that cannot be saved.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from click.shell_completion import CompletionItem

from so101_motion.cli.completion_values import completed_ports
from so101_motion.cli.options import option, together
from so101_motion.common.errors import quoted

if TYPE_CHECKING:
    from so101_motion.planning.collision.scene import Scene

IN_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
"""An existing file."""


class Finite(click.FloatRange):
    """A finite number within bounds."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Read the number."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{quoted(value)} is not a usable number.", param, ctx)
        return number

    def _describe_range(self) -> str:
        """The bounds in words, for the help and for errors."""
        if self.min is None and self.max is None:
            return ""
        if self.min is None or self.max is None:
            return super()._describe_range()
        return f"{self.min:g} to {self.max:g}"


SECONDS = Finite(min=0.0, min_open=True)
"""A time of more than 0 s."""


class Numbers(click.ParamType[np.ndarray]):
    """A fixed count of numbers, separated by commas.

    Args:
        names: A name for each, for the help.
        most: The largest absolute value.
    """

    def __init__(self, *names: str, most: float) -> None:
        self.name = ",".join(names)
        self._count, self._most = len(names), most

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> np.ndarray:
        """Read the numbers."""
        try:
            numbers = np.array([float(part) for part in str(value).split(",")])
        except ValueError:
            self.fail(f"{quoted(value)} is not a list of numbers such as {self.name}", param, ctx)
        if len(numbers) != self._count or not np.all(np.isfinite(numbers)):
            self.fail(f"{quoted(value)} must be {self._count} numbers: {self.name}", param, ctx)
        if np.max(np.abs(numbers)) > self._most:
            self.fail(
                f"{quoted(value)} must be numbers from {-self._most:g} to {self._most:g}",
                param,
                ctx,
            )
        return numbers


class PerJoint(click.ParamType[object]):
    """One number, or five separated by commas."""

    name = "NUMBER[,...]"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> object:
        """Read the number or the list."""
        try:
            numbers = [float(part) for part in str(value).split(",")]
        except ValueError:
            self.fail(
                f"{quoted(value)} is neither a number nor five numbers separated by commas",
                param,
                ctx,
            )
        return numbers[0] if len(numbers) == 1 else numbers


class Port(click.ParamType[str]):
    """The name of a serial port."""

    name = "PORT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Read the name; whether it is a port shows only when it is opened."""
        if not value.strip():
            self.fail("the port's name is empty; so101 ports lists the ports", param, ctx)
        return str(value)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Complete the ports that are plugged in."""
        return completed_ports(ctx, param, incomplete)


PORT = Port()


class Link(click.Path):
    """A symbolic link to be made; replaces only an earlier link."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Read the path, and check that the link can be made."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if path.exists() and not path.is_symlink():
            self.fail(f"{quoted(str(path))} exists and is not a link; name another", param, ctx)
        if not path.name or not os.access(path.parent, os.W_OK | os.X_OK):
            self.fail(
                f"no file can be made in {quoted(str(path.parent))}; name another folder",
                param,
                ctx,
            )
        return path


class OutFile(click.Path):
    """A file to be written; replaces an earlier one."""

    def __init__(self, *endings: str) -> None:
        super().__init__(dir_okay=False, writable=True, readable=False, path_type=Path)
        self._endings = endings

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Read the path, and check that the file can be written."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if self._endings and path.suffix.lower() not in self._endings:
            self.fail(
                f"{quoted(str(path))} must end with {' or '.join(self._endings)}.", param, ctx
            )
        if not path.parent.is_dir():
            self.fail(f"there is no folder {quoted(str(path.parent))}; make it first.", param, ctx)
        if not path.exists() and not os.access(path.parent, os.W_OK | os.X_OK):
            self.fail(
                f"no file can be written in {quoted(str(path.parent))}; name another folder",
                param,
                ctx,
            )
        return path


def port_option(words: str) -> Any:
    """The option ``--port``."""
    return option(f"{words} (or SO101_PORT).", PORT, envvar="SO101_PORT")


def read_scene(scene: Path | None) -> Scene | None:
    """The scene in a file; None for no file."""
    from so101_motion.files import scene_file

    return None if scene is None else scene_file.read_scene(scene)


SCENE_FILE = option("A scene file: the obstacles around the arm.", IN_FILE, name="--scene")
SCENE = together(read_scene, scene=SCENE_FILE)
"""The scene in a file; None if none is named."""

POINT = Numbers("X", "Y", "Z", most=1e6)
JOINTS = Numbers("PAN", "LIFT", "ELBOW", "WRIST", "ROLL", most=360.0)
