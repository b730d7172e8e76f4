"""``so101 emulate``: an arm with 7.4 V servos, and with those of an identified arm (``--like``)."""

import subprocess
import sys
import time

from so101_motion.calib.record import servo_file
from so101_motion.calib.record.servo_file import ServoRecord
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.ticks import TICKS_PER_RAD
from so101_motion.drivers.port.serial_port import SerialPort
from so101_motion.drivers.servo_types import ServoFigures

STEP = round(0.5 * TICKS_PER_RAD)
WRIST_ROLL, GRIPPER = 5, 6


def short_of_goal(bus, servo_id):
    """How many ticks short of its goal a servo without weight comes to rest after a step."""
    begin = at = bus.read(servo_id, reg.PRESENT_POSITION)
    goal = begin + STEP
    bus.write(servo_id, reg.GOAL_POSITION, goal)
    bus.write(servo_id, reg.TORQUE_ENABLE, 1)
    rests_since = time.monotonic()
    while at < begin + STEP // 2 or time.monotonic() - rests_since < 0.3:
        before, at = at, bus.read(servo_id, reg.PRESENT_POSITION)
        if at != before:
            rests_since = time.monotonic()
    return goal - at


def test_a_twin_has_the_supply_of_its_type_and_the_servos_of_the_file(tmp_path):
    stiff = {"wrist_roll": ServoFigures(torque=1.0, friction=3.0)}
    found = ServoRecord(at="2026-03-05", volts=7.4, servos=stiff)
    file = servo_file.save(tmp_path / "my_arm.json", found)
    link = str(tmp_path / "arm")
    command = [sys.executable, "-m", "so101_motion.cli", "emulate", "--link", link]
    command += ["--volts", "7.4", "--like", str(file)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline().decode().strip() == link
            bus = Bus(SerialPort(link), reply_timeout=2.0)
            assert bus.read(GRIPPER, reg.PRESENT_VOLTAGE) in (73, 74)
            assert bus.read(GRIPPER, reg.MAX_VOLTAGE) == 80
            assert short_of_goal(bus, WRIST_ROLL) > 10, "friction holds it; 1 tick without the file"
            assert short_of_goal(bus, GRIPPER) < 5, "as its type"
            bus.close()
        finally:
            process.terminate()
