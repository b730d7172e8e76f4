"""Check many configurations at once with the compiled library; coal decides the close calls.

The library gets the same bodies, pairs and margins as coal, packed once for each scene. It proves
most configurations free or touching by bounds on the distances (``native/lanes.c``). Within a few
micrometres of a margin it asks coal, so the verdicts are always coal's.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.planning.checkpoint import Checkpoint
from so101_motion.planning.collision.bodies import Bodies
from so101_motion.planning.collision.continuous_check import Level, Touches
from so101_motion.planning.collision.packed_bodies import packed
from so101_motion.planning.native.library import native

MOST_ARMS = 8  # most arms of a team; as in ``native.h``
FEW = 64  # up to so many waypoints are passed in an array whose address is known
NEAR_ROW, BOUND = 16, 7  # as in ``native.h``

FREE, TOUCHING = 0, 1
_GO_ON, _TIME_IS_UP, _END = 0, 1, 2

_Ask = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_double), ctypes.c_int)


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
        library: The library.
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
        self._at_blocked, self._at_second = pointer(self._blocked), pointer(self._points[1])
        arguments, pair_of = packed(model, bodies, floor_z or 0.0)
        self._pair_of = np.zeros(1 + max(pair_of, default=0), dtype=int)
        self._pair_of[list(pair_of)] = list(pair_of.values())
        count = max(1, len(bodies.pairs))
        self._near, self._bounds = np.zeros((count, NEAR_ROW)), np.zeros((count, BOUND))
        self._margins, self._numbers = np.zeros(len(self._pair_of)), self._pair_of.astype(float)
        if len(bodies.pairs):
            self._margins[:] = bodies.margins[self._pair_of]
        self._at_near, self._at_bounds = pointer(self._near), pointer(self._bounds)
        self._at_margins, self._at_numbers = pointer(self._margins), pointer(self._numbers)
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
        self.library.so101_check(
            self.scene,
            levels.array,
            pointer(q),
            len(q),
            0,
            pointer(verdicts),
        )
        self.raise_error()
        return np.asarray(verdicts == TOUCHING)

    def near(
        self, q: Array, q_jaw: float, within: float, gap: float = 0.0
    ) -> tuple[Array, Array] | None:
        """The pairs of bodies within a distance [m] of each other; None if coal has to decide.

        Returns:
            As ``CollisionModel.near_bounds``; the bounds are valid until the next call.
        """
        self._one[:5] = q
        self._one[5] = q_jaw
        n = self.library.so101_near_bounds(
            self.scene, self._at_one, ctypes.c_double(within), len(self._near), self._at_near,
            self._at_margins, self._at_numbers, ctypes.c_double(gap), self._at_bounds,
        )  # fmt: skip
        return None if n < 0 else (self._near[:n].copy(), self._bounds[:n])

    def lacks_more(self, places: Array, q_jaw: float, margins: Array, lack: Array) -> bool | None:
        """Like ``CollisionModel.lacks_more``; None if coal has to decide."""
        q = np.full((len(places), 6), q_jaw)
        q[:, :5] = places
        margins, lack = margins[self._pair_of], lack[self._pair_of]
        said = self.library.so101_lacks_more(
            self.scene, pointer(q), len(q), pointer(margins), pointer(lack),
            ctypes.c_double(margins.max()), len(self._near), self._at_near,
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

    def is_clear(
        self, levels: Levels, reach: Array, spacing: float, q_from: Array, q_to: Array, q_jaw: float
    ) -> bool:
        """Like ``BatchSampledCheck.is_clear``."""
        self._points[0], self._points[1], self._reach[:] = q_from, q_to, reach
        clear = self.library.so101_is_clear(
            self.scene,
            levels.array,
            self._at_reach,
            ctypes.c_double(spacing),
            self._at_points,
            self._at_second,
            ctypes.c_double(q_jaw),
            0,
        )
        self.raise_error()
        return bool(clear)

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


class Checker(ctypes.Structure):
    """How the library checks straight joint motions: sampled, or by proof."""

    _fields_ = [
        ("scene", ctypes.c_void_p),
        ("levels", ctypes.c_void_p),
        ("n_levels", ctypes.c_int),
        ("proven", ctypes.c_int),
        ("reach", ctypes.c_void_p),
        ("spacing", ctypes.c_double),
        ("q_jaw", ctypes.c_double),
    ]


class BatchSampledCheck:
    """Checks configurations and, at samples or by proof, straight joint lines.

    Attributes:
        batch: The bodies in the library.
        checker: This check in the library's form.
    """

    def __init__(
        self,
        batch: BatchCheck,
        levels: Levels,
        reach: Array,
        *,
        q_jaw: float,
        spacing: float,
        proven: bool = False,
    ) -> None:
        self.batch = batch
        self._levels, self._reach, self._q_jaw, self._spacing = levels, reach, q_jaw, spacing
        self.checker = Checker(
            batch.scene,
            ctypes.addressof(levels.array),
            levels.count,
            proven,
            reach.ctypes.data,
            spacing,
            q_jaw,
        )

    def proven(self) -> BatchSampledCheck:
        """The same check, but straight motions are clear only if that is proven."""
        return BatchSampledCheck(
            self.batch,
            self._levels,
            self._reach,
            q_jaw=self._q_jaw,
            spacing=self._spacing,
            proven=True,
        )

    def is_free(self, q: Array) -> bool:
        """Whether nothing is too close at joint angles ``q``, shape (5,), [rad]."""
        return not self.batch.touches(self._levels, q, self._q_jaw)

    def touching(self, q: Array) -> Array:
        """Which of several configurations (n, 5) [rad] touch something, booleans, shape (n,)."""
        jaw = np.full((len(q), 1), self._q_jaw)
        return self.batch.touching(self._levels, np.concatenate((q, jaw), axis=1))

    def is_clear(self, q_from: Array, q_to: Array) -> bool:
        """Whether no sample between two configurations touches; the two are not checked."""
        if self.checker.proven:
            points = np.array([q_from, q_to])
            blocked = self.batch.first_blocked(self._levels, self._reach, points, self._q_jaw)
            return blocked is None
        return self.batch.is_clear(
            self._levels, self._reach, self._spacing, q_from, q_to, self._q_jaw
        )


class Couple(ctypes.Structure):
    """Two arms of a team that must stay apart, in the library's form.

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


class BatchTeamCheck:
    """Check of one or several arms with all joints in one vector, for the library's search.

    Args:
        checks: The check of each arm, at most ``MOST_ARMS`` of them.
        couples: The pairs of arms that must stay apart.
        room: Distance they must keep [m].

    Attributes:
        library: The library.
        team: This check in its form, by reference.
    """

    def __init__(
        self,
        checks: Sequence[BatchSampledCheck],
        couples: Sequence[Couple] = (),
        room: float = 0.0,
    ) -> None:
        self._batches = dict.fromkeys(each.batch for each in checks)
        self._checks = checks
        self._arms = (Checker * len(checks))(*(each.checker for each in checks))
        self._couples = (Couple * len(couples))(*couples)
        arms, pairs = ctypes.addressof(self._arms), ctypes.addressof(self._couples)
        self.library = checks[0].batch.library
        self.team = ctypes.byref(_Team(len(checks), len(couples), arms, pairs, room))

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
            for batch in self._batches:
                batch.raise_error()


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
