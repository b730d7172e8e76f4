"""One arm with the interface of a ``Cell``, so that a program runs on either.

An arm that is in a cell keeps off the others as in any other motion; they need not stand still.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import Future

from so101_motion.arm.arm import Arm
from so101_motion.arm.cell import Cell
from so101_motion.arm.cell_member import Stand
from so101_motion.arm.motion_handle import Motion
from so101_motion.arm.picking import Picker
from so101_motion.arm.team_motion import TeamSeries, TeamStep
from so101_motion.common.clock import Clock
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import Goal
from so101_motion.planning.request import Plan, Search
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.protocols import GripperLike, RigLike
from so101_motion.rig.rig import Rig
from so101_motion.tasks.program.program import ARM


class Solo:
    """One arm; ``scene`` is that of its plans, by default the arm's own.

    Only with a ``picker`` can it pick items.
    """

    def __init__(
        self,
        arm: Arm,
        gripper: GripperLike | None,
        clock: Clock,
        picker: Picker | None = None,
    ) -> None:
        self.arm, self.gripper, self.clock, self.picker = arm, gripper, clock, picker
        self.scene: Scene | None = None

    @classmethod
    def of(cls, rig: RigLike) -> Solo:
        picker = rig.picker if isinstance(rig, Rig) else None
        return cls(rig.arm, rig.gripper, rig.clock, picker)

    @property
    def members(self) -> Mapping[str, Solo]:
        return {ARM: self}

    def stands(self) -> dict[str, Stand]:
        state = self.arm.state
        return {ARM: Stand(state.q_ref, state.q_jaw_ref)}

    def plan_together(
        self,
        goals: Mapping[str, Goal],
        *,
        limits: Mapping[str, MotionLimits],
        stands: Mapping[str, Stand],
        scenes: Mapping[str, Scene] | None = None,
    ) -> dict[str, Plan]:
        stand, search = stands[ARM], Search(scene=(scenes or {}).get(ARM, self.scene))
        plan = self.arm.plan(
            goals[ARM], limits=limits[ARM], search=search, q_start=stand.q, q_jaw=stand.q_jaw
        )
        return {ARM: plan}

    def start_series(self, steps: Iterator[TeamStep]) -> dict[str, Motion]:
        series = TeamSeries((ARM,), steps, lambda _plans: None)
        return {ARM: self.arm.start_series(series.of(ARM))}

    def check_again(self, plans: Mapping[str, Plan]) -> Future[dict[str, Plan]]:
        """``plans``, done already; raises as ``Arm.check_again`` does."""
        checked: Future[dict[str, Plan]] = Future()
        checked.set_result({name: self.arm.check_again(plan) for name, plan in plans.items()})
        return checked

    def stop(self) -> None:
        self.arm.stop()


Arms = Cell | Solo  # the arms that a program runs on
