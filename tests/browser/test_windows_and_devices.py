"""The page in several windows, on phones, in dark mode, and from the keyboard."""

from functools import partial

import numpy as np
from harness.browser_user import ASIDE, HOME, LAPTOP, PHONE

from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad

SMALL = (1120, 700)  # the least with panels on both sides


def at_rest(rig):
    """Whether it holds, short of where a crawl ends by itself."""
    is_short = np.abs(rig.arm.state.q - ASIDE).max() > to_rad(1.0)
    return bool(rig.arm.state.mode is Mode.HOLDING and not rig.arm.state.arm_moving and is_short)


CUT_OFF = """
const send = window.so101.send;
window.so101.send = (...what) => { if (!window.cut) send(...what); };
"""


def test_one_window_has_control_until_another_takes_it_loses_its_network_or_is_closed(
    guest, crawl, visit, preview, rig
):
    second = visit(SMALL)
    second.open(preview.url)
    second.until(lambda: second.says("has control. Stop works here too"))
    guest.plan()
    second.until(lambda: second.button("Execute").is_enabled())  # it sees all that happens
    before = guest.target_mm()
    second.until(lambda: second.target_mm() == before)
    field = second.fields("Target (mm)").first
    field.fill("17")
    field.press("Enter")
    second.until(lambda: second.target_mm() == before)
    assert guest.target_mm() == before
    second.press("Execute")
    second.until(lambda: second.says("Nothing was changed."))
    np.testing.assert_allclose(rig.arm.state.q, HOME, atol=to_rad(0.5))

    crawl()
    second.press("STOP")
    second.until(lambda: at_rest(rig))
    second.in_front("Events")
    second.until(lambda: second.says("Stop pressed in window "))

    def moves():
        return abs(rig.arm.state.qd_ref[0]) > 1e-3

    second.press("Take control")
    guest.until(lambda: guest.says("has control. Stop works here too"))
    guest.press("home")
    guest.until(lambda: guest.says("Nothing was changed."))
    second.in_front("Jog")
    second.press("Start jogging")
    second.until(lambda: second.says("Hold a button or its key."))
    second.page.evaluate(CUT_OFF)
    second.page.keyboard.down("q")
    second.until(moves)
    second.page.evaluate("window.cut = true")  # nothing arrives any more
    second.until(lambda: not moves())
    second.page.keyboard.up("q")
    second.page.evaluate("window.cut = false")
    second.page.keyboard.down("a")
    second.until(moves)
    second.leave()  # nobody has control then, and nobody has to be asked
    guest.until(lambda: not moves())
    guest.until(lambda: not guest.says("has control. Stop works here too"))
    guest.press("home")
    guest.until(lambda: not guest.button("Execute").is_enabled())
    guest.in_front("Jog")
    guest.until(lambda: guest.says("Off. Start jogging"))


def box(where):
    """Left, top, right, bottom."""
    found = where.bounding_box()
    assert found is not None
    x, y = found["x"], found["y"]
    return x, y, x + found["width"], y + found["height"]


def overlap(a, b):
    return a[0] < b[2] - 1 and b[0] < a[2] - 1 and a[1] < b[3] - 1 and b[1] < a[3] - 1


def is_apart(one, other):
    return not overlap(box(one), box(other.first))


def crowded(guest, width, height):
    """What has too little room, or is in the way of something, in a small window."""
    page = guest.page
    left, top, right, bottom = box(page.locator("#so101-stop"))
    views, picture = box(page.locator("#so101-views")), box(page.locator("canvas").first)
    faults = []
    if left < 0 or right > width or bottom >= 0.2 * height or min(right - left, bottom - top) < 44:
        faults.append("a thumb misses Stop")
    for name in ("Plan", "home", "Hold", "Let go"):
        above, below = box(guest.button(name))[1::2]
        if below - above < 44:
            faults.append(f"{name} is too low")
    notices = page.locator(".mantine-Notification-root").evaluate_all(  # drawn without a GPU
        "all => all.map((its) => its.getBoundingClientRect())"
        ".map(({left, top, right, bottom}) => [left, top, right, bottom])"
    )
    if any(overlap(views, notice) for notice in notices):
        faults.append("a notice covers the views")
    said = 0.0
    if width < 700:  # on a phone, what is said stands above the picture, not over the arm
        alerts = box(page.locator("#so101-alerts"))
        said = alerts[3] - alerts[1]
        if said <= 20.0 or overlap(alerts, picture) or overlap(alerts, views):
            faults.append("what is said has no place of its own")
        if views[1] < 0.5 * (picture[1] + picture[3]) or views[3] > picture[3]:
            faults.append("the views lie over the arm, or beside the picture")
        if picture[3] - picture[1] <= 0.2 * height:
            faults.append("the picture is too low")
    if (picture[2] - picture[0]) * (picture[3] - picture[1] + said) <= 0.3 * width * height:
        faults.append("the picture is too small")
    return faults


