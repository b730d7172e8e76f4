"""A trajectory as a file: CSV and JSON for programs, MCAP for Foxglove, Rerun and PlotJuggler.

CSV and JSON are in degrees, as people read them, with the unit in every name. MCAP holds ROS 2
messages and thus radians: ``sensor_msgs/msg/JointState`` on ``/joint_commands``.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from so101_motion.errors import ConfigError
from so101_motion.geometry import Array
from so101_motion.planning.trajectory import Trajectory
from so101_motion.state import ARM_JOINTS
from so101_motion.units import to_deg

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


def export(trajectory: Trajectory, path: Path) -> None:
    """Write a trajectory of the five arm joints to a file whose name says the format.

    Args:
        trajectory: The motion.
        path: Ends with ``.csv``, ``.json`` or ``.mcap``; what was there is replaced.

    Raises:
        ConfigError: There is no such format, the file cannot be written, or MCAP needs a package
            that is not installed.
    """
    write = _FORMATS.get(path.suffix.lower())
    if write is None:
        raise ConfigError("out", str(path), f"must end with one of {', '.join(_FORMATS)}")
    try:
        write(trajectory, path)
    except OSError as error:
        raise ConfigError("out", str(path), f"cannot be written: {error.strerror}") from error


def as_columns(trajectory: Trajectory) -> dict[str, list[Any]]:
    """A trajectory as rows for JSON: times [s], and a row of five numbers for each."""
    return {
        "time_s": [round(float(t), 9) for t in trajectory.t],
        "q_deg": to_deg(trajectory.q).tolist(),
        "qd_deg_per_s": to_deg(trajectory.qd).tolist(),
        "qdd_deg_per_s2": to_deg(trajectory.qdd).tolist(),
    }


def _to_csv(trajectory: Trajectory, path: Path) -> None:
    units = ("deg", "deg_per_s", "deg_per_s2")
    with open(path, "w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(["time_s", *(f"{joint}_{unit}" for unit in units for joint in ARM_JOINTS)])
        columns = as_columns(trajectory)
        for t, *rows in zip(*columns.values(), strict=True):
            out.writerow([f"{t:.9g}", *(f"{value:.6f}" for row in rows for value in row)])


def _to_json(trajectory: Trajectory, path: Path) -> None:
    content = {
        "schema": "so101/trajectory/1",
        "joints": list(ARM_JOINTS),
        "dt_s": trajectory.dt,
        "duration_s": trajectory.duration,
        **as_columns(trajectory),
    }
    path.write_text(json.dumps(content) + "\n", encoding="utf-8")


def _to_mcap(trajectory: Trajectory, path: Path) -> None:
    writer_class = mcap_writer(path)
    with open(path, "wb") as file, writer_class(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for k, t in enumerate(trajectory.t):
            at_ns = round(float(t) * 1e9)
            message = joint_state(at_ns, ARM_JOINTS, trajectory.q[k], trajectory.qd[k])
            writer.write_message("/joint_commands", schema, message, at_ns, at_ns, k)


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
            "out", str(path), "MCAP needs a package more; try: pip install 'so101-motion[mcap]'"
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


_FORMATS: dict[str, Callable[[Trajectory, Path], None]] = {
    ".csv": _to_csv,
    ".json": _to_json,
    ".mcap": _to_mcap,
}
