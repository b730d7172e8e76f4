"""Save the progress of a setup to a file, so that a later start continues there.

The terminal and the page use the same file, so a setup begun on one can be ended on the other. A
running calibration has a journal of its own, see ``journal.py``; this file has only the step.
Losing it does no harm: the setup then begins with its first step.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

from so101_motion.calib.motors.setup_view import SETUP_ORDER
from so101_motion.files import atomic

NAME = "setup.json"
"""Name of the file."""


class SetupProgress:
    """Which steps and motors are done.

    Args:
        port: The port; progress on another port is forgotten. None to take it from the file.

    Attributes:
        port: The port or machine; empty if it is not known.
        workflow: Name of the workflow under way; empty for none.
        arm: The user's name for the arm; empty if there is none.
    """

    def __init__(self, path: Path, port: str | None) -> None:
        self._path = path
        self.port, self.workflow, self.step, self.arm = port or "", "", "", ""
        self.done: list[str] = []
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            done = [joint for joint in SETUP_ORDER if joint in content["done"]]
            if port is None or content["port"] == port:
                self.port, self.done = str(content["port"]), done
                self.workflow = str(content.get("workflow", ""))
                self.step = str(content.get("step", ""))
                self.arm = str(content.get("arm", ""))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            pass

    def add(self, joint: str) -> None:
        if joint not in self.done:
            self.done.append(joint)
            self._keep()

    def reach(self, workflow: str, step: str) -> None:
        if (workflow, step) != (self.workflow, self.step):
            self.workflow, self.step = workflow, step
            self._keep()

    def call(self, arm: str) -> None:
        self.arm = arm
        self._keep()

    def work_on(self, port: str) -> None:
        if port != self.port:
            self.port, self.done = port, []
            self._keep()

    def forget_motors(self, *joints: str) -> None:
        """Forget that the motors of these joints have their ids, or of all; the step stays."""
        self.done = [joint for joint in self.done if joints and joint not in joints]
        self._keep()

    def clear(self) -> None:
        self.done, self.workflow, self.step, self.arm = [], "", "", ""
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)

    def _keep(self) -> None:
        content = {
            "port": self.port,
            "workflow": self.workflow,
            "step": self.step,
            "arm": self.arm,
            "done": self.done,
        }
        with contextlib.suppress(OSError):  # then the next start begins with the first step
            self._path.parent.mkdir(parents=True, exist_ok=True)
            atomic.write(self._path, json.dumps(content).encode() + b"\n")