def front_tab(guest, name):
    tab = guest.page.get_by_role("tab", name=name, exact=True)
    return tab.get_attribute("aria-selected") if tab.count() == 1 else None


def test_on_phones_and_tablets_bar_picture_and_panels_have_places_of_their_own(
    guest, crawl, watcher, rig
):
    small, page = watcher, watcher.page
    crawl()
    state = page.locator("#so101-state")
    small.until(lambda: state.inner_text().startswith("Moving"))
    panels = page.locator(".mantine-Paper-root").first
    for width, height in (PHONE, (820, 1180), (1024, 700)):
        small.resize((width, height))
        small.until(lambda width=width: box(page.locator("#so101-bar"))[2] == width)
        small.until(lambda: is_apart(page.locator("#so101-bar"), panels))
        small.until(lambda: not overlap(box(panels), box(page.locator("canvas").first)))
        small.comes_to([], partial(crowded, small, width, height))
    page.locator("#so101-stop").click()
    small.until(lambda: at_rest(rig))
    small.resize((390, 844))
    for tab, name in (("Program", "Record waypoint"), ("Jog", "gripper, open")):
        page.get_by_role("tab", name=tab).click()  # and what is used most needs no scrolling
        small.until(lambda name=name: box(small.button(name))[3] <= 844)
    for size in (LAPTOP, (390, 844)):  # where all panels are built anew
        small.resize(size)
        small.until(lambda: front_tab(small, "Jog") == "true")
    page.get_by_role("button", name="Health").click()  # folded at the end of the column
    meets_no_barrier(small, "Jog", "Events")
    meets_no_barrier(small, "Program")


def test_light_and_dark_windows_keep_nobody_with_other_eyes_or_hands_away_and_move_nothing(
    guest, rig
):
    before = rig.arm.state.q_ref
    guest.press("Plan")  # for the plots to show something

    def scheme():
        told = guest.page.evaluate(
            "() => { const root = document.documentElement; return ["
            "root.getAttribute('data-mantine-color-scheme'),"
            "getComputedStyle(root).getPropertyValue('--so101-bad').trim()]; }"
        )
        return told

    for shade, bad in (("light", "#c92a2a"), ("dark", "#ff8787")):
        guest.page.emulate_media(color_scheme=shade)
        guest.comes_to([shade, bad], scheme)
        # Each colour of ours is looked at in tests/unit/viewer/server/test_request_policy.py.
        meets_no_barrier(guest, "Program", "Health", "Velocity")
        if shade == "light":
            for tabs in (("Jog",), ("World",), ("Share", "Record"), ("Teach",), ("Pick",)):
                meets_no_barrier(guest, *tabs)
        meets_no_barrier(guest, "Move", "Events", "Tracking")
    guest.page.emulate_media(color_scheme="light")  # a new day
    guest.comes_to(["light", "#c92a2a"], scheme)
    np.testing.assert_array_equal(rig.arm.state.q_ref, before)
    assert guest.problems == []


VIEW = "window.__viserMutable.camera.position.toArray()"

GAMEPAD = """
window.pad = {connected: true, axes: [0, 0, 0, 0], buttons: [...Array(16)].map(() => ({value: 0}))};
navigator.getGamepads = () => [null, window.pad];
window.dispatchEvent(new Event('gamepadconnected'));
"""


