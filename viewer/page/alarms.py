"""Find what is wrong with an arm that still answers: hot servos, a weak supply, no calibration."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.common.units import to_deg
from so101_motion.control.limit_recovery import FARTHEST_OUT
from so101_motion.drivers.feetech.health import JointHealth
from so101_motion.drivers.feetech.servo_judgement import judge

from .screen_state import Sentence, Tone
from .texts import capital

SILENCE = "silence"
"""The cause of an alarm about servos that do not answer."""

LATE_WITHIN, LATE_MANY = 10.0, 10
"""So many late setpoints within this time [s] are worth an alarm. Chosen: a busy computer has one
or two; ten are seen as a jerk."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """One thing that is wrong.

    Attributes:
        cause: What it is about; there is one alarm for each cause.
        joints: The joints it is about.
        sentence: What is wrong and what to do.
    """

    cause: str
    joints: tuple[str, ...]
    sentence: Sentence


def servo_alarms(servos: Iterable[JointHealth]) -> tuple[Alarm, ...]:
    """What is wrong with servos, one alarm a cause, of the joint that suffers most."""
    found: dict[str, list[tuple[str, str, Tone]]] = {}
    for servo in servos:
        if servo.is_silent:
            text = "its servo does not answer; check its plugs and its power"
            found.setdefault(SILENCE, []).append((servo.joint, text, Tone.BAD))
            continue
        for trouble in judge(
            volts=servo.volts,
            celsius=servo.temperature_c,
            load=servo.load,
            amps=servo.amps,
            faults=servo.faults,
        ):
            tone = Tone.BAD if trouble.level == "stop" else Tone.WARM
            text = str(trouble).replace(" degC", " °C")
            found.setdefault(trouble.kind, []).append((servo.joint, text, tone))
    return tuple(_alarm(cause, cases) for cause, cases in found.items())


def state_alarms(
    state: JointState, uncalibrated: Iterable[str], not_ready: str = ""
) -> tuple[Alarm, ...]:
    """What is wrong with the joints' places and calibration.

    Args:
        state: The arm.
        uncalibrated: The joints that were never calibrated.
        not_ready: Why a machine does not drive the arm; empty when it does.
    """
    found = []
    if not_ready:
        found.append(_warm("not ready", (), f"{capital(not_ready)}."))
    unknown = tuple(uncalibrated)
    if unknown:
        text = (
            f"No calibration: {_listed(unknown)} may not be where the picture shows it. Calibrate"
            " on the Setup tab before you move the arm."
        )
        found.append(_warm("calibration", unknown, text))
    outside = tuple(state.reading.out_of_range)
    if outside:
        found.append(_warm("range", outside, _about_range(state)))
    return tuple(found)


def _about_range(state: JointState) -> str:
    """How far joints are outside their limits, and what brings them back."""
    reading, here = state.reading, state.reading.angles
    off = {joint: abs(here[joint] - at) for joint, at in reading.out_of_range.items()}
    where = ", ".join(
        f"{joint} by {to_deg(off[joint]):.0f}°, limit {to_deg(limit):.0f}°"
        for joint, limit in reading.out_of_range.items()
    )
    far = tuple(joint for joint in off if off[joint] > FARTHEST_OUT)
    then = (
        f"Move {_listed(far)} back by hand, or calibrate the arm again."
        if far
        else "The next motion brings it back slowly."
    )
    return f"Outside its range: {where}. {then}"


def not_said_yet(alarms: Iterable[Alarm], state: JointState) -> tuple[Alarm, ...]:
    """The alarms that the bar does not say already: a fault names the servos that fell silent."""
    is_fault = state.mode is Mode.FAULT
    return tuple(alarm for alarm in alarms if not (is_fault and alarm.cause == SILENCE))


class LateCycles:
    """Counts late setpoints of the last ``LATE_WITHIN`` seconds.

    Args:
        computer: What runs the control loop, in words.
    """

    def __init__(self, computer: str) -> None:
        self._computer = computer
        self._seen: list[tuple[float, int]] = []

    def alarm(self, t: float, late_ticks: int) -> tuple[Alarm, ...]:
        """The alarm for many late setpoints.

        Args:
            t: The time [s].
            late_ticks: How many there have been since the start.
        """
        self._seen.append((t, late_ticks))
        while self._seen[0][0] < t - LATE_WITHIN:
            self._seen.pop(0)
        late = late_ticks - self._seen[0][1]
        if late < LATE_MANY:
            return ()
        text = (
            f"{late} setpoints came late in the last {LATE_WITHIN:.0f} s, so motions may jerk."
            f" Close other programs on {self._computer}."
        )
        return (_warm("late", (), text),)


def _alarm(cause: str, cases: list[tuple[str, str, Tone]]) -> Alarm:
    worst = next((case for case in cases if case[2] is Tone.BAD), cases[0])
    joint, text, tone = worst
    others = tuple(each for each, _, _ in cases if each != joint)
    more = f" Also: {_listed(others)}." if others else ""
    return Alarm(
        cause=cause,
        joints=(joint, *others),
        sentence=Sentence(text=f"{joint}: {text}.{more}", tone=tone),
    )


def _warm(cause: str, joints: tuple[str, ...], text: str) -> Alarm:
    return Alarm(cause=cause, joints=joints, sentence=Sentence(text=text, tone=Tone.WARM))


def _listed(joints: tuple[str, ...]) -> str:
    if len(joints) < 3:
        return " and ".join(joints)
    return f"{joints[0]} and {len(joints) - 1} other joints"
