"""Collect the health figures of the servos and the bus from any kind of rig.

A rig on a serial port measures them; a machine sends them with its status.
A simulated arm has none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from so101_motion.drivers.feetech.health import JointHealth
from so101_motion.drivers.feetech.servo_judgement import HOT_C, LOW_V, TOO_LOW_V, WARM_C
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig

from .screen_state import Tone

_HARD_WORK = 0.8
"""Share of its drive from which a servo is near its end; chosen."""


def tones(servo: JointHealth) -> dict[str, Tone]:
    """Which figures of a servo are unusual: ``volts``, ``celsius``, ``load``."""
    faults = set(servo.faults)
    hot = "overheated" in faults or servo.temperature_c >= HOT_C
    weak = "voltage" in faults or servo.volts < TOO_LOW_V
    pressed = bool({"overload", "overcurrent"} & faults)
    return {
        "volts": _tone(weak, servo.volts < LOW_V),
        "celsius": _tone(hot, servo.temperature_c >= WARM_C),
        "load": _tone(pressed, abs(servo.load) >= _HARD_WORK),
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """The health of an arm's servos and its bus.

    Attributes:
        servos: Base to jaw; empty when nothing is measured.
        silence: Why nothing is measured; None when it is.
        period: Of the control loop [s]; None when the source does not tell.
        late_ticks: Setpoints that came more than half a period late since the start.
        port_losses: How often the port went away; None when there is no port or it is unknown.
        uncalibrated: The joints that were never calibrated.
        last_failure: The file with the second before the last failure; None when there is none.
        not_ready: Why a machine does not drive its arm; empty when it does, or cannot be asked.
    """

    servos: tuple[JointHealth, ...]
    silence: str | None
    period: float | None
    late_ticks: int
    port_losses: int | None
    uncalibrated: tuple[str, ...] = ()
    last_failure: str | None = None
    not_ready: str = ""


def read_health(rig: RigLike) -> Health:
    """The newest figures of ``rig``; never waits."""
    servos: tuple[JointHealth, ...]
    silence, losses, failure = None, None, None
    uncalibrated: tuple[str, ...] = ()
    not_ready = ""
    period = rig.executor.dt if isinstance(rig, Rig) else None
    if isinstance(rig, HardwareRig):
        servos = rig.servos.health
        losses = rig.servos.port_losses
        uncalibrated = rig.uncalibrated
        failure = rig.last_failure
        if not servos:
            silence = "No servo has answered yet."
    elif isinstance(rig, Rig):
        servos, silence = (), "Simulated: there are no servos to measure."
    else:
        status = getattr(rig, "status", {})
        reported, unknown = status.get("health"), status.get("uncalibrated")
        servos = tuple(_from_status(reported)) if isinstance(reported, Mapping) else ()
        not_ready = str(status.get("not_ready") or "")
        uncalibrated = tuple(map(str, unknown)) if isinstance(unknown, list) else ()
        if not servos:
            silence = "The machine's arm reports no servo health."
    return Health(
        servos=servos,
        silence=silence,
        period=period,
        late_ticks=rig.arm.state.late_ticks,
        port_losses=losses,
        uncalibrated=uncalibrated,
        last_failure=None if failure is None else str(failure),
        not_ready=not_ready,
    )


def _tone(bad: bool, odd: bool) -> Tone:
    return Tone.BAD if bad else Tone.WARM if odd else Tone.PLAIN


def _from_status(reported: Mapping[str, Any]) -> list[JointHealth]:
    """The servos in a machine's status; leaves out entries that cannot be read."""
    found = []
    for joint, figures in reported.items():
        try:
            servo = JointHealth(
                joint=str(joint),
                servo_id=int(figures.get("servo_id", 0)),
                t=0.0,
                latched=(),
                volts=float(figures["volts"]),
                amps=float(figures["amps"]),
                temperature_c=int(figures["temperature_c"]),
                load=0.01 * float(figures["load_percent"]),
                faults=tuple(map(str, figures["faults"])),
                answers=int(figures["answers"]),
                lost=int(figures["lost"]),
                corrupt=int(figures["corrupt"]),
                retries=int(figures["retries"]),
                is_silent=figures["silent"] is True,
            )
        except (KeyError, TypeError, ValueError):
            continue
        found.append(servo)
    return sorted(found, key=lambda servo: servo.servo_id)
