"""Bases for a task: the ten best are planned, verified, and as good as those of a longer search."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, PlanningError
from so101_motion.common.geometry import SE3
from so101_motion.files.cell_file import read_cell
from so101_motion.planning.collision.apart import ROOM
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Box, Obstacle, Scene, StandingArm
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program import Loop, Program, Waypoint, files
from so101_motion.tasks.sweeps import (
    PlaceSweep,
    Region,
    find_bases,
    read_task,
    scene_text,
    task_of,
    task_text,
    write_placement,
)
from so101_motion.tasks.sweeps.mounted_arm import cheapest
from so101_motion.tasks.sweeps.placement_task import task_from

DOWN = {"approach": [0, 0, -1], "approach_tolerance_deg": 15}
TASK = task_from(
    {
        "frame": "jaw_tip",
        "poses": [
            {"name": "left", "position_mm": [200, 80, 60], "aperture_percent": 30, **DOWN},
            {"name": "right", "position_mm": [210, -90, 60], "pause_s": 0.5, **DOWN},
        ],
    }
)
REGION = Region(x=(-0.05, 0.0), y=(-0.03, 0.03), turn=(-0.5, 0.5), spacing=0.05, turn_step=0.5)
SMALL = PlaceSweep(task=task_text(TASK), region=REGION)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("placed") / "out"
    return find_bases(SMALL, folder), folder


def test_the_best_bases_reach_every_pose_free_of_contact(found):
    model = RobotModel.load()
    placement, _ = found
    assert placement.best
    assert [base.time for base in placement.best] == sorted(base.time for base in placement.best)
    for base in placement.best:
        T_cell_base = REGION.base(base.lattice_index)
        collision = CollisionModel(model, REGION.seen_from(Scene(), T_cell_base))
        for pose, q in zip(TASK.poses, base.q, strict=True):
            assert T_cell_base @ model.frame(q, "jaw_tip").p == pytest.approx(pose.p, abs=1e-5)
            axis = T_cell_base.R @ model.frame(q).R[:, 2]
            assert -axis[2] >= math.cos(math.radians(15.1))
            assert model.outside(q) is None
            assert collision.is_free(q)
        assert base.clearance > 0.0
        assert base.torque_left > 0.0
        assert 0.0 <= base.robust <= 1.0


def test_no_base_of_the_first_round_is_better(found):
    placement, _ = found
    every = replace(SMALL, planned=True)
    judge = every.open()
    times = np.concatenate([judge(shard)["time"] for shard in range(every.shards)])
    assert placement.best[0].time <= 1.002 * times.min() + 1e-6
    screened = {each.lattice_index: each.time for each in placement.screened}
    bounds = np.array([screened[index] for index in every.bases])
    assert np.all(bounds <= times + 1e-6)


def test_a_task_out_of_reach_says_which_pose_is_missed(tmp_path):
    far = replace(REGION, x=(-0.9, -0.9))
    with pytest.raises(PlanningError, match=r"miss pose 1 \(left\)"):
        find_bases(replace(SMALL, region=far), tmp_path / "out")


def test_no_base_stands_in_an_obstacle(tmp_path):
    block = Obstacle(
        name="block",
        shape=Box(size=np.array((0.2, 0.2, 0.05))),
        T_base_obstacle=SE3.from_translation((0.0, 0.0, 0.02)),
    )
    scene = scene_text(Scene(obstacles=(block,)))
    with pytest.raises(PlanningError, match="would be inside an obstacle"):
        find_bases(replace(SMALL, scene=scene), tmp_path / "out")


FOLDED = tuple(np.radians([0.0, -92.0, 78.0, 60.0, 0.0, -10.0]).tolist())
ORIGIN = Region(x=(0.0, 0.0), y=(0.0, 0.0), turn=(0.0, 0.0))


def left_at(y: float, *q: tuple[float, ...]) -> Scene:
    T_cell_base = SE3.from_translation((0.0, y, 0.0))
    arm = StandingArm(name="left", T_base_arm=T_cell_base, q=np.array([FOLDED, *q]), room=ROOM)
    return Scene(arms=(arm,))


def test_every_configuration_of_another_arm_is_kept_clear_of(tmp_path):
    """An arm that reaches over one of the poses, at one of two configurations, is in the way."""
    screen = replace(SMALL, region=ORIGIN, scene=scene_text(left_at(-0.3)))
    assert screen.open()(0)["missed"].tolist() == [-1]
    over = (*np.radians([-85.0, 30.0, 0.0, 30.0, 0.0]).tolist(), 0.0)
    reaching = replace(screen, scene=scene_text(left_at(-0.3, over)))
    assert screen.open()(0)["clearance"] > reaching.open()(0)["clearance"]


def test_the_cell_with_the_other_arm_is_written_beside_the_program(tmp_path):
    scene = left_at(-0.4)
    sweep = replace(SMALL, region=ORIGIN, scene=scene_text(scene))
    placement = find_bases(sweep, tmp_path / "out")
    write_placement(placement, sweep, tmp_path / "out", arm="right")
    cell = read_cell(tmp_path / "out" / "best" / "01-cell.json")
    assert [each.name for each in cell.arms] == ["right", "left"]
    assert cell.arms[1].T_cell_base.p == pytest.approx([0.0, -0.4, 0.0])
    assert "left</text>" in (tmp_path / "out" / "map.svg").read_text()
    arm = cell.arms[0]
    seen = ORIGIN.seen_from(scene, arm.T_cell_base)
    collision = CollisionModel(RobotModel.load(), seen)
    for q in placement.best[0].q:
        assert collision.is_free(q)


@pytest.mark.parametrize("mount", ["table", "wall", "upside-down"])
def test_a_base_is_turned_about_its_own_axis_and_sees_the_table_where_it_is(mount):
    region = Region(x=(0.1, 0.1), y=(0.2, 0.2), z=(0.5, 0.5), mount=mount, turn=(0.3, 0.3))
    T = region.base((0, 0, 0, 0))
    assert T.p == pytest.approx([0.1, 0.2, 0.5])
    up = {"table": [0, 0, 1], "wall": [1, 0, 0], "upside-down": [0, 0, -1]}[mount]
    assert T.R[:, 2] == pytest.approx(up, abs=1e-12)
    scene = region.seen_from(Scene(), T)
    if mount == "table":
        assert scene.floor_z == pytest.approx(-0.5024)
        return
    (table,) = scene.obstacles
    size = table.shape.size
    top = T @ table.T_base_obstacle @ SE3.from_translation((0.0, 0.0, size[2] / 2))
    assert top.p == pytest.approx([0.1, 0.2, -0.0024])


def test_gravity_pulls_down_wherever_the_base_is():
    model = RobotModel.load()
    q = np.radians([[20.0, -30.0, 40.0, 30.0, 10.0]])
    hanging = model.mounted(np.diag([1.0, -1.0, -1.0]))
    assert hanging.holding_torques(q) == pytest.approx(-model.holding_torques(q))
    sideways = model.mounted(Region(x=(0, 0), y=(0, 0), mount="wall").base((0, 0, 0, 0)).R)
    assert abs(model.holding_torques(q)[0, 0]) < 1e-6 < abs(sideways.holding_torques(q)[0, 0])


def test_a_program_is_a_task_for_any_base(tmp_path):
    waypoints = tuple(
        Waypoint(name=name, q=np.radians(q))
        for name, q in (
            ("a", [20.0, -20.0, 20.0, 70.0, 0.0]),
            ("b", [-20.0, -10.0, 20.0, 60.0, 9.0]),
        )
    )
    files.write(Program.of_waypoints(waypoints, rounds=1), tmp_path / "program.json")
    task = read_task(tmp_path / "program.json")
    origin = Region(x=(0.0, 0.0), y=(0.0, 0.0), turn=(0.0, 0.0))
    found = find_bases(PlaceSweep(task=task_text(task), region=origin), tmp_path / "out")
    model = RobotModel.load()
    for waypoint, q in zip(waypoints, found.best[0].q, strict=True):
        assert model.frame(q).p == pytest.approx(model.frame(waypoint.q).p, abs=1e-5)
    assert task_of(Program.of_waypoints(waypoints)).poses[0].name == "a"
    picks = Program.of_waypoints((*waypoints, replace(waypoints[0], item="cube")))
    for odd in (picks, Program.of_waypoints(waypoints, loops=(Loop(first=0, last=1, times=2),))):
        with pytest.raises(ConfigError, match="are not possible in a task"):
            task_of(odd)


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"position_mm": [1, 2]}, "position_mm"),
        ({"approach": [0, 0, 0]}, "approach"),
        ({"rpy_deg": [0, 0, 0]}, "approach"),
        ({"roll_tolerance_deg": 5}, "roll_tolerance_deg"),
        ({"colour": "red"}, "colour"),
        ({"pass": True, "pause_s": 1.0}, "pass"),
    ],
)
def test_an_invalid_pose_is_named(changed, key):
    pose = {"name": "there", "position_mm": [200, 0, 50], "approach": [0, 0, -1], **changed}
    with pytest.raises(ConfigError, match=f"pose 2: {key}"):
        task_from({"poses": [{"name": "here", "position_mm": [200, 90, 50]}, pose]})


@pytest.mark.parametrize("closed", [True, False])
def test_the_cheapest_path_is_the_cheapest_of_all(closed):
    random = np.random.default_rng(1)
    counts = (3, 4, 2, 3)
    shapes = [(counts[k], counts[(k + 1) % 4]) for k in range(4 if closed else 3)]
    costs = [random.uniform(size=shape) for shape in shapes]
    total, options = cheapest(costs, closed=closed)

    def cost(choice):
        return sum(of[choice[k], choice[(k + 1) % 4]] for k, of in enumerate(costs))

    assert total == pytest.approx(cost(options))
    assert total == pytest.approx(min(map(cost, itertools.product(*map(range, counts)))))
