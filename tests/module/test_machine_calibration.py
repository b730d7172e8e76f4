"""The setup page's calibration of a machine's arm: through the sensor of a real module process."""

import threading

import pytest
from harness.emulated_kit import Kit
from harness.fake_parent import CALIBRATION, SENSOR
from harness.viam_machine import SIM, running_machine, until_true

from so101_motion.common.errors import MachineRefused, MachineUnavailable
from so101_motion.common.operation import RemoteOperation
from so101_motion.viam.client import MachineRig

PAUSE = threading.Event()


def resources(port, file):
    """What the machine has: the sensor is on the servos, and its arm is simulated."""
    return (*SIM, (SENSOR, CALIBRATION, "calibration", {"port": port, "calibration_file": file}))


def test_an_arm_is_calibrated_over_the_network_and_the_network_may_fail(tmp_path):
    kit = Kit(tmp_path)
    kit.put(0.5)
    try:
        with (
            running_machine(resources=resources(kit.port, str(tmp_path / "arm.json"))) as machine,
            MachineRig.connect(machine.address) as rig,
        ):
            calibrator = RemoteOperation(
                lambda request: rig.do_command("calibration", request), "calibration"
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
    until_true(lambda: rig.readings("calibration")[reads] >= begin + 3)


def calibrate(operation, kit, machine, rig):
    assert operation.view.state == "idle"
    with pytest.raises(MachineRefused, match="set_homing"):
        operation.ask("set_homing")

    operation.ask("start")
    assert operation.view.state == "started"
    assert not any(kit.driven)
    kit.let_go()
    operation.ask("take_pose")
    until_true(lambda: operation.view.offer("set_homing").due_in == 0.0)
    operation.ask("set_homing")
    operation.ask("start_range_recording")
    for share in (0.5, 0.45, 0.4, 0.35, 0.3):
        kit.put(share)
        see(rig)

    def elbow():
        return operation.view.facts["joints"]["elbow_flex"]

    until_true(lambda: elbow()["verdict"] == "too_short")
    with pytest.raises(MachineRefused, match="elbow_flex"):
        operation.ask("stop_range_recording")

    machine.cut()
    until_true(lambda: not operation.view.is_connected)
    assert "127.0.0.1" in operation.view.trouble
    with pytest.raises(MachineUnavailable):
        operation.ask("save_calibration")
    machine.mend()
    until_true(lambda: operation.view.is_connected)
    assert operation.view.state == "range_recording", "it went on over there"

    while operation.view.offer("stop_range_recording").why_not is not None:
        PAUSE.wait(kit.sweep())  # to its end: where the hand stops later is outside what was seen
    operation.ask("stop_range_recording")
    ended = operation.ask("save_calibration")
    assert ended["torque_enabled"]
    assert ended["joints_calibrated"] == 6
    assert all(kit.driven)
    assert operation.view.is_over
    assert operation.view.facts["holds"]
