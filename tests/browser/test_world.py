"""The World tab: obstacles are added, dragged, held, saved and loaded, and plans avoid them."""

import json

import numpy as np
import pytest
from so101_viewer.page import history

from so101_motion.files.scene_file import read_scene, scene_to

RED, TEAL = 0xE03131, 0x0CA678
HOSTILE = "<img src=x onerror=window.PWNED=1>"


@pytest.fixture
def world(guest):
    """The World tab of an arm at home with nothing around it."""
    guest.in_front("World")
    guest.until(lambda: things(guest) == [])
    yield guest
    guest.in_front("Move")


def things(guest):
    """The nodes of things in the scene, the newest last."""
    nodes = [name for name in guest.nodes() if name.startswith("/world/")]
    return sorted((n for n in nodes if n[7:].isdigit()), key=lambda name: int(name[7:]))


def add(guest, kind):
    """Add a thing and return its node."""
    before = things(guest)
    guest.press(kind)
    guest.until(lambda: len(things(guest)) == len(before) + 1)
    guest.until(lambda: guest.says(f"Added {kind}"))
    return things(guest)[-1]


def shown(guest, label):
    """The fields behind a label of this tab; other tabs may have the same label."""
    return guest.fields(label).filter(visible=True)


def fill(guest, label, *values):
    fields = shown(guest, label)
    for k, value in enumerate(values):
        fields.nth(k).fill(value)
        fields.nth(k).press("Enter")
        guest.page.wait_for_timeout(80)  # the page sends one message per panel every 50 ms


def test_an_added_obstacle_is_drawn_and_planned_with_and_moves_nothing(world, rig, preview):
    def places():
        seen = (
            world.page.get_by_role("button", name=name, exact=True).filter(visible=True)
            for name in ("sphere", "undo", "attach to gripper", "delete")
        )
        return [each.first.bounding_box() for each in seen]

    arrows = preview._server.viser.scene._handle_from_node_name["/target"]
    q, stood = rig.arm.state.q, places()
    node = add(world, "box")
    world.until(lambda: len(rig.arm.scene.obstacles) == 1 and world.color_of(node) == TEAL)
    world.until(lambda: "/world-handles" in world.nodes())
    world.until(lambda: shown(world, "Size (mm)").count() == 3)
    assert places() == stood  # no button takes another's place
    world.until(lambda: not arrows.visible)  # one pair of handles at a time
    fill(world, "Size (mm)", "40", "50", "70")
    world.until(lambda: np.allclose(rig.arm.scene.obstacles[0].shape.size, [0.04, 0.05, 0.07]))
    world.until(  # its bottom stays, so its middle is higher; the page hears of it a little later
        lambda: (
            float(shown(world, "Position (mm)").nth(2).input_value() or 0)
            == pytest.approx(1e3 * rig.arm.scene.obstacles[0].T_base_obstacle.p[2], abs=0.1)
        )
    )
    fill(world, "Position (mm)", "250", "-100", "32.6")
    world.until(
        lambda: np.allclose(rig.arm.scene.obstacles[0].T_base_obstacle.p, [0.25, -0.1, 0.0326])
    )
    np.testing.assert_allclose(rig.arm.scene.obstacles[0].shape.size, [0.04, 0.05, 0.07])
    node = things(world)[-1]  # the browser hears of it a little later
    world.until(lambda: np.allclose(world.pose_of(node)["position"], [0.25, -0.1, 0.0326]))
    np.testing.assert_allclose(rig.arm.state.q, q, atol=1e-3)
    world.page.get_by_role("tab", name="Move").click()
    world.press("rest")
    world.until(lambda: arrows.visible)  # whoever aims anew sees the target's again
    world.page.get_by_role("tab", name="World").click()
    assert world.problems == []


