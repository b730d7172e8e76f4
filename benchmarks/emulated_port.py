"""An emulated arm in a process of its own, for benchmarks in real time."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SUPPORT = "".join(
    f"0 {joint} start\n4 {joint} release\n"
    for joint in ("shoulder_lift", "elbow_flex", "wrist_flex")
)
"""A hand that holds the arm up until its servos do."""


@contextmanager
def emulated_port(*options: str, hand: str = "") -> Iterator[str]:
    """Run ``so101 emulate --realtime``; yields the name of its port. See ``emulated_process``."""
    with emulated_process(*options, hand=hand) as (port, _):
        yield port


@contextmanager
def emulated_process(*options: str, hand: str = "") -> Iterator[tuple[str, int]]:
    """Run ``so101 emulate --realtime``; yields the name of its port, and its process id.

    Args:
        options: Further options of that command.
        hand: A script of a hand at the joints, as ``--hand`` reads it.
    """
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "hand"
        script.write_text(hand)
        command = [sys.executable, "-m", "so101_motion.cli", "emulate", "--realtime", *options]
        process = subprocess.Popen(
            [*command, "--hand", str(script)] if hand else command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            yield next(word for word in line.split() if word.startswith("/dev/")), process.pid
        finally:
            process.terminate()
            process.wait()
