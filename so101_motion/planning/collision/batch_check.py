"""Check many configurations at once with the compiled library; coal decides the close calls.

The library gets the same bodies, pairs and margins as coal, packed once for each scene. It proves
most configurations free or touching by bounds on the distances (``native/lanes.c``). Within a few
micrometres of a margin it asks coal, so the verdicts are always coal's.

Bodies are convex: the points of a hull and a radius by which it is widened. The mesh of an obstacle
becomes its triangles, a cloud its cubes; all of them are leaves of one tree (``native/scene.c``).
"""

from __future__ import annotations

import ctypes
import itertools
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.native.library import native
from so101_motion.planning.checkpoint import Checkpoint
from so101_motion.planning.collision.bodies import Bodies, Body, Cubes, Hull, Standing
from so101_motion.planning.collision.scene import FLOOR, LINKS, Box, Capsule, Mesh, Sphere

MOST_ARMS = 8  # most arms of a team; as in ``native.h``
FEW = 64  # up to so many waypoints are passed in an array whose address is known
NEAR_ROW, BOUND = 16, 7  # as in ``native.h``

FREE, TOUCHING = 0, 1
_GO_ON, _TIME_IS_UP, _END = 0, 1, 2

_Ask = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_double), ctypes.c_int)


Touches = Callable[[Array], bool]
"""Whether any pair is too close at a configuration of all six joints, shape (6,), [rad]."""


class Level(NamedTuple):
    """A check of configurations."""

    clearance: float  # distance that all pairs keep if the check finds none too close [m]
    touches: Touches  # the check itself, by coal
    margins: tuple[float, float]  # that it demands of pairs of links and of all others [m]


class _Level(ctypes.Structure):
    _fields_ = [
        ("margin", ctypes.c_double * 2),
        ("clearance", ctypes.c_double),
        ("id", ctypes.c_int),
    ]


class Levels:
    """Checks with different margins in the library's form, each with coal's for the close calls."""

    def __init__(self, batch: BatchCheck, levels: Sequence[Level]) -> None:
        self.count = len(levels)
        self.array = (_Level * self.count)()
        for here, level in zip(self.array, levels, strict=True):
            here.margin[0], here.margin[1] = level.margins
            here.clearance, here.id = level.clearance, batch.register(level.touches)


