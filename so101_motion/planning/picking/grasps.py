"""List the grasps of an item that five joints can reach, the best first.

A grasp is a configuration in which the fixed finger stands beside the item, ``BESIDE`` away, and
the moving jaw can close on the opposite side. Directions of approach lie in the arm's own vertical
plane, for five joints allow no others: from above, tilted, and from the side. For each, the jaws
may close along every direction in which the item has two opposite surfaces. These are found on the
convex hull of the item: lines across it, at several depths between the fingers, give its thickness
and both contact normals there (an antipodal pair). The closed forms give the joints for all of them
at once; the arm's plane is then a little aside of the wanted one, because the finger is beside the
roll axis, so that is done twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import coal
import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.common.units import to_rad
from so101_motion.planning.cell.handover import JawGeometry
from so101_motion.planning.collision.bodies import hull_of
from so101_motion.planning.collision.coal_shapes import held_shape, hull_points, placed
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import (
    LINKS,
    Obstacle,
    Shape,
    ShapeFile,
)
from so101_motion.planning.collision.shape_files import read_shape
from so101_motion.planning.kinematics.arm_geometry import JOINT_SLACK, ArmStructure
from so101_motion.planning.kinematics.batch_ik import (
    configurations_at,
    facing_turned,
    roll_for,
    rotation_angles,
)
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import JAW_LINK, RobotModel

THICKEST = 0.06
"""The thickest item that is gripped [m]. Chosen: the jaw then stands 34 deg off the fixed finger,
and with more it pushes the item out (a coefficient of friction of 0.35 on both sides holds it)."""

THINNEST = 0.004  # the thinnest [m]; chosen: below 2 mm a jaw passes for closed
SQUARE = to_rad(20.0)  # largest angle between a jaw's direction and a surface; chosen, by friction
BESIDE = 0.002  # gap beside the fixed finger before the jaw closes [m]; chosen
TIP = 0.0063  # how far the fixed finger's tip is beyond the frame ``jaw_tip`` [m]; urdf/README.md
OVERLAPS = (0.018, 0.012, 0.007)  # how far the fingers reach past the item's near side [m]; chosen
TILTS = tuple(to_rad(each) for each in (0.0, 20.0, 40.0, 60.0, 80.0, -20.0))
WIDER = (to_rad(16.0), to_rad(7.0))  # how far the jaw is open beyond the item; chosen, 16 and 7 mm
ROOM = 0.0015  # between the open jaw and the item [m]; chosen
BACKS = (0.05, 0.03)  # straight way in and out [m]; chosen: more than the fingers' overlap
_LONG = 0.04  # longer items are gripped near their ends as well [m]; chosen
_FROM_END = 0.012  # distance of such a grasp from the end [m]; chosen: fingers are 20 mm wide
_BALL = 96  # directions by which a round item is sampled
_TURN = to_rad(12.0)  # largest turn from the wanted pose; contacts are judged where it is reached
_EXACT = to_rad(0.5)  # the same for the second time
_SAME_BRANCH = 1.5  # largest joint motion of a straight way in [rad]; chosen
_ROOMY = 0.005  # a grasp with so much more room than the margin is better [m]; chosen
_FAR = 0.25  # grasps farther out are worse [m]; chosen
_ASKED = 12  # grasps in contact for which is found out with what
_DEPTHS = (0.15, 0.4, 0.7, 1.0)  # of the lines across an item, shares of the overlap
_BESIDES = (-0.006, 0.0, 0.006)  # and beside the middle of the fingers [m]

Kind = Literal["above", "side"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grasp:
    """One way to grip an item.

    Attributes:
        q: The arm's configuration around the item, shape (5,), [rad].
        q_before: That before the straight way in, shape (5,), [rad].
        T_item_tip: Pose of the frame ``jaw_tip`` in the item's frame, jaw open: z along the
            approach, x from the moving jaw to the fixed finger.
        thickness: The item's between the jaws [m].
        square: Largest angle between the jaws' direction and the surfaces [rad].
        tilt: Between the approach and straight down [rad].
        q_jaw_open: Where the jaw stands before it closes [rad].
        cost: Less is better.
    """

    q: Array
    q_before: Array
    T_item_tip: SE3
    thickness: float
    square: float
    tilt: float
    q_jaw_open: float
    cost: float

    @property
    def kind(self) -> Kind:
        return "above" if abs(self.tilt) < to_rad(45.0) else "side"

    def is_like(self, other: SE3) -> bool:
        """Whether ``other``, a ``T_item_tip``, is within 5 mm and 15 deg of this one."""
        T = self.T_item_tip
        turned = math.acos(min(max((np.trace(T.R.T @ other.R) - 1.0) / 2.0, -1.0), 1.0))
        return bool(np.linalg.norm(T.p - other.p) < 0.005) and turned < to_rad(15.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wishes:
    """What a user says about grasps.

    Attributes:
        kinds: From where the item may be approached.
        only: Poses of ``jaw_tip`` in the item's frame to use instead of those that are searched.
        never: Such poses that are not to be used, nor others like them.
    """

    kinds: tuple[Kind, ...] = ("above", "side")
    only: tuple[SE3, ...] = ()
    never: tuple[SE3, ...] = ()


@dataclass(slots=True)
class Tally:
    """How many grasps were looked at, and what forbade them; for the message."""

    narrowest: float = math.inf  # the least thickness between opposite surfaces [m]
    surfaces: int = 0  # pairs of surfaces that fit between the jaws
    reached: int = 0  # of them, those that five joints reach
    unwanted: int = 0  # of those that are free, what the user does not want
    blockers: dict[str, int] = field(default_factory=dict)


class Hull(NamedTuple):
    """The convex hull of an item.

    A point x is inside if ``normals @ x <= offsets``. Large faces come first.
    """

    points: Array  # its corners, shape (k, 3), [m]
    normals: Array  # shape (m, 3)
    offsets: Array  # shape (m,), [m]

    def at(self, T: SE3) -> Hull:
        """The same hull in another frame."""
        normals = self.normals @ T.R.T
        return Hull(self.points @ T.R.T + T.p, normals, self.offsets + normals @ T.p)


@lru_cache(maxsize=32)
def _hull_by(_: bytes, shape: Shape) -> Hull:
    from scipy.spatial import ConvexHull

    found = ConvexHull(hull_points(shape, _BALL))
    corners = found.points[found.simplices]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(sides, axis=1)
    planes, number = np.unique(np.round(found.equations, 7), axis=0, return_inverse=True)
    order = np.argsort(-np.bincount(number.ravel(), areas), kind="stable")
    return Hull(found.points[found.vertices], planes[order, :3], -planes[order, 3])


def item_hull(shape: Shape | ShapeFile) -> Hull:
    """The convex hull of an item, cached."""
    shape = read_shape(shape)
    return _hull_by(shape.fingerprint(), shape)


class _Rows(NamedTuple):
    """Grasps that are looked at, n of them."""

    R: Array  # rotations of ``jaw_tip`` in the base frame, (n, 3, 3)
    overlap: Array  # how far the tip reaches past the item's near side, (n,) [m]
    aside: Array  # of the item's middle, along y, (n,) [m]

    def only(self, which: Any) -> _Rows:
        return _Rows(self.R[which], self.overlap[which], self.aside[which])


class _Contacts(NamedTuple):
    p: Array  # where ``jaw_tip`` is in the base frame, (n, 3) [m]
    thickness: Array  # (n,) [m]; infinite where the jaws would close on nothing
    square: Array  # (n,) [rad]


class GraspSearch:
    """Finds grasps for one arm.

    Args:
        model: The arm.
        structure: Its closed forms.
    """

    def __init__(self, model: RobotModel, structure: ArmStructure) -> None:
        self._model, self._structure = model, structure
        self._chain = ArmChain(model, "jaw_tip")
        self.jaw = JawGeometry(model)
        self._R_tip_tool = model.rotation_to_tool("jaw_tip")
        self._T_tip_base = model.frame(np.zeros(5), "jaw_tip").inverse

    def find(
        self,
        item: Obstacle,
        collision: CollisionModel,
        q_start: Array,
        wishes: Wishes,
        *,
        finer: int = 1,
    ) -> tuple[list[Grasp], Tally]:
        """The free grasps of an item, the best first, and what forbade the others.

        Args:
            item: The item.
            collision: For a scene in which gripper and jaw may touch the item.
            q_start: Where the arm is, shape (5,), [rad].
            wishes: What the user says about grasps.
            finer: How many times more directions are tried.
        """
        T, tally = item.T_base_obstacle, Tally()
        hull = item_hull(item.shape).at(T)
        if wishes.only:
            rows = self._wished(hull, [T @ each for each in wishes.only])
        else:
            rows = self._rows(hull, wishes, finer)
        rows, met = self._fitting(hull, rows, tally)
        tally.surfaces = len(rows.R)
        q, number = self.solve(met.p, rows.R)
        R = self._chain.rotations(q)
        near = rotation_angles(np.swapaxes(rows.R[number], 1, 2) @ R) < _TURN
        q, number = q[near], number[near]
        # Once more, with the rotations that are reached: the finger is beside the arm's plane.
        rows, met = self._fitting(hull, rows.only(number)._replace(R=R[near]), tally)
        q, number = self.solve(met.p, rows.R)
        R = self._chain.rotations(q)
        near = rotation_angles(np.swapaxes(rows.R[number], 1, 2) @ R) < _EXACT
        q, R, number = q[near], R[near], number[near]
        before, reaches = self._before(q, R)
        q, R, number, before = q[reaches], R[reaches], number[reaches], before[reaches]
        tally.reached = len(q)
        grasps = list[Grasp]()
        if len(q) == 0:
            return grasps, tally
        closed = np.array([self.jaw.angle_for(t) for t in met.thickness[number] + 2.0 * BESIDE])
        left: Any = np.ones(len(q), dtype=bool)
        shuts = np.logical_not(collision.touching(q, np.minimum(closed, self.jaw.opened)))
        for wider in WIDER:
            opened = np.minimum(closed + wider, self.jaw.opened)
            touches = np.logical_or(
                collision.touching(q, opened), collision.touching(before, opened)
            )
            free: Any = left & shuts & np.logical_not(touches)
            left &= np.logical_not(free)
            roomy = free & np.logical_not(collision.touching(q, opened, extra=_ROOMY))
            for k in np.flatnonzero(free):
                T_tip = SE3(R[k], self._chain.positions(q[k][None])[0])
                tilt = math.acos(min(max(-float(R[k, 2, 2]), -1.0), 1.0))
                square = float(met.square[number[k]])
                deep = float(rows.overlap[number[k]])
                grasp = Grasp(
                    q=q[k],
                    q_before=before[k],
                    T_item_tip=T.inverse @ T_tip,
                    thickness=float(met.thickness[number[k]]),
                    square=square,
                    tilt=tilt,
                    q_jaw_open=float(opened[k]),
                    cost=(square / SQUARE) ** 2
                    + tilt / math.pi
                    + (0.0 if roomy[k] else 0.5)
                    + (OVERLAPS[0] - deep) / OVERLAPS[0]
                    + 30.0 * abs(float(rows.aside[number[k]]))
                    + 0.2 * float(np.abs(q[k] - q_start).max())
                    + 2.0 * max(float(np.hypot(*T_tip.p[:2])) - _FAR, 0.0) / _FAR,
                )
                if grasp.kind in wishes.kinds and not any(map(grasp.is_like, wishes.never)):
                    grasps.append(grasp)
                else:
                    tally.unwanted += 1
        for k in np.flatnonzero(left)[:: max(1, int(left.sum()) // _ASKED)]:
            pair = collision.first_contact(q[k], opened[k])
            pair = pair or collision.first_contact(q[k], closed[k])
            if pair := pair or collision.first_contact(before[k], opened[k]):
                other = pair[1] if pair[1] not in LINKS or pair[0] in LINKS else pair[0]
                tally.blockers[other] = tally.blockers.get(other, 0) + 1
        return sorted(grasps, key=lambda each: each.cost), tally

    def _before(self, q: Array, R: Array) -> tuple[Array, Any]:
        """Configurations before the straight way in, (n, 5) [rad], and which can be reached."""
        p, every = self._chain.positions(q), np.arange(len(q))
        before, reaches = np.zeros_like(q), np.zeros(len(q), dtype=bool)
        for back in BACKS:
            at, number = self.solve(p - back * R[:, :, 2], R)
            turned = rotation_angles(np.swapaxes(R[number], 1, 2) @ self._chain.rotations(at))
            away = np.where(turned < _EXACT, np.abs(at - q[number]).max(axis=1), np.inf)
            for k in every[~reaches]:
                own = np.flatnonzero(number == k)
                if len(own) and away[best := own[np.argmin(away[own])]] < _SAME_BRANCH:
                    before[k], reaches[k] = at[best], True
        return before, reaches

    def solve(self, p: Array, R: Array, frame: str = "jaw_tip") -> tuple[Array, Any]:
        """All configurations for poses of a frame (n, 3) [m] and (n, 3, 3), as near as it can be.

        Returns:
            Configurations (m, 5) [rad], inside the limits, with the frame at its point, and of
            which pose each is, (m,).
        """
        if len(p) == 0:
            return np.zeros((0, 5)), np.zeros(0, dtype=int)
        R_tool = R if frame == "tool" else R @ self._R_tip_tool
        structure = self._structure
        target, pitch = facing_turned(structure, frame, p, R_tool, 0.0)
        roll = roll_for(structure, target.pan, pitch, R_tool)
        grid = configurations_at(structure, frame, p, roll, pitch)
        number, *_ = inside = np.nonzero(grid.excess <= JOINT_SLACK)
        m = structure.measures
        return np.clip(grid.q[inside], m.lower, m.upper), number

    def clear_of_item(self, grasp: Grasp, item: Obstacle, q_jaw: float) -> bool:
        """Whether the jaw at an angle [rad] keeps ``ROOM`` from an item to be gripped."""
        return self._jaw_to(grasp, item, q_jaw) >= ROOM

    def angle_closed(self, grasp: Grasp, item: Obstacle) -> float:
        """The angle at which the jaw meets the item while it lies on the fixed finger [rad]."""
        low, high = self.jaw.closed, grasp.q_jaw_open
        for _ in range(9):
            middle = 0.5 * (low + high)
            if self._jaw_to(grasp, item, middle, pushed=BESIDE) > 0.0:
                high = middle
            else:
                low = middle
        return high

    def _jaw_to(self, grasp: Grasp, item: Obstacle, q_jaw: float, pushed: float = 0.0) -> float:
        """The distance of the jaw from the item, pushed towards the fixed finger [m]."""
        T_tip_jaw = self._T_tip_base @ self._model.link_placements(np.zeros(5), q_jaw)[JAW_LINK]
        T_tip_item = SE3.from_translation((pushed, 0.0, 0.0)) @ grasp.T_item_tip.inverse
        shape, _ = held_shape(read_shape(item.shape))
        return float(
            coal.distance(
                hull_of(JAW_LINK), placed(T_tip_jaw), shape, placed(T_tip_item),
                coal.DistanceRequest(), coal.DistanceResult(),
            )
        )  # fmt: skip

    def _rows(self, hull: Hull, wishes: Wishes, finer: int) -> _Rows:
        """Directions of approach and of closing for an item in the base frame."""
        middle, m = hull.points.mean(axis=0), self._structure.measures
        azimuth = math.atan2(middle[1] - m.pan[1], middle[0] - m.pan[0])
        outwards = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        tilts = np.array(TILTS)
        overlaps = np.array(OVERLAPS)
        if finer > 1:
            tilts = np.linspace(min(TILTS), max(TILTS), len(TILTS) * finer)
            overlaps = np.linspace(max(OVERLAPS), min(OVERLAPS), len(OVERLAPS) * finer)
        found = list[tuple[Array, float, float]]()
        for tilt in tilts:
            a = math.sin(tilt) * outwards - np.array([0.0, 0.0, math.cos(tilt)])
            for x in _across(hull, a, to_rad(12.0) / finer):
                y = np.cross(a, x)
                R = np.column_stack([x, y, a])
                extent = float(np.ptp(hull.points @ y))
                end = 0.5 * extent - _FROM_END
                asides = (0.0, end, -end) if extent > _LONG else (0.0,)
                found += [(R, o, aside) for o in overlaps for aside in asides]
        if not found:
            return _Rows(np.zeros((0, 3, 3)), np.zeros(0), np.zeros(0))
        return _Rows(*(np.array(each) for each in zip(*found, strict=True)))

    def _wished(self, hull: Hull, wanted: Sequence[SE3]) -> _Rows:
        """The rows for poses of ``jaw_tip`` in the base frame; the gap beside the item is ours."""
        inside = [(hull.points - each.p) @ each.R for each in wanted]
        return _Rows(
            np.array([each.R for each in wanted]),
            np.array([TIP - points[:, 2].min() for points in inside]),
            np.array([-points.mean(axis=0)[1] for points in inside]),
        )

    def _fitting(self, hull: Hull, rows: _Rows, tally: Tally) -> tuple[_Rows, _Contacts]:
        """Those of the rows that the jaws can grip."""
        met = _contacts(hull, rows)
        fits = met.square <= SQUARE
        tally.narrowest = min(tally.narrowest, float(met.thickness[fits].min(initial=math.inf)))
        fits &= (met.thickness <= THICKEST) & (met.thickness >= THINNEST)
        return rows.only(fits), _Contacts(*(each[fits] for each in met))


def _across(hull: Hull, a: Array, apart: float) -> list[Array]:
    """Directions of closing for an approach, those of large faces first, both ways."""
    found = list[Array]()
    for normal in hull.normals[np.abs(hull.normals @ a) < math.sin(SQUARE)]:
        x = normal - (normal @ a) * a
        x /= np.linalg.norm(x)
        if all(abs(float(x @ each)) < math.cos(apart) for each in found):
            found.append(x)
    return [sign * each for each in found for sign in (1.0, -1.0)]


def _contacts(hull: Hull, rows: _Rows) -> _Contacts:
    """Where the jaws would meet an item in the base frame: lines across it between the fingers."""
    n = len(rows.R)
    if n == 0:
        return _Contacts(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    x, y, a = rows.R[:, :, 0], rows.R[:, :, 1], rows.R[:, :, 2]
    nearest = (a @ hull.points.T).min(axis=1)
    middle = y @ hull.points.mean(axis=0) + rows.aside
    depth, beside = (each.ravel() for each in np.meshgrid(_DEPTHS, _BESIDES))
    z = nearest[:, None] + depth * rows.overlap[:, None]
    on_line = (middle[:, None] + beside)[..., None] * y[:, None] + z[..., None] * a[:, None]
    slope = x @ hull.normals.T  # (n, m)
    room = hull.offsets - on_line @ hull.normals.T  # (n, lines, m)
    flat = np.abs(slope) < 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        at = room / slope[:, None]
    upper = np.where((slope > 1e-9)[:, None], at, np.inf)
    lower = np.where((slope < -1e-9)[:, None], at, -np.inf)
    last, first = upper.min(axis=2), lower.max(axis=2)
    missed = (last <= first) | (flat[:, None] & (room < -1e-9)).any(axis=2)
    last, first = np.where(missed, -np.inf, last), np.where(missed, np.inf, first)
    every = np.arange(n)
    high, low = last.argmax(axis=1), first.argmin(axis=1)
    x_high, x_low = last[every, high], first[every, low]
    with np.errstate(invalid="ignore"):
        cos_high = slope[every, upper[every, high].argmin(axis=1)]
        cos_low = -slope[every, lower[every, low].argmax(axis=1)]
        square = np.arccos(np.clip(np.minimum(cos_high, cos_low), -1.0, 1.0))
    met = x_high > x_low
    thickness = np.where(met, x_high - x_low, np.inf)
    square = np.where(met, square, np.inf)
    p = (
        np.where(met, x_high + BESIDE, 0.0)[:, None] * x
        + middle[:, None] * y
        + (nearest + rows.overlap - TIP)[:, None] * a
    )
    return _Contacts(p, thickness, square)
