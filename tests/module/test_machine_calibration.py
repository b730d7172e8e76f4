"""The setup page's calibration of a machine's arm: through the sensor of a real module process."""

import threading
import time

import pytest
from harness.emulated_kit import Kit
from harness.fake_parent import CALIBRATION, SENSOR
from harness.viam_machine import SIM, running_machine
from so101_viewer.setup.machine import MachineCalibrator

from so101_motion.calib.procedure.steps import Command, State
from so101_motion.calib.procedure.travel_assessment import Verdict
from so101_motion.calib.record.record import JOINTS
from so101_motion.common.errors import MachineRefused, MachineUnavailable
from so101_motion.viam.client import MachineRig

PAUSE = threading.Event()


def resources(port, file):
    """What the machine has: the sensor is on the servos, and its arm is simulated."""
    return (*SIM, (SENSOR, CALIBRATION, "calibration", {"port": port, "calibration_file": file}))


def until(condition, seconds=60.0):
    """Wait for ``condition``: the machine is another process, whose time is real."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come true"
        PAUSE.wait(0.02)


@pytest.mark.slow
def test_an_arm_is_calibrated_over_the_network_and_the_network_may_fail(tmp_path):
    kit = Kit(tmp_path)
    kit.put(0.5)
    try:
        with (
            running_machine(resources=resources(kit.port, str(tmp_path / "arm.json"))) as machine,
            MachineRig.connect(machine.address) as rig,
        ):
            calibrator = MachineCalibrator(
                lambda command: rig.do_command("calibration", command),
                lambda: rig.readings("calibration"),
                set_torque=rig.arm.set_torque,
            )
            try:
                calibrate(calibrator, kit, machine, rig)
            finally:
                calibrator.close()
    finally:
        kit.close()


def see(rig):
    """Wait until the joints have been read a few times more."""
    reads = "position_samples"
    begin = rig.readings("calibration")[reads]
    until(lambda: rig.readings("calibration")[reads] >= begin + 3)


def calibrate(calibrator, kit, machine, rig):
    assert calibrator.situation.view.state is State.IDLE
    with pytest.raises(MachineRefused, match="set_homing"):
        calibrator.step(Command.SET_HOMING)

    calibrator.step(Command.START)
    assert calibrator.situation.view.state is State.STARTED
    assert not any(kit.driven)
    calibrator.step(Command.SET_HOMING)
    calibrator.step(Command.START_RECORDING)
    kit.let_go()
    for share in (0.5, 0.45, 0.4, 0.35, 0.3):
        kit.put(share)
        see(rig)
    until(lambda: calibrator.situation.joints["elbow_flex"].verdict is Verdict.TOO_SHORT)
    with pytest.raises(MachineRefused, match="elbow_flex"):
        calibrator.step(Command.STOP_RECORDING)

    machine.cut()
    until(lambda: not calibrator.situation.is_connected)
    assert "127.0.0.1" in calibrator.situation.view.error
    with pytest.raises(MachineUnavailable):
        calibrator.step(Command.SAVE)
    machine.mend()
    until(lambda: calibrator.situation.is_connected)
    assert calibrator.situation.view.state is State.RECORDING, "it went on over there"

    while not all(view.is_done for view in calibrator.situation.joints.values()):
        PAUSE.wait(kit.sweep())  # to its end: where the hand stops later is outside what was seen
    calibrator.step(Command.STOP_RECORDING)
    ended = calibrator.step(Command.SAVE)
    assert ended.holds
    assert set(ended.stored.calibration) == set(JOINTS)
    assert all(kit.driven)
    assert calibrator.situation.view.state is State.IDLE
    assert calibrator.situation.holds
