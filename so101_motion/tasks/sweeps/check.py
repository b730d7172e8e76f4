"""Check the motions of a data set in a scene, or with another calibration: which fail, and why.

A motion is the straight joint lines through its setpoints, and all of it is checked, not samples.
Shards are those of the data set. Every worker reads its folder, so on a cluster all computers must
have access to it.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.units import to_rad
from so101_motion.files.scene_file import scene_from
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.sweeps.folder import SweepFolder
from so101_motion.tasks.sweeps.joint_reading import JointReading
from so101_motion.tasks.sweeps.packed import Columns
from so101_motion.tasks.sweeps.plans import Episode, episodes_of


@dataclass(frozen=True, kw_only=True)
class CheckSweep:
    """A check of motions, as plain data; made by ``of``.

    Attributes:
        source: The folder of the motions.
        source_sha256: The SHA-256 of its content.
        shards: How many shards it has.
        items: How many problems it has.
        scene: What is around the arm now, as the JSON text of a scene.
        reading: Converts the recorded numbers to angles of the arm that is to move; None if they
            are the model's.
    """

    source: str
    source_sha256: str
    shards: int
    items: int
    scene: str
    reading: JointReading | None = None

    kind = "check"
    unit = "motions"

    @classmethod
    def of(cls, folder: Path, scene: str, reading: JointReading | None = None) -> CheckSweep:
        """The check of the motions in a folder; other arguments as the attributes.

        Raises:
            ConfigError: The folder has no sweep of plans, or one that is not complete.
        """
        manifest: dict[str, Any] = SweepFolder(folder).manifest()
        if manifest.get("kind") != "plans":
            raise ConfigError("plans", str(folder), f"is a sweep of {manifest.get('kind')}")
        if manifest.get("sha256") is None:
            raise ConfigError(
                "plans", str(folder), "is not complete; run the same sweep again to complete it"
            )
        return cls(
            source=str(folder.resolve()),
            source_sha256=manifest["sha256"],
            shards=manifest["shards"],
            items=manifest["facts"]["count"],
            scene=scene,
            reading=reading,
        )

    def facts(self) -> Mapping[str, object]:
        """Its parameters, without the folder: a moved data set is still the same."""
        facts = {**asdict(self), "scene": json.loads(self.scene)}
        del facts["source"]
        return facts

    def open(self) -> Callable[[int], Columns]:
        """Load the arm and the scene."""
        collision = CollisionModel(
            RobotModel.load(), scene_from(json.loads(self.scene), folder=None)
        )
        return lambda number: self._checked(collision, number)

    def _checked(self, collision: CollisionModel, number: int) -> Columns:
        """The columns of a shard: ``problem``; where it first fails, ``time`` [s], not a number if
        nowhere; ``first`` and ``second``, the bodies that are too close there, or the joint and the
        end of its travel.
        """  # noqa: D205
        shard = SweepFolder(Path(self.source)).read(number)
        if shard is None:
            raise ConfigError("plans", self.source, f"lacks shard {number}")
        problems, times, pairs = [], [], []
        for episode in episodes_of(shard):
            time, pair = self._failure(collision, episode)
            problems.append(episode.problem)
            times.append(time)
            pairs.append(pair)
        return {
            "problem": np.array(problems, dtype=np.int64),
            "time": np.array(times, dtype=np.float32),
            "first": np.array([first for first, _ in pairs], dtype="U64"),
            "second": np.array([second for _, second in pairs], dtype="U64"),
        }

    def _failure(
        self, collision: CollisionModel, episode: Episode
    ) -> tuple[float, tuple[str, str]]:
        """The time at which a motion first fails [s], and the two things that cause it."""
        x = episode.action[:, :5].astype(np.float64)
        found, end = list[tuple[float, tuple[str, str]]](), len(x)
        if self.reading is None:
            q = to_rad(x)
        else:
            q = self.reading.angles(x)
            for frame, each in enumerate(q):
                beyond = self.reading.beyond(each)
                if beyond is not None:
                    time = float(episode.timestamp[frame])
                    found.append((time, (beyond[0], "the end of its travel")))
                    end = frame
                    break
        blocked = collision.first_blocked(q[:end]) if end else None
        if blocked is not None:
            closest = collision.clearance(blocked)
            nearest = int(np.argmin(np.linalg.norm(q - blocked, axis=1)))
            found.append((float(episode.timestamp[nearest]), (closest.first, closest.second)))
        return min(found, default=(np.nan, ("", "")))


def check_summary(folder: Path) -> tuple[dict[str, float], list[int]]:
    """Count the motions of a check and those that fail, by cause; and list those that fail.

    Raises:
        ConfigError: The folder has no such sweep.
    """
    place = SweepFolder(folder)
    manifest: dict[str, Any] = place.manifest()
    if manifest.get("kind") != "check":
        raise ConfigError("check", str(folder), f"is a sweep of {manifest.get('kind')}")
    motions, blocked, by = 0, list[int](), Counter[str]()
    for number in range(int(manifest["shards"])):
        shard = place.read(number)
        if shard is None:
            continue
        motions += len(shard["problem"])
        hit = ~np.isnan(shard["time"])
        blocked += shard["problem"][hit].tolist()
        by.update(
            f"{a} and {b}" for a, b in zip(shard["first"][hit], shard["second"][hit], strict=True)
        )
    pairs = {f"blocked by {pair}": count for pair, count in by.most_common()}
    return {"motions": motions, "blocked": len(blocked), **pairs}, blocked
