import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from so101_viewer.page.screen_state import Tone
from so101_viewer.scene import scene_edits
from so101_viewer.scene.scene_edits import held, holder_of, let_go
from so101_viewer.world.scene_user import ArmsOfCell
from so101_viewer.world.world_model import DRAG_PERIOD, OverlapCheck, WorldModel, in_each_other

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.files.cell_file import CellArm, CellFile, read_cell
from so101_motion.files.scene_file import read_scene, scene_to
from so101_motion.planning.collision.scene import Attached, Box, Obstacle, Scene, Sphere
from so101_motion.planning.kinematics.model import RobotModel

TOOL = SE3.from_rpy((0.3, 0.0, 0.5), (0.25, 0.05, 0.2))


@pytest.fixture
def world(tmp_path):
    return WorldModel(Scene(), file=tmp_path / "kept" / "scene.json")


def box_at(p, *, name="block", size=0.06):
    shape = Box(size=np.full(3, size))
    return Obstacle(name=name, shape=shape, T_base_obstacle=SE3.from_translation(p))


def test_what_is_added_is_selected_and_can_be_taken_back(world):
    world.add("box")
    world.add("sphere")
    assert world.names == ("box 1", "sphere 1")
    assert world.selected == "sphere 1"
    world.history.undo()
    assert world.names == ("box 1",)
    assert world.selected is None
    world.history.undo()
    assert world.scene == Scene()
    assert not world.history.can_undo
    world.history.undo()
    world.history.redo()
    world.history.redo()
    assert world.names == ("box 1", "sphere 1")
    assert not world.history.can_redo


