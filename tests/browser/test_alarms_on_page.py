"""Alarms that no hot servo causes: no calibration, late cycles, joints of a machine's arm."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import Visit, crawl_aside
from harness.browser_user import Guest
from harness.emulated_kit import Kit
from harness.fake_parent import ARM, HARDWARE_ARM
from harness.viam_machine import carried_out, running_machine
from so101_viewer import Source, serve_source
from so101_viewer.panels.health_panel import LATE_MANY
from so101_viewer.scene.robot_view import MOVED_LINK

from so101_motion.calib.record import record, store
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.drivers.emulator import registers as reg
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.hardware_rig import HardwareRig, open_hardware
from so101_motion.rig.rig import Rig
from so101_motion.rig.servo_driver import ServoSettings
from so101_motion.viam.client import MachineRig

pytestmark = pytest.mark.browser

SMALL = (1120, 700)
OUTSIDE = 100  # [tick] that the wrist's roll is outside its range


def part(joint: str) -> str:
    return f"/live/{MOVED_LINK[joint]}/"


def events_with(guest: Guest, words: str) -> int:
    guest.page.get_by_role("tab", name="Events").click()
    region = guest.page.get_by_role("region", name="Events")
    return sum(words in line for line in region.locator("span").all_inner_texts())


def sees_one_alarm(guest: Guest, words: str) -> str:
    """The sentence of the only alarm, once the bar and the Health tab show it."""
    guest.until(lambda: any(words in text for _, text in guest.alerts()))
    ((tone, text),) = [each for each in guest.alerts() if words in each[1]]
    assert tone == "warm"
    guest.until(guest.has_badge)
    guest.until(lambda: events_with(guest, words) > 0)
    guest.page.wait_for_timeout(1200)  # its figures are read again and again
    assert events_with(guest, words) == 1
    return text


def is_well_again(guest: Guest, words: str) -> None:
    guest.until(lambda: not any(words in text for _, text in guest.alerts()))
    guest.until(lambda: not guest.has_badge(), seconds=90.0)


@pytest.fixture
def new_arm(tmp_path: Path) -> Iterator[tuple[Kit, Callable[[], HardwareRig]]]:
    """Servos with ids that were never calibrated, and what opens them."""
    kit = Kit(tmp_path)
    settings = ServoSettings(port=kit.port).with_arm(SERVO_IDS)
    yield kit, lambda: open_hardware(settings, reply_timeout=0.3)
    kit.close()


def test_joints_without_a_calibration_are_a_headline_a_badge_colours_and_one_event(
    new_arm: tuple[Kit, Callable[[], HardwareRig]], visit: Visit
) -> None:
    kit, open_arm = new_arm
    with open_arm() as rig, serve_source(Source.given(rig, "New arm"), port=0) as preview:
        guest = visit(SMALL)
        guest.open(preview.url)
        text = sees_one_alarm(guest, "No calibration: ")
        assert "Calibrate on the Setup tab before you move the arm." in text
        in_alarm = guest.color_of(part("elbow_flex"))
        for servo in kit.world.servos:  # somebody calibrates it
            servo.memory.keep(reg.MIN_POSITION, 1500)
            servo.memory.keep(reg.MAX_POSITION, 2600)
        rig.reload()
        is_well_again(guest, "No calibration")
        guest.until(lambda: guest.color_of(part("elbow_flex")) != in_alarm)
        assert guest.problems == []
        guest.leave()


def test_late_setpoints_are_a_headline_and_a_badge_until_they_have_stopped(
    guest: Guest, rig: Rig
) -> None:
    def hold_up(_: object) -> None:
        """Keep the control loop busy for two cycles."""
        threading.Event().wait(0.02)

    in_color, before = guest.color_of(part("elbow_flex")), rig.arm.state.late_ticks
    crawl_aside(rig)
    end = rig.executor.listen(hold_up)  # type: ignore[attr-defined]
    guest.until(lambda: rig.arm.state.late_ticks > before + 2 * LATE_MANY)
    end()
    rig.arm.stop()
    text = sees_one_alarm(guest, "setpoints came late in the last 10 s")
    assert text.endswith("so motions may jerk. Close other programs on this computer.")
    assert guest.color_of(part("elbow_flex")) == in_color  # it is about no joint
    is_well_again(guest, "came late")
    assert guest.problems == []


def test_a_joint_of_a_machine_outside_its_range_is_said_until_a_motion_has_brought_it_back(
    visit: Visit, tmp_path: Path
) -> None:
    entries = {
        joint: replace(record.default(joint), id=i)
        for i, joint in enumerate(record.JOINTS, start=1)
    }
    entries["wrist_roll"] = replace(entries["wrist_roll"], range_min=2048 + OUTSIDE)
    store.save(tmp_path / "calibration.json", entries)
    attributes = {"calibration_file": str(tmp_path / "calibration.json")}
    with running_machine(emulated=True) as machine:
        machine.remove(ARM, "arm")
        arm = machine.add(ARM, HARDWARE_ARM, "arm", {"port": machine.port, **attributes})
        source = Source(
            title="Arm of a machine", open=lambda: MachineRig.connect(machine.address, arm="arm")
        )
        with serve_source(source, port=0) as preview:
            guest = visit(SMALL)
            guest.open(preview.url)
            sees_one_alarm(guest, "is not the calibration that the servos")
            assert machine.do(arm, "write_calibration")["success"]
            text = sees_one_alarm(guest, "Outside its range: wrist_roll by 9°, limit ")
            assert text.endswith("The next motion brings it back slowly.")
            in_alarm = guest.color_of(part("wrist_roll"))

            with MachineRig.connect(machine.address, arm="arm") as other:
                goal = JointGoal(q=other.state.q + np.radians([0.0, 0.0, 0.0, 0.0, 20.0]))
                carried_out(lambda: other.arm.move(goal, wait=False).result(60.0))
            is_well_again(guest, "Outside its range")
            guest.until(lambda: guest.color_of(part("wrist_roll")) != in_alarm)
            assert guest.problems == []
            guest.leave()
