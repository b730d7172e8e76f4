from contextlib import contextmanager

import numpy as np
import pytest
from harness.browser_user import HOME, LAPTOP, READY

from so101_motion.common.units import to_rad

NAME = "<b>lift</b>"


@pytest.fixture
def program(guest, preview):
    """A window on the Program tab with two waypoints: where the target is, and the arm."""
    guest.page.get_by_role("tab", name="Program").click()
    assert guest.button("Plan program").count() == 0  # a program begins with one button
    for number, button in enumerate(("Record waypoint", "target", "Record waypoint"), 1):
        guest.press_next(button)
        guest.until(lambda number=number: guest.says(f"Recorded waypoint {number}."))
    guest.page.locator(".so101-steps button").first.click()
    guest.press("delete")
    guest.until(lambda: guest.page.locator(".so101-steps button").count() == 2)
    guest.page.locator(".so101-steps button").first.click()  # the target stands there again
    yield guest
    guest.page.get_by_role("tab", name="Program").click()
    guest.until(lambda: shows_files(guest))
    guest.until(lambda: is_cleared(guest))
    guest.page.get_by_text("Save and load").click()
    guest.page.get_by_role("tab", name="Move").click()


def shows_files(guest):
    """Whether "Save and load" is open; a click on what a test left open would close it."""
    if not guest.button("new").is_visible():
        guest.page.get_by_text("Save and load").click()
        guest.page.wait_for_timeout(1000)
    return guest.button("new").is_visible()


def is_cleared(guest):
    guest.press("new")
    return "/program/dots" not in guest.nodes()


def at(q, rig):
    return float(np.max(np.abs(rig.arm.state.q - q))) < to_rad(0.5)


def planned(guest):
    """Have the program planned, again if the page hears of a new speed meanwhile."""

    def is_planned():
        if guest.says("Press Plan program"):
            guest.press("Plan program")
            guest.page.wait_for_timeout(1000)
        return guest.button("Run program").is_enabled()

    guest.press("Plan program")
    guest.page.wait_for_timeout(500)
    guest.until(is_planned)


@contextmanager
def told(rig):
    """What the joints are told meanwhile, every setpoint of it."""
    goals = []

    def listen(driver):
        driver.on_command = lambda command: goals.append(np.array(command.q_cmd))

    def forget(driver):
        driver.on_command = None

    call = rig.executor.call
    call(listen).result(60.0)
    try:
        yield goals
    finally:
        call(forget).result(60.0)


def test_a_program_is_recorded_planned_run_and_kept(program, rig, own_files):
    assert {"/program/dots", "/program/number0", "/program/number1"} <= program.nodes()
    shows_what_belongs_to_the_tab_in_front(program, rig)
    program.until(lambda: "/program/path" in program.nodes())
    program.until(lambda: program.says("One round"))
    timeline = program.page.locator(".so101-timeline")
    whole = float(timeline.get_attribute("data-duration") or "nan")
    shown = program.page.get_by_role("slider", name="Rehearsal (s)")

    def goes_to_the_middle():
        """Whether a finger does; the page may just be moving the line."""
        line = timeline.bounding_box()
        assert line is not None
        x, y = line["x"] + 0.25 * line["width"], line["y"] + 10.0
        program.finger((x, y), (x + 0.1 * line["width"], y), (x + 0.25 * line["width"], y))
        for _ in range(60):
            if abs(float(shown.get_attribute("aria-valuenow") or 0) - 0.5 * whole) < 0.1:
                return True
            program.page.wait_for_timeout(50)
        return False

    program.until(goes_to_the_middle)
    assert at(HOME, rig)  # planning moves nothing
    program.resize((390, 844))  # Plan and Run stay at the end of a phone's panel
    run = program.button("Run program")
    program.until(lambda: run.bounding_box()["y"] + run.bounding_box()["height"] <= 844.0)
    program.resize(LAPTOP)
    with told(rig) as goals:
        program.press("Run program")
        program.until(lambda: program.says("Done."))
        program.until(lambda: not (rig.arm.state.arm_moving or rig.gripper.is_moving))
    assert min(float(np.max(np.abs(q - READY))) for q in goals) < to_rad(0.5)
    assert at(HOME, rig)
    program.until(lambda: program.button("Run program").is_disabled())
    program.page.get_by_text("Save and load").click()
    said = program.page.locator("#so101-why")  # the sentence itself is scrolled away
    program.press("save")
    program.until(lambda: said.is_visible() and said.inner_text() == "Type a name first.")
    program.fields("Program name").fill("wave")
    program.page.wait_for_timeout(200)
    program.press("save")
    program.until(lambda: (own_files / "programs" / "wave.json").exists())
    program.press("new")
    program.until(lambda: program.says("then press Record waypoint"))
    program.press("load")
    program.until(lambda: program.says("Loaded wave, 2 steps."))
    program.page.get_by_text("Save and load").click()
    assert program.problems == []


