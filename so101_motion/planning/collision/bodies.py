"""Build the collision bodies and pairs for Pinocchio and coal: links, held objects, obstacles.

*Bodies.* Each link is one convex hull that contains the whole real part (``urdf/README.md``). A
box, a sphere, a capsule is itself; a mesh is its triangles; a point cloud an octree of full cubes;
the floor a half-space. What the gripper holds rides on the gripper's link; a mesh or a cloud that
is held is taken as its convex hull, which is cheap and on the safe side.

*Pairs.* Links that hinge on each other always touch and some others never can; the table of
``so101_description`` says which and how that was found out. Base and shoulder cannot move towards
the floor, nor the base towards anything, so these are not checked. What is held may touch the
gripper and the jaw, and whatever the scene allows. An obstacle is held only against the links that
can come near it: a link stays in a ball around the pan's axis whatever the joints do.

*Margins.* A scene's margin says how well its obstacles are known. How far the links must stay apart
from each other does not depend on that, so a margin wider than the usual one does not count there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
import so101_description

from so101_motion.common.geometry import SE3, Array, frozen_array
from so101_motion.planning.checkpoint import Checkpoint, wanted
from so101_motion.planning.collision.coal_shapes import (
    convex_hull,
    full_cubes,
    held_shape,
    octree,
    standing_shape,
)
from so101_motion.planning.collision.motion_bounds import MotionBounds
from so101_motion.planning.collision.scene import (
    FLOOR,
    HOLDERS,
    LINKS,
    MARGIN,
    Attached,
    Box,
    Capsule,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
    StandingArm,
)
from so101_motion.planning.collision.shape_files import read_shape

NEAR = 0.1
"""Obstacles that a link can never come nearer than this are not held against it [m]. Chosen: more
than the widest clearance that a proof asks for."""

SUNK = 0.001
"""So deep the base may stand in what it is screwed to [m]. Chosen: a table that is given as a box
has its top where the base plate has its underside."""

_LOWERING = frozenset(LINKS[LINKS.index("upper arm") :])
"""The links that can move towards the floor."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bodies:
    """Everything that can touch, in the form of Pinocchio.

    Attributes:
        geometry: The bodies and the pairs of them that are checked, Pinocchio's.
        pairs: Those pairs by name.
        margins: How far each pair must stay apart, shape (len(pairs),), [m].
        moved_by: How many of the arm's joints move the first and the second body of each pair,
            integers, shape (len(pairs), 2).
        swapped: Whether coal answers for a pair as if its second body had been named first.
        levers: How far from each arm joint's axis anything it moves can be.
        standing: What stands around, by its index among the bodies: its shape as it was given, of
            a cloud the cubes that are near.
    """

    geometry: Any
    pairs: tuple[tuple[str, str], ...]
    margins: Array
    moved_by: Any
    swapped: tuple[bool, ...]
    levers: MotionBounds
    standing: dict[int, Standing]

    def __post_init__(self) -> None:
        object.__setattr__(self, "margins", frozen_array(self.margins, (len(self.pairs),)))


class Cubes(NamedTuple):
    """The full cubes of a point cloud.

    Attributes:
        middles: Where they are in the cloud's frame, shape (n, 3), [m].
        edge: How long their edges are [m].
    """

    middles: Array
    edge: float


class Hull(NamedTuple):
    """The convex hull of points, widened all around.

    Attributes:
        points: In a frame of its own, shape (n, 3), [m].
        radius: By how much [m].
    """

    points: Array
    radius: float


Standing = Box | Sphere | Capsule | Mesh | Cubes | Hull
"""The form of an obstacle."""


class _Mover(NamedTuple):
    """A body that joints may move: a link or something held.

    Attributes:
        name: What messages call it.
        joint: The joint it hangs on, 0 for none.
        placement: Where it is in that joint's frame, Pinocchio's.
        shape: coal's.
        points: It lies inside their hull; in the joint's frame, shape (n, 3), [m].
    """

    name: str
    joint: int
    placement: Any
    shape: Any
    points: Array


