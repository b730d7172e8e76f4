import csv
import io
from functools import partial

import numpy as np
import viser
from harness.browser_user import HOME, PHONE, READY, Guest, move_to
from PIL import Image
from viser import _messages

from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_mm, to_rad
from so101_motion.planning.kinematics.model import RobotModel


def at_rest(rig):
    state = rig.arm.state
    return state.mode is Mode.HOLDING and not state.arm_moving


def far_from(q, rig):
    return float(np.max(np.abs(rig.arm.state.q - q))) > to_rad(1.0)


def curves(guest, tab):
    """Over how many rows of the plot in a tab the joints' colours go; few when all is flat."""
    guest.page.get_by_role("tab", name=tab).click()
    plot = guest.page.locator(".uplot canvas").filter(visible=True).first
    picture = Image.open(io.BytesIO(plot.screenshot())).convert("HSV")
    _, saturation, value = (np.asarray(band, dtype=int) for band in picture.split())
    return int(np.any((saturation > 120) & (value > 120), axis=1).sum())


def test_a_crafted_link_cannot_bring_another_servers_scripts_into_our_page(guest, preview):
    evil = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        visitors = []
        evil._websock_server.on_client_connect(visitors.append)
        script = _messages.RunJavascriptMessage(source="window.PWNED = 1")
        evil._websock_server.queue_message(script)
        page = guest.page.context.new_page()  # it has our cookie
        log = []
        page.on("console", lambda message: log.append(message.text))
        address = f"ws://127.0.0.1:{evil.get_port()}"
        page.goto(f"{preview.url.split('?')[0]}?websocket={address}")
        victim = Guest(page=page, problems=[], asked=[])
        victim.until(lambda: any(f"Connecting to: {address}" in line for line in log))
        page.wait_for_timeout(1000)
        assert visitors == []
        assert page.evaluate("window.PWNED") is None
        page.close()
    finally:
        evil.stop()


def test_a_target_is_planned_kept_over_a_reload_executed_and_its_run_downloaded(
    guest, preview, rig, tmp_path
):
    page = guest.page

    def caption():
        return page.locator("div:visible", has_text=" s; peak ").last.inner_text()

    def opacity():
        plot = page.locator(".uplot .u-wrap").filter(visible=True).first
        return float(plot.evaluate("plot => getComputedStyle(plot).opacity"))

    def in_front(tab):
        page.get_by_role("tab", name=tab, exact=True).click()

    assert {"/live/base_link", "/live/gripper_link", "/ghost/gripper_link", "/target"} <= (
        guest.nodes()
    )
    guest.until(lambda: guest.says("holding"))  # idle, or stopped by an earlier test
    guest.type_target(250.0, -120.0, 150.0)
    guest.until(lambda: guest.says("Reachable. Press Plan."))
    before = guest.pose_of("/live/gripper_link")
    guest.plan()
    guest.until(lambda: guest.says("Peak speed"))
    page.reload()
    guest.until(lambda: guest.button("Execute").count() == 1)
    guest.until(lambda: "/path" in guest.nodes() and guest.button("Execute").is_enabled())
    guest.until(lambda: np.allclose(guest.end_of_path(), [0.25, -0.12, 0.15], atol=1e-4))
    assert guest.pose_of("/live/gripper_link") == before  # neither moves anything

    in_front("Velocity")
    guest.until(lambda: caption().startswith("Plan "))
    name = caption().split(",")[0]
    guest.comes_to(1.0, opacity)
    drawn = page.get_by_role("img", name="Plot of velocity (°/s), over time")
    guest.until(lambda: drawn.filter(visible=True).count() == 1)  # for who cannot see it
    in_front("Share")
    guest.until(lambda: guest.says(f"{name}. Choose a file type."))
    in_front("Move")
    buttons = [guest.button(name) for name in ("Plan", "Execute", "0.25×", "open")]
    places = [button.bounding_box() for button in buttons]
    guest.press("Execute")
    guest.until(lambda: guest.says("Arrived"))
    assert [button.bounding_box() for button in buttons] == places  # none takes another's place
    p_tip = rig.arm.model.frame(rig.arm.state.q, "jaw_tip").p
    np.testing.assert_allclose(to_mm(p_tip), [250.0, -120.0, 150.0], atol=0.2)
    p_gripper = RobotModel.load().frame(rig.arm.state.q, "gripper_link").p
    guest.until(
        lambda: np.allclose(guest.pose_of("/live/gripper_link")["position"], p_gripper, atol=5e-4)
    )
    guest.until(lambda: guest.button("Execute").is_disabled())
    guest.until(lambda: caption().startswith(f"{name}, no longer current") and opacity() == 0.5)
    in_front("Tracking")
    guest.until(lambda: guest.says(f"{name}: RMS"))

    in_front("Share")
    guest.until(lambda: guest.says(f"{name}, no longer current. Choose a file type."))
    for label, wanted in (("Motion", "The last run"), ("File", "Table, degrees (CSV)")):
        field = guest.fields(label).filter(visible=True).first
        guest.until(field.is_enabled)
        field.click()
        page.get_by_role("option", name=wanted).click()
        guest.until(lambda field=field, wanted=wanted: wanted in field.input_value())
        page.wait_for_timeout(300)  # the page sends one message per panel every 50 ms
    with page.expect_download() as download:
        guest.press("Download")
    download.value.save_as(tmp_path / "run.csv")
    assert download.value.suggested_filename.startswith("so101-run-")
    last = list(csv.DictReader((tmp_path / "run.csv").read_text().splitlines()))[-1]
    end = np.radians([float(last[f"{joint}_measured_deg"]) for joint in ARM_JOINTS])
    np.testing.assert_allclose(end, rig.arm.state.q, atol=0.02)
    move_to(rig, 0.5 * READY)  # somebody else moves it
    in_front("Move")
    guest.until(lambda: guest.says("Another motion: RMS"))
    in_front("Velocity")
    own = (preview.url.split("?")[0], "data:", "blob:")
    assert [url for url in guest.asked if not url.startswith(own)] == []
    assert guest.asked
    assert guest.problems == []