class BatchCheck:
    """The bodies of one scene in the library's memory. Belongs to one thread.

    Attributes:
        scene: The library's handle of it.
        margins_at: Address of each pair's margin, as the library numbers pairs.
        numbers_at: Address of our numbers of these pairs.
        near_at: Address of room for a row of each pair.
    """

    def __init__(self, model: Any, bodies: Bodies, floor_z: float | None) -> None:
        library = self.library = native().library
        self._coal: list[Touches] = []
        self._error: BaseException | None = None
        self._checkpoint: Checkpoint | None = None
        self._is_late: Callable[[], bool] | None = None
        self._ask = _Ask(weakly(self))
        self._one, self._one_verdict = np.zeros(6), np.zeros(1, dtype=np.uint8)
        self._at_one, self._at_one_verdict = pointer(self._one), pointer(self._one_verdict)
        self._points, self._reach, self._blocked = np.zeros((FEW, 5)), np.zeros(5), np.zeros(5)
        self._at_points, self._at_reach = pointer(self._points), pointer(self._reach)
        self._at_blocked = pointer(self._blocked)
        arguments, pair_of = packed(model, bodies, floor_z or 0.0)
        self._pair_of = np.zeros(1 + max(pair_of, default=0), dtype=int)
        self._pair_of[list(pair_of)] = list(pair_of.values())
        count = max(1, len(bodies.pairs))
        self._near, self._bounds = np.zeros((count, NEAR_ROW)), np.zeros((count, BOUND))
        self._margins, self._numbers = np.zeros(len(self._pair_of)), self._pair_of.astype(float)
        if len(bodies.pairs):
            self._margins[:] = bodies.margins[self._pair_of]
        self.near_at, self._at_bounds = pointer(self._near), pointer(self._bounds)
        self.margins_at, self.numbers_at = pointer(self._margins), pointer(self._numbers)
        handle = library.so101_new(*(_argument(each) for each in arguments), self._ask)
        if not handle:
            raise MemoryError("no memory for the bodies of a scene")
        self.scene = ctypes.c_void_p(handle)
        weakref.finalize(self, library.so101_free, self.scene)

    def register(self, touches: Touches) -> int:
        """Register coal's check; return the number by which the library asks for it."""
        self._coal.append(touches)
        return len(self._coal) - 1

    def touches(self, levels: Levels, q: Array, q_jaw: float) -> bool:
        """Whether anything touches at ``q``, shape (5,), [rad]."""
        self._one[:5] = q
        self._one[5] = q_jaw
        one = self.library.so101_check(
            self.scene, levels.array, self._at_one, 1, 0, self._at_one_verdict
        )
        if self._error is not None:
            self.raise_error()
        return bool(one)

    def touching(self, levels: Levels, configurations: Array) -> Array:
        """Which of the configurations, shape (n, 6), [rad], touch something; booleans, (n,)."""
        q = np.ascontiguousarray(configurations, dtype=np.float64)
        verdicts = np.zeros(len(q), dtype=np.uint8)
        self.library.so101_check(self.scene, levels.array, pointer(q), len(q), 0, pointer(verdicts))
        self.raise_error()
        return np.asarray(verdicts == TOUCHING)

    def near(
        self, q: Array, q_jaw: float, within: float, gap: float = 0.0
    ) -> tuple[Array, Array] | None:
        """As ``CollisionModel.near_bounds`` [m]; None if coal has to decide."""
        self._one[:5] = q
        self._one[5] = q_jaw
        n = self.library.so101_near_bounds(
            self.scene, self._at_one, ctypes.c_double(within), len(self._near), self.near_at,
            self.margins_at, self.numbers_at, ctypes.c_double(gap), self._at_bounds,
        )  # fmt: skip
        return None if n < 0 else (self._near[:n].copy(), self._bounds[:n])

    def lacks_more(self, places: Array, q_jaw: float, margins: Array, lack: Array) -> bool | None:
        """Like ``CollisionModel.lacks_more``; None if coal has to decide."""
        q = np.full((len(places), 6), q_jaw)
        q[:, :5] = places
        margins, lack = margins[self._pair_of], lack[self._pair_of]
        said = self.library.so101_lacks_more(
            self.scene, pointer(q), len(q), pointer(margins), pointer(lack),
            ctypes.c_double(margins.max()), len(self._near), self.near_at,
        )  # fmt: skip
        return None if said < 0 else bool(said)

    def first_blocked(
        self, levels: Levels, reach: Array, points: Array, q_jaw: float
    ) -> Array | None:
        """Like ``CollisionModel.first_blocked``, for ``levels`` from the lowest margins up."""
        count, at = len(points), self._at_points
        if count <= FEW:
            self._points[:count] = points
        else:
            points = np.ascontiguousarray(points, dtype=np.float64)
            at = pointer(points)
        self._reach[:] = reach
        verdict = self.library.so101_first_blocked(
            self.scene,
            levels.array,
            levels.count,
            self._at_reach,
            at,
            count,
            ctypes.c_double(q_jaw),
            self._at_blocked,
        )
        self.raise_error()
        if verdict not in (FREE, TOUCHING):
            raise MemoryError("no memory for the check of a motion")
        return self._blocked.copy() if verdict == TOUCHING else None

    def watch(self, checkpoint: Checkpoint) -> None:
        """Set the function that the library calls again and again while it works."""
        self._checkpoint = checkpoint

    @contextmanager
    def until(self, is_late: Callable[[], bool]) -> Iterator[None]:
        """Stop the library's search in this block when ``is_late`` says that time is up."""
        self._is_late = is_late
        try:
            yield
        finally:
            self._is_late = None
            self.library.so101_resume(self.scene)

    def raise_error(self) -> None:
        """Raise what a check of coal or the checkpoint raised meanwhile."""
        if self._error is not None:
            error, self._error = self._error, None
            self.library.so101_resume(self.scene)
            raise error

    def tally(self) -> tuple[int, int]:
        """How many configurations were checked, and how many of them coal had to decide."""
        counts = (ctypes.c_long * 4)()
        self.library.so101_tally(self.scene, counts)
        return counts[2], counts[3]

    def answer(self, q: Any, level: int) -> int:
        """Answer the library: coal's verdict for a level, or, for -1, whether to go on."""
        try:
            if level < 0:
                if self._checkpoint is not None:
                    self._checkpoint()
                return _TIME_IS_UP if self._is_late and self._is_late() else _GO_ON
            return int(self._coal[level](np.array(q[:6])))
        except BaseException as error:  # ``raise_error`` raises it after the library returns
            self._error = error
            return _END