def test_jogging_lasts_as_long_as_a_key_or_a_button_or_one_of_a_gamepad_is_held(guest, rig):
    page = guest.page

    def turns():
        return float(rig.arm.state.qd_ref[0])

    def moves():
        return abs(turns()) > to_rad(1.0)

    def holds(pressed, stick):
        page.evaluate(
            "([pressed, stick]) => { window.pad.axes[0] = stick;"
            " window.pad.buttons[5].pressed = pressed; }",
            [pressed, stick],
        )

    page.get_by_role("tab", name="Jog").click()
    view = page.evaluate(VIEW)
    page.keyboard.press("q")  # off until it is switched on
    page.keyboard.down("s")  # viser's own keys fly through the picture, these do not
    page.wait_for_timeout(500)
    page.keyboard.up("s")
    np.testing.assert_allclose(page.evaluate(VIEW), view, atol=1e-3)
    guest.press("Start jogging")
    guest.until(lambda: guest.says("Hold a button or its key."))
    assert at_rest(rig) or not moves()
    for let_go in (
        lambda: page.keyboard.up("q"),
        lambda: page.evaluate("dispatchEvent(new Event('blur'))"),  # the window is left
    ):
        page.keyboard.down("q")
        guest.until(moves)
        let_go()
        guest.until(lambda: not moves())
        page.keyboard.up("q")
    x, y, right, bottom = box(page.get_by_label("shoulder_pan, less"))
    page.mouse.move(0.5 * (x + right), 0.5 * (y + bottom))
    page.mouse.down()
    guest.until(moves)
    page.mouse.up()
    guest.until(lambda: not moves())

    page.evaluate(GAMEPAD)
    holds(False, 1.0)
    page.wait_for_timeout(200)
    assert not moves()
    holds(True, 1.0)
    guest.until(lambda: turns() < -to_rad(1.0))
    holds(True, 0.1)  # a stick that does not come back to its middle quite
    guest.until(lambda: abs(turns()) < 1e-6)
    holds(True, -1.0)
    guest.until(lambda: turns() > to_rad(1.0))
    page.evaluate("window.pad.connected = false")  # its battery is empty
    guest.until(lambda: abs(turns()) < 1e-6)
    page.evaluate("navigator.getGamepads = () => []")

    page.keyboard.down("q")
    guest.until(moves)
    page.keyboard.press("Space")  # Stop ends it, whatever is held
    guest.until(lambda: at_rest(rig) and guest.says("Stopped. Start jogging to go on."))
    page.keyboard.up("q")
    assert guest.problems == []


def meets_no_barrier(guest, *tabs):
    """Look for barriers with these tabs of different panels in front."""
    for name in tabs:
        tab = guest.page.get_by_role("tab", name=name, exact=True)
        tab.click()
        guest.comes_to("true", lambda tab=tab: tab.get_attribute("aria-selected"))
    guest.page.wait_for_timeout(400)
    guest.comes_to([], guest.barriers)  # names come a moment later


CHANGING = """
window.hits = [];
const hold = document.body.appendChild(document.createElement('div'));
hold.id = 'hold';
hold.style = 'position:fixed;z-index:9900;left:100px;top:300px';
const show = (names) => {
  hold.innerHTML = names.map((name) => `<button style="width:90px">${name}</button>`).join('');
  for (const each of hold.children) each.onclick = () => {
    window.hits.push(each.textContent);
    if (each.textContent === 'first') show(['other', 'same']);
  };
};
show(['first', 'same']);
"""


def test_the_second_half_of_a_double_click_hits_no_other_button(guest):
    page = guest.page
    page.evaluate(CHANGING)
    guest.double_click(145.0, 308.0)  # a button that makes room for another one
    guest.double_click(235.0, 308.0)  # one that may be pressed often
    guest.comes_to(["first", "same", "same"], lambda: page.evaluate("window.hits"))
    page.wait_for_timeout(700)
    page.mouse.click(145.0, 308.0)
    guest.comes_to(["first", "same", "same", "other"], lambda: page.evaluate("window.hits"))
    page.evaluate("document.querySelector('#hold').remove()")


def test_p_plans_escape_and_space_stop_also_in_a_field_and_no_other_key_moves_the_arm(
    guest, crawl, rig
):
    guest.page.keyboard.press("p")
    guest.until(lambda: guest.button("Execute").is_enabled())
    guest.page.evaluate("document.activeElement.blur()")  # else Enter presses that button again
    for key in ("Enter", "e", "x", "g", "ArrowUp"):
        guest.page.keyboard.press(key)
    guest.page.wait_for_timeout(300)
    assert at_rest(rig)
    guest.until(lambda: guest.button("Execute").is_enabled())

    crawl()
    guest.fields("Target for").first.click()  # Escape closes an open list first
    guest.until(lambda: guest.page.get_by_role("option", name="jaw tip").is_visible())
    guest.page.keyboard.press("Escape")
    guest.until(lambda: not guest.page.get_by_role("option", name="jaw tip").is_visible())
    assert rig.arm.state.arm_moving
    guest.page.keyboard.press("Control+k")  # no list of commands that would cover Stop
    guest.fields("Target (mm)").first.click()
    guest.page.keyboard.press("Escape")
    guest.until(lambda: at_rest(rig))
    assert guest.page.get_by_placeholder("Search commands").count() == 0
    assert guest.page.locator(".tabler-icon-adjustments").filter(visible=True).count() == 0

    world = guest.page.get_by_role("tab", name="World")
    floor = guest.page.get_by_role("checkbox").last
    for field in (guest.fields("Target (mm)").first, floor):
        if field is floor:
            world.click()
        crawl()
        field.click()
        guest.page.keyboard.press("Space")
        guest.until(lambda: at_rest(rig))
