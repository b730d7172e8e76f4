"""When two arms come too near to each other, by coal: a judge that shares no code with apart.c."""

import math

import coal
import numpy as np

from so101_motion.common.geometry import SE3

_PART = 0.25  # as in apart.c


def meet_by_coal(a, b, T, qa, qb, room, early):
    """The first time at which two arms come too near, by coal; ``early`` is in steps."""
    data = a.model.createData(), b.model.createData()
    travel_a, travel_b, last = a.travel(qa), b.travel(qb), len(qa) - 1
    due = np.zeros((len(a.objects), len(b.objects)))
    request, t = coal.DistanceRequest(), 0.0
    while t <= last:
        k = min(int(t), max(last - 1, 0))
        at = [q[k] + (t - k) * (q[min(k + 1, last)] - q[k]) for q in (qa, qb)]
        place_a = a.placed(at[0], SE3.identity(), data[0])
        place_b = b.placed(at[1], T, data[1])
        for i, j in zip(*np.nonzero(due <= t), strict=True):
            one, other = a.objects[i], b.objects[j]
            due[i, j] = math.inf
            if one.joint == other.joint == 0:
                continue
            speeds = np.column_stack((travel_a[k:, i], travel_b[k:, j]))
            need = room + (early * float(speeds[0].min()) if last else 0.0)
            gap = coal.distance(
                one.shape, place_a[i], other.shape, place_b[j], request, coal.DistanceResult()
            )
            if gap < need:
                return t, gap, int(i), int(j)
            due[i, j] = max(
                until(speeds, t, k, gap - room, early), until(speeds, t, k, _PART * room, 0.0)
            )
        following = float(due.min())
        t = last if t < last < following < math.inf else following
    return None


def until(speeds, t, k, room, early):
    """Like ``until`` in apart.c; ``speeds`` begin at step ``k``, shape (m, 2), [m]."""
    for step, (va, vb) in enumerate(speeds, k):
        left, late = (step + 1 - t) * (va + vb), early * min(va, vb)
        if left + late > room:
            return float(t + (room - late) / (va + vb)) if room > late else t
        room, t = room - left, step + 1.0
    return math.inf
