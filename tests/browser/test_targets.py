"""Targets: set by a click, turned by rings, dragged out of reach, and replaced by the nearest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from harness.browser_user import HOME, Guest
from viser.transforms import SO3

from so101_motion.common.geometry import SE3
from so101_motion.common.units import to_mm
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.rig import Rig

pytestmark = pytest.mark.browser

GHOST = "/ghost/gripper_link/"
BLUE, RED = 0x3C82F6, 0xE03131


def click_does(guest: Guest, what: str) -> None:
    """Choose what a click in the picture does."""
    guest.fields("A click").first.click()
    guest.page.get_by_role("option", name=what).click()
    guest.page.wait_for_timeout(300)


def test_a_click_on_the_floor_sets_the_target_and_undo_takes_it_back(
    guest: Guest, rig: Rig
) -> None:
    before = guest.target_mm()
    click_does(guest, "sets the target")
    left, top, width, height = guest.picture()
    x, y = left + 0.62 * width, top + 0.55 * height
    guest.click_until(lambda: (x, y), lambda: guest.target_mm() != before)
    floor_mm = to_mm(rig.arm.scene.floor_z or 0.0)
    guest.until(lambda: abs(guest.target_mm()[2] - floor_mm - 20.0) < 0.2)
    there = guest.target_mm()
    undo = guest.button("undo").filter(visible=True).first
    redo = guest.button("redo").filter(visible=True).first
    guest.until(lambda: undo.is_enabled() and redo.is_disabled())
    redo.click(force=True)  # a grey one says why
    guest.until(lambda: guest.says("redo: Nothing was undone."))
    assert guest.target_mm() == there
    undo.click()
    guest.until(lambda: guest.target_mm() != there)
    guest.page.wait_for_timeout(700)
    redo.click()
    guest.until(lambda: guest.target_mm() == there)
    guest.until(redo.is_disabled)
    click_does(guest, "selects")
    assert not rig.arm.is_moving


def test_the_nearest_place_is_taken_and_a_direction_is_kept(guest: Guest) -> None:
    guest.until(lambda: guest.button("take the nearest").is_disabled())
    guest.type_target(600.0, 0.0, 200.0)
    guest.until(lambda: guest.button("take the nearest").is_enabled())
    guest.press("take the nearest")
    guest.until(lambda: guest.says("Reachable. Press Plan."))
    guest.until(lambda: 300.0 < guest.target_mm()[0] < 599.0)

    def rings() -> bool:
        node = "window.__viserSceneTree.getState()['/target'].message.props"
        return not guest.page.evaluate(f"{node}.disable_rotations")

    guest.type_target(230.0, 0.0, 120.0)
    guest.page.get_by_text("Direction", exact=True).click()
    guest.until(lambda: not rings())
    guest.fields("Keeps").filter(visible=True).first.click()
    guest.page.get_by_role("option", name="tilt and roll").click()
    guest.until(rings)
    before = guest.pose_of("/target")["wxyz"]
    guest.page.get_by_role("slider", name="Roll (°)").press("ArrowRight")
    guest.until(lambda: guest.pose_of("/target")["wxyz"] != before)
    guest.fields("Keeps").filter(visible=True).first.click()
    guest.page.get_by_role("option").first.click()
    guest.until(lambda: not rings())
    guest.page.get_by_text("Direction", exact=True).click()


def test_an_object_is_clicked_and_the_nearest_place_beside_it_is_taken(
    guest: Guest, rig: Rig
) -> None:
    before, top_z = rig.arm.scene, 0.08
    place = SE3.from_translation((0.24, 0.1, 0.5 * top_z))
    box = Obstacle(name="box", shape=Box(size=np.array([0.06, 0.06, top_z])), T_base_obstacle=place)
    rig.arm.scene = Scene(floor_z=before.floor_z, obstacles=(box,))
    guest.until(lambda: "/world/0" in guest.nodes())
    click_does(guest, "sets the target")
    first = guest.target_mm()
    guest.click_until(
        lambda: guest.place_of("/world/0", (0.0, 0.0, 0.5 * top_z)),
        lambda: guest.target_mm() != first,
    )
    guest.until(lambda: np.allclose(guest.target_mm(), [240.0, 100.0, 100.0], atol=8.0))
    guest.until(lambda: abs(guest.target_mm()[2] - 100.0) < 0.2)  # 20 mm above it
    guest.until(lambda: guest.says("Reachable. Press Plan."))
    guest.until(lambda: pointing(guest)[2] < -0.9)  # from above; -0.82 without
    guest.type_target(240.0, 100.0, 60.0)  # inside it
    guest.until(lambda: guest.says("would hit"))
    guest.until(lambda: guest.button("Plan").is_disabled())
    guest.press("take the nearest")
    guest.until(lambda: guest.says("Reachable. Press Plan."))

    def off() -> float:
        return float(np.linalg.norm(np.subtract(guest.target_mm(), (240.0, 100.0, 60.0))))

    guest.until(lambda: 5.0 < off() < 80.0)
    click_does(guest, "selects")
    rig.arm.scene = before
    guest.until(lambda: "/world/0" not in guest.nodes())


def pointing(guest: Guest) -> np.ndarray:
    """Where the ghost's gripper points."""
    model = RobotModel.load()
    T_gripper_tool = model.frame(HOME, "gripper_link").inverse @ model.frame(HOME, "tool")
    R_base_gripper = SO3(np.array(guest.pose_of("/ghost/gripper_link")["wxyz"])).as_matrix()
    return np.asarray(R_base_gripper @ T_gripper_tool.R[:, 2])


