"""What can be taken away from the page: a plan or the last run, as one of several kinds of file."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from so101_motion.export import LeRobot, Run, encoded
from so101_motion.planning.scene import Scene

from .recording import film_of, recording
from .screen import PlanSight


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of file.

    Attributes:
        label: What people call it.
        suffix: Of the file.
        lerobot: Whether it has LeRobot's names and units.
    """

    label: str
    suffix: str
    lerobot: bool = False


FILM = Kind(label="Film for any browser (HTML)", suffix=".html")

KINDS = (
    FILM,
    Kind(label="Table, degrees (CSV)", suffix=".csv"),
    Kind(label="JSON, degrees", suffix=".json"),
    Kind(label="MCAP: Foxglove, Rerun", suffix=".mcap"),
    Kind(label="LeRobot names (CSV)", suffix=".csv", lerobot=True),
    Kind(label="LeRobot names (JSON)", suffix=".json", lerobot=True),
)

PLAN, RUN = "The plan", "The last run"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Subject:
    """A motion to take away.

    Attributes:
        seen: Its plan.
        run: How it was carried out, or None for the plan alone.
        scene: What the plan was made for.
        q_jaw: Jaw angle [rad].
        lerobot: How LeRobot counts for this arm.
        title: Which arm it is.
    """

    seen: PlanSight
    run: Run | None
    scene: Scene
    q_jaw: float
    lerobot: LeRobot
    title: str


def kind_called(label: str) -> Kind:
    """The kind of file with that label; the first if there is none."""
    return next((kind for kind in KINDS if kind.label == label), KINDS[0])


def file_name(subject: Subject, kind: Kind, now: datetime) -> str:
    """A name that sorts by time and says what is in the file."""
    what = "plan" if subject.run is None else "run"
    names = "-lerobot" if kind.lerobot else ""
    return f"so101-{what}-{now:%Y%m%d-%H%M%S}{names}{kind.suffix}"


def content(subject: Subject, kind: Kind) -> bytes:
    """The file; takes up to some seconds for a long film.

    Raises:
        ConfigError: MCAP needs a package that is not installed.
    """
    if kind is FILM:
        film = film_of(
            subject.seen,
            subject.scene,
            title=subject.title,
            q_jaw=subject.q_jaw,
            run=subject.run,
        )
        return recording(film)
    return encoded(
        subject.seen.plan.trajectory if subject.run is None else subject.run,
        f"motion{kind.suffix}",
        lerobot=subject.lerobot if kind.lerobot else None,
    )
