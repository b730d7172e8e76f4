"""Report an identification: its figures, the changes since the last one, and its predictions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.calib.procedure.servo_fit import Identified
from so101_motion.calib.procedure.servo_twin import JointRecord
from so101_motion.calib.record import servo_file
from so101_motion.calib.record.servo_file import HandLoad, ServoRecord
from so101_motion.common.errors import CalibrationError
from so101_motion.common.units import to_deg, to_mm
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.emulator.joint_figures import SO101
from so101_motion.setup.identify_figures import Prediction

CHANGED = 0.25
"""Friction or torque must differ from the last time by this share to be reported. Chosen: twice as
much as two identifications of one arm differ."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyReport:
    """The result of an identification."""

    found: ServoRecord  # the new figures
    before: ServoRecord | None  # the figures before; None if there were none
    predictions: Mapping[str, Prediction]  # how well figures predict each joint, by name
    file: Path | None  # the file that it is saved in; None if it is not saved

    def to_json(self) -> dict[str, Any]:
        load = self.found.load
        return {
            "at": self.found.at,
            "volts": round(self.found.volts, 2),
            "file": None if self.file is None else str(self.file),
            "joints": {joint: self._joint(joint) for joint in self.found.servos},
            "load": None
            if load is None
            else {"mass_g": round(1e3 * load.mass, 1), "com_mm": [to_mm(x) for x in load.com]},
            "changes": list(changes(self.before, self.found)),
        }

    def text(self) -> str:
        lines = [
            f"{'joint':<15}{'torque':>8}{'friction':>10}{'dead time':>11}{'play':>8}"
            f"{'off, as sold':>14}{'as known':>10}"
        ]
        for joint, each in self.found.servos.items():
            play = "–" if each.play is None else f"{to_deg(each.play):.2f}°"
            told = self.predictions.get(joint)
            off = ("–", "–") if told is None else (_deg(told.as_sold), _deg(told.as_known))
            lines.append(
                f"{joint:<15}{each.torque:>8.0%}{each.friction:>10.0%}{each.dead_time:>11.0%}"
                f"{play:>8}{off[0]:>14}{off[1]:>10}"
            )
        lines += self.remarks()
        if self.file is not None:
            lines.append(f"saved in {self.file}; used from the next start")
        return "\n".join(lines) + "\n"

    def remarks(self) -> list[str]:
        said = [f"supply {self.found.volts:.1f} V; shares are of the servo type's figures"]
        load = self.found.load
        if load is not None:
            x, y, z = (to_mm(each) for each in load.com)
            said.append(
                f"the hand carries {1e3 * load.mass:.0f} g, its centre at"
                f" ({x:.0f}, {y:.0f}, {z:.0f}) mm of the tool; plans count with it until the"
                " program ends; to keep it, configure payload_kg and payload_com_mm"
            )
        return [*said, *changes(self.before, self.found)]

    def _joint(self, joint: str) -> dict[str, Any]:
        each, told = self.found.servos[joint], self.predictions.get(joint)
        return {
            "torque": each.torque,
            "friction": each.friction,
            "dead_time": each.dead_time,
            "play_deg": None if each.play is None else to_deg(each.play),
            "off_as_sold_deg": None if told is None else to_deg(told.as_sold),
            "off_as_known_deg": None if told is None else to_deg(told.as_known),
        }


def changes(before: ServoRecord | None, now: ServoRecord) -> Iterator[str]:
    if before is None:
        return
    for joint, each in now.servos.items():
        last = before.servos.get(joint)
        if last is None:
            continue
        for name, share in (
            ("friction", each.friction / max(last.friction, 1e-6) - 1.0),
            ("torque", each.torque / last.torque - 1.0),
        ):
            if abs(share) >= CHANGED:
                word = "more" if share > 0.0 else "less"
                yield f"{joint} has {abs(share):.0%} {word} {name} than on {before.at[:10]}"


def changes_since(calibration: Path) -> tuple[str, ...]:
    try:
        now = servo_file.read(calibration)
    except CalibrationError as error:
        return (str(error),)
    return () if now is None else tuple(changes(servo_file.before(calibration), now))


def record_of(found: Identified) -> ServoRecord:
    load = found.load
    return ServoRecord(
        at=datetime.now(UTC).isoformat(timespec="seconds"),
        volts=found.volts,
        servos=found.servos,
        load=None if load is None else HandLoad(mass=load.mass, com=load.com),
    )


def write_recordings(
    folder: Path, records: Mapping[str, JointRecord], weights: Mapping[str, Any]
) -> tuple[Path, ...]:
    """Write recordings in the form that ``benchmarks/fit_servo.py`` reads, one file a joint.

    They hold goals, positions, supply and weight, and neither a serial number nor a date.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for joint, record in records.items():
        newest = np.searchsorted(record.t_goals, record.t, side="right") - 1
        goals = record.goals[np.maximum(newest, 0)] - record.zero_ticks
        ticks = record.ticks - record.zero_ticks
        files.append(folder / f"{joint}.npz")
        np.savez_compressed(
            files[-1],
            t_s=(record.t - record.t[0])[None],
            goal_rad=record.direction * goals[None] * RAD_PER_TICK,
            position_tick=record.direction * ticks[None],
            torque_enable=np.ones((1, len(ticks)), dtype=np.bool_),
            volts=record.volts[None],
            load_nm=weights[joint][None],
            kp=np.array([record.p_gain]),
            mass_kg=np.zeros(1),
            length_m=np.zeros(1),
            inertia_kgm2=np.array([SO101[record.index].inertia]),
            acceleration_radps2=np.array([record.acceleration]),
            trajectory=np.array([f"sweep of {joint}"]),
        )
    return tuple(files)


def _deg(angle: float) -> str:
    return f"{to_deg(angle):.2f}°"
