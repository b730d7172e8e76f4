"""Motor Setup Only and Calibration Only from end to end, on a port and through a machine.

The pages, their threads, the bus and the module are real, but there is no browser: see
``test_setup_full.py``.
"""

from contextlib import closing

import numpy as np
import pytest
from harness.emulated_kit import Kit, new_kit  # the module's own helpers
from harness.fake_parent import CALIBRATION, SENSOR
from harness.page_client import Hand
from harness.viam_machine import running_machine
from so101_viewer import serve as serve_preview
from so101_viewer import serve_setup

from so101_motion.calib.motors.setup_view import SETUP_ORDER
from so101_motion.calib.record import store
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings

pytestmark = pytest.mark.emulator_only

PATIENCE = 0.03
"""Above what a busy machine takes to run the emulator's thread [s]."""

UNDO = "Undo: restore the previous calibration"
TARGETS = {joint: 6 - place for place, joint in enumerate(SETUP_ORDER)}


@pytest.fixture
def kit(tmp_path):
    with new_kit(tmp_path) as kit:
        yield kit


def id_of(kit, joint):
    return int(kit.world.servo(joint).servo_id)


def set_up(hand, kit, joint):
    """Plug one motor in, and press the button once it is found."""
    button = f"Write id {TARGETS[joint]} to this motor"
    pressed = []  # a motor that was set up before has its id already

    def is_done():
        if hand.can(button):  # again, if a busy computer has lost an answer
            hand.press(button)
            pressed.append(button)
        return bool(pressed) and id_of(kit, joint) == TARGETS[joint] and not hand.has(button)

    kit.plug_in(joint)
    hand.until(is_done, f"setting {joint} up", seconds=60.0)


def skip(hand, joint):
    """Skip a motor; again where a busy page has dropped the press."""
    button = f"Skip {joint}"

    def is_skipped():
        hand.press(button)
        hand.until_or(lambda: not hand.has(button), seconds=5.0)
        return not hand.has(button)

    hand.until(is_skipped, button)


def finish(hand):
    """Verify until all is set up correctly, then end the workflow."""

    def is_ended():
        for button in ("Finish", "Verify all six", "Verify again"):
            if hand.can(button):
                hand.press(button)
                break
        return hand.says("All done.")

    hand.until(is_ended, "finishing", seconds=60.0)


def test_a_preview_of_an_arm_on_a_port_has_the_setup_beside_it(tmp_path):
    settings = ServoSettings(port=str(tmp_path / "arm")).with_arm(SERVO_IDS)
    with (
        Emulator(EmulatorOptions(link=tmp_path / "arm")),
        open_hardware(settings, reply_timeout=PATIENCE) as rig,
        serve_preview(rig, port=0) as preview,
    ):
        hand = Hand(preview)
        hand.press("Calibration Only")
        hand.expect("Step 1 of 7")
        hand.press("Next")
        hand.until(lambda: hand.can("Next"), "going on")
        hand.press("Abort the setup")
        hand.press("Press again to abort")
        hand.expect("Aborted: nothing was changed, and nothing was moved")
        assert rig.arm.state.mode is Mode.HOLDING


def test_the_motors_of_a_machine_are_set_up_through_its_calibration_sensor(kit, tmp_path):
    from so101_motion.viam.client import Machine

    has = ((SENSOR, CALIBRATION, "calibration", {"port": kit.port}),)  # no arm yet
    with (
        running_machine(resources=has) as machine,
        Machine.connect(machine.address) as connected,
        serve_setup(port=0, machine=connected, progress_file=tmp_path / "setup.json") as app,
    ):
        hand = Hand(app)
        hand.press("Motor Setup Only")
        hand.press("Next")
        kit.plug_in("gripper", "wrist_roll")
        hand.expect("Several servos answer")
        set_up(hand, kit, "gripper")
        for joint in SETUP_ORDER[1:]:
            skip(hand, joint)
            kit.world.servo(joint).memory.keep(reg.ID, TARGETS[joint])
        hand.press("Next")
        kit.plug_in(*SETUP_ORDER)
        finish(hand)
        assert not (tmp_path / "setup.json").exists()


def calibrate(hand, kit, middle, begin="Let go of the joints"):
    """From the page of the homing pose to the summary; the pose is a share of each travel."""

    def is_begun():  # on a busy machine a question expires, and answers come too late: "Start"
        for button in (
            begin,
            "Start the calibration",
            "Press again: the joints go limp",
            "Start again",
        ):
            if hand.can(button):
                hand.press(button)
        return hand.says("The blue ghost shows the pose")

    hand.until(is_begun, begin)
    assert not any(kit.driven)
    kit.put(middle)
    hand.press("I hold it there")
    hand.expect("The pose is taken")
    hand.press("Next")
    hand.expect("Still to do: shoulder_pan, shoulder_lift")
    for way in ((middle, 0.0), (0.0, 1.0), (1.0, middle)):
        kit.lead((*np.linspace(*way, 24), way[1], way[1]))
    hand.until(lambda: hand.can("Finish the recording"), "Finish the recording")
    hand.press("Finish the recording")
    hand.press("Next")
    hand.expect("Look at what was recorded")


def all_six_answer(hand):
    """Whether the page has seen them; on a busy machine answers come late, and it offers this."""
    if hand.says("All six servos are set up correctly"):
        return True
    if hand.can("Verify again"):
        hand.press("Verify again")
    return False


def is_saved(hand, file):
    """Whether the page says so; if a busy machine kept a servo from answering, it offers this."""
    if hand.can("Try to save again"):
        hand.press("Try to save again")
    return hand.says(f"Saved: {file}")


def test_a_machines_arm_is_calibrated_and_that_is_undone_through_its_sensor(tmp_path):
    from so101_motion.viam.client import Machine

    file = tmp_path / "machine.json"
    with closing(Kit(tmp_path)) as kit:
        attributes = {"port": kit.port, "calibration_file": str(file)}
        has = ((SENSOR, CALIBRATION, "calibration", attributes),)  # no arm yet
        with (
            running_machine(resources=has, is_patient=True) as machine,
            Machine.connect(machine.address) as connected,
            serve_setup(port=0, machine=connected, progress_file=tmp_path / "setup.json") as app,
        ):
            hand = Hand(app)
            hand.press("Calibration Only")
            hand.expect("Step 1 of 7")
            hand.press("Next")
            hand.until(lambda: all_six_answer(hand))
            hand.press("Next")
            calibrate(hand, kit, 0.5)
            hand.press("Save")
            hand.until(lambda: is_saved(hand, file))
            assert not hand.has(UNDO)  # there was none before
            first = store.read(file).calibration
            assert all(kit.driven)

            hand.press("Back")
            hand.press("Back")
            calibrate(hand, kit, 0.4, "Calibrate again")
            hand.press("Save")
            hand.until(lambda: is_saved(hand, file))
            assert store.read(file).calibration != first
            hand.press(UNDO)
            hand.expect(f"The previous calibration is restored: {file}")
            assert store.read(file).calibration == first
            assert kit.offsets == {joint: entry.homing_offset for joint, entry in first.items()}

            hand.press("Next")
            hand.expect("This arm cannot be moved from here")
            hand.press("Next")
            hand.expect("The machine uses it already")
            hand.press("Finish")
            hand.expect("All done.")
