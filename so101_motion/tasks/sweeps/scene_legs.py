"""Plan legs of a program in one scene; given up after a number of looks, not by the clock."""

from __future__ import annotations

from collections.abc import Sequence

from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.native.library import native
from so101_motion.planning.planner import Plan, Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload, Strength
from so101_motion.tasks.sweeps.work_budget import NEVER, WorkBudget

_LOOKS = 100
"""After how many checkpoints a leg is given up. Chosen: some tenths of a second."""


class SceneLegs:
    """What ``plan_leg`` plans with: a fresh planner. Belongs to one thread.

    Args:
        model: The arm.
        scene: What is around it.
        limits: The caps of its motions.
        payload: What it carries.
        strength: What its servos bear.
    """

    def __init__(
        self,
        model: RobotModel,
        scene: Scene,
        limits: MotionLimits,
        *,
        payload: Payload | None = None,
        strength: Strength | None = None,
    ) -> None:
        self.limits = limits
        self._scene, self._payload, self._strength = scene, payload, strength
        self._patience = WorkBudget(_LOOKS)
        # A fresh one: its looks are counted in batches that go on from plan to plan.
        self._planner = Planner(model, self._patience)

    def plan(
        self,
        goal: JointGoal | PathGoal,
        *,
        limits: MotionLimits | None,
        q_start: Array | None,
        q_jaw: float | None,
    ) -> Plan:
        """Plan from joint angles, shape (5,), [rad]."""
        assert q_start is not None
        assert q_jaw is not None
        self._patience.reset(compiled=native().library is not None)
        request = PlanRequest(
            q_start=q_start,
            goal=goal,
            limits=limits or self.limits,
            q_jaw=q_jaw,
            scene=self._scene,
            payload=self._payload,
            strength=self._strength,
            time_budget=NEVER,
        )
        return self._planner.plan(request)


def jaw_angles(apertures: Sequence[float | None], *, goes_around: bool) -> list[float]:
    """The jaw's angle after each stop [rad]; a jaw that is never told stays closed.

    Args:
        apertures: What it is told there, 0 to 1; None for nothing.
        goes_around: Whether the first stop comes after the last; else nothing is known before it.
    """
    given = [each for each in apertures if each is not None]
    aperture = given[-1] if given and goes_around else 0.0
    jaws = []
    for each in apertures:
        aperture = aperture if each is None else each
        jaws.append(JAW_CLOSED + aperture * (JAW_OPEN - JAW_CLOSED))
    return jaws
