"""Turn a plan or the last run into a file for download."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

from so101_motion.files.trajectory_export import LeRobot, encoded

from .film import MovedArm, film_of, recording


@dataclass(frozen=True, slots=True, kw_only=True)
class FileKind:
    """A kind of file.

    Attributes:
        label: What people call it.
        suffix: Of the file.
        lerobot: Whether it has LeRobot's names and units.
    """

    label: str
    suffix: str
    lerobot: bool = False


FILM = FileKind(label="Film for any browser (HTML)", suffix=".html")

KINDS = (
    FILM,
    FileKind(label="Table, degrees (CSV)", suffix=".csv"),
    FileKind(label="JSON, degrees", suffix=".json"),
    FileKind(label="MCAP: Foxglove, Rerun", suffix=".mcap"),
    FileKind(label="LeRobot names (CSV)", suffix=".csv", lerobot=True),
    FileKind(label="LeRobot names (JSON)", suffix=".json", lerobot=True),
)

PLAN, RUN = "The plan", "The last run"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedMotion:
    """A motion that can be downloaded.

    Attributes:
        arms: How each arm moves, by its name; the name of a single one is empty.
        chosen: The arm whose motion is written into a file that can hold only one.
        lerobot: LeRobot's units for that arm.
        title: Which arms they are.
    """

    arms: Mapping[str, MovedArm]
    chosen: str
    lerobot: LeRobot
    title: str

    @property
    def arm(self) -> MovedArm:
        """How the chosen arm moves."""
        return self.arms[self.chosen]


def kind_called(label: str) -> FileKind:
    """The kind of file with this label; the first if there is none."""
    return next((kind for kind in KINDS if kind.label == label), KINDS[0])


def file_name(subject: SharedMotion, kind: FileKind, now: datetime) -> str:
    """A file name with time and content, so that names sort by time."""
    what = "plan" if subject.arm.run is None else "run"
    names = "-lerobot" if kind.lerobot else ""
    arm = "" if kind is FILM else re.sub(r"\W+", "-", f" {subject.chosen}".rstrip())
    return f"so101-{what}-{now:%Y%m%d-%H%M%S}{arm}{names}{kind.suffix}"


def content(subject: SharedMotion, kind: FileKind) -> bytes:
    """The bytes of the file; takes some seconds for a long film.

    Raises:
        ConfigError: MCAP needs a package that is not installed.
    """
    if kind is FILM:
        return recording(film_of(subject.arms, title=subject.title))
    arm = subject.arm
    return encoded(
        arm.view.plan.trajectory if arm.run is None else arm.run,
        f"motion{kind.suffix}",
        lerobot=subject.lerobot if kind.lerobot else None,
    )
