"""Plan legs of a program in one scene, with a limit on work instead of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from so101_motion.arm.cell_member import Stand
from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Plan, Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload, Strength
from so101_motion.tasks.program.program import ARM, Program
from so101_motion.tasks.program.rehearsal import plan_leg
from so101_motion.tasks.sweeps.work_budget import NEVER, WorkBudget

_LOOKS = 100
"""A leg is given up after so many checkpoints. Chosen: some tenths of a second."""


class SceneLegs:
    """The planner for ``plan_leg``; always a fresh one. Belongs to one thread.

    Args:
        model: The arm.
        scene: What is around it.
        limits: The caps of its motions.
        payload: The load in its hand.
        strength: The strength of its servos.
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
        # A fresh one: checkpoints are counted in batches that continue from plan to plan.
        self._planner = Planner(model, self._patience)

    def plan_together(
        self,
        goals: Mapping[str, JointGoal | PathGoal],
        *,
        limits: Mapping[str, MotionLimits],
        stands: Mapping[str, Stand],
    ) -> dict[str, Plan]:
        """Plan for the only arm."""
        ((name, goal),) = goals.items()
        self._patience.reset()
        request = PlanRequest(
            q_start=stands[name].q,
            goal=goal,
            limits=limits[name],
            q_jaw=stands[name].q_jaw,
            scene=self._scene,
            payload=self._payload,
            strength=self._strength,
            time_budget=NEVER,
        )
        return {name: self._planner.plan(request)}

    def leg(self, program: Program, indices: range, q_start: Array, q_jaw: float) -> Plan | None:
        """The motion of a leg; arguments and errors of ``plan_leg``. None if there is none."""
        stands, caps = {ARM: Stand(q_start, q_jaw)}, {ARM: self.limits}
        return plan_leg(self, program.on([ARM]), indices, stands, caps).plan


def jaw_angles(apertures: Sequence[float | None], *, goes_around: bool) -> list[float]:
    """The jaw's angle after each stop [rad]; closed before the first aperture.

    Args:
        apertures: Its aperture at each stop, 0 to 1; None to leave it.
        goes_around: Whether the first stop comes again after the last.
    """
    given = [each for each in apertures if each is not None]
    aperture = given[-1] if given and goes_around else 0.0
    jaws = []
    for each in apertures:
        aperture = aperture if each is None else each
        jaws.append(JAW_CLOSED + aperture * (JAW_OPEN - JAW_CLOSED))
    return jaws
