"""The tab with servo and bus health; it raises the alarms."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import msgspec
import viser

from so101_motion.common.errors import in_series
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, JointState
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.limit_recovery import FARTHEST_OUT
from so101_motion.drivers.feetech.health import JointHealth
from so101_motion.drivers.feetech.servo_judgement import HOT_C, LOW_V, TOO_LOW_V, WARM_C, judge
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.setup.setup_steps import CALIBRATION_ONLY

from ..page import markup, texts
from ..page.page_context import PageContext, Part
from ..page.screen_state import Sentence, Tone
from ..page.texts import capital

_EVERY = 0.5  # how often the figures are read anew [s]; nobody reads faster
_COUNTS = ("answers", "retries", "lost", "corrupt")  # of messages on the bus
_HARD_WORK = 0.8  # share of its drive from which a servo is near its end; chosen


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
    """The health of an arm's servos and its bus."""

    servos: tuple[JointHealth, ...] = ()  # base to jaw; empty when nothing is measured
    silence: str | None  # why nothing is measured; None when it is
    period: float | None = None  # of the control loop [s]; None when the source does not tell
    late_ticks: int  # setpoints that came more than half a period late since the start
    # how often the port went away; None when there is no port or it is unknown
    port_losses: int | None = None
    uncalibrated: tuple[str, ...] = ()
    has_file: bool = True  # whether a calibration file is in use, as far as that is known
    # the file with the second before the last failure; None when there is none
    last_failure: str | None = None
    # why a machine does not drive its arm; empty when it does, or cannot be asked
    not_ready: str = ""
    notes: tuple[str, ...] = ()  # about the servos and their calibration


def read_health(rig: RigLike) -> Health:
    """The newest figures of ``rig``; never waits."""
    late_ticks = rig.arm.state.late_ticks
    if isinstance(rig, HardwareRig):
        servos, failure = rig.servos.health, rig.last_failure
        return Health(
            servos=servos,
            silence=None if servos else "No servo has answered yet.",
            late_ticks=late_ticks,
            period=rig.executor.dt,
            port_losses=rig.servos.port_losses,
            uncalibrated=rig.uncalibrated,
            has_file=any(each.source == "file" for each in rig.servos.setups.values()),
            last_failure=None if failure is None else str(failure),
            notes=tuple(rig.servos.notes),
        )
    if isinstance(rig, Rig):
        silence = "Simulated: there are no servos to measure."
        return Health(silence=silence, late_ticks=late_ticks, period=rig.executor.dt)
    status = getattr(rig, "status", {})
    reported, unknown, notes = (status.get(key) for key in ("health", "uncalibrated", "notes"))
    servos, unread = _from_status(reported if isinstance(reported, Mapping) else {})
    return Health(
        servos=servos,
        silence=None if servos else "This arm does not report the health of its servos.",
        late_ticks=late_ticks,
        uncalibrated=tuple(map(str, unknown)) if isinstance(unknown, list) else (),
        not_ready=str(status.get("not_ready") or ""),
        notes=(*unread, *(map(str, notes) if isinstance(notes, list) else ())),
    )


def _tone(bad: bool, odd: bool) -> Tone:
    return Tone.BAD if bad else Tone.WARM if odd else Tone.PLAIN


def _from_status(reported: Mapping[str, Any]) -> tuple[tuple[JointHealth, ...], list[str]]:
    """The servos in a machine's status, and a note on each whose entry cannot be read."""
    found, unread = list[JointHealth](), list[str]()
    for joint, told in reported.items():
        try:
            given = {"servo_id": 0, **told, "joint": str(joint), "t": 0.0, "latched": ()}
            given |= {"load": 0.01 * told["load_percent"], "is_silent": told["silent"]}
            found.append(msgspec.convert(given, JointHealth, strict=False))
        except (KeyError, TypeError, msgspec.ValidationError) as error:
            unread.append(f"the machine's figures of {joint} cannot be read: {error}")
    return tuple(sorted(found, key=lambda servo: servo.servo_id)), unread


def figures(found: Health) -> str:
    if found.silence is not None:
        servos = escape(found.silence)
    else:
        head = "".join(f"<span>{name}</span>" for name in ("", "V", "A", "°C", "load %", "errors"))
        servos = f"<div><p>{head}</p>{''.join(map(_servo, found.servos))}</div>"
    lines = []
    if found.period is not None:
        lines.append(("Control cycle", f"{1000.0 * found.period:.0f} ms"))
    lines.append(("Late cycles", f"{found.late_ticks}"))
    if found.servos:
        _, retries, lost, corrupt = (
            sum(getattr(servo, name) for servo in found.servos) for name in _COUNTS
        )
        counts = f"{retries} retries, {lost} lost, {corrupt} garbled"
        lines.append(("Bus, since the start", f"{counts}; errors are the last two"))
    if found.port_losses is not None:
        times = {0: "never", 1: "once"}.get(found.port_losses, f"{found.port_losses} times")
        lines.append(("Disconnected", times))
    if not found.has_file:
        lines.append(("Calibration file", f"none: {_NO_FILE}"))
    if found.last_failure is not None:
        lines.append(("Before the last failure", found.last_failure))
    lines += [("Note", capital(note)) for note in found.notes]
    return f'<div class="so101-health">{servos}</div>{markup.facts(lines)}'


