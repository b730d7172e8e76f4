"""Fill a pallet: pick each cube at the same spot and put it down on the next place of a grid.

    python examples/palletising.py
    python examples/palletising.py --rows 2 --columns 2 --speed 60

Every pick and every place is an approach: the jaw comes above the spot by any free way, goes
straight down on it, and leaves straight up. The tool points down, and how it is turned about the
vertical is free, which is what five joints can do everywhere on the table. The arm is simulated;
for a real one, ``open_hardware`` takes the place of ``open_simulated``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

import numpy as np

import so101_motion as so101
from so101_motion.common.units import to_mm, to_rad
from so101_motion.planning.collision.scene import FLOOR_Z

CUBE = 0.02
GRIP_HEIGHT = 0.014  # of the jaw's tip over the table: a little above the cube's middle
HOVER = np.array([0.0, 0.0, 0.04])
DOWN = np.diag([1.0, -1.0, -1.0])
CUBES_ARRIVE = (0.16, 0.14)
FIRST_PLACE = (0.16, -0.16)
PITCH = 0.04
OPEN, CLOSED = 0.5, 0.2  # apertures: beside a cube, and on one


def places(rows: int, columns: int) -> Iterator[tuple[float, float]]:
    """The grid's spots in the base frame [m], row by row."""
    for row in range(rows):
        for column in range(columns):
            yield FIRST_PLACE[0] + PITCH * row, FIRST_PLACE[1] + PITCH * column


def visit(rig: so101.Rig, spot: tuple[float, float], aperture: float) -> None:
    """Down on a spot, move the jaw to an aperture, and up again."""
    p_tip = np.array([*spot, FLOOR_Z + GRIP_HEIGHT])
    approach = so101.ApproachGoal(T_base_tool=so101.SE3(DOWN, p_tip), hover=HOVER, frame="jaw_tip")
    rig.arm.move(approach)
    reached = rig.arm.T_base("jaw_tip").p
    print(f"  jaw at ({', '.join(f'{x:.1f}' for x in to_mm(reached))}) mm")
    rig.gripper.move(aperture)
    leave = so101.LineGoal(
        T_base_tool=so101.SE3(DOWN, p_tip + HOVER), metric=approach.metric, frame="jaw_tip"
    )
    rig.arm.move(leave)


def main() -> None:
    """Fill the pallet."""
    parser = argparse.ArgumentParser(description="Fill a pallet with cubes, on a simulated arm.")
    parser.add_argument("--rows", type=int, default=3)
    parser.add_argument("--columns", type=int, default=2)
    parser.add_argument("--speed", type=float, default=90.0, help="of every joint [deg/s]")
    asked = parser.parse_args()
    begin, count = time.monotonic(), asked.rows * asked.columns
    with so101.open_simulated(speed=to_rad(asked.speed), acceleration=to_rad(500.0)) as rig:
        rig.gripper.move(OPEN)
        for number, spot in enumerate(places(asked.rows, asked.columns), start=1):
            print(f"cube {number} of {count}")
            visit(rig, CUBES_ARRIVE, CLOSED)
            visit(rig, spot, OPEN)
    print(f"{count} cubes in {time.monotonic() - begin:.1f} s")


if __name__ == "__main__":
    main()
