"""Answer ``run_program``: plan and run a program of waypoints on an arm.

``{"command": "run_program", "waypoints": [...], "loops": [...], "rounds": 3}`` has the entries of a
program's file (``tasks/program/files.py``). The surroundings are read once, then the whole program
is planned and run. All of that is one motion, so a Stop or a newer motion ends it at any point.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.attributes import Attributes
from so101_motion.tasks.teleop.local_arms import jaw_of
from so101_motion.viam.requests.commands import Command, Taking

if TYPE_CHECKING:
    from so101_motion.tasks.program import Program, Rehearsal
    from so101_motion.viam.models.arm_resource import ArmResource

_ENTRIES = ("schema", "waypoints", "loops", "rounds")


class ProgramCommands:
    """Runs programs on one arm component. Lives in the event loop.

    Args:
        arm: The component.

    Attributes:
        commands: The method for each ``command``.
    """

    def __init__(self, arm: ArmResource) -> None:
        self._arm = arm
        self.commands: Mapping[str, Command] = {"run_program": Taking(self._run, _ENTRIES)}

    async def _run(self, given: Attributes) -> dict[str, Any]:
        from so101_motion.tasks.program import run_once_planned
        from so101_motion.tasks.program.files import program_from, rounds_to

        content = {key: given.raw(key) for key in _ENTRIES if given.given(key)}
        program = await asyncio.to_thread(program_from, content)
        await self._arm.set_manual_mode(False)  # holds again after a fault, too
        rig = self._arm.rig
        planned = partial(self._planned, asyncio.get_running_loop(), program)
        run = run_once_planned(rig.arm, jaw_of(rig), rig.clock, program, planned)
        await self._arm.arrived(run.motion)
        assert run.rehearsal is not None
        return {
            "waypoints": len(program),
            "rounds": rounds_to(program.rounds),
            "round_s": round(run.rehearsal.duration, 3),
        }

    def _planned(
        self, loop: asyncio.AbstractEventLoop, program: Program, motion: Motion
    ) -> Rehearsal:
        """Read the surroundings and plan; called on the arm's planning thread once it rests."""
        from so101_motion.tasks.program import rehearse

        rig, scene, around = self._arm.rig, None, self._arm.surroundings
        if around.is_asked():
            reading = asyncio.run_coroutine_threadsafe(around.around(rig.arm.scene), loop)
            scene = motion.wait_for(reading)
        return rehearse(rig.arm, jaw_of(rig), program, scene=scene)
