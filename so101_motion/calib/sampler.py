"""Watching the joints of a calibration: all positions in one transaction, 100 times a second.

The port's thread calls a ``Sampler``; everybody else reads what it saw last, one immutable value.
A servo that falls silent, or a port that goes away, ends nothing: the others go on, what was
recorded stays, and when the cable is back in place the recording continues.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from so101_motion.calib.record import JOINTS
from so101_motion.calib.recording import Arc, Sweep
from so101_motion.clock import Clock
from so101_motion.drivers.bus import Bus
from so101_motion.drivers.presence import Presence
from so101_motion.drivers.registers import PRESENT_POSITION, TICKS_PER_TURN

_ROW = PRESENT_POSITION


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What the sampler saw last.

    Attributes:
        ticks: Where each joint is, 0 to 4095 [tick]; joints that were never read are missing.
        arcs: Their travels since the recording began; empty before.
        samples: How often they have been read since then.
        silent: Joints whose servos do not answer at present.
        t: When that was [s].
    """

    ticks: Mapping[str, int] = field(default_factory=dict)
    arcs: Mapping[str, Arc] = field(default_factory=dict)
    samples: int = 0
    silent: tuple[str, ...] = ()
    t: float = 0.0


class Sampler:
    """Reads the joints' positions whenever it is called. Called by the port's thread only.

    Args:
        clock: What time it is.
        joints: Which joints.

    Attributes:
        seen: What it saw last; replaced whole, any thread may read it.
    """

    def __init__(self, clock: Clock, joints: Sequence[str]) -> None:
        self.seen = Seen(t=clock.now())
        self._clock = clock
        self._joints = {JOINTS.index(joint) + 1: joint for joint in joints}
        self._presence = Presence(tuple(self._joints))
        self._sweeps: dict[str, Sweep] | None = None
        self._samples = 0

    def record(self) -> None:
        """From now on, keep where the joints have been; on the port's thread as well."""
        self._sweeps = {joint: Sweep() for joint in self._joints.values()}
        self._samples = 0

    def __call__(self, bus: Bus) -> None:
        """Read all positions once.

        Raises:
            PortUnavailable: There is no port at present; call again when it is back.
        """
        answers = bus.sync_read(
            tuple(self._joints), _ROW.address, _ROW.size, given_up=self._presence.silent
        )
        now = self._clock.now()
        self._presence.judge(answers, now)
        found = {
            self._joints[servo_id]: _ROW.decode(answer.data) % TICKS_PER_TURN
            for servo_id, answer in answers.items()
        }
        self.seen = Seen(
            t=now,
            ticks={**self.seen.ticks, **found},
            arcs=self._sweep(now, found),
            samples=self._samples,
            silent=tuple(joint for i, joint in self._joints.items() if i in self._presence.silent),
        )

    def _sweep(self, now: float, found: Mapping[str, int]) -> Mapping[str, Arc]:
        if self._sweeps is None:
            return {}
        self._samples += 1
        for joint, ticks in found.items():
            self._sweeps[joint].feed(now, ticks)
        return {joint: sweep.arc for joint, sweep in self._sweeps.items() if sweep.arc is not None}
