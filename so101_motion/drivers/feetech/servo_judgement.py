"""Judge a servo by its supply, temperature, load and faults, with one table of thresholds.

The executor ends motions for findings of level ``stop``, the motor setup refuses a wrong supply,
and ``diagnose``, ``so101 doctor`` and the page report the same findings in the same words. The bus
never turns a status bit into an error, because the reading with it is good; it is judged here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from so101_motion.drivers.bus.registers import LET_GO
from so101_motion.drivers.feetech.health import JointHealth

HOT_C = 65
"""At this temperature a joint is not moved any more [degC]."""

OFF_C = 70
"""At this temperature a servo switches itself off [degC] (FT)."""

WARM_C = 55
"""Above this temperature motions get slower [degC]. Chosen."""

TOO_LOW_V, TOO_LOW_7V4 = 5.5, 4.5
"""Lowest supply at which a joint is moved: if the servo's type is not known or 12 V, and if it is a
7.4 V servo [V]. On the power of a USB port alone servos are weak and restart. Chosen; many 7.4 V
arms run on 5 V, and 4 V is the servo's own limit (WS)."""

LOW_V = 6.0
"""A 7.4 V servo below this is weak [V]. Chosen; an empty battery of two cells has 6 V."""

LOW_12_V = 9.0
"""The same for a 12 V servo [V]. Also the border between the two types' own upper limits, 8.0 and
14.0 V (WS, FW)."""

SAG_V = 0.7
"""The voltage may drop this much from the first servo to the last [V]. Chosen."""

LOSSY, BROKEN = 0.005, 0.1
"""Shares of lost or garbled answers that cause a warning and that make a bus unusable. Chosen: a
good bus has none, and retries make up for 7 % (``bus.RETRIES``)."""

ENOUGH = 1000
"""Fewest answers for which a share is judged; half a percent of fewer is chance."""


LETS_GO = frozenset(LET_GO.names)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoTrouble:
    """One thing that is wrong with a servo: a sentence with its figure, and what to do about it."""

    # its subject; ``"fault"`` if only a status bit shows it
    kind: Literal["temperature", "load", "supply", "fault"]
    # ``"stop"`` if its joint must not be moved, ``"warn"`` if the servo does not fit its supply,
    # ``"note"`` if it works, but not as well as it could
    level: Literal["stop", "warn", "note"]
    sentence: str
    fix: str

    def __str__(self) -> str:
        return f"{self.sentence}; {self.fix}"


def judge(
    *,
    volts: float,
    lowest_volts: float = 0.0,
    highest_volts: float | None = None,
    celsius: int,
    load: float,
    amps: float,
    faults: Iterable[str],
) -> tuple[ServoTrouble, ...]:
    """Everything that is wrong with a servo, worst first; empty when all is well.

    ``lowest_volts`` and ``highest_volts`` are the limits in its registers [V], the upper one None
    if it is not known. ``load`` is its drive, -1 to 1; ``faults`` as ``Fault.names``.
    """
    reported = frozenset(faults)
    found = []
    support = "support the arm and what it holds; " if reported & LETS_GO else ""
    if "overheated" in reported or celsius >= WARM_C:
        is_off = "overheated" in reported
        how = "too hot and has let go" if is_off else "too hot" if celsius >= HOT_C else "hot"
        sentence = f"its servo is {how} ({celsius} °C, it switches off at {OFF_C})"
        if is_off and celsius < OFF_C:
            sentence = f"its servo was too hot and has let go (now {celsius} °C)"
        found.append(
            ServoTrouble(
                kind="temperature",
                level="stop" if celsius >= HOT_C or is_off else "note",
                sentence=sentence,
                fix=f"{support}let it cool below {WARM_C} °C, and do not let it press or hold up a"
                " load for long",
            )
        )
    if reported & {"overload", "overcurrent"}:
        is_off = "overcurrent" in reported
        found.append(
            ServoTrouble(
                kind="load",
                level="stop",
                sentence=f"its servo is overloaded{' and has let go' if is_off else ''}"
                f" ({100 * abs(load):.0f} % drive, {abs(amps):.2f} A)",
                fix=f"{support}free the joint or take weight off it, then move again",
            )
        )
    supply = judge_supply(volts, lowest_volts, highest_volts)
    if supply is None and "voltage" in reported:
        supply = ServoTrouble(
            kind="fault",
            level="stop",
            sentence="its servo reports a supply outside its limits, or one that drops under load"
            f" (last read: {volts:.1f} V)",
            fix="check the power supply and, with 7.4 V servos, that it is not a 12 V one",
        )
    found += [] if supply is None else [supply]
    if "encoder" in reported:
        found.append(
            ServoTrouble(
                kind="fault",
                level="stop",
                sentence="its servo reports a broken encoder",
                fix="replace the servo",
            )
        )
    return tuple(found)


