"""Several simulated arms in one page: common motions, jogging one arm, programs, their world."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import Visit
from harness.browser_user import Guest
from harness.web_camera import web_camera
from so101_viewer import CellPage, CellSource, serve_cell

from so101_motion.common.geometry import SE3
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.files.cell_file import arms_in_a_circle, read_cell
from so101_motion.rig.cell_rigs import CellRigs, open_cell
from so101_motion.rig.rig import Rig

pytestmark = pytest.mark.browser

ATTEMPTS = 4
"""So often a motion is tried: a busy machine ends one by itself when it sends no setpoints."""

STOPPED = "Stopped. All arms hold where they are."

FILE = arms_in_a_circle(2)


@pytest.fixture(scope="module")
def arms() -> Iterator[CellRigs]:
    with open_cell(FILE) as opened:
        for rig in opened.rigs.values():
            rig.arm.set_speed(to_rad(3.0))  # for many seconds
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
        guest.until(lambda: guest.says(STOPPED) or guest.has_stalled())
        guest.until(lambda: not any(rig.arm.is_moving for rig in rigs))
        if guest.says(STOPPED):
            break
    else:
        pytest.skip("this machine is too busy to let a simulated arm move")
    assert guest.problems == []


def test_each_arm_is_jogged_by_itself(guest: Guest, arms: CellRigs) -> None:
    page, (first, second) = guest.page, arms.rigs.values()

    def moves(rig: Rig) -> bool:
        return bool(np.any(np.abs(rig.arm.state.qd_ref) > to_rad(1.0)))

    page.get_by_role("tab", name="Jog", exact=True).click()
    jog = page.get_by_role("tablist").filter(has_text=re.compile("^arm 1arm 2$"))
    for name in ("arm 1", "arm 2"):  # both are switched on; the tab in front says which one moves
        jog.get_by_role("tab", name=name, exact=True).click()
        guest.press("Start jogging")
        guest.until(lambda: page.locator('.so101-jog[data-jog="on"]:visible').count() == 1)
    page.keyboard.down("q")
    guest.until(lambda: moves(second))
    assert not moves(first)
    jog.get_by_role("tab", name="arm 1", exact=True).click()  # the key is still held
    guest.until(lambda: not moves(second))
    assert not moves(first)
    page.keyboard.up("q")
    page.keyboard.down("q")
    guest.until(lambda: moves(first))
    assert not moves(second)
    guest.press("STOP")
    guest.until(lambda: not moves(first) and guest.says("Stopped. Start jogging to go on."))
    page.keyboard.up("q")
    page.get_by_role("tab", name="Move", exact=True).click()
    assert guest.problems == []


def test_a_program_for_both_arms_is_recorded_edited_and_planned(
    guest: Guest, arms: CellRigs
) -> None:
    page, rigs = guest.page, list(arms.rigs.values())
    guest.until(lambda: all(rig.arm.state.mode is Mode.HOLDING for rig in rigs))
    page.get_by_role("tab", name="Program", exact=True).click()
    guest.until(lambda: guest.button("Plan program").is_disabled())
    guest.press("all arms")
    guest.until(lambda: guest.says("Recorded step 1."))
    guest.press("arm 2")
    guest.until(lambda: guest.says("Recorded step 2."))
    rows = page.locator(".so101-steps span")
    guest.comes_to(["arm 1, arm 2", "arm 2"], rows.all_inner_texts)
    page.locator(".so101-steps:visible button").first.click()
    page.get_by_role("tablist").filter(has_text=re.compile("^arm 1arm 2$")).get_by_role(
        "tab", name="arm 1", exact=True
    ).click()
    guest.press("leave out")
    guest.until(lambda: rows.all_inner_texts() == ["arm 2"] * 2)
    stood = [rig.arm.state.q for rig in rigs]
    guest.press("Plan program")
    guest.until(lambda: guest.button("Run program").is_enabled())
    for rig, q in zip(rigs, stood, strict=True):
        np.testing.assert_array_equal(rig.arm.state.q, q)
    guest.comes_to([], guest.barriers)  # names come a moment later
    guest.until(lambda: guest.says("mm between arms"))
    line, ghost = page.locator(".so101-timeline:visible"), "/arms/1/program/ghost/gripper_link"
    at = line.bounding_box()
    assert at is not None

    def ghost_at(share: float) -> list[float]:
        """Where the second arm's ghost is, once it has come there."""
        before = guest.pose_of(ghost)
        line.click(position={"x": share * at["width"], "y": 0.5 * at["height"]})
        guest.until(lambda: guest.pose_of(ghost) != before)
        return guest.pose_of(ghost)["position"]

    assert ghost_at(0.1) != ghost_at(0.3)
    before = guest.pose_of(ghost)
    guest.press("2×")
    guest.until(lambda: guest.pose_of(ghost) != before)
    page.locator(".so101-steps:visible button").last.click()
    guest.press("this step")
    guest.comes_to(["2"], line.locator("b").all_inner_texts)
    for rig, q in zip(rigs, stood, strict=True):
        np.testing.assert_array_equal(rig.arm.state.q, q)  # only ghosts have moved
    page.get_by_role("tab", name="Move", exact=True).click()
    assert guest.problems == []


