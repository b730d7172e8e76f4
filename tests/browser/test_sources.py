"""How the page connects to its arm, and what it shows when the arm is not there or not well."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from harness.browser_user import Servos
from harness.fake_parent import ARM, SIMULATED
from harness.viam_machine import running_machine  # it lives with the tests of the machine
from so101_viewer import Source, serve_source

from so101_motion.calib.record import store
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.servo_driver import ServoSettings

SMALL = (1120, 700)
BASE = "/live/base_link/"
OUTSIDE = 100  # [tick] that the wrist's roll is outside its range when the arm is found


class Cable:
    """A page on a port with an emulated arm, which can be pulled out and put in."""

    def __init__(self, port, clock):
        self.port, self.rigs, self._servos = str(port), [], Servos(port, clock)
        self._clock = clock
        self.type = self._servos.type
        self.type("pose")  # somebody holds it up until it holds itself
        self.type("unplug")
        self.preview = serve_source(Source(title=f"Arm on {port}", open=self._open), port=0)

    def _open(self):
        file = Path(f"{self.port}.json")
        settings = ServoSettings(port=self.port).with_arm(SERVO_IDS)
        if not file.exists():
            with open_hardware(settings, clock=self._clock) as rig:
                calibration = dict(rig.servos.calibration)
            aside = 2048 + OUTSIDE  # the hand holds it at 2048
            calibration["wrist_roll"] = replace(calibration["wrist_roll"], range_min=aside)
            store.save(file, calibration)
            looks = ServoSettings(port=self.port, calibration_file=file)
            with open_hardware(looks, clock=self._clock) as rig:
                rig.write_calibration()
        settings = replace(settings, calibration_file=file)
        self.rigs.append(open_hardware(settings, clock=self._clock))
        return self.rigs[-1]

    @property
    def q(self):
        return self.rigs[-1].arm.state.q

    def close(self):
        self.preview.close()
        self._servos.close()


@pytest.fixture(scope="module")
def cable(tmp_path_factory, paced):
    cable = Cable(tmp_path_factory.mktemp("port") / "arm", paced)
    yield cable
    cable.close()


@pytest.fixture(scope="module")
def in_background(visit, cable):
    """A window on the arm of the cable."""
    guest = visit(SMALL)
    guest.page.goto(cable.preview.url)
    return guest


def test_an_arm_on_a_port_comes_goes_and_comes_back_without_moving(in_background, cable):
    guest = in_background
    guest.until(lambda: guest.says("Still looking"))
    keeps_looking = "This page keeps looking for the arm"
    guest.until(lambda: guest.says(keeps_looking))
    guest.until(lambda: guest.says(f"Arm on {cable.port}"))
    assert guest.button("Plan").count() == 0

    cable.type("end unplug")
    guest.see_the_arm()
    guest.until(lambda: guest.says("12.0"))  # volts
    guest.until(lambda: not guest.says("Still looking"))
    guest.until(lambda: not guest.says(keeps_looking))
    in_color = guest.color_of(BASE)
    guest.until(lambda: guest.says("Outside its range: wrist_roll by"))
    guest.until(lambda: guest.color_of("/live/gripper_link/") != in_color)
    cable.type("end pose")
    before = cable.q

    cable.type("unplug")
    guest.until(lambda: guest.says("Lost the arm on"))
    guest.until(lambda: guest.color_of(BASE) != in_color)
    guest.until(lambda: guest.button("Plan").is_disabled())

    cable.type("end unplug")
    guest.until(lambda: guest.says("Connected again. Nothing moves. Press Hold to go on."))
    assert "no such port" not in guest.page.locator("#so101-alerts").inner_text()
    guest.until(lambda: guest.color_of(BASE) == in_color)
    guest.until(lambda: guest.button("Plan").is_disabled())
    guest.press("Hold")
    guest.until(lambda: guest.says("Idle, holding"))
    guest.until(lambda: not guest.says("press Hold"))
    np.testing.assert_allclose(cable.q, before, atol=0.06)  # an arm held anew sags a little
    guest.page.get_by_role("tab", name="Events").click()
    guest.until(lambda: guest.says("is back; nothing moves until you ask"))
    assert guest.problems == []


FAST = {"speed_degs_per_sec": 90.0, "acceleration_degs_per_sec_per_sec": 400.0}
PAIR = (
    (ARM, SIMULATED, "leader", FAST),
    (ARM, SIMULATED, "arm", FAST),
    ("rdk:service:generic", "devrel:so101:teleop", "teleop",
     {"leader_arm": "leader", "follower_arm": "arm", "manage_leader_torque": False}),
)  # fmt: skip


BEGIN = np.radians([-30.0, -20.0, 20.0, 10.0, 0.0])
"""Where the machine's arm is taught: not home, where an arm that ignores the path may end, too."""


