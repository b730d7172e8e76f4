"""Calibrate, configure and move an emulated arm with LeRobot's own code.

LeRobot is large, so it is no dependency of this package; give it an environment of its own::

    pip install 'lerobot[feetech]'
    python examples/lerobot_on_the_emulator.py --so101 path/to/so101

Everything on this side of the port is LeRobot's own code. A scripted hand holds the emulated arm
and moves its joints through their ranges while LeRobot records them, as a person would, and the
Enter key is pressed for it at the right moments. The figures it has to find are the emulator's.

Last run with LeRobot 0.6.1 on Python 3.12. It takes 45 s.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from lerobot.motors import Motor, MotorNormMode
from lerobot.motors.feetech import FeetechMotorsBus
from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig

JOINTS = (
    "shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper",
)  # fmt: skip

STOPS_DEG = ((-115, 123), (-105, 102), (-102, 90), (-103, 102), (-164, 171), (-11, 117))
"""The emulated joints' mechanical stops."""

SWEEP, SWEPT, RELEASE = 9.0, 21.0, 32.0
"""When the hand begins to move the joints, has done so, and lets go [s]."""


def hand() -> str:
    """A script: hold, go to both stops and back to the middle, hold until LeRobot does, let go."""
    lines = []
    for joint, (lower, upper) in zip(JOINTS, STOPS_DEG, strict=True):
        ways = ((SWEEP, 0), (SWEEP + 3.0, lower), (SWEEP + 8.0, upper), (SWEPT, 0))
        lines += [f"0 {joint} start", *(f"{t} {joint} {angle}" for t, angle in ways)]
        lines.append(f"{RELEASE} {joint} release")
    return "\n".join(lines)


@contextlib.contextmanager
def emulated(so101: str, *options: str) -> Iterator[str]:
    """A port with servos behind it."""
    command = [so101, "emulate", "--realtime", *options]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait()


class EnterKey:
    """Standard input that somebody else types on."""

    def __init__(self) -> None:
        reader, self._writer = os.pipe()
        sys.stdin = os.fdopen(reader)

    def press(self) -> None:
        """Enter."""
        os.write(self._writer, b"\n")

    def press_after(self, seconds: float) -> None:
        """Enter, later, whatever this program does meanwhile."""
        subprocess.Popen(
            ["sh", "-c", f"sleep {seconds}; echo >&{self._writer}"], pass_fds=[self._writer]
        )


def check(what: str, holds: bool, seen: object) -> None:
    """Say what was found; end when it is wrong."""
    print(f"{'ok   ' if holds else 'WRONG'} {what}: {seen}", flush=True)
    if not holds:
        raise SystemExit(1)


def set_up_a_new_motor(so101: str) -> None:
    """A motor as delivered, alone on the bus, becomes the gripper's."""
    with emulated(so101, "--ids", "6=1") as port:
        bus = FeetechMotorsBus(port, {"gripper": Motor(6, "sts3215", MotorNormMode.RANGE_0_100)})
        bus.setup_motor("gripper")
        found = bus.broadcast_ping()
        check("a new motor gets its id", found == {6: 777}, found)
        bus.disconnect(disable_torque=False)


def calibrate(robot: SO101Follower, key: EnterKey, started: float) -> None:
    """LeRobot's own procedure, from the half-turn homings to the file."""
    key.press()  # "move to the middle of its range and press ENTER"
    key.press_after(max(0.0, started + SWEPT + 1.0 - time.monotonic()))  # the sweep is over
    with contextlib.redirect_stdout(open(os.devnull, "w")):  # a live table
        robot.connect()
    widths = {}
    for joint, (lower, upper) in zip(JOINTS, STOPS_DEG, strict=True):
        entry = robot.calibration[joint]
        if joint == "wrist_roll":
            check("wrist_roll", (entry.range_min, entry.range_max) == (0, 4095), entry)
            continue
        recorded = (entry.range_max - entry.range_min) * 360.0 / 4096.0
        widths[joint] = (round(recorded, 1), upper - lower)
    near = all(abs(recorded - true) < 6.0 for recorded, true in widths.values())
    check("recorded widths and true ones [deg]", near, widths)
    offsets = [robot.calibration[joint].homing_offset for joint in JOINTS]
    check("homing offsets of an arm held in its middle", max(map(abs, offsets)) < 120, offsets)
    check("the servos hold what the file says", robot.is_calibrated, robot.calibration_fpath.name)


def check_configuration(robot: SO101Follower) -> None:
    """Check the registers that ``connect`` has written."""
    for row, wanted in (
        ("Maximum_Acceleration", 254), ("Acceleration", 254), ("Return_Delay_Time", 0),
        ("P_Coefficient", 16), ("D_Coefficient", 32), ("Torque_Enable", 1), ("Lock", 1),
    ):  # fmt: skip
        values = {joint: robot.bus.read(row, joint, normalize=False) for joint in JOINTS}
        check(row, set(values.values()) == {wanted}, sorted(set(values.values())))
    for row, wanted in (("Max_Torque_Limit", 500), ("Overload_Torque", 25)):
        value = robot.bus.read(row, "gripper", normalize=False)
        check(f"gripper {row}", value == wanted, value)


def wave(robot: SO101Follower) -> None:
    """A teleoperation loop at 50 Hz for three seconds, and how well the arm keeps up."""
    here = robot.get_observation()
    worst = 0.0
    begin = time.monotonic()
    for k in range(150):
        time.sleep(max(0.0, begin + 0.02 * k - time.monotonic()))
        angle = 25.0 * math.sin(2.0 * math.pi * k / 150)
        goal = {**here, "shoulder_pan.pos": here["shoulder_pan.pos"] + angle}
        robot.send_action(goal)
        seen = robot.get_observation()
        worst = max(worst, abs(seen["shoulder_pan.pos"] - goal["shoulder_pan.pos"]))
    took = time.monotonic() - begin
    check("50 Hz for 3 s, largest lag [deg]", worst < 15.0, f"{worst:.1f}, took {took:.2f} s")
    time.sleep(0.5)
    # The vendor's SDK keeps what came too late and takes it for the next answer.
    robot.bus.port_handler.ser.reset_input_buffer()
    back = robot.get_observation()["shoulder_pan.pos"] - here["shoulder_pan.pos"]
    check("back where it was [deg]", abs(back) < 2.0, f"{back:.2f}")


def main() -> None:
    """Run it all; ends with an error at the first thing that is wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--so101", default="so101", help="the command of this package")
    so101 = parser.parse_args().so101
    set_up_a_new_motor(so101)
    key = EnterKey()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "hand").write_text(hand())
        with emulated(so101, "--hand", str(folder / "hand")) as port:
            started = time.monotonic()
            robot = SO101Follower(
                SO101FollowerConfig(port=port, id="emulated", calibration_dir=folder)
            )
            calibrate(robot, key, started)
            check_configuration(robot)
            time.sleep(max(0.0, started + RELEASE + 1.0 - time.monotonic()))
            wave(robot)
            robot.disconnect()
            robot.connect()  # asks nothing: file and servos agree
            check("known again when connected anew", robot.is_calibrated, "no question asked")
            robot.bus.disable_torque()
            limp = robot.bus.sync_read("Torque_Enable", normalize=False)
            check("limp when asked to be", set(limp.values()) == {0}, set(limp.values()))
            robot.disconnect()
    print("LeRobot did not notice.")


if __name__ == "__main__":
    main()
