"""Build the collision bodies and pairs for coal: links, held objects, obstacles.

*Bodies.* Each link is one convex hull that contains the whole real part (``urdf/README.md``).
Boxes, spheres and capsules are used as they are; a mesh is its convex parts and other triangles; a
point cloud an octree of full cubes; what surfaces enclose is solid (``solids.py``); the floor is a
half-space. Held objects move with the gripper's link; a held mesh or cloud is replaced by its
convex hull, which is cheap and on the safe side.

*Pairs.* Links joined by a hinge always touch, and some others never can; the table of
``so101_description`` says which. Base and shoulder cannot move towards the floor, nor the base
towards anything. Held objects may touch the gripper, the jaw and what the scene allows. An obstacle
is checked only against links that can come near it: each stays in a ball around the pan joint.

*Margins.* A scene's margin says how well its obstacles are known. The distance that links keep from
each other does not depend on that, so it never gets wider than the default margin.

*Motion bounds* are upper bounds on the distance of moved points from each joint's axis, from the
gripper back to the base: the parts that the next joint carries stay in a ball around that joint,
and the link between offsets that ball from this joint's axis (F. Schwarzer, M. Saha, J.-C. Latombe,
Adaptive Dynamic Collision Checking, IEEE T-RO 2005). The jaw does not move during a motion.
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

from so101_motion.common.geometry import SE3, Array, freeze, frozen_array, rot_z
from so101_motion.planning.checkpoint import Checkpoint, never_abandoned
from so101_motion.planning.collision.coal_shapes import (
    convex_hull,
    cube_middles,
    cube_numbers,
    full_cubes,
    held_shape,
    kept_hull,
    octree,
    standing_shape,
)
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
from so101_motion.planning.collision.solids import Inside, Keyed, enclosed, filled, parts_of


class _Extent(NamedTuple):
    """How far points are from a joint: from its axis, and from its origin [m]."""

    across: float
    around: float


class MotionBounds:
    """Bounds for one arm with the objects it holds.

    ``offsets`` are ``T_before_joint`` of each joint, the jaw's last; ``points`` (n, 3) [m] for each
    joint's frame those whose hull contains its parts. ``longest`` holds whatever the jaw does, (5,)
    [m].
    """

    def __init__(self, offsets: Sequence[SE3], points: Sequence[Array]) -> None:
        self._offsets = [offset.p for offset in offsets]
        self._own = [_extent(each) for each in points[:-1]]
        self._hand, self._jaw, self._T_hand_jaw = points[-2], points[-1], offsets[-1]
        around_jaw = float(np.linalg.norm(self._T_hand_jaw.p)) + _extent(self._jaw).around
        self.longest = self._chained(_Extent(around_jaw, around_jaw))
        self.at = lru_cache(maxsize=8)(self._at)

    def _at(self, q_jaw: float) -> Array:
        """The bound for each joint of the arm with the jaw at ``q_jaw`` [rad], shape (5,), [m]."""
        return self._chained(_extent(self._T_hand_jaw @ (self._jaw @ rot_z(q_jaw).T)))

    def _chained(self, jaw: _Extent) -> Array:
        last = len(self._own) - 1
        hand = self._own[last]
        levers = np.zeros(len(self._own))
        levers[last], ball = max(hand.across, jaw.across), max(hand.around, jaw.around)
        for joint in range(last - 1, -1, -1):
            own, offset = self._own[joint], self._offsets[joint + 1]
            levers[joint] = max(own.across, float(np.linalg.norm(offset[:2])) + ball)
            ball = max(own.around, float(np.linalg.norm(offset)) + ball)
        return frozen_array(levers)


def _extent(points: Array) -> _Extent:
    return _Extent(
        float(np.linalg.norm(points[:, :2], axis=1).max()),
        float(np.linalg.norm(points, axis=1).max()),
    )


MOST_CORNERS = 1024  # solids with more are given as triangles; chosen by time
NEAR = 0.1  # pairs that never come nearer are left out [m]; chosen, above all clearances
SUNK = 0.001  # how deep the base may be in a table it is screwed to [m]; chosen

_LOWERING = frozenset(LINKS[LINKS.index("upper arm") :])
"""The links that can move towards the floor."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bodies:
    """All collision bodies and pairs."""

    bodies: tuple[Body, ...]  # the bodies
    indices: Any  # the pairs of them that are checked, integers, shape (len(pairs), 2)
    pairs: tuple[tuple[str, str], ...]  # those pairs by name
    margins: Array  # distance that each pair must keep, shape (len(pairs),), [m]
    # how many of the arm's joints move the first and the second body of each pair, integers, shape
    # (len(pairs), 2)
    moved_by: Any
    # whether coal answers for a pair as if its second body had been named first
    swapped: tuple[bool, ...]
    levers: MotionBounds  # bounds on the distance of moved points from each joint's axis
    # shapes of the obstacles by their index among the bodies; of a cloud, the cubes that are near
    standing: dict[int, Standing]
    # what the surfaces among them enclose, None if it is not known; coal measures no depth in
    # surfaces
    insides: dict[int, Inside | None]

    def __post_init__(self) -> None:
        freeze(self, margins=(len(self.pairs),))


