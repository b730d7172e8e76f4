"""The operation of the Pick tab: one command moves the demo's cube onto its tray."""

from concurrent.futures import wait
from dataclasses import replace

import pytest

from so101_motion.cli.view import cube_and_tray
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import ConfigError, NotPossibleNow
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import FLOOR_Z, Box, Obstacle
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.tasks.picking import PickOperation, place_from


def test_one_command_moves_the_cube_onto_the_tray(planning_process):
    clock = ManualClock()
    with open_simulated(scene=cube_and_tray(), clock=clock) as rig:
        operation = PickOperation(rig.picker, place="tray")
        offer = operation.view.offers[-1]
        assert (offer.command, offer.why_not) == ("pick", None)
        assert offer.arguments == {"item": "cube", "place": "tray"}
        started = operation.begin(offer.command, **offer.arguments)
        stages = set()
        while not started.future.done():
            stages.add(operation.view.state)
            clock.advance(0.05)
            wait([started.future], timeout=0.002)
        started.future.result()
        true, view = rig.things.where("cube"), operation.view
        believed = rig.arm.scene.items[0].T_base_obstacle
    assert {"close", "lift", "carry", "let go"} <= stages
    assert true.p == pytest.approx([0.11, -0.2, FLOOR_Z + 0.005 + 0.0125], abs=2e-3)
    assert true.p == pytest.approx(believed.p, abs=1e-3)
    assert {row.mark for row in view.rows} == {"✓"}
    assert view.picture is None


def test_what_was_planned_in_another_scene_is_not_carried_out(planning_process):
    with open_simulated(scene=cube_and_tray(), clock=ManualClock()) as rig:
        operation = PickOperation(rig.picker)
        assert operation.view.offer("run").why_not == "plan it first"
        facts = operation.ask("plan_pick", item="cube")
        assert [row.label for row in operation.view.rows] == list(facts["stages_s"])
        assert len(operation.view.picture.ghosts) == len(operation.view.rows)
        assert {offer.command: offer.why_not for offer in operation.view.offers}["run"] is None
        at = SE3.from_translation([0.2, 0.0, 0.1])
        wall = Obstacle(name="wall", shape=Box(size=[0.02, 0.4, 0.2]), T_base_obstacle=at)
        rig.arm.scene = replace(rig.arm.scene, obstacles=(*rig.arm.scene.obstacles, wall))
        with pytest.raises(NotPossibleNow, match="the scene has changed"):
            operation.begin("run")


def test_a_miss_of_what_was_planned_is_followed_by_grasps_as_they_were_wished(
    planning_process, monkeypatch
):
    asked = []
    monkeypatch.setattr(PickOperation, "_begin", lambda _, *given: asked.append(given))
    with open_simulated(scene=cube_and_tray(), clock=ManualClock()) as rig:
        operation = PickOperation(rig.picker)
        facts = operation.begin("plan_pick", item="cube", approach="above")
        operation.begin("run", tries=2)
    ((item, _, wishes, tries, plan),) = asked
    assert (item, wishes.kinds, tries) == ("cube", ("above",), 2)
    assert plan.grasp.kind == facts["approach"] == "above"


def test_a_place_is_a_point_or_what_is_put_on():
    scene = cube_and_tray()
    assert place_from("", scene) is None
    assert place_from("tray", scene).p == pytest.approx([0.11, -0.2, FLOOR_Z + 0.005])
    assert place_from("200, 120, 0, 90", scene).yaw == pytest.approx(1.5708, abs=1e-4)
    with pytest.raises(ConfigError, match="or the name of an obstacle"):
        place_from("trey", scene)
