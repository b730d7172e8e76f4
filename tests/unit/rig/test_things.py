"""Things around an arm: gripped, held, dropped, lying where they were put."""

import math
from dataclasses import replace

import numpy as np
import pytest
from harness.things_around import DOWN, UP, around, cube, hand, under

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, rot_x
from so101_motion.drivers.emulator.hand import jaw_angle_for_gap
from so101_motion.planning.collision.scene import (
    FLOOR_Z,
    Box,
    Capsule,
    Cylinder,
    Obstacle,
    Scene,
    Sphere,
)
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.rig.things import keep_up, things_in

OPEN, FIRM = math.radians(60.0), 1.3


def at(q, q_jaw):
    return np.append(q, q_jaw)


def gripped(scene, **settings):
    """A world in which the fingers have closed, and where the jaw was stopped."""
    things = things_in(scene, **settings)
    stop = things.follow(at(DOWN, OPEN), 0.0)
    things.follow(at(DOWN, stop), 0.0)
    return things, stop


def carried(scene, torque=FIRM, **settings):
    things, stop = gripped(scene, **settings)
    things.follow(at(UP, stop), torque)
    return things, stop


@pytest.mark.parametrize("edge", [0.01, 0.02, 0.03])
def test_the_jaw_is_stopped_as_wide_as_the_thing(edge):
    _, stop = gripped(around(cube(edge)))
    assert math.degrees(stop - jaw_angle_for_gap(edge)) == pytest.approx(0.0, abs=1.0)


def test_it_goes_with_the_gripper_and_lies_where_it_is_let_go():
    things, stop = gripped(around(cube()))
    lay = things.where("cube")
    beside = (hand(DOWN).inverse @ lay.p)[0] - 0.0125
    assert beside == pytest.approx(-0.0078, abs=1e-4)  # the fixed finger's surface
    things.follow(at(UP, stop - 0.01), FIRM)
    assert things.held == "cube"
    moved = (hand(UP) @ (hand(DOWN).inverse @ lay)).matrix
    assert np.allclose(things.where("cube").matrix, moved, atol=1e-9)
    model = RobotModel.load()
    p_tool = model.frame(UP).inverse @ things.where("cube").p
    loaded = model.with_payload(0.03, p_tool).gravity_torque(at(UP, stop))
    assert things.weight(at(UP, stop)) == pytest.approx(
        loaded - model.gravity_torque(at(UP, stop)), abs=1e-9
    )
    assert things.follow(at(UP, stop + 0.02), 0.0) < stop + 0.02
    assert things.held is None
    assert [each.partition(" at")[0] for each in things.told] == ["cube is gripped", "cube lies"]
    assert things.where("cube").p == pytest.approx([*moved[:2, 3], FLOOR_Z + 0.0125], abs=1e-9)
    assert not things.weight(at(UP, OPEN)).any()


@pytest.mark.parametrize(
    ("torque", "friction", "mass"), [(FIRM, 0.1, 0.5), (0.02, 0.5, 0.4)], ids=["slippery", "heavy"]
)
def test_what_friction_does_not_hold_stays_behind(torque, friction, mass):
    scene = around(replace(cube(), mass=mass))
    things, stop = gripped(scene, friction=friction)
    assert things.held == "cube"
    things.follow(at(UP, stop), torque)
    assert things.held is None
    assert things.where("cube").p[2] == pytest.approx(FLOOR_Z + 0.0125)


def test_what_is_pressed_at_its_edge_is_squeezed_out():
    size = np.array([0.01, 0.04, 0.025])  # turned by 35 deg, so that the fingers meet two corners
    T = under(DOWN, size) @ SE3.from_rpy((0.0, 0.0, math.radians(35.0)))
    bar = Obstacle(name="bar", shape=Box(size=size), T_base_obstacle=T, mass=0.02)
    things, stop = gripped(around(bar))
    assert stop > 0.0
    assert things.held is None
    assert things.follow(at(DOWN, stop), 0.0) == -math.inf  # the jaw closes on
    assert list(things.told) == ["bar was squeezed out of the fingers"]


