"""Parameter types of the command line: finite numbers, ports, files to read or to write.

An output file is checked before anything else happens, so that no motion is planned and no path
recorded that cannot be saved.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from click.shell_completion import CompletionItem

from so101_motion.cli.completion import completed_ports
from so101_motion.cli.options import option, together
from so101_motion.common.errors import quoted

if TYPE_CHECKING:
    from so101_motion.planning.collision.scene import Scene

IN_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)  # an existing file


class Finite(click.FloatRange):
    """A finite number within bounds."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{quoted(value)} is not a usable number.", param, ctx)
        return number

    def _describe_range(self) -> str:
        if self.min is None and self.max is None:
            return ""
        if self.min is None or self.max is None:
            return super()._describe_range()
        return f"{self.min:g} to {self.max:g}"


SECONDS = Finite(min=0.0, min_open=True)  # a time of more than 0 s


class Parsed(click.ParamType[Any]):
    """What ``read`` makes of a text; it raises ``ValueError``, in words that follow the text."""

    def __init__(self, name: str, read: Callable[[str], object]) -> None:
        self.name, self._read = name, read

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return self._read(value) if isinstance(value, str) else value
        except ValueError as error:
            self.fail(f"{quoted(value)} {error}", param, ctx)


def _numbers(*names: str, most: float, like: str, in_mm: bool = False) -> Parsed:
    """As many numbers, each from ``-most`` to ``most``; ``like`` is an example."""
    listed = ",".join(names)

    def read(text: str) -> np.ndarray:
        try:
            numbers = np.array([float(part) for part in text.split(",")])
        except ValueError:
            numbers = np.empty(0)
        if numbers.shape != (len(names),) or not np.all(np.abs(numbers) <= most):
            raise ValueError(
                f"must be {len(names)} numbers {listed} from {-most:g} to {most:g}, with commas,"
                f" without spaces: {like}"
            )
        if in_mm and 0.0 < np.abs(numbers).max() < 1.0:
            meant = ",".join(f"{1000.0 * x:g}" for x in numbers)
            raise ValueError(f"is in millimetres; did you mean {meant}?")
        return numbers

    return Parsed(listed, read)


def _per_joint(text: str) -> object:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise ValueError("is neither a number nor five numbers separated by commas") from None
    return numbers[0] if len(numbers) == 1 else numbers


PER_JOINT = Parsed("NUMBER[,...]", _per_joint)  # one number, or five separated by commas


class _Port(click.ParamType[str]):
    """The name of a serial port; whether it is one shows only when it is opened."""

    name = "PORT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if not value.strip():
            self.fail("the port's name is empty; so101 ports lists the ports", param, ctx)
        return str(value)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        return completed_ports(ctx, param, incomplete)


PORT = _Port()


class OutFile(click.Path):
    """A file to be written; replaces an earlier one, or only a link to one if it is a ``link``."""

    def __init__(self, *endings: str, link: bool = False) -> None:
        super().__init__(dir_okay=False, writable=not link, readable=False, path_type=Path)
        self._endings, self._link = endings, link

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        wrong = ""
        if self._endings and path.suffix.lower() not in self._endings:
            wrong = f"{quoted(str(path))} must end with {' or '.join(self._endings)}."
        elif self._link and path.exists() and not path.is_symlink():
            wrong = f"{quoted(str(path))} exists and is not a link; name another"
        elif not path.parent.is_dir():
            wrong = f"there is no folder {quoted(str(path.parent))}; make it first."
        elif (self._link or not path.exists()) and not os.access(path.parent, os.W_OK | os.X_OK):
            wrong = f"no file can be written in {quoted(str(path.parent))}; name another folder"
        if wrong:
            self.fail(wrong, param, ctx)
        return path


def port_option(words: str) -> Any:
    return option(f"{words} (or SO101_PORT).", PORT, envvar="SO101_PORT")


def read_scene(scene: Path | None) -> Scene | None:
    from so101_motion.files import scene_file

    return None if scene is None else scene_file.read_scene(scene)


SCENE_FILE = option("A scene file: the obstacles around the arm.", IN_FILE, name="--scene")
SCENE = together(read_scene, scene=SCENE_FILE)  # the scene in it; None if none is named

POINT = _numbers("X", "Y", "Z", most=5000.0, like="250,0,60", in_mm=True)
DIRECTION = _numbers("X", "Y", "Z", most=5000.0, like="0,0,-1")
JOINTS = _numbers("PAN", "LIFT", "ELBOW", "WRIST", "ROLL", most=360.0, like="0,-45,45,60,0")
