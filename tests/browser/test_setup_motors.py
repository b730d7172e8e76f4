"""The setup app in a browser: what is lit, what a press does, and what a reload keeps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from browser_guest import Guest
from setup_kit import PATIENCE, FreshKit, fresh_kit
from so101_viewer import SetupApp, serve_setup

pytestmark = [pytest.mark.browser, pytest.mark.emulator_only]

SMALL = (660, 420)  # drawn without a GPU, every pixel takes its time
ORANGE, GREEN = 0xF58200, 0x3CA050

Visit = Callable[..., Guest]


@pytest.fixture
def kit(tmp_path: Path) -> Iterator[FreshKit]:
    with fresh_kit(tmp_path) as kit:
        yield kit


def serve(kit: FreshKit, tmp_path: Path) -> SetupApp:
    progress = tmp_path / "setup.json"
    return serve_setup(port=0, ports=[kit.port], patience=PATIENCE, progress_file=progress)


def press(guest: Guest, name: str) -> None:
    """Click without waiting for a picture: drawing without a GPU takes its time."""
    guest.until(lambda: guest.button(name).count() == 1 and guest.button(name).is_enabled())
    guest.button(name).dispatch_event("click")


def reload(guest: Guest, name: str) -> None:
    """Load the page again; it is where it was once this button is there."""
    guest.page.reload()
    guest.until(lambda: guest.button(name).count() == 1)


def choose(guest: Guest, url: str) -> None:
    guest.page.goto(url)
    press(guest, "Motor Setup Only")
    guest.until(lambda: guest.says("Step 1 of 3"))


def lit(guest: Guest, link: str) -> int:
    return guest.color_of(f"/setup/arm/{link}/")


def test_a_motor_gets_its_id_in_the_browser_and_every_reload_is_where_it_was(
    visit: Visit, kit: FreshKit, tmp_path: Path
) -> None:
    with serve(kit, tmp_path) as app:
        guest = visit(SMALL)
        choose(guest, app.url)
        guest.until(lambda: guest.says("no servo answers"))  # and that is no obstacle yet
        reload(guest, "Next")
        press(guest, "Next")

        guest.until(lambda: guest.says("Connect only the motor of gripper"))
        guest.until(lambda: lit(guest, "moving_jaw_so101_v1_link") == ORANGE)
        assert guest.button("Write id 6 to this motor").is_disabled()
        assert guest.button("Next").is_disabled()

        kit.connect_only("gripper", "wrist_roll")
        guest.until(lambda: guest.says("Several servos answer"))
        assert guest.says("unplug the others")
        assert guest.button("Write id 6 to this motor").is_disabled()

        kit.connect_only("gripper")
        guest.until(lambda: guest.button("Write id 6 to this motor").is_enabled())
        assert guest.says("1 Mbaud → 6")
        guest.until(lambda: lit(guest, "moving_jaw_so101_v1_link") == GREEN)
        assert kit.ids["gripper"] == 1  # nothing is written by finding it
        reload(guest, "Write id 6 to this motor")
        for _ in range(3):  # a window that was loaded again may not be in control at once
            press(guest, "Write id 6 to this motor")
            guest.page.wait_for_timeout(4000)
            if kit.ids["gripper"] == 6:
                break
        guest.until(lambda: guest.says("id 6, 1 Mbaud"))
        reload(guest, "Write id 5 to this motor")
        guest.until(lambda: guest.says("Unplug the motor of gripper, then connect only"))
        guest.until(lambda: lit(guest, "gripper_link") == ORANGE)
        press(guest, "Abort the setup")
        guest.until(lambda: guest.says("Aborted: nothing was moved"))
        reload(guest, "Motor Setup Only")
        assert guest.problems == []