def test_a_ring_turns_the_gripper_and_what_is_out_of_reach_is_red(guest: Guest) -> None:
    mouse = guest.page.mouse

    def value(slider: str) -> float:
        found = guest.page.get_by_role("slider", name=slider)
        return float(found.get_attribute("aria-valuenow") or "nan")

    def drag(node: str, *points: tuple[float, float, float]) -> None:
        places = [guest.place_of(node, p) for p in points]
        mouse.move(*places[0])
        guest.page.wait_for_timeout(300)
        mouse.down()
        for x1, y1 in places[1:]:
            mouse.move(x1, y1)
            guest.page.wait_for_timeout(100)

    guest.type_target(230.0, 0.0, 120.0)
    keeps = guest.fields("Keeps").filter(visible=True)
    if keeps.count() == 0:  # a rerun finds it unfolded
        guest.page.get_by_text("Direction", exact=True).click()
    keeps.first.click()
    guest.page.get_by_role("option", name="tilt and roll").click()
    guest.page.wait_for_timeout(500)

    def comes(condition: Callable[[], bool], looks: int) -> bool:
        """Whether a drag comes to this soon."""
        for _ in range(looks):
            if condition():
                return True
            guest.page.wait_for_timeout(50)
        return False

    def turns(slider: str, first: int, second: int, *angles: float) -> bool:
        """Whether a drag of a ring does; a busy browser may not know yet where the mouse is."""
        before = value(slider)
        drag("/target", *(ring(first, second, angle) for angle in angles))
        mouse.up()
        return comes(lambda: abs(value(slider) - before) > 5.0, 10)

    tilt, roll, p_mm = value("Tilt (°)"), value("Roll (°)"), guest.target_mm()
    guest.until(lambda: turns("Tilt (°)", 0, 2, 45.0, 55.0, 65.0))
    assert abs(value("Roll (°)") - roll) < 3.0
    assert guest.target_mm() == p_mm
    tilt = value("Tilt (°)")
    guest.until(lambda: turns("Roll (°)", 0, 1, 35.0, 20.0, 5.0))
    assert abs(value("Tilt (°)") - tilt) < 3.0
    keeps.first.click()
    guest.page.get_by_role("option", name="any").click()
    guest.page.get_by_text("Direction", exact=True).click()
    guest.type_target(240.0, 0.0, 130.0)  # where no handle has led it
    guest.until(lambda: guest.color_of(GHOST) == BLUE)

    def is_dragged_away() -> bool:
        mouse.up()
        drag("/target", (0.085, 0.0, 0.0), (0.3, 0.0, 0.0), (0.5, 0.0, 0.0))
        return comes(lambda: guest.says("mm out of reach") and "/reach" in guest.nodes(), 60)

    guest.until(is_dragged_away)
    guest.until(lambda: guest.color_of(GHOST) == RED)
    mouse.up()
    guest.until(lambda: "/reach" not in guest.nodes())
    guest.press("take the nearest")
    guest.until(lambda: guest.color_of(GHOST) == BLUE)
    assert guest.problems == []


def ring(first: int, second: int, angle_deg: float) -> tuple[float, float, float]:
    """A point on the ring of the target's handles in the plane of two of their axes [m]."""
    p = [0.0, 0.0, 0.0]
    p[first], p[second] = (
        0.0715 * np.cos(np.radians(angle_deg)),
        0.0715 * np.sin(np.radians(angle_deg)),
    )
    return (p[0], p[1], p[2])
