"""Make the plots of the documentation from plans and motions of the simulated arm.

Needs matplotlib, which toppra brings along where it is installed. Run it from anywhere:

    python docs/make_plots.py
"""

from __future__ import annotations

import threading
from pathlib import Path

import matplotlib as mpl
import numpy as np

from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_rad
from so101_motion.files.scene_file import read_scene
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.request import Plan
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated

mpl.use("Agg")  # draws into files, also where there is no screen
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
TABLE = ROOT / "examples" / "table.json"
COLORS = ("#e03131", "#2f9e44", "#1c7ed6", "#f08c00", "#9c36b5")
START_DEG = (65.0, -20.0, 30.0, 50.0, 0.0)
GOAL = (0.19, 0.2, 0.1)
TICK = 0.01  # [s]
STOP_AFTER = 1.2  # [s], while it is fast


def main() -> None:
    """Write the pictures."""
    clock = ManualClock()
    start = to_rad(np.array(START_DEG))
    with open_simulated(scene=read_scene(TABLE), q_start=start, clock=clock) as rig:
        plan = rig.arm.plan(PoseGoal.at_point(GOAL))
        timing(plan, PICTURES / "timing.png")
        stopping(plan, stopped(rig, clock, plan), PICTURES / "stopping.png")


def timing(plan: Plan, file: Path) -> None:
    """Angles, and how much of each cap the joints use, over time."""
    trajectory, limits = plan.trajectory, plan.limits
    jerk = np.gradient(trajectory.qdd, trajectory.t, axis=0)
    figure, axes = plt.subplots(4, sharex=True, figsize=(8, 8), layout="constrained")
    rows = (
        ("angle [deg]", to_deg(trajectory.q)),
        ("velocity [% of cap]", 100.0 * trajectory.qd / limits.velocity),
        ("acceleration [% of cap]", 100.0 * trajectory.qdd / limits.acceleration),
        ("jerk [% of cap]", 100.0 * jerk / limits.jerk),
    )
    for axis, (label, values) in zip(axes, rows, strict=True):
        for joint, color, column in zip(ARM_JOINTS, COLORS, values.T, strict=True):
            axis.plot(trajectory.t, column, color=color, linewidth=1.4, label=joint)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    for axis in axes[1:]:
        axis.axhline(100.0, color="black", linestyle="--", linewidth=1)
        axis.axhline(-100.0, color="black", linestyle="--", linewidth=1)
    axes[0].legend(ncols=5, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, 1.3))
    axes[-1].set_xlabel("time [s]")
    _write(figure, file)


def stopped(rig: Rig, clock: ManualClock, plan: Plan) -> tuple[Array, Array]:
    """What the joints were sent while the plan was executed and stopped on the way.

    Returns:
        Times since the first setpoint, shape (n,), [s]; joint angles, shape (n, 5), [rad].
    """
    motion = rig.arm.move(plan, wait=False)
    sent: list[Array] = []
    while not sent or np.array_equal(sent[-1], plan.q_start):  # until it has begun
        clock.advance(TICK)
        sent = [rig.arm.state.q_ref]
    stop = threading.Thread(target=rig.arm.stop)
    while not motion.future.done():
        if len(sent) == round(STOP_AFTER / TICK):
            stop.start()
            stop.join(0.2)  # it is under way; it returns when the arm is at rest
        clock.advance(TICK)
        sent.append(rig.arm.state.q_ref)
    stop.join()
    return TICK * np.arange(len(sent)), np.array(sent)


def stopping(plan: Plan, seen: tuple[Array, Array], file: Path) -> None:
    """The joints' angles and speeds as planned, and as they were with a stop on the way."""
    t, q = seen
    planned = plan.trajectory
    figure, (angles, speeds) = plt.subplots(2, sharex=True, figsize=(8, 5), layout="constrained")
    for joint, color, k in zip(ARM_JOINTS, COLORS, range(len(ARM_JOINTS)), strict=True):
        angles.plot(planned.t, to_deg(planned.q[:, k]), color=color, linewidth=1, linestyle=":")
        angles.plot(t, to_deg(q[:, k]), color=color, linewidth=1.8, label=joint)
        speeds.plot(planned.t, to_deg(planned.qd[:, k]), color=color, linewidth=1, linestyle=":")
        speeds.plot(t, to_deg(np.gradient(q[:, k], t)), color=color, linewidth=1.8)
    for axis, label in ((angles, "angle [deg]"), (speeds, "velocity [deg/s]")):
        axis.axvline(STOP_AFTER, color="black", linewidth=1)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    angles.set_title("dotted: the plan; black: stop is asked for", fontsize="medium")
    angles.legend(ncols=5, fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.12))
    speeds.set_xlabel("time [s]")
    speeds.set_xlim(0.0, STOP_AFTER + 1.0)
    _write(figure, file)


def _write(figure: Figure, file: Path) -> None:
    figure.savefig(file, dpi=110)
    plt.close(figure)
    print(file.relative_to(ROOT))


if __name__ == "__main__":
    main()
