from __future__ import annotations

import io
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import viser
from conftest import PHONE, move_to
from harness.browser_user import HOME, READY, Guest
from PIL import Image
from so101_viewer import Preview
from viser import _messages

from so101_motion.common.geometry import SE3
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_mm, to_rad
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.planning.collision.scene import Obstacle, Scene, Sphere
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.rig import Rig

pytestmark = pytest.mark.browser


def at_rest(rig: Rig) -> bool:
    state = rig.arm.state
    return state.mode is Mode.HOLDING and not state.arm_moving


def far_from(q: np.ndarray, rig: Rig) -> bool:
    return float(np.max(np.abs(rig.arm.state.q - q))) > to_rad(1.0)


def start_slow_move(guest: Guest, rig: Rig) -> None:
    """Set out on a move that takes twenty seconds."""
    rig.arm.set_speed(to_rad(3.0))
    guest.plan()
    guest.press("Execute")
    guest.until(lambda: rig.arm.is_moving and far_from(HOME, rig))


def stands_on_the_way(rig: Rig) -> bool:
    return at_rest(rig) and far_from(HOME, rig) and far_from(READY, rig)


def expect_stopped_on_the_way(guest: Guest, rig: Rig) -> None:
    guest.until(lambda: guest.says("Stopped. The arm holds where it is."))
    guest.until(lambda: at_rest(rig))
    assert stands_on_the_way(rig)


def curves(guest: Guest, tab: str) -> int:
    """Over how many rows of the plot in a tab the joints' colours go; few when all is flat."""
    guest.page.get_by_role("tab", name=tab).click()
    plot = guest.page.locator(".uplot canvas").filter(visible=True).first
    picture = Image.open(io.BytesIO(plot.screenshot())).convert("HSV")
    _, saturation, value = (np.asarray(band, dtype=int) for band in picture.split())
    return int(np.any((saturation > 120) & (value > 120), axis=1).sum())


def test_the_link_opens_the_page_and_shows_the_arm(guest: Guest) -> None:
    assert {"/live/base_link", "/live/gripper_link", "/ghost/gripper_link", "/target"} <= (
        guest.nodes()
    )
    guest.until(lambda: guest.says("Idle, holding"))
    assert guest.page.locator("canvas").count() >= 1
    guest.until(lambda: guest.button("Execute").is_disabled())
    assert guest.problems == []


def test_without_the_key_there_is_only_a_refusal(
    visit: Callable[[], Guest], preview: Preview
) -> None:
    stranger = visit()
    reply = stranger.page.goto(preview.url.split("?")[0])
    assert reply is not None
    assert reply.status == 401
    assert "This link has expired" in stranger.words()


def test_the_page_reaches_nothing_but_its_own_server(guest: Guest, preview: Preview) -> None:
    own = (preview.url.split("?")[0], "data:", "blob:")
    assert [url for url in guest.asked if not url.startswith(own)] == []
    assert guest.asked


def test_a_crafted_link_cannot_bring_another_servers_scripts_into_our_page(
    opened: Guest, preview: Preview
) -> None:
    evil = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        visitors: list[object] = []
        evil._websock_server.on_client_connect(visitors.append)
        script = _messages.RunJavascriptMessage(source="window.PWNED = 1")
        evil._websock_server.queue_message(script)
        page = opened.page.context.new_page()  # it has our cookie
        log: list[str] = []
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


def test_a_switch_has_the_arm_go_around_what_comes_into_its_way(guest: Guest, rig: Rig) -> None:
    guest.type_target(100.0, 200.0, 200.0)
    guest.until(lambda: guest.says("Reachable. Press Plan."))
    guest.page.get_by_role("checkbox").filter(visible=True).last.click()
    guest.plan()
    guest.until(lambda: guest.button("Execute").is_enabled())
    guest.press("Execute")
    guest.until(lambda: rig.arm.newest_motion.plan is not None and rig.arm.is_moving)
    ball = Obstacle(
        name="ball",
        shape=Sphere(radius=0.02),
        T_base_obstacle=SE3.from_translation((0.0, 0.3, 0.3)),
    )
    before, rig.arm.scene = rig.arm.scene, Scene(obstacles=(ball,))
    guest.until(lambda: rig.arm.newest_motion.playing is not None)  # it is planned again
    guest.until(lambda: guest.says("Arrived"))
    rig.arm.scene = before
    guest.page.get_by_role("checkbox").filter(visible=True).last.click()