def judge_supply(
    volts: float, lowest_volts: float, highest_volts: float | None
) -> ServoTrouble | None:
    """The trouble of a servo's supply, or None; arguments as for ``judge``."""
    if highest_volts is not None and volts > highest_volts:
        nominal = nominal_volts(highest_volts)
        mixed_up = ": a 7.4 V servo on a 12 V supply" if nominal < LOW_12_V < volts else ""
        return ServoTrouble(
            kind="supply",
            level="stop",
            sentence=f"it gets {volts:.1f} V but is made for at most {highest_volts:.1f} V"
            f"{mixed_up}",
            fix=f"switch the power off now and use a supply of {nominal:g} V",
        )
    is_7v4 = highest_volts is not None and highest_volts < LOW_12_V
    if volts <= lowest_volts or volts < (TOO_LOW_7V4 if is_7v4 else TOO_LOW_V):
        return ServoTrouble(
            kind="supply",
            level="stop",
            sentence=f"it gets only {volts:.1f} V",
            fix="switch the arm's power supply on (a USB port cannot feed servos), or check its"
            " plugs",
        )
    if highest_volts is not None and highest_volts >= LOW_12_V > volts:
        return ServoTrouble(
            kind="supply",
            level="warn",
            sentence=f"it gets only {volts:.1f} V but is a 12 V servo, so it will be weak and slow",
            fix="use a supply of 12 V, if the other servos are made for it as well",
        )
    if volts < LOW_V:
        return ServoTrouble(
            kind="supply",
            level="note",
            sentence=f"it gets only {volts:.1f} V, so it is weak and slow and may restart when"
            " several joints move",
            fix="use a stronger supply, or check its plugs",
        )
    return None


def nominal_volts(highest_volts: float) -> float:
    """The rated supply of a servo, 7.4 or 12 [V], by the upper limit in its registers [V]."""
    return 7.4 if highest_volts < LOW_12_V else 12.0


def sag(volts: Sequence[float]) -> ServoTrouble | None:
    """The trouble of a voltage that drops along the cable, base to jaw [V]; None if all is well."""
    if volts[0] - volts[-1] <= SAG_V:
        return None
    return ServoTrouble(
        kind="supply",
        level="note",
        sentence=f"{volts[0]:.1f} V at the base but {volts[-1]:.1f} V at the end: the thin cables"
        " carry too much",
        fix="check their plugs, or feed the far end as well",
    )


def alarms(health: Iterable[JointHealth]) -> dict[str, str]:
    """Why joints must not be moved, by joint; silent servos are the driver's to report."""
    found: dict[str, str] = {}
    for joint in health:
        is_well = joint.temperature_c < HOT_C and joint.volts >= LOW_V and not joint.faults
        if is_well or joint.is_silent:
            continue
        for trouble in judge(
            volts=joint.volts,
            celsius=joint.temperature_c,
            load=joint.load,
            amps=joint.amps,
            faults=joint.faults,
        ):
            if trouble.level == "stop":
                found.setdefault(joint.joint, str(trouble))
    return found


def let_go(health: Iterable[JointHealth]) -> frozenset[str]:
    """The joints whose servos have switched themselves off."""
    return frozenset(
        each.joint for each in health if not each.is_silent and LETS_GO & {*each.faults}
    )


def share_of_speed(health: Iterable[JointHealth]) -> float:
    """The share of its speed that the arm should use, 1 to 0.25, by its hottest servo."""
    hottest = max([joint.temperature_c for joint in health], default=0)
    if hottest <= WARM_C:
        return 1.0
    return float(np.interp(hottest, (WARM_C, HOT_C), (1.0, 0.25)))


def lossy_share(count: int, asked: int) -> float:
    """The share of lost or garbled answers, if it deserves a warning; else 0."""
    share = count / asked if asked >= ENOUGH else 0.0
    return share if share > LOSSY else 0.0