class Cubes(NamedTuple):
    """The full cubes of a point cloud."""

    middles: Array  # their middles in the cloud's frame, shape (n, 3), [m]
    edge: float  # length of their edges [m]


class Hull(NamedTuple):
    """The convex hull of points, widened all around."""

    points: Array  # the points in its own frame, shape (n, 3), [m]
    radius: float  # how much it is widened [m]


Standing = Box | Sphere | Capsule | Mesh | Cubes | Hull  # the form of an obstacle


class Body(NamedTuple):
    """A link, a held object, an obstacle or a part of it."""

    name: str  # its name in messages
    joint: int  # the joint that carries it, 0 for none
    placement: Any  # its pose in that joint's frame, Pinocchio's
    shape: Any  # its shape, coal's


class _Mover(NamedTuple):
    """A body that joints may move: a link or a held object."""

    body: Body  # the body
    points: Array  # points whose hull contains it, in the joint's frame, shape (n, 3), [m]


def bodies_in(model: Any, scene: Scene, checkpoint: Checkpoint = never_abandoned) -> Bodies:
    """The bodies of an arm (a Pinocchio model with six joints) and of a scene."""
    gathered = _Gathered(model, _carried(Keyed(id(model), model), scene.attached))
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


def bodies_without(
    model: Any, attached: tuple[Attached, ...], left_out: frozenset[str]
) -> tuple[Bodies, Array]:
    """The bodies of an arm and of held objects without those left out; no pairs are checked.

    Also bounds on the distance of each one's points from each joint's axis, shape (n, 6), [m].
    """
    carried = _carried(Keyed(id(model), model), attached)
    kept = [each for each in carried.movers if each.body.name not in left_out]
    levers = np.zeros((len(kept), 6))
    for row, (body, points) in zip(levers, kept, strict=True):
        if body.joint:
            row[body.joint - 1], ball = _extent(points)
        for j in range(body.joint - 1, 0, -1):
            offset = model.jointPlacements[j + 1].translation
            row[j - 1] = float(np.linalg.norm(offset[:2])) + ball
            ball += float(np.linalg.norm(offset))
    return _Gathered(model, carried._replace(movers=kept)).bodies(set(), 0.0), levers


def _passed(attached: tuple[Attached, ...], other: StandingArm) -> set[frozenset[str]]:
    """The pairs that may touch because two arms pass an object on."""
    given = {each.name for each in attached if each.passed_to == other.name}
    taken = {each.name for each in other.attached if each.passed_to}
    pairs = (*product(given, HOLDERS), *product(HOLDERS | given, taken))
    return {frozenset((mine, other.called(theirs))) for mine, theirs in pairs}


def around_base(model: Any, scene: Scene) -> str | None:
    """The name of an obstacle that the base stands in, deeper than ``SUNK``; None if it is free.

    Motions are not checked for this, because no joint moves the base. Other arms keep their room.
    """
    _, base = next(iter(_hulls().values()))
    standing = [
        *(
            (each.name, shape, each.T_base_obstacle)
            for each in scene.obstacles
            for shape in _shapes_of(each, _foot(model, each.T_base_obstacle))
        ),
        *((name, part.shape, T) for arm in scene.arms for name, part, T in _parts_of(model, arm)),
    ]
    for name, shape, T in standing:
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        at = coal.Transform3s(np.array(T.R), T.p + np.array([0.0, 0.0, -SUNK]))
        coal.collide(base, coal.Transform3s(), shape, at, request, result)
        if result.isCollision():
            return name
    return None


def _shapes_of(obstacle: Obstacle, foot: Array) -> Iterator[Any]:
    form = read_shape(obstacle.shape)
    if isinstance(form, PointCloud):
        yield octree(full_cubes(form), form.resolution)
    elif isinstance(form, Mesh):
        for part in parts_of(form, foot):
            yield standing_shape(part.mesh) if part.hull is None else convex_hull(part.hull)
    else:
        yield standing_shape(form)


