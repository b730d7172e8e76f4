"""Turn a plan or the last run into a file for download."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from so101_motion.files.trajectory_export import LeRobot, Run, encoded

from ..page.screen_state import PlanView
from .film import film_of, recording


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
        view: Its plan.
        run: How it was carried out, or None for the plan alone.
        lerobot: LeRobot's units for this arm.
        title: Which arm it is.
    """

    view: PlanView
    run: Run | None
    lerobot: LeRobot
    title: str


def kind_called(label: str) -> FileKind:
    """The kind of file with this label; the first if there is none."""
    return next((kind for kind in KINDS if kind.label == label), KINDS[0])


def file_name(subject: SharedMotion, kind: FileKind, now: datetime) -> str:
    """A file name with time and content, so that names sort by time."""
    what = "plan" if subject.run is None else "run"
    names = "-lerobot" if kind.lerobot else ""
    return f"so101-{what}-{now:%Y%m%d-%H%M%S}{names}{kind.suffix}"


def content(subject: SharedMotion, kind: FileKind) -> bytes:
    """The bytes of the file; takes some seconds for a long film.

    Raises:
        ConfigError: MCAP needs a package that is not installed.
    """
    if kind is FILM:
        return recording(film_of(subject.view, title=subject.title, run=subject.run))
    return encoded(
        subject.view.plan.trajectory if subject.run is None else subject.run,
        f"motion{kind.suffix}",
        lerobot=subject.lerobot if kind.lerobot else None,
    )
