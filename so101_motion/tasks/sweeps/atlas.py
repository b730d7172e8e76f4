"""Look up whether the arm reaches a point, and how well, in an atlas that a sweep has computed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import ConfigError
from so101_motion.tasks.sweeps.folder import SweepFolder
from so101_motion.tasks.sweeps.reach import BRANCH_BITS, Grid

_ROW = np.dtype(
    [
        ("limits", "u1"),
        ("branches", "u1"),
        ("ways", "u2"),
        ("clearance", "f4"),
        ("torque_left", "f4"),
        ("manipulability", "f4"),
        *((f"q{joint}", "f4") for joint in range(5)),
    ]
)

_FIGURES = ("limits", "branches", "ways", "clearance", "torque_left", "manipulability")


class Reach(NamedTuple):
    """How well the arm reaches a point of the grid."""

    limits: int  # the branches within the joint limits there, as bits of ``BRANCH_BITS``
    branches: int  # those of them with a configuration that is free of contact
    ways: int  # how many of the sampled configurations are free of contact
    clearance: float  # smallest distance between bodies in the best of them [m]
    torque_left: float  # share of the servos' holding torque that it leaves; negative: too heavy
    manipulability: float  # volume of the tool's velocity ellipsoid in it [m^3/rad^3]
    q: tuple[float, ...]  # its joint angles [rad]

    @property
    def reachable(self) -> bool:
        """Whether the arm can be there without contact and hold itself."""
        return self.ways > 0 and self.torque_left >= 0.0

    @property
    def branch_names(self) -> tuple[str, ...]:
        return tuple(
            f"{side}, elbow {'up' if up else 'down'}"
            for (side, up), bit in BRANCH_BITS.items()
            if self.branches & bit
        )


NOWHERE = Reach(0, 0, 0, np.nan, np.nan, np.nan, (np.nan,) * 5)
"""The entry of a point that no joint angles within the limits reach."""


class Atlas:
    """The result of a sweep of the arm's reach.

    ``points`` are the numbers of the grid's points within the joint limits, ascending, shape (n,);
    ``rows`` their figures, shape (n,), with fields as in ``Reach``, and ``q0`` to ``q4``.
    """

    def __init__(
        self,
        facts: Mapping[str, Any],
        grid: Grid,
        points: NDArray[np.int64],
        rows: NDArray[np.void],
    ) -> None:
        self.facts, self.grid, self.points, self.rows = facts, grid, points, rows
        self._row_of = np.full(grid.size, -1, dtype=np.int32)
        self._row_of[points] = np.arange(len(points))
        self._per_metre = 1.0 / grid.spacing
        self._look: tuple[Callable[[int], int], Callable[[int], Any]] = (
            self._row_of.item,
            rows.item,
        )

    @classmethod
    def read(cls, folder: Path | str) -> Atlas:
        """Read the atlas in a folder; ``ConfigError`` if there is none, or it is not complete."""
        place = SweepFolder(Path(folder))
        manifest = place.manifest()
        if manifest.get("kind") != "reach":
            raise ConfigError("atlas", str(folder), f"is a sweep of {manifest.get('kind')}")
        count = int(manifest["shards"])
        shards = [place.read(shard) for shard in range(count)]
        missing = sum(shard is None for shard in shards)
        if missing:
            raise ConfigError(
                "atlas", str(folder),
                f"lacks {missing} of {count} shards; run the same so101 sweep again to complete it",
            )  # fmt: skip
        whole = [shard for shard in shards if shard is not None]
        points = np.concatenate([shard["point"] for shard in whole])
        rows = np.empty(len(points), dtype=_ROW)
        for name in _FIGURES:
            rows[name] = np.concatenate([shard[name] for shard in whole])
        q = np.concatenate([shard["q"] for shard in whole])
        for joint in range(5):
            rows[f"q{joint}"] = q[:, joint]
        facts = manifest["facts"]
        x, y, z = facts["grid_first"]
        nx, ny, nz = facts["grid_counts"]
        return cls(facts, Grid(facts["spacing"], (x, y, z), (nx, ny, nz)), points, rows)

    def at(self, x: float, y: float, z: float) -> Reach:
        """How well the arm reaches a point of the base frame [m]."""
        (i0, j0, k0), (nx, ny, nz) = self.grid.first, self.grid.counts
        i, j, k = (
            round(x * self._per_metre) - i0,
            round(y * self._per_metre) - j0,
            round(z * self._per_metre) - k0,
        )
        if not (0 <= i < nx and 0 <= j < ny and 0 <= k < nz):
            return NOWHERE
        row_of, row = self._look
        number = row_of(i + nx * (j + ny * k))
        if number < 0:
            return NOWHERE
        values = row(number)
        return Reach._make((*values[:6], values[6:]))

    def summary(self) -> dict[str, float]:
        """A summary in a few figures.

        How many points the grid has, and how many are within the joint limits, free of contact and
        reachable; the reachable volume [m^3]; medians over the reachable points.
        """
        rows = self.rows
        free = rows["ways"] > 0
        good = free & (rows["torque_left"] >= 0.0)
        figures: dict[str, float] = {
            "points": self.grid.size,
            "within_limits": len(rows),
            "free": int(free.sum()),
            "reachable": int(good.sum()),
            "volume_m3": float(good.sum()) * self.grid.spacing**3,
        }
        branches = Counter(int(each).bit_count() for each in rows["branches"][good])
        figures |= {f"with_{count}_branches": branches[count] for count in (1, 2, 3, 4)}
        for name in ("clearance", "torque_left", "manipulability"):
            values = rows[name][good]
            figures[f"median_{name}"] = float(np.median(values)) if len(values) else float("nan")
        return figures
