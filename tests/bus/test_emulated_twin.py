"""``so101 emulate``: an arm with 7.4 V servos, or with those of an identified arm (``--like``)."""

import subprocess
import sys
import time
from contextlib import contextmanager

from so101_motion.calib.record import servo_file
from so101_motion.calib.record.servo_file import ServoRecord
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.ticks import TICKS_PER_RAD
from so101_motion.drivers.port.serial_port import SerialPort
from so101_motion.drivers.servo_types import ServoFigures

STEP = round(0.5 * TICKS_PER_RAD)
WRIST_ROLL, GRIPPER = 5, 6


@contextmanager
def emulated(link, *options):
    command = [sys.executable, "-m", "so101_motion.cli", "emulate", "--link", str(link), *options]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline().decode().strip() == str(link)
            bus = Bus(SerialPort(str(link)), reply_timeout=2.0)
            yield bus
            bus.close()
        finally:
            process.terminate()
            process.wait(60.0)


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


def test_servos_for_7_4_volts_report_their_supply_and_its_limit(tmp_path):
    with emulated(tmp_path / "arm", "--volts", "7.4") as bus:
        assert bus.read(GRIPPER, reg.PRESENT_VOLTAGE) in (73, 74)
        assert bus.read(GRIPPER, reg.MAX_VOLTAGE) == 80


def test_a_twin_has_the_servos_of_the_file_and_no_others(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    stiff = {"wrist_roll": ServoFigures(torque=0.5, friction=5.0)}
    found = ServoRecord(at="2026-03-05", volts=12.0, servos=stiff)
    file = servo_file.save(tmp_path / "my_arm.json", found)
    with emulated(tmp_path / "arm", "--like", str(file)) as bus:
        assert short_of_goal(bus, WRIST_ROLL) > 10, "friction holds it; 1 tick without the file"
        assert short_of_goal(bus, GRIPPER) < 5, "as its type"


def test_a_file_that_holds_no_servos_is_refused(tmp_path):
    file = tmp_path / "my_arm.json"
    file.write_text("{}")
    command = [sys.executable, "-m", "so101_motion.cli", "emulate", "--like", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode != 0
    assert 'holds no "servos"' in done.stderr
    assert "identify the arm again" in done.stderr
