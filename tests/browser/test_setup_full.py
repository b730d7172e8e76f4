"""Full Setup in the browser, from new parts to the first move, with everything that goes wrong.

The tests are the chapters of one walk; at each step the user first does it wrong, and now and then
loads the page anew. The servos run in this process, so that a test can plug them in and lead their
joints; the page finds them on a port.
"""

import json
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from harness.browser_user import Guest
from harness.clocks import pace_arms_on_servos
from harness.emulated_kit import new_kit  # it lives with the tests of the module
from playwright.sync_api import TimeoutError
from so101_viewer.page import shared_fields
from so101_viewer.setup_app import serve_setup

from so101_motion.calib.motors.setup_view import SETUP_ORDER
from so101_motion.calib.procedure.summary import HOMING_POSE
from so101_motion.calib.record import store
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.drivers.emulator import registers as reg

PATIENCE = 0.1  # [s]; a servo is silent after eight of these: the browser needs a processor, too
SMALL = (760, 480)  # drawn without a GPU, every pixel takes its time
PHONE = {"width": 390, "height": 844}
WAYS = ("Next", "Back", "Abort the setup")
CLICK = "button => button.click()"  # not waiting for the scene to be drawn
ORANGE, GREEN = 0xF58200, 0x3CA050

POSE = {"wrist_roll": HOMING_POSE["wrist_roll"], GRIPPER_JOINT: 0.9}
OTHERS = tuple(joint for joint in HOMING_POSE if joint != "elbow_flex")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("a-servo-adapter-whose-name-is-as-long-as-those-in-by-id-are")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(folder / "home"))
        yield folder


@pytest.fixture(scope="module")
def kit(folder):
    with (
        pytest.MonkeyPatch.context() as patch,
        new_kit(folder, now=pace_arms_on_servos(patch.setattr).now) as kit,
    ):
        yield kit


@pytest.fixture(scope="module")
def app(folder, kit):
    kept = folder / "setup.json"
    with serve_setup(port=0, ports=[kit.port], reply_timeout=PATIENCE, progress_file=kept) as app:
        yield app


def angles(kit):
    """Where the joints are [rad]."""
    return np.array([servo.drive.q for servo in kit.world.servos])


class Newcomer:
    """Somebody at the page, who trusts it to lose nothing."""

    def __init__(self, guest):
        self.guest = guest

    def reloads(self, still):
        """Load the page anew; what it said is there again."""
        self.guest.page.reload()
        self.guest.until(lambda: self.guest.says(still), seconds=120.0)

    def presses(self, name):
        self.guest.until(lambda: self.can(name))
        self.guest.button(name).evaluate(CLICK)

    def double_clicks(self, name):
        """Press a button twice in a row with the mouse, as people do who need not."""
        button = self.guest.button(name)
        button.evaluate("button => button.scrollIntoView({block: 'center'})")
        box = button.bounding_box()
        assert box is not None
        self.guest.double_click(box["x"] + 0.5 * box["width"], box["y"] + 8.0)

    def sees(self, words):
        self.guest.until(lambda: self.guest.says(words))

    def insists(self, *names, until):
        """Press the buttons that can be pressed, again where a busy machine lost an answer."""

        def is_so():
            for name in names:
                if self.can(name) and not until():
                    with suppress(TimeoutError):  # it may go just now
                        self.guest.button(name).evaluate(CLICK, timeout=1000)
                    for _ in range(60):
                        if until():
                            return True
                        self.guest.page.wait_for_timeout(50)
            return until()

        self.guest.until(is_so, seconds=120.0)

    def can(self, name):
        button = self.guest.button(name)
        try:
            return button.count() == 1 and button.is_enabled(timeout=1000)
        except TimeoutError:  # it went between the two questions
            return False

    def color(self, name):
        look = "button => getComputedStyle(button).backgroundColor"
        return str(self.guest.button(name).evaluate(look))

    def sees_lit(self, link, colour):
        self.guest.until(lambda: self.guest.color_of(f"/setup/arm/{link}/") == colour)

    def bar(self, joint):  # in per cent
        meter = self.guest.page.get_by_role("meter", name=joint, exact=True)
        self.guest.until(lambda: meter.count() == 1)
        return float(meter.get_attribute("aria-valuenow") or "nan")

    def sweeps(self, kit, way, joints, until):
        """Lead joints along their travel, until the page has seen all of it."""
        kit.let_go()
        for begin, end in pairwise(way):
            kit.lead(_shares(begin, end), joints)
        self.sees(until)

    @staticmethod
    def is_in_view(part):
        """Whether the middle of a part of the page is there without scrolling, free of others."""
        seen = part.evaluate(
            "part => { const { left, width, top, height } = part.getBoundingClientRect();"
            " return part.contains("
            "document.elementFromPoint(left + width / 2, top + height / 2)); }"
        )
        return seen

    def hits_on_a_phone(self, *names, text=""):
        """Look at the page on a phone for a moment: buttons, and a text, are in view there."""
        parts = [self.guest.button(name) for name in names]
        if text:
            parts.append(self.guest.page.get_by_text(text).first)
        self.guest.page.set_viewport_size(PHONE)
        self.guest.until(lambda: all(map(self.is_in_view, parts)))
        self.guest.page.set_viewport_size({"width": SMALL[0], "height": SMALL[1]})

    def agrees(self):
        """Say that nothing is in the arm's way."""
        self.presses("Move and measure")
        self.presses("Is everything out of the way? Press again")