def _servo(servo: JointHealth) -> str:
    count = servo.lost + servo.corrupt
    errors = _figure(f"{count}", Tone.WARM if count else Tone.PLAIN)
    if servo.is_silent:
        figures = '<b class="so101-bad silent">does not answer</b>'
    else:
        tone = tones(servo)
        figures = (
            _figure(f"{servo.volts:.1f}", tone["volts"])
            + _figure(f"{abs(servo.amps):.2f}", Tone.PLAIN)
            + _figure(f"{servo.temperature_c:.0f}", tone["celsius"])
            + _figure(f"{100.0 * abs(servo.load):.0f}", tone["load"])
        )
    reports = escape(", ".join(servo.faults))
    said = f'<b class="so101-bad reports">reports: {reports}</b>' if reports else ""
    return f"<i>{escape(servo.joint)}</i>{figures}{errors}{said}"


def _figure(text: str, tone: Tone) -> str:
    kind = "span" if tone is Tone.PLAIN else "b"
    return f'<{kind} class="so101-{tone.value}">{text}</{kind}>'


SILENCE = "silence"  # the cause of an alarm about servos that do not answer

LATE_WITHIN, LATE_MANY = 10.0, 10
"""So many late setpoints within this time [s] are worth an alarm. Chosen: a busy computer has one
or two; ten are seen as a jerk."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """One thing that is wrong, with what to do; there is one alarm for each cause."""

    cause: str
    joints: tuple[str, ...]
    sentence: Sentence


def servo_alarms(servos: Collection[JointHealth]) -> tuple[Alarm, ...]:
    """What is wrong with servos, one alarm a cause, of the joint that suffers most."""
    found: dict[str, list[tuple[JointHealth, str, Tone]]] = {}
    for servo in servos:
        if servo.is_silent:
            text = "its servo does not answer; check its plugs and its power"
            found.setdefault(SILENCE, []).append((servo, text, Tone.BAD))
            continue
        for trouble in judge(
            volts=servo.volts,
            celsius=servo.temperature_c,
            load=servo.load,
            amps=servo.amps,
            faults=servo.faults,
        ):
            tone = Tone.BAD if trouble.level == "stop" else Tone.WARM
            text = str(trouble)
            found.setdefault(trouble.kind, []).append((servo, text, tone))
    return tuple(
        _alarm(cause, cases, is_all=1 < len(servos) == len(cases)) for cause, cases in found.items()
    )


_NOTABLE = to_rad(1.0)  # so far beyond the limits of plans is worth an alarm [rad]; chosen


def state_alarms(
    state: JointState, health: Health, limits: tuple[Array, Array] | None = None
) -> tuple[Alarm, ...]:
    """What is wrong with an arm besides its servos; ``limits`` of its plans are (5,) each [rad]."""
    if state.mode is Mode.CALIBRATING:
        return ()  # nothing can be moved, and angles may be guesses
    found = []
    if health.not_ready:
        found.append(_warm("not ready", (), f"{capital(health.not_ready)}."))
    unknown = health.uncalibrated
    if unknown:
        text = (
            f"No calibration: {_listed(unknown)} may not be where the picture shows it. Choose"
            f" {CALIBRATION_ONLY.title} on the Setup tab before you move the arm."
        )
        found.append(_warm("calibration", unknown, text))
    elif not health.has_file and state.mode is Mode.LIMP:  # once; then the Health tab has it
        text = (
            f"No calibration file fits this arm: {_NO_FILE}. You can use it, slowly at first;"
            f" {CALIBRATION_ONLY.title} on the Setup tab makes a file."
        )
        found.append(_warm("calibration", (), text))
    inside = dict(state.reading.out_of_range)
    for joint, q, lower, upper in zip(ARM_JOINTS, state.q, *(limits or ((), ())), strict=False):
        if not lower - _NOTABLE <= q <= upper + _NOTABLE:
            inside.setdefault(joint, min(max(q, lower), upper))
    if inside:
        found.append(_warm("range", tuple(inside), _about_range(state, inside)))
    return tuple(found)


_NO_FILE = "zero is the middle of each joint's travel, and points are some 40 mm off"


def _about_range(state: JointState, inside: Mapping[str, float]) -> str:
    here = state.reading.angles
    off = {joint: abs(here[joint] - at) for joint, at in inside.items()}
    where = ", ".join(
        f"{joint} by {to_deg(off[joint]):.0f}°, limit {to_deg(limit):.0f}°"
        for joint, limit in inside.items()
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
    """Counts late setpoints of the last ``LATE_WITHIN`` seconds, for a computer named in words."""

    def __init__(self, computer: str) -> None:
        self._computer = computer
        self._seen: list[tuple[float, int]] = []

    def alarm(self, t: float, late_ticks: int) -> tuple[Alarm, ...]:
        """The alarm for many late setpoints; ``late_ticks`` counts all until now, ``t`` [s]."""
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


def _alarm(cause: str, cases: list[tuple[JointHealth, str, Tone]], *, is_all: bool) -> Alarm:
    worst = next((case for case in cases if case[2] is Tone.BAD), cases[0])
    servo, text, tone = worst
    others = [each for each, _, _ in cases if each is not servo]
    is_heat = cause == "temperature"
    named = (f"{o.joint} at {o.temperature_c:.0f} °C" if is_heat else o.joint for o in others)
    whose = f"{servo.joint} (also {_listed(tuple(named))})" if others else servo.joint
    return Alarm(
        cause=cause,
        joints=(servo.joint, *(each.joint for each in others)),
        sentence=Sentence(f"{'Every joint' if is_all else whose}: {text}.", tone=tone),
    )


def _warm(cause: str, joints: tuple[str, ...], text: str) -> Alarm:
    return Alarm(cause=cause, joints=joints, sentence=Sentence(text, Tone.WARM))


def _listed(joints: tuple[str, ...]) -> str:
    if len(joints) <= 4:
        return in_series(joints)
    return f"{joints[0]} and {len(joints) - 1} other joints"


class HealthPart(Part):
    """Shows the figures of the servos and the bus of an arm.

    Args:
        mark: Called with the joints in alarm, and how bad it is.
        name: What messages call the arm; empty if it is alone.
    """

    def __init__(
        self,
        context: PageContext,
        rig: RigLike,
        panel: viser.PanelHandle,
        *,
        mark: Callable[[Mapping[str, Tone]], None],
        name: str = "",
    ) -> None:
        self._rig, self._name, self._mark = rig, name, mark
        self._bar, self._log = context.bar, context.events
        self._late = LateCycles(
            "this computer" if isinstance(rig, Rig) else "the machine's computer"
        )
        self._alarms: tuple[Alarm, ...] = ()
        self._told: tuple[Alarm, ...] = ()
        self._due, self._warns = 0.0, False
        self._health: Health | None = None
        self._tab = panel.add_tab(f"Health {name}".strip(), viser.Icon.HEARTBEAT)
        with self._tab:
            self._figures = context.gui.add_html("")

    def refresh(self) -> bool:
        now = time.monotonic()
        if now < self._due:
            return False
        self._due = now + _EVERY
        health = read_health(self._rig)
        news = health != self._health
        self._health = health
        self._look_for_alarms(health)
        return news

    def _look_for_alarms(self, health: Health) -> None:
        rig, state = self._rig, self._rig.arm.state
        found: tuple[Alarm, ...] = ()
        if rig.connection.problem is None:
            found = (
                *servo_alarms(health.servos),
                *state_alarms(state, health, rig.arm.range),
                *self._late.alarm(time.monotonic(), health.late_ticks),
            )
        warns = bool(found) or rig.connection.problem is not None
        if warns is not self._warns:
            self._warns = warns
            self._tab.icon = viser.Icon.ALERT_TRIANGLE if warns else viser.Icon.HEARTBEAT
        self._tell(not_said_yet(found, state))
        if found != self._alarms:
            self._alarms = found
            marks: dict[str, Tone] = {}
            for alarm in found:
                for joint in alarm.joints:
                    if marks.get(joint) is not Tone.BAD:
                        marks[joint] = alarm.sentence.tone
            self._mark(marks)

    def _tell(self, alarms: tuple[Alarm, ...]) -> None:
        before, self._told = {alarm.cause for alarm in self._told}, alarms
        said = [texts.named(self._name, alarm.sentence) for alarm in alarms]
        for alarm, sentence in zip(alarms, said, strict=True):
            if alarm.cause not in before:
                self._log.add(sentence.text, sentence.tone)
        self._bar.alert(f"alarms {self._name}", said)

    def show(self) -> None:
        if self._health is not None:
            self._figures.content = figures(self._health)
