"""Calibrate an arm and set up its motors, asking a person as LeRobot's own driver does.

But a joint that was not moved to its stops is refused by name, and zeros are saved as well.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from so101_motion.calib.record import lerobot
from so101_motion.calib.record.record import JOINTS, SERVO_IDS
from so101_motion.common.errors import CalibrationError, MotorSetupError, So101Error
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.setup.calibrator import Calibrator

Opener = Callable[[ServoSettings], HardwareRig]

MIDDLE = (
    "Move {name} to the middle of its range of motion (upper arm upright, forearm and gripper level"
    " and straight ahead, the gripper turned so that it opens upwards) and press ENTER...."
)
TRAVEL = (
    "Move all joints slowly through their entire ranges of motion, to both stops.\n"
    "Recording positions. Press ENTER to stop..."
)


def calibrate(port: str, file: Path, *, name: str, open_rig: Opener) -> None:
    """Calibrate the arm and save to ``file``; if that exists, the person may keep it instead.

    The arm is open and holds afterwards. ``RuntimeError`` if it was not calibrated; its servos have
    their previous settings.
    """
    if file.is_file():
        answer = input(
            f"Press ENTER to use provided calibration file associated with the id of {name}, or"
            " type 'c' and press ENTER to run calibration: "
        )
        if answer.strip().lower() != "c":
            return
    calibrator = Calibrator.open(port, file, open_rig=open_rig)
    try:
        _go_through(calibrator, name)
        lerobot.export(calibrator.save().calibration, file)
    except So101Error as error:
        raise RuntimeError(f"{name} was not calibrated: {error}") from error
    finally:
        calibrator.close()
    print("Calibration saved to", file)


def set_up_motors(port: str, file: Path, open_rig: Opener) -> None:
    """Give the motors on a closed ``port`` their ids, from the gripper to the shoulder."""
    calibrator = Calibrator.open(port, file, open_rig=open_rig)
    try:
        for joint in reversed(JOINTS):
            while not _is_set_up(calibrator, joint):
                pass
            print(f"'{joint}' motor id set to {SERVO_IDS[joint]}")
    finally:
        calibrator.close()


def _go_through(calibrator: Calibrator, name: str) -> None:
    calibrator.start()
    input(MIDDLE.format(name=name))
    calibrator.set_homing()
    calibrator.start_recording()
    print(TRAVEL)
    while True:
        input()
        try:
            calibrator.stop_recording()
        except CalibrationError as error:
            print(f"{error}. Press ENTER again then...")
        else:
            return


def _is_set_up(calibrator: Calibrator, joint: str) -> bool:
    input(f"Connect the controller board to the '{joint}' motor only and press enter.")
    try:
        calibrator.motors.discover(joint)
        calibrator.motors.assign(joint)
    except MotorSetupError as error:
        print(error)
        return False
    return True
