"""Requests of the motion service for several arms: moving together and handing over."""

import asyncio
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import pytest
from harness.facing_arms import T_LEFT_RIGHT

from so101_motion.arm.cell import Cell
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import ConfigError, OutsideLimits
from so101_motion.common.geometry import SE3
from so101_motion.common.units import to_rad
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.viam.requests.together import hand_over, move_together, set_held

ASIDE = np.radians([60.0, -30.0, 30.0, 30.0, 0.0])
STICK = {"name": "stick", "box_mm": [20, 20, 160], "position_mm": [0, 0, 150], "mass_kg": 0.04}


@dataclass
class HereArm:
    """An arm of this process with nothing around it."""

    rig: Rig
    short_name: str
    shared: Cell

    async def ready(self):
        pass

    @property
    def cell(self):
        return self

    def cell_of(self, name):
        return self.shared

    @property
    def surroundings(self):
        return self

    async def around(self, scene):
        return scene


@pytest.fixture
def arms():
    with ExitStack() as stack:
        clock, cell, made = ManualClock(), Cell(), {}
        for name, T in (("left", SE3.identity()), ("right", T_LEFT_RIGHT)):
            fast = {"speed": to_rad(180.0), "acceleration": to_rad(500.0)}
            rig = stack.enter_context(open_simulated(clock=clock, q_start=ASIDE, **fast))
            cell.add(name, rig, T)
            made[name] = HereArm(rig, name, cell)
        yield made


async def seen_through(_, motion):
    await asyncio.wrap_future(motion.future)


async def in_time(arms, asked):
    """Ask for a handover while time passes; hardly while an arm's thread may be about to begin."""
    passing = asyncio.ensure_future(hand_over(asked, arms, seen_through))
    rested = 0
    while not passing.done():
        rigs = [arm.rig for arm in arms.values()]
        moving = any(rig.arm.state.arm_moving or rig.gripper.is_moving for rig in rigs)
        rested = 0 if moving else rested + 1
        await asyncio.sleep(0.001)
        rigs[0].clock.advance(0.01 if moving or rested % 20 == 0 else 0.0)
    return passing.result()


async def test_what_an_arm_holds_is_said_and_passed_on(arms):
    await set_held({"left": [STICK]}, arms)
    taken = await in_time(arms, {"from": "left", "to": "right", "object": "stick"})
    assert (taken["name"], taken["mass_kg"]) == ("stick", 0.04)
    assert arms["left"].rig.arm.scene.attached == ()
    [held] = arms["right"].rig.arm.scene.attached
    np.testing.assert_allclose(1e3 * held.T_tool_object.p, taken["position_mm"], atol=1e-3)
    await set_held({"right": []}, arms)
    assert arms["right"].rig.arm.scene.attached == ()


@pytest.mark.parametrize(
    ("goal", "error", "says"),
    [
        ([0.0], ConfigError, "must be"),
        ({}, ConfigError, "one of joints_deg and pose"),
        ({"joint_deg": [0, 0, 0, 0, 0]}, ConfigError, 'did you mean "joints_deg"'),
        ({"joints_deg": [0, 0]}, ConfigError, '"joints_deg"'),
        ({"joints_deg": [0, 0, 0, 0, 300]}, OutsideLimits, "wrist_roll"),
        ({"pose": [200, 0, 150]}, ConfigError, '"pose"'),
        ({"pose": {"z_mm": 150}}, ConfigError, '"z_mm"'),
        ({"pose": {"o_z": "up"}}, ConfigError, '"o_z"'),
    ],
)
async def test_an_invalid_goal_is_refused_with_the_name_of_its_arm(arms, goal, error, says):
    valid = {"joints_deg": [0, 0, 0, 0, 0]}
    with pytest.raises(error, match=f"^right: .*{says}"):
        await move_together({"left": valid, "right": goal}, arms, seen_through)


async def test_an_invalid_handover_or_thing_in_a_hand_is_refused(arms):
    with pytest.raises(ConfigError, match=r"^right: .*mass_kg"):
        await set_held({"left": [STICK], "right": [STICK | {"mass_kg": -1}]}, arms)
    assert arms["left"].rig.arm.scene.attached == ()
    with pytest.raises(ConfigError, match="lft"):
        await hand_over({"from": "lft", "to": "right", "object": "stick"}, arms, seen_through)
    with pytest.raises(ConfigError, match="which holds: nothing"):
        await hand_over({"from": "left", "to": "right", "object": "stick"}, arms, seen_through)
    with pytest.raises(ConfigError, match="must be"):
        await hand_over("left", arms, seen_through)
    with pytest.raises(ConfigError, match="lft"):
        await set_held({"lft": []}, arms)
