"""The planning process: make plans for the parent process, and end with it.

It answers one request after the other; for one that shall not wait it makes a copy of itself. While
it works, the planner calls a checkpoint every few milliseconds (``planning/checkpoint.py``), which
looks whether the plan is still wanted and the parent is still there, and now and then tells the
parent that there is progress. It ignores signals that a terminal sends to all processes.
"""

from __future__ import annotations

import gc
import os
import signal
import socket
import sys
import time
from typing import TYPE_CHECKING

from so101_motion.arm.plan_messages import Kind, MessageSocket, packed, unpacked
from so101_motion.common.errors import So101Error, WorkerError
from so101_motion.common.realtime import restore_normal_priority
from so101_motion.planning.checkpoint import Abandoned

if TYPE_CHECKING:
    from so101_motion.planning.cell.team_requests import TeamTask
    from so101_motion.planning.planner import Planner
    from so101_motion.planning.request import PlanRequest

_LOOK = 0.002  # how often a checkpoint looks at the socket [s]; chosen: a look takes 2 us
_SIGN = 0.25  # how often it sends a sign of life [s]; chosen


class Child:
    """The child's end.

    Args:
        line: The socket to the parent.
    """

    def __init__(self, line: MessageSocket) -> None:
        self._line = line
        self._next_look = self._next_sign = 0.0

    def checkpoint(self) -> None:
        """Look whether this plan is still wanted, and tell the parent that there is progress."""
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = now + _LOOK
        # One request at a time: only COPY or GIVE_UP can come now, or the parent's end.
        if self._line.has_more() and (self._line.receive()[0] is not Kind.COPY or self._copy()):
            raise Abandoned
        if now >= self._next_sign:
            self._next_sign = now + _SIGN
            self._line.send(Kind.ALIVE)

    def run(self) -> None:
        """Answer requests until the parent ends, which raises ``EOFError`` or ``OSError``."""
        try:
            planner = self._loaded()
        except Exception as error:  # the parent must be told why
            problem = WorkerError(
                f"the planner cannot be loaded: {type(error).__name__}: {error}; install this"
                " package again"
            )
            self._send(Kind.READY, problem)
            return
        self._send(Kind.READY, None)
        while True:
            kind, parts = self._line.receive()
            if kind is Kind.COPY:
                self._copy()
            elif kind is Kind.REQUEST:
                self._next_sign = 0.0
                line = self._line
                answer = self._answer(planner, unpacked(parts))
                if self._line is line:  # else this is a copy, which was not asked
                    self._send(Kind.ANSWER, answer)

    def _copy(self) -> bool:
        """Make a copy of this process, which answers on a socket of its own; whether this is it.

        Memory that neither changes is shared: a copy takes a tenth of what a new process takes.
        """
        line = self._line.receive_line()
        if os.fork():
            line.close()
            return False
        self._line.close()
        self._line = MessageSocket(line)
        self._send(Kind.READY, os.getpid())
        return True

    def _loaded(self) -> Planner:
        self.checkpoint()
        from so101_motion.planning.kinematics.model import RobotModel

        self.checkpoint()
        from so101_motion.planning.planner import Planner

        self.checkpoint()
        planner = Planner(RobotModel.load(), self.checkpoint)
        planner.warm_up()
        gc.collect()
        gc.freeze()  # what looks at all that is here takes 13 ms, and copies of this process more
        return planner

    def _answer(self, planner: Planner, request: PlanRequest | TeamTask[object]) -> object:
        try:
            return _planned(planner, request)
        except Abandoned:
            return None
        except So101Error as error:
            return error
        except (EOFError, OSError):  # the parent has ended
            raise
        except Exception as error:  # a defect of ours: the caller must get it, not hang
            return WorkerError(f"planning failed unexpectedly: {type(error).__name__}: {error}")

    def _send(self, kind: Kind, value: object) -> None:
        self._line.send(kind, packed(value))


def _planned(planner: Planner, request: PlanRequest | TeamTask[object]) -> object:
    from so101_motion.planning.cell.team_requests import HandoverRequest, TeamRequest
    from so101_motion.planning.request import PlanRequest

    if isinstance(request, PlanRequest):
        return planner.plan(request)
    if isinstance(request, TeamRequest):
        from so101_motion.planning.cell.together import plan_together

        return plan_together(planner, request.team)
    from so101_motion.planning.picking.pick_plan import PickRequest, plan_pick

    if isinstance(request, PickRequest):
        return plan_pick(planner, request)
    from so101_motion.planning.cell.handover import plan_handover

    assert isinstance(request, HandoverRequest)
    return plan_handover(planner, request)


def main() -> None:
    """Serve the parent over the socket whose file descriptor is the first argument."""
    restore_normal_priority()  # control loops go first
    os.dup2(2, 1)  # what a library prints is for the log
    if hasattr(signal, "SIGCHLD"):
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for a copy that has ended
    line = MessageSocket(socket.socket(fileno=int(sys.argv[1])))
    try:
        Child(line).run()
    except (EOFError, OSError):
        os._exit(0)  # the parent is gone; nothing here is worth an orderly end


if __name__ == "__main__":
    main()