def bodies_in(model: Any, scene: Scene, checkpoint: Checkpoint = wanted) -> Bodies:
    """The bodies of an arm (a Pinocchio model with six joints) and of a scene."""
    gathered = _Gathered(model, _carried(_Same(model), scene.attached))
    gathered.pair_movers(scene.attached)
    if scene.floor_z is not None:
        gathered.add_floor(scene.floor_z)
    for obstacle in scene.obstacles:
        checkpoint()
        gathered.add_obstacle(obstacle, checkpoint)
    for arm in scene.arms:
        checkpoint()
        gathered.add_arm(arm)
    allowed = set(scene.may_touch)
    allowed |= {
        frozenset((held.name, other)) for held in scene.attached for other in held.may_touch
    }
    for arm in scene.arms:
        allowed |= _passed(scene.attached, arm)
    return gathered.bodies(allowed, scene.margin)


def bodies_without(model: Any, attached: tuple[Attached, ...], left_out: frozenset[str]) -> Bodies:
    """The bodies of an arm and of what it holds, but for some; no pair of them is checked."""
    carried = _carried(_Same(model), attached)
    kept = [each for each in carried.movers if each.name not in left_out]
    return _Gathered(model, carried._replace(movers=kept)).bodies(set(), 0.0)


def _passed(attached: tuple[Attached, ...], other: StandingArm) -> set[frozenset[str]]:
    """The pairs that may touch because an arm and one that stands pass something on."""
    given = {each.name for each in attached if each.passed_to == other.name}
    taken = {each.name for each in other.attached if each.passed_to}
    pairs = (*product(given, HOLDERS), *product(HOLDERS | given, taken))
    return {frozenset((mine, other.called(theirs))) for mine, theirs in pairs}


def around_base(model: Any, scene: Scene) -> str | None:
    """What the base stands in, deeper than ``SUNK``, by name; None if it is free.

    Motions are not held against this, for no joint moves the base. Other arms keep their room.
    """
    _, base = next(iter(_hulls().values()))
    standing = [
        *((each.name, _shape_of(each), each.T_base_obstacle) for each in scene.obstacles),
        *((name, part.shape, T) for arm in scene.arms for name, part, T in _parts_of(model, arm)),
    ]
    for name, shape, T in standing:
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        at = coal.Transform3s(np.array(T.R), T.p + np.array([0.0, 0.0, -SUNK]))
        coal.collide(base, coal.Transform3s(), shape, at, request, result)
        if result.isCollision():
            return name
    return None


def _shape_of(obstacle: Obstacle) -> Any:
    form = read_shape(obstacle.shape)
    if isinstance(form, PointCloud):
        return octree(full_cubes(form, wanted), form.resolution)
    return standing_shape(form)


class _Part(NamedTuple):
    """A link of an arm that stands, or something it holds, widened.

    Attributes:
        name: What messages of that arm call it.
        joint: The joint it hangs on, 0 for none.
        shape: coal's, in the joint's frame.
        form: The same as numbers.
    """

    name: str
    joint: int
    shape: Any
    form: Hull


@lru_cache(maxsize=16)
def _widened(same: _Same, attached: tuple[Attached, ...], radius: float) -> list[_Part]:
    """The links of an arm and what it holds, widened all around by a radius [m]."""
    parts = []
    for each in reversed(_carried(same, attached).movers):
        shape = convex_hull(each.points)
        shape.setSweptSphereRadius(radius)
        form = Hull(np.array(shape.points()), radius)
        parts.append(_Part(each.name, each.joint, shape, form))
    return parts


def _parts_of(model: Any, arm: StandingArm) -> Iterator[tuple[str, _Part, SE3]]:
    """The parts of an arm that stands, at each of its configurations, and what messages call them.

    They are widened by the arm's room.
    """
    data, T_base_arm = model.createData(), _placement(arm.T_base_arm)
    parts = _widened(_Same(model), arm.attached, arm.room)
    for q in arm.q:
        pin.forwardKinematics(model, data, np.array(q))
        for part in parts:
            T = T_base_arm * data.oMi[part.joint]
            yield arm.called(part.name), part, SE3(T.rotation, T.translation)


