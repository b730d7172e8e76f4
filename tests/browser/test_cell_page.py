"""Several simulated arms in one page: common motions, jogging one arm, programs, their world."""

import re

import numpy as np
import pytest
from so101_viewer import Source, serve

from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.files.cell_file import arms_in_a_circle, read_cell
from so101_motion.rig.cell_rigs import open_cell

FILE = arms_in_a_circle(2)


@pytest.fixture(scope="module")
def arms():
    with open_cell(FILE) as opened:
        for rig in opened.rigs.values():
            rig.arm.set_speed(to_rad(3.0))  # for many seconds
        yield opened


@pytest.fixture(scope="module")
def page(arms):
    source = Source(title="Two arms", open=lambda: arms, lasts=True)
    with serve(source, port=0) as served:
        yield served


@pytest.fixture(scope="module")
def guest(visit, page):
    guest = visit()
    guest.page.goto(page.url)
    guest.until(lambda: guest.button("Plan").count() == 1)
    guest.page.wait_for_function(
        "() => window.__viserSceneTree && '/arms/1/live/gripper_link' in "
        "window.__viserSceneTree.getState()"
    )
    return guest


def record(guest, row, arms):
    """Press the button for ``arms`` in a row of the Program tab."""
    row_at = f"xpath=//*[text()='{row}']/ancestor::*[.//button][1]//button"
    guest.page.locator(row_at).filter(has_text=re.compile(f"^{arms}$")).click()


def arm_tab(guest, name):
    """The tab of an arm within the tab in front."""
    tabs = guest.page.get_by_role("tablist").filter(has_text=re.compile("^arm 1arm 2$"))
    return tabs.get_by_role("tab", name=name, exact=True).filter(visible=True)


def test_a_common_motion_is_planned_executed_and_stopped(guest, arms):
    rigs = list(arms.rigs.values())
    guest.until(lambda: guest.button("Plan").is_enabled())
    before = [rig.arm.state.q for rig in rigs]
    guest.press("Plan")
    guest.until(lambda: guest.button("Execute").is_enabled())
    for rig, q in zip(rigs, before, strict=True):
        np.testing.assert_array_equal(rig.arm.state.q, q)  # planning moves nothing
    guest.until(lambda: guest.says("arm 1 to arm 2"))  # the clearance between them
    guest.press("Execute")
    guest.until(lambda: all(rig.arm.state.arm_moving for rig in rigs))
    guest.press("STOP")
    guest.until(lambda: guest.says("Stopped. All arms hold where they are."))
    guest.until(lambda: not any(rig.arm.state.arm_moving for rig in rigs))
    assert guest.problems == []


def test_each_arm_is_jogged_by_itself(guest, arms):
    page, (first, second) = guest.page, arms.rigs.values()

    def moves(rig):
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


def test_a_program_is_recorded_from_targets_and_from_an_arm_and_planned(guest, arms):
    page, (first, second) = guest.page, arms.rigs.values()
    guest.until(lambda: all(rig.arm.state.mode is Mode.HOLDING for rig in (first, second)))
    page.get_by_role("tab", name="Program", exact=True).click()
    guest.press("Record waypoint")
    guest.until(lambda: guest.says("Recorded waypoint 1."))
    record(guest, "Record target", "all arms")
    guest.until(lambda: guest.says("Recorded waypoint 2."))
    page.locator(".so101-steps:visible button").first.click()
    guest.press("delete")
    guest.until(lambda: guest.says("Press Plan program"))
    record(guest, "Record arm", "arm 2")
    rows = page.locator(".so101-steps span")
    guest.comes_to(["arm 1, arm 2", "arm 2"], rows.all_inner_texts)
    page.locator(".so101-steps:visible button").first.click()
    arm_tab(guest, "arm 1").click()
    guest.press("leave out")
    guest.comes_to(["arm 2"] * 2, rows.all_inner_texts)
    stood = [rig.arm.state.q for rig in (first, second)]
    guest.until(lambda: guest.button("Plan program").is_enabled())
    guest.press("Plan program")
    guest.until(lambda: guest.button("Run program").is_enabled())
    line, ghost = page.locator(".so101-timeline:visible"), "/arms/1/program/ghost/gripper_link"
    guest.comes_to([], guest.barriers)  # names come a moment later
    guest.until(lambda: guest.says("mm between arms"))
    at = line.bounding_box()
    assert at is not None

    def ghost_at(share):
        """Where the second arm's ghost is, once it has come there."""
        before = guest.pose_of(ghost)
        line.click(position={"x": share * at["width"], "y": 0.5 * at["height"]})
        guest.until(lambda: guest.pose_of(ghost) != before)
        return guest.pose_of(ghost)["position"]

    assert ghost_at(0.05) != ghost_at(0.2)
    for rig, q in zip((first, second), stood, strict=True):
        np.testing.assert_array_equal(rig.arm.state.q, q)  # only ghosts have moved
    page.get_by_role("tab", name="Move", exact=True).click()
    assert guest.problems == []


def test_what_is_put_around_the_arms_is_planned_around_by_each_and_saved_with_them(
    guest, arms, own_files
):
    page, rigs = guest.page, arms.rigs

    def seen():
        return [[each.name for each in rig.arm.scene.obstacles] for rig in rigs.values()]

    page.get_by_role("tab", name="World", exact=True).click()
    guest.press("box")
    guest.until(lambda: seen() == [["box 1"], ["box 1"]])
    guest.until(lambda: any(re.fullmatch("/world/[0-9]+", node) for node in guest.nodes()))
    guest.until(lambda: guest.button("delete").filter(visible=True).is_enabled())
    assert guest.button("for Viam").filter(visible=True).count() == 0
    stood = [rig.arm.state.q for rig in rigs.values()]
    second = list(rigs)[1]

    def held():
        return [[each.name for each in rig.arm.scene.attached] for rig in rigs.values()]

    gripper = page.get_by_role("combobox", name="Gripper of").filter(visible=True)
    gripper.click()
    page.get_by_role("option", name=second, exact=True).filter(visible=True).click()
    guest.until(lambda: gripper.input_value() == second)
    guest.button("attach to gripper").filter(visible=True).click()
    guest.until(lambda: (seen(), held()) == ([[], []], [[], ["box 1"]]))
    guest.until(lambda: guest.says(f"{second} holds box 1"))
    guest.until(lambda: gripper.is_disabled())
    guest.comes_to([], guest.barriers)
    guest.button("detach").filter(visible=True).click()
    guest.until(lambda: (seen(), held()) == ([["box 1"], ["box 1"]], [[], []]))
    for rig, q in zip(rigs.values(), stood, strict=True):
        np.testing.assert_array_equal(rig.arm.state.q, q)  # an edit moves nothing
    guest.until(lambda: guest.says("box 1 stays here."))  # now its rows are back, and move "save"
    guest.press_next("save")
    file = own_files / "cell.json"
    guest.until(file.exists)
    assert [each.name for each in read_cell(file).scene.obstacles] == ["box 1"]
    page.get_by_role("tab", name="Move", exact=True).click()
    assert guest.problems == []
