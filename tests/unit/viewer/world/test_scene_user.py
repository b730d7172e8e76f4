"""Whose scene the World tab edits: an arm's, or that of several arms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from so101_viewer.scene.scene_edits import held, holder_of, let_go
from so101_viewer.world.scene_user import ArmsOfCell, OneArm

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.files.cell_file import CellArm, CellFile, read_cell
from so101_motion.files.scene_file import read_scene
from so101_motion.planning.collision.scene import Attached, Obstacle, Scene, Sphere

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


def test_a_single_arm_has_the_scene_as_it_is(tmp_path):
    only = rig()
    user = OneArm(only)
    user.use(SCENE)
    assert only.arm.scene is user.scene is SCENE
    user.write(SCENE, tmp_path / "scene.json")
    assert read_scene(tmp_path / "scene.json") == SCENE
