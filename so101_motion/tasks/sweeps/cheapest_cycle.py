"""Choose one configuration at each stop so that the whole cycle takes the least time."""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import Array


def least_time(distance: Array, velocity: float, acceleration: float, jerk: float) -> Array:
    """The shortest time from rest to rest over distances, any shape, [rad] to [s].

    No motion of an arm takes less than the joint that turns farthest.

    Source: L. Biagiotti and C. Melchiorri, Trajectory Planning for Automatic Machines and Robots,
    2008, section 3.4, the double S with both ends at rest.
    """
    d = np.abs(distance)
    ramp = acceleration / jerk
    if velocity * jerk >= acceleration**2:
        cruise = d / velocity + velocity / acceleration + ramp
        full = velocity * (velocity / acceleration + ramp)
    else:
        cruise = d / velocity + 2.0 * np.sqrt(velocity / jerk)
        full = 2.0 * velocity * np.sqrt(velocity / jerk)
    ramped = ramp + np.sqrt(ramp**2 + 4.0 * d / acceleration)
    short = 4.0 * np.cbrt(0.5 * d / jerk)
    below = np.where(d >= 2.0 * acceleration * ramp**2, ramped, short)
    return np.where(d >= full, cruise, below)


def cheapest(costs: list[Array], *, closed: bool) -> tuple[float, list[int]]:
    """Choose one option at each stop so that the sum of costs is least.

    Args:
        costs: Costs from each option of a stop to each of the next, arrays (n_k, n_k+1); for a
            cycle the last leads back to the first stop.
        closed: Whether it is a cycle, which ends where it began with the same option.

    Returns:
        The cost, infinite if there is no choice, and the option at each stop.
    """
    n = len(costs[0])
    reached = np.where(np.eye(n, dtype=bool), 0.0, np.inf) if closed else np.zeros((1, n))
    before = []
    for cost in costs:
        through = reached[:, :, None] + cost[None]
        best = through.argmin(axis=1)
        before.append(best)
        reached = np.take_along_axis(through, best[:, None], axis=1)[:, 0]
    if closed:
        start = int(np.argmin(np.diag(reached)))
        last, total = start, float(reached[start, start])
    else:
        start, last = 0, int(np.argmin(reached[0]))
        total = float(reached[0, last])
    options = [last]
    for best in reversed(before):
        options.append(int(best[start, options[-1]]))
    options.reverse()
    return total, options[:-1] if closed else options
