"""Find the pairs of links that never collide: ``python -m urdf.make_allowed_pairs``.

Draws configurations uniformly inside the URDF's limits, the jaw's angle too, and counts for every
pair of links how often their hulls meet, and how often the drawn triangles inside them do. Run it
after ``make_hulls`` and ``make_meshes`` or a change of limits; takes a minute or two. The result is
``allowed_pairs.json``; with ``SO101_ROBOT=so100`` that of the SO-100.
"""

import itertools
import json
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from . import GROUND, PARTS, ROBOT, URDF_PATH, TriangleMesh, load_hull, load_visual

SAMPLES: Final = 100_000
SEED: Final = 20261121
FLOOR_Z: Final = -0.0024  # underside of the base in base_link, where the table is [m]

Shapes = Mapping[str, Any]  # a coal shape for every link
Pair = tuple[str, str]


def _convex(mesh: TriangleMesh) -> Any:
    shape = _triangles(mesh)
    shape.buildConvexHull(True, "Qt")
    return shape.convex


def _triangles(mesh: TriangleMesh) -> Any:
    shape = coal.BVHModelOBBRSS()
    shape.beginModel(len(mesh.faces), len(mesh.vertices))
    shape.addVertices(mesh.vertices)
    for face in mesh.faces.tolist():
        shape.addTriangle(*(mesh.vertices[i] for i in face))
    shape.endModel()
    return shape


def _drawn(link: str) -> TriangleMesh:
    """Everything drawn of a link as one mesh."""
    meshes = [surface.mesh for surface in load_visual(PARTS[link])]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return TriangleMesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate(
            [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
        ).astype(np.int32),
    )


def _shapes(make: Callable[[str], Any]) -> Shapes:
    return {link: make(link) for link in PARTS}


class Arm:
    """Where the links are in a configuration."""

    def __init__(self) -> None:
        self._model = pin.buildModelFromUrdf(str(URDF_PATH))
        self._data = self._model.createData()
        self._frames = {link: self._model.getFrameId(link) for link in PARTS}
        self.lower: NDArray[np.float64] = self._model.lowerPositionLimit
        self.upper: NDArray[np.float64] = self._model.upperPositionLimit

    def placements(self, q: NDArray[np.float64]) -> dict[str, Any]:
        """Place every link for six joint angles, the jaw's last, [rad]."""
        pin.framesForwardKinematics(self._model, self._data, q)
        return {
            link: coal.Transform3s(self._data.oMf[i].rotation, self._data.oMf[i].translation)
            for link, i in self._frames.items()
        }


def meets(shapes: Shapes, placed: Mapping[str, Any], pair: Pair) -> bool:
    """Whether the shapes of two links overlap."""
    first, second = pair
    return bool(
        coal.collide(
            shapes[first],
            placed[first],
            shapes[second],
            placed[second],
            coal.CollisionRequest(),
            coal.CollisionResult(),
        )
    )


def sample(samples: int, seed: int) -> dict[str, Any]:
    """Count overlaps in random configurations.

    Args:
        samples: Number of configurations.
        seed: Of numpy's default generator.

    Returns:
        What ``allowed_pairs.json`` holds.
    """
    arm = Arm()
    # What lies inside the hulls can only meet where the hulls do.
    hulls = _shapes(lambda link: _convex(load_hull(PARTS[link])))
    drawn = _shapes(lambda link: _triangles(_drawn(link)))
    kinds = ("hulls", "drawn")
    links = list(PARTS)
    pairs = [pair for pair in itertools.combinations(links, 2) if not _adjacent(pair)]
    counts = {pair: dict.fromkeys(kinds, 0) for pair in pairs}
    anywhere = dict.fromkeys(kinds, 0)
    nearest = dict.fromkeys(pairs, np.inf)
    lowest = dict.fromkeys(links, np.inf)
    for q in np.random.default_rng(seed).uniform(arm.lower, arm.upper, (samples, len(arm.lower))):
        placed = arm.placements(q)
        found = dict.fromkeys(kinds, False)
        for pair in pairs:
            if meets(hulls, placed, pair):
                counts[pair]["hulls"] += 1
                found["hulls"] = True
                hit = meets(drawn, placed, pair)
                counts[pair]["drawn"] += hit
                found["drawn"] |= hit
            elif counts[pair]["hulls"] == 0:
                nearest[pair] = min(nearest[pair], _distance(hulls, placed, pair))
        for kind in kinds:
            anywhere[kind] += found[kind]
        for link in links:
            lowest[link] = min(lowest[link], _lowest(hulls[link], placed[link]))
    rows = [
        _row(pair, counts.get(pair), nearest.get(pair, 0.0))
        for pair in itertools.combinations(links, 2)
    ]
    return {
        "samples": samples,
        "seed": seed,
        "configurations_with_an_overlap": anywhere,
        "pairs": rows + [_ground_row(link, lowest[link]) for link in links],
    }


def _adjacent(pair: Pair) -> bool:
    links = list(PARTS)
    return links.index(pair[1]) - links.index(pair[0]) == 1


def _distance(shapes: Shapes, placed: Mapping[str, Any], pair: Pair) -> float:
    first, second = pair
    return float(
        coal.distance(
            shapes[first],
            placed[first],
            shapes[second],
            placed[second],
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
    )


def _lowest(hull: Any, placed: Any) -> float:
    heights = hull.points() @ placed.getRotation()[2] + placed.getTranslation()[2]
    return float(np.min(heights))


def _row(pair: Pair, counts: dict[str, int] | None, nearest: float) -> dict[str, Any]:
    row: dict[str, Any] = {"first": pair[0], "second": pair[1]}
    if counts is None:
        return row | {"allowed": True, "reason": "adjacent"}
    if counts["hulls"] == 0:
        return row | {"allowed": True, "reason": "never", "nearest": round(nearest, 4)}
    return row | {"allowed": False, "overlaps": counts}


def _ground_row(link: str, lowest: float) -> dict[str, Any]:
    row: dict[str, Any] = {"first": link, "second": GROUND}
    if link == "base_link":
        return row | {"allowed": True, "reason": "stands on it"}
    nearest = round(lowest - FLOOR_Z, 4)
    if nearest > 0.0:
        return row | {"allowed": True, "reason": "never", "nearest": nearest}
    return row | {"allowed": False}


def main() -> None:
    """Sample and write ``allowed_pairs.json``."""
    begin = time.perf_counter()
    result = {
        "origin": (
            "Written by urdf/make_allowed_pairs.py: configurations drawn uniformly inside the "
            f"limits of {URDF_PATH.name}, all six joints. 'adjacent' links share a hinge and "
            "always touch; 'never' pairs did not meet in any sample and came no nearer than "
            "'nearest' [m], so a check with a margin below that may leave them out. The ground is "
            f"the plane z = {FLOOR_Z} m in base_link, the table under the base. 'overlaps' counts "
            "configurations: of the convex hulls, and of what is drawn inside them."
        ),
        **sample(SAMPLES, SEED),
    }
    assert ROBOT.allowed_pairs is not None
    ROBOT.allowed_pairs.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    for row in result["pairs"]:
        print(*(f"{value}" for value in row.values()), sep="  ")
    print(f"{result['configurations_with_an_overlap']}  {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
