"""Answer ``run_program``: plan and run a program on an arm.

``{"command": "run_program", "waypoints": [...], "loops": [...], "rounds": 3}`` has the entries of a
program's file (``tasks/program/files.py``), so it may have ``"steps"`` as well. The surroundings
are read once, then the whole program is planned and run. All of that is one motion, so a Stop or a
newer motion ends it at any point.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from so101_motion.arm.motion_queue import wait_here
from so101_motion.common.attributes import Attributes
from so101_motion.tasks.teleop.local_arms import jaw_of
from so101_motion.viam.requests.commands import Command, Taking

if TYPE_CHECKING:
    from so101_motion.common.operation import Moving
    from so101_motion.rig.rig import Rig
    from so101_motion.tasks.program import Program, Rehearsal, Solo
    from so101_motion.viam.surroundings.surroundings import Surroundings

ENTRIES = ("schema", "waypoints", "steps", "loops", "rounds")


class ProgrammedArm(Protocol):
    """The component of an arm; see ``ArmResource``."""

    rig: Rig
    surroundings: Surroundings

    async def set_manual_mode(self, manual_mode: bool) -> None:
        """Start manual mode, or hold."""

    async def arrived(self, motion: Moving) -> None:
        """Wait until a motion of this arm has arrived."""


class ProgramCommands:
    """Runs programs on one arm component. Lives in the event loop.

    Args:
        arm: The component.

    Attributes:
        commands: The method for each ``command``.
    """

    def __init__(self, arm: ProgrammedArm) -> None:
        self._arm = arm
        self.commands: Mapping[str, Command] = {"run_program": Taking(self._run, ENTRIES)}

    async def _run(self, given: Attributes) -> dict[str, Any]:
        from so101_motion.tasks.program import ARM, ProgramRun, Solo
        from so101_motion.tasks.program.files import program_from, rounds_to

        content = {key: given.raw(key) for key in ENTRIES if given.given(key)}
        program = (await asyncio.to_thread(program_from, content)).on([ARM])
        await self._arm.set_manual_mode(False)  # holds again after a fault, too
        rig = self._arm.rig
        solo = Solo(rig.arm, jaw_of(rig), rig.clock)
        planned = partial(self._planned, asyncio.get_running_loop(), solo, program)
        run = ProgramRun(solo, program, planned)
        await self._arm.arrived(run.motions[ARM])
        assert run.rehearsal is not None
        return {
            "waypoints": len(program),
            "rounds": rounds_to(program.rounds),
            "round_s": round(run.rehearsal.duration, 3),
        }

    def _planned(self, loop: asyncio.AbstractEventLoop, solo: Solo, program: Program) -> Rehearsal:
        """Read the surroundings and plan; called on the arm's planning thread once it rests."""
        from so101_motion.tasks.program import rehearse

        around = self._arm.surroundings
        if around.is_asked():
            reading = asyncio.run_coroutine_threadsafe(around.around(solo.arm.scene), loop)
            solo.scene = wait_here(reading)
        return rehearse(solo, program)
