"""Several simulated arms in one page: planned for together, moved together, stopped together."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from conftest import Visit
from harness.browser_user import Guest
from so101_viewer import CellPage, CellSource, serve_cell

from so101_motion.common.units import to_rad
from so101_motion.files.cell_file import arms_in_a_circle
from so101_motion.rig.cell_rigs import CellRigs, open_cell

pytestmark = pytest.mark.browser

ATTEMPTS = 4
"""So often a motion is tried: a busy machine ends one by itself when it sends no setpoints."""

STOPPED, STALLED = "Stopped. All arms hold where they are.", "No setpoint could be sent"

FILE = arms_in_a_circle(2)


@pytest.fixture(scope="module")
def arms() -> Iterator[CellRigs]:
    with open_cell(FILE) as opened:
        for rig in opened.rigs.values():
            rig.arm.set_speed(to_rad(4.0))  # for many seconds
        yield opened


@pytest.fixture(scope="module")
def page(arms: CellRigs) -> Iterator[CellPage]:
    source = CellSource(title="Two arms", file=FILE, open=lambda: arms, lasts=True)
    with serve_cell(source, port=0) as served:
        yield served


@pytest.fixture(scope="module")
def guest(visit: Visit, page: CellPage) -> Guest:
    guest = visit()
    guest.page.goto(page.url)
    guest.until(lambda: guest.button("Plan").count() == 1)
    guest.page.wait_for_function(
        "() => window.__viserSceneTree && '/arms/1/live/gripper_link' in "
        "window.__viserSceneTree.getState()",
    )
    return guest


@pytest.mark.timeout(400)
def test_a_common_motion_is_planned_executed_and_stopped(guest: Guest, arms: CellRigs) -> None:
    rigs = list(arms.rigs.values())
    for _ in range(ATTEMPTS):
        guest.until(lambda: guest.button("Plan").is_enabled())
        before = [rig.arm.state.q for rig in rigs]
        guest.press("Plan")
        guest.until(lambda: guest.button("Execute").is_enabled())
        for rig, q in zip(rigs, before, strict=True):
            np.testing.assert_array_equal(rig.arm.state.q, q)  # planning moves nothing
        guest.until(lambda: guest.says("arm 1 to arm 2"))  # the clearance between them
        guest.press("Execute")
        guest.until(lambda: not guest.button("Execute").is_enabled())
        guest.press("STOP")
        guest.until(lambda: guest.says(STOPPED) or guest.says(STALLED))
        assert not any(rig.arm.is_moving for rig in rigs)
        if guest.says(STOPPED):
            break
    else:
        pytest.skip("this machine is too busy to let a simulated arm move")
    assert guest.problems == []
