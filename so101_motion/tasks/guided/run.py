"""Run a planned replay: one motion of the arm, and a jaw that moves with it.

The jaw follows the aperture of the arm's present setpoint: both stop together. It grips an object
that it closes on and holds it until the path opens it again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial

import numpy as np

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import Gripper, JawFollowing, move_jaw
from so101_motion.arm.motion_handle import Motion, Step
from so101_motion.common.geometry import Array
from so101_motion.planning.request import Plan
from so101_motion.tasks.guided.replay import Replay

_AHEAD = 4
"""How many samples ahead the arm's place on its leg is searched in each period; chosen, more than
can be left out in a row."""


def start_replay(
    arm: Arm, gripper: Gripper | None, replay: Replay | Callable[[], Future[Replay]]
) -> Motion:
    """Move along a planned path; supersedes what is under way.

    A stop, a newer motion or ``Motion.interrupt`` ends it at any point, and the jaw stops too.

    Args:
        arm: The arm that it was planned for; it must be where the plan begins.
        gripper: Its gripper; None to leave the jaw alone.
        replay: The planned replay, or a function that starts planning it once the arm rests.
    """
    runs: list[_JawRun] = []
    motion = arm.start_series(_steps(arm, gripper, replay, runs))
    motion.future.add_done_callback(lambda _: _close(runs))
    return motion


def _steps(
    arm: Arm,
    gripper: Gripper | None,
    replay: Replay | Callable[[], Future[Replay]],
    runs: list[_JawRun],
) -> Iterator[Step]:
    if callable(replay):
        planning, planned = replay(), list[Replay]()
        yield lambda motion: planned.append(motion.wait_for(planning))
        replay = planned[0]
    yield replay.approach
    for leg in replay.legs:
        if gripper is not None and leg.begin is not None:
            yield partial(move_jaw, gripper, leg.begin)
        if leg.plan is None:
            continue
        if gripper is None or leg.aperture is None:
            yield leg.plan
            continue
        run = _JawRun(arm, gripper, leg.plan, leg.aperture)
        runs.append(run)
        yield run.begin
        yield leg.plan
        yield run.end


def _close(runs: list[_JawRun]) -> None:
    for run in runs:
        run.close()


class _JawRun:
    """Moves the jaw on one leg: it follows the aperture that belongs to the arm's place."""

    def __init__(self, arm: Arm, gripper: Gripper, plan: Plan, aperture: Array) -> None:
        self._arm, self._gripper = arm, gripper
        self._q, self._aperture, self._dt = plan.trajectory.q, aperture, plan.trajectory.dt
        self._rate = np.gradient(aperture, self._dt)
        self._at = 0
        self._following: JawFollowing | None = None

    def begin(self, motion: Motion) -> None:
        """Start the jaw; a jaw that grips and is not to open keeps its grip."""
        if self._gripper.is_holding and self._aperture.max() <= self._gripper.aperture:
            return
        self._following = self._gripper.follow(each=self._aim)

    def end(self, motion: Motion) -> None:
        """Wait for the jaw, because the arm has arrived."""
        if self._following is not None:
            motion.wait_for(self._following.close())

    def close(self) -> None:
        if self._following is not None:
            self._following.close()

    # The I/O thread

    def _aim(self, jaw: JawFollowing) -> None:
        q_ref = self._arm.state.q_ref
        ahead = self._q[self._at : self._at + _AHEAD]
        self._at += int(np.argmin(np.abs(ahead - q_ref).max(axis=1)))
        coming = min(self._at + 1, len(self._q) - 1)  # where the arm is wanted after this period
        jaw.aim(self._aperture[coming], self._rate[coming])
