"""Where the arm would touch itself or the floor, and how far it stays away.

One of the two doors of Pinocchio (``model.py`` is the other), and the only one of coal.

How it works:

*Bodies.* Each link is one convex hull that contains the whole real part (``urdf/README.md``), so
a posture that is free here is free on the arm; the price is about one false alarm in a hundred.
The floor is a half-space. The jaw is placed by its own angle: an open gripper is wider.

*Pairs.* Links that hinge on each other always touch and some others never can; the table of
``so101_description`` says which and how that was found out. Base and shoulder cannot move towards
the floor, so only the links from the upper arm outwards are held against it.

*One posture* is one call into coal: kinematics, bounding boxes, and exact checks of the pairs
whose boxes meet. A posture is free if every pair keeps more than ``margin`` apart.

*A motion* is checked so that nothing is missed between postures. No point of the arm moves further
than ``travel`` metres along a joint motion: the joint angles passed, each times the distance of
the furthest point from that joint's axis. If all pairs keep ``c`` apart at some posture, nothing
touches within ``c`` of travel before and after it. So the motion is halved until each part has
a posture in its middle that clears half the part's travel, asking with the widest of a few
clearances that will do: far from everything, a handful of postures clear a whole move. What comes
out is a proof for the hulls: at least ``margin`` at every posture looked at, never contact between.

A model belongs to one thread, like everything that holds Pinocchio's data.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
import so101_description
from numpy.typing import ArrayLike

from so101_motion.geometry import Array
from so101_motion.planning.model import RobotModel

FLOOR = "floor"
"""The name of the floor in messages."""

FLOOR_Z = -0.0024
"""Height of the table in the base frame [m]: the underside of the base plate, from the official
model's lowest point."""

MARGIN = 0.003
"""How far bodies must stay apart at every posture looked at [m]. Chosen: what the printed parts,
their backlash (about 1 deg) and cables may add near the body, and small enough for tight poses."""

_WIDER = (2.0, 5.0, 12.0, 25.0)
"""Further clearances asked of motions, in margins. Chosen: the fastest of nine sets over 300
motions between random free postures."""


class Clearance(NamedTuple):
    """How close the closest two bodies are.

    Attributes:
        distance: Between their hulls [m]; negative by the depth if they overlap.
        first: A link by its human name, such as ``"upper arm"``.
        second: Another link or ``"floor"``.
    """

    distance: float
    first: str
    second: str

    def told(self, verb: str = "would be") -> str:
        """In words, such as ``"the jaw would be 2.0 mm into the floor"``."""
        if self.distance > 0.0:
            return f"the {self.first} {verb} {self.distance * 1e3:.1f} mm from the {self.second}"
        return f"the {self.first} {verb} {-self.distance * 1e3:.1f} mm into the {self.second}"


class CollisionModel:
    """Checks postures and motions for contact. Belongs to one thread.

    Attributes:
        margin: How far bodies must stay apart [m].
        floor_z: Height of the floor in the base frame [m], or None.
        pairs: The pairs of bodies that are checked, by their human names.
        reach: For each arm joint, a bound on how far a point moves per angle, shape (5,), [m/rad].
    """

    def __init__(
        self, model: RobotModel, *, floor_z: float | None = FLOOR_Z, margin: float = MARGIN
    ) -> None:
        if not 0.0 < margin < math.inf:
            raise ValueError(f"margin must be positive and finite, got {margin}")
        self.margin, self.floor_z = margin, floor_z
        self._model = model.pin_model
        self._data = self._model.createData()
        self._bodies = _arm_bodies(self._model)
        if floor_z is not None:
            _add_floor(self._bodies, floor_z)
        names = [body.name for body in self._bodies.geometryObjects]
        self.pairs = tuple((names[p.first], names[p.second]) for p in self._bodies.collisionPairs)
        self.reach = _reach(self._model, self._bodies)
        self._distances = pin.GeometryData(self._bodies)
        # From tight to wide; the first is the margin.
        self._levels = [
            (clearance, self._touches_within(clearance))
            for clearance in (margin, *(factor * margin for factor in _WIDER))
        ]
        self._touches = self._levels[0][1]
        self._q = np.zeros(self._model.nq)

    def is_free(self, q: ArrayLike, q_jaw: float = 0.0) -> bool:
        """Whether every pair of bodies keeps more than the margin apart.

        Args:
            q: Joint angles, shape (5,), [rad].
            q_jaw: Jaw angle [rad].
        """
        self._q[:5] = q
        self._q[5] = q_jaw
        return not self._touches(self._q)

    def distances(self, q: ArrayLike, q_jaw: float = 0.0) -> Array:
        """The distance of each pair in ``pairs`` [m], negative where they overlap.

        Args:
            q: Joint angles, shape (5,), [rad].
            q_jaw: Jaw angle [rad].
        """
        self._q[:5] = q
        self._q[5] = q_jaw
        pin.computeDistances(self._model, self._data, self._bodies, self._distances, self._q)
        return np.array([result.min_distance for result in self._distances.distanceResults])

    def clearance(self, q: ArrayLike, q_jaw: float = 0.0) -> Clearance:
        """The closest pair of bodies.

        Args:
            q: Joint angles, shape (5,), [rad].
            q_jaw: Jaw angle [rad].
        """
        distances = self.distances(q, q_jaw)
        closest = int(np.argmin(distances))
        return Clearance(float(distances[closest]), *self.pairs[closest])

    def first_contact(self, q: ArrayLike, q_jaw: float = 0.0) -> tuple[str, str] | None:
        """The two bodies that are too close, the closest if there are several, or None.

        Args:
            q: Joint angles, shape (5,), [rad].
            q_jaw: Jaw angle [rad].
        """
        if self.is_free(q, q_jaw):
            return None
        _, first, second = self.clearance(q, q_jaw)
        return first, second

    def travel(self, points: Array) -> Array:
        """A bound on how far any point of the arm moves along a polyline.

        Args:
            points: Joint angles, shape (n, 5), [rad].

        Returns:
            Accumulated from the first point, shape (n,), [m].
        """
        steps: Array = np.abs(np.diff(points, axis=0)) @ self.reach
        return np.concatenate(([0.0], np.cumsum(steps)))

    def blocked_posture(self, points: Array, q_jaw: float = 0.0) -> Array | None:
        """A posture on the straight lines through ``points`` that is too close, or None.

        None is a proof that the whole motion, ends included, is free of contact. The order is
        middle first, because motions are most often blocked far from their ends.

        Args:
            points: Joint angles, shape (n, 5), n >= 1, [rad].
            q_jaw: Jaw angle during the motion [rad].
        """
        travelled = self.travel(points).tolist()
        at = _along(points, travelled)
        posture, levels, margin = self._q, self._levels, self.margin
        widest = levels[-1][0]
        posture[5] = q_jaw
        parts = deque([(0.0, travelled[-1])])
        while parts:
            begin, end = parts.popleft()
            half = 0.5 * (end - begin)
            middle = begin + half
            posture[:5] = at(middle)
            # No clearance proves a part this long; a look at its middle may still refuse it.
            wanted = half if half <= widest else margin
            clearance, touches = next(level for level in levels if level[0] >= wanted)
            if touches(posture):
                if clearance == margin or self._touches(posture):
                    return posture[:5].copy()
            elif clearance >= half:
                continue
            parts.append((begin, middle))
            parts.append((middle, end))
        return None

    def _touches_within(self, clearance: float) -> Callable[[Array], bool]:
        """A check of one posture (all six joints) for pairs within ``clearance``."""
        results = pin.GeometryData(self._bodies)
        for request in results.collisionRequests:
            request.security_margin = clearance
        # The naive manager tests every bounding box against every other; for eight bodies that
        # beats keeping a tree up to date.
        manager = pin.BroadPhaseManager_NaiveCollisionManager(self._model, self._bodies, results)
        stop_at_first = pin.CollisionCallBackDefault(self._bodies, results, True)
        model, data, check = self._model, self._data, pin.computeCollisions

        def touches(q_full: Array) -> bool:
            return bool(check(model, data, manager, stop_at_first, q_full))

        return touches