def _shares(begin, end):
    """A way along a joint's travel in small steps, with a rest at the end."""
    count = round(abs(end - begin) / 0.04)
    return [begin + (end - begin) * k / count for k in range(count + 1)] + [end] * 5


@pytest.fixture(scope="module")
def person(visit, app):
    guest = visit(SMALL)
    guest.page.goto(app.url)
    guest.until(lambda: guest.button("Full Setup").count() == 1)
    return Newcomer(guest)


def test_six_motors_get_their_ids_are_verified_and_the_arm_is_assembled(person, kit):
    person.presses("Full Setup")
    person.sees("no servo answers")  # and that is no obstacle yet
    person.presses("Next")
    person.sees("Connect only the motor of gripper, which opens and closes the jaw")
    person.sees_lit("moving_jaw_so101_v1_link", ORANGE)
    assert not person.can("Write id 6 to this motor")
    assert not person.can("Next")

    kit.plug_in("gripper", "wrist_roll")
    person.sees("Several servos answer")
    person.sees("unplug the others")
    assert not person.can("Write id 6 to this motor")

    kit.plug_in("gripper")
    write = "Write id 6 to this motor"
    person.guest.until(lambda: person.can(write))
    person.sees_lit("moving_jaw_so101_v1_link", GREEN)
    assert kit.ids.count(1) == 6, "nothing is written by finding it"
    person.insists(write, until=lambda: kit.ids[5] == 6 and not person.guest.button(write).count())
    assert kit.ids == [1, 1, 1, 1, 1, 6]
    person.sees("unplug the motor of gripper")
    for servo_id, joint in zip(range(5, 0, -1), SETUP_ORDER[1:], strict=True):  # in another program
        kit.world.servo(joint).memory.keep(reg.ID, servo_id)
        skip = person.guest.button(f"Skip {joint}")
        person.insists(f"Skip {joint}", until=lambda skip=skip: not skip.count())
    person.sees("All six motors are set up or skipped")
    person.presses("Next")

    person.sees("All six together")
    kit.plug_in(*SETUP_ORDER[1:])
    cable = "Check the cable between servos 5 and 6"
    person.insists("Verify all six", "Verify again", until=lambda: person.guest.says(cable))
    person.sees("Servo 6 (gripper) does not answer")
    person.hits_on_a_phone("Verify again", *WAYS, text=cable)
    person.sees_lit("moving_jaw_so101_v1_link", ORANGE)
    assert not person.can("Next")
    kit.plug_in(*SETUP_ORDER)
    person.reloads("Servo 6 (gripper) does not answer")
    person.insists("Verify again", until=lambda: person.can("Next"))
    person.double_clicks("Next")

    person.guest.page.wait_for_timeout(500)
    person.sees("Motor 1 turns the arm on its base")
    person.sees_lit("shoulder_link", ORANGE)
    person.guest.until(lambda: person.guest.barriers() == [])
    person.hits_on_a_phone("This joint is right", "Skip the check", *WAYS[1:])
    person.presses("This joint is right")
    person.sees("Motor 2 lifts the upper arm")
    person.sees("Still to check: shoulder_lift, elbow_flex")
    before = person.guest.pose_of("/setup/arm/upper_arm_link")
    person.guest.until(lambda: person.guest.pose_of("/setup/arm/upper_arm_link") != before)
    person.presses("Skip the check")


