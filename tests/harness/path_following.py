"""How well an arm follows a planned path: random paths, and how far from them it was."""

from dataclasses import dataclass

import numpy as np

from so101_motion.common.errors import PlanningError
from so101_motion.planning.goals import PathGoal

MIDDLE_DEG = np.array([0.0, -30.0, 30.0, 20.0, 0.0])
REACH_DEG = np.array([70.0, 45.0, 45.0, 60.0, 90.0])

_TICK = 0.01
_LAGS = np.arange(0.0, 0.25, 0.002)


@dataclass(frozen=True)
class Followed:
    """How well one plan was followed, in true joint angles.

    Attributes:
        error: Largest distance of a joint from its planned path, once the lag is taken out [deg].
        lag: How far behind its setpoints the arm was [s], the same for all joints and times.
        final: Largest distance of a joint from its goal at the end [deg].
        missed: Largest distance of a joint at the waypoint that was passed worst [deg].
    """

    error: float
    lag: float
    final: float
    missed: float


def random_plan(rig, seed, waypoints=4, middle=MIDDLE_DEG, reach=REACH_DEG):
    """A plan from where the arm is, through random waypoints, to the last of them [deg]."""
    rng = np.random.default_rng(seed)
    for _ in range(200):
        path = middle + rng.uniform(-1.0, 1.0, (waypoints, 5)) * reach
        try:
            return rig.arm.plan(PathGoal(waypoints=np.radians(path))), path
        except PlanningError:
            continue
    raise AssertionError(f"no free path for seed {seed}")


def follow(bench, rig, plan, path):
    """Move the arm along ``plan``, through the waypoints ``path`` [deg]."""
    motion = rig.arm.move(plan, wait=False)
    rows, times = [], []
    while not motion.future.done():
        bench.advance(_TICK)
        state = rig.arm.state
        if state.arm_moving:
            times.append(state.t)
            rows.append((np.degrees(state.q_ref), bench.arm_deg(rig)))
    motion.result(timeout=0.0)
    q_ref, q = (np.array(column) for column in zip(*rows, strict=True))
    t = np.array(times) - times[0]
    errors = [_error(t, q_ref, q, lag) for lag in _LAGS]
    return Followed(
        error=float(min(errors)),
        lag=float(_LAGS[np.argmin(errors)]),
        final=float(np.max(np.abs(q[-1] - path[-1]))),
        missed=float(max(np.min(np.max(np.abs(q - point), axis=1)) for point in path)),
    )


def _error(t, q_ref, q, lag):
    wanted = np.array([np.interp(t - lag, t, column) for column in q_ref.T]).T
    return np.max(np.abs(wanted - q))
