"""Fit a smooth joint curve along which the tool keeps to its path.

How it works. Given are configurations for points of the path a centimetre apart; they come from a
search over a grid, so what is free (mostly the pitch) changes in steps.

1. *Smooth.* The sequence is replaced by a near one with small second differences. That moves the
   tool off its path a little.
2. *Project.* Newton's method with the least joint motion puts the tool back. It does not change the
   freedom that the path leaves, so that stays smooth.
3. *Lay a cubic spline through the configurations*, and check the middle between each two. Where the
   tool is off by more than 0.45 of the tolerance there, the middles are projected and added as
   configurations, until it is not.

Curves that leave the joint limits, do not converge or are not accepted are tried again with less
smoothing, in the end with none. If none succeeds, the path comes close to a singular configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.cartesian.tool_path import ToolPath
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.path_geometry import JointPath, cubic_path, solved

SMOOTHED = (30.0, 1.0, 0.0)
"""Weights of smoothness against nearness, one attempt after the other, where the pitch is free.
Chosen: the first evens out changes shorter than ten configurations."""

EXACT = (0.0, 1.0)  # the same where the goal prescribes the tool's orientation

MOST_CONFIGURATIONS, FINEST = 400, 0.001
"""A curve that needs more configurations than this, and closer together [m], is given up: it passes
too close to a singular configuration."""

SETTLING = 0.7  # twice the configurations must leave less of the error; a smooth curve: a sixteenth

MIDWAY = 0.45
"""Share of the tolerance by which a curve may be off in the middle between its configurations.
Elsewhere it may be a tenth further off than there (at most 1.09 times on 180 lines), so half the
tolerance is kept everywhere."""

LIMIT_SLACK = 0.5 * verify.POSITION_TOLERANCE
"""How far a curve may be outside the joint limits [rad]: half of what verification accepts."""

_EXACT = 1e-8  # a tool this close to its path is on it [m]

_ROUNDS, _STEPS = 4, 4
"""How often Newton's method works out the Jacobian, and how many steps it takes with each. From
close by one Jacobian and two steps do, but near singular configurations."""

_DAMPING = 1e-10  # keeps a step finite at a singular configuration [m^2/rad^2]; nothing elsewhere


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitFailure:
    """Where and why no curve could be fitted."""

    s: float  # how far along the path [m]
    q: Array  # the configuration that failed, shape (5,), [rad]
    turned: float = 0.0  # how far it turns the tool off [rad], if that is too far
    # whether it is in contact. If neither, the path is near a singular configuration
    in_contact: bool = False


Accept = Callable[[JointPath], FitFailure | None]  # checks a curve; returns None if it is accepted


class CurveFitter:
    """Fits joint curves to tool paths of one frame, at most ``tolerance`` [m] off."""

    def __init__(self, chain: ArmChain, lower: Array, upper: Array, tolerance: float) -> None:
        self._chain, self._lower, self._upper = chain, lower, upper
        self._tolerance = tolerance

    def fit(
        self, tool_path: ToolPath, s: Array, q: Array, stiffnesses: Sequence[float], accept: Accept
    ) -> JointPath | FitFailure:
        """A curve over ``s - s[0]`` through configurations near given ones; or why none was found.

        ``s`` (n,) are places on the path, evenly spaced, n >= 6 [m], and ``q`` (n, 5) a
        configuration for each; the first is kept as it is. ``stiffnesses`` are ``SMOOTHED`` or
        ``EXACT``.
        """
        p = tool_path.places(s)
        widest = int(np.argmax(np.linalg.norm(np.diff(q, axis=0), axis=1)))
        found: JointPath | FitFailure = FitFailure(
            s=0.5 * float(s[widest] + s[widest + 1]), q=q[widest]
        )
        for stiffness in stiffnesses if _is_ragged(q) else (0.0,):
            on_path = self._projected(_smoothed(q, stiffness) if stiffness else q, p)
            if on_path is None:
                continue
            on_path[0] = q[0]
            found = self._through(tool_path, s, on_path)
            if isinstance(found, JointPath):
                problem = accept(found)
                if problem is None:
                    return found
                found = problem
        return found

    def _through(self, tool_path: ToolPath, s: Array, q: Array) -> JointPath | FitFailure:
        before = np.inf
        while True:
            path = curve_through(q, float(s[-1] - s[0]))
            off, outside = self._errors(tool_path, s, path)
            if off.max() <= MIDWAY * self._tolerance and outside.max() <= LIMIT_SLACK:
                return path
            worst = int(np.argmax(np.maximum(off / self._tolerance, outside)))
            middles = 0.5 * (s[:-1] + s[1:])
            finer = self._projected(path.evaluate(middles - s[0]).q, tool_path.places(middles))
            settles = off.max() <= max(SETTLING * before, MIDWAY * self._tolerance)
            too_fine = 2 * len(q) > MOST_CONFIGURATIONS and s[1] - s[0] < FINEST
            if finer is None or too_fine or not settles:
                return FitFailure(s=float(middles[worst]), q=q[worst])
            s, q, before = _between(s, middles), _between(q, finer), float(off.max())

    def _errors(self, tool_path: ToolPath, s: Array, path: JointPath) -> tuple[Array, Array]:
        """In each piece the tool's distance from its path [m] and the joints' from limits [rad]."""
        middles = 0.5 * (s[:-1] + s[1:])
        off = self._chain.positions(path.evaluate(middles - s[0]).q) - tool_path.places(middles)
        low, high = _extremes(path)
        outside = np.maximum(self._lower - low, high - self._upper).max(axis=1)
        return np.linalg.norm(off, axis=1), outside

    def _projected(self, q: Array, p: Array) -> Array | None:
        """The nearest ``q`` (n, 5) with the tool at ``p`` (n, 3) [m]; None if none settles."""
        q = np.clip(q, self._lower, self._upper)
        for _ in range(_ROUNDS):
            here, J = self._chain.positions_and_jacobians(q)
            square = J @ J.transpose(0, 2, 1) + _DAMPING * np.eye(3)
            inverse = J.transpose(0, 2, 1) @ np.linalg.inv(square)
            for _ in range(_STEPS):
                off = p - here
                if float(np.abs(off).max()) <= _EXACT:
                    return q
                step = np.einsum("nij,nj->ni", inverse, off)
                q = np.clip(q + step, self._lower, self._upper)
                here = self._chain.positions(q)
        return None


def curve_through(q: Array, length: float) -> JointPath:
    """The cubic spline over 0 to ``length`` through evenly spaced ``q`` (m, 5) [rad], m >= 6.

    At the ends the outer two pieces are one cubic ("not a knot"), because nothing is known of the
    curvature there and assuming none would bend the tool's path.

    Source: C. de Boor, A Practical Guide to Splines, 1978, chapter IV.
    """
    h = length / (len(q) - 1)
    right = (6.0 / h**2) * (q[:-2] - 2.0 * q[1:-1] + q[2:])
    bends = np.empty_like(q)
    # With b0 - 2 b1 + b2 = 0 the first equation, b0 + 4 b1 + b2 = r1, says what b1 is; likewise at
    # the end.
    bends[[1, -2]] = right[[0, -1]] / 6.0
    right[[1, -2]] -= bends[[1, -2]]
    bends[2:-2] = solved(np.full(len(q) - 4, 4.0), np.ones(len(q) - 5), right[1:-1])
    bends[0], bends[-1] = 2.0 * bends[1] - bends[2], 2.0 * bends[-2] - bends[-3]
    return cubic_path(np.linspace(0.0, length, len(q)), q, bends)


def _extremes(path: JointPath) -> tuple[Array, Array]:
    """The smallest and the largest value of each joint on each piece, each (pieces, 5), [rad]."""
    c0, c1, c2, c3 = path.coefficients.transpose(1, 0, 2)
    h = np.diff(path.knots)[:, None]
    # A cubic turns where its derivative is zero: at most twice; the larger root by the product.
    root = np.sqrt(np.maximum(c2 * c2 - 3.0 * c1 * c3, 0.0))
    far = -(c2 + np.copysign(root, c2))
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = np.nan_to_num(np.array([far / (3.0 * c3), c1 / far]))
    u = np.concatenate([np.clip(turns, 0.0, h), np.zeros_like(h[None] * c0), h + 0.0 * c0[None]])
    q = c0 + u * (c1 + u * (c2 + u * c3))
    return q.min(axis=0), q.max(axis=0)


def _is_ragged(q: Array) -> bool:
    """Whether pitch or roll change along the configurations, so that smoothing helps."""
    pitch = q[:, 1:4].sum(axis=1)
    return bool(max(np.ptp(pitch), np.ptp(q[:, 4])) > 1e-9)


def _smoothed(q: Array, stiffness: float) -> Array:
    """The sequence with the least sum of squared distances and second differences; ends kept.

    Source: E. T. Whittaker, On a new method of graduation, 1923.
    """
    count = len(q)
    bend = np.zeros((count - 2, count))
    rows = np.arange(count - 2)
    bend[rows, rows], bend[rows, rows + 1], bend[rows, rows + 2] = 1.0, -2.0, 1.0
    system = np.eye(count) + stiffness * bend.T @ bend
    system[[0, -1]] = np.eye(count)[[0, -1]]
    return np.asarray(np.linalg.solve(system, q))


def _between(values: Array, middles: Array) -> Array:
    """Values interleaved with those in the middle between them."""
    both = np.empty((len(values) + len(middles), *values.shape[1:]))
    both[::2], both[1::2] = values, middles
    return both