class ArmLines(NamedTuple):
    """How the lines of one arm are checked in its scene: at samples, or by proof."""

    batch: BatchCheck
    levels: Levels  # by proof all of them count, else the first
    reach: Array  # for each joint, a bound on how far a point moves per angle, shape (5,), [m/rad]
    q_jaw: float  # [rad]
    spacing: float  # largest travel between two samples [m]
    proven: bool = False


class _Checker(ctypes.Structure):
    _fields_ = [
        ("scene", ctypes.c_void_p),
        ("levels", ctypes.c_void_p),
        ("n_levels", ctypes.c_int),
        ("proven", ctypes.c_int),
        ("reach", ctypes.c_void_p),
        ("spacing", ctypes.c_double),
        ("q_jaw", ctypes.c_double),
    ]


class Couple(ctypes.Structure):
    """Two arms, by number, that must stay apart, in the library's form.

    ``placement``: the second's base in the first's base frame, rotation by rows, then translation.
    """

    _fields_ = [
        ("first", ctypes.c_int),
        ("second", ctypes.c_int),
        ("a", ctypes.c_void_p),
        ("b", ctypes.c_void_p),
        ("levers_a", ctypes.c_void_p),
        ("levers_b", ctypes.c_void_p),
        ("placement", ctypes.c_double * 12),
    ]


class _Team(ctypes.Structure):
    _fields_ = [
        ("arms", ctypes.c_int),
        ("couples", ctypes.c_int),
        ("arm", ctypes.c_void_p),
        ("couple", ctypes.c_void_p),
        ("room", ctypes.c_double),
    ]