def test_numbers_change_the_selected_thing_or_nothing_where_they_cannot_be(world):
    world.add("box")
    foot = world.thing.T_base_obstacle.p[2] - 0.02
    world.resize(size=np.array([0.1, 0.2, 0.3]))
    assert world.thing.T_base_obstacle.p[2] == pytest.approx(foot + 0.15)
    world.move_to(np.array([0.3, 0.0, 0.15]))
    world.turn_to(np.array([0.0, 0.0, 0.5]))
    thing = world.thing
    np.testing.assert_allclose(thing.shape.size, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(thing.T_base_obstacle.p, [0.3, 0.0, 0.15])
    np.testing.assert_allclose(thing.T_base_obstacle.rpy, [0.0, 0.0, 0.5], atol=1e-12)
    before = world.scene
    with pytest.raises(ConfigError, match=r"size must be 0 to 100000 mm, not -200 mm$"):
        world.resize(size=np.array([0.1, -0.2, 0.3]))
    with pytest.raises(ConfigError, match=r"mass must be 0 to 100000 g, not -50 g$"):
        world.set_mass(-0.05)
    with pytest.raises(ConfigError):
        world.move_to(np.array([0.1, np.nan, 0.3]))
    assert world.scene is before
    world.set_keep_out(True)
    assert world.thing.keep_out
    world.rename("lamp  zone")
    assert world.selected == "lamp zone"
    world.set_floor(None)
    assert world.scene.floor_z is None


def test_edits_without_a_selection_are_refused_in_a_sentence(world):
    for edit in (
        world.remove,
        lambda: world.rename("x"),
        lambda: world.resize(radius=0.1),
        lambda: world.move_to(np.zeros(3)),
        lambda: world.hold(TOOL),
    ):
        with pytest.raises(ConfigError, match="select an object first"):
            edit()


def test_a_drag_is_one_entry_for_undo_and_is_handed_on_now_and_then(world):
    world.add("box")
    assert world.due(0.0) is world.scene
    assert world.due(0.0) is None
    before = world.scene
    given = 0
    for k in range(1, 51):
        world.drag(SE3.from_translation((0.2, 0.001 * k, 0.05)), TOOL)
        given += world.due(0.01 * k) is not None
    assert given <= 0.5 / DRAG_PERIOD + 1
    world.drop()
    assert world.due(0.5) is world.scene
    np.testing.assert_allclose(world.thing.T_base_obstacle.p, [0.2, 0.05, 0.05])
    world.history.undo()
    assert world.scene is before


def test_a_hold_without_a_move_is_no_edit_and_a_thing_that_went_away_is_let_alone(world):
    world.add("box")
    before = world.scene
    world.drag(world.thing.T_base_obstacle, TOOL)
    assert world.scene is before
    assert not world.dragging
    world.remove()
    world.drag(SE3.identity(), TOOL)
    assert world.names == ()


def test_what_one_of_several_arms_holds_outlasts_a_loaded_scene_and_is_not_in_its_file(world):
    world.add("sphere")
    world.hold(TOOL, "arm 2")
    assert world.sentence.text.startswith("arm 2 holds sphere 1")
    content = world.as_file()
    assert "sphere" not in content.decode()
    world.load("scene.json", content)
    assert [holder_of(each) for each in world.scene.attached] == ["arm 2"]


def test_what_is_held_is_dragged_and_moved_in_the_hand(world):
    world.add("sphere")
    world.move_to(TOOL @ np.array([0.0, 0.0, 0.12]))
    world.hold(TOOL)
    assert world.sentence.text.endswith("the tip is 100 mm away.")
    assert isinstance(world.thing, Attached)
    world.drag(TOOL @ SE3.from_translation((0.0, 0.0, 0.05)), TOOL)
    world.drop()
    np.testing.assert_allclose(world.thing.T_tool_object.p, [0.0, 0.0, 0.05], atol=1e-12)
    world.set_mass(0.02)
    assert world.thing.mass == 0.02
    world.let_go(TOOL)
    np.testing.assert_allclose(
        world.thing.T_base_obstacle.p, TOOL.R @ [0.0, 0.0, 0.05] + TOOL.p, atol=1e-12
    )
    assert [each.mass for each in world.scene.items] == [0.02]
    world.set_mass(0.0)
    assert not world.scene.items


def test_a_saved_scene_is_what_a_plan_reads_and_a_file_that_cannot_be_written_is_named(world):
    world.add("capsule")
    world.rename('<img src=x onerror="alert(1)">')
    world.save()
    assert world.sentence.tone is Tone.GOOD
    assert str(world.file) in world.sentence.text
    assert scene_to(read_scene(world.file)) == scene_to(world.scene)
    assert json.loads(world.as_file()) == json.loads(world.file.read_bytes())
    with pytest.raises(ConfigError, match=r"scene\.json"):  # its folder is a file
        WorldModel(Scene(), file=world.file / "scene.json").save()


def test_an_edit_that_cannot_be_planned_with_is_taken_back_and_it_is_said_why(world):
    world.set_floor(None)
    world.set_floor(0.02)
    world.refuse(ConfigError("rpy_deg", [10, 0, 0], '"left" does not stand upright'))
    assert world.scene.floor_z is None
    assert "does not stand upright" in world.sentence.text
    assert world.sentence.tone is Tone.BAD


def test_a_loaded_scene_takes_the_place_of_what_was_there_and_can_be_taken_back(world):
    world.add("box")
    saved = json.dumps(scene_to(Scene(obstacles=(box_at((0.2, 0.2, 0.1)),), floor_z=None)))
    world.load("table.json", saved.encode())
    assert world.names == ("block",)
    assert world.scene.floor_z is None
    assert world.selected is None
    world.history.undo()
    assert world.names == ("box 1",)


def test_a_mesh_is_added_around_its_middle(world):
    body = trimesh.creation.box((20.0, 30.0, 40.0))
    body.apply_translation((500.0, 0.0, 0.0))
    world.load("Cup.STL", body.export(file_type="stl"))
    np.testing.assert_allclose(np.ptp(world.thing.shape.vertices, axis=0), [0.02, 0.03, 0.04])
    np.testing.assert_allclose(world.thing.shape.vertices.mean(axis=0), np.zeros(3), atol=1e-9)
    assert world.names == ("Cup 1",)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("scene.json", b"{", "is not JSON"),
        ("scene.json", b"\xff\xfe", "is not JSON"),
        (
            "scene.json",
            b'{"obstacles": [{"name": "a", "mesh_file": "/etc/hostname"}]}',
            "cannot be read",
        ),
        ("part.stl", b"solid nothing", "'part.stl': holds no triangles"),
        ("seen.ply", b"ply", "'seen.ply': is not a ply file"),
        ("seen.xyz", b"hello", "'seen.xyz': holds no points"),
        ("part.exe", b"", "is neither a scene"),
    ],
)
def test_a_file_that_is_no_scene_is_refused_and_nothing_changes(world, name, content, says):
    with pytest.raises(ConfigError, match=says):
        world.load(name, content)
    assert world.scene == Scene()
    assert not world.history.can_undo


def test_a_scene_that_somebody_else_gave_the_arm_is_taken_over(world):
    world.add("box")
    other = Scene(obstacles=(box_at((0.2, 0.2, 0.1)),))
    world.adopt(other)
    assert world.scene is other
    assert world.due(0.0) is None
    assert world.selected is None


def test_an_obstacle_in_the_arm_or_in_what_it_holds_is_reported_and_what_is_apart_is_not():
    contacts, model, q = OverlapCheck(), RobotModel.load(), np.zeros(5)
    inside = Scene(obstacles=(box_at(model.frame(q, "gripper_link").p),))
    said = in_each_other(contacts.overlap(inside, q, 0.0))
    assert "'block'" in said.text
    assert said.tone is Tone.BAD
    T = model.frame(q) @ SE3.from_translation((0.0, 0.0, 0.1))
    part = Scene(obstacles=(box_at(T.p, name="part", size=0.02),))
    holds = scene_edits.held(part, "part", model.frame(q))
    wall = box_at(T.p - np.array([0.0, 0.0, 0.025]), name="wall", size=0.04)
    assert "'wall'" in contacts.overlap(holds.with_obstacles([wall]), q, 0.0)
    on_the_floor = box_at((0.2, 0.25, 0.0))
    assert contacts.overlap(holds.with_obstacles([on_the_floor]), q, 0.0) is None