BETWEEN_CLICKS = """() => {
    const click = (name) =>
        [...document.querySelectorAll('button')]
            .find((button) => button.innerText.trim() === name)
            .click();
    ['home', 'STOP', 'rest'].forEach(click);
}"""


def test_stop_between_two_other_clicks_ends_a_move_on_the_way(guest, rig):
    rig.arm.set_speed(to_rad(3.0))  # for twenty seconds
    guest.plan()
    guest.press("Execute")
    guest.until(lambda: rig.arm.state.arm_moving and far_from(HOME, rig))
    guest.page.evaluate(BETWEEN_CLICKS)
    guest.until(lambda: at_rest(rig))
    assert far_from(HOME, rig)
    assert far_from(READY, rig)


def arrow(guest):
    """Where the arrow up of the target is in the picture [px]."""
    return guest.place_of("/target", (0.0, 0.0, 0.085))


def drags_arrow(guest):
    """Drag the arrow and keep it; whether it is, a busy page may miss where the mouse is."""
    x, y = arrow(guest)
    mouse = guest.page.mouse
    mouse.up()
    mouse.move(x, y)
    guest.page.wait_for_timeout(200)
    mouse.down()
    for step in range(1, 9):
        mouse.move(x, y - 6 * step)
        guest.page.wait_for_timeout(60)
    for _ in range(60):
        if "/reach" in guest.nodes():  # what is within reach is shaded meanwhile
            return True
        guest.page.wait_for_timeout(50)
    return False


def test_dragging_an_arrow_moves_the_target_and_the_ghost(guest, rig):
    before = guest.pose_of("/target")["position"]
    ghost_before = guest.pose_of("/ghost/gripper_link")["position"]
    guest.until(lambda: drags_arrow(guest))
    guest.page.mouse.up()
    guest.until(lambda: "/reach" not in guest.nodes())
    guest.until(lambda: guest.pose_of("/ghost/gripper_link")["position"] != ghost_before)
    after = guest.pose_of("/target")["position"]
    assert after[2] - before[2] > 0.01
    guest.until(lambda: guest.target_mm()[2] > to_mm(before[2]) + 10.0)

    for width, height in (PHONE, (820, 1180)):
        guest.page.set_viewport_size({"width": width, "height": height})
        guest.until(partial(finger_drags_target_down, guest))
    assert at_rest(rig)
    assert not far_from(HOME, rig)


def finger_drags_target_down(guest):
    """Whether it does; the picture may not have its size yet."""
    z = guest.pose_of("/target")["position"][2]
    x, y = arrow(guest)
    guest.finger((x, y), *((x, y + 1.5 * step) for step in range(1, 9)))
    guest.page.wait_for_timeout(500)
    return bool(guest.pose_of("/target")["position"][2] < z - 0.005)


def test_a_plan_is_played_and_shows_what_it_sweeps_and_its_curves(guest, rig):
    rig.arm.set_speed(to_rad(5.0))  # at a quarter of that it plays for minutes
    guest.plan()
    guest.until(lambda: guest.says("Clearance"))
    guest.until(lambda: {"/sweep/gripper_link", "/sweep/shoulder_link"} <= guest.nodes())
    at_goal = guest.pose_of("/ghost/gripper_link")["position"]
    guest.press("0.25×")
    guest.until(lambda: guest.pose_of("/ghost/gripper_link")["position"] != at_goal)
    seen = {tuple(guest.pose_of("/ghost/gripper_link")["position"])}
    guest.until(
        lambda: seen.add(tuple(guest.pose_of("/ghost/gripper_link")["position"])) or len(seen) > 3
    )
    guest.press("0.25×")
    guest.until(lambda: curves(guest, "Velocity") > 10)
    over = guest.page.locator(".u-over").filter(visible=True).first
    width = over.bounding_box()["width"]
    now = over.locator(".so101-now")

    def goes_to_the_middle():
        """Whether a click does; the page may just be drawing the curves anew."""
        over.click(position={"x": 0.5 * width, "y": 40.0})
        guest.page.wait_for_timeout(500)
        return abs(now.bounding_box()["x"] - over.bounding_box()["x"] - 0.5 * width) < 5.0

    guest.until(goes_to_the_middle)
    guest.until(lambda: guest.pose_of("/ghost/gripper_link")["position"] != at_goal)
    handle = guest.page.get_by_role("slider", name="Preview (s)")
    end = float(handle.get_attribute("aria-valuemax") or "nan")
    guest.until(lambda: abs(float(handle.get_attribute("aria-valuenow") or 0) / end - 0.5) < 0.02)
    assert at_rest(rig)
    assert not far_from(HOME, rig)
