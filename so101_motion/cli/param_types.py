"""Parameter types of the command line: finite numbers, ports, files to read or to write.

A file to be written is checked before anything else happens, so that no motion is planned and no
path recorded that cannot be saved.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import click
import numpy as np
from click.shell_completion import CompletionItem

from so101_motion.cli.completion_values import completed_ports
from so101_motion.common.errors import quoted

IN_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
"""A file that is there."""


class Finite(click.FloatRange):
    """A finite number within bounds."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number."""
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
"""How long; more than nothing."""


class Numbers(click.ParamType[np.ndarray]):
    """A fixed count of numbers with commas between.

    Args:
        most: The largest amount that can be meant.
    """

    def __init__(self, *names: str, most: float) -> None:
        self.name = ",".join(names)
        self._count, self._most = len(names), most

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> np.ndarray:
        """The numbers."""
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
    """One number, or five with commas between."""

    name = "NUMBER[,...]"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> object:
        """The number, or a list of them."""
        try:
            numbers = [float(part) for part in str(value).split(",")]
        except ValueError:
            self.fail(
                f"{quoted(value)} is neither a number nor five numbers with commas between",
                param,
                ctx,
            )
        return numbers[0] if len(numbers) == 1 else numbers


class Port(click.ParamType[str]):
    """The name of a serial port."""

    name = "PORT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The name; only opening it tells whether it is a port."""
        if not value.strip():
            self.fail("a port has a name, such as /dev/ttyACM0; so101 ports lists them", param, ctx)
        return str(value)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Ports that are plugged in."""
        return completed_ports(ctx, param, incomplete)


PORT = Port()


class Link(click.Path):
    """A symbolic link to be made; replaces only an earlier link."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path of a link that can be made now."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if path.exists() and not path.is_symlink():
            self.fail(f"{quoted(str(path))} exists and is not a link.", param, ctx)
        if not path.name or not os.access(path.parent, os.W_OK | os.X_OK):
            self.fail(f"nothing can be made in {quoted(str(path.parent))}.", param, ctx)
        return path


class OutFile(click.Path):
    """A file to be written; replaces an earlier one."""

    def __init__(self, *endings: str) -> None:
        super().__init__(dir_okay=False, writable=True, readable=False, path_type=Path)
        self._endings = endings

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path of a file that can be written now."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if self._endings and path.suffix.lower() not in self._endings:
            self.fail(
                f"{quoted(str(path))} must end with {' or '.join(self._endings)}.", param, ctx
            )
        if not path.parent.is_dir():
            self.fail(f"there is no folder {quoted(str(path.parent))}; make it first.", param, ctx)
        if not path.exists() and not os.access(path.parent, os.W_OK | os.X_OK):
            self.fail(f"nothing can be written in {quoted(str(path.parent))}.", param, ctx)
        return path