@pytest.mark.parametrize(
    ("beside", "q_jaw_deg"),
    [(-0.01, 30.0), (0.045, 30.0), (0.09, 60.0)],
    ids=["under the finger", "under the jaw", "beyond the jaw"],
)
def test_what_is_not_between_the_fingers_is_not_gripped(beside, q_jaw_deg):
    things = things_in(around(cube(beside=beside)))
    stop = things.follow(at(DOWN, math.radians(q_jaw_deg)), 0.0)
    assert (stop, things.held) == (-math.inf, None)


@pytest.mark.parametrize(
    ("shape", "turned_deg", "height"),
    [
        (Box(size=np.array([0.02, 0.03, 0.04])), 20.0, 0.02),
        (Box(size=np.array([0.02, 0.03, 0.04])), 80.0, 0.015),
        (Cylinder(radius=0.01, length=0.04), 70.0, 0.01),
        (Sphere(radius=0.015), 10.0, 0.015),
        (Capsule(radius=0.01, length=0.04), 30.0, 0.01),
    ],
)
def test_it_falls_on_the_nearest_face_it_can_lie_on(shape, turned_deg, height):
    T = under(DOWN, np.full(3, 0.02)) @ SE3(rot_x(math.radians(turned_deg)), np.zeros(3))
    item = Obstacle(name="it", shape=shape, T_base_obstacle=T, mass=0.01)
    plate = Obstacle(
        name="plate",
        shape=Box(size=np.array([0.2, 0.2, 0.004])),
        T_base_obstacle=SE3.from_translation((*T.p[:2], FLOOR_Z + 0.002)),
    )
    aside = SE3.from_translation((T.p[0] - 0.1, T.p[1] + 0.1, FLOOR_Z + 0.05))
    post = Obstacle(name="post", shape=Box(size=np.full(3, 0.1)), T_base_obstacle=aside)
    things, _ = carried(around(item, plate, post), friction=10.0)
    assert things.held == "it"
    things.follow(at(UP, OPEN), 0.0)
    assert things.where("it").p[2] == pytest.approx(FLOOR_Z + 0.004 + height, abs=2e-4)


def test_edits_of_a_scene_are_made_but_beliefs_of_an_arm_are_not():
    scene = around(cube(), cube(name="other", beside=0.2))
    things = things_in(scene)

    def edit(new):
        nonlocal scene
        keep_up(things, scene, new)
        scene = new

    there = things.where("cube")
    T_tool = RobotModel.load().frame(DOWN)
    edit(scene.taking("cube", T_tool))
    edit(scene.putting("cube", SE3.from_translation((0.1, 0.1, 0.0))))  # so the arm believes
    edit(scene.taking("cube", T_tool))
    edit(replace(scene, attached=()))  # so it lost it
    assert things.where("cube") is there
    edit(around(cube(), *scene.obstacles))
    edit(Scene(obstacles=tuple(each for each in scene.obstacles if each.name == "other")))
    assert things.names == ("other",)
    moved = replace(scene.items[0], T_base_obstacle=SE3.from_translation((0.1, 0.1, 0.0)))
    edit(around(moved))
    assert things.where("other").p == pytest.approx([0.1, 0.1, 0.0])
    with pytest.raises(ConfigError, match="there are: other"):
        things.where("cube")


def test_a_simulated_gripper_holds_carries_and_notices_a_loss():
    clock = ManualClock()
    with open_simulated(scene=around(cube()), q_start=DOWN, q_jaw_start=OPEN, clock=clock) as rig:

        def finish(motion):
            while not motion.future.done():
                clock.advance(0.05)
            motion.result()

        finish(rig.gripper.grab(wait=False))
        clock.advance(0.2)
        assert rig.gripper.is_holding
        assert rig.gripper.q_jaw == pytest.approx(math.radians(7.3), abs=0.02)
        rig.arm.scene = rig.arm.scene.taking("cube", rig.arm.T_base_tool)
        finish(rig.arm.move(rig.arm.plan(JointGoal(q=UP)), wait=False))
        assert rig.gripper.is_holding
        assert rig.things.where("cube").p[2] > 0.06
        rig.things.take_away("cube")
        clock.advance(0.5)
        assert not rig.gripper.is_holding