def _along(points: Array, travelled: list[float]) -> Callable[[float], Array]:
    """The point after some travel along a polyline, as a function."""
    if len(points) == 1 or travelled[-1] == 0.0:
        return lambda _: points[0]
    if len(points) == 2:
        start, rate = points[0], (points[1] - points[0]) / travelled[1]

        def on_line(s: float) -> Array:
            q: Array = start + rate * s
            return q

        return on_line

    def on_polyline(s: float) -> Array:
        k = min(max(bisect_right(travelled, s), 1), len(travelled) - 1)
        begin, end = travelled[k - 1], travelled[k]
        part = (s - begin) / (end - begin) if end > begin else 0.0
        q: Array = points[k - 1] + part * (points[k] - points[k - 1])
        return q

    return on_polyline


def _arm_bodies(model: Any) -> Any:
    """The links' hulls and the pairs of them that can meet."""
    bodies = pin.GeometryModel()
    parts = so101_description.PARTS
    for link, part in parts.items():
        frame = model.frames[model.getFrameId(link)]
        points = coal.StdVec_Vec3s()
        for vertex in so101_description.load_hull(part).vertices:
            points.append(vertex)
        hull = coal.ConvexBase.convexHull(points, False, "Qt")
        bodies.addGeometryObject(
            pin.GeometryObject(
                part.replace("_", " "),
                frame.parentJoint,
                model.getFrameId(link),
                frame.placement,
                hull,
            )
        )
    allowed = so101_description.load_allowed_pairs()
    links = list(parts)
    for i, first in enumerate(links):
        for j in range(i + 1, len(links)):
            if frozenset((first, links[j])) not in allowed:
                bodies.addCollisionPair(pin.CollisionPair(i, j))
    return bodies


def _add_floor(bodies: Any, floor_z: float) -> None:
    """Everything below ``floor_z``, held against the links that can get there."""
    plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), floor_z)
    floor = bodies.addGeometryObject(pin.GeometryObject(FLOOR, 0, 0, pin.SE3.Identity(), plane))
    first_that_lowers = bodies.getGeometryId("upper arm")
    for i in range(first_that_lowers, floor):
        bodies.addCollisionPair(pin.CollisionPair(i, floor))


def _reach(model: Any, bodies: Any) -> Array:
    """How far from each arm joint's axis the bodies it carries can ever be, shape (5,), [m].

    From the hand back to the base: what the next joint carries stays in a ball around that joint,
    whatever its angle, and the ball is offset from this joint's axis by the link between.
    """
    hulls = {
        body.parentJoint: np.asarray(body.geometry.points()) @ body.placement.rotation.T
        + body.placement.translation
        for body in bodies.geometryObjects
        if body.parentJoint > 0
    }
    reach, ball, offset = np.zeros(model.njoints), 0.0, np.zeros(3)
    for joint in range(model.njoints - 1, 0, -1):
        points = hulls[joint]
        across = float(np.linalg.norm(points[:, :2], axis=1).max())
        reach[joint] = max(across, float(np.linalg.norm(offset[:2])) + ball)
        around = float(np.linalg.norm(points, axis=1).max())
        ball = max(around, float(np.linalg.norm(offset)) + ball)
        offset = model.jointPlacements[joint].translation
    return np.array(reach[1:6])
