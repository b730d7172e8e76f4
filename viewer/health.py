"""How the servos and their bus are, as figures; whatever kind of arm tells them.

A rig on a serial port has them at hand; a running machine sends the same figures with its status,
if its module has them. A simulated arm measures nothing, and says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from so101_motion.alarms import HOT_C, WARM_C, WEAK_V
from so101_motion.assembly import Rig
from so101_motion.rig import HardwareRig
from so101_motion.rig_like import RigLike

from .screen import Tone

_LOW_V = 6.0
"""Below this even a 7.4 V servo has little strength; as in the diagnosis [V]."""

_HARD_WORK = 0.8
"""Share of its drive from which a servo is near its end; chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoFigures:
    """One servo.

    Attributes:
        joint: Which joint.
        volts: Supply voltage [V].
        amps: Motor current [A].
        celsius: Temperature.
        load: Drive, -1 to 1; not a torque.
        faults: What it reports now.
        answers: Right answers since the start.
        lost: Questions without an answer.
        corrupt: Questions with a garbled answer.
        retries: Questions that were repeated.
        is_silent: Whether it does not answer; the figures are then its last ones.
    """

    joint: str
    volts: float
    amps: float
    celsius: float
    load: float
    faults: tuple[str, ...]
    answers: int
    lost: int
    corrupt: int
    retries: int
    is_silent: bool

    @property
    def errors(self) -> int:
        """Answers that were missed or garbled."""
        return self.lost + self.corrupt

    def tones(self) -> dict[str, Tone]:
        """Which figures are out of the ordinary: ``volts``, ``celsius``, ``load``."""
        hot = {"overheated"} & set(self.faults) or self.celsius >= HOT_C
        weak = {"voltage"} & set(self.faults) or self.volts < WEAK_V
        pressed = {"overload", "overcurrent"} & set(self.faults)
        return {
            "volts": _tone(bool(weak), self.volts < _LOW_V),
            "celsius": _tone(bool(hot), self.celsius >= WARM_C),
            "load": _tone(bool(pressed), abs(self.load) >= _HARD_WORK),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """All that can be told.

    Attributes:
        servos: Base to jaw; empty when nothing is measured.
        silence: Why nothing is measured; None when it is.
        period: Of the control loop [s]; None when the source does not tell.
        late_ticks: Setpoints that came more than half a period late since the start.
        port_losses: How often the port went away; None when there is none or it is not told.
    """

    servos: tuple[ServoFigures, ...]
    silence: str | None
    period: float | None
    late_ticks: int
    port_losses: int | None


def look_at(rig: RigLike) -> Health:
    """How ``rig`` is; asks nobody and waits for nobody."""
    servos: tuple[ServoFigures, ...]
    silence, losses = None, None
    period = rig.executor.dt if isinstance(rig, Rig) else None
    if isinstance(rig, HardwareRig):
        servos = tuple(map(_of_servo, rig.servos.health))
        losses = rig.servos.port_losses
        if not servos:
            silence = "No servo has answered yet."
    elif isinstance(rig, Rig):
        servos, silence = (), "Simulated: there are no servos to measure."
    else:
        told = getattr(rig, "status", {}).get("health")
        servos = tuple(_told(told)) if isinstance(told, Mapping) else ()
        if not servos:
            silence = "The machine's arm does not tell how its servos are."
    return Health(
        servos=servos,
        silence=silence,
        period=period,
        late_ticks=rig.arm.state.late_ticks,
        port_losses=losses,
    )


def _tone(bad: bool, odd: bool) -> Tone:
    return Tone.BAD if bad else Tone.WARM if odd else Tone.PLAIN


def _of_servo(joint: Any) -> ServoFigures:
    return ServoFigures(
        joint=joint.joint,
        volts=joint.volts,
        amps=joint.amps,
        celsius=joint.temperature_c,
        load=joint.load,
        faults=joint.faults,
        answers=joint.answers,
        lost=joint.lost,
        corrupt=joint.corrupt,
        retries=joint.retries,
        is_silent=joint.is_silent,
    )


def _told(told: Mapping[str, Any]) -> list[ServoFigures]:
    """The servos that a machine told of; what is not as ours tells it is left out."""
    found = []
    for joint, figures in told.items():
        try:
            servo = ServoFigures(
                joint=str(joint),
                volts=float(figures["volts"]),
                amps=float(figures["amps"]),
                celsius=float(figures["temperature_c"]),
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
        found.append((int(figures.get("servo_id", 0)), servo))
    return [servo for _, servo in sorted(found, key=lambda pair: pair[0])]