def drag_up(world, node):
    """Drag the handle of what is selected upwards; whether the thing follows until it is let go."""
    before = world.pose_of(node)["position"][2]
    x, y = world.place_of("/world-handles", (0.0, 0.0, 0.07))
    mouse = world.page.mouse
    mouse.move(x, y)
    world.page.wait_for_timeout(400)
    mouse.down()
    for step in range(1, 9):
        mouse.move(x, y - 6 * step)
        world.page.wait_for_timeout(60)
    for _ in range(100):
        if world.pose_of(node)["position"][2] > before + 0.005:
            break
        world.page.wait_for_timeout(50)
    follows = world.pose_of(node)["position"][2] > before + 0.005
    mouse.up()
    return follows


def test_a_thing_is_selected_and_dragged_and_a_zone_is_red(world, rig, monkeypatch):
    monkeypatch.setattr(history, "ONE_DRAG", 60.0)  # a busy page drags slowly
    first = add(world, "box")
    add(world, "capsule")

    def is_selected():
        world.page.mouse.click(*world.place_of(first, (0.0, -0.02, -0.01)))
        world.page.wait_for_timeout(300)  # a busy browser may not know yet that it is there
        names = shown(world, "Name").evaluate_all("fields => fields.map((each) => each.value)")
        return "box 1" in names  # none are there while a click was too early

    def place():
        return rig.arm.scene.obstacles[0].T_base_obstacle.p

    world.until(is_selected)
    world.comes_to("box 1", lambda: shown(world, "Selected").first.input_value())
    world.until(lambda: world.color_of(first) == TEAL)
    before = place()
    # A busy browser may find the handle only after the button is down.
    world.until(lambda: drag_up(world, first))
    world.until(lambda: place()[2] > before[2] + 0.01)
    world.until(lambda: np.allclose(world.pose_of(first)["position"], place(), atol=1e-4))
    world.button("undo").first.click()  # all of the drag
    world.until(lambda: np.allclose(place(), before))
    world.until(lambda: np.allclose(world.pose_of("/world-handles")["position"], before))

    drawn = things(world)
    world.page.get_by_label("Keep-out zone").click()
    world.until(lambda: rig.arm.scene.obstacles[0].keep_out)
    world.until(lambda: len(things(world)) == 2 and things(world) != drawn)
    world.until(lambda: world.color_of(things(world)[-1]) == RED)
    world.press("attach to gripper")
    world.until(lambda: world.says("is a keep-out zone, which cannot be held"))


def test_a_saved_scene_comes_back_by_load_and_is_shown_as_viam_says_it(
    world, rig, scene_file, tmp_path
):
    add(world, "box")
    fill(world, "Name", HOSTILE)
    world.until(lambda: [o.name for o in rig.arm.scene.obstacles] == [HOSTILE])
    world.press("save")
    world.until(lambda: world.says(str(scene_file)))
    before = read_scene(scene_file)
    world.button("undo").last.click()
    world.until(lambda: not scene_file.exists())
    world.button("redo").last.click()
    world.until(lambda: scene_file.exists())
    saved = read_scene(scene_file)
    assert scene_to(saved) == scene_to(before)
    assert scene_to(saved) == scene_to(rig.arm.scene)
    with world.page.expect_download() as download:
        world.press("download")
    download.value.save_as(tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == scene_to(saved)

    world.press("delete")
    world.until(lambda: rig.arm.scene.obstacles == ())
    load(world, tmp_path / "again.json")
    world.until(lambda: rig.arm.scene == saved)
    assert world.page.locator("img[src=x]").count() == 0
    assert not any("img" in node for node in world.nodes())
    world.press("for Viam")
    text = world.page.get_by_label("The world_state of a Move request")
    world.until(lambda: text.count() == 1 and text.input_value())
    (group,) = json.loads(text.input_value())["obstacles"]
    assert group["referenceFrame"] == "arm_origin"
    assert group["geometries"][0]["label"] == HOSTILE
    assert world.page.evaluate("window.PWNED") is None
    world.press("Copy")
    world.until(lambda: world.button("Copied").count() == 1)


def load(guest, path):
    with guest.page.expect_file_chooser() as chooser:
        guest.press("Load")
    chooser.value.set_files(path)
