"""Targets: set by a click, turned by rings, dragged out of reach, and replaced by the nearest."""

import numpy as np

from so101_motion.common.units import to_mm

GHOST = "/ghost/gripper_link/"
BLUE, RED = 0x3C82F6, 0xE03131


def click_does(guest, what):
    """Choose what a click in the picture does."""
    guest.fields("A click").first.click()
    guest.page.get_by_role("option", name=what).click()
    guest.page.wait_for_timeout(300)


def test_a_click_on_the_floor_sets_the_target_and_undo_takes_it_back(guest, rig):
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
    assert not rig.arm.state.arm_moving


def test_a_ring_turns_the_gripper_and_what_is_out_of_reach_is_red(guest):
    mouse = guest.page.mouse

    def value(slider):
        found = guest.page.get_by_role("slider", name=slider)
        return float(found.get_attribute("aria-valuenow") or "nan")

    def drag(node, *points):
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

    def comes(condition, looks):
        """Whether a drag comes to this soon."""
        for _ in range(looks):
            if condition():
                return True
            guest.page.wait_for_timeout(50)
        return False

    def turns(slider, first, second, *angles):
        """Whether a drag of a ring does; a busy browser may not know yet where the mouse is."""
        before = value(slider)
        drag("/target", *(ring(first, second, angle) for angle in angles))
        mouse.up()
        return comes(lambda: abs(value(slider) - before) > 5.0, 10)

    roll, p_mm = value("Roll (°)"), guest.target_mm()
    guest.until(lambda: turns("Tilt (°)", 0, 2, 45.0, 55.0, 65.0))
    assert abs(value("Roll (°)") - roll) < 3.0
    assert guest.target_mm() == p_mm
    keeps.first.click()
    guest.page.get_by_role("option", name="any").click()
    guest.page.get_by_text("Direction", exact=True).click()
    guest.type_target(240.0, 0.0, 130.0)  # where no handle has led it
    guest.until(lambda: guest.color_of(GHOST) == BLUE)
    guest.type_target(600.0, 0.0, 130.0)
    guest.until(lambda: guest.says("mm out of reach"))
    guest.until(lambda: guest.color_of(GHOST) == RED)
    guest.press("nearest")
    guest.until(lambda: guest.color_of(GHOST) == BLUE)
    assert guest.problems == []


def ring(first, second, angle_deg):
    """A point on the ring of the target's handles in the plane of two of their axes [m]."""
    p = [0.0, 0.0, 0.0]
    p[first], p[second] = (
        0.0715 * np.cos(np.radians(angle_deg)),
        0.0715 * np.sin(np.radians(angle_deg)),
    )
    return (p[0], p[1], p[2])


def test_what_is_no_number_is_refused_and_the_value_before_comes_back(guest):
    field = guest.fields("Target (mm)").first
    before = guest.target_mm()
    for typed in ("abc", "1e9", ""):
        field.click()
        field.press("Control+a")
        field.press("Delete")
        guest.page.keyboard.type(typed)
        field.press("Tab")
        guest.until(lambda: guest.target_mm() == before)
