"""Answer ``run_program``: plan and run a program on an arm.

``{"command": "run_program", "waypoints": [...], "loops": [...], "rounds": 3}`` has the entries of a
program's file (``tasks/program/files.py``), so it may have ``"steps"`` as well. The surroundings
are read once, then the whole program is planned and run. All of that is one motion, so a Stop or a
newer motion ends it at any point.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from so101_motion.arm.motion_queue import wait_here
from so101_motion.common.attributes import Attributes
from so101_motion.tasks.teleop.local_arms import jaw_of

if TYPE_CHECKING:
    from so101_motion.common.operation import Moving
    from so101_motion.rig.rig import Rig
    from so101_motion.viam.surroundings.surroundings import Surroundings

ENTRIES = ("schema", "waypoints", "steps", "loops", "rounds")


async def run_program(
    rig: Rig,
    surroundings: Surroundings,
    hold: Callable[[], Awaitable[None]],
    arrived: Callable[[Moving], Awaitable[None]],
    given: Attributes,
) -> dict[str, Any]:
    """Plan and run a program; ``hold`` ends manual mode, and holds again after a fault."""
    from so101_motion.tasks.program import ARM, ProgramRun, Rehearsal, Solo, rehearse
    from so101_motion.tasks.program.files import program_from, rounds_to

    content = {key: given.raw(key) for key in ENTRIES if given.given(key)}
    program = (await asyncio.to_thread(program_from, content)).on([ARM])
    await hold()
    solo = Solo(rig.arm, jaw_of(rig), rig.clock)
    loop = asyncio.get_running_loop()

    def planned() -> Rehearsal:
        """Read the surroundings and plan; called on the arm's planning thread once it rests."""
        if surroundings.is_asked():
            reading = asyncio.run_coroutine_threadsafe(surroundings.around(solo.arm.scene), loop)
            solo.scene = wait_here(reading)
        return rehearse(solo, program)

    run = ProgramRun(solo, program, planned)
    await arrived(run.motions[ARM])
    assert run.rehearsal is not None
    return {
        "waypoints": len(program),
        "rounds": rounds_to(program.rounds),
        "round_s": round(run.rehearsal.duration, 3),
    }
