"""Read and write the zeros of a calibration, in a file beside it: ``arm.zero.json``.

The zeros are not in the calibration itself, because other programs use that file as well: LeRobot
refuses further fields, and the published module drops them when it saves. So each entry here
repeats the numbers of the record that it belongs to. If any program has changed those since, the
entry is ignored, and a note says so. While a calibration is being saved a joint has two entries,
for the old record and for the new, so that after a crash either record has its own zero.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from so101_motion.calib.record.record import JOINTS, Calibration, JointCalibration
from so101_motion.calib.record.zero import CONVENTIONS, Zero
from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import CalibrationError, ConfigError, quoted
from so101_motion.common.units import to_deg, to_rad
from so101_motion.files import json_file

_SAME = ("drive_mode", "homing_offset", "range_min", "range_max")
"""An entry belongs to the record that has the same values of these."""

_SOURCES = ("stops", "pose", *CONVENTIONS)


def read(path: Path, calibration: Calibration) -> tuple[dict[str, Zero], tuple[str, ...]]:
    """Read the zeros of ``calibration`` from the file at ``path``, with notes on problems.

    Without a file there are none. With a file that cannot be read there are none either, and a note
    says so: the joints then have their zero in the middle, as with a file of another program.
    """
    if not path.exists():
        return {}, ()
    try:
        content = json_file.read(path)
        entries = content.get("joints") if isinstance(content, Mapping) else None
        if not isinstance(entries, Mapping):
            raise CalibrationError(None, f'{path} holds no "joints"', "calibrate again")
        zeros = {
            joint: found
            for joint, entry in calibration.items()
            if joint in entries and (found := _zero(joint, entry, entries[joint])) is not None
        }
    except CalibrationError as error:
        return {}, (f"zero is the middle of each travel, because zeros cannot be read: {error}",)
    stale = [joint for joint in calibration if entries.get(joint) and joint not in zeros]
    if not stale:
        return zeros, ()
    return zeros, (
        f"{', '.join(stale)}: another program has calibrated since {path.name} was written, so zero"
        " is the middle of the travel again",
    )


def text(*sides: tuple[Calibration, Mapping[str, Zero]]) -> bytes:
    joints: dict[str, list[dict[str, object]]] = {}
    for calibration, zeros in sides:
        for joint in JOINTS:
            if joint not in zeros or joint not in calibration:
                continue
            entry = {
                **{name: getattr(calibration[joint], name) for name in _SAME},
                "by": zeros[joint].by,
                "middle_deg": round(to_deg(zeros[joint].angle), 4),
            }
            known = joints.setdefault(joint, [])
            if entry not in known:
                known.append(entry)
    if not joints:
        return b""
    about = "the model's angle at the middle of the recorded travel, for records with these numbers"
    return json.dumps({"about": about, "joints": joints}, indent=2).encode() + b"\n"


def _zero(joint: str, record: JointCalibration, entries: object) -> Zero | None:
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise CalibrationError(joint, "its zeros must be a list of objects", "calibrate again")
    for entry in reversed(entries):  # the last was written last
        if all(entry.get(name) == getattr(record, name) for name in _SAME):
            return _checked(joint, entry)
    return None


def _checked(joint: str, entry: Mapping[str, object]) -> Zero:
    by = entry.get("by")
    if by not in _SOURCES:
        raise CalibrationError(
            joint, f'"by" is {" or ".join(_SOURCES)}, not {quoted(by)}', "calibrate again"
        )
    try:
        middle_deg = checked_number(
            "middle_deg", entry.get("middle_deg"), lower=-180.0, upper=180.0
        )
    except ConfigError as error:
        raise CalibrationError(joint, str(error), "calibrate again") from error
    return Zero(by=str(by), angle=to_rad(middle_deg))
