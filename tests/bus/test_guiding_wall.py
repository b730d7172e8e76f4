"""A hand feels a wall where it leads an arm into contact, on emulated servos."""

import math

import numpy as np
import pytest
from harness.random_scenes import obstacle

from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.emulator.hand import Hand, parse_script
from so101_motion.drivers.feetech.hand_guiding import WALL_DEPTH
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene

BEGIN = (60.0, -45.0, 45.0, 60.0, 0.0)
CRATE = obstacle("crate", (0.4, 0.04, 0.4), (0.3, 0.0, 0.2))
GENTLE, STRONG = 1.3, 8.0
"""Torque of a hand [N m]: twice what leads a joint in free space, and more than a servo has."""
PLAY = math.radians(1.0)
"""What the dead band, play and friction of a joint add [rad]."""


pytestmark = pytest.mark.emulated(q_start=(*np.radians(BEGIN), 0.0))


class Guided:
    """An arm that a hand guides, near a crate."""

    def __init__(self, bench):
        self.bench, self.rig = bench, bench.open()
        bench.advance(0.5)
        self.arm = self.rig.arm
        self.arm.set_speed(math.radians(90.0))
        bench.finish(bench.go(self.rig, *BEGIN))
        self.arm.scene = self.arm.scene.with_obstacles([CRATE])
        self.collision = CollisionModel(self.arm.model, self.arm.scene)

    @property
    def q(self):
        """Where the arm truly is, shape (5,), [rad]."""
        return np.radians(self.bench.arm_deg(self.rig))

    @property
    def room(self):
        """Distance to what is nearest [m]."""
        return float(self.collision.distances(self.q, self.arm.state.q_jaw).min())

    def lead(self, script, strength, seconds):
        """Lead it by hand; returns its angles every cycle, (n, 5) [rad], and the least room [m]."""
        self.bench.emulator.advance()
        self.bench.world.hand = Hand(
            parse_script(script), self.bench.clock.now(), strength=strength
        )
        q, room = [], math.inf
        for k in range(round(100.0 * seconds)):
            self.bench.advance(0.01)
            q.append(self.q)
            room = min(room, self.room) if k % 5 == 0 else room
        return np.array(q), room


@pytest.fixture
def guided(bench):
    return Guided(bench)


INTO_CRATE = "0.1 shoulder_pan start\n2.1 shoulder_pan -20\n"
INTO_ITSELF = "0.1 elbow_flex start\n2.1 elbow_flex 95\n"


@pytest.mark.parametrize("script", [INTO_CRATE, INTO_ITSELF])
def test_a_hand_is_held_back_before_contact_and_the_joint_hardly_goes_back(guided, script):
    if script is INTO_ITSELF:  # away from the table, folded
        guided.bench.finish(guided.bench.go(guided.rig, 90.0, -50.0, 45.0, 75.0, 0.0))
    joint = script.split()[1]
    i = ARM_JOINTS.index(joint)
    guided.arm.set_manual(True)
    q, room = guided.lead(script + f"3.0 {joint} release\n", GENTLE, 4.5)
    assert abs(q[250, i] - q[0, i]) > math.radians(4.0), "it was led"
    assert room > 0.0
    at_wall, after = q[300:], guided.q
    assert abs(after[i] - q[299, i]) < WALL_DEPTH + PLAY
    back = np.abs(np.diff(at_wall[:, i])).max() / 0.01
    assert back < math.radians(60.0)
    np.testing.assert_allclose(np.delete(after, i), np.delete(q[0], i), atol=PLAY)


def test_a_strong_hand_gets_past_the_wall_and_the_joint_does_not_jump_when_it_is_let_go(guided):
    guided.arm.set_manual(True)
    q, room = guided.lead(INTO_CRATE + "3.0 shoulder_pan release\n", STRONG, 4.5)
    assert room < 0.0
    assert np.degrees(q[299, 0]) < 0.0
    assert guided.q[0] - q[299, 0] < WALL_DEPTH + PLAY
    assert np.abs(np.diff(q[300:, 0])).max() / 0.01 < math.radians(60.0)


def test_what_the_arm_learns_to_keep_off_is_a_wall_at_once(guided):
    around = guided.arm.scene
    guided.arm.scene = own = Scene()
    guided.arm.set_manual(True)
    guided.arm.keep_off(own, around)
    _, room = guided.lead(INTO_CRATE, GENTLE, 2.5)
    assert room > 0.0


def test_an_arm_in_contact_can_be_led_out_of_it_but_not_deeper(guided):
    scene, guided.arm.scene = guided.arm.scene, Scene()
    guided.bench.finish(guided.bench.go(guided.rig, 46.0, *BEGIN[1:]))
    guided.arm.scene = scene
    inside = guided.q[0]
    assert guided.room < 0.0
    guided.arm.set_manual(True)
    deeper, _ = guided.lead("0.1 shoulder_pan start\n2.1 shoulder_pan -20\n", GENTLE, 2.5)
    assert abs(deeper[-1, 0] - inside) < WALL_DEPTH + PLAY
    out, _ = guided.lead("0.1 shoulder_pan start\n2.1 shoulder_pan 65\n", GENTLE, 2.5)
    assert np.degrees(out[-1, 0]) > 58.0
    assert guided.room > 0.0