def _foot(model: Any, T: SE3) -> Array:
    """Points of the base above the table and of the shoulder, in the frame at ``T``, (n, 3) [m]."""
    base, shoulder = (np.array(hull.points()) for _, hull in list(_hulls().values())[:2])
    at = model.jointPlacements[1]
    points = np.concatenate([base, shoulder @ at.rotation.T + at.translation])
    return np.asarray((points[points[:, 2] > 0.005] - T.p) @ T.R)


class _Part(NamedTuple):
    """A link of another arm at rest, or an object it holds, widened."""

    name: str  # its name in messages about that arm
    joint: int  # the joint that carries it, 0 for none
    shape: Any  # its shape in the joint's frame, coal's
    form: Hull  # the same as numbers


@lru_cache(maxsize=16)
def _widened(model: Keyed, attached: tuple[Attached, ...], radius: float) -> list[_Part]:
    """The links of an arm and the objects it holds, widened all around by a radius [m]."""
    parts = []
    for each in reversed(_carried(model, attached).movers):
        shape = convex_hull(each.points)
        shape.setSweptSphereRadius(radius)
        form = Hull(np.array(shape.points()), radius)
        parts.append(_Part(each.body.name, each.body.joint, shape, form))
    return parts


def _parts_of(model: Any, arm: StandingArm) -> Iterator[tuple[str, _Part, SE3]]:
    """The parts of another arm at rest, at each of its configurations, with names for messages.

    They are widened by the arm's room.
    """
    data, T_base_arm = model.createData(), _placement(arm.T_base_arm)
    parts = _widened(Keyed(id(model), model), arm.attached, arm.room)
    for q in arm.q:
        pin.forwardKinematics(model, data, np.array(q))
        for part in parts:
            T = T_base_arm * data.oMi[part.joint]
            yield arm.called(part.name), part, SE3(T.rotation, T.translation)


