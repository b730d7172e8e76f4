"""A serial port with servos behind it: ``so101 emulate`` in a process of its own, or a real arm."""

import asyncio
import signal
import sys
from contextlib import asynccontextmanager

from grpclib import GRPCError, Status

from harness.fake_parent import ROOT

EMULATE = "from so101_motion.cli import main; main()"

SUPPORT = "".join(f"0 {joint} start\n" for joint in ("shoulder_lift", "elbow_flex", "wrist_flex"))
"""A hand that keeps the arm from falling while nobody holds it."""


class HardwarePort:
    """A port with servos; faults are typed into the emulator's standard input."""

    def __init__(self, port, process=None):
        self.port, self.process = port, process

    async def let_go(self):
        """Let go of an emulated arm that somebody held up; it holds by itself now."""
        if self.process is not None:
            await self.fault("end pose")

    async def fault(self, line):
        """Let something happen to the emulated servos, e.g. ``unplug`` or ``end unplug``."""
        self.process.stdin.write(f"{line}\n".encode())
        await self.process.stdin.drain()


async def works(call):
    """Whether a call succeeds, which is refused as long as servos are silent."""
    try:
        await call()
    except GRPCError as error:
        if error.status is not Status.UNAVAILABLE:
            raise
        return False
    return True


def servos_came_late(error):
    """Whether a busy machine kept emulated servos from answering or from moving in time."""
    if error.status is Status.ABORTED:
        return "from where it should be" in error.message
    lost = (Status.UNAVAILABLE, Status.FAILED_PRECONDITION)  # an answer, and the fault it makes
    return error.status in lost and "not ready" not in error.message


def processes_came_late(error):
    """Whether a busy machine kept processes of simulated arms from answering or moving in time."""
    late = ("has not listed its components within", "no setpoint could be sent")
    return any(words in error.message for words in late)


async def patiently(call, tries=5, came_late=servos_came_late):
    """The outcome of ``call()``, which is asked for again when ``came_late`` says so of its error.

    What only a busy machine does is no finding; anything else that goes wrong is raised at once.
    """
    for left in reversed(range(tries)):
        try:
            return await call()
        except GRPCError as error:
            if not left or not came_late(error):
                raise
            await asyncio.sleep(0.5)


async def in_the_end(call):
    """The outcome of ``call()``, asked for again if processes came late on a busy machine."""
    return await patiently(call, came_late=processes_came_late)


@asynccontextmanager
async def emulated_port(folder, *options):
    """Servos of an arm that somebody holds up."""
    link, hand = folder / "arm", folder / "hand"
    hand.write_text(SUPPORT)
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", EMULATE, "emulate", "--realtime",
        "--link", str(link), "--hand", str(hand), *options,
        cwd=ROOT, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        await process.stdout.readline()
        yield HardwarePort(str(link), process)
    finally:
        process.send_signal(signal.SIGTERM)
        await asyncio.wait_for(process.wait(), 60.0)