def test_two_buttons_plan_and_move_the_arm_to_the_target(guest: Guest, rig: Rig) -> None:
    guest.type_target(250.0, -120.0, 150.0)
    guest.until(lambda: guest.says("Reachable. Press Plan."))
    before = guest.pose_of("/live/gripper_link")

    guest.plan()
    guest.until(lambda: "/path" in guest.nodes())
    guest.until(lambda: guest.says("Peak speed"))
    guest.until(lambda: guest.page.locator(".uplot").count() >= 1)
    guest.until(lambda: np.allclose(guest.end_of_path(), [0.25, -0.12, 0.15], atol=1e-4))
    assert guest.pose_of("/live/gripper_link") == before  # planning moves nothing

    buttons = [guest.button(name) for name in ("Plan", "Execute", "0.25×", "open")]
    places = [button.bounding_box() for button in buttons]
    guest.press("Execute")
    guest.until(lambda: guest.says("Arrived"))
    assert [button.bounding_box() for button in buttons] == places  # none takes another's place
    p_tip = rig.arm.model.frame(rig.arm.state.q, "jaw_tip").p
    np.testing.assert_allclose(to_mm(p_tip), [250.0, -120.0, 150.0], atol=0.2)
    T_base_gripper = RobotModel.load().frame(rig.arm.state.q, "gripper_link")
    guest.until(
        lambda: np.allclose(
            guest.pose_of("/live/gripper_link")["position"], T_base_gripper.p, atol=5e-4
        )
    )
    guest.until(lambda: guest.button("Execute").is_disabled())
    assert guest.problems == []


def test_the_stop_button_ends_a_move_on_the_way(guest: Guest, rig: Rig) -> None:
    start_slow_move(guest, rig)
    guest.press("STOP")
    expect_stopped_on_the_way(guest, rig)


@pytest.mark.parametrize("key", ["Space", "Escape"])
def test_the_stop_keys_end_a_move_on_the_way(guest: Guest, rig: Rig, key: str) -> None:
    start_slow_move(guest, rig)
    guest.page.keyboard.press(key)
    expect_stopped_on_the_way(guest, rig)


def test_a_click_on_stop_is_not_lost_between_other_clicks(guest: Guest, rig: Rig) -> None:
    start_slow_move(guest, rig)
    guest.page.evaluate(
        """() => {
            const click = (name) =>
                [...document.querySelectorAll('button')]
                    .find((button) => button.innerText.trim() === name)
                    .click();
            ['home', 'STOP', 'rest'].forEach(click);
        }"""
    )
    guest.until(lambda: at_rest(rig))
    assert stands_on_the_way(rig)


def arrow(guest: Guest) -> tuple[float, float]:
    """Where the arrow up of the target is in the picture [px]."""
    return guest.place_of("/target", (0.0, 0.0, 0.085))


def drags_arrow(guest: Guest) -> bool:
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


def test_dragging_an_arrow_moves_the_target_and_the_ghost(guest: Guest, rig: Rig) -> None:
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


def finger_drags_target_down(guest: Guest) -> bool:
    """Whether it does; the picture may not have its size yet."""
    z = guest.pose_of("/target")["position"][2]
    x, y = arrow(guest)
    guest.finger((x, y), *((x, y + 1.5 * step) for step in range(1, 9)))
    guest.page.wait_for_timeout(500)
    return bool(guest.pose_of("/target")["position"][2] < z - 0.005)


def test_the_camera_follows_the_tool(guest: Guest, rig: Rig) -> None:
    guest.press("Follow")
    before = guest.page.evaluate("window.__viserMutable.camera.position.toArray()")
    move_to(rig, READY)
    guest.until(
        lambda: (
            np.linalg.norm(
                np.subtract(
                    guest.page.evaluate("window.__viserMutable.camera.position.toArray()"), before
                )
            )
            > 0.05
        )
    )
    guest.press("Home")


