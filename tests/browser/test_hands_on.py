"""What hands do on the page: lead the arm, turn the picture, let the arm go."""

from itertools import pairwise

import numpy as np
import pytest
from harness.browser_user import READY, move_to

from so101_motion.common.modes import Mode

VIEW = "window.__viserMutable.camera.position.toArray()"


def tip(rig):
    return rig.arm.model.frame(rig.arm.state.q_ref, "tool").p


def moves(rig):
    return bool(np.any(np.abs(rig.arm.state.qd_ref) > 1e-3))


@pytest.fixture
def jogging(guest, rig):
    """A window that jogs an arm in its ready pose."""
    move_to(rig, READY)
    guest.in_front("Jog")
    switch_on(guest)
    yield guest
    choose(guest, "slow", "joints")
    rig.arm.stop()
    guest.in_front("Move")


def switch_on(guest):
    guest.press("Start jogging")
    guest.until(lambda: guest.page.get_by_label("gripper, open").is_enabled())


def is_chosen(guest, name):
    return guest.button(name).get_attribute("aria-pressed") == "true"


def choose(guest, *names):
    for name in names:
        guest.press(name)
        guest.until(lambda name=name: is_chosen(guest, name))


def test_the_arm_follows_the_arrows_as_long_as_they_are_dragged(jogging, rig):
    choose(jogging, "arrows", "fast")
    jogging.until(lambda: jogging.says("Drag the target's arrows"))
    before, mouse = tip(rig), jogging.page.mouse

    def leads_up():
        """Whether a drag does; a busy page may miss where the mouse is, or let go on the way."""
        x, y = jogging.place_of("/target", (0.0, 0.0, 0.085))
        mouse.move(x, y)
        jogging.page.wait_for_timeout(300)
        mouse.down()
        for step in (*range(1, 9), *(7, 8) * 10):
            mouse.move(x, y - 5 * step)
            jogging.page.wait_for_timeout(80)
            if tip(rig)[2] - before[2] > 0.003:
                break
        mouse.up()
        jogging.until(lambda: not moves(rig))
        return bool(tip(rig)[2] - before[2] > 0.003)

    jogging.until(leads_up)


def test_the_views_turn_the_picture(guest):
    def view():
        return np.asarray(guest.page.evaluate(VIEW))

    def rests():
        before = view()
        guest.page.wait_for_timeout(300)
        return bool(np.all(view() == before))

    seen = []
    for name in ("Top", "Home", "Front", "Side"):
        before = view()
        guest.button(name).click()
        guest.until(lambda before=before: float(np.linalg.norm(view() - before)) > 0.1)
        guest.until(rests)
        seen.append(view())
    assert min(np.linalg.norm(a - b) for a, b in pairwise(seen)) > 0.1
    guest.button("Home").click()
    guest.until(lambda: float(np.linalg.norm(view() - seen[1])) < 0.01)


def test_a_grey_button_says_why_letting_go_asks_first_and_hold_holds_again(guest, watcher, rig):
    guest.until(lambda: guest.button("Hold").is_disabled())
    guest.button("Hold").click(force=True)
    guest.until(lambda: guest.says("Hold: The joints are held already."))
    assert guest.button("Hold").get_attribute("title") == "The joints are held already."
    assert rig.arm.state.mode is Mode.HOLDING
    guest.until(lambda: not guest.says("Hold: The joints are held already."))
    watcher.until(lambda: watcher.button("Let go").is_disabled())
    watcher.button("Let go").click(force=True)
    watcher.until(lambda: watcher.says("Let go: Another window has control: here only STOP works."))

    guest.press("Let go")
    guest.until(lambda: guest.page.locator("#so101-buttons .asks").count() == 1)
    assert rig.arm.state.mode is Mode.HOLDING
    guest.let_go(lambda: rig.arm.state.mode is Mode.LIMP)
    guest.until(lambda: guest.says("The arm is limp. Press Hold to keep it where it is."))
    guest.until(lambda: guest.button("Hold").is_enabled())
    guest.press("Hold")
    guest.until(lambda: rig.arm.state.mode is Mode.HOLDING)
    guest.until(lambda: guest.says("The arm holds again. Set a target, then press Plan."))
