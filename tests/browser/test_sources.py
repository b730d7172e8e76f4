"""How the page connects to its arm, and what it shows when the arm is not there."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import Visit
from harness.browser_user import Guest
from harness.viam_machine import running_machine  # it lives with the tests of the machine
from so101_viewer import Preview, Source, serve_source

from so101_motion.calib.record import store
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.servo_driver import ServoSettings

pytestmark = pytest.mark.browser

SMALL = (1120, 700)
BASE = "/live/base_link/"
OUTSIDE = 100  # [tick] that the wrist's roll is outside its range when the arm is found


class Cable:
    """A page on a port with an emulated arm, which can be pulled out and put in."""

    def __init__(self, port: Path) -> None:
        self.port = str(port)
        self.rigs: list[RigLike] = []
        self._servos = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "so101_motion.cli",
                "emulate",
                "--realtime",
                "--link",
                self.port,
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._servos.stdout is not None
        self._servos.stdout.readline()
        self.type("pose")  # somebody holds it up until it holds itself
        self.type("unplug")
        while port.exists():
            threading.Event().wait(0.01)
        source = Source(title=f"Arm on {self.port}", open=self._open)
        self.preview: Preview = serve_source(source, port=0)

    def type(self, line: str) -> None:
        assert self._servos.stdin is not None
        self._servos.stdin.write(f"{line}\n")
        self._servos.stdin.flush()

    def _open(self) -> RigLike:
        file = Path(f"{self.port}.json")
        settings = ServoSettings(port=self.port).with_arm(SERVO_IDS)
        patience = 0.3  # this computer has a browser to run as well
        if not file.exists():
            with open_hardware(settings, reply_timeout=patience) as rig:
                calibration = dict(rig.servos.calibration)
            aside = 2048 + OUTSIDE  # the hand holds it at 2048
            calibration["wrist_roll"] = replace(calibration["wrist_roll"], range_min=aside)
            store.save(file, calibration)
        settings = replace(settings, calibration_file=file)
        self.rigs.append(open_hardware(settings, reply_timeout=patience))
        return self.rigs[-1]

    @property
    def q(self) -> np.ndarray:
        return self.rigs[-1].arm.state.q

    def close(self) -> None:
        self.preview.close()
        self._servos.terminate()
        self._servos.wait(10.0)
        for pipe in (self._servos.stdin, self._servos.stdout):
            assert pipe is not None
            pipe.close()


@pytest.fixture(scope="module")
def cable(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cable]:
    cable = Cable(tmp_path_factory.mktemp("port") / "arm")
    yield cable
    cable.close()


@pytest.fixture(scope="module")
def in_background(visit: Visit, cable: Cable) -> Guest:
    """A window on the arm of the cable."""
    guest = visit(SMALL)
    guest.page.goto(cable.preview.url)
    return guest


def test_an_arm_on_a_port_comes_goes_and_comes_back_without_moving(
    in_background: Guest, cable: Cable
) -> None:
    guest = in_background
    guest.until(lambda: guest.says("Still looking"))
    guest.until(lambda: guest.says(f"Arm on {cable.port}"))
    assert guest.button("Plan").count() == 0

    cable.type("end unplug")
    guest.see_the_arm()
    guest.until(lambda: guest.says("12.0"))  # volts
    assert not guest.says("Still looking")
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
    guest.until(lambda: guest.says("Fix this, then press Hold."))
    guest.until(lambda: guest.color_of(BASE) == in_color)
    guest.until(lambda: guest.button("Plan").is_disabled())
    guest.press("Hold")
    guest.until(lambda: guest.says("Idle, holding"))
    guest.until(lambda: not guest.says("press Hold"))
    np.testing.assert_allclose(cable.q, before, atol=0.06)  # an arm held anew sags a little
    guest.page.get_by_role("tab", name="Events").click()
    guest.until(lambda: guest.says("is back; nothing moves until you ask"))
    assert guest.problems == []


def test_the_servos_tab_says_what_will_move_and_stop_ends_it(
    in_background: Guest, cable: Cable
) -> None:
    guest, arm, before = in_background, cable.rigs[-1].arm, cable.q
    guest.page.get_by_role("tab", name="Servos").click()
    guest.until(lambda: guest.says("Measures how each servo differs from its type."))
    guest.press("Plan the motions")
    guest.until(lambda: guest.says("The arm is raised; then move, one after the other"))
    np.testing.assert_allclose(cable.q, before, atol=0.06)
    guest.press("The hand is empty")
    guest.until(lambda: arm.is_moving and guest.says("Raising the arm … Stop ends it."))
    guest.press("STOP")
    guest.until(lambda: guest.says("Stopped. The arm holds where it is."))
    assert arm.state.mode is Mode.HOLDING
    guest.until(lambda: guest.button("Plan the motions").is_enabled())
    assert guest.button("The hand is empty").count() == 0
    assert guest.problems == []


def test_an_arm_of_a_machine_goes_and_comes_back(visit: Visit) -> None:
    from so101_motion.viam.client import MachineRig

    with running_machine() as machine:
        source = Source(
            title=f"Arm of machine {machine.address}",
            open=lambda: MachineRig.connect(machine.address),
        )
        with serve_source(source, port=0) as preview:
            guest = visit(SMALL)
            guest.open(preview.url)
            guest.until(lambda: guest.says("reports no servo health"))
            in_color = guest.color_of(BASE)
            machine.cut()
            guest.until(lambda: guest.says("Lost the machine"))
            guest.until(lambda: guest.color_of(BASE) != in_color)
            machine.mend()
            guest.until(lambda: not guest.says("Lost the machine"))
            guest.until(lambda: guest.says("Idle, holding"))
            guest.until(lambda: guest.color_of(BASE) == in_color)
            guest.leave()
