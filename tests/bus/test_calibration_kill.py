"""kill -9 while a process calibrates: what the servos and the file hold afterwards."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from so101_motion.calib.procedure import journal
from so101_motion.calib.procedure.eeprom import HeldCalibration, read_held
from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS, SERVO_IDS
from so101_motion.drivers.emulator import registers as emulated
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.servo_driver import ServoSettings

PATIENCE = 0.2
"""Above what a busy machine takes to run the emulator's thread [s]."""

PROCESS = Path(__file__).parents[1] / "harness" / "calibrating_process.py"
STEPS = ("start", "set_homing", "start_recording", "sweep", "stop_recording")


class Workshop:
    """An emulated arm, and a process that calibrates it until it is killed.

    Attributes:
        file: The calibration file.
    """

    def __init__(self, folder, home):
        self.file, self.port = folder / "arm.json", str(folder / "port")
        self.emulator = Emulator(EmulatorOptions(link=folder / "port", calibrated=False))
        self._process = subprocess.Popen(
            [sys.executable, str(PROCESS), self.port, str(self.file)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
            env={**os.environ, "XDG_DATA_HOME": home, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        self._child = 0

    def begin(self):
        """A new calibration in a new process."""
        self._child = int(self._ask("begin"))

    def do(self, *steps):
        """Let it do these steps; how far it is then."""
        for step in steps:
            said = self._sweep() if step == "sweep" else self._ask(step)
        return said

    def save_until(self, joint):
        """Let it save until that joint's servo holds its new limits."""
        memory = self.emulator.world.servo(joint).memory
        before = memory.raw(emulated.MAX_POSITION)
        self._process.stdin.write("save\n")
        until = time.monotonic() + 20.0
        while memory.raw(emulated.MAX_POSITION) == before:
            assert time.monotonic() < until, "nothing is saved"

    def kill(self):
        os.kill(self._child, signal.SIGKILL)
        assert self._process.stdout.readline() == "gone\n"

    def put(self, share):
        """Put all joints at this share of their travel."""
        with self.emulator.world.lock:
            for servo in self.emulator.world.servos:
                shaft = servo.drive.shaft
                shaft.put(round(shaft.lower + share * (shaft.upper - shaft.lower)))

    def look(self):
        """What a new process that moves the arm finds: in the servos, and in the file."""
        ids = {"servo_ids": (1, 2, 3, 4, 5), "gripper_id": 6}
        settings = ServoSettings(port=self.port, timeout=0.0, calibration_file=self.file, **ids)
        with open_hardware(settings, reply_timeout=PATIENCE) as rig, rig.lend_bus("a look") as loan:
            servos = loan.call(
                lambda bus: {joint: read_held(bus, SERVO_IDS[joint]) for joint in JOINTS}
            )
            in_use = rig.servos.calibration
        said = dict(store.read(self.file).calibration) if self.file.exists() else None
        assert not journal.path_for(self.file).exists()
        assert said is None or in_use == said
        return servos, said

    def close(self):
        self._process.kill()
        self._process.wait()
        self._process.stdin.close()
        self._process.stdout.close()
        self.emulator.close()

    def _sweep(self):
        for share in (0.0, 0.4, 0.8, 1.0, 0.6):
            self.put(share)
            said = self._ask("look")
        return said

    def _ask(self, step):
        self._process.stdin.write(f"{step}\n")
        return self._process.stdout.readline().strip()


@pytest.fixture
def workshop(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    workshop = Workshop(tmp_path, str(tmp_path / "home"))
    yield workshop
    workshop.close()


def test_a_killed_calibration_ends_with_the_former_or_with_the_new_one(workshop):
    new = ({joint: HeldCalibration(homing_offset=0) for joint in JOINTS}, None)  # as delivered
    for after in range(1, len(STEPS) + 1):
        workshop.put(0.45)
        workshop.begin()
        workshop.do(*STEPS[:after])
        workshop.kill()
        assert workshop.look() == new

    workshop.put(0.55)
    workshop.begin()
    workshop.do(*STEPS)
    workshop.save_until("shoulder_pan")  # five servos are left, and the file
    workshop.kill()
    servos, said = workshop.look()
    assert said is not None
    assert servos == {joint: HeldCalibration.of(said[joint]) for joint in JOINTS}

    workshop.put(0.3)
    workshop.begin()
    assert workshop.do(*STEPS, "save") == "idle"
    workshop.kill()
    again, said_again = workshop.look()
    assert said_again != said
    assert again == {joint: HeldCalibration.of(said_again[joint]) for joint in JOINTS}
