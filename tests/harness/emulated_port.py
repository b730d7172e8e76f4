"""A serial port with servos behind it: ``so101 emulate`` in a process of its own, or a real arm."""

import asyncio
import signal
import sys
from contextlib import asynccontextmanager

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
        await asyncio.wait_for(process.wait(), 10.0)
