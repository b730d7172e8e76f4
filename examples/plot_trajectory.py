"""Plan a move and plot it: angles, speeds and accelerations of the joints, beside their caps.

    python examples/plot_trajectory.py trajectory.png --xyz 250 120 150

Needs matplotlib (`pip install matplotlib`).
Nothing moves; the arm is simulated.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np

import so101_motion as so101
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_m
from so101_motion.planning.request import Plan
from so101_motion.planning.timing.limits import MotionLimits

mpl.use("Agg")  # draws into files, also where there is no screen
import matplotlib.pyplot as plt


def plot(plan: Plan, limits: MotionLimits, file: Path) -> None:
    """Write the picture."""
    trajectory = plan.trajectory
    rows = (
        ("angle [deg]", trajectory.q, None),
        ("speed [deg/s]", trajectory.qd, limits.velocity),
        ("acceleration [deg/s²]", trajectory.qdd, limits.acceleration),
    )
    figure, axes = plt.subplots(len(rows), sharex=True, figsize=(8, 8), layout="constrained")
    for axis, (label, values, caps) in zip(axes, rows, strict=True):
        axis.plot(trajectory.t, to_deg(values), label=ARM_JOINTS)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        for cap in np.unique(to_deg(caps)) if caps is not None else ():
            axis.axhline(cap, color="black", linestyle="--", linewidth=1)
            axis.axhline(-cap, color="black", linestyle="--", linewidth=1)
    axes[0].legend(ncols=3, fontsize="small")
    axes[0].set_title(f"{plan.duration:.2f} s; caps dashed")
    axes[-1].set_xlabel("time [s]")
    figure.savefig(file, dpi=120)
    plt.close(figure)


def main() -> None:
    """Plan and plot."""
    parser = argparse.ArgumentParser(description="Plot a planned move.")
    parser.add_argument("file", type=Path, help="the picture: .png, .svg or .pdf")
    parser.add_argument(
        "--xyz", nargs=3, type=float, default=(250.0, 120.0, 150.0),
        metavar=("X", "Y", "Z"), help="where the tool shall go, in the arm's base frame [mm]",
    )  # fmt: skip
    asked = parser.parse_args()
    with so101.open_simulated() as rig:
        plan = rig.arm.plan(so101.PoseGoal.at_point(to_m(np.array(asked.xyz))))
        plot(plan, rig.arm.limits, asked.file)
    print(f"{asked.file}: {plan.duration:.2f} s, {len(plan.trajectory)} setpoints")


if __name__ == "__main__":
    main()