def test_an_arm_is_calibrated_by_hand_and_a_page_that_is_loaded_anew_has_lost_nothing(
    person, kit, folder
):
    person.sees("put one hand on the arm")
    assert not person.can("Next")
    kit.hold(elbow_flex=0.4)
    matches = "The blue ghost shows the pose"
    begins = ("Let go of the joints", "Start the calibration")
    person.insists(*begins, until=lambda: person.guest.says(matches))
    assert not any(kit.driven)
    person.sees("Torque off: the joints are limp")
    for name, why in (("Hold", "A calibration is under way: "), ("Let go", "The joints are limp")):
        person.guest.button(name).click(force=True)
        person.sees(f"{name}: {why}")
    person.guest.until(lambda: "/setup/ghost/gripper_link" in person.guest.nodes())

    assert not person.can("Next")
    kit.hold(**POSE)
    person.presses("Take it when I hold still")  # no hand is left for a button
    person.sees("The pose is taken")
    person.guest.until(lambda: person.can("Next"))
    assert not person.guest.button("Record").count()  # only Next shines
    assert person.color("Take the pose again") == person.color("Back") != person.color("Next")
    person.presses("Next")

    person.sees("Still to do: shoulder_pan, shoulder_lift")
    person.guest.until(lambda: person.guest.barriers() == [])
    person.hits_on_a_phone("Finish the recording", *WAYS)
    assert not person.can("Finish the recording")
    before = person.guest.pose_of("/setup/arm/lower_arm_link")
    kit.let_go()
    kit.lead((*_shares(0.5, 0.2), *_shares(0.2, 0.5), 0.2), ("elbow_flex",))
    person.guest.until(lambda: 25.0 < person.bar("elbow_flex") < 40.0)
    person.guest.until(lambda: person.guest.pose_of("/setup/arm/lower_arm_link") != before)
    person.reloads("Still to do: shoulder_pan, shoulder_lift")
    person.guest.until(lambda: 25.0 < person.bar("elbow_flex") < 40.0)  # nothing is lost

    person.sweeps(kit, (0.5, 0.0, 1.0, 0.5), OTHERS, until="Still to do: elbow_flex.")
    assert not person.can("Finish the recording")
    person.sweeps(kit, (0.2, 0.0, 1.0, 0.5), ("elbow_flex",), until="Put the arm down, then finish")
    person.presses("Finish the recording")
    person.guest.until(lambda: person.can("Next"))
    person.presses("Next")

    person.sees("Look at what was recorded")
    person.hits_on_a_phone("Save", *WAYS)
    person.guest.comes_to(6, person.guest.page.get_by_text("new", exact=True).count)
    person.presses("Save")
    person.sees("Saved:")
    file = next((folder / "home" / "so101_motion").glob("*_calibration.json"))
    person.sees(str(file))
    assert set(store.read(file).calibration) == set(HOMING_POSE)
    person.sees("Torque on: the joints are held")
    assert all(kit.driven)
    kit.let_go()


def test_the_arm_moves_only_when_the_way_is_clear_and_is_ready_to_use(person, kit, monkeypatch):
    monkeypatch.setattr(shared_fields, "ASKED_FOR", 60.0)  # a busy page answers late
    person.presses("Next")
    plans = "This will move:"  # planned anew where a busy machine had no time for it
    person.insists("Hold the joints", "Plan the test", until=lambda: person.guest.says(plans))
    person.presses("Guide by hand")
    person.sees("Guided by hand")
    person.sees("The arm yields to your hand. Move it by hand")
    person.guest.let_go(lambda: not any(kit.driven))
    person.sees("Torque off: the joints are limp")
    assert not person.can("Let go")
    person.insists("Hold", until=lambda: person.guest.says("This will move:"))
    person.agrees()
    person.sees("Moving shoulder_pan")
    person.guest.until(lambda: person.can("Stop the test"))
    person.guest.page.wait_for_timeout(400)
    person.guest.page.keyboard.press("Space")
    person.sees("was not finished")
    person.hits_on_a_phone("Test again", "Skip the test", "Back", "Abort the setup")
    pale = person.color("Back")
    person.guest.until(lambda: person.color("Skip the test") == pale)
    person.guest.until(lambda: person.color("Test again") != pale)  # only this shines
    person.sees("Torque on: the joints are held")
    assert all(kit.driven)
    person.presses("Skip the test")
    person.sees("devrel:so101:arm")
    person.guest.until(lambda: person.guest.barriers() == [])
    snippet = person.guest.page.locator("textarea").first.input_value()
    components = json.loads(snippet)["components"]
    assert components[0]["attributes"]["port"] == kit.port
    assert components[0]["attributes"]["calibration_file"].endswith("_calibration.json")
    with person.guest.page.expect_download() as download:
        person.presses("Save it as a file")
    assert json.loads(Path(download.value.path()).read_text()) == json.loads(snippet)
    person.presses("Open the arm's page")
    person.sees("The preview of the arm")

    link = person.guest.page.get_by_role("link", name="The preview of the arm")
    before = angles(kit)
    with person.guest.page.context.expect_page() as opened:
        link.evaluate("link => link.click()")
    preview = Newcomer(Guest(page=opened.value, problems=[], asked=[]))
    preview.presses("ready")
    preview.insists(
        "Hold", "Plan", "Execute", until=lambda: bool(np.abs(angles(kit) - before).max() > 0.3)
    )
    preview.guest.page.close()
    assert person.guest.problems == []
