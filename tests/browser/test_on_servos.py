"""Gripper and calibration on emulated servos: what they really do, and what the page says of it.

Page, threads and bus are real, but there is no browser.
"""

import pytest
from harness.browser_user import Servos
from harness.page_client import Hand
from so101_viewer import serve

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings

pytestmark = pytest.mark.emulator_only

WIDTH_MM = 30.0


@pytest.fixture
def servos(tmp_path, paced):
    with Servos(tmp_path / "arm", paced) as servos:
        yield servos


def test_what_the_jaw_holds_is_said_with_its_width_and_its_slider_sets_the_force(servos, paced):
    settings = ServoSettings(port=servos.port).with_arm(SERVO_IDS)
    servos.type("pose")  # somebody holds it up until it holds itself
    with open_hardware(settings, clock=paced) as rig, serve(rig, port=0) as preview:
        rig.arm.set_torque(True)
        servos.type("end pose")
        hand, pressed = Hand(preview), []
        for force in (100, 60):
            hand.enter("Grip force (%)", force)
            hand.until(lambda force=force: rig.gripper.force == pytest.approx(0.01 * force))
            hand.enter("Opening (%)", 100)
            hand.until(lambda: rig.gripper.aperture > 0.97)
            hand.expect("Holding nothing, ")
            servos.type(f"object={WIDTH_MM / 1000.0}")
            hand.enter("Opening (%)", 0)
            hand.expect("Holding something: the tips are ")
            width_mm = float(hand.words().partition("the tips are ")[2].split()[0])
            assert width_mm == pytest.approx(WIDTH_MM, abs=3.0)
            since = paced.now()
            hand.until(lambda since=since: paced.now() > since + 1.0)
            state = rig.arm.state
            pressed.append(state.q_jaw - state.q_jaw_ref)  # how far it is sent into the thing
        assert pressed[1] < pressed[0]  # how much: tests/unit/arm/test_gripper.py
        servos.type("end object")  # it slips out
        hand.expect("Holding nothing, ")


def test_a_file_that_the_servos_do_not_hold_is_refused_and_can_be_stored_from_the_page(
    servos, tmp_path, paced
):
    entries = {
        joint: JointCalibration(id=i, homing_offset=40 * (joint == "elbow_flex"))
        for i, joint in enumerate(JOINTS, start=1)
    }
    file = tmp_path / "other.json"
    store.save(file, entries)

    def stored():
        with servos.world.lock:
            return [bytes(servo.memory.flash) for servo in servos.world.servos]

    before = stored()
    asked = ServoSettings(port=servos.port, timeout=None, calibration_file=file)
    with open_hardware(asked, clock=paced) as rig, serve(rig, port=0) as preview:
        hand = Hand(preview)
        hand.press("Hold")
        hand.expect("is not the calibration that the servos on")
        assert rig.arm.state.mode is not Mode.HOLDING
        assert stored() == before
        hand.press("Store the file")
        hand.until(lambda: not hand.has("Store the file"))
        hand.press("Hold")
        hand.until(lambda: rig.arm.state.mode is Mode.HOLDING)
        assert rig.servos.calibration["elbow_flex"].homing_offset == 40
        assert stored() != before