class _Gathered:
    """Collects bodies and pairs."""

    def __init__(self, model: Any, carried: _Carried) -> None:
        self._model = model
        self._movers, self._levers, self._spans = carried
        self._bodies = [each.body for each in self._movers]
        self._pairs: list[tuple[int, int]] = []
        self._standing: dict[int, Standing] = {}
        self._insides: dict[int, Inside | None] = {}
        self._centre = np.array(model.jointPlacements[1].translation)

    def pair_movers(self, attached: tuple[Attached, ...]) -> None:
        """Add pairs of links that can meet, and of held objects with the links that do not hold."""
        index = {each.name: i for i, each in enumerate(self._bodies)}
        free_to_meet = _link_pairs()
        for held in attached:
            for link in LINKS:
                if link not in HOLDERS:
                    self._pairs.append((index[held.name], index[link]))
        self._pairs += [(index[outer], index[inner]) for inner, outer in free_to_meet]

    def add_floor(self, floor_z: float) -> None:
        """Add the floor: everything below ``floor_z`` [m]."""
        plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), floor_z)
        floor = self._add(FLOOR, pin.SE3.Identity(), plane)
        for i, (each, _) in enumerate(self._movers):
            if each.name in _LOWERING or each.name not in LINKS:
                self._pairs.append((i, floor))

    def add_obstacle(self, obstacle: Obstacle, checkpoint: Checkpoint) -> None:
        """Add an obstacle, unless nothing can come near it."""
        form, T, name = read_shape(obstacle.shape), obstacle.T_base_obstacle, obstacle.name
        checkpoint()
        if isinstance(form, PointCloud):
            for cubes, inside in self._cubes(form, T, _foot(self._model, T), checkpoint):
                self._stand(name, cubes, octree(*cubes), T, inside)
        elif isinstance(form, Mesh):
            for part in parts_of(form, _foot(self._model, T)):
                checkpoint()
                if part.hull is None:
                    self._stand(name, part.mesh, standing_shape(part.mesh), T, part.inside)
                else:
                    many = len(part.hull) > MOST_CORNERS
                    given = filled(part.mesh, part.hull) if many else Hull(part.hull, 0.0)
                    self._stand(name, given, kept_hull(part.hull.tobytes()), T)
        else:
            self._stand(name, form, standing_shape(form), T)

    def add_arm(self, arm: StandingArm) -> None:
        """Add another arm at rest."""
        for name, part, T in _parts_of(self._model, arm):
            self._stand(name, part.form, part.shape, T)

    def _stand(
        self, name: str, given: Standing, shape: Any, T: SE3, inside: Inside | None = None
    ) -> None:
        """Add a shape that does not move, if a link can come near it."""
        shape.computeLocalAABB()
        away = float(np.linalg.norm(T @ shape.aabb_center - self._centre)) - shape.aabb_radius
        near = [
            i
            for i, (each, span) in enumerate(zip(self._movers, self._spans, strict=True))
            if each.body.joint > 0 and span + NEAR > away
        ]
        if near:
            this = self._add(name, _placement(T), shape)
            self._standing[this] = given
            if isinstance(shape, coal.BVHModelOBBRSS | coal.OcTree):
                self._insides[this] = inside
            self._pairs += [(i, this) for i in near]

    def _cubes(
        self, cloud: PointCloud, T: SE3, foot: Array, checkpoint: Checkpoint
    ) -> Iterator[tuple[Cubes, Inside | None]]:
        """The cubes of a cloud at ``T`` that the arm can come near, of solids and of surfaces.

        Often they are a small part of it.
        """
        cubes, centre = full_cubes(cloud, checkpoint), T.inverse @ self._centre
        farthest = max(self._spans) + NEAR + math.sqrt(3.0) * cloud.resolution
        away = np.linalg.norm(cubes - centre, axis=1)
        near = cubes[away < farthest]
        if len(near) == 0:
            return
        # What is partly out of reach is still closed.
        inside, hollow = enclosed(cubes[away < 2.0 * farthest], cloud.resolution, foot)
        hollow = hollow[np.linalg.norm(hollow - centre, axis=1) < farthest]
        hollow = cube_middles(cube_numbers(hollow, cloud.resolution), cloud.resolution)
        checkpoint()
        of_solid = inside.bounds(near)
        if of_solid.any():
            filled = np.concatenate([near[of_solid], hollow])
            yield Cubes(filled, cloud.resolution), inside
        if not of_solid.all():
            yield Cubes(near[~of_solid], cloud.resolution), None

    def bodies(self, allowed: set[frozenset[str]], margin: float) -> Bodies:
        """The collected bodies, without the pairs that may touch."""
        names = [each.name for each in self._bodies]
        movable = np.array([min(each.joint, 5) for each in self._bodies], dtype=int)
        kept = [(a, b) for a, b in self._pairs if frozenset((names[a], names[b])) not in allowed]
        indices = np.array(kept, dtype=int).reshape(-1, 2)
        own = min(margin, MARGIN)
        links = {i for i, name in enumerate(names) if name in LINKS}
        return Bodies(
            bodies=tuple(self._bodies),
            indices=indices,
            pairs=tuple((names[a], names[b]) for a, b in kept),
            margins=np.array([own if links.issuperset(pair) else margin for pair in kept]),
            moved_by=movable[indices],
            # Octrees come first, whatever was asked (observed in coal 3.0.3).
            swapped=tuple(isinstance(self._bodies[b].shape, coal.OcTree) for _, b in kept),
            levers=self._levers,
            standing=self._standing,
            insides=self._insides,
        )

    def _add(self, name: str, placement: Any, shape: Any) -> int:
        self._bodies.append(Body(name, 0, placement, shape))
        return len(self._bodies) - 1


class _Carried(NamedTuple):
    """An arm with the objects it holds, without its surroundings."""

    movers: Sequence[_Mover]  # its bodies
    levers: MotionBounds  # bounds on the distance of moved points from each joint's axis
    spans: Sequence[float]  # largest distance of each body from the pan joint [m]


@lru_cache(maxsize=16)
def _carried(keyed: Keyed, attached: tuple[Attached, ...]) -> _Carried:
    """The bodies that an arm carries; cached, because scenes change more often."""
    model = keyed.value
    # The outermost first: they are hit most often, and bodies are looked at in this order.
    movers = [*_held(model, attached), *reversed(list(_links(model)))]
    steps = [float(np.linalg.norm(model.jointPlacements[j].translation)) for j in range(2, 7)]
    # The links between, then itself.
    spans = [
        sum(steps[: max(0, each.body.joint - 1)]) + float(np.linalg.norm(each.points, axis=1).max())
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
    return _Mover(Body(name, int(frame.parentJoint), placement, shape), in_joint)


def _placement(T: SE3) -> Any:
    return pin.SE3(np.array(T.R), np.array(T.p))


@cache
def _hulls() -> dict[str, tuple[str, Any]]:
    """The hull of each link with the name of its part; cached."""
    return {
        link: (part, convex_hull(so101_description.load_hull(part).vertices))
        for link, part in so101_description.PARTS.items()
    }


def hull_of(link: str) -> Any:
    """The hull of a link, by its name in the URDF, in the link's frame; coal's."""
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
            np.concatenate([np.zeros((1, 3)), *(e.points for e in movers if e.body.joint == j)])
            for j in joints
        ],
    )