class LineCheck:
    """Checks configurations and straight joint lines of one arm, or of several together.

    Args:
        arms: At most ``MOST_ARMS`` arms, whose joints follow each other in one vector.
        couples: The pairs of arms that must stay apart.
        room: Distance they must keep [m].

    Attributes:
        team: This check in the library's form, by reference.
        checkers: That of each arm.
    """

    def __init__(
        self, arms: Sequence[ArmLines], couples: Sequence[Couple] = (), room: float = 0.0
    ) -> None:
        self.arms, self.library = arms, native().library
        self.checkers = (_Checker * len(arms))(
            *(
                _Checker(
                    each.batch.scene,
                    ctypes.addressof(each.levels.array),
                    each.levels.count,
                    each.proven,
                    each.reach.ctypes.data,
                    each.spacing,
                    each.q_jaw,
                )
                for each in arms
            )
        )
        self._couples = (Couple * len(couples))(*couples)
        places = ctypes.addressof(self.checkers), ctypes.addressof(self._couples)
        self.team = ctypes.byref(_Team(len(arms), len(couples), *places, room))
        self._batches = dict.fromkeys(each.batch for each in arms)

    def proven(self) -> LineCheck:
        """The same check of one arm, but straight lines are clear only if that is proven."""
        return LineCheck([self.arms[0]._replace(proven=True)])

    def is_free(self, q: Array) -> bool:
        """Whether nothing is too close at joint angles ``q`` [rad]."""
        q = np.ascontiguousarray(q, dtype=np.float64)
        return self._raised(self.library.so101_team_is_free(self.team, pointer(q)))

    def touching(self, q: Array) -> Array:
        """Which configurations (n, 5) [rad] of the first arm touch something, booleans, (n,)."""
        arm = self.arms[0]
        jaw = np.full((len(q), 1), arm.q_jaw)
        return arm.batch.touching(arm.levels, np.concatenate((q, jaw), axis=1))

    def is_clear(self, q_from: Array, q_to: Array) -> bool:
        """Whether a line is clear between its ends, which are not checked unless it is proven.

        No sample of an arm in its scene touches, and arms are proven to stay apart.
        """
        ends = np.array([q_from, q_to], dtype=np.float64)
        at = pointer(ends[0]), pointer(ends[1])
        return self._raised(self.library.so101_team_is_clear(self.team, *at, 0))

    def _raised(self, verdict: int) -> bool:
        for batch in self._batches:
            batch.raise_error()
        return bool(verdict)

    @contextmanager
    def until(self, is_late: Callable[[], bool]) -> Iterator[None]:
        """Stop the library's search in this block when ``is_late`` says that time is up.

        Raises:
            BaseException: What a check of coal or the checkpoint raised meanwhile.
        """
        with ExitStack() as stack:
            for batch in self._batches:
                stack.enter_context(batch.until(is_late))
            yield
            self._raised(True)


def weakly(batch: BatchCheck) -> Callable[[Any, int], int]:
    """A function that calls ``batch.answer`` without keeping the batch alive."""
    this = weakref.ref(batch)

    def ask(q: Any, level: int) -> int:
        alive = this()
        return _END if alive is None else alive.answer(q, level)

    return ask


def pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    """The address of an array's first element, for the library."""
    return ctypes.c_void_p(array.ctypes.data)


def _argument(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        assert value.flags.c_contiguous
        return pointer(value)
    return ctypes.c_double(value) if isinstance(value, float) else value


_CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))


def packed(model: Any, bodies: Bodies, floor_z: float) -> tuple[list[Any], dict[int, int]]:
    """The arguments of ``so101_new`` in its order, and our pair for each pair of the library."""
    objects = bodies.bodies
    names = [each.name for each in objects]
    movers = [
        i for i, each in enumerate(objects) if i not in bodies.standing and each.name != FLOOR
    ]
    place = {i: k for k, i in enumerate(movers)}
    hulls = [_hull(objects[i]) for i in movers]
    pairs, with_floor = [], 0
    masks = dict.fromkeys(bodies.standing, 0)
    rows = {i: k * len(movers) for k, i in enumerate(bodies.standing, 1)}
    own, others = list[int](), dict[int, int]()
    for k, (a, b) in enumerate(bodies.indices.tolist()):
        if names[b] == FLOOR:
            with_floor |= 1 << place[a]
            others[place[a]] = k
        elif b in masks:
            masks[b] |= 1 << place[a]
            others[rows[b] + place[a]] = k
        else:
            is_own = names[a] in LINKS and names[b] in LINKS
            pairs.append((place[a], place[b], 0 if is_own else 1))
            own.append(k)
    pair_of = dict(enumerate(own)) | {len(own) + number: k for number, k in others.items()}
    shapes: list[tuple[Array, float]] = []
    at, shape, mask = [np.zeros((0, 3))], [np.zeros(0, int)], [np.zeros(0, int)]
    obstacle = [np.zeros(0, int)]
    for o, (i, standing) in enumerate(bodies.standing.items()):
        T = objects[i].placement
        forms, places = _pieces(standing, np.array(T.rotation), np.array(T.translation))
        at.append(places)
        shape.append(len(shapes) + np.arange(len(places)) % len(forms))
        mask.append(np.full(len(places), masks[i]))
        obstacle.append(np.full(len(places), o))
        shapes += forms
    arguments = [
        _offsets(model),
        len(movers),
        np.array([objects[i].joint for i in movers], np.int32),
        _starts([points for points, _ in hulls]),
        np.concatenate([points for points, _ in hulls]),
        np.array([radius for _, radius in hulls]),
        len(pairs),
        np.array(pairs, np.int32).reshape(-1, 3),
        ctypes.c_uint32(with_floor),
        floor_z,
        len(shapes),
        _starts([points for points, _ in shapes]),
        np.concatenate([np.zeros((0, 3)), *(points for points, _ in shapes)]),
        np.array([radius for _, radius in shapes]),
        sum(map(len, at)),
        np.concatenate(at),
        np.concatenate(shape).astype(np.int32),
        np.concatenate(mask).astype(np.uint32),
        np.concatenate(obstacle).astype(np.int32),
        len(masks),
    ]
    return arguments, pair_of


