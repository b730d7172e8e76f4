"""The arms of a cell file, opened: those without a port are simulated."""

import time
from concurrent.futures import wait

import numpy as np
import pytest
from harness.facing_arms import Facing
from so101_viewer.world.scene_user import ArmsOfCell

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import BusError, ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.files.cell_file import CellArm, CellFile
from so101_motion.planning.collision.scene import FLOOR_Z, Box, Obstacle, Scene
from so101_motion.rig.cell_rigs import open_cell
from so101_motion.tasks.program import Program, Waypoint, rehearse, start_program


def test_all_arms_are_opened_and_know_each_other_and_what_is_around():
    box = Obstacle(
        name="box",
        shape=Box(size=[0.1] * 3),
        T_base_obstacle=SE3.from_translation((0.2, 0.3, 0.05)),
    )
    arms = tuple(
        CellArm(name=name, T_cell_base=SE3.from_translation(p))
        for name, p in (("left", (0.0, 0.0, 0.0)), ("right", (0.0, -0.5, 0.0)))
    )
    clock = ManualClock()
    with open_cell(CellFile(arms=arms, scene=Scene(obstacles=(box,))), clock=clock) as opened:
        assert list(opened.rigs) == ["left", "right"]
        (other,) = opened.cell.members["left"].others()
        assert other.name == "right"
        np.testing.assert_allclose(other.T_base_other.p, [0.0, -0.5, 0.0])
        (seen,) = opened.rigs["right"].arm.scene.obstacles
        np.testing.assert_allclose(seen.T_base_obstacle.p, [0.2, 0.8, 0.05])


def test_simulated_arms_stand_where_they_keep_apart():
    arms = (
        CellArm(name="left", T_cell_base=SE3.identity()),
        CellArm(name="right", T_cell_base=SE3.from_rpy((0.0, 0.0, np.pi), (0.35, 0.0, 0.0))),
    )
    with open_cell(CellFile(arms=arms, scene=Scene()), clock=ManualClock()) as opened:
        q_left, q_right = (rig.arm.state.q for rig in opened.rigs.values())
        assert Facing(1).are_apart(q_left, q_right)


def test_one_port_under_two_names_is_refused_before_it_is_opened(tmp_path):
    (tmp_path / "by-id").symlink_to(tmp_path / "tty")
    arms = tuple(
        CellArm(name=name, port=str(tmp_path / port), T_cell_base=SE3.identity())
        for name, port in (("left", "tty"), ("right", "by-id"))
    )
    with pytest.raises(ConfigError, match="under another name"):
        open_cell(CellFile(arms=arms, scene=Scene()), clock=ManualClock())


def test_an_arm_that_cannot_be_opened_is_named(tmp_path):
    arms = (CellArm(name="bea", T_cell_base=SE3.identity(), port=str(tmp_path / "none")),)
    with pytest.raises(BusError, match=r"^bea: .*no such port"):
        open_cell(CellFile(arms=arms, scene=Scene()))


def test_a_cube_that_one_arm_puts_down_is_picked_by_the_other_in_one_program():
    T = SE3.from_translation((0.2, 0.05, FLOOR_Z + 0.0125))
    cube = Obstacle(name="cube", shape=Box(size=[0.025] * 3), T_base_obstacle=T, mass=0.02)
    arms = tuple(
        CellArm(name=name, T_cell_base=SE3.from_rpy((0.0, 0.0, turn), (x, 0.0, 0.0)))
        for name, turn, x in (("left", 0.0, 0.0), ("right", np.pi, 0.4))
    )
    q = np.radians([0.0, -90.0, 70.0, 70.0, 0.0])
    file, clock = CellFile(arms=arms, scene=Scene(obstacles=(cube,))), ManualClock()
    with open_cell(file, clock=clock) as opened:
        for rig in opened.rigs.values():
            rig.arm.set_speed(np.radians(180.0))
        page = ArmsOfCell(opened.rigs, file)

        def step(name, place, q=q):
            return {name: Waypoint(name="over", q=q, item="cube", place=place)}

        aside = {"left": Waypoint(name="aside", q=np.append(1.2, q[1:]))}
        steps = step("left", "200,-60,0"), aside, step("right", ""), step("right", "180,-100,0")
        run = start_program(opened.cell, rehearse(opened.cell, Program(steps=steps)))
        held, end = set(), time.monotonic() + 120.0
        while not run.future.done() and time.monotonic() < end:
            clock.advance(0.05)
            wait([run.future], timeout=0.001)
            held |= {(each.name, each.holder) for each in page.scene.attached}
        run.future.result(0.0)
        for rig in opened.rigs.values():
            (item,) = rig.arm.scene.items
            np.testing.assert_allclose(
                rig.things.where("cube").p, item.T_base_obstacle.p, atol=3e-3
            )
        (shown,) = page.scene.items
    assert held == {("cube", "left"), ("cube", "right")}
    np.testing.assert_allclose(shown.T_base_obstacle.p[:2], [0.4 - 0.18, 0.1], atol=3e-3)