class _Gathered:
    """Bodies and pairs as they come together."""

    def __init__(self, model: Any, carried: _Carried) -> None:
        self._geometry = pin.GeometryModel()
        self._model = model
        self._movers, self._levers, self._spans = carried
        self._pairs: list[tuple[int, int]] = []
        self._standing: dict[int, Standing] = {}
        for each in self._movers:
            self._add(each.name, each.joint, each.placement, each.shape)
        self._centre = np.array(model.jointPlacements[1].translation)

    def pair_movers(self, attached: tuple[Attached, ...]) -> None:
        """Pairs of links that can meet, and things held with the links that do not hold them."""
        index = {each.name: i for i, each in enumerate(self._movers)}
        free_to_meet = _link_pairs()
        for held in attached:
            for link in LINKS:
                if link not in HOLDERS:
                    self._pairs.append((index[held.name], index[link]))
        self._pairs += [(index[outer], index[inner]) for inner, outer in free_to_meet]

    def add_floor(self, floor_z: float) -> None:
        """Everything below ``floor_z`` [m]."""
        plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), floor_z)
        floor = self._add(FLOOR, 0, pin.SE3.Identity(), plane)
        for i, each in enumerate(self._movers):
            if each.name in _LOWERING or each.name not in LINKS:
                self._pairs.append((i, floor))

    def add_obstacle(self, obstacle: Obstacle, checkpoint: Checkpoint) -> None:
        """Something that stands, unless nothing can come near it."""
        form, T = read_shape(obstacle.shape), obstacle.T_base_obstacle
        given: Standing
        if isinstance(form, PointCloud):
            given = Cubes(self._in_reach(form, T, checkpoint), form.resolution)
            if len(given.middles) == 0:
                return
            checkpoint()
            shape = octree(*given)
        else:
            given, shape = form, standing_shape(form)
        self._stand(obstacle.name, given, shape, T)

    def add_arm(self, arm: StandingArm) -> None:
        """An arm that stands."""
        for name, part, T in _parts_of(self._model, arm):
            self._stand(name, part.form, part.shape, T)

    def _stand(self, name: str, given: Standing, shape: Any, T: SE3) -> None:
        """Something that stands, if anything can come near it."""
        shape.computeLocalAABB()
        away = float(np.linalg.norm(T @ shape.aabb_center - self._centre)) - shape.aabb_radius
        near = [
            i
            for i, (each, span) in enumerate(zip(self._movers, self._spans, strict=True))
            if each.joint > 0 and span + NEAR > away
        ]
        if near:
            this = self._add(name, 0, _placement(T), shape)
            self._standing[this] = given
            self._pairs += [(i, this) for i in near]

    def _in_reach(self, cloud: PointCloud, T: SE3, checkpoint: Checkpoint) -> Array:
        """The cubes of a cloud at ``T`` that the arm can come near: often a small part of it."""
        cubes = full_cubes(cloud, checkpoint)
        away = np.linalg.norm(cubes @ T.R.T + (T.p - self._centre), axis=1)
        diagonal = math.sqrt(3.0) * cloud.resolution
        return np.asarray(cubes[away < max(self._spans) + NEAR + diagonal])

    def bodies(self, allowed: set[frozenset[str]], margin: float) -> Bodies:
        """What has come together, without the pairs that may touch."""
        objects = list(self._geometry.geometryObjects)
        names = [each.name for each in objects]
        movable = [min(each.parentJoint, 5) for each in objects]
        kept = [(a, b) for a, b in self._pairs if frozenset((names[a], names[b])) not in allowed]
        for pair in kept:
            self._geometry.addCollisionPair(pin.CollisionPair(*pair))
        own = min(margin, MARGIN)
        links = {i for i, name in enumerate(names) if name in LINKS}
        return Bodies(
            geometry=self._geometry,
            pairs=tuple((names[a], names[b]) for a, b in kept),
            margins=np.array([own if links.issuperset(pair) else margin for pair in kept]),
            moved_by=np.array([(movable[a], movable[b]) for a, b in kept], int).reshape(-1, 2),
            # Octrees come first, whatever was asked (observed in coal 3.0.3).
            swapped=tuple(isinstance(objects[b].geometry, coal.OcTree) for _, b in kept),
            levers=self._levers,
            standing=self._standing,
        )

    def _add(self, name: str, joint: int, placement: Any, shape: Any) -> int:
        return int(
            self._geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, shape))
        )