def test_what_is_put_around_the_arms_is_planned_around_by_each_and_saved_with_them(
    guest: Guest, arms: CellRigs, own_files: Path
) -> None:
    page, rigs = guest.page, arms.rigs

    def seen() -> list[list[str]]:
        return [[each.name for each in rig.arm.scene.obstacles] for rig in rigs.values()]

    page.get_by_role("tab", name="World", exact=True).click()
    guest.press("box")
    guest.until(lambda: seen() == [["box 1"], ["box 1"]])
    guest.until(lambda: any(re.fullmatch("/world/[0-9]+", node) for node in guest.nodes()))
    in_cell = [
        (arm.T_cell_base @ rigs[arm.name].arm.scene.obstacles[0].T_base_obstacle).matrix
        for arm in FILE.arms
    ]
    np.testing.assert_allclose(in_cell[0], in_cell[1], atol=1e-9)
    guest.until(lambda: guest.button("delete").filter(visible=True).is_enabled())
    assert guest.button("attach").filter(visible=True).count() == 0
    assert guest.button("for Viam").filter(visible=True).count() == 0
    guest.comes_to([], guest.barriers)
    stood = [rig.arm.state.q for rig in rigs.values()]
    second = list(rigs)[1]
    inside = rigs[second].arm.T_base().p
    p = (FILE.arms[1].T_cell_base @ SE3.from_translation(inside)).p
    fields = guest.fields("Position (mm)").filter(visible=True)
    guest.until(lambda: fields.count() == 3)
    for k, value in enumerate(1000.0 * p):
        fields.nth(k).fill(f"{value:.1f}")
        fields.nth(k).press("Enter")
        page.wait_for_timeout(80)
    guest.until(lambda: guest.says(f"{second}: ") and guest.says("is inside"))
    for rig, q in zip(rigs.values(), stood, strict=True):
        np.testing.assert_array_equal(rig.arm.state.q, q)  # an edit moves nothing
    guest.press("save")
    file = own_files / "cell.json"
    guest.until(file.exists)
    saved = read_cell(file)
    assert [each.name for each in saved.scene.obstacles] == ["box 1"]
    assert [each.name for each in saved.arms] == list(rigs)
    guest.press("delete")
    guest.until(lambda: seen() == [[], []])
    guest.button("undo").filter(visible=True).first.click()
    guest.until(lambda: seen() == [["box 1"], ["box 1"]])
    guest.button("redo").filter(visible=True).first.click()
    guest.until(lambda: seen() == [[], []])
    guest.button("undo").filter(visible=True).last.click()
    guest.until(lambda: not file.exists())
    page.get_by_role("tab", name="Move", exact=True).click()
    assert guest.problems == []


def test_the_pictures_of_a_camera_are_shown_over_the_scene(visit: Visit, arms: CellRigs) -> None:
    with web_camera() as camera:
        source = CellSource(
            title="Two arms",
            file=FILE,
            open=lambda: arms,
            lasts=True,
            camera=f"{camera}/picture",
        )
        with serve_cell(source, port=0) as served:
            window = visit()
            window.page.goto(served.url)
            picture = window.page.get_by_alt_text("The camera's picture")
            window.until(lambda: picture.count() == 1)
            first = picture.get_attribute("src")
            window.until(lambda: picture.get_attribute("src") != first)
            window.leave()