def hand(guest):
    """Where the browser draws the arm's hand [m]."""
    return np.array(guest.pose_of("/live/gripper_link")["position"])


def test_an_arm_of_a_machine_is_taught_follows_its_leader_goes_and_comes_back(
    visit, tmp_path, monkeypatch
):
    from so101_motion.viam.client import MachineRig

    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path))
    model = RobotModel.load()
    with running_machine(resources=PAIR) as machine:
        with MachineRig.connect(machine.address, arm="arm") as other:
            other.arm.move(JointGoal(q=BEGIN), wait=False).result(60.0)
        source = Source(
            title=f"Arm of machine {machine.address}",
            open=lambda: MachineRig.connect(machine.address, arm="arm"),
        )
        with serve_source(source, port=0) as preview:
            guest = visit(SMALL)
            guest.open(preview.url)
            guest.until(lambda: guest.says("does not report the health of its servos"))
            in_color = guest.color_of(BASE)
            guest.page.get_by_role("tab", name="Jog").click()
            guest.until(lambda: guest.says("The arm of a machine cannot be jogged"))
            assert not guest.button("Start jogging").is_enabled()
            guest.page.get_by_role("tab", name="Teach").click()
            guest.until(lambda: guest.says("Keep a hand on the leader"))
            taught = model.frame(BEGIN, "gripper_link").p
            guest.until(lambda: np.allclose(hand(guest), taught, atol=1e-3))
            guest.until(lambda: guest.button("Record a path").is_enabled())
            guest.press("Record a path")
            recording = guest.page.get_by_text(re.compile(r'Recording "path", [1-9]'))
            guest.until(lambda: recording.count() == 1)  # a press at once would be a double click
            guest.until(lambda: guest.says("Guided by hand"))
            guest.press("End the recording")
            guest.until(lambda: guest.says('"path" is saved: '))
            assert (tmp_path / "paths" / "path.json").exists()
            guest.until(lambda: guest.says("Idle, holding"))

            guest.press("Follow the leader")
            guest.until(lambda: guest.says("Following the leader."))
            before = hand(guest)
            with MachineRig.connect(machine.address, arm="leader") as leader:
                goal = JointGoal(q=np.radians([20.0, -10.0, 5.0, 5.0, 0.0]))
                leader.arm.move(goal, wait=False).result(60.0)
                p_leader = model.frame(leader.arm.state.q, "gripper_link").p
            guest.until(lambda: np.allclose(hand(guest), p_leader, atol=0.005))
            assert not np.allclose(before, p_leader, atol=0.02)
            guest.press("STOP")
            guest.until(lambda: guest.button("Follow the leader").count() == 1)
            guest.until(lambda: guest.says("Idle, holding"))

            before = hand(guest)
            guest.until(lambda: guest.button("Plan replay").is_enabled())
            guest.press("Plan replay")
            guest.until(lambda: guest.says("s to its start, then 0.0 s along it"))
            np.testing.assert_allclose(hand(guest), before, atol=1e-3)  # nothing moves yet
            assert guest.sees("/teach/path")
            guest.press_next("Replay")
            guest.until(lambda: guest.says("Done."))
            guest.until(lambda: np.allclose(hand(guest), taught, atol=0.005))
            machine.cut()
            guest.until(lambda: guest.says("Lost the machine"))
            guest.until(lambda: guest.color_of(BASE) != in_color)
            machine.mend()
            guest.until(lambda: not guest.says("Lost the machine"))
            guest.until(lambda: guest.says("Idle, holding"))
            guest.until(lambda: guest.color_of(BASE) == in_color)
            guest.leave()