def test_a_cloud_stays_where_it_was_seen_and_has_voxels_of_a_size_that_is_chosen(world):
    points = np.random.default_rng(3).uniform(0.2001, 0.2999, (20_000, 3))
    text = "\n".join(f"{x:.5f} {y:.5f} {z:.5f}" for x, y, z in points).encode()
    world.load("shelf.xyz", text)
    cloud = world.thing.shape
    assert world.names == ("shelf 1",)
    assert len(cloud.points) == 1_000
    assert cloud.resolution == 0.01
    np.testing.assert_allclose(world.thing.T_base_obstacle.p + cloud.points.mean(axis=0), 0.25)
    world.set_voxel(0.05)
    assert len(world.thing.shape.points) == 8
    world.history.undo()
    assert len(world.thing.shape.points) == 1_000
    world.set_voxel(0.001)
    world.remove()
    with pytest.raises(ConfigError, match="choose a larger cube size"):
        world.load("wide.xyz", b"".join(b"%g %g 0\n" % (x / 900, y / 900)
                                        for x in range(300) for y in range(300)))  # fmt: skip


BALL = Sphere(radius=0.03)
STICK = Attached(name="stick", shape=BALL, T_tool_object=SE3.identity())
SCENE = Scene(
    obstacles=(
        Obstacle(name="ball", shape=BALL, T_base_obstacle=SE3.from_translation((0.3, 0.1, 0.1))),
    ),
    floor_z=0.01,
)
RAISED = SE3.from_rpy((0.0, 0.0, np.pi), (0.4, 0.0, 0.05))


def rig(*attached):
    """The scene of an arm; nothing else of it is needed here."""
    return SimpleNamespace(arm=SimpleNamespace(scene=Scene(attached=attached)))


def cell(T_right=RAISED):
    arms = (
        CellArm(name="left", T_cell_base=SE3.identity()),
        CellArm(name="right", T_cell_base=T_right, attached=(STICK,)),
    )
    return CellFile(arms=arms, scene=Scene())


def test_each_arm_of_a_cell_sees_the_scene_from_its_base_and_keeps_what_it_holds(tmp_path):
    left, right = rig(), rig(STICK)
    user = ArmsOfCell({"left": left, "right": right}, cell())
    [stick] = user.scene.attached
    assert holder_of(stick) == "right"
    around = replace(SCENE, attached=(stick,))
    user.use(around)
    assert user.scene is around
    assert left.arm.scene == SCENE
    seen = right.arm.scene
    np.testing.assert_allclose(seen.obstacles[0].T_base_obstacle.p, [0.1, -0.1, 0.05], atol=1e-12)
    assert seen.floor_z == pytest.approx(-0.04)
    assert [type(each) for each in seen.attached] == [Attached]
    assert seen == replace(seen, attached=(STICK,))
    user.write(around, tmp_path / "cell.json")
    read = read_cell(tmp_path / "cell.json")
    assert read.scene == SCENE
    assert [each.name for each in read.arms] == ["left", "right"]
    assert [each.name for each in read.arms[1].attached] == ["stick"]


def test_a_scene_that_one_arm_cannot_have_is_given_to_none():
    left, right = rig(), rig()
    leaning = SE3.from_rpy((0.3, 0.0, 0.0), (0.4, 0.0, 0.0))
    user = ArmsOfCell({"left": left, "right": right}, cell(leaning))
    for scene, says in (
        (SCENE, "does not stand upright"),
        (
            replace(SCENE, floor_z=None, attached=(STICK,)),
            "is held, but the file does not say by which arm",
        ),
    ):
        with pytest.raises(ConfigError, match=says):
            user.use(scene)
        assert left.arm.scene == right.arm.scene == Scene()
        assert user.scene == Scene()


def test_what_an_arm_of_a_cell_holds_is_passed_on_put_down_and_taken_by_another(tmp_path):
    T_tool = SE3.from_translation((0.2, 0.0, 0.1))
    left, right = rig(), rig()
    for each in (left, right):
        each.arm.T_base = lambda: T_tool
    user = ArmsOfCell({"left": left, "right": right}, cell())
    tools = user.tools()
    np.testing.assert_allclose(tools["right"].p, [0.2, 0.0, 0.15], atol=1e-12)
    user.use(held(SCENE, "ball", tools["right"], "right"))
    [ball] = right.arm.scene.attached
    assert left.arm.scene.obstacles == left.arm.scene.attached == right.arm.scene.obstacles == ()
    T_cell_ball = tools["right"] @ ball.T_tool_object
    np.testing.assert_allclose(T_cell_ball.p, [0.3, 0.1, 0.1], atol=1e-12)
    before = user.scene
    assert user.scene is before
    left.arm.scene = replace(left.arm.scene, attached=(ball,))  # a handover, with both hands at it
    assert [holder_of(each) for each in user.scene.attached] == ["right"]
    right.arm.scene = replace(right.arm.scene, attached=())
    assert [holder_of(each) for each in user.scene.attached] == ["left"]
    file = tmp_path / "cell.json"
    user.write(user.scene, file)
    assert [len(each.attached) for each in read_cell(file).arms] == [1, 0]
    user.use(let_go(user.scene, "ball", tools["left"]))
    assert [each.name for each in right.arm.scene.obstacles] == ["ball"]
    assert left.arm.scene.attached == ()
