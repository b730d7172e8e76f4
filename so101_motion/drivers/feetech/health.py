"""Health of the servos: their measured figures and their reply counters."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.protocol import Answer
from so101_motion.drivers.bus.registers import Fault
from so101_motion.drivers.bus.reply_counters import ReplyCounter

VITALS_START = reg.PRESENT_POSITION.address
VITALS_COUNT = reg.PRESENT_CURRENT.address + reg.PRESENT_CURRENT.size - VITALS_START
"""The measured block: position, velocity, load, voltage, temperature, status, moving, current."""


VITALS_PERIOD = 0.1
"""Time between two reads of that block [s]; makes the average cycle 1.07 times the shortest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointHealth:
    """The health of one servo at ``t``, when the figures were measured, on the rig's clock [s]."""

    joint: str
    servo_id: int
    t: float
    is_silent: bool  # whether it does not answer at present; the figures are then its last ones
    volts: float  # of the supply at the servo [V]
    amps: float  # of the motor [A]
    temperature_c: int
    load: float  # drive, -1 to 1; not a torque
    # the conditions it reports now: ``voltage``, ``encoder``, ``overheated``, ``overcurrent``,
    # ``overload``
    faults: tuple[str, ...]
    latched: tuple[str, ...]  # all conditions it has reported since the start
    # right answers since the start; ``lost`` ones, ``corrupt`` ones and ``retries`` likewise
    answers: int
    lost: int
    corrupt: int
    retries: int


# Both are called in every cycle, and their results change ten times a second at most.


@lru_cache(maxsize=256)
def _figures(block: bytes) -> tuple[float, float, int, float]:
    """Volts, amperes, degrees Celsius and drive in a measured block."""

    def si(register: reg.Register) -> float:
        return register.scale * register.cut(block, VITALS_START)

    return (
        si(reg.PRESENT_VOLTAGE),
        si(reg.PRESENT_CURRENT),
        reg.PRESENT_TEMPERATURE.cut(block, VITALS_START),
        si(reg.PRESENT_LOAD),
    )


@lru_cache(maxsize=256)
def _words(status: int) -> tuple[str, ...]:
    """The bits of a status byte."""
    return Fault(status).names


class HealthReadings:
    """Keeps the measured blocks of the servos, and says when to read them again.

    Args:
        now: The time [s].
    """

    def __init__(self, now: float) -> None:
        self._due = now
        self._blocks: dict[int, tuple[float, bytes]] = {}

    def count(self, now: float) -> int:
        """How many bytes to read now: only the position, or the whole block when it is due."""
        return VITALS_COUNT if now >= self._due else reg.PRESENT_POSITION.size

    def take(self, now: float, found: Mapping[int, Answer]) -> Mapping[int, float]:
        """Keep the blocks by servo, if whole ones were read; return their supply voltages [V]."""
        if now < self._due:
            return {}
        self._due = now + VITALS_PERIOD
        self._blocks = self._blocks | {i: (now, answer.data) for i, answer in found.items()}
        return {i: _figures(answer.data)[0] for i, answer in found.items()}

    def health(
        self,
        names: Mapping[int, str],
        counters: Mapping[int, ReplyCounter],
        silent: Collection[int],
    ) -> tuple[JointHealth, ...]:
        """The newest health of each servo in ``names``, base to jaw; from any thread."""
        found = []
        for servo_id, joint in names.items():
            if servo_id not in self._blocks:
                continue
            (t, block), counter = self._blocks[servo_id], counters[servo_id]
            volts, amps, temperature_c, load = _figures(block)
            health = JointHealth(
                joint=joint,
                servo_id=servo_id,
                t=t,
                is_silent=servo_id in silent,
                volts=volts,
                amps=amps,
                temperature_c=temperature_c,
                load=load,
                faults=_words(counter.faults),
                latched=_words(counter.latched),
                answers=counter.answers,
                lost=counter.lost,
                corrupt=counter.corrupt,
                retries=counter.retries,
            )
            found.append(health)
        return tuple(found)
