"""Let a motion begin while the arm still moves: go from its state straight into the motion.

The sure way is to come to rest first. Any instant of that is a state, and the fastest motion from
the first to a later one cuts off what lies between. The shortest cut that keeps all limits and is
proven free is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from so101_motion.common.errors import PlanningError
from so101_motion.planning.planning_context import PlanningContext
from so101_motion.planning.timing import online
from so101_motion.planning.timing.trajectory import Trajectory

TRIED = 16  # number of states that are tried as the end of the cut; chosen: each takes 50 us


def taken_up(context: PlanningContext, lead: Trajectory, motion: Trajectory) -> Trajectory:
    """The motion from the first state of ``lead`` to the end of ``motion``, which starts at rest.

    ``lead`` would come to rest where ``motion`` begins.

    Raises:
        PlanningError: Not even coming to rest first keeps the limits and out of contact.
    """
    whole, limits, moves = lead.then(len(lead) - 1, motion), context.request.limits, context.moves
    last, begin = len(whole) - 1, whole.sample(0.0)
    tried: list[tuple[int, int, Callable[[], Trajectory]]] = []
    for k in np.unique(np.linspace(1, last, TRIED).astype(int)).tolist():
        with suppress(PlanningError):
            count, cut = online.between(begin, whole.sample(k * whole.dt), limits, whole.dt)
            tried.append((count - k, k, cut))
    for saved, k, cut in sorted(tried, key=lambda each: each[0]):
        shorter = cut().then(saved + k, whole.since(k))
        if saved < 0 and moves.is_free(shorter):
            with suppress(PlanningError):
                context.check([shorter])
                return shorter
    context.check([whole])
    return whole