def _offsets(model: Any) -> Array:
    """Pose of each joint in the one before: rotation by rows, then translation, shape (6, 12)."""
    placements = [model.jointPlacements[joint] for joint in range(1, 7)]
    rows = [np.concatenate((np.array(T.rotation).ravel(), T.translation)) for T in placements]
    return np.ascontiguousarray(rows)


def _starts(points: Sequence[Array]) -> NDArray[np.int32]:
    return np.cumsum([0, *(len(each) for each in points)]).astype(np.int32)


def _points_of(shape: Any) -> tuple[Array, float]:
    """The points of a convex shape of coal's and the radius around them."""
    radius = float(shape.getSweptSphereRadius())
    if isinstance(shape, coal.Box):
        return 2.0 * _CORNERS * np.array(shape.halfSide), radius
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), radius + float(shape.radius)
    if isinstance(shape, coal.Capsule):
        ends = np.outer((-1.0, 1.0), (0.0, 0.0, shape.halfLength))
        return ends, radius + float(shape.radius)
    return np.array(shape.points()), radius


def _hull(body: Body) -> tuple[Array, float]:
    """The points of a body in its joint's frame, shape (n, 3), and the radius around them [m]."""
    points, radius = _points_of(body.shape)
    T = body.placement
    return np.ascontiguousarray(points @ np.array(T.rotation).T + np.array(T.translation)), radius


def _pieces(standing: Standing, R: Array, p: Array) -> tuple[list[tuple[Array, float]], Array]:
    """The convex pieces of an obstacle, rotated, and their places, shape (n, 3), [m].

    There is one piece for all places, or one for each.
    """
    if isinstance(standing, Cubes):
        return [(standing.edge * _CORNERS @ R.T, 0.0)], standing.middles @ R.T + p
    if isinstance(standing, Mesh):
        corners = standing.vertices[standing.triangles] @ R.T
        middles = corners.mean(axis=1)
        return [(each, 0.0) for each in corners - middles[:, None]], middles + p
    if isinstance(standing, Hull):
        middle = standing.points.mean(axis=0)
        return [((standing.points - middle) @ R.T, standing.radius)], (R @ middle + p)[None]
    return [_rounded_form(standing, R)], p[None]


def _rounded_form(standing: Box | Sphere | Capsule, R: Array) -> tuple[Array, float]:
    if isinstance(standing, Box):
        return _CORNERS * standing.size @ R.T, 0.0
    if isinstance(standing, Sphere):
        return np.zeros((1, 3)), standing.radius
    ends = np.outer((-1.0, 1.0), R[:, 2]) * (0.5 * standing.length - standing.radius)
    return ends, standing.radius
