"""Export trajectories: CSV and JSON for programs, MCAP for Foxglove, Rerun and PlotJuggler.

CSV and JSON are in degrees with the unit in every name, or have LeRobot's names and units
(``LeRobot``). MCAP holds ROS 2 messages in radians: ``sensor_msgs/msg/JointState`` with the
commanded angles on ``/joint_commands`` and the measured ones on ``/joint_states``.

A motion that was carried out (``Run``) is written with commanded and measured angles side by side.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, frozen_array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg
from so101_motion.files import atomic
from so101_motion.planning.timing.trajectory import Trajectory

JOINT_STATE = """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
"""The definition of ``sensor_msgs/msg/JointState``, as MCAP files carry it."""

STRING = "string data\n"
"""The definition of ``std_msgs/msg/String``."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """A motion as it was carried out.

    Attributes:
        t: Times since it began, shape (m,), [s].
        q_ref: Commanded joint angles, shape (m, 5), [rad].
        q: Measured joint angles, shape (m, 5), [rad].
    """

    t: Array
    q_ref: Array
    q: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", frozen_array(self.t, (-1,)))
        for name in ("q_ref", "q"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (len(self.t), 5)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeRobot:
    """LeRobot's units: degrees from the middle of a joint's travel, per cent for the jaw.

    The columns have LeRobot's names, ``shoulder_pan.pos`` and so on. A run has an ``action`` and an
    ``observation.state``, as in LeRobot's data sets.

    Attributes:
        middles: The model's angles in the middles of the joints' travels, shape (5,), [rad].
        aperture: How far the jaw is open meanwhile: 0 closed, 1 open.
    """

    middles: Array = field(default_factory=lambda: np.zeros(5))
    aperture: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "middles", frozen_array(self.middles, (5,)))

    def rows(self, q: Array) -> Array:
        """Joint angles (m, 5) [rad] in LeRobot's units, with the jaw, shape (m, 6)."""
        return np.column_stack([to_deg(q - self.middles), np.full(len(q), 100.0 * self.aperture)])


def export(motion: Trajectory | Run, path: Path, *, lerobot: LeRobot | None = None) -> None:
    """Write a motion of the five arm joints to a file; the name's ending chooses the format.

    Args:
        motion: As planned, or as it was carried out.
        path: Ends with ``.csv``, ``.json`` or ``.mcap``; an existing file is replaced.
        lerobot: LeRobot's names and units for CSV or JSON; None for our own.

    Raises:
        ConfigError: There is no such format, the file cannot be written, or the package for MCAP is
            not installed.
    """
    content = encoded(motion, path.name, lerobot=lerobot)
    try:
        atomic.write(path, content)
    except OSError as error:
        raise ConfigError("out", str(path), f"cannot be written: {error.strerror}") from error


def encoded(motion: Trajectory | Run, name: str, *, lerobot: LeRobot | None = None) -> bytes:
    """The bytes that ``export`` would write to a file called ``name``; raises the same errors."""
    check_name(name, lerobot=lerobot is not None)
    suffix, rows = Path(name).suffix.lower(), _rows(motion)
    return _FORMATS[suffix](rows, name) if lerobot is None else _LEROBOT[suffix](rows, lerobot)


def check_name(name: str, *, lerobot: bool = False) -> None:
    """Refuse a file name that ``export`` would refuse, before there is anything to write.

    Args:
        name: The file's name.
        lerobot: Whether it is to hold LeRobot's names.

    Raises:
        ConfigError: There is no such format, or MCAP needs a package that is not installed.
    """
    suffix = Path(name).suffix.lower()
    if not lerobot and suffix not in _FORMATS:
        raise ConfigError("out", name, f"must end with one of {', '.join(_FORMATS)}")
    if lerobot and suffix not in _LEROBOT:
        wanted = " or ".join(_LEROBOT)
        raise ConfigError("out", name, f"must end with {wanted} to hold LeRobot's names")
    if suffix == ".mcap":
        mcap_writer(Path(name))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rows:
    """The table that is written, a row for each of the m times.

    Attributes:
        t: [s].
        values: Joint values, each (m, 5), in degrees, positions first; by the suffix of a joint's
            column in CSV and by the name in JSON.
        q: Wanted positions, (m, 5), [rad].
        qd: Wanted velocities, (m, 5), [rad/s]; None where they are not known.
        q_measured: Measured positions, (m, 5), [rad], or None.
        head: Fields that JSON has before the rows.
    """

    t: Array
    values: dict[tuple[str, str], Array]
    q: Array
    qd: Array | None
    q_measured: Array | None
    head: dict[str, Any]


def _rows(motion: Trajectory | Run) -> _Rows:
    if isinstance(motion, Run):
        return _Rows(
            t=motion.t,
            values={
                ("deg", "q_deg"): to_deg(motion.q_ref),
                ("measured_deg", "q_measured_deg"): to_deg(motion.q),
            },
            q=motion.q_ref,
            qd=None,
            q_measured=motion.q,
            head={"schema": "so101/run/1", "joints": list(ARM_JOINTS)},
        )
    return _Rows(
        t=motion.t,
        values={
            ("deg", "q_deg"): to_deg(motion.q),
            ("deg_per_s", "qd_deg_per_s"): to_deg(motion.qd),
            ("deg_per_s2", "qdd_deg_per_s2"): to_deg(motion.qdd),
        },
        q=motion.q,
        qd=motion.qd,
        q_measured=None,
        head={
            "schema": "so101/trajectory/1",
            "joints": list(ARM_JOINTS),
            "dt_s": motion.dt,
            "duration_s": motion.duration,
        },
    )


