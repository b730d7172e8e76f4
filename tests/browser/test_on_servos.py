"""Gripper and programs on emulated servos: what they really do, and what the page says of it."""

import pytest
from harness.browser_user import Servos
from so101_viewer import serve

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.servo_driver import ServoSettings

WIDTH_MM = 30.0


@pytest.fixture(scope="module")
def servos(tmp_path_factory, paced):
    with Servos(tmp_path_factory.mktemp("port") / "arm", paced) as servos:
        servos.type("pose")  # somebody holds it up until it holds itself
        yield servos


@pytest.fixture(scope="module")
def arm_on_port(servos, paced):
    settings = ServoSettings(port=servos.port).with_arm(SERVO_IDS)
    with open_hardware(settings, clock=paced) as rig:
        rig.arm.set_torque(True)
        servos.type("end pose")
        yield rig


@pytest.fixture(scope="module")
def page_of_it(arm_on_port):
    with serve(arm_on_port, port=0) as preview:
        yield preview


@pytest.fixture(scope="module")
def window(visit, page_of_it):
    guest = visit()
    guest.open(page_of_it.url)
    return guest


@pytest.fixture
def guest(window, arm_on_port, servos):
    """A window on an arm whose jaw is empty."""
    window.page.get_by_role("tab", name="Move", exact=True).click()
    yield window
    servos.type("end object")


def test_what_the_jaw_holds_is_said_with_its_width_and_its_slider_sets_the_force(
    guest, arm_on_port, servos
):
    opening = guest.page.get_by_role("slider", name="Opening (%)")
    force = guest.page.get_by_role("slider", name="Grip force (%)")
    pressed = []
    for end in ("End", "Home"):
        force.press(end)
        opening.press("End")
        guest.until(lambda: arm_on_port.gripper.aperture > 0.97)
        guest.until(lambda: guest.says("Holding nothing, "))
        servos.type(f"object={WIDTH_MM / 1000.0}")
        opening.press("Home")
        guest.until(lambda: guest.says("Holding something: the tips are "))
        words = guest.page.get_by_text("Holding something: the tips are ").inner_text()
        width_mm = float(words.split(" mm")[0].split()[-1])
        assert abs(width_mm - WIDTH_MM) < 3.0
        guest.page.wait_for_timeout(1000)
        state = arm_on_port.arm.state
        pressed.append(state.q_jaw - state.q_jaw_ref)  # how far it is sent into the thing
    assert pressed[1] < pressed[0]  # how much: tests/unit/arm/test_gripper.py
    force.press("End")
    servos.type("end object")  # it slips out
    guest.until(lambda: guest.says("Holding nothing, "))


def test_a_file_that_the_servos_do_not_hold_is_refused_and_can_be_stored_from_the_page(
    visit, tmp_path, paced
):
    entries = {
        joint: JointCalibration(id=i, homing_offset=40 * (joint == "elbow_flex"))
        for i, joint in enumerate(JOINTS, start=1)
    }
    file = tmp_path / "other.json"
    store.save(file, entries)
    emulator = Servos(tmp_path / "arm", paced)

    def stored():
        with emulator.world.lock:
            return [bytes(servo.memory.flash) for servo in emulator.world.servos]

    before = stored()
    asked = ServoSettings(port=str(tmp_path / "arm"), timeout=None, calibration_file=file)
    with emulator, open_hardware(asked, clock=paced) as rig, serve(rig, port=0) as preview:
        guest = visit()
        guest.open(preview.url)
        guest.until(lambda: guest.button("Hold").is_enabled())
        for tab in guest.page.get_by_role("tab").all():
            if tab.is_visible():
                tab.click()
        guest.press("Hold")
        guest.until(lambda: guest.says("is not the calibration that the servos on"))
        assert rig.arm.state.mode is not Mode.HOLDING
        assert stored() == before
        guest.press("Store the file")
        asks = guest.page.locator("#so101-buttons .asks")
        guest.until(lambda: asks.count() == 1)
        guest.page.wait_for_timeout(700)
        asks.click()
        guest.until(lambda: guest.button("Store the file").count() == 0)
        guest.press("Hold")
        guest.until(lambda: rig.arm.state.mode is Mode.HOLDING)
        assert rig.servos.calibration["elbow_flex"].homing_offset == 40
        assert stored() != before
        guest.leave()