class _Same:
    """A Pinocchio model to look something up by: the very same object."""

    def __init__(self, model: Any) -> None:
        self.model = model

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.model is self.model

    def __hash__(self) -> int:
        return id(self.model)


class _Carried(NamedTuple):
    """An arm with what it holds, whatever is around.

    Attributes:
        movers: Its bodies.
        levers: How far from each joint's axis anything it moves can be.
        spans: Until where each body can be from the pan's joint [m].
    """

    movers: Sequence[_Mover]
    levers: MotionBounds
    spans: Sequence[float]


@lru_cache(maxsize=16)
def _carried(same: _Same, attached: tuple[Attached, ...]) -> _Carried:
    """Made once: scenes change more often."""
    model = same.model
    # The outermost first: they are hit most often, and bodies are looked at in this order.
    movers = [*_held(model, attached), *reversed(list(_links(model)))]
    steps = [float(np.linalg.norm(model.jointPlacements[j].translation)) for j in range(2, 7)]
    # The links between, then itself.
    spans = [
        sum(steps[: max(0, each.joint - 1)]) + float(np.linalg.norm(each.points, axis=1).max())
        for each in movers
    ]
    return _Carried(movers, _levers(model, movers), spans)


def _links(model: Any) -> Iterator[_Mover]:
    for link, (part, hull) in _hulls().items():
        frame = model.frames[model.getFrameId(link)]
        yield _mover(part.replace("_", " "), frame, SE3.identity(), hull, hull.points())


def _held(model: Any, attached: tuple[Attached, ...]) -> Iterator[_Mover]:
    frame = model.frames[model.getFrameId("tool")]
    for held in attached:
        shape, points = held_shape(read_shape(held.shape))
        yield _mover(held.name, frame, held.T_tool_object, shape, points)


def _mover(name: str, frame: Any, T_frame_body: SE3, shape: Any, points: Array) -> _Mover:
    placement = frame.placement * _placement(T_frame_body)
    in_joint = np.asarray(points) @ placement.rotation.T + placement.translation
    return _Mover(name, int(frame.parentJoint), placement, shape, in_joint)


def _placement(T: SE3) -> Any:
    return pin.SE3(np.array(T.R), np.array(T.p))


@cache
def _hulls() -> dict[str, tuple[str, Any]]:
    """The hull of each link with the name of its part; read once, for they never change."""
    return {
        link: (part, convex_hull(so101_description.load_hull(part).vertices))
        for link, part in so101_description.PARTS.items()
    }


def hull_of(link: str) -> Any:
    """The hull of a link by its name in the URDF, in its frame; coal's."""
    return _hulls()[link][1]


@cache
def _link_pairs() -> tuple[tuple[str, str], ...]:
    """The pairs of links that can meet, the inner one first."""
    allowed = so101_description.load_allowed_pairs()
    human = {link: part.replace("_", " ") for link, part in so101_description.PARTS.items()}
    links = list(human)
    return tuple(
        (human[inner], human[outer])
        for i, inner in enumerate(links)
        for outer in links[i + 1 :]
        if frozenset((inner, outer)) not in allowed
    )


def _levers(model: Any, movers: list[_Mover]) -> MotionBounds:
    joints = range(1, model.njoints)
    offsets = [model.jointPlacements[joint] for joint in joints]
    return MotionBounds(
        [SE3(each.rotation, each.translation) for each in offsets],
        [
            np.concatenate([np.zeros((1, 3)), *(e.points for e in movers if e.joint == j)])
            for j in joints
        ],
    )