def _to_csv(rows: _Rows, _name: str) -> bytes:
    names = [f"{joint}_{unit}" for unit, _ in rows.values for joint in ARM_JOINTS]
    values = np.column_stack(list(rows.values.values()))
    return _table(
        ["time_s", *names],
        (
            [f"{t:.9g}", *(f"{value:.6f}" for value in row)]
            for t, row in zip(rows.t, values, strict=True)
        ),
    )


def _to_json(rows: _Rows, _name: str) -> bytes:
    columns = {name: values.tolist() for (_, name), values in rows.values.items()}
    content = {**rows.head, "time_s": [round(float(t), 9) for t in rows.t], **columns}
    return json.dumps(content).encode() + b"\n"


def _to_mcap(rows: _Rows, name: str) -> bytes:
    file = io.BytesIO()
    with mcap_writer(Path(name))(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for k, t in enumerate(rows.t):
            at_ns = round(float(t) * 1e9)
            qd = None if rows.qd is None else rows.qd[k]
            wanted = joint_state(at_ns, ARM_JOINTS, rows.q[k], qd)
            writer.write_message("/joint_commands", schema, wanted, at_ns, at_ns, k)
            if rows.q_measured is not None:
                there = joint_state(at_ns, ARM_JOINTS, rows.q_measured[k])
                writer.write_message("/joint_states", schema, there, at_ns, at_ns, k)
    return file.getvalue()


def _lerobot_groups(rows: _Rows, lerobot: LeRobot) -> dict[str, Array]:
    """The columns in groups, by the prefix of their names; each (m, 6)."""
    if rows.q_measured is None:
        return {"": lerobot.rows(rows.q)}
    return {
        "action.": lerobot.rows(rows.q),
        "observation.state.": lerobot.rows(rows.q_measured),
    }


def _to_lerobot_csv(rows: _Rows, lerobot: LeRobot) -> bytes:
    groups = _lerobot_groups(rows, lerobot)
    values = np.column_stack(list(groups.values()))
    return _table(
        ["timestamp", "frame_index", *_lerobot_names(groups)],
        (
            [f"{t:.6f}", k, *(f"{value:.4f}" for value in row)]
            for k, (t, row) in enumerate(zip(rows.t, values, strict=True))
        ),
    )


def _to_lerobot_json(rows: _Rows, lerobot: LeRobot) -> bytes:
    groups = _lerobot_groups(rows, lerobot)
    values = np.column_stack(list(groups.values())).T.round(4).tolist()
    content = {
        "schema": "so101/lerobot/1",
        "timestamp": rows.t.round(6).tolist(),
        **dict(zip(_lerobot_names(groups), values, strict=True)),
    }
    return json.dumps(content).encode() + b"\n"


def _lerobot_names(groups: dict[str, Array]) -> list[str]:
    joints = (*ARM_JOINTS, GRIPPER_JOINT)
    return [f"{group}{joint}.pos" for group in groups for joint in joints]


def _table(names: list[str], rows: Iterable[list[Any]]) -> bytes:
    text = io.StringIO(newline="")
    out = csv.writer(text)
    out.writerow(names)
    out.writerows(rows)
    return text.getvalue().encode()


def mcap_writer(path: Path) -> Any:
    """The class that writes ROS 2 messages to an open MCAP file.

    Args:
        path: Which file is to be written, for the message.

    Raises:
        ConfigError: The package for it is not installed.
    """
    try:
        from mcap_ros2.writer import Writer
    except ImportError as error:
        raise ConfigError(
            "out", str(path), "MCAP needs another package; try: pip install 'so101-motion[mcap]'"
        ) from error
    return Writer


def joint_state(
    at_ns: int,
    names: Sequence[str],
    q: Array,
    qd: Array | None = None,
    effort: Sequence[float] = (),
) -> dict[str, Any]:
    """A ``JointState`` message.

    Args:
        at_ns: Its time [ns].
        names: Of the n joints.
        q: Positions, shape (n,), [rad].
        qd: Velocities, shape (n,), [rad/s]; None where there are none.
        effort: What goes into that field.
    """
    return {
        "header": {
            "stamp": {"sec": at_ns // 10**9, "nanosec": at_ns % 10**9},
            "frame_id": "base_link",
        },
        "name": list(names),
        "position": q.tolist(),
        "velocity": [] if qd is None else qd.tolist(),
        "effort": list(effort),
    }


_FORMATS: dict[str, Callable[[_Rows, str], bytes]] = {
    ".csv": _to_csv,
    ".json": _to_json,
    ".mcap": _to_mcap,
}

_LEROBOT: dict[str, Callable[[_Rows, LeRobot], bytes]] = {
    ".csv": _to_lerobot_csv,
    ".json": _to_lerobot_json,
}
