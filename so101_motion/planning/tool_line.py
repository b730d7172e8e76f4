"""A straight line of the tool as a curve of the joints, and its timing.

Along the curve the arm moves by one number ``u`` from 0 to 1, the share of the line that is done:
a jerk-limited start, constant speed, a jerk-limited end. The tool stays on the curve whatever the
speed, and moves evenly, which is what a line is wanted for. The speed is set by the joint that has
most to do anywhere along the line; toppra would be faster where the others have less to do, but
its motion needs smoothing, and that would leave the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from so101_motion.geometry import Array
from so101_motion.planning import verify
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.online import point_to_point
from so101_motion.planning.path_geometry import JointPath
from so101_motion.planning.trajectory import Trajectory

SAME = 1e-6
"""A curve no joint moves along by more than this [rad] is no motion. Chosen."""

SLOWER = 4
"""How often a motion may be slowed down until it keeps its limits; two did for 900 random lines."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolLine:
    """A curve in joint space along which the tool moves straight.

    Attributes:
        path: The curve; its parameter is the share of the line that is done, 0 to 1.
        length: Of the line [m].
    """

    path: JointPath
    length: float

    @property
    def waypoints(self) -> Array:
        """The postures the curve was laid through, shape (m, 5), [rad]."""
        return self.path.evaluate(self.path.knots).q

    def timed(self, limits: MotionLimits, dt: float) -> Trajectory:
        """The motion along the line, from rest to rest, at one speed as far as possible.

        Args:
            limits: Caps of the joints and of the tool.
            dt: Time between samples [s].
        """
        if float(np.ptp(self.waypoints, axis=0).max()) <= SAME:
            return point_to_point(self.waypoints[0], self.waypoints[0], limits, dt)
        caps = self._caps(limits)
        trajectory = self._moved(caps, dt)
        for _ in range(SLOWER):
            stretch = verify.violations(trajectory, limits).stretch
            if stretch <= 1.0:
                break
            # Once is nearly enough; but the samples fall elsewhere then, and a short peak of jerk
            # that lay between them may show.
            slower = stretch * (1.0 + verify.TOLERANCE)
            caps = [cap / slower**k for k, cap in enumerate(caps, 1)]
            trajectory = self._moved(caps, dt)
        return trajectory

    def _caps(self, limits: MotionLimits) -> list[float]:
        """Speed, acceleration and jerk of ``u`` that hardly break a limit anywhere.

        Of a joint's acceleration, ``q'' u_t^2 + q' u_tt``, the first part may take half.
        """
        _, q_u, q_uu = self.path.evaluate(np.linspace(0.0, 1.0, 4 * len(self.path.knots)))
        slope, bend = np.abs(q_u).max(axis=0), np.abs(q_uu).max(axis=0)
        with np.errstate(divide="ignore"):
            speed = min(
                float(np.min(limits.velocity / slope)),
                float(np.min(np.sqrt(0.5 * limits.acceleration / bend))),
            )
            if limits.tool_speed is not None and self.length > 0.0:
                speed = min(speed, limits.tool_speed / self.length)
            acceleration = float(np.min((limits.acceleration - bend * speed**2) / slope))
            jerk = float(np.min(limits.jerk / slope))
        return [speed, acceleration, jerk]

    def _moved(self, caps: list[float], dt: float) -> Trajectory:
        speed, acceleration, jerk = caps
        one = MotionLimits.uniform(velocity=speed, acceleration=acceleration, jerk=jerk, n=1)
        share = point_to_point(np.zeros(1), np.ones(1), one, dt)
        q, q_u, q_uu = self.path.evaluate(share.q[:, 0])
        return Trajectory(
            dt=dt,
            q=q,
            qd=q_u * share.qd,
            qdd=q_u * share.qdd + q_uu * share.qd**2,
            duration=share.duration,
        )


def curve_through(q: Array) -> JointPath:
    """The cubic spline through evenly spaced postures, over 0 to 1.

    At the ends the outer two pieces are one cubic ("not a knot"), because nothing is known of the
    curvature there and assuming none would bend the tool's way.

    Args:
        q: Shape (m, 5), m >= 4, [rad].

    Source: C. de Boor, A Practical Guide to Splines, 1978, chapter IV.
    """
    count = len(q) - 1
    h = 1.0 / count
    system = 4.0 * np.eye(count + 1) + np.eye(count + 1, k=1) + np.eye(count + 1, k=-1)
    system[0, :3] = system[-1, -3:] = (1.0, -2.0, 1.0)
    right = np.zeros_like(q)
    right[1:-1] = (6.0 / h**2) * (q[:-2] - 2.0 * q[1:-1] + q[2:])
    bends = np.linalg.solve(system, right)
    coefficients = np.stack(
        [
            q[:-1],
            np.diff(q, axis=0) / h - h * (2.0 * bends[:-1] + bends[1:]) / 6.0,
            bends[:-1] / 2.0,
            np.diff(bends, axis=0) / (6.0 * h),
        ],
        axis=1,
    )
    return JointPath(knots=np.linspace(0.0, 1.0, count + 1), coefficients=coefficients)
