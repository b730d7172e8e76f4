"""Read all joint positions in one transaction, 100 times a second, during a calibration.

The port's thread calls a ``Sampler``; other threads read its last result, one immutable value. A
silent servo or a missing port does not end the recording: the other joints go on, recorded travels
stay, and the recording continues when the cable is back in place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from so101_motion.calib.procedure.travel import TravelArc, TravelRecorder
from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.common.clock import Clock
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.registers import PRESENT_POSITION, TICKS_PER_TURN
from so101_motion.drivers.feetech.presence import Presence

_ROW = PRESENT_POSITION

TREMBLE = 23  # how far a joint may move meanwhile [tick], 2 deg; a hand trembles. Chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class Positions:
    """The positions that the sampler read last."""

    # where each joint is, 0 to 4095 [tick]; joints that were never read are missing
    ticks: Mapping[str, int] = field(default_factory=dict)
    # their travels since the recording began; empty before
    arcs: Mapping[str, TravelArc] = field(default_factory=dict)
    samples: int = 0  # how often they were read since the recording began
    silent: tuple[str, ...] = ()  # joints that do not answer
    t: float = 0.0  # when they were read [s]
    held_since: float = 0.0  # since when the arm is held still [s]
    grown_at: float = 0.0  # when a travel last grew [s]


class Sampler:
    """Reads the joints' positions whenever the port's thread calls it."""

    def __init__(self, clock: Clock, joints: Sequence[str]) -> None:
        # replaced whole, any thread may read it
        self.seen = Positions(t=clock.now(), held_since=clock.now())
        self._clock = clock
        self._joints = {SERVO_IDS[joint]: joint for joint in joints}
        self._presence = Presence(tuple(self._joints))
        self._sweeps: dict[str, TravelRecorder] | None = None
        self._samples = 0
        self._stillness = Stillness()

    def record(self) -> None:
        self._sweeps = {joint: TravelRecorder() for joint in self._joints.values()}
        self._samples = 0

    def __call__(self, bus: Bus) -> None:
        answers = bus.sync_read(
            tuple(self._joints), _ROW.address, _ROW.size, given_up=self._presence.silent
        )
        now = self._clock.now()
        self._presence.judge(answers, now)
        found = {
            self._joints[servo_id]: _ROW.decode(answer.data) % TICKS_PER_TURN
            for servo_id, answer in answers.items()
        }
        silent = tuple(joint for i, joint in self._joints.items() if i in self._presence.silent)
        ticks, arcs = {**self.seen.ticks, **found}, self._sweep(now, found)
        held = {
            joint: None if joint in silent else ticks.get(joint) for joint in self._joints.values()
        }
        self.seen = Positions(
            t=now,
            ticks=ticks,
            arcs=arcs,
            samples=self._samples,
            silent=silent,
            held_since=now - self._stillness.feed(now, held),
            grown_at=now if arcs != self.seen.arcs else self.seen.grown_at,
        )

    def _sweep(self, now: float, found: Mapping[str, int]) -> Mapping[str, TravelArc]:
        if self._sweeps is None:
            return {}
        self._samples += 1
        for joint, ticks in found.items():
            self._sweeps[joint].feed(now, ticks)
        return {joint: sweep.arc for joint, sweep in self._sweeps.items() if sweep.arc is not None}


class Stillness:
    """Measures how long joints have been held still, to take the homing pose hands-free.

    The user needs both hands for the arm. So a key or button only announces the pose, and it is
    taken once nothing has moved for a moment. ``feed`` it the joints' positions.
    """

    def __init__(self) -> None:
        self._since = 0.0
        self._anchor: dict[str, int] = {}

    def feed(self, t: float, ticks: Mapping[str, int | None]) -> float:
        """How long all joints have stayed within ``TREMBLE`` [s]; 0 if one does not answer."""
        known = {joint: place for joint, place in ticks.items() if place is not None}
        is_still = known.keys() == ticks.keys() == self._anchor.keys() and all(
            abs(place - self._anchor[joint]) <= TREMBLE for joint, place in known.items()
        )
        if not is_still:
            self._since, self._anchor = t, known
        return t - self._since
