"""Export trajectories: CSV and JSON for programs, MCAP for Foxglove, Rerun and PlotJuggler.

CSV and JSON are in degrees with the unit in every name. MCAP holds ROS 2 messages in radians:
``sensor_msgs/msg/JointState`` with the commanded angles on ``/joint_commands`` and the measured
ones on ``/joint_states``.

A motion that was carried out (``Run``) is written with commanded and measured angles side by side.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.common.attributes import checked_kind
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, freeze
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg
from so101_motion.files import atomic
from so101_motion.planning.request import Plan
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

STRING = "string data\n"  # the definition of ``std_msgs/msg/String``


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """A motion as it was carried out."""

    t: Array  # times since it began, shape (m,), [s]
    q_ref: Array  # commanded joint angles, shape (m, 5), [rad]
    q: Array  # measured joint angles, shape (m, 5), [rad]

    def __post_init__(self) -> None:
        freeze(self, t=(-1,))
        freeze(self, q_ref=(len(self.t), 5), q=(len(self.t), 5))


Motion = Trajectory | Run


def export(motion: Motion | Plan, path: Path | str) -> None:
    """Write a motion of the five arm joints to a file; the name's ending chooses the format.

    Args:
        motion: As planned, or as it was carried out.
        path: Ends with ``.csv``, ``.json`` or ``.mcap``; an existing file is replaced.

    Raises:
        ConfigError: There is no such format, the file cannot be written, or the package for MCAP is
            not installed.
    """
    path, motion = Path(path), motion.trajectory if isinstance(motion, Plan) else motion
    checked_kind("motion", motion, Motion, "a plan, its trajectory, or a Run")
    atomic.save("out", path, encoded(motion, path.name))


def encoded(motion: Motion, name: str) -> bytes:
    """The bytes that ``export`` would write to a file called ``name``; raises the same errors."""
    check_name(name)
    return _FORMATS[Path(name).suffix.lower()](motion, name)


def check_name(name: str) -> None:
    """Refuse a file name that ``export`` would refuse, before there is anything to write."""
    suffix = Path(name).suffix.lower()
    if suffix not in _FORMATS:
        raise ConfigError("out", name, f"must end with one of {', '.join(_FORMATS)}")
    if suffix == ".mcap":
        mcap_writer(Path(name))


def _columns(motion: Motion) -> dict[tuple[str, str], Array]:
    """Joint values in degrees, (m, 5) each, by the ending of a CSV column and the name in JSON."""
    if isinstance(motion, Run):
        values = {("deg", "q_deg"): motion.q_ref, ("measured_deg", "q_measured_deg"): motion.q}
    else:
        values = {
            ("deg", "q_deg"): motion.q,
            ("deg_per_s", "qd_deg_per_s"): motion.qd,
            ("deg_per_s2", "qdd_deg_per_s2"): motion.qdd,
        }
    return {names: to_deg(each) for names, each in values.items()}


def _to_csv(motion: Motion, _name: str) -> bytes:
    columns = _columns(motion)
    text = io.StringIO(newline="")
    out = csv.writer(text)
    out.writerow(["time_s", *(f"{joint}_{unit}" for unit, _ in columns for joint in ARM_JOINTS)])
    for t, row in zip(motion.t, np.column_stack(list(columns.values())), strict=True):
        out.writerow([f"{t:.9g}", *(f"{value:.6f}" for value in row)])
    return text.getvalue().encode()


def _to_json(motion: Motion, _name: str) -> bytes:
    head: dict[str, object] = {"schema": "so101/run/1", "joints": list(ARM_JOINTS)}
    if isinstance(motion, Trajectory):
        head |= {"schema": "so101/trajectory/1", "dt_s": motion.dt, "duration_s": motion.duration}
    columns = {name: values.tolist() for (_, name), values in _columns(motion).items()}
    content = {**head, "time_s": [round(float(t), 9) for t in motion.t], **columns}
    return json.dumps(content).encode() + b"\n"


def _to_mcap(motion: Motion, name: str) -> bytes:
    file = io.BytesIO()
    with mcap_writer(Path(name))(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for k, t in enumerate(motion.t):
            at_ns = round(float(t) * 1e9)
            if isinstance(motion, Run):
                messages = {
                    "/joint_commands": joint_state(at_ns, ARM_JOINTS, motion.q_ref[k]),
                    "/joint_states": joint_state(at_ns, ARM_JOINTS, motion.q[k]),
                }
            else:
                wanted = joint_state(at_ns, ARM_JOINTS, motion.q[k], motion.qd[k])
                messages = {"/joint_commands": wanted}
            for topic, message in messages.items():
                writer.write_message(topic, schema, message, at_ns, at_ns, k)
    return file.getvalue()


def mcap_writer(path: Path) -> Any:
    """The class that writes ROS 2 messages to an MCAP file; ``ConfigError`` if not installed."""
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
    """A ``JointState`` message: ``q``, shape (n,), [rad], and ``qd``, [rad/s], of n joints."""
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


_FORMATS: dict[str, Callable[[Motion, str], bytes]] = {
    ".csv": _to_csv,
    ".json": _to_json,
    ".mcap": _to_mcap,
}
