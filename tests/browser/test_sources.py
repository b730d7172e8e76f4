"""How the page connects to its arm, and what it shows when the arm is not there or not well.

Page, threads, bus and module are real, but there is no browser.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from harness.browser_user import Servos
from harness.fake_parent import ARM, SIMULATED
from harness.page_client import Hand
from harness.viam_machine import running_machine  # it lives with the tests of the machine
from so101_viewer import Source, serve

from so101_motion.calib.record import store
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings

pytestmark = pytest.mark.emulator_only

BASE = "/live/base_link/"
KEEPS_LOOKING = "This page keeps looking for the arm"
OUTSIDE = 100  # [tick] that the wrist's roll is outside its range when the arm is found


class Cable:
    """A page on a port with an emulated arm, which can be pulled out and put in."""

    def __init__(self, port, clock):
        self.port, self.rigs, self._servos = str(port), [], Servos(port, clock)
        self._clock = clock
        self.type = self._servos.type
        self.type("pose")  # somebody holds it up until it holds itself
        self.type("unplug")
        self.preview = serve(Source(title=f"Arm on {port}", open=self._open), port=0)

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


def test_an_arm_on_a_port_comes_goes_and_comes_back_without_moving(cable):
    hand = Hand(cable.preview)
    hand.expect("Still looking")
    hand.expect(KEEPS_LOOKING)
    hand.expect(f"Arm on {cable.port}")
    assert not hand.has("Plan")

    cable.type("end unplug")
    hand.until(lambda: hand.has("Plan"))
    hand.expect("12.0")  # volts
    hand.until(lambda: not hand.says("Still looking") and not hand.says(KEEPS_LOOKING))
    in_color = hand.color_of(BASE)
    hand.expect("Outside its range: wrist_roll by")
    hand.until(lambda: hand.color_of("/live/gripper_link/") != in_color)
    cable.type("end pose")
    before = cable.q

    cable.type("unplug")
    hand.until(lambda: hand.warns("Lost the arm on"))
    hand.until(lambda: hand.color_of(BASE) != in_color)
    hand.until(lambda: not hand.can("Plan"))

    cable.type("end unplug")
    hand.until(lambda: hand.warns("Connected again. Nothing moves. Press Hold to go on."))
    assert not hand.warns("no such port")
    hand.until(lambda: hand.color_of(BASE) == in_color)
    hand.until(lambda: not hand.can("Plan"))
    hand.press("Hold")
    hand.expect("Held in part")
    hand.until(lambda: not hand.says("press Hold"))
    np.testing.assert_allclose(cable.q, before, atol=0.06)  # an arm held anew sags a little
    hand.expect("is back; nothing moves until you ask")


FAST = {"speed_degs_per_sec": 90.0, "acceleration_degs_per_sec_per_sec": 400.0}
PAIR = (
    (ARM, SIMULATED, "leader", FAST),
    (ARM, SIMULATED, "arm", FAST),
    ("rdk:service:generic", "devrel:so101:teleop", "teleop",
     {"leader_arm": "leader", "follower_arm": "arm", "manage_leader_torque": False}),
)  # fmt: skip


BEGIN = np.radians([-30.0, -20.0, 20.0, 10.0, 0.0])
"""Where the machine's arm is taught: not home, where an arm that ignores the path may end, too."""


def test_an_arm_of_a_machine_is_taught_follows_its_leader_goes_and_comes_back(
    tmp_path, monkeypatch
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
        with serve(source, port=0) as page:
            hand = Hand(page)

            def is_at(p, atol=0.005):
                """Whether the page shows the arm's hand there."""
                return np.allclose(hand.place_of("/live/gripper_link"), p, atol=atol)

            hand.expect("does not report the health of its servos")
            in_color = hand.color_of(BASE)
            hand.expect("The arm of a machine cannot be jogged")
            assert not hand.can("Start jogging")
            hand.expect("Keep a hand on the leader")
            taught = model.frame(BEGIN, "gripper_link").p
            hand.until(lambda: is_at(taught, atol=1e-3))
            hand.press("Record a path")
            hand.until(lambda: re.search(r'Recording "path", [1-9]', hand.words()))
            hand.expect("Guided by hand")
            hand.press("End the recording")
            hand.expect('"path" is saved: ')
            assert (tmp_path / "paths" / "path.json").exists()
            hand.expect("Idle, holding")

            hand.press("Follow the leader")
            hand.expect("Following the leader.")
            with MachineRig.connect(machine.address, arm="leader") as leader:
                goal = JointGoal(q=np.radians([20.0, -10.0, 5.0, 5.0, 0.0]))
                leader.arm.move(goal, wait=False).result(60.0)
                p_leader = model.frame(leader.arm.state.q, "gripper_link").p
            hand.until(lambda: is_at(p_leader))
            assert not np.allclose(taught, p_leader, atol=0.02)
            hand.press("STOP")
            hand.until(lambda: hand.has("Follow the leader"))
            hand.expect("Stopped, holding")

            before = np.array(hand.place_of("/live/gripper_link"))
            hand.press("Plan replay")
            hand.expect("s to its start, then 0.0 s along it")
            assert is_at(before, atol=1e-3)  # nothing moves yet
            hand.press("Replay")
            hand.expect("Done.")
            hand.until(lambda: is_at(taught))
            machine.cut()
            hand.until(lambda: hand.warns("Lost the machine"))
            hand.until(lambda: hand.color_of(BASE) != in_color)
            machine.mend()
            hand.until(lambda: not hand.warns("Lost the machine"))
            hand.expect("Idle, holding")
            hand.until(lambda: hand.color_of(BASE) == in_color)