def shows_what_belongs_to_the_tab_in_front(program, rig):
    """Plan on the Move tab, then the program, and look at what the scene shows."""

    def shown(*nodes):
        return {each for each in every if program.sees(each)} == set(nodes)

    ghost, own_path, sweep = "/ghost/gripper_link", "/path", "/sweep/gripper_link"
    other_ghost, other_path, dots = "/program/ghost/gripper_link", "/program/path", "/program/dots"
    every = (own_path, sweep, other_path, dots)
    program.until(lambda: shown(dots) and program.sees(ghost))  # the target, to be recorded
    program.in_front("Move")
    program.press("Plan")
    program.until(lambda: shown(own_path, sweep) and program.sees(ghost))
    program.in_front("Program")
    program.until(lambda: shown(dots) and program.sees(ghost))
    rig.arm.set_speed(to_rad(3.0))  # at half of that the rehearsal plays for over a minute
    planned(program)
    program.press("0.5×")
    program.until(lambda: program.sees(other_ghost))
    program.press("0.5×")
    program.until(lambda: shown(dots, other_path) and not program.sees(ghost))
    program.page.locator(".so101-steps button").first.click()  # what was asked for last is seen
    program.until(lambda: program.sees(ghost) and not program.sees(other_ghost))
    rig.arm.set_speed(to_rad(180.0))
    planned(program)


def test_waypoints_are_dragged_and_edits_are_shown_undone_and_redone(program, rig):
    page = program.page

    def click_sphere(k):
        page.mouse.click(*program.place_of(f"/program/dots/{k}"))
        page.wait_for_timeout(300)
        return "chosen" in (rows.nth(k).get_attribute("class") or "")

    def names():
        return page.locator(".so101-steps span").all_inner_texts()

    rows = page.locator(".so101-steps button")
    boxes = [{"x": 0.0, "y": 0.0}]

    def are_at_rest():
        before = list(boxes)
        boxes[:] = rows.evaluate_all(
            "rows => rows.map((row) => row.getBoundingClientRect().toJSON())"
        )
        page.wait_for_timeout(300)
        return boxes == before

    def drag_by_mouse():
        page.mouse.move(x0, y0)
        page.mouse.down()
        page.mouse.move(x0, y0 + 10.0)
        page.mouse.move(x1, y1)
        page.mouse.up()

    def drag_by_finger():
        x = page.locator(".so101-steps i").first.bounding_box()["x"] + 4.0
        program.finger((x, y0), (x, y0 + 12.0), (x, y1))  # by its number

    program.until(are_at_rest)
    (x0, y0), (x1, y1) = ((row["x"] + 40.0, row["y"] + 12.0) for row in boxes)
    for drag in (drag_by_mouse, drag_by_finger):
        program.until(lambda: names() == ["B", "C"])
        drag()
        program.until(lambda: names() == ["C", "B"])
        program.press("undo")

    program.until(lambda: click_sphere(0))
    program.fields("Name").filter(visible=True).first.fill(NAME)
    program.until(lambda: names() == [NAME, "C"])
    for button, there in (("undo", "B"), ("redo", NAME), ("undo", "B")):
        program.press(button)
        program.until(lambda there=there: names() == [there, "C"])

    def place():
        return program.pose_of("/program/dots/0")["position"]

    program.until(lambda: click_sphere(0))
    at_ready = place()
    program.press("re-record")  # to where the arm is
    p_home = rig.arm.model.frame(HOME, "tool").p
    program.until(lambda: np.allclose(place(), p_home, atol=1e-4))
    program.press("undo")
    program.until(lambda: np.allclose(place(), at_ready, atol=1e-4))
    assert at(HOME, rig)