def test_the_joint_sliders_and_the_tool_aim_as_well(guest: Guest, rig: Rig) -> None:
    guest.page.get_by_text("Joints (°)").click()
    slider = guest.page.locator('[role="slider"][aria-valuemax="162.7"]')  # the wrist's roll

    def at_its_end() -> bool:
        slider.press("End")  # again, if the page was still unfolding
        return slider.get_attribute("aria-valuenow") == "162.7"

    guest.until(at_its_end)
    guest.page.get_by_text("Joints (°)").click()

    q = READY.copy()
    q[4] = to_rad(162.7)
    for frame, name in (("tool", "tool"), ("jaw_tip", "jaw tip")):
        guest.fields("Target for").first.click()
        guest.page.get_by_role("option", name=name).click()
        there_mm = to_mm(rig.arm.model.frame(q, frame).p)
        guest.until(lambda there_mm=there_mm: np.allclose(guest.target_mm(), there_mm, atol=0.2))
    assert not far_from(HOME, rig)


def test_a_pose_can_be_saved_and_comes_back_by_its_name(guest: Guest, rig: Rig) -> None:
    guest.page.get_by_text("My poses").click()
    guest.fields("Name").filter(visible=True).first.fill("<i>mine</i>")
    guest.page.wait_for_timeout(200)
    guest.press("target")
    guest.until(lambda: guest.says("Saved as <i>mine</i>."))
    ready_mm = guest.target_mm()
    guest.press("home")
    guest.until(lambda: guest.says("The arm is already there."))
    guest.press("set as target")
    guest.until(lambda: guest.target_mm() == ready_mm)
    assert [pose.name for pose in SavedPoses().own()] == ["<i>mine</i>"]
    guest.press("delete")
    guest.until(lambda: guest.says("Deleted <i>mine</i>."))
    guest.button("undo").filter(visible=True).last.click()
    guest.until(lambda: [pose.name for pose in SavedPoses().own()] == ["<i>mine</i>"])
    guest.until(lambda: guest.button("delete").count() == 1)
    guest.press("delete")
    guest.until(lambda: guest.says("Deleted <i>mine</i>."))
    guest.page.get_by_text("My poses").click()
    assert not far_from(HOME, rig)


def test_a_plan_is_played_and_shows_what_it_sweeps_and_its_curves(guest: Guest, rig: Rig) -> None:
    rig.arm.set_speed(to_rad(20.0))  # at a quarter of that it plays for many seconds
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
    width = over.bounding_box()["width"]  # type: ignore[index]
    over.click(position={"x": 0.5 * width, "y": 40.0})
    now = over.locator(".so101-now")
    guest.until(lambda: abs(now.bounding_box()["x"] - over.bounding_box()["x"] - 0.5 * width) < 5.0)  # type: ignore[index]
    guest.until(lambda: guest.pose_of("/ghost/gripper_link")["position"] != at_goal)
    handle = guest.page.get_by_role("slider", name="Preview (s)")
    end = float(handle.get_attribute("aria-valuemax") or "nan")
    guest.until(lambda: abs(float(handle.get_attribute("aria-valuenow") or 0) - 0.5 * end) < 0.1)
    assert at_rest(rig)
    assert not far_from(HOME, rig)


def test_a_reload_moves_nothing_and_keeps_the_plan(guest: Guest, rig: Rig) -> None:
    guest.plan()
    guest.page.reload()
    guest.until(lambda: guest.button("Execute").count() == 1)
    guest.until(lambda: "/path" in guest.nodes())
    guest.until(lambda: guest.button("Execute").is_enabled())
    assert at_rest(rig)
    assert not far_from(HOME, rig)


def test_the_arm_is_orange_and_its_ghost_blue(guest: Guest) -> None:
    def pixels() -> tuple[int, int]:
        """How many are orange, and how many the pale blue of the ghost."""
        picture = Image.open(io.BytesIO(guest.page.screenshot())).convert("HSV")
        width, height = picture.size
        scene = picture.crop((width // 4, height // 10, 3 * width // 4, 3 * height // 5))
        hue, saturation, value = (np.asarray(band, dtype=int) for band in scene.split())
        orange = (saturation > 120) & (value > 80) & (hue > 12) & (hue < 34)
        blue = (saturation > 20) & (saturation < 150) & (value > 120) & (hue > 140) & (hue < 170)
        return int(orange.sum()), int(blue.sum())

    with guest.looking():
        guest.until(lambda: min(pixels()) > 500, seconds=60.0)
        _, blue = pixels()
        guest.press("home")  # where the arm is: no ghost
        guest.until(lambda: guest.says("The arm is already there."))
        guest.until(lambda: blue > 500 + pixels()[1], seconds=60.0)
        orange, _ = pixels()
    assert orange > 500
